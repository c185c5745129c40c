//! The agent's configuration file: read strictly, checked whole, turned into a type whose fields cannot be wrong.

mod marker;
mod raw;

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use protocol::document::{Document, DocumentError, INSTANT_WANTED, endpoint_problem, parse_instant};
use protocol::id::{RobotId, TeamId};
use protocol::marker::Marker;
use protocol::security::{Member, Security, roster::Role};
use protocol::time::Timestamp;

use raw::{RawCapture, RawConfig};

/// A capture time below this (a day) counts from a recording's own zero, not from 1970.
pub const RECORDING_ZERO_BELOW: Timestamp = Timestamp(86_400_000_000_000);

/// Port of `/metrics` where the file gives none.
const METRICS_PORT: u16 = 9465;

/// Everything `robot-agent run` needs to know, checked.
#[derive(Debug, Clone)]
pub struct Config {
    /// Where it was read from.
    pub path: PathBuf,
    /// The robot's name.
    pub robot: RobotId,
    /// The team's name.
    pub team: TeamId,
    /// Name of the host, for people.
    pub host: String,
    /// Where alarms outlive the program.
    pub state_dir: Option<PathBuf>,
    /// `camera.toml`.
    pub camera: PathBuf,
    /// What the robot wears.
    pub marker: Marker,
    /// Where frames come from.
    pub capture: CaptureConfig,
    /// How it works on them.
    pub work: WorkConfig,
    /// Endpoints of leaders and routers.
    pub connect: Vec<String>,
    /// Whether `connect` is the default because the file says nothing.
    pub connect_is_default: bool,
    /// Bytes a second on the wire that it keeps to, where there is a cap.
    pub max_bytes_per_s: Option<f64>,
    /// Its certificate, or how else it is known to the leader.
    pub security: Security,
    /// Address of `/metrics`, where it is wanted.
    pub metrics: Option<SocketAddr>,
}

/// Where frames come from, and when.
#[derive(Debug, Clone, PartialEq)]
pub struct CaptureConfig {
    /// A folder of images, a video, or a camera device.
    pub source: PathBuf,
    /// When a recording begins.
    pub replay_start: ReplayStart,
    /// Which instant of the recording is played at `replay_start`; `None`: the recording's own zero where it counts from
    /// one ([`RECORDING_ZERO_BELOW`]), else its first frame.
    pub recording_start: Option<Timestamp>,
    /// Nominal frames a second.
    pub frame_rate_hz: f64,
    /// What follows the last frame of a recording.
    pub at_end: AtEnd,
}

/// When a recording begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ReplayStart {
    /// As soon as the agent runs.
    Now,
    /// At this instant of the robot's clock.
    At(Timestamp),
    /// When the leader says, on the leader's clock.
    Leader,
}

/// What follows the last frame of a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AtEnd {
    /// The agent stays and answers.
    Stay,
    /// The agent stops.
    Stop,
}

/// How the agent works on frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WorkConfig {
    /// Columns of the panorama over 360°; `None`: as many as suit the camera.
    pub panorama_columns: Option<u32>,
    /// Time for one frame, seconds; stages that would begin later are left out and said so. `None`: all stages run.
    pub budget_s: Option<f64>,
    /// Frames a second that are worked on at most.
    pub max_frame_rate_hz: f64,
}

impl Config {
    /// Reads and checks a file. Files it names are checked where they are opened (`robot-agent check` opens all of them).
    pub fn read(path: &Path) -> Result<Self, DocumentError> {
        Self::from_document(&Document::read(path)?)
    }

