//! The map message from calibration and targets.

use nalgebra::{Matrix2x3, Matrix3, Vector2};
use protocol::id::{RobotId, TargetId};
use protocol::message::{MapRobot, MapStatus, MapTarget, Presence, TeamMap, Trouble, Trust};
use protocol::time::Timestamp;

use crate::calibration::live::Calibrator;
use crate::calibration::systematic::Shared;
use crate::correspondence::{Followed, Follower, OBSERVED_S};
use crate::leader::config::LeaderCoreConfig;

/// Height of a target's centre over that of its top, for somebody who stands on the floor, and its spread.
const CENTRE_OF_TOP: (f64, f64) = (0.52, 0.02);

/// What the leader knows of a robot beside its pose.
#[derive(Debug, Clone)]
pub struct RobotFacts {
    /// Who.
    pub id: RobotId,
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
pub fn build(
    robots: &[RobotFacts],
    calibrator: &Calibrator,
    follower: &Follower,
    config: &LeaderCoreConfig,
    stamp: Timestamp,
) -> TeamMap {
    let placed: Vec<usize> = (0..robots.len()).filter(|&r| calibrator.pose(r, stamp).is_some()).collect();
    let (status, because) = calibrator.status();
    let oldest = robots
        .iter()
        .filter(|r| r.presence == Presence::Online)
        .filter_map(|r| r.last_capture)
        .map(|t| stamp.seconds_since(t))
        .fold(0.0, f64::max);
    let mut strangers = 0;
    TeamMap {
        leader: config.leader,
        term: config.term,
        sequence: 0,
        stamp,
        oldest_contribution_s: oldest as f32,
        status,
        explanation: explanation(status, &because, robots, config),
        gauge: calibrator.gauge().map(|g| robots[g].id),
        robots: robots
            .iter()
            .enumerate()
            .map(|(r, facts)| {
                let team_from_body = calibrator.pose(r, stamp);
                if team_from_body.is_none() {
                    strangers += 1;
                }
                MapRobot {
                    id: facts.id,
                    team_from_body,
                    component: if team_from_body.is_some() { 0 } else { strangers.min(255) as u8 },
                    presence: facts.presence,
                    moving: calibrator.moves(r),
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
        joint_covariance: joint_covariance(&placed, calibrator),
        targets: follower
            .targets()
            .iter()
            .filter(|f| f.is_confirmed())
            .filter_map(|f| target_entry(f, &placed, robots, calibrator, config, stamp))
            .take(protocol::message::map::MAX_TARGETS)
            .collect(),
        next_target: TargetId(0),
        alarms: Vec::new(),
    }
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
    calibrator: &Calibrator,
    config: &LeaderCoreConfig,
    stamp: Timestamp,
) -> Option<MapTarget> {
    let mut target = followed.state.target.clone();
    target.predict(stamp);
    if followed.covariance(calibrator).symmetric_eigenvalues().max().sqrt() > config.targets.publish_below_m {
        return None;
    }
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
    let mut observers: Vec<RobotId> = followed
        .state
        .observers
        .iter()
        .filter(|(_, at)| stamp.seconds_since(*at) < OBSERVED_S)
        .map(|(r, _)| robots[*r].id)
        .collect();
    observers.sort_unstable();
    let seeing = || {
        let lately = followed.state.observers.iter().filter(|(_, at)| stamp.seconds_since(*at) < OBSERVED_S);
        lately.filter_map(|(r, _)| Some((robots[*r].id, calibrator.station(*r)?.position() - position)))
    };
    Some(MapTarget {
        id: followed.id,
        position_m: [position.x, position.y, z_m],
        velocity_mps: [velocity.x as f32, velocity.y as f32],
        height_m: top_seen.then_some((top_m as f32, top_var.sqrt() as f32)),
        own_covariance: [own[(0, 0)], own[(0, 1)], 0.0, own[(1, 1)], 0.0, z_var].map(|v| v as f32),
        pose_jacobian: jacobian.map(|v| v as f32).collect(),
        pair: best_pair(&seeing().collect::<Vec<_>>()),
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

/// Full covariance matrix from the map's upper triangle of `n` rows; `None` where the length does not fit.
pub fn full_covariance(upper: &[f32], n: usize) -> Option<nalgebra::DMatrix<f64>> {
    if upper.len() != n * (n + 1) / 2 {
        return None;
    }
    let mut full = nalgebra::DMatrix::zeros(n, n);
    let mut values = upper.iter();
    for r in 0..n {
        for c in r..n {
            let v = f64::from(*values.next()?);
            full[(r, c)] = v;
            full[(c, r)] = v;
        }
    }
    Some(full)
}

/// 3 × 3 covariance of a target of the map with the robots' part: own + J · joint · Jᵀ.
pub fn target_covariance(map: &TeamMap, target: &MapTarget) -> Option<Matrix3<f64>> {
    let n = 3 * map.robots.iter().filter(|r| r.team_from_body.is_some()).count();
    let joint = full_covariance(&map.joint_covariance, n)?;
    if target.pose_jacobian.len() != 2 * n {
        return None;
    }
    let j = nalgebra::DMatrix::from_row_iterator(2, n, target.pose_jacobian.iter().map(|v| f64::from(*v)));
    let [xx, xy, xz, yy, yz, zz] = target.own_covariance.map(f64::from);
    let mut cov = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
    let by_poses = &j * joint * j.transpose();
    for r in 0..2 {
        for c in 0..2 {
            cov[(r, c)] += by_poses[(r, c)];
        }
    }
    Some(cov)
}
