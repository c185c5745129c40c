//! Faults on purpose: a team with stand-by leaders on a simulated network, one fault a run, and what the map was like meanwhile.
//!
//! ```text
//!  World ─▶ Robot (observations from the truth) ═ Fabric (links, tokens, faults) ═▶ Leader × 3 ─▶ maps ─▶ robots' fences
//!    └───────────────────────────────── truth ────────────────────────────────────────────▶ Judge ◀┘
//! ```
//! The leaders are the real ones, as their service drives them; the network behaves as Zenoh was measured to. A seed fixes the
//! world, the fault and every message, so a bad run can be had again.

pub mod fabric;
pub mod fault;
pub mod feed;
pub mod judge;
pub mod processes;

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

use protocol::codec::{decode, encode};
use protocol::fence::Fence;
use protocol::id::{LeaderId, RobotId};
use protocol::message::{ClockProbe, Observation, TeamMap};
use protocol::time::Timestamp;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use team_leader::leader::{Input, Leader, LeaderCoreConfig, Output};

use crate::network::{EventQueue, VirtualNs};
use crate::scenario::Scenario;
use crate::team::TeamError;
use crate::team::simulated::leader_clock;
use crate::world::{State, World};
use fabric::{Fabric, Life, SECOND, Weather};
use fault::{Fault, Kind};
use feed::Robot;
use judge::{Findings, Judge};

/// Leaders of a team: one that rules and two that stand by.
pub const LEADERS: usize = 3;
/// Their clocks minus true time, seconds.
const LEADER_CLOCKS_S: [f64; LEADERS] = [0.0, 0.004, -0.003];
/// Links and tokens are looked at this often.
const TICK: VirtualNs = SECOND / 50;
/// After the end of the fault the run goes on for so long, seconds.
const AFTER_S: f64 = 5.0;
/// Somebody is asked for in the map when two robots have seen him for so long, seconds.
const SEEN_S: f64 = 1.5;
/// Messages that a process which does not read keeps.
const RING: usize = 512;
/// Leaders must agree so long after the last change of the network, seconds.
const AGREED_S: f64 = 2.5;
/// A session in conflict is used again so long after the other one has gone, seconds.
const CONFLICT_S: f64 = 2.5;

/// The result of one seed.
#[derive(Debug, Clone, Serialize)]
pub struct Run {
    /// Which.
    pub seed: u64,
    /// What went wrong.
    pub fault: Kind,
    /// From … to, seconds.
    pub fault_s: (f64, f64),
    /// What the map was like.
    #[serde(flatten)]
    pub findings: Findings,
    /// Messages that the links lost.
    pub messages_lost: u64,
    /// Messages that could not be read.
    pub refused: u64,
    /// Alarms raised, and how many some leader at work does not have.
    pub alarms: (usize, usize),
}

/// Runs the fault of a seed.
///
/// # Errors
/// The scenario has no world.
pub fn run(seed: u64) -> Result<Run, TeamError> {
    let scenario = scenario()?;
    let world = World::new(&scenario, seed)?;
    let fault = Fault::of_seed(seed, world.robots().len());
    let mut team = Team::new(scenario, world, fault, seed)?;
    let end = ((fault.to_s + AFTER_S) * 1e9) as VirtualNs;
    while let Some((now, event)) = team.events.pop() {
        if now > end {
            break;
        }
        team.happen(now, event);
    }
    Ok(team.conclude())
}

/// Three robots that stand, and three people, in an empty room.
fn scenario() -> Result<Scenario, TeamError> {
    let text = "name = \"chaos\"\nduration_s = 20.0\n[robots]\ncount = 3\n[people]\ncount = 3\ncamouflaged = 0\n\
                [room]\nsize_m = [8.0, 6.0, 2.7]\n";
    Ok(Scenario::parse(text, "chaos")?)
}

enum Event {
    Tick,
    Frame { robot: usize, picture: usize },
    Arrival { to: usize, letter: Letter },
}

