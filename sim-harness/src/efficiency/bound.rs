//! The Cramér–Rao bound: the inverse of the Fisher information, from central differences of the exact measurements.

use nalgebra::{DMatrix, DVector};

use super::scene::{Measurement, Scene, turn};

/// Step of the differences, m and rad: its error is its square.
const STEP: f64 = 1e-5;

/// The derivatives of `measure` at `x`, a row a number.
pub fn derivatives(x: &[f64], rows: usize, measure: impl Fn(&[f64], usize) -> f64) -> DMatrix<f64> {
    let mut jacobian = DMatrix::zeros(rows, x.len());
    for k in 0..x.len() {
        let (mut after, mut before) = (x.to_vec(), x.to_vec());
        after[k] += STEP;
        before[k] -= STEP;
        for row in 0..rows {
            jacobian[(row, k)] = turn(measure(&after, row) - measure(&before, row)) / (2.0 * STEP);
        }
    }
    jacobian
}

/// The bound of all unknowns of a layout whose measurements have one `sigma`; `None` where they do not determine it.
pub fn bound(scene: &Scene, measurements: &[Measurement], sigma: f64) -> Option<DMatrix<f64>> {
    let jacobian = derivatives(&scene.unknowns(), measurements.len(), |x, k| scene.with(x).exact(&measurements[k]));
    (jacobian.transpose() * jacobian / (sigma * sigma)).cholesky().map(|c| c.inverse())
}

/// The bound of the distance between the first two robots.
pub fn of_baseline(scene: &Scene, bound: &DMatrix<f64>) -> f64 {
    let [x, y, _] = scene.robots[1];
    let mut d = DVector::zeros(bound.nrows());
    (d[0], d[1]) = (x / x.hypot(y), y / x.hypot(y));
    d.dot(&(bound * &d)).sqrt()
}

#[cfg(test)]
mod tests;
