//! Where the joint solution begins.
//!
//! First come names for sightings without one (the calibration's naming); then relative poses of pairs with a distance,
//! along a spanning tree from what is held; then robots that the tree does not reach are tried at many places, and the best
//! fit is kept; last the targets, where the rays of their observers pass closest.

use nalgebra::{Matrix2, Vector2};
use protocol::angle::wrap;
use protocol::frames::Pose2;
use protocol::marker::Marker;
use protocol::message::MapStatus;
use protocol::time::Timestamp;

use super::input::{Part, Problem, Sighting};
use super::joint::State;
use super::terms::{Kind, Other, Term};
use crate::calibration::closed_form::{cylinder_range_m, relative_pose};
use crate::calibration::kernel;
use crate::calibration::naming::{self, Known, View};
use crate::calibration::slot::{Sighted, Slot};

/// A margin as in the live calibration.
const NAMING_MARGIN: f64 = 14.0;

/// Axis bearing and range of a sighting, each with sigma: as given, or from the tangents.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Axis {
    /// rad.
    pub bearing: (f64, f64),
    /// m.
    pub range: Option<(f64, f64)>,
}

/// What a sighting says of the peer's axis. `radius_m` of the peer's body where it is round.
pub fn axis(sighting: &Sighting, radius_m: Option<f64>) -> Option<Axis> {
    let tangent = |part| sighting.features.iter().find(|f| f.part == part);
    if let (Some(left), Some(right)) = (tangent(Part::Left), tangent(Part::Right)) {
        let width = wrap(left.bearing_rad - right.bearing_rad);
        let sigma = left.sigma_rad.hypot(right.sigma_rad);
        let range = radius_m
            .and_then(|r| Some((cylinder_range_m(width, r)?, r)))
            .map(|(b, r)| (b, b * (b * b - r * r).max(0.0).sqrt() / (2.0 * r) * sigma));
        return Some(Axis { bearing: (wrap(right.bearing_rad + 0.5 * width), 0.5 * sigma), range });
    }
    let from_features = || {
        let n = sighting.features.len() as f64;
        let first = sighting.features.first()?;
        let mean = sighting.features.iter().map(|f| wrap(f.bearing_rad - first.bearing_rad)).sum::<f64>() / n;
        Some((wrap(first.bearing_rad + mean), 0.05))
    };
    let bearing = sighting.bearing.or_else(from_features)?;
    Some(Axis { bearing, range: sighting.range })
}

/// Radius of a robot's body, where it is round.
pub fn radius_m(problem: &Problem, robot: usize) -> Option<f64> {
    match &problem.robots[robot].marker {
        Marker::Cylinder { radius_m, .. } | Marker::Bars { radius_m, .. } => Some(*radius_m),
        Marker::Rectangle { .. } => None,
    }
}

/// Names for sightings without one; the status says whether they could be told. Unnamed ones that remain are false.
pub fn name_sightings(problem: &mut Problem) -> MapStatus {
    if problem.sightings.iter().all(|s| s.peer.is_some()) {
        return MapStatus::Converged;
    }
    // All bodies that an unnamed one may be must be alike for its range to be known.
    let mut radii: Vec<Option<f64>> = (0..problem.robots.len()).map(|r| radius_m(problem, r)).collect();
    radii.dedup();
    let common = if radii.len() == 1 { radii[0] } else { None };
    let mut slots: Vec<Vec<(Slot, Vec<usize>)>> = vec![Vec::new(); problem.robots.len()];
    let at = Timestamp::default();
    for (k, s) in problem.sightings.iter().enumerate() {
        let radius = s.peer.map_or(common, |p| radius_m(problem, p));
        let Some(axis) = axis(s, radius) else { continue };
        let width_rad = axis.range.map(|(range, sigma)| {
            let (width, slope) = kernel::width(range);
            (width, (slope * sigma).powi(2))
        });
        let sighted = Sighted {
            bearing_rad: axis.bearing.0,
            bearing_var: axis.bearing.1.powi(2),
            width_rad,
            frame_var: (0.0, 0.0),
            robot: s.peer,
        };
        let mine = &mut slots[s.observer];
        match mine.iter_mut().find(|(slot, _)| slot.distance2(&sighted, 0.0).is_some()) {
            Some((slot, members)) => {
                slot.add(at, sighted);
                members.push(k);
            }
            None => mine.push((Slot::new(at, sighted), vec![k])),
        }
    }
    let views: Vec<View> = (0..problem.robots.len())
        .map(|robot| View {
            robot,
            slots: slots[robot].iter().map(|(slot, _)| slot.mean()).collect(),
            known: match problem.robots[robot].pose {
                Some(pose) => Known::Fixed(pose),
                None if robot == problem.anchor && problem.robots.iter().all(|r| r.pose.is_none()) => {
                    Known::Fixed(Pose2::IDENTITY)
                }
                None => Known::Nothing,
            },
        })
        .collect();
    let named = naming::name(&views, 0.0, NAMING_MARGIN);
    for (robot, names) in named.names.iter().enumerate() {
        for ((_, members), name) in slots[robot].iter().zip(names) {
            for &k in members {
                problem.sightings[k].peer = problem.sightings[k].peer.or(*name);
            }
        }
    }
    if named.ambiguous.is_empty() { MapStatus::Converged } else { MapStatus::Ambiguous }
}

