//! Every kind of measurement as a number predicted from poses and points, with its derivatives.
//!
//! All kinds are built from two: the bearing of a point and its distance. A tangent of a cylinder is the bearing of its
//! axis ± asin(R/B) (report 5.2.1); a bar or the edge of a plate is a point of the other's body (5.2.2, 5.2.3), so it
//! tells the other's heading; elevations are atan2(z − h, D) (5.1), on the near side of a cylinder (5-10).

use nalgebra::DVector;
use protocol::angle::wrap;

use super::layout::{Layout, ROBOT, State, TARGET};
use crate::calibration::kernel;

/// What is measured. Lengths in metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Kind {
    /// Bearing of the axis of a robot, or of a target.
    Bearing,
    /// Distance to the axis of a robot.
    Range,
    /// Angle between the tangents of a cylinder.
    Width {
        /// R.
        radius_m: f64,
    },
    /// Bearing of a tangent: side +1 left, −1 right.
    Tangent {
        /// R.
        radius_m: f64,
        /// +1 or −1.
        side: f64,
    },
    /// Elevation of a ring on the near side of a cylinder.
    RingElevation {
        /// R.
        radius_m: f64,
        /// Above the floor.
        z_m: f64,
        /// Of the observer's camera.
        camera_m: f64,
    },
    /// Bearing of a point of the other's body.
    BodyPoint {
        /// In the other's body frame.
        at_m: [f64; 2],
    },
    /// Elevation of such a point.
    BodyPointElevation {
        /// In the other's body frame.
        at_m: [f64; 2],
        /// Above the floor.
        z_m: f64,
        /// Of the observer's camera.
        camera_m: f64,
    },
    /// Heading of the other minus the observer's.
    Heading,
    /// A number of the way from the observer to the other, who is the same robot later: weights times (way − `step`), where the
    /// way is x, y and turn in the observer's body frame. Three such numbers, whitened, are an odometry with its covariance.
    Way {
        /// As measured: m, m, rad.
        step: [f64; 3],
        /// A row of L⁻¹, where L Lᵀ is the covariance.
        weights: [f64; 3],
    },
    /// Elevation of a target.
    Elevation {
        /// Of the observer's camera.
        camera_m: f64,
    },
}

/// Whom it is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Other {
    /// A robot.
    Robot(usize),
    /// A target.
    Target(usize),
}

/// One measured number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Term {
    /// Who measured.
    pub observer: usize,
    /// Whom.
    pub other: Other,
    /// What.
    pub kind: Kind,
    /// The number, rad or m.
    pub measured: f64,
    /// Standard deviation.
    pub sigma: f64,
    /// Stamp minus the target's reference time, s; 0 for what stands.
    pub since_s: f64,
}

/// A predicted number with derivatives to the observer's pose and to the other (pose x y h of a robot, x y z of a target).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prediction {
    /// Predicted − measured, wrapped where it is an angle.
    pub residual: f64,
    /// To x, y, heading of the observer.
    pub observer: [f64; 3],
    /// To the other.
    pub other: [f64; 3],
}

/// A standardised residual (predicted − measured)/sigma with its derivatives to all numbers of observer and other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Row {
    /// The residual.
    pub residual: f64,
    /// To the observer's numbers.
    pub observer: [f64; ROBOT],
    /// To the other's numbers.
    pub other: [f64; TARGET],
}

impl Row {
    /// Its derivatives to the unknowns of a layout.
    pub fn unknowns(&self, term: &Term, layout: &Layout) -> DVector<f64> {
        let mut all = DVector::zeros(layout.unknowns);
        let other = match term.other {
            Other::Robot(r) => &layout.robots[r],
            Other::Target(t) => &layout.targets[t],
        };
        for (columns, derivatives) in [(&layout.robots[term.observer], &self.observer), (other, &self.other)] {
            for (column, d) in columns.iter().zip(derivatives) {
                if let Some(c) = *column {
                    all[c] += d;
                }
            }
        }
        all
    }
}

impl Kind {
    /// Whether the observer's bearing bias enters.
    pub fn turns_with_bias(&self) -> bool {
        matches!(self, Self::Bearing | Self::Tangent { .. } | Self::BodyPoint { .. } | Self::Heading)
    }
}

