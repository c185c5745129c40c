//! Errors that all bearings of a robot share, from the innovations of moving targets.
//!
//! Problem: a robot's pictures may be older than their stamps say (latency that no clock probe sees: a driver's buffers), its
//! bearings may be turned against its heading, its errors may be larger than it states. No single frame tells.
//!
//! Insight: a target's filter that has them wrong errs linearly in what is wrong. How it errs is a matrix that goes through the
//! same steps as the filter, so each innovation is a linear measurement of the shared errors with the innovation's own white
//! noise, and all innovations of all targets are summed in one information matrix (B. Friedland, "Treatment of bias in recursive
//! filtering", IEEE Trans. Automatic Control 14, 1969: exact for a linear filter). The filters take off the errors as estimated
//! so far: a wrong lag upsets velocities, which are what shows lags.
//!
//! ```text
//!  z(t) = h(x(t − τ)) + b + v    r = z(t + τ̂) − b̂ − h(x̂)    G = g − H D,  g = (−∂h/∂t, 1) for the observer, 0 for others
//!  Λ += Gᵀ G / S    η += Gᵀ (r + G θ̂) / S    D ← D + K G    θ̂ = (τ̂, b̂) = (Λ + Λ₀)⁻¹ η,    x̂ ← x̂ − D Δθ̂
//! ```
//!
//! That all robots are late by the same is not seen: lags count from the median robot's.
//!
//! Innovations are white only as long as each bearing is its target's. Two people taken for each other for two seconds are a hundred
//! innovations that all say the same wrong thing, of which the sum above makes a lag of ten sigmas. So Λ and η are kept apart for
//! blocks of a few seconds: how much the estimate changes when a block is left out (M. Quenouille's and J. Tukey's jackknife) is how much
//! it owes to single events, and no sigma is told below that. A robot's errors are judged without the block that is worst for it.

mod watched;

use std::collections::VecDeque;

use nalgebra::{DMatrix, DVector};
use protocol::frames::Pose2;
use protocol::id::TargetId;
use protocol::time::Timestamp;

use crate::leader::config::TargetConfig;
use watched::{Bearing, Fitting, Watched};

/// A priori a lag is within this, seconds, and a bias, rad (standard deviations).
const LAG_S: f64 = 0.1;
const BIAS_RAD: f64 = 0.01;
/// Errors of poses and bodies that look like a bias, rad, and like a lag, seconds: no average takes them away.
const BIAS_FLOOR_RAD: f64 = 7e-4;
const LAG_FLOOR_S: f64 = 0.003;
/// How long what was learnt counts, seconds.
const MEMORY_S: f64 = 120.0;
/// Between solutions, seconds.
const INTERVAL_S: f64 = 1.0;
/// A lag or bias is told when it is known so well.
const TOLD_LAG_S: f64 = 0.03;
const TOLD_BIAS_RAD: f64 = 0.003;
/// It is corrected when it is so many sigmas from zero and at least so large.
const SURE_SIGMAS: f64 = 4.0;
const LEAST_LAG_S: f64 = 0.015;
const LEAST_BIAS_RAD: f64 = 0.004;
/// Innovations are summed in blocks so long, seconds; so many are needed before anything is told, and are kept at most.
const BLOCK_S: f64 = 3.0;
const LEAST_BLOCKS: usize = 4;
const MAX_BLOCKS: usize = 40;
/// They are left out in so many groups, for large teams' sake.
const GROUPS: usize = 8;
/// Innovations (by what they tell) until the sigmas that a robot states are judged, and how many count.
const LEAST_COUNT: f64 = 15.0;
const MOST_COUNT: f64 = 100.0;
/// The mean of all lags is zero within this, seconds: it is not seen, and would drift.
const MEAN_LAG_S: f64 = 0.005;
/// Errors larger than stated by more than this factor are widened, beyond the other the robot's bearings are set aside.
const WIDENED: f64 = 2.0;
const SET_ASIDE: f64 = 4.0;
/// Most targets watched, and frames that wait to be settled.
const MAX_WATCHED: usize = 64;
const MAX_PENDING: usize = 4096;

