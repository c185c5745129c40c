//! `sim-harness peers`: how well robots are found, measured and named in rendered pictures.

use std::fmt::Write;
use std::path::PathBuf;

use clap::Args;
use indicatif::ProgressBar;
use protocol::folder::make_writable;

use super::record::Format;
use super::told::tell;
use crate::peers::{self, Plan, Report, Team, statistics, verdict};
use crate::scenario::{CameraSpec, Scenario};

/// Arguments of `peers`.
#[derive(Debug, Clone, Args)]
pub struct PeersArgs {
    /// Pictures in all
    #[arg(long, default_value_t = 10_000, value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
    pictures: u32,
    /// Pictures of each layout, 10 a second
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=100))]
    per_layout: u32,
    /// Of the first layout; each has the next
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// The camera of this scenario instead of the reference design: a file, or the name of one inside the program
    #[arg(long, value_name = "SCENARIO")]
    camera_of: Option<PathBuf>,
    /// Rooms without any robot to see: every sighting is a false one
    #[arg(long)]
    without_robots: bool,
    /// Nobody in the team wears bars: rings and plates alone
    #[arg(long)]
    plain: bool,
    /// Threads
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=64))]
    threads: u32,
    /// Writes report.json, table.txt, faults.txt and a picture of each fault there
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Writes what cylinders and plates were fitted to, with the truth, a line of JSON each: for `sim-harness verdict`
    #[arg(long, value_name = "FILE")]
    fits: Option<PathBuf>,
    /// How to report
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