impl Term {
    /// The standardised residual with bias, time offset and the target's motion. The stamp is late by the observer's offset
    /// τ, so a target is looked at where it was at t − τ.
    pub fn row(&self, state: &State) -> Row {
        let observer = state.poses[self.observer];
        let (other, velocity) = match self.other {
            Other::Robot(r) => (state.poses[r], [0.0; 2]),
            Other::Target(t) => (state.points[t], [state.points[t][3], state.points[t][4]]),
        };
        let since_s = self.since_s - observer[4];
        let there = [other[0] + velocity[0] * since_s, other[1] + velocity[1] * since_s, other[2]];
        let p = self.predict([observer[0], observer[1], observer[2]], there);
        let inverse = self.sigma.recip();
        let bias = self.kind.turns_with_bias();
        let is_angle = self.kind != Kind::Range;
        let residual = if bias && is_angle { wrap(p.residual + observer[3]) } else { p.residual };
        let moving = matches!(self.other, Other::Target(_));
        let by_offset = if moving { -(p.other[0] * velocity[0] + p.other[1] * velocity[1]) } else { 0.0 };
        let by_velocity = if moving { [p.other[0] * since_s, p.other[1] * since_s] } else { [0.0; 2] };
        Row {
            residual: residual * inverse,
            observer: [p.observer[0], p.observer[1], p.observer[2], f64::from(u8::from(bias)), by_offset]
                .map(|d| d * inverse),
            other: [p.other[0], p.other[1], p.other[2], by_velocity[0], by_velocity[1]].map(|d| d * inverse),
        }
    }

    /// Predicts from the observer's pose and the other's pose (or point).
    pub fn predict(&self, observer: [f64; 3], other: [f64; 3]) -> Prediction {
        if let Kind::Way { step, weights } = self.kind {
            return way(observer, other, step, weights);
        }
        // The point that is looked at, and its derivative to the other's heading.
        let body = match self.kind {
            Kind::BodyPoint { at_m } | Kind::BodyPointElevation { at_m, .. } => at_m,
            _ => [0.0, 0.0],
        };
        let turn = matches!(self.kind, Kind::BodyPoint { .. } | Kind::BodyPointElevation { .. });
        let (s, c) = if turn { other[2].sin_cos() } else { (0.0, 1.0) };
        let arm = [c * body[0] - s * body[1], s * body[0] + c * body[1]];
        let point = [other[0] + arm[0], other[1] + arm[1]];
        let by_heading = [-arm[1], arm[0]];
        let (bearing, b_observer, b_point) = kernel::bearing(observer, point);
        let (range, d_observer, d_point) = kernel::distance(observer, point);
        let scaled = |v: [f64; 3], f: f64| v.map(|x| x * f);
        let (predicted, to_observer, to_point, third) = match self.kind {
            Kind::Bearing | Kind::BodyPoint { .. } => (bearing, b_observer, b_point, 0.0),
            Kind::Range => (range, d_observer, d_point, 0.0),
            Kind::Width { radius_m } => {
                let (half, slope) = half_width(radius_m, range);
                (2.0 * half, scaled(d_observer, 2.0 * slope), d_point.map(|x| 2.0 * slope * x), 0.0)
            }
            Kind::Tangent { radius_m, side } => {
                let (half, slope) = half_width(radius_m, range);
                let f = side * slope;
                let to_observer = [0, 1, 2].map(|k| b_observer[k] + f * d_observer[k]);
                let to_point = [0, 1].map(|k| b_point[k] + f * d_point[k]);
                (bearing + side * half, to_observer, to_point, 0.0)
            }
            Kind::RingElevation { radius_m, z_m, camera_m } => {
                let near = (range - radius_m).max(1e-3);
                let (value, slope, _) = elevation(z_m - camera_m, near);
                (value, scaled(d_observer, slope), d_point.map(|x| slope * x), 0.0)
            }
            Kind::BodyPointElevation { z_m, camera_m, .. } => {
                let (value, slope, _) = elevation(z_m - camera_m, range);
                (value, scaled(d_observer, slope), d_point.map(|x| slope * x), 0.0)
            }
            Kind::Elevation { camera_m } => {
                let (value, slope, to_z) = elevation(other[2] - camera_m, range);
                (value, scaled(d_observer, slope), d_point.map(|x| slope * x), to_z)
            }
            Kind::Heading | Kind::Way { .. } => (other[2] - observer[2], [0.0, 0.0, -1.0], [0.0, 0.0], 1.0),
        };
        let residual = predicted - self.measured;
        let third = if turn { to_point[0] * by_heading[0] + to_point[1] * by_heading[1] } else { third };
        Prediction {
            residual: if self.kind == Kind::Range { residual } else { wrap(residual) },
            observer: to_observer,
            other: [to_point[0], to_point[1], third],
        }
    }
}

