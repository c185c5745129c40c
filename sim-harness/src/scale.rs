//! What one leader carries: many robots with synthetic observations through real Zenoh sessions, the leader in a process of its own.
//!
//! ```text
//!  this process: rooms of 4 robots and 4 people ─▶ a session a robot ═ TCP on loopback ═▶ child process: leader's service
//!       ▲ observer: maps                                                                    processor time, memory, files from /proc
//! ```
//! Robots of a room see each other and its people; rooms do not see each other, so the leader has as many components as there are
//! rooms, like a house. The senders do what an agent's shell does (announcement, token, observations, health, clock probes) without
//! an agent's pictures. With two processors the leader is pinned to one and the senders to the other.

mod judge;
pub mod leader;
pub mod room;
pub mod sender;

use std::io::{BufRead, BufReader, Write};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use protocol::board::figures::{ProcessFigures, figures_of};
use protocol::host_clock::Clock;
use protocol::key::Key;
use protocol::message::TeamMap;
use protocol::transport::{Options, Transport};
use serde::{Deserialize, Serialize};

use crate::score::statistics::percentile;
use crate::team::{self, TeamError, failed};
use room::Room;

/// Robots and people in a room.
pub const ROOM: usize = 4;
/// Most robots: as many as a map holds.
pub const MAX_ROBOTS: usize = protocol::message::map::MAX_ROBOTS;
/// Time for the leader's process to listen.
const START_LIMIT: Duration = Duration::from_secs(20);
/// Left out of the figures: joining, first calibration.
const SETTLING: Duration = Duration::from_secs(5);
/// Memory counts from here on, at the latest: by then all that is kept for seconds is full.
const FILLING: Duration = Duration::from_secs(60);
/// A soak has so many spans at most: where memory grew in one, another follows.
const MOST_SPANS: usize = 4;
/// What a span may add to the memory, of what there was before the first.
const MOST_GROWTH: f64 = 0.1;
/// Between two looks at the leader's memory.
const LOOK_PERIOD: Duration = Duration::from_secs(1);

/// What is tried.
#[derive(Debug, Clone, Serialize)]
pub struct Load {
    /// Robots.
    pub robots: usize,
    /// Observations a second of each.
    pub rate_hz: f64,
    /// How long, seconds, after 5 s of settling.
    pub duration_s: f64,
    /// Seed of the noise.
    pub seed: u64,
    /// Whether robots wear codes; if not, all look alike and the leader finds out who is in which room.
    pub coded: bool,
    /// Whether leader and senders are pinned to processors 0 and 1.
    pub pinned: bool,
    /// A soak: where memory has grown at the end, it goes on for as long again, until it no longer grows or has grown in four spans.
    /// Buffers that once were needed stay with the process: a leader that was kept waiting for a second is larger from then on,
    /// and one that leaks grows each time.
    pub flat: bool,
}

impl Load {
    fn room(&self, number: usize) -> Room {
        let room = Room::new(number, self.seed);
        if self.coded { room.with_codes() } else { room }
    }

    /// Robots that are tied to another one, and people whom two robots see: a robot that is alone in the last room is neither.
    fn there(&self) -> [usize; 2] {
        let (full, rest) = (self.robots / ROOM, self.robots % ROOM);
        let robots = ROOM * full + if rest > 1 { rest } else { 0 };
        [robots, ROOM * (full + usize::from(rest > 1))]
    }
}

/// What came out.
#[derive(Debug, Clone, Serialize)]
pub struct Figures {
    /// What was tried.
    pub load: Load,
    /// The leader's share of one processor.
    pub leader_cores: f64,
    /// From an observation's arrival to its map on the wire, milliseconds, whole run: median, 99th percentile, worst.
    pub latency_ms: [f64; 3],
    /// From capture to the map at an observer's, milliseconds, after settling: median, 99th percentile, worst.
    pub capture_to_map_ms: [f64; 3],
    /// How long it was measured, seconds, after settling.
    pub measured_s: f64,
    /// Observations sent.
    pub sent: u64,
    /// Observations that the leader heard.
    pub heard: u64,
    /// Messages that the leader dropped or refused.
    pub lost: u64,
    /// Maps that the observer got.
    pub maps: u64,
    /// Robots with a place, people in the last map.
    pub placed: [usize; 2],
    /// Of these, the ones that are where they are shown, and how many there are: robots (5 cm) and people (0.5 m).
    pub right: [[usize; 2]; 2],
    /// Least part of robots and people that were shown where they are in any look once a second after settling.
    pub least_right: [f64; 2],
    /// When all robots were placed rightly, seconds after the start.
    pub all_placed_s: Option<f64>,
    /// Resident memory of the leader after a minute (after half of a shorter run), when its windows are full, and at the end, MB;
    /// a soak that went on has further ends.
    pub memory_mb: Vec<f64>,
    /// Open files of the leader at the same times.
    pub open_files: Vec<usize>,
}

