//! Where a target's error comes from (report 5.4, the (5-14) of the errata, for any number of robots).
//!
//! At the minimum the estimate is linear in the measurements: a measurement that is off by one sigma moves the target by
//! g = C jᵀ w (C the covariance, j the standardised derivatives, w the weight). So Σ g gᵀ is the target's covariance, and each
//! measurement's part of it is its own g gᵀ; g over sigma is the sensitivity. Where measurements contradict each other the stated
//! covariance is larger: some are not believed, and which ones is in doubt.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::Stage;
use super::input::Problem;
use super::joint;
use super::layout::Layout;
use super::matching::{self, Doubt};
use super::observability::dense;
use super::terms::{Kind, Other, Term};

/// With more unknowns the whole covariance would be too large.
const MAX_UNKNOWNS: usize = 1500;
/// A pixel of a panorama of 1080 columns, degrees.
const PIXEL_DEG: f64 = 360.0 / 1080.0;

/// A target's error explained.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Explained {
    /// Which target.
    pub target: String,
    /// When, where it moves.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time_s: Option<f64>,
    /// Root mean square error along the floor if every measurement errs by its stated sigma, and if bearings without a name may be
    /// paired wrongly, metres.
    pub rms_m: f64,
    /// The Cramér–Rao bound of it: the same with no measurement set aside and no doubt about the pairing, metres.
    pub bound_m: f64,
    /// Parts, largest first. Their squares sum to that of `rms_m`.
    pub parts: Vec<Contribution>,
}

/// A source of error.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Contribution {
    /// What: the matching of bearings without a name, the baseline between two robots (its length and direction), the way of a robot
    /// between two places, a bearing, a clock, a bias, a contradiction (measurements of which some must be wrong, and which ones is
    /// not certain).
    pub source: String,
    /// Root mean square, metres.
    pub rms_m: f64,
    /// Part of the variance, 0 … 1.
    pub share: f64,
    /// That bearings without a name were paired wrongly, 0 … 1, where that is the source.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub probability: Option<f64>,
    /// By how much the target moves if all its angles are off by a degree in the worst way, metres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub m_per_deg: Option<f64>,
    /// The same for a pixel on 1080 columns.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub m_per_px: Option<f64>,
    /// By how much the target moves for each metre of distances between robots.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub m_per_m: Option<f64>,
    /// By how much it moves for each millisecond that the stamps are late.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub m_per_ms: Option<f64>,
}

/// Sums over the measurements of a source.
#[derive(Debug, Clone, Default)]
struct Source {
    name: String,
    variance: f64,
    probability: Option<f64>,
    per_rad: f64,
    per_m: f64,
    per_s: Option<[f64; 2]>,
}

impl Stage {
    /// All located targets explained; empty where the solution is not determined or too large.
    pub(super) fn explain(&self, problem: &Problem) -> Vec<Explained> {
        let layout = &self.layout;
        if !self.joint.weakest.undetermined.is_empty() || layout.unknowns == 0 || layout.unknowns > MAX_UNKNOWNS {
            return Vec::new();
        }
        let state = &self.joint.state;
        let rows: Vec<DVector<f64>> = self.terms.iter().map(|t| t.row(state).unknowns(t, layout)).collect();
        let mut weighted = DMatrix::zeros(layout.unknowns, layout.unknowns);
        for ((term, row), w) in self.terms.iter().zip(&rows).zip(&self.joint.weights) {
            accumulate(&mut weighted, term, row, layout, *w);
        }
        for &(column, _, _, sigma) in &layout.priors {
            weighted[(column, column)] += sigma.powi(-2);
        }
        let bound = dense(&joint::normal(&self.terms, layout, state), layout).cholesky().map(|c| c.inverse());
        let (Some(cov), Some(bound)) = (weighted.cholesky().map(|c| c.inverse()), bound) else { return Vec::new() };
        let poses: Vec<[f64; 3]> = state.poses.iter().map(|p| [p[0], p[1], p[2]]).collect();
        let sigmas: Vec<(f64, f64)> = (0..poses.len()).map(|r| self.sigma(r)).collect();
        let doubts = matching::doubts(problem, matching::Known { poses: &poses, sigmas: &sigmas });
        let located = (0..problem.targets.len()).filter(|t| self.located[*t]);
        located
            .filter_map(|t| {
                let (x, y) = (layout.targets[t][0]?, layout.targets[t][1]?);
                let place = cov.select_rows(&[x, y]);
                let stated = self.target_covariance(t);
                let parts = self.parts(problem, &place, stated[(0, 0)] + stated[(1, 1)], &rows, doubts[t]);
                let variance = |c: &DMatrix<f64>| c[(x, x)] + c[(y, y)];
                Some(Explained {
                    target: problem.targets[t].clone(),
                    time_s: problem.times[t],
                    rms_m: parts.iter().map(|p| p.rms_m * p.rms_m).sum::<f64>().sqrt(),
                    bound_m: variance(&bound).sqrt(),
                    parts,
                })
            })
            .collect()
    }

