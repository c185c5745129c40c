//! Unwrapping: from the camera's ring to a picture that reads like a picture.
//!
//! [`PanoramaGeometry`] says which bearing and elevation a panorama pixel has (cylinder or sphere); [`GazeWindow`] the same
//! for a virtual perspective camera; [`RadialPanorama`] is the ring by its image radius, plain or rectified, without a
//! camera model; [`Lut`] holds where in the source each output pixel lies, for one mounted camera, with the
//! bilinear weights; `kernel` is the loop over the pixels.
//!
//! ```text
//!                    forward
//!  behind   left        │       right    behind       columns run clockwise, so the world is not mirrored
//!  ├─────────┼──────────┼─────────┼──────────┤
//!  u = −½   W/4−½     W/2−½    3W/4−½      W−½        bearing π … π/2 … 0 … −π/2 … −π
//! ```
//!
//! Source: report (4-1), (4-2) with errata, `MATHS.md` §4.1, §7.1 and §7.8.

mod gaze;
mod kernel;
mod lut;
mod radial;
mod watch;

use std::f64::consts::{PI, TAU};

use protocol::angle::wrap;

use crate::optics::MountedCamera;

pub use gaze::GazeWindow;
pub use lut::{Lut, LutEntry, UnwarpError};
pub use radial::RadialPanorama;
pub use watch::Watch;

/// How rows are spaced in elevation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Projection {
    /// Rows equally spaced in tan(elevation): vertical heights keep their ratios, as on a cylinder about the axis.
    Cylinder,
    /// Rows equally spaced in elevation: reaches the poles.
    Sphere,
}

/// A panorama's pixels in angles of the body frame. Pixel centres are at integers; all 360° are there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PanoramaGeometry {
    width: u32,
    height: u32,
    projection: Projection,
    /// Row coordinate (tangent or angle) at v = −½ and v = H − ½.
    top: f64,
    bottom: f64,
    theta0_rad: f64,
}

/// A geometry that cannot be.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum GeometryError {
    /// A side is 0 or absurd.
    #[error("a panorama of {width}x{height} pixels: each side must be from 1 to {}", PanoramaGeometry::MAX_SIDE_PX)]
    Size {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// Not an interval of elevations.
    #[error("elevations from {low_deg} to {high_deg} degrees: the first must be the lower one, and {limit}")]
    Elevation {
        /// Lower end.
        low_deg: f64,
        /// Upper end.
        high_deg: f64,
        /// What the projection can show.
        limit: &'static str,
    },
    /// A rectifying polynomial that does not run in one sense over the ring.
    #[error(
        "a rectifying polynomial that turns back between the image radii {inner_px} and {outer_px} px: rows would fold"
    )]
    Folded {
        /// Smaller radius.
        inner_px: f64,
        /// Larger radius.
        outer_px: f64,
    },
    /// The camera does not see all around.
    #[error("a {model} camera does not see all around: only `perspective` views can be made from it")]
    NotPanoramic {
        /// The camera's model.
        model: &'static str,
    },
}

impl PanoramaGeometry {
    /// Largest side of a panorama.
    pub const MAX_SIDE_PX: u32 = 16_384;

    /// Columns are a multiple of this, so that rows stay aligned and the sides divide well.
    const WIDTH_STEP: u32 = 120;

    /// Rows for one row of equal scale in both directions at the horizon: the report's 162 rows over the reference
    /// camera's field of view.
    const ROW_STRETCH: f64 = 1.5;

    /// A panorama with forward in its middle and the seam behind, between two elevations (radians, lowest first).
    ///
    /// # Errors
    /// An impossible size or interval.
    pub fn new(
        width: u32,
        height: u32,
        projection: Projection,
        elevation_rad: [f64; 2],
    ) -> Result<Self, GeometryError> {
        if !(1..=Self::MAX_SIDE_PX).contains(&width) || !(1..=Self::MAX_SIDE_PX).contains(&height) {
            return Err(GeometryError::Size { width, height });
        }
        let [low, high] = elevation_rad;
        let (pole_rad, limit) = match projection {
            Projection::Cylinder => (89_f64.to_radians(), "a cylinder shows -89 to 89 degrees"),
            Projection::Sphere => (0.5 * PI + 1e-12, "a sphere shows -90 to 90 degrees"),
        };
        if !(low < high && low >= -pole_rad && high <= pole_rad) {
            return Err(GeometryError::Elevation { low_deg: low.to_degrees(), high_deg: high.to_degrees(), limit });
        }
        let row = |e: f64| if projection == Projection::Cylinder { e.tan() } else { e };
        Ok(Self { width, height, projection, top: row(high), bottom: row(low), theta0_rad: PI })
    }

