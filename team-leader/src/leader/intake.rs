//! What comes in, checked and brought to the leader's time.

use nalgebra::Matrix3;
use protocol::frames::Pose2;
use protocol::id::RobotId;
use protocol::message::observation::FeaturePart;
use protocol::message::{
    Announcement, ClockProbe, ClockReply, Motion, Observation, Odometry, PeerSighting, Stages, TrackState,
};
use protocol::time::Timestamp;

use super::{Leader, Output};
use crate::calibration::closed_form::cylinder_range_m;
use crate::calibration::kernel;
use crate::calibration::live::Look;
use crate::calibration::slot::Sighted;
use crate::clock_offset::ClockOffset;
use crate::correspondence::Frame;
use crate::stereo::range_cue::CameraFacts;
use crate::timeline::Refusal;

/// Sightings less sure than this are not used.
const LEAST_CONFIDENCE: f64 = 0.3;
/// Ranges of robots that are used, metres.
const RANGE_M: [f64; 2] = [kernel::LEAST_RANGE_M, 60.0];

impl Leader {
    pub(super) fn announced(&mut self, announcement: Announcement, outputs: &mut Vec<Output>) {
        let robot = announcement.robot;
        let camera = &announcement.camera;
        if !(camera.height_m > 0.0 && camera.height_m <= 10.0 && camera.tilt_sigma_rad >= 0.0) {
            let text = format!(
                "robot {robot} announces a camera {} m above the floor with a tilt sigma of {} rad; (0, 10] m and ≥ 0 would be right: ignored",
                camera.height_m, camera.tilt_sigma_rad
            );
            return self.tell(text, outputs);
        }
        let Some(k) = self.member(robot, outputs) else { return };
        self.members[k].announced = Some((announcement.epoch, announcement.marker, announcement.camera));
    }

    /// Uses an observation; false where it was refused.
    pub(super) fn observed(
        &mut self,
        now: Timestamp,
        robot: RobotId,
        observation: &Observation,
        outputs: &mut Vec<Output>,
    ) -> bool {
        let Some(k) = self.member(robot, outputs) else { return false };
        self.members[k].heard = Some(now);
        self.members[k].alive = true;
        let trusted = self.config.clock.trusted;
        let member = &self.members[k];
        let camera = member
            .announced
            .as_ref()
            .map(|(_, _, camera)| CameraFacts { height_m: camera.height_m, tilt_sigma_rad: camera.tilt_sigma_rad });
        let Some(camera) = camera else {
            self.tell(format!("robot {robot} sends observations but has not announced itself yet: they wait"), outputs);
            return false;
        };
        // A new session has a new clock until a probe says otherwise.
        let known_clock = member.clock.filter(|_| member.clock_epoch == Some(observation.epoch));
        let (at, at_sigma_s) = match (trusted, known_clock) {
            (true, _) => (observation.capture, 0.0),
            (false, Some(clock)) => (clock.leader_time(observation.capture), clock.sigma_s(now)),
            (false, None) => return false,
        };
        let clock = (!trusted).then_some(now);
        let admission =
            match self.members[k].timeline.admit(observation.epoch, observation.sequence, at, self.newest, clock) {
                Ok(admission) => admission,
                Err(refusal) => {
                    let why = match refusal {
                        Refusal::OutOfOrder => "came twice or after a newer one",
                        Refusal::Late => "came too late",
                        Refusal::Future => "is stamped in the future: is its clock stepping?",
                    };
                    self.tell(format!("an observation of robot {robot} {why}; such are counted and not used"), outputs);
                    return false;
                }
            };
        self.newest = Some(self.newest.map_or(at, |n| n.max(at)));
        if admission.new_session {
            self.follower.forget_tracks(k);
            self.systematic.new_session(k);
        }
        let sightings: Vec<Sighted> = if observation.stages.ran(Stages::PEERS) {
            observation.sightings.iter().filter_map(|s| self.sighted(s)).collect()
        } else {
            Vec::new()
        };
        let sigmas =
            observation.tracks.iter().filter(|t| t.state == TrackState::Visible).map(|t| t.bearing_sigma.value());
        self.note_bearings(k, sigmas, admission.since_last_s);
        let changes = self.calibrator.observe(&Look {
            robot: k,
            at,
            since_last_s: admission.since_last_s,
            motion: observation.motion,
            odometry: observation.odometry.as_ref().and_then(odometry_of),
            sightings: &sightings,
        });
        for (robot, ..) in &changes.left {
            self.systematic.left_station(*robot);
        }
        self.tell_findings(outputs);
        self.follower.follow_changes(&changes, at);
        if let (Some(pose), Motion::Standing) = (self.calibrator.station(k), observation.motion) {
            let frame = Frame { robot: k, at, at_sigma_s, pose, camera, tracks: &observation.tracks };
            self.follow(&frame, outputs);
        }
        true
    }

