//! `sim-harness scale`: what one leader carries.

use clap::Args;

use super::record::Format;
use super::run::exit_code;
use super::told::print;
use crate::scale::{self, Figures, Load, MAX_ROBOTS};
use crate::team::{TeamError, failed};

/// Arguments of `scale`. The soak is `scale --robots 20 --duration 1800`.
#[derive(Debug, Clone, Args)]
pub struct ScaleArgs {
    /// Robots, in rooms of four; several numbers are tried one after another
    #[arg(long, value_delimiter = ',', default_value = "10,50,200")]
    robots: Vec<usize>,
    /// Observations a second of each
    #[arg(long, default_value_t = 10.0)]
    rate_hz: f64,
    /// How long each, after 5 s of settling
    #[arg(long, value_name = "SECONDS", default_value_t = 30.0)]
    duration: f64,
    /// Seed of the noise
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Robots wear no codes: all look alike, and the leader finds out who is in which room
    #[arg(long)]
    alike: bool,
    /// Do not pin the leader to processor 0 and the senders to 1
    #[arg(long)]
    no_pin: bool,
    /// A soak: fail where the leader's memory grew by more than a tenth and goes on growing (the run is made longer to see it, to
    /// four spans in all), its open files grew at all, or a message was lost
    #[arg(long)]
    flat: bool,
    /// How to report
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
    /// The leader's process: not for people
    #[arg(long, hide = true)]
    as_leader: bool,
}

/// Does it; gives the exit code: 1 where `--flat` was asked for and is not.
#[allow(clippy::print_stderr)]
pub fn run(args: &ScaleArgs) -> u8 {
    let done = if args.as_leader { scale::leader::run() } else { measure(args) };
    match done {
        Ok(()) => 0,
        Err(error) => {
            eprintln!("sim-harness scale: {error}");
            exit_code(&error)
        }
    }
}

#[allow(clippy::print_stderr)]
fn measure(args: &ScaleArgs) -> Result<(), TeamError> {
    let usage = |what: String| Err(TeamError::Usage(what));
    if let Some(wrong) = args.robots.iter().find(|robots| !(1..=MAX_ROBOTS).contains(*robots)) {
        return usage(format!("--robots {wrong}: 1 to {MAX_ROBOTS}"));
    }
    if !(0.1..=120.0).contains(&args.rate_hz) {
        return usage(format!("--rate-hz {}: 0.1 to 120", args.rate_hz));
    }
    if !(1.0..=86_400.0).contains(&args.duration) {
        return usage(format!("--duration {}: 1 to 86400 seconds", args.duration));
    }
    let mut all = Vec::new();
    for robots in &args.robots {
        let load = Load {
            robots: *robots,
            rate_hz: args.rate_hz,
            duration_s: args.duration,
            seed: args.seed,
            coded: !args.alike,
            pinned: !args.no_pin,
            flat: args.flat,
        };
        let mut minute = 0;
        let figures = scale::run(&load, &mut |seconds, now| {
            // A long run says once a minute how it goes.
            if seconds as u64 / 60 > minute {
                minute = seconds as u64 / 60;
                let megabytes = now.resident_bytes as f64 * 1e-6;
                eprintln!("{minute} min: {megabytes:.1} MB, {} files, {:.1} s of processor", now.open_files, now.cpu_s);
            }
        })?;
        let line = in_words(&figures, all.is_empty());
        all.push(figures);
        if args.format == Format::Text && !print(&line).map_err(failed)? {
            break;
        }
    }
    if args.format == Format::Json {
        print(&serde_json::to_string_pretty(&all).map_err(failed)?).map_err(failed)?;
    }
    match all.iter().filter(|_| args.flat).find_map(unflat) {
        Some(why) => Err(TeamError::Service(why)),
        None => Ok(()),
    }
}

/// What a soak must not show.
fn unflat(figures: &Figures) -> Option<String> {
    let robots = figures.load.robots;
    if figures.memory_grows() {
        return Some(format!("{robots} robots: the leader's memory grew from {} MB", marks_mb(figures, " to ")));
    }
    let files = &figures.open_files;
    if files.last() > files.first() {
        return Some(format!("{robots} robots: the leader's open files grew from {}", joined(files, " to ")));
    }
    (figures.lost > 0).then(|| format!("{robots} robots: the leader lost {} messages", figures.lost))
}

fn in_words(figures: &Figures, first: bool) -> String {
    let heading = "robots  cores  latency p50 / p99 / worst ms  capture→map p50 / p99 ms  heard of sent     lost  maps/s    robots    people (least)  all after s  MB half → end  files";
    let [p50, p99, worst] = figures.latency_ms;
    let [age_50, age_99, _] = figures.capture_to_map_ms;
    let least = figures.least_right[1];
    let all_after = figures.all_placed_s.map_or("never".to_owned(), |s| format!("{s:.0}"));
    let line = format!(
        "{:>6}  {:>5.2}  {p50:>11.1} / {p99:>5.1} / {worst:>8.1}  {age_50:>17.1} / {age_99:>5.1}  {:>7} of {:>7}  {:>4}  {:>6.1}  {:>3} of {:<3} {:>3} of {:<3} ({least:.2})  {all_after:>11}  {:>15}  {}",
        figures.load.robots,
        figures.leader_cores,
        figures.heard,
        figures.sent,
        figures.lost,
        figures.maps as f64 / figures.measured_s,
        figures.right[0][0],
        figures.right[0][1],
        figures.right[1][0],
        figures.right[1][1],
        marks_mb(figures, " → "),
        joined(&figures.open_files, " → "),
    );
    if first { format!("{heading}\n{line}") } else { line }
}

fn marks_mb(figures: &Figures, between: &str) -> String {
    joined(figures.memory_mb.iter().map(|mb| format!("{mb:.1}")), between)
}

fn joined(values: impl IntoIterator<Item: ToString>, between: &str) -> String {
    values.into_iter().map(|value| value.to_string()).collect::<Vec<_>>().join(between)
}
