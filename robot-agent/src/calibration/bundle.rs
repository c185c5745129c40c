//! The full model from points seen in views of unknown poses: bundle adjustment.
//!
//! Problem: a camera of about ten numbers and six more for each view, from a thousand points. Insight: for given camera
//! numbers each view's best pose is a small problem of its own, so the poses are eliminated view by view (variable
//! projection) and the outer problem has the camera's numbers only. With r the residuals at the best poses, J_c and J_p the
//! derivatives by camera and pose, and P the projector onto the complement of J_p's columns, the outer Jacobian is P·J_c:
//! its gradient is exact, and Σ (P·J_c)ᵀ(P·J_c) is the camera's information with the poses' uncertainty already taken off.
//!
//! Residuals beyond [`OUTLIER_SIGMAS`] of their robust scale count less the larger they are; nothing within is touched,
//! so that χ² keeps its meaning.
//!
//! Source: Golub & Pereyra 1973, Kaufman 1975.

mod covariance;
mod pose;
mod start;

pub(crate) use covariance::unit;
pub use covariance::{CameraCovariance, CovarianceSource, WeakDirection};
pub use pose::ViewPose;
pub(crate) use pose::fit_pose;
pub use start::StartError;

use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt, TerminationReason};
use nalgebra::storage::Owned;
use nalgebra::{DMatrix, DVector, Dyn, Vector2};

use super::free_camera::FreeCamera;
use super::observation::Observations;

/// Residuals (lengths of two components) beyond this many sigmas count less; of Gaussian ones 0.03 % do.
pub const OUTLIER_SIGMAS: f64 = 4.0;
/// Rounds of reweighting at most.
const MAX_ROUNDS: usize = 12;
/// Residual of a point that the camera cannot see, px: a step that loses points is never an improvement.
pub(crate) const LOST_PX: f64 = 1e3;
/// Share of points that may be outliers before a fit is refused.
const MAX_OUTLIERS: f64 = 0.25;

/// Why there is no fit.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BundleError {
    /// No start could be found.
    #[error(transparent)]
    Start(#[from] StartError),
    /// Fewer numbers than unknowns.
    #[error(
        "{measurements} measured numbers cannot determine {unknowns} unknowns ({camera} of the camera, 6 a view): take more \
         views, or a simpler model"
    )]
    TooFew {
        /// Two a point.
        measurements: usize,
        /// All.
        unknowns: usize,
        /// The camera's.
        camera: usize,
    },
    /// The iteration did not settle.
    #[error("{model}: the fit did not converge ({reason}; rms {rms_px:.2} px): another model, or wrong points?")]
    NotConverged {
        /// The camera's model.
        model: String,
        /// What ended it.
        reason: String,
        /// Where it stood, px.
        rms_px: f64,
    },
    /// Too many points contradict the rest.
    #[error(
        "{model}: {outliers} of {points} points contradict the others (wrong corner order, or views of different boards?); \
             worst is view {worst_view:?} with rms {worst_px:.1} px"
    )]
    Contradictory {
        /// The camera's model.
        model: String,
        /// Points beyond the limit.
        outliers: usize,
        /// All points.
        points: usize,
        /// View with the largest residuals.
        worst_view: String,
        /// Its rms, px.
        worst_px: f64,
    },
}

/// A fitted camera.
#[derive(Debug, Clone)]
pub struct Fit {
    /// The camera and which of its numbers were turned.
    pub camera: FreeCamera,
    /// The object in the camera's frame, view by view.
    pub poses: Vec<ViewPose>,
    /// Projected minus measured, px, view by view, as the points stand.
    pub residuals_px: Vec<Vec<Vector2<f64>>>,
    /// Weights in [0, 1].
    pub weights: Vec<Vec<f64>>,
    /// Robust rms of one component, px: the noise that the residuals show.
    pub sigma_px: f64,
    /// Numbers measured minus unknowns.
    pub dof: usize,
    /// Each view's information on the camera's unknowns, for residuals of 1 px.
    view_information: Vec<DMatrix<f64>>,
    /// Each view's gradient of half the sum of squares.
    view_gradients: Vec<DVector<f64>>,
}