    pub(super) fn clock_replied(
        &mut self,
        now: Timestamp,
        robot: RobotId,
        reply: &ClockReply,
        outputs: &mut Vec<Output>,
    ) {
        let Some(k) = self.member(robot, outputs) else { return };
        let max_drift = self.config.clock.max_drift;
        let member = &mut self.members[k];
        let usable = match &mut member.clock {
            Some(clock) if member.clock_epoch == Some(reply.epoch) => clock.narrow(reply, now),
            slot => match ClockOffset::from_reply(reply, now, max_drift) {
                Some(clock) => {
                    *slot = Some(clock);
                    member.clock_epoch = Some(reply.epoch);
                    true
                }
                None => false,
            },
        };
        if !usable {
            self.tell(format!("clock replies of robot {robot} contradict themselves: ignored"), outputs);
        }
    }

    /// Sends the probes that are due.
    pub(super) fn probe(&mut self, now: Timestamp, outputs: &mut Vec<Output>) {
        for member in &mut self.members {
            if member.next_probe(&self.config.clock).is_some_and(|due| due <= now) {
                member.probes = member.probes.saturating_add(1);
                member.last_probe = Some(now);
                outputs.push(Output::ClockProbe(member.id, ClockProbe { sent: now }));
            }
        }
    }

    /// A sighting in the calibration's terms; `None` where it says nothing usable.
    fn sighted(&self, sighting: &PeerSighting) -> Option<Sighted> {
        if sighting.confidence.value() < LEAST_CONFIDENCE {
            return None;
        }
        let robot = match sighting.robot {
            Some(id) => Some(self.members.iter().position(|m| m.id == id)?),
            None => None,
        };
        let width_rad = match sighting.range {
            Some(r) => Some((r.range.m(), r.sigma.value())),
            None => self.range_from_edges(sighting, robot),
        }
        .filter(|(range, sigma)| (RANGE_M[0]..RANGE_M[1]).contains(range) && *sigma > 0.0)
        .map(|(range, sigma)| {
            let (width, slope) = kernel::width(range);
            (width, (slope * sigma).powi(2))
        });
        let sigma = sighting.bearing_sigma.value();
        let frame_var = (sigma * sigma, width_rad.map_or(0.0, |(_, var)| var));
        Some(Sighted { bearing_rad: sighting.bearing.rad(), bearing_var: sigma * sigma, width_rad, frame_var, robot })
    }

    /// Range from the two edges of a round body, where all robots that it may be are equally thick.
    fn range_from_edges(&self, sighting: &PeerSighting, robot: Option<usize>) -> Option<(f64, f64)> {
        let edge = |part| sighting.features.iter().find(|f| f.part == part);
        let (left, right) = (edge(FeaturePart::Left)?, edge(FeaturePart::Right)?);
        let mut radii = match robot {
            Some(k) => vec![self.members[k].radius_m()?],
            None => self.members.iter().filter_map(super::member::Member::radius_m).collect(),
        };
        radii.dedup();
        let [radius_m] = radii[..] else { return None };
        let width = protocol::angle::wrap(left.bearing.rad() - right.bearing.rad());
        let range_m = cylinder_range_m(width, radius_m)?;
        let sigma = left.sigma.value().hypot(right.sigma.value());
        Some((range_m, range_m * (range_m.powi(2) - radius_m.powi(2)).max(0.0).sqrt() / (2.0 * radius_m) * sigma))
    }
}

/// Odometry with its covariance; `None` where it is not finite or not a covariance.
fn odometry_of(odometry: &Odometry) -> Option<(Pose2, Matrix3<f64>)> {
    let [xx, xy, xh, yy, yh, hh] = odometry.covariance.map(f64::from);
    let covariance = Matrix3::new(xx, xy, xh, xy, yy, yh, xh, yh, hh);
    let step = Pose2::new(f64::from(odometry.dx_m), f64::from(odometry.dy_m), f64::from(odometry.dheading_rad));
    let finite = [step.x_m, step.y_m, step.heading_rad].iter().chain(covariance.iter()).all(|v| v.is_finite());
    let positive = finite && covariance.symmetric_eigenvalues().min() >= -1e-12;
    positive.then_some((step, covariance))
}
