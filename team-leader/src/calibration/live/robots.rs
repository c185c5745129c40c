//! Each robot by itself: motion, slots, following a moving one.

use std::collections::BTreeSet;

use nalgebra::Matrix3;
use protocol::frames::Pose2;
use protocol::message::Motion;
use protocol::time::Timestamp;

use super::{Calibrator, FRESH_S, LEAST_COUNT, Look, MAX_SLOTS};
use crate::calibration::block::Link;
use crate::calibration::kernel;
use crate::calibration::naming::Doubt;
use crate::calibration::rover::Rover;
use crate::calibration::slot::{Sighted, Slot};

/// Squared sigmas by which a pair must be better than another one that it excludes.
const CLEARLY: f64 = 9.0;

/// A robot as the calibration knows it.
#[derive(Debug, Clone)]
pub struct Robot {
    /// It has sent an observation.
    pub seen: bool,
    /// Since when it stands; `None` while it moves or before it said so.
    pub standing_since: Option<Timestamp>,
    /// Where it sees others while it stands.
    pub slots: Vec<Slot>,
    /// While it moves, or stands but has not been tied to the standing ones yet.
    pub rover: Option<Rover>,
    /// Its remembered place is old, and nothing has confirmed it.
    pub unsure: bool,
    /// It is there again.
    pub back: bool,
    /// Since when it is taken to move though it says that it stands, and where it was.
    pub adrift: Option<(Timestamp, Pose2)>,
    /// Looks in a row that show it off its place.
    pub astray: u32,
    /// Checks in a row that contradict its place.
    pub contradictions: u32,
    /// Distances of it that are not believed.
    pub doubt: Option<Doubt>,
    /// Looks in a row at which the rest fits without it alone, and the factor on the variances of its links that follows.
    pub blamed: u32,
    /// See `blamed`.
    pub aside: f64,
}

impl Default for Robot {
    fn default() -> Self {
        Self {
            unsure: false,
            back: false,
            seen: false,
            standing_since: None,
            slots: Vec::new(),
            rover: None,
            adrift: None,
            astray: 0,
            contradictions: 0,
            doubt: None,
            blamed: 0,
            aside: 1.0,
        }
    }
}

impl Robot {
    /// It is there, and may have been moved since its place was remembered.
    pub fn is_doubted(&self) -> bool {
        self.unsure && self.back
    }
}

impl Calibrator {
    /// Takes over what the robot says of its own motion.
    pub(super) fn follow_motion(&mut self, look: &Look<'_>) {
        let robot = &mut self.robots[look.robot];
        (robot.seen, robot.back) = (true, true);
        match look.motion {
            Motion::Standing => {
                if robot.standing_since.is_none() {
                    robot.standing_since = Some(look.at);
                    robot.slots.clear();
                }
            }
            Motion::Turning | Motion::Moving | Motion::Lifted => {
                if robot.standing_since.take().is_some() {
                    self.depart(look.robot, look.at);
                }
            }
            // Nothing is known: what stood is taken to stand, as long as nothing contradicts.
            Motion::Unknown => {}
        }
        let standing = self.robots[look.robot].standing_since.is_some();
        if let Some(rover) = &mut self.robots[look.robot].rover {
            match (look.odometry, look.since_last_s) {
                (Some((step, covariance)), Some(since_s)) if !standing => {
                    rover.drive(look.at, step, &covariance, since_s);
                }
                _ => rover.predict(look.at, standing),
            }
        }
    }

    /// The robot leaves its station: what its links told goes into the prior, then it is followed as a rover.
    pub(super) fn depart(&mut self, robot: usize, at: Timestamp) {
        let mut ended = Vec::new();
        for (observer, r) in self.robots.iter() {
            for slot in &r.slots {
                let Some(peer) = slot.name else { continue };
                if observer != robot && peer != robot {
                    continue;
                }
                if let Some(mean) = slot.mean_before(at).filter(|_| slot.count() >= LEAST_COUNT) {
                    ended.push(self.link(observer, peer, &mean));
                }
            }
        }
        self.absolve(robot);
        self.robots[robot].slots.clear();
        for r in self.robots.iter_mut() {
            r.slots.retain(|s| s.name != Some(robot));
        }
        self.block.absorb(&ended);
        let Some(covariance) = self.block.covariance(robot, robot) else { return };
        let Some(departed) = self.block.remove(robot) else { return };
        self.changes.left.push((robot, departed.team_from_body, covariance));
        for r in self.robots.iter_mut() {
            if let Some(rover) = &mut r.rover {
                rover.forget(robot, &covariance);
            }
        }
        let speeds = [self.config.speed_mps, self.config.turn_radps];
        self.robots[robot].rover = Some(Rover::leaving(&departed, at, speeds));
    }

