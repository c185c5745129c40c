//! What ends a target: silence, a place that nobody knows any more, a double.

use protocol::id::TargetId;

use super::state::State;
use super::{Followed, Follower};
use crate::calibration::live::Calibrator;

/// A target that was never believed is dropped sooner, seconds.
const TENTATIVE_S: f64 = 0.8;
/// Larger axis beyond which nothing is known any more, m.
const LOST_M: f64 = 2.0;
/// Nobody is inside a robot: a target surely so near to one's axis is the robot, m.
const INSIDE_M: f64 = 0.12;
const SURELY_M: f64 = 0.1;
/// Two targets this close, one of them without bearings of its own, are one.
const DOUBLE_M: f64 = 0.25;

impl Follower {
    /// Drops what is over.
    pub(super) fn keep_up(&mut self, calibrator: &Calibrator) {
        let newest = self.newest;
        let forget_s = self.config.forget_after_s;
        let over = |f: &Followed| {
            let patience_s = if f.is_confirmed() { forget_s } else { TENTATIVE_S };
            newest.seconds_since(f.state.last) > patience_s
                || f.state.target.sigma_m() > LOST_M
                || calibrator.poses(newest).any(|(_, p)| {
                    (p.position() - f.state.target.position()).norm() < INSIDE_M && f.state.target.sigma_m() < SURELY_M
                })
        };
        let mut gone: Vec<usize> = (0..self.targets.len()).filter(|&t| over(&self.targets[t])).collect();
        gone.extend(self.doubles().into_iter().filter(|t| !over(&self.targets[*t])));
        gone.sort_unstable();
        gone.dedup();
        for t in gone.into_iter().rev() {
            let f = self.targets.remove(t);
            for m in self.memories.iter_mut().filter(|m| m.bound == Some(f.id)) {
                m.bind(None);
            }
            if f.is_confirmed() {
                self.remember_departed(f);
            }
        }
        self.forget_vacated();
    }

    /// Targets that stand where another stands and have nothing of their own.
    fn doubles(&self) -> Vec<usize> {
        (0..self.targets.len()).filter(|&t| self.is_double(self.targets[t].id, &self.targets[t].state)).collect()
    }

    /// Whether a target in this state would stand where another stands, which more robots see.
    pub(super) fn is_double(&self, id: TargetId, state: &State) -> bool {
        let newest = self.newest;
        let current = |s: &State| s.observers_at(newest).count();
        let own = current(state);
        own <= 1
            && self.targets.iter().filter(|g| g.id != id).any(|g| {
                let theirs = current(&g.state);
                (g.state.target.position() - state.target.position()).norm() < DOUBLE_M
                    && (theirs > own || (theirs == own && g.id < id))
            })
    }
}
