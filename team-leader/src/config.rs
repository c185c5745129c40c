//! The leader's configuration file: read strictly, checked whole, turned into a type whose fields cannot be wrong.

mod raw;

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use protocol::document::{Document, DocumentError, INSTANT_WANTED, endpoint_problem, parse_instant};
use protocol::fence::MAX_TERM;
use protocol::frames::Pose2;
use protocol::id::{LeaderId, RobotId, TeamId};
use protocol::message::map::MAX_ROBOTS;
use protocol::security::{Member, Security, roster::Role};
use protocol::time::Timestamp;

use crate::leader::{Anchor, LeaderCoreConfig};
use raw::RawConfig;

/// Port of `/metrics` where the file gives none.
const METRICS_PORT: u16 = 9464;
/// A leader that connects to others first listens for so long whether one of them leads, seconds.
const LISTENS_S: f64 = 1.0;

/// Everything `team-leader run` needs to know, checked.
#[derive(Debug, Clone)]
pub struct Config {
    /// The team's name.
    pub team: TeamId,
    /// The leader's name.
    pub id: LeaderId,
    /// Settings of the pure leader.
    pub core: LeaderCoreConfig,
    /// Endpoints to listen on.
    pub listen: Vec<String>,
    /// Whether `listen` is the default because the file says nothing.
    pub listen_is_default: bool,
    /// Endpoints of other leaders and routers.
    pub connect: Vec<String>,
    /// Certificates and access control.
    pub security: Security,
    /// Address of `/metrics`, where it is wanted.
    pub metrics: Option<SocketAddr>,
    /// Where what must outlive the program is kept.
    pub state_dir: Option<PathBuf>,
    /// Whether the map is also published as JSON while somebody listens.
    pub json: bool,
    /// When recordings are to be replayed, if they are.
    pub replay: Option<Replay>,
}

/// When robots that replay recordings (`replay_start = "leader"`) begin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Replay {
    /// At this instant of the leader's clock.
    At(Timestamp),
    /// Once so many robots have joined, and a little later.
    WhenJoined {
        /// How many.
        robots: usize,
        /// Seconds between the last one's joining and the start.
        delay_s: f64,
    },
}

impl Config {
    /// Reads and checks a file.
    pub fn read(path: &Path) -> Result<Self, DocumentError> {
        Self::from_document(&Document::read(path)?)
    }

    /// Checks a text that has been read.
    pub fn from_document(document: &Document) -> Result<Self, DocumentError> {
        let raw: RawConfig = document.parse()?;
        let id = LeaderId::new(&raw.leader.id)
            .map_err(|e| document.invalid("leader.id", quoted(&raw.leader.id), e.to_string()))?;
        let team = TeamId::new(&raw.leader.team)
            .map_err(|e| document.invalid("leader.team", quoted(&raw.leader.team), e.to_string()))?;
        let mut core = LeaderCoreConfig::new(id);
        core.term = raw.leader.term;
        if core.term > MAX_TERM {
            let wanted = format!("a first term of at most {MAX_TERM}");
            return Err(document.invalid("leader.term", core.term.to_string(), wanted));
        }
        if !raw.network.connect.is_empty() {
            core.listens_s = LISTENS_S;
        }
        core.anchor = raw.gauge.as_ref().map(|gauge| anchor(document, gauge)).transpose()?;
        core.clock.trusted = raw.clock.trusted;
        let t = &raw.targets;
        core.silent_after_s =
            in_range(document, "leader.silent_after_s", raw.leader.silent_after_s, 0.1, 3600.0, "seconds")?;
        core.targets.forget_after_s =
            in_range(document, "targets.forget_after_s", t.forget_after_s, 0.1, 3600.0, "seconds")?;
        core.targets.publish_below_m =
            in_range(document, "targets.publish_below_m", t.publish_below_m, 0.01, 100.0, "metres")?;
        core.targets.person_height_m = (
            in_range(document, "targets.person_height_m", t.person_height_m, 0.5, 2.5, "metres")?,
            in_range(document, "targets.person_height_sigma_m", t.person_height_sigma_m, 0.001, 2.0, "metres")?,
        );
        let listen = endpoints(document, "network.listen", raw.network.listen.as_deref(), true)?;
        if listen.as_ref().is_some_and(Vec::is_empty) {
            let wanted = "a leader listens on at least one endpoint, or no agent can join";
            return Err(document.invalid("network.listen", "[]", wanted));
        }
        let connect = endpoints(document, "network.connect", Some(&raw.network.connect), false)?.unwrap_or_default();
        let who = Member { team, role: Role::Leader, name: id.as_str() };
        let security = Security::checked(document, raw.security.as_ref(), who, listen.as_deref(), Some(&connect))?;
        Ok(Self {
            team,
            id,
            core,
            listen_is_default: listen.is_none(),
            listen: listen.unwrap_or_else(|| vec![security.default_endpoint()]),
            connect,
            security,
            metrics: raw.metrics.as_ref().map(|raw| raw.checked(document, METRICS_PORT)).transpose()?,
            state_dir: raw.leader.state_dir.as_ref().map(|dir| document.resolve(dir)),
            json: raw.map.json,
            replay: raw.replay.as_ref().map(|replay| self::replay(document, replay)).transpose()?,
        })
    }
}

