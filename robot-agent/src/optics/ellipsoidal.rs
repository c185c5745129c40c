//! A concave ellipsoidal mirror with the pinhole in one focus (`model = "ellipsoidal"`): a single viewpoint V in the
//! other. Light passes V before it meets the mirror on the opposite side, so rays are given from V on.
//!
//! The optics' axis z runs from V to the pinhole at 2c; χ is the angle of a ray from it, ψ that of its image ray:
//! tan(χ/2) = (1+e)/(1−e) · tan(ψ/2), r_I = f tan ψ. Source: `MATHS.md` §1.0 and §1.1 (4).

use std::f64::consts::FRAC_PI_2;

use serde::{Deserialize, Serialize};

use super::ParameterError;
use super::axial::{Axial, AxialDesign, AxialOptics, AxialRay, ImagePlane};
use super::mirror::CameraSide;
use super::parameter::{check_length_mm, check_positive_px, design, one};

/// The parameters of `[ellipsoidal]` in `camera.toml`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EllipsoidalParameters {
    /// a: the semi-axis along the axis, mm.
    #[serde(alias = "ellipsoid_a_mm")]
    pub a_mm: f64,
    /// c: half of the distance between V and the pinhole, mm; < a.
    #[serde(alias = "ellipsoid_c_mm")]
    pub c_mm: f64,
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

design!(EllipsoidalParameters: a_mm, c_mm, focal_length_px, centre_px, aspect);

/// A ellipsoidal camera, validated.
pub type Ellipsoidal = Axial<EllipsoidalParameters>;

/// The mirror and its pinhole in a meridian half-plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EllipsoidalOptics {
    focal_length_px: f64,
    /// (1 + e)/(1 − e).
    gain: f64,
}

impl AxialDesign for EllipsoidalParameters {
    const MODEL: &'static str = "ellipsoidal";
    type Optics = EllipsoidalOptics;

    fn optics(&self, _image_size_px: [u32; 2]) -> Result<EllipsoidalOptics, ParameterError> {
        let Self { a_mm, c_mm, focal_length_px, .. } = *self;
        check_length_mm("a_mm", a_mm)?;
        check_length_mm("c_mm", c_mm)?;
        check_positive_px("focal_length_px", focal_length_px)?;
        if c_mm >= a_mm {
            let expected = "less than a_mm (an ellipsoid has an eccentricity c/a below 1)";
            return Err(ParameterError::new("c_mm", c_mm, expected));
        }
        Ok(EllipsoidalOptics { focal_length_px, gain: (a_mm + c_mm) / (a_mm - c_mm) })
    }

    fn image_plane(&self) -> ImagePlane {
        ImagePlane { centre_px: self.centre_px, aspect: self.aspect, upside_down: self.camera.is_upside_down() }
    }

    fn elevation_deg(&self) -> Option<[f64; 2]> {
        self.elevation_deg
    }
}

impl AxialOptics for EllipsoidalOptics {
    fn ray_of_radius(&self, radius_px: f64) -> Option<AxialRay> {
        let psi = (radius_px / self.focal_length_px).atan();
        Some(AxialRay { origin_mm: [0.0; 2], zenith_rad: 2.0 * (self.gain * (0.5 * psi).tan()).atan() })
    }

    fn radius_of_zenith(&self, chi: f64) -> Option<f64> {
        let psi = 2.0 * ((0.5 * chi).tan() / self.gain).atan();
        (psi < FRAC_PI_2).then(|| self.focal_length_px * psi.tan())
    }

    fn focal_length_px(&self) -> f64 {
        self.focal_length_px
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::laws::{assert_rel, camera_laws, golden};

    fn parameters() -> EllipsoidalParameters {
        EllipsoidalParameters {
            a_mm: 60.0,
            c_mm: 30.0,
            focal_length_px: 600.0,
            centre_px: [383.5, 287.5],
            aspect: 1.0,
            camera: CameraSide::Above,
            elevation_deg: None,
        }
    }

    camera_laws!(laws, Ellipsoidal::new(parameters(), [768, 576]).unwrap());

    #[test]
    fn images_are_golden() {
        let (_, golden, tol) = golden("ellipsoid");
        let optics = parameters().optics([768, 576]).unwrap();
        for row in golden.as_array().unwrap() {
            let ray = optics.ray_of_radius(row["r_I"].as_f64().unwrap()).unwrap();
            assert_rel(ray.zenith_rad, &row["chi"], tol);
            assert_rel(optics.radius_of_zenith(ray.zenith_rad).unwrap(), &row["r_I"], tol);
        }
    }

    #[test]
    fn a_hyperboloid_s_lengths_are_named() {
        let error = Ellipsoidal::new(EllipsoidalParameters { c_mm: 61.0, ..parameters() }, [768, 576]).unwrap_err();
        assert!(error.to_string().contains("eccentricity"), "{error}");
    }
}
