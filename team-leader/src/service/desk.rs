//! What happens to each thing that comes in, and where each output goes.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use protocol::host_clock::Clock;
use protocol::id::{LeaderId, RobotId, TeamId};
use protocol::key::{Key, Topic};
use protocol::latency::Latencies;
use protocol::message::map::MAX_ROBOTS;
use protocol::message::{Alarm, Announcement, Candidacy, Edges, Health, Observation, TeamMap};
use protocol::time::Timestamp;
use protocol::transport::{
    Asked, AskedMap, AskedMapJson, AskedReplayStart, Publisher, Received, Sign, TextPublisher, Transport,
    TransportError, WireBytes,
};

use super::heartbeat::Heartbeat;
use super::probes::{Probes, Told};
use super::replay::CommonStart;
use super::state::Keeper;
use super::word::Word;
use super::{LONGEST_IDLE, Setup, Summary};
use crate::leader::{Input, Leader, Output, THAW_AFTER};
use crate::team_map::json::{EdgeJson, MapJson};

/// What a leader answers that has been followed by another and not noticed yet.
const STOOD_STILL: &str = "this leader stood still and does not lead any more; ask again";
/// After a thaw clients connect anew at once. Zenoh's do not come back (1.10.2) where a link is closed while they finish opening
/// it, so the session that goes waits until they have.
const RENEWAL_DELAY: Duration = Duration::from_millis(600);
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
    heartbeat: Heartbeat,
    /// When it was last at work.
    worked: Instant,
    candidacy: Publisher<Candidacy>,
    /// While it leads.
    map: Option<Publisher<TeamMap>>,
    json: Option<TextPublisher>,
    reigns: bool,
    /// When the session is to be replaced.
    renews_at: Option<Instant>,
    keeper: Option<Keeper>,
    word: Word,
    /// Robots whose token is there.
    present: BTreeSet<RobotId>,
    /// Robots that have ever said anything.
    known: BTreeSet<RobotId>,
    pub(super) probes: Probes,
    start: CommonStart,
    last_map: Option<TeamMap>,
    latencies: Latencies,
    /// When observations arrived that no map has shown yet.
    unshown: Vec<Timestamp>,
    observations: u64,
    maps: u64,
    notices: Vec<String>,
}

impl Desk {
    /// Declares what the leader publishes.
    pub async fn declare(transport: &Transport, setup: Setup, locators: Vec<String>) -> Result<Self, TransportError> {
        let Setup { mut leader, id, team, clock, json, replay, state, .. } = setup;
        let (keeper, notices) = match state {
            Some(state) => {
                let (keeper, notices) = Keeper::start(state, clock.now(), &mut leader);
                (Some(keeper), notices)
            }
            None => (None, Vec::new()),
        };
        Ok(Self {
            candidacy: transport.publish(Key::candidacy(team, id)).await?,
            map: None,
            json: None,
            reigns: false,
            renews_at: None,
            keeper,
            worked: Instant::now(),
            // Last: who sees it finds the rest.
            heartbeat: Heartbeat::start(transport.clone(), Key::leader_alive(team, id))?,
            probes: Probes::new(transport.clone(), team, clock),
            transport: transport.clone(),
            leader,
            id,
            team,
            clock,
            publish_json: json,
            somebody_reads_json: false,
            locators,
            word: Word::default(),
            present: BTreeSet::new(),
            known: BTreeSet::new(),
            start: CommonStart::new(replay),
            last_map: None,
            latencies: Latencies::default(),
            unshown: Vec::new(),
            observations: 0,
            maps: 0,
            notices,
        })
    }

    /// Work begins now, however long ago everything was declared.
    pub fn wake(&mut self) {
        self.worked = Instant::now();
        self.handle(self.now(), Input::Deadline);
    }

    /// Whether it is time for a new session.
    pub fn renews(&self) -> bool {
        self.renews_at.is_some_and(|at| at <= Instant::now())
    }

    /// Goes on in a new session, in which nothing is declared yet.
    pub async fn renew(&mut self, transport: &Transport) -> Result<(), TransportError> {
        tracing::warn!("leader {} goes on in a new session", self.id);
        (self.map, self.json) = (None, None);
        self.word.clear();
        self.candidacy = transport.publish(Key::candidacy(self.team, self.id)).await?;
        self.probes = Probes::new(transport.clone(), self.team, self.clock);
        self.transport = transport.clone();
        self.heartbeat = Heartbeat::start(transport.clone(), Key::leader_alive(self.team, self.id))?;
        // Opening it took its time: that is no freeze.
        self.worked = Instant::now();
        // Who is there will be told anew; who has gone since would never be.
        for robot in std::mem::take(&mut self.present) {
            self.handle(self.now(), Input::RobotGone(robot));
        }
        self.handle(self.now(), Input::Renewed);
        self.renews_at = None;
        Ok(())
    }