impl Figures {
    /// Whether the last span of the run added more to the leader's memory than a tenth of what there was before the first.
    pub fn memory_grows(&self) -> bool {
        grows(&self.memory_mb)
    }
}

fn grows(memory_mb: &[f64]) -> bool {
    matches!(memory_mb, [.., before, after] if after - before > MOST_GROWTH * memory_mb[0])
}

/// What the leader's process says at its end.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct LeaderSummary {
    /// Observations heard.
    pub observations: u64,
    /// Milliseconds.
    pub latency_ms: [f32; 3],
    /// Dropped and refused.
    pub lost: u64,
}

/// Runs it. `progress` hears the seconds that have passed and the leader's figures of that moment.
///
/// # Errors
/// No second process, no session, more robots than a map holds.
pub fn run(load: &Load, progress: &mut dyn FnMut(f64, ProcessFigures)) -> Result<Figures, TeamError> {
    let mut child = start_leader(load.pinned)?;
    let measured = connected(&mut child).and_then(|endpoint| measure(load, &endpoint, &child, progress));
    // The leader ends with its input, whatever happened here.
    drop(child.stdin.take());
    let summary = summary_of(&mut child);
    let mut figures = measured?;
    let summary = summary?;
    figures.heard = summary.observations;
    figures.latency_ms = summary.latency_ms.map(f64::from);
    figures.lost = summary.lost;
    Ok(figures)
}

fn start_leader(pinned: bool) -> Result<Child, TeamError> {
    let own = std::env::current_exe().map_err(failed)?;
    let mut command = match pinned {
        true => {
            let mut command = Command::new("taskset");
            command.args(["-c", "0"]).arg(own);
            command
        }
        false => Command::new(own),
    };
    if pinned {
        // All threads that there will be inherit it.
        let pid = std::process::id().to_string();
        let pin = Command::new("taskset").args(["-a", "-c", "-p", "1", &pid]).stdout(Stdio::null()).status();
        pin.map_err(|error| TeamError::Service(format!("taskset: {error}; try --no-pin")))?;
    }
    command.args(["scale", "--as-leader"]).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().map_err(failed)
}

fn connected(child: &mut Child) -> Result<String, TeamError> {
    let began = Instant::now();
    let Some(output) = child.stdout.take() else { return Err(failed("the leader's process has no output")) };
    let mut line = String::new();
    let mut reader = BufReader::new(output);
    reader.read_line(&mut line).map_err(failed)?;
    if line.trim().is_empty() || began.elapsed() > START_LIMIT {
        return Err(failed("the leader's process did not begin"));
    }
    // The summary comes later, from the same pipe.
    child.stdout = Some(reader.into_inner());
    Ok(line.trim().to_owned())
}

fn summary_of(child: &mut Child) -> Result<LeaderSummary, TeamError> {
    let mut last = String::new();
    if let Some(output) = child.stdout.take() {
        for line in BufReader::new(output).lines() {
            last = line.map_err(failed)?;
        }
    }
    child.wait().map_err(failed)?;
    serde_json::from_str(&last).map_err(|error| failed(format!("the leader's process gave no summary: {error}")))
}

fn measure(
    load: &Load,
    endpoint: &str,
    child: &Child,
    progress: &mut dyn FnMut(f64, ProcessFigures),
) -> Result<Figures, TeamError> {
    let runtime = team::runtime()?;
    // `taskset` replaces itself by the leader, so its number is the child's.
    runtime.block_on(measure_async(load, endpoint, &child.id().to_string(), progress))
}

