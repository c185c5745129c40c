//! All that reached a leader, as a file; and the same leader fed with it again: a run's maps and score in a second, without
//! a picture being rendered. For work on the leader, and for looking at what it made of a message.
//!
//! ```text
//! {"scenario":{..},"seed":3,"duration_s":60.0,"robots":["r1",..]}                                first line
//! {"arrival_ns":..,"key":"pal/sim/robot/r1/observation","envelope":"50414c.."}                    a message, hexadecimal
//! {"robot":"r1","time_s":4.73,"visible_fraction":[0.8,..]}                                        truth: who could see whom
//! ```
//! The world is made again from scenario and seed, so a recording stands for as long as those mean the same. Deadlines of the
//! leader are kept, its clock probes are not sent again: the recorded replies answer those of the run.

use std::fs::File;
use std::io::{self, BufRead, BufReader, BufWriter, Write};
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use protocol::codec::{DecodeError, decode};
use protocol::id::RobotId;
use protocol::key::{Key, RobotTopic, Topic};
use protocol::time::Timestamp;
use serde::{Deserialize, Serialize};
use team_leader::leader::{Input, Leader, LeaderCoreConfig, Output};
use team_leader::team_map::json::EdgeJson;

use crate::bandwidth::VideoRate;
use crate::scenario::Scenario;
use crate::score::scores::Latency;
use crate::team::simulated::leader_clock;
use crate::team::truth::Glimpse;
use crate::team::{Outcome, TeamError, leader_id};
use crate::world::World;

/// Name of the file in the folder of a run.
pub const FILE: &str = "leader.jsonl";
/// Most messages in a recording.
const MAX_MESSAGES: usize = 10_000_000;

/// What reached the leader.
#[derive(Debug, Clone, PartialEq)]
pub struct Heard {
    /// On the leader's clock.
    pub arrival: Timestamp,
    /// Under which key; `alive` is the appearance of a robot's liveliness token.
    pub key: Key,
    /// As encoded by the sender.
    pub envelope: Arc<[u8]>,
}

/// A recorded run.
#[derive(Debug, Clone)]
pub struct Recording {
    header: Header,
    heard: Vec<Heard>,
    glimpses: Vec<Vec<Glimpse>>,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    scenario: Scenario,
    seed: u64,
    duration_s: f64,
    /// In the order of the world.
    robots: Vec<RobotId>,
}

impl Header {
    /// What is wrong, in words.
    fn check(&self, file: &str) -> Result<(), String> {
        self.scenario.check(file).map_err(|error| error.to_string())?;
        let (longest_s, robots) = (self.scenario.duration_s, self.scenario.robots.count);
        if !(self.duration_s > 0.0 && self.duration_s <= longest_s) {
            return Err(format!(
                "`duration_s = {}` is not possible; more than 0 and at most {longest_s} seconds, the scenario's length, would be right",
                self.duration_s
            ));
        }
        if self.robots.len() != robots {
            return Err(format!("`robots` names {}; the scenario's {robots} would be right", self.robots.len()));
        }
        Ok(())
    }
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(untagged)]
enum Line {
    Message {
        arrival_ns: u64,
        key: String,
        envelope: String,
    },
    Seen {
        robot: RobotId,
        #[serde(flatten)]
        glimpse: Glimpse,
    },
}

/// The leader's input in a message; `None` of keys that are not for it.
pub fn leader_input(key: &Key, envelope: &[u8]) -> Result<Option<Input>, DecodeError> {
    let Topic::Robot(robot, topic) = key.topic else { return Ok(None) };
    Ok(Some(match topic {
        RobotTopic::Alive => Input::RobotAlive(robot),
        RobotTopic::Announcement => Input::Announcement(decode(envelope)?),
        RobotTopic::Observation => Input::Observation(robot, decode(envelope)?),
        RobotTopic::Clock => Input::ClockReply(robot, decode(envelope)?),
        RobotTopic::Alarm => Input::Alarm(decode(envelope)?),
        RobotTopic::Health => Input::Health(decode(envelope)?),
        RobotTopic::Edges => Input::Edges(robot, decode(envelope)?),
        RobotTopic::Picture(_) | RobotTopic::Command => return Ok(None),
    }))
}

