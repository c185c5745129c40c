//! `camera.toml`: read, checked, turned into a [`MountedCamera`].
//!
//! Every wrong value is reported with the file, the line, the key, the value and what would be right; unknown keys are
//! errors, so that a misspelt one never falls back to a default in silence.

mod models;
mod raw;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use protocol::document::{Document, DocumentError};

use super::parameter::Design;
use super::{Camera, Mask, MountedCamera, Mounting, Timing};

pub use models::MODELS;

/// A `camera.toml` that was read and checked, but whose mask has not been read.
#[derive(Debug, Clone)]
pub struct CameraFile {
    document: Document,
    camera: Arc<dyn Camera>,
    mounting: Mounting,
    timing: Timing,
    mask_file: Option<PathBuf>,
}

impl CameraFile {
    /// Reads and checks a file.
    ///
    /// # Errors
    /// The file cannot be read, is no TOML, has unknown keys or values that make no camera, or names a model that this
    /// version does not support.
    pub fn read(path: &Path) -> Result<Self, DocumentError> {
        Self::check(Document::read(path)?)
    }

    /// Checks a text; `path` is for messages and relative masks.
    ///
    /// # Errors
    /// As [`CameraFile::read`].
    pub fn parse(text: &str, path: &Path) -> Result<Self, DocumentError> {
        Self::check(Document::from_text(path, text.to_owned()))
    }

    fn check(document: Document) -> Result<Self, DocumentError> {
        let raw::Checked { camera, mounting, timing, mask_file } = raw::parse(&document)?;
        Ok(Self { document, camera, mounting, timing, mask_file })
    }

    /// Reads the mask, if there is one, and puts the camera on its robot.
    ///
    /// # Errors
    /// The mask is missing, not a picture, or of another size than the camera's.
    pub fn mount(&self) -> Result<MountedCamera, DocumentError> {
        let mask = self.mask_file.as_deref().map(|file| self.read_mask(file)).transpose()?;
        Ok(MountedCamera::from_parts(self.camera.clone(), self.mounting, mask.map(Arc::new), self.timing))
    }

    fn read_mask(&self, file: &Path) -> Result<Mask, DocumentError> {
        let path = self.document.resolve(file);
        let error = |problem: String| self.document.invalid("mask.file", path.display(), problem);
        let picture = image::open(&path).map_err(|source| error(format!("cannot be used: {source}")))?.into_luma8();
        let [w, h] = self.camera.image_size_px();
        if picture.dimensions() != (w, h) {
            let (mw, mh) = picture.dimensions();
            return Err(error(format!("has {mw}x{mh} pixels, must have the picture's {w}x{h}")));
        }
        Ok(Mask { size_px: [w, h], tested: picture.into_raw().into_iter().map(|gray| gray > 0).collect() })
    }
}

/// The part of a `camera.toml` that describes the camera: model, size and the model's table, without a mounting.
#[expect(clippy::missing_panics_doc, clippy::expect_used, reason = "tables of numbers and names")]
pub fn camera_toml(camera: &dyn Camera) -> String {
    let mut text = format!("model = \"{}\"\nimage_size_px = {:?}\n", camera.model(), camera.image_size_px());
    let mut tables = toml::Table::new();
    tables.insert(camera.model().to_owned(), camera.table().into());
    if let Some(misalignment) = camera.misalignment() {
        tables.insert("misalignment".to_owned(), misalignment.table().into());
    }
    text.push_str(&toml::to_string(&tables).expect("a table is TOML"));
    text
}

impl MountedCamera {
    /// Reads a `camera.toml` with its mask.
    ///
    /// # Errors
    /// As [`CameraFile::read`] and [`CameraFile::mount`].
    pub fn load(path: &Path) -> Result<Self, DocumentError> {
        CameraFile::read(path)?.mount()
    }
}

#[cfg(test)]
mod tests;
