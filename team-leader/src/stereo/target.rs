//! One moving object followed by bearings.
//!
//! State: position and velocity on the floor and height of the top, *given* exact poses of the robots; how it depends on their poses is carried
//! along (Schmidt's consider filter), so that `cov = own + J Σ Jᵀ` holds for any pair of entries of the map, and errors of
//! the calibration never average out over frames. He stands or walks (`modes`); velocities forget (people turn), driven by white
//! acceleration. What is wrong about a robot's bearings lasts (gait; what is behind somebody who stands), so its part that lasts is in
//! the state as well: it never averages out within the time that it lasts.
//!
//! Where rays cross well they measure the height of the top. That stays with somebody, and where rays cross badly, or there is
//! only one, the top's elevation gives the range: D = (Z − H) / tan α (`MATHS.md` §7, 11). One filter of both does either as it should be.

use nalgebra::{Matrix2, Matrix5, RowVector3, RowVector5, Vector2, Vector3, Vector5};
use protocol::angle::wrap;
use protocol::frames::Pose2;
use protocol::time::Timestamp;

use crate::calibration::kernel;

mod modes;

use modes::{Lasting, Measured, Modes, NEW_VELOCITY_MPS, TOP};

pub use modes::{ERRORS_LAST_S, LASTING, SHIFTS_M2PS, STANDS_S, VELOCITY_MEMORY_S, WALKS_S};

/// Longest prediction in one go, seconds.
const LONGEST_STEP_S: f64 = 5.0;
/// Before its first bearings a target may be anywhere this far around, m.
const NEW_POSITION_M: f64 = 5.0;

/// A measured range further from what is expected is of something else (feet that something hides), sigmas.
pub const RANGE_GATE_SIGMAS: f64 = 2.5;

/// How much a head moves up and down with the gait and its upper end with what is behind it, m; how well the height may become known at
/// most, m; beyond so many sigmas it is a hand or half a head.
const TOP_SWAY_M: f64 = 0.03;
const TOP_FLOOR_M: f64 = 0.02;
const TOP_GATE_SIGMAS: f64 = 3.0;
/// Tops nearer to the horizon, rad, or to the camera's height, m, say nothing about range.
const LEAST_ELEVATION_RAD: f64 = 0.03;
const LEAST_ABOVE_M: f64 = 0.2;

/// How a range fits.
struct RangeInnovation {
    residual: f64,
    var: f64,
    own: RowVector5<f64>,
    to_pose: RowVector3<f64>,
}

/// A target's filter.
#[derive(Debug, Clone)]
pub struct Target {
    modes: Modes,
    at: Timestamp,
    acceleration_m2ps3: f64,
    top_seen: bool,
}

/// A top seen from a standing robot.
#[derive(Debug, Clone, Copy)]
pub struct TopFrom {
    /// Which robot.
    pub robot: usize,
    /// Its pose.
    pub pose: Pose2,
    /// Its camera above the floor, m.
    pub camera_height_m: f64,
    /// Elevation with its standard deviation, rad.
    pub elevation_rad: (f64, f64),
    /// Capture, leader's clock.
    pub at: Timestamp,
    /// By how much its variance is taken larger, for errors of successive frames are alike.
    pub repeat: f64,
}

/// A bearing from a standing robot.
#[derive(Debug, Clone, Copy)]
pub struct BearingFrom {
    /// Which robot.
    pub robot: usize,
    /// Its pose.
    pub pose: Pose2,
    /// In its body frame.
    pub bearing_rad: f64,
    /// rad².
    pub var: f64,
    /// The part of it that lasts (how he holds himself, what is behind him): much the same in the next frames of the same robot.
    pub lasting: f64,
    /// Capture, leader's clock.
    pub at: Timestamp,
    /// Since the same robot's bearing before, seconds.
    pub interval_s: f64,
}

/// How a bearing fits.
#[derive(Debug, Clone, Copy)]
pub struct Innovation {
    /// Measured − predicted, rad.
    pub residual_rad: f64,
    /// Its variance without the poses' errors, rad².
    pub var: f64,
    /// Predicted distance, m.
    pub range_m: f64,
    own: RowVector5<f64>,
    other: RowVector3<f64>,
}

impl Innovation {
    /// Derivative of the predicted bearing to the position.
    pub fn to_position(&self) -> nalgebra::RowVector2<f64> {
        nalgebra::RowVector2::new(self.own[0], self.own[1])
    }