async fn measure_async(
    load: &Load,
    endpoint: &str,
    leader: &str,
    progress: &mut dyn FnMut(f64, ProcessFigures),
) -> Result<Figures, TeamError> {
    let team = leader::team_id()?;
    let observer = Transport::open(Options::client([endpoint])).await.map_err(failed)?;
    let mut maps = observer.subscribe::<TeamMap>(Key::map(team)).await.map_err(failed)?;
    let (stop, stopped) = tokio::sync::watch::channel(sender::Conduct::default());
    let mut senders = Vec::new();
    for index in 0..load.robots {
        let room = load.room(index / ROOM);
        senders.push(sender::start(team, room, index, load.rate_hz, &[endpoint.to_owned()], stopped.clone()).await?);
    }
    let clock = Clock::system();
    let look = || figures_of(leader).ok_or_else(|| failed("the leader's process has ended"));
    let mut tick = tokio::time::interval(LOOK_PERIOD);
    let began = Instant::now();
    let total = SETTLING + Duration::from_secs_f64(load.duration_s);
    let filling = FILLING.min(total / 2);
    let (mut until, mut marks) = (total, Vec::<ProcessFigures>::new());
    let (mut settled, mut ages, mut count) = (None, Vec::new(), 0);
    let (mut last_map, mut all_placed_s, mut least_right) = (None, None, [1.0_f64; 2]);
    let rooms: Vec<Room> = (0..load.robots.div_ceil(ROOM)).map(|number| load.room(number)).collect();
    let there = load.there();
    let end = loop {
        if began.elapsed() >= until {
            let end = look()?;
            marks.push(end);
            let memory_mb: Vec<f64> = marks.iter().map(megabytes).collect();
            if !load.flat || !grows(&memory_mb) || memory_mb.len() > MOST_SPANS {
                break end;
            }
            until += total - filling;
        }
        tokio::select! {
            Some(map) = maps.recv() => {
                if settled.is_some() {
                    count += 1;
                    ages.push(clock.now().seconds_since(map.message.stamp) * 1e3);
                }
                last_map = Some(map.message);
            }
            _ = tick.tick() => {
                let figures = look()?;
                if settled.is_none() && began.elapsed() >= SETTLING {
                    settled = Some((figures, Instant::now()));
                }
                if marks.is_empty() && began.elapsed() >= filling {
                    marks.push(figures);
                }
                if let Some(map) = &last_map {
                    let right = judge::right(map, &rooms);
                    if right[0] == there[0] {
                        all_placed_s.get_or_insert(began.elapsed().as_secs_f64());
                    }
                    for k in (0..2).filter(|_| settled.is_some()) {
                        least_right[k] = least_right[k].min(right[k] as f64 / there[k].max(1) as f64);
                    }
                }
                progress(began.elapsed().as_secs_f64(), figures);
            }
        }
    };
    let (start, since) = settled.unwrap_or((end, began));
    let measured_s = since.elapsed().as_secs_f64().max(1e-3);
    stop.send_modify(|conduct| conduct.stopped = true);
    let mut sent = 0;
    for sender in senders {
        sent += sender.await.map_err(failed)?;
    }
    observer.close().await.map_err(failed)?;
    let placed = last_map.as_ref().map_or([0, 0], |map| {
        [map.robots.iter().filter(|robot| robot.team_from_body.is_some()).count(), map.targets.len()]
    });
    let right = last_map.as_ref().map_or([0, 0], |map| judge::right(map, &rooms));
    Ok(Figures {
        load: load.clone(),
        leader_cores: (end.cpu_s - start.cpu_s) / measured_s,
        latency_ms: [0.0; 3],
        capture_to_map_ms: percentiles(&ages),
        measured_s,
        sent,
        heard: 0,
        lost: 0,
        maps: count,
        placed,
        right: [[right[0], there[0]], [right[1], there[1]]],
        least_right,
        all_placed_s,
        memory_mb: marks.iter().map(megabytes).collect(),
        open_files: marks.iter().map(|figures| figures.open_files).collect(),
    })
}

fn megabytes(figures: &ProcessFigures) -> f64 {
    figures.resident_bytes as f64 * 1e-6
}

/// Median, 99th percentile and largest.
fn percentiles(values: &[f64]) -> [f64; 3] {
    [0.5, 0.99, 1.0].map(|share| percentile(values, share).unwrap_or(0.0))
}

/// Flushes a line to the parent.
fn say(line: &str) -> Result<(), TeamError> {
    let mut output = std::io::stdout().lock();
    writeln!(output, "{line}").and_then(|()| output.flush()).map_err(failed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_leader_that_once_was_kept_waiting_is_flat_and_one_that_leaks_is_not() {
        assert!(!grows(&[39.7, 43.5]));
        // Buffers for a second of waiting, then no more.
        assert!(grows(&[39.7, 48.6]));
        assert!(!grows(&[39.7, 48.6, 49.1]));
        // The same again and again is a tenth of the first, though of the last it is less.
        assert!(grows(&[40.0, 44.1, 48.2, 52.3, 56.4]));
        assert!(!grows(&[40.0]));
        assert!(!grows(&[]));
    }
}
