//! How a person moves: he stands or he walks, and which is not known. Each of the two has a filter of its own, and every measurement says
//! which explains it better (interacting multiple models: Blom and Bar-Shalom, IEEE Trans. Automatic Control 33, 1988).
//!
//! One filter for both has to believe of people who stand that they may walk off at any time, and follows those who turn too late: the
//! squared errors were half of what it said of people who stood, and a fifth more than it said of people who walked.

use nalgebra::{Matrix5, RowSVector, RowVector3, RowVector5, SMatrix, SVector, Vector5};

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
/// Robots whose lasting errors are followed: those that saw him last.
pub const OBSERVERS: usize = 4;
const STATES: usize = BODY + OBSERVERS;

type Mean = SVector<f64, STATES>;
type Cov = SMatrix<f64, STATES, STATES>;
/// How the state depends on a robot's pose.
pub type ToPose = SMatrix<f64, STATES, 3>;
/// Who is far off is mostly somebody else: variances grow so many times faster than heavy tails alone ask for.
const FAR_OFF: f64 = 6.0;
/// No measurement rules out either: least probability.
const LEAST_PROBABILITY: f64 = 1e-6;

/// Position and velocity on the floor, height of the top and the lasting errors of the robots' bearings, as far as they are known.
#[derive(Debug)]
pub struct Estimate {
    /// x, y, their velocities, height; then for each of some robots the error of its bearings of this body that lasts, as a part of its
    /// standard deviation.
    pub mean: Mean,
    /// Its covariance given exact poses of the robots.
    pub cov: Cov,
    /// How it depends on the pose of each robot that contributed, in one order for all estimates of a target.
    pub dependence: Vec<ToPose>,
}

impl Clone for Estimate {
    fn clone(&self) -> Self {
        Self { mean: self.mean.clone(), cov: self.cov.clone(), dependence: self.dependence.clone() }
    }

    // The derived one would allocate.
    fn clone_from(&mut self, source: &Self) {
        (self.mean, self.cov) = (source.mean, source.cov);
        self.dependence.clone_from(&source.dependence);
    }
}

impl Estimate {
    fn new(mean: &Vector5<f64>, cov: &Matrix5<f64>) -> Self {
        let mut all = Self { mean: Mean::zeros(), cov: Cov::identity(), dependence: Vec::new() };
        all.mean.fixed_rows_mut::<BODY>(0).copy_from(mean);
        all.cov.fixed_view_mut::<BODY, BODY>(0, 0).copy_from(cov);
        all
    }

    /// Errors are another robot's from now on.
    pub fn renew(&mut self, slot: usize) {
        let entry = BODY + slot;
        self.mean[entry] = 0.0;
        self.reset(entry, 1.0);
        self.dependence.iter_mut().for_each(|d| d.row_mut(entry).fill(0.0));
    }

    /// Becomes the mixture of itself and so large a share of another.
    fn blend(&mut self, other: &Self, share: f64) {
        let (apart, own) = (other.mean - self.mean, 1.0 - share);
        self.mean += apart * share;
        self.cov = self.cov * own + other.cov * share + apart * apart.transpose() * (own * share);
        for (d, of) in self.dependence.iter_mut().zip(&other.dependence) {
            *d = *d * own + of * share;
        }
    }

    /// Nothing is known of an entry of the state but its standard deviation.
    fn reset(&mut self, entry: usize, sigma: f64) {
        self.cov.row_mut(entry).fill(0.0);
        self.cov.column_mut(entry).fill(0.0);
        self.cov[(entry, entry)] = sigma * sigma;
    }

    /// Entry `to` grows by so many times entry `from`, which then shrinks to `keep`.
    fn pass_on(&mut self, to: Option<usize>, from: usize, reach: f64, keep: f64) {
        if let Some(to) = to {
            self.mean[to] += reach * self.mean[from];
            for o in 0..STATES {
                self.cov[(to, o)] += reach * self.cov[(from, o)];
            }
            for o in 0..STATES {
                self.cov[(o, to)] += reach * self.cov[(o, from)];
            }
            for d in &mut self.dependence {
                for o in 0..3 {
                    d[(to, o)] += reach * d[(from, o)];
                }
            }
        }
        self.mean[from] *= keep;
        self.cov.row_mut(from).scale_mut(keep);
        self.cov.column_mut(from).scale_mut(keep);
        for d in &mut self.dependence {
            d.row_mut(from).scale_mut(keep);
        }
    }

    /// Errors of bearings fade within about this time, and others come.
    fn fade(&mut self, dt_s: f64, lasts_s: f64) {
        let keep = (-dt_s / lasts_s).exp();
        for k in BODY..STATES {
            self.pass_on(None, k, 0.0, keep);
            self.cov[(k, k)] += 1.0 - keep * keep;
        }
    }

    /// Time goes on for somebody who stands.
    fn stand(&mut self, dt_s: f64) {
        for k in 2..4 {
            self.mean[k] = 0.0;
            self.reset(k, SHIFTS_MPS);
            self.dependence.iter_mut().for_each(|d| d.row_mut(k).fill(0.0));
            self.cov[(k - 2, k - 2)] += SHIFTS_M2PS * dt_s;
        }
        self.fade(dt_s, ERRORS_LAST_S[0]);
    }

