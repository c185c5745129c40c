//! The leader as a state machine: messages, presence and time in; maps, probes and guidance out. It knows no clock, no
//! network, no runtime.
//!
//! ```text
//!  Observation ─▶ clock offset ─▶ timeline ─▶ calibration (who stands where) ─▶ correspondence (targets) ─▶ map
//! ```

mod alarms;
pub mod components;
pub mod config;
mod consistency;
mod guidance;
mod inherit;
mod intake;
mod member;
mod names;
mod sessions;
pub mod succession;
mod surroundings;

use std::collections::BTreeSet;

use protocol::fence::Fence;
use protocol::id::{LeaderId, RobotId};
use protocol::message::map::MAX_EXPLANATION_LEN;
use protocol::message::{
    Alarm, Announcement, Candidacy, ClockProbe, ClockReply, Edges, Guidance, Health, MapStatus, MapTarget, Observation,
    Recent, Surroundings, TeamMap,
};
use protocol::time::Timestamp;

use crate::structure::Landmark;
use crate::team_map::build::{RobotFacts, build};
use alarms::AlarmLog;
use components::{Component, Exchange};
pub use config::{Anchor, CalibrationConfig, ClockConfig, GuidanceConfig, LeaderCoreConfig, TargetConfig};
use inherit::Heritage;
use member::Member;
use names::{Names, Own};
use sessions::Sessions;
use succession::{Change, Succession};

/// Most robots in a team.
pub const MAX_ROBOTS: usize = protocol::message::map::MAX_ROBOTS;
/// A leader that stood still for so long has been followed by another: it must not go on as if nothing had been.
pub const THAW_AFTER: std::time::Duration = std::time::Duration::from_secs(1);
/// So many robots have all of a leader's time. Of twice as many each has half of it: whatever can wait is done half as often.
const FULL_CARE: usize = 10;
/// Larger teams have a map at most so often, seconds.
const MAP_INTERVAL_S: f64 = 0.015;
/// Most distinct notices.
const MAX_NOTICES: usize = 1000;

/// Everything that happens to a leader. `now` (leader's clock) goes with every call.
#[derive(Debug, Clone)]
pub enum Input {
    /// A robot says who it is.
    Announcement(Announcement),
    /// A robot's frame.
    Observation(RobotId, Observation),
    /// What a robot has seen of late, asked for when its token appeared.
    Recent(RobotId, Recent),
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
    /// What stands upright round a robot.
    Edges(RobotId, Edges),
    /// Another leader's liveliness token appeared.
    LeaderAlive(LeaderId),
    /// Another leader's liveliness token vanished.
    LeaderGone(LeaderId),
    /// Where another leader stands. One's own comes back and is ignored.
    Candidacy(Candidacy),
    /// The map of whoever leads. One's own comes back and is ignored.
    Map(TeamMap),
    /// This program stood still for longer than the others wait ([`THAW_AFTER`]).
    Thawed,
    /// A new session is open ([`Output::Renew`]): the others must be heard in it first.
    Renewed,
    /// `next_deadline` has come.
    Deadline,
}

/// Everything a leader does.
#[derive(Debug, Clone)]
pub enum Output {
    /// Lead: publish maps and answer for the team, in this term; `None`: stand by, take all of that back.
    Reign(Option<u64>),
    /// Go on in a new session: the other leaders have given this one up, or it does not hear them.
    Renew,
    /// Publish, and answer queries with it from now on. Only while it leads.
    Map(TeamMap),
    /// Tell the other leaders.
    Candidacy(Candidacy),
    /// A robot's alarm, for the record: each once.
    Alarm(Alarm),
    /// Ask this robot; the shell sets `sent` at the last moment.
    ClockProbe(RobotId, ClockProbe),
    /// Publish.
    Guidance(Guidance),
    /// Publish, for this robot only, at once: it is of use for its next frame.
    Surroundings(Surroundings),
    /// Tell people, once: named robot, what and what would cure it.
    Notice(String),
}

