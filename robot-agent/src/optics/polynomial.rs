//! Scaramuzza's polynomial camera, as OCamCalib writes it (`model = "polynomial"`).
//!
//! OCamCalib's axes are (row, column, backward); here they are (column, row, forward) = (x, y, z), so its ray
//! (x', y', f(ρ)) is (x, y, −f(ρ)) with ρ = |(x, y)| in pixels, and f(0) < 0 for a camera that looks along its z.
//!
//! Problem: OCamCalib gives two polynomials, f for pixel → ray and an approximate inverse for ray → pixel, which differ
//! by up to a tenth of a pixel, so that a point would not come back where it was. Insight: one of them is the camera,
//! the other only where Newton starts. Here `forward` is the camera where it is given and `inverse` must agree with it;
//! with `inverse` alone, that is the camera.
//! Source: Scaramuzza, Martinelli and Siegwart 2006; OCamCalib's `cam2world` and `world2cam`.

use std::f64::consts::{FRAC_PI_2, PI};
use std::sync::OnceLock;

use nalgebra::{Matrix2, Matrix2x3, RowVector3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::axial::is_somewhere;
use super::parameter::{Design, Numbers, camera_by_design, check_centre, check_finite};
use super::root::root;
use super::{Camera, NormalisedPlane, ParameterError, Ray, elevations_on_the_picture, is_in_image};

/// Furthest that `inverse` may be off `forward` on the picture before they belong to different cameras, px.
const MAX_DISAGREEMENT_PX: f64 = 2.0;
/// More coefficients than this are a mistake.
const MAX_COEFFICIENTS: usize = 32;

/// The parameters of `[polynomial]` in `camera.toml`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolynomialParameters {
    /// OCamCalib's `ss`, ascending: f(ρ) = ss₀ + ss₁ρ + ss₂ρ² + … with ρ in px.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub forward: Vec<f64>,
    /// OCamCalib's `invpol`, ascending: ρ(θ) = p₀ + p₁θ + p₂θ² + … with θ = atan(f/ρ), minus the elevation here.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub inverse: Vec<f64>,
    /// (u₀, v₀), px: OCamCalib's (yc, xc), counted from 0.
    pub centre_px: [f64; 2],
    /// c, d, e: v = c·y + d·x + v₀, u = e·y + x + u₀.
    #[serde(default = "identity")]
    pub affine: [f64; 3],
}

fn identity() -> [f64; 3] {
    [1.0, 0.0, 0.0]
}

impl Design for PolynomialParameters {
    /// Only the polynomial that is the camera.
    fn visit(&mut self, visitor: &mut dyn FnMut(&str, &mut f64)) {
        if self.forward.is_empty() {
            self.inverse.visit("inverse", visitor);
        } else {
            self.forward.visit("forward", visitor);
        }
        self.centre_px.visit("centre_px", visitor);
        self.affine.visit("affine", visitor);
    }

    /// An inverse that was computed for the old numbers goes.
    fn with_values(&self, values: &[f64]) -> Self {
        let mut design = self.clone();
        let mut values = values.iter();
        design.visit(&mut |_, number| *number = values.next().copied().unwrap_or(*number));
        if design.forward != self.forward {
            design.inverse.clear();
        }
        design
    }
}

/// A polynomial camera, validated.
#[derive(Debug, Clone, PartialEq)]
pub struct Polynomial {
    parameters: PolynomialParameters,
    image_size_px: [u32; 2],
    /// Largest ρ, px, up to which the angle off the axis grows with ρ.
    limit_px: f64,
    elevation_rad: OnceLock<[f64; 2]>,
}

