//! What comes in, checked and brought to the leader's time.

use nalgebra::Matrix3;
use protocol::frames::Pose2;
use protocol::id::RobotId;
use protocol::message::observation::FeaturePart;
use protocol::message::{
    Alarm, Announcement, ClockProbe, ClockReply, Edges, Motion, Observation, Odometry, PeerSighting, Recent, Stages,
    Trouble,
};
use protocol::time::Timestamp;

use super::sessions::Verdict;
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
/// So many observations in a row that took so much longer or shorter than usual ask for a clock probe (one alone was held up
/// somewhere); seconds. How fast the usual delay is learned, a part an observation.
const CLOCK_JUMP_S: f64 = 0.05;
const CLOCK_JUMP_FRAMES: u32 = 3;
const DELAY_MEMORY: f64 = 0.2;
/// Edges are of the place where the robot stands now if they are no older, seconds.
const EDGES_AGE_S: f64 = 1.0;
/// Ranges of robots that are used, metres.
const RANGE_M: [f64; 2] = [kernel::LEAST_RANGE_M, 60.0];

impl Leader {
    pub(super) fn announced(&mut self, now: Timestamp, announcement: Announcement, outputs: &mut Vec<Output>) {
        let robot = announcement.robot;
        let verdict = self.sessions.announced(now, &announcement);
        if !self.is_used(robot, verdict, outputs) {
            return;
        }
        let camera = &announcement.camera;
        if !(camera.height_m > 0.0 && camera.height_m <= 10.0 && camera.tilt_sigma_rad >= 0.0) {
            let text = format!(
                "robot {robot} announces a camera {} m above the floor with a tilt sigma of {} rad; (0, 10] m and ≥ 0 would be right: ignored",
                camera.height_m, camera.tilt_sigma_rad
            );
            return self.tell(text, outputs);
        }
        let Some(k) = self.member(robot, outputs) else { return };
        self.home(k).calibrator.is_back(k);
        self.members[k].announced = Some((announcement.epoch, announcement.marker, announcement.camera));
    }

    /// What a robot saw before this leader came.
    pub(super) fn remind(&mut self, robot: RobotId, recent: Recent) {
        if let Some(member) = self.members.iter_mut().find(|member| member.id == robot) {
            member.remind(recent);
        }
    }

    /// Uses what has waited for the robot's announcement or its clock; the robot's number where something was used.
    pub(super) fn catch_up(&mut self, now: Timestamp, robot: RobotId, outputs: &mut Vec<Output>) -> Option<usize> {
        let member = self.members.iter_mut().find(|member| member.id == robot)?;
        let mut used = None;
        for observation in member.take_waiting(self.config.clock.trusted) {
            used = self.observed(now, robot, observation, outputs).or(used);
        }
        if let Some(k) = used {
            // They took as long as they waited, not as long as the network takes.
            self.members[k].usual_delay_s = None;
        }
        used
    }

