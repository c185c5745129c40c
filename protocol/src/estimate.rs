//! Estimates with covariance, solver reports, χ² gates.
//!
//! A number without its covariance is worth nothing to whoever must weigh it, and a solver that gives a number only hides
//! why. So an [`Estimate`] is value and covariance together, and a solve ends in a [`SolverReport`] that tells *how* it
//! ended apart from whether the result may be used.

mod report;

use nalgebra::{SMatrix, SVector};
use serde::{Deserialize, Serialize};
use statrs::distribution::{ChiSquared, ContinuousCDF};

pub use report::{MAX_CONDITION, SolverReport, Termination, Weakest};

/// A value of `N` numbers with its covariance, in the units of the value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate<const N: usize> {
    /// The numbers.
    pub value: SVector<f64, N>,
    /// Symmetric, positive semi-definite.
    pub covariance: SMatrix<f64, N, N>,
}

impl<const N: usize> Estimate<N> {
    /// Value and covariance; the covariance is made symmetric.
    pub fn new(value: SVector<f64, N>, covariance: SMatrix<f64, N, N>) -> Self {
        Self { value, covariance: 0.5 * (covariance + covariance.transpose()) }
    }

    /// The standard deviation of entry `i` (< N).
    pub fn sigma(&self, i: usize) -> f64 {
        self.covariance[(i, i)].max(0.0).sqrt()
    }

    /// The estimate of `value = f(self)`, of which `jacobian` is the derivative at `self`.
    pub fn propagate<const M: usize>(&self, value: SVector<f64, M>, jacobian: &SMatrix<f64, M, N>) -> Estimate<M> {
        Estimate::new(value, jacobian * self.covariance * jacobian.transpose())
    }

    /// Normalised squared distance of `deviation = value − truth` (angles wrapped by the caller): χ² with N degrees of
    /// freedom if the covariance is honest. `None` where the covariance is singular.
    pub fn normalised_square(&self, deviation: &SVector<f64, N>) -> Option<f64> {
        let factor = self.covariance.cholesky()?;
        Some(deviation.dot(&factor.solve(deviation)))
    }

    /// Whether all numbers are finite and no variance is negative.
    pub fn is_sound(&self) -> bool {
        let finite = self.value.iter().chain(self.covariance.iter()).all(|number| number.is_finite());
        finite && (0..N).all(|i| self.covariance[(i, i)] >= 0.0)
    }
}

/// What became of a solve. Failing to converge can never look like success.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SolveStatus {
    /// A minimum that fits.
    Converged,
    /// Iterations ran out.
    NotConverged,
    /// Some direction is not determined although there are enough measurements.
    Degenerate,
    /// Several solutions fit equally.
    Ambiguous,
    /// A minimum that does not fit its sigmas.
    Inconsistent,
    /// Too few measurements.
    Insufficient,
}

/// The quantile `p` of χ² with `dof` degrees of freedom; 0 for dof 0.
pub fn chi2_quantile(p: f64, dof: usize) -> f64 {
    if dof == 0 {
        return 0.0;
    }
    ChiSquared::new(dof as f64).map_or(f64::NAN, |d| d.inverse_cdf(p))
}

/// Whether `chi2` with `dof` degrees of freedom is below the quantile `p`. NaN is not.
pub fn within_gate(chi2: f64, dof: usize, p: f64) -> bool {
    chi2 <= chi2_quantile(p, dof)
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix2, Vector2};

    use super::*;

    #[test]
    fn quantiles_are_those_of_the_tables() {
        // Abramowitz and Stegun, table 26.8.
        for (p, dof, table) in [(0.95, 1, 3.84146), (0.99, 2, 9.21034), (0.99, 4, 13.2767), (0.999, 10, 29.5883)] {
            assert!((chi2_quantile(p, dof) - table).abs() < 1e-4, "{p} {dof}");
        }
        assert_eq!(chi2_quantile(0.99, 0), 0.0);
        assert!(within_gate(13.0, 4, 0.99) && !within_gate(13.5, 4, 0.99) && !within_gate(f64::NAN, 4, 0.99));
    }

    #[test]
    fn a_rotated_estimate_keeps_its_normalised_distance() {
        let estimate = Estimate::new(Vector2::new(1.0, 2.0), Matrix2::new(0.04, 0.01, 0.01, 0.09));
        let (s, c) = 0.7f64.sin_cos();
        let turn = Matrix2::new(c, -s, s, c);
        let turned = estimate.propagate(turn * estimate.value, &turn);
        let deviation = Vector2::new(0.1, -0.2);
        let before = estimate.normalised_square(&deviation).unwrap();
        // By hand: C⁻¹ = [9 −1; −1 4]/0.35 for C = [0.04 0.01; 0.01 0.09].
        assert!((before - (9.0 * 0.01 + 2.0 * 0.02 + 4.0 * 0.04) / 0.35).abs() < 1e-12);
        assert!((turned.normalised_square(&(turn * deviation)).unwrap() - before).abs() < 1e-12);
        assert!((estimate.sigma(1) - 0.3).abs() < 1e-15);
    }

    #[test]
    fn an_unsound_estimate_is_known() {
        let good = Estimate::new(Vector2::new(1.0, 2.0), Matrix2::identity());
        assert!(good.is_sound());
        assert!(!Estimate { value: Vector2::new(f64::NAN, 0.0), ..good }.is_sound());
        assert!(!Estimate { covariance: -good.covariance, ..good }.is_sound());
        assert_eq!(Estimate { covariance: Matrix2::zeros(), ..good }.normalised_square(&good.value), None);
    }
}
