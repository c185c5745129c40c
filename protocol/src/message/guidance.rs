//! Where a robot should go for a better view.

use bincode::{Decode, Encode};

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
    /// RMS error of the present targets here, metres.
    pub error_here_m: f64,
    /// The same at the goal.
    pub error_there_m: f64,
}
