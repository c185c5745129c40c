//! Robots as geometry and noise among the harness' walking people, in a room of its own for each seed.

use std::f64::consts::PI;

use nalgebra::Vector2;
use protocol::angle::wrap;
use protocol::frames::Pose2;
use protocol::id::{RobotId, TrackId};
use protocol::marker::Marker;
use protocol::message::{
    ElevationEnd, Motion, ObjectClass, Observation, PeerSighting, SightedRange, Stages, TrackObservation, TrackState,
};
use protocol::quantity::{Angle16, Fraction8, LogSigma, Millimetres};
use protocol::time::Timestamp;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use statrs::distribution::{ContinuousCDF, Normal, StudentsT};

use crate::recorded::RecordedError;
use crate::recorded::feed::Recorded;
use crate::scenario::{CameraSpec, CaptureSpec, PeopleSpec, RobotsSpec, RoomSpec, Scenario};
use crate::world::World;

/// Rooms are so wide and so deep, metres.
const SIZE_M: [[f64; 2]; 2] = [[6.5, 9.5], [5.0, 7.0]];
/// Of a robot's axis from the walls, and of its first place.
const MARGIN_M: f64 = 0.4;
const FIRST_MARGIN_M: f64 = 0.8;
/// Between two robots at first.
const APART_M: f64 = 1.2;
const ROBOTS: usize = 3;
const PEOPLE: usize = 3;
const RATE_HZ: f64 = 10.0;
const RADIUS_M: f64 = 0.2;
const CAMERA_M: f64 = 0.6;
/// Of an edge of a fellow robot, white; of a pair's bearing and width as long as both stand, degrees.
const EDGE_DEG: f64 = 0.05;
const PAIR_DEG: f64 = 0.015;
/// What agents say of a person's axis: metres aside, and degrees.
const ASIDE_M: f64 = 0.025;
const ANGLE_DEG: f64 = 0.1;
/// How wrong it is, as a part of what they say, and for how long, seconds: of somebody who walks and who stands. Measured on the bearings
/// of agents in rendered pictures (ten teams, 47 174 bearings); these are spread like Student's t of four degrees of freedom.
const WRONG: [[f64; 2]; 2] = [[0.93, 0.36], [1.0, 4.0]];
const FREEDOM: f64 = 4.0;
/// Who is slower stands, m/s.
const STANDS_MPS: f64 = 0.1;
/// Robots drive at this speed.
const SPEED_MPS: f64 = 0.4;
/// A person is seen from here on, and where no robot's axis is within this of the line of sight, metres.
const LEAST_RANGE_M: f64 = 0.5;
const HIDES_M: f64 = 0.3;
/// People walk for so long, and each stops once or more for so long, seconds.
pub const DURATION_S: f64 = 75.0;
const STOP_S: f64 = 19.0;

#[derive(Debug, Clone)]
struct Robot {
    id: RobotId,
    pose: Pose2,
    /// Where from, where to, from when, until when.
    way: Option<(Pose2, Pose2, f64, f64)>,
    frame: u32,
    phase_s: f64,
    /// Errors of people's bearings, as normal draws.
    wrong: [f64; PEOPLE],
    /// Errors of bearing and width of each other robot while both stand.
    pair: [[f64; 2]; ROBOTS],
}

/// The room.
#[derive(Debug)]
pub struct Room {
    rng: ChaCha8Rng,
    size_m: [f64; 2],
    robots: Vec<Robot>,
    world: World,
}

