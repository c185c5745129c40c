//! How a program joins the team's network, and what that means in Zenoh's configuration.

use std::path::PathBuf;
use std::time::Duration;

use serde_json::{Value, json};

use super::error::{TransportError, words};
use crate::board::Board;
use crate::codec::Kind;
use crate::document::endpoint_problem;
use crate::host_clock::Clock;
use crate::security::{Passwords, Security, rules};

/// Silence after which the other side counts as gone. It is the silent side's own setting that counts.
pub const LEASE: Duration = Duration::from_secs(1);
/// Words without content in a lease, where there is nothing else to say. Each costs its reader an acknowledgement of 66 bytes; with
/// Zenoh's four that would be a sixth of what a robot at 5 Hz sends.
const KEEP_ALIVES: u64 = 3;
/// Limit on the handshake. Zenoh's 10 s would make a frozen leader cost 11 s; with this it costs 1.6 s.
pub const HANDSHAKE_LIMIT: Duration = Duration::from_millis(500);
/// First and longest pause between attempts to connect.
pub const RETRY: [Duration; 2] = [Duration::from_millis(100), Duration::from_millis(500)];
/// Largest message a session puts together from fragments: the largest of ours, and Zenoh's own headers.
pub const MAX_MESSAGE_BYTES: usize = Kind::MapJson.max_bytes() + (64 << 10);
/// Most sessions that one leader or router takes.
pub const MAX_SESSIONS: usize = 1000;

/// What a program is in the team's network.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// An agent, or a tool: holds one link to a leader or router, and takes the next of its list when it is lost.
    Client,
    /// A leader: a router in the process, to which clients and other leaders connect.
    Router,
}

/// How to open a session.
#[derive(Debug, Clone)]
pub struct Options {
    /// What it is.
    pub role: Role,
    /// Own endpoints (routers only), as `tcp/127.0.0.1:0`: port 0 takes a free one, see
    /// [`super::Transport::locators`]. Empty: a router is reached by nobody.
    pub listen: Vec<String>,
    /// Endpoints to connect to. A client needs one at least and uses one at a time; a router tries all, for ever.
    pub connect: Vec<String>,
    /// How long a client waits for its first connection; `None` waits for ever and says so once in the log.
    pub connect_limit: Option<Duration>,
    /// A Zenoh configuration file (JSON5) with more: certificates, user and password, access control. Mode, endpoints and
    /// scouting are set here and not there.
    pub zenoh_file: Option<PathBuf>,
    /// Let Zenoh count bytes on the wire ([`super::Transport::wire_bytes`]). It opens the session's admin space, which
    /// whoever is connected may read: for measurements.
    pub measure: bool,
    /// Stamps what comes in.
    pub clock: Clock,
    /// Certificates and access control. The files are read when the session opens.
    pub security: Security,
    /// Where the service shows its figures.
    pub board: Board,
}

impl Options {
    /// An agent or a tool that connects to any of `connect`.
    pub fn client(connect: impl IntoIterator<Item = impl Into<String>>) -> Self {
        Self {
            role: Role::Client,
            listen: Vec::new(),
            connect: connect.into_iter().map(Into::into).collect(),
            connect_limit: None,
            zenoh_file: None,
            measure: false,
            clock: Clock::system(),
            security: Security::default(),
            board: Board::default(),
        }
    }

    /// A leader that listens on `listen`.
    pub fn router(listen: impl IntoIterator<Item = impl Into<String>>) -> Self {
        let listen = listen.into_iter().map(Into::into).collect();
        Self { role: Role::Router, listen, ..Self::client([] as [String; 0]) }
    }

    /// The Zenoh configuration.
    pub(super) fn to_zenoh(&self) -> Result<zenoh::Config, TransportError> {
        self.listen.iter().try_for_each(|endpoint| check_endpoint(endpoint, true))?;
        self.connect.iter().try_for_each(|endpoint| check_endpoint(endpoint, false))?;
        if self.role == Role::Client && self.connect.is_empty() {
            return Err(TransportError::NowhereToConnect);
        }
        let file = self.zenoh_file.as_ref().map(|path| path.display().to_string());
        let wrong = |error: &zenoh::Error| TransportError::Configuration { file: file.clone(), reason: words(error) };
        let mut config = match &self.zenoh_file {
            Some(path) => zenoh::Config::from_file(path).map_err(|error| wrong(&error))?,
            None => zenoh::Config::default(),
        };
        for (key, value) in self.settings().into_iter().chain(self.protection()?) {
            config.insert_json5(key, &value.to_string()).map_err(|error| wrong(&error))?;
        }
        Ok(config)
    }

