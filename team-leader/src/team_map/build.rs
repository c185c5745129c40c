//! The map message from the components' calibrations and targets.

use nalgebra::{Matrix2x3, Vector2};
use protocol::id::{RobotId, TargetId};
use protocol::message::{MapRobot, MapStatus, MapTarget, Presence, TeamMap, Trouble, Trust};
use protocol::time::Timestamp;

use crate::calibration::live::Calibrator;
use crate::calibration::systematic::Shared;
use crate::correspondence::{Followed, ObservedBy};
use crate::leader::components::Component;
use crate::leader::config::LeaderCoreConfig;

/// Height of a target's centre over that of its top, for somebody who stands on the floor, and its spread.
const CENTRE_OF_TOP: (f64, f64) = (0.52, 0.02);

/// What the leader knows of a robot beside its pose.
#[derive(Debug, Clone)]
pub struct RobotFacts {
    /// Who.
    pub id: RobotId,
    /// Which of the leader's components it belongs to.
    pub component: usize,
    /// Whether it is there.
    pub presence: Presence,
    /// robot − leader and its standard deviation, seconds.
    pub clock_offset_s: Option<(f32, f32)>,
    /// Capture of its last observation, leader's clock.
    pub last_capture: Option<Timestamp>,
    /// What all its bearings share.
    pub shared: Shared,
    /// Whether its sigmas are believed.
    pub trust: Trust,
    /// Whether others would show it if what it sees were false.
    pub verifiable: bool,
    /// Why it is not used, where it is not.
    pub trouble: Option<Trouble>,
    /// Observations of it that were lost or refused.
    pub observations_lost: u32,
}

/// The map at `stamp`.
pub fn build(robots: &[RobotFacts], components: &[Component], config: &LeaderCoreConfig, stamp: Timestamp) -> TeamMap {
    let home: Vec<&Component> = robots.iter().filter_map(|facts| components.get(facts.component)).collect();
    let mut in_order: Vec<(&Component, Vec<usize>)> =
        components.iter().map(|component| (component, placed(component, stamp))).collect();
    in_order.sort_by_key(|(component, _)| component.number);
    let (status, because) = status(components);
    let oldest = robots
        .iter()
        .filter(|r| r.presence == Presence::Online)
        .filter_map(|r| r.last_capture)
        .map(|t| stamp.seconds_since(t))
        .fold(0.0, f64::max);
    let mut free = (0..=u8::MAX).filter(|number| components.iter().all(|component| component.number != *number));
    TeamMap {
        leader: config.leader,
        term: config.term,
        sequence: 0,
        stamp,
        oldest_contribution_s: oldest as f32,
        status,
        explanation: explanation(status, &because, robots, config),
        gauge: components.first().and_then(|team| team.calibrator.gauge()).map(|g| robots[g].id),
        robots: robots
            .iter()
            .zip(&home)
            .enumerate()
            .map(|(r, (facts, home))| {
                let team_from_body = home.calibrator.pose(r, stamp);
                let component = match team_from_body {
                    Some(_) => home.number,
                    None => free.next().unwrap_or(u8::MAX),
                };
                MapRobot {
                    id: facts.id,
                    team_from_body,
                    component,
                    presence: facts.presence,
                    moving: home.calibrator.moves(r),
                    clock_offset_s: facts.clock_offset_s,
                    lag_s: facts.shared.lag_s.map(|(v, s)| (v as f32, s as f32)),
                    bias_rad: facts.shared.bias_rad.map(|(v, s)| (v as f32, s as f32)),
                    trust: facts.trust,
                    verifiable: facts.verifiable,
                    trouble: facts.trouble,
                    observations_lost: facts.observations_lost,
                }
            })
            .collect(),
        joint_covariance: in_order
            .iter()
            .flat_map(|(component, placed)| joint_covariance(placed, &component.calibrator))
            .collect(),
        targets: in_order
            .iter()
            .flat_map(|(component, placed)| {
                component.shown().filter_map(|f| target_entry(f, placed, robots, component, config, stamp))
            })
            .take(protocol::message::map::MAX_TARGETS)
            .collect(),
        next_target: TargetId(0),
        alarms: Vec::new(),
    }
}

/// Robots of a component with a pose.
fn placed(component: &Component, stamp: Timestamp) -> Vec<usize> {
    component.calibrator.poses(stamp).map(|(robot, _)| robot).collect()
}

/// How all components stand: as the worst of them. A robot that has no place is its component's fault only where that is all that
/// is wrong.
fn status(components: &[Component]) -> (MapStatus, Vec<usize>) {
    let badness = |status: MapStatus| match status {
        MapStatus::Converged => 0,
        MapStatus::Insufficient => 1,
        MapStatus::Ambiguous => 2,
        MapStatus::Inconsistent => 3,
        MapStatus::Waiting => 4,
    };
    let all: Vec<(MapStatus, Vec<usize>)> = components.iter().map(|component| component.calibrator.status()).collect();
    let worst =
        all.iter().map(|(status, _)| *status).max_by_key(|status| badness(*status)).unwrap_or(MapStatus::Waiting);
    let because = all.into_iter().filter(|(status, _)| *status == worst).flat_map(|(_, robots)| robots).collect();
    (worst, because)
}

