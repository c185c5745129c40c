//! Replays of others' recordings as tables for people.

use std::fmt::Write;

use crate::recorded::{cmc, mrclam, roh};

/// Of `replay cmc`.
pub fn cmc(r: &cmc::Report) -> String {
    let mut text = format!(
        "{} frames, {} people-instants; a bearing's sigma by its innovations: {:.2}°\n\
         horizontal error {:.3} m median, {:.3} m RMS; IDF1 {:.3}, recall {:.3}, precision {:.3} at 0.5 m; NEES/2 {:.2}\n",
        r.frames, r.truths, r.bearing_sigma_deg, r.median_m, r.rms_m, r.idf1, r.recall, r.precision, r.nees
    );
    for notice in &r.notices {
        let _ = writeln!(text, "{notice}");
    }
    text
}

/// Of `replay mrclam`.
pub fn mrclam(r: &mrclam::Report) -> String {
    let mutual = match r.mutual {
        0 => format!("no two robots saw each other within {} s: no relative pose to score", mrclam::MUTUAL_S),
        n => format!(
            "{n} mutual sightings: {:.3} m and {:.2}° median; NEES/3 {:.2} mean, {:.2} by its median",
            r.mutual_m, r.mutual_deg, r.nees, r.nees_median
        ),
    };
    let mut text = format!(
        "{} robots, {} sightings of each other; left out: {} readings of landmarks, {} of barcodes that nobody wears\n\
         wheels do what they are told {:.0} ms late by the innovations\n\
         {mutual}\n\n\
         {:<8} {:>9} {:>10} {:>17} {:>6}\n",
        r.robots,
        r.sightings,
        r.landmarks,
        r.unknown_barcodes,
        1e3 * r.wheel_lag_s,
        "pair",
        "instants",
        "median m",
        "dead reckoning m",
        "ratio"
    );
    for p in &r.pairs {
        let name = format!("r{} r{}", p.robots[0], p.robots[1]);
        let ratio = p.median_m / p.reckoned_m;
        let _ = writeln!(text, "{name:<8} {:>9} {:>10.3} {:>17.3} {ratio:>6.2}", p.instants, p.median_m, p.reckoned_m);
    }
    for notice in &r.notices {
        let _ = writeln!(text, "{notice}");
    }
    text
}

/// Of `replay roh`.
pub fn roh(r: &roh::Report) -> String {
    let mut text = format!(
        "{:<12} {:>5} {:>26} {:>26} {:>16} {:>16}\n",
        "place m", "sets", "bias mm, mm, °", "scatter mm, mm, °", "solver m, °", "closed form m, °"
    );
    let three = |v: &[f64; 3]| format!("{:>7.1} {:>7.1} {:>6.2}", 1e3 * v[0], 1e3 * v[1], v[2]);
    let two = |e: &roh::Errors| format!("{:.3} {:.2}", e.median_m, e.median_deg);
    for p in &r.places {
        let _ = writeln!(
            text,
            "{:<12} {:>5} {:>26} {:>26} {:>16} {:>16}",
            format!("{}, {}", p.at_m[0], p.at_m[1]),
            p.sets,
            three(&p.bias),
            three(&p.scatter),
            two(&p.solver),
            two(&p.closed_form)
        );
    }
    let _ = writeln!(
        text,
        "all, median: solver {} (failed {}), closed form {} (failed {}); a bearing's sigma by its residuals {:.2}°, NEES/3 {:.2}",
        two(&r.solver),
        r.solver.failed,
        two(&r.closed_form),
        r.closed_form.failed,
        r.sigma_deg,
        r.nees
    );
    text
}
