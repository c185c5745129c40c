//! Small least-squares problems given by a residual function alone: derivatives by differences, iterations by the library.

use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt};
use nalgebra::storage::Owned;
use nalgebra::{DMatrix, DVector, Dyn};

/// Residual that stands for one that does not exist: a step there is never an improvement.
const NO_RESIDUAL: f64 = 1e6;

/// A minimum.
#[derive(Debug, Clone)]
pub(super) struct Minimum {
    /// Where.
    pub(super) x: DVector<f64>,
    /// Residuals there.
    pub(super) residuals: DVector<f64>,
    /// Derivatives of the residuals there.
    pub(super) jacobian: DMatrix<f64>,
}

/// Minimises Σ rᵢ(x)², `steps` being changes of x small against its curvature. `None` where the start has no residuals.
pub(super) fn minimise(
    start: DVector<f64>,
    steps: &[f64],
    residuals: impl Fn(&DVector<f64>) -> Option<DVector<f64>>,
) -> Option<Minimum> {
    let count = residuals(&start)?.len();
    let problem = Problem { x: start, steps, count, residuals };
    let solver = LevenbergMarquardt::new().with_ftol(1e-13).with_xtol(1e-11).with_gtol(1e-13).with_patience(60);
    let (problem, _) = solver.minimize(problem);
    let residuals = (problem.residuals)(&problem.x)?;
    let jacobian = problem.differences();
    Some(Minimum { x: problem.x, residuals, jacobian })
}

struct Problem<'a, F> {
    x: DVector<f64>,
    steps: &'a [f64],
    count: usize,
    residuals: F,
}

impl<F: Fn(&DVector<f64>) -> Option<DVector<f64>>> Problem<'_, F> {
    fn differences(&self) -> DMatrix<f64> {
        let mut jacobian = DMatrix::zeros(self.count, self.x.len());
        for (k, step) in self.steps.iter().enumerate() {
            let moved = |by: f64| {
                let mut x = self.x.clone();
                x[k] += by;
                (self.residuals)(&x)
            };
            if let (Some(up), Some(down)) = (moved(*step), moved(-step)) {
                jacobian.set_column(k, &((up - down) / (2.0 * step)));
            }
        }
        jacobian
    }
}

impl<F: Fn(&DVector<f64>) -> Option<DVector<f64>>> LeastSquaresProblem<f64, Dyn, Dyn> for Problem<'_, F> {
    type ParameterStorage = Owned<f64, Dyn>;
    type ResidualStorage = Owned<f64, Dyn>;
    type JacobianStorage = Owned<f64, Dyn, Dyn>;

    fn set_params(&mut self, x: &DVector<f64>) {
        self.x.copy_from(x);
    }

    fn params(&self) -> DVector<f64> {
        self.x.clone()
    }

    fn residuals(&self) -> Option<DVector<f64>> {
        Some((self.residuals)(&self.x).unwrap_or_else(|| DVector::from_element(self.count, NO_RESIDUAL)))
    }

    fn jacobian(&self) -> Option<DMatrix<f64>> {
        Some(self.differences())
    }
}
