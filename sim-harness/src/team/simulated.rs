//! The team in virtual time: no clock, no thread and no network decides anything, so a seed fixes every byte.
//!
//! One loop takes the next event, hands it to the agent or the leader it is for, and puts what they say on the simulated
//! network as encoded envelopes. Work costs modelled time ([`FRAME_COST_NS`], [`OBSERVATION_COST_NS`]). Pictures are rendered
//! by other threads, but which picture comes when is fixed, so they change nothing.

mod node;

use std::sync::Arc;

use protocol::codec::{Kind, claimed_kind, decode, encode};
use protocol::id::RobotId;
use protocol::key::{Key, RobotTopic};
use protocol::message::{ClockReply, Observation, TeamMap};
use protocol::time::Timestamp;
use robot_agent::agent::{self, Agent, AgentSettings, Frame, Token};
use team_leader::leader::{self, Leader, LeaderCoreConfig};
use team_leader::team_map::json::EdgeJson;

use self::node::{Due, LeaderNode, RobotNode};
use super::frames::{Ahead, Taken};
use super::truth::Glimpse;
use super::{Outcome, PICTURES, TeamError, TeamSettings, camera, check_cameras, leader_id, team_id};
use crate::bandwidth::{Traffic, VideoRate};
use crate::network::{EventQueue, Network, VirtualNs};
use crate::render::Renderer;
use crate::replay::{Heard, leader_input};
use crate::scenario::Scenario;
use crate::score::scores::Latency;
use crate::world::World;
use crate::world::robot::START_STAMP_S;

/// Modelled: from mid-exposure to the picture in memory.
const READOUT_NS: u64 = 10_000_000;
/// Modelled: an agent's work on one picture.
pub const FRAME_COST_NS: u64 = 20_000_000;
/// Modelled: the leader's work on one observation, its map included.
pub const OBSERVATION_COST_NS: u64 = 1_000_000;
/// Deadlines are at least so far ahead: time goes on whatever a node wants.
const LEAST_STEP_NS: u64 = 1_000_000;

/// From the capture time to the picture in memory: of a camera that turns, the half of the turn that comes after it, too.
pub(crate) fn readout_ns(world: &World, robot: &RobotId) -> u64 {
    let turn_s = world.camera().other(robot).and_then(|eye| eye.turn_s()).unwrap_or(0.0);
    READOUT_NS + (0.5e9 * turn_s) as u64
}

/// Everything that happens.
enum Event {
    /// The next picture of a robot is in its memory.
    Picture(usize),
    /// A node wanted to be called.
    Deadline(usize),
    /// An envelope arrives.
    Arrival { from: usize, to: usize, envelope: Arc<[u8]> },
    /// The leader sees a robot's liveliness token.
    Alive(usize),
}

/// Runs a scenario with a seed. `progress` hears the virtual time now and then, in seconds.
pub fn run(
    scenario: &Scenario,
    seed: u64,
    settings: &TeamSettings,
    progress: &dyn Fn(f64),
) -> Result<Outcome, TeamError> {
    check_cameras(scenario, settings)?;
    let world = Arc::new(World::new(scenario, seed)?);
    let mut team = Team::new(scenario, world, settings)?;
    team.start();
    let end = (team.duration_s * 1e9) as VirtualNs;
    let mut told_s = 0.0;
    while let Some((now, event)) = team.events.pop() {
        if now > end {
            break;
        }
        let now_s = now as f64 * 1e-9;
        if now_s >= told_s + 0.5 {
            told_s = now_s;
            progress(now_s);
        }
        team.happen(now, event)?;
    }
    team.finish(end)
}

struct Team {
    scenario: Scenario,
    world: Arc<World>,
    duration_s: f64,
    robots: Vec<RobotNode>,
    leader: LeaderNode,
    events: EventQueue<Event>,
    network: Network,
    traffic: Traffic,
    maps: Vec<TeamMap>,
    observations: Vec<(RobotId, Observation)>,
    heard: Vec<Heard>,
    latencies_ms: Vec<f64>,
    capture_latencies_ms: Vec<f64>,
    jpeg: (u64, u64),
    notices: Vec<String>,
}

