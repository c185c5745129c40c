//! The file that `solve` reads, and the checked problem that comes of it.

use std::collections::BTreeMap;

use nalgebra::Matrix3;
use protocol::angle::wrap;
use protocol::frames::Pose2;
use protocol::marker::Marker;
use serde::Deserialize;

use super::SolveError;
use super::fitting::misfit;
use super::layout::Nuisance;

/// Stamps of bearings that may be of one place, seconds.
const TOGETHER_S: f64 = 0.02;

/// Length of a piece of a target's way that is taken for straight, seconds: a walker's acceleration of 0.5 m/s² bends it by
/// 5 mm.
pub const PIECE_S: f64 = 0.4;

/// One problem as written.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields, expecting = "an object with robots, sightings, bearings")]
pub struct RawProblem {
    /// Seconds; in sequences.
    pub time_s: Option<f64>,
    /// Whose body frame is the team frame (unless poses or landmarks are given). Default: the first robot.
    pub anchor: Option<String>,
    /// All robots.
    #[serde(default)]
    pub robots: Vec<RawRobot>,
    /// Robot sees robot.
    #[serde(default)]
    pub sightings: Vec<RawSighting>,
    /// Robot sees target.
    #[serde(default)]
    pub bearings: Vec<RawBearing>,
    /// Targets of known position.
    #[serde(default)]
    pub landmarks: Vec<RawLandmark>,
    /// Motion since the line before; in sequences.
    #[serde(default)]
    pub odometry: Vec<RawOdometry>,
}

/// A robot as written.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RawRobot {
    /// Name.
    pub id: String,
    /// Default 0.6.
    pub camera_height_m: Option<f64>,
    /// What the others see of it. Default: cylinder of radius 0.2 m.
    pub marker: Option<Marker>,
    /// Known pose: held fixed.
    pub pose: Option<RawPose>,
    /// It is another of the robots, listed before it, at a later place. Camera height and marker are that one's if not given.
    pub moved_from: Option<RawMoved>,
    /// A priori sigma of an error that all bearings of this robot share; makes it an unknown.
    pub bearing_bias_sigma_deg: Option<f64>,
    /// A priori sigma of by how much its stamps are late; makes it an unknown. Needs bearings with `time_s`.
    pub time_offset_sigma_s: Option<f64>,
}

/// The way to a later place as written, in the body frame at the earlier one.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RawMoved {
    /// Who it was.
    pub robot: String,
    /// Forward.
    pub dx_m: f64,
    /// To the left.
    pub dy_m: f64,
    /// Counter-clockwise.
    pub dheading_deg: f64,
    /// Of the three: m and rad.
    pub covariance: [[f64; 3]; 3],
}

/// A pose as written.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(missing_docs, reason = "the names say it")]
pub struct RawPose {
    pub x_m: f64,
    pub y_m: f64,
    pub heading_deg: f64,
}

/// A sighting as written: an entry of `peers` with its `observer`, and its `peer` where the marker does not say who it is.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(missing_docs, reason = "the names say it")]
pub struct RawSighting {
    pub observer: String,
    #[serde(default)]
    pub peer: Option<String>,
    /// Another word for `peer`.
    #[serde(default)]
    pub robot: Option<String>,
    /// Kind of the peer's marker.
    pub marker: Option<String>,
    pub bearing_deg: Option<f64>,
    pub bearing_sigma_deg: Option<f64>,
    pub range_m: Option<f64>,
    pub range_sigma_m: Option<f64>,
    pub heading_deg: Option<f64>,
    pub heading_sigma_deg: Option<f64>,
    /// That it is a robot at all, 0 to 1; who writes a sighting into a file is sure of it.
    pub confidence: Option<f64>,
    #[serde(default)]
    pub features: Vec<RawFeature>,
    pub features_deg: Option<Vec<f64>>,
    pub feature_sigma_deg: Option<f64>,
}

