//! The map as JSON for people and tools: names and units as in the files of `solve` and `truth.jsonl`.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, Matrix3};
use protocol::id::RobotId;
use protocol::message::{Alarm, MapStatus, Presence, TeamMap, Trust};
use serde::{Deserialize, Serialize};

use super::build::trouble_in_words;
use crate::structure::Landmark;

/// The team map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MapJson {
    /// Leader's clock, seconds since the epoch.
    pub time_s: f64,
    /// Who leads.
    pub leader: String,
    /// Its term.
    pub term: u64,
    /// Counts the maps of the term.
    pub sequence: u64,
    /// waiting, converged, ambiguous, inconsistent, insufficient.
    pub status: String,
    /// Why.
    pub explanation: String,
    /// The robot that fixed the frame.
    pub gauge: Option<String>,
    /// Seconds.
    pub oldest_contribution_s: f64,
    /// All robots.
    pub robots: Vec<RobotJson>,
    /// Moving objects.
    pub targets: Vec<TargetJson>,
    /// What robots raised in the last seconds, oldest first; the same alarm is in many maps.
    #[serde(default)]
    pub alarms: Vec<AlarmJson>,
    /// What stands still: upright edges that several robots see, or one robot from several places.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub edges: Vec<EdgeJson>,
}

/// A corner of a wall, a door frame, a post, a side of a piece of furniture.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EdgeJson {
    /// Metres.
    pub x_m: f64,
    /// Metres.
    pub y_m: f64,
    /// 2 × 2, with the poses' part, m².
    pub covariance: [[f64; 2]; 2],
    /// From where to where above the floor it was seen, metres; it may go on beyond.
    pub z_m: [f64; 2],
    /// Robots that have seen it.
    pub robots: Vec<String>,
    /// Places from which it was seen.
    pub views: usize,
}

impl EdgeJson {
    /// A landmark and who has seen it.
    pub fn of((landmark, robots): &(&Landmark, Vec<RobotId>)) -> Self {
        let c = &landmark.covariance;
        Self {
            x_m: landmark.position.x,
            y_m: landmark.position.y,
            covariance: [[c[(0, 0)], c[(0, 1)]], [c[(1, 0)], c[(1, 1)]]],
            z_m: landmark.extent_m,
            robots: robots.iter().map(ToString::to_string).collect(),
            views: landmark.views,
        }
    }
}

impl MapJson {
    /// With what stands still.
    pub fn with_structure(map: &TeamMap, structure: &[(&Landmark, Vec<RobotId>)]) -> Self {
        let edges = structure.iter().map(EdgeJson::of).collect();
        Self { edges, ..Self::from(map) }
    }
}

/// An alarm of a robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AlarmJson {
    /// Who says so.
    pub robot: String,
    /// Its session, hexadecimal.
    pub epoch: String,
    /// Counts the alarms of the session.
    pub number: u32,
    /// Robot's clock, seconds.
    pub time_s: f64,
    /// What.
    pub what: String,
}

impl From<&Alarm> for AlarmJson {
    fn from(alarm: &Alarm) -> Self {
        Self {
            robot: alarm.robot.to_string(),
            epoch: format!("{:016x}", alarm.epoch),
            number: alarm.number,
            time_s: alarm.at.as_secs_f64(),
            what: alarm.kind.to_string(),
        }
    }
}

/// How fast somebody walks, and how near, for [`RobotJson::clock_bearing_sigma_deg`]: m/s and metres.
pub const WALKER: (f64, f64) = (1.5, 2.0);

/// A robot; position, heading and covariance (x, y, heading; m and rad) are null while it has no place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RobotJson {
    /// Who.
    pub id: String,
    /// Metres.
    pub x_m: Option<f64>,
    /// Metres.
    pub y_m: Option<f64>,
    /// Degrees, counter-clockwise.
    pub heading_deg: Option<f64>,
    /// 3 × 3, m and rad.
    pub covariance: Option<[[f64; 3]; 3]>,
    /// Its component.
    pub component: u8,
    /// online, silent, offline.
    pub presence: String,
    /// Whether it moves.
    pub moving: bool,
    /// robot − leader, seconds.
    pub clock_offset_s: Option<f64>,
    /// Its standard deviation; the truth is within √3 of these for certain.
    pub clock_offset_sigma_s: Option<f64>,
    /// By how much its pictures are older than their stamps say, seconds.
    pub lag_s: Option<f64>,
    /// Its standard deviation.
    pub lag_sigma_s: Option<f64>,
    /// Error that all its bearings of targets share, degrees.
    pub bias_deg: Option<f64>,
    /// Its standard deviation.
    pub bias_sigma_deg: Option<f64>,
    /// full, widened, set_aside: whether its sigmas are believed.
    pub trust: String,
    /// The factor by which its sigmas are widened, where they are.
    pub widened: Option<f64>,
    /// What that costs: the error of the bearing of somebody who walks past at 1.5 m/s in 2 m, degrees (one sigma).
    #[serde(default)]
    pub clock_bearing_sigma_deg: Option<f64>,
    /// Why its observations are not used, where they are not.
    #[serde(default)]
    pub trouble: Option<String>,
    /// Observations that never came, or too late or out of order.
    #[serde(default)]
    pub observations_lost: u32,
}

