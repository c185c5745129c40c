//! The team in real time: agents and leader as services with Zenoh sessions of their own on loopback.
//!
//! Each robot's pictures are rendered ahead and handed over when they would have left the camera; its clock is the host's
//! plus the offset of the scenario. An observer with a session of its own hears maps and observations as anybody could.

mod source;

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use protocol::codec::Kind;
use protocol::host_clock::Clock;
use protocol::id::{RobotId, TeamId};
use protocol::key::{Key, Pattern, RobotTopic};
use protocol::message::{Observation, TeamMap};
use protocol::meter::{Direction, Row, share_of_wire};
use protocol::time::Timestamp;
use protocol::transport::{AskedPicture, Options, Received, Transport, WireBytes};
use robot_agent::agent::{Agent, AgentSettings, PictureKind};
use robot_agent::service as agent_service;
use team_leader::leader::{Leader, LeaderCoreConfig};
use team_leader::service as leader_service;
use tokio::sync::watch;

use self::source::{Seen, SimulatedCamera};
use super::frames::Ahead;
use super::simulated::readout_ns;
use super::{Outcome, TeamError, TeamSettings, camera, check_cameras, failed, leader_id, team_id};
use crate::bandwidth::{Traffic, VideoRate};
use crate::render::Renderer;
use crate::scenario::Scenario;
use crate::score::scores::Latency;
use crate::world::{Capture, World};

/// From the moment everything is set up to the scenario's start: sessions open and the first pictures are rendered.
const LEAD: Duration = Duration::from_millis(1500);
/// A picture whose rendering has not begun so long after its time is left out.
const TOO_LATE: Duration = Duration::from_millis(20);
/// Maps and observations are heard for so long after the scenario's end.
const TAIL: Duration = Duration::from_millis(300);
/// Time that an agent has to answer with a picture.
const PICTURE_LIMIT: Duration = Duration::from_secs(3);
/// Between two words of progress.
const TICK: Duration = Duration::from_millis(250);

/// Runs a scenario with a seed. `progress` hears the scenario's time now and then, in seconds.
pub fn run(
    scenario: &Scenario,
    seed: u64,
    settings: &TeamSettings,
    progress: &(dyn Fn(f64) + Sync),
) -> Result<Outcome, TeamError> {
    check_cameras(scenario, settings)?;
    let world = Arc::new(World::new(scenario, seed)?);
    let runtime = super::runtime()?;
    runtime.block_on(run_team(scenario, world, settings, progress))
}

async fn run_team(
    scenario: &Scenario,
    world: Arc<World>,
    settings: &TeamSettings,
    progress: &(dyn Fn(f64) + Sync),
) -> Result<Outcome, TeamError> {
    let duration_s = settings.duration_s(&world);
    let (team, clock) = (team_id()?, Clock::system());
    let leader = leader_service::Service::open(leader_service::Setup {
        leader: Leader::new(LeaderCoreConfig::new(leader_id()?)),
        id: leader_id()?,
        team,
        clock,
        session: Options { measure: true, ..Options::router(["tcp/127.0.0.1:0"]) },
        replay: None,
        json: false,
        state: None,
        nobody_after: leader_service::NOBODY_AFTER,
    })
    .await
    .map_err(failed)?;
    let locators = leader.locators().to_vec();
    let (stop, stopped) = watch::channel(false);
    let leader = tokio::spawn(leader.run(until(stopped.clone())));

    let observer = Transport::open(Options::client(locators.clone())).await.map_err(failed)?;
    let (mut maps, mut observations) = (None, None);
    if !settings.unwatched {
        maps = Some(observer.subscribe_map(team).await.map_err(failed)?);
        let everybody = Pattern::EveryRobot(team, RobotTopic::Observation);
        observations = Some(observer.subscribe::<Observation>(everybody).await.map_err(failed)?);
    }

    let zero = clock.now() + LEAD;
    let robots = start_robots(scenario, &world, settings, zero, team, &locators, &stopped)?;
    let mut heard = Heard::default();
    let end = zero + Duration::from_secs_f64(duration_s) + TAIL;
    let mut tick = tokio::time::interval(TICK);
    while clock.now() < end {
        tokio::select! {
            Some(map) = async { maps.as_mut()?.recv().await }, if maps.is_some() => heard.maps.push(map),
            Some(observation) = async { observations.as_mut()?.recv().await }, if observations.is_some() => {
                heard.observations.push(observation);
            }
            _ = tick.tick() => progress(clock.now().seconds_since(zero).clamp(0.0, duration_s)),
        }
    }
    let names: Vec<RobotId> = robots.iter().map(|r| r.name).collect();
    let pictures = if settings.unwatched { Vec::new() } else { pictures(&observer, team, &names).await };

    // Whoever has ended already needs no word.
    let _ = stop.send(true);
    let mut finished = Vec::new();
    for robot in robots {
        let summary = robot.task.await.map_err(failed)?.map_err(failed)?;
        finished.push((robot.name, summary, robot.seen));
    }
    let leader = leader.await.map_err(failed)?.map_err(failed)?;
    observer.close().await.map_err(failed)?;
    Ok(outcome(scenario, world, duration_s, zero, heard, finished, &leader, pictures))
}

