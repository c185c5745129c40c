//! Where robots stand and drive, by the seed: far enough from walls, furniture and each other, all in sight of each other,
//! and in a layout that three unnamed robots can make sense of: not nearly in a line, not nearly equilateral.

use std::sync::Arc;

use nalgebra::Vector2;
use protocol::id::RobotId;
use rand::{Rng, RngExt};

use super::WorldError;
use super::floor::Floor;
use super::robot::{Blink, Robot};
use crate::scenario::{DriveSpec, RobotsSpec};

/// Of a robot's axis from walls and furniture where it stands.
const STANDING_MARGIN_M: f64 = 0.6;
/// Of a robot's axis from walls and furniture while it drives.
const DRIVING_MARGIN_M: f64 = 0.4;
/// Of lines of sight from furniture.
const SIGHT_MARGIN_M: f64 = 0.28;
/// Of a driving robot's axis from another robot's.
const PASSING_MARGIN_M: f64 = 0.9;
/// Least angle of any triangle of robots.
const LEAST_ANGLE_RAD: f64 = 0.35;
/// Least ratio of the longest to the shortest side of a triangle of robots.
const LEAST_RATIO: f64 = 1.12;
/// Of other robots' axes from the sides of the picture of one that looks one way.
const VIEW_MARGIN_RAD: f64 = 0.12;
const LAYOUTS: usize = 4000;
const TRIES: usize = 60;
/// Between the starts of two robots' lamps.
const BEGUN_APART_S: f64 = 0.37;

/// First pose and drives of each robot. Who looks one way, and half of how far, is turned so that all others are in its picture.
pub(super) fn place(
    spec: &RobotsSpec,
    wanted: &[(RobotId, Option<f64>)],
    floor: &Floor,
    rng: &mut impl Rng,
) -> Result<Vec<Robot>, WorldError> {
    for _ in 0..LAYOUTS {
        let mut robots: Vec<Robot> = Vec::new();
        for (n, (id, _)) in wanted.iter().enumerate() {
            let drives: Vec<DriveSpec> = spec.drives.iter().filter(|d| d.robot == *id).cloned().collect();
            let wear = Arc::new(spec.wear_of(id));
            let blink = spec.beacon_of(id).map(|beacon| Blink::new(beacon, BEGUN_APART_S * n as f64));
            let fixed = spec.poses.get(n).map(|[x, y, h]| [*x, *y, h.to_radians()]);
            let tries = if fixed.is_some() { 1 } else { TRIES };
            let found = (0..tries).find_map(|_| {
                let half = floor.half();
                let random = [
                    rng.random_range(-half.x..half.x),
                    rng.random_range(-half.y..half.y),
                    rng.random_range(-std::f64::consts::PI..std::f64::consts::PI),
                ];
                let robot = Robot {
                    id: *id,
                    clock_offset_s: 0.0,
                    captures: Vec::new(),
                    first_pose: fixed.unwrap_or(random),
                    drives: drives.clone(),
                    wear: wear.clone(),
                    blink: blink.clone(),
                };
                (fixed.is_some() || fits(&robot, &robots, spec, floor)).then_some(robot)
            });
            match found {
                Some(robot) => robots.push(robot),
                None => break,
            }
        }
        if robots.len() == wanted.len() && turn_to_the_others(&mut robots, wanted, spec.poses.len()) {
            return Ok(robots);
        }
    }
    Err(WorldError::NoRoomForRobots { count: wanted.len(), apart_m: spec.apart_m, within_m: spec.within_m })
}

/// Turns who looks one way, but for those whose pose is given; `false` if somebody's picture cannot hold all others.
fn turn_to_the_others(robots: &mut [Robot], wanted: &[(RobotId, Option<f64>)], given: usize) -> bool {
    let stations: Vec<Vec<Vector2<f64>>> = robots.iter().map(Robot::stations).collect();
    for (n, (robot, (_, half))) in robots.iter_mut().zip(wanted).enumerate().skip(given) {
        let Some(half) = half else { continue };
        let others = stations.iter().enumerate().filter(|(i, _)| *i != n).flat_map(|(_, s)| s);
        let ways: Vec<Vector2<f64>> = others.map(|p| (p - stations[n][0]).normalize()).collect();
        let middle: Vector2<f64> = ways.iter().sum();
        robot.first_pose[2] = middle.y.atan2(middle.x);
        if ways.iter().any(|way| way.angle(&middle) > half - VIEW_MARGIN_RAD) {
            return false;
        }
    }
    true
}

fn fits(robot: &Robot, others: &[Robot], spec: &RobotsSpec, floor: &Floor) -> bool {
    let stations = robot.stations();
    stations.iter().all(|p| floor.clearance(*p) >= STANDING_MARGIN_M)
        && stations.windows(2).all(|w| floor.is_clear(w[0], w[1], DRIVING_MARGIN_M))
        && others.iter().all(|other| {
            let theirs = other.stations();
            theirs.iter().all(|q| {
                stations.iter().all(|p| {
                    let apart = (p - q).norm();
                    apart >= spec.apart_m && apart <= spec.within_m && floor.is_clear(*p, *q, SIGHT_MARGIN_M)
                })
            }) && pass(&stations, &theirs)
        })
        && triangles(&stations, others)
}

/// Whether the ways keep apart (seen as whole lines, whoever drives first).
fn pass(ours: &[Vector2<f64>], theirs: &[Vector2<f64>]) -> bool {
    let along = |s: &[Vector2<f64>]| -> Vec<Vector2<f64>> {
        let mut points = s.to_vec();
        for w in s.windows(2) {
            points.extend((0..=20).map(|i| w[0] + (w[1] - w[0]) * (f64::from(i) / 20.0)));
        }
        points
    };
    let theirs = along(theirs);
    along(ours).iter().all(|p| theirs.iter().all(|q| (p - q).norm() >= PASSING_MARGIN_M))
}

/// Whether every triangle with two of the others is well shaped, wherever each of the three stands.
fn triangles(stations: &[Vector2<f64>], others: &[Robot]) -> bool {
    let ends = |s: &[Vector2<f64>]| -> Vec<Vector2<f64>> {
        let mut ends = vec![s[0]];
        if s.len() > 1 {
            ends.push(s[s.len() - 1]);
        }
        ends
    };
    others.iter().enumerate().all(|(i, a)| {
        others[..i].iter().all(|b| {
            ends(&a.stations()).iter().all(|a| {
                ends(&b.stations()).iter().all(|b| ends(stations).iter().all(|c| is_well_shaped([*a, *b, *c])))
            })
        })
    })
}

fn is_well_shaped(corners: [Vector2<f64>; 3]) -> bool {
    let side = |i: usize| (corners[(i + 1) % 3] - corners[(i + 2) % 3]).norm();
    let angle = |i: usize| {
        let (a, b) = (corners[(i + 1) % 3] - corners[i], corners[(i + 2) % 3] - corners[i]);
        (a.dot(&b) / (a.norm() * b.norm())).clamp(-1.0, 1.0).acos()
    };
    let sides = [side(0), side(1), side(2)];
    let (low, high) = sides.iter().fold((f64::INFINITY, 0.0f64), |(l, h), s| (l.min(*s), h.max(*s)));
    (0..3).all(|i| angle(i) >= LEAST_ANGLE_RAD) && high / low >= LEAST_RATIO
}