/// A moving object.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TargetJson {
    /// Its number in the team, as text.
    pub id: String,
    /// The component of robots in whose frame it is.
    #[serde(default)]
    pub component: u8,
    /// Metres.
    pub x_m: f64,
    /// Metres.
    pub y_m: f64,
    /// Height of the centre, metres.
    pub z_m: f64,
    /// 3 × 3, with the poses' part, m².
    pub covariance: [[f64; 3]; 3],
    /// m/s.
    pub vx_mps: f64,
    /// m/s.
    pub vy_mps: f64,
    /// Height of the top.
    pub height_m: Option<f64>,
    /// Its standard deviation.
    pub height_sigma_m: Option<f64>,
    /// Robots that see it now.
    pub observers: Vec<String>,
    /// The two of them whose bearings serve it best.
    pub pair: Option<[String; 2]>,
    /// Seconds since it was last measured.
    pub age_s: f64,
}

impl From<&TeamMap> for MapJson {
    fn from(map: &TeamMap) -> Self {
        let mut covariances: BTreeMap<u8, (Option<DMatrix<f64>>, usize)> =
            map.components().into_iter().map(|c| (c, (map.joint_covariance_of(c), 0))).collect();
        Self {
            time_s: map.stamp.as_secs_f64(),
            leader: map.leader.to_string(),
            term: map.term,
            sequence: map.sequence,
            status: status_word(map.status).to_owned(),
            explanation: map.explanation.clone(),
            gauge: map.gauge.map(|g| g.to_string()),
            oldest_contribution_s: f64::from(map.oldest_contribution_s),
            robots: map
                .robots
                .iter()
                .map(|robot| {
                    let pose = robot.team_from_body;
                    let covariance = pose.and(covariances.get_mut(&robot.component)).and_then(|(joint, next)| {
                        *next += 3;
                        Some(block(joint.as_ref()?, *next - 3))
                    });
                    RobotJson {
                        id: robot.id.to_string(),
                        x_m: pose.map(|p| p.x_m),
                        y_m: pose.map(|p| p.y_m),
                        heading_deg: pose.map(|p| p.heading_rad.to_degrees()),
                        covariance,
                        component: robot.component,
                        presence: presence_word(robot.presence).to_owned(),
                        moving: robot.moving,
                        clock_offset_s: robot.clock_offset_s.map(|c| f64::from(c.0)),
                        clock_offset_sigma_s: robot.clock_offset_s.map(|c| f64::from(c.1)),
                        lag_s: robot.lag_s.map(|l| f64::from(l.0)),
                        lag_sigma_s: robot.lag_s.map(|l| f64::from(l.1)),
                        bias_deg: robot.bias_rad.map(|b| f64::from(b.0).to_degrees()),
                        bias_sigma_deg: robot.bias_rad.map(|b| f64::from(b.1).to_degrees()),
                        trust: trust_word(robot.trust, robot.verifiable || pose.is_none()).to_owned(),
                        widened: match robot.trust {
                            Trust::Widened(factor) => Some(f64::from(factor)),
                            Trust::Full | Trust::SetAside => None,
                        },
                        clock_bearing_sigma_deg: robot
                            .clock_offset_s
                            .map(|c| (WALKER.0 * f64::from(c.1) / WALKER.1).to_degrees()),
                        trouble: robot.trouble.map(|t| trouble_in_words(t).to_owned()),
                        observations_lost: robot.observations_lost,
                    }
                })
                .collect(),
            targets: map
                .targets
                .iter()
                .map(|t| TargetJson {
                    id: t.id.to_string(),
                    component: t.component,
                    x_m: t.position_m[0],
                    y_m: t.position_m[1],
                    z_m: t.position_m[2],
                    covariance: rows(
                        &covariances
                            .get(&t.component)
                            .and_then(|(joint, _)| t.covariance(joint.as_ref()?))
                            .unwrap_or_else(|| Matrix3::identity() * 1e6),
                    ),
                    vx_mps: f64::from(t.velocity_mps[0]),
                    vy_mps: f64::from(t.velocity_mps[1]),
                    height_m: t.height_m.map(|h| f64::from(h.0)),
                    height_sigma_m: t.height_m.map(|h| f64::from(h.1)),
                    observers: t.observers.iter().map(ToString::to_string).collect(),
                    pair: t.pair.map(|(a, b)| [a.to_string(), b.to_string()]),
                    age_s: f64::from(t.age_s),
                })
                .collect(),
            alarms: map.alarms.iter().map(AlarmJson::from).collect(),
            edges: Vec::new(),
        }
    }
}

fn block(joint: &DMatrix<f64>, k: usize) -> [[f64; 3]; 3] {
    rows(&joint.fixed_view::<3, 3>(k, k).into_owned())
}

fn rows(m: &Matrix3<f64>) -> [[f64; 3]; 3] {
    [0, 1, 2].map(|r| [m[(r, 0)], m[(r, 1)], m[(r, 2)]])
}

/// The status in the words of the JSON.
pub fn status_word(status: MapStatus) -> &'static str {
    match status {
        MapStatus::Waiting => "waiting",
        MapStatus::Converged => "converged",
        MapStatus::Ambiguous => "ambiguous",
        MapStatus::Inconsistent => "inconsistent",
        MapStatus::Insufficient => "insufficient",
    }
}

fn trust_word(trust: Trust, verifiable: bool) -> &'static str {
    match trust {
        Trust::Full if !verifiable => "unverifiable",
        Trust::Full => "full",
        Trust::Widened(_) => "widened",
        Trust::SetAside => "set_aside",
    }
}

fn presence_word(presence: Presence) -> &'static str {
    match presence {
        Presence::Online => "online",
        Presence::Silent => "silent",
        Presence::Offline => "offline",
    }
}
