//! The agent's configuration as it stands in the file. Every key with its unit, its default and what it does.
//! Paths count from the folder of the file.

use std::path::PathBuf;

use protocol::board::metrics::RawMetrics;
use protocol::marker::Marker;
use protocol::security::RawSecurity;
use serde::Deserialize;

/// The whole file. Unknown keys are errors.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RawConfig {
    /// Who the robot is. Required.
    pub robot: RawRobot,
    /// Where frames come from. Required.
    pub capture: RawCapture,
    /// How the agent works on them.
    #[serde(default)]
    pub work: RawWork,
    /// Whom it talks to.
    #[serde(default)]
    pub network: RawNetwork,
    /// Figures for Prometheus. Default: none are served.
    pub metrics: Option<RawMetrics>,
    /// Its certificate, or how else it is known to the leader. Default: nothing, for a leader without `[security]`.
    pub security: Option<RawSecurity>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RawRobot {
    /// The robot's name, `[a-z0-9_-]{1,16}`, unique in the team. Required.
    pub id: String,
    /// The team's name, `[a-z0-9_-]{1,16}`. Required.
    pub team: String,
    /// The camera's file (`camera.toml`). Required.
    pub camera: PathBuf,
    /// What the others see of this robot, as a table. This or `marker_file` is required.
    pub marker: Option<Marker>,
    /// The same, in a TOML file of its own (one file for a team of one look).
    pub marker_file: Option<PathBuf>,
    /// A folder in which alarms outlive the program: raised before a restart and perhaps not heard, they are published again.
    /// Default: none.
    pub state_dir: Option<PathBuf>,
    /// Name of the host, for people, at most 64 bytes. Default: the machine's own name.
    pub host: Option<String>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RawCapture {
    /// A folder of images (with `frames.csv` or `sequence.toml`), a `.y4m` or other video, or a camera (`/dev/video0`).
    /// Required.
    pub source: PathBuf,
    /// When a recording begins: `"leader"` (the leader gives one start for the whole team), or an instant on the robot's
    /// clock (RFC 3339 with offset, or nanoseconds since 1970). Default: as soon as the agent runs, which is right for one
    /// robot only. No effect on a camera.
    pub replay_start: Option<toml::Value>,
    /// Which instant of the recording is played at `replay_start` (RFC 3339 or nanoseconds, as its capture times); the same for
    /// all robots of a team. Default: 0 where the capture times count from the recording's own zero (they are below a
    /// day), else the capture time of the first frame.
    pub recording_start: Option<toml::Value>,
    /// Nominal frames a second, for the announcement and for sources that carry no times. Default 10.
    #[serde(default = "ten")]
    pub frame_rate_hz: f64,
    /// After a recording's last frame: `"stay"` (goes on answering) or `"stop"`. Default `"stay"`.
    #[serde(default = "stay")]
    pub at_end: String,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RawWork {
    /// Columns of the panorama over 360°, 64 to 8192. Default: as many as suit the camera, 1080 for the reference camera.
    /// Time and memory grow with the square.
    pub panorama_columns: Option<u32>,
    /// Time for one frame, milliseconds; stages that would begin later are left out, in turns, and the observation says
    /// so. Default 0, no limit: each frame is worked whole, and of those that come meanwhile the newest is next. A limit
    /// keeps the rate of observations up on a busy processor at the cost of tracks and peers in each.
    pub budget_ms: f64,
    /// Frames a second that are worked on at most; others are dropped and counted. Default 120.
    pub max_frame_rate_hz: f64,
}

impl Default for RawWork {
    fn default() -> Self {
        Self { panorama_columns: None, budget_ms: 0.0, max_frame_rate_hz: 120.0 }
    }
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RawNetwork {
    /// Endpoints of all leaders or zenohd routers of the team, `tcp/HOST:PORT`; the agent holds one link and takes the next
    /// when it is lost. Default `["tcp/127.0.0.1:7447"]`: a leader on this host.
    pub connect: Option<Vec<String>>,
    /// Bytes a second that the agent sends at most, as they stand on the wire (TCP/IP's headers too), 200 to 1e9. Where it needs more,
    /// observations are left out down to 2 a second, then tracks, the least certain first; fellow robots and alarms always go. Default: no
    /// cap. Pictures that somebody asks for are sent whole.
    pub max_bytes_per_s: Option<f64>,
}

fn ten() -> f64 {
    10.0
}

fn stay() -> String {
    "stay".to_owned()
}