struct Robot {
    name: RobotId,
    task: tokio::task::JoinHandle<Result<agent_service::Summary, agent_service::ServiceError>>,
    seen: Arc<Mutex<Seen>>,
}

fn start_robots(
    scenario: &Scenario,
    world: &Arc<World>,
    settings: &TeamSettings,
    zero: Timestamp,
    team: TeamId,
    locators: &[String],
    stopped: &watch::Receiver<bool>,
) -> Result<Vec<Robot>, TeamError> {
    let duration_s = settings.duration_s(world);
    let names = settings.names(world);
    let mut robots = Vec::new();
    for ((index, robot), renderer) in world.robots().iter().enumerate().zip(Renderer::team(world)) {
        let captures = robot.captures.iter().filter(|c| c.true_time_s <= duration_s).copied().collect();
        let mut agent_settings = AgentSettings::new(names[index], scenario.marker_of(&robot.id));
        agent_settings.frame_rate_hz = scenario.capture_of(&robot.id).rate_hz;
        let clock = Clock::with_offset_ns((robot.clock_offset_s * 1e9).round() as i64);
        let epoch = zero.0.wrapping_add(index as u64);
        let agent = Agent::new(agent_settings, camera(scenario, settings, &robot.id)?, epoch)?;
        let seen = Arc::new(Mutex::new(Seen::default()));
        // A camera that is behind loses pictures; delivering them late would only make the next ones late too.
        let too_late =
            move |capture: &Capture| Clock::system().now() > zero.offset_by_secs(capture.true_time_s) + TOO_LATE;
        let pictures = Ahead::start(renderer, captures, too_late);
        let readout = Duration::from_nanos(readout_ns(world, &robot.id));
        let camera = SimulatedCamera::new(pictures, zero, robot.clock_offset_s, readout, seen.clone());
        let setup = agent_service::Setup {
            agent,
            source: Box::new(camera),
            clock,
            team,
            session: Options { measure: true, ..Options::client(locators.to_vec()) },
            journal: None,
            start: None,
            stop_at_end: false,
        };
        let task = tokio::spawn(agent_service::run(setup, until(stopped.clone())));
        robots.push(Robot { name: names[index], task, seen });
    }
    Ok(robots)
}

/// Ends when the flag is set, or when nobody can set it any more.
async fn until(mut flag: watch::Receiver<bool>) {
    let _ = flag.wait_for(|set| *set).await;
}

async fn pictures(observer: &Transport, team: TeamId, names: &[RobotId]) -> Vec<(PictureKind, RobotId, Vec<u8>)> {
    let mut pictures = Vec::new();
    for name in names {
        for kind in super::PICTURES {
            let key = Key::robot(team, *name, RobotTopic::Picture(kind));
            match observer.ask(key, &AskedPicture(kind), PICTURE_LIMIT).await {
                Ok(answered) => pictures.push((kind, *name, answered.answer.0)),
                Err(error) => tracing::warn!("{key}: {error}"),
            }
        }
    }
    pictures
}

