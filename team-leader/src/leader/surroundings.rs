//! What each robot is told of the people round it: where the map has them, and which of its own tracks are they.
//!
//! A robot alone guesses how far away somebody is, and in a crowd who stands in front; its figures slide from one body to another,
//! and bearings of the wrong one come to the leader. Told where to look, it measures the right one. Only the search is directed:
//! bearings are still of its own picture, so that what one robot errs does not come back as another's measurement.
//!
//! It is told only of whom two others see: that place is theirs, and not its own bearing come back. Who is on one ray, or on none any
//! more, may be anywhere near: a robot that looks for him there finds a figure in somebody else, its bearing holds the wrong place
//! up, and all of them stay wrong. With one other robot it is told of whom both see.

use nalgebra::Vector2;
use protocol::message::surroundings::MAX_PEOPLE;
use protocol::message::{Neighbour, Surroundings};
use protocol::quantity::{Angle16, LogSigma, Millimetres};
use protocol::time::Timestamp;

use super::{Leader, Output};

/// People further away are not told of, metres.
const FURTHEST_M: f64 = 8.0;
/// Other robots that must see somebody for his place to be told to one.
const OTHERS: usize = 2;
/// Fastest that is told, m/s.
const FASTEST_MPS: f64 = 10.0;

impl Leader {
    /// Tells a robot whose observation was used what is round it.
    pub(super) fn tell_surroundings(&self, robot: usize, outputs: &mut Vec<Output>) {
        let (Some(term), Some(newest)) = (self.succession.reign(), self.newest) else { return };
        let Some((at, epoch)) = self.clock_and_session(robot, newest) else { return };
        let people = self.neighbours(robot, newest);
        if !people.is_empty() {
            let (leader, robot) = (self.config.leader, self.members[robot].id);
            outputs.push(Output::Surroundings(Surroundings { robot, epoch, leader, term, at, people }));
        }
    }

    /// A time on the robot's own clock, and its session.
    fn clock_and_session(&self, robot: usize, at: Timestamp) -> Option<(Timestamp, u64)> {
        let member = &self.members[robot];
        let epoch = member.announced.as_ref().map(|(epoch, ..)| *epoch)?;
        if self.config.clock.trusted {
            return Some((at, epoch));
        }
        Some((member.clock_of(epoch)?.robot_time(at), epoch))
    }

    fn neighbours(&self, robot: usize, at: Timestamp) -> Vec<Neighbour> {
        let component = &self.components[self.members[robot].component];
        let calibrator = &component.calibrator;
        let Some(pose) = calibrator.pose(robot, at).filter(|_| !calibrator.moves(robot)) else { return Vec::new() };
        let body_from_team = pose.inverse();
        let needed = calibrator.stations().filter(|(r, _)| *r != robot).count().clamp(1, OTHERS);
        let mut near: Vec<(f64, Neighbour)> = component
            .confirmed()
            .filter_map(|followed| {
                let own_track = followed.state.observers_at(at).find(|o| o.robot == robot).map(|o| o.track);
                let others = followed.state.observers_at(at).filter(|o| o.robot != robot).count();
                if others < needed || needed < OTHERS && own_track.is_none() {
                    return None;
                }
                let covariance = followed.published_covariance(calibrator, &self.config.targets)?;
                let mut target = followed.state.target.clone();
                target.predict(at);
                let place = body_from_team.transform(target.position());
                let range_m = place.norm();
                let along = (target.position() - pose.position()) / range_m.max(1e-9);
                let across = Vector2::new(-along.y, along.x);
                let sigma =
                    [along, across].map(|axis| LogSigma::from_value(axis.dot(&(covariance * axis)).max(0.0).sqrt()));
                let velocity = body_from_team.rotation() * target.velocity();
                let neighbour = Neighbour {
                    track: own_track,
                    bearing: Angle16::from_rad(place.y.atan2(place.x)),
                    range: Millimetres::from_m(range_m),
                    sigma,
                    velocity_mmps: [velocity.x, velocity.y]
                        .map(|v| (1e3 * v.clamp(-FASTEST_MPS, FASTEST_MPS)).round() as i16),
                };
                (range_m < FURTHEST_M).then_some((range_m, neighbour))
            })
            .collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0));
        near.into_iter().take(MAX_PEOPLE).map(|(_, neighbour)| neighbour).collect()
    }
}