    /// Checks a text that has been read.
    pub fn from_document(document: &Document) -> Result<Self, DocumentError> {
        let raw: RawConfig = document.parse()?;
        let r = &raw.robot;
        let connect = raw.network.connect.as_deref().map(|given| endpoints(document, given)).transpose()?;
        let work = &raw.work;
        let robot = RobotId::new(&r.id).map_err(|e| document.invalid("robot.id", quoted(&r.id), e.to_string()))?;
        let team = TeamId::new(&r.team).map_err(|e| document.invalid("robot.team", quoted(&r.team), e.to_string()))?;
        let who = Member { team, role: Role::Robot, name: robot.as_str() };
        let security = Security::checked(document, raw.security.as_ref(), who, None, connect.as_deref())?;
        Ok(Self {
            path: document.path().to_owned(),
            robot,
            team,
            host: host(document, r.host.as_deref())?,
            state_dir: r.state_dir.as_ref().map(|dir| document.resolve(dir)),
            camera: document.resolve(&r.camera),
            marker: marker::checked(document, r)?,
            capture: capture(document, &raw.capture)?,
            work: WorkConfig {
                panorama_columns: columns(document, work.panorama_columns)?,
                budget_s: match in_range(document, "work.budget_ms", work.budget_ms, 0.0, 1e4, "milliseconds")? {
                    0.0 => None,
                    ms => Some(ms * 1e-3),
                },
                max_frame_rate_hz: in_range(
                    document,
                    "work.max_frame_rate_hz",
                    work.max_frame_rate_hz,
                    0.01,
                    120.0,
                    "frames a second",
                )?,
            },
            connect_is_default: connect.is_none(),
            connect: connect.unwrap_or_else(|| vec![security.default_endpoint()]),
            security,
            max_bytes_per_s: raw
                .network
                .max_bytes_per_s
                .map(|cap| in_range(document, "network.max_bytes_per_s", cap, 200.0, 1e9, "bytes a second"))
                .transpose()?,
            metrics: raw.metrics.as_ref().map(|raw| raw.checked(document, METRICS_PORT)).transpose()?,
        })
    }
}

fn capture(document: &Document, raw: &RawCapture) -> Result<CaptureConfig, DocumentError> {
    let replay_start = match &raw.replay_start {
        None => ReplayStart::Now,
        Some(toml::Value::String(text)) if text == "leader" => ReplayStart::Leader,
        Some(value) => match parse_instant(value) {
            Some(instant) => ReplayStart::At(instant),
            None => {
                let wanted = format!("\"leader\" (the leader gives one start for the team), or {INSTANT_WANTED}");
                return Err(document.invalid("capture.replay_start", value, wanted));
            }
        },
    };
    let recording_start = match &raw.recording_start {
        None => None,
        Some(value) => Some(
            parse_instant(value).ok_or_else(|| document.invalid("capture.recording_start", value, INSTANT_WANTED))?,
        ),
    };
    let at_end = match raw.at_end.as_str() {
        "stay" => AtEnd::Stay,
        "stop" => AtEnd::Stop,
        other => {
            let wanted = "\"stay\" (the agent goes on answering) or \"stop\" (it ends)";
            return Err(document.invalid("capture.at_end", quoted(other), wanted));
        }
    };
    let rate = in_range(document, "capture.frame_rate_hz", raw.frame_rate_hz, 0.01, 120.0, "frames a second")?;
    let source = document.resolve(&raw.source);
    Ok(CaptureConfig { source, replay_start, recording_start, frame_rate_hz: rate, at_end })
}

fn columns(document: &Document, given: Option<u32>) -> Result<Option<u32>, DocumentError> {
    let Some(given) = given else { return Ok(None) };
    if (64..=8192).contains(&given) {
        return Ok(Some(given));
    }
    Err(document.invalid("work.panorama_columns", given, "columns over 360°, 64 to 8192"))
}

fn host(document: &Document, given: Option<&str>) -> Result<String, DocumentError> {
    match given {
        Some(name) if name.len() <= 64 => Ok(name.to_owned()),
        Some(name) => Err(document.invalid("robot.host", quoted(name), "at most 64 bytes")),
        None => Ok(this_host()),
    }
}

/// The machine's own name, as Linux tells it; for people only, so not knowing it is no error.
fn this_host() -> String {
    let name = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let name: String = name.trim().chars().take(64).filter(char::is_ascii).collect();
    if name.is_empty() { "unknown".to_owned() } else { name }
}

fn endpoints(document: &Document, given: &[String]) -> Result<Vec<String>, DocumentError> {
    if given.is_empty() {
        let wanted = "an agent needs at least one leader or router to connect to";
        return Err(document.invalid("network.connect", "[]", wanted));
    }
    for text in given {
        if let Some(problem) = endpoint_problem(text, false) {
            return Err(document.invalid("network.connect", quoted(text), problem));
        }
    }
    Ok(given.to_vec())
}