fn joint_covariance(placed: &[usize], calibrator: &Calibrator) -> Vec<f32> {
    let n = 3 * placed.len();
    let mut full = nalgebra::DMatrix::<f64>::zeros(n, n);
    for (i, &a) in placed.iter().enumerate() {
        for (j, &b) in placed.iter().enumerate().skip(i) {
            full.fixed_view_mut::<3, 3>(3 * i, 3 * j).copy_from(&calibrator.covariance(a, b));
        }
    }
    (0..n).flat_map(|r| (r..n).map(move |c| (r, c))).map(|(r, c)| full[(r, c)] as f32).collect()
}

fn target_entry(
    followed: &Followed,
    placed: &[usize],
    robots: &[RobotFacts],
    component: &Component,
    config: &LeaderCoreConfig,
    stamp: Timestamp,
) -> Option<MapTarget> {
    let calibrator = &component.calibrator;
    let mut target = followed.state.target.clone();
    target.predict(stamp);
    followed.published_covariance(calibrator, &config.targets)?;
    let position = target.position();
    let own = target.own_covariance();
    let ((top_m, top_var), top_seen) = target.top_m();
    let z_m = CENTRE_OF_TOP.0 * top_m;
    let z_var = CENTRE_OF_TOP.0.powi(2) * top_var + (CENTRE_OF_TOP.1 * top_m).powi(2);
    let blocks: Vec<Matrix2x3<f64>> = placed
        .iter()
        .map(|r| target.dependence().find(|(d, _)| d == r).map_or_else(Matrix2x3::zeros, |(_, block)| block))
        .collect();
    let jacobian =
        (0..2).flat_map(|row| blocks.iter().flat_map(move |b| b.row(row).iter().copied().collect::<Vec<_>>()));
    let velocity = target.velocity();
    let mut observers: Vec<RobotId> = followed.state.observers_at(stamp).map(|o| robots[o.robot].id).collect();
    observers.sort_unstable();
    let station = |o: &ObservedBy| Some((robots[o.robot].id, calibrator.station(o.robot)?.position() - position));
    let seeing: Vec<_> = followed.state.observers_at(stamp).filter_map(station).collect();
    Some(MapTarget {
        id: followed.id,
        component: component.number,
        position_m: [position.x, position.y, z_m],
        velocity_mps: [velocity.x as f32, velocity.y as f32],
        height_m: top_seen.then_some((top_m as f32, top_var.sqrt() as f32)),
        own_covariance: [own[(0, 0)], own[(0, 1)], 0.0, own[(1, 1)], 0.0, z_var].map(|v| v as f32),
        pose_jacobian: jacobian.map(|v| v as f32).collect(),
        pair: best_pair(&seeing),
        observers,
        age_s: stamp.seconds_since(followed.state.last).max(0.0) as f32,
    })
}

/// The two robots from which rays at equal sigmas place a target best: least (D₁² + D₂²)/sin²φ₀, the trace of its covariance
/// over σ² (`MATHS.md` §5.4).
fn best_pair(seeing: &[(RobotId, Vector2<f64>)]) -> Option<(RobotId, RobotId)> {
    let mut best: Option<(f64, (RobotId, RobotId))> = None;
    for (k, (a, u)) in seeing.iter().enumerate() {
        for (b, w) in &seeing[k + 1..] {
            let cross = u.x * w.y - u.y * w.x;
            let (d2, e2) = (u.norm_squared(), w.norm_squared());
            let trace = (d2 + e2) * d2 * e2 / (cross * cross).max(1e-12);
            if best.is_none_or(|(least, _)| trace < least) {
                best = Some((trace, (*a.min(b), *a.max(b))));
            }
        }
    }
    best.map(|(_, pair)| pair)
}

fn explanation(status: MapStatus, because: &[usize], robots: &[RobotFacts], config: &LeaderCoreConfig) -> String {
    let names = because.iter().take(8).map(|r| robots[*r].id.to_string()).collect::<Vec<_>>().join(", ");
    let mut text = match status {
        MapStatus::Waiting => match config.anchor {
            Some(anchor) if robots.iter().all(|r| r.id != anchor.robot) => {
                format!("waiting for the anchor {}, whose pose fixes the frame", anchor.robot)
            }
            _ => "no two standing robots see each other yet".to_owned(),
        },
        MapStatus::Converged => "all robots are placed".to_owned(),
        MapStatus::Ambiguous => {
            format!(
                "the layout is symmetric: {names} may be exchanged; any of them moving, or another place, would tell"
            )
        }
        MapStatus::Inconsistent => "sightings contradict each other: a marker's size or a camera is wrong".to_owned(),
        MapStatus::Insufficient => format!("{names}: not placed; it must stand and see a placed robot that sees it"),
    };
    let away: Vec<&str> =
        robots.iter().filter(|r| r.presence == Presence::Offline).take(8).map(|r| r.id.as_str()).collect();
    if !away.is_empty() {
        text.push_str("; missing: ");
        text.push_str(&away.join(", "));
    }
    for robot in robots.iter().take(8) {
        if let Some(trouble) = robot.trouble {
            text.push_str(&format!("; {} is not used: {}", robot.id, trouble_in_words(trouble)));
        }
    }
    while text.len() > 256 {
        text.pop();
    }
    text
}

/// Why a robot is not used.
pub fn trouble_in_words(trouble: Trouble) -> &'static str {
    match trouble {
        Trouble::NotAnnounced => "it has not announced itself",
        Trouble::ClockUnknown => "its clock has not answered",
        Trouble::ClockUncertain => "its clock is known too badly",
        Trouble::TwoSessions => "two sessions use its id",
    }
}
