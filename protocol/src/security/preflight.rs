//! Certificates looked at before connecting, and a failed handshake put into words.
//!
//! Over Zenoh a wrong authority, an expired certificate and nobody being there look the same ("Timeout!"). So whatever can be
//! known from the files is checked first, and when no connection comes about, the handshake is made once more by hand
//! ([`probe`]) to hear what the other side objects to.

use std::io::{Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, UNIX_EPOCH};

use rustls::ClientConfig;
use rustls::crypto::ring;
use rustls_pki_types::pem::PemObject;
use rustls_pki_types::{CertificateDer, PrivateKeyDer, ServerName, UnixTime};
use webpki::{EndEntityCert, KeyUsage, anchor_from_trusted_cert};
use x509_parser::prelude::{FromDer, X509Certificate};

use super::roster::{Role, Roster};
use super::{Credentials, Member, Security, host_of, is_loopback};
use crate::document::DocumentError;
use crate::time::Timestamp;

/// A certificate that ends sooner is spoken of.
pub const EXPIRES_SOON: Duration = Duration::from_secs(30 * 86_400);
/// Time for each step of a probe.
const PROBE_LIMIT: Duration = Duration::from_secs(1);
/// Largest file of a certificate or key that is read.
const MAX_FILE_BYTES: u64 = 1 << 20;

/// Why a member's certificate cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum PreflightError {
    /// A file is missing or cannot be read.
    #[error("{file}: {problem}; `team-leader provision` makes the folder of a member, copied as a whole", file = file.display())]
    File {
        /// Which.
        file: PathBuf,
        /// What is wrong.
        problem: String,
    },
    /// The key is of another certificate.
    #[error("{key}: this key does not fit {certificate}; copy both from the same folder", key = key.display(), certificate = certificate.display())]
    KeyDoesNotFit {
        /// The key.
        key: PathBuf,
        /// The certificate.
        certificate: PathBuf,
    },
    /// Another authority issued it.
    #[error(
        "{certificate}: wrong authority: it was issued by {issuer:?}, and {authority} is {expected:?}{hint}",
        certificate = certificate.display(), authority = authority.display(),
        hint = if issuer == expected { " with another key" } else { "" }
    )]
    WrongAuthority {
        /// The certificate.
        certificate: PathBuf,
        /// Who it says issued it.
        issuer: String,
        /// The authority's file.
        authority: PathBuf,
        /// Who that is.
        expected: String,
    },
    /// Its time is over.
    #[error(
        "{certificate}: expired {days} days ago (clock of this host: {now}); renew it: team-leader provision {role} {name} --renew",
        certificate = certificate.display()
    )]
    Expired {
        /// The certificate.
        certificate: PathBuf,
        /// So long ago.
        days: u64,
        /// This host's clock.
        now: Timestamp,
        /// Role of its holder.
        role: Role,
        /// Name of its holder.
        name: String,
    },
    /// Its time has not begun.
    #[error("{certificate}: not valid for another {days} days; is the clock of this host right ({now})?", certificate = certificate.display())]
    NotYet {
        /// The certificate.
        certificate: PathBuf,
        /// So long from now.
        days: u64,
        /// This host's clock.
        now: Timestamp,
    },
    /// It is somebody else's.
    #[error("{certificate}: wrong name: it is for {found:?}, and this is {expected:?}", certificate = certificate.display())]
    WrongName {
        /// The certificate.
        certificate: PathBuf,
        /// Whose it is.
        found: String,
        /// Whose it should be, without the generation.
        expected: String,
    },
    /// It cannot serve.
    #[error("{certificate}: not for this use: {problem}", certificate = certificate.display())]
    WrongUse {
        /// The certificate.
        certificate: PathBuf,
        /// What is wrong.
        problem: String,
    },
    /// Nobody could check that this is the leader.
    #[error(
        "{certificate}: no robot could connect to {endpoint}: the certificate is for {hosts}; make one for this host: \
         team-leader provision {role} {name} --renew --host {host}",
        certificate = certificate.display(), hosts = hosts.join(", "), host = host_of(endpoint)
    )]
    WrongHost {
        /// The certificate.
        certificate: PathBuf,
        /// The endpoint.
        endpoint: String,
        /// What the certificate is for.
        hosts: Vec<String>,
        /// Role of its holder.
        role: Role,
        /// Name of its holder.
        name: String,
    },
    /// The roster does not accept it.
    #[error("{roster}: {name:?} is not accepted: revoked, or the roster is older than the certificate", roster = roster.display())]
    NotAccepted {
        /// The roster.
        roster: PathBuf,
        /// The certificate's name.
        name: String,
    },
    /// The roster or the passwords cannot be read.
    #[error(transparent)]
    Document(#[from] DocumentError),
}

