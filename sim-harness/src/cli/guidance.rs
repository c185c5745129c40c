//! `sim-harness guidance`: robots go where the leader says; expected and achieved errors.

use clap::Args;
use indicatif::ProgressBar;

use super::record::Format;
use super::told::tell;
use crate::guidance::{self, Report};

/// Arguments of `guidance`.
#[derive(Debug, Clone, Args)]
pub struct GuidanceArgs {
    /// How many seeds, from 0 on
    #[arg(long, default_value_t = 40, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    seeds: u64,
    /// How to report
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

/// Does it; gives the exit code.
#[allow(clippy::print_stderr)]
pub fn run(args: &GuidanceArgs) -> u8 {
    let bar = ProgressBar::new(args.seeds);
    let report = guidance::run(0..args.seeds, &|| bar.inc(1));
    bar.finish_and_clear();
    let told = report.map_err(|e| e.to_string()).and_then(|report| match args.format {
        Format::Json => serde_json::to_string_pretty(&report).map_err(|e| e.to_string()),
        Format::Text => Ok(text(&report)),
    });
    match told {
        Ok(text) => tell("guidance", &text, 0),
        Err(error) => {
            eprintln!("sim-harness guidance: {error}");
            1
        }
    }
}

fn text(report: &Report) -> String {
    let mut text = String::from(
        "seed  robot   way m   here: expected achieved stated   there: expected achieved stated   achieved/expected\n",
    );
    for run in &report.runs {
        let line = match &run.told {
            Some(told) => format!(
                "{:4}  {:5}  {:6.2}         {:8.4} {:8.4} {:6.4}          {:8.4} {:8.4} {:6.4}   {:17.2}\n",
                run.seed,
                told.robot,
                told.way_m,
                told.error_here_m,
                run.before_m,
                run.stated_before_m,
                told.error_there_m,
                run.after_m,
                run.stated_after_m,
                run.after_m / told.error_there_m
            ),
            None => format!("{:4}  nobody is told: no place is worth the way\n", run.seed),
        };
        text.push_str(&line);
    }
    text.push_str(&format!(
        "\n{} of {} followed: here {:.4} m expected, {:.4} m achieved; there {:.4} m expected, {:.4} m achieved ({:+.0} %); \
         the fall is {:+.0} % off\n",
        report.followed,
        report.runs.len(),
        report.expected_here_m,
        report.achieved_before_m,
        report.expected_there_m,
        report.achieved_after_m,
        100.0 * (report.there - 1.0),
        100.0 * (report.fall - 1.0)
    ));
    text
}
