//! Alarms and events: exactly once by (robot, epoch, number); history for late joiners.

use bincode::{Decode, Encode};

use crate::codec::{Invalid, Kind, Message, Subject, bounded_decode, check};
use crate::id::{RobotId, TrackId};
use crate::time::Timestamp;

/// Something that an operator should know.
#[derive(Debug, Clone, PartialEq, Encode, Decode)]
pub struct Alarm {
    /// Who says so.
    pub robot: RobotId,
    /// Its session.
    pub epoch: u64,
    /// Counts the alarms of the session from 0.
    pub number: u32,
    /// When, on the robot's clock.
    pub at: Timestamp,
    /// What.
    pub kind: AlarmKind,
}

/// What happened.
#[derive(Debug, Clone, PartialEq, Encode, Decode)]
pub enum AlarmKind {
    /// More than half of the picture changed and no cause could be told.
    SceneChanged,
    /// The light was switched or jumped.
    LightSwitched,
    /// The robot began to move: tracks are suspended.
    SelfMotion,
    /// Frames are frozen, black, saturated or fail to arrive, with the reason (≤ 128 bytes).
    SensorFailure(String),
    /// The background is ready (again): tracks resume.
    BackgroundReady,
    /// A person came into view.
    PersonAppeared(TrackId),
    /// A person left.
    PersonLeft(TrackId),
}

impl std::fmt::Display for AlarmKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::SceneChanged => f.write_str("the scene changed, nobody knows why"),
            Self::LightSwitched => f.write_str("the light was switched"),
            Self::SelfMotion => f.write_str("the robot moves"),
            Self::SensorFailure(reason) => write!(f, "the camera fails: {reason}"),
            Self::BackgroundReady => f.write_str("the background is ready"),
            Self::PersonAppeared(track) => write!(f, "a person appeared (track {track})"),
            Self::PersonLeft(track) => write!(f, "a person left (track {track})"),
        }
    }
}

/// Most bytes of a reason.
pub const MAX_REASON_LEN: usize = 128;

impl Message for Alarm {
    const KIND: Kind = Kind::Alarm;

    fn validate(&self) -> Result<(), Invalid> {
        match &self.kind {
            AlarmKind::SensorFailure(reason) => check::text("reason", reason, MAX_REASON_LEN),
            _ => Ok(()),
        }
    }

    fn subject(&self) -> Subject {
        Subject::Robot(self.robot)
    }

    bounded_decode!(Kind::Alarm);
}
