//! A maximum-likelihood estimator that shares nothing with the solver: Gauss–Newton on numerical derivatives of the exact
//! measurements, from where it is told to begin. What the bound does not tell where it is only a first approximation, this does.
//! With tails the estimator of least square error stands in its place where that is known.

use nalgebra::{DMatrix, DVector, dvector};
use serde::Serialize;

use super::bound::derivatives;
use super::cases::{Noise, TAIL};
use super::scene::{Measurement, Scene, turn};

/// What the solver is compared with where the bound does not serve.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Reference {
    /// [`estimate`]: the likelihood's peak that is reached from the truth or, with tails, the likelier of that and the one that is
    /// reached from the solver's answer.
    LikeliestPeak,
    /// [`LeastSquareError`].
    LeastSquareError,
}

impl Reference {
    /// In words.
    pub fn words(self) -> &'static str {
        match self {
            Self::LikeliestPeak => "the likeliest peak's",
            Self::LeastSquareError => "the least that any estimator makes",
        }
    }
}

const MAX_ITERATIONS: usize = 60;
/// Step at which it ends, m and rad.
const STEP: f64 = 1e-7;
/// Sets that are less likely than the likeliest by this (logarithm) do not count.
const LEAST_LOG: f64 = -14.0;

/// The unknowns at the peak of their likelihood given `measured` that is reached from `start`, and their loss there (less is likelier);
/// errors are `sigma` times what `noise` says, whose density it knows. `None` where the iteration does not end.
pub fn estimate(
    scene: &Scene,
    measurements: &[Measurement],
    measured: &[f64],
    (sigma, noise): (f64, Noise),
    start: Vec<f64>,
) -> Option<(Vec<f64>, f64)> {
    let mut x = start;
    let exact = |x: &[f64], k: usize| scene.with(x).exact(&measurements[k]);
    let residuals = |x: &[f64]| {
        let at = scene.with(x);
        let of = |(m, v): (&Measurement, &f64)| turn(v - at.exact(m)) / sigma;
        DVector::from_iterator(measured.len(), measurements.iter().zip(measured).map(of))
    };
    let cost = |r: &DVector<f64>| r.iter().map(|r| noise.loss(*r).0).sum::<f64>();
    let mut r = residuals(&x);
    for _ in 0..MAX_ITERATIONS {
        let j = derivatives(&x, measured.len(), exact) / sigma;
        let mut weighted = j.clone();
        for (mut row, r) in weighted.row_iter_mut().zip(r.iter()) {
            row *= noise.loss(*r).1;
        }
        let step = (weighted.transpose() * &j).cholesky()?.solve(&(weighted.transpose() * &r));
        let mut scale = 1.0;
        let moved = loop {
            let moved: Vec<f64> = x.iter().zip(step.iter()).map(|(x, s)| x + scale * s).collect();
            let there = residuals(&moved);
            if cost(&there) <= cost(&r) * (1.0 + 1e-12) {
                r = there;
                break moved;
            }
            scale *= 0.5;
            if scale < 1e-6 {
                return Some((x, cost(&r)));
            }
        };
        x = moved;
        if scale * step.amax() < STEP {
            return Some((x, cost(&r)));
        }
    }
    None
}

/// The estimator of least mean square error where errors have tails: the mean over all sets of measurements that may be from the broad
/// part, by their probability (Pitman's estimator for a linear model: no other whose error does not depend on where the truth is has a
/// smaller one). Linear about the truth. It knows the errors' density, and neither knows nor gains from being near the truth, as an
/// estimator does that climbs the nearest of several peaks from there.
pub struct LeastSquareError {
    truth: Vec<f64>,
    sets: Vec<Set>,
}

/// Measurements that may be from the broad part, and what follows.
struct Set {
    /// From errors, in sigmas, to those of the unknowns.
    gain: DMatrix<f64>,
    /// χ² is its quadratic form.
    form: DMatrix<f64>,
    /// ln of the probability but for χ² and a constant.
    log: f64,
}

/// Most measurements for which all sets are looked at, and most that are in one.
const MOST_MEASUREMENTS: usize = 24;
const MOST_WRONG: usize = 3;

impl LeastSquareError {
    /// `None` for too many measurements, or too few.
    pub fn new(scene: &Scene, measurements: &[Measurement], sigma: f64) -> Option<Self> {
        let n = measurements.len();
        if n > MOST_MEASUREMENTS {
            return None;
        }
        let truth = scene.unknowns();
        let j = derivatives(&truth, n, |x, k| scene.with(x).exact(&measurements[k])) / sigma;
        let mut wrongs: Vec<Vec<usize>> = vec![Vec::new()];
        let mut last = 0;
        for _ in 0..MOST_WRONG {
            let larger: Vec<Vec<usize>> = wrongs[last..]
                .iter()
                .flat_map(|set| (set.last().map_or(0, |k| k + 1)..n).map(|k| [set.clone(), vec![k]].concat()))
                .collect();
            last = wrongs.len();
            wrongs.extend(larger);
        }
        let (share, width) = TAIL;
        let set = |wrong: &Vec<usize>| {
            let weights = DVector::from_fn(n, |k, _| if wrong.contains(&k) { width.powi(-2) } else { 1.0 });
            let weighted = DMatrix::from_diagonal(&weights) * &j;
            let information = (j.transpose() * &weighted).cholesky()?;
            let gain = information.solve(&weighted.transpose());
            let form = DMatrix::from_diagonal(&weights) - &weighted * &gain;
            let odds = wrong.len() as f64 * (share / (1.0 - share) / width).ln();
            Some(Set { gain, form, log: odds - 0.5 * information.determinant().ln() })
        };
        Some(Self { truth, sets: wrongs.iter().map(set).collect::<Option<_>>()? })
    }

    /// The unknowns, from the errors of the measurements in sigmas.
    pub fn estimate(&self, errors: &[f64]) -> Vec<f64> {
        let e = DVector::from_column_slice(errors);
        let logs: Vec<f64> = self.sets.iter().map(|s| s.log - 0.5 * e.dot(&(&s.form * &e))).collect();
        let most = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let (mut sum, mut mean) = (0.0, DVector::zeros(self.truth.len()));
        for (set, log) in self.sets.iter().zip(logs).filter(|(_, log)| log - most > LEAST_LOG) {
            let p = (log - most).exp();
            sum += p;
            mean.gemv(p, &set.gain, &e, 1.0);
        }
        self.truth.iter().zip(mean.iter()).map(|(x, m)| x + m / sum).collect()
    }
}

/// Errors of an estimate: baseline, position and heading of each robot, position of each target; squared and summed.
pub fn squared_errors(scene: &Scene, x: &[f64]) -> DVector<f64> {
    let at = scene.with(x);
    let length = |s: &Scene| s.robots[1][0].hypot(s.robots[1][1]);
    let place = |a: &[f64], b: &[f64]| (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2);
    let robots = || at.robots.iter().zip(&scene.robots);
    dvector![
        (length(&at) - length(scene)).powi(2),
        robots().map(|(a, b)| place(a, b)).sum(),
        robots().map(|(a, b)| turn(a[2] - b[2]).powi(2)).sum(),
        at.targets.iter().zip(&scene.targets).map(|(a, b)| place(a, b)).sum()
    ]
}
