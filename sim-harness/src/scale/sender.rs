//! One robot's session: what an agent's shell declares and sends, without an agent.

use std::time::Duration;

use protocol::host_clock::Clock;
use protocol::id::{RobotId, TeamId};
use protocol::key::{Key, RobotTopic};
use protocol::marker::Marker;
use protocol::message::{Announcement, CameraSummary, ClockProbe, ClockReply, Health, Observation};
use protocol::transport::{Options, Transport};
use tokio::sync::watch;
use tokio::task::JoinHandle;

use super::room::{CAMERA_M, CYLINDER_M, RADIUS_M, Room};
use super::{ROOM, failed};
use crate::team::TeamError;

/// Between two health reports.
const HEALTH_PERIOD: Duration = Duration::from_secs(1);

/// How a robot behaves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Conduct {
    /// It ends.
    pub stopped: bool,
    /// Its clock minus the host's, seconds.
    pub clock_s: f64,
    /// How often it sends each observation.
    pub copies: u32,
}

impl Default for Conduct {
    fn default() -> Self {
        Self { stopped: false, clock_s: 0.0, copies: 1 }
    }
}

impl Conduct {
    /// Takes a line: `step SECONDS` sets the clock on, `copies N` is how often each message is sent.
    ///
    /// # Errors
    /// Another line, said.
    pub fn obey(&mut self, line: &str) -> Result<(), TeamError> {
        let wrong = || failed(format!("{line:?} is not `step SECONDS` or `copies N`"));
        match line.trim().split_once(' ') {
            Some(("step", by)) => self.clock_s += by.parse::<f64>().map_err(|_| wrong())?,
            Some(("copies", count)) => self.copies = count.parse().map_err(|_| wrong())?,
            _ => return Err(wrong()),
        }
        Ok(())
    }
}

/// Starts a robot; gives the number of its observations when it is stopped.
pub async fn start(
    team: TeamId,
    mut room: Room,
    index: usize,
    rate_hz: f64,
    endpoints: &[String],
    mut conduct: watch::Receiver<Conduct>,
) -> Result<JoinHandle<u64>, TeamError> {
    let (robot, epoch) = (RobotId::new(&format!("r{index}"))?, index as u64 + 1);
    let key = |topic| Key::robot(team, robot, topic);
    let transport = Transport::open(Options::client(endpoints)).await.map_err(failed)?;
    let announcement = transport.publish::<Announcement>(key(RobotTopic::Announcement)).await.map_err(failed)?;
    let observation = transport.publish::<Observation>(key(RobotTopic::Observation)).await.map_err(failed)?;
    let health = transport.publish::<Health>(key(RobotTopic::Health)).await.map_err(failed)?;
    let mut probes = transport.answer::<ClockProbe>(key(RobotTopic::Clock)).await.map_err(failed)?;
    let alive = transport.declare_alive(key(RobotTopic::Alive)).await.map_err(failed)?;
    announcement.put(&self::announcement(robot, epoch, rate_hz)).map_err(failed)?;
    Ok(tokio::spawn(async move {
        let clock = Clock::system();
        let mut frames = tokio::time::interval(Duration::from_secs_f64(1.0 / rate_hz));
        frames.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
        // Robots do not take their pictures at one instant.
        frames.reset_after(Duration::from_secs_f64((index as f64 * 0.618).fract() / rate_hz));
        let mut reports = tokio::time::interval(HEALTH_PERIOD);
        let mut sent = 0;
        let now = conduct.clone();
        loop {
            tokio::select! {
                _ = conduct.wait_for(|conduct| conduct.stopped) => break,
                _ = frames.tick() => {
                    let Conduct { clock_s, copies, .. } = *now.borrow();
                    let mut seen = room.observe(index % ROOM, clock.now(), epoch);
                    seen.capture = seen.capture.offset_by_secs(clock_s);
                    for _ in 0..copies {
                        sent += u64::from(observation.put(&seen).is_ok());
                    }
                }
                _ = reports.tick() => drop(health.put(&report(robot, epoch, clock, sent))),
                Some(asked) = probes.recv() => {
                    let clock_s = now.borrow().clock_s;
                    let [received, replied] = [asked.arrived, clock.now()].map(|at| at.offset_by_secs(clock_s));
                    let reply = ClockReply { probe_sent: asked.question.sent, received, replied, epoch };
                    // Whoever asked may be gone.
                    let _ = asked.reply(&reply);
                }
            }
        }
        drop((alive, announcement, observation, health, probes));
        let _ = transport.close().await;
        sent
    }))
}

/// What such a robot says of itself.
pub fn announcement(robot: RobotId, epoch: u64, frame_rate_hz: f64) -> Announcement {
    let camera = CameraSummary {
        model: "pal".to_owned(),
        height_m: CAMERA_M,
        height_sigma_m: 0.0,
        tilt_sigma_rad: 0.0,
        elevation_rad: [-0.26, 0.35],
        frame_rate_hz,
    };
    let marker = Marker::Cylinder { radius_m: RADIUS_M, height_m: CYLINDER_M, look: None };
    Announcement {
        robot,
        epoch,
        host: "scale".to_owned(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        marker,
        camera,
    }
}

fn report(robot: RobotId, epoch: u64, clock: Clock, frames: u64) -> Health {
    Health {
        robot,
        epoch,
        at: clock.now(),
        frame_rate_hz: 10.0,
        frames,
        frames_dropped: 0,
        frames_bad: 0,
        stages_skipped: 0,
        messages_dropped: 0,
        messages_refused: 0,
        latency_ms: [0.0; 2],
        traffic: Vec::new(),
    }
}
