//! Joint maximum likelihood over robots and targets: Levenberg–Marquardt with analytic Jacobians, covariance and
//! observability from the singular values (`MATHS.md` §5.5).

use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt};
use nalgebra::storage::Owned;
use nalgebra::{DMatrix, DVector, Dyn};
use protocol::angle::wrap;

use super::terms::{Other, Term};

/// A singular value of the Jacobian (columns scaled to one) below this part of the largest is zero.
const RANK_TOLERANCE: f64 = 1e-7;

/// Unknowns and knowns of a problem.
#[derive(Debug, Clone)]
pub struct State {
    /// Poses x, y, heading of the robots.
    pub poses: Vec<[f64; 3]>,
    /// x, y, z of the targets.
    pub points: Vec<[f64; 3]>,
}

/// Which numbers of the state are unknown, in the order of the columns.
#[derive(Debug, Clone, Default)]
pub struct Layout {
    /// First column of each robot.
    pub robots: Vec<Option<usize>>,
    /// First column of each target (x, y).
    pub targets: Vec<Option<usize>>,
    /// Column of each target's z.
    pub heights: Vec<Option<usize>>,
    /// Columns.
    pub unknowns: usize,
}

/// A solution.
#[derive(Debug, Clone)]
pub struct Joint {
    /// With the unknowns solved.
    pub state: State,
    /// Of the unknowns; only meaningful with nullity 0.
    pub covariance: DMatrix<f64>,
    /// Sum of squared standardised residuals.
    pub chi2: f64,
    /// Rows minus unknowns.
    pub dof: usize,
    /// Directions that no measurement determines.
    pub nullity: usize,
    /// The weakest direction (unit length; metres and radians).
    pub weakest: DVector<f64>,
    /// Its standard deviation; infinite where it is not determined.
    pub weakest_sigma: f64,
    /// Whether the iteration ended at a minimum.
    pub converged: bool,
}

impl Layout {
    /// All robots but the held ones, all targets but the held ones; z where `with_height`.
    pub fn new(held_robots: &[bool], held_targets: &[bool], with_height: &[bool]) -> Self {
        let mut layout = Self::default();
        for held in held_robots {
            layout.robots.push((!held).then_some(layout.unknowns));
            layout.unknowns += if *held { 0 } else { 3 };
        }
        for (held, height) in held_targets.iter().zip(with_height) {
            layout.targets.push((!held).then_some(layout.unknowns));
            layout.unknowns += if *held { 0 } else { 2 };
            layout.heights.push((*height && !held).then_some(layout.unknowns));
            layout.unknowns += usize::from(*height && !held);
        }
        layout
    }

    fn read(&self, state: &State) -> DVector<f64> {
        let mut x = DVector::zeros(self.unknowns);
        for (column, pose) in self.robots.iter().zip(&state.poses) {
            if let Some(c) = *column {
                x.fixed_rows_mut::<3>(c).copy_from_slice(pose);
            }
        }
        for ((column, height), point) in self.targets.iter().zip(&self.heights).zip(&state.points) {
            if let Some(c) = *column {
                x.fixed_rows_mut::<2>(c).copy_from_slice(&point[..2]);
            }
            if let Some(c) = *height {
                x[c] = point[2];
            }
        }
        x
    }

    fn write(&self, x: &DVector<f64>, state: &mut State) {
        for (column, pose) in self.robots.iter().zip(&mut state.poses) {
            if let Some(c) = *column {
                *pose = [x[c], x[c + 1], wrap(x[c + 2])];
            }
        }
        for ((column, height), point) in self.targets.iter().zip(&self.heights).zip(&mut state.points) {
            if let Some(c) = *column {
                (point[0], point[1]) = (x[c], x[c + 1]);
            }
            if let Some(c) = *height {
                point[2] = x[c];
            }
        }
    }
}

struct Fit<'a> {
    terms: &'a [Term],
    layout: &'a Layout,
    state: State,
}

impl Fit<'_> {
    fn other(&self, term: &Term) -> [f64; 3] {
        match term.other {
            Other::Robot(r) => self.state.poses[r],
            Other::Target(t) => self.state.points[t],
        }
    }
}

impl LeastSquaresProblem<f64, Dyn, Dyn> for Fit<'_> {
    type ResidualStorage = Owned<f64, Dyn>;
    type JacobianStorage = Owned<f64, Dyn, Dyn>;
    type ParameterStorage = Owned<f64, Dyn>;

    fn set_params(&mut self, x: &DVector<f64>) {
        self.layout.write(x, &mut self.state);
    }

    fn params(&self) -> DVector<f64> {
        self.layout.read(&self.state)
    }

    fn residuals(&self) -> Option<DVector<f64>> {
        let values =
            self.terms.iter().map(|t| t.predict(self.state.poses[t.observer], self.other(t)).residual / t.sigma);
        let residuals = DVector::from_iterator(self.terms.len(), values);
        residuals.iter().all(|r| r.is_finite()).then_some(residuals)
    }

    fn jacobian(&self) -> Option<DMatrix<f64>> {
        Some(jacobian(self.terms, self.layout, &self.state))
    }
}