/// Poses along the tree of pairs with a distance; `None` for robots that it does not reach.
pub fn tree(problem: &Problem, held: &[Option<Pose2>]) -> Vec<Option<Pose2>> {
    let mut poses = held.to_vec();
    let looks = |i: usize, j: usize| {
        problem
            .sightings
            .iter()
            .filter(move |s| s.observer == i && s.peer == Some(j))
            .filter_map(move |s| axis(s, radius_m(problem, j)).map(|a| (a, s.heading)))
    };
    loop {
        let mut added = false;
        for j in 0..poses.len() {
            if poses[j].is_some() {
                continue;
            }
            let found = (0..poses.len()).find_map(|i| {
                let from = poses[i]?;
                let seen = looks(i, j).next();
                let back = looks(j, i).next();
                let range = looks(i, j).chain(looks(j, i)).find_map(|(a, _)| a.range)?.0;
                match (seen, back) {
                    (Some((a, _)), Some((b, _))) => Some(from * relative_pose(a.bearing.0, b.bearing.0, range)),
                    (Some((a, Some((heading, _)))), None) => {
                        let (s, c) = a.bearing.0.sin_cos();
                        Some(from * Pose2::new(range * c, range * s, heading))
                    }
                    (None, Some((b, Some((heading, _))))) => {
                        let (s, c) = b.bearing.0.sin_cos();
                        Some(from * Pose2::new(range * c, range * s, heading).inverse())
                    }
                    _ => None,
                }
            });
            if found.is_some() {
                poses[j] = found;
                added = true;
            }
        }
        if !added {
            return poses;
        }
    }
}

/// A lattice of places and headings to try a robot at, around what is known: `n` of them, without a random source.
pub fn lattice(known: &[Vector2<f64>], n: usize, salt: usize) -> Vec<Pose2> {
    let count = known.len().max(1) as f64;
    let centre = known.iter().sum::<Vector2<f64>>() / count;
    let reach = known.iter().map(|p| (p - centre).norm()).fold(2.0, f64::max) * 1.5;
    // Additive recurrences with the plastic numbers of three dimensions fill a box evenly.
    let fraction = |k: usize, a: f64| ((k + 17 * salt) as f64 * a).fract();
    (0..n)
        .map(|k| {
            Pose2::new(
                centre.x + reach * (2.0 * fraction(k + 1, 0.819_172_513) - 1.0),
                centre.y + reach * (2.0 * fraction(k + 1, 0.671_043_607) - 1.0),
                std::f64::consts::TAU * fraction(k + 1, 0.549_700_478),
            )
        })
        .collect()
}

/// Puts targets where the rays of their observers pass closest (and heights where elevations say).
pub fn place_targets(state: &mut State, terms: &[Term], free: &[bool]) {
    for (t, _) in free.iter().enumerate().filter(|(_, free)| **free) {
        let mut a = Matrix2::identity() * 1e-9;
        let mut b = Vector2::zeros();
        let rays = || terms.iter().filter(|m| m.other == Other::Target(t));
        let mut mean = Vector2::zeros();
        let mut count = 0.0;
        for m in rays().filter(|m| m.kind == Kind::Bearing) {
            let [x, y, h] = state.poses[m.observer];
            let (s, c) = (h + m.measured).sin_cos();
            let normal = Vector2::new(-s, c);
            let across = normal * normal.transpose();
            a += across;
            b += across * Vector2::new(x, y);
            mean += Vector2::new(x + 2.0 * c, y + 2.0 * s);
            count += 1.0;
        }
        let mut p = a.try_inverse().map_or_else(Vector2::zeros, |inverse| inverse * b);
        if p.norm() > 1e4 || !p.norm().is_finite() || a.determinant() < 1e-6 {
            p = mean / f64::max(count, 1.0);
        }
        state.points[t][0] = p.x;
        state.points[t][1] = p.y;
        for m in rays() {
            if let Kind::Elevation { camera_m } = m.kind {
                let [x, y, _] = state.poses[m.observer];
                state.points[t][2] = camera_m + (p - Vector2::new(x, y)).norm() * m.measured.tan();
            }
        }
    }
}
