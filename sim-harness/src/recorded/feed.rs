//! A leader fed with encoded messages: what it gets has been through the wire's quantities and checks.

use std::collections::VecDeque;

use protocol::codec::{decode, encode};
use protocol::id::{LeaderId, RobotId};
use protocol::marker::Marker;
use protocol::message::{Announcement, CameraSummary, Guidance, Observation, TeamMap};
use protocol::time::Timestamp;
use team_leader::leader::{Anchor, Input, Leader, LeaderCoreConfig, Output};

use super::RecordedError;

/// A leader and its notices.
#[derive(Debug)]
pub struct Feed {
    leader: Leader,
    /// What it told people.
    pub notices: Vec<String>,
    /// What it said of better places, until somebody takes it; the last [`MAX_GUIDANCE`].
    pub guidance: VecDeque<Guidance>,
}

/// Most guidance kept.
pub const MAX_GUIDANCE: usize = 64;

/// A robot of a recording.
#[derive(Debug, Clone)]
pub struct Recorded {
    /// Its name.
    pub id: RobotId,
    /// Known pose.
    pub fixed: Option<protocol::frames::Pose2>,
    /// Of its camera above the floor, metres.
    pub height_m: f64,
    /// Unknown tilt, radians.
    pub tilt_sigma_rad: f64,
    /// What the others see.
    pub marker: Marker,
    /// Observations a second.
    pub rate_hz: f64,
}

impl Feed {
    /// A leader that has heard the announcements. Its settings are the defaults but for clocks, which a recording shares.
    pub fn new(robots: &[Recorded], change: impl FnOnce(&mut LeaderCoreConfig)) -> Result<Self, RecordedError> {
        let message = |e: &dyn std::fmt::Display| RecordedError::Message(e.to_string());
        let mut config = LeaderCoreConfig::new(LeaderId::new("replay").map_err(|e| message(&e))?);
        config.clock.trusted = true;
        let fixed = robots.iter().filter_map(|r| Some(Anchor { robot: r.id, team_from_body: r.fixed? }));
        config.fixed = fixed.collect();
        change(&mut config);
        let mut feed = Self { leader: Leader::new(config), notices: Vec::new(), guidance: VecDeque::new() };
        for robot in robots {
            let announcement = Announcement {
                robot: robot.id,
                epoch: 1,
                host: "recording".into(),
                version: String::new(),
                marker: robot.marker.clone(),
                camera: CameraSummary {
                    model: "recorded".into(),
                    height_m: robot.height_m as f32 as f64,
                    height_sigma_m: 0.0,
                    tilt_sigma_rad: robot.tilt_sigma_rad,
                    elevation_rad: [-1.5, 1.5],
                    frame_rate_hz: robot.rate_hz,
                },
            };
            let envelope = encode(&announcement).map_err(|e| message(&e))?;
            let announcement = decode(&envelope).map_err(|e| message(&e))?;
            feed.handle(Timestamp::default(), Input::Announcement(announcement));
        }
        Ok(feed)
    }

    /// Sends an observation; the map that comes of it.
    pub fn observe(&mut self, robot: RobotId, observation: &Observation) -> Result<Option<TeamMap>, RecordedError> {
        let message = |e: &dyn std::fmt::Display| RecordedError::Message(format!("observation of {robot}: {e}"));
        let envelope = encode(observation).map_err(|e| message(&e))?;
        let observation: Observation = decode(&envelope).map_err(|e| message(&e))?;
        Ok(self.handle(observation.capture, Input::Observation(robot, observation)))
    }

    fn handle(&mut self, now: Timestamp, input: Input) -> Option<TeamMap> {
        let mut outputs = Vec::new();
        self.leader.handle(now, input, &mut outputs);
        let mut map = None;
        for output in outputs {
            match output {
                Output::Map(new) => map = Some(new),
                Output::Notice(text) => self.notices.push(text),
                Output::Guidance(guidance) => {
                    if self.guidance.len() >= MAX_GUIDANCE {
                        self.guidance.pop_front();
                    }
                    self.guidance.push_back(guidance);
                }
                // Nobody else leads here, and nobody answers.
                _ => {}
            }
        }
        map
    }
}
