//! Command line.

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use sim_harness::cli::record;

#[derive(Debug, Parser)]
#[command(name = "sim-harness", about = "Whole robot teams in one process, against truth", version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Images and truth of a scenario, as files
    Record(record::RecordArgs),
}

fn main() -> ExitCode {
    match Cli::parse().command {
        Command::Record(args) => ExitCode::from(record::run(&args)),
    }
}
