//! How a person moves: he stands or he walks, and which is not known. Each of the two has a filter of its own, and every measurement says
//! which explains it better (interacting multiple models: Blom and Bar-Shalom, IEEE Trans. Automatic Control 33, 1988).
//!
//! One filter for both has to believe of people who stand that they may walk off at any time, and follows those who turn too late: the
//! squared errors were half of what it said of people who stood, and a fifth more than it said of people who walked.

use nalgebra::{Matrix2x3, Matrix3, Matrix5, RowVector3, RowVector5, Vector3, Vector5};
use protocol::time::Timestamp;

use crate::stereo::motion::Step;
use crate::stereo::tails::log_student;

/// How long a velocity lasts, seconds.
pub const VELOCITY_MEMORY_S: f64 = 2.5;
/// Standard deviation of the velocity of somebody of whom nothing is known but that he walks, m/s.
pub const NEW_VELOCITY_MPS: f64 = 0.5;
/// How long people stand, seconds.
pub const STANDS_S: f64 = 3.0;
/// How long they walk, seconds.
pub const WALKS_S: f64 = 10.0;
/// Somebody who stands shifts his weight: variance of the position, m² a second, and standard deviation of the velocity, m/s. More than he
/// does, for not all that is wrong about the bearings of somebody who stands is each robot's own.
pub const SHIFTS_M2PS: f64 = 2e-3;
const SHIFTS_MPS: f64 = 0.05;
/// The part of a bearing's variance that lasts. On the bearings of robots in rendered rooms that is nearly all of it, but what comes of a
/// sudden (two people in one outline) must not count as a move.
pub const LASTING: f64 = 0.44;
/// For about how long it does, seconds, on the same bearings: of somebody who stands, who is seen before the same things in the same
/// light, and of somebody who walks, whose gait comes back.
pub const ERRORS_LAST_S: [f64; 2] = [4.0, 0.36];
/// The highest that is seen of somebody changes with his hair and what is behind it: variance of the height, m² a second. Less than it
/// would take to explain by a shrinking body that somebody goes away.
const TOP_M2PS: f64 = 2e-5;
/// Its index in the state, and the length of that.
pub const TOP: usize = 4;
const BODY: usize = 5;
/// Robots whose lasting errors are followed, so many at a time. Of who stands among more, each of the others says little: no more than if
/// every error of it that lasts were told apart.
const OBSERVERS: usize = 4;
const STATES: usize = BODY + OBSERVERS;
/// Who has not seen him for so long leaves his place among them to another, seconds.
const STALE_S: f64 = 1.0;
/// Who is far off is mostly somebody else: variances grow so many times faster than heavy tails alone ask for.
const FAR_OFF: f64 = 6.0;
/// No measurement rules out either: least probability.
const LEAST_PROBABILITY: f64 = 1e-6;

/// One number for each entry of the state: position and velocity on the floor, height of the top, then for each of some robots the error of
/// its bearings of this body that lasts, as a part of its standard deviation. Matrices are arrays of columns.
type Column = [f64; STATES];
type Cov = [Column; STATES];
/// How the state depends on a robot's pose.
type ToPose = [Column; 3];

/// `to` becomes so much of itself and so much of another.
fn blend(to: &mut Column, own: f64, other: &Column, share: f64) {
    for (to, of) in to.iter_mut().zip(other) {
        *to = own * *to + share * of;
    }
}

fn dot(a: &Column, b: &Column) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// How the state goes on.
#[derive(Debug, Clone, Copy)]
struct Motion {
    /// Position per velocity, seconds, and what is left of the velocity and of the bearings' errors.
    reach_s: f64,
    keep_velocity: f64,
    keep_errors: f64,
}

impl Motion {
    fn apply(&self, state: &mut Column) {
        for k in 0..2 {
            state[k] += self.reach_s * state[k + 2];
            state[k + 2] *= self.keep_velocity;
        }
        state[BODY..].iter_mut().for_each(|error| *error *= self.keep_errors);
    }
}

/// What is known of somebody, given what he does and exact poses of the robots.
#[derive(Debug, Clone, Copy)]
struct Estimate {
    mean: Column,
    cov: Cov,
}

impl Estimate {
    /// Becomes the mixture of itself and so large a share of another.
    fn blend(&mut self, other: &Self, share: f64) {
        let own = 1.0 - share;
        let mut apart = other.mean;
        blend(&mut apart, 1.0, &self.mean, -1.0);
        for (j, column) in self.cov.iter_mut().enumerate() {
            blend(column, own, &other.cov[j], share);
            blend(column, 1.0, &apart, own * share * apart[j]);
        }
        blend(&mut self.mean, own, &other.mean, share);
    }

