//! How long one frame takes: the agent's own stages with its default settings, on frames in memory, stage by stage.
//!
//! What runs is what `robot_agent::agent` runs between a frame and its observation for a robot without fellows: unwarp, change
//! (own motion, background), regions with the change gate, tracks, learning, and what pictures of the past need. Frames are
//! read before the clock starts, the first ones warm caches and the background up. Beside each stage stands its floor: the
//! bytes that it must at least move, at the speed at which this machine copies a buffer of that size.

mod floor;
mod frames;

use std::time::Instant;

use protocol::time::Timestamp;
use robot_agent::motion::{BackgroundState, MotionSettings, MotionStage, Raster};
use robot_agent::panorama::{PanoramaGeometry, Projection, Watch};
use robot_agent::picture::Gallery;
use robot_agent::tracking::{Tracker, TrackerSettings, View};
use serde::Serialize;

use crate::score::statistics::percentile;

pub use floor::Floors;
pub use frames::{Frames, FramesError};

/// The stages in the order of their work.
pub const STAGES: [&str; 6] = ["unwarp", "change", "extract", "track", "learn", "record"];

/// What a run measured.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// Frames that were timed.
    pub frames: usize,
    /// Camera and panorama, pixels.
    pub camera_px: [u32; 2],
    /// Panorama, pixels.
    pub panorama_px: [u32; 2],
    /// Vector instructions that the kernels used.
    pub kernels: &'static str,
    /// Whole frame, µs.
    pub total_us_median: f64,
    /// Whole frame, µs.
    pub total_us_p99: f64,
    /// A stage each, µs.
    pub us_median: PerStage,
    /// What the bytes alone would take, µs.
    pub floor_us: PerStage,
    /// Their sum.
    pub floor_total_us: f64,
    /// Objects that move, a frame.
    pub det_mean: f64,
    /// Published tracks, a frame.
    pub tracks_mean: f64,
    /// Different tracks that were published.
    pub track_ids: usize,
    /// Exact median of 30 panoramas, µs.
    pub median_of_30_us: f64,
    /// Bytes that the agent holds for pictures, tables and background.
    pub memory_bytes: usize,
}

/// A value a stage.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
#[allow(missing_docs)]
pub struct PerStage {
    pub unwarp: f64,
    pub change: f64,
    pub extract: f64,
    pub track: f64,
    pub learn: f64,
    pub record: f64,
}

impl PerStage {
    fn from_array([unwarp, change, extract, track, learn, record]: [f64; 6]) -> Self {
        Self { unwarp, change, extract, track, learn, record }
    }

    /// In the order of [`STAGES`].
    pub fn to_array(self) -> [f64; 6] {
        [self.unwarp, self.change, self.extract, self.track, self.learn, self.record]
    }
}

/// Why there is no report.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    /// The frames.
    #[error(transparent)]
    Frames(#[from] FramesError),
    /// The agent's stages.
    #[error("{0}")]
    Agent(String),
    /// Nothing is left to be timed.
    #[error("{frames} frames of which {warm} warm up: nothing is left to be timed")]
    TooFew {
        /// There are.
        frames: usize,
        /// Not timed.
        warm: usize,
    },
}

