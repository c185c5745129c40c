//! A robot that moves, followed by what it sees of the standing ones and they of it.
//!
//! State: x, y, heading and their rates, in the team frame, *given* the poses of the standing robots. The rates forget
//! (Ornstein–Uhlenbeck with the stated speeds), so that uncertainty grows like a driving robot's and not like a rocket's.
//! How the estimate depends on the standing robots' poses is carried along as a matrix (Schmidt's consider filter): their
//! errors neither average out over the frames of one drive nor are they counted twice. Once it stands, every frame has the same lasting
//! errors: what it knew on arrival is kept beside, for the sightings since then are those of its station.

use nalgebra::{Matrix3, Matrix6, Matrix6x3, RowVector3, RowVector6, Vector3, Vector6};
use protocol::angle::wrap;
use protocol::frames::Pose2;
use protocol::time::Timestamp;

use super::block::{Block, Departed};
use super::kernel;
use super::slot::Sighted;
use crate::stereo::motion::Step;

/// How long a speed lasts, seconds.
const SPEED_MEMORY_S: f64 = 1.5;
/// A robot notices its motion late: by then it may be this far from where it stood (standard deviation: m, m, rad).
const LATE_START: [f64; 3] = [0.08, 0.08, 0.08];
/// Speeds of a robot that hardly moves, m/s and rad/s.
const REST: [f64; 2] = [0.03, 0.03];
/// Squared sigmas (two numbers) beyond which a sighting is not of this robot.
const GATE: f64 = 16.0;
/// Longest prediction in one go, seconds.
const LONGEST_STEP_S: f64 = 5.0;

/// A moving robot, or one that has come to stand and is not tied to others yet.
#[derive(Debug, Clone)]
pub struct Rover {
    mean: Vector6<f64>,
    cov: Matrix6<f64>,
    dependence: Vec<(usize, Matrix6x3<f64>)>,
    at: Timestamp,
    speeds: [f64; 2],
    arrived: Option<Box<Arrived>>,
}

/// A rover as it came to stand.
#[derive(Debug, Clone)]
struct Arrived {
    /// Before anybody saw it stand.
    before: Rover,
    /// How often each standing robot has seen it stand.
    sightings: Vec<(usize, u32)>,
}

/// One predicted scalar with its derivatives to the rover's state and to the standing robot's pose.
struct Predicted {
    residual: f64,
    own: RowVector6<f64>,
    other: RowVector3<f64>,
    noise: f64,
}

impl Rover {
    /// A robot that has left its station at about `at`; `speeds`: standard deviations, m/s and rad/s.
    pub fn leaving(departed: &Departed, at: Timestamp, speeds: [f64; 2]) -> Self {
        let pose = departed.team_from_body;
        let mut cov = Matrix6::zeros();
        cov.fixed_view_mut::<3, 3>(0, 0).copy_from(&departed.own_covariance);
        for k in 0..3 {
            cov[(k, k)] += LATE_START[k].powi(2);
            cov[(k + 3, k + 3)] = if k < 2 { speeds[0].powi(2) } else { speeds[1].powi(2) };
        }
        let wide = |block: &Matrix3<f64>| {
            let mut d = Matrix6x3::zeros();
            d.fixed_view_mut::<3, 3>(0, 0).copy_from(block);
            d
        };
        Self {
            mean: Vector6::new(pose.x_m, pose.y_m, pose.heading_rad, 0.0, 0.0, 0.0),
            cov,
            dependence: departed.dependence.iter().map(|(m, d)| (*m, wide(d))).collect(),
            at,
            speeds,
            arrived: None,
        }
    }

    /// A robot that is remembered to stand at `pose`.
    pub fn standing_at(pose: Pose2, covariance: &Matrix3<f64>, at: Timestamp, speeds: [f64; 2]) -> Self {
        let mut cov = Matrix6::zeros();
        cov.fixed_view_mut::<3, 3>(0, 0).copy_from(covariance);
        for k in 3..6 {
            cov[(k, k)] = 1e-12;
        }
        let mean = Vector6::new(pose.x_m, pose.y_m, pose.heading_rad, 0.0, 0.0, 0.0);
        Self { mean, cov, dependence: Vec::new(), at, speeds, arrived: None }
    }

    /// Pose at `at`, from the state's time.
    pub fn pose_at(&self, at: Timestamp) -> Pose2 {
        let dt = at.seconds_since(self.at).clamp(-LONGEST_STEP_S, LONGEST_STEP_S);
        let m = &self.mean;
        Pose2::new(m[0] + dt * m[3], m[1] + dt * m[4], m[2] + dt * m[5])
    }

    /// Pose at the state's time.
    pub fn pose(&self) -> Pose2 {
        self.pose_at(self.at)
    }