fn in_range(document: &Document, key: &str, value: f64, low: f64, high: f64, unit: &str) -> Result<f64, DocumentError> {
    if (low..=high).contains(&value) {
        return Ok(value);
    }
    Err(document.invalid(key, value, format!("{unit} between {low} and {high}")))
}

fn quoted(text: &str) -> String {
    format!("{text:?}")
}

#[cfg(test)]
mod tests {
    use super::*;

    const LEAST: &str = "[robot]\nid = 'r1'\nteam = 'demo'\ncamera = 'camera.toml'\n\
                         marker = { kind = 'cylinder', radius_m = 0.2 }\n[capture]\nsource = 'frames'\n";

    #[test]
    fn a_short_file_gets_defaults_on_loopback_and_paths_beside_it() {
        let config = read(LEAST).unwrap();
        assert_eq!(config.connect, ["tcp/127.0.0.1:7447"]);
        assert!(config.connect_is_default && !config.host.is_empty());
        assert_eq!(config.camera, Path::new("/etc/pal/camera.toml"));
        assert_eq!(config.capture.source, Path::new("/etc/pal/frames"));
        assert_eq!(config.capture.replay_start, ReplayStart::Now);
        assert_eq!(config.capture.at_end, AtEnd::Stay);
        assert!(matches!(config.marker, Marker::Cylinder { height_m: [0.1, 0.5], look: None, .. }));
    }

    #[test]
    fn a_recording_begins_at_an_instant_or_when_the_leader_says() {
        let at = |value: &str| read(&format!("{LEAST}replay_start = {value}\n")).map(|c| c.capture.replay_start);
        assert_eq!(at("'leader'").unwrap(), ReplayStart::Leader);
        let instant = ReplayStart::At(Timestamp(1_795_248_000_000_000_000));
        assert_eq!(at("2026-11-21T08:00:00Z").unwrap(), instant);
        assert_eq!(at("'2026-11-21T09:00:00+01:00'").unwrap(), instant);
        assert_eq!(at("1795248000000000000").unwrap(), instant);
        let message = at("'leder'").unwrap_err().to_string();
        for part in ["agent.toml:8", "capture.replay_start", "leder", "\"leader\"", "RFC 3339"] {
            assert!(message.contains(part), "{part:?} is missing in: {message}");
        }
    }

    #[test]
    fn what_is_wrong_is_named_with_its_line_and_what_would_be_right() {
        for (from, to, parts) in [
            ("'r1'", "'R 1'", vec!["agent.toml:2", "robot.id", "R 1", "a-z"]),
            ("'demo'", "'a-team-with-a-long-name'", vec!["agent.toml:3", "robot.team", "1 to 16"]),
            ("radius_m = 0.2", "radius_mm = 200", vec!["agent.toml:5", "radius_mm", "radius_m"]),
            ("radius_m = 0.2", "radius_m = 200.0", vec!["agent.toml:5", "robot.marker.radius_m", "200", "metres"]),
            ("source", "sauce", vec!["agent.toml:7", "sauce", "`source`"]),
            ("'frames'", "'frames'\nat_end = 'loop'", vec!["agent.toml:8", "\"loop\"", "stay", "stop"]),
            ("'frames'", "'f'\nframe_rate_hz = 1e6", vec!["agent.toml:8", "1000000", "frames a second"]),
            ("'frames'", "'f'\n[work]\nbudget_ms = -1.0", vec!["agent.toml:9", "work.budget_ms", "milliseconds"]),
            ("'frames'", "'f'\n[network]\nconnect = []", vec!["agent.toml:9", "at least one leader"]),
            ("'frames'", "'f'\n[network]\nconnect = ['10.0.0.1']", vec!["agent.toml:9", "tcp/127.0.0.1:7447"]),
        ] {
            let text = LEAST.replacen(from, to, 1);
            let message = read(&text).map(|_| ()).unwrap_err().to_string();
            for part in parts {
                assert!(message.contains(part), "{part:?} is missing in: {message}");
            }
        }
    }

    fn read(text: &str) -> Result<Config, DocumentError> {
        Config::from_document(&Document::from_text(Path::new("/etc/pal/agent.toml"), text.to_owned()))
    }
}
