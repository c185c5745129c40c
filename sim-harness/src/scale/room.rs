//! A room of four robots at the corners of a square, each room's a little another, and four people who walk in circles, as bearings
//! with noise. It shares no formula with the leader: positions are chosen, angles follow.

use protocol::id::{RobotId, TrackId};
use protocol::marker::Marker;
use protocol::message::observation::FeaturePart;
use protocol::message::{
    ElevationEnd, Feature, Motion, ObjectClass, Observation, PeerSighting, Stages, TrackObservation, TrackState,
};
use protocol::quantity::{Angle16, Fraction8, LogSigma};
use protocol::time::Timestamp;
use rand::SeedableRng;
use rand_chacha::ChaCha12Rng;
use rand_distr::{Distribution, Normal};

use super::ROOM;
use crate::world::person::Gait;
use crate::world::robot::RobotState;
use crate::world::{PersonState, State};

/// Radius of a robot's cylinder, metres.
pub const RADIUS_M: f64 = 0.2;
/// Lower and upper end of the cylinder, metres.
pub const CYLINDER_M: [f64; 2] = [0.1, 0.5];
/// Height of the cameras, metres.
pub const CAMERA_M: f64 = 0.6;
/// One sigma of an edge's bearing, radians.
const EDGE_SIGMA_RAD: f64 = 0.001;
/// One sigma of a person's bearing, radians.
const PERSON_SIGMA_RAD: f64 = 0.006;
/// One sigma of elevations, radians.
const ELEVATION_SIGMA_RAD: f64 = 0.003;

/// How far the corners of other rooms are from those of the first at most, metres.
const OFF_M: f64 = 0.35;
/// Walks repeat after so long, seconds: large angles would lose digits.
const DAY_S: f64 = 1e5;

/// One room, as one of its robots sees it.
#[derive(Debug)]
pub struct Room {
    seed: u64,
    number: usize,
    sequence: u32,
    coded: bool,
}

impl Room {
    /// Rooms are numbered from 0; each has its own angles.
    pub fn new(number: usize, seed: u64) -> Self {
        Self { seed, number, sequence: 0, coded: false }
    }

    /// Its robots wear codes: sightings say who is seen.
    #[must_use]
    pub fn with_codes(self) -> Self {
        Self { coded: true, ..self }
    }

    /// Robot 0 to 3: place in the room (metres) and heading (radians).
    pub fn robot(&self, robot: usize) -> [f64; 3] {
        let corner = [[-1.6, -1.4], [1.7, -1.3], [1.5, 1.6], [-1.5, 1.5]][robot % ROOM];
        let k = (self.number * ROOM + robot % ROOM) as f64;
        // No two rooms are alike.
        let off = |turn: f64| if self.number == 0 { 0.0 } else { OFF_M * (turn * k).sin() };
        [corner[0] + off(2.4), corner[1] + off(5.1), 1.3 * k]
    }

    /// Person 0 to 3 after so many seconds: place and height.
    fn person(&self, person: usize, time_s: f64) -> [f64; 3] {
        let phase = 1.6 * person as f64 + self.number as f64 + time_s * (0.4 + 0.1 * person as f64);
        let radius = 0.5 + 0.5 * person as f64 / ROOM as f64;
        [radius * phase.cos() + 0.1, radius * phase.sin() - 0.2, 1.6 + 0.08 * person as f64]
    }

    /// Where everybody is at an instant.
    pub fn truth(&self, at: Timestamp) -> State {
        let time_s = at.as_secs_f64() % DAY_S;
        let robots = (0..ROOM).filter_map(|k| {
            let [x_m, y_m, heading_rad] = self.robot(k);
            let id = RobotId::new(&format!("r{}", self.number * ROOM + k)).ok()?;
            Some(RobotState { id, x_m, y_m, heading_rad, moving: false })
        });
        let people = (0..ROOM).map(|k| {
            let [x_m, y_m, height_m] = self.person(k, time_s);
            let gait = Gait { x_m, y_m, heading_rad: 0.0, phase_rad: 0.0, swing_rad: 0.0 };
            let z_m = height_m / 2.0;
            PersonState { id: format!("p{}", k + 1), x_m, y_m, z_m, height_m, heading_rad: 0.0, speed_mps: 0.0, gait }
        });
        State { time_s, robots: robots.collect(), people: people.collect() }
    }