#[derive(Default)]
struct Heard {
    maps: Vec<Received<TeamMap>>,
    observations: Vec<Received<Observation>>,
}

type Finished = (RobotId, agent_service::Summary, Arc<Mutex<Seen>>);

#[expect(clippy::too_many_arguments, reason = "the ends of everything that ran come together here, once")]
fn outcome(
    scenario: &Scenario,
    world: Arc<World>,
    duration_s: f64,
    zero: Timestamp,
    heard: Heard,
    finished: Vec<Finished>,
    leader: &leader_service::Summary,
    pictures: Vec<(PictureKind, RobotId, Vec<u8>)>,
) -> Outcome {
    let mut traffic = Traffic::default();
    let mut notices: Vec<String> = leader.notices.iter().map(|n| format!("leader: {n}")).collect();
    // The leader's session also forwards everything to the observer, so its own count says nothing of the map's cost.
    add_traffic(&mut traffic, "leader", &leader.traffic, None);
    let (mut glimpses, mut frames, mut late, mut jpeg, mut shown) = (Vec::new(), Vec::new(), 0, (0, 0), Vec::new());
    let mut names = Vec::new();
    for (name, summary, seen) in finished {
        add_traffic(&mut traffic, name.as_str(), &summary.traffic, summary.wire);
        let seen = std::mem::take(&mut *seen.lock().unwrap_or_else(PoisonError::into_inner));
        notices.extend(summary.notices.iter().map(|n| format!("{name}: {n}")));
        if summary.frames_dropped > 0 {
            notices.push(format!("{name}: {} pictures dropped because a newer one was there", summary.frames_dropped));
        }
        if seen.skipped > 0 {
            notices.push(format!("{name}: {} pictures left out because rendering was behind", seen.skipped));
        }
        late += seen.late + seen.skipped;
        jpeg = (jpeg.0 + seen.jpeg.0, jpeg.1 + seen.jpeg.1);
        shown.push(seen.glimpses.len());
        glimpses.push(seen.glimpses);
        frames.extend(seen.last.map(|frame| (name, frame)));
        names.push(name);
    }
    if leader.dropped > 0 {
        notices.push(format!("leader: {} messages dropped because it was too slow", leader.dropped));
    }
    let sizes = world.robots().iter().map(|r| world.camera().image_size_of(&r.id));
    let video = VideoRate::of(shown.into_iter().zip(sizes), jpeg, duration_s);
    let from_capture: Vec<f64> = heard.maps.iter().map(|m| m.arrived.seconds_since(m.message.stamp) * 1e3).collect();
    let [p50, p99, _] = leader.map_latency_ms.map(f64::from);
    Outcome {
        scenario: scenario.clone(),
        duration_s,
        zero,
        maps: heard.maps.into_iter().map(|m| m.message).collect(),
        edges: leader.edges.clone(),
        observations: heard.observations.into_iter().filter_map(|o| Some((o.key.robot_id()?, o.message))).collect(),
        heard: Vec::new(),
        latency_ms: Latency { p50: Some(p50), p99: Some(p99) },
        capture_to_map_ms: Latency::of(&from_capture),
        modelled: false,
        bandwidth: traffic.rates(duration_s),
        video,
        pictures,
        frames,
        notices,
        late_frames: late,
        names,
        glimpses,
        world,
    }
}

/// What a session sent, by kind, but for the pictures asked for at the end.
fn add_traffic(traffic: &mut Traffic, sender: &str, rows: &[Row], measured: Option<WireBytes>) {
    let sent = rows.iter().filter(|row| row.direction == Direction::Sent).copied();
    for (row, wire) in share_of_wire(sent, measured.map(|wire| wire.sent)) {
        if row.kind != Kind::Picture {
            traffic.add_many(sender, row.kind.name(), row.count.messages, row.count.payload_bytes, wire);
        }
    }
}
