//! `sim-harness baseline`: how well two robots know their distance after a second of standing.

use std::fmt::Write;
use std::path::PathBuf;

use clap::Args;
use indicatif::ProgressBar;

use super::record::Format;
use super::told::tell;
use crate::baseline::{self, Plan, Row, Sample};
use crate::scenario::{CameraSpec, Scenario};

/// Arguments of `baseline`.
#[derive(Debug, Clone, Args)]
pub struct BaselineArgs {
    /// Rooms with two robots, drawn anew
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    layouts: u32,
    /// Of the first layout; each has the next
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u64).range(0..1_000_000_000))]
    seed: u64,
    /// The camera of this scenario instead of the reference design: a file, or the name of one inside the program
    #[arg(long, value_name = "SCENARIO")]
    camera_of: Option<PathBuf>,
    /// Threads
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=64))]
    threads: u32,
    /// How to report
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

/// Does it; the exit code: 0 as required, 1 not, 2 usage error.
#[allow(clippy::print_stderr)]
pub fn run(args: &BaselineArgs) -> u8 {
    match work(args) {
        Ok((text, is_kept)) => tell("baseline", &text, u8::from(!is_kept)),
        Err((code, why)) => {
            eprintln!("sim-harness baseline: {why}");
            code
        }
    }
}

fn work(args: &BaselineArgs) -> Result<(String, bool), (u8, String)> {
    let camera = match &args.camera_of {
        Some(path) => Scenario::load(path).map_err(|e| (2, e.to_string()))?.camera,
        None => CameraSpec::default(),
    };
    let camera = CameraSpec { others: Vec::new(), tilts: Vec::new(), ..camera };
    let plan = Plan { layouts: args.layouts as usize, seed: args.seed, threads: args.threads as usize, camera };
    let bar = ProgressBar::new(plan.layouts as u64);
    let samples = baseline::run(&plan, &|| bar.inc(1)).map_err(|why| (1, why))?;
    bar.finish_and_clear();
    let rows = baseline::rows(&samples);
    let is_kept = rows.iter().all(|row| row.rms_percent <= row.required_percent);
    let text = match args.format {
        Format::Text => table(&samples, &rows),
        Format::Json => serde_json::to_string_pretty(&serde_json::json!({ "rows": rows, "layouts": samples }))
            .map_err(|e| (1, e.to_string()))?,
    };
    Ok((text, is_kept))
}

fn table(samples: &[Sample], rows: &[Row]) -> String {
    let mut text = format!(
        "{} layouts; the baseline in the map after {} s of standing\n\n  baseline     layouts   in the map    bias      RMS apart from it   required   NEES (bounds)\n",
        samples.len(),
        baseline::STANDING_S
    );
    for r in rows {
        let nees = match (r.nees, r.nees_bounds) {
            (Some(nees), Some([low, high])) => format!("{nees:.2} ({low:.2} … {high:.2})"),
            _ => "-".to_owned(),
        };
        let _ = writeln!(
            text,
            "  {:.1}–{:.1} m {:>10} {:>12} {:>+8.2} % {:>14.2} % {:>10.0} %   {nees}",
            r.range_m[0], r.range_m[1], r.layouts[0], r.layouts[1], r.bias_percent, r.rms_percent, r.required_percent
        );
    }
    let beyond = samples.iter().filter(|s| s.found.is_some_and(|[error, sigma]| error.abs() > 3.0 * sigma));
    for s in beyond {
        let [error, sigma] = s.found.unwrap_or_default();
        let _ = writeln!(
            text,
            "  beyond 3 σ: seed {} ({}) at {:.2} m, {:+.1} mm off ± {:.1} mm",
            s.seed,
            s.marker,
            s.range_m,
            1e3 * error,
            1e3 * sigma
        );
    }
    text
}
