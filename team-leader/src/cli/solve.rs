//! `team-leader solve`: poses and targets from bearings in a file, offline.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

/// Arguments of `solve`.
#[derive(Debug, Clone, Args)]
pub struct SolveArgs {
    /// One problem as JSON ("-" reads standard input).
    #[arg(required_unless_present = "sequence", conflicts_with = "sequence")]
    pub input: Option<PathBuf>,
    /// A file with one problem a line, each with `time_s`: runs the whole pipeline over time, one map a line.
    #[arg(long)]
    pub sequence: Option<PathBuf>,
    /// How to solve.
    #[arg(long, value_enum, default_value_t = Method::Joint)]
    pub method: Method,
    /// Format of the result.
    #[arg(long, value_enum, default_value_t = Format::Json)]
    pub format: Format,
}

/// How to solve.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Method {
    /// Joint maximum likelihood over everything.
    Joint,
    /// The report's corrected formulas alone.
    ClosedForm,
}

/// Format of the result.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// For programs.
    Json,
    /// For people.
    Text,
}

/// Runs it; the exit code: 0 fine, 1 the job failed, 2 usage error.
pub fn run(_args: &SolveArgs) -> u8 {
    1
}
