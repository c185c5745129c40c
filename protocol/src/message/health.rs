//! How a robot is doing: every two seconds.

use bincode::{Decode, Encode};

use crate::codec::{Invalid, Kind, Message, Subject, bounded_decode, check};
use crate::id::RobotId;
use crate::time::Timestamp;

/// Rates, drops, latency and bytes since the agent's start, but for the rates and latencies (over the last period).
#[derive(Debug, Clone, PartialEq, Encode, Decode)]
pub struct Health {
    /// Whose.
    pub robot: RobotId,
    /// Its session.
    pub epoch: u64,
    /// Robot's clock.
    pub at: Timestamp,
    /// Frames a second worked on.
    pub frame_rate_hz: f32,
    /// Frames that came in.
    pub frames: u64,
    /// Frames dropped because a newer one was there.
    pub frames_dropped: u64,
    /// Frames that could not be used (wrong size, unreadable).
    pub frames_bad: u64,
    /// Stages left out for lack of time.
    pub stages_skipped: u64,
    /// Messages that a full queue or the transport dropped.
    pub messages_dropped: u64,
    /// Messages that could not be decoded.
    pub messages_refused: u64,
    /// Milliseconds from capture to publication: median and 99th percentile.
    pub latency_ms: [f32; 2],
    /// Traffic by message kind.
    pub traffic: Vec<KindTraffic>,
}

/// Traffic of one message kind since the start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Encode, Decode)]
pub struct KindTraffic {
    /// [`crate::message`] kind as in the envelope.
    pub kind: u8,
    /// Messages sent.
    pub messages: u64,
    /// Bytes of the envelopes.
    pub payload_bytes: u64,
}

/// Most kinds of messages in a report.
pub const MAX_TRAFFIC: usize = 32;

impl Message for Health {
    const KIND: Kind = Kind::Health;

    fn validate(&self) -> Result<(), Invalid> {
        check::in_range("frame_rate_hz", self.frame_rate_hz, 0.0, f64::from(f32::MAX))?;
        check::all_finite("latency_ms", &self.latency_ms)?;
        check::count("traffic", self.traffic.len(), MAX_TRAFFIC)
    }

    fn subject(&self) -> Subject {
        Subject::Robot(self.robot)
    }

    bounded_decode!(Kind::Health);
}