    /// Gives sightings to named slots and to rovers; returns those that nobody claims.
    pub(super) fn match_sightings(&mut self, look: &Look<'_>) -> Vec<Sighted> {
        let floored: Vec<Sighted> = look.sightings.iter().map(|s| self.with_floors(s)).collect();
        if self.robots[look.robot].standing_since.is_none() {
            self.follow_by_own_sightings(look, &floored);
            return Vec::new();
        }
        if !self.block.contains(look.robot) {
            return look.sightings.to_vec();
        }
        let mut free = vec![true; floored.len()];
        for (k, sighted) in look.sightings.iter().enumerate() {
            let floor_var = self.config.bearing_floor_rad.powi(2);
            let slots = self.robots[look.robot].slots.iter();
            if slots.filter(|s| s.name.is_some()).any(|s| s.distance2(sighted, floor_var).is_some()) {
                free[k] = false;
            }
        }
        let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
        for (r, robot) in self.robots.iter() {
            let Some(rover) = &robot.rover else { continue };
            for (k, sighted) in floored.iter().enumerate().filter(|(k, s)| free[*k] && s.robot.is_none_or(|t| t == r)) {
                let sighted = self.believed(look.robot, r, sighted);
                if let Some(d2) = rover.distance2_seen(&self.block, look.robot, look.at, &sighted) {
                    pairs.push((d2, r, k));
                }
            }
        }
        let mut taken = vec![false; floored.len()];
        for (r, k) in clear_pairs(&pairs) {
            let standing = self.robots[r].standing_since.is_some();
            let [frame, floored] = [&look.sightings[k], &floored[k]].map(|s| self.believed(look.robot, r, s));
            if let Some(rover) = &mut self.robots[r].rover {
                rover.predict(look.at, standing);
                rover.update_seen(&self.block, look.robot, look.at, &frame, &floored);
            }
            // A robot that stands again is to get a slot.
            taken[k] = !standing;
        }
        look.sightings.iter().zip(taken).filter(|(_, t)| !t).map(|(s, _)| *s).collect()
    }

    fn follow_by_own_sightings(&mut self, look: &Look<'_>, floored: &[Sighted]) {
        let Some(rover) = &self.robots[look.robot].rover else { return };
        let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
        for (other, robot) in self.robots.iter().filter(|(other, _)| *other != look.robot) {
            for (k, sighted) in floored.iter().enumerate().filter(|(_, s)| s.robot.is_none_or(|t| t == other)) {
                let sighted = self.believed(look.robot, other, sighted);
                let distance2 = match &robot.rover {
                    Some(moving) => rover.distance2_between(&self.block, moving, look.at, &sighted),
                    None => rover.distance2_sees(&self.block, other, look.at, &sighted),
                };
                pairs.extend(distance2.map(|d2| (d2, other, k)));
            }
        }
        for (member, k) in clear_pairs(&pairs).into_iter().filter(|(other, _)| self.block.contains(*other)) {
            let sighted = self.believed(look.robot, member, &floored[k]);
            if let Some(rover) = &mut self.robots[look.robot].rover {
                rover.update_sees(&self.block, member, look.at, &sighted);
            }
        }
    }

    /// Averages sightings into slots; what fits none opens one.
    pub(super) fn fill_slots(&mut self, robot: usize, at: Timestamp, sightings: &[Sighted]) {
        let floor_var = self.config.bearing_floor_rad.powi(2);
        let slots = &mut self.robots[robot].slots;
        let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
        for (s, slot) in slots.iter().enumerate() {
            for (k, sighted) in sightings.iter().enumerate() {
                if let Some(d2) = slot.distance2(sighted, floor_var) {
                    // Older slots are preferred a little: one place, one slot.
                    pairs.push((d2 + if slot.name.is_some() { 0.0 } else { 1.0 }, s, k));
                }
            }
        }
        let mut used = vec![false; sightings.len()];
        for (s, k) in best_pairs(pairs) {
            slots[s].add(at, sightings[k]);
            used[k] = true;
        }
        slots.retain(|s| s.name.is_some() || at.seconds_since(s.last) < 2.0 * FRESH_S);
        for (sighted, _) in sightings.iter().zip(used).filter(|(_, u)| !u) {
            if slots.len() < MAX_SLOTS {
                slots.push(Slot::new(at, *sighted));
            }
        }
    }