    /// Nothing is known of an entry of the state but its variance.
    fn reset(&mut self, entry: usize, var: f64) {
        self.cov[entry] = [0.0; STATES];
        self.cov.iter_mut().for_each(|column| column[entry] = 0.0);
        self.cov[entry][entry] = var;
    }

    /// Time goes on, and new errors of bearings come.
    fn advance(&mut self, motion: &Motion) {
        motion.apply(&mut self.mean);
        self.cov.iter_mut().for_each(|column| motion.apply(column));
        for k in 0..2 {
            let velocity = self.cov[k + 2];
            blend(&mut self.cov[k], 1.0, &velocity, motion.reach_s);
            self.cov[k + 2].iter_mut().for_each(|c| *c *= motion.keep_velocity);
        }
        for k in BODY..STATES {
            self.cov[k].iter_mut().for_each(|c| *c *= motion.keep_errors);
            self.cov[k][k] += 1.0 - motion.keep_errors * motion.keep_errors;
        }
    }

    /// See [`Modes::correct`]: moves by the gain, which is returned with the measurement's density. That has heavy tails, as bearings do:
    /// what the narrower of the two modes does not explain, time and again, speaks for the wider one. By Gaussians of stretched variances
    /// neither would be worse, and a target that stands at a crossing of rays of two different people would stay there.
    fn correct(&mut self, row: &Column, residual: f64, var: f64, widened: f64) -> (Column, f64) {
        let residual = residual - (BODY..STATES).map(|k| row[k] * self.mean[k]).sum::<f64>();
        let mut seen = [0.0; STATES];
        for (column, part) in self.cov.iter().zip(row).filter(|(_, part)| **part != 0.0) {
            blend(&mut seen, 1.0, column, *part);
        }
        let var = var + dot(row, &seen);
        let gain = seen.map(|s| s / (var + widened));
        blend(&mut self.mean, 1.0, &gain, residual);
        for (column, s) in self.cov.iter_mut().zip(&seen) {
            blend(column, 1.0, &gain, -s);
        }
        (gain, log_student(residual * residual / var, var).exp())
    }
}

/// How the state depends on a robot's pose, if he stands and if he walks.
#[derive(Debug, Clone, Copy)]
struct Dependence {
    robot: usize,
    stands: ToPose,
    walks: ToPose,
}

impl Dependence {
    fn each(&mut self) -> [&mut ToPose; 2] {
        [&mut self.stands, &mut self.walks]
    }
}

/// A measurement of the state.
#[derive(Debug, Clone, Copy)]
pub struct Measured {
    /// Its derivatives to position, velocity and height.
    pub own: RowVector5<f64>,
    /// The robot whose pose it depends on, and its derivatives to that.
    pub pose: Option<(usize, RowVector3<f64>)>,
    /// How far off it is of what is predicted, whether he stands or walks.
    pub residual: f64,
    /// Its variance without the part that lasts.
    pub var: f64,
    /// By the tails of its errors ([`crate::stereo::tails::stretch`]): the state moves as if the variance were larger.
    pub stretch: f64,
    /// What lasts of its error.
    pub lasting: Option<Lasting>,
}

/// A part of a measurement's error that is much the same in the next frames of the same robot.
#[derive(Debug, Clone, Copy)]
pub struct Lasting {
    /// Whose.
    pub robot: usize,
    /// When.
    pub at: Timestamp,
    /// Since the one before, seconds.
    pub interval_s: f64,
    /// Variance.
    pub var: f64,
}

/// What is known if he stands and if he walks, and of both together.
#[derive(Debug, Clone)]
pub struct Modes {
    stands: Estimate,
    walks: Estimate,
    walking: f64,
    /// In one order for both.
    dependence: Vec<Dependence>,
    /// Whose errors that last are in the state, and when each saw him last.
    observers: [Option<(usize, Timestamp)>; OBSERVERS],
    mean: Vector5<f64>,
    cov: Matrix5<f64>,
}

impl Modes {
    /// Of somebody of whom this is known.
    pub fn new(mean: &Vector5<f64>, cov: &Matrix5<f64>) -> Self {
        let mut known = Estimate { mean: [0.0; STATES], cov: [[0.0; STATES]; STATES] };
        known.mean[..BODY].copy_from_slice(mean.as_slice());
        for (column, of) in known.cov.iter_mut().zip(cov.column_iter()) {
            column[..BODY].copy_from_slice(of.as_slice());
        }
        (BODY..STATES).for_each(|k| known.cov[k][k] = 1.0);
        Self {
            stands: known,
            walks: known,
            walking: WALKS_S / (STANDS_S + WALKS_S),
            dependence: Vec::new(),
            observers: [None; OBSERVERS],
            mean: *mean,
            cov: *cov,
        }
    }