/// What a good certificate says.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Report {
    /// Its common name.
    pub name: String,
    /// When it ends.
    pub expires: Timestamp,
    /// What people should know.
    pub remarks: Vec<String>,
}

impl Security {
    /// Checks all files of a member; `None` where there is nothing to check. `listen` are the endpoints of a leader.
    ///
    /// # Errors
    /// The first file that is missing or wrong, and what would be right.
    pub fn preflight(&self, who: Member, listen: &[String], now: Timestamp) -> Result<Option<Report>, PreflightError> {
        match self {
            Self::Loopback | Self::Open => Ok(None),
            Self::Tls(credentials) => credentials.preflight(who, listen, now).map(Some),
            Self::Password(passwords) => {
                read(&passwords.password_file)?;
                self.access_control()?;
                Ok(None)
            }
        }
    }
}

impl Credentials {
    fn preflight(&self, who: Member, listen: &[String], now: Timestamp) -> Result<Report, PreflightError> {
        let (certificate, key_file) = (self.certificate(), self.key());
        let authority_der = certificate_of(&self.authority())?;
        let own_der = certificate_of(&certificate)?;
        let key = key_of(&key_file)?;
        let file = |problem: &str| PreflightError::File { file: certificate.clone(), problem: problem.to_owned() };
        let parsed = X509Certificate::from_der(&own_der).map_err(|_| file("is no X.509 certificate"))?.1;
        let wrong_authority =
            || PreflightError::File { file: self.authority(), problem: "is no certificate of an authority".to_owned() };
        let authority = X509Certificate::from_der(&authority_der).map_err(|_| wrong_authority())?.1;
        let anchor = anchor_from_trusted_cert(&authority_der).map_err(|_| wrong_authority())?;

        let signing = ring::sign::any_supported_type(&key)
            .map_err(|e| PreflightError::File { file: key_file.clone(), problem: e.to_string() })?;
        if signing.public_key().is_some_and(|public| public.as_ref() != parsed.public_key().raw) {
            return Err(PreflightError::KeyDoesNotFit { key: key_file, certificate });
        }
        let end_entity = EndEntityCert::try_from(&own_der).map_err(|e| file(&e.to_string()))?;
        let time = UnixTime::since_unix_epoch(Duration::from_nanos(now.0));
        let serves = matches!(who.role, Role::Leader | Role::Router);
        let uses = [Some(KeyUsage::client_auth()), serves.then(KeyUsage::server_auth)];
        let (role, name) = (who.role, who.name.to_owned());
        for usage in uses.into_iter().flatten() {
            let verified = end_entity.verify_for_usage(
                webpki::ALL_VERIFICATION_ALGS,
                std::slice::from_ref(&anchor),
                &[],
                time,
                usage,
                None,
                None,
            );
            let Err(error) = verified.map(|_| ()) else { continue };
            let days = |from: UnixTime, to: UnixTime| to.as_secs().saturating_sub(from.as_secs()) / 86_400;
            return Err(match error {
                webpki::Error::CertExpired { not_after, .. } => {
                    PreflightError::Expired { certificate, days: days(not_after, time), now, role, name }
                }
                webpki::Error::CertNotValidYet { not_before, .. } => {
                    PreflightError::NotYet { certificate, days: days(time, not_before), now }
                }
                webpki::Error::UnknownIssuer | webpki::Error::InvalidSignatureForPublicKey => {
                    PreflightError::WrongAuthority {
                        certificate,
                        issuer: parsed.issuer().to_string(),
                        authority: self.authority(),
                        expected: authority.subject().to_string(),
                    }
                }
                other => PreflightError::WrongUse { certificate, problem: other.to_string() },
            });
        }
        let found = parsed.subject().iter_common_name().find_map(|n| n.as_str().ok()).unwrap_or_default().to_owned();
        let expected = format!("{}.{role}.{name}", who.team);
        if found.rsplit_once('.').map(|(member, _)| member) != Some(&*expected) {
            return Err(PreflightError::WrongName { certificate, found, expected });
        }
        if serves {
            self.check_hosts(&end_entity, &parsed, who, listen)?;
            let roster = Roster::read(&self.roster())?;
            if !roster.accepts(&found) {
                return Err(PreflightError::NotAccepted { roster: self.roster(), name: found });
            }
        }
        let end_s = u64::try_from(parsed.validity().not_after.timestamp()).unwrap_or(0);
        let mut remarks = Vec::new();
        let left = Duration::from_secs(end_s).saturating_sub(Duration::from_nanos(now.0));
        if left < EXPIRES_SOON {
            let days = left.as_secs() / 86_400;
            remarks
                .push(format!("the certificate expires in {days} days: team-leader provision {role} {name} --renew"));
        }
        remarks.extend(readable_by_others(&self.key()));
        Ok(Report { name: found, expires: Timestamp(end_s.saturating_mul(1_000_000_000)), remarks })
    }

