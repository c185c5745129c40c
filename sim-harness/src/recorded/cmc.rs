//! Curtin's multi-camera people (CMC): a detector's boxes of four fixed cameras, three-dimensional truth.
//!
//! Each camera becomes a robot of known pose whose agent reports the boxes as tracks: the bearing of a box's middle, the
//! elevations of its edges. Which boxes are one person is the leader's affair; false alarms and misses are the detector's.
//! The standard deviation of a bearing is one number, found from the data's own innovations: the leader's map, before a frame
//! is heard, predicts the bearings of that frame, and sigma is chosen so that their normalised squares are one in the mean
//! (tails left out).

use std::collections::BTreeMap;
use std::path::Path;

use nalgebra::{Matrix3, Matrix3x4, Vector3};
use protocol::angle::wrap;
use protocol::frames::Pose2;
use protocol::id::{RobotId, TrackId};
use protocol::marker::Marker;
use protocol::message::{
    ElevationEnd, Motion, ObjectClass, Observation, Stages, TeamMap, TrackObservation, TrackState,
};
use protocol::quantity::{Angle16, Fraction8, LogSigma};
use protocol::time::Timestamp;
use serde::{Deserialize, Serialize};

use super::feed::{Feed, Recorded};
use super::tracks::{Seen, Tracks};
use super::{RecordedError, files, median};
use crate::score::assignment::assign;

/// Of the published recording.
const FRAME_RATE_HZ: f64 = 4.0;
/// Largest number of a frame: seven hours.
const LAST_FRAME: f64 = 100_000.0;
/// Picture, pixels: boxes that touch its edge are cut there.
const IMAGE_PX: [f64; 2] = [1920.0, 1024.0];
const EDGE_PX: f64 = 3.0;
/// The part of the room in which the set's authors track, and in which there is truth: x and y from … to, metres (the
/// boundaries of their published tracker). Others wait beside it; estimates of them are neither right nor wrong.
const AREA_M: [[f64; 2]; 2] = [[2.03, 6.30], [0.00, 3.41]];
/// A person is matched within this, metres.
const GATE_M: f64 = 0.5;
/// Before the data have told, degrees.
const FIRST_SIGMA_DEG: f64 = 1.0;
/// Passes over the data for sigma.
const PASSES: usize = 4;
/// Squared sigmas beyond which an innovation does not tell of sigma: real bearings have 2.6 % beyond three, which the leader's own
/// density takes for tails.
const INNOVATION_GATE: f64 = 9.0;

/// Scores of a replay.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// Frames.
    pub frames: usize,
    /// People-instants in truth.
    pub truths: usize,
    /// Of a bearing, from the innovations.
    pub bearing_sigma_deg: f64,
    /// Median distance along the floor of matched people, metres.
    pub median_m: f64,
    /// Root mean square of it.
    pub rms_m: f64,
    /// Identity F1 at a gate of 0.5 m.
    pub idf1: f64,
    /// Matched over all truths.
    pub recall: f64,
    /// Matched over all estimates.
    pub precision: f64,
    /// Mean squared normalised error over two.
    pub nees: f64,
    /// What the leader told.
    pub notices: Vec<String>,
}

#[derive(Debug, Deserialize)]
struct Camera {
    #[serde(rename = "P_3x4")]
    projection: [[f64; 4]; 3],
}

struct View {
    id: RobotId,
    centre: Vector3<f64>,
    /// World direction of a pixel.
    unproject: Matrix3<f64>,
    /// Boxes by frame: left, top, width, height.
    boxes: BTreeMap<u64, Vec<[f64; 4]>>,
}

/// Truth: frame, person, x, y.
type Truth = BTreeMap<u64, Vec<(u64, [f64; 2])>>;

