//! A spherical mirror under a pinhole camera (`model = "spherical"`): no single viewpoint, but a caustic inside the ball.
//!
//! Sphere of radius ρ about the origin, pinhole at (0, h): incidence sin i = (h/ρ) sin ψ, mirror point at μ = i − ψ from
//! the axis, ray at ζ = 2i − ψ. Source: `MATHS.md` §1.1 (3).

use std::f64::consts::FRAC_PI_2;

use serde::{Deserialize, Serialize};

use super::ParameterError;
use super::axial::{Axial, AxialDesign, AxialOptics, AxialRay, ImagePlane};
use super::mirror::CameraSide;
use super::parameter::{check_length_mm, check_positive_px, design, one};
use super::root::root;

/// The field of view ends this much before grazing incidence, where a pixel says nothing about its angle.
const GRAZING_MARGIN_RAD: f64 = 1e-3;

/// The parameters of `[spherical]` in `camera.toml`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SphericalParameters {
    /// ρ: the sphere's radius, mm.
    #[serde(alias = "radius_mm")]
    pub rho_mm: f64,
    /// h: from the sphere's centre to the pinhole, mm; > ρ.
    pub h_mm: f64,
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

design!(SphericalParameters: rho_mm, h_mm, focal_length_px, centre_px, aspect);

/// A spherical camera, validated.
pub type Spherical = Axial<SphericalParameters>;

/// The mirror and its pinhole in a meridian half-plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SphericalOptics {
    rho_mm: f64,
    h_mm: f64,
    focal_length_px: f64,
}

impl AxialDesign for SphericalParameters {
    const MODEL: &'static str = "spherical";
    type Optics = SphericalOptics;

    fn optics(&self, _image_size_px: [u32; 2]) -> Result<SphericalOptics, ParameterError> {
        let Self { rho_mm, h_mm, focal_length_px, .. } = *self;
        check_length_mm("rho_mm", rho_mm)?;
        check_length_mm("h_mm", h_mm)?;
        check_positive_px("focal_length_px", focal_length_px)?;
        if h_mm <= rho_mm {
            let expected = "more than rho_mm (the pinhole would be inside the mirror)";
            return Err(ParameterError::new("h_mm", h_mm, expected));
        }
        Ok(SphericalOptics { rho_mm, h_mm, focal_length_px })
    }

    fn image_plane(&self) -> ImagePlane {
        ImagePlane { centre_px: self.centre_px, aspect: self.aspect, upside_down: self.camera.is_upside_down() }
    }

    fn elevation_deg(&self) -> Option<[f64; 2]> {
        self.elevation_deg
    }
}

impl SphericalOptics {
    /// The ray with an angle of incidence i in [0, π/2).
    fn ray_of_incidence(&self, i: f64) -> AxialRay {
        let psi = (self.rho_mm / self.h_mm * i.sin()).asin();
        let (sin, cos) = (i - psi).sin_cos();
        AxialRay { origin_mm: [self.rho_mm * sin, self.rho_mm * cos], zenith_rad: 2.0 * i - psi }
    }

    fn radius_of_incidence(&self, i: f64) -> Option<f64> {
        let psi = (self.rho_mm / self.h_mm * i.sin()).asin();
        (i <= FRAC_PI_2 - GRAZING_MARGIN_RAD).then(|| self.focal_length_px * psi.tan())
    }
}

impl AxialOptics for SphericalOptics {
    fn ray_of_radius(&self, radius_px: f64) -> Option<AxialRay> {
        let psi = (radius_px / self.focal_length_px).atan();
        let i = (self.h_mm / self.rho_mm * psi.sin()).asin();
        (i <= FRAC_PI_2 - GRAZING_MARGIN_RAD).then(|| self.ray_of_incidence(i))
    }

    fn radius_of_zenith(&self, zeta: f64) -> Option<f64> {
        // ζ(i) = 2i − ψ(i) rises with a slope between 1 and 2.
        let ratio = self.rho_mm / self.h_mm;
        let i = root(0.0, FRAC_PI_2, 0.5 * zeta, |i| {
            let sin = ratio * i.sin();
            (2.0 * i - sin.asin() - zeta, 2.0 - ratio * i.cos() / (1.0 - sin * sin).sqrt())
        })?;
        self.radius_of_incidence(i)
    }