    /// Derivative of the predicted bearing to the observer's pose.
    pub fn to_pose(&self) -> RowVector3<f64> {
        self.other
    }
}

impl Target {
    /// A target at about `position`; its first bearings come by [`Target::update`]. `top_m`: expected height and spread.
    pub fn new(position: Vector2<f64>, at: Timestamp, acceleration_m2ps3: f64, top_m: (f64, f64)) -> Self {
        let (p, v) = (NEW_POSITION_M.powi(2), NEW_VELOCITY_MPS.powi(2));
        let mean = Vector5::new(position.x, position.y, 0.0, 0.0, top_m.0);
        let cov = Matrix5::from_diagonal(&Vector5::new(p, p, v, v, top_m.1 * top_m.1));
        Self { modes: Modes::new(&mean, &cov), at, acceleration_m2ps3, top_seen: false }
    }

    fn mean(&self) -> &Vector5<f64> {
        self.modes.mean()
    }

    fn cov(&self) -> &Matrix5<f64> {
        self.modes.cov()
    }

    /// Where it is at the state's time.
    pub fn position(&self) -> Vector2<f64> {
        Vector2::new(self.mean()[0], self.mean()[1])
    }

    /// m/s.
    pub fn velocity(&self) -> Vector2<f64> {
        Vector2::new(self.mean()[2], self.mean()[3])
    }

    /// Covariance of the position given exact poses, m².
    pub fn own_covariance(&self) -> Matrix2<f64> {
        self.cov().fixed_view::<2, 2>(0, 0).into_owned()
    }