/// A frame of a robot whose tracks have got their owners for good.
#[derive(Debug, Clone)]
pub struct SettledFrame {
    /// Whose.
    pub robot: usize,
    /// The time under which the leader used it.
    pub at: Timestamp,
    /// Whose each bearing is, the bearing in the body frame, and its sigma, rad.
    pub bearings: Vec<(TargetId, f64, f64)>,
}

/// What is known of a robot's shared errors.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Shared {
    /// By how much its pictures are older than their stamps say, seconds, and its standard deviation, where told.
    pub lag_s: Option<(f64, f64)>,
    /// Bias of its targets' bearings against its heading, rad, and its standard deviation, where told.
    pub bias_rad: Option<(f64, f64)>,
    /// The part of the lag that is sure: it is corrected.
    pub sure_lag_s: f64,
    /// The same of the bias.
    pub sure_bias_rad: f64,
    /// By how much its errors are larger than it states (at least 1; 1 where they fit).
    pub widened: f64,
    /// They are so much larger that its bearings are not used.
    pub set_aside: bool,
}

/// Shared errors of all robots.
#[derive(Debug)]
pub struct Systematic {
    config: TargetConfig,
    watched: Vec<Watched>,
    /// Robots in the order of their rows below.
    numbers: Vec<usize>,
    /// What innovations told, the oldest first.
    blocks: VecDeque<Block>,
    /// Lag and bias of each robot, two rows each.
    estimate: DVector<f64>,
    robots: Vec<Shared>,
    /// Frames in use, as they were stamped: robot, time used, time stamped with its sigma, pose.
    pending: VecDeque<Pending>,
    last_solve: Option<Timestamp>,
}

#[derive(Debug, Clone, Copy)]
struct Pending {
    /// Its row.
    robot: usize,
    used: Timestamp,
    stamped: Timestamp,
    sigma_s: f64,
    pose: Pose2,
}

/// What the innovations of some seconds tell.
#[derive(Debug, Clone)]
struct Block {
    since: Timestamp,
    /// Λ and η: two rows a robot.
    information: DMatrix<f64>,
    vector: DVector<f64>,
    /// How well each robot's errors fit its sigmas: sum of the weights, and of the weighed excesses.
    fits: Vec<[f64; 2]>,
}

impl Block {
    fn new(since: Timestamp, robots: usize) -> Self {
        let n = 2 * robots;
        Self { since, information: DMatrix::zeros(n, n), vector: DVector::zeros(n), fits: vec![[0.0; 2]; robots] }
    }

    fn add_robot(&mut self) {
        self.fits.push([0.0; 2]);
        let n = 2 * self.fits.len();
        self.information = std::mem::take(&mut self.information).resize(n, n, 0.0);
        self.vector = std::mem::take(&mut self.vector).resize_vertically(n, 0.0);
    }

    /// One unknown begins anew; what it told of the others stays.
    fn marginalise(&mut self, row: usize, prior_sigma: f64) {
        let column = self.information.column(row).clone_owned();
        let own = column[row] + prior_sigma.powi(-2);
        self.information -= &column * column.transpose() / own;
        let share = self.vector[row] / own;
        self.vector -= &column * share;
        self.information.row_mut(row).fill(0.0);
        self.information.column_mut(row).fill(0.0);
        self.vector[row] = 0.0;
    }

    fn forget(&mut self, keep: f64) {
        self.information *= keep;
        self.vector *= keep;
    }
}

impl Systematic {
    /// Nothing is known.
    pub fn new(config: TargetConfig) -> Self {
        Self {
            config,
            watched: Vec::new(),
            numbers: Vec::new(),
            blocks: VecDeque::new(),
            estimate: DVector::zeros(0),
            robots: Vec::new(),
            pending: VecDeque::new(),
            last_solve: None,
        }
    }

