//! Command line of the leader.

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use team_leader::cli::check::{self, CheckArgs};
use team_leader::cli::doctor::{self, DoctorArgs};
use team_leader::cli::plan::{self, PlanArgs};
use team_leader::cli::provision::{self, ProvisionArgs};
use team_leader::cli::query::{self, QueryArgs};
use team_leader::cli::run::{self, RunArgs};
use team_leader::cli::solve::{self, SolveArgs};
use tracing_subscriber::EnvFilter;

/// Calibrates robots against each other, pairs what they see, triangulates it, keeps the map.
#[derive(Debug, Parser)]
#[command(version, about, max_term_width = 110, after_help = "Logs go to standard error; RUST_LOG=debug shows more.")]
struct Cli {
    /// How logs are written: for people, or a JSON object a line
    #[arg(long, global = true, value_enum, default_value_t = LogFormat::Text)]
    log_format: LogFormat,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum LogFormat {
    Text,
    Json,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// The service: hears the robots of a team over Zenoh and publishes their map, until it is stopped.
    Run(RunArgs),
    /// Poses and targets from bearings in a file, offline.
    Solve(SolveArgs),
    /// Where the robots should stand to see the targets best.
    Plan(PlanArgs),
    /// Validates a configuration and says what is wrong, without starting.
    Check(CheckArgs),
    /// Asks a running team: the map, a robot's pictures, a robot's status.
    Query(QueryArgs),
    /// Listens to a running team: who is there, what is wrong, what would fix it.
    Doctor(DoctorArgs),
    /// Certificates: the team's authority, a certificate a robot, leader and operator, renewal, revocation.
    Provision(ProvisionArgs),
}

fn main() -> ExitCode {
    protocol::closed_pipe::end_quietly();
    let cli = Cli::parse();
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| {
        EnvFilter::new("info,zenoh=warn,zenoh::net=error,zenoh_transport=error,zenoh_link_tcp=error")
    });
    let logs = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr);
    match cli.log_format {
        LogFormat::Text => logs.init(),
        LogFormat::Json => logs.json().init(),
    }
    ExitCode::from(match &cli.command {
        Command::Run(args) => run::run(args),
        Command::Solve(args) => solve::run(args),
        Command::Plan(args) => plan::run(args),
        Command::Check(args) => check::run(args),
        Command::Query(args) => query::run(args),
        Command::Doctor(args) => doctor::run(args),
        Command::Provision(args) => provision::run(args),
    })
}
