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

use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::axial::is_somewhere;
use super::parameter::{camera_by_design, check_positive_px, design};
use super::{Camera, ParameterError, Ray, bearing_rad};

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
    /// Time for the whole turn; column u was taken (u + ½)/width of it after the first. The capture time is the middle's.
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
    camera_by_design!("mosaic");

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

    fn seen_after_s(&self, pixel: &Vector2<f64>) -> f64 {
        self.column_time_s(pixel.x) - 0.5 * self.parameters.turn_s
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

/// What a picture of the camera on the arm gives to a mosaic: its slit, and where the arm was.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Slit {
    /// Grey levels from the top down.
    gray: Vec<u8>,
}

/// A mosaic joined from slits.
#[derive(Debug, Clone, PartialEq)]
pub struct Joined {
    /// Grey levels, row by row.
    pub gray: Vec<u8>,
    /// Which slit each column shows.
    pub slit_of_column: Vec<usize>,
    /// The largest angle between a column's arm and the arm of its slit, radians: half the step from picture to picture
    /// where they cover the turn.
    pub largest_gap_rad: f64,
}

/// Why there is no mosaic.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum JoinError {
    /// Nothing to join.
    #[error("no pictures")]
    NoPictures,
    /// Rows of another number than the mosaic's.
    #[error("a picture of {rows} rows; the mosaic has {expected} (image_size_px), as its pictures must have")]
    Rows {
        /// The picture's.
        rows: usize,
        /// The mosaic's.
        expected: usize,
    },
    /// The slit is beyond the picture.
    #[error("the slit would be column {column} of a picture of {width}: slit_deg or focal_length_px is wrong")]
    OffPicture {
        /// Where it would be.
        column: i64,
        /// Columns of the picture.
        width: u32,
    },
}

impl Mosaic {
    /// The slit of a picture by a pinhole camera on the arm with the mosaic's focal length and horizon, the middle of whose
    /// columns looks along the arm: the column that looks v off the arm.
    ///
    /// # Errors
    /// A picture with another number of rows than the mosaic, or without that column.
    pub fn slit(&self, [width, height]: [u32; 2], gray: &[u8]) -> Result<Slit, JoinError> {
        let expected = self.image_size_px[1] as usize;
        let rows = if gray.len() == width as usize * height as usize { height as usize } else { 0 };
        if rows != expected {
            return Err(JoinError::Rows { rows, expected });
        }
        // Left of the axis is a positive angle. A slanted slit is further from the pinhole: its rows are stretched by
        // 1/cos v, which the mosaic's own focal length must already have.
        let column = 0.5 * (f64::from(width) - 1.0) - self.parameters.focal_length_px * self.slit_rad.sin();
        let column = column.round();
        if !(column >= 0.0 && column < f64::from(width)) {
            return Err(JoinError::OffPicture { column: column as i64, width });
        }
        Ok(Slit { gray: gray.iter().skip(column as usize).step_by(width as usize).copied().collect() })
    }

    /// The arm's angle a share of the turn after the mosaic's first column, radians.
    pub fn arm_at_share_rad(&self, share: f64) -> f64 {
        self.arm_rad(share * self.width() - 0.5)
    }

    /// Joins slits, each with its arm's angle ω in radians: every column is the slit whose arm was nearest. As many slits as
    /// columns make it exact.
    ///
    /// # Errors
    /// No slits, or slits of another mosaic.
    pub fn join(&self, slits: &[(f64, Slit)]) -> Result<Joined, JoinError> {
        let [columns, rows] = self.image_size_px.map(|n| n as usize);
        if let Some((_, slit)) = slits.iter().find(|(_, slit)| slit.gray.len() != rows) {
            return Err(JoinError::Rows { rows: slit.gray.len(), expected: rows });
        }
        let mut joined =
            Joined { gray: vec![0; columns * rows], slit_of_column: Vec::with_capacity(columns), largest_gap_rad: 0.0 };
        for u in 0..columns {
            let arm = self.arm_rad(u as f64);
            let away = |slit_arm: f64| ((slit_arm - arm + PI).rem_euclid(TAU) - PI).abs();
            let nearest = slits.iter().enumerate().min_by(|a, b| away(a.1.0).total_cmp(&away(b.1.0)));
            let (index, (slit_arm, slit)) = nearest.ok_or(JoinError::NoPictures)?;
            for (v, gray) in slit.gray.iter().enumerate() {
                joined.gray[v * columns + u] = *gray;
            }
            joined.slit_of_column.push(index);
            joined.largest_gap_rad = joined.largest_gap_rad.max(away(*slit_arm));
        }
        Ok(joined)
    }
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
        // Clockwise from behind: what is on the left is seen before what is ahead.
        let seen = |d: Vector3<f64>| camera.seen_after_s(&camera.project_direction(&d).unwrap());
        assert!(seen(Vector3::x()).abs() < 1e-9 && (seen(Vector3::y()) + 9.0).abs() < 1e-9);
    }

    #[test]
    fn a_mosaic_of_pictures_shows_each_direction_in_its_column() {
        // Pictures whose grey level is the direction they look in, one a degree.
        let mosaic = Mosaic::new(parameters(0.0, 0.0), [360, 480]).unwrap();
        let gray: Vec<Vec<u8>> = (0..360).map(|deg: i32| vec![(deg / 2) as u8; 5 * 480]).collect();
        let slits: Vec<(f64, Slit)> = gray
            .iter()
            .enumerate()
            .map(|(deg, gray)| ((deg as f64 + 0.5).to_radians(), mosaic.slit([5, 480], gray).unwrap()))
            .collect();
        let joined = mosaic.join(&slits).unwrap();
        assert!(joined.largest_gap_rad < 1e-9, "{}", joined.largest_gap_rad);
        for bearing_deg in [10.5_f64, 100.5, -90.5] {
            let (sin, cos) = bearing_deg.to_radians().sin_cos();
            let pixel = mosaic.project_direction(&Vector3::new(cos, sin, 0.0)).unwrap();
            let seen = joined.gray[240 * 360 + pixel.x.round() as usize];
            assert_eq!(joined.slit_of_column[pixel.x.round() as usize] as f64, bearing_deg.rem_euclid(360.0).floor());
            assert_eq!(f64::from(seen), (bearing_deg.rem_euclid(360.0) / 2.0).floor());
        }
    }
}
