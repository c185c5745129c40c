//! Where frames come from: folders of images, `.y4m` files, any video through `ffmpeg`, cameras.
//!
//! Problem: frames from files must carry the instant of their capture, never that of reading. Insight: every source
//! knows its times before the first pixel is decoded (a list, or a rate), so they are checked at opening, and what can
//! go wrong later is one frame at a time. A bad frame is an error *in* the stream, which goes on: whether to stop or to
//! skip and count is the caller's choice. Pacing is the caller's, too.
//!
//! Gray values: gray files as they are; colour images by Rec. 709 (0.2126 R + 0.7152 G + 0.0722 B); `.y4m` the luma plane
//! as it is; other video as `ffmpeg` converts it to 8-bit gray.

pub mod detections;
mod ffmpeg;
mod folder;
pub mod live;
mod picture_file;
mod times;
pub mod v4l;
mod y4m;

use std::path::{Path, PathBuf};

use protocol::document::DocumentError;
use protocol::time::Timestamp;

use crate::agent::Frame;
use crate::optics::Timing;

pub use picture_file::{GrayPicture, is_picture, read_gray};

/// A stream of frames in order of capture.
pub trait FrameSource: Send {
    /// The next frame, or what is wrong with it; `None` at the end. After an error the stream goes on with the frame
    /// after, and ends where there is none.
    fn next_frame(&mut self) -> Option<Result<Frame, CaptureError>>;

    /// Goes past frames captured before `capture` without decoding them, where the source can; how many.
    fn skip_before(&mut self, _capture: Timestamp) -> u64 {
        0
    }

    /// Frames in the whole stream, where that is known.
    fn frames(&self) -> Option<u64>;

    /// What somebody should know about the source although it works (files that no list names …).
    fn remarks(&self) -> &[String] {
        &[]
    }
}

/// How to read a source.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CaptureOptions {
    /// Width and height that every frame must have: the camera's.
    pub image_size_px: Option<[u32; 2]>,
    /// Frame rate, for a folder without `frames.csv` and `sequence.toml` and instead of a video's own.
    pub frame_rate_hz: Option<f64>,
    /// Capture of the first frame where the source does not say; the epoch by default.
    pub first_capture: Option<Timestamp>,
}

/// What is wrong with a source or one of its frames.
#[derive(Debug, thiserror::Error)]
pub enum CaptureError {
    /// No such file or folder, or it cannot be read.
    #[error("{}: {source}", path.display())]
    Read {
        /// File or folder.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A folder without frames.
    #[error("{}: no images (png, jpg, jpeg, bmp, pgm) in this folder", folder.display())]
    Empty {
        /// The folder.
        folder: PathBuf,
    },
    /// Frames without times.
    #[error(
        "{}: the frames have no capture times: put `frames.csv` (file,capture_ns) or `sequence.toml` (frame_rate_hz, \
         first_capture_ns) beside them", folder.display()
    )]
    NoTimes {
        /// The folder.
        folder: PathBuf,
    },
    /// `sequence.toml` is wrong.
    #[error(transparent)]
    Sequence(#[from] DocumentError),
    /// `frames.csv` is wrong.
    #[error("{}:{line}: {message}", path.display())]
    List {
        /// The file.
        path: PathBuf,
        /// Line, counted from 1.
        line: usize,
        /// The value, and what would be right.
        message: String,
    },
    /// An image that cannot be decoded.
    #[error("{}: cannot decode the picture: {message}", path.display())]
    Picture {
        /// The image.
        path: PathBuf,
        /// Why.
        message: String,
    },
    /// A frame of another size than the camera's.
    #[error("{what}: {}x{} pixels, but the camera's pictures have {}x{}", got[0], got[1], expected[0], expected[1])]
    Size {
        /// File, or stream and frame number.
        what: String,
        /// Its width and height.
        got: [u32; 2],
        /// The camera's.
        expected: [u32; 2],
    },
    /// A video stream that is broken or of a kind that is not understood.
    #[error("{}: {message}", path.display())]
    Stream {
        /// The video.
        path: PathBuf,
        /// What and where.
        message: String,
    },
    /// `ffmpeg` cannot be started.
    #[error("{}: not a folder, an image or a .y4m file, and {program} cannot be started to decode it ({source}): install ffmpeg", path.display())]
    NoFfmpeg {
        /// The video.
        path: PathBuf,
        /// What was tried.
        program: String,
        /// Why.
        source: std::io::Error,
    },
    /// A camera that cannot be opened, or is gone.
    #[error("{}: {message}", path.display())]
    Camera {
        /// The device.
        path: PathBuf,
        /// Why.
        message: String,
    },
}

/// Opens a folder of images, one image, a `.y4m` file or a video.
///
/// # Errors
/// What makes the source as a whole unusable.
pub fn open(input: &Path, options: CaptureOptions) -> Result<Box<dyn FrameSource>, CaptureError> {
    if is_camera(input) {
        return Ok(Box::new(open_camera(input, options, Timing::default())?));
    }
    let metadata = std::fs::metadata(input).map_err(|source| CaptureError::Read { path: input.into(), source })?;
    if metadata.is_dir() {
        return Ok(Box::new(folder::ImageFolder::open(input, options)?));
    }
    if is_picture(input) {
        return Ok(Box::new(folder::ImageFolder::single(input, options)));
    }
    let is_y4m = input.extension().is_some_and(|e| e.eq_ignore_ascii_case("y4m"));
    if is_y4m {
        let file = std::fs::File::open(input).map_err(|source| CaptureError::Read { path: input.into(), source })?;
        return Ok(Box::new(y4m::Y4m::open(std::io::BufReader::new(file), input, options)?));
    }
    Ok(Box::new(ffmpeg::Ffmpeg::open("ffmpeg", input, options)?))
}

/// Whether an input is a camera.
pub fn is_camera(input: &Path) -> bool {
    input.starts_with("/dev")
}

/// Opens a camera (`/dev/video0`). `timing` is its camera file's.
///
/// # Errors
/// It is not there, or has no mode of the size.
pub fn open_camera(input: &Path, options: CaptureOptions, timing: Timing) -> Result<live::LiveCamera, CaptureError> {
    let CaptureOptions { image_size_px, frame_rate_hz, .. } = options;
    let driver = v4l::V4l { path: input.into(), image_size_px, frame_rate_hz };
    live::LiveCamera::open(input.display().to_string(), Box::new(driver), timing)
        .map_err(|fault| CaptureError::Camera { path: input.into(), message: fault.to_string() })
}

#[cfg(test)]
mod tests;