/// A feature as written (`peers`).
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(missing_docs, reason = "the names say it")]
pub struct RawFeature {
    pub part: RawPart,
    #[serde(default)]
    pub index: Option<u8>,
    pub bearing_deg: f64,
    pub sigma_deg: f64,
    #[serde(default)]
    pub elevation_deg: Option<[f64; 2]>,
    /// Default `sigma_deg`.
    #[serde(default)]
    pub elevation_sigma_deg: Option<f64>,
}

/// Part of a marker as written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
#[expect(missing_docs, reason = "the names say it")]
pub enum RawPart {
    Left,
    Right,
    Bar,
    Edge,
}

/// A bearing of a target as written.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(missing_docs, reason = "the names say it")]
pub struct RawBearing {
    pub observer: String,
    #[serde(default)]
    pub target: Option<String>,
    /// When; in one problem: a target with times may move.
    pub time_s: Option<f64>,
    pub bearing_deg: f64,
    pub bearing_sigma_deg: f64,
    pub elevation_deg: Option<f64>,
    pub elevation_sigma_deg: Option<f64>,
}

/// A landmark as written.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(missing_docs, reason = "the names say it")]
pub struct RawLandmark {
    pub id: String,
    pub x_m: f64,
    pub y_m: f64,
    pub z_m: Option<f64>,
}

/// Odometry as written.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(missing_docs, reason = "the names say it")]
pub struct RawOdometry {
    pub robot: String,
    pub dx_m: f64,
    pub dy_m: f64,
    pub dheading_deg: f64,
    pub covariance: Option<[[f64; 3]; 3]>,
}

/// A robot.
#[derive(Debug, Clone)]
pub struct Robot {
    /// Name.
    pub id: String,
    /// Above the floor, metres.
    pub camera_height_m: f64,
    /// What the others see.
    pub marker: Marker,
    /// Held fixed.
    pub pose: Option<Pose2>,
    /// Another robot at a later place.
    pub moved: Option<Moved>,
    /// Errors of its measurements that are unknowns.
    pub nuisance: Nuisance,
}

/// The way of a robot from one place to another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moved {
    /// Index of the robot where it was, less than its own.
    pub from: usize,
    /// Forward, to the left (m), counter-clockwise (rad), in the body frame where it was.
    pub step: [f64; 3],
    /// Of the step.
    pub covariance: Matrix3<f64>,
}

/// A sighting, radians and metres.
#[derive(Debug, Clone)]
pub struct Sighting {
    /// Index of the observer.
    pub observer: usize,
    /// Index of the peer, where told.
    pub peer: Option<usize>,
    /// Axis: bearing and sigma.
    pub bearing: Option<(f64, f64)>,
    /// Axis: range and sigma.
    pub range: Option<(f64, f64)>,
    /// Peer's heading minus the observer's, and sigma.
    pub heading: Option<(f64, f64)>,
    /// Raw features: then they are the measurement.
    pub features: Vec<Feature>,
}

/// A feature, radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Feature {
    /// Which part.
    pub part: Part,
    /// Bearing.
    pub bearing_rad: f64,
    /// Of the bearing.
    pub sigma_rad: f64,
    /// Of the lower and upper end.
    pub elevation_rad: Option<[f64; 2]>,
    /// Of each of them.
    pub elevation_sigma_rad: f64,
}

/// Part of a marker.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// Left tangent of a cylinder.
    Left,
    /// Right tangent.
    Right,
    /// Bar of this number.
    Bar(usize),
    /// One of the bars round a cylinder.
    UnnumberedBar,
    /// 0 right, 1 left edge of a rectangle.
    Edge(usize),
}

impl Part {
    /// As the file has it.
    pub fn in_words(self) -> String {
        match self {
            Self::Left => "left".to_owned(),
            Self::Right => "right".to_owned(),
            Self::Bar(n) => format!("bar {n}"),
            Self::UnnumberedBar => "a bar".to_owned(),
            Self::Edge(n) => format!("edge {n}"),
        }
    }
}