    /// x, y, their velocities, height, whether he stands or walks.
    pub fn mean(&self) -> &Vector5<f64> {
        &self.mean
    }

    /// Its covariance given exact poses of the robots.
    pub fn cov(&self) -> &Matrix5<f64> {
        &self.cov
    }

    /// ∂(x, y)/∂(pose) of each robot that contributed.
    pub fn dependence(&self) -> impl Iterator<Item = (usize, Matrix2x3<f64>)> + '_ {
        let [stands, walks] = [1.0 - self.walking, self.walking];
        let of = move |d: &Dependence| Matrix2x3::from_fn(|k, c| stands * d.stands[c][k] + walks * d.walks[c][k]);
        self.dependence.iter().map(move |d| (d.robot, of(d)))
    }

    /// Time goes on. `acceleration_m2ps3`: of somebody who walks.
    pub fn predict(&mut self, dt_s: f64, acceleration_m2ps3: f64) {
        let left = |lasts_s: f64| (-dt_s / lasts_s).exp();
        let (standing, starts, stops) = (1.0 - self.walking, 1.0 - left(STANDS_S), 1.0 - left(WALKS_S));
        let walking = self.walking * (1.0 - stops) + standing * starts;
        let (started, stopped) = (standing * starts / walking, self.walking * stops / (1.0 - walking));
        self.walking = walking;
        // Of somebody who begins to walk it is not known where to.
        let mut starter = self.stands;
        (2..4).for_each(|k| starter.reset(k, NEW_VELOCITY_MPS * NEW_VELOCITY_MPS));
        self.stands.blend(&self.walks, stopped);
        self.walks.blend(&starter, started);

        let step = Step::over(dt_s, VELOCITY_MEMORY_S);
        let [place, both, velocity] = step.grows(acceleration_m2ps3);
        let [stand, walk] = ERRORS_LAST_S.map(left);
        let stand = Motion { reach_s: 0.0, keep_velocity: 0.0, keep_errors: stand };
        let walk = Motion { reach_s: step.reach_s, keep_velocity: step.keep_velocity, keep_errors: walk };
        for d in &mut self.dependence {
            for (stands, walks) in d.stands.iter_mut().zip(&mut d.walks) {
                let starter = *stands;
                blend(stands, 1.0 - stopped, walks, stopped);
                blend(walks, 1.0 - started, &starter, started);
                stand.apply(stands);
                walk.apply(walks);
            }
        }
        self.stands.advance(&stand);
        self.walks.advance(&walk);
        for k in 0..2 {
            self.stands.cov[k][k] += SHIFTS_M2PS * dt_s;
            self.stands.cov[k + 2][k + 2] = SHIFTS_MPS * SHIFTS_MPS;
            self.walks.cov[k][k] += place;
            self.walks.cov[k][k + 2] += both;
            self.walks.cov[k + 2][k] += both;
            self.walks.cov[k + 2][k + 2] += velocity;
        }
        for mode in [&mut self.stands, &mut self.walks] {
            mode.cov[TOP][TOP] += TOP_M2PS * dt_s;
        }
        self.mix();
    }

    /// Uses a measurement.
    pub fn correct(&mut self, m: &Measured) {
        let mut row = [0.0; STATES];
        row[..BODY].copy_from_slice(m.own.as_slice());
        let (mut var, mut further) = (m.var, [0.0; 2]);
        if let Some(lasting) = m.lasting {
            match self.slot_of(&lasting) {
                Some(slot) => row[BODY + slot] = lasting.var.sqrt(),
                // Of errors that are not followed so many count as one, but each is as likely as ever.
                None => {
                    let alike = |lasts_s: f64| (2.0 * lasts_s / lasting.interval_s).max(1.0);
                    further = ERRORS_LAST_S.map(|lasts_s| lasting.var * (alike(lasts_s) - 1.0));
                    var += lasting.var;
                }
            }
        }
        let far = FAR_OFF * (m.stretch - 1.0) * (m.var + m.lasting.map_or(0.0, |l| l.var));
        let off =
            |mode: &Estimate| m.residual - (0..BODY).map(|k| m.own[k] * (mode.mean[k] - self.mean[k])).sum::<f64>();
        let (if_stands, if_walks) = (off(&self.stands), off(&self.walks));
        let (by_standing, stands) = self.stands.correct(&row, if_stands, var, far + further[0]);
        let (by_walking, walks) = self.walks.correct(&row, if_walks, var, far + further[1]);
        for d in &mut self.dependence {
            for (to_pose, gain) in d.each().into_iter().zip([&by_standing, &by_walking]) {
                for column in to_pose {
                    let by = dot(&row, column);
                    blend(column, 1.0, gain, -by);
                }
            }
        }
        if let Some((robot, to_pose)) = m.pose {
            let d = self.dependence_on(robot);
            for (of_mode, gain) in d.each().into_iter().zip([&by_standing, &by_walking]) {
                for (column, by) in of_mode.iter_mut().zip(&to_pose) {
                    blend(column, 1.0, gain, -by);
                }
            }
        }
        let (stands, walks) = ((1.0 - self.walking) * stands, self.walking * walks);
        // Neither explains what is far off.
        if stands + walks > f64::MIN_POSITIVE {
            self.walking = (walks / (stands + walks)).clamp(LEAST_PROBABILITY, 1.0 - LEAST_PROBABILITY);
        }
        self.mix();
    }

    /// Which of the errors that last is a robot's: from now on, if there is place.
    fn slot_of(&mut self, m: &Lasting) -> Option<usize> {
        let own = self.observers.iter().position(|o| o.is_some_and(|(robot, _)| robot == m.robot));
        let slot = own.or_else(|| {
            let oldest = (0..OBSERVERS).min_by_key(|k| self.observers[*k].map(|(_, at)| at))?;
            if self.observers[oldest].is_some_and(|(_, at)| m.at.seconds_since(at) < STALE_S) {
                return None;
            }
            self.renew(BODY + oldest, 0.0, 1.0);
            Some(oldest)
        })?;
        self.observers[slot] = Some((m.robot, m.at));
        Some(slot)
    }

    /// Of an entry of the state something else is known.
    fn renew(&mut self, entry: usize, mean: f64, var: f64) {
        for mode in [&mut self.stands, &mut self.walks] {
            mode.mean[entry] = mean;
            mode.reset(entry, var);
        }
        for column in self.dependence.iter_mut().flat_map(Dependence::each).flatten() {
            column[entry] = 0.0;
        }
    }

    fn dependence_on(&mut self, robot: usize) -> &mut Dependence {
        let known = self.dependence.iter().position(|d| d.robot == robot);
        let k = known.unwrap_or_else(|| {
            let nothing = [[0.0; STATES]; 3];
            self.dependence.push(Dependence { robot, stands: nothing, walks: nothing });
            self.dependence.len() - 1
        });
        &mut self.dependence[k]
    }

    /// The height is known from elsewhere.
    pub fn set_top(&mut self, top_m: f64, var: f64) {
        self.renew(TOP, top_m, var);
        self.mix();
    }

    /// A robot's pose was corrected by `shift` (x, y, heading).
    pub fn shift(&mut self, robot: usize, shift: &Vector3<f64>) {
        let Some(d) = self.dependence.iter().find(|d| d.robot == robot) else { return };
        for (mode, to_pose) in [(&mut self.stands, &d.stands), (&mut self.walks, &d.walks)] {
            for (column, by) in to_pose.iter().zip(shift) {
                blend(&mut mode.mean, 1.0, column, *by);
            }
        }
        self.mix();
    }

    /// A robot contributes no longer: the errors of its pose, given by their covariance, become the target's own.
    pub fn forget(&mut self, robot: usize, pose: &Matrix3<f64>) {
        let Some(k) = self.dependence.iter().position(|d| d.robot == robot) else { return };
        let d = self.dependence.swap_remove(k);
        for (mode, to_pose) in [(&mut self.stands, &d.stands), (&mut self.walks, &d.walks)] {
            for (a, b) in (0..3).flat_map(|a| (0..3).map(move |b| (a, b))) {
                for (column, by) in mode.cov.iter_mut().zip(&to_pose[b]) {
                    blend(column, 1.0, &to_pose[a], pose[(a, b)] * by);
                }
            }
        }
        self.mix();
    }

    fn mix(&mut self) {
        let [stands, walks] = [1.0 - self.walking, self.walking];
        let apart = Vector5::from_fn(|k, _| self.walks.mean[k] - self.stands.mean[k]);
        self.mean = Vector5::from_fn(|k, _| self.stands.mean[k] + walks * apart[k]);
        self.cov = Matrix5::from_fn(|i, j| {
            stands * self.stands.cov[j][i] + walks * self.walks.cov[j][i] + stands * walks * apart[i] * apart[j]
        });
    }
}
