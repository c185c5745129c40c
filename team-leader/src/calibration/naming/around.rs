//! Of a large team, those robots that a root may see.
//!
//! The search of names grows with the robots it may place. In a house full of robots that look alike most agree with a root's
//! slots in some distance by chance, but hardly any also see a third robot where the root sees one.

use nalgebra::Vector2;

use super::{View, common_range, relative_pose};
use crate::calibration::kernel;

/// Views that are searched without choosing.
const MANY: usize = 24;
/// A third robot is the same within this part of its distance and so much, metres.
const SAME_PART: f64 = 0.05;
const SAME_M: f64 = 0.1;

/// The views that the root's robot may be tied to, by few steps, at most 24; all of them where there are no more. The order
/// stays.
pub fn around(views: Vec<View>, root: usize) -> Vec<View> {
    if views.len() <= MANY {
        return views;
    }
    let Some(root) = views.iter().position(|view| view.robot == root) else { return Vec::new() };
    let mut chosen = vec![root];
    let mut next = 0;
    while let Some(&i) = chosen.get(next) {
        next += 1;
        let ties: Vec<(usize, bool)> = (0..views.len())
            .filter(|j| !chosen.contains(j))
            .filter_map(|j| Some((j, tie(&views[i], &views[j])?)))
            .collect();
        let crowded = chosen.len() + ties.len() > MANY;
        let near = ties.into_iter().filter(|(_, by_third)| *by_third || !crowded).map(|(j, _)| j);
        chosen.extend(near.take(MANY.saturating_sub(chosen.len())));
    }
    chosen.sort_unstable();
    let mut numbers = 0..;
    views.into_iter().filter(|_| numbers.next().is_some_and(|k| chosen.binary_search(&k).is_ok())).collect()
}

/// Whether two robots may see each other: some distance agrees both ways. With that, whether both then see a third robot at one
/// place, or say each other's name.
fn tie(one: &View, other: &View) -> Option<bool> {
    let mut tied = None;
    for (s, seen) in one.slots.iter().enumerate().filter(|(_, slot)| slot.robot.is_none_or(|r| r == other.robot)) {
        for (t, back) in other.slots.iter().enumerate().filter(|(_, slot)| slot.robot.is_none_or(|r| r == one.robot)) {
            let Some((range_m, _)) = common_range([seen.width_rad, back.width_rad]) else { continue };
            let one_from_other = relative_pose(seen.bearing_rad, back.bearing_rad, range_m);
            let ends = |view: &View, but: usize| -> Vec<Vector2<f64>> {
                let slots = view.slots.iter().enumerate().filter(|(k, _)| *k != but);
                slots.filter_map(|(_, slot)| end(slot.bearing_rad, slot.width_rad?.0)).collect()
            };
            let theirs: Vec<_> = ends(other, t).into_iter().map(|p| one_from_other.transform(p)).collect();
            let same = |p: &Vector2<f64>, q: &Vector2<f64>| (p - q).norm() < SAME_M + SAME_PART * p.norm();
            let third = ends(one, s).iter().any(|p| theirs.iter().any(|q| same(p, q)));
            if third || (seen.robot.is_some() && back.robot.is_some()) {
                return Some(true);
            }
            tied = Some(false);
        }
    }
    tied
}

/// Where a slot's robot is, in the observer's frame.
fn end(bearing_rad: f64, width_rad: f64) -> Option<Vector2<f64>> {
    let range_m = kernel::range(width_rad);
    range_m.is_finite().then(|| range_m * Vector2::new(bearing_rad.cos(), bearing_rad.sin()))
}
