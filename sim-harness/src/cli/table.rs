//! Scores and traffic as tables for people.

use std::fmt::Write;

use crate::bandwidth::{KindRate, VideoRate};
use crate::score::scores::{Latency, RobotScores, TargetScores};
use crate::score::{Scores, Summary};
use crate::team::Outcome;

/// The figures of one run.
pub fn scores(scores: &Scores) -> String {
    let mut text = format!("{}, seed {}, {} s\n\n", scores.scenario, scores.seed, scores.duration_s);
    figures(&mut text, &[("", &scores.robots, &scores.targets, &scores.latency_ms)]);
    if scores.structure.edges > 0 {
        let _ = writeln!(text, "\n{}", scores.structure);
    }
    if scores.modelled {
        text.push_str("\nVirtual time: latency and bytes on the wire are modelled.\n");
    }
    text
}

/// Mean and worst of several runs, and the main figures of each.
pub fn summary(summary: &Summary) -> String {
    let (first, last) = (summary.seeds.first(), summary.seeds.last());
    let seeds = first.zip(last).map_or(String::new(), |(a, b)| format!("seeds {a} to {b}"));
    let mut text =
        format!("{}, {} runs ({seeds}) of {} s\n\n", summary.scenario, summary.seeds.len(), summary.duration_s);
    let (mean, worst) = (&summary.mean, &summary.worst);
    figures(
        &mut text,
        &[
            ("mean", &mean.robots, &mean.targets, &mean.latency_ms),
            ("worst", &worst.robots, &worst.targets, &worst.latency_ms),
        ],
    );
    let _ = writeln!(
        text,
        "\nall runs together: {} identity switches, {} false tracks\n{}\n",
        summary.total.id_switches, summary.total.false_tracks, summary.structure
    );
    let _ = writeln!(
        text,
        "{:>5} {:>9} {:>9} {:>9} {:>9} {:>8} {:>8} {:>9} {:>8} {:>8} {:>8} {:>6} {:>6}",
        "seed",
        "robot m",
        "robot °",
        "drive m",
        "drive °",
        "NEES r",
        "placed",
        "target m",
        "NEES t",
        "cover",
        "GOSPA",
        "switch",
        "false"
    );
    for run in &summary.runs {
        let (r, t) = (&run.robots, &run.targets);
        let _ = writeln!(
            text,
            "{:>5} {:>9} {:>9} {:>9} {:>9} {:>8} {:>8} {:>9} {:>8} {:>8} {:>8} {:>6} {:>6}",
            run.seed,
            number(r.position_rms_m, 4),
            number(r.heading_rms_deg, 3),
            number(r.driving.position_rms_m, 3),
            number(r.driving.heading_rms_deg, 2),
            number(r.nees, 2),
            percent(r.placed),
            number(t.rms_within_5m_m, 3),
            number(t.nees, 2),
            percent(t.coverage),
            number(t.gospa_m, 3),
            t.id_switches,
            t.false_tracks,
        );
    }
    text
}

/// Bytes by robot and message kind beside video.
pub fn bandwidth(rates: &[KindRate], video: &VideoRate, robots: usize, modelled: bool) -> String {
    let wire = if modelled { "wire B/s (modelled)" } else { "wire B/s" };
    let mut text = format!("{:<8} {:<14} {:>9} {:>14} {:>20}\n", "sender", "kind", "messages", "payload B/s", wire);
    let mut row = |sender: &str, kind: &str, messages: u64, payload: f64, wire: f64| {
        let _ = writeln!(text, "{sender:<8} {kind:<14} {messages:>9} {payload:>14.0} {wire:>20.0}");
    };
    for rate in rates {
        row(&rate.robot, &rate.kind, rate.messages, rate.payload_bytes_per_s, rate.wire_bytes_per_s);
    }
    let sum = |part: fn(&KindRate) -> f64| rates.iter().map(part).sum::<f64>();
    let (payload, wire) = (sum(|r| r.payload_bytes_per_s), sum(|r| r.wire_bytes_per_s));
    row("all", "", rates.iter().map(|r| r.messages).sum(), payload, wire);
    let _ = writeln!(
        text,
        "\nvideo of {robots} robots: raw {:.0} B/s ({:.0} times the messages on the wire), JPEG {:.0} B/s ({:.0} times)",
        video.raw_bytes_per_s,
        video.raw_bytes_per_s / wire.max(1.0),
        video.jpeg_bytes_per_s,
        video.jpeg_bytes_per_s / wire.max(1.0),
    );
    text
}