/// Writes what the leader of a run heard.
pub fn write(outcome: &Outcome, path: &Path) -> Result<(), TeamError> {
    let write = || -> io::Result<()> {
        let mut file = BufWriter::new(File::create(path)?);
        let header = Header {
            scenario: outcome.scenario.clone(),
            seed: outcome.world.seed(),
            duration_s: outcome.duration_s,
            robots: outcome.names.clone(),
        };
        serde_json::to_writer(&mut file, &header)?;
        let messages = outcome.heard.iter().map(|heard| Line::Message {
            arrival_ns: heard.arrival.0,
            key: heard.key.to_string(),
            envelope: heard.envelope.iter().map(|byte| format!("{byte:02x}")).collect(),
        });
        let seen = outcome.names.iter().zip(&outcome.glimpses).flat_map(|(robot, glimpses)| {
            glimpses.iter().map(|glimpse| Line::Seen { robot: *robot, glimpse: glimpse.clone() })
        });
        for line in messages.chain(seen) {
            file.write_all(b"\n")?;
            serde_json::to_writer(&mut file, &line)?;
        }
        file.write_all(b"\n")?;
        file.flush()
    };
    write().map_err(|source| TeamError::Output { path: path.to_owned(), source })
}

impl Recording {
    /// Reads a file of [`write()`], or that of a run's folder.
    pub fn read(path: &Path) -> Result<Self, TeamError> {
        let path = if path.is_dir() { path.join(FILE) } else { path.to_owned() };
        let fault = |reason: String| TeamError::Recording { file: path.clone(), reason };
        let file = File::open(&path)
            .map_err(|e| fault(format!("{e}; give the --out folder of `run --transport simulated`, or its {FILE}")))?;
        let mut lines = BufReader::new(file).lines();
        let first = lines.next().ok_or_else(|| fault("is empty".to_owned()))?.map_err(|e| fault(e.to_string()))?;
        let header: Header = serde_json::from_str(&first).map_err(|e| fault(format!("line 1: {e}")))?;
        header.check(&path.display().to_string()).map_err(|why| fault(format!("line 1: {why}")))?;
        let mut heard = Vec::new();
        let mut glimpses = vec![Vec::new(); header.robots.len()];
        for (line, number) in lines.zip(2..) {
            let fault = |reason: String| fault(format!("line {number}: {reason}"));
            let line = line.map_err(|e| fault(e.to_string()))?;
            match serde_json::from_str(&line)
                .map_err(|_| fault("is neither a message nor what a robot saw".to_owned()))?
            {
                Line::Message { arrival_ns, key, envelope } => {
                    let envelope = bytes(&envelope).ok_or_else(|| fault("`envelope` is not hexadecimal".to_owned()))?;
                    let key = key.parse().map_err(|e| fault(format!("{e}")))?;
                    heard.push(Heard { arrival: Timestamp(arrival_ns), key, envelope });
                }
                Line::Seen { robot, glimpse } => {
                    let index = header.robots.iter().position(|name| *name == robot);
                    glimpses[index.ok_or_else(|| fault(format!("robot {robot} is not in line 1")))?].push(glimpse);
                }
            }
            if heard.len() > MAX_MESSAGES {
                return Err(fault(format!("more than {MAX_MESSAGES} messages")));
            }
        }
        if heard.is_empty() {
            let wanted = r#"lines {"arrival_ns":..,"key":..,"envelope":..} would be right"#;
            return Err(fault(format!("has no message to the leader; {wanted}")));
        }
        Ok(Self { header, heard, glimpses })
    }