    /// Time goes on for somebody who walks.
    fn walk(&mut self, dt_s: f64, acceleration_m2ps3: f64) {
        let keep = (-dt_s / VELOCITY_MEMORY_S).exp();
        let reach = VELOCITY_MEMORY_S * (1.0 - keep);
        let q = acceleration_m2ps3;
        for k in 0..2 {
            self.pass_on(Some(k), k + 2, reach, keep);
            self.cov[(k, k)] += q * dt_s.powi(3) / 3.0;
            self.cov[(k, k + 2)] += q * dt_s * dt_s / 2.0;
            self.cov[(k + 2, k)] += q * dt_s * dt_s / 2.0;
            self.cov[(k + 2, k + 2)] += q * dt_s;
        }
        self.fade(dt_s, ERRORS_LAST_S[1]);
    }

    /// What is known of somebody who begins to walk: not where to.
    fn start(&self) -> Self {
        let mut walker = self.clone();
        (2..4).for_each(|k| walker.reset(k, NEW_VELOCITY_MPS));
        walker
    }

    /// See [`Modes::correct`]; returns the measurement's density. It has heavy tails, as bearings do: what the narrower of the two modes
    /// does not explain, time and again, speaks for the wider one. By Gaussians of stretched variances neither would be worse, and a
    /// target that stands at a crossing of rays of two different people would stay there.
    fn correct(
        &mut self,
        own: &RowVector5<f64>,
        residual: f64,
        noise: Noise,
        pose: Option<(usize, RowVector3<f64>)>,
    ) -> f64 {
        let (entry, part) = (BODY + noise.slot, noise.lasting.sqrt());
        let mut row = RowSVector::<f64, STATES>::zeros();
        row.fixed_columns_mut::<BODY>(0).copy_from(own);
        row[entry] = part;
        let residual = residual - part * self.mean[entry];
        let seen = self.cov * row.transpose();
        let var = (row * seen)[0] + noise.var - noise.lasting;
        let gain = seen / (var + FAR_OFF * (noise.stretch - 1.0) * noise.var);
        self.mean += gain * residual;
        self.cov -= gain * seen.transpose();
        for d in &mut self.dependence {
            *d -= gain * (row * *d);
        }
        if let Some((robot, to_pose)) = pose {
            self.dependence[robot] -= gain * to_pose;
        }
        log_student(residual * residual / var, var).exp()
    }
}

/// Error of a measurement.
#[derive(Debug, Clone, Copy)]
pub struct Noise {
    /// Variance.
    pub var: f64,
    /// Its part that lasts: the error is much the same in the next frames of the same robot.
    pub lasting: f64,
    /// Whose lasting error it is.
    pub slot: usize,
    /// By the tails of its errors ([`crate::stereo::tails::stretch`]): the state moves as if the variance were larger.
    pub stretch: f64,
}

impl From<f64> for Noise {
    fn from(var: f64) -> Self {
        Self { var, lasting: 0.0, slot: 0, stretch: 1.0 }
    }
}

/// What is known if he stands and if he walks, and of both together.
#[derive(Debug, Clone)]
pub struct Modes {
    stands: Estimate,
    walks: Estimate,
    walking: f64,
    both: Estimate,
}

impl Modes {
    /// Of somebody of whom this is known.
    pub fn new(mean: &Vector5<f64>, cov: &Matrix5<f64>) -> Self {
        let both = Estimate::new(mean, cov);
        Self { stands: both.clone(), walks: both.clone(), walking: WALKS_S / (STANDS_S + WALKS_S), both }
    }

    /// What is known, whether he stands or walks.
    pub fn both(&self) -> &Estimate {
        &self.both
    }

    /// Time goes on. `acceleration_m2ps3`: of somebody who walks.
    pub fn predict(&mut self, dt_s: f64, acceleration_m2ps3: f64) {
        let part = |lasts_s: f64| 1.0 - (-dt_s / lasts_s).exp();
        let (standing, starts, stops) = (1.0 - self.walking, part(STANDS_S), part(WALKS_S));
        let walking = self.walking * (1.0 - stops) + standing * starts;
        let (started, stopped) = (standing * starts / walking, self.walking * stops / (1.0 - walking));
        let starter = self.stands.start();
        self.stands.blend(&self.walks, stopped);
        self.walks.blend(&starter, started);
        self.walking = walking;
        self.stands.stand(dt_s);
        self.walks.walk(dt_s, acceleration_m2ps3);
        self.change(|mode| mode.cov[(TOP, TOP)] += TOP_M2PS * dt_s);
    }

    /// Uses a measurement that is `residual` off what both together predict: its derivatives to the state, and to the pose of one of the
    /// robots, by its place in the dependence.
    pub fn correct(
        &mut self,
        own: &RowVector5<f64>,
        residual: f64,
        noise: Noise,
        pose: Option<(usize, RowVector3<f64>)>,
    ) {
        let off =
            |mode: &Estimate| residual - (0..BODY).map(|k| own[k] * (mode.mean[k] - self.both.mean[k])).sum::<f64>();
        let (if_stands, if_walks) = (off(&self.stands), off(&self.walks));
        let stands = (1.0 - self.walking) * self.stands.correct(own, if_stands, noise, pose);
        let walks = self.walking * self.walks.correct(own, if_walks, noise, pose);
        // Neither explains what is far off.
        if stands + walks > f64::MIN_POSITIVE {
            self.walking = (walks / (stands + walks)).clamp(LEAST_PROBABILITY, 1.0 - LEAST_PROBABILITY);
        }
        self.mix();
    }

    /// The same for whichever he does.
    pub fn change(&mut self, change: impl Fn(&mut Estimate)) {
        change(&mut self.stands);
        change(&mut self.walks);
        self.mix();
    }

    fn mix(&mut self) {
        self.both.clone_from(&self.stands);
        self.both.blend(&self.walks, self.walking);
    }
}
