//! Who may be in a team, and what each may say and read: one section of a configuration file.
//!
//! ```text
//! team-leader provision ──▶ authority ──▶ a certificate a robot, leader, operator, router   (names: `roster`)
//!                                  └────▶ team.toml: which certificates are accepted
//!                                             └──▶ rules: one set, for every router (leaders in their process, zenohd as a file)
//! ```
//! Certificates are checked before anything connects ([`preflight`]), because on the network a failed handshake looks like nobody
//! being there. The rules are per name on the certificate, and everything that no rule allows is denied.
//!
//! Without the section only this host can join: a leader listens on loopback.

#[cfg(feature = "zenoh")]
pub mod preflight;
pub mod roster;
pub mod rules;

use std::path::{Path, PathBuf};

use serde::Deserialize;

use crate::document::{DEFAULT_ENDPOINT, Document, DocumentError};
use crate::id::TeamId;
use roster::{Names, Role, Roster, common_name};

/// `[security]` as it stands in the file.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RawSecurity {
    /// `"tls"`: certificates and access control. `"password"`: user and password, unencrypted, for a team with a single
    /// router. `"none"`: whoever reaches the address is part of the team. Required.
    pub mode: String,
    /// `tls`: the folder that `team-leader provision` made for this member: `authority.pem`, `certificate.pem`, `key.pem`, and for a
    /// leader `team.toml`. Default `security`.
    pub folder: Option<PathBuf>,
    /// `password`: the file with this member's own password (one line); its user is its name. Required there.
    pub password_file: Option<PathBuf>,
    /// `password`, leaders: the file with everybody's `user:password`, one a line; users are `robot.r1`, `operator.ann`. Required there.
    pub passwords_file: Option<PathBuf>,
}

/// How a program is protected, checked against where it listens and connects.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum Security {
    /// Nothing was said: this host alone.
    #[default]
    Loopback,
    /// `mode = "none"`: whoever reaches the address is part of the team.
    Open,
    /// `mode = "tls"`.
    Tls(Credentials),
    /// `mode = "password"`.
    Password(Passwords),
}

/// A member's folder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Credentials {
    /// The folder.
    pub folder: PathBuf,
}

/// A member's user and password, and for the router everybody's.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Passwords {
    /// The team.
    pub team: TeamId,
    /// `robot.r1`.
    pub user: String,
    /// The file with its password.
    pub password_file: PathBuf,
    /// The file with everybody's, where this is the router.
    pub passwords_file: Option<PathBuf>,
}

/// Who a configuration is for.
#[derive(Debug, Clone, Copy)]
pub struct Member<'a> {
    /// The team.
    pub team: TeamId,
    /// What it is in the team.
    pub role: Role,
    /// Its name.
    pub name: &'a str,
}

impl Credentials {
    /// The certificate by which all others are judged.
    pub fn authority(&self) -> PathBuf {
        self.folder.join("authority.pem")
    }

    /// The member's own certificate.
    pub fn certificate(&self) -> PathBuf {
        self.folder.join("certificate.pem")
    }

    /// Its private key.
    pub fn key(&self) -> PathBuf {
        self.folder.join("key.pem")
    }

    /// Who is accepted: needed by those who route.
    pub fn roster(&self) -> PathBuf {
        self.folder.join("team.toml")
    }
}

impl Security {
    /// Checks the section against the endpoints that the file gives (`None`: not given).
    ///
    /// # Errors
    /// A mode that does not exist or lacks its keys, keys of another mode, endpoints that do not fit the mode: listening beyond
    /// loopback without a section, `tcp/` under TLS, several routers with passwords.
    pub fn checked(
        document: &Document,
        raw: Option<&RawSecurity>,
        who: Member,
        listen: Option<&[String]>,
        connect: Option<&[String]>,
    ) -> Result<Self, DocumentError> {
        let security = match raw {
            None => Self::Loopback,
            Some(raw) => raw.mode(document, who)?,
        };
        let tls = matches!(security, Self::Tls(_));
        for (key, endpoints) in [("network.listen", listen), ("network.connect", connect)] {
            for endpoint in endpoints.unwrap_or_default() {
                let wanted = match (tls, endpoint.starts_with("tls/")) {
                    (true, false) => {
                        "with [security] mode = \"tls\" every endpoint begins with tls/, as tls/192.168.1.10:7447"
                    }
                    (false, true) => "an endpoint with tls/ needs [security] mode = \"tls\" and certificates",
                    _ => continue,
                };
                return Err(document.invalid(key, format!("{endpoint:?}"), wanted));
            }
        }
        if security == Self::Loopback
            && let Some(open) = listen.unwrap_or_default().iter().find(|endpoint| !is_loopback(endpoint))
        {
            let wanted = "without [security] a leader listens on this host alone (127.0.0.1, [::1], localhost); give it [security] \
                          mode = \"tls\" and certificates (team-leader provision), or say mode = \"none\" where whoever reaches \
                          the address may be part of the team";
            return Err(document.invalid("network.listen", format!("{open:?}"), wanted));
        }
        if let Self::Password(_) = security {
            security.refuse_several_routers(document, who, connect.unwrap_or_default())?;
        }
        Ok(security)
    }