/// What went on beside the figures.
pub fn remarks(outcome: &Outcome) -> String {
    let mut text = String::new();
    let latency = &outcome.capture_to_map_ms;
    let _ = writeln!(
        text,
        "{} maps; from a picture's capture to its map: median {} ms, 99 % within {} ms",
        outcome.maps.len(),
        number(latency.p50, 1),
        number(latency.p99, 1)
    );
    if outcome.late_frames > 0 {
        let _ = writeln!(text, "{} pictures were rendered late or not at all", outcome.late_frames);
    }
    for notice in outcome.notices.iter().take(20) {
        let _ = writeln!(text, "note: {notice}");
    }
    if outcome.notices.len() > 20 {
        let _ = writeln!(text, "and {} more notes", outcome.notices.len() - 20);
    }
    text
}

type Column<'a> = (&'a str, &'a RobotScores, &'a TargetScores, &'a Latency);

fn figures(text: &mut String, columns: &[Column<'_>]) {
    if columns.len() > 1 {
        let _ = write!(text, "{:<44}", "");
        columns.iter().for_each(|c| {
            let _ = write!(text, "{:>16}", c.0);
        });
        text.push('\n');
    }
    let mut row = |name: &str, value: &dyn Fn(&Column<'_>) -> String| {
        let _ = write!(text, "{name:<44}");
        columns.iter().for_each(|c| {
            let _ = write!(text, "{:>16}", value(c));
        });
        text.push('\n');
    };
    row("standing robots: position RMS (m)", &|c| number(c.1.position_rms_m, 4));
    row("standing robots: heading RMS (°)", &|c| number(c.1.heading_rms_deg, 3));
    if columns.iter().any(|c| c.1.driving.position_rms_m.is_some()) {
        row("driving robot: position RMS (m)", &|c| number(c.1.driving.position_rms_m, 3));
        row("driving robot: heading RMS (°)", &|c| number(c.1.driving.heading_rms_deg, 2));
        row("  while it moves: position RMS (m)", &|c| number(c.1.driving.moving_position_rms_m, 3));
        row("  while it moves: heading RMS (°)", &|c| number(c.1.driving.moving_heading_rms_deg, 2));
    }
    row("robots with a pose", &|c| percent(c.1.placed));
    row("robots: NEES (1 is honest; bounds at 1 %)", &|c| nees(c.1.nees, c.1.nees_bounds));
    row("targets: RMS (m)", &|c| number(c.2.rms_m, 3));
    row("  within 5 m of the two nearest robots (m)", &|c| number(c.2.rms_within_5m_m, 3));
    row("targets: coverage", &|c| percent(c.2.coverage));
    row("targets: GOSPA (m)", &|c| number(c.2.gospa_m, 3));
    row("targets: identity switches", &|c| c.2.id_switches.to_string());
    row("targets: false tracks", &|c| c.2.false_tracks.to_string());
    row("targets: NEES (1 is honest; bounds at 1 %)", &|c| nees(c.2.nees, c.2.nees_bounds));
    row("observation to map: median / 99 % (ms)", &|c| format!("{} / {}", number(c.3.p50, 2), number(c.3.p99, 2)));
}

fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or("-".to_owned(), |v| format!("{v:.digits$}"))
}

fn percent(value: Option<f64>) -> String {
    value.map_or("-".to_owned(), |v| format!("{:.1} %", 100.0 * v))
}

fn nees(value: Option<f64>, bounds: Option<[f64; 2]>) -> String {
    let bounds = bounds.map_or(String::new(), |[low, high]| format!(" [{low:.2} {high:.2}]"));
    format!("{}{bounds}", number(value, 2))
}
