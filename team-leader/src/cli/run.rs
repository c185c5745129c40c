//! `team-leader run`: the service.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use protocol::board::{self, systemd};
use protocol::host_clock::Clock;
use protocol::transport::{CLOSE_LIMIT, Options, TransportError};

use super::solve::Format;
use crate::config::Config;
use crate::leader::Leader;
use crate::service::{NOBODY_AFTER, Service, Setup, StateDir, Summary};

/// Time from the signal to the end of the process, whatever hangs.
const STOP_LIMIT: Duration = Duration::from_secs(5);

/// Arguments of `run`.
#[derive(Debug, Clone, Args)]
pub struct RunArgs {
    /// The leader's configuration file.
    #[arg(long)]
    pub config: PathBuf,
}

/// Runs until SIGINT or SIGTERM; the exit code: 0 stopped as asked, 1 failed, 2 wrong configuration.
pub fn run(args: &RunArgs) -> u8 {
    let config = match Config::read(&args.config) {
        Ok(config) => config,
        Err(error) => return super::usage_error(&error, Format::Text),
    };
    if let Err(error) = super::check::preflight(&config) {
        return super::usage_error(&error, Format::Text);
    }
    if config.listen_is_default {
        tracing::info!("{}: no [network] listen: only this host can join", args.config.display());
    }
    let runtime = match tokio::runtime::Builder::new_multi_thread().enable_all().build() {
        Ok(runtime) => runtime,
        Err(error) => return super::failure(&error, Format::Text),
    };
    let state = match config.state_dir.as_ref().map(|dir| StateDir::open(dir, config.team)).transpose() {
        Ok(state) => state,
        Err(error) => return super::usage_error(&error, Format::Text),
    };
    let led = runtime.block_on(lead(config, state));
    // A task that hangs must not keep the process.
    runtime.shutdown_timeout(CLOSE_LIMIT);
    match led {
        Ok(summary) => {
            let [median, p99, worst] = summary.map_latency_ms;
            tracing::info!(
                "led: {} observations, {} maps, {median:.1} ms from observation to map ({p99:.1} ms p99, {worst:.1} ms worst), \
                 {} messages dropped, {} refused",
                summary.observations,
                summary.maps,
                summary.dropped,
                summary.refused
            );
            0
        }
        Err(error) => super::failure(&error, Format::Text),
    }
}

async fn lead(mut config: Config, state: Option<StateDir>) -> Result<Summary, TransportError> {
    let mut session = Options::router(config.listen);
    session.connect = config.connect;
    session.security = config.security;
    session.measure = config.metrics.is_some();
    let (board, metrics) = (session.board.clone(), config.metrics);
    // Tells this session from others that use the same name.
    config.core.epoch = Clock::system().now().0;
    let service = Service::open(Setup {
        leader: Leader::new(config.core),
        id: config.id,
        team: config.team,
        clock: Clock::system(),
        session,
        replay: config.replay,
        json: config.json,
        state,
        nobody_after: NOBODY_AFTER,
    })
    .await?;
    tracing::info!("leader {} of team {} listens on {}", config.id, config.team, service.locators().join(", "));
    systemd::ready(&format!("leads team {}", config.team));
    let keepers = tokio::spawn(async move {
        let Err(error) = board::keep(board, metrics).await;
        tracing::error!("no figures: {error}");
    });
    let led = service
        .run(async {
            stop_signal().await;
            tracing::info!("stopping");
            systemd::stopping();
            std::thread::spawn(|| {
                std::thread::sleep(STOP_LIMIT);
                tracing::error!("not stopped within {STOP_LIMIT:?}: giving up");
                std::process::exit(1);
            });
        })
        .await;
    keepers.abort();
    led
}

/// SIGINT or SIGTERM. Without handlers the process ends by the signal itself.
async fn stop_signal() {
    use tokio::signal::unix::{SignalKind, signal};
    let (Ok(mut interrupt), Ok(mut terminate)) = (signal(SignalKind::interrupt()), signal(SignalKind::terminate()))
    else {
        return std::future::pending().await;
    };
    tokio::select! {
        _ = interrupt.recv() => {}
        _ = terminate.recv() => {}
    }
}
