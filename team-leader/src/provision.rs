//! The team's own authority: makes the certificates of its members, and the roster by which routers know them.
//!
//! ```text
//! pki/authority.pem  authority.key          the key never leaves this folder
//! pki/team.toml                             who is accepted, by name and generation
//! pki/robot-r1/   authority.pem  certificate.pem  key.pem                 copied as a whole to robot r1: [security] folder
//! pki/leader-l1/  the same, and team.toml   (kept up to date here; copy it again after every change)
//! pki/router-z1/  the same, and router.json5 for zenohd
//! ```
//! Renewing keeps the name, so no rule changes. Rotating gives a new name and accepts both until the older is revoked.
//! Revoking takes the name out of the rules; it never comes back.

use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use protocol::document::DocumentError;
use protocol::id::{MemberId, TeamId};
use protocol::security::roster::{Entry, MAX_MEMBERS, Role, Roster, common_name};
use protocol::security::rules;
use protocol::time::Timestamp;
use protocol::whole_file;
use rcgen::{
    BasicConstraints, CertificateParams, DistinguishedName, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair,
    KeyUsagePurpose,
};
use time::OffsetDateTime;

/// Certificates begin so long ago: clocks of robots that have just been switched on may be behind.
const BEGINS_EARLIER: Duration = Duration::from_secs(86_400);
/// How long the authority lives: ten years.
pub const AUTHORITY_VALID: Duration = Duration::from_secs(3650 * 86_400);
/// Hosts that every leader's and router's certificate is for.
const OWN_HOSTS: [&str; 3] = ["localhost", "127.0.0.1", "::1"];
/// Most hosts in one certificate.
pub const MAX_HOSTS: usize = 32;

/// Why nothing was provisioned.
#[derive(Debug, thiserror::Error)]
pub enum ProvisionError {
    /// A file cannot be read or written.
    #[error("{}: {source}", path.display())]
    File {
        /// Which.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// There is an authority already.
    #[error("{}: there is an authority already; another one would make all its certificates worthless. Use another folder", .0.display())]
    AuthorityExists(PathBuf),
    /// There is none.
    #[error("{folder}: no authority here; make one first: team-leader provision --pki {folder} authority --team NAME", folder = .0.display())]
    NoAuthority(PathBuf),
    /// The roster cannot be read.
    #[error(transparent)]
    Roster(#[from] DocumentError),
    /// The member has a certificate.
    #[error(
        "{role} {name} has a certificate already: --renew makes a new one of the same name, --rotate one of a new name"
    )]
    Exists {
        /// Its role.
        role: Role,
        /// Its name.
        name: MemberId,
    },
    /// The member has none.
    #[error("there is no {role} {name} whose certificate could be {what}")]
    Unknown {
        /// Its role.
        role: Role,
        /// Its name.
        name: MemberId,
        /// Renewed, rotated, revoked.
        what: &'static str,
    },
    /// Too many of a kind.
    #[error("the team has {MAX_MEMBERS} {0}s already, and more are not provided for")]
    TooMany(Role),
    /// A host that is none.
    #[error("the host {host:?} {problem}")]
    Host {
        /// As given.
        host: String,
        /// What is wrong.
        problem: String,
    },
    /// The certificate cannot be made.
    #[error("the certificate cannot be made: {0}")]
    Certificate(#[from] rcgen::Error),
}

/// What is wanted of a member that may have a certificate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Issue {
    /// Its first one, or the next after all were revoked.
    First,
    /// Another one of the same name, before the old one expires.
    Renewed,
    /// One of the next name; both are accepted until the older is revoked.
    Rotated,
}

/// A folder with an authority, its roster and its members' folders.
#[derive(Debug)]
pub struct Pki {
    folder: PathBuf,
    roster: Roster,
}