impl Polynomial {
    /// Checks that the parameters make a camera.
    ///
    /// # Errors
    /// The first parameter that makes that impossible.
    pub fn new(parameters: PolynomialParameters, image_size_px: [u32; 2]) -> Result<Self, ParameterError> {
        let p = &parameters;
        for (key, list) in [("forward", &p.forward), ("inverse", &p.inverse)] {
            check_finite(key, list, "ascending coefficients")?;
            if list.len() > MAX_COEFFICIENTS {
                let expected = format!("at most {MAX_COEFFICIENTS} coefficients");
                return Err(ParameterError::new(key, format!("{} coefficients", list.len()), expected));
            }
        }
        if p.forward.is_empty() && p.inverse.is_empty() {
            return Err(ParameterError::new("forward", &p.forward, "OCamCalib's ss (or give inverse, its invpol)"));
        }
        if p.forward.first().is_some_and(|f| *f >= 0.0) {
            let expected = "coefficients with the first below 0, as OCamCalib's ss (ascending: is it reversed?)";
            return Err(ParameterError::new("forward", &p.forward, expected));
        }
        check_centre(p.centre_px, image_size_px)?;
        let [c, d, e] = p.affine;
        if !(c > 0.2 && c < 5.0 && d.abs() < 0.5 && e.abs() < 0.5) {
            return Err(ParameterError::new("affine", p.affine, "[c, d, e] near [1, 0, 0]"));
        }
        let mut camera = Self { image_size_px, limit_px: 0.0, elevation_rad: OnceLock::new(), parameters };
        camera.limit_px = camera.find_limit();
        if camera.limit_px < 4.0 {
            let key = if camera.parameters.forward.is_empty() { "inverse" } else { "forward" };
            let expected = "a polynomial whose angle off the axis grows with the radius";
            return Err(ParameterError::new(key, camera.polynomial(), expected));
        }
        camera.check_agreement()?;
        Ok(camera)
    }

    /// The parameters.
    pub fn design(&self) -> &PolynomialParameters {
        &self.parameters
    }

    /// The coefficients that are the camera.
    fn polynomial(&self) -> &[f64] {
        if self.parameters.forward.is_empty() { &self.parameters.inverse } else { &self.parameters.forward }
    }

    /// The largest distance (px) on the picture between the images by `inverse` and by `forward`; 0 where only one is
    /// given.
    pub fn disagreement_px(&self) -> f64 {
        const STEPS: u32 = 256;
        if self.parameters.forward.is_empty() || self.parameters.inverse.is_empty() {
            return 0.0;
        }
        let reach = self.limit_px.min(self.reach_px());
        (1..=STEPS)
            .map(|i| {
                let rho = reach * f64::from(i) / f64::from(STEPS);
                let theta = horner(&self.parameters.forward, rho).0.atan2(rho);
                (horner(&self.parameters.inverse, theta).0 - rho).abs()
            })
            .fold(0.0, f64::max)
    }

    fn check_agreement(&self) -> Result<(), ParameterError> {
        let off = self.disagreement_px();
        if off <= MAX_DISAGREEMENT_PX {
            return Ok(());
        }
        let expected =
            format!("the inverse of forward: they are up to {off:.1} px apart (leave it out, or see its order)");
        Err(ParameterError::new("inverse", &self.parameters.inverse, expected))
    }

    /// Distance from the centre to the farthest corner, px.
    fn reach_px(&self) -> f64 {
        let [w, h] = self.image_size_px.map(f64::from);
        let corners = [[-0.5, -0.5], [w - 0.5, -0.5], [-0.5, h - 0.5], [w - 0.5, h - 0.5]];
        corners.iter().map(|c| self.ideal(&Vector2::from(*c)).norm()).fold(0.0, f64::max)
    }

    /// Where the angle stops growing with the radius: for f, where f − ρf′ ≥ 0; for the inverse, where ρ stops growing.
    fn find_limit(&self) -> f64 {
        const STEPS: u32 = 2000;
        if self.parameters.forward.is_empty() {
            let mut rho = 0.0;
            for i in 0..=STEPS {
                let theta = -FRAC_PI_2 + PI * f64::from(i) / f64::from(STEPS);
                let (value, slope) = horner(&self.parameters.inverse, theta);
                if slope <= 0.0 {
                    break;
                }
                rho = value;
            }
            return rho;
        }
        // The picture's corners are far enough, with room for what a calibration tries.
        let reach = 2.0 * self.reach_px();
        let turns = |rho: f64| {
            let (f, slope) = horner(&self.parameters.forward, rho);
            f - rho * slope >= 0.0
        };
        let step = reach / f64::from(STEPS);
        let first = (0..=STEPS).map(|i| f64::from(i) * step).find(|rho| turns(*rho));
        first.map_or(reach, |rho| (rho - step).max(0.0))
    }

    fn affine(&self) -> Matrix2<f64> {
        let [c, d, e] = self.parameters.affine;
        Matrix2::new(1.0, e, d, c)
    }

    /// Offset from the centre without the affine part.
    fn ideal(&self, pixel: &Vector2<f64>) -> Vector2<f64> {
        let offset = pixel - Vector2::from(self.parameters.centre_px);
        let [c, d, e] = self.parameters.affine;
        Vector2::new(c * offset.x - e * offset.y, offset.y - d * offset.x) / (c - d * e)
    }

