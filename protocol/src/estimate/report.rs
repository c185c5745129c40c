//! How a least-squares solve ended.

use nalgebra::{DMatrix, DVector};

use super::{SolveStatus, chi2_quantile};

/// Largest ratio of the information's eigenvalues (unknowns scaled to unit information) at which the weakest direction
/// still counts as determined. Beyond, rounding alone could have made it.
pub const MAX_CONDITION: f64 = 1e12;

/// Why the iteration ended, with the value that decided and the threshold.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Termination {
    /// The cost changed by less, relatively.
    CostChange {
        /// Last relative change.
        value: f64,
        /// Below which it ends.
        threshold: f64,
    },
    /// The step was shorter.
    Step {
        /// Last step.
        value: f64,
        /// Below which it ends.
        threshold: f64,
    },
    /// The gradient was smaller.
    Gradient {
        /// Last gradient.
        value: f64,
        /// Below which it ends.
        threshold: f64,
    },
    /// Iterations ran out: not converged.
    IterationLimit {
        /// How many were allowed.
        limit: usize,
    },
    /// A number stopped being finite: not converged.
    NotFinite,
}

impl Termination {
    /// Whether it is the end of a search and not its failure.
    pub fn is_converged(&self) -> bool {
        matches!(self, Self::CostChange { .. } | Self::Step { .. } | Self::Gradient { .. })
    }
}

/// The direction in which the result is determined worst.
#[derive(Debug, Clone, PartialEq)]
pub struct Weakest {
    /// Unit vector in the unknowns.
    pub direction: DVector<f64>,
    /// Standard deviation along it; infinite where it is not determined at all.
    pub sigma: f64,
}

/// Everything a solver has to say.
#[derive(Debug, Clone, PartialEq)]
pub struct SolverReport {
    /// The unknowns.
    pub estimate: DVector<f64>,
    /// Their covariance, the inverse of the information; `None` where some direction is not determined.
    pub covariance: Option<DMatrix<f64>>,
    /// Sum of squared standardised residuals.
    pub chi2: f64,
    /// Measurements minus unknowns.
    pub dof: usize,
    /// How many were made.
    pub iterations: usize,
    /// Why it ended.
    pub termination: Termination,
    /// Where it is weakest.
    pub weakest: Option<Weakest>,
}

impl SolverReport {
    /// From the solution, the information matrix JᵀWJ there, and χ² of `measurements` numbers.
    pub fn new(
        estimate: DVector<f64>,
        information: &DMatrix<f64>,
        chi2: f64,
        measurements: usize,
        iterations: usize,
        termination: Termination,
    ) -> Self {
        let dof = measurements.saturating_sub(estimate.len());
        let (covariance, weakest) = invert(information);
        Self { estimate, covariance, chi2, dof, iterations, termination, weakest }
    }

    /// What became of it; `p` is the quantile of χ² above which the measurements contradict each other (0.999, say).
    pub fn status(&self, p: f64) -> SolveStatus {
        let finite = self.chi2.is_finite() && self.estimate.iter().all(|number| number.is_finite());
        if !self.termination.is_converged() || !finite {
            SolveStatus::NotConverged
        } else if self.covariance.is_none() {
            SolveStatus::Degenerate
        } else if self.dof > 0 && self.chi2 > chi2_quantile(p, self.dof) {
            SolveStatus::Inconsistent
        } else {
            SolveStatus::Converged
        }
    }

    /// Whether the estimate may be used: converged, determined, and not in contradiction at 99.9 %.
    pub fn is_usable(&self) -> bool {
        self.status(0.999) == SolveStatus::Converged
    }
}