    fn refuse_several_routers(
        &self,
        document: &Document,
        who: Member,
        connect: &[String],
    ) -> Result<(), DocumentError> {
        let most = usize::from(who.role != Role::Leader);
        if connect.len() <= most {
            return Ok(());
        }
        let wanted = "[security] mode = \"password\" is for teams with a single router: a second one could not tell who speaks \
                      through the first. Use mode = \"tls\", or one leader alone";
        Err(document.invalid("network.connect", format!("{connect:?}"), wanted))
    }

    /// Where a leader listens and an agent connects when the file gives nothing.
    pub fn default_endpoint(&self) -> String {
        match self {
            Self::Tls(_) => DEFAULT_ENDPOINT.replacen("tcp/", "tls/", 1),
            _ => DEFAULT_ENDPOINT.to_owned(),
        }
    }

    /// One line for people.
    pub fn in_words(&self) -> String {
        match self {
            Self::Loopback => "none: this host alone".to_owned(),
            Self::Open => "none, as [security] says: whoever reaches the address is part of the team".to_owned(),
            Self::Tls(credentials) => format!("certificates and access control ({})", credentials.folder.display()),
            Self::Password(passwords) => {
                format!("user {} and password, unencrypted: no secret from who shares the network", passwords.user)
            }
        }
    }

    /// What a router enforces: `access_control` of Zenoh's configuration. `None` where everybody may do everything.
    ///
    /// # Errors
    /// The roster or the passwords cannot be read.
    pub fn access_control(&self) -> Result<Option<serde_json::Value>, DocumentError> {
        match self {
            Self::Loopback | Self::Open => Ok(None),
            Self::Tls(credentials) => {
                Ok(Some(rules::access_control(&Roster::read(&credentials.roster())?, Names::Certificates)))
            }
            Self::Password(passwords) => match &passwords.passwords_file {
                None => Ok(None),
                Some(file) => {
                    Ok(Some(rules::access_control(&Roster::of_passwords(passwords.team, file)?, Names::Users)))
                }
            },
        }
    }
}

impl RawSecurity {
    fn mode(&self, document: &Document, who: Member) -> Result<Security, DocumentError> {
        let foreign = |fits: [(&str, bool); 3]| {
            let stray = fits.into_iter().find(|(_, stands)| *stands);
            let mode = &self.mode;
            stray.map_or(Ok(()), |(key, _)| {
                let key = format!("security.{key}");
                Err(document.invalid(&key, "given", format!("mode = {mode:?} has no such key; leave it out")))
            })
        };
        let (folder, own, all) = (self.folder.is_some(), self.password_file.is_some(), self.passwords_file.is_some());
        match self.mode.as_str() {
            "none" => {
                foreign([("folder", folder), ("password_file", own), ("passwords_file", all)])?;
                Ok(Security::Open)
            }
            "tls" => {
                foreign([("folder", false), ("password_file", own), ("passwords_file", all)])?;
                let folder = self.folder.as_deref().unwrap_or(Path::new("security"));
                Ok(Security::Tls(Credentials { folder: document.resolve(folder) }))
            }
            "password" => {
                foreign([("folder", folder), ("password_file", false), ("passwords_file", false)])?;
                let missing = |key: &str, wanted: &str| document.invalid(&format!("security.{key}"), "missing", wanted);
                let leads = who.role == Role::Leader;
                let own = self.password_file.as_ref().map(|file| document.resolve(file));
                let all = self.passwords_file.as_ref().map(|file| document.resolve(file));
                match (own, all, leads) {
                    (Some(password_file), all, _) if leads == all.is_some() => Ok(Security::Password(Passwords {
                        team: who.team,
                        user: format!("{}.{}", who.role, who.name),
                        password_file,
                        passwords_file: all,
                    })),
                    (None, ..) => Err(missing("password_file", "the file with this member's own password, one line")),
                    (_, None, _) => {
                        Err(missing("passwords_file", "the file with everybody's user:password, one a line"))
                    }
                    _ => Err(document.invalid(
                        "security.passwords_file",
                        "given",
                        "only a leader has everybody's passwords",
                    )),
                }
            }
            other => {
                let wanted = "\"tls\" (certificates and access control), \"password\" (a single router, unencrypted) or \"none\" \
                              (whoever reaches the address is part of the team)";
                Err(document.invalid("security.mode", format!("{other:?}"), wanted))
            }
        }
    }
}

impl Member<'_> {
    /// The name on its certificate of that generation.
    pub fn common_name(&self, generation: u32) -> String {
        common_name(self.team, self.role, self.name, generation)
    }
}

/// The host of an endpoint.
pub(crate) fn host_of(endpoint: &str) -> &str {
    let address = endpoint.split(['#', '?']).next().unwrap_or_default();
    let address = address.split_once('/').map_or(address, |(_, address)| address);
    address.rsplit_once(':').map_or(address, |(host, _)| host).trim_matches(['[', ']'])
}

/// Whether only this host reaches the endpoint.
pub fn is_loopback(endpoint: &str) -> bool {
    let host = host_of(endpoint);
    host == "localhost" || host.parse::<std::net::IpAddr>().is_ok_and(|address| address.is_loopback())
}

#[cfg(test)]
mod tests;
