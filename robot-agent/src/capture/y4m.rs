//! YUV4MPEG2 streams, 8 bits a sample: the luma plane of each frame.
//!
//! ```text
//! YUV4MPEG2 W768 H576 F10:1 Ip A1:1 C420jpeg\n
//! FRAME\n  luma W·H  chroma …
//! FRAME\n  …
//! ```
//! Source: the yuv4mpeg(5) manual page.

use std::io::{BufRead, ErrorKind, Read};
use std::path::{Path, PathBuf};

use protocol::time::Timestamp;

use super::times::Rate;
use super::{CaptureError, CaptureOptions, FrameSource};
use crate::agent::Frame;

/// A header longer than this is not one.
const MAX_HEADER_BYTES: u64 = 4096;
/// Pictures larger than this on a side are taken for a damaged header.
const MAX_SIDE_PX: u32 = 16_384;

/// A stream of frames at a constant rate.
#[derive(Debug)]
pub(super) struct Y4m<R> {
    input: R,
    path: PathBuf,
    size_px: [u32; 2],
    chroma_bytes: u64,
    rate: Rate,
    expected_size_px: Option<[u32; 2]>,
    next: u64,
    ended: bool,
}

impl<R: BufRead> Y4m<R> {
    /// Reads the header; `path` is for messages.
    pub(super) fn open(mut input: R, path: &Path, options: CaptureOptions) -> Result<Self, CaptureError> {
        let error = |message: String| CaptureError::Stream { path: path.into(), message };
        let line = read_line(&mut input).map_err(|source| CaptureError::Read { path: path.into(), source })?;
        let header = line.ok_or_else(|| error("is empty".into()))?;
        let mut words = header.split_ascii_whitespace();
        if words.next() != Some("YUV4MPEG2") {
            return Err(error("does not begin with YUV4MPEG2: not a y4m stream".into()));
        }
        let (mut width, mut height, mut frame_rate_hz, mut colour) = (0, 0, options.frame_rate_hz, "420jpeg");
        for word in words {
            let wrong = || error(format!("header field {word:?} cannot be read"));
            match word.split_at_checked(1) {
                Some(("W", value)) => width = value.parse().map_err(|_| wrong())?,
                Some(("H", value)) => height = value.parse().map_err(|_| wrong())?,
                Some(("F", value)) => frame_rate_hz = frame_rate_hz.or(Some(ratio(value).ok_or_else(wrong)?)),
                Some(("C", value)) => colour = value,
                _ => {}
            }
        }
        if !(1..=MAX_SIDE_PX).contains(&width) || !(1..=MAX_SIDE_PX).contains(&height) {
            return Err(error(format!("{width}x{height} pixels: each side must be from 1 to {MAX_SIDE_PX}")));
        }
        let chroma_bytes = chroma_bytes(colour, u64::from(width), u64::from(height)).ok_or_else(|| {
            error(format!("colour format C{colour} is not understood: one of mono, 420, 411, 422, 444 with 8 bits"))
        })?;
        let rate = frame_rate_hz.and_then(|hz| Rate::new(options.first_capture.unwrap_or(Timestamp(0)), hz));
        let rate = rate.ok_or_else(|| error("no frame rate (F) in the header: the frames have no times".into()))?;
        let expected_size_px = options.image_size_px;
        let size_px = [width, height];
        Ok(Self { input, path: path.into(), size_px, chroma_bytes, rate, expected_size_px, next: 0, ended: false })
    }

    /// Frames read or tried so far.
    pub(super) fn position(&self) -> u64 {
        self.next
    }

    fn read_frame(&mut self) -> Result<Option<Vec<u8>>, String> {
        let number = self.next;
        let line = read_line(&mut self.input).map_err(|e| format!("frame {number}: {e}"))?;
        let Some(line) = line else { return Ok(None) };
        if line.split_ascii_whitespace().next() != Some("FRAME") {
            return Err(format!("frame {number} does not begin with FRAME: the stream is damaged"));
        }
        let luma_bytes = u64::from(self.size_px[0]) * u64::from(self.size_px[1]);
        let mut luma = Vec::with_capacity(luma_bytes as usize);
        let mut read = self.input.by_ref().take(luma_bytes).read_to_end(&mut luma).map(|n| n as u64);
        if let Ok(n) = read {
            let skipped = std::io::copy(&mut self.input.by_ref().take(self.chroma_bytes), &mut std::io::sink());
            read = skipped.map(|m| n + m);
        }
        match read {
            Ok(n) if n == luma_bytes + self.chroma_bytes => Ok(Some(luma)),
            Ok(n) => Err(format!("frame {number} is truncated: {n} of {} bytes", luma_bytes + self.chroma_bytes)),
            Err(e) => Err(format!("frame {number}: {e}")),
        }
    }
}

impl<R: BufRead + Send> FrameSource for Y4m<R> {
    fn next_frame(&mut self) -> Option<Result<Frame, CaptureError>> {
        if self.ended {
            return None;
        }
        let gray = match self.read_frame() {
            Ok(gray) => gray,
            Err(message) => {
                // The place of the next frame is lost with this one.
                self.ended = true;
                return Some(Err(CaptureError::Stream { path: self.path.clone(), message }));
            }
        };
        let Some(gray) = gray else {
            self.ended = true;
            return None;
        };
        let number = self.next;
        self.next += 1;
        let [width, height] = self.size_px;
        if let Some(expected) = self.expected_size_px.filter(|expected| *expected != self.size_px) {
            let what = format!("{}, frame {number}", self.path.display());
            return Some(Err(CaptureError::Size { what, got: self.size_px, expected }));
        }
        Some(Ok(Frame { capture: self.rate.capture(number), width, height, gray }))
    }

    fn frames(&self) -> Option<u64> {
        None
    }
}

/// A line without its end; `None` at the end of the stream.
fn read_line(input: &mut impl BufRead) -> std::io::Result<Option<String>> {
    let mut bytes = Vec::new();
    input.by_ref().take(MAX_HEADER_BYTES).read_until(b'\n', &mut bytes)?;
    if bytes.is_empty() {
        return Ok(None);
    }
    if bytes.pop() != Some(b'\n') {
        return Err(std::io::Error::new(ErrorKind::InvalidData, "a header line without an end"));
    }
    String::from_utf8(bytes)
        .map(Some)
        .map_err(|_| std::io::Error::new(ErrorKind::InvalidData, "a header that is no text"))
}

/// `a:b` as a number.
fn ratio(text: &str) -> Option<f64> {
    let (numerator, denominator) = text.split_once(':')?;
    let value = numerator.parse::<u32>().ok().map(f64::from)? / denominator.parse::<u32>().ok().map(f64::from)?;
    (value.is_finite() && value > 0.0).then_some(value)
}

/// Bytes after the luma plane of a frame; `None` for formats with more than 8 bits and unknown ones.
fn chroma_bytes(colour: &str, width: u64, height: u64) -> Option<u64> {
    let half = |n: u64| n.div_ceil(2);
    Some(match colour {
        "mono" => 0,
        "420" | "420jpeg" | "420mpeg2" | "420paldv" => 2 * half(width) * half(height),
        "411" => 2 * width.div_ceil(4) * height,
        "422" => 2 * half(width) * height,
        "444" => 2 * width * height,
        "444alpha" => 3 * width * height,
        _ => return None,
    })
}
