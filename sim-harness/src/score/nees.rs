//! Normalised estimation error squared: is a covariance honest?
//!
//! eᵀ P⁻¹ e of an honest estimate follows χ² with as many degrees of freedom as e has entries, so the mean over samples
//! divided by their dimension is 1, and the sum over independent samples is χ² with the sum of the dimensions (Bar-Shalom et
//! al. 2001, §5.4). Samples are taken at least [`SPACING_S`] apart.

use nalgebra::{DMatrix, DVector};
use protocol::estimate::chi2_quantile;
use serde::Serialize;

/// Least time between two samples of one thing, seconds.
pub const SPACING_S: f64 = 2.0;
/// Chance that an honest estimator falls outside the bounds.
pub const LEVEL: f64 = 0.01;
/// Added to a covariance that rounding to `f32` on the wire made indefinite: (10 µm)², (10 µrad)².
const ROUNDING: f64 = 1e-10;

/// Sum of samples and of their dimensions; pools over runs by `+`.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Nees {
    /// Σ eᵀ P⁻¹ e.
    pub sum: f64,
    /// Σ dimension.
    pub dimensions: usize,
}

impl Nees {
    /// Takes a sample in.
    pub fn add(&mut self, sample: f64, dimension: usize) {
        self.sum += sample;
        self.dimensions += dimension;
    }

    /// Mean over the samples divided by their dimension; 1 is honest.
    pub fn mean(&self) -> Option<f64> {
        (self.dimensions > 0).then(|| self.sum / self.dimensions as f64)
    }

    /// Two-sided χ² bounds of the mean at [`LEVEL`].
    pub fn bounds(&self) -> Option<[f64; 2]> {
        let n = self.dimensions;
        (n > 0).then(|| [LEVEL / 2.0, 1.0 - LEVEL / 2.0].map(|p| chi2_quantile(p, n) / n as f64))
    }
}

impl std::ops::AddAssign for Nees {
    fn add_assign(&mut self, other: Self) {
        self.add(other.sum, other.dimensions);
    }
}

/// eᵀ P⁻¹ e; `None` where P is no covariance.
pub fn mahalanobis2(error: &DVector<f64>, covariance: &DMatrix<f64>) -> Option<f64> {
    let n = error.len();
    let solve = |p: DMatrix<f64>| p.cholesky().map(|c| error.dot(&c.solve(error)));
    solve(covariance.clone())
        .or_else(|| solve(covariance + DMatrix::identity(n, n) * ROUNDING))
        .filter(|d| d.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_correlated_pair_is_weighed_by_the_inverse_covariance() {
        // P = [[4, 2], [2, 3]], P⁻¹ = [[3, −2], [−2, 4]] / 8; e = (2, 1): (12 − 8 + 4) / 8 = 1.
        let p = DMatrix::from_row_slice(2, 2, &[4.0, 2.0, 2.0, 3.0]);
        let d = mahalanobis2(&DVector::from_vec(vec![2.0, 1.0]), &p).unwrap();
        assert!((d - 1.0).abs() < 1e-12);
    }

    #[test]
    fn bounds_are_the_chi_square_table_divided_by_the_degrees_of_freedom() {
        // χ² with 10 degrees of freedom: 2.156 and 25.188 (Abramowitz and Stegun, table 26.8).
        let mut nees = Nees::default();
        for _ in 0..5 {
            nees.add(2.0, 2);
        }
        let [low, high] = nees.bounds().unwrap();
        assert!((low - 0.2156).abs() < 1e-4 && (high - 2.5188).abs() < 1e-4, "{low} {high}");
        assert_eq!(nees.mean(), Some(1.0));
    }
}