/// Replays a folder.
pub fn replay(folder: &Path) -> Result<Report, RecordedError> {
    let views = views(folder)?;
    let truth = truth(folder)?;
    let nothing = |value: &str, want| {
        Err(RecordedError::Format { file: folder.display().to_string(), line: None, value: value.to_owned(), want })
    };
    if views.iter().all(|view| view.boxes.is_empty()) {
        return nothing("no box in any DET_*_CamN.txt", "a line for each box that a detector found");
    }
    if !views.iter().flat_map(|view| view.boxes.keys()).any(|frame| truth.contains_key(frame)) {
        return nothing(
            "no frame is both in DET_*_CamN.txt and in GT_*_WORLD_CENTROID.txt",
            "the same numbers of frames",
        );
    }
    let mut sigma_deg = FIRST_SIGMA_DEG;
    for _ in 0..PASSES {
        let run = run(&views, sigma_deg)?;
        // The prediction's own part of the variance does not scale with sigma; a few passes settle it.
        let mean = run.innovations2.iter().sum::<f64>() / run.innovations2.len() as f64;
        let scale = mean.sqrt();
        if !scale.is_finite() {
            break;
        }
        sigma_deg *= scale.clamp(0.5, 2.0);
    }
    let run = run(&views, sigma_deg)?;
    Ok(score(&run, &truth, sigma_deg))
}

fn views(folder: &Path) -> Result<Vec<View>, RecordedError> {
    let path = folder.join("cameras.json");
    let file = path.display().to_string();
    let cameras: BTreeMap<String, Camera> = serde_json::from_str(&files::text(&path)?).map_err(|e| {
        let want = "{\"cam1\": {\"P_3x4\": [[..4], [..4], [..4]]}, ..}";
        RecordedError::Format { file: file.clone(), line: Some(e.line()), value: e.to_string(), want }
    })?;
    let mut views = Vec::new();
    for (name, camera) in &cameras {
        let fault = |want| RecordedError::Format { file: file.clone(), line: None, value: name.clone(), want };
        let number = name.trim_start_matches("cam");
        let found = files::named(folder, |n| n.starts_with("DET_") && n.ends_with(&format!("Cam{number}.txt")))?;
        let [path] = &found[..] else { return Err(fault("a camera with one file DET_*_CamN.txt")) };
        let p = Matrix3x4::from_fn(|r, c| camera.projection[r][c]);
        let left: Matrix3<f64> = p.fixed_view::<3, 3>(0, 0).into_owned();
        let inverse = left.try_inverse().ok_or_else(|| fault("a projection that can be inverted"))?;
        // In front of the camera the third row is positive where the determinant is.
        let unproject = inverse * left.determinant().signum();
        let mut boxes: BTreeMap<u64, Vec<[f64; 4]>> = BTreeMap::new();
        for row in files::checked_table(path, 6, "frame, -1, left, top, width, height", known_frame)? {
            boxes.entry(row[0] as u64).or_default().push([row[2], row[3], row[4], row[5]]);
        }
        let id = RobotId::new(name).map_err(|e| RecordedError::Message(e.to_string()))?;
        views.push(View { id, centre: -inverse * p.column(3), unproject, boxes });
    }
    Ok(views)
}

fn truth(folder: &Path) -> Result<Truth, RecordedError> {
    let found = files::named(folder, |n| n.starts_with("GT_") && n.ends_with("WORLD_CENTROID.txt"))?;
    let [path] = &found[..] else {
        let (file, value) = (folder.display().to_string(), format!("{} files GT_*_WORLD_CENTROID.txt", found.len()));
        return Err(RecordedError::Format { file, line: None, value, want: "one" });
    };
    let mut truth = Truth::new();
    for row in files::checked_table(path, 10, "frame, person, five others, x, y, z", known_frame)? {
        truth.entry(row[0] as u64).or_default().push((row[1] as u64, [row[7], row[8]]));
    }
    Ok(truth)
}

/// Every frame from the first to the last is gone through.
fn known_frame(row: &[f64]) -> Result<(), (f64, &'static str)> {
    if (0.0..=LAST_FRAME).contains(&row[0]) && row[0].fract() == 0.0 {
        return Ok(());
    }
    Err((row[0], "a frame's whole number from 0 to 100000"))
}

impl View {
    /// Bearing and elevation of a pixel; the robots look along the world's x.
    fn look(&self, u: f64, v: f64) -> [f64; 2] {
        let d = self.unproject * Vector3::new(u, v, 1.0);
        [d.y.atan2(d.x), d.z.atan2(d.x.hypot(d.y))]
    }

    fn seen(&self, [left, top, width, height]: [f64; 4]) -> Seen {
        let middle = left + 0.5 * width;
        let elevation_rad = [self.look(middle, top + height)[1], self.look(middle, top)[1]];
        Seen { bearing_rad: self.look(middle, top + 0.5 * height)[0], elevation_rad }
    }

