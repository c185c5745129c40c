//! A folder of images, sorted by name.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use protocol::time::Timestamp;

use super::times::{Listed, Rate, read_list, read_sequence};
use super::{CaptureError, CaptureOptions, FrameSource, picture_file::is_picture, read_gray};
use crate::agent::Frame;

/// Name of the list of capture times.
const LIST: &str = "frames.csv";
/// Name of the file with the frame rate.
const SEQUENCE: &str = "sequence.toml";
/// Where a recording keeps its images.
const SUBFOLDER: &str = "frames";

/// Images with capture times known beforehand.
#[derive(Debug)]
pub(super) struct ImageFolder {
    frames: std::vec::IntoIter<Listed>,
    total: u64,
    image_size_px: Option<[u32; 2]>,
    remarks: Vec<String>,
}

impl ImageFolder {
    /// Opens a folder of images, or of a recording with a subfolder `frames`. The list or rate may stand beside the
    /// images or beside the subfolder.
    pub(super) fn open(folder: &Path, options: CaptureOptions) -> Result<Self, CaptureError> {
        let mut images = pictures_in(folder)?;
        let mut places = vec![folder.to_path_buf()];
        let inner = folder.join(SUBFOLDER);
        if images.is_empty() && inner.is_dir() {
            images = pictures_in(&inner)?;
            places.insert(0, inner);
        }
        let find = |name: &str| places.iter().map(|place| place.join(name)).find(|path| path.is_file());
        if let Some(list) = find(LIST) {
            let frames = read_list(&list)?;
            let listed: BTreeSet<&Path> = frames.iter().map(|f| f.path.as_path()).collect();
            let unlisted = images.iter().filter(|path| !listed.contains(path.as_path())).count();
            let mut source = Self::new(frames, options);
            if unlisted > 0 {
                source.remarks.push(format!("{}: {unlisted} images of the folder are not listed", list.display()));
            }
            return Ok(source);
        }
        if images.is_empty() {
            return Err(CaptureError::Empty { folder: folder.into() });
        }
        let first = options.first_capture.unwrap_or(Timestamp(0));
        let rate = match (find(SEQUENCE), options.frame_rate_hz) {
            (Some(sequence), _) => read_sequence(&sequence)?,
            (None, Some(hz)) => Rate::new(first, hz).ok_or_else(|| CaptureError::NoTimes { folder: folder.into() })?,
            (None, None) => return Err(CaptureError::NoTimes { folder: folder.into() }),
        };
        let listed = |(i, path): (usize, PathBuf)| Listed { path, capture: rate.capture(i as u64) };
        Ok(Self::new(images.into_iter().enumerate().map(listed).collect(), options))
    }

    /// One image as a stream of one frame.
    pub(super) fn single(image: &Path, options: CaptureOptions) -> Self {
        let capture = options.first_capture.unwrap_or(Timestamp(0));
        Self::new(vec![Listed { path: image.into(), capture }], options)
    }

    fn new(frames: Vec<Listed>, options: CaptureOptions) -> Self {
        Self {
            total: frames.len() as u64,
            frames: frames.into_iter(),
            image_size_px: options.image_size_px,
            remarks: Vec::new(),
        }
    }
}

impl FrameSource for ImageFolder {
    fn next_frame(&mut self) -> Option<Result<Frame, CaptureError>> {
        let Listed { path, capture } = self.frames.next()?;
        Some(read_gray(&path, self.image_size_px).map(|picture| Frame {
            capture,
            width: picture.width,
            height: picture.height,
            gray: picture.gray,
        }))
    }

    fn skip_before(&mut self, capture: Timestamp) -> u64 {
        let past = self.frames.as_slice().iter().take_while(|listed| listed.capture < capture).count();
        if past > 0 {
            self.frames.nth(past - 1);
        }
        past as u64
    }

    fn frames(&self) -> Option<u64> {
        Some(self.total)
    }

    fn remarks(&self) -> &[String] {
        &self.remarks
    }
}

/// The images of a folder, sorted by name.
fn pictures_in(folder: &Path) -> Result<Vec<PathBuf>, CaptureError> {
    let error = |source| CaptureError::Read { path: folder.into(), source };
    let mut images = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(error)? {
        let path = entry.map_err(error)?.path();
        if is_picture(&path) && path.is_file() {
            images.push(path);
        }
    }
    images.sort();
    Ok(images)
}
