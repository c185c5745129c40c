//! Any video, decoded by an `ffmpeg` process that pipes YUV4MPEG2 in gray.
//!
//! The piped format carries size and frame rate, so no second program has to be asked. Frames come at the stream's
//! constant rate; `ffmpeg` repeats or drops frames of a variable one.

use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::thread::JoinHandle;

use super::y4m::Y4m;
use super::{CaptureError, CaptureOptions, FrameSource};
use crate::agent::Frame;

/// How much of what `ffmpeg` complains about is kept.
const MAX_COMPLAINT_BYTES: usize = 2048;

/// A running `ffmpeg`; stopped when dropped.
#[derive(Debug)]
pub(super) struct Ffmpeg {
    path: PathBuf,
    child: Child,
    stream: Y4m<BufReader<ChildStdout>>,
    complaint: Option<JoinHandle<String>>,
}

impl Ffmpeg {
    /// Starts `program` on a video and waits for the first frame's header.
    pub(super) fn open(program: &str, path: &Path, options: CaptureOptions) -> Result<Self, CaptureError> {
        let no_ffmpeg = |source| CaptureError::NoFfmpeg { path: path.into(), program: program.into(), source };
        let mut child = Command::new(program)
            .args(["-v", "error", "-nostdin", "-i"])
            .arg(path)
            .args(["-map", "0:v:0", "-an", "-pix_fmt", "gray", "-strict", "-1", "-f", "yuv4mpegpipe", "-"])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(no_ffmpeg)?;
        let complaint = child.stderr.take().map(|stderr| std::thread::spawn(move || first_bytes(stderr)));
        let Some(stdout) = child.stdout.take() else {
            return Err(no_ffmpeg(std::io::Error::other("its output cannot be read")));
        };
        match Y4m::open(BufReader::with_capacity(1 << 20, stdout), path, options) {
            Ok(stream) => Ok(Self { path: path.into(), child, stream, complaint }),
            Err(error) => {
                // Without a header there is something better to say than that: what ffmpeg said.
                let _ = child.kill();
                let _ = child.wait();
                let said = complaint.and_then(|thread| thread.join().ok()).unwrap_or_default();
                if said.is_empty() {
                    return Err(error);
                }
                Err(CaptureError::Stream { path: path.into(), message: format!("ffmpeg cannot decode it: {said}") })
            }
        }
    }

    /// What went wrong, once the stream has ended.
    fn end(&mut self) -> Option<CaptureError> {
        let thread = self.complaint.take()?;
        let status = self.child.wait();
        let said = thread.join().unwrap_or_default();
        if status.is_ok_and(|s| s.success()) && said.is_empty() {
            return None;
        }
        let message = format!("ffmpeg after {} frames: {said}", self.stream.position());
        Some(CaptureError::Stream { path: self.path.clone(), message })
    }
}

impl FrameSource for Ffmpeg {
    fn next_frame(&mut self) -> Option<Result<Frame, CaptureError>> {
        self.stream.next_frame().or_else(|| self.end().map(Err))
    }

    fn frames(&self) -> Option<u64> {
        None
    }
}

impl Drop for Ffmpeg {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Drains a stream so that its writer never blocks, and keeps its beginning.
fn first_bytes(mut stream: impl Read) -> String {
    let mut kept = Vec::new();
    let mut buffer = [0; 1024];
    while let Ok(n @ 1..) = stream.read(&mut buffer) {
        kept.extend_from_slice(&buffer[..n.min(MAX_COMPLAINT_BYTES - kept.len())]);
    }
    String::from_utf8_lossy(&kept).trim().to_owned()
}
