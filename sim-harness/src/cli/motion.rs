//! `sim-harness motion`: one robot's eye on rendered scenes with truth.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use clap::Args;
use indicatif::ProgressBar;
use protocol::folder::make_writable;

use super::record::Format;
use super::seeds::{Seeds, parse};
use super::told::tell;
use crate::motion::score::{Errors, Regime};
use crate::motion::{Case, Claim, Tally, Trial, TrialError, run as run_trial, verdict};
use crate::parallel;

/// Arguments of `motion`.
#[derive(Debug, Clone, Args)]
pub struct MotionArgs {
    /// Which cases; all without
    #[arg(value_enum)]
    cases: Vec<Case>,
    /// Seeds, as 0..19 or 1,3,7
    #[arg(long, value_name = "SEEDS", default_value = "0..19", value_parser = parse)]
    seeds: Seeds,
    /// Threads
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=64))]
    threads: u32,
    /// Writes each trial's scenario (for `sim-harness record`) and what was seen beside the truth there
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Keeps rendered pictures in that folder (a byte a pixel, 0.1 GB a trial), and takes those that are there
    #[arg(long, value_name = "DIR")]
    pictures: Option<PathBuf>,
    /// How to report
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

/// Does it; gives the exit code: 1 where a promise was not kept.
#[allow(clippy::print_stderr)]
pub fn run(args: &MotionArgs) -> u8 {
    match work(args) {
        Ok((text, kept)) => tell("motion", &text, u8::from(!kept)),
        Err(error) => {
            eprintln!("sim-harness motion: {error}");
            1
        }
    }
}

fn work(args: &MotionArgs) -> Result<(String, bool), String> {
    let mut cases = if args.cases.is_empty() { Case::ALL.to_vec() } else { args.cases.clone() };
    cases.sort();
    cases.dedup();
    let jobs: Vec<(Case, u64)> = cases.iter().flat_map(|c| args.seeds.0.iter().map(move |s| (*c, *s))).collect();
    for folder in args.out.iter().chain(&args.pictures) {
        make_writable(folder).map_err(|e| format!("{}: {e}", folder.display()))?;
    }
    let bar = ProgressBar::new(jobs.len() as u64);
    let tallies = run_all(&jobs, args.threads as usize, args.pictures.as_deref(), |trial| {
        bar.inc(1);
        args.out.as_deref().map_or(Ok(()), |out| write_trial(out, trial))
    })?;
    bar.finish_and_clear();
    let mut results: Vec<(Case, Tally, Vec<Claim>)> = Vec::new();
    for case in cases {
        let mut all = Tally::default();
        jobs.iter().zip(&tallies).filter(|((c, _), _)| *c == case).for_each(|(_, t)| all.pool(t));
        let claims = verdict::claims(case, &all);
        results.push((case, all, claims));
    }
    let kept = results.iter().flat_map(|(_, _, claims)| claims).all(|c| c.kept);
    Ok((
        match args.format {
            Format::Text => text(&results),
            Format::Json => {
                let case = |(case, tally, claims): &(Case, Tally, Vec<Claim>)| serde_json::json!({"case": case.name(), "claims": claims, "figures": tally});
                serde_json::json!({"kept": kept, "cases": results.iter().map(case).collect::<Vec<_>>()}).to_string()
            }
        },
        kept,
    ))
}

/// Works all trials on some threads; tallies in the order of the jobs.
fn run_all(
    jobs: &[(Case, u64)],
    threads: usize,
    pictures: Option<&Path>,
    done: impl Fn(&Trial) -> Result<(), String> + Sync,
) -> Result<Vec<Tally>, String> {
    let tallies = parallel::map(threads, jobs, |(case, seed)| {
        let trial = run_trial(*case, *seed, pictures).map_err(|e: TrialError| e.to_string())?;
        done(&trial).map(|()| Tally::of(&trial))
    });
    tallies.into_iter().collect()
}