    /// Its team.
    pub fn team(&self) -> TeamId {
        self.team
    }

    /// Whether this leader leads.
    pub fn reigns(&self) -> bool {
        self.reigns
    }

    /// Declares what only the leader that leads publishes, or takes it back: with it goes what was kept for late joiners.
    pub async fn publish_or_not(&mut self) {
        (self.map, self.json) = (None, None);
        if !self.reigns {
            return;
        }
        let (map, json) = (Key::map(self.team), Key::map_json(self.team));
        match (self.transport.publish(map).await, self.transport.publish_text(json).await) {
            (Ok(map), Ok(json)) => (self.map, self.json) = (Some(map), Some(json)),
            (Err(error), _) | (_, Err(error)) => tracing::error!("the map cannot be published: {error}"),
        }
        if let (Some(publisher), Some(map)) = (&self.map, &self.last_map) {
            log_unsent(publisher.put(map));
        }
    }

    /// Leader's clock.
    pub fn now(&self) -> Timestamp {
        self.clock.now()
    }

    /// How long the leader's deadline is away, at most [`LONGEST_IDLE`].
    pub fn patience(&self) -> Duration {
        let renewal = self.renews_at.map_or(LONGEST_IDLE, |at| at.saturating_duration_since(Instant::now()));
        let deadline = self.leader.next_deadline().map_or(LONGEST_IDLE, |at| self.clock.until(at));
        deadline.min(renewal).min(LONGEST_IDLE)
    }

    pub fn announced(&mut self, got: Received<Announcement>) {
        let (robot, host, version) = (got.message.robot, &got.message.host, &got.message.version);
        if self.known.len() < MAX_ROBOTS && self.known.insert(robot) {
            tracing::info!("robot {robot} has joined: host {host}, robot-agent {version}");
        }
        self.handle(got.arrived, Input::Announcement(got.message));
        self.maybe_start();
    }

    pub fn observed(&mut self, got: Received<Observation>) {
        let Some(robot) = got.key.robot_id() else { return };
        self.observations += 1;
        self.unshown.push(got.arrived);
        self.handle(got.arrived, Input::Observation(robot, got.message));
        if !self.leader.owes_map() {
            // A map has shown it, or none will.
            self.unshown.clear();
        }
    }

    pub fn alarmed(&mut self, got: Received<Alarm>) {
        self.handle(got.arrived, Input::Alarm(got.message));
    }

    pub fn health(&mut self, got: Received<Health>) {
        let health = got.message;
        self.handle(got.arrived, Input::Health(health.clone()));
        if self.leader.hears(health.robot, health.epoch) {
            self.transport.board().health(&health);
        }
    }

    pub fn looked_round(&mut self, got: Received<Edges>) {
        if let Some(robot) = got.key.robot_id() {
            self.handle(got.arrived, Input::Edges(robot, got.message));
        }
    }

    pub fn told(&mut self, (robot, told): (RobotId, Told)) {
        match told {
            Told::Clock(answered) => self.handle(answered.arrived, Input::ClockReply(robot, answered.answer)),
            Told::Recent(answered) => self.handle(answered.arrived, Input::Recent(robot, answered.answer)),
        }
    }

    pub fn map_heard(&mut self, got: Received<TeamMap>) {
        if !self.reigns {
            self.keep(&got.message);
        }
        self.handle(got.arrived, Input::Map(got.message));
    }

    pub fn robot_sign(&mut self, sign: Sign) {
        let Some(robot) = sign.key.robot_id() else { return };
        if sign.alive {
            if self.present.len() < MAX_ROBOTS {
                self.present.insert(robot);
            }
            self.handle(self.clock.now(), Input::RobotAlive(robot));
            self.probes.recall(robot);
            self.maybe_start();
        } else {
            self.present.remove(&robot);
            tracing::warn!("robot {robot} has gone");
            self.handle(self.clock.now(), Input::RobotGone(robot));
        }
    }

    pub fn leader_sign(&mut self, sign: Sign) {
        let Topic::LeaderAlive(other) = sign.key.topic else { return };
        if other != self.id {
            tracing::info!("leader {other} of team {} {}", self.team, if sign.alive { "is there" } else { "has gone" });
            let input = if sign.alive { Input::LeaderAlive(other) } else { Input::LeaderGone(other) };
            self.handle(self.now(), input);
        }
    }