impl Team {
    fn new(scenario: &Scenario, world: Arc<World>, settings: &TeamSettings) -> Result<Self, TeamError> {
        let duration_s = settings.duration_s(&world);
        let mut robots = Vec::new();
        let names = settings.names(&world);
        for ((index, robot), mut renderer) in world.robots().iter().enumerate().zip(Renderer::team(&world)) {
            if let Some(folder) = &settings.pictures {
                let kept = renderer.keep_in(folder, scenario);
                kept.map_err(|source| TeamError::Output { path: folder.clone(), source })?;
            }
            let captures = robot.captures.iter().filter(|c| c.true_time_s <= duration_s).copied().collect();
            let mut agent_settings = AgentSettings::new(names[index], scenario.marker_of(&robot.id));
            agent_settings.frame_rate_hz = scenario.capture_of(&robot.id).rate_hz;
            let agent = Agent::new(agent_settings, camera(scenario, settings, &robot.id)?, index as u64 + 1)?;
            robots.push(RobotNode {
                name: names[index],
                agent,
                clock_offset_s: robot.clock_offset_s,
                readout_ns: readout_ns(&world, &robot.id),
                pictures: Ahead::start(renderer, captures, |_| false),
                next: None,
                last: None,
                glimpses: Vec::new(),
                due: Due::default(),
            });
        }
        Ok(Self {
            scenario: scenario.clone(),
            duration_s,
            network: Network::new(settings.network, world.seed()),
            world,
            robots,
            leader: LeaderNode {
                leader: Leader::new(LeaderCoreConfig::new(leader_id()?)),
                free_at: 0,
                due: Due::default(),
            },
            events: EventQueue::default(),
            traffic: Traffic::default(),
            maps: Vec::new(),
            observations: Vec::new(),
            heard: Vec::new(),
            latencies_ms: Vec::new(),
            capture_latencies_ms: Vec::new(),
            jpeg: (0, 0),
            notices: Vec::new(),
        })
    }

    /// Number of the leader's node.
    fn leader_node(&self) -> usize {
        self.robots.len()
    }

    fn start(&mut self) {
        for index in 0..self.robots.len() {
            self.events.push(0, Event::Deadline(index));
            self.robots[index].due.set(0);
            self.events.push(LEAST_STEP_NS, Event::Alive(index));
            self.expect_picture(index);
        }
    }

    fn expect_picture(&mut self, index: usize) {
        let robot = &mut self.robots[index];
        robot.next = robot.pictures.wait();
        if let Some(taken) = &robot.next {
            let at = (taken.capture.true_time_s * 1e9) as VirtualNs + robot.readout_ns;
            self.events.push(at, Event::Picture(index));
        }
    }

    fn happen(&mut self, now: VirtualNs, event: Event) -> Result<(), TeamError> {
        match event {
            Event::Picture(index) => self.picture(now, index),
            Event::Deadline(node) if node == self.leader_node() => {
                if self.leader.due.is(now) {
                    self.tell_leader(now, leader::Input::Deadline)?;
                }
                Ok(())
            }
            Event::Deadline(index) => {
                if self.robots[index].due.is(now) {
                    self.tell_robot(now, index, agent::Input::Deadline, 0)?;
                }
                Ok(())
            }
            Event::Alive(index) => {
                let name = self.robots[index].name;
                self.hear(now, Key::robot(team_id()?, name, RobotTopic::Alive), &[]);
                self.tell_leader(now, leader::Input::RobotAlive(name))
            }
            Event::Arrival { from, to, envelope } if to == self.leader_node() => self.at_leader(now, from, &envelope),
            Event::Arrival { to, envelope, .. } => self.at_robot(now, to, &envelope),
        }
    }

    fn picture(&mut self, now: VirtualNs, index: usize) -> Result<(), TeamError> {
        let Some(Taken { capture, picture, jpeg_bytes, .. }) = self.robots[index].next.take() else { return Ok(()) };
        if let Some(bytes) = jpeg_bytes {
            self.jpeg.0 += bytes as u64;
            self.jpeg.1 += 1;
        }
        self.robots[index]
            .glimpses
            .push(Glimpse { time_s: capture.true_time_s, visible_fraction: picture.visible_fraction });
        let frame = Frame { capture: capture.stamp, width: picture.width, height: picture.height, gray: picture.gray };
        self.robots[index].last = Some(frame.clone());
        self.tell_robot(now, index, agent::Input::Frame(frame), FRAME_COST_NS)?;
        self.expect_picture(index);
        Ok(())
    }

    fn at_robot(&mut self, now: VirtualNs, index: usize, envelope: &[u8]) -> Result<(), TeamError> {
        let input = match claimed_kind(envelope) {
            Some(Kind::Announcement) => decode(envelope).map(Box::new).map(agent::Input::Announcement),
            Some(Kind::Surroundings) => decode(envelope).map(agent::Input::Surroundings),
            Some(Kind::ClockProbe) => decode(envelope).map(|probe| agent::Input::ClockProbe(Token(now), probe)),
            _ => return Ok(()),
        };
        match input {
            Ok(input) => self.tell_robot(now, index, input, 0),
            Err(error) => {
                self.notices.push(format!("{}: {error}", self.robots[index].name));
                Ok(())
            }
        }
    }