    /// What a robot sees at an instant.
    pub fn observe(&mut self, robot: usize, capture: Timestamp, epoch: u64) -> Observation {
        let stream = (self.number * ROOM + robot) as u64;
        let mut noise = ChaCha12Rng::seed_from_u64(self.seed ^ (stream << 32) ^ u64::from(self.sequence));
        let mut jitter = |sigma: f64| Normal::new(0.0, sigma).map_or(0.0, |normal| normal.sample(&mut noise));
        let [x, y, heading] = self.robot(robot);
        let time_s = capture.as_secs_f64() % DAY_S;
        let bearing = |to: [f64; 3]| (to[1] - y).atan2(to[0] - x) - heading;
        let mut sightings = Vec::new();
        for other in (0..ROOM).filter(|other| *other != robot % ROOM) {
            let to = self.robot(other);
            let distance = (to[0] - x).hypot(to[1] - y);
            let half = (RADIUS_M / distance).asin();
            let ends = CYLINDER_M.map(|height| ((height - CAMERA_M) / (distance - RADIUS_M)).atan());
            let mut edge = |part, off: f64| Feature {
                part,
                bearing: Angle16::from_rad(bearing(to) + off + jitter(EDGE_SIGMA_RAD)),
                sigma: LogSigma::from_value(EDGE_SIGMA_RAD),
                elevation: Some((
                    ends.map(|end| Angle16::from_rad(end + jitter(ELEVATION_SIGMA_RAD))),
                    LogSigma::from_value(ELEVATION_SIGMA_RAD),
                )),
            };
            let features = vec![edge(FeaturePart::Right, -half), edge(FeaturePart::Left, half)];
            sightings.push(PeerSighting {
                marker: Marker::CYLINDER,
                robot: RobotId::new(&format!("r{}", self.number * ROOM + other)).ok().filter(|_| self.coded),
                bearing: Angle16::from_rad(bearing(to)),
                bearing_sigma: LogSigma::from_value(EDGE_SIGMA_RAD),
                range: None,
                heading: None,
                confidence: Fraction8::from_value(1.0),
                features,
            });
        }
        let mut tracks = Vec::new();
        for person in 0..ROOM {
            let to = self.person(person, time_s);
            let distance = (to[0] - x).hypot(to[1] - y).max(0.4);
            let ends = [0.0, to[2]].map(|height| ((height - CAMERA_M) / distance).atan().clamp(-0.26, 0.35));
            tracks.push(TrackObservation {
                track: TrackId(person as u32),
                state: TrackState::Visible,
                bearing: Angle16::from_rad(bearing(to) + jitter(PERSON_SIGMA_RAD)),
                bearing_sigma: LogSigma::from_value(PERSON_SIGMA_RAD),
                elevation: ends.map(Angle16::from_rad),
                elevation_sigma: LogSigma::from_value(ELEVATION_SIGMA_RAD),
                ends: ends.map(|end| if end > -0.26 && end < 0.35 { ElevationEnd::Seen } else { ElevationEnd::Cut }),
                width: Angle16::from_rad(0.5 / distance),
                range: None,
                class: ObjectClass::Person,
                confidence: Fraction8::from_value(0.95),
                doubtful: false,
                appearance: None,
            });
        }
        let sequence = self.sequence;
        self.sequence = self.sequence.wrapping_add(1);
        Observation {
            epoch,
            sequence,
            capture,
            motion: Motion::Standing,
            odometry: None,
            stages: Stages::ALL,
            sightings,
            tracks,
        }
    }
}