#[derive(Clone)]
enum Letter {
    /// For a leader.
    Input(Box<Input>),
    /// For a robot, from a leader.
    Probe(usize, ClockProbe),
    /// For a robot.
    Map(Arc<TeamMap>),
}

impl Letter {
    fn of(input: Input) -> Self {
        Self::Input(Box::new(input))
    }
}

struct LeaderNode {
    name: LeaderId,
    core: Option<Leader>,
    epoch: u64,
    /// What its state folder holds.
    saved: Option<Arc<TeamMap>>,
    recorded: Vec<(RobotId, u64, u32)>,
    /// What it has published last while it rules: its cache for late joiners.
    published: Option<Arc<TeamMap>>,
    /// What waits while it does not read.
    ring: VecDeque<Letter>,
}

struct Receiver {
    fence: Fence,
    believed: Option<(f64, LeaderId, u64)>,
}

struct Team {
    scenario: Scenario,
    world: World,
    fault: Fault,
    /// The leader that ruled when the fault began.
    victim: usize,
    robots: Vec<Robot>,
    double: Option<Robot>,
    receivers: Vec<Receiver>,
    leaders: Vec<LeaderNode>,
    fabric: Fabric,
    events: EventQueue<Event>,
    random: ChaCha8Rng,
    judge: Judge,
    /// Who looks at the map.
    looks: usize,
    begun: bool,
    ended: bool,
    refused: u64,
    next_alarm: Vec<VirtualNs>,
}

impl Team {
    fn new(scenario: Scenario, world: World, fault: Fault, seed: u64) -> Result<Self, TeamError> {
        let count = world.robots().len();
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(0x7465_616d);
        let mut leaders = Vec::new();
        for k in 0..LEADERS {
            let name = LeaderId::new(&format!("l{}", k + 1))?;
            leaders.push(LeaderNode {
                name,
                core: None,
                epoch: 0,
                saved: None,
                recorded: Vec::new(),
                published: None,
                ring: VecDeque::new(),
            });
        }
        let mut team = Self {
            robots: (0..count).map(|k| Robot::new(&world, k)).collect(),
            double: None,
            receivers: (0..count).map(|_| Receiver { fence: Fence::default(), believed: None }).collect(),
            fabric: Fabric::new(count, LEADERS, seed),
            judge: Judge::new((fault.from_s, fault.to_s)),
            looks: (fault.robot + 1) % count,
            next_alarm: (0..count).map(|k| SECOND + k as VirtualNs * SECOND / 7).collect(),
            victim: 0,
            events: EventQueue::default(),
            begun: false,
            ended: false,
            refused: 0,
            scenario,
            world,
            fault,
            leaders,
            random,
        };
        for k in 0..LEADERS {
            team.start_leader(0, k);
        }
        for robot in 0..count {
            team.expect_frame(robot, 0);
        }
        team.events.push(0, Event::Tick);
        Ok(team)
    }

    fn expect_frame(&mut self, robot: usize, picture: usize) {
        if let Some(capture) = self.world.robots()[robot].captures.get(picture) {
            self.events.push((capture.true_time_s * 1e9) as VirtualNs, Event::Frame { robot, picture });
        }
    }

    fn happen(&mut self, now: VirtualNs, event: Event) {
        match event {
            Event::Tick => {
                self.tick(now);
                self.events.push(now + TICK, Event::Tick);
            }
            Event::Frame { robot, picture } => {
                self.expect_frame(robot, picture + 1);
                self.frame(now, robot);
            }
            Event::Arrival { to, letter } => self.arrive(now, to, letter),
        }
    }

    fn tick(&mut self, now: VirtualNs) {
        let now_s = seconds(now);
        if !self.begun && now_s >= self.fault.from_s {
            self.begun = true;
            self.begin(now);
        }
        if !self.ended && now_s >= self.fault.to_s {
            self.ended = true;
            self.end(now);
        }
        for sign in self.fabric.settle(now) {
            self.sign(now, sign);
        }
        for k in 0..LEADERS {
            let due = self.leaders[k].core.as_ref().and_then(Leader::next_deadline);
            if self.works(self.leader_node(k)) && due.is_some_and(|at| at <= self.leader_time(now, k)) {
                self.tell(now, k, Input::Deadline);
            }
        }
        for robot in 0..self.robots.len() {
            if self.works(robot) && now >= self.next_alarm[robot] {
                self.next_alarm[robot] = now + SECOND;
                let alarm = self.robots[robot].raise(leader_clock(now));
                self.tell_leaders(now, robot, &Input::Alarm(alarm), true);
            }
        }
        self.check_terms(now_s);
    }