    fn track(&self, number: u32, box_px: [f64; 4], seen: &Seen, sigma_rad: f64) -> TrackObservation {
        let [left, top, width, height] = box_px;
        let end = |cut: bool| if cut { ElevationEnd::Cut } else { ElevationEnd::Seen };
        let aside = left < EDGE_PX || left + width > IMAGE_PX[0] - EDGE_PX;
        let row = top + 0.5 * height;
        let across = wrap(self.look(left, row)[0] - self.look(left + width, row)[0]).abs();
        TrackObservation {
            track: TrackId(number),
            state: TrackState::Visible,
            bearing: Angle16::from_rad(seen.bearing_rad),
            // Half of a body cut off by the edge moves the middle by a quarter of its width.
            bearing_sigma: LogSigma::from_value(if aside { sigma_rad.hypot(0.25 * across) } else { sigma_rad }),
            elevation: seen.elevation_rad.map(Angle16::from_rad),
            elevation_sigma: LogSigma::from_value(sigma_rad),
            ends: [end(top + height > IMAGE_PX[1] - EDGE_PX), end(top < EDGE_PX)],
            width: Angle16::from_rad(across),
            range: None,
            class: ObjectClass::Unknown,
            confidence: Fraction8::from_value(1.0),
            doubtful: false,
            appearance: None,
        }
    }
}

struct Run {
    maps: Vec<(u64, TeamMap)>,
    innovations2: Vec<f64>,
    notices: Vec<String>,
}

fn run(views: &[View], sigma_deg: f64) -> Result<Run, RecordedError> {
    let sigma_rad = sigma_deg.to_radians();
    let robots: Vec<Recorded> = views
        .iter()
        .map(|v| Recorded {
            id: v.id,
            fixed: Some(Pose2::new(v.centre.x, v.centre.y, 0.0)),
            height_m: v.centre.z,
            tilt_sigma_rad: 0.0,
            marker: Marker::Cylinder { radius_m: 0.2, height_m: [0.1, 0.5], look: None },
            rate_hz: FRAME_RATE_HZ,
        })
        .collect();
    let mut feed = Feed::new(&robots, |_| {})?;
    let mut tracks = vec![Tracks::default(); views.len()];
    let frames: Vec<u64> = views.iter().flat_map(|v| v.boxes.keys().copied()).collect();
    let (first, last) = (frames.iter().min().copied().unwrap_or(1), frames.iter().max().copied().unwrap_or(0));
    let mut maps: Vec<(u64, TeamMap)> = Vec::new();
    let mut innovations2 = Vec::new();
    for frame in first..=last {
        let capture = Timestamp::from_secs_f64(1000.0 + frame as f64 / FRAME_RATE_HZ);
        let mut newest = None;
        for (view, tracks) in views.iter().zip(&mut tracks) {
            let boxes = view.boxes.get(&frame).map_or(&[][..], Vec::as_slice);
            let seen: Vec<Seen> = boxes.iter().map(|b| view.seen(*b)).collect();
            if let Some((_, before)) = maps.last() {
                innovations2.extend(seen.iter().filter_map(|s| innovation2(view, s, before, capture, sigma_rad)));
            }
            let numbers = tracks.follow(&seen);
            let observed = numbers.iter().zip(boxes).zip(&seen).map(|((n, b), s)| view.track(*n, *b, s, sigma_rad));
            let observation = Observation {
                epoch: 1,
                sequence: u32::try_from(frame).unwrap_or(u32::MAX),
                capture,
                motion: Motion::Standing,
                odometry: None,
                stages: Stages::ALL,
                sightings: Vec::new(),
                tracks: observed.collect(),
            };
            newest = feed.observe(view.id, &observation)?.or(newest);
        }
        maps.extend(newest.map(|map| (frame, map)));
    }
    Ok(Run { maps, innovations2, notices: feed.notices })
}

