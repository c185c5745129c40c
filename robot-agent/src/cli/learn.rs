//! `robot-agent learn`.

use std::io::Write;
use std::path::{Path, PathBuf};

use protocol::angle::difference;
use protocol::marker::Marker;
use protocol::whole_file;
use robot_agent::optics::MountedCamera;
use robot_agent::panorama::{Lut, PanoramaGeometry};
use robot_agent::peers::{self, Grid, KnownView, PeerDetector};
use serde::Deserialize;

use super::{Failure, open_frames};

/// Most pictures that are learnt from: more say nothing new.
const MOST_PICTURES: usize = 64;

/// Learns what a robot looks like from pictures of it at known places: the rings of its round body, as a marker for
/// `marker_file` and `peers --markers`. Says in how many of the pictures the robot is found by it;
/// in none is an error.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// A folder of images, an image, a .y4m file, or a video that ffmpeg decodes.
    input: PathBuf,
    /// The camera file (camera.toml).
    #[arg(long, value_name = "FILE")]
    camera: PathBuf,
    /// Where the robot is in the pictures: a JSON array with one object a picture, in order: {"bearing_deg": 12.0, "range_m": 2.4}
    /// as this camera's robot has it, to the axis; one object if it stands still. To a centimetre or two.
    #[arg(long, value_name = "FILE")]
    places: PathBuf,
    /// Radius of the round body, metres.
    #[arg(long, value_name = "M")]
    radius_m: f64,
    /// Lower and upper end of its painted part above the floor, metres.
    #[arg(long, num_args = 2, value_names = ["LOW", "HIGH"])]
    height_m: Vec<f64>,
    /// Where the marker goes: a .toml or a .json file; without, standard output as JSON.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// One place of the file.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct Place {
    bearing_deg: f64,
    range_m: f64,
}

/// Runs the command.
pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let camera = MountedCamera::load(&arguments.camera).map_err(Failure::usage)?;
    let (radius_m, height_m) = checked(arguments)?;
    let format = arguments.out.as_deref().map(Written::of).transpose()?;
    let places = load_places(&arguments.places, radius_m)?;
    let pictures = pictures(arguments, &camera, &places)?;
    let views: Vec<KnownView<'_>> = pictures
        .iter()
        .map(|(raw, place)| KnownView { raw, bearing_rad: place.bearing_deg.to_radians(), range_m: place.range_m })
        .collect();
    let learnt = peers::learn(&camera, &views, radius_m, height_m)
        .map_err(|error| Failure::job(format!("{}: {error}", arguments.input.display())))?;
    tracing::info!("pixels differ from the rings by {:.1} % of the contrast", 100.0 * learnt.rest);
    try_out(&camera, &views, &learnt.bearings_rad, &learnt.marker)?;
    match (&arguments.out, format) {
        (Some(path), Some(format)) => {
            let text = format.text(&learnt.marker)?;
            whole_file::replace(path, text.as_bytes(), whole_file::ORDINARY)
                .map_err(|e| Failure::job(format!("cannot write {}: {e}", path.display())))
        }
        _ => Ok(writeln!(std::io::stdout().lock(), "{}", Written::Json.text(&learnt.marker)?)?),
    }
}

fn checked(arguments: &Arguments) -> Result<(f64, [f64; 2]), Failure> {
    let radius_m = arguments.radius_m;
    if !(0.01..=2.0).contains(&radius_m) {
        return Err(Failure::usage(format!("--radius-m {radius_m}: 0.01 to 2 metres would be right")));
    }
    match arguments.height_m[..] {
        [low, high] if low >= 0.0 && low + 0.05 <= high && high <= 5.0 => Ok((radius_m, [low, high])),
        _ => {
            let given = &arguments.height_m;
            Err(Failure::usage(format!(
                "--height-m {given:?}: two heights from 0 to 5 metres, the upper one 0.05 or more above the lower, would be right"
            )))
        }
    }
}