    fn check_hosts(
        &self,
        end_entity: &EndEntityCert,
        parsed: &X509Certificate,
        who: Member,
        listen: &[String],
    ) -> Result<(), PreflightError> {
        for endpoint in listen {
            let host = host_of(endpoint);
            let unspecified = host.parse::<std::net::IpAddr>().is_ok_and(|address| address.is_unspecified());
            let Ok(server) = ServerName::try_from(host) else { continue };
            // On all addresses: which of them is used is known to the robots' files only.
            if unspecified || end_entity.verify_is_valid_for_subject_name(&server).is_ok() {
                continue;
            }
            return Err(PreflightError::WrongHost {
                certificate: self.certificate(),
                endpoint: endpoint.clone(),
                hosts: hosts_of(parsed),
                role: who.role,
                name: who.name.to_owned(),
            });
        }
        Ok(())
    }
}

/// Tries one handshake with a leader or router and says what is wrong; `Ok` where it goes well.
///
/// # Errors
/// In words: nobody there, another authority, a certificate for other hosts, our certificate refused.
pub fn probe(endpoint: &str, credentials: &Credentials) -> Result<(), String> {
    let address = endpoint.split(['#', '?']).next().unwrap_or_default();
    let address = address.split_once('/').map_or(address, |(_, address)| address);
    let mut addresses = address.to_socket_addrs().map_err(|e| format!("{address}: the name is not known ({e})"))?;
    let socket = addresses.next().ok_or_else(|| format!("{address}: the name has no address"))?;
    let mut tcp =
        TcpStream::connect_timeout(&socket, PROBE_LIMIT).map_err(|e| format!("{address}: nobody listens ({e})"))?;
    let limits = tcp.set_read_timeout(Some(PROBE_LIMIT)).and(tcp.set_write_timeout(Some(PROBE_LIMIT)));
    limits.map_err(|e| e.to_string())?;
    let server = ServerName::try_from(host_of(endpoint).to_owned()).map_err(|e| format!("{address}: {e}"))?;
    let config = client_config(credentials).map_err(|e| e.to_string())?;
    let mut session = rustls::ClientConnection::new(Arc::new(config), server).map_err(|e| in_words(address, &e))?;
    while session.is_handshaking() {
        session.complete_io(&mut tcp).map_err(|e| tls_in_words(address, &e))?;
    }
    // The other side looks at our certificate after we have finished; its objection comes as an alert.
    let mut stream = rustls::Stream::new(&mut session, &mut tcp);
    let _ = stream.flush();
    match stream.read(&mut [0; 1]) {
        Err(error) if !matches!(error.kind(), std::io::ErrorKind::WouldBlock | std::io::ErrorKind::TimedOut) => {
            Err(tls_in_words(address, &error))
        }
        _ => Ok(()),
    }
}

fn client_config(credentials: &Credentials) -> Result<ClientConfig, PreflightError> {
    let file = |file: PathBuf| move |e: rustls::Error| PreflightError::File { file, problem: e.to_string() };
    let mut roots = rustls::RootCertStore::empty();
    roots.add(certificate_of(&credentials.authority())?).map_err(file(credentials.authority()))?;
    let chain = vec![certificate_of(&credentials.certificate())?];
    ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .map_err(file(credentials.authority()))?
        .with_root_certificates(roots)
        .with_client_auth_cert(chain, key_of(&credentials.key())?)
        .map_err(file(credentials.key()))
}

fn tls_in_words(address: &str, error: &std::io::Error) -> String {
    match error.get_ref().and_then(|inner| inner.downcast_ref::<rustls::Error>()) {
        Some(tls) => in_words(address, tls),
        None => format!("{address}: something listens there that does not speak TLS, or is overloaded ({error})"),
    }
}

