//! The leader as a state machine: messages, presence and time in; maps, probes and guidance out. It knows no clock, no
//! network, no runtime.

pub mod config;

use protocol::id::RobotId;
use protocol::message::{Alarm, Announcement, ClockProbe, ClockReply, Guidance, Health, Observation, TeamMap};
use protocol::time::Timestamp;

pub use config::{Anchor, CalibrationConfig, ClockConfig, LeaderCoreConfig, TargetConfig};

/// Everything that happens to a leader. `now` (leader's clock) goes with every call.
#[derive(Debug, Clone)]
pub enum Input {
    /// A robot says who it is.
    Announcement(Announcement),
    /// A robot's frame.
    Observation(RobotId, Observation),
    /// A robot's liveliness token appeared.
    RobotAlive(RobotId),
    /// A robot's liveliness token vanished.
    RobotGone(RobotId),
    /// Answer to a probe; `now` of the call is the time of arrival.
    ClockReply(RobotId, ClockReply),
    /// A robot's alarm.
    Alarm(Alarm),
    /// A robot's health.
    Health(Health),
    /// `next_deadline` has come.
    Deadline,
}

/// Everything a leader does.
#[derive(Debug, Clone)]
pub enum Output {
    /// Publish, and answer queries with it from now on.
    Map(TeamMap),
    /// Ask this robot; the shell sets `sent` at the last moment.
    ClockProbe(RobotId, ClockProbe),
    /// Publish.
    Guidance(Guidance),
    /// Tell people, once: named robot, what and what would cure it.
    Notice(String),
}

/// The pure leader.
#[derive(Debug)]
pub struct Leader {
    _config: LeaderCoreConfig,
}

impl Leader {
    /// A leader that knows nobody yet.
    pub fn new(config: LeaderCoreConfig) -> Self {
        Self { _config: config }
    }

    /// Works on one event. Outputs are appended in the order in which they should leave.
    pub fn handle(&mut self, _now: Timestamp, _input: Input, _outputs: &mut Vec<Output>) {}

    /// When [`Input::Deadline`] is wanted at the latest. Earlier or repeated calls do no harm.
    pub fn next_deadline(&self) -> Option<Timestamp> {
        None
    }
}
