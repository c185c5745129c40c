//! Poses in the plane. `team_from_body` maps body coordinates to team coordinates, so products read left to right:
//! `team_from_a * a_from_b = team_from_b`.

mod jacobians;

use std::f64::consts::PI;
use std::ops::Mul;

use bincode::{Decode, Encode};
use nalgebra::{Matrix2, Vector2};
use serde::{Deserialize, Serialize};

use crate::angle::wrap;
use crate::codec::{Invalid, check};

/// A rigid motion of the floor plane, SE(2).
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, Encode, Decode)]
pub struct Pose2 {
    /// Metres.
    pub x_m: f64,
    /// Metres.
    pub y_m: f64,
    /// Radians, counter-clockwise, in (−π, π].
    pub heading_rad: f64,
}

impl Pose2 {
    /// The frame itself.
    pub const IDENTITY: Self = Self { x_m: 0.0, y_m: 0.0, heading_rad: 0.0 };

    /// A pose with its heading wrapped.
    pub fn new(x_m: f64, y_m: f64, heading_rad: f64) -> Self {
        Self { x_m, y_m, heading_rad: wrap(heading_rad) }
    }

    /// The position.
    pub fn position(&self) -> Vector2<f64> {
        Vector2::new(self.x_m, self.y_m)
    }

    /// The rotation.
    pub fn rotation(&self) -> Matrix2<f64> {
        let (s, c) = self.heading_rad.sin_cos();
        Matrix2::new(c, -s, s, c)
    }

    /// `b_from_a` of an `a_from_b`.
    pub fn inverse(&self) -> Self {
        let p = -(self.rotation().transpose() * self.position());
        Self::new(p.x, p.y, -self.heading_rad)
    }

    /// A point of the inner frame in the outer one.
    pub fn transform(&self, point: Vector2<f64>) -> Vector2<f64> {
        self.rotation() * point + self.position()
    }

    /// The bearing in the inner frame of a point given in the outer one, in (−π, π].
    pub fn bearing_to(&self, point: Vector2<f64>) -> f64 {
        let d = point - self.position();
        wrap(d.y.atan2(d.x) - self.heading_rad)
    }

    /// Whether it may travel: finite, heading in (−π, π] (a little more for rounding).
    pub(crate) fn validate(&self, field: &'static str) -> Result<(), Invalid> {
        check::all_finite(field, &[self.x_m, self.y_m])?;
        check::in_range(field, self.heading_rad, -PI - 1e-6, PI + 1e-6)
    }
}

impl Mul for Pose2 {
    type Output = Self;
    // Angles add: that is what the composition of rotations is.
    #[allow(clippy::suspicious_arithmetic_impl)]
    fn mul(self, inner: Self) -> Self {
        let p = self.transform(inner.position());
        Self::new(p.x, p.y, self.heading_rad + inner.heading_rad)
    }
}
