//! What a leader takes over from another one, or from itself before a restart: frame, places, numbers of targets.
//!
//! Problem: whoever takes over must go on in the same frame with the same numbers, but a frame is nowhere measured.
//!
//! Insight: leaders that stand by compute everything anyway, from the same observations. All they lack is what the first leader
//! chose: the gauge and the numbers; and both stand in its map. So a map is all that is inherited, heard or read from a file. Its
//! poses become remembered places: the first robots that stand as remembered to each other carry the frame on, and one that
//! stands elsewhere is placed anew by what it sees. A leader that has already solved in a frame of its own gives it up: nobody
//! has seen it.

use std::collections::BTreeMap;

use nalgebra::Matrix3;
use protocol::frames::Pose2;
use protocol::id::RobotId;
use protocol::message::{Presence, TeamMap};
use protocol::time::Timestamp;

use super::{Leader, Output};
use crate::calibration::live::Calibrator;

/// A robot of both maps is elsewhere when it is further away than this and the stated sigmas, metres and radians.
const ELSEWHERE: (f64, f64) = (0.1, 0.035);
/// Sigmas on top of it.
const ELSEWHERE_SIGMAS: f64 = 5.0;
/// Frames differ for so long before one's own is given up, seconds.
const DIFFERS_S: f64 = 0.5;

/// What is remembered between maps of others.
#[derive(Debug, Default)]
pub struct Heritage {
    /// Since when our frame differs from the ruling leader's, by its components.
    differs_since: BTreeMap<u8, Timestamp>,
    /// Robots whose places were read from a file and have not been confirmed.
    from_file: Vec<RobotId>,
}

impl Leader {
    /// Goes on from a map that was saved before: places that the robots' sightings confirm, numbers of targets, the term.
    /// Call it before anything else; `now` is the leader's clock.
    pub fn resume(&mut self, now: Timestamp, saved: &TeamMap, outputs: &mut Vec<Output>) {
        self.succession.term_heard(saved.term);
        for component in saved.components() {
            self.take_places(now, saved, component, true, outputs);
            self.heritage.from_file.extend(saved.placed(component).map(|robot| robot.id));
        }
        self.follow_numbers(saved, saved.stamp);
    }

    /// A map of the leader that rules, while this one stands by.
    pub(super) fn inherit(&mut self, now: Timestamp, map: &TeamMap, outputs: &mut Vec<Output>) {
        let components = map.components();
        self.heritage.differs_since.retain(|component, _| components.contains(component));
        for theirs in components {
            let Some(ours) = self.counterpart(map, theirs) else {
                self.take_places(now, map, theirs, false, outputs);
                continue;
            };
            if !self.frame_differs(map, theirs, ours) {
                self.heritage.differs_since.remove(&theirs);
                continue;
            }
            let since = *self.heritage.differs_since.entry(theirs).or_insert(now);
            if now.seconds_since(since) >= DIFFERS_S {
                self.forget_frame(ours);
                self.take_places(now, map, theirs, false, outputs);
                self.heritage.differs_since.remove(&theirs);
            }
        }
        self.follow_numbers(map, map.stamp.offset_by_secs(self.seconds_behind(map)));
    }

    /// Learns which of our targets bear which numbers in a map, of the instant `at`.
    fn follow_numbers(&mut self, map: &TeamMap, at: Timestamp) {
        let serial = |component: usize| self.components[component].serial;
        let frames: BTreeMap<u8, u32> =
            map.components().into_iter().filter_map(|c| Some((c, serial(self.counterpart(map, c)?)))).collect();
        let own = self.own_targets(at);
        self.names.follow(&map.targets, map.next_target, at, &own, |component| frames.get(&component).copied());
    }

    /// Our component that has places for most robots of one of a map's; the team's own for the team's own. `None` where we have
    /// no such frame yet.
    fn counterpart(&self, map: &TeamMap, theirs: u8) -> Option<usize> {
        if theirs == 0 {
            return self.components[0].calibrator.gauge().map(|_| 0);
        }
        let homes: Vec<usize> = map
            .placed(theirs)
            .filter_map(|robot| {
                let k = self.members.iter().position(|m| m.id == robot.id)?;
                let home = self.members[k].component;
                self.components[home].calibrator.knows(k).then_some(home)
            })
            .collect();
        let count = |home: usize| homes.iter().filter(|h| **h == home).count();
        homes.iter().copied().max_by_key(|home| (count(*home), usize::MAX - home))
    }