    fn at_leader(&mut self, now: VirtualNs, from: usize, envelope: &[u8]) -> Result<(), TeamError> {
        let robot = self.robots[from].name;
        let Some(topic) = claimed_kind(envelope).and_then(leader_topic) else { return Ok(()) };
        let key = Key::robot(team_id()?, robot, topic);
        self.hear(now, key, envelope);
        match leader_input(&key, envelope) {
            Ok(Some(input)) => {
                if let leader::Input::Observation(_, observation) = &input {
                    self.observations.push((robot, observation.clone()));
                }
                self.tell_leader(now, input)
            }
            Ok(None) => Ok(()),
            Err(error) => {
                self.notices.push(format!("leader, from {robot}: {error}"));
                Ok(())
            }
        }
    }

    fn hear(&mut self, now: VirtualNs, key: Key, envelope: &[u8]) {
        self.heard.push(Heard { arrival: leader_clock(now), key, envelope: envelope.into() });
    }

    fn tell_robot(&mut self, now: VirtualNs, index: usize, input: agent::Input, cost: u64) -> Result<(), TeamError> {
        let mut outputs = Vec::new();
        let robot = &mut self.robots[index];
        robot.agent.handle(robot.clock(now), input, &mut outputs);
        let done = now + cost;
        for output in outputs {
            self.send_from_robot(done, index, &output)?;
        }
        let robot = &mut self.robots[index];
        let wanted = robot.virtual_time(robot.agent.next_deadline());
        if let Some(at) = robot.due.want(wanted.max(now + LEAST_STEP_NS)) {
            self.events.push(at, Event::Deadline(index));
        }
        Ok(())
    }

    fn send_from_robot(&mut self, now: VirtualNs, index: usize, output: &agent::Output) -> Result<(), TeamError> {
        let name = self.robots[index].name;
        let leader = self.leader_node();
        let encoded = match output {
            agent::Output::Announcement(message) => (Kind::Announcement, encode(message)),
            agent::Output::Observation(message) => (Kind::Observation, encode(message)),
            agent::Output::Alarm(message) => (Kind::Alarm, encode(message)),
            agent::Output::Health(message) => (Kind::Health, encode(message)),
            agent::Output::Edges(message) => (Kind::Edges, encode(message)),
            agent::Output::ClockReply(_, reply) => {
                let reply = ClockReply { replied: self.robots[index].clock(now), ..*reply };
                (Kind::ClockReply, encode(&reply))
            }
            agent::Output::Notice(text) => {
                self.notices.push(format!("{name}: {text}"));
                return Ok(());
            }
            agent::Output::CommandReply(..) | agent::Output::Picture(..) => return Ok(()),
        };
        let (kind, envelope) = encoded;
        let envelope: Arc<[u8]> =
            envelope.map_err(|e| TeamError::Encode { sender: name.to_string(), reason: e.to_string() })?.into();
        self.traffic.add(name.as_str(), kind, envelope.len());
        self.send(now, index, leader, &envelope);
        if kind == Kind::Announcement {
            for other in (0..self.robots.len()).filter(|other| *other != index) {
                self.send(now, index, other, &envelope);
            }
        }
        Ok(())
    }

    fn send(&mut self, now: VirtualNs, from: usize, to: usize, envelope: &Arc<[u8]>) {
        if let Some(at) = self.network.send(now, from, to) {
            self.events.push(at, Event::Arrival { from, to, envelope: envelope.clone() });
        }
    }

