//! Upright edges of what stands still round a standing robot: corners of walls, door frames, posts, sides of furniture.
//!
//! Seen by several robots they become the static structure of the team's map. Told seldom: what they are of does not move.

use bincode::{Decode, Encode};

use crate::codec::{Invalid, Kind, Message, bounded_decode, check};
use crate::quantity::{Angle16, LogSigma};
use crate::time::Timestamp;

/// Most edges of one picture.
pub const MAX_EDGES: usize = 48;

/// The upright edges round a robot.
#[derive(Debug, Clone, PartialEq, Encode, Decode)]
pub struct Edges {
    /// The robot's session.
    pub epoch: u64,
    /// Capture of the last frame in them, robot's clock.
    pub at: Timestamp,
    /// The plainest first (≤ [`MAX_EDGES`]).
    pub edges: Vec<UprightEdge>,
}

/// One edge, in the robot's body frame.
#[derive(Debug, Clone, Copy, PartialEq, Encode, Decode)]
pub struct UprightEdge {
    /// Where it is.
    pub bearing: Angle16,
    /// Standard deviation, rad.
    pub sigma: LogSigma,
    /// Grey levels left and right of it, as seen by the robot.
    pub levels: [u8; 2],
    /// Of its lower and upper end.
    pub elevation: [Angle16; 2],
    /// Whether that end is where it ends: it is not if the picture does, or if something stands before it as far as can be told.
    pub ends: [bool; 2],
}

impl Message for Edges {
    const KIND: Kind = Kind::Edges;

    fn validate(&self) -> Result<(), Invalid> {
        check::count("edges", self.edges.len(), MAX_EDGES)
    }

    bounded_decode!(Kind::Edges);
}
