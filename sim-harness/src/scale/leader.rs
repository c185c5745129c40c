//! The child process: a leader's service that says where it listens, leads until its input ends, and says what it did.

use std::io::Read;

use protocol::host_clock::Clock;
use protocol::id::{LeaderId, NameError, TeamId};
use protocol::transport::Options;
use team_leader::leader::{Leader, LeaderCoreConfig};
use team_leader::service::{NOBODY_AFTER, Service, Setup};

use super::{LeaderSummary, failed, say};
use crate::team::{self, TeamError};

/// Name of the team.
pub(super) fn team_id() -> Result<TeamId, NameError> {
    TeamId::new("scale")
}

/// Leads.
///
/// # Errors
/// No session, nobody to talk to.
pub fn run() -> Result<(), TeamError> {
    let runtime = team::runtime()?;
    runtime.block_on(lead())
}

async fn lead() -> Result<(), TeamError> {
    let id = LeaderId::new("leader")?;
    let setup = Setup {
        state: None,
        leader: Leader::new(LeaderCoreConfig::new(id)),
        id,
        team: team_id()?,
        clock: Clock::system(),
        session: Options::router(["tcp/127.0.0.1:0"]),
        replay: None,
        json: false,
        nobody_after: NOBODY_AFTER,
    };
    let service = Service::open(setup).await.map_err(failed)?;
    say(&service.locators().join(","))?;
    let input_ends = async {
        // The parent's end of the pipe closes with it.
        let _ = tokio::task::spawn_blocking(|| std::io::stdin().read_to_end(&mut Vec::new())).await;
    };
    let summary = service.run(input_ends).await.map_err(failed)?;
    let summary = LeaderSummary {
        observations: summary.observations,
        latency_ms: summary.map_latency_ms,
        lost: summary.dropped + summary.refused,
    };
    say(&serde_json::to_string(&summary).map_err(failed)?)
}