    /// Gives the leader an input and sends what it says. A leader that stood still says so to its core first: by now another
    /// one leads.
    pub fn handle(&mut self, now: Timestamp, input: Input) {
        let mut outputs = Vec::new();
        if self.stood_still() {
            tracing::warn!("leader {} stood still for {:.1} s", self.id, self.worked.elapsed().as_secs_f64());
            self.leader.handle(self.clock.now(), Input::Thawed, &mut outputs);
        }
        self.leader.handle(now, input, &mut outputs);
        self.worked = Instant::now();
        self.heartbeat.beat();
        for output in outputs {
            match output {
                Output::Reign(term) => self.reign(term),
                Output::Renew => self.renews_at = self.renews_at.or(Instant::now().checked_add(RENEWAL_DELAY)),
                Output::Candidacy(word) => log_unsent(self.candidacy.put(&word)),
                Output::Alarm(alarm) => self.record(&alarm),
                Output::Map(map) => self.publish(map),
                Output::ClockProbe(robot, probe) => self.probes.ask(robot, probe),
                Output::Guidance(guidance) => self.word.guide(guidance),
                Output::Surroundings(surroundings) => self.word.show(surroundings),
                Output::Notice(text) => self.tell(text),
            }
        }
    }

    fn stood_still(&self) -> bool {
        self.worked.elapsed() > THAW_AFTER
    }

    fn reign(&mut self, term: Option<u64>) {
        self.reigns = term.is_some();
        match term {
            Some(term) => tracing::info!("leader {} leads team {} in term {term}", self.id, self.team),
            None => {
                // At once: what is put between here and the next declaration would be another leader's to say.
                (self.map, self.json, self.last_map) = (None, None, None);
                tracing::warn!("leader {} stands by: another one leads team {}", self.id, self.team);
            }
        }
        self.maybe_start();
    }

    fn publish(&mut self, map: TeamMap) {
        self.maps += 1;
        let now = self.clock.now();
        for arrived in self.unshown.drain(..) {
            self.latencies.push(now.seconds_since(arrived));
        }
        if let Some(publisher) = &self.map {
            log_unsent(publisher.put(&map));
        }
        if let Some(json) = self.json.as_ref().filter(|_| self.somebody_reads_json) {
            match self.as_json(&map) {
                Ok(text) => log_unsent(json.put(text)),
                Err(why) => tracing::error!("{why}"),
            }
        }
        self.transport.board().map(&map);
        self.keep(&map);
        self.last_map = Some(map);
    }

    /// Saves the map now and then.
    fn keep(&mut self, map: &TeamMap) {
        if let Some(keeper) = &mut self.keeper {
            keeper.keep(map, self.leader.highest_term());
        }
    }

    fn record(&mut self, alarm: &Alarm) {
        tracing::info!("robot {}: alarm {}: {}", alarm.robot, alarm.number, alarm.kind);
        if let Some(keeper) = &mut self.keeper {
            keeper.record(alarm);
        }
    }

    /// Gives the common start when it is time, if it is this leader's to give; one that another leader gave stands.
    fn maybe_start(&mut self) {
        if let Some(start) = self.leader.replay_start() {
            self.start.adopt(start);
        }
        if self.reigns {
            self.start.joined(self.present.intersection(&self.known).count(), self.clock.now());
        }
        if let Some(start) = self.start.start() {
            self.leader.give_replay_start(start);
        }
    }

    /// Declares publishers for robots that are told something for the first time.
    pub async fn declare_word(&mut self) {
        self.word.declare(&self.transport, self.team).await;
    }

    /// Whether anybody listens to the map as JSON: it is not even written if not.
    pub async fn look_for_listeners(&mut self) {
        self.somebody_reads_json = match &self.json {
            Some(json) if self.publish_json => json.has_listeners().await,
            _ => false,
        };
    }

    pub fn give_map(&self, asked: Asked<AskedMap>) {
        log_unsent(match &self.last_map {
            _ if self.stood_still() => asked.refuse(STOOD_STILL),
            Some(map) => asked.reply(map),
            None => asked.refuse(&self.no_map()),
        });
    }

    pub fn give_json(&self, asked: Asked<AskedMapJson>) {
        log_unsent(match self.last_map.as_ref().map(|map| self.as_json(map)) {
            _ if self.stood_still() => asked.refuse(STOOD_STILL),
            Some(Ok(json)) => asked.reply(&json),
            Some(Err(why)) => asked.refuse(&why),
            None => asked.refuse(&self.no_map()),
        });
    }

    pub fn give_start(&self, asked: Asked<AskedReplayStart>) {
        let answer = self.start.answer(asked.question.0, asked.arrived, self.clock.now());
        log_unsent(asked.reply(&answer));
    }

    fn as_json(&self, map: &TeamMap) -> Result<String, String> {
        let json = MapJson::with_structure(map, &self.leader.structure());
        serde_json::to_string(&json).map_err(|error| format!("the map cannot be written as JSON: {error}"))
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
            edges: self.leader.structure().iter().map(EdgeJson::of).collect(),
            map_latency_ms: self.latencies.report(),
            dropped: meter.dropped(),
            refused: meter.refused(),
            traffic: meter.rows(),
            wire,
            notices: self.notices.clone(),
        }
    }
}

pub(super) fn log_unsent<T>(sent: Result<T, TransportError>) {
    if let Err(error) = sent {
        tracing::warn!("{error}");
    }
}