    /// The panorama that suits a camera: all elevations that it sees as it is mounted, on a cylinder up to ±60° and on a sphere beyond.
    ///
    /// The rule: as many columns as the radial scale of the picture, averaged over the field of view, has pixels on a
    /// full circle, rounded down to a multiple of 120 (so columns never outnumber what the picture resolves at
    /// mid-field); rows 1.5 times those of equal scale, rounded down to an even number. The reference camera gives
    /// 1080×162.
    ///
    /// # Errors
    /// [`GeometryError::NotPanoramic`].
    pub fn for_camera(camera: &MountedCamera) -> Result<Self, GeometryError> {
        let elevation_rad = elevations_in_the_body(camera);
        let scale = radial_px_per_rad(camera).filter(|_| camera.camera().is_panoramic());
        let Some(scale) = scale else { return Err(GeometryError::NotPanoramic { model: camera.camera().model() }) };
        Self::of_scale(scale, elevation_rad)
    }

    /// The panorama that people and robots are looked for in: that of [`PanoramaGeometry::for_camera`] with no more columns than the
    /// picture has pixels along the horizon, of a camera that sees the pole the part from -60° to 45°, on a cylinder as well; of one that
    /// looks one way all round, though only a part of it is ever valid.
    ///
    /// # Errors
    /// [`GeometryError::NotPanoramic`] for a camera that looks one way, up or down, whose picture's middle is no bearing.
    pub fn for_work(camera: &MountedCamera) -> Result<Self, GeometryError> {
        const WORK_RAD: [f64; 2] = [-PI / 3.0, PI / 4.0];
        let suited = if camera.camera().is_panoramic() { Self::for_camera(camera)? } else { Self::around(camera)? };
        let [mut low, mut high] = suited.elevation_rad();
        if suited.projection == Projection::Sphere {
            (low, high) = (low.max(WORK_RAD[0]), high.min(WORK_RAD[1]));
        }
        if low >= high {
            return Ok(suited);
        }
        // Much of the picture's scale may be along the meridians; around the robot, where people and robots are, it has no more than this.
        let level = 0.0_f64.clamp(low, high);
        let around = |k: u32| Some(camera.resolution(f64::from(k) * PI / 4.0, level)?.bearing_px_per_rad);
        let most = (0..8).filter_map(around).reduce(f64::max).filter(|most| *most > 0.0);
        let scale = (f64::from(suited.width) + 0.5) / TAU;
        if suited.projection == Projection::Cylinder && most.is_none_or(|most| most >= scale) {
            return Ok(suited);
        }
        Self::of_scale(most.map_or(scale, |most| scale.min(most)), [low, high])
    }

    /// The panorama of a camera that looks one way: all round. The rule is that of [`PanoramaGeometry::for_camera`], with the scale in
    /// the middle of the picture.
    fn around(camera: &MountedCamera) -> Result<Self, GeometryError> {
        const STEEPEST_RAD: f64 = PI / 4.0;
        let not_panoramic = || GeometryError::NotPanoramic { model: camera.camera().model() };
        let middle = camera.image_size_px().map(|n| 0.5 * (f64::from(n) - 1.0));
        let (bearing, elevation) = camera
            .bearing_elevation_rad(&nalgebra::Vector2::from(middle))
            .filter(|(_, elevation)| elevation.abs() < STEEPEST_RAD)
            .ok_or_else(not_panoramic)?;
        let scale = camera.resolution(bearing, elevation).ok_or_else(not_panoramic)?.bearing_px_per_rad;
        Self::of_scale(scale / elevation.cos(), elevations_of_the_picture(camera))
    }

    fn of_scale(px_per_rad: f64, [low, high]: [f64; 2]) -> Result<Self, GeometryError> {
        const CYLINDER_LIMIT_RAD: f64 = PI / 3.0;
        let columns = (TAU * px_per_rad / f64::from(Self::WIDTH_STEP)).floor() as u32;
        let width = (columns * Self::WIDTH_STEP).clamp(Self::WIDTH_STEP, Self::MAX_SIDE_PX / 2);
        let (projection, span) = if low >= -CYLINDER_LIMIT_RAD && high <= CYLINDER_LIMIT_RAD {
            (Projection::Cylinder, high.tan() - low.tan())
        } else {
            (Projection::Sphere, high - low)
        };
        let rows = Self::ROW_STRETCH * span * f64::from(width) / TAU;
        let height = ((0.5 * rows).floor() as u32 * 2).clamp(2, Self::MAX_SIDE_PX);
        Self::new(width, height, projection, [low, high])
    }

    /// The same panorama with another bearing (radians) at its left border; π is the project's convention.
    pub fn with_theta0(self, theta0_rad: f64) -> Self {
        Self { theta0_rad, ..self }
    }