    /// Feeds a leader with the recording. Latency is the real time of the leader's steps; traffic and pictures are not there.
    pub fn replay(self) -> Result<Outcome, TeamError> {
        let Self { header: Header { scenario, seed, duration_s, robots }, heard, glimpses } = self;
        let world = Arc::new(World::new(&scenario, seed)?);
        let mut leader = Leader::new(LeaderCoreConfig::new(leader_id()?));
        let (mut maps, mut observations, mut notices) = (Vec::new(), Vec::new(), Vec::new());
        let mut step_ms = Vec::new();
        let mut outputs = Vec::new();
        for message in &heard {
            if let Some(deadline) = leader.next_deadline().filter(|at| *at < message.arrival) {
                leader.handle(deadline, Input::Deadline, &mut outputs);
            }
            let input = match leader_input(&message.key, &message.envelope) {
                Ok(Some(input)) => input,
                Ok(None) => continue,
                Err(error) => {
                    notices.push(format!("leader, under {}: {error}", message.key));
                    continue;
                }
            };
            if let Input::Observation(robot, observation) = &input {
                observations.push((*robot, observation.clone()));
            }
            let begin = Instant::now();
            leader.handle(message.arrival, input, &mut outputs);
            let took_ms = begin.elapsed().as_secs_f64() * 1e3;
            for output in outputs.drain(..) {
                match output {
                    Output::Map(map) => {
                        step_ms.push(took_ms);
                        maps.push(map);
                    }
                    Output::Notice(text) => notices.push(format!("leader: {text}")),
                    Output::ClockProbe(..)
                    | Output::Guidance(_)
                    | Output::Surroundings(_)
                    | Output::Reign(_)
                    | Output::Renew
                    | Output::Candidacy(_)
                    | Output::Alarm(_) => {}
                }
            }
        }
        Ok(Outcome {
            scenario,
            world,
            names: robots,
            duration_s,
            zero: leader_clock(0),
            edges: leader.structure().iter().map(EdgeJson::of).collect(),
            maps,
            observations,
            heard,
            glimpses,
            latency_ms: Latency::of(&step_ms),
            capture_to_map_ms: Latency::default(),
            modelled: false,
            bandwidth: Vec::new(),
            video: VideoRate::default(),
            pictures: Vec::new(),
            frames: Vec::new(),
            notices,
            late_frames: 0,
        })
    }
}

fn bytes(hexadecimal: &str) -> Option<Arc<[u8]>> {
    let digit = |digit: &u8| char::from(*digit).to_digit(16).and_then(|value| u8::try_from(value).ok());
    let (pairs, rest) = hexadecimal.as_bytes().as_chunks::<2>();
    let bytes = pairs.iter().map(|[high, low]| Some(16 * digit(high)? + digit(low)?)).collect();
    if rest.is_empty() { bytes } else { None }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The error of a recording of the scenario `tiny` with a first line that is changed and these lines after it.
    fn refused(change: impl Fn(&mut Header), rest: &str) -> String {
        let scenario = Scenario::builtin("tiny").unwrap().unwrap();
        let robots = scenario.robot_ids();
        let mut header = Header { duration_s: scenario.duration_s, seed: 1, scenario, robots };
        change(&mut header);
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), format!("{}\n{rest}", serde_json::to_string(&header).unwrap())).unwrap();
        Recording::read(file.path()).unwrap_err().to_string()
    }

    #[test]
    fn a_recording_without_messages_is_refused() {
        let error = refused(|_| {}, "");
        assert!(error.contains("no message") && error.contains("arrival_ns"), "{error}");
    }

    #[test]
    fn a_first_line_that_cannot_be_is_named_with_key_and_value() {
        for duration_s in [-1.0, 0.0, 1e300] {
            let error = refused(|header| header.duration_s = duration_s, "");
            let named = error.contains("line 1") && error.contains(&format!("`duration_s = {duration_s}`"));
            assert!(named && error.contains("at most 5 seconds"), "{error}");
        }
        let error = refused(|header| header.scenario.duration_s = 1e300, "");
        assert!(error.contains("line 1") && error.contains("0.1 to 3600 seconds"), "{error}");
        let error = refused(|header| header.robots.truncate(1), "");
        assert!(error.contains("line 1") && error.contains("`robots` names 1"), "{error}");
    }
}