/// A bearing of a target, radians.
#[derive(Debug, Clone)]
pub struct Bearing {
    /// Index of the observer.
    pub observer: usize,
    /// Index into the names of targets, where told.
    pub target: Option<usize>,
    /// Bearing and sigma.
    pub bearing: (f64, f64),
    /// Elevation and sigma.
    pub elevation: Option<(f64, f64)>,
    /// Stamp, seconds.
    pub time_s: Option<f64>,
}

impl Bearing {
    /// Whether the stamps of two bearings may be of one place.
    pub fn is_together(&self, other: &Self) -> bool {
        match (self.time_s, other.time_s) {
            (Some(a), Some(b)) => (a - b).abs() < TOGETHER_S,
            (a, b) => a == b,
        }
    }
}

/// A known target.
#[derive(Debug, Clone)]
pub struct Landmark {
    /// Index into the names of targets.
    pub target: usize,
    /// Metres.
    pub position_m: [f64; 2],
    /// Metres.
    pub z_m: Option<f64>,
}

/// A checked problem.
#[derive(Debug, Clone, Default)]
pub struct Problem {
    /// Robots.
    pub robots: Vec<Robot>,
    /// Index of the anchor.
    pub anchor: usize,
    /// Sightings.
    pub sightings: Vec<Sighting>,
    /// Bearings.
    pub bearings: Vec<Bearing>,
    /// Names of targets and landmarks; of a target that may move once for each piece of its way.
    pub targets: Vec<String>,
    /// When each is where it is, for those that may move.
    pub times: Vec<Option<f64>>,
    /// Landmarks.
    pub landmarks: Vec<Landmark>,
    /// Of each bearing, whether its target was found by [`super::pairing`]; empty before that.
    pub paired: Vec<bool>,
    /// What was left out of what is written, in words.
    pub remarks: Vec<String>,
}

impl Problem {
    /// Parses and checks one problem.
    pub fn parse(text: &str) -> Result<Self, SolveError> {
        let raw: RawProblem = serde_json::from_str(text).map_err(SolveError::Json)?;
        if !raw.odometry.is_empty() {
            return Err(SolveError::Value {
                place: "odometry".into(),
                value: format!("given {} times", raw.odometry.len()),
                right:
                    "nothing (it is for the lines of `--sequence`; in one problem a later place of a robot is another \
                        robot with `moved_from`)"
                        .into(),
            });
        }
        Self::check(&raw)
    }

