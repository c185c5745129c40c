//! A maximum-likelihood estimator that shares nothing with the solver: Gauss–Newton on numerical derivatives of the exact
//! measurements, from where it is told to begin. What the bound does not tell where it is only a first approximation, this does.

use nalgebra::{DVector, dvector};

use super::bound::derivatives;
use super::cases::Noise;
use super::scene::{Measurement, Scene, turn};

const MAX_ITERATIONS: usize = 60;
/// Step at which it ends, m and rad.
const STEP: f64 = 1e-7;

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
