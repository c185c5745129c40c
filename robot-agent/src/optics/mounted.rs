//! A camera on a robot: everything in and out is in the body frame (origin on the robot's vertical axis at the floor),
//! tilt, yaw and mirror reversal removed.

use std::sync::Arc;

use nalgebra::{Rotation3, Vector2, Vector3};

use super::{Camera, Mounting, Pal, Ray, bearing_rad, direction, elevation_rad, is_in_image};

/// A camera model with its mounting, its mask and its timing. Cloning is cheap.
#[derive(Debug, Clone)]
pub struct MountedCamera {
    camera: Arc<dyn Camera>,
    mounting: Mounting,
    body_from_camera: Rotation3<f64>,
    mask: Option<Arc<Mask>>,
    timing: Timing,
}

/// Which pixels of the picture show the world. The others (own body, the hole, dirt) are never tested, never counted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mask {
    /// Width and height; those of the camera's picture.
    pub size_px: [u32; 2],
    /// Row by row; false = never tested.
    pub tested: Vec<bool>,
}

/// When a pixel was seen, relative to the picture's capture time. All default to 0.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Timing {
    /// Exposure of one row.
    pub exposure_s: f64,
    /// From the first row's exposure to the last one's (rolling shutter).
    pub readout_s: f64,
    /// From mid-exposure to the stamp of the capture, already part of the stamp's error.
    pub latency_s: f64,
}

/// Pixels a radian somewhere in the picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Resolution {
    /// Displacement in the picture for a change of bearing, px/rad.
    pub bearing_px_per_rad: f64,
    /// Displacement in the picture for a change of elevation, px/rad.
    pub elevation_px_per_rad: f64,
}

impl MountedCamera {
    /// Mounts a camera; no mask, no delays.
    pub fn new(camera: impl Camera + 'static, mounting: Mounting) -> Self {
        Self::from_parts(Arc::new(camera), mounting, None, Timing::default())
    }

    /// Mounts a camera with everything `camera.toml` knows. A mask must have the picture's size.
    pub(super) fn from_parts(
        camera: Arc<dyn Camera>,
        mounting: Mounting,
        mask: Option<Arc<Mask>>,
        timing: Timing,
    ) -> Self {
        let body_from_camera = mounting.body_from_camera_rotation();
        Self { camera, mounting, body_from_camera, mask, timing }
    }

    /// Design D of `MATHS.md` §3.6 with V on the axis at a height: the reference camera of tests and simulation.
    pub fn reference(height_m: f64) -> Self {
        Self::new(Pal::reference(), Mounting::at_height(height_m))
    }

    /// The same with other delays.
    pub fn with_timing(self, timing: Timing) -> Self {
        Self { timing, ..self }
    }

    /// The model, in its own frame.
    pub fn camera(&self) -> &dyn Camera {
        self.camera.as_ref()
    }

    /// How it is mounted, with sigmas.
    pub fn mounting(&self) -> &Mounting {
        &self.mounting
    }

    /// The mask, if any.
    pub fn mask(&self) -> Option<&Mask> {
        self.mask.as_deref()
    }

    /// Exposure, read-out, latency.
    pub fn timing(&self) -> &Timing {
        &self.timing
    }

    /// Width and height of the picture.
    pub fn image_size_px(&self) -> [u32; 2] {
        self.camera.image_size_px()
    }

    /// Where a point of the body frame (metres) appears; `None` outside the domain. Ignores the mask.
    pub fn project_body(&self, point_m: &Vector3<f64>) -> Option<Vector2<f64>> {
        self.project_parallel(&(point_m - self.mounting.position_m))
    }

    /// Where a direction of the body frame, a point at infinity, appears. Ignores the mask.
    pub fn project_body_direction(&self, direction: &Vector3<f64>) -> Option<Vector2<f64>> {
        self.camera.project_direction(&self.model_from_parallel(direction))
    }

    /// The ray of a pixel in the body frame, metres. Ignores the mask.
    pub fn unproject_body(&self, pixel: &Vector2<f64>) -> Option<Ray> {
        let mut ray = self.unproject_parallel(pixel)?;
        ray.origin_m += self.mounting.position_m;
        Some(ray)
    }

    /// Bearing and elevation in the body frame (radians, tilt removed) of the direction that a pixel sees.
    pub fn bearing_elevation_rad(&self, pixel: &Vector2<f64>) -> Option<(f64, f64)> {
        let ray = self.unproject_parallel(pixel)?;
        Some((bearing_rad(&ray.direction), elevation_rad(&ray.direction)))
    }

