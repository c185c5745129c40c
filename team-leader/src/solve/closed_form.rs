//! The report's corrected formulas alone: (5-2) for distances, the mutual bearings for relative poses, (5-1) for targets.
//!
//! One pair at a time and nothing is adjusted jointly, so it is less exact than the joint solution; it is the double check
//! of it, as it shares no solver with it.

use nalgebra::{Matrix2, Matrix3, Vector2};
use protocol::angle::wrap;
use protocol::estimate::SolveStatus;
use protocol::frames::Pose2;
use protocol::message::MapStatus;

use super::fitting;
use super::input::{Bearing, Problem};
use super::output::{Solution, SolvedRobot, SolvedTarget, UNKNOWN_VAR};
use super::start::{Axis, among_landmarks, axis, name_sightings, radius_m};
use crate::calibration::closed_form::relative_pose;
use crate::stereo::triangulate::{StereoBearings, StereoSigmas, fuse_heights, height_m, triangulate, weighted_mean};

/// What a pair of robots measured of each other.
#[derive(Debug, Clone, Copy)]
struct Pair {
    bearing_21: (f64, f64),
    bearing_12: (f64, f64),
    baseline: (f64, f64),
}

/// Solves by closed forms. Bearings without a target are left out.
pub fn solve(mut problem: Problem) -> Solution {
    let naming = name_sightings(&mut problem);
    let said = fitting::prepare(&mut problem);
    let n = problem.robots.len();
    let mut poses: Vec<Option<(Pose2, Matrix3<f64>)>> =
        problem.robots.iter().map(|r| r.pose.map(|p| (p, Matrix3::zeros()))).collect();
    for (robot, pose) in poses.iter_mut().enumerate().filter(|(_, p)| p.is_none()) {
        // The closed form says nothing of how sure it is.
        *pose = among_landmarks(&problem, robot).map(|p| (p, Matrix3::identity() * UNKNOWN_VAR));
    }
    if poses.iter().all(Option::is_none) {
        poses[problem.anchor] = Some((Pose2::IDENTITY, Matrix3::zeros()));
    }
    loop {
        let step = (0..n).filter(|&j| poses[j].is_none()).find_map(|j| {
            (0..n).find_map(|i| {
                let (from, cov) = poses[i]?;
                Some((j, compose(&from, &cov, &measured_pair(&problem, i, j)?)))
            })
        });
        match step {
            Some((j, placed)) => poses[j] = Some(placed),
            None => break,
        }
    }
    let targets: Vec<SolvedTarget> = (0..problem.targets.len()).filter_map(|t| locate(&problem, &poses, t)).collect();
    let robots: Vec<SolvedRobot> = problem
        .robots
        .iter()
        .zip(&poses)
        .filter_map(|(robot, placed)| {
            let (pose, cov) = (*placed)?;
            Some(SolvedRobot {
                id: robot.id.clone(),
                x_m: pose.x_m,
                y_m: pose.y_m,
                heading_deg: pose.heading_rad.to_degrees(),
                covariance: (cov[(0, 0)] < UNKNOWN_VAR)
                    .then(|| [0, 1, 2].map(|r| [cov[(r, 0)], cov[(r, 1)], cov[(r, 2)]])),
                nuisance: Default::default(),
            })
        })
        .collect();
    let (status, explanation) = if naming == MapStatus::Ambiguous {
        (SolveStatus::Ambiguous, "several ways of naming the sightings fit equally")
    } else if robots.len() < n {
        (SolveStatus::Insufficient, "a robot has no mutual sighting with a distance")
    } else {
        (SolveStatus::Converged, "closed forms, pair by pair")
    };
    let weakest_direction = "not known by closed forms".to_owned();
    Solution { robots, targets, weakest_direction, warnings: said, ..Solution::empty(status, explanation) }
}

/// Mean of all that `i` says of `j` and back; `None` without both bearings and a distance.
fn measured_pair(problem: &Problem, i: usize, j: usize) -> Option<Pair> {
    let looks = |a: usize, b: usize| -> Vec<Axis> {
        let of = problem.sightings.iter().filter(|s| s.observer == a && s.peer == Some(b));
        of.filter_map(|s| axis(s, radius_m(problem, b))).collect()
    };
    let (there, back) = (looks(i, j), looks(j, i));
    let baseline = weighted_mean(there.iter().chain(&back).filter_map(|a| a.range))?;
    let bearing = |looks: &[Axis]| {
        let first = looks.first()?.bearing.0;
        let (mean, sigma) = weighted_mean(looks.iter().map(|a| (wrap(a.bearing.0 - first), a.bearing.1)))?;
        Some((wrap(first + mean), sigma))
    };
    Some(Pair { bearing_21: bearing(&there)?, bearing_12: bearing(&back)?, baseline })
}