    fn begin(&mut self, now: VirtualNs) {
        let rules = |node: &LeaderNode| node.core.as_ref().is_some_and(|core| core.reign().is_some());
        self.victim = self.leaders.iter().position(rules).unwrap_or(0);
        let (robot, victim) = (self.fault.robot, self.leader_node(self.victim));
        match self.fault.kind {
            Kind::KillLeader => self.kill_leader(now, self.victim),
            Kind::KillAllLeaders => (0..LEADERS).for_each(|k| self.kill_leader(now, k)),
            Kind::FreezeLeader => self.fabric.life[victim] = Life::Frozen(now),
            Kind::StallLeader => self.fabric.life[victim] = Life::Stalled(now),
            Kind::CutLeader => self.fabric.island[victim] = 1,
            Kind::Partition => (self.fabric.island[victim], self.fabric.island[robot]) = (1, 1),
            Kind::KillRobot => self.fabric.life[robot] = Life::Dead(now),
            Kind::FreezeRobot => self.fabric.life[robot] = Life::Frozen(now),
            Kind::CutRobot => self.fabric.island[robot] = 1,
            Kind::StepClock | Kind::JumpClock => self.robots[robot].clock_offset_s += self.fault.step_s,
            Kind::Loss => self.fabric.weather.loss = 0.05,
            Kind::Delay => self.fabric.weather = Weather { delay_s: (0.2, 0.1), disorder: true, ..Weather::default() },
            Kind::Duplication => self.fabric.weather.duplicates = 0.5,
            Kind::Reordering => {
                self.fabric.weather = Weather { delay_s: (0.06, 0.06), disorder: true, ..Weather::default() };
            }
            Kind::Double => {
                let mut double = Robot::new(&self.world, (robot + 1) % self.robots.len());
                (double.id, double.epoch) = (self.robots[robot].id, 1000);
                self.double = Some(double);
            }
            Kind::Garbage | Kind::Flood | Kind::Nothing => {}
        }
    }

    fn end(&mut self, now: VirtualNs) {
        let robot = self.fault.robot;
        self.fabric.weather = Weather::default();
        self.fabric.island.fill(0);
        self.double = None;
        match self.fault.kind {
            Kind::KillLeader => self.start_leader(now, self.victim),
            Kind::KillAllLeaders => (0..LEADERS).for_each(|k| self.start_leader(now, k)),
            Kind::FreezeLeader | Kind::StallLeader => self.wake_leader(now, self.victim),
            Kind::KillRobot => {
                self.robots[robot].restart();
                self.fabric.life[robot] = Life::Works;
                let announcement = self.robots[robot].announcement(&self.scenario);
                self.tell_leaders(now, robot, &Input::Announcement(announcement), true);
            }
            Kind::FreezeRobot => {
                self.robots[robot].lose_sight();
                self.fabric.life[robot] = Life::Works;
            }
            _ => {}
        }
    }

    fn kill_leader(&mut self, now: VirtualNs, k: usize) {
        let node = self.leader_node(k);
        self.fabric.life[node] = Life::Dead(now);
        let leader = &mut self.leaders[k];
        (leader.core, leader.published) = (None, None);
        leader.ring.clear();
    }

