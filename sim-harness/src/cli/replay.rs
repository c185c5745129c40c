//! `sim-harness replay`: recordings again. `leader`: what a leader heard in a simulated run, to a leader of today; `cmc`,
//! `mrclam`, `roh`: recordings made by others, against their truth.

use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};

use super::record::Format;
use super::run::{exit_code, json, text, writable};
use super::told::tell;
use super::{recorded_text, table};
use crate::recorded::{self, RecordedError};
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
    /// CMC: a detector's boxes of four fixed cameras, who is who unknown (GT_*, DET_*, cameras.json)
    Cmc(SetArgs),
    /// UTIAS MRCLAM: driving robots that see each other, with odometry (Barcodes.dat, RobotN_*.dat)
    Mrclam(SetArgs),
    /// Roh: bearings of four beacons at surveyed places (landmark.csv, (Xx,Yy).csv)
    Roh(SetArgs),
}

#[derive(Debug, Clone, Args)]
struct SetArgs {
    /// The set's folder
    dir: PathBuf,
    /// How to report
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
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
    let (what, done) = match &args.what {
        What::Leader(args) => ("leader", leader(args).map_err(|e| (exit_code(&e), e.to_string()))),
        What::Cmc(args) => ("cmc", set(args, recorded::cmc::replay, recorded_text::cmc)),
        What::Mrclam(args) => ("mrclam", set(args, recorded::mrclam::replay, recorded_text::mrclam)),
        What::Roh(args) => ("roh", set(args, recorded::roh::replay, recorded_text::roh)),
    };
    match done {
        Ok(text) => tell(&format!("replay {what}"), &text, 0),
        Err((code, error)) => {
            eprintln!("sim-harness replay {what}: {error}");
            code
        }
    }
}

/// Replays a set of others and reports.
fn set<R: serde::Serialize>(
    args: &SetArgs,
    replay: impl Fn(&Path) -> Result<R, RecordedError>,
    text: impl Fn(&R) -> String,
) -> Result<String, (u8, String)> {
    let report = replay(&args.dir).map_err(|e| (2, e.to_string()))?;
    match args.format {
        Format::Json => serde_json::to_string_pretty(&report).map_err(|e| (1, e.to_string())),
        Format::Text => Ok(text(&report)),
    }
}

fn leader(args: &LeaderArgs) -> Result<String, TeamError> {
    if let Some(out) = &args.out {
        writable(out)?;
    }
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