    /// Like [`MountedCamera::project_body`] for a point relative to the model's origin, axes parallel to the body's:
    /// the frame of `robot-agent camera project`.
    pub fn project_parallel(&self, point_m: &Vector3<f64>) -> Option<Vector2<f64>> {
        self.camera.project(&self.model_from_parallel(point_m))
    }

    /// Like [`MountedCamera::unproject_body`] with the ray's origin relative to the model's origin, axes parallel to
    /// the body's.
    pub fn unproject_parallel(&self, pixel: &Vector2<f64>) -> Option<Ray> {
        let ray = self.camera.unproject(pixel)?;
        let turn = |v: Vector3<f64>| self.body_from_camera * self.reversed(v);
        Some(Ray { origin_m: turn(ray.origin_m), direction: turn(ray.direction) })
    }

    /// How much later than the picture's capture time (mid-exposure of its middle row, or of its middle column where columns come
    /// one after the other) a place on it is seen, seconds.
    pub fn seen_after_s(&self, pixel: &Vector2<f64>) -> f64 {
        let rows = f64::from(self.image_size_px()[1]);
        self.camera.seen_after_s(pixel) + ((pixel.y + 0.5) / rows - 0.5) * self.timing.readout_s
    }

    /// The best single viewpoint in the body frame, metres: bearings and elevations are as from there to within
    /// [`Camera::viewpoint_miss_m`].
    pub fn viewpoint_body_m(&self) -> Vector3<f64> {
        self.mounting.position_m + self.body_from_camera * self.reversed(self.camera.viewpoint_m())
    }

    /// Whether a pixel shows the world: in the camera's domain and not masked (judged at the nearest pixel).
    pub fn is_tested(&self, pixel: &Vector2<f64>) -> bool {
        self.camera.unproject(pixel).is_some() && self.is_unmasked(pixel)
    }

    /// Whether the nearest pixel is in the picture and not masked; says nothing about the camera's domain.
    pub fn is_unmasked(&self, pixel: &Vector2<f64>) -> bool {
        if !is_in_image(pixel, self.image_size_px()) {
            return false;
        }
        let [w, h] = self.image_size_px();
        let (u, v) = ((pixel.x.round().max(0.0) as u32).min(w - 1), (pixel.y.round().max(0.0) as u32).min(h - 1));
        self.mask.as_ref().is_none_or(|mask| mask.tested[(v * w + u) as usize])
    }

    /// The picture's scale around a direction of the body frame; `None` where that is outside the domain. A change of
    /// bearing, not of angle on the sphere: for the PAL its scale is the image radius.
    pub fn resolution(&self, bearing_rad: f64, elevation_rad: f64) -> Option<Resolution> {
        // Central differences of a smooth map: 1e-5 rad keeps truncation and rounding below 1e-9 of the value.
        const STEP_RAD: f64 = 1e-5;
        let project = |b: f64, e: f64| self.project_body_direction(&direction(b, e));
        let scale = |plus: Option<Vector2<f64>>, minus: Option<Vector2<f64>>| {
            let here = project(bearing_rad, elevation_rad)?;
            // At the rim of the domain one side is enough.
            match (plus, minus) {
                (Some(p), Some(m)) => Some((p - m).norm() / (2.0 * STEP_RAD)),
                (Some(p), None) => Some((p - here).norm() / STEP_RAD),
                (None, Some(m)) => Some((here - m).norm() / STEP_RAD),
                (None, None) => None,
            }
        };
        let (b, e, h) = (bearing_rad, elevation_rad, STEP_RAD);
        Some(Resolution {
            bearing_px_per_rad: scale(project(b + h, e), project(b - h, e))?,
            elevation_px_per_rad: scale(project(b, e + h), project(b, e - h))?,
        })
    }

    /// The camera in one line, for announcements and logs.
    pub fn summary(&self) -> String {
        let [w, h] = self.image_size_px();
        let [low, high] = self.camera.elevation_rad().map(f64::to_degrees);
        let height = self.mounting.height_m().map_or_else(|| "unknown height".into(), |z| format!("height {z:.3} m"));
        format!("{} {w}x{h}, elevation {low:.1}..{high:.1} deg, {height}", self.camera.model())
    }

    fn model_from_parallel(&self, v: &Vector3<f64>) -> Vector3<f64> {
        self.reversed(self.body_from_camera.inverse_transform_vector(v))
    }