    fn start_leader(&mut self, now: VirtualNs, k: usize) {
        let node = self.leader_node(k);
        self.fabric.life[node] = Life::Works;
        self.fabric.forget(node);
        let at = self.leader_time(now, k);
        let leader = &mut self.leaders[k];
        leader.epoch += 1;
        let mut config = LeaderCoreConfig::new(leader.name);
        (config.epoch, config.listens_s) = (leader.epoch, 1.0);
        let mut core = Leader::new(config);
        if let Some(saved) = &leader.saved {
            core.resume(at, saved, &mut Vec::new());
        }
        for (robot, epoch, number) in &leader.recorded {
            core.alarm_is_known(*robot, *epoch, *number);
        }
        leader.core = Some(core);
        self.tell(now, k, Input::Deadline);
    }

    /// As its service does: the core hears first that it stood still, then what waited.
    fn wake_leader(&mut self, now: VirtualNs, k: usize) {
        let node = self.leader_node(k);
        let since = match self.fabric.life[node] {
            Life::Frozen(since) | Life::Stalled(since) => since,
            _ => now,
        };
        self.fabric.life[node] = Life::Works;
        if now - since > team_leader::leader::THAW_AFTER.as_nanos() as u64 {
            // Its links were given up meanwhile: with the new ones it gets what it missed and what is kept.
            self.fabric.forget(node);
            self.tell(now, k, Input::Thawed);
        }
        for letter in std::mem::take(&mut self.leaders[k].ring) {
            self.arrive(now, node, letter);
        }
    }

    fn sign(&mut self, now: VirtualNs, sign: fabric::Sign) {
        let at = sign.at - self.robots.len();
        if sign.of < self.robots.len() {
            let id = self.robots[sign.of].id;
            if !sign.alive {
                return self.tell(now, at, Input::RobotGone(id));
            }
            self.tell(now, at, Input::RobotAlive(id));
            // What publishers keep for late joiners.
            let announcement = self.robots[sign.of].announcement(&self.scenario);
            self.post(now, sign.of, sign.at, &Letter::of(Input::Announcement(announcement)), true);
            for alarm in self.robots[sign.of].kept_alarms().to_vec() {
                self.post(now, sign.of, sign.at, &Letter::of(Input::Alarm(alarm)), true);
            }
            return;
        }
        let other = sign.of - self.robots.len();
        let name = self.leaders[other].name;
        self.tell(now, at, if sign.alive { Input::LeaderAlive(name) } else { Input::LeaderGone(name) });
        if let Some(map) = self.leaders[other].published.clone().filter(|_| sign.alive) {
            self.post(now, sign.of, sign.at, &Letter::of(Input::Map((*map).clone())), true);
        }
    }

    fn frame(&mut self, now: VirtualNs, robot: usize) {
        let state = self.world.at(seconds(now));
        if self.works(robot) {
            let observation = self.robots[robot].observe(&state, leader_clock(now));
            let id = self.robots[robot].id;
            let is_victim = robot == self.fault.robot && self.fault.lasts(seconds(now));
            let copies = if is_victim && self.fault.kind == Kind::Flood { 100 } else { 1 };
            for _ in 0..copies {
                self.tell_leaders(now, robot, &Input::Observation(id, observation.clone()), false);
            }
            if is_victim && self.fault.kind == Kind::Garbage {
                self.send_garbage(now, robot, &observation);
            }
        }
        if robot == self.fault.robot
            && let Some(double) = &mut self.double
        {
            let observation = double.observe(&state, leader_clock(now));
            let input = Input::Observation(double.id, observation);
            self.tell_leaders(now, robot, &input, false);
        }
    }

    /// Envelopes with bytes changed: what can still be read is delivered.
    fn send_garbage(&mut self, now: VirtualNs, robot: usize, observation: &Observation) {
        let Ok(envelope) = encode(observation) else { return };
        for _ in 0..20 {
            let mut bytes = envelope.clone();
            for _ in 0..self.random.random_range(1..6) {
                let at = self.random.random_range(0..bytes.len());
                bytes[at] = self.random.random();
            }
            bytes.truncate(self.random.random_range(bytes.len() / 2..=bytes.len()));
            match decode::<Observation>(&bytes) {
                Ok(read) => {
                    let id = self.robots[robot].id;
                    self.tell_leaders(now, robot, &Input::Observation(id, read), false);
                }
                Err(_) => self.refused += 1,
            }
        }
    }

