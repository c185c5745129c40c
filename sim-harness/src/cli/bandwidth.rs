//! `sim-harness bandwidth`: bytes by message kind and robot, against video.

use std::path::PathBuf;

use clap::Args;

use super::record::Format;
use super::run::{Transport, checked_duration, exit_code, json, one, progress};
use super::table;
use crate::scenario::Scenario;
use crate::team::{TeamError, TeamSettings};

/// Arguments of `bandwidth`.
#[derive(Debug, Clone, Args)]
pub struct BandwidthArgs {
    /// A scenario file, or the name of a scenario inside the program: default, tiny, moving_start
    scenario: PathBuf,
    /// How messages travel; in a simulated network the bytes on the wire are computed
    #[arg(long, value_enum, default_value_t = Transport::Simulated)]
    transport: Transport,
    /// Another seed than the scenario's
    #[arg(long)]
    seed: Option<u64>,
    /// Only the first seconds of the scenario
    #[arg(long, value_name = "SECONDS")]
    duration: Option<f64>,
    /// How to report
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

/// Does it; gives the exit code.
#[allow(clippy::print_stderr)]
pub fn run(args: &BandwidthArgs) -> u8 {
    match measure(args) {
        Ok(text) => {
            println!("{}", text.trim_end());
            0
        }
        Err(error) => {
            eprintln!("sim-harness bandwidth: {error}");
            exit_code(&error)
        }
    }
}

fn measure(args: &BandwidthArgs) -> Result<String, TeamError> {
    let scenario = Scenario::load(&args.scenario)?;
    let settings = TeamSettings { duration_s: checked_duration(args.duration)?, ..TeamSettings::default() };
    let bar = progress(settings.duration_s.unwrap_or(f64::INFINITY).min(scenario.duration_s));
    let seed = args.seed.unwrap_or(scenario.seed);
    let outcome = one(&scenario, seed, args.transport, &settings, &|s| bar.set_position(s as u64))?;
    bar.finish_and_clear();
    if args.format == Format::Json {
        return json(&serde_json::json!({
            "scenario": outcome.scenario.name, "seed": seed, "duration_s": outcome.duration_s, "modelled": outcome.modelled,
            "bandwidth": outcome.bandwidth, "video": outcome.video,
        }));
    }
    let title = format!("{}, seed {seed}, {} s\n\n", outcome.scenario.name, outcome.duration_s);
    Ok(title + &table::bandwidth(&outcome.bandwidth, &outcome.video, outcome.names.len(), outcome.modelled))
}
