//! How well a track fits a target, in nats: log-likelihood that it is the target's, less that it is clutter.
//!
//! Bearings of bodies have heavy tails (an arm, a shadow, half a body), so residuals follow Student's t, not a Gaussian: one
//! far off costs little more than clutter and never moves a target far ([`stretch`]). Clutter is what robots follow that is
//! nobody: a few tracks anywhere in the picture, and pieces of bodies beside the bodies they belong to.

use std::f64::consts::TAU;

use protocol::angle::wrap;
use protocol::id::TargetId;

use super::{Follower, Frame, PRESENT_S, Sight, gate_distance2};
use crate::calibration::live::Calibrator;

/// Degrees of freedom of Student's t.
const NU: f64 = 4.0;
/// ln Γ((ν + 1) / 2) − ln Γ(ν / 2) − ln √(νπ) at ν = 4.
const LOG_STUDENT: f64 = -0.980_829_253_011_726;
/// Tracks of nobody in a picture, and pieces of a body beside it that have a track of their own.
const CLUTTER: f64 = 0.5;
const PIECES: f64 = 0.4;
/// How far from a body's axis its pieces lie, standard deviation in metres.
const PIECE_M: f64 = 0.2;

/// What a squared sigma of a single robot's range is worth, nats, where the target's is known to this part: ranges of feet
/// and heads err alike from frame to frame.
const CUE_WORTH: f64 = 0.25;
const KNOWN_RANGE: f64 = 0.3;

/// Log-density of a residual of squared distance `d2` and variance `var`.
pub fn log_student(d2: f64, var: f64) -> f64 {
    LOG_STUDENT - 0.5 * var.ln() - 0.5 * (NU + 1.0) * (1.0 + d2 / NU).ln()
}

/// By how much the variance of a measurement at squared distance `d2` grows, so that far ones move little.
pub fn stretch(d2: f64) -> f64 {
    ((NU + d2) / (NU + 1.0)).max(1.0)
}

/// A track and a target.
#[derive(Debug, Clone, Copy)]
pub struct Fit {
    /// Squared residual over its variance, all errors counted.
    pub d2: f64,
    /// How far away the target is, m.
    pub range_m: f64,
    /// Track of the target against clutter, nats.
    pub log_ratio: f64,
    /// By how much this assignment is better than another one, nats.
    pub margin: f64,
}

impl Follower {
    /// How well a sight fits target `t`.
    pub(super) fn fit(&self, frame: &Frame<'_>, sight: &Sight, t: usize, calibrator: &Calibrator) -> Fit {
        let target = &self.targets[t].target;
        let rough = self.bearing(frame, sight, 3.0, 1.0);
        let range_m = target.innovation(&rough).range_m;
        let m = self.bearing(frame, sight, range_m, 1.0);
        let innovation = target.innovation(&m);
        let (d2, var) = gate_distance2(&innovation, target, &m, calibrator);
        let known_range = target.sigma_m() < KNOWN_RANGE * range_m;
        let cue = if known_range { CUE_WORTH * sight.cue.cost(range_m) } else { 0.0 };
        let clutter = self.clutter(frame.robot, &frame.pose, sight.bearing_rad, frame.at, Some(self.targets[t].id));
        Fit { d2, range_m, log_ratio: log_student(d2, var) - clutter.ln() - cue, margin: f64::INFINITY }
    }

    /// Density of tracks (1/rad) at a bearing that are no further person: anywhere, and pieces of the targets that the robot
    /// follows, but for target `except`.
    pub(super) fn clutter(
        &self,
        robot: usize,
        pose: &protocol::frames::Pose2,
        bearing_rad: f64,
        at: protocol::time::Timestamp,
        except: Option<TargetId>,
    ) -> f64 {
        let mut density = CLUTTER / TAU;
        for followed in self.targets.iter().filter(|f| Some(f.id) != except) {
            if !followed.is_seen_by(robot, at, PRESENT_S) {
                continue;
            }
            let away = followed.target.position() - pose.position();
            let sigma = (PIECE_M / away.norm().max(0.3)).min(0.5);
            let off = wrap(bearing_rad - pose.bearing_to(followed.target.position())) / sigma;
            density += PIECES * (-0.5 * off * off).exp() / (sigma * TAU.sqrt());
        }
        density
    }
}