    fn arrive(&mut self, now: VirtualNs, to: usize, letter: Letter) {
        match self.fabric.life[to] {
            Life::Dead(_) => return,
            // The system's buffers take it until the link's lease is over.
            Life::Frozen(since) if now - since > SECOND => return,
            Life::Frozen(_) | Life::Stalled(_) if to < self.robots.len() => return,
            Life::Frozen(_) | Life::Stalled(_) => {
                let ring = &mut self.leaders[to - self.robots.len()].ring;
                if ring.len() >= RING {
                    ring.pop_front();
                }
                return ring.push_back(letter);
            }
            Life::Works => {}
        }
        match letter {
            Letter::Input(input) => self.tell(now, to - self.robots.len(), *input),
            Letter::Probe(leader, probe) => {
                let reply = self.robots[to].answer(leader_clock(now), probe);
                let input = Input::ClockReply(self.robots[to].id, reply);
                self.post(now, to, leader, &Letter::of(input), false);
            }
            Letter::Map(map) => self.hear_map(now, to, &map),
        }
    }

    /// Gives a leader's core an input and sends what it says.
    fn tell(&mut self, now: VirtualNs, k: usize, input: Input) {
        let at = self.leader_time(now, k);
        let node = self.leader_node(k);
        let heard = match &input {
            Input::Map(map) => Some(Arc::new(map.clone())),
            _ => None,
        };
        let mut outputs = Vec::new();
        let Some(core) = &mut self.leaders[k].core else { return };
        core.handle(at, input, &mut outputs);
        if core.reign().is_none() && heard.is_some() {
            self.leaders[k].saved = heard;
        }
        for output in outputs {
            match output {
                Output::Map(map) => {
                    let map = Arc::new(map);
                    self.leaders[k].saved = Some(map.clone());
                    self.leaders[k].published = Some(map.clone());
                    for robot in 0..self.robots.len() {
                        self.post(now, node, robot, &Letter::Map(map.clone()), false);
                    }
                    self.tell_other_leaders(now, k, &Input::Map((*map).clone()));
                }
                Output::Candidacy(word) => self.tell_other_leaders(now, k, &Input::Candidacy(word)),
                Output::ClockProbe(id, mut probe) => {
                    probe.sent = at;
                    if let Some(robot) = self.robots.iter().position(|r| r.id == id) {
                        self.post(now, node, robot, &Letter::Probe(node, probe), false);
                    }
                }
                Output::Alarm(alarm) => {
                    let key = (alarm.robot, alarm.epoch, alarm.number);
                    if self.leaders[k].recorded.contains(&key) {
                        self.judge.violation(format!("leader {} records alarm {key:?} twice", self.leaders[k].name));
                    }
                    self.leaders[k].recorded.push(key);
                }
                Output::Reign(None) => self.leaders[k].published = None,
                // The links here hold no state that could be stale.
                Output::Reign(Some(_))
                | Output::Renew
                | Output::Guidance(_)
                | Output::Surroundings(_)
                | Output::Notice(_) => {}
            }
        }
    }

    fn hear_map(&mut self, now: VirtualNs, robot: usize, map: &Arc<TeamMap>) {
        let now_s = seconds(now);
        let receiver = &mut self.receivers[robot];
        if !receiver.fence.admits(leader_clock(now), map.leader, map.term) {
            return;
        }
        if let Some((at_s, _, term)) = receiver.believed
            && map.term < term
            && now_s - at_s < protocol::fence::FENCE.as_secs_f64()
        {
            self.judge.violation(format!("robot {robot} goes back from term {term} to {}", map.term));
        }
        receiver.believed = Some((now_s, map.leader, map.term));
        if robot == self.looks {
            let Some(k) = self.leaders.iter().position(|l| l.name == map.leader) else { return };
            let truth = self.world.at(map.stamp.seconds_since(leader_clock(0)) - LEADER_CLOCKS_S[k]);
            let live = self.live(now_s, &truth);
            self.judge.look(now_s, map, &truth, &live);
        }
    }