fn in_words(address: &str, error: &rustls::Error) -> String {
    use rustls::{AlertDescription as Alert, CertificateError as Bad, Error};
    let why = match error {
        Error::InvalidCertificate(Bad::UnknownIssuer | Bad::BadSignature) => {
            "its certificate was issued by another authority than ours".to_owned()
        }
        Error::InvalidCertificate(Bad::Expired | Bad::ExpiredContext { .. }) => {
            "its certificate has expired".to_owned()
        }
        Error::InvalidCertificate(Bad::NotValidForName | Bad::NotValidForNameContext { .. }) => {
            format!(
                "its certificate is not for the host {}; provision the leader with --host for it",
                host_of(&format!("tls/{address}"))
            )
        }
        Error::InvalidCertificate(Bad::InvalidPurpose | Bad::InvalidPurposeContext { .. }) => {
            "its certificate is not one of a leader or router".to_owned()
        }
        Error::AlertReceived(Alert::UnknownCA | Alert::DecryptError | Alert::BadCertificate) => {
            "it does not accept our certificate: issued by another authority than its own".to_owned()
        }
        Error::AlertReceived(Alert::CertificateExpired) => "it says that our certificate has expired".to_owned(),
        Error::AlertReceived(Alert::CertificateRequired) => "it wants a certificate of us".to_owned(),
        Error::InvalidMessage(_) => "it does not speak TLS; is its endpoint tcp/ instead of tls/?".to_owned(),
        other => other.to_string(),
    };
    format!("{address}: {why}")
}

fn certificate_of(file: &Path) -> Result<CertificateDer<'static>, PreflightError> {
    CertificateDer::from_pem_slice(&read(file)?)
        .map_err(|e| PreflightError::File { file: file.to_owned(), problem: format!("no certificate in it ({e})") })
}

fn key_of(file: &Path) -> Result<PrivateKeyDer<'static>, PreflightError> {
    PrivateKeyDer::from_pem_slice(&read(file)?)
        .map_err(|e| PreflightError::File { file: file.to_owned(), problem: format!("no private key in it ({e})") })
}

fn read(file: &Path) -> Result<Vec<u8>, PreflightError> {
    let wrong = |problem: String| PreflightError::File { file: file.to_owned(), problem };
    let size = std::fs::metadata(file).map_err(|e| wrong(format!("cannot be read ({e})")))?.len();
    if size > MAX_FILE_BYTES {
        return Err(wrong(format!("has {size} bytes; a certificate or key has at most {MAX_FILE_BYTES}")));
    }
    std::fs::read(file).map_err(|e| wrong(format!("cannot be read ({e})")))
}

fn hosts_of(parsed: &X509Certificate) -> Vec<String> {
    use x509_parser::extensions::GeneralName;
    let Ok(Some(extension)) = parsed.subject_alternative_name() else { return vec!["no host".to_owned()] };
    let host = |name: &GeneralName| match name {
        GeneralName::DNSName(name) => Some((*name).to_owned()),
        GeneralName::IPAddress(bytes) => match **bytes {
            [a, b, c, d] => Some(std::net::Ipv4Addr::new(a, b, c, d).to_string()),
            _ => <[u8; 16]>::try_from(*bytes).ok().map(|six| std::net::Ipv6Addr::from(six).to_string()),
        },
        _ => None,
    };
    extension.value.general_names.iter().filter_map(host).collect()
}

/// A key that others on this host could copy.
fn readable_by_others(key: &Path) -> Option<String> {
    use std::os::unix::fs::PermissionsExt;
    let mode = std::fs::metadata(key).ok()?.permissions().mode() & 0o777;
    (mode & 0o007 != 0).then(|| {
        format!("{}: everybody on this host may read the private key (mode {mode:o}); chmod 640", key.display())
    })
}

/// What a program should say at its start about being reached and secured.
pub fn opening_remark(security: &Security, listen: &[String]) -> Option<String> {
    match security {
        Security::Loopback => Some("no [security]: only this host can join".to_owned()),
        Security::Open if listen.iter().any(|endpoint| !is_loopback(endpoint)) => {
            Some("[security] mode = \"none\": whoever reaches this address is part of the team, reads pictures and gives commands".to_owned())
        }
        Security::Password(_) => Some("[security] mode = \"password\": nothing is encrypted".to_owned()),
        _ => None,
    }
}

/// This host's clock in the unit of certificates.
pub fn now() -> Timestamp {
    let since = std::time::SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    Timestamp(u64::try_from(since.as_nanos()).unwrap_or(u64::MAX))
}
