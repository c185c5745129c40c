//! Estimates with covariance, solver reports, χ² gates.

use serde::{Deserialize, Serialize};
use statrs::distribution::{ChiSquared, ContinuousCDF};

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