impl Fit {
    /// Fits from a start with known poses.
    ///
    /// # Errors
    /// Too few points, no convergence, or points that contradict each other.
    pub fn from_poses(
        observations: &Observations,
        start: &FreeCamera,
        poses: Vec<ViewPose>,
    ) -> Result<Self, BundleError> {
        Self::in_rounds(observations, start, poses, MAX_ROUNDS)
    }

    /// As [`Fit::from_poses`] with at most so many rounds of reweighting; one round is plain least squares.
    pub(crate) fn in_rounds(
        observations: &Observations,
        start: &FreeCamera,
        poses: Vec<ViewPose>,
        rounds: usize,
    ) -> Result<Self, BundleError> {
        let (camera_unknowns, measurements) = (start.unknowns().len(), 2 * observations.points());
        let unknowns = camera_unknowns + 6 * observations.views.len();
        if measurements <= unknowns {
            return Err(BundleError::TooFew { measurements, unknowns, camera: camera_unknowns });
        }
        let weights: Vec<Vec<f64>> = observations.views.iter().map(|v| vec![1.0; v.points.len()]).collect();
        let mut problem = Problem::new(observations, start.clone(), poses, weights);
        let mut reason = TerminationReason::LostPatience;
        for round in 1..=rounds {
            if camera_unknowns > 0 {
                let solver =
                    LevenbergMarquardt::new().with_ftol(1e-10).with_xtol(1e-9).with_gtol(1e-10).with_patience(30);
                let (solved, report) = solver.minimize(problem);
                problem = solved;
                // The last step that was tried may have been refused: the poses must be those of the result.
                let values = problem.params();
                problem.set_params(&values);
                reason = report.termination;
            } else {
                reason = TerminationReason::Converged { ftol: true, xtol: true };
            }
            // The last weights are those that the result was fitted with.
            if round == rounds || !problem.reweigh() {
                break;
            }
        }
        problem.finish(&reason, measurements - unknowns)
    }

    /// Fits from nothing but a camera of the right kind: scale and poses are searched.
    ///
    /// # Errors
    /// As [`Fit::from_poses`], or no start was found.
    pub fn search(observations: &Observations, start: &FreeCamera) -> Result<Self, BundleError> {
        let (camera, poses) = start::search(observations, start)?;
        Self::from_poses(observations, &camera, poses)
    }

    /// Root mean square length of the residuals (both components together), px.
    pub fn rms_px(&self) -> f64 {
        let (mut sum, mut n) = (0.0, 0usize);
        for residual in self.residuals_px.iter().flatten() {
            sum += residual.norm_squared();
            n += 1;
        }
        (sum / n.max(1) as f64).sqrt()
    }

    /// Mean length of the residuals, px.
    pub fn mean_px(&self) -> f64 {
        let lengths: Vec<f64> = self.residuals_px.iter().flatten().map(Vector2::norm).collect();
        lengths.iter().sum::<f64>() / lengths.len().max(1) as f64
    }

    /// Sum of squared residuals, each counted by its weight, px².
    pub fn weighted_squares_px2(&self) -> f64 {
        let pairs = self.residuals_px.iter().flatten().zip(self.weights.iter().flatten());
        pairs.map(|(r, w)| w * r.norm_squared()).sum()
    }

    /// Root mean square length of the residuals, each counted by its weight, px: what errors on unseen views compare with.
    pub fn weighted_rms_px(&self) -> f64 {
        let points = self.residuals_px.iter().map(Vec::len).sum::<usize>();
        (self.weighted_squares_px2() / points.max(1) as f64).sqrt()
    }

    /// Points that count less than fully.
    pub fn outliers(&self) -> usize {
        self.weights.iter().flatten().filter(|w| **w < 1.0).count()
    }
}