impl Room {
    /// The room of a seed.
    ///
    /// # Errors
    /// People who find no place to walk.
    pub fn new(seed: u64) -> Result<Self, RecordedError> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let [width, depth] = SIZE_M.map(|[low, high]| rng.random_range(low..high));
        let mut place =
            |x: [f64; 2], y: [f64; 2]| Vector2::new(rng.random_range(x[0]..x[1]), rng.random_range(y[0]..y[1]));
        // Robots in one half of the room, people everywhere.
        let mut places: Vec<Vector2<f64>> = Vec::new();
        while places.len() < ROBOTS {
            let p = place([FIRST_MARGIN_M, 0.5 * width], [FIRST_MARGIN_M, depth - FIRST_MARGIN_M]);
            if places.iter().all(|q| (q - p).norm() > APART_M) {
                places.push(p);
            }
        }
        let names = ["r1", "r2", "r3"];
        let robots = places
            .iter()
            .zip(names)
            .filter_map(|(p, name)| {
                Some(Robot {
                    id: RobotId::new(name).ok()?,
                    pose: Pose2::new(p.x, p.y, rng.random_range(-PI..PI)),
                    way: None,
                    frame: 0,
                    phase_s: rng.random_range(0.0..1.0 / RATE_HZ),
                    wrong: [0.0; PEOPLE],
                    pair: [[0.0; 2]; ROBOTS],
                })
            })
            .collect();
        let mut room = Self { rng, size_m: [width, depth], robots, world: world([width, depth], &places, seed)? };
        (0..ROBOTS).for_each(|r| room.draw_pairs(r));
        Ok(room)
    }

    /// Robots as the leader hears of them.
    pub fn recorded(&self) -> Result<Vec<Recorded>, RecordedError> {
        let marker = Marker::Cylinder { radius_m: RADIUS_M, height_m: [0.1, 0.5], look: None };
        let robot = |r: &Robot| Recorded {
            id: r.id,
            fixed: None,
            height_m: CAMERA_M,
            tilt_sigma_rad: 0.002,
            marker: marker.clone(),
            rate_hz: RATE_HZ,
        };
        Ok(self.robots.iter().map(robot).collect())
    }

    /// Where robots may be: x and y from … to, metres.
    pub fn area_m(&self) -> [[f64; 2]; 2] {
        self.size_m.map(|size| [MARGIN_M, size - MARGIN_M])
    }

    /// Where a robot stands.
    pub fn pose(&self, robot: usize) -> Pose2 {
        self.robots[robot].pose
    }

    /// The world counts from the middle of the room.
    fn centre(&self) -> Vector2<f64> {
        0.5 * Vector2::from(self.size_m)
    }

    /// Where people are.
    pub fn people(&self, time_s: f64) -> Vec<Vector2<f64>> {
        let centre = self.centre();
        self.world.at(time_s).people.iter().map(|p| Vector2::new(p.x_m, p.y_m) + centre).collect()
    }

    /// The robot drives by `step` in its body frame; when it will stand again.
    pub fn drive(&mut self, robot: RobotId, step: Pose2, time_s: f64) -> Option<f64> {
        let r = self.robots.iter().position(|r| r.id == robot)?;
        let from = self.robots[r].pose;
        let end_s = time_s + step.position().norm() / SPEED_MPS + 1.0;
        self.robots[r].way = Some((from, from * step, time_s, end_s));
        Some(end_s)
    }

    /// The next picture of any robot: whose, when, and what is seen on it.
    pub fn next_frame(&mut self) -> (usize, f64, Observation) {
        let due = |r: &Robot| r.phase_s + f64::from(r.frame) / RATE_HZ;
        let first = (0..ROBOTS).min_by(|a, b| due(&self.robots[*a]).total_cmp(&due(&self.robots[*b])));
        let k = first.unwrap_or_default();
        let time_s = due(&self.robots[k]);
        for r in 0..ROBOTS {
            self.go(r, time_s);
        }
        let moving = self.robots[k].way.is_some();
        let observation = Observation {
            epoch: 1,
            sequence: self.robots[k].frame,
            capture: Timestamp::from_secs_f64(1000.0 + time_s),
            motion: if moving { Motion::Moving } else { Motion::Standing },
            odometry: None,
            stages: Stages::ALL,
            sightings: self.sightings(k),
            tracks: if moving { Vec::new() } else { self.tracks(k, time_s) },
        };
        self.robots[k].frame += 1;
        (k, time_s, observation)
    }

    fn go(&mut self, r: usize, time_s: f64) {
        let Some((from, to, from_s, to_s)) = self.robots[r].way else { return };
        let share = ((time_s - from_s) / (to_s - from_s)).clamp(0.0, 1.0);
        let share = share * share * (3.0 - 2.0 * share);
        let along = from.position() + share * (to.position() - from.position());
        let turn = share * wrap(to.heading_rad - from.heading_rad);
        self.robots[r].pose = Pose2::new(along.x, along.y, wrap(from.heading_rad + turn));
        if time_s >= to_s {
            self.robots[r].way = None;
            self.draw_pairs(r);
        }
    }

    /// A new place has new errors.
    fn draw_pairs(&mut self, r: usize) {
        for other in 0..ROBOTS {
            for part in 0..2 {
                self.robots[r].pair[other][part] = self.normal(PAIR_DEG.to_radians());
                self.robots[other].pair[r][part] = self.normal(PAIR_DEG.to_radians());
            }
        }
    }

    fn normal(&mut self, sigma: f64) -> f64 {
        let unit: f64 = StandardNormal.sample(&mut self.rng);
        sigma * unit
    }

    fn sightings(&mut self, k: usize) -> Vec<PeerSighting> {
        let me = self.robots[k].pose;
        let edge = EDGE_DEG.to_radians();
        let mut seen = Vec::new();
        for other in (0..ROBOTS).filter(|o| *o != k) {
            let to = self.robots[other].pose.position();
            let range_m = (to - me.position()).norm();
            let [shift, wider] = self.robots[k].pair[other];
            let (left, right) = (self.normal(edge), self.normal(edge));
            let width = 2.0 * (RADIUS_M / range_m).asin() + left - right + wider;
            let range_m = RADIUS_M / (0.5 * width).sin();
            let range_sigma_m =
                range_m * (range_m * range_m - RADIUS_M * RADIUS_M).sqrt() / (2.0 * RADIUS_M) * 2f64.sqrt();
            seen.push(PeerSighting {
                marker: Marker::CYLINDER,
                robot: None,
                bearing: Angle16::from_rad(me.bearing_to(to) + 0.5 * (left + right) + shift),
                bearing_sigma: LogSigma::from_value(edge / 2f64.sqrt()),
                range: Some(SightedRange {
                    range: Millimetres::from_m(range_m),
                    sigma: LogSigma::from_value(range_sigma_m * edge),
                }),
                heading: None,
                confidence: Fraction8::from_value(0.9),
                features: Vec::new(),
            });
        }
        seen.sort_by_key(|s| s.bearing);
        seen
    }

    /// Whether another robot stands before a place.
    fn is_hidden(&self, k: usize, place: Vector2<f64>) -> bool {
        let eye = self.robots[k].pose.position();
        let way = place - eye;
        (0..ROBOTS).filter(|o| *o != k).any(|o| {
            let to = self.robots[o].pose.position() - eye;
            let along = to.dot(&way) / way.norm_squared();
            (0.0..1.0).contains(&along) && (to - along * way).norm() < HIDES_M
        })
    }

    fn tracks(&mut self, k: usize, time_s: f64) -> Vec<TrackObservation> {
        let me = self.robots[k].pose;
        let mut seen = Vec::new();
        let centre = self.centre();
        for (p, person) in self.world.at(time_s).people.iter().enumerate() {
            let to = Vector2::new(person.x_m, person.y_m) + centre;
            let range_m = (to - me.position()).norm();
            let [part, lasts_s] = WRONG[usize::from(person.speed_mps < STANDS_MPS)];
            let keep = (-1.0 / RATE_HZ / lasts_s).exp();
            let new = self.normal((1.0 - keep * keep).sqrt());
            let wrong = keep * self.robots[k].wrong[p] + new;
            self.robots[k].wrong[p] = wrong;
            if range_m < LEAST_RANGE_M || self.is_hidden(k, to) {
                continue;
            }
            let sigma = ANGLE_DEG.to_radians().hypot(ASIDE_M / range_m);
            let bearing = me.bearing_to(to) + sigma * part * heavy_tailed(wrong);
            let elevation = [-CAMERA_M, person.height_m - CAMERA_M].map(|h| (h / range_m).atan());
            seen.push(TrackObservation {
                track: TrackId(p as u32),
                state: TrackState::Visible,
                bearing: Angle16::from_rad(bearing),
                bearing_sigma: LogSigma::from_value(sigma),
                elevation: elevation.map(Angle16::from_rad),
                elevation_sigma: LogSigma::from_value(0.005),
                ends: [ElevationEnd::Seen, ElevationEnd::Seen],
                width: Angle16::from_rad(2.0 * (0.23 / range_m).atan()),
                range: None,
                class: ObjectClass::Person,
                confidence: Fraction8::from_value(0.9),
                doubtful: false,
                appearance: None,
            });
        }
        seen
    }
}

