//! Four cameras under a four-sided mirror pyramid that share one viewpoint (`model = "pyramid"`).
//!
//! Apex in the mirrors' origin, pointing up, faces at 45°; V = (0, 0, −h). Camera i stands at h(cos φᵢ, sin φᵢ, 0) with
//! φᵢ = i · 90° and looks down; its mirror image in face i is V. Positions in this model are given from V, the single
//! viewpoint. Source: report 2.1 (Nalwa), `MATHS.md` §1.1 (1).
//!
//! The four pictures stand side by side, camera 0 on the left, each a quarter of the width. Their u runs outwards along
//! the camera's azimuth φᵢ and v along φᵢ + 90°; as in any single mirror they are reversed.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};
use std::sync::OnceLock;

use nalgebra::{Matrix3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::axial::is_somewhere;
use super::parameter::{camera_by_design, check_centre, check_focal_lengths, check_length_mm, design};
use super::{Camera, ParameterError, Ray, bearing_rad, elevations_on_the_picture};

/// Cameras of a pyramid.
const CAMERAS: u32 = 4;

/// The parameters of `[pyramid]` in `camera.toml`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PyramidParameters {
    /// h: from the apex to V and to each camera, mm.
    pub h_mm: f64,
    /// f of each camera, px.
    pub focal_length_px: f64,
    /// Where each camera's axis meets its own picture, from that picture's first pixel, px.
    pub centre_px: [f64; 2],
}

design!(PyramidParameters: h_mm, focal_length_px, centre_px);

/// A pyramid of cameras, validated.
#[derive(Debug, Clone, PartialEq)]
pub struct Pyramid {
    parameters: PyramidParameters,
    image_size_px: [u32; 2],
    elevation_rad: OnceLock<[f64; 2]>,
}

impl Pyramid {
    /// Checks that the parameters make four cameras.
    ///
    /// # Errors
    /// The first parameter that makes that impossible.
    pub fn new(parameters: PyramidParameters, image_size_px: [u32; 2]) -> Result<Self, ParameterError> {
        let [w, h] = image_size_px;
        if !w.is_multiple_of(CAMERAS) {
            let expected = format!("inside four pictures side by side: a width of {w} px is no multiple of 4");
            return Err(ParameterError::new("centre_px", parameters.centre_px, expected));
        }
        check_length_mm("h_mm", parameters.h_mm)?;
        check_focal_lengths([parameters.focal_length_px; 2], [w / CAMERAS, h])
            .map_err(|error| ParameterError { value: format!("{:?}", parameters.focal_length_px), ..error })?;
        check_centre(parameters.centre_px, [w / CAMERAS, h])?;
        Ok(Self { parameters, image_size_px, elevation_rad: OnceLock::new() })
    }

    /// Columns of one camera's picture.
    fn width(&self) -> f64 {
        f64::from(self.image_size_px[0] / CAMERAS)
    }

    /// The camera whose picture holds a column.
    fn camera_of_column(&self, u: f64) -> u32 {
        ((u + 0.5) / self.width()).floor().clamp(0.0, f64::from(CAMERAS - 1)) as u32
    }
}

/// Unit vectors out along a camera's azimuth and across it.
fn axes(camera: u32) -> [Vector3<f64>; 2] {
    let (sin, cos) = (f64::from(camera) * FRAC_PI_2).sin_cos();
    [Vector3::new(cos, sin, 0.0), Vector3::new(-sin, cos, 0.0)]
}

/// Reflection in a camera's face.
fn reflection(camera: u32) -> Matrix3<f64> {
    let normal = (axes(camera)[0] + Vector3::z()) / 2.0_f64.sqrt();
    Matrix3::identity() - 2.0 * normal * normal.transpose()
}

impl Camera for Pyramid {
    camera_by_design!("pyramid");

    fn image_of_point(&self, point_m: &Vector3<f64>) -> Option<Vector2<f64>> {
        is_somewhere(point_m).then_some(())?;
        let camera = ((bearing_rad(point_m) + FRAC_PI_4) / FRAC_PI_2).floor().rem_euclid(f64::from(CAMERAS)) as u32;
        let [out, across] = axes(camera);
        let d = reflection(camera) * point_m;
        (d.z < 0.0).then_some(())?;
        let f = self.parameters.focal_length_px / -d.z;
        let offset = Vector2::new(f * d.dot(&out), f * d.dot(&across));
        let [u0, v0] = self.parameters.centre_px;
        let pixel = Vector2::new(u0 + offset.x, v0 + offset.y);
        // Beyond its own picture's sides lies that of another camera.
        (pixel.x >= -0.5 && pixel.x < self.width() - 0.5).then_some(())?;
        Some(pixel + Vector2::new(f64::from(camera) * self.width(), 0.0))
    }

    fn image_of_direction(&self, direction: &Vector3<f64>) -> Option<Vector2<f64>> {
        self.image_of_point(direction)
    }

    fn ray_of_image(&self, pixel: &Vector2<f64>) -> Option<Ray> {
        let camera = self.camera_of_column(pixel.x);
        let [out, across] = axes(camera);
        let [u0, v0] = self.parameters.centre_px;
        let offset = Vector2::new(pixel.x - f64::from(camera) * self.width() - u0, pixel.y - v0);
        let image_ray = out * offset.x + across * offset.y - Vector3::z() * self.parameters.focal_length_px;
        let direction = (reflection(camera) * image_ray).normalize();
        // A face shows only its own quarter of the world.
        let turn = direction.dot(&across).atan2(direction.dot(&out));
        (-FRAC_PI_4..FRAC_PI_4).contains(&turn).then_some(Ray { origin_m: Vector3::zeros(), direction })
    }

    fn elevation_rad(&self) -> [f64; 2] {
        *self.elevation_rad.get_or_init(|| elevations_on_the_picture(self))
    }

    fn is_panoramic(&self) -> bool {
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::laws::{assert_rel, camera_laws, golden};

    fn camera(size: [u32; 2]) -> Pyramid {
        let centre_px = [f64::from(size[0]) / 8.0 - 0.5, f64::from(size[1]) / 2.0 - 0.5];
        Pyramid::new(PyramidParameters { h_mm: 60.0, focal_length_px: 500.0, centre_px }, size).unwrap()
    }

    camera_laws!(laws, camera([1600, 1000]));

    #[test]
    fn images_and_directions_are_golden() {
        let (_, golden, tol) = golden("pyramid");
        // So large that every golden point is on its picture.
        let camera = camera([16_000, 4000]);
        for row in golden.as_array().unwrap() {
            let [x, y, z] = [0, 1, 2].map(|i| row["P"][i].as_f64().unwrap());
            // Golden points are from the apex.
            let pixel = camera.project(&(Vector3::new(x, y, z + 60.0) * 1e-3)).unwrap();
            let number = row["cam"].as_f64().unwrap();
            assert_rel(pixel.x - 4000.0 * number - 1999.5, &row["u"], tol);
            assert_rel(pixel.y - 1999.5, &row["v"], tol);
            let ray = camera.unproject(&pixel).unwrap();
            for i in 0..3 {
                assert_rel(ray.direction[i], &row["dir"][i], tol);
            }
        }
    }

    #[test]
    fn a_width_that_cannot_be_divided_is_an_error() {
        let parameters = PyramidParameters { h_mm: 60.0, focal_length_px: 500.0, centre_px: [100.0, 100.0] };
        assert!(Pyramid::new(parameters, [1601, 1000]).unwrap_err().to_string().contains("multiple of 4"));
    }
}