    /// OCamCalib's θ for a radius: its root where only the inverse is given.
    fn theta_of_radius(&self, rho: f64) -> Option<f64> {
        (rho <= self.limit_px).then_some(())?;
        if !self.parameters.forward.is_empty() {
            return Some(horner(&self.parameters.forward, rho).0.atan2(rho));
        }
        let inverse = &self.parameters.inverse;
        // Nearer than the image of the axis there is nothing.
        (rho >= horner(inverse, -FRAC_PI_2).0).then_some(())?;
        root(-FRAC_PI_2, FRAC_PI_2, -FRAC_PI_2 + rho / self.limit_px, |theta| {
            let (value, slope) = horner(inverse, theta);
            if value > self.limit_px || slope <= 0.0 { (f64::INFINITY, 1.0) } else { (value - rho, slope) }
        })
    }

    /// ρ for OCamCalib's θ.
    fn radius_of_theta(&self, theta: f64) -> Option<f64> {
        if self.parameters.forward.is_empty() {
            let (rho, slope) = horner(&self.parameters.inverse, theta);
            return (slope > 0.0 && rho <= self.limit_px && rho >= 0.0).then_some(rho);
        }
        let forward = &self.parameters.forward;
        let (sin, cos) = theta.sin_cos();
        // f(ρ) cos θ = ρ sin θ; the left minus the right rises along ρ where the angle does.
        let miss = |rho: f64| {
            let (f, slope) = horner(forward, rho);
            (f * cos - rho * sin, slope * cos - sin)
        };
        (miss(self.limit_px).0 >= 0.0).then_some(())?;
        let start = if self.parameters.inverse.is_empty() {
            -forward[0] * cos / (1.0 - sin)
        } else {
            horner(&self.parameters.inverse, theta).0
        };
        root(0.0, self.limit_px, start, miss)
    }
}

/// A polynomial with ascending coefficients, and its derivative.
fn horner(coefficients: &[f64], x: f64) -> (f64, f64) {
    coefficients.iter().rev().fold((0.0, 0.0), |(value, slope), c| (value * x + c, slope * x + value))
}

impl Camera for Polynomial {
    camera_by_design!("polynomial");

    fn image_of_point(&self, point_m: &Vector3<f64>) -> Option<Vector2<f64>> {
        is_somewhere(point_m).then_some(())?;
        let radius = point_m.x.hypot(point_m.y);
        let rho = self.radius_of_theta((-point_m.z).atan2(radius))?;
        let azimuth = if radius > 0.0 { point_m.xy() / radius } else { Vector2::x() };
        Some(self.affine() * azimuth * rho + Vector2::from(self.parameters.centre_px))
    }

    fn image_of_direction(&self, direction: &Vector3<f64>) -> Option<Vector2<f64>> {
        self.image_of_point(direction)
    }

    /// With ρ(θ) and tan θ = −z/r; for OCamCalib's f, f(ρ) cos θ = ρ sin θ gives dρ/dθ = (f sin θ + ρ cos θ)/(f′ cos θ − sin θ).
    fn point_jacobian(&self, point_m: &Vector3<f64>) -> Option<Matrix2x3<f64>> {
        is_somewhere(point_m).then_some(())?;
        let radius = point_m.x.hypot(point_m.y);
        let theta = (-point_m.z).atan2(radius);
        let rho = self.radius_of_theta(theta)?;
        let by_theta = if self.parameters.forward.is_empty() {
            horner(&self.parameters.inverse, theta).1
        } else {
            let ((f, slope), (sin, cos)) = (horner(&self.parameters.forward, rho), theta.sin_cos());
            (f * sin + rho * cos) / (slope * cos - sin)
        };
        by_theta.is_finite().then_some(())?;
        let square = point_m.norm_squared();
        let (by_r, by_z) = (by_theta * point_m.z / square, -by_theta * radius / square);
        let azimuth = if radius > 0.0 { point_m.xy() / radius } else { Vector2::x() };
        let sideways = Vector2::new(-azimuth.y, azimuth.x);
        let across = if radius > 1e-9 * point_m.z.abs() { rho / radius } else { by_r };
        let offset_by_point = azimuth * RowVector3::new(by_r * azimuth.x, by_r * azimuth.y, by_z)
            + sideways * RowVector3::new(across * sideways.x, across * sideways.y, 0.0);
        Some(self.affine() * offset_by_point)
    }

