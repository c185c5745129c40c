//! A PAL for an orthographic (telecentric) camera: its second mirror is a paraboloid (`model = "pal-orthographic"`).
//!
//! Light leaves the second mirror along the axis at a distance r_p, and tan(ζ/2) = K_o r_p with
//! K_o = (1 + e_e)/((1 − e_e) p): the picture is exactly stereographic up to the window. It is the limit c_h → ∞ of the
//! perspective PAL. Source: report 3.5, `MATHS.md` §3.1.

use serde::{Deserialize, Serialize};

use super::{MeridianRay, Window, check_ellipsoid, check_glass, check_horizon, check_window};
use crate::optics::ParameterError;
use crate::optics::axial::{Axial, AxialDesign, AxialOptics, AxialRay, ImagePlane};
use crate::optics::parameter::{check_elevations, check_length_mm, check_positive_px, design, one};

/// The parameters of `[pal-orthographic]` in `camera.toml`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PalOrthographicDesign {
    /// a_e of the first mirror, mm; > c_e.
    pub ellipsoid_a_mm: f64,
    /// c_e of the first mirror, mm; > 0.
    pub ellipsoid_c_mm: f64,
    /// p: the semi-latus rectum of the second mirror, mm.
    #[serde(alias = "p_mm")]
    pub paraboloid_p_mm: f64,
    /// Pixels along v in the picture for a millimetre at the second mirror.
    pub magnification_px_per_mm: f64,
    /// a_R of the refracting ellipsoid, mm.
    pub refraction_a_mm: f64,
    /// e_R of the refracting ellipsoid, in [0, 1).
    pub refraction_eccentricity: f64,
    /// n of the glass against air, ≥ 1.
    pub refractive_index: f64,
    /// (u₀, v₀): the image of the axis, px.
    pub centre_px: [f64; 2],
    /// Pixels along u for one along v.
    #[serde(default = "one")]
    pub aspect: f64,
    /// Elevations [lowest, highest] that the annulus shows, degrees.
    pub elevation_deg: [f64; 2],
}

design!(
    PalOrthographicDesign: ellipsoid_a_mm,
    ellipsoid_c_mm,
    paraboloid_p_mm,
    magnification_px_per_mm,
    refraction_a_mm,
    refraction_eccentricity,
    refractive_index,
    centre_px,
    aspect,
);

/// An orthographic PAL camera, validated.
pub type PalOrthographic = Axial<PalOrthographicDesign>;

/// The optics in a meridian half-plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OrthographicMeridian {
    /// K_o/m: tan(ζ/2) a pixel.
    gain_per_px: f64,
    window: Window,
}

impl AxialDesign for PalOrthographicDesign {
    const MODEL: &'static str = "pal-orthographic";
    type Optics = OrthographicMeridian;

    fn optics(&self, _image_size_px: [u32; 2]) -> Result<OrthographicMeridian, ParameterError> {
        check_ellipsoid(self.ellipsoid_a_mm, self.ellipsoid_c_mm)?;
        check_length_mm("paraboloid_p_mm", self.paraboloid_p_mm)?;
        check_positive_px("magnification_px_per_mm", self.magnification_px_per_mm)?;
        check_window(self.refraction_a_mm, self.refraction_eccentricity)?;
        check_glass(self.refractive_index)?;
        check_elevations(self.elevation_deg)?;
        let window = Window::new(self.refraction_a_mm, self.refraction_eccentricity, self.refractive_index);
        check_horizon(&window, self.elevation_deg)?;
        let gain_per_px = self.half_angle_gain_per_mm() / self.magnification_px_per_mm;
        Ok(OrthographicMeridian { gain_per_px, window })
    }

    fn image_plane(&self) -> ImagePlane {
        ImagePlane { centre_px: self.centre_px, aspect: self.aspect, upside_down: false }
    }

    fn elevation_deg(&self) -> Option<[f64; 2]> {
        Some(self.elevation_deg)
    }
}

impl PalOrthographicDesign {
    /// K_o, for r at the second mirror.
    pub fn half_angle_gain_per_mm(&self) -> f64 {
        let e = self.ellipsoid_c_mm / self.ellipsoid_a_mm;
        (1.0 + e) / ((1.0 - e) * self.paraboloid_p_mm)
    }
}

