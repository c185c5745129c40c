//! What happens to each thing that comes in, and where each output goes.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use protocol::host_clock::Clock;
use protocol::id::{LeaderId, RobotId, TeamId};
use protocol::key::{Key, Topic};
use protocol::latency::Latencies;
use protocol::message::map::MAX_ROBOTS;
use protocol::message::{Alarm, Announcement, ClockReply, Guidance, Health, Observation, TeamMap};
use protocol::time::Timestamp;
use protocol::transport::{
    AliveToken, Answered, Asked, AskedMap, AskedMapJson, AskedReplayStart, Publisher, Received, Sign, TextPublisher,
    Transport, TransportError, WireBytes,
};

use super::probes::Probes;
use super::replay::CommonStart;
use super::sessions::{Sessions, Verdict};
use super::{LONGEST_IDLE, Setup, Summary};
use crate::leader::{Input, Leader, Output};
use crate::team_map::json::MapJson;

/// Most notices that are kept for the summary; all are logged.
const MAX_NOTICES: usize = 256;

/// The state of a leader at work.
#[derive(Debug)]
pub struct Desk {
    leader: Leader,
    id: LeaderId,
    team: TeamId,
    clock: Clock,
    publish_json: bool,
    somebody_reads_json: bool,
    locators: Vec<String>,
    transport: Transport,
    _alive: AliveToken,
    map: Publisher<TeamMap>,
    json: TextPublisher,
    guidance: BTreeMap<RobotId, Publisher<Guidance>>,
    /// Guidance for robots that have no publisher yet; the last of each robot.
    undelivered: BTreeMap<RobotId, Guidance>,
    sessions: Sessions,
    /// Robots whose token is there.
    present: BTreeSet<RobotId>,
    /// Robots that have ever said anything.
    known: BTreeSet<RobotId>,
    pub(super) probes: Probes,
    start: CommonStart,
    last_map: Option<TeamMap>,
    latencies: Latencies,
    observations: u64,
    maps: u64,
    notices: Vec<String>,
}

impl Desk {
    /// Declares what the leader publishes.
    pub async fn declare(transport: &Transport, setup: Setup, locators: Vec<String>) -> Result<Self, TransportError> {
        let Setup { leader, id, team, clock, json, replay, .. } = setup;
        Ok(Self {
            map: transport.publish(Key::map(team)).await?,
            json: transport.publish_text(Key::map_json(team)).await?,
            // Last: who sees it finds the rest.
            _alive: transport.declare_alive(Key::leader_alive(team, id)).await?,
            probes: Probes::new(transport.clone(), team, clock),
            transport: transport.clone(),
            leader,
            id,
            team,
            clock,
            publish_json: json,
            somebody_reads_json: false,
            locators,
            guidance: BTreeMap::new(),
            undelivered: BTreeMap::new(),
            sessions: Sessions::default(),
            present: BTreeSet::new(),
            known: BTreeSet::new(),
            start: CommonStart::new(replay),
            last_map: None,
            latencies: Latencies::default(),
            observations: 0,
            maps: 0,
            notices: Vec::new(),
        })
    }

    /// Leader's clock.
    pub fn now(&self) -> Timestamp {
        self.clock.now()
    }

    /// How long the leader's deadline is away, at most [`LONGEST_IDLE`].
    pub fn patience(&self) -> Duration {
        self.leader.next_deadline().map_or(LONGEST_IDLE, |at| self.clock.until(at).min(LONGEST_IDLE))
    }

    pub fn announced(&mut self, got: Received<Announcement>) {
        let verdict = self.sessions.announced(&got.message);
        if !self.heard(verdict) {
            return;
        }
        let (robot, host, version) = (got.message.robot, &got.message.host, &got.message.version);
        if self.known.len() < MAX_ROBOTS && self.known.insert(robot) {
            tracing::info!("robot {robot} has joined: host {host}, robot-agent {version}");
        }
        self.handle(got.arrived, Input::Announcement(got.message));
        self.start.joined(self.present.intersection(&self.known).count(), self.clock.now());
    }

    pub fn observed(&mut self, got: Received<Observation>) {
        let Some(robot) = got.key.robot_id() else { return };
        let verdict = self.sessions.heard(robot, got.message.epoch);
        if !self.heard(verdict) {
            return;
        }
        self.observations += 1;
        let before = self.maps;
        self.handle(got.arrived, Input::Observation(robot, got.message));
        if self.maps > before {
            self.latencies.push(self.clock.now().seconds_since(got.arrived));
        }
    }

    pub fn alarmed(&mut self, got: Received<Alarm>) {
        let verdict = self.sessions.heard(got.message.robot, got.message.epoch);
        if self.heard(verdict) {
            tracing::info!("robot {}: alarm {}: {:?}", got.message.robot, got.message.number, got.message.kind);
            self.handle(got.arrived, Input::Alarm(got.message));
        }
    }

    pub fn health(&mut self, got: Received<Health>) {
        let verdict = self.sessions.heard(got.message.robot, got.message.epoch);
        if self.heard(verdict) {
            self.transport.board().health(&got.message);
            self.handle(got.arrived, Input::Health(got.message));
        }
    }

    pub fn probed(&mut self, (robot, answered): (RobotId, Answered<ClockReply>)) {
        let verdict = self.sessions.heard(robot, answered.answer.epoch);
        if self.heard(verdict) {
            self.handle(answered.arrived, Input::ClockReply(robot, answered.answer));
        }
    }