    /// What is known of a robot.
    pub fn of(&self, robot: usize) -> Shared {
        self.row(robot).map_or_else(Shared::unknown, |k| self.robots[k])
    }

    /// A frame goes into use, corrected: what the robot itself said is kept until its owners are settled.
    pub fn expect(&mut self, robot: usize, used: Timestamp, stamped: Timestamp, sigma_s: f64, pose: Pose2) {
        if self.pending.len() >= MAX_PENDING {
            let _ = self.pending.pop_front();
        }
        let robot = self.row(robot).unwrap_or_else(|| self.add(robot));
        self.pending.push_back(Pending { robot, used, stamped, sigma_s, pose });
    }

    /// Number of a robot among those that have been met, by which everything here goes.
    fn row(&self, robot: usize) -> Option<usize> {
        self.numbers.iter().position(|known| *known == robot)
    }

    fn add(&mut self, robot: usize) -> usize {
        self.numbers.push(robot);
        self.robots.push(Shared::unknown());
        self.blocks.iter_mut().for_each(Block::add_robot);
        self.estimate = std::mem::take(&mut self.estimate).resize_vertically(2 * self.robots.len(), 0.0);
        self.robots.len() - 1
    }

    /// The robot left its station: its heading is another, and what is on the way was seen from there. Its lag stays.
    pub fn left_station(&mut self, robot: usize) {
        let Some(robot) = self.row(robot) else { return };
        self.pending.retain(|p| p.robot != robot);
        self.watched.retain(|w| !w.concerns(robot));
        self.marginalise(2 * robot + 1, BIAS_RAD);
        let shared = &mut self.robots[robot];
        (shared.bias_rad, shared.sure_bias_rad) = (None, 0.0);
    }

    /// The robot began a new session: another camera, another clock.
    pub fn new_session(&mut self, robot: usize) {
        self.left_station(robot);
        let Some(robot) = self.row(robot) else { return };
        self.marginalise(2 * robot, LAG_S);
        self.robots[robot] = Shared::unknown();
        self.blocks.iter_mut().for_each(|block| block.fits[robot] = [0.0; 2]);
    }

    /// One unknown begins anew; what it told of the others stays.
    fn marginalise(&mut self, row: usize, prior_sigma: f64) {
        self.blocks.iter_mut().for_each(|block| block.marginalise(row, prior_sigma));
        self.estimate[row] = 0.0;
    }

    /// Learns from a frame whose owners are final.
    pub fn learn(&mut self, frame: &SettledFrame) {
        let Some(robot) = self.row(frame.robot) else { return };
        let Some(k) = self.pending.iter().position(|p| p.robot == robot && p.used == frame.at) else { return };
        let Some(pending) = self.pending.remove(k) else { return };
        for &(id, bearing_rad, sigma_rad) in &frame.bearings {
            self.take(id, &pending, bearing_rad, sigma_rad);
        }
        let now = pending.stamped;
        self.watched.retain(|w| !w.is_over(now));
        if self.last_solve.is_none_or(|t| now.seconds_since(t) >= INTERVAL_S) {
            let since_s = self.last_solve.map_or(0.0, |t| now.seconds_since(t));
            self.last_solve = Some(now);
            self.solve(since_s);
        }
    }

    fn take(&mut self, id: TargetId, pending: &Pending, bearing_rad: f64, sigma_rad: f64) {
        let k = match self.watched.iter().position(|w| w.id == id) {
            Some(k) => k,
            None if self.watched.len() < MAX_WATCHED => {
                self.watched.push(Watched::new(id, pending.stamped));
                self.watched.len() - 1
            }
            None => return,
        };
        let robot = pending.robot;
        let widened = self.robots[robot].widened;
        let bearing = Bearing {
            robot,
            at: pending.stamped,
            at_sigma_s: pending.sigma_s,
            pose: pending.pose,
            bearing_rad,
            sigma_rad,
            widened,
        };
        let Some(innovation) = self.watched[k].take(&bearing, &self.config, &self.estimate) else { return };
        let row = |r: usize, g: [f64; 2]| g[0] * self.estimate[2 * r] + g[1] * self.estimate[2 * r + 1];
        let known: f64 = innovation.to_shared.iter().map(|&(r, g)| row(r, g)).sum();
        let rows = || innovation.to_shared.iter().flat_map(|&(r, g)| [(2 * r, g[0]), (2 * r + 1, g[1])]);
        let block = self.block(pending.stamped);
        for (a, ga) in rows() {
            block.vector[a] += ga * (innovation.residual_rad + known) * innovation.weight;
            for (b, gb) in rows() {
                block.information[(a, b)] += ga * gb * innovation.weight;
            }
        }
        if let Some(Fitting { excess, weight }) = innovation.fitting {
            let [weights, excesses] = &mut block.fits[robot];
            (*weights, *excesses) = (*weights + weight, *excesses + weight * excess);
        }
    }

