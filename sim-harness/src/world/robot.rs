//! A robot's way through the run: where it stands, when it drives, when its pictures are taken, what its clock says.

use std::sync::Arc;

use nalgebra::Vector2;
use protocol::id::RobotId;
use protocol::time::Timestamp;
use rand::{Rng, RngExt};

use crate::scenario::{BeaconSpec, CaptureSpec, DriveSpec, WearSpec};

/// Zero of the true time on every clock of the team before its own offset, so that no stamp is negative.
pub const START_STAMP_S: f64 = 1.0;

/// A robot of the run.
#[derive(Debug, Clone)]
pub struct Robot {
    /// Its name.
    pub id: RobotId,
    /// Its clock minus true time, constant.
    pub clock_offset_s: f64,
    /// Its pictures, in order.
    pub captures: Vec<Capture>,
    /// Pose before the first drive: x m, y m, heading rad.
    pub first_pose: [f64; 3],
    /// Its drives, in order.
    pub drives: Vec<DriveSpec>,
    /// What it wears.
    pub wear: Arc<WearSpec>,
    /// The lamp above it.
    pub blink: Option<Blink>,
}

/// A lamp that blinks a code again and again.
#[derive(Debug, Clone, PartialEq)]
pub struct Blink {
    /// Lit or dark.
    bits: Vec<bool>,
    bit_s: f64,
    /// When it began: every robot was switched on at another time.
    begun_s: f64,
}

impl Blink {
    /// Begun so long before the run.
    pub fn new(spec: &BeaconSpec, begun_s: f64) -> Self {
        let bits = spec.code.bytes().map(|bit| bit == b'1').collect();
        Self { bits, bit_s: 1e-3 * f64::from(spec.bit_ms), begun_s }
    }

    /// Whether it is lit at a true time.
    pub fn is_lit(&self, time_s: f64) -> bool {
        let bit = ((time_s + self.begun_s) / self.bit_s).floor() as i64;
        self.bits.get(bit.rem_euclid(self.bits.len().max(1) as i64) as usize).is_some_and(|lit| *lit)
    }
}

/// One picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Capture {
    /// Mid-exposure, seconds of true time since the start.
    pub true_time_s: f64,
    /// The same instant on the robot's clock: `START_STAMP_S + true_time_s + clock_offset_s` since the team's zero.
    pub stamp: Timestamp,
}

/// A robot at an instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RobotState {
    /// Which.
    pub id: RobotId,
    /// Room frame.
    pub x_m: f64,
    /// Room frame.
    pub y_m: f64,
    /// Counter-clockwise from the room's x, unwrapped.
    pub heading_rad: f64,
    /// Whether it drives or turns.
    pub moving: bool,
}

impl Robot {
    /// Where it is at a true time.
    pub fn at(&self, time_s: f64) -> RobotState {
        let [mut x_m, mut y_m, mut heading_rad] = self.first_pose;
        let mut moving = false;
        for drive in &self.drives {
            let share = ((time_s - drive.start_s) / (drive.end_s - drive.start_s)).clamp(0.0, 1.0);
            moving |= share > 0.0 && share < 1.0;
            // The way first, the turn after it.
            let straight = match (drive.distance_m > 0.0, drive.turn_deg.abs() > 0.0) {
                (true, true) => 0.65,
                (true, false) => 1.0,
                _ => 0.0,
            };
            let way = if straight > 0.0 { smooth(share / straight) * drive.distance_m } else { 0.0 };
            let turn = if straight < 1.0 { smooth((share - straight) / (1.0 - straight)) } else { 0.0 };
            x_m += way * heading_rad.cos();
            y_m += way * heading_rad.sin();
            heading_rad += turn * drive.turn_deg.to_radians();
        }
        RobotState { id: self.id, x_m, y_m, heading_rad, moving }
    }

    /// The places where it stands between drives.
    pub fn stations(&self) -> Vec<Vector2<f64>> {
        std::iter::once(f64::NEG_INFINITY)
            .chain(self.drives.iter().map(|d| d.end_s))
            .map(|t| {
                let s = self.at(if t.is_finite() { t } else { -1e6 });
                Vector2::new(s.x_m, s.y_m)
            })
            .collect()
    }

    /// Whether it stands still for the whole run.
    pub fn stands(&self) -> bool {
        self.drives.is_empty()
    }
}

/// 0 … 1 with speed and acceleration zero at both ends.
fn smooth(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * x * (10.0 - 15.0 * x + 6.0 * x * x)
}

/// Clock offset and capture times of a robot.
pub fn schedule(spec: &CaptureSpec, duration_s: f64, rng: &mut impl Rng) -> (f64, Vec<Capture>) {
    let spread = |rng: &mut dyn FnMut() -> f64, amount: f64| (2.0 * rng() - 1.0) * amount;
    let mut draw = || rng.random::<f64>();
    let clock_offset_s = spread(&mut draw, spec.clock_offset_ms * 1e-3);
    let jitter_s = spec.jitter_ms * 1e-3;
    let phase_s = jitter_s + draw() * (1.0 / spec.rate_hz);
    let mut captures = Vec::new();
    loop {
        let true_time_s = phase_s + captures.len() as f64 / spec.rate_hz + spread(&mut draw, jitter_s);
        if true_time_s > duration_s {
            return (clock_offset_s, captures);
        }
        let stamp = Timestamp(((START_STAMP_S + true_time_s + clock_offset_s) * 1e9).round() as u64);
        captures.push(Capture { true_time_s, stamp });
    }
}