/// Times every frame after the first `warm` ones.
///
/// # Errors
/// Frames that the agent cannot work on, or none left.
pub fn run(frames: &Frames, warm: usize) -> Result<Report, BenchError> {
    if frames.len() <= warm {
        return Err(BenchError::TooFew { frames: frames.len(), warm });
    }
    let [width, height] = frames.lut.size_px();
    let raster = Raster { width: width as usize, height: height as usize, wraps: true };
    let agent = |error: &dyn std::fmt::Display| BenchError::Agent(error.to_string());
    let elevation = [-15f64, 20.0].map(f64::to_radians); // the header does not say; only bearings are used
    let geometry = PanoramaGeometry::new(width, height, Projection::Cylinder, elevation).map_err(|e| agent(&e))?;
    let valid: Vec<u8> = frames.lut.valid().iter().map(|&v| u8::from(v)).collect();
    let mut motion = MotionStage::new(raster, Some(&valid), MotionSettings::default()).map_err(|e| agent(&e))?;
    let mut tracker = Tracker::new(raster, View::uncalibrated(geometry), TrackerSettings::default());
    let mut watch = Watch::new(&frames.lut);
    let mut gallery = Gallery::new(raster);
    let mut panorama = vec![0u8; raster.len()];

    let mut laps: [Vec<f64>; STAGES.len()] = Default::default();
    let mut totals = Vec::new();
    let (mut detections, mut published) = (0usize, 0usize);
    let mut ids = std::collections::BTreeSet::new();
    for (i, picture) in frames.iter().enumerate() {
        let capture = Timestamp::from_secs_f64(1.0 + i as f64 / frames.rate_hz);
        let start = Instant::now();
        let mut lap = [0.0; STAGES.len()];
        let mut last = start;
        let mut done = |stage: usize| {
            let now = Instant::now();
            lap[stage] = (now - last).as_secs_f64() * 1e6;
            last = now;
        };
        watch.unwarp(&frames.lut, picture, motion.next_drawing(false)).map_err(|e| agent(&e))?;
        done(0);
        let change = motion.change_drawn(capture);
        done(1);
        motion.extract();
        done(2);
        if change.background == BackgroundState::Ready {
            tracker.step(&motion.scene(), capture, &[]);
        } else {
            tracker.suspend(capture);
        }
        let tracks = tracker.tracks();
        done(3);
        motion.learn(tracker.holds());
        done(4);
        gallery.record(&motion, &tracks);
        done(5);
        let total = (last - start).as_secs_f64() * 1e6;
        if i < warm {
            continue;
        }
        totals.push(total);
        for (all, lap) in laps.iter_mut().zip(lap) {
            all.push(lap);
        }
        detections += motion.scene().objects.iter().filter(|o| o.moves && !o.is_ghost()).count();
        published += tracks.len();
        ids.extend(tracks.iter().map(|t| t.id));
    }
    let n = totals.len();
    let floors = Floors::measure(frames.lut.source_size_px(), raster);
    Ok(Report {
        frames: n,
        camera_px: frames.lut.source_size_px(),
        panorama_px: [width, height],
        kernels: robot_agent::motion::kernel::level(),
        total_us_median: quantile(&totals, 0.5),
        total_us_p99: quantile(&totals, 0.99),
        us_median: PerStage::from_array(laps.map(|l| quantile(&l, 0.5))),
        floor_total_us: floors.stages.to_array().iter().sum(),
        floor_us: floors.stages,
        det_mean: detections as f64 / n as f64,
        tracks_mean: published as f64 / n as f64,
        track_ids: ids.len(),
        median_of_30_us: median_of_30(frames, &mut panorama).map_err(|e| agent(&e))?,
        memory_bytes: motion.memory_bytes() + frames.lut.memory_bytes() + watch.memory_bytes(),
    })
}

/// The exact median of 30 panoramas spread over the frames, the median of ten times.
fn median_of_30(frames: &Frames, out: &mut [u8]) -> Result<f64, robot_agent::panorama::UnwarpError> {
    let step = (frames.len() / 30).max(1);
    let mut stack = Vec::new();
    for i in 0..30 {
        let Some(picture) = frames.iter().nth(i * step % frames.len()) else { break };
        frames.lut.unwarp(picture, out)?;
        stack.push(out.to_vec());
    }
    let stack: Vec<&[u8]> = stack.iter().map(Vec::as_slice).collect();
    let times: Vec<f64> = (0..10)
        .map(|_| {
            let start = Instant::now();
            robot_agent::motion::kernel::median(&stack, out);
            start.elapsed().as_secs_f64() * 1e6
        })
        .collect();
    Ok(quantile(&times, 0.5))
}

/// [`percentile`]; 0 where nothing was measured.
fn quantile(values: &[f64], share: f64) -> f64 {
    percentile(values, share).unwrap_or(0.0)
}