    fn tell_leader(&mut self, arrival: VirtualNs, input: leader::Input) -> Result<(), TeamError> {
        let is_observation = matches!(input, leader::Input::Observation(..));
        let capture_ns = match &input {
            leader::Input::Observation(robot, observation) => {
                let sender = self.robots.iter().find(|r| r.name == *robot);
                sender.map(|s| s.virtual_time(observation.capture))
            }
            _ => None,
        };
        let begin = arrival.max(self.leader.free_at);
        let done = begin + if is_observation { OBSERVATION_COST_NS } else { 0 };
        self.leader.free_at = done;
        let mut outputs = Vec::new();
        // What arrived is stamped on arrival, as a service does.
        self.leader.leader.handle(leader_clock(arrival), input, &mut outputs);
        for output in outputs {
            match output {
                leader::Output::Map(map) => {
                    let envelope = self.leader_envelope(encode(&map))?;
                    self.traffic.add("leader", Kind::TeamMap, envelope.len());
                    if is_observation {
                        self.latencies_ms.push((done - arrival) as f64 * 1e-6);
                        self.capture_latencies_ms.extend(capture_ns.map(|at| (done.saturating_sub(at)) as f64 * 1e-6));
                    }
                    self.maps.push(map);
                }
                leader::Output::ClockProbe(robot, mut probe) => {
                    probe.sent = leader_clock(done);
                    let envelope = self.leader_envelope(encode(&probe))?;
                    self.traffic.add("leader", Kind::ClockProbe, envelope.len());
                    if let Some(to) = self.robots.iter().position(|r| r.name == robot) {
                        self.send(done, self.leader_node(), to, &envelope);
                    }
                }
                leader::Output::Guidance(guidance) => {
                    let envelope = self.leader_envelope(encode(&guidance))?;
                    self.traffic.add("leader", Kind::Guidance, envelope.len());
                }
                leader::Output::Surroundings(surroundings) => {
                    let envelope = self.leader_envelope(encode(&surroundings))?;
                    self.traffic.add("leader", Kind::Surroundings, envelope.len());
                    let to = self.robots.iter().position(|r| r.name == surroundings.robot);
                    if let Some(to) = to {
                        self.send(done, self.leader_node(), to, &envelope);
                    }
                }
                // Nobody else leads here.
                leader::Output::Reign(_)
                | leader::Output::Renew
                | leader::Output::Candidacy(_)
                | leader::Output::Alarm(_) => {}
                leader::Output::Notice(text) => self.notices.push(format!("leader: {text}")),
            }
        }
        if let Some(deadline) = self.leader.leader.next_deadline() {
            let wanted = virtual_time(deadline.seconds_since(leader_clock(0)));
            if let Some(at) = self.leader.due.want(wanted.max(done + LEAST_STEP_NS)) {
                self.events.push(at, Event::Deadline(self.leader_node()));
            }
        }
        Ok(())
    }

    fn leader_envelope<E: std::fmt::Display>(&self, envelope: Result<Vec<u8>, E>) -> Result<Arc<[u8]>, TeamError> {
        envelope
            .map(Arc::from)
            .map_err(|e| TeamError::Encode { sender: "the leader".to_owned(), reason: e.to_string() })
    }

    fn finish(mut self, end: VirtualNs) -> Result<Outcome, TeamError> {
        let mut pictures = Vec::new();
        for robot in &mut self.robots {
            let now = robot.clock(end);
            for kind in PICTURES {
                let mut outputs = Vec::new();
                robot.agent.handle(now, agent::Input::Picture(Token(0), kind), &mut outputs);
                for output in outputs {
                    if let agent::Output::Picture(_, Ok(bytes)) = output {
                        pictures.push((kind, robot.name, bytes));
                    }
                }
            }
        }
        let sizes = self.world.robots().iter().map(|r| self.world.camera().image_size_of(&r.id));
        let frames = self.robots.iter().map(|r| r.glimpses.len()).zip(sizes);
        let video = VideoRate::of(frames, self.jpeg, self.duration_s);
        let raw = self.robots.iter_mut().filter_map(|r| r.last.take().map(|frame| (r.name, frame))).collect::<Vec<_>>();
        Ok(Outcome {
            scenario: self.scenario,
            world: self.world,
            duration_s: self.duration_s,
            zero: leader_clock(0),
            maps: self.maps,
            edges: self.leader.leader.structure().iter().map(EdgeJson::of).collect(),
            observations: self.observations,
            heard: self.heard,
            latency_ms: Latency::of(&self.latencies_ms),
            capture_to_map_ms: Latency::of(&self.capture_latencies_ms),
            modelled: true,
            bandwidth: self.traffic.rates(self.duration_s),
            video,
            pictures,
            frames: raw,
            notices: self.notices,
            late_frames: 0,
            names: self.robots.iter().map(|r| r.name).collect(),
            glimpses: self.robots.into_iter().map(|r| r.glimpses).collect(),
        })
    }
}

/// Under which key a kind of message reaches the leader.
fn leader_topic(kind: Kind) -> Option<RobotTopic> {
    match kind {
        Kind::Announcement => Some(RobotTopic::Announcement),
        Kind::Observation => Some(RobotTopic::Observation),
        Kind::ClockReply => Some(RobotTopic::Clock),
        Kind::Alarm => Some(RobotTopic::Alarm),
        Kind::Health => Some(RobotTopic::Health),
        Kind::Edges => Some(RobotTopic::Edges),
        _ => None,
    }
}

/// The leader's clock: right, and zero is a second before the scenario's start.
pub(crate) fn leader_clock(now: VirtualNs) -> Timestamp {
    Timestamp((START_STAMP_S * 1e9) as u64 + now)
}

fn virtual_time(since_start_s: f64) -> VirtualNs {
    (since_start_s.max(0.0) * 1e9).round() as VirtualNs
}
