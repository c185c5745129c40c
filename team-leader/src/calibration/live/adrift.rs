//! A robot that moves before it says so.
//!
//! A robot notices its own motion late: up to a second after it began. Meanwhile what it sees of its fellows, and they of it,
//! leaves the places where it was seen all along. What is off in most of its pairs at once, and far more than chance allows,
//! is its own doing: it is taken to move from then on, and to stand again when it says so and is seen at rest. Who never says
//! that it moves and rests elsewhere has been carried.

use protocol::angle::wrap;
use protocol::frames::Pose2;
use protocol::message::Motion;
use protocol::time::Timestamp;

use super::robots::best_pairs;
use super::{Calibrator, FRESH_S, Finding, LEAST_COUNT, Look};
use crate::calibration::rover::Rover;
use crate::calibration::slot::{Off, Slot};

/// How far from where it was seen all along a sighting may be and still show the same robot, radians.
const NEAR_RAD: f64 = 0.25;
/// What is older says nothing of the present, seconds.
const PRESENT_S: f64 = 0.25;
/// Excess of χ² over its mean, summed over the pairs that are off, beyond which chance is no explanation; the most that a
/// sighting adds to it.
const EXCESS: f64 = 40.0;
const MOST_OF_ONE: f64 = 60.0;
/// Looks in a row that must show it, where several pairs are off and where it is the only one that can be seen.
const LOOKS: u32 = 2;
const LOOKS_OF_ONE_PAIR: u32 = 4;
/// How long a robot is taken to move at least, seconds: as late as it may say so itself.
const HOLD_S: f64 = 1.0;
/// What is further from where it was is elsewhere, m and rad.
const ELSEWHERE: [f64; 2] = [0.05, 0.035];

impl Calibrator {
    /// What the robot does: as it says, unless it was found adrift.
    pub(super) fn motion(&mut self, look: &Look<'_>) -> Motion {
        let robot = &mut self.robots[look.robot];
        let Some((since, left)) = robot.adrift else { return look.motion };
        if !matches!(look.motion, Motion::Standing | Motion::Unknown) {
            robot.adrift = None;
            return look.motion;
        }
        let rests = robot.rover.as_ref().is_none_or(Rover::rests);
        if look.at.seconds_since(since) < HOLD_S || !rests {
            return Motion::Moving;
        }
        robot.adrift = None;
        if robot.rover.as_ref().is_some_and(|rover| is_elsewhere(left, rover.pose_at(look.at))) {
            self.new_findings.push(Finding::Carried { robot: look.robot });
        }
        look.motion
    }

    /// Finds out whether somebody has left his place without saying so.
    pub(super) fn find_adrift(&mut self, look: &Look<'_>) {
        if !self.block.contains(look.robot) || self.robots[look.robot].standing_since.is_none() {
            return;
        }
        let peers = self.note_offsets(look);
        for robot in peers.into_iter().chain([look.robot]) {
            let needed = match self.verdict(robot, look) {
                Verdict::SaysNothing => continue,
                Verdict::Stands => {
                    self.robots[robot].astray = 0;
                    continue;
                }
                Verdict::Astray { looks } => looks,
            };
            self.robots[robot].astray += 1;
            if self.robots[robot].astray >= needed {
                self.robots[robot].astray = 0;
                self.robots[robot].standing_since = None;
                self.robots[robot].adrift = self.block.pose(robot).map(|left| (look.at, left));
                self.depart(robot, look.at);
                return;
            }
        }
    }

    /// Notes how far off each named slot's robot is seen; whom they show.
    fn note_offsets(&mut self, look: &Look<'_>) -> Vec<usize> {
        let floor_var = self.config.bearing_floor_rad.powi(2);
        let slots = &mut self.robots[look.robot].slots;
        let named =
            |s: &&mut Slot| s.name.is_some() && s.count() >= LEAST_COUNT && look.at.seconds_since(s.last) < FRESH_S;
        let mut known: Vec<_> = slots.iter_mut().filter(named).collect();
        let means: Vec<_> = known.iter().map(|slot| slot.mean()).collect();
        let mut pairs = Vec::new();
        for (s, slot) in known.iter().enumerate() {
            for (k, sighted) in look.sightings.iter().enumerate() {
                let away_rad = wrap(sighted.bearing_rad - means[s].bearing_rad).abs();
                if away_rad < NEAR_RAD && slot.may_show(sighted) {
                    pairs.push((away_rad, s, k));
                }
            }
        }
        let mut seen = Vec::new();
        for (s, k) in best_pairs(pairs) {
            let (by_bearing, by_width) = means[s].squares(&look.sightings[k], floor_var);
            let (chi2, n) = (by_bearing + by_width.unwrap_or(0.0), 1 + u32::from(by_width.is_some()));
            known[s].off = Some(Off { at: look.at, chi2: chi2.min(MOST_OF_ONE), n });
            seen.extend(known[s].name);
        }
        seen
    }

