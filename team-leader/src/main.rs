//! Command line.

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use team_leader::cli::solve::{self, SolveArgs};

/// Calibrates robots against each other, pairs what they see, triangulates it, keeps the map.
#[derive(Debug, Parser)]
#[command(version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Poses and targets from bearings in a file, offline.
    Solve(SolveArgs),
}

fn main() -> ExitCode {
    match Cli::parse().command {
        Command::Solve(args) => ExitCode::from(solve::run(&args)),
    }
}
