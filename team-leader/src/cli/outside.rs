//! How `query` and `doctor` reach a running team: as a client, by the leader's own configuration or by team and endpoints.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use protocol::document::DocumentError;
use protocol::id::TeamId;
use protocol::security::{Credentials, Security};
use protocol::transport::Options;

use crate::config::Config;

/// Time to reach the leader.
const CONNECT_LIMIT: Duration = Duration::from_secs(3);

/// Where the team is.
#[derive(Debug, Clone, Args)]
pub struct Outside {
    /// The leader's configuration file: team, endpoints, and (with certificates) who asks
    #[arg(long, global = true, default_value = "leader.toml")]
    pub config: PathBuf,
    /// Instead of a configuration: the team's name
    #[arg(long, global = true, requires = "connect")]
    team: Option<TeamId>,
    /// Instead of a configuration: an endpoint of a leader or router, as tls/192.168.1.10:7447; may be given again
    #[arg(long, global = true, requires = "team")]
    connect: Vec<String>,
    /// The asker's own folder of certificates (`team-leader provision operator NAME`)
    #[arg(long, global = true, value_name = "FOLDER")]
    security: Option<PathBuf>,
}

impl Outside {
    /// The team, and how to open a session to it.
    ///
    /// # Errors
    /// A configuration that is missing or wrong.
    pub fn options(&self) -> Result<(TeamId, Options), DocumentError> {
        let (team, connect, security) = match self.team {
            Some(team) => (team, self.connect.clone(), Security::Loopback),
            None => {
                let config = Config::read(&self.config)?;
                let connect = config.listen.iter().map(|endpoint| reachable(endpoint)).collect();
                (config.team, connect, config.security)
            }
        };
        let own = self.security.clone().map(|folder| Security::Tls(Credentials { folder }));
        let options = Options {
            connect_limit: Some(CONNECT_LIMIT),
            security: own.unwrap_or(security),
            ..Options::client(connect)
        };
        Ok((team, options))
    }
}

/// Where a leader that listens on all addresses is reached from its own host.
fn reachable(endpoint: &str) -> String {
    endpoint.replace("/0.0.0.0:", "/127.0.0.1:").replace("/[::]:", "/[::1]:")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_leader_on_all_addresses_is_asked_on_loopback() {
        assert_eq!(reachable("tcp/0.0.0.0:7447"), "tcp/127.0.0.1:7447");
        assert_eq!(reachable("tls/[::]:7447"), "tls/[::1]:7447");
        assert_eq!(reachable("tcp/192.168.1.10:7447"), "tcp/192.168.1.10:7447");
    }
}
