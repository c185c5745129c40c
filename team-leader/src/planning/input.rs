//! The file that `plan` reads.
//!
//! ```json
//! {"robots": [{"id": "r1", "x_m": 0, "y_m": 0, "movable": false}, {"id": "r2", "x_m": 2, "y_m": 0, "radius_m": 0.2}],
//!  "targets": [{"id": "t1", "x_m": 3, "y_m": 1}],
//!  "sigma_deg": 0.05, "area": {"x_m": [-4, 4], "y_m": [-3, 3]}, "obstacles": [{"x_m": [1, 2], "y_m": [1, 1.5]}]}
//! ```

use protocol::frames::Pose2;
use protocol::marker::Marker;
use serde::Deserialize;

use super::{Criterion, radius_of};
use crate::solve::SolveError;

/// Most robots and targets of a plan.
const MAX_ROBOTS: usize = 32;
const MAX_TARGETS: usize = 64;
/// A grid over more than this is too coarse, metres.
const MAX_REACH_M: f64 = 50.0;

/// As written.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, expecting = "an object with robots and targets")]
pub struct PlanInput {
    /// At least two; the first one's pose is the frame.
    pub robots: Vec<RawRobot>,
    /// At least one.
    pub targets: Vec<RawTarget>,
    /// Of each bearing and edge, degrees; default 0.05.
    pub sigma_deg: Option<f64>,
    /// How far a robot may go along either axis, metres; default 4.
    pub reach_m: Option<f64>,
    /// What a metre of travel costs, m² of variance; default 0.
    pub travel_m2_per_m: Option<f64>,
    /// What to make small; default `trace`.
    pub criterion: Option<Criterion>,
    /// Where robots may be; default everywhere.
    pub area: Option<Box2>,
    /// Where they may not, and past which nobody sees.
    #[serde(default)]
    pub obstacles: Vec<Box2>,
}

/// A robot as written.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RawRobot {
    /// Name.
    pub id: String,
    /// Where it stands, metres.
    pub x_m: f64,
    /// Where it stands, metres.
    pub y_m: f64,
    /// Default 0.
    pub heading_deg: Option<f64>,
    /// Of its body, metres; default that of the marker, else 0.2.
    pub radius_m: Option<f64>,
    /// What the others see of it.
    pub marker: Option<Marker>,
    /// Default: all but the first.
    pub movable: Option<bool>,
}

/// A target as written.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RawTarget {
    /// Name.
    pub id: String,
    /// Metres.
    pub x_m: f64,
    /// Metres.
    pub y_m: f64,
}

/// A rectangle along the axes.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Box2 {
    /// From and to, metres.
    pub x_m: [f64; 2],
    /// From and to, metres.
    pub y_m: [f64; 2],
}

impl Box2 {
    /// Whether it is a rectangle at all: one with its sides exchanged holds nothing.
    fn check(&self, place: &str) -> Result<(), SolveError> {
        for (key, [from, to]) in [("x_m", self.x_m), ("y_m", self.y_m)] {
            if !(from.is_finite() && to.is_finite() && from <= to) {
                return Err(SolveError::Value {
                    place: format!("{place}.{key}"),
                    value: format!("[{from}, {to}]"),
                    right: "two finite numbers, the lower one first".into(),
                });
            }
        }
        Ok(())
    }
}

/// A robot of a plan.
#[derive(Debug, Clone)]
pub struct Planned {
    /// Name.
    pub id: String,
    /// Where it stands.
    pub pose: Pose2,
    /// Of its body, metres.
    pub radius_m: f64,
    /// Whether it may be sent elsewhere.
    pub movable: bool,
}

/// A checked problem.
#[derive(Debug, Clone)]
pub struct PlanProblem {
    /// At least two.
    pub robots: Vec<Planned>,
    /// Names and places, at least one.
    pub targets: Vec<(String, [f64; 2])>,
    /// Of each bearing and edge.
    pub sigma_rad: f64,
    /// How far a robot may go along either axis.
    pub reach_m: f64,
    /// What a metre of travel costs.
    pub travel_m2_per_m: f64,
    /// What to make small.
    pub criterion: Criterion,
    /// Where robots may be.
    pub area: Option<Box2>,
    /// Where they may not, and past which nobody sees.
    pub obstacles: Vec<Box2>,
}

