//! `robot-agent track`.

use std::io::{self, IsTerminal};
use std::path::{Path, PathBuf};

use indicatif::{ProgressBar, ProgressStyle};
use protocol::message::{ElevationEnd, TrackState};
use robot_agent::agent::Frame;
use robot_agent::capture::detections::Detections;
use robot_agent::motion::{BackgroundState, Change, MotionSettings, MotionStage, Raster};
use robot_agent::optics::MountedCamera;
use robot_agent::panorama::{Lut, PanoramaGeometry};
use robot_agent::peers::{Grid, PeerDetector};
use robot_agent::picture::{Animation, Gallery, encode_jpeg, encode_png};
use robot_agent::tracking::{PeerBearing, TrackView, Tracker, TrackerSettings, View};
use serde_json::{Value, json};

use super::{Failure, Lines, check_frame_rate, open_frames, print_lines};

/// Follows what moves in recorded frames: one JSON line a frame on standard output, pictures to a folder. Nothing is skipped.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// A folder of images, a .y4m file, or a video that ffmpeg decodes.
    input: PathBuf,
    /// The camera file (camera.toml). Pictures of a pinhole camera are tested as they are, all others as a panorama.
    #[arg(long, value_name = "FILE")]
    camera: PathBuf,
    /// Where pictures go: mask/NNNNNN.png of every frame, panorama/NNNNNN.jpg, and at the end background, objects, tracks,
    /// synopsis and gaze, and animation.png, which a browser plays: boxes and a window on each object.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Frames from one annotated picture to the next.
    #[arg(long, value_name = "N", default_value_t = 10)]
    every: u64,
    /// Frame rate, for a folder that does not say.
    #[arg(long, value_name = "HZ")]
    frame_rate_hz: Option<f64>,
    /// The camera is on a robot that may drive (a panoramic one is taken to be).
    #[arg(long)]
    may_drive: bool,
    /// Boxes of somebody else's detector instead of our motion stage, in MOT format (frame,id,left,top,width,height; frames from
    /// 1), in pixels of the picture that is tested: the panorama, or the pinhole's own.
    #[arg(long, value_name = "FILE", conflicts_with = "markers")]
    detections: Option<PathBuf>,
    /// Multiplies the sides of --detections, where they were made on a picture of another size.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, requires = "detections")]
    detections_scale: f64,
    /// What fellow robots wear (see `peers`): they are found and never taken for people. For panoramas.
    #[arg(long, value_name = "FILE")]
    markers: Option<PathBuf>,
}

/// Runs the command.
pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    check_frame_rate(arguments.frame_rate_hz)?;
    let camera = MountedCamera::load(&arguments.camera).map_err(Failure::usage)?;
    let mut source = open_frames(&arguments.input, &camera, arguments.frame_rate_hz)?;
    let mut pipeline = Offline::new(camera, arguments.may_drive, arguments.markers.as_deref())?;
    if let Some(path) = &arguments.detections {
        pipeline.detections = Some(read_detections(path, arguments.detections_scale, &pipeline.raster)?);
    }
    if let Some(dir) = &arguments.out {
        for name in ["mask", "panorama"] {
            let folder = dir.join(name);
            create_folder(&folder)?;
            remove_numbered(&folder)?;
        }
    }
    let mut job = Job { pipeline, arguments, progress: progress_bar(source.frames()) };
    print_lines(&arguments.input, source.as_mut(), &mut job)?;
    job.progress.finish_and_clear();
    match &arguments.out {
        Some(dir) => job.pipeline.write_last_pictures(dir),
        None => Ok(()),
    }
}

/// The stages with what is wanted of them.
struct Job<'a> {
    pipeline: Offline,
    arguments: &'a Arguments,
    progress: ProgressBar,
}

impl Lines for Job<'_> {
    fn of_frame(&mut self, index: u64, time_s: f64, frame: &Frame) -> Result<Value, Failure> {
        self.progress.inc(1);
        let change = self.pipeline.step(index, frame)?;
        if let Some(dir) = &self.arguments.out {
            self.pipeline.write_pictures(dir, index, self.arguments.every.max(1))?;
            self.pipeline.animate(time_s);
        }
        Ok(self.pipeline.line(index, time_s, &change))
    }

    /// Nothing is marked in it.
    fn of_bad_frame(&mut self, index: u64) -> Result<Value, Failure> {
        self.progress.inc(1);
        if let Some(dir) = &self.arguments.out {
            self.pipeline.write_mask(dir, index, vec![0; self.pipeline.raster.len()])?;
        }
        let Offline { motion, .. } = &self.pipeline;
        Ok(json!({ "motion": Value::Null, "alarm": Value::Null, "background": word(motion.state()), "objects": [] }))
    }
}

fn word(background: BackgroundState) -> &'static str {
    match background {
        BackgroundState::Suspended => "suspended",
        BackgroundState::Building => "building",
        BackgroundState::Ready => "ready",
    }
}