impl OrthographicMeridian {
    fn radius_of_ray(&self, ray: &MeridianRay) -> f64 {
        (0.5 * ray.zeta_in).tan() / self.gain_per_px
    }
}

impl AxialOptics for OrthographicMeridian {
    fn ray_of_radius(&self, radius_px: f64) -> Option<AxialRay> {
        self.window.ray_of_zenith_inside(2.0 * (self.gain_per_px * radius_px).atan()).map(AxialRay::from)
    }

    fn radius_of_zenith(&self, zenith_rad: f64) -> Option<f64> {
        Some(self.radius_of_ray(&self.window.ray_of_zenith(zenith_rad)?))
    }

    fn radius_of_point(&self, r_mm: f64, z_mm: f64) -> Option<f64> {
        Some(self.radius_of_ray(&self.window.ray_of_point(r_mm, z_mm)?))
    }

    fn single_viewpoint_mm(&self) -> Option<f64> {
        None
    }

    /// That of the unified sphere with ξ = 1: px along v at ζ_in = 90°.
    fn focal_length_px(&self) -> f64 {
        1.0 / self.gain_per_px
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::optics::laws::{assert_rel, camera_laws, golden};
    use crate::optics::{Camera, Pal, PalDesign};

    fn design() -> PalOrthographicDesign {
        PalOrthographicDesign {
            ellipsoid_a_mm: 23.8095238095,
            ellipsoid_c_mm: 9.52380952381,
            paraboloid_p_mm: 20.0,
            magnification_px_per_mm: 34.0,
            refraction_a_mm: 31.25,
            refraction_eccentricity: 0.6,
            refractive_index: 1.5168,
            centre_px: [383.5, 287.5],
            aspect: 1.0,
            elevation_deg: [-15.0, 20.0],
        }
    }

    camera_laws!(laws, PalOrthographic::new(design(), [768, 576]).unwrap());

    #[test]
    fn zenith_angles_inside_the_glass_are_golden() {
        let (inputs, golden, tol) = golden("pal.orthographic");
        let design = PalOrthographicDesign { ellipsoid_c_mm: 0.4 * 23.8095238095, paraboloid_p_mm: 10.0, ..design() };
        assert_rel(design.half_angle_gain_per_mm(), &golden["Ko"], tol);
        // Without bending the window lets ζ through as it is.
        let bare = PalOrthographicDesign { refractive_index: 1.0, elevation_deg: [5.0, 60.0], ..design };
        let camera = PalOrthographic::new(bare, [768, 576]).unwrap();
        for (r, zeta) in inputs["r_I"].as_array().unwrap().iter().zip(golden["zeta"].as_array().unwrap()) {
            let ray = camera.optics().ray_of_radius(34.0 * r.as_f64().unwrap()).unwrap();
            assert_rel(ray.zenith_rad, zeta, tol);
        }
    }

    #[test]
    fn it_is_the_limit_of_a_perspective_pal_with_a_far_pinhole() {
        // p = b_h²/a_h, so e_h → 1; r_I = m r_p becomes f tan ψ with tan(ζ/2) = K tan(ψ/2) = K_o r_p.
        let (p, c) = (20.0, 9e3_f64);
        // a = −p/2 + √(p²/4 + c²) solves (c² − a²)/a = p.
        let a = -0.5 * p + (0.25 * p * p + c * c).sqrt();
        let orthographic = PalOrthographic::new(design(), [768, 576]).unwrap();
        let gain = design().half_angle_gain_per_mm();
        let e_h = c / a;
        let k = (1.0 + 0.4) / (1.0 - 0.4) * (e_h + 1.0) / (e_h - 1.0);
        let far = PalDesign {
            hyperboloid_a_mm: a,
            hyperboloid_c_mm: c,
            focal_length_px: 34.0 * k / (2.0 * gain),
            ..PalDesign::REFERENCE
        };
        let perspective = Pal::new(far, [768, 576]).unwrap();
        let point = Vector3::new(2.0, 0.7, 0.3);
        let off = (orthographic.project(&point).unwrap() - perspective.project(&point).unwrap()).norm();
        assert!(off < 1e-3, "{off} px");
    }
}