/// The squared normalised difference of a bearing to the nearest that the map before predicts.
fn innovation2(view: &View, seen: &Seen, before: &TeamMap, at: Timestamp, sigma_rad: f64) -> Option<f64> {
    let dt = at.seconds_since(before.stamp);
    let of = |target: &protocol::message::MapTarget| {
        let [x, y, _] = target.position_m;
        let [vx, vy] = target.velocity_mps.map(f64::from);
        let (dx, dy) = (x + dt * vx - view.centre.x, y + dt * vy - view.centre.y);
        let range = dx.hypot(dy);
        let cov = before.covariance_of(target)?;
        let across = nalgebra::Vector2::new(-dy, dx) / range;
        let spread = (across.transpose() * cov.fixed_view::<2, 2>(0, 0) * across)[0];
        // A walker's acceleration of 0.4 m²/s³ adds to where he is a frame later.
        let walked = 0.4 * dt.powi(3) / 3.0;
        let var = sigma_rad * sigma_rad + (spread + walked) / (range * range);
        Some(wrap(seen.bearing_rad - dy.atan2(dx)).powi(2) / var)
    };
    before.targets.iter().filter_map(of).min_by(f64::total_cmp).filter(|d2| *d2 < INNOVATION_GATE)
}

fn score(run: &Run, truth: &Truth, bearing_sigma_deg: f64) -> Report {
    let (mut errors, mut normalised) = (Vec::new(), Vec::new());
    let (mut truths, mut estimates, mut matched) = (0, 0, 0);
    // How often each person and each target are within the gate of each other.
    let mut together: BTreeMap<(u64, u64), usize> = BTreeMap::new();
    for (frame, map) in &run.maps {
        let Some(people) = truth.get(frame) else { continue };
        truths += people.len();
        let away = |p: &[f64; 2], t: &[f64; 3]| (p[0] - t[0]).hypot(p[1] - t[1]);
        let distances: Vec<Vec<f64>> =
            people.iter().map(|(_, p)| map.targets.iter().map(|t| away(p, &t.position_m)).collect()).collect();
        let assigned = assign(&distances, GATE_M);
        estimates += (0..map.targets.len())
            .filter(|c| assigned.contains(&Some(*c)) || inside(&map.targets[*c].position_m))
            .count();
        for ((person, p), column) in people.iter().zip(assigned) {
            let Some(target) = column.map(|c| &map.targets[c]) else { continue };
            matched += 1;
            errors.push(away(p, &target.position_m));
            *together.entry((*person, u64::from(target.id.0))).or_default() += 1;
            let e = nalgebra::Vector2::new(target.position_m[0] - p[0], target.position_m[1] - p[1]);
            let cov = map.covariance_of(target).map(|c| c.fixed_view::<2, 2>(0, 0).into_owned());
            normalised.extend(cov.and_then(|c| c.try_inverse()).map(|i| (e.transpose() * i * e)[0]));
        }
    }
    let square = errors.iter().map(|e| e * e).sum::<f64>() / errors.len().max(1) as f64;
    Report {
        frames: run.maps.len(),
        truths,
        bearing_sigma_deg,
        rms_m: square.sqrt(),
        idf1: 2.0 * identity_matches(&together) as f64 / (truths + estimates).max(1) as f64,
        recall: matched as f64 / truths.max(1) as f64,
        precision: matched as f64 / estimates.max(1) as f64,
        nees: normalised.iter().sum::<f64>() / (2 * normalised.len()).max(1) as f64,
        median_m: median(errors),
        notices: run.notices.clone(),
    }
}

fn inside(position_m: &[f64; 3]) -> bool {
    AREA_M.iter().zip(position_m).all(|([low, high], p)| (*low..=*high).contains(p))
}

/// The most instants that one target a person can explain (Ristani et al., 2016).
fn identity_matches(together: &BTreeMap<(u64, u64), usize>) -> usize {
    let people: Vec<u64> = unique(together.keys().map(|k| k.0));
    let targets: Vec<u64> = unique(together.keys().map(|k| k.1));
    let count = |p: u64, t: u64| together.get(&(p, t)).copied().unwrap_or(0);
    let most = together.values().max().copied().unwrap_or(0) as f64 + 1.0;
    // Gain grows with the count: a distance whose square falls with it.
    let distances: Vec<Vec<f64>> =
        people.iter().map(|p| targets.iter().map(|t| (most - count(*p, *t) as f64).sqrt()).collect()).collect();
    let best = assign(&distances, most.sqrt());
    people.iter().zip(best).filter_map(|(p, c)| Some(count(*p, targets[c?]))).sum()
}

fn unique(values: impl Iterator<Item = u64>) -> Vec<u64> {
    values.collect::<std::collections::BTreeSet<_>>().into_iter().collect()
}