/// The camera's numbers as the unknowns of a least-squares library, each view at its best pose.
struct Problem<'a> {
    observations: &'a Observations,
    camera: FreeCamera,
    poses: Vec<ViewPose>,
    weights: Vec<Vec<f64>>,
    /// Weighted residuals at the best poses; `None` where the numbers make no camera.
    residuals: Option<DVector<f64>>,
}

impl<'a> Problem<'a> {
    fn new(observations: &'a Observations, camera: FreeCamera, poses: Vec<ViewPose>, weights: Vec<Vec<f64>>) -> Self {
        let mut problem = Self { observations, camera, poses, weights, residuals: None };
        let values = problem.params();
        problem.set_params(&values);
        problem.camera.seek_steps(observations, &problem.poses);
        problem
    }

    /// New weights from the present residuals; whether any changed noticeably.
    fn reweigh(&mut self) -> bool {
        let lengths = self.lengths_px();
        let sigma = robust_sigma(lengths.iter().flatten().copied());
        let mut changed = false;
        for (weights, lengths) in self.weights.iter_mut().zip(&lengths) {
            for (weight, length) in weights.iter_mut().zip(lengths) {
                let limit = OUTLIER_SIGMAS * sigma;
                let new = if *length <= limit { 1.0 } else { (limit / length).powi(2) };
                changed |= (new - *weight).abs() > 0.02;
                *weight = new;
            }
        }
        if changed {
            let values = self.params();
            self.set_params(&values);
        }
        changed
    }

    /// Unweighted lengths of the residuals.
    fn lengths_px(&self) -> Vec<Vec<f64>> {
        let views = self.observations.views.iter().zip(&self.poses);
        views.map(|(view, pose)| pose.residuals_px(&self.camera, view).iter().map(Vector2::norm).collect()).collect()
    }

    /// For each view the camera's Jacobian with the pose projected out.
    fn view_jacobians(&self) -> Vec<DMatrix<f64>> {
        let by_camera = self.camera.jacobians(self.observations, &self.poses);
        let views = self.observations.views.iter().zip(&self.poses).zip(&self.weights);
        by_camera
            .into_iter()
            .zip(views)
            .map(|(mut by_camera, ((view, pose), weights))| {
                let mut by_pose = pose.jacobian(&self.camera, view);
                for (i, weight) in weights.iter().enumerate() {
                    for row in [2 * i, 2 * i + 1] {
                        by_camera.row_mut(row).scale_mut(weight.sqrt());
                        by_pose.row_mut(row).scale_mut(weight.sqrt());
                    }
                }
                let q = by_pose.qr().q();
                let along = q.tr_mul(&by_camera);
                by_camera - q * along
            })
            .collect()
    }

    fn finish(self, reason: &TerminationReason, dof: usize) -> Result<Fit, BundleError> {
        let views = self.observations.views.iter().zip(&self.poses);
        let residuals_px: Vec<Vec<Vector2<f64>>> = views.map(|(v, p)| p.residuals_px(&self.camera, v)).collect();
        let rms_px = |r: &[Vector2<f64>]| (r.iter().map(Vector2::norm_squared).sum::<f64>() / r.len() as f64).sqrt();
        let model = self.camera.camera().model().to_owned();
        let all: Vec<Vector2<f64>> = residuals_px.iter().flatten().copied().collect();
        // Patience may run out at the limit of what the derivatives by differences resolve; the gradient decides.
        let jacobians = self.view_jacobians();
        let mut offset = 0;
        let (mut view_information, mut view_gradients) = (Vec::new(), Vec::new());
        let residuals = self.residuals.clone().unwrap_or_else(|| DVector::zeros(2 * all.len()));
        for jacobian in &jacobians {
            let r = residuals.rows(offset, jacobian.nrows());
            offset += jacobian.nrows();
            view_information.push(jacobian.tr_mul(jacobian));
            view_gradients.push(jacobian.tr_mul(&r));
        }
        if !reason.was_successful() && !is_stationary(&view_information, &view_gradients, residuals.norm_squared()) {
            let reason = format!("{reason:?}");
            return Err(BundleError::NotConverged { model, reason, rms_px: rms_px(&all) });
        }
        let outliers = self.weights.iter().flatten().filter(|w| **w < 1.0).count();
        if outliers as f64 > MAX_OUTLIERS * all.len() as f64 || all.iter().any(|r| r.norm() >= LOST_PX) {
            let worst = residuals_px.iter().map(|r| rms_px(r)).enumerate().max_by(|a, b| a.1.total_cmp(&b.1));
            let (index, worst_px) = worst.unwrap_or((0, f64::NAN));
            let worst_view = self.observations.views[index].name.clone();
            return Err(BundleError::Contradictory { model, outliers, points: all.len(), worst_view, worst_px });
        }
        let sigma_px = (residuals.norm_squared() / dof.max(1) as f64).sqrt();
        Ok(Fit {
            camera: self.camera,
            poses: self.poses,
            residuals_px,
            weights: self.weights,
            sigma_px,
            dof,
            view_information,
            view_gradients,
        })
    }
}