/// A normal draw of variance one as one with heavy tails of the same variance.
fn heavy_tailed(normal: f64) -> f64 {
    let share = Normal::standard().cdf(normal);
    StudentsT::new(0.0, ((FREEDOM - 2.0) / FREEDOM).sqrt(), FREEDOM).map_or(normal, |t| t.inverse_cdf(share))
}

/// The people of a room with robots at these places.
fn world(size_m: [f64; 2], robots: &[Vector2<f64>], seed: u64) -> Result<World, RecordedError> {
    let poses = robots.iter().map(|p| [p.x - 0.5 * size_m[0], p.y - 0.5 * size_m[1], 0.0]).collect();
    let scenario = Scenario {
        name: "guidance".to_owned(),
        duration_s: DURATION_S,
        seed,
        room: RoomSpec { size_m: [size_m[0], size_m[1], 2.6], furniture: Vec::new(), ..RoomSpec::default() },
        robots: RobotsSpec { count: robots.len(), poses, ..RobotsSpec::default() },
        people: PeopleSpec { count: PEOPLE, camouflaged: 0, stop_s: STOP_S, ..PeopleSpec::default() },
        capture: CaptureSpec::default(),
        camera: CameraSpec::default(),
    };
    World::new(&scenario, seed).map_err(|e| RecordedError::Message(format!("the room of seed {seed}: {e}")))
}
