//! Where the object stands in one view.

use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt};
use nalgebra::storage::Owned;
use nalgebra::{DMatrix, DVector, Dyn, Isometry3, SVector, Translation3, U6, UnitQuaternion, Vector2, Vector3};

use super::LOST_PX;
use crate::calibration::free_camera::FreeCamera;
use crate::calibration::observation::View;

/// The object in the camera's frame.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewPose {
    /// Metres.
    pub camera_from_object: Isometry3<f64>,
}

impl ViewPose {
    /// A point of the object in the camera's frame.
    pub fn in_camera(&self, object_m: &Vector3<f64>) -> Vector3<f64> {
        self.camera_from_object.rotation * object_m + self.camera_from_object.translation.vector
    }

    /// Projected minus measured, px, point by point; [`LOST_PX`] for a point that the camera cannot see.
    pub(crate) fn residuals_px(&self, camera: &FreeCamera, view: &View) -> Vec<Vector2<f64>> {
        let camera = camera.camera();
        view.points
            .iter()
            .map(|(object, pixel)| {
                camera.image_of_point(&self.in_camera(object)).map_or(Vector2::repeat(LOST_PX), |image| image - pixel)
            })
            .collect()
    }

    /// Derivatives of the projections, 2·points × 6: by a small rotation of the camera's axes applied after the present
    /// one (radians), then by translation (metres).
    pub(super) fn jacobian(&self, camera: &FreeCamera, view: &View) -> DMatrix<f64> {
        let mut jacobian = DMatrix::zeros(2 * view.points.len(), 6);
        for (i, (object, _)) in view.points.iter().enumerate() {
            let turned = self.camera_from_object.rotation * object;
            let point = turned + self.camera_from_object.translation.vector;
            let Some(by_point) = camera.camera().point_jacobian(&point) else { continue };
            let by_rotation = by_point * -turned.cross_matrix();
            jacobian.fixed_view_mut::<2, 3>(2 * i, 0).copy_from(&by_rotation);
            jacobian.fixed_view_mut::<2, 3>(2 * i, 3).copy_from(&by_point);
        }
        jacobian
    }

    fn moved(&self, by: &SVector<f64, 6>) -> Self {
        let rotation = UnitQuaternion::from_scaled_axis(by.fixed_rows::<3>(0).into_owned());
        let translation = self.camera_from_object.translation.vector + by.fixed_rows::<3>(3);
        Self {
            camera_from_object: Isometry3::from_parts(
                Translation3::from(translation),
                rotation * self.camera_from_object.rotation,
            ),
        }
    }
}

/// The best pose near a start, for this camera. Weights are in [0, 1].
pub(crate) fn fit_pose(camera: &FreeCamera, view: &View, weights: &[f64], start: &ViewPose) -> ViewPose {
    let problem = PoseProblem { camera, view, weights, base: start.clone(), by: SVector::zeros() };
    let solver = LevenbergMarquardt::new().with_ftol(1e-12).with_xtol(1e-10).with_gtol(1e-12).with_patience(8);
    let (solved, _) = solver.minimize(problem);
    solved.base.moved(&solved.by)
}

struct PoseProblem<'a> {
    camera: &'a FreeCamera,
    view: &'a View,
    weights: &'a [f64],
    base: ViewPose,
    by: SVector<f64, 6>,
}

impl LeastSquaresProblem<f64, Dyn, U6> for PoseProblem<'_> {
    type ParameterStorage = Owned<f64, U6>;
    type ResidualStorage = Owned<f64, Dyn>;
    type JacobianStorage = Owned<f64, Dyn, U6>;

    fn set_params(&mut self, by: &SVector<f64, 6>) {
        self.by = *by;
    }

    fn params(&self) -> SVector<f64, 6> {
        self.by
    }

    fn residuals(&self) -> Option<DVector<f64>> {
        let residuals = self.base.moved(&self.by).residuals_px(self.camera, self.view);
        let weighted = residuals.iter().zip(self.weights).flat_map(|(r, w)| [r.x * w.sqrt(), r.y * w.sqrt()]);
        Some(DVector::from_iterator(2 * residuals.len(), weighted))
    }

    fn jacobian(&self) -> Option<nalgebra::OMatrix<f64, Dyn, U6>> {
        // The parameters turn about `base`: exact where `by` is zero, and within a few parts in 10⁴ on the way.
        let jacobian = self.base.moved(&self.by).jacobian(self.camera, self.view);
        let mut fixed = nalgebra::OMatrix::<f64, Dyn, U6>::zeros(jacobian.nrows());
        for (row, mut out) in jacobian.row_iter().zip(fixed.row_iter_mut()) {
            out.copy_from(&row);
        }
        for (i, weight) in self.weights.iter().enumerate() {
            fixed.row_mut(2 * i).scale_mut(weight.sqrt());
            fixed.row_mut(2 * i + 1).scale_mut(weight.sqrt());
        }
        Some(fixed)
    }
}