/// The pure leader.
#[derive(Debug)]
pub struct Leader {
    config: LeaderCoreConfig,
    members: Vec<Member>,
    /// The first is the team's.
    components: Vec<Component>,
    exchange: Exchange,
    /// Capture of the newest admitted observation, leader's clock: the stamp of the map.
    newest: Option<Timestamp>,
    sequence: u64,
    owes_map: bool,
    last_map: Option<Timestamp>,
    told: BTreeSet<String>,
    succession: Succession,
    fence: Fence,
    heritage: Heritage,
    names: Names,
    sessions: Sessions,
    alarms: AlarmLog,
    /// What robots that replay recordings were told, by whoever leads.
    replay_start: Option<Timestamp>,
}

impl Leader {
    /// A leader that knows nobody yet.
    pub fn new(config: LeaderCoreConfig) -> Self {
        Self {
            components: vec![Component::first(&config)],
            exchange: Exchange::default(),
            succession: Succession::new(config.leader, config.epoch, config.term, 0, config.listens_s),
            fence: Fence::default(),
            heritage: Heritage::default(),
            names: Names::default(),
            sessions: Sessions::default(),
            alarms: AlarmLog::default(),
            replay_start: None,
            config,
            members: Vec::new(),
            newest: None,
            sequence: 0,
            owes_map: false,
            last_map: None,
            told: BTreeSet::new(),
        }
    }

    /// Works on one event. Outputs are appended in the order in which they should leave.
    pub fn handle(&mut self, now: Timestamp, input: Input, outputs: &mut Vec<Output>) {
        self.succeed(now, &input, outputs);
        let mut used = None;
        match input {
            Input::Announcement(announcement) => {
                let robot = announcement.robot;
                self.announced(now, announcement, outputs);
                used = self.catch_up(now, robot, outputs);
            }
            Input::Observation(robot, observation) => used = self.observed(now, robot, observation, outputs),
            Input::Recent(robot, recent) => {
                self.remind(robot, recent);
                used = self.catch_up(now, robot, outputs);
            }
            Input::RobotAlive(robot) => {
                if let Some(k) = self.member(robot, outputs) {
                    self.members[k].alive = true;
                    self.home(k).calibrator.is_back(k);
                }
            }
            Input::RobotGone(robot) => {
                self.sessions.gone(robot);
                if let Some(k) = self.members.iter().position(|m| m.id == robot) {
                    self.members[k].alive = false;
                }
            }
            Input::ClockReply(robot, reply) => {
                self.clock_replied(now, robot, &reply, outputs);
                used = self.catch_up(now, robot, outputs);
            }
            Input::Alarm(alarm) => self.alarmed(now, alarm, outputs),
            Input::Health(health) => {
                // It says nothing that the leader needs, but a session that has no frames still speaks by it.
                let verdict = self.sessions.heard(now, health.robot, health.epoch);
                self.is_used(health.robot, verdict, outputs);
            }
            Input::Edges(robot, edges) => self.looked_round(now, robot, &edges, outputs),
            Input::Map(map) => self.map_heard(now, &map, outputs),
            Input::LeaderAlive(_)
            | Input::LeaderGone(_)
            | Input::Candidacy(_)
            | Input::Thawed
            | Input::Renewed
            | Input::Deadline => {}
        }
        self.owes_map |= used.is_some();
        if self.succession.reign().is_none() {
            self.owes_map = false;
        } else if let Some(robot) = used {
            self.tell_surroundings(robot, outputs);
            self.guide(self.members[robot].component, now, outputs);
            self.tell_of_moved(outputs);
        }
        if self.owes_map && self.map_is_due(now) {
            (self.owes_map, self.last_map) = (false, Some(now));
            outputs.push(Output::Map(self.map(now)));
        }
        self.probe(now, outputs);
    }

