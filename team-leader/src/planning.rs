//! Where the robots should stand to see the present targets best (report section VI of the corrected mathematics).
//!
//! The expected error of a layout needs no measurement: the information of what would be measured there is that of the joint
//! solution (`solve::joint`), so the plan is for exactly the estimator that will be used. Minimised is the sum of the variances
//! of all targets (or the largest axis of any) over the places of the robots that may move, one robot after the other: a grid
//! round it, then Nelder and Mead's simplex, until nobody gains. A place counts only if it is in free space, sees every target
//! past the other robots, and every other robot past the targets.

mod input;
pub mod outlook;
mod search;

use nalgebra::Matrix2;
use protocol::marker::Marker;
use serde::Serialize;

pub use input::{PlanInput, PlanProblem, Planned};

use crate::solve::joint;
use crate::solve::layout::{Layout, Nuisance, State, TARGET};
use crate::solve::terms::{Kind, Other, Term};

/// Half of a person's width, metres: nobody sees past nearer than that.
const HALF_WIDTH_M: f64 = 0.25;
/// What one fault costs, m²: more than any error and way.
const FAULT_M2: f64 = 1e9;
/// Robots keep this far from each other beside their radii, metres.
const MARGIN_M: f64 = 0.2;
/// Robots keep this far from targets, metres.
const LEAST_TARGET_M: f64 = 0.5;
/// Rounds over all robots at most.
const MAX_ROUNDS: usize = 6;
/// A round that gains less than this part ends the search.
const LEAST_GAIN: f64 = 1e-5;

/// What to make small.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Criterion {
    /// The sum of all targets' variances.
    #[default]
    Trace,
    /// The largest axis of any target's ellipse.
    LargestAxis,
}

/// A plan.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Plan {
    /// Expected RMS error of the targets where the robots stand, metres; null where it is not determined or not seen.
    pub error_here_m: Option<f64>,
    /// The same at the planned places.
    pub error_there_m: f64,
    /// Where each should stand.
    pub robots: Vec<Goal>,
    /// What is expected of each target there.
    pub targets: Vec<Expected>,
}

/// Where a robot should stand.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Goal {
    /// Which.
    pub id: String,
    /// Metres.
    pub x_m: f64,
    /// Metres.
    pub y_m: f64,
    /// How far that is from where it stands.
    pub travel_m: f64,
}

/// What is expected of a target.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Expected {
    /// Which.
    pub id: String,
    /// Expected covariance of x, y, m².
    pub covariance: [[f64; 2]; 2],
    /// Its root mean square, metres.
    pub rms_m: f64,
}

/// Finds better places. `None` where no place is allowed from which all targets are determined.
pub fn plan(problem: &PlanProblem) -> Option<Plan> {
    let here: Vec<[f64; 2]> = problem.robots.iter().map(|r| [r.pose.x_m, r.pose.y_m]).collect();
    let mut places = here.clone();
    let mut best = cost(problem, &places, &here);
    for _ in 0..MAX_ROUNDS {
        let before = best;
        for robot in (0..places.len()).filter(|r| problem.robots[*r].movable) {
            let around = problem.robots[robot].pose.position();
            let (place, value) = search::minimise(around.into(), problem.reach_m, |place| {
                let mut moved = places.clone();
                moved[robot] = place;
                cost(problem, &moved, &here)
            });
            if value < best {
                (places[robot], best) = (place, value);
            }
        }
        if before - best <= LEAST_GAIN * best {
            break;
        }
    }
    let covariances = expected(problem, &places)?;
    let rms = |c: &[Matrix2<f64>]| (c.iter().map(Matrix2::trace).sum::<f64>() / c.len() as f64).sqrt();
    let visible = |places: &[[f64; 2]]| (0..places.len()).all(|r| faults(problem, places, r) == 0);
    Some(Plan {
        error_here_m: expected(problem, &here).filter(|_| visible(&here)).map(|c| rms(&c)),
        error_there_m: rms(&covariances),
        robots: problem
            .robots
            .iter()
            .zip(&places)
            .map(|(r, [x, y])| Goal {
                id: r.id.clone(),
                x_m: *x,
                y_m: *y,
                travel_m: (x - r.pose.x_m).hypot(y - r.pose.y_m),
            })
            .collect(),
        targets: problem
            .targets
            .iter()
            .zip(covariances)
            .map(|((id, _), c)| Expected {
                id: id.clone(),
                covariance: [[c[(0, 0)], c[(0, 1)]], [c[(1, 0)], c[(1, 1)]]],
                rms_m: c.trace().sqrt(),
            })
            .collect(),
    })
    .filter(|_| best < FAULT_M2)
}

