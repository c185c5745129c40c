//! Who is who among robots that look alike.
//!
//! Problem: each standing robot has slots (places where it sees some robot), none with a name. Some slots are no robots.
//!
//! Insight: a pair that sees each other tells one distance twice, and a third robot must then appear at a predicted bearing
//! and distance in both pictures, and they in its. A wrong name almost always breaks a distance, a bearing or the
//! handedness of a triangle; where it does not, the layout is symmetric, and nothing but time (somebody moves) can tell.
//!
//! Algorithm: from the root outwards, place one more robot by any pair of slots of equal distance, name every slot that
//! the placement explains, pay for each expected slot that is missing; keep the best `BEAM` partial namings. The
//! complete ones are solved jointly; their cost is χ² plus the price of misses and of slots left without a name. A robot
//! is placed only where every naming within the margin of the best agrees on its pose.

mod around;

use std::collections::BTreeSet;

use nalgebra::{Matrix3, Vector3};
use protocol::angle::wrap;
use protocol::frames::Pose2;

use super::block::{Block, Link};
use super::closed_form::relative_pose;
use super::kernel;
use super::slot::SlotMean;
pub use around::around;

/// Partial namings kept.
const BEAM: usize = 24;
/// Complete namings solved jointly.
const SOLVED: usize = 8;
/// Price of a robot that is not seen where it should be.
const MISS_COST: f64 = 10.0;
/// The same where a nearer robot may hide it.
const HIDDEN_COST: f64 = 1.0;
/// Price of a slot without a name (a false sighting, or a stranger).
const FALSE_COST: f64 = 12.0;
/// Squared sigmas, per coordinate pair, beyond which a slot is not what is predicted.
const MATCH_GATE: f64 = 25.0;
/// Sigmas by which the two distances of a pair may differ.
const RECIPROCITY_SIGMAS: f64 = 4.5;
/// Two namings agree on a robot when its poses are this close.
const SAME_PLACE_M: f64 = 0.15;
const SAME_HEADING_RAD: f64 = 0.06;
/// Half width of a body that may hide another, metres.
const BODY_M: f64 = 0.25;

/// A standing robot and what it sees; variances with their floors.
#[derive(Debug, Clone)]
pub struct View {
    /// Who looks.
    pub robot: usize,
    /// Its slots.
    pub slots: Vec<SlotMean>,
    /// Its pose as far as known, in the frame of the result: held (a member of the block) or a hint.
    pub known: Known,
    /// Distances that are not believed.
    pub doubt: Option<Doubt>,
}

/// Why some distances of a robot are not believed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Doubt {
    /// Its marker is not as announced: those that others measure to it.
    Size,
    /// Its camera is not as announced: those that it measures.
    Ranges,
}

/// Width of a slot of `observer` as it counts if it shows `peer`.
fn believed(observer: &View, peer: &View, slot: &SlotMean) -> Option<(f64, f64)> {
    let doubted = observer.doubt == Some(Doubt::Ranges) || peer.doubt == Some(Doubt::Size);
    slot.width_rad.filter(|_| !doubted)
}

/// What is known of a robot's pose before.
#[derive(Debug, Clone, Copy)]
pub enum Known {
    /// Nothing.
    Nothing,
    /// It is there.
    Fixed(Pose2),
    /// It should be there.
    Hint(Pose2, Matrix3<f64>),
}

/// The result.
#[derive(Debug, Clone, Default)]
pub struct Naming {
    /// Robots whose place is certain, with pose: those that were fixed, too.
    pub placed: Vec<(usize, Pose2)>,
    /// Robots that could be placed in several ways.
    pub ambiguous: Vec<usize>,
    /// Robots whose place might as well be that of another one, which the best naming does not place.
    pub replaceable: Vec<usize>,
    /// Name of each slot of each view under the best naming, for slots between placed robots.
    pub names: Vec<Vec<Option<usize>>>,
    /// χ² and prices of the best naming.
    pub cost: f64,
    /// By view: squared residuals of all that it sees and that is seen of it.
    pub fits: Vec<f64>,
}

