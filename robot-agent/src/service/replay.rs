//! A recording played at its own pace: a frame captured at `c` comes at `start + (c − recording_start)`, so that the processes
//! of a team that replay with one `start` and one `recording_start` keep the recorded phases and clock offsets.
//!
//! A process that comes late joins the present: frames that are past are skipped, not hurried through.

use std::sync::{Arc, OnceLock};
use std::time::Duration;

use protocol::host_clock::Clock;
use protocol::time::Timestamp;

use super::source::{Captured, LONGEST_WAIT, LiveSource};
use crate::agent::Frame;
use crate::capture::FrameSource;
use crate::config::RECORDING_ZERO_BELOW;

/// A frame this late is still played; an older one is skipped.
const LATE_BY_AT_MOST: Duration = Duration::from_millis(200);

/// When the recording begins, on the robot's clock. Empty until it is known.
pub type Start = Arc<OnceLock<Timestamp>>;

/// A recording as a live source.
pub struct Replay {
    recording: Box<dyn FrameSource>,
    start: Start,
    /// The instant of the recording that is played at `start`; known at the latest with the first frame.
    zero: Option<Timestamp>,
    next: Option<Frame>,
    skipped: u64,
}

impl Replay {
    /// Plays `recording` from `start` on. `recording_start`: see [`crate::config::CaptureConfig`].
    pub fn new(recording: Box<dyn FrameSource>, start: Start, recording_start: Option<Timestamp>) -> Self {
        Self { recording, start, zero: recording_start, next: None, skipped: 0 }
    }

    /// The next frame of the recording that is not past, before it is due: decoding takes time.
    fn read(&mut self, clock: &Clock) -> Captured {
        if let (Some(&start), Some(zero)) = (self.start.get(), self.zero) {
            let present = moved(zero, start, clock.now());
            self.skipped += self.recording.skip_before(present - LATE_BY_AT_MOST);
        }
        match self.recording.next_frame() {
            None => Captured::End,
            Some(Err(error)) => Captured::Bad(error.to_string()),
            Some(Ok(frame)) => {
                let counts_from_zero = frame.capture < RECORDING_ZERO_BELOW;
                self.zero.get_or_insert(if counts_from_zero { Timestamp(0) } else { frame.capture });
                self.next = Some(frame);
                Captured::Waiting
            }
        }
    }
}

impl LiveSource for Replay {
    fn next(&mut self, clock: &Clock) -> Captured {
        let Some(frame) = &self.next else { return self.read(clock) };
        let (Some(&start), Some(zero)) = (self.start.get(), self.zero) else {
            std::thread::sleep(LONGEST_WAIT / 2);
            return Captured::Waiting;
        };
        let due = moved(start, zero, frame.capture);
        if due + LATE_BY_AT_MOST < clock.now() {
            self.skipped += 1;
            self.next = None;
            return Captured::Waiting;
        }
        let wait = clock.until(due);
        std::thread::sleep(wait.min(LONGEST_WAIT));
        if wait > LONGEST_WAIT {
            return Captured::Waiting;
        }
        if self.skipped > 0 {
            let n = std::mem::take(&mut self.skipped);
            tracing::warn!("{n} frames of the recording were past already and were skipped");
        }
        self.next.take().map_or(Captured::Waiting, |frame| Captured::Frame(Frame { capture: due, ..frame }))
    }
}

/// `base + (to − from)`, exact.
fn moved(base: Timestamp, from: Timestamp, to: Timestamp) -> Timestamp {
    let ns = i128::from(base.0) + i128::from(to.0) - i128::from(from.0);
    Timestamp(ns.clamp(0, i128::from(u64::MAX)) as u64)
}

#[cfg(test)]
mod tests {
    use std::collections::VecDeque;

    use super::*;
    use crate::capture::CaptureError;

    #[test]
    fn frames_are_stamped_from_the_common_start_and_keep_their_phase() {
        let clock = Clock::system();
        let begin = clock.now();
        // This robot's first frame came 37 ms after the recording's zero.
        let mut replay = Replay::new(recording(&[37, 137]), started(begin), None);
        let stamps: Vec<_> = frames(&mut replay, &clock).iter().map(|f| f.capture).collect();
        assert_eq!(stamps, [begin + Duration::from_millis(37), begin + Duration::from_millis(137)]);
        assert!(clock.now() >= stamps[1], "a frame comes when it was captured, not before");
    }

    #[test]
    fn a_recording_with_true_dates_begins_with_its_first_frame_unless_told_otherwise() {
        let clock = Clock::system();
        let begin = clock.now();
        let days = 1_700_000_000_000;
        let mut replay = Replay::new(recording(&[days]), started(begin), None);
        assert_eq!(frames(&mut replay, &clock)[0].capture, begin);
        let zero = Some(Timestamp((days - 20) * 1_000_000));
        let mut replay = Replay::new(recording(&[days]), started(begin), zero);
        assert_eq!(frames(&mut replay, &clock)[0].capture, begin + Duration::from_millis(20));
    }

    #[test]
    fn who_comes_late_joins_the_present() {
        let clock = Clock::system();
        let start = Timestamp(clock.now().0 - 10_000_000_000);
        let mut replay = Replay::new(recording(&[0, 5000, 9990, 10_050]), started(start), None);
        let stamps: Vec<_> = frames(&mut replay, &clock).iter().map(|f| f.capture).collect();
        assert_eq!(stamps, [start + Duration::from_millis(9990), start + Duration::from_millis(10_050)]);
    }

    #[test]
    fn without_a_start_nothing_is_played() {
        let mut replay = Replay::new(recording(&[0]), Start::default(), None);
        assert!(matches!(replay.next(&Clock::system()), Captured::Waiting));
    }

    fn frames(replay: &mut Replay, clock: &Clock) -> Vec<Frame> {
        let mut frames = Vec::new();
        loop {
            match replay.next(clock) {
                Captured::Frame(frame) => frames.push(frame),
                Captured::End => return frames,
                _ => {}
            }
        }
    }

    fn started(at: Timestamp) -> Start {
        Arc::new(OnceLock::from(at))
    }

    fn recording(captures_ms: &[u64]) -> Box<dyn FrameSource> {
        Box::new(Fake(captures_ms.iter().map(|ms| Timestamp(ms * 1_000_000)).collect()))
    }

    struct Fake(VecDeque<Timestamp>);

    impl FrameSource for Fake {
        fn next_frame(&mut self) -> Option<Result<Frame, CaptureError>> {
            let capture = self.0.pop_front()?;
            Some(Ok(Frame { capture, width: 1, height: 1, gray: vec![0] }))
        }
        fn frames(&self) -> Option<u64> {
            None
        }
        fn skip_before(&mut self, capture: Timestamp) -> u64 {
            let before = self.0.len();
            self.0.retain(|c| *c >= capture);
            (before - self.0.len()) as u64
        }
    }
}