/// Derivatives of the standardised residuals.
pub fn jacobian(terms: &[Term], layout: &Layout, state: &State) -> DMatrix<f64> {
    let mut j = DMatrix::zeros(terms.len(), layout.unknowns);
    for (row, term) in terms.iter().enumerate() {
        let other = match term.other {
            Other::Robot(r) => state.poses[r],
            Other::Target(t) => state.points[t],
        };
        let p = term.predict(state.poses[term.observer], other);
        if let Some(c) = layout.robots[term.observer] {
            for k in 0..3 {
                j[(row, c + k)] += p.observer[k] / term.sigma;
            }
        }
        match term.other {
            Other::Robot(r) => {
                if let Some(c) = layout.robots[r] {
                    for k in 0..3 {
                        j[(row, c + k)] += p.other[k] / term.sigma;
                    }
                }
            }
            Other::Target(t) => {
                if let Some(c) = layout.targets[t] {
                    for k in 0..2 {
                        j[(row, c + k)] += p.other[k] / term.sigma;
                    }
                }
                if let Some(c) = layout.heights[t] {
                    j[(row, c)] += p.other[2] / term.sigma;
                }
            }
        }
    }
    j
}

/// How many directions of the unknowns the Jacobian does not determine.
pub fn nullity(j: &DMatrix<f64>) -> usize {
    decompose(j).0
}

/// Solves from `start`.
pub fn solve(terms: &[Term], layout: &Layout, start: State) -> Joint {
    let fit = Fit { terms, layout, state: start };
    let (fit, report) = if layout.unknowns == 0 || terms.is_empty() {
        (fit, None)
    } else {
        let solver = LevenbergMarquardt::new().with_ftol(1e-14).with_xtol(1e-14).with_gtol(1e-14).with_patience(200);
        let (fit, report) = solver.minimize(fit);
        (fit, Some(report))
    };
    let residuals = fit.residuals();
    let chi2 = residuals.as_ref().map_or(f64::INFINITY, DVector::norm_squared);
    let j = jacobian(terms, layout, &fit.state);
    let (nullity, covariance, weakest, weakest_sigma) = decompose(&j);
    // At the floor of the arithmetic the solver says that it can do no better, which is a minimum.
    let gradient = residuals.as_ref().map_or(f64::INFINITY, |r| {
        let g = j.transpose() * r;
        let scale = j.column_iter().map(|c| c.norm()).fold(1.0, f64::max) * r.norm().max(1.0);
        g.amax() / scale
    });
    let ended = report.is_none_or(|r| r.termination.was_successful()) || gradient < 1e-6;
    Joint {
        state: fit.state,
        covariance,
        chi2,
        dof: terms.len().saturating_sub(layout.unknowns),
        nullity,
        weakest,
        weakest_sigma,
        converged: ended && chi2.is_finite() && gradient < 1e-3,
    }
}

/// Nullity, covariance (pseudo-inverse), weakest direction and its sigma.
fn decompose(j: &DMatrix<f64>) -> (usize, DMatrix<f64>, DVector<f64>, f64) {
    let n = j.ncols();
    if n == 0 {
        return (0, DMatrix::zeros(0, 0), DVector::zeros(0), 0.0);
    }
    let norms: Vec<f64> = j.column_iter().map(|c| if c.norm() > 0.0 { c.norm() } else { 1.0 }).collect();
    let mut scaled = j.clone();
    for (k, mut column) in scaled.column_iter_mut().enumerate() {
        column /= norms[k];
    }
    if scaled.nrows() < n {
        // The decomposition gives as many right vectors as there are rows; the rest is null.
        scaled = scaled.resize_vertically(n, 0.0);
    }
    let svd = scaled.svd(false, true);
    let largest = svd.singular_values.max();
    let Some(v_t) = svd.v_t else { return (n, DMatrix::zeros(n, n), DVector::zeros(n), f64::INFINITY) };
    let mut covariance = DMatrix::zeros(n, n);
    let mut nullity = 0;
    let mut null_direction = None;
    for (k, s) in svd.singular_values.iter().enumerate() {
        let mut v = v_t.row(k).transpose();
        for (c, norm) in norms.iter().enumerate() {
            v[c] /= norm;
        }
        if *s <= RANK_TOLERANCE * largest {
            nullity += 1;
            null_direction = Some(v.normalize());
        } else {
            covariance += &v * v.transpose() / (s * s);
        }
    }
    if let Some(v) = null_direction {
        return (nullity, covariance, v, f64::INFINITY);
    }
    let eigen = covariance.clone().symmetric_eigen();
    let k = eigen.eigenvalues.imax();
    let sigma = eigen.eigenvalues[k].max(0.0).sqrt();
    (0, covariance, eigen.eigenvectors.column(k).into_owned(), sigma)
}

#[cfg(test)]
mod tests;
