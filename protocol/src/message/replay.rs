//! When recordings begin: the leader gives one instant for the team.
//!
//! The reply is also a clock comparison (the same four timestamps as [`super::ClockReply`], the other way round), so that a robot
//! converts the instant to its own clock without knowing more: offset = ((probe_sent − received) + (arrival − replied)) / 2.

use bincode::{Decode, Encode};

use crate::codec::{Invalid, Kind, Message, bounded_decode};
use crate::time::Timestamp;

/// The leader's answer to a [`super::ClockProbe`] of a robot that waits to replay.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Encode, Decode)]
pub struct ReplayStart {
    /// Copied from the probe: robot's clock.
    pub probe_sent: Timestamp,
    /// Leader's clock when the probe came in.
    pub received: Timestamp,
    /// Leader's clock when the reply went out.
    pub replied: Timestamp,
    /// When recordings begin, on the leader's clock; `None`: not known yet, ask again.
    pub start: Option<Timestamp>,
}

impl ReplayStart {
    /// The start on the clock of the robot that asked and got this reply at `arrival`. Exact to half the round trip.
    pub fn on_own_clock(&self, arrival: Timestamp) -> Option<Timestamp> {
        let out_s = self.probe_sent.seconds_since(self.received);
        let back_s = arrival.seconds_since(self.replied);
        Some(self.start?.offset_by_secs(0.5 * (out_s + back_s)))
    }
}

impl Message for ReplayStart {
    const KIND: Kind = Kind::ReplayStart;

    fn validate(&self) -> Result<(), Invalid> {
        Ok(())
    }

    bounded_decode!(Kind::ReplayStart);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_start_is_converted_with_the_offset_of_the_clocks_whatever_the_leader_took() {
        // The robot's clock is 20 ms ahead; 3 ms each way; the leader took 50 ms.
        let robot_from_leader = |ns: u64| Timestamp(ns + 20_000_000);
        let reply = ReplayStart {
            probe_sent: robot_from_leader(1_000_000_000),
            received: Timestamp(1_003_000_000),
            replied: Timestamp(1_053_000_000),
            start: Some(Timestamp(9_000_000_000)),
        };
        let start = reply.on_own_clock(robot_from_leader(1_056_000_000)).unwrap();
        assert!(start.seconds_since(robot_from_leader(9_000_000_000)).abs() < 1e-9);
        assert_eq!(ReplayStart { start: None, ..reply }.on_own_clock(Timestamp(2)), None);
    }
}
