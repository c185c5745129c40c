//! `robot-agent run`.

use std::path::PathBuf;
use std::time::Duration;

use protocol::board::{self, systemd};
use protocol::host_clock::Clock;
use protocol::transport::{CLOSE_LIMIT, Options};
use robot_agent::capture::{self, CaptureOptions};
use robot_agent::config::{AtEnd, ReplayStart};
use robot_agent::service::{self, Journal, LiveSource, Replay, Setup, Start};

use super::Failure;
use super::check::{self, Checked};

/// Time from the signal to the end of the process, whatever hangs.
const STOP_LIMIT: Duration = Duration::from_secs(5);

/// The service: frames in, observations out over Zenoh, until it is stopped.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// The agent's configuration file.
    #[arg(long)]
    config: PathBuf,
}

/// Runs the command.
pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let Checked { config, agent, camera, source } = check::open(&arguments.config, epoch())?;
    if config.connect_is_default {
        tracing::info!("{}: no [network] connect: a leader on this host is looked for", arguments.config.display());
    }
    for remark in source.remarks() {
        tracing::warn!("{remark}");
    }
    let start = Start::default();
    let asks_leader = config.capture.replay_start == ReplayStart::Leader;
    match config.capture.replay_start {
        ReplayStart::Leader => tracing::info!("the recording begins when the leader says"),
        ReplayStart::Now => drop(start.set(Clock::system().now())),
        ReplayStart::At(instant) => drop(start.set(instant)),
    }
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().map_err(Failure::job)?;
    let input = &config.capture.source;
    let source: Box<dyn LiveSource> = if capture::is_camera(input) {
        // A camera serves one reader.
        drop(source);
        let options = CaptureOptions {
            image_size_px: Some(camera.image_size_px()),
            frame_rate_hz: Some(config.capture.frame_rate_hz),
            first_capture: None,
        };
        Box::new(capture::open_camera(input, options, *camera.timing()).map_err(Failure::job)?)
    } else {
        Box::new(Replay::new(source, start.clone(), config.capture.recording_start))
    };
    let mut session = Options { security: config.security, ..Options::client(&config.connect) };
    session.measure = config.metrics.is_some();
    let board = session.board.clone();
    let journal = config.state_dir.as_ref().map(|dir| Journal::open(dir, config.robot)).transpose();
    let setup = Setup {
        journal: journal.map_err(Failure::usage)?,
        source,
        agent,
        clock: Clock::system(),
        team: config.team,
        session,
        start: asks_leader.then_some(start),
        stop_at_end: config.capture.at_end == AtEnd::Stop,
    };
    systemd::ready(&format!("robot {} of team {}", config.robot, config.team));
    let worked = runtime.block_on(async {
        let keepers = tokio::spawn(async move {
            let Err(error) = board::keep(board, config.metrics).await;
            tracing::error!("no figures: {error}");
        });
        let worked = service::run(setup, stop_signal()).await;
        keepers.abort();
        worked
    });
    // A task that hangs must not keep the process.
    runtime.shutdown_timeout(CLOSE_LIMIT);
    let summary = worked.map_err(Failure::job)?;
    tracing::info!(
        "stopped: {} frames and {} messages dropped, {} messages refused",
        summary.frames_dropped,
        summary.messages_dropped,
        summary.messages_refused
    );
    Ok(())
}

/// A session later than every earlier one of the robot.
fn epoch() -> u64 {
    Clock::system().now().0
}

/// SIGINT or SIGTERM; then the process has [`STOP_LIMIT`].
async fn stop_signal() {
    use tokio::signal::unix::{SignalKind, signal};
    let (Ok(mut interrupt), Ok(mut terminate)) = (signal(SignalKind::interrupt()), signal(SignalKind::terminate()))
    else {
        // Without handlers the process ends by the signal itself.
        return std::future::pending().await;
    };
    tokio::select! {
        _ = interrupt.recv() => {}
        _ = terminate.recv() => {}
    }
    tracing::info!("stopping");
    systemd::stopping();
    std::thread::spawn(|| {
        std::thread::sleep(STOP_LIMIT);
        tracing::error!("not stopped within {STOP_LIMIT:?}: giving up");
        std::process::exit(1);
    });
}