    /// When [`Input::Deadline`] is wanted at the latest. Earlier or repeated calls do no harm.
    pub fn next_deadline(&self) -> Option<Timestamp> {
        let probes = self.members.iter().filter_map(|m| m.next_probe(&self.config.clock));
        let map = self.last_map.filter(|_| self.owes_map).map(|last| last.offset_by_secs(MAP_INTERVAL_S));
        probes.chain([self.succession.next()]).chain(map).min()
    }

    /// What stands still in the team's frame: upright edges that two robots have seen, or one from two places.
    pub fn structure(&self) -> Vec<(&Landmark, Vec<RobotId>)> {
        let landmarks = self.components.first().map_or(&[][..], |team| team.structure.landmarks());
        let names = |robots: &[usize]| robots.iter().filter_map(|k| Some(self.members.get(*k)?.id)).collect();
        landmarks.iter().map(|landmark| (landmark, names(&landmark.robots))).collect()
    }

    /// Whether observations have been used that no map has shown yet.
    pub fn owes_map(&self) -> bool {
        self.owes_map
    }

    /// A small team has a map for every observation, a large one as often as anybody can use.
    fn map_is_due(&self, now: Timestamp) -> bool {
        let waits = |last: Timestamp| now.seconds_since(last) < MAP_INTERVAL_S;
        self.thrift() == 1 || !self.last_map.is_some_and(waits)
    }

    /// How many times as many robots there are as have a leader's full care, at least 1.
    fn thrift(&self) -> usize {
        self.members.len().div_ceil(FULL_CARE).max(1)
    }

    /// Whether messages of this session are used: of two robots of one id neither is.
    pub fn hears(&self, robot: RobotId, epoch: u64) -> bool {
        self.sessions.is_heard(robot, epoch)
    }

    /// Who this leader is.
    pub fn id(&self) -> LeaderId {
        self.config.leader
    }

    /// The term, while it leads.
    pub fn reign(&self) -> Option<u64> {
        self.succession.reign()
    }

    /// The highest term that it knows of.
    pub fn highest_term(&self) -> u64 {
        self.succession.highest()
    }

    /// The common start that robots were given, for the other leaders.
    pub fn give_replay_start(&mut self, start: Timestamp) {
        self.replay_start = Some(start);
    }

    /// The common start of recordings that this or another leader gave.
    pub fn replay_start(&self) -> Option<Timestamp> {
        self.replay_start
    }

    /// An alarm that stands in the record of an earlier session: it is not new when it comes again.
    pub fn alarm_is_known(&mut self, robot: RobotId, epoch: u64, number: u32) {
        self.alarms.mark(robot, epoch, number);
    }

    /// Takes part in the succession: hears the other leaders, decides, says where it stands.
    fn succeed(&mut self, now: Timestamp, input: &Input, outputs: &mut Vec<Output>) {
        match input {
            Input::LeaderAlive(leader) => self.succession.token(now, *leader, true),
            Input::LeaderGone(leader) => self.succession.token(now, *leader, false),
            Input::Candidacy(word) => {
                if self.succession.heard(now, word) {
                    let text = format!(
                        "two leaders use the id {}: sessions {:016x} and {:016x}; give one of them another [leader] id",
                        word.leader, self.config.epoch, word.epoch
                    );
                    self.tell(text, outputs);
                }
                self.replay_start = self.replay_start.or(word.replay_start);
            }
            Input::Thawed | Input::Renewed => {
                if matches!(input, Input::Thawed) && self.succession.knows_others() {
                    outputs.push(Output::Renew);
                }
                if self.succession.thawed(now).is_some() {
                    outputs.push(Output::Reign(None));
                }
            }
            _ => {}
        }
        if self.succession.is_deaf(now) {
            outputs.push(Output::Renew);
        }
        let robots = self.robots_used(now);
        match self.succession.decide(now, robots) {
            Some(Change::Begin(term)) => {
                self.sequence = 0;
                self.fence.admits(now, self.config.leader, term);
                outputs.push(Output::Reign(Some(term)));
            }
            Some(Change::End) => outputs.push(Output::Reign(None)),
            None => {}
        }
        let word = self.succession.word(now, robots, self.replay_start);
        outputs.extend(word.map(Output::Candidacy));
    }

