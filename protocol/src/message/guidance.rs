//! Where a robot should go for a better view.

use bincode::{Decode, Encode};

use crate::codec::{Invalid, Kind, Message, Subject, bounded_decode, check};
use crate::frames::Pose2;
use crate::id::RobotId;
use crate::time::Timestamp;

/// A better place to stand, and what it would buy.
#[derive(Debug, Clone, PartialEq, Encode, Decode)]
pub struct Guidance {
    /// For whom.
    pub robot: RobotId,
    /// Leader's clock.
    pub at: Timestamp,
    /// Where, in the team frame.
    pub team_from_goal: Pose2,
    /// Expected RMS error of the present targets here where nobody hides another, metres; the map states more.
    pub error_here_m: f64,
    /// The same at the goal.
    pub error_there_m: f64,
    /// Term of the leader that says it: a robot drops guidance of a lower term than that of the map it believes
    /// ([`crate::fence`]).
    pub term: u64,
}

impl Message for Guidance {
    const KIND: Kind = Kind::Guidance;

    fn validate(&self) -> Result<(), Invalid> {
        check::term("term", self.term)?;
        self.team_from_goal.validate("team_from_goal")?;
        check::in_range("error_here_m", self.error_here_m, 0.0, f64::MAX)?;
        check::in_range("error_there_m", self.error_there_m, 0.0, f64::MAX)
    }

    fn subject(&self) -> Subject {
        Subject::Robot(self.robot)
    }

    bounded_decode!(Kind::Guidance);
}
