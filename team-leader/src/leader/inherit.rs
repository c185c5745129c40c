//! What a leader takes over from another one, or from itself before a restart: frame, places, numbers of targets.
//!
//! Problem: whoever takes over must go on in the same frame with the same numbers, but a frame is nowhere measured.
//!
//! Insight: leaders that stand by compute everything anyway, from the same observations. All they lack is what the first leader
//! chose: the gauge and the numbers; and both stand in its map. So a map is all that is inherited, heard or read from a file. Its
//! poses become remembered places: the first robots that stand as remembered to each other carry the frame on, and one that
//! stands elsewhere is placed anew by what it sees. A leader that has already solved in a frame of its own gives it up: nobody
//! has seen it.

use nalgebra::Matrix3;
use protocol::frames::Pose2;
use protocol::id::RobotId;
use protocol::message::TeamMap;
use protocol::time::Timestamp;

use super::names::Own;
use super::{Leader, Output};
use crate::calibration::live::Calibrator;
use crate::correspondence::Follower;
use crate::team_map::build::full_covariance;

/// A robot of both maps is elsewhere when it is further away than this and the stated sigmas, metres and radians.
const ELSEWHERE: (f64, f64) = (0.1, 0.035);
/// Sigmas on top of it.
const ELSEWHERE_SIGMAS: f64 = 5.0;
/// Frames differ for so long before one's own is given up, seconds.
const DIFFERS_S: f64 = 0.5;

/// What is remembered between maps of others.
#[derive(Debug, Default)]
pub struct Heritage {
    /// Since when the own frame differs from the ruling leader's.
    differs_since: Option<Timestamp>,
    /// Robots whose places were read from a file and have not been confirmed.
    from_file: Vec<RobotId>,
}

impl Leader {
    /// Goes on from a map that was saved before: places that the robots' sightings confirm, numbers of targets, the term.
    /// Call it before anything else; `now` is the leader's clock.
    pub fn resume(&mut self, now: Timestamp, saved: &TeamMap, outputs: &mut Vec<Output>) {
        self.succession.term_heard(saved.term);
        self.take_places(now, saved, true, outputs);
        self.heritage.from_file = placed(saved).into_iter().map(|(id, ..)| id).collect();
        self.names.follow(&saved.targets, saved.next_target, saved.stamp, &[]);
    }

    /// A map of the leader that rules, while this one stands by.
    pub(super) fn inherit(&mut self, now: Timestamp, map: &TeamMap, outputs: &mut Vec<Output>) {
        if self.calibrator.gauge().is_none() {
            self.take_places(now, map, false, outputs);
        } else if self.frame_differs(map) {
            let since = *self.heritage.differs_since.get_or_insert(now);
            if now.seconds_since(since) >= DIFFERS_S {
                self.forget_frame();
                self.take_places(now, map, false, outputs);
                self.heritage.differs_since = None;
            }
        } else {
            self.heritage.differs_since = None;
        }
        let at = map.stamp.offset_by_secs(self.seconds_behind(map));
        let own: Vec<Own> = self
            .follower
            .targets()
            .iter()
            .filter(|followed| followed.is_confirmed())
            .map(|followed| {
                let (target, ahead_s) = (&followed.state.target, at.seconds_since(followed.state.last));
                let position = target.position() + target.velocity() * ahead_s.clamp(-0.5, 0.5);
                Own { id: followed.id, position }
            })
            .collect();
        self.names.follow(&map.targets, map.next_target, at, &own);
    }

    /// Says which robots stand elsewhere than remembered, once they are placed.
    pub(super) fn tell_of_moved(&mut self, outputs: &mut Vec<Output>) {
        for k in self.calibrator.take_moved() {
            let id = self.members[k].id;
            if self.heritage.from_file.contains(&id) {
                self.tell(
                    format!("robot {id} does not stand where it stood before the restart: its old place is dropped"),
                    outputs,
                );
            }
        }
    }

    fn take_places(&mut self, now: Timestamp, map: &TeamMap, from_file: bool, outputs: &mut Vec<Output>) {
        let gauge = map.gauge;
        for (id, pose, covariance) in placed(map) {
            let Some(k) = self.member(id, outputs) else { continue };
            if from_file {
                self.members[k].alive = false;
            }
            let is_gauge = gauge == Some(id);
            self.calibrator.remember(k, pose, &covariance, now, is_gauge, from_file);
        }
    }

    /// Whether most robots that both place stand elsewhere here than there.
    fn frame_differs(&self, map: &TeamMap) -> bool {
        let (mut common, mut elsewhere) = (0, 0);
        for (id, theirs, covariance) in placed(map) {
            let Some(k) = self.members.iter().position(|m| m.id == id) else { continue };
            let Some(ours) = self.calibrator.station(k) else { continue };
            let both = covariance + self.calibrator.covariance(k, k);
            let away_m = (theirs.position() - ours.position()).norm();
            let turned_rad = protocol::angle::wrap(theirs.heading_rad - ours.heading_rad).abs();
            let moved = away_m > ELSEWHERE.0 + ELSEWHERE_SIGMAS * (both[(0, 0)] + both[(1, 1)]).sqrt()
                || turned_rad > ELSEWHERE.1 + ELSEWHERE_SIGMAS * both[(2, 2)].sqrt();
            common += 1;
            elsewhere += usize::from(moved);
        }
        2 * elsewhere >= common.max(1)
    }

    /// Everything that is expressed in the own frame goes; robots and their clocks stay.
    fn forget_frame(&mut self) {
        self.calibrator = Calibrator::new(self.config.calibration);
        self.follower = Follower::new(self.config.targets);
        for k in 0..self.members.len() {
            self.introduce(self.members[k].id);
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

/// Robots of the map's first component with pose and covariance.
fn placed(map: &TeamMap) -> Vec<(RobotId, Pose2, Matrix3<f64>)> {
    let robots = map.robots.iter().filter(|robot| robot.team_from_body.is_some());
    let joint = full_covariance(&map.joint_covariance, 3 * robots.clone().count());
    robots
        .enumerate()
        .filter_map(|(k, robot)| {
            let covariance = joint.as_ref()?.fixed_view::<3, 3>(3 * k, 3 * k).into_owned();
            // Rounded to single precision on the wire.
            let covariance = covariance + Matrix3::identity() * 1e-10;
            Some((robot.id, robot.team_from_body.filter(|_| robot.component == 0)?, covariance))
        })
        .collect()
}