/// Inverse and weakest direction. Unknowns have different units, so the test for rank is made with each scaled to unit
/// information; the weakest direction is given in the unknowns' own units.
fn invert(information: &DMatrix<f64>) -> (Option<DMatrix<f64>>, Option<Weakest>) {
    let n = information.nrows();
    if n == 0 || !information.is_square() || !information.iter().all(|number| number.is_finite()) {
        return (None, None);
    }
    let scale = DVector::from_fn(n, |i, _| information[(i, i)].max(f64::MIN_POSITIVE).sqrt());
    let unit = DMatrix::from_fn(n, n, |i, j| information[(i, j)] / (scale[i] * scale[j]));
    let eigen = unit.symmetric_eigen();
    let least = eigen.eigenvalues.imin();
    let (smallest, largest) = (eigen.eigenvalues[least], eigen.eigenvalues.max());
    if smallest * MAX_CONDITION <= largest {
        let direction = eigen.eigenvectors.column(least).component_div(&scale);
        return (None, Some(Weakest { direction: direction.normalize(), sigma: f64::INFINITY }));
    }
    let mut root = eigen.eigenvectors.clone();
    for (mut column, eigenvalue) in root.column_iter_mut().zip(eigen.eigenvalues.iter()) {
        column /= eigenvalue.sqrt();
    }
    let covariance = DMatrix::from_fn(n, n, |i, j| root.row(i).dot(&root.row(j)) / (scale[i] * scale[j]));
    let spread = covariance.clone().symmetric_eigen();
    let widest = spread.eigenvalues.imax();
    let weakest = Weakest {
        direction: spread.eigenvectors.column(widest).into_owned(),
        sigma: spread.eigenvalues[widest].max(0.0).sqrt(),
    };
    (Some(covariance), Some(weakest))
}

#[cfg(test)]
mod tests {
    use nalgebra::{dmatrix, dvector};

    use super::*;

    const DONE: Termination = Termination::Step { value: 1e-10, threshold: 1e-9 };

    #[test]
    fn the_covariance_is_the_inverse_and_the_weakest_direction_its_longest_axis() {
        let information = dmatrix![4.0, 0.0; 0.0, 0.25];
        let report = SolverReport::new(dvector![1.0, 2.0], &information, 3.0, 5, 4, DONE);
        assert!((report.covariance.as_ref().unwrap() - dmatrix![0.25, 0.0; 0.0, 4.0]).amax() < 1e-14);
        let weakest = report.weakest.as_ref().unwrap();
        assert!((weakest.sigma - 2.0).abs() < 1e-14 && weakest.direction[1].abs() > 0.999);
        assert_eq!((report.dof, report.is_usable()), (3, true));
    }

    #[test]
    fn units_do_not_make_a_direction_undetermined() {
        // One unknown in metres to 1 cm, one to a nanoradian, correlated.
        let information = dmatrix![1e4, 0.5e11; 0.5e11, 1e18];
        let report = SolverReport::new(dvector![0.0, 0.0], &information, 0.0, 2, 1, DONE);
        let identity = report.covariance.clone().unwrap() * information;
        assert!((identity[(0, 0)] - 1.0).abs() < 1e-9 && (identity[(1, 1)] - 1.0).abs() < 1e-9);
    }

    #[test]
    fn an_undetermined_direction_is_named_and_the_result_not_usable() {
        let report = SolverReport::new(dvector![0.0, 0.0], &dmatrix![1.0, 1.0; 1.0, 1.0], 0.0, 4, 4, DONE);
        assert_eq!(report.status(0.999), SolveStatus::Degenerate);
        let weakest = report.weakest.as_ref().unwrap();
        assert!(weakest.sigma.is_infinite() && (weakest.direction[0] + weakest.direction[1]).abs() < 1e-9);
        assert!(!report.is_usable());
    }

    #[test]
    fn failing_to_converge_never_looks_like_success() {
        let solved = |chi2, termination| SolverReport::new(dvector![0.0], &dmatrix![1.0], chi2, 3, 50, termination);
        assert_eq!(solved(1.0, Termination::IterationLimit { limit: 50 }).status(0.999), SolveStatus::NotConverged);
        assert_eq!(solved(f64::NAN, DONE).status(0.999), SolveStatus::NotConverged);
        assert_eq!(solved(100.0, DONE).status(0.999), SolveStatus::Inconsistent);
        assert!(solved(1.0, DONE).is_usable());
    }
}
