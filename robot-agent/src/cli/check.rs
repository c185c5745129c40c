//! `robot-agent check`: everything that `run` would open is opened, nothing is started.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use protocol::security::Member;
use protocol::security::preflight;
use protocol::security::roster::Role;
use robot_agent::agent::{Agent, AgentError, AgentSettings};
use robot_agent::capture::{self, CaptureOptions, FrameSource};
use robot_agent::config::{AtEnd, Config, ReplayStart};
use robot_agent::optics::MountedCamera;
use robot_agent::service::Journal;
use serde_json::json;

use super::{Failure, Format};

/// Validates a configuration and says what is wrong, without starting.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// The agent's configuration file.
    #[arg(long)]
    config: PathBuf,
    /// Format of the result.
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

/// A configuration with everything that it names, opened.
pub(super) struct Checked {
    pub(super) config: Config,
    pub(super) agent: Agent,
    pub(super) camera: MountedCamera,
    pub(super) source: Box<dyn FrameSource>,
}

/// Reads a configuration and opens what it names.
pub(super) fn open(path: &Path, epoch: u64) -> Result<Checked, Failure> {
    let config = Config::read(path).map_err(Failure::usage)?;
    let who = Member { team: config.team, role: Role::Robot, name: config.robot.as_str() };
    let certificate = config.security.preflight(who, &[], preflight::now()).map_err(Failure::usage)?;
    for remark in certificate.iter().flat_map(|report| &report.remarks) {
        tracing::warn!("{remark}");
    }
    let of_file = |error| Failure::Usage(format!("{}: `robot.camera`: {error}", path.display()));
    let camera = MountedCamera::load(&config.camera).map_err(of_file)?;
    let image_size_px = camera.image_size_px();
    let mut settings = AgentSettings::new(config.robot, config.marker.clone());
    settings.host = config.host.clone();
    settings.panorama_columns = config.work.panorama_columns;
    settings.frame_rate_hz = config.capture.frame_rate_hz;
    settings.max_frame_rate_hz = config.work.max_frame_rate_hz;
    settings.budget_s = config.work.budget_s;
    settings.max_bytes_per_s = config.max_bytes_per_s;
    let wrong_work = |error: AgentError| match (&error, config.work.panorama_columns) {
        (AgentError::Panorama(_) | AgentError::Motion(_), Some(columns)) => Failure::Usage(format!(
            "{}: `work.panorama_columns` = {columns}: {error}; give more columns, or leave it out",
            path.display()
        )),
        _ => Failure::Usage(format!("{}: {error}", config.camera.display())),
    };
    let agent = Agent::new(settings, camera.clone(), epoch).map_err(wrong_work)?;
    // The size is checked frame by frame by the agent, which counts what does not fit and goes on.
    let mut options = CaptureOptions { frame_rate_hz: Some(config.capture.frame_rate_hz), ..CaptureOptions::default() };
    if capture::is_camera(&config.capture.source) {
        // A camera is asked for a size.
        options.image_size_px = Some(image_size_px);
    }
    let of_source = |error| Failure::Usage(format!("{}: `capture.source`: {error}", path.display()));
    let source = capture::open(&config.capture.source, options).map_err(of_source)?;
    tracing::debug!("pictures of {}x{} pixels are expected", image_size_px[0], image_size_px[1]);
    Ok(Checked { config, agent, camera, source })
}

/// At less (measured: 92 % of people are in the map at 5 Hz, half of them at 2 Hz, nobody at 1 Hz) an operator is told.
const LEAST_RATE_HZ: f64 = 4.0;

/// Runs the command.
pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let mut output = io::stdout().lock();
    let result = check(arguments, &mut output);
    if let (Err(Failure::Usage(why)), Format::Json) = (&result, arguments.format) {
        writeln!(output, "{}", json!({ "ok": false, "error": why }))?;
    }
    result
}

fn check(arguments: &Arguments, output: &mut impl Write) -> Result<(), Failure> {
    let Checked { config, camera, mut source, .. } = open(&arguments.config, 0)?;
    if let Some(dir) = &config.state_dir {
        Journal::check(dir).map_err(Failure::usage)?;
    }
    let frames = source.frames();
    // One frame is read: a camera file for other pictures is the commonest mistake.
    let first = match source.next_frame() {
        None => return Err(Failure::Usage(format!("{}: no frames", config.capture.source.display()))),
        Some(Err(error)) => return Err(Failure::usage(error)),
        Some(Ok(frame)) => frame,
    };
    let [width, height] = camera.image_size_px();
    if [first.width, first.height] != [width, height] {
        return Err(Failure::Usage(format!(
            "{}: the first frame has {}x{} pixels, but {} says image_size_px = [{width}, {height}]",
            config.capture.source.display(),
            first.width,
            first.height,
            config.camera.display()
        )));
    }
    let replay = match config.capture.replay_start {
        ReplayStart::Now => "at once".to_owned(),
        ReplayStart::Leader => "when the leader says".to_owned(),
        ReplayStart::At(instant) => format!("at {instant} of this host's clock"),
    };
    let mut remarks = source.remarks().to_vec();
    if config.marker.look().is_none() {
        remarks.push("the marker has no `look`: no fellow robot can find this one in a picture".to_owned());
    }
    let rate_hz = config.capture.frame_rate_hz;
    if rate_hz < LEAST_RATE_HZ {
        remarks.push(format!(
            "capture.frame_rate_hz = {rate_hz}: whoever walks is not followed at less than {LEAST_RATE_HZ} frames a second"
        ));
    }
    if arguments.format == Format::Json {
        let report = json!({
            "ok": true, "robot": config.robot, "team": config.team, "host": config.host, "camera": camera.summary(),
            "source": config.capture.source, "frames": frames, "replay": replay, "connect": config.connect,
            "security": config.security.in_words(), "remarks": remarks,
        });
        writeln!(output, "{report}")?;
        return Ok(());
    }
    writeln!(output, "{}: fine", arguments.config.display())?;
    writeln!(output, "  robot     {} of team {}, on host {}", config.robot, config.team, config.host)?;
    writeln!(output, "  camera    {}: {}", config.camera.display(), camera.summary())?;
    let count = frames.map_or_else(|| "frames".to_owned(), |n| format!("{n} frames"));
    writeln!(output, "  source    {}: {count}, first captured at {}", config.capture.source.display(), first.capture)?;
    let at_end = if config.capture.at_end == AtEnd::Stop { "then stops" } else { "then stays" };
    writeln!(output, "  replay    begins {replay}, {at_end}")?;
    let default = if config.connect_is_default { " (the default: a leader on this host)" } else { "" };
    writeln!(output, "  connects  {}{default}", config.connect.join(", "))?;
    writeln!(output, "  security  {}", config.security.in_words())?;
    for remark in remarks {
        writeln!(output, "  remark    {remark}")?;
    }
    Ok(())
}
