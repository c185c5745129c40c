//! The four-timestamp clock probe.

use bincode::{Decode, Encode};

use crate::codec::{Invalid, Kind, Message, bounded_decode};
use crate::time::Timestamp;

/// The leader asks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Encode, Decode)]
pub struct ClockProbe {
    /// Leader's clock when it was sent.
    pub sent: Timestamp,
}

/// The robot answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Encode, Decode)]
pub struct ClockReply {
    /// Copied from the probe.
    pub probe_sent: Timestamp,
    /// Robot's clock when the probe came in.
    pub received: Timestamp,
    /// Robot's clock when the reply went out.
    pub replied: Timestamp,
    /// The robot's session.
    pub epoch: u64,
}

impl Message for ClockProbe {
    const KIND: Kind = Kind::ClockProbe;

    fn validate(&self) -> Result<(), Invalid> {
        Ok(())
    }

    bounded_decode!(Kind::ClockProbe);
}

impl Message for ClockReply {
    const KIND: Kind = Kind::ClockReply;

    fn validate(&self) -> Result<(), Invalid> {
        Ok(())
    }

    bounded_decode!(Kind::ClockReply);
}