    /// Mirror reversal negates the image's azimuth: y in the camera's frame.
    pub(crate) fn reversed(&self, v: Vector3<f64>) -> Vector3<f64> {
        if self.mounting.mirrored { Vector3::new(v.x, -v.y, v.z) } else { v }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;

    fn mounted(change: impl FnOnce(&mut Mounting)) -> MountedCamera {
        let mut mounting = Mounting::at_height(0.6);
        change(&mut mounting);
        MountedCamera::new(Pal::reference(), mounting)
    }

    fn assert_close(a: f64, b: f64) {
        assert!((a - b).abs() < 1e-9, "{a} is not {b}");
    }

    #[test]
    fn straight_ahead_is_right_of_the_centre_and_left_is_below_it() {
        let camera = mounted(|_| {});
        let ahead = camera.project_body(&Vector3::new(3.0, 0.0, 0.6)).unwrap();
        assert!(ahead.x > 383.5 + 200.0);
        assert_close(ahead.y, 287.5);
        let left = camera.project_body(&Vector3::new(0.0, 3.0, 0.6)).unwrap();
        assert!(left.y > 287.5 + 200.0);
        assert_close(left.x, 383.5);
    }

    #[test]
    fn the_bearing_of_a_pixel_is_the_picture_s_angle_plus_the_offset() {
        let camera = mounted(|m| m.rotation_rpy_rad[2] = 0.3);
        let pixel = Vector2::new(383.5 + 120.0, 287.5 + 150.0);
        let (bearing, _) = camera.bearing_elevation_rad(&pixel).unwrap();
        assert_close(bearing, 150.0_f64.atan2(120.0) + 0.3);
    }

    #[test]
    fn mirrored_negates_the_picture_s_angle() {
        let camera = mounted(|m| {
            m.mirrored = true;
            m.rotation_rpy_rad[2] = 0.3;
        });
        let (bearing, _) = camera.bearing_elevation_rad(&Vector2::new(383.5 + 120.0, 287.5 + 150.0)).unwrap();
        assert_close(bearing, -(150.0_f64.atan2(120.0)) + 0.3);
    }

    #[test]
    fn a_nose_down_tilt_is_removed_from_elevations() {
        // The camera pitches 2° nose down: what it sees 2° above its own equator ahead is level in the body frame.
        let camera = mounted(|m| m.rotation_rpy_rad[1] = 2_f64.to_radians());
        let level = camera.project_body_direction(&Vector3::new(1.0, 0.0, 0.0)).unwrap();
        let untilted = mounted(|_| {}).project_body_direction(&direction(0.0, 2_f64.to_radians())).unwrap();
        assert!((level - untilted).norm() < 1e-9);
        let (bearing, elevation) = camera.bearing_elevation_rad(&level).unwrap();
        assert_close(bearing, 0.0);
        assert_close(elevation, 0.0);
    }

    #[test]
    fn a_body_point_lies_on_the_ray_of_its_pixel_under_any_mounting() {
        let camera = mounted(|m| {
            m.position_m = Vector3::new(0.1, -0.05, 0.7);
            m.rotation_rpy_rad = [0.02, -0.03, 1.1];
            m.mirrored = true;
        });
        for i in 0..36 {
            let bearing = f64::from(i) * 0.1745 - 3.1;
            let point = Vector3::new(2.0 * bearing.cos(), 2.0 * bearing.sin(), 0.75);
            let ray = camera.unproject_body(&camera.project_body(&point).unwrap()).unwrap();
            assert!((point - ray.origin_m).cross(&ray.direction).norm() < 1e-10);
        }
    }

    #[test]
    fn the_resolution_across_is_the_image_radius() {
        let camera = mounted(|_| {});
        let at = camera.resolution(0.4, 0.0).unwrap();
        assert!((at.bearing_px_per_rad - 216.610_988_92).abs() < 1e-4);
        // Table of MATHS §3.6: (233.317 − 200.806) px over 10° around the horizon, to its curvature.
        assert!((at.elevation_px_per_rad - 186.2).abs() < 1.0, "{}", at.elevation_px_per_rad);
        assert!(camera.resolution(0.4, 0.8).is_none());
    }

    #[test]
    fn the_viewpoint_is_5_mm_above_v() {
        let viewpoint = mounted(|_| {}).viewpoint_body_m();
        assert!((viewpoint.z - 0.605).abs() < 0.001 && viewpoint.x.abs() < 1e-12);
        assert!(bearing_rad(&Vector3::new(0.0, 1.0, 0.0)) == FRAC_PI_2);
    }
}