    fn radius_of_point(&self, r_mm: f64, z_mm: f64) -> Option<f64> {
        let (rho, h) = (self.rho_mm, self.h_mm);
        (r_mm.hypot(z_mm) > rho).then_some(())?;
        if r_mm == 0.0 {
            return (z_mm > 0.0).then_some(0.0);
        }
        // G(μ) of MATHS: negative on the axis, positive where the mirror's normal points at the point.
        let mu = root(0.0, r_mm.atan2(z_mm), 0.5 * r_mm.atan2(z_mm), |mu| {
            let ((sin, cos), (sin2, cos2)) = (mu.sin_cos(), (2.0 * mu).sin_cos());
            let value = h * z_mm * sin2 - h * r_mm * cos2 - rho * (h + z_mm) * sin + rho * r_mm * cos;
            let slope = 2.0 * h * (z_mm * cos2 + r_mm * sin2) - rho * ((h + z_mm) * cos + r_mm * sin);
            (value, slope)
        })?;
        let psi = (rho * mu.sin()).atan2(h - rho * mu.cos());
        self.radius_of_incidence(mu + psi)
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
    use nalgebra::Vector3;

    use super::*;
    use crate::optics::Camera;
    use crate::optics::axial::{axis_crossing_mm, caustic_mm};
    use crate::optics::laws::{assert_rel, camera_laws, golden};

    fn parameters() -> SphericalParameters {
        SphericalParameters {
            rho_mm: 40.0,
            h_mm: 120.0,
            focal_length_px: 900.0,
            centre_px: [383.5, 287.5],
            aspect: 1.0,
            camera: CameraSide::Above,
            elevation_deg: None,
        }
    }

    fn camera() -> Spherical {
        Spherical::new(parameters(), [768, 576]).unwrap()
    }

    camera_laws!(laws, camera());
    camera_laws!(
        laws_from_below,
        Spherical::new(
            SphericalParameters { camera: CameraSide::Below, elevation_deg: Some([-45.0, 30.0]), ..parameters() },
            [768, 576]
        )
        .unwrap()
    );

    #[test]
    fn rays_caustic_and_images_are_golden() {
        let (_, golden, tol) = golden("sphere");
        let optics = *camera().optics();
        for row in golden.as_array().unwrap() {
            let radius = row["r_I"].as_f64().unwrap();
            let ray = optics.ray_of_radius(radius).unwrap();
            assert_rel(ray.zenith_rad, &row["zeta"], tol);
            assert_rel(ray.origin_mm[0].atan2(ray.origin_mm[1]), &row["mu"], tol);
            assert_rel(axis_crossing_mm(&ray), &row["z_axis"], tol);
            for i in 0..2 {
                assert_rel(ray.origin_mm[i], &row["M"][i], tol);
                // By differences of rays, not the closed form.
                assert_rel(caustic_mm(&optics, radius).unwrap()[i], &row["caustic"][i], 1e-7);
            }
            let [r, z] = [0, 1].map(|i| row["P"][i].as_f64().unwrap());
            assert_rel(optics.radius_of_point(r, z).unwrap(), &row["r_I"], tol);
            assert_rel(optics.radius_of_zenith(ray.zenith_rad).unwrap(), &row["r_I"], tol);
        }
    }

    #[test]
    fn points_inside_and_behind_the_ball_have_no_image() {
        for point in [[0.0, 0.0, 0.02], [0.0, 0.0, -1.0], [0.03, 0.0, 0.02]] {
            assert!(camera().project(&Vector3::from(point)).is_none(), "{point:?}");
        }
    }

    #[test]
    fn a_mirror_that_contains_its_camera_is_an_error() {
        let error = Spherical::new(SphericalParameters { h_mm: 35.0, ..parameters() }, [768, 576]).unwrap_err();
        assert!(error.to_string().contains("inside the mirror"), "{error}");
    }
}
