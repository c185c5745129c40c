//! Where live frames come from: anything that gives them when they are captured.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use protocol::host_clock::Clock;

use crate::agent::Frame;

/// Longest time that [`LiveSource::next`] may block, so that a stopping agent does not wait for a still camera.
pub const LONGEST_WAIT: Duration = Duration::from_millis(100);

/// What a source gives.
#[derive(Debug)]
pub enum Captured {
    /// A frame, stamped with its capture time on the robot's own clock.
    Frame(Frame),
    /// A frame that could not be read: which, and why.
    Bad(String),
    /// Nothing yet; ask again.
    Waiting,
    /// There will be no more.
    End,
}

/// A source of live frames. It runs in its own thread.
pub trait LiveSource: Send {
    /// The next frame, when it has been captured. Blocks for at most [`LONGEST_WAIT`], then says `Waiting`.
    fn next(&mut self, clock: &Clock) -> Captured;
}

/// A source fed by another thread: the newest frame wins. For simulations and cameras that call back.
pub fn frame_channel() -> (FrameSender, Box<dyn LiveSource>) {
    let slot = Arc::new(Slot { state: Mutex::new(SlotState::default()), filled: Condvar::new() });
    (FrameSender { slot: slot.clone() }, Box::new(FrameReceiver { slot }))
}

/// The sending end of [`frame_channel`]. Dropping it ends the source.
#[derive(Debug)]
pub struct FrameSender {
    slot: Arc<Slot>,
}

impl FrameSender {
    /// Hands over a frame; never blocks. Gives back a frame that nobody has taken yet.
    pub fn send(&self, frame: Frame) -> Option<Frame> {
        let old = self.slot.lock().frame.replace(frame);
        self.slot.filled.notify_one();
        old
    }
}

impl Drop for FrameSender {
    fn drop(&mut self) {
        self.slot.lock().ended = true;
        self.slot.filled.notify_one();
    }
}

#[derive(Debug, Default)]
struct SlotState {
    frame: Option<Frame>,
    ended: bool,
}

#[derive(Debug)]
struct Slot {
    state: Mutex<SlotState>,
    filled: Condvar,
}

impl Slot {
    fn lock(&self) -> MutexGuard<'_, SlotState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

struct FrameReceiver {
    slot: Arc<Slot>,
}

impl LiveSource for FrameReceiver {
    fn next(&mut self, _clock: &Clock) -> Captured {
        let empty = |state: &mut SlotState| state.frame.is_none() && !state.ended;
        let (mut state, _) = self
            .slot
            .filled
            .wait_timeout_while(self.slot.lock(), LONGEST_WAIT, empty)
            .unwrap_or_else(PoisonError::into_inner);
        match state.frame.take() {
            Some(frame) => Captured::Frame(frame),
            None if state.ended => Captured::End,
            None => Captured::Waiting,
        }
    }
}

#[cfg(test)]
mod tests {
    use protocol::time::Timestamp;

    use super::*;

    #[test]
    fn the_newest_frame_wins_and_the_older_one_comes_back() {
        let (sender, mut source) = frame_channel();
        assert!(sender.send(frame(1)).is_none());
        assert_eq!(sender.send(frame(2)).map(|f| f.capture), Some(Timestamp(1)));
        assert!(matches!(source.next(&Clock::system()), Captured::Frame(f) if f.capture == Timestamp(2)));
        assert!(matches!(source.next(&Clock::system()), Captured::Waiting));
        drop(sender);
        assert!(matches!(source.next(&Clock::system()), Captured::End));
    }

    fn frame(ns: u64) -> Frame {
        Frame { capture: Timestamp(ns), width: 1, height: 1, gray: vec![0] }
    }
}