    /// Whether it hardly moves.
    pub fn rests(&self) -> bool {
        self.mean[3].hypot(self.mean[4]) < REST[0] && self.mean[5].abs() < REST[1]
    }

    /// Covariance of x, y, heading given exact poses of the standing robots, at the state's time.
    pub fn own_covariance(&self) -> Matrix3<f64> {
        self.cov.fixed_view::<3, 3>(0, 0).into_owned()
    }

    /// ∂(x, y, heading)/∂(pose of each standing robot).
    pub fn dependence(&self) -> impl Iterator<Item = (usize, Matrix3<f64>)> + '_ {
        self.dependence.iter().map(|(m, d)| (*m, d.fixed_view::<3, 3>(0, 0).into_owned()))
    }

    /// Covariance of x, y, heading with everything.
    pub fn covariance(&self, block: &Block) -> Matrix3<f64> {
        let mut sum = self.own_covariance();
        for (a, da) in self.dependence() {
            for (b, db) in self.dependence() {
                if let Some(cov) = block.covariance(a, b) {
                    sum += da * cov * db.transpose();
                }
            }
        }
        0.5 * (sum + sum.transpose())
    }

    /// What is known of it but for the sightings since it stands.
    pub fn before_it_stood(&self) -> &Self {
        self.arrived.as_ref().map_or(self, |arrived| &arrived.before)
    }

    /// Predicts to `at`; backwards is ignored. A robot that says it stands has no speed.
    pub fn predict(&mut self, at: Timestamp, standing: bool) {
        self.move_on(at, standing);
        if !standing {
            self.arrived = None;
        } else if self.arrived.is_none() {
            self.arrived = Some(Box::new(Arrived { before: self.clone(), sightings: Vec::new() }));
        }
    }

    fn move_on(&mut self, at: Timestamp, standing: bool) {
        let dt = at.seconds_since(self.at).min(LONGEST_STEP_S);
        if dt <= 0.0 {
            return;
        }
        self.at = at;
        let step = Step::over(dt, SPEED_MEMORY_S);
        let (reach, keep) = if standing { (0.0, 0.0) } else { (step.reach_s, step.keep_velocity) };
        let mut f = Matrix6::identity();
        for k in 0..3 {
            f[(k, k + 3)] = reach;
            f[(k + 3, k + 3)] = keep;
        }
        self.mean = f * self.mean;
        self.mean[2] = wrap(self.mean[2]);
        self.cov = f * self.cov * f.transpose();
        for (_, d) in &mut self.dependence {
            *d = f * *d;
        }
        for k in 0..3 {
            let sigma = self.speeds[usize::from(k == 2)];
            if standing {
                self.cov[(k + 3, k + 3)] = (0.02 * sigma).powi(2);
                continue;
            }
            let [place, both, velocity] = step.grows(2.0 * sigma * sigma / SPEED_MEMORY_S);
            self.cov[(k, k)] += place;
            self.cov[(k, k + 3)] += both;
            self.cov[(k + 3, k)] += both;
            self.cov[(k + 3, k + 3)] += velocity;
        }
    }

    /// Moves by odometry since `since_s` ago: body-frame motion with covariance (x, y, heading).
    pub fn drive(&mut self, at: Timestamp, step: Pose2, covariance: &Matrix3<f64>, since_s: f64) {
        let pose = Pose2::new(self.mean[0], self.mean[1], self.mean[2]);
        let moved = pose * step;
        let (s, c) = pose.heading_rad.sin_cos();
        let rotation = Matrix3::new(c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0);
        let mut f = Matrix6::identity();
        f[(0, 2)] = -(moved.y_m - pose.y_m);
        f[(1, 2)] = moved.x_m - pose.x_m;
        for k in 3..6 {
            f[(k, k)] = 0.0;
        }
        self.arrived = None;
        self.cov = f * self.cov * f.transpose();
        let added = rotation * covariance * rotation.transpose();
        let mut corner = self.cov.fixed_view_mut::<3, 3>(0, 0);
        corner += added;
        for (_, d) in &mut self.dependence {
            *d = f * *d;
        }
        let rate = 1.0 / since_s.max(1e-3);
        self.mean = Vector6::new(
            moved.x_m,
            moved.y_m,
            moved.heading_rad,
            rate * (moved.x_m - pose.x_m),
            rate * (moved.y_m - pose.y_m),
            rate * step.heading_rad,
        );
        for k in 0..3 {
            self.cov[(k + 3, k + 3)] = (0.2 * self.speeds[usize::from(k == 2)]).powi(2);
        }
        self.at = self.at.max(at);
    }

    /// Squared distance (two numbers, in sigmas) of a sighting of this robot by the standing `member`; `None` outside the gate.
    pub fn distance2_seen(&self, block: &Block, member: usize, at: Timestamp, sighted: &Sighted) -> Option<f64> {
        let terms = self.seen(block, member, at, sighted)?;
        self.distance2(block, member, &terms)
    }

    /// The same of this robot's sighting of the standing `member`.
    pub fn distance2_sees(&self, block: &Block, member: usize, at: Timestamp, sighted: &Sighted) -> Option<f64> {
        let terms = self.sees(block, member, at, sighted)?;
        self.distance2(block, member, &terms)
    }

    /// The same of this robot's sighting of `other`, which moves as well. How both depend on the same standing robots is left
    /// out.
    pub fn distance2_between(&self, block: &Block, other: &Self, at: Timestamp, sighted: &Sighted) -> Option<f64> {
        let (me, there) = (self.pose_at(at), other.pose_at(at));
        let (from, to) = ([me.x_m, me.y_m, me.heading_rad], [there.x_m, there.y_m]);
        let (mine, theirs) = (self.covariance(block), other.covariance(block));
        let variance = |f: [f64; 3], t: [f64; 2]| {
            let (f, t) = (RowVector3::from(f), RowVector3::new(t[0], t[1], 0.0));
            (f * mine * f.transpose() + t * theirs * t.transpose())[0]
        };
        let (bearing, b_from, b_to) = kernel::bearing(from, to);
        let mut sum = wrap(sighted.bearing_rad - bearing).powi(2) / (sighted.bearing_var + variance(b_from, b_to));
        if let Some((width_rad, noise)) = sighted.width_rad {
            let (range, d_from, d_to) = kernel::distance(from, to);
            let (width, slope) = kernel::width(range);
            let residual = width_rad - width - block.common_width_rad();
            sum += residual * residual / (noise + slope * slope * variance(d_from, d_to));
        }
        (sum < GATE).then_some(sum)
    }

    /// The standing `member` saw this robot; `floored`: with what frames of the same view have in common.
    pub fn update_seen(&mut self, block: &Block, member: usize, at: Timestamp, frame: &Sighted, floored: &Sighted) {
        let seen = self.arrived.as_mut().map_or(1, |arrived| arrived.once_more(member));
        if let Some(terms) = self.seen(block, member, at, &frame.nth(floored, seen)) {
            self.update(member, &terms);
        }
    }

    /// This robot saw the standing `member`.
    pub fn update_sees(&mut self, block: &Block, member: usize, at: Timestamp, sighted: &Sighted) {
        if let Some(terms) = self.sees(block, member, at, sighted) {
            self.update(member, &terms);
        }
    }

    /// The standing robots' poses were corrected by `shift` (x, y, heading) of `member`.
    pub fn shift(&mut self, member: usize, shift: &Vector3<f64>) {
        if let Some((_, d)) = self.dependence.iter().find(|(m, _)| *m == member) {
            self.mean += d * shift;
            self.mean[2] = wrap(self.mean[2]);
        }
        if let Some(arrived) = &mut self.arrived {
            arrived.before.shift(member, shift);
        }
    }

    /// `member` leaves its station: what its error contributed stays as this robot's own.
    pub fn forget(&mut self, member: usize, covariance: &Matrix3<f64>) {
        if let Some(k) = self.dependence.iter().position(|(m, _)| *m == member) {
            let (_, d) = self.dependence.swap_remove(k);
            self.cov += d * covariance * d.transpose();
        }
        if let Some(arrived) = &mut self.arrived {
            arrived.before.forget(member, covariance);
        }
    }

    fn seen(&self, block: &Block, member: usize, at: Timestamp, sighted: &Sighted) -> Option<Vec<Predicted>> {
        let m = block.pose(member)?;
        let dt = at.seconds_since(self.at);
        let me = self.pose_at(at);
        let (from, to) = ([m.x_m, m.y_m, m.heading_rad], [me.x_m, me.y_m]);
        let (bearing, b_pose, b_point) = kernel::bearing(from, to);
        let own = |p: [f64; 2]| RowVector6::new(p[0], p[1], 0.0, dt * p[0], dt * p[1], 0.0);
        let mut terms = vec![Predicted {
            residual: wrap(sighted.bearing_rad - bearing),
            own: own(b_point),
            other: RowVector3::from(b_pose),
            noise: sighted.bearing_var,
        }];
        if let Some((width_rad, noise)) = sighted.width_rad {
            let (range, d_pose, d_point) = kernel::distance(from, to);
            let (width, slope) = kernel::width(range);
            terms.push(Predicted {
                residual: width_rad - width - block.common_width_rad(),
                own: own(d_point) * slope,
                other: RowVector3::from(d_pose) * slope,
                noise,
            });
        }
        Some(terms)
    }

    fn sees(&self, block: &Block, member: usize, at: Timestamp, sighted: &Sighted) -> Option<Vec<Predicted>> {
        let m = block.pose(member)?;
        let dt = at.seconds_since(self.at);
        let me = self.pose_at(at);
        let (from, to) = ([me.x_m, me.y_m, me.heading_rad], [m.x_m, m.y_m]);
        let (bearing, b_pose, b_point) = kernel::bearing(from, to);
        let own = |p: [f64; 3]| RowVector6::new(p[0], p[1], p[2], dt * p[0], dt * p[1], dt * p[2]);
        let mut terms = vec![Predicted {
            residual: wrap(sighted.bearing_rad - bearing),
            own: own(b_pose),
            other: RowVector3::new(b_point[0], b_point[1], 0.0),
            noise: sighted.bearing_var,
        }];
        if let Some((width_rad, noise)) = sighted.width_rad {
            let (range, d_pose, d_point) = kernel::distance(from, to);
            let (width, slope) = kernel::width(range);
            terms.push(Predicted {
                residual: width_rad - width - block.common_width_rad(),
                own: own(d_pose) * slope,
                other: RowVector3::new(d_point[0], d_point[1], 0.0) * slope,
                noise,
            });
        }
        Some(terms)
    }

    /// Sum over the scalars; their correlation through the state is left out, which only widens the gate.
    fn distance2(&self, block: &Block, member: usize, terms: &[Predicted]) -> Option<f64> {
        let mut sum = 0.0;
        for term in terms {
            let mut var = (term.own * self.cov * term.own.transpose())[0] + term.noise;
            for (a, da) in &self.dependence {
                if let Some(cov) = block.covariance(*a, *a) {
                    let row = term.own * da + if *a == member { term.other } else { RowVector3::zeros() };
                    var += (row * cov * row.transpose())[0];
                }
            }
            sum += term.residual * term.residual / var;
        }
        (sum < GATE).then_some(sum)
    }

    fn update(&mut self, member: usize, terms: &[Predicted]) {
        let mut moved = Vector6::zeros();
        for term in terms {
            let s = (term.own * self.cov * term.own.transpose())[0] + term.noise;
            let gain = self.cov * term.own.transpose() / s;
            let residual = term.residual - (term.own * moved)[0];
            moved += gain * residual;
            let keep = Matrix6::identity() - gain * term.own;
            self.cov = keep * self.cov * keep.transpose() + gain * term.noise * gain.transpose();
            if !self.dependence.iter().any(|(m, _)| *m == member) {
                self.dependence.push((member, Matrix6x3::zeros()));
            }
            for (m, d) in &mut self.dependence {
                *d = keep * *d;
                if *m == member {
                    *d -= gain * term.other;
                }
            }
        }
        self.mean += moved;
        self.mean[2] = wrap(self.mean[2]);
    }
}

