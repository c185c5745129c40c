//! `robot-agent peers`.

use std::path::{Path, PathBuf};

use protocol::id::RobotId;
use protocol::marker::Marker;
use protocol::message::observation::FeaturePart;
use protocol::time::Timestamp;
use robot_agent::agent::Frame;
use robot_agent::optics::MountedCamera;
use robot_agent::panorama::{Lut, PanoramaGeometry};
use robot_agent::peers::{Grid, Peer, PeerDetector, PeerFeature};
use serde_json::{Value, json};

use super::{Failure, Lines, check_frame_rate, open_frames, print_lines};

/// Finds fellow robots in recorded frames by their announced look: one JSON line a frame on standard output. Every frame is
/// searched by itself.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// A folder of images, an image, a .y4m file, or a video that ffmpeg decodes.
    input: PathBuf,
    /// The camera file (camera.toml).
    #[arg(long, value_name = "FILE")]
    camera: PathBuf,
    /// What the robots wear: a JSON file with one marker or an array of markers, as in announcements; each may have a
    /// `robot`, which is told of markers that only it wears.
    #[arg(long, value_name = "FILE")]
    markers: PathBuf,
    /// Frame rate, for a folder that does not say.
    #[arg(long, value_name = "HZ")]
    frame_rate_hz: Option<f64>,
}

/// Runs the command.
pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    check_frame_rate(arguments.frame_rate_hz)?;
    let camera = MountedCamera::load(&arguments.camera).map_err(Failure::usage)?;
    let geometry = PanoramaGeometry::for_work(&camera).map_err(Failure::usage)?;
    let grid = Grid::of(&geometry)
        .ok_or_else(|| Failure::usage("this camera sees nothing from 60 degrees below to 45 above the horizon"))?;
    let detector = detector(&camera, grid, &arguments.markers)?;
    let lut = Lut::panorama(&camera, &geometry);
    let mut source = open_frames(&arguments.input, &camera, arguments.frame_rate_hz)?;
    let panorama = vec![0; geometry.pixels()];
    print_lines(&arguments.input, source.as_mut(), &mut Search { detector, lut, panorama })
}

/// The search of each frame.
struct Search {
    detector: PeerDetector,
    lut: Lut,
    panorama: Vec<u8>,
}

impl Lines for Search {
    fn of_frame(&mut self, index: u64, time_s: f64, frame: &Frame) -> Result<Value, Failure> {
        self.lut.unwarp(&frame.gray, &mut self.panorama).map_err(Failure::job)?;
        let mut peers = self.detector.detect(&frame.gray, &self.panorama);
        self.detector.read_beacons(&frame.gray, Timestamp::from_secs_f64(time_s), &mut peers);
        Ok(json!({ "frame": index, "time_s": time_s, "peers": peers.iter().map(peer).collect::<Vec<_>>() }))
    }

    fn of_bad_frame(&mut self, _index: u64) -> Result<Value, Failure> {
        Ok(json!({ "peers": [] }))
    }
}

/// The detector of what a markers file describes; what cannot be looked for is logged.
pub(super) fn detector(camera: &MountedCamera, grid: Grid, path: &Path) -> Result<PeerDetector, Failure> {
    let markers = load_markers(path)?;
    let detector = PeerDetector::for_team(camera, grid, &markers);
    for error in detector.unsupported() {
        tracing::warn!("{}: {error}", path.display());
    }
    if detector.unsupported().len() == markers.len() {
        let errors: Vec<String> = detector.unsupported().iter().map(ToString::to_string).collect();
        let path = path.display();
        return Err(Failure::usage(format!("{path}: no marker that can be looked for: {}", errors.join("; "))));
    }
    Ok(detector)
}

fn load_markers(path: &Path) -> Result<Vec<(Option<RobotId>, Marker)>, Failure> {
    let wrong = |problem: String| Failure::usage(format!("{}: {problem}", path.display()));
    let text = std::fs::read_to_string(path).map_err(|e| wrong(format!("cannot read the markers: {e}")))?;
    let document: Value = serde_json::from_str(&text).map_err(|e| wrong(format!("not JSON: {e}")))?;
    let entries = match document {
        Value::Array(entries) => entries,
        one => vec![one],
    };
    if entries.is_empty() {
        return Err(wrong("an empty array; at least one marker would be right".to_owned()));
    }
    let read = |(i, mut entry): (usize, Value)| {
        let wrong = |e: &dyn std::fmt::Display| wrong(format!("marker {i}: {e}"));
        let robot = entry.as_object_mut().and_then(|entry| entry.remove("robot"));
        let robot = robot.map(serde_json::from_value).transpose().map_err(|e| wrong(&e))?.flatten();
        let marker: Marker = serde_json::from_value(entry).map_err(|e| wrong(&e))?;
        marker.validate().map_err(|e| wrong(&e))?;
        Ok((robot, marker))
    };
    entries.into_iter().enumerate().map(read).collect()
}

fn peer(peer: &Peer) -> Value {
    let kind = Marker::KINDS.get(usize::from(peer.kind));
    json!({
        "marker": kind,
        "robot": peer.robot.map(|r| r.to_string()),
        "bearing_deg": peer.bearing_rad.to_degrees(),
        "bearing_sigma_deg": peer.bearing_sigma_rad().to_degrees(),
        "range_m": peer.range_m,
        "range_sigma_m": peer.range_sigma_m(),
        "heading_deg": peer.heading_rad.map(|h| h[0].to_degrees()),
        "heading_sigma_deg": peer.heading_rad.map(|h| h[1].to_degrees()),
        "confidence": peer.confidence,
        "features": peer.features.iter().map(feature).collect::<Vec<_>>(),
    })
}

fn feature(feature: &PeerFeature) -> Value {
    let (part, index) = match feature.part {
        FeaturePart::Left => ("left", None),
        FeaturePart::Right => ("right", None),
        FeaturePart::Bar(index) => ("bar", index),
        FeaturePart::Edge(index) => ("edge", Some(index)),
    };
    let elevation = feature.elevation_rad;
    json!({
        "part": part,
        "index": index,
        "bearing_deg": feature.bearing_rad.to_degrees(),
        "sigma_deg": feature.sigma_rad.to_degrees(),
        "elevation_deg": elevation.map(|e| e.map(f64::to_degrees)),
        "elevation_sigma_deg": elevation.map(|_| feature.elevation_sigma_rad.to_degrees()),
    })
}