    /// Where innovations of `now` are summed.
    fn block(&mut self, now: Timestamp) -> &mut Block {
        let robots = self.robots.len();
        if self.blocks.back().is_none_or(|block| now.seconds_since(block.since) >= BLOCK_S) {
            if self.blocks.len() >= MAX_BLOCKS {
                let _ = self.blocks.pop_front();
            }
            self.blocks.push_back(Block::new(now, robots));
        }
        let last = self.blocks.len() - 1;
        &mut self.blocks[last]
    }

    /// Λ + Λ₀ and η of all blocks.
    fn sums(&self) -> (DMatrix<f64>, DVector<f64>) {
        let n = self.robots.len();
        let (mut information, mut vector) = (DMatrix::zeros(2 * n, 2 * n), DVector::zeros(2 * n));
        for block in &self.blocks {
            information += &block.information;
            vector += &block.vector;
        }
        for r in 0..n {
            information[(2 * r, 2 * r)] += LAG_S.powi(-2);
            information[(2 * r + 1, 2 * r + 1)] += BIAS_RAD.powi(-2);
        }
        for (a, b) in (0..n).flat_map(|a| (0..n).map(move |b| (a, b))) {
            information[(2 * a, 2 * b)] += (MEAN_LAG_S * n as f64).powi(-2);
        }
        (information, vector)
    }

    fn solve(&mut self, since_s: f64) {
        let keep = (-since_s.clamp(0.0, MEMORY_S) / MEMORY_S).exp();
        self.blocks.iter_mut().for_each(|block| block.forget(keep));
        let n = self.robots.len();
        let (information, vector) = self.sums();
        // Robots that targets have told of.
        let told = |r: usize| self.blocks.iter().map(|block| block.information[(2 * r, 2 * r)]).sum::<f64>();
        let informed: Vec<usize> = (0..n).filter(|r| told(*r) > LAG_S.powi(-2)).collect();
        let without = self.without_each_group(&information, &vector);
        let Some(factor) = information.cholesky() else { return };
        let estimate = factor.solve(&vector);
        let change = &estimate - &self.estimate;
        self.estimate = estimate;
        self.watched.iter_mut().for_each(|w| w.rebase(&change));
        let cov = factor.inverse();
        let zero_s = median(informed.iter().map(|r| self.estimate[2 * r]).collect());
        let part = 1.0 / informed.len().max(1) as f64;
        for r in 0..n {
            // Against the team's mean, since the lag that all share is not seen.
            let contrast = |k: usize| f64::from(u8::from(k == r)) - if informed.contains(&k) { part } else { 0.0 };
            let lag_var: f64 = (0..n)
                .flat_map(|a| (0..n).map(move |b| (a, b)))
                .map(|(a, b)| contrast(a) * contrast(b) * cov[(2 * a, 2 * b)])
                .sum();
            let lag_var = lag_var.max(jackknife_var(&without, |e| (0..n).map(|k| contrast(k) * e[2 * k]).sum()));
            let bias_var = cov[(2 * r + 1, 2 * r + 1)].max(jackknife_var(&without, |e| e[2 * r + 1]));
            let lag = (self.estimate[2 * r] - zero_s, lag_var.max(0.0).sqrt().hypot(LAG_FLOOR_S));
            let bias = (self.estimate[2 * r + 1], bias_var.sqrt().hypot(BIAS_FLOOR_RAD));
            let enough = self.blocks.len() >= LEAST_BLOCKS;
            let lag_told = enough && informed.len() > 1 && informed.contains(&r) && lag.1 < TOLD_LAG_S;
            let excess = self.excess(r);
            let shared = &mut self.robots[r];
            shared.sure_lag_s = sure(lag, shared.sure_lag_s != 0.0, LEAST_LAG_S).filter(|_| lag_told).unwrap_or(0.0);
            let sure_bias = sure(bias, shared.sure_bias_rad != 0.0, LEAST_BIAS_RAD).filter(|_| enough);
            shared.sure_bias_rad = sure_bias.unwrap_or(0.0);
            shared.lag_s = lag_told.then_some(lag);
            shared.bias_rad = (enough && bias.1 < TOLD_BIAS_RAD).then_some(bias);
            shared.widened = if excess > WIDENED { excess } else { 1.0 };
            shared.set_aside = excess > SET_ASIDE;
        }
    }