/// Whether the step that remains would change the sum of squares by less than a millionth.
fn is_stationary(information: &[DMatrix<f64>], gradients: &[DVector<f64>], squares: f64) -> bool {
    let total: DMatrix<f64> = information.iter().sum();
    let gradient: DVector<f64> = gradients.iter().sum();
    match total.pseudo_inverse(1e-12) {
        Ok(inverse) => gradient.dot(&(inverse * &gradient)) < 1e-6 * squares,
        Err(_) => false,
    }
}

/// Standard deviation of one component from the median of lengths of two.
fn robust_sigma(lengths: impl Iterator<Item = f64>) -> f64 {
    let mut lengths: Vec<f64> = lengths.collect();
    lengths.sort_by(f64::total_cmp);
    // The median of Rayleigh's distribution is σ√(2 ln 2).
    lengths.get(lengths.len() / 2).map_or(0.0, |median| median / (2.0 * std::f64::consts::LN_2).sqrt()).max(1e-9)
}

impl LeastSquaresProblem<f64, Dyn, Dyn> for Problem<'_> {
    type ParameterStorage = Owned<f64, Dyn>;
    type ResidualStorage = Owned<f64, Dyn>;
    type JacobianStorage = Owned<f64, Dyn, Dyn>;

    fn set_params(&mut self, values: &DVector<f64>) {
        self.camera.set_unknowns(values.as_slice());
        self.residuals = self.camera.is_sound().then(|| {
            let mut all = Vec::with_capacity(2 * self.observations.points());
            for ((view, pose), weights) in self.observations.views.iter().zip(&mut self.poses).zip(&self.weights) {
                *pose = fit_pose(&self.camera, view, weights, pose);
                for (r, w) in pose.residuals_px(&self.camera, view).iter().zip(weights) {
                    all.extend([r.x * w.sqrt(), r.y * w.sqrt()]);
                }
            }
            DVector::from_vec(all)
        });
    }

    fn params(&self) -> DVector<f64> {
        DVector::from_vec(self.camera.unknown_values())
    }

    fn residuals(&self) -> Option<DVector<f64>> {
        // Numbers that make no camera are a bad step, not the end of the search.
        Some(self.residuals.clone().unwrap_or_else(|| DVector::from_element(2 * self.observations.points(), LOST_PX)))
    }

    fn jacobian(&self) -> Option<DMatrix<f64>> {
        let blocks = self.view_jacobians();
        let mut all = DMatrix::zeros(2 * self.observations.points(), self.camera.unknowns().len());
        let mut offset = 0;
        for block in blocks {
            all.rows_mut(offset, block.nrows()).copy_from(&block);
            offset += block.nrows();
        }
        Some(all)
    }
}

#[cfg(test)]
mod tests;
