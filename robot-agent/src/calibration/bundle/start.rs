//! Where a fit starts: a scale of the camera and a pose for each view.
//!
//! For a camera with one viewpoint, the rays d of a plane's points (X, Y) satisfy d ∝ H·(X, Y, 1), those of points in
//! space d ∝ P·(X, Y, Z, 1); H or P is the least singular vector of d × (…) = 0, and its columns are rotation and
//! translation. So any camera gives poses directly, and the camera whose poses leave the least residuals is the start.

use nalgebra::{DMatrix, Isometry3, Matrix3, Rotation3, SymmetricEigen, Translation3, UnitQuaternion, Vector3};

use super::pose::{ViewPose, fit_pose};
use crate::calibration::free_camera::FreeCamera;
use crate::calibration::observation::{Observations, View};

/// Scales of the camera that are tried, relative to the one given.
const SCALES: [f64; 9] = [1.0, 0.85, 1.18, 0.7, 1.4, 0.55, 1.75, 0.4, 2.3];
/// A start must explain the median point to within this share of the picture's shorter side.
const MAX_START_ERROR: f64 = 0.1;

/// Why no start was found.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum StartError {
    /// No pose explains a view.
    #[error(
        "{model}: no pose explains the views (best median error {error_px:.1} px): wrong board size or corner order, or a \
         camera of another kind?"
    )]
    NoPose {
        /// The camera's model.
        model: String,
        /// Of the best start.
        error_px: f64,
    },
}

/// The best of several scales with its poses.
pub(super) fn search(
    observations: &Observations,
    camera: &FreeCamera,
) -> Result<(FreeCamera, Vec<ViewPose>), StartError> {
    let mut best: Option<(f64, FreeCamera, Vec<ViewPose>)> = None;
    for scale in SCALES {
        let Some(scaled) = camera.scaled(scale) else { continue };
        let Some(poses) = poses(observations, &scaled) else { continue };
        let mut lengths: Vec<f64> = observations
            .views
            .iter()
            .zip(&poses)
            .flat_map(|(view, pose)| pose.residuals_px(&scaled, view))
            .map(|r| r.norm())
            .collect();
        lengths.sort_by(f64::total_cmp);
        let error_px = lengths[lengths.len() / 2];
        if best.as_ref().is_none_or(|(least, ..)| error_px < *least) {
            best = Some((error_px, scaled, poses));
        }
    }
    let [w, h] = observations.image_size_px.map(f64::from);
    match best {
        Some((error_px, camera, poses)) if error_px < MAX_START_ERROR * w.min(h) => Ok((camera, poses)),
        other => {
            let error_px = other.map_or(f64::INFINITY, |(error, ..)| error);
            Err(StartError::NoPose { model: camera.camera().model().to_owned(), error_px })
        }
    }
}

/// A pose for every view, by rays and then by pixels; `None` where a view has none.
pub(super) fn poses(observations: &Observations, camera: &FreeCamera) -> Option<Vec<ViewPose>> {
    observations
        .views
        .iter()
        .map(|view| {
            let start = pose_from_rays(camera, view)?;
            Some(fit_pose(camera, view, &vec![1.0; view.points.len()], &start))
        })
        .collect()
}

/// The pose from the rays of the pixels, taken to start at the camera's viewpoint.
pub(crate) fn pose_from_rays(camera: &FreeCamera, view: &View) -> Option<ViewPose> {
    let rays: Vec<(Vector3<f64>, Vector3<f64>)> = view
        .points
        .iter()
        .filter_map(|(object, pixel)| Some((*object, camera.camera().ray_of_image(pixel)?.direction)))
        .collect();
    if rays.len() < crate::calibration::observation::MIN_POINTS {
        return None;
    }
    let planar = view.is_planar();
    let centre = rays.iter().map(|(object, _)| object).sum::<Vector3<f64>>() / rays.len() as f64;
    let size = (rays.iter().map(|(o, _)| (o - centre).norm_squared()).sum::<f64>() / rays.len() as f64).sqrt();
    let columns = if planar { 3 } else { 4 };
    let mut normal = DMatrix::<f64>::zeros(3 * columns, 3 * columns);
    let normalised = |object: &Vector3<f64>| {
        let p = (object - centre) / size;
        if planar { vec![p.x, p.y, 1.0] } else { vec![p.x, p.y, p.z, 1.0] }
    };
    for (object, ray) in &rays {
        let cross = ray.cross_matrix();
        let point = normalised(object);
        let mut rows = DMatrix::zeros(3, 3 * columns);
        for (k, x) in point.iter().enumerate() {
            rows.view_mut((0, 3 * k), (3, 3)).copy_from(&(cross * *x));
        }
        normal += rows.tr_mul(&rows);
    }
    let eigen = SymmetricEigen::new(normal);
    let least = eigen.eigenvectors.column(eigen.eigenvalues.imin());
    let column = |k: usize| Vector3::new(least[3 * k], least[3 * k + 1], least[3 * k + 2]);
    // The sign that puts the points on their rays and not opposite to them.
    let along: f64 = rays
        .iter()
        .map(|(object, ray)| {
            let p = normalised(object);
            ray.dot(&(0..columns).map(|k| column(k) * p[k]).sum::<Vector3<f64>>())
        })
        .sum();
    let sign = along.signum();
    let (a, b, t) = (sign * column(0), sign * column(1), sign * column(columns - 1));
    let (matrix, scale) = if planar {
        let scale = 0.5 * (a.norm() + b.norm());
        (Matrix3::from_columns(&[a, b, a.cross(&b) / scale]), scale)
    } else {
        let c = sign * column(2);
        (Matrix3::from_columns(&[a, b, c]), (a.norm() + b.norm() + c.norm()) / 3.0)
    };
    let rotation = nearest_rotation(&(matrix / scale))?;
    let translation = t / scale * size - rotation * centre;
    let rotation = UnitQuaternion::from_rotation_matrix(&rotation);
    translation
        .iter()
        .all(|x| x.is_finite())
        .then(|| ViewPose { camera_from_object: Isometry3::from_parts(Translation3::from(translation), rotation) })
}

fn nearest_rotation(matrix: &Matrix3<f64>) -> Option<Rotation3<f64>> {
    matrix.iter().all(|x| x.is_finite()).then_some(())?;
    let svd = matrix.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    let mut flip = Matrix3::identity();
    flip[(2, 2)] = (u * v_t).determinant().signum();
    Some(Rotation3::from_matrix_unchecked(u * flip * v_t))
}
