//! A conic mirror under a pinhole camera (`model = "conic"`): its viewpoints form a circle round the axis.
//!
//! Cone of half-angle γ with its apex in the origin, opening away from the pinhole at (0, h). A ray at ψ in the camera
//! leaves at Ω = 2γ − ψ from −z, as if from the pinhole's mirror image at r = −h sin 2γ, z = h cos 2γ. The apex itself
//! has no azimuth and is not in the domain. Source: `MATHS.md` §1.1 (2).

use std::f64::consts::PI;

use serde::{Deserialize, Serialize};

use super::ParameterError;
use super::axial::{Axial, AxialDesign, AxialOptics, AxialRay, ImagePlane};
use super::mirror::CameraSide;
use super::parameter::{check_length_mm, check_positive_px, design, one};

/// Image rays end this much before they run along the cone and meet it nowhere.
const GRAZING_MARGIN_RAD: f64 = 1e-2;

/// The parameters of `[conic]` in `camera.toml`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ConicParameters {
    /// h: from the apex to the pinhole, mm.
    pub h_mm: f64,
    /// γ: between the axis and the cone, degrees in (0, 90).
    #[serde(alias = "half_angle_deg")]
    pub gamma_deg: f64,
    /// f of the pinhole camera, px.
    pub focal_length_px: f64,
    /// (u₀, v₀): the image of the axis, px.
    pub centre_px: [f64; 2],
    /// Pixels along u for one along v.
    #[serde(default = "one")]
    pub aspect: f64,
    /// Where the camera is; elevations and z are those of the body either way.
    #[serde(default)]
    pub camera: CameraSide,
    /// Elevations [lowest, highest] that the mirror shows, degrees; all that fall on the picture where not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub elevation_deg: Option<[f64; 2]>,
}

design!(ConicParameters: h_mm, gamma_deg, focal_length_px, centre_px, aspect);

/// A conic camera, validated.
pub type Conic = Axial<ConicParameters>;

/// The mirror and its pinhole in a meridian half-plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConicOptics {
    h_mm: f64,
    gamma: f64,
    focal_length_px: f64,
}

impl AxialDesign for ConicParameters {
    const MODEL: &'static str = "conic";
    type Optics = ConicOptics;

    fn optics(&self, _image_size_px: [u32; 2]) -> Result<ConicOptics, ParameterError> {
        let Self { h_mm, gamma_deg, focal_length_px, .. } = *self;
        check_length_mm("h_mm", h_mm)?;
        check_positive_px("focal_length_px", focal_length_px)?;
        if !(gamma_deg > 1.0 && gamma_deg < 90.0) {
            let expected = "the angle between axis and cone in degrees, between 1 and 90 (is it in radians?)";
            return Err(ParameterError::new("gamma_deg", gamma_deg, expected));
        }
        Ok(ConicOptics { h_mm, gamma: gamma_deg.to_radians(), focal_length_px })
    }

    fn image_plane(&self) -> ImagePlane {
        ImagePlane { centre_px: self.centre_px, aspect: self.aspect, upside_down: self.camera.is_upside_down() }
    }

    fn elevation_deg(&self) -> Option<[f64; 2]> {
        self.elevation_deg
    }
}

impl ConicOptics {
    /// The ray of an image ray at ψ in (0, γ).
    fn ray(&self, psi: f64) -> Option<AxialRay> {
        (psi > 0.0 && psi < self.gamma - GRAZING_MARGIN_RAD).then_some(())?;
        let s = self.h_mm * self.gamma.sin() / (self.gamma - psi).sin();
        let (sin, cos) = psi.sin_cos();
        Some(AxialRay { origin_mm: [s * sin, self.h_mm - s * cos], zenith_rad: PI - 2.0 * self.gamma + psi })
    }
}

impl AxialOptics for ConicOptics {
    fn ray_of_radius(&self, radius_px: f64) -> Option<AxialRay> {
        self.ray((radius_px / self.focal_length_px).atan())
    }

    fn radius_of_zenith(&self, zenith_rad: f64) -> Option<f64> {
        let psi = 2.0 * self.gamma - (PI - zenith_rad);
        self.ray(psi)?;
        Some(self.focal_length_px * psi.tan())
    }

    fn radius_of_point(&self, r_mm: f64, z_mm: f64) -> Option<f64> {
        let (sin2, cos2) = (2.0 * self.gamma).sin_cos();
        let psi = 2.0 * self.gamma - (r_mm + self.h_mm * sin2).atan2(self.h_mm * cos2 - z_mm);
        let ray = self.ray(psi)?;
        // The point is on the way out, not behind the mirror.
        let (sin, cos) = ray.zenith_rad.sin_cos();
        let along = (r_mm - ray.origin_mm[0]) * sin + (z_mm - ray.origin_mm[1]) * cos;
        (along >= 0.0).then(|| self.focal_length_px * psi.tan())
    }

    fn single_viewpoint_mm(&self) -> Option<f64> {
        None
    }

    fn focal_length_px(&self) -> f64 {
        self.focal_length_px
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::axial::caustic_mm;
    use crate::optics::laws::{assert_rel, camera_laws, golden};

    fn parameters() -> ConicParameters {
        ConicParameters {
            h_mm: 80.0,
            gamma_deg: 50.0,
            focal_length_px: 700.0,
            centre_px: [383.5, 287.5],
            aspect: 1.0,
            camera: CameraSide::Above,
            elevation_deg: None,
        }
    }

    camera_laws!(laws, Conic::new(parameters(), [768, 576]).unwrap());

    #[test]
    fn rays_viewpoints_and_images_are_golden() {
        let (_, golden, tol) = golden("cone");
        let optics = parameters().optics([768, 576]).unwrap();
        for row in golden.as_array().unwrap() {
            let radius = row["r_I"].as_f64().unwrap();
            let ray = optics.ray_of_radius(radius).unwrap();
            assert_rel(PI - ray.zenith_rad, &row["om"], tol);
            let virtual_pinhole = caustic_mm(&optics, radius).unwrap();
            for i in 0..2 {
                assert_rel(ray.origin_mm[i], &row["M"][i], tol);
                assert_rel(virtual_pinhole[i], &row["virt"][i], 1e-7);
            }
            let [r, z] = [0, 1].map(|i| row["P"][i].as_f64().unwrap());
            assert_rel(optics.radius_of_point(r, z).unwrap(), &row["r_fwd"], tol);
            assert_rel(optics.radius_of_zenith(ray.zenith_rad).unwrap(), &row["r_I"], tol);
        }
    }

    #[test]
    fn an_angle_in_radians_is_named() {
        let error = Conic::new(ConicParameters { gamma_deg: 0.87, ..parameters() }, [768, 576]).unwrap_err();
        assert!(error.to_string().contains("radians"), "{error}");
    }
}
