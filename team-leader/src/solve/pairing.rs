//! Bearings of targets without a name: which are of one target.
//!
//! With the robots' poses known, every pair of bearings of two robots meets in at most one point. A group of bearings is
//! believed for its evidence: the rays of three robots meeting in one point, or elevations that agree on a height. Two
//! rays without elevation always meet: such a pair is only taken where neither could belong to anything else.

use nalgebra::Vector2;
use protocol::angle::wrap;

use super::input::Problem;
use crate::stereo::triangulate::{StereoBearings, triangulate};

/// Squared sigmas per piece of evidence that a member may cost.
const GATE: f64 = 12.0;
/// How much cheaper a group must be than a rival for the same bearings.
const MARGIN: f64 = 6.0;
/// Farthest target, metres.
const FAR_M: f64 = 100.0;

#[derive(Debug, Clone)]
struct Group {
    members: Vec<usize>,
    cost: f64,
    evidence: usize,
}

/// Pairs the unnamed bearings; new targets get names. Returns whether anything had to be left open because it could
/// belong to several. `poses`: x, y, heading; `pose_sigma` position and heading sigma of each robot.
pub fn pair(problem: &mut Problem, poses: &[[f64; 3]], pose_sigma: &[(f64, f64)]) -> bool {
    let open: Vec<usize> = (0..problem.bearings.len()).filter(|&b| problem.bearings[b].target.is_none()).collect();
    let mut groups: Vec<Group> = Vec::new();
    for (n, &a) in open.iter().enumerate() {
        for &b in &open[n + 1..] {
            if let Some(group) = grow(problem, poses, pose_sigma, a, b, &open)
                && !groups.iter().any(|g| g.members == group.members)
            {
                groups.push(group);
            }
        }
    }
    groups.sort_by(|x, y| y.members.len().cmp(&x.members.len()).then(x.cost.total_cmp(&y.cost)));
    let mut taken = vec![false; problem.bearings.len()];
    problem.paired = vec![false; problem.bearings.len()];
    // Members of a group that was left open are of it or of its rival, and of nothing smaller.
    let mut contested = vec![0; problem.bearings.len()];
    let mut left_open = false;
    let mut next = 1;
    for (k, group) in groups.iter().enumerate() {
        if group.members.iter().any(|&m| taken[m] || contested[m] > group.members.len()) {
            continue;
        }
        let rival = groups.iter().enumerate().any(|(o, g)| {
            o != k
                && g.members.len() == group.members.len()
                && g.members.iter().any(|m| group.members.contains(m))
                && g.members.iter().all(|m| !taken[*m])
                && (group.evidence == 0 || g.cost < group.cost + MARGIN)
        });
        if rival {
            left_open = true;
            group.members.iter().for_each(|&m| contested[m] = contested[m].max(group.members.len()));
            continue;
        }
        let name = loop {
            let name = format!("u{next}");
            next += 1;
            if !problem.targets.contains(&name) {
                break name;
            }
        };
        problem.targets.push(name);
        problem.times.push(group.members.iter().find_map(|m| problem.bearings[*m].time_s));
        for &m in &group.members {
            taken[m] = true;
            problem.paired[m] = true;
            problem.bearings[m].target = Some(problem.targets.len() - 1);
        }
    }
    left_open
}

/// The pair and the best fitting bearing of every other robot.
fn grow(
    problem: &Problem,
    poses: &[[f64; 3]],
    pose_sigma: &[(f64, f64)],
    a: usize,
    b: usize,
    open: &[usize],
) -> Option<Group> {
    let (first, second) = (&problem.bearings[a], &problem.bearings[b]);
    let together = |m: usize| first.is_together(&problem.bearings[m]);
    if first.observer == second.observer || !together(b) {
        return None;
    }
    let (i, j) = (first.observer, second.observer);
    let at = |r: usize| Vector2::new(poses[r][0], poses[r][1]);
    let line = at(j) - at(i);
    let towards = line.y.atan2(line.x);
    let met = triangulate(&StereoBearings {
        target_1_rad: first.bearing.0,
        target_2_rad: second.bearing.0,
        bearing_21_rad: wrap(towards - poses[i][2]),
        bearing_12_rad: wrap(towards + std::f64::consts::PI - poses[j][2]),
        baseline_m: line.norm(),
    })?;
    if met.range_1_m > FAR_M || met.range_2_m > FAR_M || met.parallax_rad.sin() < 0.02 {
        return None;
    }
    let (s, c) = (poses[i][2] + first.bearing.0).sin_cos();
    let p = at(i) + met.range_1_m * Vector2::new(c, s);
    // Position error along the ray of the first robot; what the poses add is taken from the larger of both.
    let turn = |r: usize, sigma: f64| sigma.hypot(pose_sigma[r].1).hypot(pose_sigma[r].0 / met.range_1_m.max(0.3));
    let sigma_p = (met.range_2_m / met.parallax_rad.sin() * turn(j, second.bearing.1))
        .hypot(met.range_1_m / met.parallax_rad.tan() * turn(i, first.bearing.1))
        .hypot(met.range_1_m * turn(i, first.bearing.1));
    let height = |m: usize| {
        let bearing = &problem.bearings[m];
        let (e, sigma) = bearing.elevation?;
        let d = (p - at(bearing.observer)).norm();
        let z = problem.robots[bearing.observer].camera_height_m + d * e.tan();
        Some((z, (d / e.cos().powi(2) * sigma).hypot(e.tan() * sigma_p)))
    };
    let mut group = Group { members: vec![a, b], cost: 0.0, evidence: 0 };
    let mut heights: Vec<(f64, f64)> = Vec::new();
    let agree = |heights: &[(f64, f64)], new: Option<(f64, f64)>| {
        let (Some((z, sz)), Some((w, sw))) = (new, heights.first()) else { return (0.0, 0) };
        ((z - w).powi(2) / (sz * sz + sw * sw), 1)
    };
    for m in [a, b] {
        let (cost, evidence) = agree(&heights, height(m));
        group.cost += cost;
        group.evidence += evidence;
        heights.extend(height(m));
    }
    if group.cost > GATE {
        return None;
    }
    let others: std::collections::BTreeSet<usize> =
        open.iter().map(|&m| problem.bearings[m].observer).filter(|o| *o != i && *o != j).collect();
    for other in others {
        let best = open
            .iter()
            .filter(|&&m| problem.bearings[m].observer == other && together(m))
            .filter_map(|&m| {
                let d = p - at(other);
                let range = d.norm().max(0.1);
                let residual = wrap(d.y.atan2(d.x) - poses[other][2] - problem.bearings[m].bearing.0);
                let sigma = problem.bearings[m].bearing.1.hypot(pose_sigma[other].1).hypot(sigma_p / range);
                let (by_height, evidence) = agree(&heights, height(m));
                let cost = (residual / sigma).powi(2) + by_height;
                (cost < GATE).then_some((cost, evidence + 1, m))
            })
            .min_by(|x, y| x.0.total_cmp(&y.0));
        if let Some((cost, evidence, m)) = best {
            group.members.push(m);
            group.cost += cost;
            group.evidence += evidence;
        }
    }
    group.members.sort_unstable();
    Some(group)
}
