//! The tracks of one frame to the targets: the assignment of largest likelihood (Kuhn and Munkres on log-ratios).
//!
//! A track is worth to a target what [`Follower::fit`] says, more where it was the target's in the frames before: a robot
//! seldom takes one object for another from frame to frame. It does so now and then where people pass each other, and then
//! the bearings, sure of themselves through the other robots, outweigh the past.

use pathfinding::kuhn_munkres::kuhn_munkres;
use pathfinding::matrix::Matrix;

use super::likelihood::Fit;
use super::{Follower, Frame, Sight};
use crate::calibration::live::Calibrator;

/// Squared sigmas beyond which a track is never the target's: bound, and free.
const GATE: [f64; 2] = [60.0, 12.0];
/// What a binding is worth, nats, fully after so many frames.
const BOUND_WORTH: f64 = 5.0;
const BOUND_HITS: u32 = 5;
/// Log-odds that a new track is a given target's.
const FREE_ODDS: f64 = -1.0;
/// Log-odds that a target in view is seen: of two assignments the one that explains more.
const SEEN_ODDS: f64 = 1.0;
/// Weights are integers for the solver.
const SCALE: f64 = 1000.0;

impl Follower {
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
            let bound = memory.and_then(|m| Some((m.bound?, m.hits)));
            let row: Vec<Option<Fit>> = (0..self.targets.len())
                .map(|t| {
                    let fit = self.fit(frame, sight, t, calibrator);
                    let (mine, odds) = match bound {
                        Some((id, hits)) if id == self.targets[t].id => {
                            (true, BOUND_WORTH * f64::from(hits.min(BOUND_HITS)) / f64::from(BOUND_HITS))
                        }
                        _ => (false, FREE_ODDS),
                    };
                    let value = fit.log_ratio + odds + SEEN_ODDS;
                    let possible = fit.d2 < GATE[usize::from(!mine)] && (mine || !sight.peer) && value > 0.0;
                    worth[(k, t)] = if possible { (value * SCALE) as i64 } else { -1 };
                    possible.then_some(fit)
                })
                .collect();
            fits.push(row);
        }
        let (_, chosen) = kuhn_munkres(&worth);
        let pairs = chosen.into_iter().zip(fits);
        pairs.map(|(t, row)| row.get(t).copied().flatten().map(|fit| (t, fit))).collect()
    }
}
