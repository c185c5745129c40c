//! A sequence of problems through the whole live pipeline.
//!
//! Each line becomes one observation a robot. What an agent would know by itself is made up from the measurements: track
//! numbers (by the targets' names, or by following bearings from line to line), and whether a robot stands (by odometry,
//! or because everything it sees has shifted while others saw only it shift).

use std::collections::BTreeMap;

use protocol::angle::wrap;
use protocol::frames::Pose2;
use protocol::id::{LeaderId, RobotId, TrackId};
use protocol::marker::Marker;
use protocol::message::observation::Odometry;
use protocol::message::{
    Announcement, CameraSummary, ElevationEnd, Motion, ObjectClass, Observation, PeerSighting, SightedRange, Stages,
    TrackObservation, TrackState,
};
use protocol::quantity::{Angle16, Fraction8, LogSigma, Millimetres};
use protocol::time::Timestamp;

use super::SolveError;
use super::input::{Problem, RawLandmark, RawOdometry, RawProblem, RawRobot, Sighting};
use super::start::{axis, radius_m};
use crate::leader::{Anchor, Input, Leader, LeaderCoreConfig, Output};
use crate::team_map::json::MapJson;

/// A bearing belongs to the track of the line before when it is this near, in its sigmas and at least (rad).
const TRACK_GATE: (f64, f64) = (6.0, 0.12);
/// A sighting has shifted when it is this many sigmas from the one before.
const SHIFT_SIGMAS: f64 = 6.0;
/// Odometry below stands still: m, rad.
const STILL: (f64, f64) = (1e-4, 1e-4);
/// Sigmas of odometry without a covariance, of what was driven and at least.
const ODOMETRY_SIGMA: (f64, f64) = (0.05, 0.005);

/// The pipeline, fed line by line.
#[derive(Debug)]
pub struct Sequence {
    leader: Option<Leader>,
    robots: Vec<RawRobot>,
    landmarks: Vec<RawLandmark>,
    anchor: Option<String>,
    sequence: u32,
    line: usize,
    tracks: Vec<Tracks>,
    before: Vec<Vec<Sighting>>,
}

#[derive(Debug, Clone, Default)]
struct Tracks {
    by_name: BTreeMap<String, u32>,
    /// Last bearing and number of unnamed tracks.
    loose: Vec<(f64, u32)>,
    next: u32,
}

impl Default for Sequence {
    fn default() -> Self {
        Self::new()
    }
}

impl Sequence {
    /// Nothing is known.
    pub fn new() -> Self {
        Self {
            leader: None,
            robots: Vec::new(),
            landmarks: Vec::new(),
            anchor: None,
            sequence: 0,
            line: 0,
            tracks: Vec::new(),
            before: Vec::new(),
        }
    }

    /// Works on one line; the map after it.
    pub fn line(&mut self, text: &str) -> Result<MapJson, SolveError> {
        self.line += 1;
        let line = self.line;
        self.work(text).map_err(|source| SolveError::Line { line, source: Box::new(source) })
    }

    fn work(&mut self, text: &str) -> Result<MapJson, SolveError> {
        let mut raw: RawProblem = serde_json::from_str(text).map_err(SolveError::Json)?;
        let time_s =
            raw.time_s.filter(|t| t.is_finite() && (0.0..1e10).contains(t)).ok_or_else(|| SolveError::Value {
                place: "time_s".into(),
                value: raw.time_s.map_or_else(|| "nothing".into(), |t| t.to_string()),
                right: "seconds from zero on",
            })?;
        for (now, kept) in [(&mut raw.robots, &mut self.robots)] {
            if now.is_empty() { now.clone_from(kept) } else { kept.clone_from(now) }
        }
        if raw.landmarks.is_empty() {
            raw.landmarks.clone_from(&self.landmarks);
        } else {
            self.landmarks.clone_from(&raw.landmarks);
        }
        if raw.anchor.is_none() {
            raw.anchor.clone_from(&self.anchor);
        } else {
            self.anchor.clone_from(&raw.anchor);
        }
        let problem = Problem::check(&raw)?;
        if let Some(robot) = problem.robots.iter().find(|r| r.moved.is_some()) {
            return Err(SolveError::Value {
                place: format!("robots[{}].moved_from", robot.id),
                value: "given".into(),
                right: "`odometry` in the lines of a sequence",
            });
        }
        let ids = names(&problem)?;
        let at = Timestamp::from_secs_f64(1.0 + time_s);
        self.tracks.resize(problem.robots.len(), Tracks::default());
        self.before.resize(problem.robots.len(), Vec::new());
        let leader = match &mut self.leader {
            Some(leader) => leader,
            None => self.leader.insert(new_leader(&problem, &ids, self.anchor.is_some(), at)),
        };
        let moving = moving_robots(&problem, &self.before, &raw.odometry);
        let mut outputs = Vec::new();
        for (robot, id) in ids.iter().enumerate() {
            let sightings: Vec<&Sighting> = problem.sightings.iter().filter(|s| s.observer == robot).collect();
            let odometry = raw.odometry.iter().find(|o| o.robot == id.as_str());
            let speaks =
                !sightings.is_empty() || problem.bearings.iter().any(|b| b.observer == robot) || odometry.is_some();
            if !speaks {
                continue;
            }
            let observation = Observation {
                epoch: 1,
                sequence: self.sequence,
                capture: at,
                motion: if moving[robot] { Motion::Moving } else { Motion::Standing },
                odometry: odometry.map(odometry_of),
                stages: Stages::ALL,
                sightings: sightings.iter().filter_map(|s| sighting_of(&problem, s, &ids)).collect(),
                tracks: if moving[robot] { Vec::new() } else { tracks_of(&problem, robot, &mut self.tracks[robot]) },
            };
            leader.handle(at, Input::Observation(*id, observation), &mut outputs);
            if !sightings.is_empty() {
                self.before[robot] = sightings.into_iter().cloned().collect();
            }
        }
        self.sequence += 1;
        let mut json = outputs
            .iter()
            .rev()
            .find_map(|o| match o {
                Output::Map(map) => Some(MapJson::from(map)),
                _ => None,
            })
            .unwrap_or_else(|| empty_map(time_s));
        json.time_s = time_s;
        Ok(json)
    }
}

