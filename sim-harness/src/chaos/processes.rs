//! The same over real Zenoh: leaders and robots as processes, each in a network namespace of its own.
//!
//! ```text
//!  namespace l1: team-leader ─┐                    ┌─ namespace r0: a robot's session, what it would see of a room
//!  namespace l2: team-leader ─┼── wire (in here) ──┼─ namespace r1 … r3
//!                             └── this process: the map by fence, against the room's truth ──┘
//! ```
//! Needs the right to make namespaces and TAP devices (root). Where it is refused, nothing is claimed.

mod host;
mod robot;
mod wire;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use protocol::fence::Fence;
use protocol::id::{LeaderId, TeamId};
use protocol::key::{Key, Pattern};
use protocol::message::{Candidacy, TeamMap};
use protocol::transport::{Options, Received, Subscriber, Transport};
use serde::Serialize;
use tokio::runtime::Handle;

use super::judge::{Findings, Judge};
use crate::scale::ROOM;
use crate::scale::room::Room;
use crate::team::{self, TeamError, failed};
use host::{Hosts, Process};
pub use robot::{RobotArgs, run as run_robot};
use wire::Weather;

/// Leaders: the first rules, the second stands by.
const LEADERS: [&str; 2] = ["l1", "l2"];
/// The robot that a fault of robots concerns.
const VICTIM: usize = 2;
/// Seed of the room's noise.
const SEED: u64 = 7;
/// How long a fault lasts, and the map is looked at afterwards, seconds.
const LASTS_S: f64 = 3.0;
const AFTER_S: f64 = 5.0;
/// By how much a clock is set, seconds.
const STEP_S: f64 = 0.3;
/// How often each message is sent in a flood.
const COPIES: u32 = 100;
/// Share of packets lost.
const LOSS: f64 = 0.05;
/// 200 ± 100 ms on the way to and from robots.
const DELAY: Weather = Weather { loss: 0.0, delay_s: [0.2, 0.1], delayed_from: LEADERS.len() };
/// The team has so long to find itself.
const JOIN_LIMIT: Duration = Duration::from_secs(30);
/// Words of the stand-by leader before the fault: it has listened, and knows who rules.
const WORDS: usize = 10;
/// A map with everybody in it must have come so often before the fault.
const MAPS: usize = 80;

/// What goes wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum Fault {
    /// The leader that rules is killed with -9, and started again at the end.
    Kill,
    /// It is stopped and continued.
    Freeze,
    /// Its host's link is down.
    LinkDown,
    /// It is stopped and its host's link is down.
    Both,
    /// A robot's clock is set.
    ClockStep,
    /// 5 % of all packets are lost.
    Loss,
    /// Robots' packets take 200 ± 100 ms.
    Delay,
    /// A robot sends each message a hundred times.
    Flood,
}

/// The result of one run.
#[derive(Debug, Clone, Serialize)]
pub struct Run {
    /// What went wrong.
    pub fault: Fault,
    /// What the map was like.
    #[serde(flatten)]
    pub findings: Findings,
    /// Maps that were believed.
    pub maps: u64,
    /// Maps of replaced leaders that were not.
    pub fenced: u64,
}

/// Runs a fault once.
///
/// # Errors
/// Namespaces are refused (in words), a process does not start, the team does not find itself.
pub fn run(fault: Fault) -> Result<Run, TeamError> {
    let runtime = team::runtime()?;
    let mut team = Team::start(runtime.handle())?;
    runtime.block_on(team.endure(fault))
}

struct Team {
    hosts: Hosts,
    folder: PathBuf,
    leaders: Vec<Process>,
    robots: Vec<Process>,
}

impl Team {
    fn start(runtime: &Handle) -> Result<Self, TeamError> {
        let names: Vec<String> =
            LEADERS.iter().map(ToString::to_string).chain((0..ROOM).map(|k| format!("r{k}"))).collect();
        let hosts = Hosts::make(&names, runtime)?;
        let folder = std::env::temp_dir().join(format!("pal-chaos-{}", std::process::id()));
        std::fs::create_dir_all(&folder).map_err(failed)?;
        let mut team = Self { hosts, folder, leaders: Vec::new(), robots: Vec::new() };
        for k in 0..LEADERS.len() {
            let leader = team.start_leader(k)?;
            team.leaders.push(leader);
        }
        let endpoints: Vec<String> = (0..LEADERS.len()).map(|k| team.endpoint(k)).collect();
        for k in 0..ROOM {
            let index = k.to_string();
            let robot =
                team.hosts.start(LEADERS.len() + k, &["--as-robot", &index, "--leaders", &endpoints.join(",")])?;
            team.robots.push(robot);
        }
        Ok(team)
    }

    fn endpoint(&self, leader: usize) -> String {
        format!("tcp/{}:7447", self.hosts.address(leader))
    }

    fn start_leader(&self, k: usize) -> Result<Process, TeamError> {
        let name = LEADERS[k];
        let others: Vec<String> =
            (0..LEADERS.len()).filter(|o| *o != k).map(|o| format!("\"{}\"", self.endpoint(o))).collect();
        let text = format!(
            "[leader]\nid = \"{name}\"\nteam = \"chaos\"\nstate_dir = \"{name}\"\n[network]\nlisten = [\"{}\"]\n\
             connect = [{}]\n[security]\nmode = \"none\"\n",
            self.endpoint(k),
            others.join(", ")
        );
        let file = self.folder.join(format!("{name}.toml"));
        std::fs::write(&file, text).map_err(failed)?;
        self.hosts.start(k, &["--as-leader", &file.to_string_lossy()])
    }

