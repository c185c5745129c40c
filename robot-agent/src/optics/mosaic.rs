//! A camera on a turning arm whose pictures are joined, slit by slit, to one mosaic (`model = "mosaic"`).
//!
//! The nodal point runs on a circle of radius R about the axis; the slit looks v off the radius. With the arm at ω it
//! stands at R(cos ω, sin ω) and looks in the direction ω + v. A point at the azimuth θ and distance D is in the slit at
//!
//! ```text
//! ω = θ − v + asin(R sin v / D),   v_px = v₀ − f Z/(√(D² − R² sin² v) − R cos v)
//! ```
//!
//! For v = 0 bearings are exact for all R. Columns are of different times: a target that moves by Ω rad/s appears
//! displaced by Ω·Δt. Source: report 5.3 with its erratum, `MATHS.md` §1.1 (8).

use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::sync::Arc;

use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::axial::is_somewhere;
use super::parameter::{Design, check_positive_px, design};
use super::{Camera, Parameter, ParameterError, Ray, bearing_rad};

/// The parameters of `[mosaic]` in `camera.toml`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MosaicParameters {
    /// R: from the axis to the nodal point, mm; 0 where it is on the axis.
    #[serde(default)]
    pub radius_mm: f64,
    /// v: between the arm and the slit's direction, counter-clockwise from above, degrees.
    #[serde(default)]
    pub slit_deg: f64,
    /// f along the rows, px.
    pub focal_length_px: f64,
    /// v₀: the row of the horizon, px.
    pub horizon_px: f64,
    /// ω at the left border, u = −½, degrees.
    #[serde(default = "half_turn")]
    pub start_deg: f64,
    /// Time for the whole turn; column u was taken (u + ½)/width of it after the first.
    #[serde(default)]
    pub turn_s: f64,
    /// Whether the arm turns counter-clockwise from above; then the mosaic is reversed.
    #[serde(default)]
    pub counter_clockwise: bool,
}

fn half_turn() -> f64 {
    180.0
}

design!(MosaicParameters: radius_mm, slit_deg, focal_length_px, horizon_px, start_deg);

/// A mosaic, validated: its columns are all of 360°.
#[derive(Debug, Clone, PartialEq)]
pub struct Mosaic {
    parameters: MosaicParameters,
    image_size_px: [u32; 2],
    radius_m: f64,
    slit_rad: f64,
}

impl Mosaic {
    /// Checks that the parameters make a mosaic.
    ///
    /// # Errors
    /// The first parameter that makes that impossible.
    pub fn new(parameters: MosaicParameters, image_size_px: [u32; 2]) -> Result<Self, ParameterError> {
        let p = &parameters;
        let error = |key, value: f64, expected: &str| Err(ParameterError::new(key, value, expected));
        check_positive_px("focal_length_px", p.focal_length_px)?;
        if !(p.radius_mm >= 0.0 && p.radius_mm < 10_000.0) {
            return error("radius_mm", p.radius_mm, "a length in millimetres from 0 to 10000");
        }
        if !(-89.9..=89.9).contains(&p.slit_deg) {
            return error("slit_deg", p.slit_deg, "degrees off the arm, between -90 and 90");
        }
        if !p.horizon_px.is_finite() {
            return error("horizon_px", p.horizon_px, "a row of the picture, which may lie beyond it");
        }
        if !(-360.0..=360.0).contains(&p.start_deg) {
            return error("start_deg", p.start_deg, "degrees between -360 and 360");
        }
        if !(p.turn_s >= 0.0 && p.turn_s < 1e6) {
            return error("turn_s", p.turn_s, "seconds for the whole turn, 0 or more");
        }
        Ok(Self { radius_m: p.radius_mm * 1e-3, slit_rad: p.slit_deg.to_radians(), parameters, image_size_px })
    }

    /// The parameters.
    pub fn design(&self) -> &MosaicParameters {
        &self.parameters
    }

    /// The arm's angle ω at a column, radians.
    pub fn arm_rad(&self, u: f64) -> f64 {
        self.parameters.start_deg.to_radians() + self.sense() * TAU * (u + 0.5) / self.width()
    }

    /// When a column was taken, seconds after the mosaic's first.
    pub fn column_time_s(&self, u: f64) -> f64 {
        self.parameters.turn_s * (u + 0.5) / self.width()
    }

    fn sense(&self) -> f64 {
        if self.parameters.counter_clockwise { 1.0 } else { -1.0 }
    }

    fn width(&self) -> f64 {
        f64::from(self.image_size_px[0])
    }

