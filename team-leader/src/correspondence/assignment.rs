//! The tracks of one frame to the targets: optimal assignment (Kuhn and Munkres), in which bound pairs are preferred.

use pathfinding::kuhn_munkres::kuhn_munkres_min;
use pathfinding::matrix::Matrix;

use super::{Follower, Frame, Sight, gate_distance2};
use crate::calibration::live::Calibrator;

/// Squared sigmas within which a bound pair stays one.
const BOUND_GATE: f64 = 60.0;
/// Squared sigmas within which a track may find a target.
const FREE_GATE: f64 = 9.0;
/// What a confirmed binding is worth.
const BOUND_WORTH: f64 = 8.0;
/// Price of taking a track, or a target's place in this picture, from another.
const REBIND_COST: f64 = 8.0;
/// Price of any new binding.
const BIND_COST: f64 = 2.0;
/// Price of leaving a track alone: bound, and free.
const ALONE_COST: [f64; 2] = [45.0, 10.0];
/// Costs are integers for the solver.
const SCALE: f64 = 1000.0;
const FORBIDDEN: f64 = 1e6;

impl Follower {
    /// For each sight the index of its target.
    pub(super) fn assign(&self, frame: &Frame<'_>, sights: &[Sight], calibrator: &Calibrator) -> Vec<Option<usize>> {
        if sights.is_empty() || self.targets.is_empty() {
            return vec![None; sights.len()];
        }
        let bound =
            |track| self.memories.iter().find(|m| m.is(frame.robot, track)).and_then(|m| Some((m.bound?, m.hits)));
        let columns = self.targets.len() + sights.len();
        let mut costs = Matrix::new(sights.len(), columns, (FORBIDDEN * SCALE) as i64);
        for (k, sight) in sights.iter().enumerate() {
            let mine = bound(sight.track).filter(|(id, _)| self.targets.iter().any(|f| f.id == *id));
            for (t, followed) in self.targets.iter().enumerate() {
                let rough = self.bearing(frame, sight, 3.0, 1.0);
                let range_m = followed.target.innovation(&rough).range_m;
                let m = self.bearing(frame, sight, range_m, 1.0);
                let d2 = gate_distance2(&followed.target.innovation(&m), &followed.target, &m, calibrator);
                let cost = match mine {
                    Some((id, hits)) if id == followed.id => {
                        let worth = BOUND_WORTH * f64::from(hits.min(5)) / 5.0;
                        if d2 < BOUND_GATE { d2 - worth } else { FORBIDDEN }
                    }
                    _ if sight.peer || d2 > FREE_GATE => FORBIDDEN,
                    _ => {
                        let rival = sights
                            .iter()
                            .any(|o| o.track != sight.track && bound(o.track).is_some_and(|(id, _)| id == followed.id));
                        let taken = f64::from(u8::from(mine.is_some())) + f64::from(u8::from(rival));
                        d2 + BIND_COST + REBIND_COST * taken + 0.5 * sight.cue.cost(range_m)
                    }
                };
                costs[(k, t)] = (cost * SCALE) as i64;
            }
            costs[(k, self.targets.len() + k)] = (ALONE_COST[usize::from(mine.is_none())] * SCALE) as i64;
        }
        let (_, chosen) = kuhn_munkres_min(&costs);
        let allowed = |k: usize, t: usize| costs[(k, t)] < (0.5 * FORBIDDEN * SCALE) as i64;
        chosen.into_iter().enumerate().map(|(k, t)| (t < self.targets.len() && allowed(k, t)).then_some(t)).collect()
    }
}