    async fn endure(&mut self, fault: Fault) -> Result<Run, TeamError> {
        let team = TeamId::new("chaos")?;
        let mut clients = Vec::new();
        for k in 0..LEADERS.len() {
            clients.push(Transport::open(Options::client([self.endpoint(k)])).await.map_err(failed)?);
        }
        let mut maps: [Subscriber<TeamMap>; 2] = [
            clients[0].subscribe(Key::map(team)).await.map_err(failed)?,
            clients[1].subscribe(Key::map(team)).await.map_err(failed)?,
        ];
        let mut words: Subscriber<Candidacy> =
            clients[1].subscribe(Pattern::EveryCandidacy(team)).await.map_err(failed)?;
        let [by_first, by_second] = &mut maps;
        tokio::time::timeout(JOIN_LIMIT, found_itself(by_first, &mut words))
            .await
            .map_err(|_| failed(format!("the team had not found itself after {JOIN_LIMIT:?}")))??;

        let start = Instant::now();
        let now_s = || start.elapsed().as_secs_f64();
        let lasts_s = if fault == Fault::ClockStep { 0.0 } else { LASTS_S };
        let fault_s = (0.5, 0.5 + lasts_s);
        let (mut judge, mut fence) = (Judge::new(fault_s), Fence::default());
        let (mut begun, mut ended, mut believed) = (false, false, 0);
        let room = Room::new(0, SEED);
        let mut tick = tokio::time::interval(Duration::from_millis(10));
        while now_s() < fault_s.1 + AFTER_S {
            let heard: Option<Received<TeamMap>> = tokio::select! {
                map = by_first.recv() => map,
                map = by_second.recv() => map,
                _ = tick.tick() => None,
            };
            if !begun && now_s() >= fault_s.0 {
                begun = true;
                self.begin(fault)?;
            }
            if begun && !ended && now_s() >= fault_s.1 {
                ended = true;
                self.end(fault)?;
            }
            let Some(map) = heard else { continue };
            if fence.admits(map.arrived, map.message.leader, map.message.term) {
                believed += 1;
                let truth = room.truth(map.message.stamp);
                judge.look(now_s(), &map.message, &truth, &[true; ROOM]);
            }
        }
        for client in clients {
            // What hangs is dropped with the process.
            let _ = client.close().await;
        }
        Ok(Run { fault, findings: judge.conclude(), maps: believed, fenced: fence.refused() })
    }

    fn begin(&mut self, fault: Fault) -> Result<(), TeamError> {
        match fault {
            Fault::Kill => self.leaders[0].signal("KILL"),
            Fault::Freeze => self.leaders[0].signal("STOP"),
            Fault::LinkDown => self.hosts.link(0, "down"),
            Fault::Both => {
                self.leaders[0].signal("STOP")?;
                self.hosts.link(0, "down")
            }
            Fault::ClockStep => self.robots[VICTIM].say(&format!("step {STEP_S}")),
            Fault::Loss => {
                self.hosts.weather(Weather { loss: LOSS, ..Weather::FINE });
                Ok(())
            }
            Fault::Delay => {
                self.hosts.weather(DELAY);
                Ok(())
            }
            Fault::Flood => self.robots[VICTIM].say(&format!("copies {COPIES}")),
        }
    }

    fn end(&mut self, fault: Fault) -> Result<(), TeamError> {
        match fault {
            Fault::Kill => {
                self.leaders[0] = self.start_leader(0)?;
                Ok(())
            }
            Fault::Freeze => self.leaders[0].signal("CONT"),
            Fault::LinkDown => self.hosts.link(0, "up"),
            Fault::Both => {
                self.hosts.link(0, "up")?;
                self.leaders[0].signal("CONT")
            }
            Fault::ClockStep => Ok(()),
            Fault::Loss | Fault::Delay => {
                self.hosts.weather(Weather::FINE);
                Ok(())
            }
            Fault::Flood => self.robots[VICTIM].say("copies 1"),
        }
    }
}

impl Drop for Team {
    fn drop(&mut self) {
        self.leaders.clear();
        self.robots.clear();
        // It is in the temporary folder.
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

/// Until everybody is in the map and the second leader knows that the first one rules.
async fn found_itself(maps: &mut Subscriber<TeamMap>, words: &mut Subscriber<Candidacy>) -> Result<(), TeamError> {
    let second = LeaderId::new(LEADERS[1])?;
    let (mut whole, mut said) = (0, 0);
    while whole < MAPS || said < WORDS {
        tokio::select! {
            Some(map) = maps.recv() => {
                let placed = map.message.robots.iter().filter(|robot| robot.team_from_body.is_some()).count();
                whole += usize::from(placed == ROOM && map.message.targets.len() >= ROOM);
            }
            Some(word) = words.recv() => {
                let word = word.message;
                said += usize::from(word.leader == second && !word.rules && word.term > 0 && word.robots as usize == ROOM);
            }
        }
    }
    Ok(())
}
