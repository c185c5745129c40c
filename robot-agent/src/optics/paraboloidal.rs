//! A convex paraboloidal mirror under an orthographic (telecentric) camera (`model = "paraboloidal"`): a single
//! viewpoint V in its focus, and an exact stereographic picture.
//!
//! z = (p² − r²)/2p about V, camera at +∞: r = p tan(χ/2), χ from z, image radius = magnification · r.
//! Source: Nayar; `MATHS.md` §1.0 and §1.1 (6).

use serde::{Deserialize, Serialize};

use super::ParameterError;
use super::axial::{Axial, AxialDesign, AxialOptics, AxialRay, ImagePlane};
use super::mirror::CameraSide;
use super::parameter::{check_length_mm, check_positive_px, design, one};

/// The parameters of `[paraboloidal]` in `camera.toml`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ParaboloidalParameters {
    /// p: the semi-latus rectum, mm; the mirror's radius at the height of V, twice its focal distance.
    pub p_mm: f64,
    /// Pixels along v in the picture for a millimetre at the mirror.
    pub magnification_px_per_mm: f64,
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

design!(ParaboloidalParameters: p_mm, magnification_px_per_mm, centre_px, aspect);

/// A paraboloidal camera, validated.
pub type Paraboloidal = Axial<ParaboloidalParameters>;

/// The mirror and its camera in a meridian half-plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ParaboloidalOptics {
    p_mm: f64,
    magnification_px_per_mm: f64,
}

impl AxialDesign for ParaboloidalParameters {
    const MODEL: &'static str = "paraboloidal";
    type Optics = ParaboloidalOptics;

    fn optics(&self, _image_size_px: [u32; 2]) -> Result<ParaboloidalOptics, ParameterError> {
        let Self { p_mm, magnification_px_per_mm, .. } = *self;
        check_length_mm("p_mm", p_mm)?;
        check_positive_px("magnification_px_per_mm", magnification_px_per_mm)?;
        Ok(ParaboloidalOptics { p_mm, magnification_px_per_mm })
    }

    fn image_plane(&self) -> ImagePlane {
        ImagePlane { centre_px: self.centre_px, aspect: self.aspect, upside_down: self.camera.is_upside_down() }
    }

    fn elevation_deg(&self) -> Option<[f64; 2]> {
        self.elevation_deg
    }
}

impl AxialOptics for ParaboloidalOptics {
    fn ray_of_radius(&self, radius_px: f64) -> Option<AxialRay> {
        let (r, p) = (radius_px / self.magnification_px_per_mm, self.p_mm);
        Some(AxialRay { origin_mm: [r, (p * p - r * r) / (2.0 * p)], zenith_rad: 2.0 * (r / p).atan() })
    }

    fn radius_of_zenith(&self, chi: f64) -> Option<f64> {
        // tan(χ/2) by the half angle's cotangent would lose digits near π, where there is no mirror of any real size.
        let r = self.p_mm * (0.5 * chi).tan();
        (r >= 0.0 && r < 1e3 * self.p_mm).then_some(self.magnification_px_per_mm * r)
    }

    fn radius_of_point(&self, r_mm: f64, z_mm: f64) -> Option<f64> {
        let chi = r_mm.atan2(z_mm);
        (r_mm.hypot(z_mm) >= self.p_mm / (1.0 + chi.cos())).then_some(())?;
        self.radius_of_zenith(chi)
    }

    /// That of the unified sphere with ξ = 1: px along v at χ = 90°.
    fn focal_length_px(&self) -> f64 {
        self.magnification_px_per_mm * self.p_mm
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::laws::{assert_rel, camera_laws, golden};

    fn parameters() -> ParaboloidalParameters {
        ParaboloidalParameters {
            p_mm: 30.0,
            magnification_px_per_mm: 7.5,
            centre_px: [383.5, 287.5],
            aspect: 1.0,
            camera: CameraSide::Above,
            elevation_deg: None,
        }
    }

    camera_laws!(laws, Paraboloidal::new(parameters(), [768, 576]).unwrap());

    #[test]
    fn images_and_mirror_points_are_golden() {
        let (_, golden, tol) = golden("paraboloid");
        let optics = parameters().optics([768, 576]).unwrap();
        for row in golden.as_array().unwrap() {
            let radius_px = 7.5 * row["r_mirror"].as_f64().unwrap();
            let ray = optics.ray_of_radius(radius_px).unwrap();
            assert_rel(ray.zenith_rad, &row["chi"], tol);
            assert_rel(ray.origin_mm[1], &row["z"], tol);
            assert_rel(optics.radius_of_zenith(ray.zenith_rad).unwrap() / 7.5, &row["r_mirror"], tol);
        }
    }

    #[test]
    fn moving_the_mirror_across_its_camera_only_moves_the_picture() {
        // An orthographic camera has no point to be off: the same rays, shifted by the magnification.
        let moved = ParaboloidalParameters { centre_px: [383.5 + 7.5 * 2.0, 287.5], ..parameters() };
        let (still, moved) = (Paraboloidal::new(parameters(), [768, 576]), Paraboloidal::new(moved, [768, 576]));
        use crate::optics::Camera;
        let direction = nalgebra::Vector3::new(0.6, -0.3, 0.2);
        let shift = moved.unwrap().project_direction(&direction).unwrap()
            - still.unwrap().project_direction(&direction).unwrap();
        assert!((shift - nalgebra::Vector2::new(15.0, 0.0)).norm() < 1e-9);
    }
}