fn names(problem: &Problem) -> Result<Vec<RobotId>, SolveError> {
    let id = |(k, robot): (usize, &super::input::Robot)| {
        RobotId::new(&robot.id).map_err(|e| SolveError::Value {
            place: format!("robots[{k}].id"),
            value: e.to_string(),
            right: "1 to 16 of a-z, 0-9, '_' and '-'",
        })
    };
    problem.robots.iter().enumerate().map(id).collect()
}

fn new_leader(problem: &Problem, ids: &[RobotId], anchored: bool, at: Timestamp) -> Leader {
    // The name is a constant of the right form.
    let name = LeaderId::new("solve").or_else(|_| LeaderId::new("l"));
    let Ok(name) = name else { unreachable!("a constant name is a name") };
    let mut config = LeaderCoreConfig::new(name);
    config.clock.trusted = true;
    // The sigmas of a file are taken at their word.
    config.calibration.floor_fraction = 0.0;
    config.calibration.bearing_floor_rad = 1e-5;
    config.calibration.width_floor_rad = 1e-5;
    config.calibration.common_width_rad = 1e-6;
    config.targets.axis_sway_m = 0.0;
    config.targets.correlation_s = 0.0;
    let posed = problem.robots.iter().zip(ids).filter_map(|(r, id)| Some((r.pose?, *id)));
    config.fixed = posed.map(|(team_from_body, robot)| Anchor { robot, team_from_body }).collect();
    if config.fixed.is_empty() && anchored {
        config.anchor = Some(Anchor { robot: ids[problem.anchor], team_from_body: Pose2::IDENTITY });
    }
    let mut leader = Leader::new(config);
    let mut outputs = Vec::new();
    for (robot, id) in problem.robots.iter().zip(ids) {
        let announcement = Announcement {
            robot: *id,
            epoch: 1,
            host: String::new(),
            version: String::new(),
            marker: robot.marker.clone(),
            camera: CameraSummary {
                model: "file".into(),
                height_m: robot.camera_height_m,
                height_sigma_m: 0.0,
                tilt_sigma_rad: 0.0,
                elevation_rad: [-1.5, 1.5],
                frame_rate_hz: 10.0,
            },
        };
        leader.handle(at, Input::Announcement(announcement), &mut outputs);
    }
    leader
}

/// Who moves: by odometry where there is any; else the fewest robots that explain which pairs have shifted.
fn moving_robots(problem: &Problem, before: &[Vec<Sighting>], odometry: &[RawOdometry]) -> Vec<bool> {
    let n = problem.robots.len();
    let mut moving = vec![false; n];
    let mut told = vec![false; n];
    for o in odometry {
        if let Some(r) = problem.robots.iter().position(|r| r.id == o.robot) {
            told[r] = true;
            moving[r] = o.dx_m.hypot(o.dy_m) > STILL.0 || o.dheading_deg.to_radians().abs() > STILL.1;
        }
    }
    let mut shifted: Vec<(usize, Option<usize>)> = Vec::new();
    for s in &problem.sightings {
        if before[s.observer].is_empty() {
            continue;
        }
        let Some(now) = axis(s, s.peer.and_then(|p| radius_m(problem, p))) else { continue };
        let stays = before[s.observer].iter().filter(|b| b.peer == s.peer).any(|b| {
            axis(b, b.peer.and_then(|p| radius_m(problem, p))).is_some_and(|old| {
                let turned = wrap(now.bearing.0 - old.bearing.0).abs();
                let ranged = match (now.range, old.range) {
                    (Some((a, sa)), Some((b, sb))) => (a - b).abs() < SHIFT_SIGMAS * sa.hypot(sb),
                    _ => true,
                };
                turned < SHIFT_SIGMAS * now.bearing.1.hypot(old.bearing.1) && ranged
            })
        });
        if !stays {
            shifted.push((s.observer, s.peer));
        }
    }
    // Greedy cover: the robot that explains most, again and again.
    loop {
        shifted.retain(|(i, j)| !moving[*i] && !j.is_some_and(|j| moving[j]));
        let count = |r: usize| shifted.iter().filter(|(i, j)| *i == r || *j == Some(r)).count();
        let Some(most) = (0..n).filter(|&r| !told[r]).max_by_key(|&r| count(r)).filter(|&r| count(r) > 0) else {
            return moving;
        };
        moving[most] = true;
    }
}

