//! `sim-harness efficiency`: the solver's errors against the Cramér–Rao bound.

use std::path::PathBuf;

use clap::Args;
use indicatif::ProgressBar;
use protocol::folder::make_writable;

use super::record::Format;
use super::told::tell;
use crate::efficiency::{self, Noise, Plan, plot, table};

/// Arguments of `efficiency`.
#[derive(Debug, Clone, Args)]
pub struct EfficiencyArgs {
    /// Draws a case
    #[arg(long, default_value_t = 5000, value_parser = clap::value_parser!(u32).range(10..=1_000_000))]
    draws: u32,
    /// Draws of the independent estimator where the bound is only a first approximation; 0: none
    #[arg(long, default_value_t = 100_000)]
    reference: u32,
    /// Errors with the tails of real bearings: 4 % have five times the stated sigma
    #[arg(long)]
    tails: bool,
    /// Only cases whose name contains this ("3 robots", "24 bars", "B 2 m")
    #[arg(long, value_name = "TEXT")]
    only: Option<String>,
    /// Threads
    #[arg(long, default_value_t = 2)]
    threads: usize,
    /// Writes outcomes.json, table.txt and plot.svg there
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// How to report
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

/// Does it; gives the exit code.
#[allow(clippy::print_stderr)]
pub fn run(args: &EfficiencyArgs) -> u8 {
    match work(args) {
        Ok(text) => tell("efficiency", &text, 0),
        Err((code, error)) => {
            eprintln!("sim-harness efficiency: {error}");
            code
        }
    }
}

fn work(args: &EfficiencyArgs) -> Result<String, (u8, String)> {
    let mut cases = efficiency::cases();
    if let Some(only) = &args.only {
        cases.retain(|c| c.name().contains(only.as_str()));
    }
    if cases.is_empty() {
        let only = args.only.as_deref().unwrap_or_default();
        return Err((2, format!("--only {only:?} leaves no case; \"cylinder\" or \"5 robots\" would")));
    }
    let failed = |e: String| (1, e);
    if let Some(out) = &args.out {
        make_writable(out).map_err(|e| failed(format!("{}: {e}", out.display())))?;
    }
    let bar = ProgressBar::new(cases.len() as u64);
    let plan = Plan {
        draws: args.draws as usize,
        reference: args.reference as usize,
        noise: if args.tails { Noise::Tailed } else { Noise::Gaussian },
        threads: args.threads.clamp(1, 64),
    };
    let outcomes = efficiency::run(&cases, &plan, &|| bar.inc(1));
    bar.finish_and_clear();
    let text = table::text(&outcomes);
    let json = serde_json::json!({ "verdict": table::verdict(&outcomes), "cases": outcomes });
    let json = serde_json::to_string_pretty(&json).map_err(|e| failed(e.to_string()))?;
    if let Some(out) = &args.out {
        let put = |name: &str, text: &str| {
            std::fs::write(out.join(name), text).map_err(|e| failed(format!("{}: {e}", out.join(name).display())))
        };
        put("outcomes.json", &json)?;
        put("table.txt", &text)?;
        let path = out.join("plot.svg");
        plot::write(&outcomes, &path).map_err(|e| failed(format!("{}: {e}", path.display())))?;
    }
    Ok(match args.format {
        Format::Text => text,
        Format::Json => json,
    })
}
