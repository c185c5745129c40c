//! Pictures rendered ahead of their time, one thread a robot: a picture is a function of world and time, so rendering early
//! or late, on many threads or one, changes no byte.

use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, ImageEncoder};

use crate::bandwidth::JPEG_QUALITY;
use crate::render::{Picture, Renderer};
use crate::world::Capture;

/// Pictures that wait for their time, at most, of each robot: enough to even out the cost of single pictures.
const AHEAD: usize = 24;
/// Every so many pictures one is encoded as JPEG, to know what video would cost.
const JPEG_EVERY: usize = 10;

/// Niceness of the threads that render.
const NICE: i32 = 10;

/// A picture, when it was taken, and what a JPEG of it would take.
#[derive(Debug)]
pub struct Taken {
    /// When.
    pub capture: Capture,
    /// The picture.
    pub picture: Picture,
    /// Bytes as JPEG, of some pictures.
    pub jpeg_bytes: Option<usize>,
    /// Pictures left out since the one before.
    pub skipped: u64,
}

/// What comes next within a time.
#[derive(Debug)]
pub enum Next {
    /// A picture.
    Taken(Taken),
    /// Not yet.
    Waiting,
    /// There are no more.
    End,
}

/// The pictures of one robot in order, rendered by a thread of their own.
#[derive(Debug)]
pub struct Ahead {
    taken: Receiver<Taken>,
    thread: Option<JoinHandle<()>>,
}

impl Ahead {
    /// Starts rendering these captures, but for those of which `skip` says, when their turn comes, that it is too late.
    pub fn start(
        mut renderer: Renderer,
        captures: Vec<Capture>,
        skip: impl Fn(&Capture) -> bool + Send + 'static,
    ) -> Self {
        let (sender, taken) = sync_channel(AHEAD);
        let thread = std::thread::spawn(move || {
            give_way();
            let mut skipped = 0;
            for (number, capture) in captures.into_iter().enumerate() {
                if skip(&capture) {
                    skipped += 1;
                    continue;
                }
                if sender.send(take(&mut renderer, capture, number, std::mem::take(&mut skipped))).is_err() {
                    break;
                }
            }
        });
        Self { taken, thread: Some(thread) }
    }

    /// The next picture; `None` after the last.
    pub fn wait(&mut self) -> Option<Taken> {
        self.taken.recv().ok()
    }

    /// The next picture if it is ready in time.
    pub fn next_within(&mut self, limit: Duration) -> Next {
        match self.taken.recv_timeout(limit) {
            Ok(taken) => Next::Taken(taken),
            Err(RecvTimeoutError::Timeout) => Next::Waiting,
            Err(RecvTimeoutError::Disconnected) => Next::End,
        }
    }
}

impl Drop for Ahead {
    fn drop(&mut self) {
        // The sender fails once the receiver is gone.
        self.taken = sync_channel(0).1;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// This thread stands for a camera, which needs nothing of its robot's processor: agents and leader go first.
fn give_way() {
    // Of a thread on Linux; elsewhere it would be of the whole process.
    if cfg!(target_os = "linux") {
        let now = rustix::process::getpriority_process(None).unwrap_or(0);
        let _ = rustix::process::setpriority_process(None, now.max(NICE));
    }
}

fn take(renderer: &mut Renderer, capture: Capture, number: usize, skipped: u64) -> Taken {
    let picture = renderer.render(capture.true_time_s);
    let jpeg_bytes = number.is_multiple_of(JPEG_EVERY).then(|| jpeg_bytes(&picture)).flatten();
    Taken { capture, picture, jpeg_bytes, skipped }
}

fn jpeg_bytes(picture: &Picture) -> Option<usize> {
    let mut bytes = Vec::new();
    let encoder = JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY);
    encoder.write_image(&picture.gray, picture.width, picture.height, ExtendedColorType::L8).ok()?;
    Some(bytes.len())
}