#[derive(Debug, Clone)]
struct Partial {
    /// By view: pose and the standard deviation of its position.
    poses: Vec<Option<(Pose2, f64)>>,
    /// By view and slot: which view it shows.
    names: Vec<Vec<Option<usize>>>,
    cost: f64,
    /// See [`Naming::fits`].
    fits: Vec<f64>,
}

/// Names the slots of `views`. At least one view must be `Fixed`; the result's poses are in its frame. `margin` is how much
/// better the best naming must be.
pub fn name(views: &[View], common_width_rad: f64, margin: f64) -> Naming {
    let mut root = Partial {
        poses: vec![None; views.len()],
        names: views.iter().map(|v| vec![None; v.slots.len()]).collect(),
        cost: 0.0,
        fits: vec![0.0; views.len()],
    };
    for (j, view) in views.iter().enumerate() {
        if let Known::Fixed(pose) = view.known {
            place(&mut root, views, j, pose, 0.0);
        }
    }
    let complete = search(root, views);
    let mut solved: Vec<(f64, Partial)> = complete
        .into_iter()
        .take(SOLVED)
        .map(|mut partial| (joint_cost(&mut partial, views, common_width_rad), partial))
        .collect();
    solved.sort_by(|a, b| a.0.total_cmp(&b.0));
    conclude(&solved, views, margin)
}

fn search(root: Partial, views: &[View]) -> Vec<Partial> {
    let mut complete: Vec<Partial> = Vec::new();
    let mut beam = vec![root];
    while !beam.is_empty() {
        let mut next: Vec<Partial> = Vec::new();
        let mut seen = BTreeSet::new();
        for partial in beam {
            let before = next.len();
            let mut children = 0;
            for child in children_of(&partial, views) {
                children += 1;
                if seen.insert(child.names.clone()) {
                    next.push(child);
                }
            }
            if children == 0 && next.len() == before {
                complete.push(partial);
            }
        }
        next.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        next.truncate(BEAM);
        beam = next;
    }
    for partial in &mut complete {
        let nameless = partial.names.iter().flatten().filter(|n| n.is_none()).count();
        partial.cost += FALSE_COST * nameless as f64;
    }
    complete.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    complete.dedup_by(|a, b| a.names == b.names);
    complete
}

/// All ways to place one more robot by a pair of slots of equal distance.
fn children_of(partial: &Partial, views: &[View]) -> Vec<Partial> {
    let mut children = Vec::new();
    for j in (0..views.len()).filter(|&j| partial.poses[j].is_none()) {
        for (i, at) in partial.poses.iter().enumerate() {
            let Some((pose_i, sigma_i)) = *at else { continue };
            for s in open_slots(partial, views, i, j) {
                for t in open_slots(partial, views, j, i) {
                    let (seen, back) = (&views[i].slots[s], &views[j].slots[t]);
                    let widths = [believed(&views[i], &views[j], seen), believed(&views[j], &views[i], back)];
                    let Some((range_m, sigma_m)) = common_range(widths) else { continue };
                    let pose = pose_i * relative_pose(seen.bearing_rad, back.bearing_rad, range_m);
                    let sigma = sigma_i.hypot(sigma_m).hypot(range_m * seen.bearing_var.sqrt());
                    let mut child = partial.clone();
                    if let Known::Hint(hint, covariance) = views[j].known {
                        child.cost += hint_cost(&pose, &hint, &covariance);
                    }
                    place(&mut child, views, j, pose, sigma);
                    children.push(child);
                }
            }
        }
    }
    children
}

fn open_slots<'a>(
    partial: &'a Partial,
    views: &'a [View],
    observer: usize,
    peer: usize,
) -> impl Iterator<Item = usize> + 'a {
    let robot = views[peer].robot;
    let slots = views[observer].slots.iter().enumerate();
    slots
        .filter(move |(s, slot)| partial.names[observer][*s].is_none() && slot.robot.is_none_or(|told| told == robot))
        .map(|(s, _)| s)
}