/// What the places cost: variance and travel. Where somebody may not stand or does not see, so much for each fault that fewer are
/// always better: robots move one after the other, and several may be wrong at first.
fn cost(problem: &PlanProblem, places: &[[f64; 2]], here: &[[f64; 2]]) -> f64 {
    let travel: f64 = places.iter().zip(here).map(|(p, h)| (p[0] - h[0]).hypot(p[1] - h[1])).sum();
    let travel = problem.travel_m2_per_m * travel;
    let movable = (0..places.len()).filter(|r| problem.robots[*r].movable);
    let faults: usize = movable.map(|r| faults(problem, places, r)).sum();
    if faults > 0 {
        return FAULT_M2 * faults as f64 + travel;
    }
    let Some(covariances) = expected(problem, places) else { return FAULT_M2 + travel };
    let error = match problem.criterion {
        Criterion::Trace => covariances.iter().map(Matrix2::trace).sum::<f64>(),
        Criterion::LargestAxis => covariances.iter().map(|c| c.symmetric_eigenvalues().max()).fold(0.0, f64::max),
    };
    (error + travel).min(FAULT_M2)
}

/// Covariance of each target if the robots stood at `places`, all seeing each other and all targets; `None` where that
/// determines too little. The first robot's pose is the frame.
pub fn expected(problem: &PlanProblem, places: &[[f64; 2]]) -> Option<Vec<Matrix2<f64>>> {
    let (n, m) = (places.len(), problem.targets.len());
    let held: Vec<bool> = (0..n).map(|r| r == 0).collect();
    let layout = Layout::new(&held, &vec![Nuisance::default(); n], &vec![[true, true, false, false, false]; m]);
    let state = State {
        poses: places.iter().map(|[x, y]| [*x, *y, 0.0, 0.0, 0.0]).collect(),
        points: problem.targets.iter().map(|(_, [x, y])| [*x, *y, 0.0, 0.0, 0.0]).collect::<Vec<[f64; TARGET]>>(),
    };
    let mut terms = Vec::new();
    for observer in 0..n {
        let mut push = |other, kind| {
            let sigma = problem.sigma_rad;
            terms.push(Term { observer, other, kind, measured: 0.0, sigma, since_s: 0.0 });
        };
        for peer in (0..n).filter(|p| *p != observer) {
            let radius_m = problem.robots[peer].radius_m;
            for side in [-1.0, 1.0] {
                push(Other::Robot(peer), Kind::Tangent { radius_m, side });
            }
        }
        for target in 0..m {
            push(Other::Target(target), Kind::Bearing);
        }
    }
    let covariances = joint::normal(&terms, &layout, &state).covariances(&layout).1;
    let found: Vec<Matrix2<f64>> = covariances.iter().map(|c| c.fixed_view::<2, 2>(0, 0).into_owned()).collect();
    found.iter().all(|c| c.trace().is_finite() && c.trace() > 0.0 && c.trace() < 1e4).then_some(found)
}

/// Why a robot may not stand at its place: it is not free or too near to others, and whom it does not see; 0: it may.
fn faults(problem: &PlanProblem, places: &[[f64; 2]], robot: usize) -> usize {
    let me = places[robot];
    let radius = problem.robots[robot].radius_m;
    let range = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
    let others = || (0..places.len()).filter(|o| *o != robot);
    let sees_target = |target: [f64; 2]| {
        range(me, target) >= LEAST_TARGET_M
            && problem.line_is_free(me, target)
            && others().all(|o| !hides(me, target, HALF_WIDTH_M, places[o], problem.robots[o].radius_m))
    };
    let is_near = |o: &usize| range(me, places[*o]) < radius + problem.robots[*o].radius_m + MARGIN_M;
    usize::from(!problem.is_free(me, radius))
        + others().filter(is_near).count()
        + problem.targets.iter().filter(|(_, target)| !sees_target(*target)).count()
        + others().filter(|o| !problem.line_is_free(me, places[*o])).count()
}

/// Whether something round hides a part of what is behind (or stands in it), or is hidden by it.
fn hides(eye: [f64; 2], seen: [f64; 2], half_width_m: f64, other: [f64; 2], radius_m: f64) -> bool {
    let look = |p: [f64; 2]| ((p[1] - eye[1]).atan2(p[0] - eye[0]), (p[0] - eye[0]).hypot(p[1] - eye[1]));
    let ((a, da), (b, db)) = (look(seen), look(other));
    let half = |width: f64, range: f64| (width / range.max(width)).asin();
    protocol::angle::wrap(a - b).abs() < half(radius_m, db) + half(half_width_m, da)
}

/// Radius of a marker that is round, for the plan.
pub(crate) fn radius_of(marker: &Marker) -> f64 {
    match marker {
        Marker::Cylinder { radius_m, .. } | Marker::Bars { radius_m, .. } => *radius_m,
        Marker::Rectangle { width_m, .. } => 0.5 * width_m,
    }
}

#[cfg(test)]
mod tests;