fn compose(from: &Pose2, cov: &Matrix3<f64>, pair: &Pair) -> (Pose2, Matrix3<f64>) {
    let (beta, range) = (pair.bearing_21.0, pair.baseline.0);
    let pose = *from * relative_pose(beta, pair.bearing_12.0, range);
    let d = pose.position() - from.position();
    let by_from = Matrix3::new(1.0, 0.0, -d.y, 0.0, 1.0, d.x, 0.0, 0.0, 1.0);
    let u = d / range;
    // Columns: distance, β₂₁, β₁₂.
    let by_pair = Matrix3::new(u.x, -d.y, 0.0, u.y, d.x, 0.0, 0.0, 1.0, -1.0);
    let sigmas = nalgebra::Vector3::new(pair.baseline.1, pair.bearing_21.1, pair.bearing_12.1);
    let measured = Matrix3::from_diagonal(&sigmas.component_mul(&sigmas));
    (pose, by_from * cov * by_from.transpose() + by_pair * measured * by_pair.transpose())
}

/// The target by the pair of observers that locates it best.
fn locate(problem: &Problem, poses: &[Option<(Pose2, Matrix3<f64>)>], target: usize) -> Option<SolvedTarget> {
    let seen: Vec<&Bearing> = problem.bearings.iter().filter(|b| b.target == Some(target)).collect();
    let mut best: Option<(f64, SolvedTarget)> = None;
    for (k, a) in seen.iter().enumerate() {
        for b in seen.iter().skip(k + 1).filter(|b| b.observer != a.observer) {
            let (Some((pose_a, cov_a)), Some((pose_b, _))) = (poses[a.observer], poses[b.observer]) else { continue };
            let pair = measured_pair(problem, a.observer, b.observer).unwrap_or_else(|| Pair {
                bearing_21: (pose_a.bearing_to(pose_b.position()), 0.0),
                bearing_12: (pose_b.bearing_to(pose_a.position()), 0.0),
                baseline: ((pose_b.position() - pose_a.position()).norm(), 0.0),
            });
            let Some((cost, located)) = by_pair(problem, target, (a, &pose_a, &cov_a), b, &pair) else { continue };
            if best.as_ref().is_none_or(|(c, _)| cost < *c) {
                best = Some((cost, located));
            }
        }
    }
    best.map(|(_, located)| located)
}

fn by_pair(
    problem: &Problem,
    target: usize,
    (a, pose_a, cov_a): (&Bearing, &Pose2, &Matrix3<f64>),
    b: &Bearing,
    pair: &Pair,
) -> Option<(f64, SolvedTarget)> {
    let met = triangulate(&StereoBearings {
        target_1_rad: a.bearing.0,
        target_2_rad: b.bearing.0,
        bearing_21_rad: pair.bearing_21.0,
        bearing_12_rad: pair.bearing_12.0,
        baseline_m: pair.baseline.0,
    })?;
    let sigmas = StereoSigmas {
        target_rad: [a.bearing.1, b.bearing.1],
        peer_rad: [pair.bearing_21.1, pair.bearing_12.1],
        baseline_m: pair.baseline.1,
    };
    let rotation = pose_a.rotation();
    let position = pose_a.transform(met.position_m);
    let mut cov: Matrix2<f64> = rotation * met.covariance(pair.baseline.0, &sigmas) * rotation.transpose();
    let d: Vector2<f64> = position - pose_a.position();
    let by_pose = nalgebra::Matrix2x3::new(1.0, 0.0, -d.y, 0.0, 1.0, d.x);
    cov += by_pose * cov_a * by_pose.transpose();
    let camera = |o: &Bearing| problem.robots[o.observer].camera_height_m;
    let range_var = cov.trace();
    let z = match (a.elevation, b.elevation) {
        (Some((ea, sa)), Some((eb, sb))) => {
            let (z, _) = fuse_heights((camera(a), met.range_1_m, ea, sa), (camera(b), met.range_2_m, eb, sb));
            let (_, var) = height_m(camera(a), met.range_1_m, ea, sa.min(sb), range_var);
            Some((z, var))
        }
        (Some((e, s)), None) => Some(height_m(camera(a), met.range_1_m, e, s, range_var)),
        (None, Some((e, s))) => Some(height_m(camera(b), met.range_2_m, e, s, range_var)),
        (None, None) => None,
    };
    let z_var = z.map_or(UNKNOWN_VAR, |(_, var)| var);
    Some((
        cov.trace(),
        SolvedTarget {
            id: problem.targets[target].clone(),
            x_m: position.x,
            y_m: position.y,
            z_m: z.map(|(z, _)| z),
            covariance: Some([[cov[(0, 0)], cov[(0, 1)], 0.0], [cov[(1, 0)], cov[(1, 1)], 0.0], [0.0, 0.0, z_var]]),
            observers: observers(problem, target),
            time_s: None,
            paired: Vec::new(),
            velocity_mps: None,
        },
    ))
}

/// Who has a bearing of the target.
fn observers(problem: &Problem, target: usize) -> Vec<String> {
    let mut ids: Vec<String> = Vec::new();
    for b in problem.bearings.iter().filter(|b| b.target == Some(target)) {
        let id = &problem.robots[b.observer].id;
        if !ids.contains(id) {
            ids.push(id.clone());
        }
    }
    ids
}