/// The distance of a pair that sees each other, and its standard deviation; `None` if the two pictures disagree or neither
/// tells.
fn common_range([seen, back]: [Option<(f64, f64)>; 2]) -> Option<(f64, f64)> {
    let (width, var) = match (seen, back) {
        (Some((a, va)), Some((b, vb))) => {
            if (a - b).abs() > RECIPROCITY_SIGMAS * (va + vb).sqrt() {
                return None;
            }
            ((a * vb + b * va) / (va + vb), va * vb / (va + vb))
        }
        (Some(one), None) | (None, Some(one)) => one,
        (None, None) => return None,
    };
    let range_m = kernel::range(width);
    Some((range_m, var.sqrt() / kernel::width(range_m).1.abs()))
}

fn hint_cost(pose: &Pose2, hint: &Pose2, covariance: &Matrix3<f64>) -> f64 {
    let e = Vector3::new(pose.x_m - hint.x_m, pose.y_m - hint.y_m, wrap(pose.heading_rad - hint.heading_rad));
    // A floor on the covariance: the candidate pose has an error of its own.
    let sum = covariance + Matrix3::from_diagonal(&Vector3::new(0.0025, 0.0025, 0.0005));
    sum.cholesky().map_or(0.0, |c| e.dot(&c.solve(&e)).min(30.0))
}

/// Puts view `j` at `pose` and names every slot between it and the robots placed before, in both directions.
fn place(partial: &mut Partial, views: &[View], j: usize, pose: Pose2, sigma_m: f64) {
    for k in 0..views.len() {
        let Some((pose_k, sigma_k)) = partial.poses[k] else { continue };
        let sigma = sigma_m.hypot(sigma_k);
        let there = explain(partial, views, (j, pose), (k, pose_k), sigma);
        let back = explain(partial, views, (k, pose_k), (j, pose), sigma);
        partial.cost += there + back;
    }
    partial.poses[j] = Some((pose, sigma_m));
}

/// Names the slot of the observer that shows the peer; returns what the match, or its absence, costs.
fn explain(partial: &mut Partial, views: &[View], observer: (usize, Pose2), peer: (usize, Pose2), sigma_m: f64) -> f64 {
    let ((i, at), (j, other)) = (observer, peer);
    let (bearing, _, _) = kernel::bearing([at.x_m, at.y_m, at.heading_rad], [other.x_m, other.y_m]);
    let range_m = (other.position() - at.position()).norm();
    let (width, slope) = kernel::width(range_m);
    let across = (sigma_m / range_m.max(kernel::LEAST_RANGE_M)).powi(2);
    let along = (sigma_m * slope).powi(2);
    let distance2 = |slot: &SlotMean| {
        let db = wrap(slot.bearing_rad - bearing);
        let by_width = believed(&views[i], &views[j], slot).map_or(0.0, |(w, var)| (w - width).powi(2) / (var + along));
        db * db / (slot.bearing_var + across) + by_width
    };
    let best = open_slots(partial, views, i, j)
        .map(|s| (distance2(&views[i].slots[s]), s))
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .filter(|(d2, _)| *d2 < MATCH_GATE);
    if let Some((d2, s)) = best {
        partial.names[i][s] = Some(j);
        return d2;
    }
    let hidden = views[i].slots.iter().any(|slot| {
        let near_m = slot.width_rad.map_or(0.0, |(w, _)| kernel::range(w));
        near_m > 0.0 && near_m < range_m && wrap(slot.bearing_rad - bearing).abs() < 2.0 * BODY_M / near_m
    });
    if hidden { HIDDEN_COST } else { MISS_COST }
}