impl Pki {
    /// Makes an authority for a team.
    ///
    /// # Errors
    /// There is one already, or the folder cannot be written.
    pub fn create(folder: &Path, team: TeamId, now: Timestamp) -> Result<Self, ProvisionError> {
        std::fs::create_dir_all(folder).map_err(|source| ProvisionError::File { path: folder.to_owned(), source })?;
        if folder.join("authority.pem").exists() || folder.join("team.toml").exists() {
            return Err(ProvisionError::AuthorityExists(folder.to_owned()));
        }
        let mut params = CertificateParams::new(Vec::new())?;
        params.distinguished_name = named(&format!("{team} authority"));
        params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
        params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
        lasts(&mut params, now, AUTHORITY_VALID);
        let key = KeyPair::generate()?;
        let certificate = params.self_signed(&key)?;
        write_secret(&folder.join("authority.key"), &key.serialize_pem())?;
        write(&folder.join("authority.pem"), &certificate.pem())?;
        let pki = Self { folder: folder.to_owned(), roster: Roster::new(team) };
        pki.write_roster()?;
        Ok(pki)
    }

    /// Opens the folder of an authority.
    ///
    /// # Errors
    /// None there, or a roster that cannot be read.
    pub fn open(folder: &Path) -> Result<Self, ProvisionError> {
        if !folder.join("authority.pem").exists() {
            return Err(ProvisionError::NoAuthority(folder.to_owned()));
        }
        Ok(Self { folder: folder.to_owned(), roster: Roster::read(&folder.join("team.toml"))? })
    }

    /// Who is accepted.
    pub fn roster(&self) -> &Roster {
        &self.roster
    }

    /// The folder of a member: what it needs as `[security] folder`.
    pub fn folder_of(&self, role: Role, name: MemberId) -> PathBuf {
        self.folder.join(format!("{role}-{name}"))
    }

    /// Makes a certificate and its folder. `hosts` are the names and addresses under which a leader or router is reached; a renewed
    /// certificate needs them again.
    ///
    /// # Errors
    /// A member that has (or has not) a certificate, hosts that are none or of one who does not listen, files.
    pub fn issue(
        &mut self,
        role: Role,
        name: MemberId,
        what: Issue,
        hosts: &[String],
        (now, valid): (Timestamp, Duration),
    ) -> Result<PathBuf, ProvisionError> {
        let hosts = checked_hosts(role, hosts)?;
        let full = self.roster.of(role).len() >= MAX_MEMBERS;
        let known = self.roster.of(role).get(&name);
        let live = known.is_some_and(|entry| !entry.accepted.is_empty());
        match what {
            Issue::First if live => return Err(ProvisionError::Exists { role, name }),
            Issue::First if full && known.is_none() => return Err(ProvisionError::TooMany(role)),
            Issue::Renewed if !live => return Err(ProvisionError::Unknown { role, name, what: "renewed" }),
            Issue::Rotated if !live => return Err(ProvisionError::Unknown { role, name, what: "rotated" }),
            _ => {}
        }
        let mut entry = known.cloned().unwrap_or_default();
        if what != Issue::Renewed {
            entry.issued += 1;
            entry.accepted.insert(entry.issued);
        }
        let authority = read(&self.folder.join("authority.pem"))?;
        let issuer_key = KeyPair::from_pem(&read(&self.folder.join("authority.key"))?)?;
        let issuer = Issuer::from_ca_cert_pem(&authority, issuer_key)?;
        let mut params = CertificateParams::new(hosts)?;
        params.distinguished_name = named(&common_name(self.roster.team, role, name.as_str(), entry.issued));
        params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ClientAuth];
        if listens(role) {
            params.extended_key_usages.push(ExtendedKeyUsagePurpose::ServerAuth);
        }
        lasts(&mut params, now, valid);
        let key = KeyPair::generate()?;
        let certificate = params.signed_by(&key, &issuer)?;
        let folder = self.folder_of(role, name);
        std::fs::create_dir_all(&folder).map_err(|source| ProvisionError::File { path: folder.clone(), source })?;
        write_secret(&folder.join("key.pem"), &key.serialize_pem())?;
        write(&folder.join("certificate.pem"), &certificate.pem())?;
        write(&folder.join("authority.pem"), &authority)?;
        self.roster.of_mut(role).insert(name, entry);
        self.write_roster()?;
        Ok(folder)
    }

    /// Takes a member's certificates out of the rules: all, or (`older_only`) all but the newest after a rotation.
    ///
    /// # Errors
    /// A member that has none.
    pub fn revoke(&mut self, role: Role, name: MemberId, older_only: bool) -> Result<Vec<u32>, ProvisionError> {
        let unknown = ProvisionError::Unknown { role, name, what: "revoked" };
        let entry = self.roster.of_mut(role).get_mut(&name).ok_or(unknown)?;
        let newest = entry.issued;
        let gone = entry.accepted.iter().copied().filter(|g| !older_only || *g != newest).collect::<Vec<_>>();
        entry.accepted.retain(|generation| !gone.contains(generation));
        self.write_roster()?;
        Ok(gone)
    }

    /// The roster, here and in the folders of those who route.
    fn write_roster(&self) -> Result<(), ProvisionError> {
        let text = toml::to_string(&self.roster).map_err(|error| ProvisionError::File {
            path: self.folder.join("team.toml"),
            source: std::io::Error::other(error),
        })?;
        let text =
            format!("# Who is in the team, by `team-leader provision`. Every leader needs the present one.\n{text}");
        for role in [Role::Leader, Role::Router] {
            for name in self.roster.of(role).keys() {
                let folder = self.folder_of(role, *name);
                if role == Role::Router {
                    write(&folder.join("router.json5"), &rules::zenohd(&self.roster))?;
                }
                write(&folder.join("team.toml"), &text)?;
            }
        }
        write(&self.folder.join("team.toml"), &text)
    }
}

