//! The leader's configuration as it stands in the file. Every key with its unit, its default and what it does.

use std::path::PathBuf;

use protocol::board::metrics::RawMetrics;
use protocol::security::RawSecurity;
use serde::Deserialize;

/// The whole file. Unknown keys are errors.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RawConfig {
    /// Who leads whom. Required.
    pub leader: RawLeader,
    /// How it is reached.
    #[serde(default)]
    pub network: RawNetwork,
    /// Who may join, and what each may say and read. Default: only this host can join.
    pub security: Option<RawSecurity>,
    /// Where the team's frame is. Default: the body frame of the first standing robot.
    pub gauge: Option<RawGauge>,
    /// How clocks are compared.
    #[serde(default)]
    pub clock: RawClock,
    /// What moving objects are like.
    #[serde(default)]
    pub targets: RawTargets,
    /// How the map is given to others.
    #[serde(default)]
    pub map: RawMap,
    /// Figures for Prometheus. Default: none are served.
    pub metrics: Option<RawMetrics>,
    /// When recordings are to be replayed. Default: they are not; robots replay at their own `replay_start`.
    pub replay: Option<RawReplay>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RawLeader {
    /// The leader's name, `[a-z0-9_-]{1,16}`, unique in the team. Required.
    pub id: String,
    /// The team's name, `[a-z0-9_-]{1,16}`: the leader hears the robots of this team only. Required.
    pub team: String,
    /// The first term of a team that has none; whoever takes over takes the next one by itself. Default 1.
    #[serde(default = "one")]
    pub term: u64,
    /// A folder in which places, gauge, numbers of targets, term and the record of alarms outlive the program. Default: none,
    /// a restarted leader begins anew. Counts from the folder of the file.
    pub state_dir: Option<PathBuf>,
    /// A robot that is alive but has sent no observation for so long is shown as silent, seconds. Default 1.0.
    #[serde(default = "one_second")]
    pub silent_after_s: f64,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RawNetwork {
    /// Endpoints that agents and operators connect to, `tcp/HOST:PORT`. Default `["tcp/127.0.0.1:7447"]`: this host alone.
    /// Beyond loopback only with a `[security]` section; with certificates `tls/HOST:PORT`.
    pub listen: Option<Vec<String>>,
    /// Endpoints of other leaders or zenohd routers of the team. Default: none.
    #[serde(default)]
    pub connect: Vec<String>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RawGauge {
    /// The robot whose pose is given. Required.
    pub robot: String,
    /// Where it stands at the first solution, metres. Default 0.
    #[serde(default)]
    pub x_m: f64,
    /// Metres. Default 0.
    #[serde(default)]
    pub y_m: f64,
    /// Counter-clockwise from the team's x axis, degrees. Default 0.
    #[serde(default)]
    pub heading_deg: f64,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RawClock {
    /// All robots' clocks are the leader's already: nothing is probed. Default false: offsets are measured.
    #[serde(default)]
    pub trusted: bool,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RawTargets {
    /// A target that nobody has seen for so long is dropped, seconds. Default 2.0.
    pub forget_after_s: f64,
    /// A target is published while the larger axis of its one-sigma ellipse is below this, metres. Default 0.5.
    pub publish_below_m: f64,
    /// Mean height of people, metres: a weak cue for pairing, never a measurement of position. Default 1.72.
    pub person_height_m: f64,
    /// Its standard deviation, metres. Default 0.12.
    pub person_height_sigma_m: f64,
}

impl Default for RawTargets {
    fn default() -> Self {
        let core = crate::leader::TargetConfig::default();
        Self {
            forget_after_s: core.forget_after_s,
            publish_below_m: core.publish_below_m,
            person_height_m: core.person_height_m.0,
            person_height_sigma_m: core.person_height_m.1,
        }
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RawMap {
    /// Publish the map as JSON too, while somebody listens to `…/map/json`. Default true. Costs nothing while nobody does.
    pub json: bool,
}

impl Default for RawMap {
    fn default() -> Self {
        Self { json: true }
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RawReplay {
    /// The instant (RFC 3339 with offset, or nanoseconds since 1970; leader's clock) at which all recordings begin.
    pub start: Option<toml::Value>,
    /// Instead of `start`: begin when so many robots have joined.
    pub robots: Option<usize>,
    /// Then wait so long, seconds. Default 1.0.
    #[serde(default = "one_second")]
    pub delay_s: f64,
}

fn one() -> u64 {
    1
}

fn one_second() -> f64 {
    1.0
}