/// The weighted difference of a way and its measurement.
fn way(from: [f64; 3], to: [f64; 3], step: [f64; 3], [wx, wy, wh]: [f64; 3]) -> Prediction {
    let (s, c) = from[2].sin_cos();
    let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
    let (ahead, aside) = (c * dx + s * dy, c * dy - s * dx);
    let to_point = [wx * c - wy * s, wx * s + wy * c];
    Prediction {
        residual: wx * (ahead - step[0]) + wy * (aside - step[1]) + wh * wrap(to[2] - from[2] - step[2]),
        observer: [-to_point[0], -to_point[1], wx * aside - wy * ahead - wh],
        other: [to_point[0], to_point[1], wh],
    }
}

/// asin(R/B) and its derivative to B; inside the cylinder clamped to its skin.
fn half_width(radius_m: f64, range_m: f64) -> (f64, f64) {
    let b = range_m.max(1.001 * radius_m);
    ((radius_m / b).asin(), -radius_m / (b * (b * b - radius_m * radius_m).sqrt()))
}

/// atan2(rise, distance) and its derivatives to distance and rise.
fn elevation(rise_m: f64, distance_m: f64) -> (f64, f64, f64) {
    let d2 = rise_m * rise_m + distance_m * distance_m;
    (rise_m.atan2(distance_m), -rise_m / d2, distance_m / d2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivatives_of_all_kinds_agree_with_central_differences() {
        let (observer, other) = ([0.2, -0.4, 0.7], [2.3, 1.6, -0.5]);
        for kind in [
            Kind::Bearing,
            Kind::Range,
            Kind::Width { radius_m: 0.2 },
            Kind::Tangent { radius_m: 0.2, side: 1.0 },
            Kind::Tangent { radius_m: 0.2, side: -1.0 },
            Kind::RingElevation { radius_m: 0.2, z_m: 0.1, camera_m: 0.6 },
            Kind::BodyPoint { at_m: [0.15, -0.1] },
            Kind::BodyPointElevation { at_m: [0.15, -0.1], z_m: 0.3, camera_m: 0.6 },
            Kind::Heading,
            Kind::Way { step: [1.0, 0.5, -0.3], weights: [2.0, -3.0, 5.0] },
            Kind::Elevation { camera_m: 0.6 },
        ] {
            let term = Term { observer: 0, other: Other::Robot(1), kind, measured: 0.1, sigma: 1.0, since_s: 0.0 };
            let p = term.predict(observer, other);
            let h = 1e-6;
            for k in 0..3 {
                let (mut a, mut b) = (observer, observer);
                a[k] += h;
                b[k] -= h;
                let d = (term.predict(a, other).residual - term.predict(b, other).residual) / (2.0 * h);
                assert!((d - p.observer[k]).abs() < 1e-7, "{kind:?} observer {k}");
                let (mut a, mut b) = (other, other);
                a[k] += h;
                b[k] -= h;
                let d = (term.predict(observer, a).residual - term.predict(observer, b).residual) / (2.0 * h);
                assert!((d - p.other[k]).abs() < 1e-7, "{kind:?} other {k}: {d} {}", p.other[k]);
            }
        }
    }

    #[test]
    fn derivatives_to_bias_offset_and_velocity_agree_with_central_differences() {
        let state = State { poses: vec![[0.2, -0.4, 0.7, 0.01, 0.05]], points: vec![[2.3, 1.6, 1.2, 0.8, -0.5]] };
        for kind in [Kind::Bearing, Kind::Elevation { camera_m: 0.6 }] {
            let term = Term { observer: 0, other: Other::Target(0), kind, measured: 0.1, sigma: 0.5, since_s: 0.3 };
            let row = term.row(&state);
            let h = 1e-6;
            for k in 0..5 {
                let at = |robot: bool, d: f64| {
                    let mut moved = state.clone();
                    if robot {
                        moved.poses[0][k] += d;
                    } else {
                        moved.points[0][k] += d;
                    }
                    term.row(&moved).residual
                };
                for (robot, found) in [(true, row.observer[k]), (false, row.other[k])] {
                    let d = (at(robot, h) - at(robot, -h)) / (2.0 * h);
                    assert!((d - found).abs() < 1e-6, "{kind:?} {robot} {k}: {d} {found}");
                }
            }
        }
    }
}