    /// The estimates that each group of blocks is left out of.
    fn without_each_group(&self, information: &DMatrix<f64>, vector: &DVector<f64>) -> Vec<DVector<f64>> {
        let blocks = self.blocks.len();
        let groups = blocks.min(GROUPS);
        let without = |group: usize| {
            let (mut information, mut vector) = (information.clone(), vector.clone());
            for block in self.blocks.range(group * blocks / groups..(group + 1) * blocks / groups) {
                information -= &block.information;
                vector -= &block.vector;
            }
            Some(information.cholesky()?.solve(&vector))
        };
        (0..groups).filter_map(without).collect()
    }

    /// By how much the robot's errors of late are larger than it states, without the block that is worst for it.
    fn excess(&self, robot: usize) -> f64 {
        let mut of_late: Vec<[f64; 2]> = Vec::new();
        for fit in self.blocks.iter().rev().map(|block| block.fits[robot]).filter(|[weights, _]| *weights > 0.0) {
            of_late.push(fit);
            if of_late.iter().map(|[weights, _]| weights).sum::<f64>() > MOST_COUNT {
                break;
            }
        }
        let worst = (0..of_late.len()).max_by(|a, b| of_late[*a][1].total_cmp(&of_late[*b][1]));
        if let Some(worst) = worst {
            of_late.swap_remove(worst);
        }
        let [weights, excesses] =
            of_late.iter().fold([0.0; 2], |[w, e], [weights, excesses]| [w + weights, e + excesses]);
        if of_late.len() + 1 < LEAST_BLOCKS || weights < LEAST_COUNT {
            1.0
        } else {
            (excesses / weights).max(0.0).sqrt()
        }
    }
}

impl Shared {
    fn unknown() -> Self {
        Self { widened: 1.0, ..Self::default() }
    }
}

/// Variance of a value by how it scatters as each group of the data is left out.
fn jackknife_var(without: &[DVector<f64>], value: impl Fn(&DVector<f64>) -> f64) -> f64 {
    let n = without.len() as f64;
    if n < 2.0 {
        return f64::INFINITY;
    }
    let values: Vec<f64> = without.iter().map(value).collect();
    let mean = values.iter().sum::<f64>() / n;
    (n - 1.0) / n * values.iter().map(|v| (v - mean).powi(2)).sum::<f64>()
}

/// The estimate where it is surely not zero; once in use it stays so a little longer.
fn sure((value, sigma): (f64, f64), in_use: bool, least: f64) -> Option<f64> {
    let patience = if in_use { 0.5 } else { 1.0 };
    (value.abs() > patience * least.max(SURE_SIGMAS * sigma)).then_some(value)
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    match values.len() {
        0 => 0.0,
        n => 0.5 * (values[(n - 1) / 2] + values[n / 2]),
    }
}

#[cfg(test)]
mod tests;