fn write_trial(out: &Path, trial: &Trial) -> Result<(), String> {
    let name = format!("{}-{}", trial.case.name(), trial.seed);
    let write =
        |file: PathBuf, text: String| std::fs::write(&file, text).map_err(|e| format!("{}: {e}", file.display()));
    let scenario = toml::to_string(&trial.scenario).map_err(|e| e.to_string())?;
    write(out.join(format!("{name}.toml")), scenario)?;
    let mut lines = String::new();
    for i in &trial.instants {
        let tracks: Vec<_> = i
            .tracks
            .iter()
            .map(|t| {
                serde_json::json!({
                    "track": t.track.0, "state": format!("{:?}", t.state).to_lowercase(),
                    "bearing_deg": t.bearing.rad().to_degrees(), "bearing_sigma_deg": t.bearing_sigma.value().to_degrees(),
                    "elevation_deg": t.elevation.map(|e| e.rad().to_degrees()),
                    "elevation_sigma_deg": t.elevation_sigma.value().to_degrees(),
                    "ends": t.ends.map(|e| format!("{e:?}").to_lowercase()),
                    "range_m": t.range.as_ref().map(|r| r.range.m()), "range_sigma_m": t.range.as_ref().map(|r| r.sigma.value()),
                    "doubtful": t.doubtful,
                })
            })
            .collect();
        let people: Vec<_> = i
            .people
            .iter()
            .map(|p| {
                serde_json::json!({
                    "bearing_deg": p.bearing_rad.to_degrees(), "range_m": p.range_m, "height_m": p.height_m,
                    "elevation_deg": p.elevation_rad.map(f64::to_degrees), "visible_fraction": p.visible_fraction,
                })
            })
            .collect();
        let alarms: Vec<String> = i.alarms.iter().map(|a| format!("{a:?}")).collect();
        let line = serde_json::json!({
            "time_s": i.time_s, "motion": format!("{:?}", i.motion).to_lowercase(), "ready": i.ready,
            "alarms": alarms, "tracks": tracks, "people": people,
        });
        let _ = writeln!(lines, "{line}");
    }
    write(out.join(format!("{name}.jsonl")), lines)
}

fn text(results: &[(Case, Tally, Vec<Claim>)]) -> String {
    let mut text = String::from("case       trials  switches  coverage  nobody's/frame  bearing rms  NEES\n");
    for (case, t, _) in results {
        let all = t.all_ends();
        let _ = writeln!(
            text,
            "{:<10} {:>6}  {:>8}  {:>7.1}%  {:>14.3}  {:>10}  {}",
            case.name(),
            t.trials,
            t.switches,
            100.0 * t.coverage().unwrap_or(f64::NAN),
            t.orphans as f64 / t.frames.max(1) as f64,
            all.bearing.rms().map_or("-".into(), |r| format!("{:.2}°", r.to_degrees())),
            nees(&all.bearing),
        );
    }
    text.push_str("\ncase       feet/top       frames  bearing       range: bias rms NEES      height: bias rms NEES      feet: bias° NEES   top: bias° NEES   no bound\n");
    for (case, t, _) in results.iter().filter(|(c, ..)| !c.is_meeting()) {
        for (ends, r) in &t.regimes {
            text.push_str(&regime_line(case.name(), ends, r));
        }
    }
    text.push('\n');
    for (case, _, claims) in results {
        for c in claims {
            let _ = writeln!(
                text,
                "{} {:<10} {}: {}",
                if c.kept { "kept  " } else { "BROKEN" },
                case.name(),
                c.says,
                c.found
            );
        }
    }
    text
}

fn regime_line(case: &str, ends: &str, r: &Regime) -> String {
    let metres = |e: &Errors| match (e.bias(), e.rms()) {
        (Some(bias), Some(rms)) => format!("{bias:>6.2} {rms:>5.2} {}", nees(e)),
        _ => "-".to_owned(),
    };
    let degrees = |e: &Errors| e.bias().map_or("-".into(), |b| format!("{:>6.2} {}", b.to_degrees(), nees(e)));
    let [low, high] = &r.elevation;
    format!(
        "{case:<10} {ends:<13} {:>7}  {:<12}  {:<24}  {:<25}  {:<17}  {:<16}  {}/{}\n",
        r.bearing.count,
        nees(&r.bearing),
        metres(&r.range),
        metres(&r.height),
        degrees(low),
        degrees(high),
        r.bounds[1],
        r.bounds[0],
    )
}

/// "0.93 (84)": mean and number of samples.
fn nees(e: &Errors) -> String {
    e.nees.mean().map_or("-".into(), |mean| format!("{mean:.2} ({})", e.nees.dimensions))
}
