//! A camera that stands askew to its mirror or lens: any model, and what that does to its picture.
//!
//! Problem: no camera is exactly on its mirror's axis, and without a parameter for that a calibration moves the centre
//! and the mounting instead (40 px on OpenCV's set). Insight: turned about its own pinhole the camera sees the same
//! rays, and its picture is a homography of the aligned one; a camera moved a little off the axis is that and, to first
//! order, tangential distortion. So misalignment maps the picture alone and works for every model with one pinhole.
//!
//! ```text
//! point ──[aligned camera]──▶ ideal pixel ──[misalignment]──▶ pixel
//! ```
//!
//! Source: OpenCV's p₁, p₂; MATHS has none.

use std::sync::Arc;

use nalgebra::{Matrix2, Matrix2x3, Rotation3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::lens_distortion::LensDistortion;
use super::parameter::{Design, Numbers, check_finite};
use super::{Camera, NormalisedPlane, Parameter, ParameterError, Ray};

/// Larger tilts are a mistake in the unit.
const MAX_TILT_DEG: f64 = 20.0;

/// `[misalignment]` in `camera.toml`: one of the two.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Misalignment {
    /// p₁, p₂ as OpenCV's, on the normalised plane.
    Tangential([f64; 2]),
    /// The camera's turn against its optics about the picture's u and v axes, degrees.
    TiltDeg([f64; 2]),
}

impl Design for Misalignment {
    fn visit(&mut self, visitor: &mut dyn FnMut(&str, &mut f64)) {
        match self {
            Self::Tangential(p) => p.visit("misalignment.tangential", visitor),
            Self::TiltDeg(tilt) => tilt.visit("misalignment.tilt_deg", visitor),
        }
    }
}

/// Any camera with a misalignment, validated.
#[derive(Debug, Clone)]
pub struct Misaligned {
    aligned: Arc<dyn Camera>,
    misalignment: Misalignment,
    plane: NormalisedPlane,
    map: Map,
}

#[derive(Debug, Clone, Copy)]
enum Map {
    Tangential(LensDistortion),
    /// Turns rays of the aligned picture into those of the tilted camera.
    Tilt(Rotation3<f64>),
}

impl Misaligned {
    /// Misaligns a camera.
    ///
    /// # Errors
    /// Values that are not finite or too large, a camera without one pinhole, or one that is misaligned already.
    pub fn new(aligned: Arc<dyn Camera>, misalignment: Misalignment) -> Result<Self, ParameterError> {
        let plane = aligned.normalised_plane().filter(|_| aligned.misalignment().is_none()).ok_or_else(|| {
            let expected = format!("left out: a {} camera has none, or already has one", aligned.model());
            ParameterError::new("misalignment", misalignment, expected)
        })?;
        let map = match misalignment {
            Misalignment::Tangential([p1, p2]) => {
                check_finite("tangential", &[p1, p2], "[p1, p2]")?;
                Map::Tangential(LensDistortion::new([0.0, 0.0, p1, p2, 0.0]))
            }
            Misalignment::TiltDeg(tilt) => {
                if !tilt.iter().all(|t| t.abs() <= MAX_TILT_DEG) {
                    let expected = format!("[about u, about v] in degrees, at most {MAX_TILT_DEG}");
                    return Err(ParameterError::new("tilt_deg", tilt, expected));
                }
                let [about_u, about_v] = tilt.map(f64::to_radians);
                Map::Tilt(Rotation3::from_scaled_axis(Vector3::new(about_u, about_v, 0.0)))
            }
        };
        Ok(Self { aligned, misalignment, plane, map })
    }

    /// The camera without its misalignment.
    pub fn aligned(&self) -> &Arc<dyn Camera> {
        &self.aligned
    }

    fn normalised(&self, pixel: &Vector2<f64>) -> Vector2<f64> {
        let NormalisedPlane { centre_px, focal_length_px } = self.plane;
        (pixel - Vector2::from(centre_px)).component_div(&Vector2::from(focal_length_px))
    }

    fn pixel(&self, normalised: &Vector2<f64>) -> Vector2<f64> {
        let NormalisedPlane { centre_px, focal_length_px } = self.plane;
        normalised.component_mul(&Vector2::from(focal_length_px)) + Vector2::from(centre_px)
    }

    fn actual(&self, ideal: &Vector2<f64>) -> Option<Vector2<f64>> {
        let point = self.normalised(ideal);
        let moved = match self.map {
            Map::Tangential(lens) => lens.distort(&point)?.0,
            Map::Tilt(rotation) => turned(&rotation, &point)?,
        };
        Some(self.pixel(&moved))
    }

    fn ideal(&self, actual: &Vector2<f64>) -> Option<Vector2<f64>> {
        let point = self.normalised(actual);
        let moved = match self.map {
            Map::Tangential(lens) => lens.undistort(&point)?,
            Map::Tilt(rotation) => turned(&rotation.inverse(), &point)?,
        };
        Some(self.pixel(&moved))
    }
}

fn turned(rotation: &Rotation3<f64>, point: &Vector2<f64>) -> Option<Vector2<f64>> {
    let ray = rotation * point.push(1.0);
    (ray.z > 1e-3).then(|| ray.xy() / ray.z)
}

