//! The nodes of the simulated team: cores with their clocks.

use protocol::id::RobotId;
use protocol::time::Timestamp;
use robot_agent::agent::{Agent, Frame};
use team_leader::leader::Leader;

use super::super::frames::{Ahead, Taken};
use super::super::truth::Glimpse;
use super::{leader_clock, virtual_time};
use crate::network::VirtualNs;

/// A robot.
pub(super) struct RobotNode {
    pub name: RobotId,
    pub agent: Agent,
    /// Its clock minus true time.
    pub clock_offset_s: f64,
    /// From a capture time to the picture in memory.
    pub readout_ns: u64,
    pub pictures: Ahead,
    /// The picture that comes next.
    pub next: Option<Taken>,
    /// The last picture.
    pub last: Option<Frame>,
    pub glimpses: Vec<Glimpse>,
    pub due: Due,
}

impl RobotNode {
    /// The robot's clock at a virtual time.
    pub fn clock(&self, now: VirtualNs) -> Timestamp {
        leader_clock(now).offset_by_secs(self.clock_offset_s)
    }

    /// The virtual time at which the robot's clock shows this.
    pub fn virtual_time(&self, stamp: Timestamp) -> VirtualNs {
        virtual_time(stamp.seconds_since(leader_clock(0)) - self.clock_offset_s)
    }
}

/// The leader.
pub(super) struct LeaderNode {
    pub leader: Leader,
    /// When its work so far is done.
    pub free_at: VirtualNs,
    pub due: Due,
}

/// When a node wants to be called: the one event in the queue that counts.
#[derive(Debug, Default)]
pub(super) struct Due {
    at: Option<VirtualNs>,
}

impl Due {
    /// An event at `at` is in the queue.
    pub fn set(&mut self, at: VirtualNs) {
        self.at = Some(at);
    }

    /// Whether the event that has come is the one that counts; it is used up.
    pub fn is(&mut self, now: VirtualNs) -> bool {
        let counts = self.at == Some(now);
        if counts {
            self.at = None;
        }
        counts
    }

    /// A call is wanted at `at`: when a new event must be put into the queue for it. A sooner one that stands already will do,
    /// since the node says again what it wants after every call.
    pub fn want(&mut self, at: VirtualNs) -> Option<VirtualNs> {
        if self.at.is_some_and(|standing| standing <= at) {
            return None;
        }
        self.at = Some(at);
        Some(at)
    }
}
