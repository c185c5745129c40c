//! A virtual perspective camera that looks somewhere into the panorama (`MATHS.md` §7.8).

use nalgebra::{Vector2, Vector3};

/// A perspective window. Bearings and elevations of the body frame; pixel centres at integers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GazeWindow {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Horizontal field of view, radians in (0, π).
    pub hfov_rad: f64,
    /// Bearing of the optical axis.
    pub pan_rad: f64,
    /// Elevation of the optical axis.
    pub tilt_rad: f64,
}

impl GazeWindow {
    /// The window that shows an object so that it fills a share `fill` (0 … 1, usually 0.7) of the window: object of an
    /// angular width around a bearing, between two elevations (radians, lowest first).
    pub fn around(
        bearing_rad: f64,
        width_rad: f64,
        elevation_rad: [f64; 2],
        [width, height]: [u32; 2],
        fill: f64,
    ) -> Self {
        let [low, high] = elevation_rad;
        let tilt_rad = (0.5 * (low.tan() + high.tan())).atan();
        let across = fill * f64::from(width) / (2.0 * (0.5 * width_rad).tan());
        let upright = fill * f64::from(height) / ((high - tilt_rad).tan() - (low - tilt_rad).tan());
        let focal_px = across.min(upright);
        let hfov_rad = 2.0 * (0.5 * f64::from(width) / focal_px).atan();
        Self { width, height, hfov_rad, pan_rad: bearing_rad, tilt_rad }
    }

    /// Focal length, pixels.
    pub fn focal_px(&self) -> f64 {
        0.5 * f64::from(self.width) / (0.5 * self.hfov_rad).tan()
    }

    /// The body-frame direction (not a unit vector) that a pixel looks in.
    pub fn direction(&self, u: f64, v: f64) -> Vector3<f64> {
        let f = self.focal_px();
        let x = (u + 0.5 - 0.5 * f64::from(self.width)) / f;
        let y = (v + 0.5 - 0.5 * f64::from(self.height)) / f;
        let [forward, right, up] = self.axes();
        forward + right * x - up * y
    }

    /// The pixel that looks in a direction of the body frame, also beyond the window's edges; `None` behind it.
    pub fn pixel(&self, direction: &Vector3<f64>) -> Option<Vector2<f64>> {
        let [forward, right, up] = self.axes().map(|axis| axis.dot(direction));
        (forward > 0.0).then_some(())?;
        let f = self.focal_px() / forward;
        let middle = |side: u32| 0.5 * f64::from(side) - 0.5;
        Some(Vector2::new(middle(self.width) + f * right, middle(self.height) - f * up))
    }

    /// Forward, right, up.
    fn axes(&self) -> [Vector3<f64>; 3] {
        let (sin_p, cos_p) = self.pan_rad.sin_cos();
        let (sin_t, cos_t) = self.tilt_rad.sin_cos();
        [
            Vector3::new(cos_t * cos_p, cos_t * sin_p, sin_t),
            Vector3::new(sin_p, -cos_p, 0.0),
            Vector3::new(-sin_t * cos_p, -sin_t * sin_p, cos_t),
        ]
    }
}