impl PlanProblem {
    /// Parses and checks.
    pub fn parse(text: &str) -> Result<Self, SolveError> {
        let raw: PlanInput = serde_json::from_str(text).map_err(SolveError::Json)?;
        let value = |place: String, value: String, right: &'static str| {
            Err(SolveError::Value { place, value, right: right.into() })
        };
        if !(2..=MAX_ROBOTS).contains(&raw.robots.len()) {
            return value("robots".into(), format!("{} robots", raw.robots.len()), "2 to 32 robots");
        }
        if !(1..=MAX_TARGETS).contains(&raw.targets.len()) {
            return value("targets".into(), format!("{} targets", raw.targets.len()), "1 to 64 targets");
        }
        if let Some(area) = &raw.area {
            area.check("area")?;
        }
        for (k, obstacle) in raw.obstacles.iter().enumerate() {
            obstacle.check(&format!("obstacles[{k}]"))?;
        }
        let finite = |place: String, v: f64| if v.is_finite() { Ok(v) } else { Err((place, v)) };
        let wrong = |(place, v): (String, f64)| SolveError::Value {
            place,
            value: v.to_string(),
            right: "a finite number".into(),
        };
        let mut robots = Vec::new();
        for (k, r) in raw.robots.iter().enumerate() {
            let key = |name: &str| format!("robots[{k}].{name}");
            if let Some(Err(problem)) = r.marker.as_ref().map(Marker::validate) {
                return value(key("marker"), problem.to_string(), "the geometry of a real marker");
            }
            let radius_m = r.radius_m.or_else(|| r.marker.as_ref().map(radius_of)).unwrap_or(0.2);
            if !(radius_m > 0.0 && radius_m < 5.0) {
                return value(key("radius_m"), radius_m.to_string(), "0 to 5 m");
            }
            if robots.iter().any(|o: &Planned| o.id == r.id) {
                return Err(SolveError::Twice { what: "robot", id: r.id.clone() });
            }
            let heading = finite(key("heading_deg"), r.heading_deg.unwrap_or(0.0)).map_err(wrong)?.to_radians();
            let (x, y) = (finite(key("x_m"), r.x_m).map_err(wrong)?, finite(key("y_m"), r.y_m).map_err(wrong)?);
            let pose = Pose2::new(x, y, heading);
            robots.push(Planned { id: r.id.clone(), pose, radius_m, movable: r.movable.unwrap_or(k > 0) });
        }
        let mut targets = Vec::new();
        for (k, t) in raw.targets.iter().enumerate() {
            let key = |name: &str| format!("targets[{k}].{name}");
            let at = [finite(key("x_m"), t.x_m).map_err(wrong)?, finite(key("y_m"), t.y_m).map_err(wrong)?];
            targets.push((t.id.clone(), at));
        }
        let sigma_deg = raw.sigma_deg.unwrap_or(0.05);
        if !(sigma_deg > 0.0 && sigma_deg < 90.0) {
            return value("sigma_deg".into(), sigma_deg.to_string(), "a positive number of degrees");
        }
        let reach_m = raw.reach_m.unwrap_or(4.0);
        if !(reach_m > 0.0 && reach_m <= MAX_REACH_M) {
            return value("reach_m".into(), reach_m.to_string(), "0 to 50 m");
        }
        let travel_m2_per_m = raw.travel_m2_per_m.unwrap_or(0.0);
        if !(travel_m2_per_m >= 0.0 && travel_m2_per_m.is_finite()) {
            return value("travel_m2_per_m".into(), travel_m2_per_m.to_string(), "zero or a positive number");
        }
        Ok(Self {
            robots,
            targets,
            sigma_rad: sigma_deg.to_radians(),
            reach_m,
            travel_m2_per_m,
            criterion: raw.criterion.unwrap_or_default(),
            area: raw.area,
            obstacles: raw.obstacles,
        })
    }

    /// Whether a robot of this radius may stand there.
    pub fn is_free(&self, [x, y]: [f64; 2], radius_m: f64) -> bool {
        let within = |b: &Box2, margin: f64| {
            (b.x_m[0] - margin..=b.x_m[1] + margin).contains(&x) && (b.y_m[0] - margin..=b.y_m[1] + margin).contains(&y)
        };
        self.area.as_ref().is_none_or(|a| within(a, -radius_m)) && !self.obstacles.iter().any(|o| within(o, radius_m))
    }

    /// Whether nothing stands on the line between two places.
    pub fn line_is_free(&self, a: [f64; 2], b: [f64; 2]) -> bool {
        !self.obstacles.iter().any(|o| crosses(o, a, b))
    }
}

/// Whether a line enters a rectangle (Liang and Barsky).
fn crosses(o: &Box2, a: [f64; 2], b: [f64; 2]) -> bool {
    let (mut enter, mut leave) = (0.0f64, 1.0f64);
    for (k, side) in [o.x_m, o.y_m].iter().enumerate() {
        let d = b[k] - a[k];
        if d.abs() < 1e-12 {
            if a[k] < side[0] || a[k] > side[1] {
                return false;
            }
            continue;
        }
        let (t, u) = ((side[0] - a[k]) / d, (side[1] - a[k]) / d);
        enter = enter.max(t.min(u));
        leave = leave.min(t.max(u));
    }
    enter < leave
}