    /// Columns.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Pixels.
    pub fn pixels(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// Row spacing.
    pub fn projection(&self) -> Projection {
        self.projection
    }

    /// Bearing at the left border, u = −½.
    pub fn theta0_rad(&self) -> f64 {
        self.theta0_rad
    }

    /// Lowest and highest elevation, at the lower and upper border.
    pub fn elevation_rad(&self) -> [f64; 2] {
        [self.elevation(self.bottom), self.elevation(self.top)]
    }

    /// Bearing in (−π, π] of a column; any real column, also beyond the borders (unrolled).
    pub fn bearing_of_column(&self, u: f64) -> f64 {
        wrap(self.theta0_rad - TAU * (u + 0.5) / f64::from(self.width))
    }

    /// Column of a bearing, in [−½, W − ½).
    pub fn column_of_bearing(&self, bearing_rad: f64) -> f64 {
        let width = f64::from(self.width);
        let column = ((self.theta0_rad - bearing_rad) / TAU * width).rem_euclid(width);
        // rem_euclid of a tiny negative number may round up to the width itself.
        (if column < width { column } else { 0.0 }) - 0.5
    }

    /// Radians a column.
    pub fn bearing_step_rad(&self) -> f64 {
        TAU / f64::from(self.width)
    }

    /// Elevation of a row; any real row.
    pub fn elevation_of_row(&self, v: f64) -> f64 {
        self.elevation(self.top - (v + 0.5) * self.row_step())
    }

    /// Row of an elevation; beyond the borders where the panorama does not show it.
    pub fn row_of_elevation(&self, elevation_rad: f64) -> f64 {
        let coordinate = match self.projection {
            Projection::Cylinder => elevation_rad.tan(),
            Projection::Sphere => elevation_rad,
        };
        (self.top - coordinate) / self.row_step() - 0.5
    }

    /// Radians of elevation a row, at a row.
    pub fn elevation_step_rad(&self, v: f64) -> f64 {
        match self.projection {
            Projection::Cylinder => self.row_step() * self.elevation_of_row(v).cos().powi(2),
            Projection::Sphere => self.row_step(),
        }
    }

    fn row_step(&self) -> f64 {
        (self.top - self.bottom) / f64::from(self.height)
    }

    fn elevation(&self, coordinate: f64) -> f64 {
        match self.projection {
            Projection::Cylinder => coordinate.atan(),
            Projection::Sphere => coordinate,
        }
    }
}

/// The elevations [lowest, highest] that a mounted camera shows, in the body frame: the camera's own where its axis is nearly
/// upright (a small tilt changes no panorama), upside down where it hangs, and those of its picture where it looks aside.
fn elevations_in_the_body(camera: &MountedCamera) -> [f64; 2] {
    /// Cosine of 20°.
    const NEARLY_UPRIGHT: f64 = 0.94;
    let [low, high] = camera.camera().elevation_rad();
    let up = camera.mounting().body_from_camera_rotation() * nalgebra::Vector3::z();
    if up.z > NEARLY_UPRIGHT {
        return [low, high];
    }
    if up.z < -NEARLY_UPRIGHT {
        return [-high, -low];
    }
    elevations_of_the_picture(camera)
}

/// The elevations [lowest, highest] of what is on a camera's picture, in the body frame.
fn elevations_of_the_picture(camera: &MountedCamera) -> [f64; 2] {
    const STEPS: u32 = 64;
    let [w, h] = camera.image_size_px().map(f64::from);
    let at = |i: u32, side: f64| f64::from(i) / f64::from(STEPS) * side - 0.5;
    let pixels = (0..=STEPS).flat_map(|i| (0..=STEPS).map(move |j| (i, j)));
    let elevations = pixels.filter_map(|(i, j)| {
        camera.bearing_elevation_rad(&nalgebra::Vector2::new(at(i, w), at(j, h))).map(|(_, elevation)| elevation)
    });
    elevations.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], e| [a.min(e), b.max(e)])
}

/// Pixels a radian of elevation, averaged over what the picture shows of the first meridian that shows most.
fn radial_px_per_rad(camera: &MountedCamera) -> Option<f64> {
    const MERIDIANS: u32 = 72;
    const STEPS: u32 = 64;
    let [low, high] = camera.camera().elevation_rad();
    let step = (high - low) / f64::from(STEPS);
    let mut best: Option<(u32, f64)> = None;
    for i in 0..MERIDIANS {
        let bearing = TAU * f64::from(i) / f64::from(MERIDIANS);
        let pixel = |j: u32| {
            let elevation = if j == STEPS { high } else { low + f64::from(j) * step };
            camera.camera().project_direction(&crate::optics::direction(bearing, elevation))
        };
        let lengths = (0..STEPS).filter_map(|j| Some((pixel(j + 1)? - pixel(j)?).norm()));
        let (seen, length) = lengths.fold((0, 0.0), |(n, sum), length| (n + 1, sum + length));
        if seen > best.map_or(0, |(n, _)| n) {
            best = Some((seen, length));
        }
    }
    best.map(|(seen, length)| length / (f64::from(seen) * step))
}

#[cfg(test)]
mod tests;
