//! The outcome as a table for people, and the verdict.

use std::fmt::Write;

use serde::Serialize;

use super::reference::Reference;
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
    /// How the cases that were compared with a reference came off, by reference: the curved ones, and those that miss the bound; with
    /// tails all.
    pub referred: Vec<Referred>,
    /// Consistency checks (NEES of robots and target, NIS), and those out of their bounds at 1 % over all cases together.
    pub checks: usize,
    /// Which are out.
    pub out_of_bounds: Vec<String>,
    /// Kolmogorov's tests below 1 %, of `checks`: one in a hundred by chance.
    pub p_below_1_percent: usize,
    /// Draws without a solution.
    pub failed: usize,
}

/// Cases beside one reference.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Referred {
    /// Which.
    pub reference: Reference,
    /// How many cases.
    pub cases: usize,
    /// Those whose RMSE is at most 10 % more than the reference's, in all four quantities.
    pub within_10_percent: usize,
    /// The median of the largest of each case.
    pub median: f64,
    /// The largest, and of which case.
    pub worst: f64,
    /// Which.
    pub worst_case: String,
}

fn referred(outcomes: &[Outcome], reference: Reference) -> Option<Referred> {
    let beside = outcomes.iter().filter(|o| o.reference == reference);
    let mut all: Vec<(f64, &String)> = beside.filter_map(|o| Some((o.to_reference?.largest(), &o.name))).collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (worst, worst_case) = all.last()?;
    Some(Referred {
        reference,
        cases: all.len(),
        within_10_percent: all.iter().filter(|(ratio, _)| *ratio <= 1.1).count(),
        median: all[all.len() / 2].0,
        worst: *worst,
        worst_case: (*worst_case).clone(),
    })
}

/// Sums up.
pub fn verdict(outcomes: &[Outcome]) -> Verdict {
    let linear: Vec<&Outcome> = outcomes.iter().filter(|o| o.relative_bound <= LINEAR_BELOW).collect();
    let each = |o: &&Outcome| [o.to_bound.baseline, o.to_bound.positions, o.to_bound.headings, o.to_bound.targets];
    let mut ratios: Vec<f64> = linear.iter().flat_map(each).collect();
    ratios.sort_by(f64::total_cmp);
    let worst = linear.iter().max_by(|a, b| a.to_bound.largest().total_cmp(&b.to_bound.largest()));
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
        referred: [Reference::LikeliestPeak, Reference::LeastSquareError]
            .into_iter()
            .filter_map(|reference| referred(outcomes, reference))
            .collect(),
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
        "case", "σ_B/B", "B", "place", "turn", "target", "bias mm", "to ref", "NEES r", "NEES t", "NIS", "failed"
    );
    for o in outcomes {
        let r = o.to_bound;
        let nis = o.nis.map_or_else(|| "-".to_owned(), |n| format!("{:.3}", n.mean));
        let beside = o.to_reference.map_or_else(|| "-".to_owned(), |r| format!("{:.3}", r.largest()));
        let _ = writeln!(
            text,
            "{:<46} {:>6.4} {:>6.3} {:>6.3} {:>6.3} {:>6.3} {:>8.2} {beside:>6} {:>6.3} {:>6.3} {nis:>6} {:>6}",
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
        "\nB, place, turn, target: RMSE over the Cramér–Rao bound; to ref: over that of an independent estimator that\n\
         knows the errors' density, where σ_B/B > {LINEAR_BELOW} or the bound is missed by 5 %; with tails everywhere"
    );
    let _ = writeln!(
        text,
        "RMSE over the bound, {} cases with σ_B/B ≤ {LINEAR_BELOW}: median {:.4}, worst {:.4} ({})",
        v.linear_cases, v.median_to_bound, v.worst_to_bound, v.worst_case
    );
    for r in &v.referred {
        let _ = writeln!(
            text,
            "RMSE over {}, {} cases: median {:.4}, within 10 % {}, worst {:.4} ({})",
            r.reference.words(),
            r.cases,
            r.median,
            r.within_10_percent,
            r.worst,
            r.worst_case
        );
    }
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
