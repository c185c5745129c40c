//! Where the joint solution begins.
//!
//! First come names for sightings without one (the calibration's naming); then relative poses of pairs with a distance,
//! along a spanning tree from what is held; then robots that the tree does not reach are tried at many places, and the best
//! fit is kept; last the targets, where the rays of their observers pass closest.

use std::collections::BTreeMap;

use nalgebra::{Matrix2, Vector2};
use protocol::angle::wrap;
use protocol::frames::Pose2;
use protocol::marker::Marker;
use protocol::marker::closed_form::{PlateView, plate, three_bars};
use protocol::message::MapStatus;
use protocol::time::Timestamp;

use super::input::{Feature, Part, Problem, Sighting};
use super::layout::{State, TARGET};
use super::resection::resect;
use super::terms::{Kind, Other, Term};
use crate::calibration::closed_form::{cylinder_range_m, relative_pose};
use crate::calibration::kernel;
use crate::calibration::naming::{self, Known, View};
use crate::calibration::slot::{Sighted, Slot};

/// A margin as in the live calibration.
const NAMING_MARGIN: f64 = 14.0;

/// Sigma of a bearing that is the mean of features, none of which tells where the axis is.
pub const MEAN_SIGMA_RAD: f64 = 0.05;

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
        Some((wrap(first.bearing_rad + mean), MEAN_SIGMA_RAD))
    };
    let bearing = sighting.bearing.or_else(from_features)?;
    Some(Axis { bearing, range: sighting.range })
}

/// A sighting's axis, and the peer's heading with its sigma (minus the observer's) where it shows.
pub type Seen = (Axis, Option<(f64, f64)>);

/// What a sighting says of the peer's axis and heading (minus the observer's), by the closed forms of the marker (report
/// 5.2.1 to 5.2.3, corrected).
pub fn seen(problem: &Problem, sighting: &Sighting, peer: usize) -> Option<Seen> {
    let marker = &problem.robots[peer].marker;
    let from_features = match marker {
        Marker::Cylinder { .. } => None,
        Marker::Bars { radius_m, azimuths_deg, .. } => by_bars(sighting, *radius_m, azimuths_deg),
        Marker::Rectangle { height_m, behind_m, .. } => by_plate(sighting, marker, *height_m, *behind_m),
    };
    if let Some((axis, heading)) = from_features {
        return Some((axis, sighting.heading.or(heading)));
    }
    Some((axis(sighting, radius_m(problem, peer))?, sighting.heading))
}

/// The first, middle and last of the bars that are in view.
fn by_bars(sighting: &Sighting, radius_m: f64, azimuths_deg: &[f64]) -> Option<Seen> {
    let known = sighting.features.iter().filter_map(|f| match f.part {
        Part::Bar(n) => Some((f.bearing_rad, f.sigma_rad, azimuths_deg.get(n)?.to_radians())),
        _ => None,
    });
    let mut bars: Vec<(f64, f64, f64)> = known.collect();
    let reference = bars.first()?.0;
    bars.sort_by(|a, b| wrap(a.0 - reference).total_cmp(&wrap(b.0 - reference)));
    let [first, .., last] = bars[..] else { return None };
    let middle = bars[bars.len() / 2];
    // Further left is a smaller azimuth on the near side.
    let gaps = [wrap(first.2 - middle.2), wrap(middle.2 - last.2)];
    let found = three_bars([first.0, middle.0, last.0], middle.1, gaps, radius_m)?;
    let axis = Axis { bearing: (found.value[1], found.sigma(1)), range: Some((found.value[0], found.sigma(0))) };
    Some((axis, Some((wrap(found.value[2] - middle.2), found.sigma(2)))))
}

