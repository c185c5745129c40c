//! Robots whose observations are made from the truth instead of pictures: a thousand times as fast, with the noise that agents
//! show. They see each other and people past each other's bodies; what stands behind somebody is not seen.

use protocol::angle::wrap;
use protocol::id::{RobotId, TrackId};
use protocol::marker::Marker;
use protocol::message::{
    Alarm, AlarmKind, Announcement, CameraSummary, ClockProbe, ClockReply, ElevationEnd, Motion, ObjectClass,
    Observation, PeerSighting, SightedRange, Stages, TrackObservation, TrackState,
};
use protocol::quantity::{Angle16, Fraction8, LogSigma, Millimetres};
use protocol::time::Timestamp;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

use crate::scenario::Scenario;
use crate::world::body::RADIUS_M;
use crate::world::{State, World};

/// Half a person, metres.
const HALF_PERSON_M: f64 = 0.23;
/// Height of the camera, metres.
const CAMERA_M: f64 = 0.6;
/// Standard deviations: of an edge of a fellow robot, of a person's bearing (white, and the body's sway), radians and metres.
const EDGE_RAD: f64 = 9e-4;
const WHITE_RAD: f64 = 2.6e-3;
const SWAY_M: f64 = 0.03;
/// A track that was hidden for longer comes back under another number, seconds.
const TRACK_KEPT_S: f64 = 1.0;
/// Alarms that are kept for late joiners, as agents do.
const MAX_KEPT: usize = 64;

/// A robot's agent, as far as the network hears it.
#[derive(Debug)]
pub struct Robot {
    /// Who.
    pub id: RobotId,
    /// Its session.
    pub epoch: u64,
    /// Its clock minus true time, seconds.
    pub clock_offset_s: f64,
    /// Alarms raised so far, the newest last; over restarts, as the journal keeps them.
    pub alarms: Vec<Alarm>,
    index: usize,
    sequence: u32,
    next_alarm: u32,
    random: ChaCha8Rng,
    sway_m: Vec<f64>,
    /// Of each person: the track's number and when it was last seen.
    tracks: Vec<Option<(u32, f64)>>,
    next_track: u32,
    /// Of each person: since when it is seen without a break.
    pub seen_since: Vec<Option<f64>>,
}

impl Robot {
    /// A robot of the world.
    pub fn new(world: &World, index: usize) -> Self {
        let robot = &world.robots()[index];
        let mut random = ChaCha8Rng::seed_from_u64(world.seed());
        random.set_stream(0x0066_6565_6400 + index as u64);
        let people = world.people_count();
        Self {
            id: robot.id,
            epoch: 1,
            clock_offset_s: robot.clock_offset_s,
            alarms: Vec::new(),
            index,
            sequence: 0,
            next_alarm: 0,
            random,
            sway_m: vec![0.0; people],
            tracks: vec![None; people],
            next_track: 0,
            seen_since: vec![None; people],
        }
    }

    /// A new session: the process was started again.
    pub fn restart(&mut self) {
        self.epoch += 1;
        (self.sequence, self.next_alarm) = (0, 0);
        self.lose_sight();
    }

    /// Everything is seen anew.
    pub fn lose_sight(&mut self) {
        self.tracks.fill(None);
        self.seen_since.fill(None);
    }

    /// What the robot's clock shows.
    pub fn clock(&self, true_time: Timestamp) -> Timestamp {
        true_time.offset_by_secs(self.clock_offset_s)
    }

    /// Who it is.
    pub fn announcement(&self, scenario: &Scenario) -> Announcement {
        Announcement {
            robot: self.id,
            epoch: self.epoch,
            host: format!("host-of-{}", self.id),
            version: "chaos".to_owned(),
            marker: scenario.marker_of(&self.id),
            camera: CameraSummary {
                model: "pal".to_owned(),
                height_m: CAMERA_M,
                height_sigma_m: 0.002,
                tilt_sigma_rad: 0.002,
                elevation_rad: [(-15f64).to_radians(), 20f64.to_radians()],
                frame_rate_hz: scenario.capture.rate_hz,
            },
        }
    }

    /// Raises the next alarm.
    pub fn raise(&mut self, true_time: Timestamp) -> Alarm {
        let alarm = Alarm {
            robot: self.id,
            epoch: self.epoch,
            number: self.next_alarm,
            at: self.clock(true_time),
            kind: AlarmKind::PersonAppeared(TrackId(self.next_alarm)),
        };
        self.next_alarm += 1;
        self.alarms.push(alarm.clone());
        alarm
    }

    /// What late joiners get.
    pub fn kept_alarms(&self) -> &[Alarm] {
        &self.alarms[self.alarms.len().saturating_sub(MAX_KEPT)..]
    }

    /// The answer to a clock probe.
    pub fn answer(&self, true_time: Timestamp, probe: ClockProbe) -> ClockReply {
        let now = self.clock(true_time);
        ClockReply { probe_sent: probe.sent, received: now, replied: now.offset_by_secs(1e-4), epoch: self.epoch }
    }

