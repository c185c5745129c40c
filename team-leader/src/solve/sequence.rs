//! A sequence of problems through the whole live pipeline.
//!
//! Each line becomes one observation a robot. What an agent would know by itself is made up from the measurements: track
//! numbers (by the targets' names, or by following bearings from line to line), and whether a robot stands (by odometry,
//! or because everything it sees has shifted while others saw only it shift).
//!
//! A robot that is seen is a bearing and a range to the pipeline, as agents send it. Features become that by the closed forms of
//! the peer's marker; a heading that a sighting gives, or that bars and plates show, is not used. Nor are the places of
//! landmarks. What is not used is said ([`Sequence::take_notices`]).

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Matrix3, Vector2};
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

use super::input::{Problem, RawLandmark, RawOdometry, RawProblem, RawRobot, Robot, Sighting};
use super::start::{Axis, MEAN_SIGMA_RAD, axis, seen};
use super::{SolveError, fitting};
use crate::leader::{Anchor, Input, Leader, LeaderCoreConfig, Output};
use crate::team_map::json::MapJson;

/// A bearing belongs to the track of the line before when it is this near, in its sigmas and at least (rad).
const TRACK_GATE: (f64, f64) = (6.0, 0.12);
/// A sighting has shifted when it is this many sigmas from the one before.
const SHIFT_SIGMAS: f64 = 6.0;
/// Odometry below stands still: m, rad.
const STILL: (f64, f64) = (1e-4, 1e-4);
/// A bearing's own `time_s` is that of its line to this, seconds.
const SAME_TIME_S: f64 = 1e-6;
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
    /// Robots as they were announced.
    announced: Vec<Robot>,
    /// Time of the last line, and of the last one in which each robot measured.
    last_s: Option<f64>,
    spoke_s: Vec<Option<f64>>,
    notices: Vec<String>,
    /// Notices that would come again with every line.
    said: BTreeSet<String>,
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
            announced: Vec::new(),
            last_s: None,
            spoke_s: Vec::new(),
            notices: Vec::new(),
            said: BTreeSet::new(),
        }
    }

    /// An empty line: it counts, so that errors name the right one.
    pub fn skip_line(&mut self) {
        self.line += 1;
    }

    /// What the lines since the last call had that was not used, each with its line.
    pub fn take_notices(&mut self) -> Vec<String> {
        std::mem::take(&mut self.notices)
    }

    /// Works on one line; the map after it.
    pub fn line(&mut self, text: &str) -> Result<MapJson, SolveError> {
        self.line += 1;
        let line = self.line;
        self.work(text).map_err(|source| SolveError::Line { line, source: Box::new(source) })
    }

    fn work(&mut self, text: &str) -> Result<MapJson, SolveError> {
        let mut raw: RawProblem = serde_json::from_str(text).map_err(SolveError::Json)?;
        let time_s = self.time_of(&raw)?;
        self.keep(&mut raw)?;
        let mut problem = Problem::check(&raw)?;
        self.refuse_what_has_no_place(&raw, &problem, time_s)?;
        let ids = names(&problem)?;
        fitting::prepare(&mut problem).iter().for_each(|text| self.tell(text));
        self.tell_of_vague_sightings(&raw, &problem);
        let at = Timestamp::from_secs_f64(1.0 + time_s);
        let n = problem.robots.len();
        self.tracks.resize(n, Tracks::default());
        self.before.resize(n, Vec::new());
        self.spoke_s.resize(n, None);
        let mut outputs = Vec::new();
        let mut leader = match self.leader.take() {
            Some(leader) => leader,
            None => new_leader(&problem, &ids, self.anchor.is_some()),
        };
        self.announce(&problem, &ids, &mut leader, at, &mut outputs);
        let moving = moving_robots(&problem, &self.before, &raw.odometry);
        for (robot, id) in ids.iter().enumerate() {
            let sightings: Vec<&Sighting> = problem.sightings.iter().filter(|s| s.observer == robot).collect();
            let odometry = raw.odometry.iter().find(|o| o.robot == id.as_str());
            if !speaks(&raw, &problem, robot) {
                continue;
            }
            self.spoke_s[robot] = Some(time_s);
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
        self.leader = Some(leader);
        for output in &outputs {
            if let Output::Notice(text) = output {
                self.tell(text);
            }
        }
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

    /// The same is told once.
    fn tell(&mut self, text: &str) {
        if self.said.insert(text.to_owned()) {
            self.notices.push(format!("line {}: {text}", self.line));
        }
    }

    /// The line's time: there, possible, and not before that of the line before.
    fn time_of(&mut self, raw: &RawProblem) -> Result<f64, SolveError> {
        let wrong =
            |value: String, right: String| SolveError::Value { place: "time_s".into(), value, right: right.into() };
        let Some(time_s) = raw.time_s else { return Err(wrong("nothing".into(), "seconds from zero on".into())) };
        if !(time_s.is_finite() && (0.0..1e10).contains(&time_s)) {
            return Err(wrong(time_s.to_string(), "seconds from zero on".into()));
        }
        if let Some(last_s) = self.last_s.filter(|last_s| time_s < *last_s) {
            return Err(wrong(time_s.to_string(), format!("{last_s} (the time of the line before) or later")));
        }
        self.last_s = Some(time_s);
        Ok(time_s)
    }

    /// Robots, landmarks and anchor of earlier lines stand until a line gives others: robots one by one.
    fn keep(&mut self, raw: &mut RawProblem) -> Result<(), SolveError> {
        for (k, robot) in raw.robots.iter().enumerate() {
            if raw.robots[..k].iter().any(|other| other.id == robot.id) {
                return Err(SolveError::Twice { what: "robot", id: robot.id.clone() });
            }
            match self.robots.iter_mut().find(|kept| kept.id == robot.id) {
                Some(kept) => {
                    // A key that a later line leaves out stays.
                    let mut now = robot.clone();
                    now.marker = now.marker.or_else(|| kept.marker.take());
                    now.camera_height_m = now.camera_height_m.or(kept.camera_height_m);
                    now.pose = now.pose.or(kept.pose);
                    *kept = now;
                }
                None => self.robots.push(robot.clone()),
            }
        }
        raw.robots.clone_from(&self.robots);
        if raw.landmarks.is_empty() {
            raw.landmarks.clone_from(&self.landmarks);
        } else {
            self.landmarks.clone_from(&raw.landmarks);
        }
        if let Some(anchor) = raw.anchor.as_ref().filter(|_| self.leader.is_some())
            && self.anchor.as_ref() != Some(anchor)
        {
            let first = self.anchor.as_ref().map_or_else(|| "nothing".to_owned(), |first| format!("{first:?}"));
            return Err(SolveError::Value {
                place: "anchor".into(),
                value: format!("{anchor:?}"),
                right: format!("{first}, as in the first line: the frame is fixed there").into(),
            });
        }
        if raw.anchor.is_some() {
            self.anchor.clone_from(&raw.anchor);
        } else {
            raw.anchor.clone_from(&self.anchor);
        }
        Ok(())
    }

    /// What only a single problem may have, odometry that cannot be, and a second measurement of one instant.
    fn refuse_what_has_no_place(&self, raw: &RawProblem, problem: &Problem, time_s: f64) -> Result<(), SolveError> {
        let wrong = |place: String, value: String, right: &str| {
            Err(SolveError::Value { place, value, right: right.to_owned().into() })
        };
        for robot in &raw.robots {
            let place = |key: &str| format!("robots[{}].{key}", robot.id);
            if robot.moved_from.is_some() {
                return wrong(place("moved_from"), "given".into(), "`odometry` in the lines of a sequence");
            }
            let shared = "nothing (only one problem solves for it; a sequence finds such errors by itself)";
            if let Some(sigma) = robot.bearing_bias_sigma_deg {
                return wrong(place("bearing_bias_sigma_deg"), sigma.to_string(), shared);
            }
            if let Some(sigma) = robot.time_offset_sigma_s {
                return wrong(place("time_offset_sigma_s"), sigma.to_string(), shared);
            }
        }
        let any_held = self.announced.iter().any(|robot| robot.pose.is_some());
        for (k, robot) in problem.robots.iter().enumerate() {
            let right = match self.announced.get(k) {
                Some(before) if before.pose != robot.pose => "the pose that the robot had in the lines before, or none",
                None if robot.pose.is_some() && !self.announced.is_empty() && !any_held => {
                    "nothing: no robot of the first line has a pose, so the frame is that of a robot"
                }
                _ => continue,
            };
            return wrong(format!("robots[{}].pose", robot.id), "new in this line".into(), right);
        }
        for (k, bearing) in raw.bearings.iter().enumerate() {
            if let Some(own_s) = bearing.time_s.filter(|own_s| (own_s - time_s).abs() > SAME_TIME_S) {
                let right = format!("nothing, or the line's time {time_s}");
                return wrong(format!("bearings[{k}].time_s"), own_s.to_string(), &right);
            }
        }
        for (k, odometry) in raw.odometry.iter().enumerate() {
            let place = |key: &str| format!("odometry[{k}].{key}");
            if !problem.robots.iter().any(|robot| robot.id == odometry.robot) {
                return Err(SolveError::UnknownRobot { place: place("robot"), id: odometry.robot.clone() });
            }
            if raw.odometry[..k].iter().any(|other| other.robot == odometry.robot) {
                return Err(SolveError::Twice { what: "odometry of robot", id: odometry.robot.clone() });
            }
            for (key, value) in
                [("dx_m", odometry.dx_m), ("dy_m", odometry.dy_m), ("dheading_deg", odometry.dheading_deg)]
            {
                if !value.is_finite() || value.abs() > 1e6 {
                    return wrong(place(key), value.to_string(), "a finite number, the motion since the line before");
                }
            }
            if let Some(rows) = odometry.covariance.filter(|rows| !is_covariance(rows)) {
                let right = "a symmetric matrix of m and rad without a negative variance";
                return wrong(place("covariance"), format!("{rows:?}"), right);
            }
        }
        for (robot, spoke_s) in self.spoke_s.iter().enumerate() {
            if *spoke_s == Some(time_s) && speaks(raw, problem, robot) {
                let right = format!(
                    "more than that: {} has measured at this time in a line before, and a robot's instant is one line",
                    problem.robots[robot].id
                );
                return wrong("time_s".into(), time_s.to_string(), &right);
            }
        }
        Ok(())
    }

    /// Says what of the sightings and landmarks is not used, or hardly.
    fn tell_of_vague_sightings(&mut self, raw: &RawProblem, problem: &Problem) {
        if raw.sightings.iter().any(|s| s.heading_deg.is_some()) {
            self.tell("`heading_deg` of sightings is not used: headings come of sightings both ways and of odometry");
        }
        if !raw.landmarks.is_empty() {
            self.tell("`landmarks` are not used: they are targets like others, and their places are found");
        }
        for s in &problem.sightings {
            let Some(axis) = axis_of(problem, s) else { continue };
            if axis.bearing.1 >= MEAN_SIGMA_RAD && s.bearing.is_none() {
                let peer = s.peer.map_or("somebody", |peer| &problem.robots[peer].id);
                let observer = &problem.robots[s.observer].id;
                let text = format!(
                    "the features of {peer} that {observer} sees do not tell where its axis is: their mean is taken, to {:.0}°",
                    axis.bearing.1.to_degrees()
                );
                self.tell(&text);
            }
        }
    }

    /// Announces robots that are new, or wear or carry something else than before.
    fn announce(
        &mut self,
        problem: &Problem,
        ids: &[RobotId],
        leader: &mut Leader,
        at: Timestamp,
        outputs: &mut Vec<Output>,
    ) {
        for (k, (robot, id)) in problem.robots.iter().zip(ids).enumerate() {
            let as_before = self.announced.get(k).is_some_and(|before| {
                before.marker == robot.marker && before.camera_height_m.total_cmp(&robot.camera_height_m).is_eq()
            });
            if as_before {
                continue;
            }
            if let Some(team_from_body) = robot.pose.filter(|_| k >= self.announced.len()) {
                leader.fix(Anchor { robot: *id, team_from_body });
            }
            leader.handle(at, Input::Announcement(announcement(robot, *id)), outputs);
            match self.announced.get_mut(k) {
                Some(before) => before.clone_from(robot),
                None => self.announced.push(robot.clone()),
            }
        }
    }
}

/// Whether a robot measures anything in this line.
fn speaks(raw: &RawProblem, problem: &Problem, robot: usize) -> bool {
    problem.sightings.iter().any(|s| s.observer == robot)
        || problem.bearings.iter().any(|b| b.observer == robot)
        || raw.odometry.iter().any(|o| o.robot == problem.robots[robot].id)
}

fn is_covariance(rows: &[[f64; 3]; 3]) -> bool {
    let matrix = Matrix3::from_fn(|r, c| rows[r][c]);
    matrix.iter().all(|v| v.is_finite())
        && (matrix - matrix.transpose()).amax() <= 1e-9 * matrix.amax()
        && matrix.symmetric_eigenvalues().min() >= -1e-12
}

/// The axis of the robot that is seen, by the closed forms of its marker; of somebody unnamed only where all others wear the
/// same.
fn axis_of(problem: &Problem, s: &Sighting) -> Option<Axis> {
    let mut others = (0..problem.robots.len()).filter(|r| *r != s.observer);
    let alike = || {
        let first = others.next()?;
        others.all(|r| problem.robots[r].marker == problem.robots[first].marker).then_some(first)
    };
    let Some(peer) = s.peer.or_else(alike) else { return axis(s, None) };
    let (axis, heading) = seen(problem, s, peer)?;
    let Marker::Rectangle { behind_m, .. } = &problem.robots[peer].marker else { return Some(axis) };
    let (Some(edges), Some((range_m, _))) = (problem.robots[peer].marker.edge_points(), axis.range) else {
        return Some(axis);
    };
    if s.bearing == Some(axis.bearing) {
        return Some(axis);
    }
    // Bearing and range are of the plate's middle, beside and before the axis.
    let middle = 0.5 * (edges[0] + edges[1]);
    let (sin, cos) = axis.bearing.0.sin_cos();
    let seen_at = Vector2::new(cos, sin) * (range_m - behind_m);
    let Some((heading_rad, sigma_rad)) = heading else {
        return Some(Axis { bearing: (axis.bearing.0, axis.bearing.1.hypot(middle.norm() / range_m)), ..axis });
    };
    let at = seen_at - Pose2::new(0.0, 0.0, heading_rad).rotation() * middle;
    let lever = middle.norm() * sigma_rad.min(1.0);
    let range_sigma_m = axis.range.map_or(0.0, |(_, sigma)| sigma);
    Some(Axis {
        bearing: (at.y.atan2(at.x), axis.bearing.1.hypot(lever / range_m)),
        range: Some((at.norm(), range_sigma_m.hypot(lever))),
    })
}

fn names(problem: &Problem) -> Result<Vec<RobotId>, SolveError> {
    let id = |(k, robot): (usize, &Robot)| {
        RobotId::new(&robot.id).map_err(|e| SolveError::Value {
            place: format!("robots[{k}].id"),
            value: e.to_string(),
            right: "1 to 16 of a-z, 0-9, '_' and '-'".into(),
        })
    };
    problem.robots.iter().enumerate().map(id).collect()
}

fn new_leader(problem: &Problem, ids: &[RobotId], anchored: bool) -> Leader {
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
    if problem.robots.iter().all(|robot| robot.pose.is_none()) && anchored {
        config.anchor = Some(Anchor { robot: ids[problem.anchor], team_from_body: Pose2::IDENTITY });
    }
    Leader::new(config)
}

fn announcement(robot: &Robot, id: RobotId) -> Announcement {
    Announcement {
        robot: id,
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
    }
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
        let Some(now) = axis_of(problem, s) else { continue };
        let stays = before[s.observer].iter().filter(|b| b.peer == s.peer).any(|b| {
            axis_of(problem, b).is_some_and(|old| {
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
    let axis = axis_of(problem, s)?;
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