/// Arguments of `verdict`.
#[derive(Debug, Clone, Args)]
pub struct VerdictArgs {
    /// As `peers --fits` writes them
    #[arg(required = true, value_name = "FILE")]
    fits: Vec<PathBuf>,
    /// Writes trees and networks there: `robot-agent/src/peers/verdict`, from which the detector is built
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

/// Does it; gives the exit code.
pub fn run(args: &PeersArgs) -> u8 {
    told("peers", work(args))
}

/// `sim-harness verdict`: the trees and networks with which the detector tells robots from other things, learnt from fits.
pub fn run_verdict(args: &VerdictArgs) -> u8 {
    let examples = args.fits.iter().map(|path| verdict::read(path)).collect::<Result<Vec<_>, _>>();
    let learnt = examples.and_then(|examples| verdict::learn(&examples.concat())).and_then(|learnt| {
        args.out.iter().try_for_each(|dir| verdict::write_judges(dir, &learnt))?;
        Ok(learnt.text)
    });
    told("verdict", learnt.map_err(|e| Failure::of(2)(&e)))
}

#[allow(clippy::print_stderr)]
fn told(command: &str, text: Result<String, Failure>) -> u8 {
    match text {
        Ok(text) => tell(command, &text, 0),
        Err(failure) => {
            eprintln!("sim-harness {command}: {}", failure.why);
            failure.exit_code
        }
    }
}

/// Exit codes are 2 for what the user gave and 1 for what failed.
struct Failure {
    why: String,
    exit_code: u8,
}

impl Failure {
    fn of(exit_code: u8) -> impl Fn(&dyn std::fmt::Display) -> Self {
        move |why| Self { why: why.to_string(), exit_code }
    }
}

fn work(args: &PeersArgs) -> Result<String, Failure> {
    let (usage, failed) = (Failure::of(2), Failure::of(1));
    let layouts = args.pictures.div_ceil(args.per_layout) as usize;
    let camera = match &args.camera_of {
        Some(path) => Scenario::load(path).map_err(|e| usage(&e))?.camera,
        None => CameraSpec::default(),
    };
    let plan = Plan {
        layouts,
        pictures: args.per_layout as usize,
        seed: args.seed,
        threads: args.threads as usize,
        robots: !args.without_robots,
        team: if args.plain { Team::Plain } else { Team::Mixed },
        camera,
    };
    if let Some(out) = &args.out {
        make_writable(out).map_err(|e| failed(&format_args!("{}: {e}", out.display())))?;
    }
    if let Some(path) = &args.fits {
        let opened = std::fs::OpenOptions::new().create(true).append(true).open(path);
        opened.map_err(|e| failed(&format_args!("{}: {e}", path.display())))?;
    }
    let bar = ProgressBar::new(layouts as u64);
    let outcomes = peers::run(&plan, &|| bar.inc(1)).map_err(|e| usage(&e))?;
    bar.finish_and_clear();
    let report = statistics::report(&outcomes);
    let json = serde_json::to_string_pretty(&report).map_err(|e| failed(&e))?;
    let text = table(&report);
    if let Some(out) = &args.out {
        let faults: Vec<String> =
            report.faults.iter().map(|f| format!("seed {} picture {}: {}", f.seed, f.picture, f.what)).collect();
        for (name, text) in [("report.json", &json), ("table.txt", &text), ("faults.txt", &faults.join("\n"))] {
            let path = out.join(name);
            std::fs::write(&path, text).map_err(|e| failed(&format_args!("{}: {e}", path.display())))?;
        }
        peers::pictures::write(&plan, &outcomes, &report, out).map_err(|e| failed(&e))?;
    }
    if let Some(path) = &args.fits {
        verdict::write(path, outcomes.iter().flat_map(|o| &o.fits)).map_err(|e| failed(&e))?;
    }
    Ok(match args.format {
        Format::Text => text,
        Format::Json => json,
    })
}

pub(crate) fn table(report: &Report) -> String {
    let mut text = format!(
        "{} pictures of {} layouts from seed {}, {} sightings, {:.1} ms a picture\n\n  marker       range m   found of half seen   bearing mrad    range %         NEES   heading         named\n                                              bias   rms      bias   rms             °  NEES         right wrong\n",
        report.pictures,
        report.layouts,
        report.seed,
        report.sightings,
        report.detector_us * 1e-3
    );
    for c in &report.cells {
        let _ = writeln!(
            text,
            "  {:<11} {:.1}–{:.1} {:>7}/{:<6} {:>5.1} %  {:>6.2} {:>5.2}   {:>6.2} {:>5.2}   {:>6.2}  {:>6.1} {:>5.2} {:>6}  {:>5} {:>4}",
            c.marker,
            c.range_m[0],
            c.range_m[1],
            c.half_seen.found,
            c.half_seen.shown,
            100.0 * c.half_seen.rate(),
            c.bearing_mrad[0],
            c.bearing_mrad[1],
            c.range_percent[0],
            c.range_percent[1],
            c.nees,
            c.heading_deg,
            c.heading_nees,
            c.headings,
            c.named[0],
            c.named[1]
        );
    }
    text.push_str("\n  detection where at least half is unhidden:");
    for (marker, share) in &report.detection {
        let _ = write!(text, "  {marker} {:.2} % of {}", 100.0 * share.rate(), share.shown);
    }
    let _ = writeln!(
        text,
        "\n  sightings beyond 4 σ of every robot: {} ({} where no robot is); headings beyond 4 σ: {}\n\n  before it   unhidden      found of shown   beyond 4 σ   NEES",
        report.beyond_four_sigma, report.without_robot, report.headings_beyond_four_sigma
    );
    for h in &report.hidden {
        let _ = writeln!(
            text,
            "  {:<10} {:>3.0}–{:<3.0} % {:>9}/{:<6} {:>10} {:>8.2}",
            h.before,
            100.0 * h.visible[0],
            100.0 * h.visible[1],
            h.found,
            h.shown,
            h.beyond_four_sigma,
            h.nees
        );
    }
    let _ = writeln!(text, "\n  range over a second of standing   robots   bias     rms");
    for b in &report.baseline {
        let _ = writeln!(
            text,
            "  {:.1}–{:.1} m {:>31} {:>+7.2} % {:>6.2} %",
            b.range_m[0], b.range_m[1], b.robots, b.bias_percent, b.rms_percent
        );
    }
    text
}
