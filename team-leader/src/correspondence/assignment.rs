//! The tracks of one frame to the targets: the assignment of largest likelihood (Kuhn and Munkres on log-ratios).
//!
//! A track is worth to a target what [`Follower::fit`] says, more where it was the target's in the frames before: a robot
//! seldom takes one object for another from frame to frame. It does so now and then where people pass each other, and then
//! the bearings, sure of themselves through the other robots, outweigh the past. A robot that says that its track was with
//! others is believed less about who it is; once it is sure again, the target that the track had before counts. A track that
//! another assignment explains nearly as well moves nobody: a wrong pair would drag both targets to where neither is.

use pathfinding::kuhn_munkres::kuhn_munkres;
use pathfinding::matrix::Matrix;

use super::likelihood::Fit;
use super::memory::Memory;
use super::{Follower, Frame, Sight};
use crate::calibration::live::Calibrator;

/// Squared sigmas beyond which a track is never the target's: bound, and free.
const GATE: [f64; 2] = [16.0, 12.0];
/// What a binding is worth, nats, fully after so many frames.
const BOUND_WORTH: f64 = 5.0;
const BOUND_HITS: u32 = 5;
/// The part of that for a track that was with others of late, and what it is worth that it was the target's before.
const DOUBTFUL: f64 = 0.2;
const RETURN_WORTH: f64 = 5.0;
/// What looks count for.
const LOOKS_WORTH: f64 = 0.5;
/// Log-odds that a new track is a given target's.
const FREE_ODDS: f64 = -1.0;
/// Log-odds that a target in view is seen: of two assignments the one that explains more.
const SEEN_ODDS: f64 = 1.0;
/// Weights are integers for the solver.
const SCALE: f64 = 1000.0;

impl Follower {
    /// What speaks for a track being target `t`'s beside where it is: the frames before and its looks, nats.
    fn odds(&self, sight: &Sight, memory: Option<&Memory>, t: usize) -> f64 {
        let target = &self.targets[t];
        let mine = memory.filter(|m| m.bound == Some(target.id));
        let odds = mine.map_or(FREE_ODDS, |m| BOUND_WORTH * f64::from(m.hits.min(BOUND_HITS)) / f64::from(BOUND_HITS));
        if sight.doubtful {
            return DOUBTFUL * odds;
        }
        let returned = mine.is_none() && memory.is_some_and(|m| m.settled == Some(target.id));
        let alike = memory.and_then(|m| m.appearance).map_or(0.0, |a| LOOKS_WORTH * target.looks.resemblance(&a));
        odds + alike + if returned { RETURN_WORTH } else { 0.0 }
    }

    /// By how many nats the assignment is better than the best one in which this sight is another target's.
    fn margin(&self, worth: &Matrix<i64>, chosen: &[usize], k: usize) -> f64 {
        let mine = chosen[k];
        let others = (0..self.targets.len()).filter(|&t| t != mine && worth[(k, t)] >= 0);
        let gains = others.map(|t| {
            let with_me = worth[(k, mine)] - worth[(k, t)];
            match chosen.iter().position(|&c| c == t) {
                Some(o) => with_me + worth[(o, t)] - worth[(o, mine)].max(0),
                None => with_me,
            }
        });
        gains.min().map_or(f64::INFINITY, |least| least as f64 / SCALE)
    }

    /// For each sight the index of its target and how it fits.
    pub(super) fn assign(
        &self,
        frame: &Frame<'_>,
        sights: &[Sight],
        calibrator: &Calibrator,
    ) -> Vec<Option<(usize, Fit)>> {
        if sights.is_empty() || self.targets.is_empty() {
            return vec![None; sights.len()];
        }
        // A column each for the targets, and one each for being left alone, which is worth nothing.
        let mut worth = Matrix::new(sights.len(), self.targets.len() + sights.len(), 0i64);
        let mut fits = Vec::with_capacity(sights.len());
        for (k, sight) in sights.iter().enumerate() {
            let memory = self.memories.iter().find(|m| m.is(frame.robot, sight.track));
            let row: Vec<Option<Fit>> = (0..self.targets.len())
                .map(|t| {
                    let fit = self.fit(frame, sight, t, calibrator);
                    let mine = memory.is_some_and(|m| m.bound == Some(self.targets[t].id));
                    let value = fit.log_ratio + self.odds(sight, memory, t) + SEEN_ODDS;
                    let possible = fit.d2 < GATE[usize::from(!mine)] && (mine || !sight.peer) && value > 0.0;
                    worth[(k, t)] = if possible { (value * SCALE) as i64 } else { -1 };
                    possible.then_some(fit)
                })
                .collect();
            fits.push(row);
        }
        let (_, chosen) = kuhn_munkres(&worth);
        let margins: Vec<f64> = (0..sights.len()).map(|k| self.margin(&worth, &chosen, k)).collect();
        let pairs = chosen.into_iter().zip(fits).zip(margins);
        pairs.map(|((t, row), margin)| row.get(t).copied().flatten().map(|fit| (t, Fit { margin, ..fit }))).collect()
    }
}