/// Solves a complete naming jointly; its poses become the solution's. χ² replaces the rough distances of the search.
fn joint_cost(partial: &mut Partial, views: &[View], common_width_rad: f64) -> f64 {
    let mut block = Block::new(common_width_rad);
    let mut rough = 0.0;
    for (j, view) in views.iter().enumerate() {
        let Some((pose, _)) = partial.poses[j] else { continue };
        let sigmas = match view.known {
            Known::Fixed(_) => Vector3::repeat(1e-10),
            _ => Vector3::new(100.0, 100.0, 9.0),
        };
        if let Known::Hint(hint, covariance) = view.known {
            rough += hint_cost(&pose, &hint, &covariance);
        }
        block.insert(j, pose, &Matrix3::from_diagonal(&sigmas));
    }
    let links = links_of(partial, views);
    block.solve(&links);
    for link in &links {
        let size2 = block.residual2(link).map_or(0.0, |(bearing2, width2)| bearing2 + width2.unwrap_or(0.0));
        partial.fits[link.observer] += size2;
        partial.fits[link.peer] += size2;
    }
    let nameless = partial.names.iter().flatten().filter(|n| n.is_none()).count();
    let placed: Vec<usize> = (0..views.len()).filter(|&j| partial.poses[j].is_some()).collect();
    let named = partial.names.iter().flatten().flatten().count();
    let missing = (placed.len() * placed.len().saturating_sub(1)).saturating_sub(named);
    for &j in &placed {
        if let (Some(pose), Some(slot)) = (block.pose(j), partial.poses[j].as_mut()) {
            slot.0 = pose;
        }
    }
    let fit = if block.converged() { block.chi2().0 } else { f64::INFINITY };
    fit + rough + FALSE_COST * nameless as f64 + MISS_COST * missing as f64
}

fn links_of(partial: &Partial, views: &[View]) -> Vec<Link> {
    let mut links = Vec::new();
    for (i, names) in partial.names.iter().enumerate() {
        for (s, name) in names.iter().enumerate() {
            let Some(j) = *name else { continue };
            let slot = &views[i].slots[s];
            links.push(Link {
                observer: i,
                peer: j,
                bearing_rad: slot.bearing_rad,
                bearing_var: slot.bearing_var,
                width_rad: believed(&views[i], &views[j], slot),
            });
        }
    }
    links
}

fn conclude(solved: &[(f64, Partial)], views: &[View], margin: f64) -> Naming {
    let Some((cost, best)) = solved.first() else { return Naming::default() };
    let rivals: Vec<&Partial> = solved.iter().filter(|(c, _)| *c < cost + margin).map(|(_, p)| p).collect();
    let mut naming = Naming { names: best.names.clone(), cost: *cost, fits: best.fits.clone(), ..Naming::default() };
    let mut certain = vec![false; views.len()];
    for (j, view) in views.iter().enumerate() {
        let Some((pose, _)) = best.poses[j] else { continue };
        certain[j] = rivals.iter().all(|rival| {
            rival.poses[j].is_none_or(|(other, _)| {
                (other.position() - pose.position()).norm() < SAME_PLACE_M
                    && wrap(other.heading_rad - pose.heading_rad).abs() < SAME_HEADING_RAD
            })
        });
        let held = matches!(view.known, Known::Fixed(_));
        if !held && rivals.iter().any(|rival| takes_the_place(rival, best, j)) {
            certain[j] = false;
            naming.replaceable.push(view.robot);
        }
        if certain[j] { naming.placed.push((view.robot, pose)) } else { naming.ambiguous.push(view.robot) }
    }
    // Names go out as robots, and only between certain ones.
    for (i, names) in naming.names.iter_mut().enumerate() {
        for name in names.iter_mut() {
            *name = name.filter(|&j| certain[i] && certain[j]).map(|j| views[j].robot);
        }
    }
    naming
}

/// Whether a robot that `best` does not place could be where it has robot `j`: somebody sees it in the same slot. (Robots that
/// `best` places only change places, which their poses tell.)
fn takes_the_place(rival: &Partial, best: &Partial, j: usize) -> bool {
    let mut pairs = best.names.iter().flatten().zip(rival.names.iter().flatten());
    pairs.any(|(ours, theirs)| *ours == Some(j) && theirs.is_some_and(|other| best.poses[other].is_none()))
}

#[cfg(test)]
mod tests;
