//! `camera.toml`: read, checked, turned into a [`MountedCamera`].
//!
//! Every wrong value is reported with the file, the key, the value and what would be right; unknown keys are errors, so
//! that a misspelt one never falls back to a default in silence.

mod raw;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::pal::ParameterError;
use super::{Camera, Mask, MountedCamera, Mounting, Timing};

/// The models this version can build.
pub const SUPPORTED_MODELS: [&str; 2] = ["pal", "pinhole"];

/// The models that `camera.toml` knows by name, supported or not.
const KNOWN_MODELS: [&str; 14] = [
    "pal",
    "pal-orthographic",
    "pal-single-viewpoint",
    "unified-sphere",
    "polynomial",
    "hyperboloidal",
    "paraboloidal",
    "ellipsoidal",
    "spherical",
    "conic",
    "pyramid",
    "fisheye",
    "pinhole",
    "mosaic",
];

/// A `camera.toml` that was read and checked, but whose mask has not been read.
#[derive(Debug, Clone)]
pub struct CameraFile {
    /// Where it came from; masks are relative to its folder.
    pub path: PathBuf,
    camera: Arc<dyn Camera>,
    mounting: Mounting,
    timing: Timing,
    mask_file: Option<PathBuf>,
}

/// What is wrong with a `camera.toml`.
#[derive(Debug, thiserror::Error)]
pub enum CameraFileError {
    /// The file cannot be read.
    #[error("{}: cannot read the camera file: {source}", file.display())]
    Read {
        /// The file.
        file: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Not TOML, an unknown key, a missing key, or a value of another type.
    #[error("{}: {message}", file.display())]
    Syntax {
        /// The file.
        file: PathBuf,
        /// Line, key and what was expected.
        message: String,
    },
    /// A model of the format that this version cannot build.
    #[error("{}: model = {model:?} is not supported by this version; supported: {}", file.display(), SUPPORTED_MODELS.join(", "))]
    Unsupported {
        /// The file.
        file: PathBuf,
        /// The model.
        model: String,
    },
    /// Not a model at all.
    #[error("{}: model = {model:?} is not a camera model; one of: {}", file.display(), KNOWN_MODELS.join(", "))]
    UnknownModel {
        /// The file.
        file: PathBuf,
        /// The value.
        model: String,
    },
    /// A value that cannot be.
    #[error("{}: {key} = {value}: must be {expected}", file.display())]
    Value {
        /// The file.
        file: PathBuf,
        /// Table and key.
        key: String,
        /// The value as given.
        value: String,
        /// What would be right.
        expected: String,
    },
    /// The mask cannot be used.
    #[error("{}: mask.file = {mask:?}: {reason}", file.display())]
    Mask {
        /// The camera file.
        file: PathBuf,
        /// The mask file.
        mask: PathBuf,
        /// Why.
        reason: String,
    },
}

impl CameraFile {
    /// Reads and checks a file.
    ///
    /// # Errors
    /// See [`CameraFileError`].
    pub fn read(path: &Path) -> Result<Self, CameraFileError> {
        let text =
            std::fs::read_to_string(path).map_err(|source| CameraFileError::Read { file: path.into(), source })?;
        Self::parse(&text, path)
    }

    /// Checks a text; `path` is for messages and relative masks.
    ///
    /// # Errors
    /// See [`CameraFileError`].
    pub fn parse(text: &str, path: &Path) -> Result<Self, CameraFileError> {
        raw::parse(text).map_err(|problem| problem.in_file(path)).map(|checked| Self {
            path: path.into(),
            camera: checked.camera,
            mounting: checked.mounting,
            timing: checked.timing,
            mask_file: checked.mask_file,
        })
    }

    /// Reads the mask, if there is one, and puts the camera on its robot.
    ///
    /// # Errors
    /// [`CameraFileError::Mask`] where the mask is missing, not a picture, or of another size than the camera's.
    pub fn mount(&self) -> Result<MountedCamera, CameraFileError> {
        let mask = self.mask_file.as_deref().map(|file| self.read_mask(file)).transpose()?;
        Ok(MountedCamera::from_parts(self.camera.clone(), self.mounting, mask.map(Arc::new), self.timing))
    }

    fn read_mask(&self, file: &Path) -> Result<Mask, CameraFileError> {
        let mask = self.path.parent().unwrap_or(Path::new("")).join(file);
        let error = |reason: String| CameraFileError::Mask { file: self.path.clone(), mask: mask.clone(), reason };
        let picture = image::open(&mask).map_err(|source| error(source.to_string()))?.into_luma8();
        let [w, h] = self.camera.image_size_px();
        if picture.dimensions() != (w, h) {
            let (mw, mh) = picture.dimensions();
            return Err(error(format!("is {mw}x{mh} pixels, must have the picture's {w}x{h}")));
        }
        Ok(Mask { size_px: [w, h], tested: picture.into_raw().into_iter().map(|gray| gray > 0).collect() })
    }
}

impl MountedCamera {
    /// Reads a `camera.toml` with its mask.
    ///
    /// # Errors
    /// See [`CameraFileError`].
    pub fn load(path: &Path) -> Result<Self, CameraFileError> {
        CameraFile::read(path)?.mount()
    }
}

/// A problem before the file's name is known to it.
#[derive(Debug)]
enum Problem {
    Syntax(String),
    Unsupported(String),
    UnknownModel(String),
    Value { key: String, value: String, expected: String },
}

impl Problem {
    fn value(key: &str, value: impl std::fmt::Debug, expected: impl Into<String>) -> Self {
        Self::Value { key: key.into(), value: format!("{value:?}"), expected: expected.into() }
    }

    fn parameter(table: &str, error: ParameterError) -> Self {
        Self::Value { key: format!("{table}.{}", error.key), value: error.value, expected: error.expected }
    }

    fn in_file(self, path: &Path) -> CameraFileError {
        let file = path.into();
        match self {
            Self::Syntax(message) => CameraFileError::Syntax { file, message },
            Self::Unsupported(model) => CameraFileError::Unsupported { file, model },
            Self::UnknownModel(model) => CameraFileError::UnknownModel { file, model },
            Self::Value { key, value, expected } => CameraFileError::Value { file, key, value, expected },
        }
    }
}

#[cfg(test)]
mod tests;
