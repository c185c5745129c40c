//! When the frames of a folder were captured: `frames.csv` or `sequence.toml`.

use std::path::{Path, PathBuf};

use protocol::document::Document;
use protocol::time::Timestamp;
use serde::Deserialize;

use super::CaptureError;

/// A frame of a list.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Listed {
    pub(super) path: PathBuf,
    pub(super) capture: Timestamp,
}

/// Equally spaced frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Rate {
    pub(super) first: Timestamp,
    pub(super) period_ns: f64,
}

impl Rate {
    /// A rate that can be: `None` for 0, negative, non-finite and absurd ones.
    pub(super) fn new(first: Timestamp, frame_rate_hz: f64) -> Option<Self> {
        (frame_rate_hz > 1e-6 && frame_rate_hz < 1e6).then(|| Self { first, period_ns: 1e9 / frame_rate_hz })
    }

    /// Capture of frame `index`, counted from 0.
    pub(super) fn capture(&self, index: u64) -> Timestamp {
        Timestamp(self.first.0.saturating_add((index as f64 * self.period_ns).round() as u64))
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Sequence {
    frame_rate_hz: f64,
    #[serde(default)]
    first_capture_ns: u64,
}

/// Reads `sequence.toml`.
pub(super) fn read_sequence(path: &Path) -> Result<Rate, CaptureError> {
    let document = Document::read(path)?;
    let sequence: Sequence = document.parse()?;
    let rate = Rate::new(Timestamp(sequence.first_capture_ns), sequence.frame_rate_hz);
    let hz = sequence.frame_rate_hz;
    rate.ok_or_else(|| document.invalid("frame_rate_hz", hz, "must be a positive rate in Hz").into())
}

/// Reads `frames.csv`: a header `file,capture_ns`, then a line a frame in order of capture; files are relative to the
/// list's folder and must exist. Lines that are blank or start with # are skipped.
pub(super) fn read_list(path: &Path) -> Result<Vec<Listed>, CaptureError> {
    let text = std::fs::read_to_string(path).map_err(|source| CaptureError::Read { path: path.into(), source })?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let error = |number: usize, message: String| CaptureError::List { path: path.into(), line: number, message };
    let mut frames: Vec<Listed> = Vec::new();
    // Spreadsheets begin a text with a byte order mark.
    let lines = text.trim_start_matches('\u{feff}').lines().enumerate().map(|(i, line)| (i + 1, line.trim()));
    let mut lines = lines.filter(|(_, line)| !line.is_empty() && !line.starts_with('#'));
    match lines.next() {
        Some((_, header)) if header.split(',').map(str::trim).eq(["file", "capture_ns"]) => {}
        Some((number, header)) => return Err(error(number, format!("{header:?}: the header must be file,capture_ns"))),
        None => return Err(error(1, "the list is empty: file,capture_ns and a line a frame are missing".into())),
    }
    for (number, line) in lines {
        let wrong = || {
            error(
                number,
                format!("{line:?}: must be a file's name and its capture in ns, like 000001.png,1700000000000000000"),
            )
        };
        let (file, capture) = line.rsplit_once(',').ok_or_else(wrong)?;
        let capture = Timestamp(capture.trim().parse().map_err(|_| wrong())?);
        let file = file.trim().trim_matches('"');
        let frame = Listed { path: folder.join(file), capture };
        if file.is_empty() || !frame.path.is_file() {
            return Err(error(number, format!("{file:?}: no such file in {}", folder.display())));
        }
        if let Some(last) = frames.last().filter(|last| last.capture >= capture) {
            let message = format!(
                "{file:?} was captured at {} ns, not after the frame before it ({} ns): times must increase",
                capture.0, last.capture.0
            );
            return Err(error(number, message));
        }
        frames.push(frame);
    }
    if frames.is_empty() {
        return Err(error(1, "the list names no frame".into()));
    }
    Ok(frames)
}
