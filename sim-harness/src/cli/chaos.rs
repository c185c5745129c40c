//! `sim-harness chaos`: faults on purpose, and how long until the map is right again.

use std::fmt::Write;
use std::path::PathBuf;

use clap::{Args, ValueEnum};

use super::record::Format;
use super::run::{exit_code, json};
use super::seeds::{self, Seeds};
use super::told::tell;
use crate::chaos::processes::{self, Fault, RobotArgs};
use crate::chaos::{self, Run};
use crate::team::TeamError;

/// Right again later than this after the end of the fault is a failure, seconds.
const LIMIT_S: f64 = 2.0;

/// Arguments of `chaos`.
#[derive(Debug, Clone, Args)]
pub struct ChaosArgs {
    /// Seeds, as 0..49 or 1,3,7: each is another world with another fault; the kinds come in turn
    #[arg(long, value_parser = seeds::parse, default_value = "0..49")]
    seeds: Seeds,
    /// Over real Zenoh between processes in network namespaces (as root), each kind of fault so often, instead of simulated
    #[arg(long, value_name = "TIMES", value_parser = clap::value_parser!(u32).range(1..=1000))]
    processes: Option<u32>,
    /// With --processes: only these kinds
    #[arg(long, value_enum, value_delimiter = ',', requires = "processes")]
    faults: Vec<Fault>,
    #[command(flatten)]
    robot: RobotArgs,
    /// A leader's process: its configuration. Not for people
    #[arg(long, hide = true)]
    as_leader: Option<PathBuf>,
    /// How to report
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

/// Does it; gives the exit code: 1 where the map was right again too late, or something was that must never be.
#[allow(clippy::print_stderr)]
pub fn run(args: &ChaosArgs) -> u8 {
    if let Some(config) = &args.as_leader {
        return team_leader::cli::run::run(&team_leader::cli::run::RunArgs { config: config.clone() });
    }
    let done = match (args.robot.as_robot, args.processes) {
        (Some(robot), _) => processes::run_robot(robot, &args.robot.leaders).map(|()| (String::new(), true)),
        (None, Some(times)) => over_zenoh(args, times),
        (None, None) => all(args),
    };
    match done {
        Ok((text, fine)) => tell("chaos", &text, u8::from(!fine)),
        Err(error) => {
            eprintln!("sim-harness chaos: {error}");
            exit_code(&error)
        }
    }
}

fn all(args: &ChaosArgs) -> Result<(String, bool), TeamError> {
    let mut runs = Vec::new();
    let bar = indicatif::ProgressBar::new(args.seeds.0.len() as u64);
    for seed in &args.seeds.0 {
        runs.push(chaos::run(*seed)?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    let fine = runs.iter().all(is_fine);
    if args.format == Format::Json {
        return Ok((json(&serde_json::json!({ "limit_s": LIMIT_S, "fine": fine, "runs": runs }))?, fine));
    }
    Ok((table(&runs), fine))
}

fn over_zenoh(args: &ChaosArgs, times: u32) -> Result<(String, bool), TeamError> {
    let kinds = if args.faults.is_empty() { Fault::value_variants() } else { &args.faults };
    let (mut runs, mut fine) = (Vec::new(), true);
    let mut text = format!(
        "{:<12} {:>7} {:>8} {:>9} {:>8} {:>6} {:>7}\n",
        "fault", "next s", "right s", "silent s", "renamed", "maps", "fenced"
    );
    for fault in kinds {
        for _ in 0..times {
            let run = processes::run(*fault)?;
            fine &= run.findings.are_fine(LIMIT_S);
            let name = fault.to_possible_value().map(|value| value.get_name().to_owned()).unwrap_or_default();
            let _ = writeln!(
                text,
                "{name:<12} {:>7} {:>8} {:>9.2} {:>8} {:>6} {:>7}",
                or_dash(run.findings.taken_over_s),
                or_dash(run.findings.right_again_s),
                run.findings.longest_silence_s,
                run.findings.renamed,
                run.maps,
                run.fenced
            );
            for violation in &run.findings.violations {
                let _ = writeln!(text, "       ! {violation}");
            }
            runs.push(run);
        }
    }
    match args.format {
        Format::Json => Ok((json(&serde_json::json!({ "limit_s": LIMIT_S, "fine": fine, "runs": runs }))?, fine)),
        Format::Text => Ok((text, fine)),
    }
}

fn or_dash(value: Option<f64>) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.2}"))
}

/// Whether a run is as it should be.
pub fn is_fine(run: &Run) -> bool {
    run.findings.are_fine(LIMIT_S) && run.alarms.1 == 0
}

fn table(runs: &[Run]) -> String {
    let mut text = format!(
        "{:>5}  {:<20} {:>9} {:>9} {:>9} {:>8} {:>8} {:>7}\n",
        "seed", "fault", "next s", "right s", "silent s", "renamed", "lost", "alarms"
    );
    for run in runs {
        let _ = writeln!(text, "{}", line(run));
    }
    let worst = runs.iter().filter_map(|run| run.findings.right_again_s).fold(0.0, f64::max);
    let failed = runs.iter().filter(|run| !is_fine(run)).count();
    let _ = writeln!(
        text,
        "\n{} runs, {failed} not as they should be; right again after {worst:.2} s at worst ({LIMIT_S} s is the limit). next: from the fault\n\
         to the next leader's map; right: from the fault's end to a map that stays right; silent: longest time without a map.",
        runs.len()
    );
    text
}

/// A run in one line, and what must never be below it.
pub fn line(run: &Run) -> String {
    let findings = &run.findings;
    let mut text = format!(
        "{:>5}  {:<20} {:>9} {:>9} {:>9.2} {:>8} {:>8} {:>7}",
        run.seed,
        run.fault.word(),
        or_dash(findings.taken_over_s),
        or_dash(findings.right_again_s),
        findings.longest_silence_s,
        findings.renamed,
        run.messages_lost,
        format!("{}/{}", run.alarms.0 - run.alarms.1, run.alarms.0),
    );
    for violation in &findings.violations {
        let _ = write!(text, "\n       ! {violation}");
    }
    text
}