fn load_places(path: &Path, radius_m: f64) -> Result<Vec<Place>, Failure> {
    let wrong = |problem: String| Failure::usage(format!("{}: {problem}", path.display()));
    let text = std::fs::read_to_string(path).map_err(|e| wrong(format!("cannot read the places: {e}")))?;
    let places: Vec<Place> = serde_json::from_str(&text).map_err(|e| wrong(e.to_string()))?;
    if places.is_empty() {
        return Err(wrong("an empty array; a place for every picture, or one for all, would be right".to_owned()));
    }
    for (n, Place { bearing_deg, range_m }) in places.iter().enumerate() {
        if !bearing_deg.is_finite() || !(1.1 * radius_m..=20.0).contains(range_m) {
            let right = format!("a bearing in degrees and {:.2} to 20 m to the axis would be right", 1.1 * radius_m);
            return Err(wrong(format!("place {n}: {bearing_deg} degrees, {range_m} m: {right}")));
        }
    }
    Ok(places)
}

/// The pictures that can be read, each with its place.
fn pictures(arguments: &Arguments, camera: &MountedCamera, places: &[Place]) -> Result<Vec<(Vec<u8>, Place)>, Failure> {
    let mut source = open_frames(&arguments.input, camera, None)?;
    let (mut pictures, mut index) = (Vec::new(), 0usize);
    while let Some(frame) = source.next_frame() {
        let place = match places {
            [one] => Some(*one),
            many => many.get(index).copied(),
        };
        index += 1;
        match (frame, place) {
            (Ok(frame), Some(place)) if pictures.len() < MOST_PICTURES => pictures.push((frame.gray, place)),
            (Ok(_), _) => {}
            (Err(error), _) => tracing::warn!("picture {}: {error}", index - 1),
        }
    }
    if places.len() > 1 && places.len() != index {
        let (file, n) = (arguments.places.display(), places.len());
        return Err(Failure::usage(format!(
            "{file}: {n} places for {index} pictures; one for each, or one for all, would be right"
        )));
    }
    if pictures.is_empty() {
        return Err(Failure::job(format!("{}: not one picture could be used", arguments.input.display())));
    }
    Ok(pictures)
}

/// Logs in how many of the pictures the robot is found by the look, and how far from where it was said to be.
fn try_out(
    camera: &MountedCamera,
    views: &[KnownView<'_>],
    bearings_rad: &[f64],
    marker: &Marker,
) -> Result<(), Failure> {
    let geometry = PanoramaGeometry::for_work(camera).map_err(Failure::usage)?;
    let Some(grid) = Grid::of(&geometry) else {
        tracing::warn!("not tried out: this camera sees nothing from 60 degrees below to 45 above the horizon");
        return Ok(());
    };
    let mut detector = PeerDetector::new(camera, grid, std::slice::from_ref(marker));
    let lut = Lut::panorama(camera, &geometry);
    let mut panorama = vec![0; geometry.pixels()];
    let mut away_m: Vec<f64> = Vec::new();
    for (view, bearing_rad) in views.iter().zip(bearings_rad) {
        lut.unwarp(view.raw, &mut panorama).map_err(Failure::job)?;
        let peers = detector.detect(view.raw, &panorama);
        let there = peers.iter().filter(|p| difference(p.bearing_rad, *bearing_rad).abs() * view.range_m < 0.1);
        let nearest = there.map(|p| (p.range_m - view.range_m).abs()).min_by(f64::total_cmp);
        away_m.extend(nearest.filter(|away_m| *away_m < 0.1 * view.range_m));
    }
    let (found, n, worst_m) = (away_m.len(), views.len(), away_m.iter().copied().fold(0.0, f64::max));
    if found == 0 {
        let right = "the robot unhidden, and places that are right to a centimetre or two, would be right";
        return Err(Failure::job(format!("what was learnt finds the robot in none of the {n} pictures: {right}")));
    }
    tracing::info!("found by it in {found} of {n} pictures, at most {worst_m:.3} m from the range that was given");
    Ok(())
}

/// How the marker is written, by the file's name.
#[derive(Debug, Clone, Copy)]
enum Written {
    Toml,
    Json,
}

impl Written {
    fn of(path: &Path) -> Result<Self, Failure> {
        match path.extension().and_then(|e| e.to_str()) {
            Some("toml") => Ok(Self::Toml),
            Some("json") => Ok(Self::Json),
            _ => Err(Failure::usage(format!("--out {}: a .toml or a .json file would be right", path.display()))),
        }
    }

    fn text(self, marker: &Marker) -> Result<String, Failure> {
        match self {
            Self::Toml => toml::to_string(marker).map_err(Failure::job),
            Self::Json => serde_json::to_string_pretty(marker).map_err(Failure::job),
        }
    }
}