fn sighting_of(problem: &Problem, s: &Sighting, ids: &[RobotId]) -> Option<PeerSighting> {
    let radius = match s.peer {
        Some(peer) => radius_m(problem, peer),
        None => (0..problem.robots.len()).find_map(|r| radius_m(problem, r)),
    };
    let axis = axis(s, radius)?;
    Some(PeerSighting {
        marker: Marker::CYLINDER,
        robot: s.peer.map(|p| ids[p]),
        bearing: Angle16::from_rad(axis.bearing.0),
        bearing_sigma: LogSigma::from_value(axis.bearing.1.hypot(0.3 * Angle16::STEP_RAD)),
        range: axis.range.map(|(range, sigma)| SightedRange {
            range: Millimetres::from_m(range),
            sigma: LogSigma::from_value(sigma.hypot(3e-4)),
        }),
        heading: None,
        confidence: Fraction8::from_value(1.0),
        features: Vec::new(),
    })
}

fn odometry_of(raw: &RawOdometry) -> Odometry {
    let sigma = |size: f64| (ODOMETRY_SIGMA.0 * size.abs()).max(ODOMETRY_SIGMA.1).powi(2);
    let dheading_rad = raw.dheading_deg.to_radians();
    let c = raw.covariance.unwrap_or([
        [sigma(raw.dx_m), 0.0, 0.0],
        [0.0, sigma(raw.dy_m), 0.0],
        [0.0, 0.0, sigma(dheading_rad)],
    ]);
    Odometry {
        dx_m: raw.dx_m as f32,
        dy_m: raw.dy_m as f32,
        dheading_rad: dheading_rad as f32,
        covariance: [c[0][0], c[0][1], c[0][2], c[1][1], c[1][2], c[2][2]].map(|v| v as f32),
    }
}

fn tracks_of(problem: &Problem, robot: usize, tracks: &mut Tracks) -> Vec<TrackObservation> {
    let mut found = Vec::new();
    let mut loose = Vec::new();
    for b in problem.bearings.iter().filter(|b| b.observer == robot) {
        let number = match b.target {
            Some(t) => {
                let next = &mut tracks.next;
                *tracks.by_name.entry(problem.targets[t].clone()).or_insert_with(|| {
                    *next += 1;
                    *next
                })
            }
            None => {
                let gate = (TRACK_GATE.0 * b.bearing.1).max(TRACK_GATE.1);
                let near = (0..tracks.loose.len())
                    .map(|k| (wrap(tracks.loose[k].0 - b.bearing.0).abs(), k))
                    .filter(|(d, _)| *d < gate)
                    .min_by(|x, y| x.0.total_cmp(&y.0));
                let number = near.map_or_else(
                    || {
                        tracks.next += 1;
                        tracks.next
                    },
                    |(_, k)| tracks.loose.swap_remove(k).1,
                );
                loose.push((b.bearing.0, number));
                number
            }
        };
        let elevation = b.elevation.unwrap_or((0.0, 1.0));
        // One elevation is of a point, not of the ends of a body.
        found.push(TrackObservation {
            track: TrackId(number),
            state: TrackState::Visible,
            bearing: Angle16::from_rad(b.bearing.0),
            bearing_sigma: LogSigma::from_value(b.bearing.1.hypot(0.3 * Angle16::STEP_RAD)),
            elevation: [Angle16::from_rad(elevation.0); 2],
            elevation_sigma: LogSigma::from_value(elevation.1),
            ends: [ElevationEnd::Hidden, ElevationEnd::Hidden],
            width: Angle16(0),
            range: None,
            class: ObjectClass::Unknown,
            confidence: Fraction8::from_value(1.0),
            doubtful: false,
            appearance: None,
        });
    }
    tracks.loose = loose;
    found
}

fn empty_map(time_s: f64) -> MapJson {
    MapJson {
        time_s,
        leader: "solve".into(),
        term: 1,
        sequence: 0,
        status: "waiting".into(),
        explanation: "no measurement in this line".into(),
        gauge: None,
        oldest_contribution_s: 0.0,
        robots: Vec::new(),
        targets: Vec::new(),
        alarms: Vec::new(),
        edges: Vec::new(),
    }
}