impl Arrived {
    /// How often `member` has seen it stand, with this time.
    fn once_more(&mut self, member: usize) -> u32 {
        let Some((_, n)) = self.sightings.iter_mut().find(|(m, _)| *m == member) else {
            self.sightings.push((member, 1));
            return 1;
        };
        *n = n.saturating_add(1);
        *n
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_that_stands_is_no_surer_than_the_lasting_error_of_who_sees_it_and_arrived_with_what_it_knew() {
        let at = |s: f64| Timestamp::from_secs_f64(1000.0 + s);
        let mut block = Block::new(1e-6);
        block.insert(0, Pose2::IDENTITY, &(Matrix3::identity() * 1e-12));
        let (true_sigma_m, lasting_rad) = (0.1, 1e-3);
        let there = Pose2::new(3.0, 0.0, 0.0);
        let mut rover =
            Rover::standing_at(there, &(Matrix3::identity() * true_sigma_m * true_sigma_m), at(0.0), [0.5, 0.5]);
        let frame =
            Sighted { bearing_rad: 0.0, bearing_var: 1e-8, width_rad: None, frame_var: (1e-8, 0.0), robot: None };
        let floored = Sighted { bearing_var: 1e-8 + lasting_rad * lasting_rad, ..frame };
        for k in 1..=200 {
            rover.predict(at(0.1 * f64::from(k)), true);
            rover.update_seen(&block, 0, at(0.1 * f64::from(k)), &frame, &floored);
        }
        let across_m = rover.own_covariance()[(1, 1)].sqrt();
        assert!((across_m / (3.0 * lasting_rad) - 1.0).abs() < 0.01, "{across_m}");
        let before_m = rover.before_it_stood().own_covariance()[(1, 1)].sqrt();
        assert!((before_m / true_sigma_m - 1.0).abs() < 0.01, "{before_m}");
        // It drives on by its wheels: what it knew on arrival is of another place.
        rover.drive(at(20.5), Pose2::new(1.0, 0.0, 0.0), &(Matrix3::identity() * 1e-4), 0.5);
        rover.predict(at(20.6), true);
        assert!(rover.before_it_stood().pose().x_m > 3.9, "{:?}", rover.before_it_stood().pose());
    }
}