    /// Every source of a target's error, whose rows of the covariance are `place`, and whose stated variance is `stated_m2`.
    fn parts(
        &self,
        problem: &Problem,
        place: &DMatrix<f64>,
        stated_m2: f64,
        rows: &[DVector<f64>],
        doubt: Option<Doubt>,
    ) -> Vec<Contribution> {
        let mut sources: Vec<Source> = Vec::new();
        for ((term, row), weight) in self.terms.iter().zip(rows).zip(&self.joint.weights) {
            let g = place * row * *weight;
            let source = source(&mut sources, name(term, problem));
            source.variance += g.norm_squared();
            match term.kind {
                Kind::Way { .. } => {}
                Kind::Range => source.per_m += g.norm() / term.sigma,
                _ => source.per_rad += g.norm() / term.sigma,
            }
            if let Other::Target(t) = term.other {
                let [.., vx, vy] = self.joint.state.points[t];
                if vx != 0.0 || vy != 0.0 {
                    // A stamp that is late by a second changes the standardised bearing by this.
                    let late = term.row(&self.joint.state).observer[4];
                    let sum = source.per_s.get_or_insert([0.0; 2]);
                    (sum[0], sum[1]) = (sum[0] + g[0] * late, sum[1] + g[1] * late);
                }
            }
        }
        for &(column, robot, k, sigma) in &self.layout.priors {
            let what = if k == 3 { "bearing bias" } else { "clock" };
            let part = source(&mut sources, format!("{what} of {} (as known before)", problem.robots[robot].id));
            part.variance += place.column(column).norm_squared() * sigma.powi(-2);
        }
        if self.joint.tailed {
            // What the stated covariance has beyond errors of the stated sigmas.
            let beyond = stated_m2 - sources.iter().map(|s| s.variance).sum::<f64>();
            source(&mut sources, "contradiction".to_owned()).variance += beyond.max(0.0);
        }
        if let Some(doubt) = doubt {
            let part = source(&mut sources, "matching".to_owned());
            part.variance += doubt.square_m2;
            part.probability = Some(doubt.probability);
        }
        let total: f64 = sources.iter().map(|s| s.variance).sum();
        let some = |v: f64| (v > 0.0).then_some(v);
        let degree = 1f64.to_radians();
        let mut parts: Vec<Contribution> = sources
            .into_iter()
            .map(|s| Contribution {
                source: s.name,
                rms_m: s.variance.sqrt(),
                share: s.variance / total,
                probability: s.probability,
                m_per_deg: some(s.per_rad * degree),
                m_per_px: some(s.per_rad * degree * PIXEL_DEG),
                m_per_m: some(s.per_m),
                m_per_ms: s.per_s.map(|[x, y]| 1e-3 * x.hypot(y)),
            })
            .collect();
        parts.sort_by(|a, b| b.rms_m.total_cmp(&a.rms_m));
        parts
    }
}

fn source(sources: &mut Vec<Source>, name: String) -> &mut Source {
    let at = sources.iter().position(|s| s.name == name).unwrap_or_else(|| {
        sources.push(Source { name, ..Source::default() });
        sources.len() - 1
    });
    &mut sources[at]
}

fn name(term: &Term, problem: &Problem) -> String {
    let me = &problem.robots[term.observer].id;
    match term.other {
        Other::Robot(r) if matches!(term.kind, Kind::Way { .. }) => format!("way {me} {}", problem.robots[r].id),
        Other::Robot(r) => {
            let (a, b) = (term.observer.min(r), term.observer.max(r));
            format!("baseline {} {}", problem.robots[a].id, problem.robots[b].id)
        }
        Other::Target(t) if matches!(term.kind, Kind::Elevation { .. }) => {
            format!("elevations of {} by {me}", problem.targets[t])
        }
        Other::Target(t) => format!("bearings of {} by {me}", problem.targets[t]),
    }
}

/// Adds w j jᵀ, of which only the observer's and the other's entries are not zero.
fn accumulate(information: &mut DMatrix<f64>, term: &Term, row: &DVector<f64>, layout: &Layout, weight: f64) {
    let other = match term.other {
        Other::Robot(r) => layout.robots[r],
        Other::Target(t) => layout.targets[t],
    };
    let columns: Vec<usize> = layout.robots[term.observer].into_iter().chain(other).flatten().collect();
    for &r in &columns {
        for &c in &columns {
            information[(r, c)] += weight * row[r] * row[c];
        }
    }
}

#[cfg(test)]
mod tests;