    /// ∂(x, y)/∂(pose of each standing robot).
    pub fn dependence(&self) -> impl Iterator<Item = (usize, nalgebra::Matrix2x3<f64>)> + '_ {
        self.modes.dependence()
    }

    /// Larger axis of the own covariance, m.
    pub fn sigma_m(&self) -> f64 {
        let (xx, xy, yy) = (self.cov()[(0, 0)], self.cov()[(0, 1)], self.cov()[(1, 1)]);
        (0.5 * (xx + yy) + (0.5 * (xx - yy)).hypot(xy)).max(0.0).sqrt()
    }

    /// Height of the top and its variance, and whether it was ever seen.
    pub fn top_m(&self) -> ((f64, f64), bool) {
        ((self.mean()[TOP], self.cov()[(TOP, TOP)].max(TOP_FLOOR_M.powi(2))), self.top_seen)
    }

    /// How long it was not predicted, seconds.
    pub fn since_s(&self, at: Timestamp) -> f64 {
        at.seconds_since(self.at)
    }

    /// Predicts to `at`; backwards is ignored.
    pub fn predict(&mut self, at: Timestamp) {
        let dt = self.since_s(at).min(LONGEST_STEP_S);
        if dt <= 0.0 {
            return;
        }
        self.at = at;
        self.modes.predict(dt, self.acceleration_m2ps3);
    }

    /// How a bearing fits, without using it. A bearing older than the state is compared with where the target was then.
    pub fn innovation(&self, m: &BearingFrom) -> Innovation {
        let (dt, then) = self.place_at(m.at);
        let from = [m.pose.x_m, m.pose.y_m, m.pose.heading_rad];
        let (bearing, to_pose, to_point) = kernel::bearing(from, then);
        let own = RowVector5::new(to_point[0], to_point[1], dt * to_point[0], dt * to_point[1], 0.0);
        let (range_m, _, _) = kernel::distance(from, then);
        let var = (own * self.cov() * own.transpose())[0] + m.var;
        Innovation { residual_rad: wrap(m.bearing_rad - bearing), var, range_m, own, other: RowVector3::from(to_pose) }
    }

    /// How far away it was from a robot, m.
    pub fn range_m(&self, pose: &Pose2, at: Timestamp) -> f64 {
        kernel::distance([pose.x_m, pose.y_m, pose.heading_rad], self.place_at(at).1).0
    }

    /// Seconds since the state, and where it was then.
    fn place_at(&self, at: Timestamp) -> (f64, [f64; 2]) {
        let dt = at.seconds_since(self.at).clamp(-LONGEST_STEP_S, LONGEST_STEP_S);
        (dt, [self.mean()[0] + dt * self.mean()[2], self.mean()[1] + dt * self.mean()[3]])
    }

    /// Uses a bearing.
    pub fn update(&mut self, m: &BearingFrom) {
        self.update_stretched(m, 1.0);
    }

    /// Uses a bearing that is far off, and moves the target as if its variance were so many times larger.
    pub fn update_stretched(&mut self, m: &BearingFrom, stretch: f64) {
        let Innovation { own, residual_rad: residual, other, .. } = self.innovation(m);
        let lasting = Lasting { robot: m.robot, at: m.at, interval_s: m.interval_s, var: m.lasting };
        self.modes.correct(&Measured {
            own,
            pose: Some((m.robot, other)),
            residual,
            var: m.var - m.lasting,
            stretch,
            lasting: Some(lasting),
        });
    }

    /// Uses a measurement all of whose error is new, by its derivatives to the state and to the pose of a robot.
    fn correct(&mut self, own: &RowVector5<f64>, residual: f64, var: f64, pose: Option<(usize, RowVector3<f64>)>) {
        self.modes.correct(&Measured { own: *own, pose, residual, var, stretch: 1.0, lasting: None });
    }

    /// Uses a range along the floor from a robot (weak; for targets that one robot alone sees).
    pub fn update_range(&mut self, pose: &Pose2, range_m: f64, var: f64) {
        let innovation = self.range_innovation(pose, range_m, var);
        self.correct(&innovation.own, innovation.residual, var, None);
    }

    /// Uses a measured range along the floor from a robot, whose pose's error it shares from then on; not beyond
    /// [`RANGE_GATE_SIGMAS`].
    pub fn update_measured_range(&mut self, robot: usize, pose: &Pose2, range_m: f64, var: f64) {
        let innovation = self.range_innovation(pose, range_m, var);
        if innovation.residual.powi(2) <= RANGE_GATE_SIGMAS.powi(2) * innovation.var {
            self.correct(&innovation.own, innovation.residual, var, Some((robot, innovation.to_pose)));
        }
    }

    fn range_innovation(&self, pose: &Pose2, range_m: f64, var: f64) -> RangeInnovation {
        let from = [pose.x_m, pose.y_m, pose.heading_rad];
        let (predicted, to_pose, to_point) = kernel::distance(from, [self.mean()[0], self.mean()[1]]);
        let own = RowVector5::new(to_point[0], to_point[1], 0.0, 0.0, 0.0);
        let var = (own * self.cov() * own.transpose())[0] + var;
        RangeInnovation { residual: range_m - predicted, var, own, to_pose: RowVector3::from(to_pose) }
    }

    /// Uses the elevation of the top: of the height above the camera and the range it tells the less known by the other.
    pub fn update_top(&mut self, m: &TopFrom) {
        let (elevation, sigma) = m.elevation_rad;
        let above_m = self.mean()[TOP] - m.camera_height_m;
        if elevation < LEAST_ELEVATION_RAD || above_m < LEAST_ABOVE_M {
            return;
        }
        let (dt, then) = self.place_at(m.at);
        let (range_m, to_pose, to_point) = kernel::distance([m.pose.x_m, m.pose.y_m, m.pose.heading_rad], then);
        // Its derivatives are taken where it is expected: at the measured elevation they would err with it, and sigmas come out too
        // small by a quarter.
        let square = range_m * range_m + above_m * above_m;
        let (to_range, to_height) = (-above_m / square, range_m / square);
        let [dx, dy] = to_point.map(|d| d * to_range);
        let own = RowVector5::new(dx, dy, dt * dx, dt * dy, to_height);
        let noise = (sigma * sigma + (TOP_SWAY_M * to_height).powi(2)) * m.repeat;
        let residual = elevation - above_m.atan2(range_m);
        let d2 = residual * residual / ((own * self.cov() * own.transpose())[0] + noise);
        if d2 > TOP_GATE_SIGMAS.powi(2) {
            return;
        }
        self.correct(&own, residual, noise, Some((m.robot, RowVector3::from(to_pose) * to_range)));
        self.top_seen = true;
    }

    /// Takes over the height of the top from what was known of the same object before.
    pub fn keep_top(&mut self, before: &Self) {
        let ((top_m, var), seen) = before.top_m();
        self.modes.set_top(top_m, var);
        self.top_seen = seen;
    }

    /// The robot's pose was corrected by `shift` (x, y, heading).
    pub fn shift(&mut self, robot: usize, shift: &Vector3<f64>) {
        self.modes.shift(robot, shift);
    }

    /// The robot leaves its station: what its error contributed stays as the target's own.
    pub fn forget(&mut self, robot: usize, covariance: &nalgebra::Matrix3<f64>) {
        self.modes.forget(robot, covariance);
    }
}

#[cfg(test)]
mod tests;
