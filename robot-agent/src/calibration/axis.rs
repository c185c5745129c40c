//! Where two calibrations of one camera put the axis of its optics.
//!
//! Problem: "the centre" of a camera is where its axis is imaged, but a panoramic picture hardly tells a turn of that axis
//! from a shift of the picture. In a stereographic picture, which all of these nearly are, with m = tan(angle off the axis/2)
//! as a complex number, to first order
//!
//! ```text
//! shift by d                             δm = d
//! turn of the axis by 2e                 δm = e + ē m²
//! tangential terms, p = p₂ + i p₁        δm = 2p |m|² + p̄ m²
//! tilt t of the camera to its optics     δm = t + (t |m|² + t̄ m²)/2
//! ```
//!
//! The axis turns with every view's pose, so it costs the fit nothing. Seen are the constant and the coefficients of m² and
//! |m|²: what a tilt t does, tangential terms of p = t/4 do with the axis turned by t/2 and the centre moved by t/4. Models
//! that fit equally well may so put the axis, and with it the centre, pixels apart, while every ray of one is a ray of the
//! other after one turn. Insight: compare rays. The turn that brings the rays of one camera onto those of the other is known
//! far better than either axis, and after it both image *the same physical direction* at the same place.
//!
//! Source: Kabsch 1976 for the turn; no counterpart in the report.

use nalgebra::{Matrix3, Rotation3, SVD, Vector2, Vector3};

use crate::optics::Camera;

/// Fewer shared rays determine no turn.
const MIN_RAYS: usize = 3;

/// Two cameras on the same picture, compared ray by ray.
#[derive(Debug, Clone, PartialEq)]
pub struct SharedAxis {
    /// Angle between the two axes, radians.
    pub turn_rad: f64,
    /// Rms angle between the rays that remains after the best turn, radians.
    pub disagreement_rad: f64,
    /// Where the camera images the reference's axis, px; `None` where its optics see nothing there.
    pub image_px: Option<Vector2<f64>>,
}

/// The direction of the axis of the optics in the camera's frame.
pub fn direction(camera: &dyn Camera) -> Vector3<f64> {
    // The only one that looks ahead.
    if camera.model() == "pinhole" { Vector3::x() } else { Vector3::z() }
}

/// Where the axis of the optics is imaged: the centre of the picture, px. `None` where the camera images nothing there.
pub fn image_px(camera: &dyn Camera) -> Option<Vector2<f64>> {
    camera.image_of_direction(&direction(camera))
}

/// Finds the reference's axis in another calibration of the same camera, by the rays of these pixels. `None` where fewer
/// than three pixels have rays in both.
pub fn shared(
    reference: &dyn Camera,
    camera: &dyn Camera,
    pixels: impl IntoIterator<Item = Vector2<f64>>,
) -> Option<SharedAxis> {
    let rays: Vec<(Vector3<f64>, Vector3<f64>)> = pixels
        .into_iter()
        .filter_map(|p| Some((reference.ray_of_image(&p)?.direction, camera.ray_of_image(&p)?.direction)))
        .collect();
    (rays.len() >= MIN_RAYS).then_some(())?;
    let camera_from_reference = turn(&rays)?;
    let squares: f64 = rays.iter().map(|(r, c)| (camera_from_reference * r).angle(c).powi(2)).sum();
    let axis = camera_from_reference * direction(reference);
    Some(SharedAxis {
        turn_rad: axis.angle(&direction(camera)),
        disagreement_rad: (squares / rays.len() as f64).sqrt(),
        image_px: camera.image_of_direction(&axis),
    })
}

/// The rotation that brings the first directions onto the second with the least sum of squares.
fn turn(rays: &[(Vector3<f64>, Vector3<f64>)]) -> Option<Rotation3<f64>> {
    let sum: Matrix3<f64> = rays.iter().map(|(from, to)| to * from.transpose()).sum();
    let svd = SVD::new(sum, true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    let handedness = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant().signum()));
    Some(Rotation3::from_matrix_unchecked(u * handedness * v_t))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::optics::{Misaligned, Misalignment, UnifiedSphere, UnifiedSphereParameters};

    fn sphere(centre: Vector2<f64>, distortion: [f64; 4]) -> UnifiedSphere {
        let parameters = UnifiedSphereParameters {
            xi: 1.0,
            focal_length_px: [400.0; 2],
            centre_px: centre.into(),
            skew: 0.0,
            distortion,
        };
        UnifiedSphere::new(parameters, [1280, 960]).unwrap()
    }

    fn ring() -> Vec<Vector2<f64>> {
        let at = |i: i32, r: f64| Vector2::new(630.0 + r * f64::from(i).cos(), 470.0 + r * f64::from(i).sin());
        (0..60).flat_map(|i| [at(i, 150.0), at(i, 300.0), at(i, 420.0)]).collect()
    }

    #[test]
    fn a_camera_shares_its_axis_with_itself() {
        let camera = sphere(Vector2::new(630.0, 470.0), [-0.05, 0.01, 2e-3, -1e-3]);
        let same = shared(&camera, &camera, ring()).unwrap();
        assert!(same.turn_rad < 1e-7 && same.disagreement_rad < 1e-7);
        assert!((same.image_px.unwrap() - Vector2::new(630.0, 470.0)).norm() < 1e-4, "{same:?}");
    }

    #[test]
    fn tangential_terms_explain_a_tilted_camera_by_another_axis_and_the_same_rays() {
        let tilt = 0.4_f64.to_radians();
        let centre = Vector2::new(630.0, 470.0);
        let true_axis_px = centre + Vector2::new(400.0 * tilt, 0.0);
        let tilted =
            Misaligned::new(Arc::new(sphere(centre, [0.0; 4])), Misalignment::TiltDeg([0.0, tilt.to_degrees()]))
                .unwrap();
        assert!((image_px(&tilted).unwrap() - true_axis_px).norm() < 0.01);
        let tangential = sphere(true_axis_px - Vector2::new(100.0 * tilt, 0.0), [0.0, 0.0, 0.0, tilt / 4.0]);
        let found = shared(&tilted, &tangential, ring()).unwrap();
        assert!((found.turn_rad - tilt / 2.0).abs() < 0.02 * tilt, "{found:?}");
        // Second order: the square of the tilt.
        assert!(found.disagreement_rad < 2.0 * tilt * tilt, "{found:?}");
        assert!((found.image_px.unwrap() - true_axis_px).norm() < 0.05, "{found:?}");
        assert!((image_px(&tangential).unwrap() - true_axis_px).norm() > 0.6);
    }

    #[test]
    fn two_rays_tell_no_turn() {
        let camera = sphere(Vector2::new(630.0, 470.0), [0.0; 4]);
        assert_eq!(shared(&camera, &camera, [Vector2::new(700.0, 400.0); 2]), None);
    }
}
