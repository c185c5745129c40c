//! A camera before the simulated world: hands its pictures over when a real one would.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use protocol::host_clock::Clock;
use protocol::time::Timestamp;
use robot_agent::agent::Frame;
use robot_agent::service::{Captured, LONGEST_WAIT, LiveSource};

use super::super::frames::{Ahead, Next, Taken};
use super::super::truth::Glimpse;

/// A picture handed over so much after its time is late.
const LATE: Duration = Duration::from_millis(10);

/// What a robot was shown.
#[derive(Debug, Default)]
pub(super) struct Seen {
    /// In order of time.
    pub glimpses: Vec<Glimpse>,
    /// Bytes and number of the pictures that were encoded as JPEG.
    pub jpeg: (u64, u64),
    /// The last picture.
    pub last: Option<Frame>,
    /// Pictures that were not ready at their time.
    pub late: u64,
    /// Pictures that were left out because rendering was behind.
    pub skipped: u64,
}

/// Pictures of one robot, in real time.
#[derive(Debug)]
pub(super) struct SimulatedCamera {
    pictures: Ahead,
    zero: Timestamp,
    clock_offset_s: f64,
    readout: Duration,
    seen: Arc<Mutex<Seen>>,
    next: Option<Taken>,
}

impl SimulatedCamera {
    /// `zero`: the scenario's start on the host's clock; `readout`: from a capture time to the picture in memory.
    pub fn new(
        pictures: Ahead,
        zero: Timestamp,
        clock_offset_s: f64,
        readout: Duration,
        seen: Arc<Mutex<Seen>>,
    ) -> Self {
        Self { pictures, zero, clock_offset_s, readout, seen, next: None }
    }
}

impl LiveSource for SimulatedCamera {
    fn next(&mut self, clock: &Clock) -> Captured {
        let taken = match self.next.take() {
            Some(taken) => taken,
            None => match self.pictures.next_within(LONGEST_WAIT) {
                Next::Taken(taken) => taken,
                Next::Waiting => return Captured::Waiting,
                Next::End => return Captured::End,
            },
        };
        let capture = self.zero.offset_by_secs(taken.capture.true_time_s + self.clock_offset_s);
        let due = capture + self.readout;
        let wait = clock.until(due);
        if wait > LONGEST_WAIT {
            std::thread::sleep(LONGEST_WAIT);
            self.next = Some(taken);
            return Captured::Waiting;
        }
        std::thread::sleep(wait);
        let Taken { capture: moment, picture, jpeg_bytes, skipped } = taken;
        let frame = Frame { capture, width: picture.width, height: picture.height, gray: picture.gray };
        let mut seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        seen.late += u64::from(clock.now() > due + LATE);
        seen.skipped += skipped;
        if let Some(bytes) = jpeg_bytes {
            seen.jpeg.0 += bytes as u64;
            seen.jpeg.1 += 1;
        }
        seen.glimpses.push(Glimpse { time_s: moment.true_time_s, visible_fraction: picture.visible_fraction });
        seen.last = Some(frame.clone());
        Captured::Frame(frame)
    }
}
