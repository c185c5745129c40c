//! Who is round a robot, as the whole team sees it: where it should look.
//!
//! One picture hardly tells how far away somebody is and who stands behind whom; robots together do. What a robot is told here
//! only directs its search. What it publishes it has still measured in its own picture.

use bincode::{Decode, Encode};

use crate::codec::{Invalid, Kind, Message, Subject, bounded_decode, check};
use crate::id::{LeaderId, RobotId, TrackId};
use crate::quantity::{Angle16, LogSigma, Millimetres};
use crate::time::Timestamp;

/// Most people that one robot is told of.
pub const MAX_PEOPLE: usize = 32;

/// The people round a robot.
#[derive(Debug, Clone, PartialEq, Encode, Decode)]
pub struct Surroundings {
    /// Round whom.
    pub robot: RobotId,
    /// Its session, whose tracks are meant.
    pub epoch: u64,
    /// Who says so.
    pub leader: LeaderId,
    /// Its term: a robot drops what comes in a lower one ([`crate::fence`]).
    pub term: u64,
    /// The instant at which they are there, by the robot's own clock.
    pub at: Timestamp,
    /// Nearest first (≤ [`MAX_PEOPLE`]).
    pub people: Vec<Neighbour>,
}

/// Somebody near a robot, in its body frame.
#[derive(Debug, Clone, Copy, PartialEq, Encode, Decode)]
pub struct Neighbour {
    /// Its own track that is he, where it follows him.
    pub track: Option<TrackId>,
    /// Where his axis is.
    pub bearing: Angle16,
    /// How far along the floor.
    pub range: Millimetres,
    /// Standard deviations along and across the line of sight, metres.
    pub sigma: [LogSigma; 2],
    /// How he walks: mm/s along x and y.
    pub velocity_mmps: [i16; 2],
}

impl Message for Surroundings {
    const KIND: Kind = Kind::Surroundings;

    fn validate(&self) -> Result<(), Invalid> {
        check::term("term", self.term)?;
        check::count("people", self.people.len(), MAX_PEOPLE)
    }

    fn subject(&self) -> Subject {
        Subject::Robot(self.robot)
    }

    bounded_decode!(Kind::Surroundings);
}