    /// One frame, of the world as it is at `true_time`.
    pub fn observe(&mut self, state: &State, true_time: Timestamp) -> Observation {
        let sequence = self.sequence;
        self.sequence += 1;
        Observation {
            epoch: self.epoch,
            sequence,
            capture: self.clock(true_time),
            motion: if state.robots[self.index].moving { Motion::Moving } else { Motion::Standing },
            odometry: None,
            stages: Stages::ALL,
            sightings: self.sightings(state),
            tracks: self.tracks(state),
        }
    }

    fn sightings(&mut self, state: &State) -> Vec<PeerSighting> {
        let mut found = Vec::new();
        let me = self.index;
        for other in (0..state.robots.len()).filter(|other| *other != me) {
            let peer = &state.robots[other];
            let (bearing, range_m) = self.sees(state, peer.x_m, peer.y_m);
            let half = (RADIUS_M / range_m).asin();
            let hidden = state.people.iter().any(|p| {
                let (b, d) = self.sees(state, p.x_m, p.y_m);
                d < range_m && wrap(b - bearing).abs() < (HALF_PERSON_M / d).atan() + half
            });
            if hidden {
                continue;
            }
            let (left, right) = (self.noise(EDGE_RAD), self.noise(EDGE_RAD));
            let measured_m = RADIUS_M / (half + 0.5 * (left - right)).sin();
            let slope = range_m * (range_m * range_m - RADIUS_M * RADIUS_M).sqrt() / (2.0 * RADIUS_M);
            found.push(PeerSighting {
                marker: Marker::CYLINDER,
                robot: None,
                bearing: Angle16::from_rad(wrap(bearing + 0.5 * (left + right))),
                bearing_sigma: LogSigma::from_value(EDGE_RAD / 2f64.sqrt()),
                range: Some(SightedRange {
                    range: Millimetres::from_m(measured_m),
                    sigma: LogSigma::from_value(slope * 2f64.sqrt() * EDGE_RAD),
                }),
                heading: None,
                confidence: Fraction8::from_value(0.9),
                features: Vec::new(),
            });
        }
        found.sort_by_key(|sighting| sighting.bearing);
        found
    }

    fn tracks(&mut self, state: &State) -> Vec<TrackObservation> {
        let seen: Vec<(f64, f64)> = state.people.iter().map(|p| self.sees(state, p.x_m, p.y_m)).collect();
        let peers: Vec<(f64, f64)> = (0..state.robots.len())
            .filter(|other| *other != self.index)
            .map(|other| self.sees(state, state.robots[other].x_m, state.robots[other].y_m))
            .collect();
        let mut tracks = Vec::new();
        for (n, person) in state.people.iter().enumerate() {
            let (bearing, range_m) = seen[n];
            let half = (HALF_PERSON_M / range_m).atan();
            let covers =
                |&(b, d): &(f64, f64), half_m: f64| d < range_m && wrap(b - bearing).abs() < (half_m / d).atan() + half;
            let others = seen.iter().enumerate().filter(|(m, _)| *m != n).map(|(_, s)| s);
            if others.clone().any(|s| covers(s, HALF_PERSON_M)) || peers.iter().any(|s| covers(s, RADIUS_M)) {
                self.seen_since[n] = None;
                continue;
            }
            self.seen_since[n].get_or_insert(state.time_s);
            let known = self.tracks[n].filter(|(_, last_s)| state.time_s - last_s < TRACK_KEPT_S);
            let number = known.map_or_else(
                || {
                    self.next_track += 1;
                    self.next_track
                },
                |(number, _)| number,
            );
            self.tracks[n] = Some((number, state.time_s));
            self.sway_m[n] = 0.7 * self.sway_m[n] + self.noise(SWAY_M * (1.0f64 - 0.49).sqrt());
            let measured = bearing + self.sway_m[n] / range_m + self.noise(WHITE_RAD);
            let (bottom, top) = ((-15f64).to_radians(), 20f64.to_radians());
            let low = (-CAMERA_M / range_m).atan() + self.noise(0.005);
            let high = ((person.height_m - CAMERA_M) / range_m).atan() + self.noise(0.005);
            let end = |cut| if cut { ElevationEnd::Cut } else { ElevationEnd::Seen };
            tracks.push(TrackObservation {
                track: TrackId(number),
                state: TrackState::Visible,
                bearing: Angle16::from_rad(wrap(measured)),
                bearing_sigma: LogSigma::from_value(WHITE_RAD.hypot(SWAY_M / range_m)),
                elevation: [Angle16::from_rad(low.max(bottom)), Angle16::from_rad(high.min(top))],
                elevation_sigma: LogSigma::from_value(0.005),
                ends: [end(low < bottom), end(high > top)],
                width: Angle16::from_rad(2.0 * half),
                range: None,
                class: ObjectClass::Unknown,
                confidence: Fraction8::from_value(0.9),
                doubtful: false,
                appearance: None,
            });
        }
        tracks
    }

    /// Bearing and distance of a place on the floor.
    fn sees(&self, state: &State, x_m: f64, y_m: f64) -> (f64, f64) {
        let me = &state.robots[self.index];
        let (dx, dy) = (x_m - me.x_m, y_m - me.y_m);
        (wrap(dy.atan2(dx) - me.heading_rad), dx.hypot(dy).max(RADIUS_M + 0.05))
    }

    fn noise(&mut self, sigma: f64) -> f64 {
        Normal::new(0.0, sigma).map_or(0.0, |normal| normal.sample(&mut self.random))
    }
}
