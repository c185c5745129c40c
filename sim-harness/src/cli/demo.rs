//! `sim-harness demo`, and `sim-harness` alone: a short real run of the default scenario over Zenoh.

use std::path::PathBuf;

use clap::Args;

use super::record::Format;
use super::run::{Transport, exit_code, json, one, progress, text, writable};
use super::told::tell;
use crate::scenario::Scenario;
use crate::team::{TeamError, TeamSettings, output};

/// How much of the default scenario is run, seconds.
pub const DEMO_S: f64 = 20.0;

/// Arguments of `demo`.
#[derive(Debug, Clone, Args)]
pub struct DemoArgs {
    /// Where pictures, map.jsonl, truth.jsonl and scores.json go
    #[arg(long, value_name = "DIR", default_value = "out")]
    out: PathBuf,
    /// Another seed than the scenario's
    #[arg(long)]
    seed: Option<u64>,
    /// How to report
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

impl Default for DemoArgs {
    fn default() -> Self {
        Self { out: PathBuf::from("out"), seed: None, format: Format::Text }
    }
}

/// Does it; gives the exit code.
#[allow(clippy::print_stderr)]
pub fn run(args: &DemoArgs) -> u8 {
    match demo(args) {
        Ok(text) => tell("demo", &text, 0),
        Err(error) => {
            eprintln!("sim-harness demo: {error}");
            exit_code(&error)
        }
    }
}

fn demo(args: &DemoArgs) -> Result<String, TeamError> {
    let scenario = Scenario::load("default".as_ref())?;
    let settings = TeamSettings { duration_s: Some(DEMO_S), ..TeamSettings::default() };
    writable(&args.out)?;
    let bar = progress(DEMO_S);
    let seed = args.seed.unwrap_or(scenario.seed);
    let outcome = one(&scenario, seed, Transport::Zenoh, &settings, &|s| bar.set_position(s as u64))?;
    bar.finish_and_clear();
    let scored = outcome.score();
    output::write_all(&outcome, &scored, &args.out)?;
    match args.format {
        Format::Json => json(&scored.scores),
        Format::Text => Ok(text(&outcome, &scored, Some(&args.out))),
    }
}
