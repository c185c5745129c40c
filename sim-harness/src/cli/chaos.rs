//! `sim-harness chaos`: faults on purpose, and how long until the map is right again.

use std::fmt::Write;

use clap::Args;

use super::record::Format;
use super::run::{exit_code, json};
use super::seeds::{self, Seeds};
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
    /// How to report
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

/// Does it; gives the exit code: 1 where the map was right again too late, or something was that must never be.
#[allow(clippy::print_stderr)]
pub fn run(args: &ChaosArgs) -> u8 {
    match all(args) {
        Ok((text, fine)) => {
            println!("{}", text.trim_end());
            u8::from(!fine)
        }
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

/// Whether a run is as it should be.
pub fn is_fine(run: &Run) -> bool {
    run.findings.violations.is_empty()
        && run.alarms.1 == 0
        && run.findings.right_again_s.is_some_and(|after_s| after_s <= LIMIT_S)
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
    let or_dash = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.2}"));
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
