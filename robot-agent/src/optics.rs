//! Cameras: where a point appears, and which ray a pixel sees.

use nalgebra::{Vector2, Vector3};

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
}