    /// Uses an observation; the robot's number, or `None` where it was refused, or waits.
    pub(super) fn observed(
        &mut self,
        now: Timestamp,
        robot: RobotId,
        observation: Observation,
        outputs: &mut Vec<Output>,
    ) -> Option<usize> {
        let k = self.member(robot, outputs)?;
        self.members[k].heard = Some(now);
        self.members[k].alive = true;
        let verdict = self.sessions.heard(now, robot, observation.epoch);
        if !self.is_used(robot, verdict, outputs) {
            return None;
        }
        let trusted = self.config.clock.trusted;
        let member = &self.members[k];
        let camera = member
            .announced
            .as_ref()
            .map(|(_, _, camera)| CameraFacts { height_m: camera.height_m, tilt_sigma_rad: camera.tilt_sigma_rad });
        let Some(camera) = camera else {
            self.members[k].trouble = Some(Trouble::NotAnnounced);
            self.members[k].wait(observation);
            self.tell(format!("robot {robot} sends observations but has not announced itself yet: they wait"), outputs);
            return None;
        };
        let limit_s = self.config.clock.max_uncertainty_s;
        let (at, at_sigma_s) = match (trusted, member.clock_of(observation.epoch)) {
            (true, _) => (observation.capture, 0.0),
            (false, Some(clock)) if clock.half_width_s(now) > limit_s => {
                let known_ms = 1e3 * clock.half_width_s(now);
                self.members[k].trouble = Some(Trouble::ClockUncertain);
                let limit_ms = 1e3 * limit_s;
                let text = format!(
                    "robot {robot} is not used: its clock is known to ± {known_ms:.0} ms only, and ± {limit_ms:.0} ms is the limit; is the network slow one way?"
                );
                // The figure is that of the first time: later ones would be told again and again.
                self.tell_once(format!("clock of {robot}"), text, outputs);
                return None;
            }
            (false, Some(clock)) => (clock.leader_time(observation.capture), clock.sigma_s(now)),
            (false, None) => {
                self.members[k].trouble = Some(Trouble::ClockUnknown);
                self.members[k].wait(observation);
                return None;
            }
        };
        let admission =
            match self.members[k].timeline.admit(observation.epoch, observation.sequence, at, self.newest, now) {
                Ok(admission) => admission,
                Err(refusal) => {
                    self.members[k].doubt_clock(now, &self.config.clock);
                    let why = match refusal {
                        Refusal::OutOfOrder => "came twice or after a newer one",
                        Refusal::Late => "came too late",
                        Refusal::Future => "is stamped in the future: is its clock stepping?",
                    };
                    self.tell(format!("an observation of robot {robot} {why}; such are counted and not used"), outputs);
                    return None;
                }
            };
        let member = &mut self.members[k];
        (member.used, member.trouble) = (Some(now), None);
        if !trusted {
            let delay_s = now.seconds_since(at);
            let usual_s = *member.usual_delay_s.get_or_insert(delay_s);
            if (delay_s - usual_s).abs() <= CLOCK_JUMP_S {
                member.unusual_delays = 0;
                member.usual_delay_s = Some(usual_s + DELAY_MEMORY * (delay_s - usual_s));
            } else {
                member.unusual_delays += 1;
                if member.unusual_delays >= CLOCK_JUMP_FRAMES {
                    (member.unusual_delays, member.usual_delay_s) = (0, None);
                    member.doubt_clock(now, &self.config.clock);
                }
            }
        }
        self.newest = Some(self.newest.map_or(at, |n| n.max(at)));
        if admission.new_session {
            let home = self.home(k);
            home.follower.forget_tracks(k);
            home.systematic.new_session(k);
            let changes = home.calibrator.new_session(k, at);
            home.follow_changes(&changes, at);
        }
        let sightings: Vec<Sighted> = if observation.stages.ran(Stages::PEERS) {
            observation.sightings.iter().filter_map(|s| self.sighted(s)).collect()
        } else {
            Vec::new()
        };
        self.note_bearings(k, &observation.tracks, admission.since_last_s);
        let thrifty = self.thrift() > 1;
        let home = self.home(k);
        home.calibrator.be_thrifty(thrifty);
        let changes = home.calibrator.observe(&Look {
            robot: k,
            at,
            since_last_s: admission.since_last_s,
            motion: observation.motion,
            odometry: observation.odometry.as_ref().and_then(odometry_of),
            sightings: &sightings,
        });
        home.follow_changes(&changes, at);
        self.tell_findings(outputs);
        self.exchange_robots(at);
        if let (Some(pose), Motion::Standing) = (self.home(k).calibrator.station(k), observation.motion) {
            let frame = Frame { robot: k, at, at_sigma_s, pose, camera, tracks: &observation.tracks };
            self.follow(&frame, outputs);
        }
        Some(k)
    }

    pub(super) fn clock_replied(
        &mut self,
        now: Timestamp,
        robot: RobotId,
        reply: &ClockReply,
        outputs: &mut Vec<Output>,
    ) {
        let verdict = self.sessions.heard(now, robot, reply.epoch);
        if !self.is_used(robot, verdict, outputs) {
            return;
        }
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

    /// What a robot sees round it that stands still.
    pub(super) fn looked_round(&mut self, now: Timestamp, robot: RobotId, edges: &Edges, outputs: &mut Vec<Output>) {
        let verdict = self.sessions.heard(now, robot, edges.epoch);
        let Some(k) = self.members.iter().position(|m| m.id == robot) else { return };
        let camera = self.members[k].announced.as_ref().filter(|(epoch, ..)| *epoch == edges.epoch);
        let Some(height_m) = camera.map(|(_, _, camera)| camera.height_m) else { return };
        // What was seen long ago may have been seen from elsewhere.
        let is_new =
            self.leader_time(k, edges.epoch, edges.at).is_some_and(|at| now.seconds_since(at).abs() < EDGES_AGE_S);
        if self.is_used(robot, verdict, outputs) && is_new {
            let home = self.home(k);
            home.structure.see(k, height_m, edges, &home.calibrator);
        }
    }

    /// A time of a session of a robot on the leader's clock.
    fn leader_time(&self, robot: usize, epoch: u64, at: Timestamp) -> Option<Timestamp> {
        if self.config.clock.trusted {
            return Some(at);
        }
        self.members[robot].clock_of(epoch).map(|clock| clock.leader_time(at))
    }

    /// An alarm of a robot; any session's, also one that has ended.
    pub(super) fn alarmed(&mut self, now: Timestamp, alarm: Alarm, outputs: &mut Vec<Output>) {
        if self.alarms.take(now, &alarm) {
            outputs.push(Output::Alarm(alarm));
        }
    }

    /// Whether a message is used; if not, why is told.
    pub(super) fn is_used(&mut self, robot: RobotId, verdict: Verdict, outputs: &mut Vec<Output>) -> bool {
        match verdict {
            Verdict::Use => true,
            Verdict::Drop { notice } => {
                let in_conflict = self.sessions.in_conflict(robot);
                if let Some(member) = self.members.iter_mut().find(|m| m.id == robot).filter(|_| in_conflict) {
                    member.trouble = Some(Trouble::TwoSessions);
                }
                if let Some(notice) = notice {
                    self.tell(notice, outputs);
                }
                false
            }
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
