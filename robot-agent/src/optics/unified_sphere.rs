//! The unified sphere of Geyer, Barreto and Mei (`model = "unified-sphere"`): every central mirror and most fisheyes.
//!
//! A point goes to the unit sphere, the sphere is seen by a pinhole ξ below its centre, a lens distorts, and the sensor
//! has its focal lengths and skew. The optical axis is the camera's z:
//!
//! ```text
//! (x, y, z)/|·|  →  m = (x, y)/(z + ξ)  →  m' = distort(m)  →  u = fx·m'x + s·m'y + cx,  v = fy·m'y + cy
//! ```
//!
//! Source: Mei and Rives 2007 as OpenCV's `omnidir` writes it, `MATHS.md` §1.0.

use std::sync::OnceLock;

use nalgebra::{Matrix2, Matrix2x3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::axial::is_somewhere;
use super::lens_distortion::LensDistortion;
use super::parameter::{camera_by_design, check_centre, check_finite, check_focal_lengths, design, one_or_each};
use super::{Camera, NormalisedPlane, ParameterError, Ray, elevations_on_the_picture, is_in_image};

/// The parameters of `[unified-sphere]` in `camera.toml`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UnifiedSphereParameters {
    /// ξ: 0 a pinhole, below 1 hyperboloids and ellipsoids, 1 a paraboloid, above 1 fisheyes.
    pub xi: f64,
    /// (fx, fy), px.
    #[serde(deserialize_with = "one_or_each")]
    pub focal_length_px: [f64; 2],
    /// (cx, cy), px.
    pub centre_px: [f64; 2],
    /// s, px.
    #[serde(default)]
    pub skew: f64,
    /// k₁, k₂, p₁, p₂ as OpenCV orders them.
    #[serde(default)]
    pub distortion: [f64; 4],
}

design!(UnifiedSphereParameters: xi, focal_length_px, centre_px, skew, distortion);

/// A unified-sphere camera, validated.
#[derive(Debug, Clone, PartialEq)]
pub struct UnifiedSphere {
    parameters: UnifiedSphereParameters,
    image_size_px: [u32; 2],
    lens: LensDistortion,
    elevation_rad: OnceLock<[f64; 2]>,
}

impl UnifiedSphere {
    /// Checks that the parameters make a camera.
    ///
    /// # Errors
    /// The first parameter that makes that impossible.
    pub fn new(parameters: UnifiedSphereParameters, image_size_px: [u32; 2]) -> Result<Self, ParameterError> {
        let p = &parameters;
        if !(p.xi >= 0.0 && p.xi < 100.0) {
            return Err(ParameterError::new("xi", p.xi, "from 0 (pinhole) to 100, 1 for a parabolic mirror"));
        }
        // The sphere is ξ + 1 from its pinhole: focal lengths grow with it.
        check_focal_lengths(p.focal_length_px.map(|f| f / (1.0 + p.xi)), image_size_px)
            .map_err(|error| ParameterError { value: format!("{:?}", p.focal_length_px), ..error })?;
        check_centre(p.centre_px, image_size_px)?;
        check_finite("skew", &[p.skew], "s in pixels")?;
        check_finite("distortion", &p.distortion, "[k1, k2, p1, p2]")?;
        let [k1, k2, p1, p2] = p.distortion;
        let lens = LensDistortion::new([k1, k2, p1, p2, 0.0]);
        Ok(Self { parameters, image_size_px, lens, elevation_rad: OnceLock::new() })
    }

    /// The parameters.
    pub fn design(&self) -> &UnifiedSphereParameters {
        &self.parameters
    }

    fn sensor(&self) -> Matrix2<f64> {
        let [fx, fy] = self.parameters.focal_length_px;
        Matrix2::new(fx, self.parameters.skew, 0.0, fy)
    }

    /// The image and its derivative to the point.
    fn image(&self, point: &Vector3<f64>) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
        is_somewhere(point).then_some(())?;
        let xi = self.parameters.xi;
        let norm = point.norm();
        let depth = point.z + xi * norm;
        // One to one up to the sphere's horizon as seen from the pinhole: cos χ > −ξ (ξ < 1), > −1/ξ (ξ > 1).
        (point.z / norm > -xi.min(1.0 / xi) && depth > 0.0).then_some(())?;
        let m = point.xy() / depth;
        let (distorted, slope) = self.lens.distort(&m)?;
        let pixel = self.sensor() * distorted + Vector2::from(self.parameters.centre_px);
        // ∂m/∂P = (I₂ − m ∂depth/∂P)/depth with ∂depth/∂P = e_z + ξ P/|P|.
        let along = Vector3::z() + point * (xi / norm);
        let m_by_point = (Matrix2x3::identity() - m * along.transpose()) / depth;
        Some((pixel, self.sensor() * slope * m_by_point))
    }
}

impl Camera for UnifiedSphere {
    camera_by_design!("unified-sphere");

    fn image_of_point(&self, point_m: &Vector3<f64>) -> Option<Vector2<f64>> {
        self.image(point_m).map(|(pixel, _)| pixel)
    }