/// All stages without a clock.
struct Offline {
    camera: MountedCamera,
    /// `None`: the picture itself is tested.
    lut: Option<Lut>,
    raster: Raster,
    motion: MotionStage,
    tracker: Tracker,
    gallery: Gallery,
    animation: Animation,
    peers: Option<PeerDetector>,
    detections: Option<Detections>,
    /// Of the frame before, as in the agent.
    peer_bearings: Vec<PeerBearing>,
    tested: Vec<u8>,
    last_frame: Vec<u8>,
    tracks: Vec<TrackView>,
}

impl Offline {
    fn new(camera: MountedCamera, may_drive: bool, markers: Option<&Path>) -> Result<Self, Failure> {
        let panoramic = camera.camera().is_panoramic();
        let mut peers = None;
        let (lut, raster, view, valid) = if panoramic {
            let geometry = PanoramaGeometry::for_work(&camera).map_err(Failure::usage)?;
            if let Some(path) = markers {
                let grid = Grid::of(&geometry).ok_or_else(|| no_grid(path))?;
                peers = Some(super::peers::detector(&camera, grid, path)?);
            }
            let lut = Lut::panorama(&camera, &geometry);
            let raster = Raster { width: geometry.width() as usize, height: geometry.height() as usize, wraps: true };
            let valid: Vec<u8> = lut.valid().iter().map(|&v| u8::from(v)).collect();
            (Some(lut), raster, View::panorama(geometry, &camera), Some(valid))
        } else {
            if let Some(path) = markers {
                return Err(no_grid(path));
            }
            let [w, h] = camera.image_size_px().map(|n| n as usize);
            let valid = camera.mask().map(|m| m.tested.iter().map(|&t| u8::from(t)).collect());
            (None, Raster { width: w, height: h, wraps: false }, View::image(camera.clone()), valid)
        };
        let settings = MotionSettings {
            own_motion: panoramic || may_drive,
            upright_row: view.upright_row(),
            ..MotionSettings::default()
        };
        let motion = MotionStage::new(raster, valid.as_deref(), settings).map_err(Failure::usage)?;
        Ok(Self {
            camera,
            lut,
            raster,
            motion,
            tracker: Tracker::new(raster, view, TrackerSettings::default()),
            gallery: Gallery::new(raster),
            animation: Animation::default(),
            peers,
            detections: None,
            peer_bearings: Vec::new(),
            tested: vec![0; raster.len()],
            last_frame: Vec::new(),
            tracks: Vec::new(),
        })
    }

    fn step(&mut self, index: u64, frame: &Frame) -> Result<Change, Failure> {
        match &self.lut {
            Some(lut) => lut.unwarp(&frame.gray, &mut self.tested).map_err(Failure::job)?,
            None => self.tested.clone_from(&frame.gray),
        }
        self.last_frame.clone_from(&frame.gray);
        if let Some(detections) = &self.detections {
            let boxes = detections.of_frame(index);
            let change = self.motion.take_boxes(&self.tested, frame.capture, boxes).map_err(Failure::job)?;
            self.tracker.step_detections(&self.motion.scene(), frame.capture);
            self.tracks = self.tracker.tracks();
            self.gallery.record(&self.motion, &self.tracks);
            return Ok(change);
        }
        let change = self.motion.change(&self.tested, frame.capture).map_err(Failure::job)?;
        self.motion.extract();
        if change.background == BackgroundState::Ready {
            self.tracker.step(&self.motion.scene(), frame.capture, &self.peer_bearings);
            self.motion.learn(self.tracker.holds());
        } else {
            self.tracker.suspend(frame.capture);
        }
        if let Some(peers) = &mut self.peers {
            let found = peers.follow(&frame.gray, &self.tested, frame.capture);
            self.peer_bearings = found.iter().map(|p| PeerBearing::of(&p.to_sighting())).collect();
        }
        self.tracks = self.tracker.tracks();
        self.gallery.record(&self.motion, &self.tracks);
        Ok(change)
    }

    fn line(&self, index: u64, time_s: f64, change: &Change) -> Value {
        json!({
            "frame": index,
            "time_s": time_s,
            "motion": format!("{:?}", change.motion).to_lowercase(),
            "alarm": change.alarm.as_ref().map(ToString::to_string),
            "background": word(change.background),
            "objects": self.tracks.iter().map(object).collect::<Vec<_>>(),
        })
    }

    fn write_pictures(&self, dir: &Path, index: u64, every: u64) -> Result<(), Failure> {
        self.write_mask(dir, index, self.motion.scene().mask.iter().map(|&m| m * 255).collect())?;
        if index.is_multiple_of(every) {
            let picture = self.gallery.panorama(&self.tested, &self.tracks, self.tracker.view());
            let bytes = encode_jpeg(&picture, 85).map_err(Failure::job)?;
            write_file(&dir.join(format!("panorama/{index:06}.jpg")), &bytes)?;
        }
        Ok(())
    }

