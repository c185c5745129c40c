//! What ends a target: silence, contradiction, a double.

use protocol::angle::wrap;

use super::birth::Departed;
use super::{Followed, Follower, Frame, OBSERVED_S, Sight};
use crate::calibration::live::Calibrator;

/// A target that was never believed is dropped sooner, seconds.
const TENTATIVE_S: f64 = 0.8;
/// Mean misfit of single robots' ranges that no real object has.
const GHOST_MISFIT: f64 = 6.0;
/// The same where a robot that should see it sees nothing for so long (s), within so many metres.
const DOUBTFUL_MISFIT: f64 = 3.0;
const ABSENT_S: f64 = 1.5;
const ABSENT_RANGE_M: f64 = 6.0;
/// Larger axis beyond which nothing is known any more, m.
const LOST_M: f64 = 1.2;
/// Two targets this close, one of them without bearings of its own, are one.
const DOUBLE_M: f64 = 0.35;
/// Most dropped targets remembered.
const MAX_DEPARTED: usize = 64;

impl Follower {
    /// Notes which targets this robot should see and does not.
    pub(super) fn note_absences(&mut self, frame: &Frame<'_>, sights: &[Sight], calibrator: &Calibrator) {
        if !self.watches(frame.robot, frame.at) {
            return;
        }
        let others: Vec<(f64, f64)> = calibrator
            .poses(frame.at)
            .filter(|(r, _)| *r != frame.robot)
            .map(|(_, p)| (frame.pose.bearing_to(p.position()), (p.position() - frame.pose.position()).norm()))
            .collect();
        for followed in &mut self.targets {
            let position = followed.target.position();
            let bearing = frame.pose.bearing_to(position);
            let range_m = (position - frame.pose.position()).norm();
            let covered = sights.iter().any(|s| wrap(s.bearing_rad - bearing).abs() < s.half_width_rad + 0.05)
                || others.iter().any(|(b, d)| *d < range_m && wrap(b - bearing).abs() < 0.3 / d);
            if covered || range_m > ABSENT_RANGE_M {
                followed.absent.retain(|(r, _)| *r != frame.robot);
            } else if followed.absent.iter().all(|(r, _)| *r != frame.robot) {
                followed.absent.push((frame.robot, frame.at));
            }
        }
    }

    /// Drops what is over.
    pub(super) fn keep_up(&mut self, calibrator: &Calibrator) {
        let newest = self.newest;
        let forget_s = self.config.forget_after_s;
        let over = |f: &Followed| {
            let patience_s = if f.is_confirmed() { forget_s } else { TENTATIVE_S };
            let absent = f.absent.iter().any(|(_, since)| newest.seconds_since(*since) > ABSENT_S);
            newest.seconds_since(f.last) > patience_s
                || f.target.sigma_m() > LOST_M
                || f.misfit > GHOST_MISFIT
                || (absent && f.misfit > DOUBTFUL_MISFIT)
                || calibrator
                    .poses(newest)
                    .any(|(_, p)| (p.position() - f.target.position()).norm() < 0.12 && f.target.sigma_m() < 0.1)
        };
        let mut gone: Vec<usize> = (0..self.targets.len()).filter(|&t| over(&self.targets[t])).collect();
        gone.extend(self.doubles().into_iter().filter(|t| !over(&self.targets[*t])));
        gone.sort_unstable();
        gone.dedup();
        for t in gone.into_iter().rev() {
            let f = self.targets.remove(t);
            for m in self.memories.iter_mut().filter(|m| m.bound == Some(f.id)) {
                m.bound = None;
            }
            if f.is_confirmed() && f.misfit < DOUBTFUL_MISFIT {
                self.departed.push(Departed { id: f.id, position: f.target.position(), at: newest });
                if self.departed.len() > MAX_DEPARTED {
                    self.departed.remove(0);
                }
            }
        }
        self.forget_vacated();
    }

    /// Targets that stand where another stands and have nothing of their own.
    fn doubles(&self) -> Vec<usize> {
        let newest = self.newest;
        let current =
            |f: &Followed| f.observers.iter().filter(|(_, at)| newest.seconds_since(*at) < OBSERVED_S).count();
        let mut doubles = Vec::new();
        for (t, f) in self.targets.iter().enumerate() {
            let twin = self.targets.iter().enumerate().any(|(o, g)| {
                o != t
                    && (g.target.position() - f.target.position()).norm() < DOUBLE_M
                    && current(f) <= 1
                    && (current(g) > current(f) || (current(g) == current(f) && g.id < f.id))
            });
            if twin {
                doubles.push(t);
            }
        }
        doubles
    }
}
