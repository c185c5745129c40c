//! Frames in memory: a file of raw 8-bit gray pictures one after another, and beside it `FILE.json` with their sizes and the ring's
//! geometry.

use std::path::{Path, PathBuf};

use nalgebra::Vector2;
use robot_agent::panorama::Lut;
use serde::Deserialize;

/// Why frames cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum FramesError {
    /// A file cannot be read.
    #[error("{}: cannot be read: {source}", path.display())]
    Read {
        /// Which.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The header is no such header.
    #[error("{}: {source}", path.display())]
    Header {
        /// Which.
        path: PathBuf,
        /// What is wrong where.
        source: serde_json::Error,
    },
    /// A value that cannot be.
    #[error("{}: {key} = {value}: {wanted}", path.display())]
    Value {
        /// Which file.
        path: PathBuf,
        /// Which key.
        key: &'static str,
        /// What it says.
        value: String,
        /// What would be right.
        wanted: &'static str,
    },
}

/// `FILE.json`; what else it holds (truth boxes, the seed) is not needed here.
#[derive(Debug, Deserialize)]
struct Header {
    frames: usize,
    fps: f64,
    geometry: Ring,
}

/// The ring in the picture. Column x of the panorama lies at the angle 2πx/`cyl_w`, row y at the radius Σ `poly`ₖ Rᵏ with
/// R = `cyl_h` − 1 − y, round (`cx`, `cy`); pixels, centres at integers.
#[derive(Debug, Deserialize)]
struct Ring {
    cam_w: usize,
    cam_h: usize,
    cyl_w: usize,
    cyl_h: usize,
    cx: f64,
    cy: f64,
    poly: Vec<f64>,
}

/// Pictures in memory and how they are unwarped.
#[derive(Debug)]
pub struct Frames {
    pixels: Vec<u8>,
    picture_px: usize,
    /// Frames a second.
    pub rate_hz: f64,
    /// From the panorama to the picture.
    pub lut: Lut,
}

/// Largest side of a picture or a panorama.
const MAX_SIDE_PX: usize = 16_384;

impl Frames {
    /// Reads `file` and `file.json`; at most `limit` frames.
    ///
    /// # Errors
    /// A file that cannot be read, a header with values that cannot be, fewer bytes than it announces.
    pub fn read(file: &Path, limit: Option<usize>) -> Result<Self, FramesError> {
        let mut header_path = file.as_os_str().to_owned();
        header_path.push(".json");
        let path = PathBuf::from(header_path);
        let text = std::fs::read_to_string(&path).map_err(|source| FramesError::Read { path: path.clone(), source })?;
        let header: Header =
            serde_json::from_str(&text).map_err(|source| FramesError::Header { path: path.clone(), source })?;
        header.check(&path)?;
        let Header { frames, fps, geometry } = header;
        let picture_px = geometry.cam_w * geometry.cam_h;
        let frames = limit.map_or(frames, |limit| frames.min(limit));
        let pixels = read_start(file, frames, picture_px)?;
        Ok(Self { pixels, picture_px, rate_hz: fps, lut: geometry.lut() })
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.pixels.len() / self.picture_px
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.pixels.is_empty()
    }

    /// One after the other.
    pub fn iter(&self) -> impl Iterator<Item = &[u8]> {
        self.pixels.chunks_exact(self.picture_px)
    }
}

impl Header {
    fn check(&self, path: &Path) -> Result<(), FramesError> {
        let wrong = |key, value: String, wanted| Err(FramesError::Value { path: path.to_owned(), key, value, wanted });
        let ring = &self.geometry;
        for (key, side) in [("cam_w", ring.cam_w), ("cam_h", ring.cam_h), ("cyl_w", ring.cyl_w), ("cyl_h", ring.cyl_h)]
        {
            if !(16..=MAX_SIDE_PX).contains(&side) {
                return wrong(key, side.to_string(), "16 to 16384 pixels");
            }
        }
        if !(self.fps > 0.0 && self.fps <= 1000.0) {
            return wrong("fps", self.fps.to_string(), "above 0 and at most 1000 frames a second");
        }
        if self.frames == 0 {
            return wrong("frames", "0".to_owned(), "at least one");
        }
        if ring.poly.is_empty() || !ring.poly.iter().chain([&ring.cx, &ring.cy]).all(|v| v.is_finite()) {
            return wrong(
                "poly",
                format!("{:?}", ring.poly),
                "the finite coefficients of the radius of a row, ascending",
            );
        }
        Ok(())
    }
}

impl Ring {
    fn lut(&self) -> Lut {
        let size = |n: usize| n as u32;
        Lut::from_map([size(self.cyl_w), size(self.cyl_h)], [size(self.cam_w), size(self.cam_h)], |u, v| {
            let row = (self.cyl_h - 1) as f64 - f64::from(v);
            let radius = self.poly.iter().rev().fold(0.0, |sum, c| sum * row + c);
            let (sin, cos) = (std::f64::consts::TAU * f64::from(u) / self.cyl_w as f64).sin_cos();
            Some(Vector2::new(self.cx + radius * cos, self.cy + radius * sin))
        })
    }
}

fn read_start(file: &Path, frames: usize, picture_px: usize) -> Result<Vec<u8>, FramesError> {
    use std::io::Read;
    let read = |source| FramesError::Read { path: file.to_owned(), source };
    let opened = std::fs::File::open(file).map_err(read)?;
    let there = opened.metadata().map_err(read)?.len();
    let wanted = frames as u64 * picture_px as u64;
    if there < wanted {
        return Err(FramesError::Value {
            path: file.to_owned(),
            key: "size",
            value: format!("{there} bytes"),
            wanted: "as many bytes as the header's frames have pixels",
        });
    }
    let mut pixels = Vec::new();
    opened.take(wanted).read_to_end(&mut pixels).map_err(read)?;
    Ok(pixels)
}