    /// A slot's mean (or a sighting) with the errors that do not average out.
    pub(super) fn with_floors(&self, mean: &Sighted) -> Sighted {
        let part = self.config.floor_fraction.powi(2);
        let bearing_floor = self.config.bearing_floor_rad.powi(2).max(part * mean.frame_var.0);
        let width_floor = self.config.width_floor_rad.powi(2).max(part * mean.frame_var.1);
        Sighted {
            bearing_var: mean.bearing_var + bearing_floor,
            width_rad: mean.width_rad.map(|(w, var)| (w, var + width_floor)),
            ..*mean
        }
    }

    pub(super) fn link(&self, observer: usize, peer: usize, mean: &Sighted) -> Link {
        let mean = self.believed(observer, peer, &self.with_floors(mean));
        let aside = self.robots[observer].aside.max(self.robots[peer].aside);
        Link {
            observer,
            peer,
            bearing_rad: mean.bearing_rad,
            bearing_var: aside * mean.bearing_var,
            width_rad: mean.width_rad.map(|(w, var)| (w, aside * var)),
        }
    }

    /// A sighting of `peer` by `observer` without what is not believed of them.
    pub(super) fn believed(&self, observer: usize, peer: usize, sighted: &Sighted) -> Sighted {
        let doubted =
            self.robots[observer].doubt == Some(Doubt::Ranges) || self.robots[peer].doubt == Some(Doubt::Size);
        Sighted { width_rad: sighted.width_rad.filter(|_| !doubted), ..*sighted }
    }

    /// What a member should see of another at present: bearing and width, variances of the poses alone.
    pub(super) fn predicted(&self, observer: usize, peer: usize) -> Option<Sighted> {
        let (a, b) = (self.block.pose(observer)?, self.block.pose(peer)?);
        let (from, to) = ([a.x_m, a.y_m, a.heading_rad], [b.x_m, b.y_m]);
        let (bearing, b_from, b_to) = kernel::bearing(from, to);
        let (range, d_from, d_to) = kernel::distance(from, to);
        let (width, slope) = kernel::width(range);
        let var = |from: [f64; 3], to: [f64; 2]| {
            let f = nalgebra::RowVector3::from(from);
            let t = nalgebra::RowVector3::new(to[0], to[1], 0.0);
            let cov = |a, b| self.block.covariance(a, b).unwrap_or_else(Matrix3::zeros);
            (f * cov(observer, observer) * f.transpose()
                + t * cov(peer, peer) * t.transpose()
                + 2.0 * f * cov(observer, peer) * t.transpose())[0]
        };
        let width_rad = Some((width + self.block.common_width_rad(), slope * slope * var(d_from, d_to)));
        Some(Sighted {
            bearing_rad: bearing,
            bearing_var: var(b_from, b_to),
            width_rad,
            frame_var: (0.0, 0.0),
            robot: None,
        })
    }
}

/// As [`best_pairs`], without those that another pair might be instead: who is unsure of his place must not take another robot
/// for the one that he expects to see.
fn clear_pairs(pairs: &[(f64, usize, usize)]) -> Vec<(usize, usize)> {
    let mut chosen = best_pairs(pairs.to_vec());
    let distance2 = |pair: (usize, usize)| pairs.iter().find(|(_, l, r)| (*l, *r) == pair).map_or(0.0, |p| p.0);
    let of_left: BTreeSet<usize> = chosen.iter().map(|(l, _)| *l).collect();
    let of_right: BTreeSet<usize> = chosen.iter().map(|(_, r)| *r).collect();
    chosen.retain(|&(left, right)| {
        let limit = distance2((left, right)) + CLEARLY;
        !pairs.iter().any(|&(d2, l, r)| {
            d2 < limit && ((r == right && !of_left.contains(&l)) || (l == left && !of_right.contains(&r)))
        })
    });
    chosen
}

/// Closest pairs first, each left and right side once.
pub(super) fn best_pairs(mut pairs: Vec<(f64, usize, usize)>) -> Vec<(usize, usize)> {
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut chosen: Vec<(usize, usize)> = Vec::new();
    for (_, left, right) in pairs {
        if chosen.iter().all(|&(l, r)| l != left && r != right) {
            chosen.push((left, right));
        }
    }
    chosen
}