    /// The pixel of what the slit sees with the arm at ω, at a slope (height over distance from the nodal point).
    fn pixel(&self, arm_rad: f64, slope: f64) -> Vector2<f64> {
        let turn = self.sense() * (arm_rad - self.parameters.start_deg.to_radians());
        let column = (turn / TAU * self.width()).rem_euclid(self.width());
        // rem_euclid of a tiny negative number may round up to the width itself.
        let column = if column < self.width() { column } else { 0.0 };
        Vector2::new(column - 0.5, self.parameters.horizon_px - self.parameters.focal_length_px * slope)
    }
}

impl Camera for Mosaic {
    fn model(&self) -> &'static str {
        "mosaic"
    }

    fn image_size_px(&self) -> [u32; 2] {
        self.image_size_px
    }

    fn image_of_point(&self, point_m: &Vector3<f64>) -> Option<Vector2<f64>> {
        is_somewhere(point_m).then_some(())?;
        let distance = point_m.x.hypot(point_m.y);
        let (sin, cos) = self.slit_rad.sin_cos();
        // Outside the circle that the nodal point runs on.
        (distance > self.radius_m).then_some(())?;
        let length = (distance * distance - (self.radius_m * sin).powi(2)).sqrt() - self.radius_m * cos;
        let arm = bearing_rad(point_m) - self.slit_rad + (self.radius_m * sin / distance).asin();
        (length > 0.0).then(|| self.pixel(arm, point_m.z / length))
    }

    fn image_of_direction(&self, direction: &Vector3<f64>) -> Option<Vector2<f64>> {
        is_somewhere(direction).then_some(())?;
        let across = direction.x.hypot(direction.y);
        (across > 0.0).then(|| self.pixel(bearing_rad(direction) - self.slit_rad, direction.z / across))
    }

    fn ray_of_image(&self, pixel: &Vector2<f64>) -> Option<Ray> {
        (pixel.x.is_finite() && pixel.y.is_finite()).then_some(())?;
        let (sin_arm, cos_arm) = self.arm_rad(pixel.x).sin_cos();
        let (sin, cos) = (self.arm_rad(pixel.x) + self.slit_rad).sin_cos();
        let slope = (self.parameters.horizon_px - pixel.y) / self.parameters.focal_length_px;
        Some(Ray {
            origin_m: Vector3::new(cos_arm, sin_arm, 0.0) * self.radius_m,
            direction: Vector3::new(cos, sin, slope).normalize(),
        })
    }

    fn elevation_rad(&self) -> [f64; 2] {
        let slope = |v: f64| ((self.parameters.horizon_px - v) / self.parameters.focal_length_px).atan();
        [slope(f64::from(self.image_size_px[1]) - 0.5), slope(-0.5)]
    }

    fn is_panoramic(&self) -> bool {
        true
    }

    fn parameters(&self) -> Vec<Parameter> {
        Design::parameters(&self.parameters)
    }

    fn with_values(&self, values: &[f64]) -> Result<Arc<dyn Camera>, ParameterError> {
        Ok(Arc::new(Self::new(self.parameters.with_values(values), self.image_size_px)?))
    }

    fn table(&self) -> toml::Table {
        self.parameters.table()
    }

    /// A radial slit's rays pass the axis at all slopes, so the best point is the centre of the circle for any slit.
    fn viewpoint_m(&self) -> Vector3<f64> {
        Vector3::zeros()
    }

    /// Rays pass the centre at R sin v in plan and, where they are not level, below or above it.
    fn viewpoint_miss_m(&self) -> f64 {
        let across = self.radius_m * self.slit_rad.sin();
        let [low, high] = self.elevation_rad();
        let steepest = low.abs().max(high.abs()).min(FRAC_PI_2);
        across.hypot(self.radius_m * self.slit_rad.cos() * steepest.sin())
    }
}

/// A picture of the camera on the arm: where the arm was and when.
#[derive(Debug, Clone, Copy)]
pub struct ArmPicture<'a> {
    /// ω, radians.
    pub arm_rad: f64,
    /// Grey levels, row by row.
    pub gray: &'a [u8],
}