    pub fn robot_sign(&mut self, sign: Sign) {
        let Some(robot) = sign.key.robot_id() else { return };
        if sign.alive {
            if self.present.len() < MAX_ROBOTS {
                self.present.insert(robot);
            }
            self.handle(self.clock.now(), Input::RobotAlive(robot));
            self.start.joined(self.present.intersection(&self.known).count(), self.clock.now());
        } else {
            self.present.remove(&robot);
            tracing::warn!("robot {robot} has gone");
            self.handle(self.clock.now(), Input::RobotGone(robot));
        }
    }

    pub fn leader_sign(&mut self, sign: Sign) {
        let Topic::LeaderAlive(other) = sign.key.topic else { return };
        if other != self.id {
            let what = if sign.alive { "also leads" } else { "does not lead any more:" };
            tracing::warn!("leader {other} {what} team {}; this is leader {}", self.team, self.id);
        }
    }

    /// Gives the leader an input and sends what it says.
    pub fn handle(&mut self, now: Timestamp, input: Input) {
        let mut outputs = Vec::new();
        self.leader.handle(now, input, &mut outputs);
        for output in outputs {
            match output {
                Output::Map(map) => self.publish(map),
                Output::ClockProbe(robot, probe) => self.probes.ask(robot, probe),
                Output::Guidance(guidance) => self.guide(guidance),
                Output::Notice(text) => self.tell(text),
            }
        }
    }

    fn publish(&mut self, map: TeamMap) {
        self.maps += 1;
        log_unsent(self.map.put(&map));
        if self.somebody_reads_json {
            match as_json(&map) {
                Ok(json) => log_unsent(self.json.put(json)),
                Err(why) => tracing::error!("{why}"),
            }
        }
        self.transport.board().map(&map);
        self.last_map = Some(map);
    }

    fn guide(&mut self, guidance: Guidance) {
        match self.guidance.get(&guidance.robot) {
            Some(publisher) => log_unsent(publisher.put(&guidance)),
            None if self.undelivered.len() < MAX_ROBOTS => {
                self.undelivered.insert(guidance.robot, guidance);
            }
            None => {}
        }
    }

    /// Declares publishers for robots that get guidance for the first time.
    pub async fn declare_guidance(&mut self) {
        while let Some((robot, guidance)) = self.undelivered.pop_first() {
            match self.transport.publish(Key::guidance(self.team, robot)).await {
                Ok(publisher) => {
                    log_unsent(publisher.put(&guidance));
                    self.guidance.insert(robot, publisher);
                }
                Err(error) => tracing::error!("{error}"),
            }
        }
    }

    /// Whether anybody listens to the map as JSON: it is not even written if not.
    pub async fn look_for_listeners(&mut self) {
        self.somebody_reads_json = self.publish_json && self.json.has_listeners().await;
    }

    pub fn give_map(&self, asked: Asked<AskedMap>) {
        log_unsent(match &self.last_map {
            Some(map) => asked.reply(map),
            None => asked.refuse(&self.no_map()),
        });
    }

    pub fn give_json(&self, asked: Asked<AskedMapJson>) {
        log_unsent(match self.last_map.as_ref().map(as_json) {
            Some(Ok(json)) => asked.reply(&json),
            Some(Err(why)) => asked.refuse(&why),
            None => asked.refuse(&self.no_map()),
        });
    }

    pub fn give_start(&self, asked: Asked<AskedReplayStart>) {
        let answer = self.start.answer(asked.question.0, asked.arrived, self.clock.now());
        log_unsent(asked.reply(&answer));
    }

    fn no_map(&self) -> String {
        let present: Vec<&str> = self.present.iter().map(RobotId::as_str).collect();
        if present.is_empty() {
            return format!("there is no map yet: no robot has joined team {}", self.team);
        }
        format!(
            "there is no map yet: of team {} there are {}, and no observation has come",
            self.team,
            present.join(", ")
        )
    }

    /// Tells people that they wait for nothing.
    pub fn say_if_nobody_came(&mut self) {
        if self.present.is_empty() && self.known.is_empty() {
            let (team, here) = (self.team, self.locators.join(" or "));
            self.tell(format!(
                "no robot has joined yet: agents of team {team} ([robot] team) connect to {here} ([network] connect)"
            ));
        }
    }

    /// Whether to hear it; two robots of one id are told of here.
    fn heard(&mut self, verdict: Verdict) -> bool {
        match verdict {
            Verdict::Current => true,
            Verdict::Superseded { notice } => {
                notice.into_iter().for_each(|notice| self.tell(notice));
                false
            }
        }
    }

    fn tell(&mut self, notice: String) {
        tracing::warn!("{notice}");
        if self.notices.len() < MAX_NOTICES {
            self.notices.push(notice);
        }
    }

    /// What was done so far.
    pub fn summary(&mut self, wire: Option<WireBytes>) -> Summary {
        let meter = self.transport.meter();
        Summary {
            observations: self.observations,
            maps: self.maps,
            map_latency_ms: self.latencies.report(),
            dropped: meter.dropped(),
            refused: meter.refused(),
            traffic: meter.rows(),
            wire,
            notices: self.notices.clone(),
        }
    }
}

fn as_json(map: &TeamMap) -> Result<String, String> {
    serde_json::to_string(&MapJson::from(map)).map_err(|error| format!("the map cannot be written as JSON: {error}"))
}

fn log_unsent<T>(sent: Result<T, TransportError>) {
    if let Err(error) = sent {
        tracing::warn!("{error}");
    }
}
