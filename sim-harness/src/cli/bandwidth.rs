//! `sim-harness bandwidth`: bytes by message kind and robot, against video.

use std::path::PathBuf;

use clap::Args;
use protocol::codec::Kind;

use super::record::Format;
use super::run::{Transport, checked_duration, exit_code, json, one, progress};
use super::table;
use super::told::{note_short, scenario_help, tell};
use crate::bandwidth::interface::{Counters, in_namespace};
use crate::scenario::Scenario;
use crate::team::{TeamError, TeamSettings};

/// Arguments of `bandwidth`.
#[derive(Debug, Clone, Args)]
pub struct BandwidthArgs {
    #[arg(help = scenario_help())]
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
    /// Also count what passes the interface: the run is over Zenoh, on the loopback of a network namespace of its own (Linux)
    #[arg(long)]
    interface: bool,
    /// The run in the namespace: not for people
    #[arg(long, hide = true)]
    in_namespace: bool,
    /// How to report
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

/// Does it; gives the exit code.
#[allow(clippy::print_stderr)]
pub fn run(args: &BandwidthArgs) -> u8 {
    if args.interface && !args.in_namespace {
        let again = std::env::args_os().skip(1).chain(["--in-namespace".into()]);
        return in_namespace(again).unwrap_or_else(|why| {
            eprintln!("sim-harness bandwidth: {why}");
            1
        });
    }
    match measure(args) {
        Ok(text) => tell("bandwidth", &text, 0),
        Err(error) => {
            eprintln!("sim-harness bandwidth: {error}");
            exit_code(&error)
        }
    }
}

fn measure(args: &BandwidthArgs) -> Result<String, TeamError> {
    let scenario = Scenario::load(&args.scenario)?;
    let settings = TeamSettings {
        duration_s: checked_duration(args.duration)?,
        unwatched: args.interface,
        ..TeamSettings::default()
    };
    note_short("bandwidth", args.duration, &scenario);
    let bar = progress(settings.duration_s.unwrap_or(f64::INFINITY).min(scenario.duration_s));
    let seed = args.seed.unwrap_or(scenario.seed);
    let transport = if args.interface { Transport::Zenoh } else { args.transport };
    let before = args.interface.then(Counters::begin).transpose().map_err(TeamError::Service)?;
    let outcome = one(&scenario, seed, transport, &settings, &|s| bar.set_position(s as u64))?;
    bar.finish_and_clear();
    let passed = match before {
        Some(before) => {
            let now = Counters::read().map_err(TeamError::Service)?;
            Some(before.rate(&now, outcome.duration_s, outcome.names.len()))
        }
        None => None,
    };
    if args.format == Format::Json {
        return json(&serde_json::json!({
            "scenario": outcome.scenario.name, "seed": seed, "duration_s": outcome.duration_s, "modelled": outcome.modelled,
            "bandwidth": outcome.bandwidth, "video": outcome.video, "interface": passed,
        }));
    }
    let title = format!("{}, seed {seed}, {} s\n\n", outcome.scenario.name, outcome.duration_s);
    let table = table::bandwidth(&outcome.bandwidth, &outcome.video, outcome.names.len(), outcome.modelled);
    let unheard = Kind::TeamMap.name();
    let expected: f64 =
        outcome.bandwidth.iter().filter(|row| row.kind != unheard).map(|row| row.wire_bytes_per_s).sum();
    let counted = passed.map_or(String::new(), |rate| {
        format!(
            "\ninterface {}, all sessions, both directions, headers and acknowledgements: {:.0} B/s in {:.0} packets/s, {:.0} B/s a robot\n\
             (the table's wire bytes but for the map, which leaves only where somebody listens, as nobody does here: {expected:.0} B/s)\n",
            rate.interface, rate.bytes_per_s, rate.packets_per_s, rate.bytes_per_s_a_robot
        )
    });
    Ok(title + &table + &counted)
}