    /// Checks one problem, or a line of a sequence.
    pub fn check(raw: &RawProblem) -> Result<Self, SolveError> {
        let mut robots: Vec<Robot> = Vec::with_capacity(raw.robots.len());
        for robot in &raw.robots {
            robots.push(check_robot(robot, &robots)?);
        }
        if robots.is_empty() {
            return Err(SolveError::Missing("robots"));
        }
        let mut index: BTreeMap<&str, usize> = BTreeMap::new();
        for (k, robot) in robots.iter().enumerate() {
            if index.insert(&robot.id, k).is_some() {
                return Err(SolveError::Twice { what: "robot", id: robot.id.clone() });
            }
        }
        let robot_of = |id: &str, place: String| {
            index.get(id).copied().ok_or_else(|| SolveError::UnknownRobot { place, id: id.to_owned() })
        };
        let anchor = raw.anchor.as_ref().map_or(Ok(0), |id| robot_of(id, "anchor".into()))?;
        let mut targets: Vec<String> = Vec::new();
        let mut numbers: BTreeMap<String, usize> = BTreeMap::new();
        let mut target_of = |id: &str| match numbers.get(id) {
            Some(number) => *number,
            None => {
                targets.push(id.to_owned());
                numbers.insert(id.to_owned(), targets.len() - 1);
                targets.len() - 1
            }
        };
        let mut landmarks: Vec<Landmark> = Vec::new();
        for (k, l) in raw.landmarks.iter().enumerate() {
            let place = |field: &str| format!("landmarks[{k}].{field}");
            let position_m = [finite(l.x_m, || place("x_m"))?, finite(l.y_m, || place("y_m"))?];
            let z_m = l.z_m.map(|z| finite(z, || place("z_m"))).transpose()?;
            let target = target_of(&l.id);
            if landmarks.iter().any(|o| o.target == target) {
                return Err(SolveError::Twice { what: "landmark", id: l.id.clone() });
            }
            landmarks.push(Landmark { target, position_m, z_m });
        }
        let mut sightings = Vec::new();
        for (k, s) in raw.sightings.iter().enumerate() {
            let observer = robot_of(&s.observer, format!("sightings[{k}].observer"))?;
            if let (Some(peer), Some(robot)) = (&s.peer, &s.robot)
                && peer != robot
            {
                return Err(SolveError::Value {
                    place: format!("sightings[{k}].robot"),
                    value: format!("{robot:?}"),
                    right: format!("{peer:?}, as `peer` says, or null").into(),
                });
            }
            let named = s.peer.as_ref().or(s.robot.as_ref());
            let key = if s.peer.is_some() { "peer" } else { "robot" };
            let peer = named.map(|id| robot_of(id, format!("sightings[{k}].{key}"))).transpose()?;
            if let (Some(peer), Some(name)) = (peer, named)
                && first_place(&robots, peer) == first_place(&robots, observer)
            {
                return Err(SolveError::Value {
                    place: format!("sightings[{k}].{key}"),
                    value: name.clone(),
                    right: "another robot than the observer".into(),
                });
            }
            sightings.push(check_sighting(k, s, observer, peer, &robots)?);
        }
        let mut bearings = Vec::new();
        for (k, b) in raw.bearings.iter().enumerate() {
            let place = |field: &str| format!("bearings[{k}].{field}");
            let elevation = pair(
                b.elevation_deg,
                b.elevation_sigma_deg,
                || place("elevation_deg"),
                || place("elevation_sigma_deg"),
                1f64.to_radians(),
            )?;
            bearings.push(Bearing {
                observer: robot_of(&b.observer, place("observer"))?,
                target: b.target.as_deref().map(&mut target_of),
                bearing: (
                    wrap(finite(b.bearing_deg, || place("bearing_deg"))?.to_radians()),
                    positive(b.bearing_sigma_deg, || place("bearing_sigma_deg"))?.to_radians(),
                ),
                elevation,
                time_s: b.time_s.map(|t| finite(t, || place("time_s"))).transpose()?,
            });
        }
        let times = vec![None; targets.len()];
        let is_vague = |s: &RawSighting| s.heading_deg.is_some() && s.heading_sigma_deg.is_none();
        let vague = raw.sightings.iter().enumerate().filter(|(_, s)| is_vague(s));
        let remarks = vague.map(|(k, _)| format!("sightings[{k}]: heading_deg without heading_sigma_deg is left out"));
        let remarks = remarks.collect();
        Ok(Self { robots, anchor, sightings, bearings, targets, times, landmarks, paired: Vec::new(), remarks })
    }

    /// The bearings that were found to be of a target.
    pub fn paired_with(&self, target: usize) -> Vec<usize> {
        let is_its = |b: &usize| self.paired[*b] && self.bearings[*b].target == Some(target);
        (0..self.paired.len()).filter(is_its).collect()
    }