    /// Says which robots stand elsewhere than remembered, once they are placed.
    pub(super) fn tell_of_moved(&mut self, outputs: &mut Vec<Output>) {
        let moved = self.components.iter_mut().flat_map(|component| component.calibrator.take_moved());
        for k in moved.collect::<Vec<_>>() {
            let id = self.members[k].id;
            if self.heritage.from_file.contains(&id) {
                self.tell(
                    format!("robot {id} does not stand where it stood before the restart: its old place is dropped"),
                    outputs,
                );
            }
        }
    }

    /// Robots of one of the map's components stand as it says, in a frame that we take over.
    fn take_places(&mut self, now: Timestamp, map: &TeamMap, theirs: u8, from_file: bool, outputs: &mut Vec<Output>) {
        let ours = match theirs {
            0 => 0,
            _ => self.new_component(Calibrator::new(self.config.calibration)),
        };
        for (id, pose, covariance) in placed(map, theirs) {
            let Some(k) = self.member(id, outputs) else { continue };
            let said_gone = || map.robots.iter().any(|robot| robot.id == id && robot.presence == Presence::Offline);
            if from_file || (self.members[k].heard.is_none() && said_gone()) {
                self.members[k].alive = false;
            }
            self.move_to(k, ours, now);
            let is_gauge = map.gauge == Some(id);
            self.home(k).calibrator.remember(k, pose, &covariance, now, is_gauge, from_file);
        }
    }

    /// Whether most robots that both place stand elsewhere here than there.
    fn frame_differs(&self, map: &TeamMap, theirs: u8, ours: usize) -> bool {
        let calibrator = &self.components[ours].calibrator;
        let (mut common, mut elsewhere) = (0, 0);
        for (id, theirs, covariance) in placed(map, theirs) {
            let Some(k) = self.members.iter().position(|m| m.id == id) else { continue };
            let Some(ours) = calibrator.station(k) else { continue };
            let both = covariance + calibrator.covariance(k, k);
            let away_m = (theirs.position() - ours.position()).norm();
            let turned_rad = protocol::angle::wrap(theirs.heading_rad - ours.heading_rad).abs();
            let moved = away_m > ELSEWHERE.0 + ELSEWHERE_SIGMAS * (both[(0, 0)] + both[(1, 1)]).sqrt()
                || turned_rad > ELSEWHERE.1 + ELSEWHERE_SIGMAS * both[(2, 2)].sqrt();
            common += 1;
            elsewhere += usize::from(moved);
        }
        2 * elsewhere >= common.max(1)
    }

    /// Everything that is expressed in one of our frames goes; robots and their clocks stay.
    fn forget_frame(&mut self, component: usize) {
        self.components[component].clear(&self.config);
        for k in self.robots_of(component).collect::<Vec<_>>() {
            self.introduce(k);
        }
    }

    /// This leader's clock minus the other's, by the robots whose clocks both have measured.
    fn seconds_behind(&self, map: &TeamMap) -> f64 {
        let mut offsets: Vec<f64> = map
            .robots
            .iter()
            .filter_map(|robot| {
                let (theirs, _) = robot.clock_offset_s?;
                let member = self.members.iter().find(|m| m.id == robot.id)?;
                Some(f64::from(theirs) - member.clock?.offset_s())
            })
            .collect();
        offsets.sort_by(f64::total_cmp);
        offsets.get(offsets.len() / 2).copied().unwrap_or(0.0)
    }
}

/// Robots of one of the map's components with pose and covariance.
fn placed(map: &TeamMap, component: u8) -> Vec<(RobotId, Pose2, Matrix3<f64>)> {
    let joint = map.joint_covariance_of(component);
    map.placed(component)
        .enumerate()
        .filter_map(|(k, robot)| {
            let covariance = joint.as_ref()?.fixed_view::<3, 3>(3 * k, 3 * k).into_owned();
            // Rounded to single precision on the wire.
            let covariance = covariance + Matrix3::identity() * 1e-10;
            Some((robot.id, robot.team_from_body?, covariance))
        })
        .collect()
}