/// Joins pictures of a pinhole camera with the mosaic's focal length and horizon, `size_px` each, to a mosaic. Each
/// column comes from the picture whose arm was nearest, at the picture's column that looks v off its arm with the
/// centre of the picture looking along the arm; as many pictures as columns make it exact.
///
/// `None` without pictures, for pictures of another size, or where the slit is not on the pictures.
pub fn join(mosaic: &Mosaic, size_px: [u32; 2], pictures: &[ArmPicture<'_>]) -> Option<Vec<u8>> {
    let [w, h] = size_px.map(|n| n as usize);
    let [columns, rows] = mosaic.image_size_px.map(|n| n as usize);
    (rows == h && pictures.iter().all(|p| p.gray.len() == w * h)).then_some(())?;
    // Left of the axis is a positive angle. A slanted slit is further from the pinhole: its rows are stretched by
    // 1/cos v, which the mosaic's own focal length must already have.
    let slit = 0.5 * (w as f64 - 1.0) - mosaic.parameters.focal_length_px * mosaic.slit_rad.sin();
    let slit = slit.round();
    (slit >= 0.0 && slit < w as f64).then_some(())?;
    let mut out = vec![0; columns * rows];
    for u in 0..columns {
        let arm = mosaic.arm_rad(u as f64);
        let away = |p: &&ArmPicture<'_>| ((p.arm_rad - arm + PI).rem_euclid(TAU) - PI).abs();
        let nearest = pictures.iter().min_by(|a, b| away(a).total_cmp(&away(b)))?;
        for v in 0..rows {
            out[v * columns + u] = nearest.gray[v * w + slit as usize];
        }
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::laws::{assert_rel, camera_laws, golden};

    fn parameters(radius_mm: f64, slit_deg: f64) -> MosaicParameters {
        MosaicParameters {
            radius_mm,
            slit_deg,
            focal_length_px: 500.0,
            horizon_px: 239.5,
            start_deg: 180.0,
            turn_s: 36.0,
            counter_clockwise: false,
        }
    }

    fn camera(radius_mm: f64, slit_deg: f64) -> Mosaic {
        Mosaic::new(parameters(radius_mm, slit_deg), [1440, 480]).unwrap()
    }

    camera_laws!(a_radial_slit, camera(120.0, 0.0));
    camera_laws!(a_slanted_slit, camera(136.0, 35.8));
    camera_laws!(
        the_other_way_round,
        Mosaic::new(MosaicParameters { counter_clockwise: true, ..parameters(80.0, -20.0) }, [1440, 480]).unwrap()
    );

    #[test]
    fn arms_and_rows_are_golden() {
        let (_, golden, tol) = golden("rotating");
        for row in golden.as_array().unwrap() {
            let number = |key: &str| row[key].as_f64().unwrap();
            let camera = Mosaic::new(
                MosaicParameters { slit_deg: number("v").to_degrees(), ..parameters(number("R"), 0.0) },
                [1440, 48_000],
            )
            .unwrap();
            let [x, y, z] = [0, 1, 2].map(|i| row["P"][i].as_f64().unwrap());
            let pixel = camera.image_of_point(&(Vector3::new(x, y, z) * 1e-3)).unwrap();
            assert_rel(239.5 - pixel.y, &row["y"], tol);
            let turn = protocol::angle::wrap(camera.arm_rad(pixel.x) - number("omega"));
            assert!(turn.abs() < tol * number("omega").abs(), "{turn}");
        }
    }

    #[test]
    fn a_radial_slit_s_bearings_are_exact_at_any_distance() {
        let camera = camera(120.0, 0.0);
        let near = camera.project(&Vector3::new(0.4, 0.3, 0.0)).unwrap();
        assert!((near - camera.project_direction(&Vector3::new(0.8, 0.6, 0.0)).unwrap()).norm() < 1e-9);
    }

    #[test]
    fn columns_know_their_time() {
        let camera = camera(0.0, 0.0);
        assert_eq!(camera.column_time_s(-0.5), 0.0);
        assert_eq!(camera.column_time_s(1439.5), 36.0);
        let forward = camera.project_direction(&Vector3::x()).unwrap();
        assert!((camera.column_time_s(forward.x) - 18.0).abs() < 1e-9);
    }

    #[test]
    fn a_mosaic_of_pictures_shows_each_direction_in_its_column() {
        // Pictures whose grey level is the direction they look in, one a degree.
        let mosaic = Mosaic::new(parameters(0.0, 0.0), [360, 480]).unwrap();
        let gray: Vec<Vec<u8>> = (0..360).map(|deg: i32| vec![(deg / 2) as u8; 5 * 480]).collect();
        let pictures: Vec<ArmPicture<'_>> = gray
            .iter()
            .enumerate()
            .map(|(deg, gray)| ArmPicture { arm_rad: (deg as f64 + 0.5).to_radians(), gray })
            .collect();
        let joined = join(&mosaic, [5, 480], &pictures).unwrap();
        for bearing_deg in [10.5_f64, 100.5, -90.5] {
            let (sin, cos) = bearing_deg.to_radians().sin_cos();
            let pixel = mosaic.project_direction(&Vector3::new(cos, sin, 0.0)).unwrap();
            let seen = joined[240 * 360 + pixel.x.round() as usize];
            assert_eq!(f64::from(seen), (bearing_deg.rem_euclid(360.0) / 2.0).floor());
        }
    }
}