    /// Targets whose bearings have times become one for each [`PIECE_S`] of their way, in which they go straight on.
    pub fn split_by_time(&mut self) {
        let mut pieces: BTreeMap<(usize, i64), (usize, f64, f64)> = BTreeMap::new();
        let names = self.targets.clone();
        let mut used = vec![false; names.len()];
        for l in &self.landmarks {
            used[l.target] = true;
        }
        let still = used.clone();
        for b in &mut self.bearings {
            let Some(target) = b.target.filter(|t| !still[*t]) else { continue };
            let Some(time_s) = b.time_s else {
                used[target] = true;
                continue;
            };
            let key = (target, (time_s / PIECE_S).floor() as i64);
            let node = pieces.entry(key).or_insert_with(|| {
                // The first piece takes the target's own place, if nothing without a time has it.
                let node = if used[target] { self.targets.len() } else { target };
                if node == target {
                    used[target] = true;
                } else {
                    self.targets.push(names[target].clone());
                    self.times.push(None);
                }
                (node, 0.0, 0.0)
            });
            (node.1, node.2) = (node.1 + time_s, node.2 + 1.0);
            b.target = Some(node.0);
        }
        for (node, sum, count) in pieces.into_values() {
            self.times[node] = Some(sum / count);
        }
    }
}

/// The robot of which this one is a later place, or itself.
fn first_place(robots: &[Robot], mut robot: usize) -> usize {
    while let Some(moved) = &robots[robot].moved {
        robot = moved.from;
    }
    robot
}

fn check_moved(raw: &RawMoved, place: impl Fn(&str) -> String, before: &[Robot]) -> Result<Moved, SolveError> {
    let from = before.iter().position(|r| r.id == raw.robot).ok_or_else(|| SolveError::Value {
        place: place("moved_from.robot"),
        value: format!("{:?}", raw.robot),
        right: "a robot that is listed before it".into(),
    })?;
    let number = |value: f64, key: &str| finite(value, || place(&format!("moved_from.{key}")));
    let step = [
        number(raw.dx_m, "dx_m")?,
        number(raw.dy_m, "dy_m")?,
        wrap(number(raw.dheading_deg, "dheading_deg")?.to_radians()),
    ];
    let covariance = Matrix3::from_fn(|r, c| raw.covariance[r][c]);
    let symmetric = (covariance - covariance.transpose()).amax() <= 1e-9 * covariance.amax();
    if !(symmetric && covariance.iter().all(|v| v.is_finite()) && covariance.cholesky().is_some()) {
        return Err(SolveError::Value {
            place: place("moved_from.covariance"),
            value: format!("{:?}", raw.covariance),
            right: "a symmetric, positive definite matrix of m and rad".into(),
        });
    }
    Ok(Moved { from, step, covariance })
}

fn check_robot(raw: &RawRobot, before: &[Robot]) -> Result<Robot, SolveError> {
    let place = |field: &str| format!("robots[{}].{field}", raw.id);
    let moved = raw.moved_from.as_ref().map(|moved| check_moved(moved, place, before)).transpose()?;
    if moved.is_some() && (raw.bearing_bias_sigma_deg.is_some() || raw.time_offset_sigma_s.is_some()) {
        return Err(SolveError::Value {
            place: place("bearing_bias_sigma_deg or time_offset_sigma_s"),
            value: "given again".into(),
            right: "to say it once, where the robot is listed first: a camera keeps its errors".into(),
        });
    }
    let earlier = moved.map(|m| &before[m.from]);
    let marker = raw.marker.clone().or_else(|| earlier.map(|r| r.marker.clone())).unwrap_or(Marker::Cylinder {
        radius_m: 0.2,
        height_m: [0.1, 0.5],
        look: None,
    });
    let camera_height_m = raw.camera_height_m.or(earlier.map(|r| r.camera_height_m)).unwrap_or(0.6);
    marker.validate().map_err(|e| SolveError::Value {
        place: place("marker"),
        value: e.to_string(),
        right: "the geometry of a real marker".into(),
    })?;
    let pose = match raw.pose {
        Some(p) => Some(Pose2::new(
            finite(p.x_m, || place("pose.x_m"))?,
            finite(p.y_m, || place("pose.y_m"))?,
            finite(p.heading_deg, || place("pose.heading_deg"))?.to_radians(),
        )),
        None => None,
    };
    let sigma = |value: Option<f64>, key: &str| value.map(|s| positive(s, || place(key))).transpose();
    Ok(Robot {
        id: raw.id.clone(),
        camera_height_m: positive(camera_height_m, || place("camera_height_m"))?,
        marker,
        pose,
        moved,
        nuisance: Nuisance {
            bias_rad: sigma(raw.bearing_bias_sigma_deg, "bearing_bias_sigma_deg")?.map(f64::to_radians),
            offset_s: sigma(raw.time_offset_sigma_s, "time_offset_sigma_s")?,
        },
    })
}