/// An entry in words for people.
pub fn generations(entry: &Entry) -> String {
    if entry.accepted.is_empty() {
        return "revoked".to_owned();
    }
    let accepted: Vec<String> = entry.accepted.iter().map(u32::to_string).collect();
    format!("accepted: {} of {}", accepted.join(", "), entry.issued)
}

fn listens(role: Role) -> bool {
    matches!(role, Role::Leader | Role::Router)
}

fn checked_hosts(role: Role, hosts: &[String]) -> Result<Vec<String>, ProvisionError> {
    let wrong = |host: &str, problem: &str| ProvisionError::Host { host: host.to_owned(), problem: problem.to_owned() };
    if !listens(role) {
        return hosts.first().map_or(Ok(Vec::new()), |host| {
            Err(wrong(host, &format!("is for leaders and routers: nobody connects to a {role}")))
        });
    }
    if hosts.len() > MAX_HOSTS {
        return Err(wrong(&hosts[MAX_HOSTS], &format!("is one too many: at most {MAX_HOSTS}")));
    }
    for host in hosts {
        let is_name = !host.is_empty() && host.chars().all(|c| c.is_ascii_alphanumeric() || c == '-' || c == '.');
        if host.parse::<IpAddr>().is_err() && !is_name {
            return Err(wrong(host, "is neither a name nor an address, as lead.local or 192.168.1.10 (no port)"));
        }
    }
    Ok(OWN_HOSTS.into_iter().map(str::to_owned).chain(hosts.iter().cloned()).collect())
}

fn named(common_name: &str) -> DistinguishedName {
    let mut name = DistinguishedName::new();
    name.push(DnType::CommonName, common_name);
    name
}

fn lasts(params: &mut CertificateParams, now: Timestamp, valid: Duration) {
    let date = |at: Timestamp| {
        let seconds = i64::try_from(at.0 / 1_000_000_000).unwrap_or(i64::MAX);
        OffsetDateTime::from_unix_timestamp(seconds).unwrap_or(OffsetDateTime::UNIX_EPOCH)
    };
    params.not_before = date(now - BEGINS_EARLIER);
    params.not_after = date(now + valid);
}

fn read(path: &Path) -> Result<String, ProvisionError> {
    std::fs::read_to_string(path).map_err(|source| ProvisionError::File { path: path.to_owned(), source })
}

/// Whole or not at all: a leader that starts meanwhile reads the old one.
fn write(path: &Path, text: &str) -> Result<(), ProvisionError> {
    write_with_mode(path, text, 0o644)
}

fn write_secret(path: &Path, text: &str) -> Result<(), ProvisionError> {
    write_with_mode(path, text, 0o600)
}

fn write_with_mode(path: &Path, text: &str, mode: u32) -> Result<(), ProvisionError> {
    whole_file::replace(path, text.as_bytes(), mode)
        .map_err(|source| ProvisionError::File { path: path.to_owned(), source })
}

#[cfg(test)]
mod tests;