fn anchor(document: &Document, raw: &raw::RawGauge) -> Result<Anchor, DocumentError> {
    let robot =
        RobotId::new(&raw.robot).map_err(|e| document.invalid("gauge.robot", quoted(&raw.robot), e.to_string()))?;
    let x_m = in_range(document, "gauge.x_m", raw.x_m, -1e6, 1e6, "metres")?;
    let y_m = in_range(document, "gauge.y_m", raw.y_m, -1e6, 1e6, "metres")?;
    let heading_deg = in_range(document, "gauge.heading_deg", raw.heading_deg, -360.0, 360.0, "degrees")?;
    Ok(Anchor { robot, team_from_body: Pose2::new(x_m, y_m, heading_deg.to_radians()) })
}

fn replay(document: &Document, raw: &raw::RawReplay) -> Result<Replay, DocumentError> {
    match (&raw.start, raw.robots) {
        (Some(value), None) => {
            parse_instant(value).map(Replay::At).ok_or_else(|| document.invalid("replay.start", value, INSTANT_WANTED))
        }
        (None, Some(robots)) if (1..=MAX_ROBOTS).contains(&robots) => {
            let delay_s = in_range(document, "replay.delay_s", raw.delay_s, 0.0, 3600.0, "seconds")?;
            Ok(Replay::WhenJoined { robots, delay_s })
        }
        (None, Some(robots)) => Err(document.invalid("replay.robots", robots, format!("1 to {MAX_ROBOTS}"))),
        (start, robots) => {
            let given = if start.is_some() && robots.is_some() { "both" } else { "neither" };
            let wanted = "give either `start` (an instant) or `robots` (how many must have joined)";
            Err(document.invalid("replay", format!("{given} of `start` and `robots`"), wanted))
        }
    }
}

fn endpoints(
    document: &Document,
    key: &str,
    given: Option<&[String]>,
    listens: bool,
) -> Result<Option<Vec<String>>, DocumentError> {
    let Some(given) = given else { return Ok(None) };
    for text in given {
        if let Some(problem) = endpoint_problem(text, listens) {
            return Err(document.invalid(key, quoted(text), problem));
        }
    }
    Ok(Some(given.to_vec()))
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

    const LEAST: &str = "[leader]\nid = \"l1\"\nteam = \"demo\"\n";

    #[test]
    fn a_file_with_only_names_gets_defaults_on_loopback() {
        let config = read(LEAST).unwrap();
        assert_eq!(config.listen, ["tcp/127.0.0.1:7447"]);
        assert!(config.listen_is_default && config.connect.is_empty() && config.json && config.replay.is_none());
        assert_eq!(config.core, LeaderCoreConfig::new(LeaderId::new("l1").unwrap()), "defaults differ from the core's");
    }

    #[test]
    fn everything_that_can_be_said_is_understood() {
        let config = read(
            "[leader]\nid = 'l1'\nteam = 'demo'\nterm = 7\n[security]\nmode = 'none'\n[network]\nlisten = ['tcp/0.0.0.0:7447']\n\
             connect = ['tcp/10.0.0.2:7447']\n[gauge]\nrobot = 'r1'\nx_m = 1.0\ny_m = -2.0\nheading_deg = 90.0\n\
             [map]\njson = false\n[replay]\nrobots = 3\ndelay_s = 0.5\n[clock]\ntrusted = true\n",
        )
        .unwrap();
        assert_eq!(config.core.term, 7);
        assert_eq!(config.connect, ["tcp/10.0.0.2:7447"]);
        let anchor = config.core.anchor.unwrap();
        assert_eq!(anchor.robot.as_str(), "r1");
        assert!((anchor.team_from_body.heading_rad - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
        assert_eq!(config.replay, Some(Replay::WhenJoined { robots: 3, delay_s: 0.5 }));
        assert!(config.core.clock.trusted && !config.json);
    }

    #[test]
    fn what_is_wrong_is_named_with_its_line_and_what_would_be_right() {
        for (extra, parts) in [
            ("[network]\nlistens = []\n", vec!["leader.toml:5", "listens", "`listen`"]),
            ("[network]\nlisten = []\n", vec!["leader.toml:5", "network.listen", "at least one"]),
            ("[network]\nlisten = ['localhost']\n", vec!["leader.toml:5", "\"localhost\"", "tcp/127.0.0.1:7447"]),
            ("[network]\nconnect = ['tcp/l2:0']\n", vec!["leader.toml:5", "network.connect", "port 0"]),
            ("[targets]\nforget_after_s = -2.0\n", vec!["leader.toml:5", "-2", "seconds between"]),
            ("[targets]\nperson_height_m = 172.0\n", vec!["leader.toml:5", "172", "metres between"]),
            ("[targets]\nperson_height_cm = 172.0\n", vec!["leader.toml:5", "person_height_cm", "`person_height_m`"]),
            ("[replay]\n", vec!["leader.toml:4", "neither", "either"]),
            ("[replay]\nrobots = 0\n", vec!["leader.toml:5", "1 to 256"]),
            ("[replay]\nstart = '8 o clock'\n", vec!["leader.toml:5", "8 o clock", "RFC 3339"]),
            ("[gauge]\nrobot = 'R1'\n", vec!["leader.toml:5", "R1", "a-z"]),
        ] {
            let message = read(&format!("{LEAST}{extra}")).map(|_| ()).unwrap_err().to_string();
            for part in parts {
                assert!(message.contains(part), "{part:?} is missing in: {message}");
            }
        }
        let message = read("[leader]\nid = 'l1'\n").map(|_| ()).unwrap_err().to_string();
        assert!(message.contains("missing field `team`"), "{message}");
    }

    fn read(text: &str) -> Result<Config, DocumentError> {
        Config::from_document(&Document::from_text(Path::new("leader.toml"), text.to_owned()))
    }
}