fn check_sighting(
    k: usize,
    s: &RawSighting,
    observer: usize,
    peer: Option<usize>,
    robots: &[Robot],
) -> Result<Sighting, SolveError> {
    let place = |field: &str| format!("sightings[{k}].{field}");
    let rad = 1f64.to_radians();
    let angle = |v: Option<f64>, sigma: Option<f64>, a: &str, b: &str| pair(v, sigma, || place(a), || place(b), rad);
    if let Some(kind) = &s.marker {
        check_kind(kind, place("marker"), observer, peer, robots)?;
    }
    if let Some(confidence) = s.confidence.filter(|c| !(0.0..=1.0).contains(c)) {
        let (place, value) = (place("confidence"), confidence.to_string());
        return Err(SolveError::Value { place, value, right: "0 to 1".into() });
    }
    let mut features = Vec::new();
    for (n, f) in s.features.iter().enumerate() {
        let place = |field: &str| place(&format!("features[{n}].{field}"));
        let part = match (f.part, f.index) {
            (RawPart::Left, _) => Part::Left,
            (RawPart::Right, _) => Part::Right,
            (RawPart::Bar, Some(n)) => Part::Bar(usize::from(n)),
            (RawPart::Bar, None) => Part::UnnumberedBar,
            (RawPart::Edge, Some(n)) if n < 2 => Part::Edge(usize::from(n)),
            (RawPart::Edge, index) => {
                return Err(SolveError::Value {
                    place: place("index"),
                    value: index.map_or_else(|| "null".into(), |n| n.to_string()),
                    right: "0 (right) or 1 (left) for an edge".into(),
                });
            }
        };
        // With a bearing beside, `fitting` leaves it out and says so.
        if let Some(peer) = peer.filter(|_| s.bearing_deg.is_none())
            && let Some(has) = misfit(&robots[peer].marker, part)
        {
            return Err(SolveError::Value {
                place: place("part"),
                value: part.in_words(),
                right: format!("{has}: {} wears a marker of kind {}", robots[peer].id, robots[peer].marker.kind_name())
                    .into(),
            });
        }
        let bearing_rad = wrap(finite(f.bearing_deg, || place("bearing_deg"))?.to_radians());
        let sigma_rad = positive(f.sigma_deg, || place("sigma_deg"))?.to_radians();
        let end = |deg: f64| Ok(finite(deg, || place("elevation_deg"))?.to_radians());
        let ends = f.elevation_deg.map(|[low, high]| Ok([end(low)?, end(high)?])).transpose()?;
        let own = f.elevation_sigma_deg.map(|deg| positive(deg, || place("elevation_sigma_deg"))).transpose()?;
        let elevation_sigma_rad = own.map_or(sigma_rad, f64::to_radians);
        features.push(Feature { part, bearing_rad, sigma_rad, elevation_rad: ends, elevation_sigma_rad });
    }
    if let Some(tangents) = &s.features_deg {
        let sigma_deg = s.feature_sigma_deg.ok_or_else(|| SolveError::Value {
            place: place("feature_sigma_deg"),
            value: "nothing".into(),
            right: "a positive number of degrees, with features_deg".into(),
        })?;
        let sigma_rad = positive(sigma_deg, || place("feature_sigma_deg"))?.to_radians();
        let [right, left] = tangents[..] else {
            return Err(SolveError::Value {
                place: place("features_deg"),
                value: format!("{} numbers", tangents.len()),
                right: "two: the right and the left tangent".into(),
            });
        };
        if let Some(peer) = peer.filter(|_| s.bearing_deg.is_none())
            && let Some(has) = misfit(&robots[peer].marker, Part::Left)
        {
            return Err(SolveError::Value {
                place: place("features_deg"),
                value: format!("{tangents:?}"),
                right: format!("`features` with {has}: {} wears no round marker", robots[peer].id).into(),
            });
        }
        for (part, deg) in [(Part::Right, right), (Part::Left, left)] {
            let bearing_rad = wrap(finite(deg, || place("features_deg"))?.to_radians());
            let elevation_sigma_rad = sigma_rad;
            features.push(Feature { part, bearing_rad, sigma_rad, elevation_rad: None, elevation_sigma_rad });
        }
    }
    let bearing = angle(s.bearing_deg, s.bearing_sigma_deg, "bearing_deg", "bearing_sigma_deg")?;
    if bearing.is_none() && features.is_empty() {
        return Err(SolveError::Value {
            place: place("bearing_deg"),
            value: "nothing".into(),
            right: "a bearing, or features".into(),
        });
    }
    let range = pair(s.range_m, s.range_sigma_m, || place("range_m"), || place("range_sigma_m"), 1.0)?;
    if let Some((range_m, _)) = range {
        positive(range_m, || place("range_m"))?;
    }
    Ok(Sighting {
        observer,
        peer,
        bearing: bearing.map(|(b, sigma)| (wrap(b), sigma)),
        range,
        // DESIGN's `peers` line has a heading and no sigma of it: such a one is told and left out (`Problem::check`).
        heading: match s.heading_sigma_deg {
            Some(_) => angle(s.heading_deg, s.heading_sigma_deg, "heading_deg", "heading_sigma_deg")?,
            None => None,
        },
        features,
    })
}