    /// People that at least two robots at work have seen for a while.
    fn live(&self, now_s: f64, truth: &State) -> Vec<bool> {
        let used = |robot: usize| {
            let in_conflict = self.fault.kind == Kind::Double
                && robot == self.fault.robot
                && (self.fault.from_s..self.fault.to_s + CONFLICT_S).contains(&now_s);
            self.works(robot) && !in_conflict
        };
        (0..truth.people.len())
            .map(|n| {
                let sees = |robot: &usize| {
                    used(*robot) && self.robots[*robot].seen_since[n].is_some_and(|since_s| now_s - since_s >= SEEN_S)
                };
                (0..self.robots.len()).filter(sees).count() >= 2
            })
            .collect()
    }

    /// Robots that reach each other believe one leader, some time after the last change.
    fn check_terms(&mut self, now_s: f64) {
        let settled = |change_s: f64| now_s < change_s || now_s > change_s + AGREED_S;
        if now_s < 4.0 || !settled(self.fault.from_s) || !settled(self.fault.to_s) {
            return;
        }
        let mut believed: BTreeMap<u8, BTreeSet<(u64, LeaderId)>> = BTreeMap::new();
        for robot in (0..self.robots.len()).filter(|r| self.works(*r)) {
            if let Some((at_s, leader, term)) = self.receivers[robot].believed
                && now_s - at_s < 0.3
            {
                believed.entry(self.fabric.island[robot]).or_default().insert((term, leader));
            }
        }
        for (island, terms) in believed {
            if terms.len() > 1 {
                self.judge.violation(format!("at {now_s:.2} s robots of island {island} believe {terms:?}"));
            }
        }
    }

    fn tell_leaders(&mut self, now: VirtualNs, from: usize, input: &Input, must_arrive: bool) {
        for k in 0..LEADERS {
            let to = self.leader_node(k);
            self.post(now, from, to, &Letter::of(input.clone()), must_arrive);
        }
    }

    fn tell_other_leaders(&mut self, now: VirtualNs, from: usize, input: &Input) {
        for k in (0..LEADERS).filter(|k| *k != from) {
            let (from, to) = (self.leader_node(from), self.leader_node(k));
            self.post(now, from, to, &Letter::of(input.clone()), false);
        }
    }

    fn post(&mut self, now: VirtualNs, from: usize, to: usize, letter: &Letter, must_arrive: bool) {
        for at in self.fabric.send(now, from, to, must_arrive) {
            self.events.push(at, Event::Arrival { to, letter: letter.clone() });
        }
    }

    fn works(&self, node: usize) -> bool {
        self.fabric.life[node] == Life::Works
    }

    fn leader_node(&self, k: usize) -> usize {
        self.robots.len() + k
    }

    fn leader_time(&self, now: VirtualNs, k: usize) -> Timestamp {
        leader_clock(now).offset_by_secs(LEADER_CLOCKS_S[k])
    }

    fn conclude(self) -> Run {
        let raised: Vec<(RobotId, u64, u32)> =
            self.robots.iter().flat_map(|r| r.alarms.iter().map(|a| (a.robot, a.epoch, a.number))).collect();
        // The last moment's may be on their way.
        let settled: Vec<_> = self
            .robots
            .iter()
            .flat_map(|r| r.alarms[..r.alarms.len().saturating_sub(2)].iter().map(|a| (a.robot, a.epoch, a.number)))
            .collect();
        let missing = settled.iter().filter(|key| self.leaders.iter().any(|l| !l.recorded.contains(key))).count();
        Run {
            seed: self.world.seed(),
            fault: self.fault.kind,
            fault_s: (self.fault.from_s, self.fault.to_s),
            findings: self.judge.conclude(),
            messages_lost: self.fabric.lost,
            refused: self.refused,
            alarms: (raised.len(), missing),
        }
    }
}

fn seconds(now: VirtualNs) -> f64 {
    now as f64 * 1e-9
}

#[cfg(test)]
mod tests;