impl Camera for Misaligned {
    fn model(&self) -> &'static str {
        self.aligned.model()
    }

    fn image_size_px(&self) -> [u32; 2] {
        self.aligned.image_size_px()
    }

    fn image_of_point(&self, point_m: &Vector3<f64>) -> Option<Vector2<f64>> {
        self.actual(&self.aligned.image_of_point(point_m)?)
    }

    fn image_of_direction(&self, direction: &Vector3<f64>) -> Option<Vector2<f64>> {
        self.actual(&self.aligned.image_of_direction(direction)?)
    }

    fn ray_of_image(&self, pixel: &Vector2<f64>) -> Option<Ray> {
        self.aligned.ray_of_image(&self.ideal(pixel)?)
    }

    fn point_jacobian(&self, point_m: &Vector3<f64>) -> Option<Matrix2x3<f64>> {
        let by_point = self.aligned.point_jacobian(point_m)?;
        let ideal = self.normalised(&self.aligned.image_of_point(point_m)?);
        let moved = match self.map {
            Map::Tangential(lens) => lens.distort(&ideal)?.1,
            Map::Tilt(rotation) => {
                let ray = rotation * ideal.push(1.0);
                (ray.z > 1e-3).then_some(())?;
                // ∂(x/z, y/z) = (∂(x, y) − (x/z, y/z) ∂z)/z.
                let by_ideal = rotation.matrix().fixed_view::<3, 2>(0, 0);
                (by_ideal.fixed_view::<2, 2>(0, 0) - ray.xy() / ray.z * by_ideal.row(2)) / ray.z
            }
        };
        let [fx, fy] = self.plane.focal_length_px;
        let scale = Matrix2::from_diagonal(&Vector2::new(fx, fy));
        let inverse = Matrix2::from_diagonal(&Vector2::new(fx.recip(), fy.recip()));
        Some(scale * moved * inverse * by_point)
    }

    fn is_in_field_of_view(&self, pixel: &Vector2<f64>) -> bool {
        self.ideal(pixel).is_some_and(|ideal| self.aligned.is_in_field_of_view(&ideal))
    }

    fn misalignment(&self) -> Option<Misalignment> {
        Some(self.misalignment)
    }

    /// Those of the aligned camera: what the misalignment adds or takes at the picture's edge is not counted.
    fn elevation_rad(&self) -> [f64; 2] {
        self.aligned.elevation_rad()
    }

    fn seen_after_s(&self, pixel: &Vector2<f64>) -> f64 {
        self.aligned.seen_after_s(pixel)
    }

    fn is_panoramic(&self) -> bool {
        self.aligned.is_panoramic()
    }

    fn parameters(&self) -> Vec<Parameter> {
        self.aligned.parameters().into_iter().chain(self.misalignment.parameters()).collect()
    }

    fn with_values(&self, values: &[f64]) -> Result<Arc<dyn Camera>, ParameterError> {
        let own = self.aligned.parameters().len().min(values.len());
        let misalignment = self.misalignment.with_values(&values[own..]);
        Ok(Arc::new(Self::new(self.aligned.with_values(&values[..own])?, misalignment)?))
    }

    fn table(&self) -> toml::Table {
        self.aligned.table()
    }

    fn viewpoint_m(&self) -> Vector3<f64> {
        self.aligned.viewpoint_m()
    }

    fn viewpoint_miss_m(&self) -> f64 {
        self.aligned.viewpoint_miss_m()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::laws::camera_laws;
    use crate::optics::{Pal, Pinhole, PinholeParameters};

    fn pal(misalignment: Misalignment) -> Misaligned {
        Misaligned::new(Arc::new(Pal::reference()), misalignment).unwrap()
    }

    camera_laws!(a_tilted_pal, pal(Misalignment::TiltDeg([0.6, -1.1])));
    camera_laws!(a_tangential_pal, pal(Misalignment::Tangential([2e-3, -4e-3])));

    #[test]
    fn no_misalignment_changes_nothing() {
        let point = Vector3::new(1.0, 0.4, 0.1);
        let aligned = Pal::reference().project(&point).unwrap();
        for none in [Misalignment::TiltDeg([0.0; 2]), Misalignment::Tangential([0.0; 2])] {
            assert!((pal(none).project(&point).unwrap() - aligned).norm() < 1e-12);
        }
    }

    #[test]
    fn a_tilted_pinhole_is_one_that_turned() {
        // The pinhole looks along x with u = −y and v = −z: a turn about the picture's v axis is one about −z.
        let parameters =
            PinholeParameters { focal_length_px: [700.0, 710.0], centre_px: [320.0, 240.0], distortion: [0.0; 5] };
        let pinhole = Pinhole::new(parameters, [640, 480]).unwrap();
        let angle = 2.0_f64.to_radians();
        let point = Vector3::new(3.0, 0.2, 0.3);
        let turned = Rotation3::from_axis_angle(&-Vector3::z_axis(), angle) * point;
        let expected = pinhole.project(&turned).unwrap();
        let tilted = Misaligned::new(Arc::new(pinhole), Misalignment::TiltDeg([0.0, 2.0])).unwrap();
        assert!((tilted.project(&point).unwrap() - expected).norm() < 1e-9);
    }

    #[test]
    fn tilts_in_another_unit_and_a_second_misalignment_are_errors() {
        let error = Misaligned::new(Arc::new(Pal::reference()), Misalignment::TiltDeg([60.0, 0.0])).unwrap_err();
        assert!(error.to_string().contains("degrees"), "{error}");
        let twice =
            Misaligned::new(Arc::new(pal(Misalignment::TiltDeg([1.0, 0.0]))), Misalignment::Tangential([0.0; 2]));
        assert!(twice.is_err());
    }
}
