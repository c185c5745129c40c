//! The leader as a state machine: messages, presence and time in; maps, probes and guidance out. It knows no clock, no
//! network, no runtime.
//!
//! ```text
//!  Observation ─▶ clock offset ─▶ timeline ─▶ calibration (who stands where) ─▶ correspondence (targets) ─▶ map
//! ```

pub mod config;
mod consistency;
mod guidance;
mod intake;
mod member;

use std::collections::BTreeSet;

use protocol::id::RobotId;
use protocol::message::map::MAX_EXPLANATION_LEN;
use protocol::message::{
    Alarm, Announcement, ClockProbe, ClockReply, Guidance, Health, MapStatus, Observation, TeamMap,
};
use protocol::time::Timestamp;

use crate::calibration::live::Calibrator;
use crate::calibration::systematic::Systematic;
use crate::correspondence::Follower;
use crate::team_map::build::{RobotFacts, build};
pub use config::{Anchor, CalibrationConfig, ClockConfig, GuidanceConfig, LeaderCoreConfig, TargetConfig};
use guidance::Guide;
use member::Member;

/// Most robots in a team.
pub const MAX_ROBOTS: usize = protocol::message::map::MAX_ROBOTS;
/// Most distinct notices.
const MAX_NOTICES: usize = 1000;

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
    config: LeaderCoreConfig,
    members: Vec<Member>,
    calibrator: Calibrator,
    follower: Follower,
    systematic: Systematic,
    guide: Guide,
    /// Capture of the newest admitted observation, leader's clock: the stamp of the map.
    newest: Option<Timestamp>,
    sequence: u64,
    told: BTreeSet<String>,
}

impl Leader {
    /// A leader that knows nobody yet.
    pub fn new(config: LeaderCoreConfig) -> Self {
        Self {
            calibrator: Calibrator::new(config.calibration),
            follower: Follower::new(config.targets),
            systematic: Systematic::new(config.targets),
            guide: Guide::default(),
            config,
            members: Vec::new(),
            newest: None,
            sequence: 0,
            told: BTreeSet::new(),
        }
    }

    /// Works on one event. Outputs are appended in the order in which they should leave.
    pub fn handle(&mut self, now: Timestamp, input: Input, outputs: &mut Vec<Output>) {
        match input {
            Input::Announcement(announcement) => self.announced(announcement, outputs),
            Input::Observation(robot, observation) => {
                if self.observed(now, robot, &observation, outputs) {
                    outputs.push(Output::Map(self.map(now)));
                    self.guide(now, outputs);
                }
            }
            Input::RobotAlive(robot) => {
                if let Some(k) = self.member(robot, outputs) {
                    self.members[k].alive = true;
                }
            }
            Input::RobotGone(robot) => {
                if let Some(k) = self.members.iter().position(|m| m.id == robot) {
                    self.members[k].alive = false;
                }
            }
            Input::ClockReply(robot, reply) => self.clock_replied(now, robot, &reply, outputs),
            Input::Alarm(_) | Input::Health(_) | Input::Deadline => {}
        }
        self.probe(now, outputs);
    }

    /// When [`Input::Deadline`] is wanted at the latest. Earlier or repeated calls do no harm.
    pub fn next_deadline(&self) -> Option<Timestamp> {
        self.members.iter().filter_map(|m| m.next_probe(&self.config.clock)).min()
    }

    /// The map as of now.
    fn map(&mut self, now: Timestamp) -> TeamMap {
        self.sequence += 1;
        let stamp = self.newest.unwrap_or(now);
        let mut facts: Vec<RobotFacts> =
            self.members.iter().map(|m| m.facts(now, self.config.silent_after_s)).collect();
        for (robot, facts) in facts.iter_mut().enumerate() {
            (facts.shared, facts.trust) = (self.systematic.of(robot), self.trust(robot));
        }
        let mut map = build(&facts, &self.calibrator, &self.follower, &self.config, stamp);
        map.sequence = self.sequence;
        if let (MapStatus::Inconsistent, Some(finding)) = (map.status, self.calibrator.findings().first()) {
            map.explanation = self.in_words(finding);
            map.explanation.truncate(map.explanation.floor_char_boundary(MAX_EXPLANATION_LEN));
        }
        map
    }

    /// The robot's number; a new one is given where there is room.
    fn member(&mut self, robot: RobotId, outputs: &mut Vec<Output>) -> Option<usize> {
        if let Some(k) = self.members.iter().position(|m| m.id == robot) {
            return Some(k);
        }
        if self.members.len() >= MAX_ROBOTS {
            self.tell(format!("robot {robot} is ignored: a team has at most {MAX_ROBOTS} robots"), outputs);
            return None;
        }
        let anchor = self.config.anchor.filter(|a| a.robot == robot).map(|a| a.team_from_body);
        let k = self.calibrator.add_robot(anchor);
        if let Some(fixed) = self.config.fixed.iter().find(|f| f.robot == robot) {
            self.calibrator.fix(k, fixed.team_from_body);
        }
        self.members.push(Member::new(robot));
        Some(k)
    }

    fn tell(&mut self, text: String, outputs: &mut Vec<Output>) {
        if self.told.len() < MAX_NOTICES && self.told.insert(text.clone()) {
            outputs.push(Output::Notice(text));
        }
    }
}

#[cfg(test)]
mod tests;
