//! What waits for the agent: one slot for the newest frame and a bounded queue of questions.
//!
//! An agent that is slower than its camera must not fall behind the present: a new frame replaces the one that nobody has
//! begun, and is counted. Questions go first; they are short.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use protocol::time::Timestamp;

use crate::agent::{Frame, Input};

/// Most questions that wait; more are refused.
pub const MAX_QUESTIONS: usize = 64;

/// One thing to do.
#[derive(Debug)]
pub enum Item {
    /// A question or an event with the time of its arrival.
    Event(Timestamp, Input),
    /// The newest frame.
    Frame(Frame),
    /// Nothing came in time.
    Timeout,
    /// The end.
    Closed,
}

/// Shared between the threads of one agent.
#[derive(Debug, Default)]
pub struct Mailbox {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct State {
    frame: Option<Frame>,
    events: VecDeque<(Timestamp, Input)>,
    closed: bool,
    frames_dropped: u64,
    events_dropped: u64,
}

impl Mailbox {
    /// Puts the newest frame in; one that nobody has begun is dropped and counted.
    pub fn put_frame(&self, frame: Frame) {
        let mut state = self.lock();
        if state.frame.replace(frame).is_some() {
            state.frames_dropped += 1;
        }
        self.changed.notify_one();
    }

    /// Puts a question in; `false` when [`MAX_QUESTIONS`] wait already (counted).
    pub fn put_event(&self, arrival: Timestamp, input: Input) -> bool {
        let mut state = self.lock();
        if state.events.len() >= MAX_QUESTIONS {
            state.events_dropped += 1;
            return false;
        }
        state.events.push_back((arrival, input));
        self.changed.notify_one();
        true
    }

    /// Ends it: whoever takes gets `Closed` next.
    pub fn close(&self) {
        self.lock().closed = true;
        self.changed.notify_all();
    }

    /// Whether [`Mailbox::close`] was called.
    pub fn is_closed(&self) -> bool {
        self.lock().closed
    }

    /// Waits for something to do, at most `patience`.
    pub fn take(&self, patience: Duration) -> Item {
        let idle = |state: &mut State| !state.closed && state.events.is_empty() && state.frame.is_none();
        let (mut state, _) =
            self.changed.wait_timeout_while(self.lock(), patience, idle).unwrap_or_else(PoisonError::into_inner);
        if state.closed {
            return Item::Closed;
        }
        if let Some((arrival, input)) = state.events.pop_front() {
            return Item::Event(arrival, input);
        }
        state.frame.take().map_or(Item::Timeout, Item::Frame)
    }

    /// A question that waits, if any: between two stages of a frame.
    pub fn take_event(&self) -> Option<(Timestamp, Input)> {
        self.lock().events.pop_front()
    }

    /// Frames and questions dropped so far.
    pub fn dropped(&self) -> (u64, u64) {
        let state = self.lock();
        (state.frames_dropped, state.events_dropped)
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_that_nobody_began_gives_way_to_the_newest_and_is_counted() {
        let mailbox = Mailbox::default();
        mailbox.put_frame(frame(1));
        mailbox.put_frame(frame(2));
        assert!(matches!(mailbox.take(Duration::ZERO), Item::Frame(f) if f.capture == Timestamp(2)));
        assert!(matches!(mailbox.take(Duration::ZERO), Item::Timeout));
        assert_eq!(mailbox.dropped(), (1, 0));
    }

    #[test]
    fn questions_go_first_and_the_queue_is_bounded() {
        let mailbox = Mailbox::default();
        mailbox.put_frame(frame(1));
        for n in 0..MAX_QUESTIONS {
            assert!(mailbox.put_event(Timestamp(n as u64), Input::Deadline));
        }
        assert!(!mailbox.put_event(Timestamp(99), Input::Deadline));
        assert!(matches!(mailbox.take(Duration::ZERO), Item::Event(Timestamp(0), Input::Deadline)));
        assert_eq!(mailbox.dropped(), (0, 1));
    }

    #[test]
    fn a_closed_mailbox_gives_nothing_more() {
        let mailbox = Mailbox::default();
        mailbox.put_frame(frame(1));
        mailbox.close();
        assert!(matches!(mailbox.take(Duration::from_secs(9)), Item::Closed));
    }

    fn frame(ns: u64) -> Frame {
        Frame { capture: Timestamp(ns), width: 1, height: 1, gray: vec![0] }
    }
}