    /// Robots whose observations this leader has used of late.
    fn robots_used(&self, now: Timestamp) -> u16 {
        let lately = |at: Timestamp| now.seconds_since(at) <= self.config.silent_after_s;
        self.members.iter().filter(|m| m.used.is_some_and(lately)).count() as u16
    }

    fn map_heard(&mut self, now: Timestamp, map: &TeamMap, outputs: &mut Vec<Output>) {
        if map.leader == self.config.leader {
            return;
        }
        self.succession.term_heard(map.term);
        if self.fence.admits(now, map.leader, map.term) && self.succession.reign().is_none() {
            self.inherit(now, map, outputs);
        }
    }

    /// The map as of now.
    fn map(&mut self, now: Timestamp) -> TeamMap {
        self.sequence += 1;
        let stamp = self.newest.unwrap_or(now);
        let mut facts: Vec<RobotFacts> =
            self.members.iter().map(|m| m.facts(now, self.config.silent_after_s)).collect();
        for (robot, facts) in facts.iter_mut().enumerate() {
            let home = &self.components[self.members[robot].component];
            (facts.shared, facts.trust) = (home.systematic.of(robot), self.trust(robot));
            facts.verifiable = home.calibrator.is_verifiable(robot);
        }
        let mut map = build(&facts, &self.components, &self.config, stamp);
        map.sequence = self.sequence;
        let finding = self.components.iter().find_map(|component| component.calibrator.findings().first());
        if let (MapStatus::Inconsistent, Some(finding)) = (map.status, finding) {
            map.explanation = self.in_words(finding);
            map.explanation.truncate(map.explanation.floor_char_boundary(MAX_EXPLANATION_LEN));
        }
        map.term = self.succession.reign().unwrap_or(map.term);
        let serial = |number: u8| self.components.iter().find(|c| c.number == number).map_or(0, |c| c.serial);
        let own = |target: &MapTarget| Own::of(target, serial(target.component));
        let numbers = self.names.name_all(&map.targets.iter().map(own).collect::<Vec<_>>(), stamp);
        map.targets.iter_mut().zip(numbers).for_each(|(target, number)| target.id = number);
        map.next_target = self.names.next();
        map.alarms = self.alarms.recent(now);
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
        self.members.push(Member::new(robot));
        let k = self.members.len() - 1;
        self.introduce(k);
        Some(k)
    }

    /// Tells the calibration of its component of a robot.
    fn introduce(&mut self, k: usize) {
        let robot = self.members[k].id;
        let anchor = self.config.anchor.filter(|a| a.robot == robot).map(|a| a.team_from_body);
        let fixed = self.config.fixed.iter().find(|f| f.robot == robot).map(|f| f.team_from_body);
        let calibrator = &mut self.home(k).calibrator;
        calibrator.add_robot(k, anchor);
        if let Some(pose) = fixed {
            calibrator.fix(k, pose);
        }
    }

    /// Holds a robot that has not been heard of yet at a place that is known.
    pub fn fix(&mut self, anchor: Anchor) {
        self.config.fixed.push(anchor);
    }

    fn tell(&mut self, text: String, outputs: &mut Vec<Output>) {
        self.tell_once(text.clone(), text, outputs);
    }

    /// Tells `text` unless something was told about `subject` before.
    fn tell_once(&mut self, subject: String, text: String, outputs: &mut Vec<Output>) {
        if !self.told.insert(subject) {
            return;
        }
        outputs.push(Output::Notice(text));
        if self.told.len() >= MAX_NOTICES {
            // Rather something twice than something new never.
            self.told.clear();
        }
    }
}

#[cfg(test)]
mod tests;