/// A sighting's `marker` is that of its peer, or of one of those who may be it.
fn check_kind(
    kind: &str,
    place: String,
    observer: usize,
    peer: Option<usize>,
    robots: &[Robot],
) -> Result<(), SolveError> {
    let right = match peer {
        _ if !Marker::KINDS.contains(&kind) => format!("one of {}", Marker::KINDS.join(", ")),
        Some(peer) if robots[peer].marker.kind_name() != kind => {
            let worn = robots[peer].marker.kind_name();
            format!("{worn:?}, which {} wears (`marker` in its entry of `robots`)", robots[peer].id)
        }
        None if (0..robots.len()).all(|r| r == observer || robots[r].marker.kind_name() != kind) => {
            "the marker that one of the other robots wears (`marker` in its entry of `robots`)".to_owned()
        }
        _ => return Ok(()),
    };
    Err(SolveError::Value { place, value: format!("{kind:?}"), right: right.into() })
}

/// A value with its sigma, both in `unit`; a value without sigma is an error.
fn pair(
    value: Option<f64>,
    sigma: Option<f64>,
    place: impl Fn() -> String,
    sigma_place: impl Fn() -> String,
    unit: f64,
) -> Result<Option<(f64, f64)>, SolveError> {
    let Some(value) = value else { return Ok(None) };
    let value = finite(value, place)? * unit;
    let sigma = sigma.ok_or_else(|| SolveError::Value {
        place: sigma_place(),
        value: "nothing".into(),
        right: "a positive standard deviation beside its value".into(),
    })?;
    Ok(Some((value, positive(sigma, sigma_place)? * unit)))
}

fn finite(value: f64, place: impl Fn() -> String) -> Result<f64, SolveError> {
    if value.is_finite() && value.abs() < 1e9 {
        return Ok(value);
    }
    Err(SolveError::Value { place: place(), value: value.to_string(), right: "a finite number".into() })
}

fn positive(value: f64, place: impl Fn() -> String) -> Result<f64, SolveError> {
    if value.is_finite() && value > 0.0 && value < 1e9 {
        return Ok(value);
    }
    Err(SolveError::Value { place: place(), value: value.to_string(), right: "a finite number above zero".into() })
}
