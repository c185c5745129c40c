//! The relative pose of two robots that saw each other, in closed form. D: driven from the first sighting to the second; m₁: where
//! the member sees the newcomer, m₂: where the newcomer then sees the member; X = (p, φ): the newcomer's pose at the second
//! sighting in the member's frame at the first, a: the origin of the newcomer's first frame in its second:
//!
//! ```text
//!   p + R(φ) a = m₁     p + R(φ) m₂ = d     ⇒   φ = ∠(m₁ − d) − ∠(a − m₂),   p = d − R(φ) m₂
//! ```

use nalgebra::{Matrix3, Vector2, Vector3};
use protocol::angle::wrap;
use protocol::frames::Pose2;
use protocol::time::Timestamp;

use super::PRIOR;

/// What a robot has driven since it was first heard, by its wheels.
#[derive(Debug, Clone, Copy)]
pub struct Reckoning {
    /// In a frame of its own.
    pub pose: Pose2,
    /// Trace of the positions' and variance of the heading's growth: how unsure what was driven is.
    pub spread: [f64; 2],
    /// Metres driven and radians turned, either way.
    pub length: [f64; 2],
}

impl Reckoning {
    /// Nothing yet.
    pub const START: Self = Self { pose: Pose2::IDENTITY, spread: [0.0; 2], length: [0.0; 2] };

    /// One more step.
    pub fn drive(&mut self, step: Pose2, covariance: &Matrix3<f64>) {
        self.pose = self.pose * step;
        self.spread[0] += covariance[(0, 0)] + covariance[(1, 1)];
        self.spread[1] += covariance[(2, 2)];
        self.length[0] += step.position().norm();
        self.length[1] += step.heading_rad.abs();
    }

    /// Variances of position (m²) and heading (rad²) of what was driven since `before`, the wheels' own faults among them.
    fn unsure_since(&self, before: &Self) -> [f64; 2] {
        let [way, turned] = [0, 1].map(|k| self.length[k] - before.length[k]);
        let [_, _, wheels, turn, drift, direction] = PRIOR;
        [
            (self.spread[0] - before.spread[0]).max(0.0) + (way * wheels).powi(2) + (way * direction).powi(2),
            (self.spread[1] - before.spread[1]).max(0.0) + (turned * turn).powi(2) + (way * drift).powi(2),
        ]
    }
}

/// A sighting that waits for one the other way.
#[derive(Debug, Clone, Copy)]
pub struct Waiting {
    /// Who saw.
    pub observer: usize,
    /// Whom.
    pub peer: usize,
    /// When.
    pub at: Timestamp,
    /// rad, with variance.
    pub bearing: (f64, f64),
    /// m, with variance.
    pub range: (f64, f64),
    /// What observer and peer had driven.
    pub reckoned: [Reckoning; 2],
}

fn at(bearing: f64, range: f64) -> Vector2<f64> {
    Vector2::new(range * bearing.cos(), range * bearing.sin())
}

/// Pose of the second's observer in the first's at the time of the second, with covariance.
pub fn mutual(first: &Waiting, second: &Waiting) -> Option<(Pose2, Matrix3<f64>)> {
    // What either drove in between.
    let driven_a = first.reckoned[0].pose.inverse() * second.reckoned[1].pose;
    let driven_b = first.reckoned[1].pose.inverse() * second.reckoned[0].pose;
    let relative = |b1: f64, r1: f64, b2: f64, r2: f64| {
        let (m1, m2) = (at(b1, r1), at(b2, r2));
        let (d, a) = (driven_a.position(), driven_b.inverse().position());
        let (v, w) = (m1 - d, a - m2);
        let phi = wrap(v.y.atan2(v.x) - w.y.atan2(w.x));
        let (s, c) = phi.sin_cos();
        let turned = |q: Vector2<f64>| Vector2::new(c * q.x - s * q.y, s * q.x + c * q.y);
        // Either sighting places it; both count alike.
        let p = 0.5 * (d - turned(m2) + m1 - turned(a));
        driven_a.inverse() * Pose2::new(p.x, p.y, phi)
    };
    let inputs = [first.bearing, first.range, second.bearing, second.range];
    let value = |shift: usize, by: f64| {
        let mut x = inputs.map(|i| i.0);
        if shift < 4 {
            x[shift] += by;
        }
        relative(x[0], x[1], x[2], x[3])
    };
    let pose = value(4, 0.0);
    let mut cov = Matrix3::zeros();
    let [bias, scale, ..] = PRIOR;
    let shared = [bias, scale * first.range.0, bias, scale * second.range.0];
    for (k, (_, var)) in inputs.iter().enumerate() {
        let step = 1e-5;
        let (after, before) = (value(k, step), value(k, -step));
        let j =
            Vector3::new(after.x_m - before.x_m, after.y_m - before.y_m, wrap(after.heading_rad - before.heading_rad))
                / (2.0 * step);
        cov += (*var + shared[k] * shared[k]) * j * j.transpose();
    }
    let distance = pose.position().norm().max(0.1);
    let [of_a, of_b] = [(&first.reckoned[0], &second.reckoned[1]), (&first.reckoned[1], &second.reckoned[0])]
        .map(|(a, b)| b.unsure_since(a));
    let (driven, turned) = (of_a[0] + of_b[0], of_a[1] + of_b[1]);
    cov += Matrix3::from_diagonal(&Vector3::new(
        driven + turned * distance * distance,
        driven + turned * distance * distance,
        turned + driven / (distance * distance),
    ));
    cov.iter().all(|v| v.is_finite()).then_some((pose, cov))
}
