//! The outcome as a table for people, and the verdict.

use std::fmt::Write;

use serde::Serialize;

use super::trial::{LINEAR_BELOW, Outcome};

/// The issue's figures over all cases.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Verdict {
    /// Cases whose bound is exact enough to be compared with (σ_B/B at most 0.08).
    pub linear_cases: usize,
    /// The largest RMSE over the bound among them, and of which case.
    pub worst_to_bound: f64,
    /// Which.
    pub worst_case: String,
    /// The median of all RMSE over the bound (four a case).
    pub median_to_bound: f64,
    /// The other cases, compared with the reference.
    pub curved_cases: usize,
    /// Cases compared with the reference: these, and those that miss the bound; with tails all.
    pub referred: usize,
    /// The largest RMSE over the reference's among them, and of which case.
    pub worst_to_reference: f64,
    /// Which.
    pub worst_referred: String,
    /// The median of the largest of each case.
    pub median_to_reference: f64,
    /// Consistency checks (NEES of robots and target, NIS), and those out of their bounds at 1 % over all cases together.
    pub checks: usize,
    /// Which are out.
    pub out_of_bounds: Vec<String>,
    /// Kolmogorov's tests below 1 %, of `checks`: one in a hundred by chance.
    pub p_below_1_percent: usize,
    /// Draws without a solution.
    pub failed: usize,
}

/// Sums up.
pub fn verdict(outcomes: &[Outcome]) -> Verdict {
    let linear: Vec<&Outcome> = outcomes.iter().filter(|o| o.relative_bound <= LINEAR_BELOW).collect();
    let each = |o: &&Outcome| [o.to_bound.baseline, o.to_bound.positions, o.to_bound.headings, o.to_bound.targets];
    let mut ratios: Vec<f64> = linear.iter().flat_map(each).collect();
    ratios.sort_by(f64::total_cmp);
    let worst = linear.iter().max_by(|a, b| a.to_bound.largest().total_cmp(&b.to_bound.largest()));
    let mut referred: Vec<(f64, &String)> =
        outcomes.iter().filter_map(|o| Some((o.to_reference?.largest(), &o.name))).collect();
    referred.sort_by(|a, b| a.0.total_cmp(&b.0));
    let checks = || {
        outcomes.iter().flat_map(|o| {
            let all = [("NEES robots", Some(o.nees_robots)), ("NEES target", Some(o.nees_target)), ("NIS", o.nis)];
            all.into_iter().filter_map(move |(name, check)| Some((o, name, check?)))
        })
    };
    Verdict {
        linear_cases: linear.len(),
        worst_to_bound: worst.map_or(f64::NAN, |o| o.to_bound.largest()),
        worst_case: worst.map_or_else(String::new, |o| o.name.clone()),
        median_to_bound: ratios.get(ratios.len() / 2).copied().unwrap_or(f64::NAN),
        curved_cases: outcomes.len() - linear.len(),
        referred: referred.len(),
        worst_to_reference: referred.last().map_or(f64::NAN, |r| r.0),
        worst_referred: referred.last().map_or_else(String::new, |r| r.1.clone()),
        median_to_reference: referred.get(referred.len() / 2).map_or(f64::NAN, |r| r.0),
        checks: checks().count(),
        out_of_bounds: checks()
            .filter(|(_, _, check)| !check.holds())
            .map(|(o, name, c)| {
                format!(
                    "{}: {name} {:.3} (σ_B/B {:.3}), {:.3} to {:.3}",
                    o.name, c.mean, o.relative_bound, c.bounds[0], c.bounds[1]
                )
            })
            .collect(),
        p_below_1_percent: checks().filter(|(_, _, check)| check.p < 0.01).count(),
        failed: outcomes.iter().map(|o| o.failed).sum(),
    }
}

/// Every case a line, then the verdict.
pub fn text(outcomes: &[Outcome]) -> String {
    let mut text = format!(
        "{:<46} {:>6} {:>6} {:>6} {:>6} {:>6} {:>8} {:>6} {:>6} {:>6} {:>6} {:>6}\n",
        "case", "σ_B/B", "B", "place", "turn", "target", "bias mm", "to ML", "NEES r", "NEES t", "NIS", "failed"
    );
    for o in outcomes {
        let r = o.to_bound;
        let nis = o.nis.map_or_else(|| "-".to_owned(), |n| format!("{:.3}", n.mean));
        let ml = o.to_reference.map_or_else(|| "-".to_owned(), |r| format!("{:.3}", r.largest()));
        let _ = writeln!(
            text,
            "{:<46} {:>6.4} {:>6.3} {:>6.3} {:>6.3} {:>6.3} {:>8.2} {ml:>6} {:>6.3} {:>6.3} {nis:>6} {:>6}",
            o.name,
            o.relative_bound,
            r.baseline,
            r.positions,
            r.headings,
            r.targets,
            1e3 * o.baseline_bias_m,
            o.nees_robots.mean,
            o.nees_target.mean,
            o.failed
        );
    }
    let v = verdict(outcomes);
    let _ = writeln!(
        text,
        "\nB, place, turn, target: RMSE over the Cramér–Rao bound; to ML: over that of an independent\nestimator that knows the errors' density, where σ_B/B > {LINEAR_BELOW} or the bound is missed by 5 %; with tails everywhere"
    );
    let _ = writeln!(
        text,
        "RMSE over the bound, {} cases with σ_B/B ≤ {LINEAR_BELOW}: median {:.4}, worst {:.4} ({})",
        v.linear_cases, v.median_to_bound, v.worst_to_bound, v.worst_case
    );
    let _ = writeln!(
        text,
        "RMSE over the reference, {} cases ({} with σ_B/B > {LINEAR_BELOW}): median {:.4}, worst {:.4} ({})",
        v.referred, v.curved_cases, v.median_to_reference, v.worst_to_reference, v.worst_referred
    );
    let _ = writeln!(
        text,
        "consistency: {} of {} outside bounds at 1 % over all; {} with p < 1 % by Kolmogorov; {} draws without solution",
        v.out_of_bounds.len(),
        v.checks,
        v.p_below_1_percent,
        v.failed
    );
    for line in &v.out_of_bounds {
        let _ = writeln!(text, "  outside: {line}");
    }
    text
}