    /// Certificates, passwords, access control and size limits.
    fn protection(&self) -> Result<Vec<(&'static str, Value)>, TransportError> {
        let is_router = self.role == Role::Router;
        let mut settings = Vec::new();
        match &self.security {
            Security::Tls(credentials) => {
                if let Some(endpoint) = self.listen.iter().chain(&self.connect).find(|e| !e.starts_with("tls/")) {
                    let problem = "is not encrypted, but there are certificates".to_owned();
                    return Err(TransportError::Endpoint { endpoint: endpoint.clone(), problem });
                }
                let [authority, certificate, key] =
                    [credentials.authority(), credentials.certificate(), credentials.key()];
                let mut tls = json!({
                    "root_ca_certificate": authority, "enable_mtls": true, "verify_name_on_connect": true,
                    "close_link_on_expiration": true, "connect_certificate": certificate, "connect_private_key": key,
                });
                if is_router {
                    tls["listen_certificate"] = json!(certificate);
                    tls["listen_private_key"] = json!(key);
                }
                settings.push(("transport/link/tls", tls));
            }
            Security::Password(passwords) => settings.push(("transport/auth/usrpwd", usrpwd(passwords)?)),
            Security::Loopback | Security::Open => {}
        }
        if is_router {
            settings.push(("low_pass_filter", rules::size_limits()));
            if let Some(rules) = self.security.access_control()? {
                settings.push(("access_control", rules));
            }
        }
        Ok(settings)
    }

    fn settings(&self) -> Vec<(&'static str, Value)> {
        let is_router = self.role == Role::Router;
        let [retry_first, retry_longest] = RETRY.map(|pause| pause.as_millis() as u64);
        // Milliseconds, −1 for ever. A router connects in the background, so it never waits.
        let connect_ms = match self.connect_limit {
            Some(limit) if !is_router => i64::try_from(limit.as_millis()).unwrap_or(i64::MAX),
            _ => -1,
        };
        vec![
            ("mode", json!(if is_router { "router" } else { "client" })),
            ("listen/endpoints", json!(self.listen)),
            ("listen/timeout_ms", json!(0)),
            ("listen/exit_on_failure", json!(true)),
            ("connect/endpoints", json!(self.connect)),
            ("connect/timeout_ms", json!(connect_ms)),
            ("connect/exit_on_failure", json!(!is_router)),
            (
                "connect/retry",
                json!({ "period_init_ms": retry_first, "period_max_ms": retry_longest, "period_increase_factor": 1.5 }),
            ),
            ("scouting/multicast/enabled", json!(false)),
            ("scouting/gossip/enabled", json!(false)),
            // Our messages carry their own times; a router's stamp would be 26 bytes more on each.
            ("timestamping/enabled", json!(false)),
            ("transport/unicast/open_timeout", json!(HANDSHAKE_LIMIT.as_millis() as u64)),
            ("transport/unicast/accept_timeout", json!(HANDSHAKE_LIMIT.as_millis() as u64)),
            ("transport/unicast/max_sessions", json!(MAX_SESSIONS)),
            ("transport/link/tx/lease", json!(LEASE.as_millis() as u64)),
            ("transport/link/tx/keep_alive", json!(KEEP_ALIVES)),
            ("transport/link/rx/max_message_size", json!(MAX_MESSAGE_BYTES)),
            ("adminspace/enabled", json!(self.measure)),
        ]
    }
}

fn usrpwd(passwords: &Passwords) -> Result<Value, TransportError> {
    let file = &passwords.password_file;
    let password = std::fs::read_to_string(file).map_err(|error| TransportError::Configuration {
        file: Some(file.display().to_string()),
        reason: error.to_string(),
    })?;
    let mut settings = json!({ "user": passwords.user, "password": password.trim_end_matches(['\n', '\r']) });
    if let Some(all) = &passwords.passwords_file {
        settings["dictionary_file"] = json!(all);
    }
    Ok(settings)
}

fn check_endpoint(endpoint: &str, listens: bool) -> Result<(), TransportError> {
    // Zenoh's own settings may follow: `tcp/10.0.0.1:7447#iface=wlan0`.
    let address = endpoint.split(['#', '?']).next().unwrap_or_default();
    endpoint_problem(address, listens).map_or(Ok(()), |problem| {
        Err(TransportError::Endpoint { endpoint: endpoint.chars().take(128).collect(), problem })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::document::DEFAULT_ENDPOINT;

    #[test]
    fn zenoh_takes_every_setting_of_both_roles() {
        assert!(Options::client([DEFAULT_ENDPOINT]).to_zenoh().is_ok());
        let mut leader = Options::router(["tcp/127.0.0.1:0", "tls/[::1]:7447"]);
        leader.connect = vec!["tcp/10.0.0.2:7447#iface=wlan0".to_owned()];
        leader.measure = true;
        assert!(leader.to_zenoh().is_ok(), "{:?}", leader.to_zenoh());
    }

    #[test]
    fn a_wrong_endpoint_is_named_with_what_would_be_right() {
        for endpoint in
            ["127.0.0.1:7447", "udp/127.0.0.1:7447", "tcp/localhost", "tcp/:7447", "tcp/host:port", "tcp/h:99999"]
        {
            let error = Options::client([endpoint]).to_zenoh().unwrap_err().to_string();
            assert!(error.contains(endpoint) && error.contains("tcp"), "{error}");
        }
        assert!(matches!(Options::client([""; 0]).to_zenoh(), Err(TransportError::NowhereToConnect)));
    }

    #[test]
    fn a_missing_or_mistyped_zenoh_file_is_named() {
        let mut options = Options::client([DEFAULT_ENDPOINT]);
        options.zenoh_file = Some("/nowhere/zenoh.json5".into());
        let error = options.to_zenoh().unwrap_err().to_string();
        assert!(error.contains("/nowhere/zenoh.json5"), "{error}");
    }
}
