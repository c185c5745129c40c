//! `sim-harness replay`: recordings again. `leader`: what a leader heard in a simulated run, to a leader of today.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use super::record::Format;
use super::run::{exit_code, json, text};
use super::table;
use crate::replay::Recording;
use crate::score::Summary;
use crate::team::{TeamError, output};

/// Arguments of `replay`.
#[derive(Debug, Clone, Args)]
pub struct ReplayArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Clone, Subcommand)]
enum What {
    /// What the leader heard in `run --transport simulated --out DIR`, to a leader of today: maps and scores in a second
    Leader(LeaderArgs),
}

#[derive(Debug, Clone, Args)]
struct LeaderArgs {
    /// Folders of runs (or their leader.jsonl); of several: mean and worst of each figure
    #[arg(required = true)]
    recordings: Vec<PathBuf>,
    /// Writes what `run` writes there, but for traffic and the agents' pictures; of several recordings a folder each
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// How to report
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

/// Does it; gives the exit code.
#[allow(clippy::print_stderr)]
pub fn run(args: &ReplayArgs) -> u8 {
    let What::Leader(args) = &args.what;
    match leader(args) {
        Ok(text) => {
            println!("{}", text.trim_end());
            0
        }
        Err(error) => {
            eprintln!("sim-harness replay leader: {error}");
            exit_code(&error)
        }
    }
}

fn leader(args: &LeaderArgs) -> Result<String, TeamError> {
    let mut runs = Vec::new();
    for path in &args.recordings {
        let outcome = Recording::read(path)?.replay()?;
        let scored = outcome.score();
        let folder = args.out.as_ref().map(|out| match args.recordings.len() {
            1 => out.clone(),
            _ => out.join(format!("seed-{}", outcome.world.seed())),
        });
        if let Some(folder) = &folder {
            output::write_all(&outcome, &scored, folder)?;
        }
        if args.recordings.len() == 1 {
            return match args.format {
                Format::Json => json(&scored.scores),
                Format::Text => Ok(text(&outcome, &scored, folder.as_deref())),
            };
        }
        runs.push(scored.scores);
    }
    let summary = Summary::new(runs).ok_or_else(|| TeamError::Usage("no recording is given".to_owned()))?;
    match args.format {
        Format::Json => json(&summary),
        Format::Text => Ok(table::summary(&summary)),
    }
}
