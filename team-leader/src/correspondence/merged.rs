//! What a region that covers several objects tells about each.
//!
//! Its middle is nobody's bearing. But its left end is the left side of whoever reaches furthest left, its right end of
//! whoever reaches furthest right, and the widths of the objects are known from when they were seen alone. Who is at which
//! end follows from where the other robots and the past put them; where that is doubtful the ends lie so close together
//! that it hardly matters. One who covers both ends is measured by the middle; who covers none is somewhere inside.

use protocol::angle::wrap;

use super::{Follower, Frame, Sight, gate_distance2};
use crate::calibration::live::Calibrator;
use crate::stereo::target::BearingFrom;

/// Sides of a body move with arms and steps, standard deviation in metres.
const SIDE_M: f64 = 0.07;
/// Squared sigmas beyond which an end is somebody else's.
const END_GATE: f64 = 9.0;

/// A member of a region, as predicted.
struct Inside {
    target: usize,
    bearing_rad: f64,
    half_width_rad: f64,
    range_m: f64,
}

impl Follower {
    /// Uses the regions of this frame that cover several objects.
    pub(super) fn measure_merged(
        &mut self,
        frame: &Frame<'_>,
        sights: &[Sight],
        assigned: &[Option<usize>],
        calibrator: &Calibrator,
    ) {
        let mut done: Vec<(i64, i64)> = Vec::new();
        for (k, sight) in sights.iter().enumerate().filter(|(_, s)| s.region) {
            // Members of one region have its bearing and its width.
            let key = |s: &Sight| ((s.bearing_rad * 1e4).round() as i64, (s.half_width_rad * 1e4).round() as i64);
            if assigned[k].is_none() || done.contains(&key(sight)) {
                continue;
            }
            done.push(key(sight));
            let members: Vec<usize> =
                (0..sights.len()).filter(|&o| sights[o].region && key(&sights[o]) == key(sight)).collect();
            let inside: Vec<Inside> =
                members.iter().filter_map(|&o| assigned[o]).map(|t| self.predict_inside(frame, t)).collect();
            for &o in &members {
                if let (Some(t), Some(m)) =
                    (assigned[o], self.memories.iter_mut().find(|m| m.is(frame.robot, sights[o].track)))
                {
                    let _ = m.hit(self.targets[t].id, 0.0);
                }
            }
            let known = inside.len() == members.len();
            self.measure_region(frame, sight, &inside, known, calibrator);
        }
    }

    fn predict_inside(&self, frame: &Frame<'_>, t: usize) -> Inside {
        let followed = &self.targets[t];
        let probe = BearingFrom { robot: frame.robot, pose: frame.pose, bearing_rad: 0.0, var: 1.0, at: frame.at };
        let innovation = followed.target.innovation(&probe);
        let range_m = innovation.range_m.max(0.3);
        Inside {
            target: t,
            bearing_rad: wrap(-innovation.residual_rad),
            half_width_rad: (followed.half_width_m / range_m).atan(),
            range_m,
        }
    }

    fn measure_region(
        &mut self,
        frame: &Frame<'_>,
        region: &Sight,
        inside: &[Inside],
        known: bool,
        calibrator: &Calibrator,
    ) {
        let reach = |i: &Inside, side: f64| wrap(i.bearing_rad - region.bearing_rad) * side + i.half_width_rad;
        let furthest =
            |side: f64| inside.iter().max_by(|a, b| reach(a, side).total_cmp(&reach(b, side))).map(|i| i.target);
        let (Some(left), Some(right)) = (furthest(1.0), furthest(-1.0)) else { return };
        for member in inside {
            let side_sigma = SIDE_M / member.range_m;
            let room = (region.half_width_rad - member.half_width_rad).max(0.0);
            let (offset, sigma) = match (member.target == left, member.target == right) {
                (true, true) => (0.0, (0.5 * room).hypot(side_sigma)),
                (true, false) if known => (room, side_sigma),
                (false, true) if known => (-room, side_sigma),
                // Inside, no more is known; what lies inside already needs no update.
                _ => (0.0, 0.6 * region.half_width_rad),
            };
            let var = (sigma * sigma + region.sigma_rad.powi(2).min(sigma * sigma)) * self.repeat(member.target, frame);
            let bearing_rad = wrap(region.bearing_rad + offset);
            let m = BearingFrom { robot: frame.robot, pose: frame.pose, bearing_rad, var, at: frame.at };
            let followed = &self.targets[member.target];
            let innovation = followed.target.innovation(&m);
            if gate_distance2(&innovation, &followed.target, &m, calibrator).0 < END_GATE {
                self.use_bearing(member.target, &m);
            }
        }
    }
}
