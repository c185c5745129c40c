//! Whether what robots say fits together: shared errors are corrected, what contradicts is named.

use protocol::message::{TrackObservation, Trust};
use protocol::quantity::LogSigma;

use super::components::Component;
use super::{Leader, Output};
use crate::calibration::live::Finding;
use crate::correspondence::Frame;

/// A lag or a bias that people are told of.
const TOLD_LAG_S: f64 = 0.03;
const TOLD_BIAS_RAD: f64 = 0.01;

impl Leader {
    /// A frame goes to the follower, less the errors that the robot's bearings are known to share.
    pub(super) fn follow(&mut self, frame: &Frame<'_>, outputs: &mut Vec<Output>) {
        let home = self.members[frame.robot].component;
        let thrift = self.thrift();
        let Component { calibrator, follower, systematic, .. } = &mut self.components[home];
        let shared = systematic.of(frame.robot);
        let used = frame.at.offset_by_secs(-shared.sure_lag_s);
        systematic.expect(frame.robot, used, frame.at, frame.at_sigma_s, frame.pose);
        let mut pose = frame.pose;
        pose.heading_rad = protocol::angle::wrap(pose.heading_rad - shared.sure_bias_rad);
        let widened: Vec<TrackObservation>;
        let tracks = if shared.widened > 1.0 {
            let wider = |t: &TrackObservation| TrackObservation {
                bearing_sigma: LogSigma::from_value(t.bearing_sigma.value() * shared.widened),
                ..t.clone()
            };
            widened = frame.tracks.iter().map(wider).collect();
            &widened
        } else {
            frame.tracks
        };
        follower.be_thrifty(thrift as u32);
        follower.observe(&Frame { at: used, pose, tracks, ..*frame }, calibrator);
        for settled in follower.take_settled() {
            systematic.learn(&settled);
        }
        for robot in self.robots_of(home).collect::<Vec<_>>() {
            self.tell_of_shared_errors(robot, outputs);
        }
    }

    /// What people should know of a robot's shared errors, once each.
    fn tell_of_shared_errors(&mut self, robot: usize, outputs: &mut Vec<Output>) {
        let now = self.home(robot).systematic.of(robot);
        let found = [now.sure_lag_s.abs() > TOLD_LAG_S, now.sure_bias_rad.abs() > TOLD_BIAS_RAD, now.widened > 1.0];
        let told = std::mem::replace(&mut self.members[robot].told_shared, found);
        let id = self.members[robot].id;
        if found[0] && !told[0] {
            let (lag_s, sigma_s) = now.lag_s.unwrap_or((now.sure_lag_s, 0.0));
            let (ms, word) = (lag_s.abs() * 1e3, if lag_s > 0.0 { "older" } else { "younger" });
            let text = format!(
                "robot {id}: its pictures are {ms:.0} ± {:.0} ms {word} than their stamps say, against the other robots': \
                 corrected; a `latency_ms` in its camera's [timing] would say so",
                sigma_s * 1e3
            );
            self.tell(text, outputs);
        }
        if found[1] && !told[1] {
            let text = format!(
                "robot {id}: its bearings of targets are turned by {:.2}° against its heading: corrected; its camera's \
                 azimuth or centre may be wrong",
                now.sure_bias_rad.to_degrees()
            );
            self.tell(text, outputs);
        }
        if found[2] && !told[2] {
            let text = format!(
                "robot {id}: errors of its bearings are about {:.1} times as large as it states: its sigmas are widened",
                now.widened
            );
            self.tell(text, outputs);
        }
    }

    /// What the calibration has found to be wrong, once each.
    pub(super) fn tell_findings(&mut self, outputs: &mut Vec<Output>) {
        let found = self.components.iter_mut().flat_map(|component| component.calibrator.take_new_findings());
        for finding in found.collect::<Vec<_>>() {
            let text = self.in_words(&finding);
            self.tell(text, outputs);
        }
    }

    /// A finding with the robots' names.
    pub(super) fn in_words(&self, finding: &Finding) -> String {
        let id = |r: usize| self.members.get(r).map_or_else(|| "?".to_owned(), |m| m.id.to_string());
        match finding {
            Finding::Size { robot, ratio } => format!(
                "robot {} looks {ratio:.2} times as thick as it announces: its marker's size is wrong; its distances are \
                 taken from what it sees itself",
                id(*robot)
            ),
            Finding::Ranges { robot, ratio } => format!(
                "robot {} measures distances {ratio:.2} times as long as the others: its camera's file or height is wrong; \
                 distances are taken from what the others see",
                id(*robot)
            ),
            Finding::Pair { a, b, ranges_m: [one, other] } => format!(
                "robots {} and {} measure the distance between them as {one:.2} and {other:.2} m: the marker's size that one of \
                 them announces, or a camera, is wrong",
                id(*a),
                id(*b)
            ),
            Finding::Contradicts { robot } => format!(
                "what robot {} sees of the others, or they of it, contradicts the rest: it is set aside; its camera or marker \
                 is wrong",
                id(*robot)
            ),
            Finding::OwnName { observer } => format!(
                "robot {} sees its own name on another robot: markers or ids are exchanged; names of such markers are not \
                 believed",
                id(*observer)
            ),
            Finding::Carried { robot } => {
                format!(
                    "robot {} stands elsewhere than before without having said that it moves: it was carried",
                    id(*robot)
                )
            }
        }
    }

    /// What the map says of how far a robot's sigmas are believed.
    pub(super) fn trust(&self, robot: usize) -> Trust {
        let home = &self.components[self.members[robot].component];
        let shared = home.systematic.of(robot);
        if shared.set_aside || home.calibrator.is_set_aside(robot) {
            Trust::SetAside
        } else if shared.widened > 1.0 {
            Trust::Widened(shared.widened as f32)
        } else {
            Trust::Full
        }
    }
}
