//! A convex hyperboloidal mirror with the pinhole in its other focus (`model = "hyperboloidal"`): a single viewpoint V
//! in the focus inside the mirror.
//!
//! The optics' axis z runs from V to the pinhole at 2c; χ is the angle of a ray from it, ψ that of its image ray:
//! tan(χ/2) = (e+1)/(e−1) · tan(ψ/2), r_I = f tan ψ. Source: `MATHS.md` §1.0 and §1.1 (5).

use serde::{Deserialize, Serialize};

use super::ParameterError;
use super::axial::{Axial, AxialDesign, AxialOptics, AxialRay, ImagePlane};
use super::mirror::CameraSide;
use super::parameter::{check_length_mm, check_positive_px, design, one};

/// The parameters of `[hyperboloidal]` in `camera.toml`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HyperboloidalParameters {
    /// a: half of the distance between the sheets' vertices, mm.
    #[serde(alias = "hyperboloid_a_mm")]
    pub a_mm: f64,
    /// c: half of the distance between V and the pinhole, mm; > a.
    #[serde(alias = "hyperboloid_c_mm")]
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

design!(HyperboloidalParameters: a_mm, c_mm, focal_length_px, centre_px, aspect);

/// A hyperboloidal camera, validated.
pub type Hyperboloidal = Axial<HyperboloidalParameters>;

/// The mirror and its pinhole in a meridian half-plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HyperboloidalOptics {
    a_mm: f64,
    c_mm: f64,
    focal_length_px: f64,
    /// (e + 1)/(e − 1).
    gain: f64,
}

impl AxialDesign for HyperboloidalParameters {
    const MODEL: &'static str = "hyperboloidal";
    type Optics = HyperboloidalOptics;

    fn optics(&self, _image_size_px: [u32; 2]) -> Result<HyperboloidalOptics, ParameterError> {
        let Self { a_mm, c_mm, focal_length_px, .. } = *self;
        check_length_mm("a_mm", a_mm)?;
        check_length_mm("c_mm", c_mm)?;
        check_positive_px("focal_length_px", focal_length_px)?;
        if c_mm <= a_mm {
            let expected = "more than a_mm (a hyperboloid has an eccentricity c/a above 1)";
            return Err(ParameterError::new("c_mm", c_mm, expected));
        }
        Ok(HyperboloidalOptics { a_mm, c_mm, focal_length_px, gain: (c_mm + a_mm) / (c_mm - a_mm) })
    }

    fn image_plane(&self) -> ImagePlane {
        ImagePlane { centre_px: self.centre_px, aspect: self.aspect, upside_down: self.camera.is_upside_down() }
    }

    fn elevation_deg(&self) -> Option<[f64; 2]> {
        self.elevation_deg
    }
}

impl HyperboloidalOptics {
    /// |VM| along a ray; `None` at the asymptote's angle and beyond, where there is no mirror.
    fn distance_mm(&self, chi: f64) -> Option<f64> {
        let Self { a_mm: a, c_mm: c, .. } = *self;
        let d = (c * c - a * a) / (a + c * chi.cos());
        (d > 0.0 && d.is_finite()).then_some(d)
    }
}

impl AxialOptics for HyperboloidalOptics {
    fn ray_of_radius(&self, radius_px: f64) -> Option<AxialRay> {
        let psi = (radius_px / self.focal_length_px).atan();
        let chi = 2.0 * (self.gain * (0.5 * psi).tan()).atan();
        let d = self.distance_mm(chi)?;
        Some(AxialRay { origin_mm: [d * chi.sin(), d * chi.cos()], zenith_rad: chi })
    }

    fn radius_of_zenith(&self, chi: f64) -> Option<f64> {
        self.distance_mm(chi)?;
        let psi = 2.0 * ((0.5 * chi).tan() / self.gain).atan();
        Some(self.focal_length_px * psi.tan())
    }

    fn radius_of_point(&self, r_mm: f64, z_mm: f64) -> Option<f64> {
        let chi = r_mm.atan2(z_mm);
        (r_mm.hypot(z_mm) >= self.distance_mm(chi)?).then_some(())?;
        self.radius_of_zenith(chi)
    }

    fn focal_length_px(&self) -> f64 {
        self.focal_length_px
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::optics::Camera;
    use crate::optics::laws::{assert_rel, camera_laws, golden};

    fn parameters() -> HyperboloidalParameters {
        HyperboloidalParameters {
            a_mm: 28.0955,
            c_mm: 38.658,
            focal_length_px: 600.0,
            centre_px: [383.5, 287.5],
            aspect: 1.0,
            camera: CameraSide::Above,
            elevation_deg: None,
        }
    }

    fn camera(change: impl FnOnce(&mut HyperboloidalParameters)) -> Hyperboloidal {
        let mut parameters = parameters();
        change(&mut parameters);
        Hyperboloidal::new(parameters, [768, 576]).unwrap()
    }

    camera_laws!(looked_at_from_above, camera(|_| {}));
    camera_laws!(
        looked_at_from_below,
        camera(|p| {
            p.camera = CameraSide::Below;
            p.aspect = 1.02;
            p.elevation_deg = Some([-40.0, 15.0]);
        })
    );

    #[test]
    fn images_and_mirror_points_are_golden() {
        let (_, golden, tol) = golden("hyperboloid");
        let optics = *camera(|_| {}).optics();
        for row in golden.as_array().unwrap() {
            let ray = optics.ray_of_radius(row["r_I"].as_f64().unwrap()).unwrap();
            assert_rel(ray.zenith_rad, &row["chi"], tol);
            assert_rel(ray.origin_mm[0], &row["mirror"][0], tol);
            assert_rel(ray.origin_mm[1], &row["mirror"][1], tol);
            assert_rel(optics.radius_of_zenith(ray.zenith_rad).unwrap(), &row["r_I"], tol);
        }
    }

    #[test]
    fn a_camera_below_its_mirror_sees_the_floor_in_the_middle() {
        let down = Vector3::new(0.0, 0.0, -1.0);
        let pixel = camera(|p| p.camera = CameraSide::Below).project_direction(&down).unwrap();
        assert!((pixel.x - 383.5).abs() < 1e-9 && (pixel.y - 287.5).abs() < 1e-9);
        assert!(camera(|_| {}).project_direction(&down).is_none());
    }

    #[test]
    fn a_point_inside_the_mirror_has_no_image() {
        assert!(camera(|_| {}).project(&Vector3::new(0.001, 0.0, 0.001)).is_none());
    }

    #[test]
    fn an_ellipsoid_s_lengths_are_named() {
        let wrong = HyperboloidalParameters { c_mm: 20.0, ..parameters() };
        let error = Hyperboloidal::new(wrong, [768, 576]).unwrap_err();
        assert!(error.to_string().contains("eccentricity"), "{error}");
    }
}
