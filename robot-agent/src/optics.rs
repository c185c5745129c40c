//! Cameras: where a point appears, and which ray a pixel sees.
//!
//! One camera model a file behind the object-safe [`Camera`]; [`CameraFile`] reads `camera.toml`; [`MountedCamera`]
//! puts a model on a robot and speaks the body frame, which is what the rest of the agent wants.
//!
//! ```text
//! body frame ──[Mounting]──▶ camera frame ──[mirrored]──▶ Camera::project ──▶ pixel
//! ```

mod camera_file;
#[cfg(test)]
mod laws;
mod mounted;
mod mounting;
pub mod pal;
pub mod pinhole;

use nalgebra::{Vector2, Vector3};

pub use camera_file::{CameraFile, SUPPORTED_MODELS};
pub use mounted::{Mask, MountedCamera, Resolution, Timing};
pub use mounting::{Mounting, MountingSigma};
pub use pal::{Pal, PalDesign};
pub use pinhole::Pinhole;

/// What a pixel sees: a half-line, in metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ray {
    /// Where the ray leaves the outermost surface (the viewpoint of a central camera).
    pub origin_m: Vector3<f64>,
    /// Unit vector away from the camera.
    pub direction: Vector3<f64>,
}

/// A camera model without its mounting. Points are in the camera's frame: origin V of `MATHS.md` §3 for the PAL, the
/// viewpoint of a central camera; axes as the body's (x forward, y left, z up). Pixels have their centres at integers.
///
/// The domain is the same in all directions: a pixel belongs to it iff it is in the picture (−½ … size−½) and its ray
/// is one the model describes; a point iff its pixel does.
pub trait Camera: std::fmt::Debug + Send + Sync {
    /// Name as in `camera.toml`.
    fn model(&self) -> &'static str;

    /// Width and height of the picture.
    fn image_size_px(&self) -> [u32; 2];

    /// Where a point (metres) appears; `None` outside the domain.
    fn project(&self, point_m: &Vector3<f64>) -> Option<Vector2<f64>>;

    /// Where a point at infinity appears; `direction` need not be a unit vector.
    fn project_direction(&self, direction: &Vector3<f64>) -> Option<Vector2<f64>>;

    /// The ray of a pixel; `None` outside the domain.
    fn unproject(&self, pixel: &Vector2<f64>) -> Option<Ray>;

    /// Elevations [lowest, highest] in radians that the camera sees somewhere.
    fn elevation_rad(&self) -> [f64; 2];

    /// Whether it sees all bearings.
    fn is_panoramic(&self) -> bool;

    /// The point from which the camera looks, to the best approximation by one point. The origin for central cameras;
    /// for the PAL the point of its axis that its rays miss least.
    fn viewpoint_m(&self) -> Vector3<f64> {
        Vector3::zeros()
    }

    /// The largest distance (metres) by which a ray misses [`Camera::viewpoint_m`]; 0 for central cameras.
    fn viewpoint_miss_m(&self) -> f64 {
        0.0
    }
}

/// Whether a pixel position lies on the picture, whose pixels reach half a pixel beyond their centres.
pub(crate) fn is_in_image(pixel: &Vector2<f64>, image_size_px: [u32; 2]) -> bool {
    let inside = |x: f64, n: u32| x >= -0.5 && x <= f64::from(n) - 0.5;
    inside(pixel.x, image_size_px[0]) && inside(pixel.y, image_size_px[1])
}

/// The elevation (radians) of a direction.
pub fn elevation_rad(direction: &Vector3<f64>) -> f64 {
    direction.z.atan2(direction.x.hypot(direction.y))
}

/// The bearing (radians, counter-clockwise from x) of a direction.
pub fn bearing_rad(direction: &Vector3<f64>) -> f64 {
    direction.y.atan2(direction.x)
}

/// The unit vector with a bearing and an elevation (radians).
pub fn direction(bearing_rad: f64, elevation_rad: f64) -> Vector3<f64> {
    let (sin_b, cos_b) = bearing_rad.sin_cos();
    let (sin_e, cos_e) = elevation_rad.sin_cos();
    Vector3::new(cos_e * cos_b, cos_e * sin_b, sin_e)
}