    fn ray_of_image(&self, pixel: &Vector2<f64>) -> Option<Ray> {
        let offset = self.ideal(pixel);
        let rho = offset.norm();
        let (sin, cos) = self.theta_of_radius(rho)?.sin_cos();
        let azimuth = if rho > 0.0 { offset / rho } else { Vector2::x() };
        Some(Ray { origin_m: Vector3::zeros(), direction: Vector3::new(cos * azimuth.x, cos * azimuth.y, -sin) })
    }

    fn normalised_plane(&self) -> Option<NormalisedPlane> {
        let forward = self.parameters.forward.first();
        let focal = forward.map_or_else(|| horner(&self.parameters.inverse, -FRAC_PI_2).1, |f| -f);
        Some(NormalisedPlane { centre_px: self.parameters.centre_px, focal_length_px: [focal; 2] })
    }

    fn elevation_rad(&self) -> [f64; 2] {
        *self.elevation_rad.get_or_init(|| elevations_on_the_picture(self))
    }

    /// Everything round the axis is on the picture up to a ring that looks off the axis.
    fn is_panoramic(&self) -> bool {
        is_in_image(&Vector2::from(self.parameters.centre_px), self.image_size_px)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::laws::camera_laws;

    /// Kind of a published OCamCalib calibration of a 640×480 mirror camera.
    const FORWARD: [f64; 5] = [-121.1, 0.0, 1.73e-3, 4.4e-7, 7.1e-9];

    fn parameters() -> PolynomialParameters {
        PolynomialParameters {
            forward: FORWARD.to_vec(),
            inverse: Vec::new(),
            centre_px: [326.4, 237.8],
            affine: [0.9994, 3e-4, -6e-4],
        }
    }

    fn camera(change: impl FnOnce(&mut PolynomialParameters)) -> Polynomial {
        let mut parameters = parameters();
        change(&mut parameters);
        Polynomial::new(parameters, [640, 480]).unwrap()
    }

    fn inverse_alone() -> Polynomial {
        camera(|p| {
            p.forward.clear();
            p.inverse = vec![190.0, 110.0, 5.0, 18.0, 8.0];
        })
    }

    camera_laws!(by_its_forward_polynomial, camera(|_| {}));
    camera_laws!(by_its_inverse_polynomial, inverse_alone());

    #[test]
    fn a_ray_is_that_of_cam2world() {
        // By hand: row offset 60, column offset 80, no affine part: ρ = 100, f = −121.1 + 17.3 + 0.44 + 0.71.
        let camera = camera(|p| p.affine = [1.0, 0.0, 0.0]);
        let ray = camera.unproject(&Vector2::new(326.4 + 80.0, 237.8 + 60.0)).unwrap();
        let expected = Vector3::new(80.0, 60.0, 121.1 - 17.3 - 0.44 - 0.71).normalize();
        assert!((ray.direction - expected).norm() < 1e-12, "{ray:?}");
    }

    #[test]
    fn the_affine_part_is_that_of_world2cam() {
        let straight = camera(|p| p.affine = [1.0, 0.0, 0.0]);
        let point = Vector3::new(1.0, 0.6, 0.4);
        let ideal = straight.project(&point).unwrap() - Vector2::new(326.4, 237.8);
        let ours = camera(|_| {}).project(&point).unwrap() - Vector2::new(326.4, 237.8);
        let (column, row) = (-6e-4 * ideal.y + ideal.x, 0.9994 * ideal.y + 3e-4 * ideal.x);
        assert!((ours - Vector2::new(column, row)).norm() < 1e-9);
    }

    #[test]
    fn an_inverse_that_belongs_to_another_camera_is_an_error() {
        let wrong = PolynomialParameters { inverse: vec![100.0, 50.0], ..parameters() };
        let error = Polynomial::new(wrong, [640, 480]).unwrap_err();
        assert_eq!(error.key, "inverse");
        assert!(error.to_string().contains("px apart"), "{error}");
    }

    #[test]
    fn impossible_polynomials_are_named() {
        let error = |change: fn(&mut PolynomialParameters)| {
            let mut parameters = parameters();
            change(&mut parameters);
            Polynomial::new(parameters, [640, 480]).unwrap_err().to_string()
        };
        assert!(error(|p| p.forward.reverse()).contains("reversed"));
        assert!(error(|p| p.forward.clear()).contains("ss"));
        assert!(error(|p| p.forward[2] = f64::NAN).contains("finite"));
        assert!(error(|p| p.affine = [100.0, 0.0, 0.0]).contains("affine"));
    }
}