    fn image_of_direction(&self, direction: &Vector3<f64>) -> Option<Vector2<f64>> {
        self.image_of_point(direction)
    }

    fn ray_of_image(&self, pixel: &Vector2<f64>) -> Option<Ray> {
        let distorted = self.sensor().try_inverse()? * (pixel - Vector2::from(self.parameters.centre_px));
        let m = self.lens.undistort(&distorted)?;
        let xi = self.parameters.xi;
        let s = m.norm_squared();
        let root = 1.0 + (1.0 - xi * xi) * s;
        (root >= 0.0).then_some(())?;
        let factor = (xi + root.sqrt()) / (1.0 + s);
        let direction = Vector3::new(factor * m.x, factor * m.y, factor - xi).normalize();
        Some(Ray { origin_m: Vector3::zeros(), direction })
    }

    fn normalised_plane(&self) -> Option<NormalisedPlane> {
        let p = &self.parameters;
        Some(NormalisedPlane { centre_px: p.centre_px, focal_length_px: p.focal_length_px })
    }

    fn elevation_rad(&self) -> [f64; 2] {
        *self.elevation_rad.get_or_init(|| elevations_on_the_picture(self))
    }

    /// Everything round the axis is on the picture up to a ring that looks off the axis.
    fn is_panoramic(&self) -> bool {
        is_in_image(&Vector2::from(self.parameters.centre_px), self.image_size_px)
    }

    fn point_jacobian(&self, point_m: &Vector3<f64>) -> Option<Matrix2x3<f64>> {
        self.image(point_m).map(|(_, jacobian)| jacobian)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::laws::camera_laws;

    fn camera(xi: f64, distortion: [f64; 4]) -> UnifiedSphere {
        let parameters = UnifiedSphereParameters {
            xi,
            focal_length_px: [250.0 * (1.0 + 0.3 * xi), 246.0 * (1.0 + 0.3 * xi)],
            centre_px: [390.0, 283.0],
            skew: 0.7,
            distortion,
        };
        UnifiedSphere::new(parameters, [768, 576]).unwrap()
    }

    camera_laws!(a_pinhole, camera(0.0, [0.0; 4]));
    camera_laws!(a_hyperboloid, camera(0.93, [0.0; 4]));
    camera_laws!(a_paraboloid, camera(1.0, [-0.02, 0.01, 0.0, 0.0]));
    camera_laws!(a_misaligned_fisheye, camera(1.8, [-0.1, 0.05, 2e-3, -1e-3]));

    #[test]
    fn straight_ahead_is_right_of_the_centre_and_left_is_below_it() {
        let camera = camera(0.93, [0.0; 4]);
        let ahead = camera.project(&Vector3::new(1.0, 0.0, 0.3)).unwrap();
        assert!(ahead.x > 500.0 && (ahead.y - 283.0).abs() < 1e-9);
        let left = camera.project(&Vector3::new(0.0, 1.0, 0.3)).unwrap();
        assert!(left.y > 380.0 && (left.x - 390.0).abs() < 1.0);
    }

    #[test]
    fn a_point_behind_the_sphere_s_horizon_has_no_image() {
        assert!(camera(1.8, [0.0; 4]).project(&Vector3::new(0.1, 0.0, -1.0)).is_none());
        assert!(camera(0.0, [0.0; 4]).project(&Vector3::new(0.1, 0.0, -1.0)).is_none());
    }

    #[test]
    fn the_golden_hyperboloid_is_a_unified_sphere() {
        // Golden group `hyperboloid`: f = 600, e = 1.376 are ξ = 0.95115, γ = 185.24; r_I = 15.163 sees χ = 0.15935.
        let parameters = UnifiedSphereParameters {
            xi: 0.951_148_743_393_995,
            focal_length_px: [185.239_802_576_036; 2],
            centre_px: [320.0, 240.0],
            skew: 0.0,
            distortion: [0.0; 4],
        };
        let camera = UnifiedSphere::new(parameters, [640, 480]).unwrap();
        let chi: f64 = 0.159_353_459_381_168;
        let pixel = camera.project_direction(&Vector3::new(chi.sin(), 0.0, chi.cos())).unwrap();
        assert!((pixel.x - 320.0 - 15.163_349_350_280_5).abs() < 1e-9, "{pixel:?}");
    }

    #[test]
    fn impossible_parameters_are_named() {
        let wrong = |change: fn(&mut UnifiedSphereParameters)| {
            let mut parameters = *camera(0.9, [0.0; 4]).design();
            change(&mut parameters);
            UnifiedSphere::new(parameters, [768, 576]).unwrap_err().to_string()
        };
        assert!(wrong(|p| p.xi = -0.1).contains("xi = -0.1"));
        assert!(wrong(|p| p.focal_length_px = [4.2, 4.2]).contains("[4.2, 4.2]"));
        assert!(wrong(|p| p.distortion[1] = f64::NAN).contains("distortion"));
        assert!(wrong(|p| p.centre_px = [900.0, 10.0]).contains("768x576"));
    }
}