/// Distance by the known height of the edges; heading by the ratio of their apparent heights.
fn by_plate(sighting: &Sighting, marker: &Marker, height_m: f64, behind_m: f64) -> Option<Seen> {
    let edge = |n| sighting.features.iter().find(|f| f.part == Part::Edge(n));
    let (right, left) = (edge(0)?, edge(1)?);
    let apparent = |f: &Feature| f.elevation_rad.map(|[low, high]| high.tan() - low.tan());
    let (h_right, h_left) = (apparent(right)?, apparent(left)?);
    if h_right <= 0.0 || h_left <= 0.0 {
        return None;
    }
    let mean = 0.5 * (h_right + h_left);
    let sigma = right.sigma_rad.hypot(left.sigma_rad);
    let height_sigma = right.elevation_sigma_rad.hypot(left.elevation_sigma_rad);
    let range = height_m / mean + behind_m;
    let across = wrap(left.bearing_rad - right.bearing_rad);
    let axis = Axis {
        bearing: (wrap(right.bearing_rad + 0.5 * across), 0.5 * sigma.max(0.1 * across.abs())),
        range: Some((range, range * height_sigma / mean)),
    };
    let view = PlateView {
        bearings_rad: [left.bearing_rad, right.bearing_rad],
        bearing_sigma_rad: sigma,
        heights: [h_left, h_right],
        relative_height_sigma: height_sigma / mean,
    };
    Some((axis, plate(&view, marker).map(|found| (found.value[2], found.sigma(2)))))
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
            doubt: None,
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

/// Poses along the tree of pairs with a distance; `None` for robots that it does not reach. Of several sightings of a pair
/// the median counts, so that a single gross error does not begin the search in the wrong place.
pub fn tree(problem: &Problem, held: &[Option<Pose2>]) -> Vec<Option<Pose2>> {
    let mut looks: BTreeMap<(usize, usize), Look> = BTreeMap::new();
    for s in &problem.sightings {
        let Some(peer) = s.peer else { continue };
        let Some((axis, heading)) = seen(problem, s, peer) else { continue };
        let look = looks.entry((s.observer, peer)).or_default();
        look.bearings.push(axis.bearing.0);
        look.ranges.extend(axis.range.map(|r| r.0));
        look.headings.extend(heading.map(|h| h.0));
    }
    let looks: BTreeMap<(usize, usize), MedianLook> = looks
        .into_iter()
        .filter_map(|(pair, look)| {
            Some((pair, (median_angle(&look.bearings)?, median(look.ranges), median_angle(&look.headings))))
        })
        .collect();
    let mut poses = held.to_vec();
    for (robot, pose) in poses.iter_mut().enumerate().filter(|(_, p)| p.is_none()) {
        *pose = among_landmarks(problem, robot);
    }
    loop {
        let mut added = along_ways(problem, &mut poses);
        for j in 0..poses.len() {
            if poses[j].is_some() {
                continue;
            }
            let found = (0..poses.len()).find_map(|i| {
                let from = poses[i]?;
                let (seen, back) = (looks.get(&(i, j)), looks.get(&(j, i)));
                let range = seen.and_then(|s| s.1).or_else(|| back.and_then(|b| b.1))?;
                match (seen, back) {
                    (Some((a, ..)), Some((b, ..))) => Some(from * relative_pose(*a, *b, range)),
                    (Some((a, _, Some(heading))), None) => {
                        let (s, c) = a.sin_cos();
                        Some(from * Pose2::new(range * c, range * s, *heading))
                    }
                    (None, Some((b, _, Some(heading)))) => {
                        let (s, c) = b.sin_cos();
                        Some(from * Pose2::new(range * c, range * s, *heading).inverse())
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

/// Places before and after the ways that robots went, where one of the two is known; whether there were any.
fn along_ways(problem: &Problem, poses: &mut [Option<Pose2>]) -> bool {
    let mut added = false;
    for (j, robot) in problem.robots.iter().enumerate() {
        let Some(moved) = &robot.moved else { continue };
        let way = Pose2::new(moved.step[0], moved.step[1], moved.step[2]);
        match (poses[moved.from], poses[j]) {
            (Some(from), None) => poses[j] = Some(from * way),
            (None, Some(to)) => poses[moved.from] = Some(to * way.inverse()),
            _ => continue,
        }
        added = true;
    }
    added
}

/// Where a robot sees three landmarks or more.
pub fn among_landmarks(problem: &Problem, robot: usize) -> Option<Pose2> {
    if problem.landmarks.is_empty() {
        return None;
    }
    let seen = problem.bearings.iter().filter(|b| b.observer == robot).filter_map(|b| {
        let mark = problem.landmarks.iter().find(|l| b.target == Some(l.target))?;
        Some((mark.position_m, b.bearing.0))
    });
    resect(&seen.collect::<Vec<_>>())
}

/// Median bearing, range and heading.
type MedianLook = (f64, Option<f64>, Option<f64>);

#[derive(Debug, Clone, Default)]
struct Look {
    bearings: Vec<f64>,
    ranges: Vec<f64>,
    headings: Vec<f64>,
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

/// The angle from which the others are nearest in sum.
fn median_angle(angles: &[f64]) -> Option<f64> {
    // A few candidates are enough against a few gross errors, and keep it linear.
    let step = (angles.len() / 9).max(1);
    let away = |a: f64| angles.iter().map(|b| wrap(a - b).abs()).sum::<f64>();
    let best = angles.iter().step_by(step).min_by(|a, b| away(**a).total_cmp(&away(**b)))?;
    Some(wrap(best + median(angles.iter().map(|a| wrap(a - best)).collect())?))
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
pub fn place_targets(state: &mut State, terms: &[Term], free: &[[bool; TARGET]]) {
    let mut rays: Vec<Vec<usize>> = vec![Vec::new(); free.len()];
    for (k, term) in terms.iter().enumerate() {
        if let Other::Target(t) = term.other {
            rays[t].push(k);
        }
    }
    for (t, _) in free.iter().enumerate().filter(|(_, free)| free[0]) {
        let mut a = Matrix2::identity() * 1e-9;
        let mut b = Vector2::zeros();
        let rays = || rays[t].iter().map(|k| &terms[*k]);
        let mut mean = Vector2::zeros();
        let mut count = 0.0;
        for m in rays().filter(|m| m.kind == Kind::Bearing) {
            let [x, y, h, ..] = state.poses[m.observer];
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
                let [x, y, ..] = state.poses[m.observer];
                state.points[t][2] = camera_m + (p - Vector2::new(x, y)).norm() * m.measured.tan();
            }
        }
    }
}
