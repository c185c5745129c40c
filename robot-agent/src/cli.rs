//! `robot-agent`: one module a subcommand, each with its arguments and an `execute`.
//!
//! Results go to standard output, logs and errors to standard error. Exit codes: 0 fine, 1 the job failed, 2 usage or
//! configuration error.

mod calibrate;
mod camera;
mod check;
mod learn;
mod mosaic;
mod peers;
mod run;
mod track;
mod unwarp;

use std::io::{self, Write};
use std::path::Path;
use std::process::ExitCode;

use clap::{Parser, Subcommand, ValueEnum};
use robot_agent::agent::Frame;
use robot_agent::capture::{self, CaptureError, CaptureOptions, FrameSource};
use robot_agent::optics::MountedCamera;
use serde_json::{Value, json};
use tracing_subscriber::EnvFilter;

/// One robot's vision: unwarps its 360° picture, follows what moves, sees its fellow robots, publishes bearings.
#[derive(Debug, Parser)]
#[command(version, about, max_term_width = 110, after_help = "Logs go to standard error; RUST_LOG=debug shows more.")]
struct Cli {
    /// How logs are written: for people, or a JSON object a line
    #[arg(long, global = true, value_enum, default_value_t)]
    log_format: Format,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Run(run::Arguments),
    Track(track::Arguments),
    Unwarp(unwarp::Arguments),
    Mosaic(mosaic::Arguments),
    Camera(camera::Arguments),
    Calibrate(calibrate::Arguments),
    Peers(peers::Arguments),
    Learn(learn::Arguments),
    Check(check::Arguments),
}

/// How results are printed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
enum Format {
    /// For people.
    #[default]
    Text,
    /// For programs.
    Json,
}

/// Why a command did not succeed; the text names what and where.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Failure {
    /// The command line or a configuration file is wrong: exit code 2.
    Usage(String),
    /// The job failed: exit code 1.
    Job(String),
    /// Whoever read our standard output has gone; nothing to complain about.
    OutputClosed,
}

impl Failure {
    /// A wrong command line or configuration.
    fn usage(error: impl std::fmt::Display) -> Self {
        Self::Usage(error.to_string())
    }

    /// A failed job.
    fn job(error: impl std::fmt::Display) -> Self {
        Self::Job(error.to_string())
    }
}

impl From<io::Error> for Failure {
    /// For writes to standard output.
    fn from(error: io::Error) -> Self {
        if error.kind() == io::ErrorKind::BrokenPipe {
            return Self::OutputClosed;
        }
        Self::Job(format!("cannot write to standard output: {error}"))
    }
}

/// Parses, runs, reports.
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| {
        EnvFilter::new("info,zenoh=warn,zenoh::net=error,zenoh_transport=error,zenoh_link_tcp=error")
    });
    let logs = tracing_subscriber::fmt().with_env_filter(filter).with_writer(io::stderr);
    match cli.log_format {
        Format::Text => logs.init(),
        Format::Json => logs.json().init(),
    }
    let result = match &cli.command {
        Command::Run(arguments) => run::execute(arguments),
        Command::Track(arguments) => track::execute(arguments),
        Command::Unwarp(arguments) => unwarp::execute(arguments),
        Command::Mosaic(arguments) => mosaic::execute(arguments),
        Command::Camera(arguments) => camera::execute(arguments),
        Command::Calibrate(arguments) => calibrate::execute(arguments),
        Command::Peers(arguments) => peers::execute(arguments),
        Command::Learn(arguments) => learn::execute(arguments),
        Command::Check(arguments) => check::execute(arguments),
    };
    let (code, message) = match result {
        Ok(()) | Err(Failure::OutputClosed) => return ExitCode::SUCCESS,
        Err(Failure::Job(message)) => (1, message),
        Err(Failure::Usage(message)) => (2, message),
    };
    // Nothing can be done where standard error is closed, too.
    let _ = writeln!(io::stderr(), "error: {message}");
    ExitCode::from(code)
}

/// A frame rate that the command line gives for an input without times.
fn check_frame_rate(frame_rate_hz: Option<f64>) -> Result<(), Failure> {
    match frame_rate_hz {
        Some(rate) if !(rate > 0.0 && rate <= 1000.0) => {
            Err(Failure::usage(format!("--frame-rate-hz {rate}: must be above 0 and at most 1000")))
        }
        _ => Ok(()),
    }
}

/// Makes the JSON line of each frame.
trait Lines {
    /// Of a frame, so many seconds since the first.
    fn of_frame(&mut self, index: u64, time_s: f64, frame: &Frame) -> Result<Value, Failure>;

    /// The same of one that cannot be used: what is in every line but for the number, the time and the error.
    fn of_bad_frame(&mut self, index: u64) -> Result<Value, Failure>;
}

/// Prints a JSON line for each frame. One that cannot be used has a line too, with the error; the first is logged, all are counted,
/// and not one frame that can be used is an error.
fn print_lines(input: &Path, source: &mut dyn FrameSource, lines: &mut impl Lines) -> Result<(), Failure> {
    let mut output = io::stdout().lock();
    let (mut index, mut first, mut bad) = (0u64, None, 0u64);
    while let Some(frame) = source.next_frame() {
        let line = match frame {
            Ok(frame) => {
                let first = *first.get_or_insert(frame.capture);
                lines.of_frame(index, frame.capture.seconds_since(first), &frame)?
            }
            Err(error) => {
                bad += 1;
                match bad {
                    1 => tracing::warn!("frame {index}: {error}"),
                    _ => tracing::debug!("frame {index}: {error}"),
                }
                let mut line = lines.of_bad_frame(index)?;
                line["frame"] = json!(index);
                line["time_s"] = Value::Null;
                line["error"] = json!(error.to_string());
                line
            }
        };
        writeln!(output, "{line}")?;
        index += 1;
    }
    if index == bad {
        return Err(Failure::job(format!("{}: not one frame could be used", input.display())));
    }
    if bad > 0 {
        tracing::warn!("{}: {bad} of {index} frames could not be used", input.display());
    }
    Ok(())
}

/// The frames of an input for this camera; what its reader has to remark goes to the log.
fn open_frames(
    input: &Path,
    camera: &MountedCamera,
    frame_rate_hz: Option<f64>,
) -> Result<Box<dyn FrameSource>, Failure> {
    let options = CaptureOptions { image_size_px: Some(camera.image_size_px()), frame_rate_hz, first_capture: None };
    let source = open_source(input, options, camera)?;
    for remark in source.remarks() {
        tracing::warn!("{remark}");
    }
    Ok(source)
}

/// A source of frames; a camera's are stamped by the camera file's `[timing]`.
fn open_source(input: &Path, options: CaptureOptions, camera: &MountedCamera) -> Result<Box<dyn FrameSource>, Failure> {
    let opened = match capture::is_camera(input) {
        false => capture::open(input, options),
        true => capture::open_camera(input, options, *camera.timing()).map(|c| Box::new(c) as Box<dyn FrameSource>),
    };
    opened.map_err(|error| match error {
        CaptureError::Sequence(_) | CaptureError::List { .. } | CaptureError::NoTimes { .. } => Failure::usage(error),
        _ => Failure::job(error),
    })
}
