//! `robot-agent`: one module a subcommand, each with its arguments and an `execute`.
//!
//! Results go to standard output, logs and errors to standard error. Exit codes: 0 fine, 1 the job failed, 2 usage or
//! configuration error.

mod camera;
mod check;
mod peers;
mod run;
mod track;
mod unwarp;

use std::io::{self, Write};
use std::process::ExitCode;

use clap::{Parser, Subcommand, ValueEnum};
use tracing_subscriber::EnvFilter;

/// One robot's vision: unwarps its 360° picture, follows what moves, sees its fellow robots, publishes bearings.
#[derive(Debug, Parser)]
#[command(version, about, max_term_width = 110, after_help = "Logs go to standard error; RUST_LOG=debug shows more.")]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Run(run::Arguments),
    Track(track::Arguments),
    Unwarp(unwarp::Arguments),
    Camera(camera::Arguments),
    Peers(peers::Arguments),
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
    tracing_subscriber::fmt().with_env_filter(filter).with_writer(io::stderr).init();
    let result = match &cli.command {
        Command::Run(arguments) => run::execute(arguments),
        Command::Track(arguments) => track::execute(arguments),
        Command::Unwarp(arguments) => unwarp::execute(arguments),
        Command::Camera(arguments) => camera::execute(arguments),
        Command::Peers(arguments) => peers::execute(arguments),
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
