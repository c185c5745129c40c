//! An ordinary camera with the five-coefficient lens distortion of OpenCV (`model = "pinhole"`), so that ordinary video
//! can be tracked. The optical axis is the camera's x: u = cx − fx·y/x, v = cy − fy·z/x.

use std::sync::OnceLock;

use nalgebra::{Matrix2, Matrix2x3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::lens_distortion::LensDistortion;
use super::parameter::{camera_by_design, check_centre, check_finite, check_focal_lengths, design, one_or_each};
use super::{Camera, NormalisedPlane, ParameterError, Ray, elevations_on_the_picture};

/// The parameters of `[pinhole]` in `camera.toml`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PinholeParameters {
    /// (fx, fy), px.
    #[serde(deserialize_with = "one_or_each")]
    pub focal_length_px: [f64; 2],
    /// (cx, cy), px.
    pub centre_px: [f64; 2],
    /// k₁, k₂, p₁, p₂, k₃ as OpenCV orders them.
    #[serde(default)]
    pub distortion: [f64; 5],
}

design!(PinholeParameters: focal_length_px, centre_px, distortion);

/// A pinhole camera, validated.
#[derive(Debug, Clone, PartialEq)]
pub struct Pinhole {
    parameters: PinholeParameters,
    image_size_px: [u32; 2],
    lens: LensDistortion,
    elevation_rad: OnceLock<[f64; 2]>,
}

impl Pinhole {
    /// Checks that the parameters make a camera.
    ///
    /// # Errors
    /// The first parameter that makes that impossible.
    pub fn new(parameters: PinholeParameters, image_size_px: [u32; 2]) -> Result<Self, ParameterError> {
        check_focal_lengths(parameters.focal_length_px, image_size_px)?;
        check_centre(parameters.centre_px, image_size_px)?;
        check_finite("distortion", &parameters.distortion, "[k1, k2, p1, p2, k3]")?;
        let lens = LensDistortion::new(parameters.distortion);
        Ok(Self { parameters, image_size_px, lens, elevation_rad: OnceLock::new() })
    }

    /// The parameters.
    pub fn parameters(&self) -> &PinholeParameters {
        &self.parameters
    }

    /// The image and its derivative to the point of the normalised plane, which is (−y/x, −z/x).
    fn image(&self, point: &Vector3<f64>) -> Option<(Vector2<f64>, Matrix2<f64>)> {
        (point.x > 0.0 && point.x.is_finite()).then_some(())?;
        let (distorted, slope) = self.lens.distort(&Vector2::new(-point.y / point.x, -point.z / point.x))?;
        let focal = Vector2::from(self.parameters.focal_length_px);
        let pixel = Vector2::from(self.parameters.centre_px) + focal.component_mul(&distorted);
        Some((pixel, Matrix2::from_diagonal(&focal) * slope))
    }
}

impl Camera for Pinhole {
    camera_by_design!("pinhole");

    fn image_of_point(&self, point_m: &Vector3<f64>) -> Option<Vector2<f64>> {
        self.image(point_m).map(|(pixel, _)| pixel)
    }

    fn image_of_direction(&self, direction: &Vector3<f64>) -> Option<Vector2<f64>> {
        self.image_of_point(direction)
    }

    fn ray_of_image(&self, pixel: &Vector2<f64>) -> Option<Ray> {
        let p = &self.parameters;
        let distorted = (pixel - Vector2::from(p.centre_px)).component_div(&Vector2::from(p.focal_length_px));
        let undistorted = self.lens.undistort(&distorted)?;
        let direction = Vector3::new(1.0, -undistorted.x, -undistorted.y).normalize();
        Some(Ray { origin_m: Vector3::zeros(), direction })
    }

    fn normalised_plane(&self) -> Option<NormalisedPlane> {
        let p = &self.parameters;
        Some(NormalisedPlane { centre_px: p.centre_px, focal_length_px: p.focal_length_px })
    }

    fn elevation_rad(&self) -> [f64; 2] {
        *self.elevation_rad.get_or_init(|| elevations_on_the_picture(self))
    }

    fn is_panoramic(&self) -> bool {
        false
    }

    fn point_jacobian(&self, point_m: &Vector3<f64>) -> Option<Matrix2x3<f64>> {
        let (_, slope) = self.image(point_m)?;
        let (x, y, z) = (point_m.x, point_m.y, point_m.z);
        Some(slope * Matrix2x3::new(y / (x * x), -1.0 / x, 0.0, z / (x * x), 0.0, -1.0 / x))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::laws::camera_laws;

    fn parameters(distortion: [f64; 5]) -> PinholeParameters {
        PinholeParameters { focal_length_px: [700.0, 710.0], centre_px: [322.0, 238.5], distortion }
    }

    fn camera(distortion: [f64; 5]) -> Pinhole {
        Pinhole::new(parameters(distortion), [640, 480]).unwrap()
    }

    camera_laws!(without_distortion, camera([0.0; 5]));
    camera_laws!(with_barrel_distortion, camera([-0.28, 0.09, 1e-3, -5e-4, -0.012]));
    camera_laws!(with_pincushion_distortion, camera([0.2, -0.03, 0.0, 2e-4, 0.0]));

    #[test]
    fn a_point_to_the_left_appears_left_and_a_point_above_appears_above() {
        let pixel = camera([0.0; 5]).project(&Vector3::new(2.0, 0.2, 0.1)).unwrap();
        assert_eq!((pixel.x, pixel.y), (322.0 - 70.0, 238.5 - 35.5));
    }

    #[test]
    fn what_is_behind_has_no_image() {
        assert!(camera([0.0; 5]).project(&Vector3::new(-1.0, 0.0, 0.0)).is_none());
    }

    #[test]
    fn a_focal_length_in_millimetres_is_named() {
        let wrong = PinholeParameters { focal_length_px: [4.2, 4.2], ..parameters([0.0; 5]) };
        let error = Pinhole::new(wrong, [640, 480]).unwrap_err().to_string();
        assert!(error.contains("focal_length_px") && error.contains("millimetres"), "{error}");
    }
}