    fn write_mask(&self, dir: &Path, index: u64, mask: Vec<u8>) -> Result<(), Failure> {
        let path = dir.join(format!("mask/{index:06}.png"));
        image::GrayImage::from_raw(self.raster.width as u32, self.raster.height as u32, mask)
            .ok_or_else(|| Failure::job("the mask has another size than the picture"))?
            .save(&path)
            .map_err(|e| Failure::job(format!("{}: cannot write the mask: {e}", path.display())))
    }

    fn animate(&mut self, time_s: f64) {
        if self.animation.wants_next() {
            let frame = self.gallery.frame(&self.tested, &self.tracks, self.tracker.view());
            self.animation.add(&frame, time_s);
        } else {
            self.animation.skip();
        }
    }

    fn write_last_pictures(&self, dir: &Path) -> Result<(), Failure> {
        let pictures = [
            ("background.png", self.gallery.background(&self.motion)),
            ("objects.png", self.gallery.objects(&self.motion)),
            ("tracks.png", self.gallery.tracks(&self.motion)),
            ("synopsis.png", self.gallery.synopsis(&self.motion)),
            ("gaze.png", self.gallery.gaze(&self.last_frame, &self.camera, &self.tracks)),
        ];
        for (name, picture) in pictures {
            write_file(&dir.join(name), &encode_png(&picture).map_err(Failure::job)?)?;
        }
        if !self.animation.is_empty() {
            write_file(&dir.join("animation.png"), &self.animation.encode().map_err(Failure::job)?)?;
        }
        Ok(())
    }
}

fn read_detections(path: &Path, scale: f64, raster: &Raster) -> Result<Detections, Failure> {
    if !(scale > 0.0 && scale.is_finite()) {
        return Err(Failure::usage(format!("--detections-scale {scale}: a positive number was expected")));
    }
    let detections = Detections::read(path, scale).map_err(Failure::usage)?;
    if let Some(problem) = &detections.first_problem {
        tracing::warn!("{}: {} lines skipped, the first is {problem}", path.display(), detections.skipped);
    }
    let (width, height) = (raster.width as f64, raster.height as f64);
    let share = detections.share_inside(width, height);
    if share < 0.9 {
        return Err(Failure::usage(format!(
            "{}: {:.0} % of the boxes lie outside the picture of {width} x {height} pixels; were they made on one of another size \
             (--detections-scale)?",
            path.display(),
            100.0 * (1.0 - share)
        )));
    }
    Ok(detections)
}

fn no_grid(path: &Path) -> Failure {
    Failure::usage(format!("--markers {}: fellow robots are found in cylinder panoramas only", path.display()))
}

fn object(track: &TrackView) -> Value {
    let end = |e: ElevationEnd| match e {
        ElevationEnd::Seen => "seen",
        ElevationEnd::Cut => "cut",
        ElevationEnd::Hidden => "hidden",
    };
    let state = match track.state {
        TrackState::Visible => "visible",
        TrackState::Merged => "merged",
        TrackState::Hidden => "hidden",
    };
    json!({
        "track": track.id.0,
        "state": state,
        "class": format!("{:?}", track.class).to_lowercase(),
        "bearing_deg": track.bearing_rad.to_degrees(),
        "bearing_sigma_deg": track.bearing_sigma_rad.to_degrees(),
        "elevation_deg": track.extent.elevation_rad.map(f64::to_degrees),
        "ends": track.extent.ends.map(end),
        "box": [track.arc.start, track.rows[0], track.arc.width, track.rows[1] - track.rows[0] + 1],
        "area_px": track.area_px,
        "range_m": track.extent.range.map(|r| r.range_m),
        "range_sigma_m": track.extent.range.map(|r| r.sigma_m),
        "confidence": track.confidence,
    })
}

fn create_folder(path: &Path) -> Result<(), Failure> {
    std::fs::create_dir_all(path)
        .map_err(|e| Failure::job(format!("{}: cannot create the folder: {e}", path.display())))
}

/// Removes what an earlier, longer run left: pictures whose names are numbers.
fn remove_numbered(folder: &Path) -> Result<(), Failure> {
    let failed = |e: io::Error| Failure::job(format!("{}: cannot be cleared: {e}", folder.display()));
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        let stem = path.file_stem().and_then(|s| s.to_str()).unwrap_or_default();
        let is_picture = path.extension().is_some_and(|e| e == "png" || e == "jpg");
        if is_picture && stem.len() >= 6 && stem.bytes().all(|b| b.is_ascii_digit()) {
            std::fs::remove_file(&path).map_err(failed)?;
        }
    }
    Ok(())
}

fn write_file(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    std::fs::write(path, bytes).map_err(|e| Failure::job(format!("{}: cannot write: {e}", path.display())))
}

fn progress_bar(frames: Option<u64>) -> ProgressBar {
    if !io::stderr().is_terminal() || io::stdout().is_terminal() {
        return ProgressBar::hidden();
    }
    let bar = frames.map_or_else(ProgressBar::new_spinner, ProgressBar::new);
    let style = ProgressStyle::with_template("{bar:40} {pos}/{len} frames, {per_sec}, {eta} left");
    bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}
