//! Calibrations of other tools.
//!
//! | tool | file | models |
//! |---|---|---|
//! | OCamCalib | `calib_results.txt` | polynomial |
//! | OpenCV's `omnidir` | YAML with `camera_matrix`, `distortion_coefficients`, `xi` | unified sphere |
//! | Kalibr | `camchain.yaml` | unified sphere (`omni`), fisheye (`pinhole` with `equi`), pinhole (`radtan`, `none`) |
//!
//! A camera of another model than the file can say is converted, and the distance that remains is told.

mod kalibr;
mod ocamcalib;
mod opencv;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::optics::{Camera, ParameterError};

/// Larger files are taken for a mistake.
const MAX_BYTES: u64 = 1 << 20;

/// Whose file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Tool {
    /// `calib_results.txt`.
    OCamCalib,
    /// OpenCV's `omnidir`, YAML.
    OpenCv,
    /// `camchain.yaml`.
    Kalibr,
}

/// A camera of another tool.
#[derive(Debug, Clone)]
pub struct Imported {
    /// The camera.
    pub camera: Arc<dyn Camera>,
    /// Whose file it was.
    pub tool: Tool,
    /// What a reader should know: an inverse that differs, distortion that was left out.
    pub remarks: Vec<String>,
}

/// A file for another tool.
#[derive(Debug, Clone)]
pub struct Exported {
    /// Its text.
    pub text: String,
    /// Largest distance between the camera and what the file says, px; 0 where the model is the same.
    pub worst_px: f64,
    /// Rms of that distance, px.
    pub rms_px: f64,
}

/// Why a file is no camera, or a camera cannot be written to one.
#[derive(Debug, thiserror::Error)]
pub enum FormatError {
    /// It cannot be read.
    #[error("{path}: cannot be read: {source}", path = path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// Not the format it seems to be.
    #[error("{path}: {reason}", path = path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What is wrong and what would be right.
        reason: String,
    },
    /// A camera the tool has no words for.
    #[error("a {model} camera cannot be written for {tool}: {reason}")]
    NoWords {
        /// The camera's model.
        model: String,
        /// The tool.
        tool: &'static str,
        /// Why.
        reason: String,
    },
}

impl Tool {
    fn name(self) -> &'static str {
        match self {
            Self::OCamCalib => "OCamCalib",
            Self::OpenCv => "OpenCV's omnidir",
            Self::Kalibr => "Kalibr",
        }
    }
}

/// Reads a file of any of the tools; what it contains decides whose it is.
///
/// # Errors
/// It cannot be read, is of none of the tools, or describes no camera; the message names file, key and value.
pub fn import(path: &Path) -> Result<Imported, FormatError> {
    let unreadable = |source| FormatError::Unreadable { path: path.into(), source };
    let bytes = std::fs::metadata(path).map_err(unreadable)?.len();
    if bytes > MAX_BYTES {
        let message = format!("{bytes} bytes; a calibration has at most {MAX_BYTES}");
        return Err(unreadable(std::io::Error::new(std::io::ErrorKind::FileTooLarge, message)));
    }
    let text = std::fs::read_to_string(path).map_err(unreadable)?;
    parse(&text).map_err(|reason| FormatError::Malformed { path: path.into(), reason })
}

fn parse(text: &str) -> Result<Imported, String> {
    let has_key = |key: &str| text.lines().any(|line| line.trim_start().starts_with(key));
    if has_key("camera_model:") {
        return kalibr::parse(text);
    }
    if has_key("xi:") || has_key("%YAML") {
        return opencv::parse(text);
    }
    if text.lines().any(|line| line.starts_with('#')) {
        return ocamcalib::parse(text);
    }
    Err("neither OCamCalib's calib_results.txt (with its # lines), nor OpenCV's YAML (with xi), nor Kalibr's camchain (with \
         camera_model)"
        .into())
}

/// The text of a camera for another tool.
///
/// # Errors
/// The tool has no model that comes near the camera.
pub fn export(camera: &dyn Camera, tool: Tool) -> Result<Exported, FormatError> {
    let exported = match tool {
        Tool::OCamCalib => ocamcalib::write(camera),
        Tool::OpenCv => opencv::write(camera),
        Tool::Kalibr => kalibr::write(camera),
    };
    exported.map_err(|reason| FormatError::NoWords { model: camera.model().into(), tool: tool.name(), reason })
}

/// The value of one of the camera's numbers.
fn number(camera: &dyn Camera, name: &str) -> f64 {
    camera.parameters().iter().find(|p| p.name == name).map_or(0.0, |p| p.value)
}

fn numbers<const N: usize>(camera: &dyn Camera, key: &str) -> [f64; N] {
    std::array::from_fn(|i| number(camera, &format!("{key}[{i}]")))
}

fn parameter(error: &ParameterError) -> String {
    error.to_string()
}

/// The camera in the first of the kinds that is its own, or the nearest match of the last variant of `kind`.
fn in_model(
    camera: &dyn Camera,
    kind: super::candidate::Kind,
    model: &str,
) -> Result<super::conversion::Conversion, String> {
    if camera.model() == model && camera.misalignment().is_none() {
        let values: Vec<f64> = camera.parameters().iter().map(|p| p.value).collect();
        let same = camera.with_values(&values).map_err(|e| parameter(&e))?;
        return Ok(super::conversion::Conversion { camera: same, rms_px: 0.0, worst_px: 0.0 });
    }
    let centre: [f64; 2] = numbers(camera, "centre_px");
    let candidates = kind.candidates(camera.image_size_px(), Some(centre)).map_err(|e| parameter(&e))?;
    candidates
        .iter()
        .filter_map(|candidate| super::conversion::convert(camera, candidate))
        .min_by(|a, b| a.rms_px.total_cmp(&b.rms_px))
        .ok_or_else(|| format!("no {model} camera sees what it sees"))
}

#[cfg(test)]
mod tests;