    /// What a look says of whether a robot has left its place.
    fn verdict(&self, robot: usize, look: &Look<'_>) -> Verdict {
        let mut excess = 0.0;
        let mut pairs = 0;
        let mut off = Vec::new();
        // Pairs of this look, and those of them that are off.
        let (mut looked_at, mut looked_off) = (0, 0);
        for &peer in self.block.members().iter().filter(|&&peer| peer != robot) {
            let pair = self.pair(robot, peer, look.at);
            if pair.n == 0 {
                continue;
            }
            pairs += 1;
            if pair.is_off() {
                off.push(peer);
                excess += pair.chi2 - f64::from(pair.n);
            }
            if pair.newest == Some(look.at) && (look.robot == robot || look.robot == peer) {
                looked_at += 1;
                looked_off += usize::from(pair.is_off());
            }
        }
        if looked_at == 0 {
            return Verdict::SaysNothing;
        }
        if looked_off == 0 || excess <= EXCESS {
            return Verdict::Stands;
        }
        match off[..] {
            // The other one may have moved as well, unless somebody else sees it where it was.
            [peer] if pairs == 1 && self.is_where_it_was(peer, robot, look.at) => {
                Verdict::Astray { looks: LOOKS_OF_ONE_PAIR }
            }
            [_, _, ..] if 2 * off.len() > pairs => Verdict::Astray { looks: LOOKS },
            _ => Verdict::Stands,
        }
    }

    /// Whether most of the others see a robot where it was, and it them.
    fn is_where_it_was(&self, robot: usize, but: usize, at: Timestamp) -> bool {
        let others = self.block.members().iter().filter(|&&peer| peer != robot && peer != but);
        let pairs: Vec<Pair> = others.map(|&peer| self.pair(robot, peer, at)).filter(|pair| pair.n > 0).collect();
        2 * pairs.iter().filter(|pair| !pair.is_off()).count() > pairs.len()
    }

    fn pair(&self, a: usize, b: usize, at: Timestamp) -> Pair {
        let toward = |from: usize, to: usize| {
            let slots = self.robots[from].slots.iter().filter(move |s| s.name == Some(to));
            slots.filter_map(|s| s.off).filter(|off| at.seconds_since(off.at).abs() < PRESENT_S)
        };
        toward(a, b).chain(toward(b, a)).fold(Pair::default(), |pair, off| Pair {
            chi2: pair.chi2 + off.chi2,
            n: pair.n + off.n,
            newest: pair.newest.max(Some(off.at)),
        })
    }
}

/// What a look says of a robot that says that it stands.
#[derive(Debug, Clone, Copy)]
enum Verdict {
    /// It shows no pair of it.
    SaysNothing,
    /// Most of its pairs are as they were, or chance explains them.
    Stands,
    /// It has left its place, if so many looks in a row say so.
    Astray { looks: u32 },
}

/// How far off two robots see each other at present: χ², its degrees of freedom, and as of when.
#[derive(Debug, Clone, Copy, Default)]
struct Pair {
    chi2: f64,
    n: u32,
    newest: Option<Timestamp>,
}

impl Pair {
    /// Three standard deviations beyond the mean of χ².
    fn is_off(&self) -> bool {
        let n = f64::from(self.n);
        self.chi2 > n + 3.0 * (2.0 * n).sqrt()
    }
}

fn is_elsewhere(before: Pose2, now: Pose2) -> bool {
    (now.position() - before.position()).norm() > ELSEWHERE[0]
        || wrap(now.heading_rad - before.heading_rad).abs() > ELSEWHERE[1]
}
