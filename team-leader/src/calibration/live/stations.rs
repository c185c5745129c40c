//! The standing robots together: names, checks of names, the joint solution.

use nalgebra::{Matrix3, Vector3};
use protocol::angle::wrap;
use protocol::frames::Pose2;
use protocol::time::Timestamp;

use super::Finding;
use super::{
    CHECK_INTERVAL_S, CONTRADICTIONS, Calibrator, FRESH_S, Fit, GAUGE_VAR, LEAST_COUNT, NAMING_INTERVAL_S, SETTLED_S,
    remembered,
};
use crate::calibration::naming::{self, Known, Naming, View};

/// Covariance of a member that only its links determine (m², m², rad²).
pub(super) const WEAK: [f64; 3] = [100.0, 100.0, 9.0];
/// Blocks of more members, and those of a large team, are solved at most this often, seconds.
const LARGE_BLOCK: usize = 8;
const LARGE_BLOCK_INTERVAL_S: f64 = 0.1;
/// How long a robot that stands waits for others that come to stand, before it is named, seconds.
const STRAGGLERS_S: f64 = 1.0;
/// Robots tried as the root of a frame in one attempt; the next attempt goes on with others.
const MAX_ROOTS: usize = 24;
/// Squared sigmas (two numbers) within which a slot of a member is a member that should be there.
const SLOT_GATE: f64 = 18.0;

/// Names as they follow from one robot's place.
struct Rooted {
    root: usize,
    pose: Pose2,
    covariance: Matrix3<f64>,
    naming: Naming,
    views: Vec<View>,
    /// Others that then stand where they are remembered.
    agreeing: usize,
}

impl Calibrator {
    /// Names slots of a member that show another member where it must be.
    pub(super) fn name_slots_of_members(&mut self, robot: usize, at: Timestamp) {
        if !self.block.contains(robot) {
            return;
        }
        let nameless: Vec<usize> = (0..self.robots[robot].slots.len())
            .filter(|&s| {
                let slot = &self.robots[robot].slots[s];
                slot.name.is_none() && slot.count() >= LEAST_COUNT
            })
            .collect();
        for s in nameless.into_iter().rev() {
            let mean = self.with_floors(&self.robots[robot].slots[s].mean());
            let best = self
                .block
                .members()
                .iter()
                .filter(|&&peer| peer != robot && mean.robot.is_none_or(|told| told == peer))
                .filter_map(|&peer| {
                    let mean = self.believed(robot, peer, &mean);
                    let predicted = self.predicted(robot, peer)?;
                    let db = wrap(mean.bearing_rad - predicted.bearing_rad);
                    let mut d2 = db * db / (mean.bearing_var + predicted.bearing_var);
                    if let (Some((a, va)), Some((b, vb))) = (mean.width_rad, predicted.width_rad) {
                        d2 += (a - b).powi(2) / (va + vb);
                    }
                    (d2 < SLOT_GATE).then_some((d2, peer))
                })
                .min_by(|a, b| a.0.total_cmp(&b.0));
            let Some((_, peer)) = best else { continue };
            let slots = &mut self.robots[robot].slots;
            let rival = slots.iter().position(|slot| slot.name == Some(peer));
            match rival {
                None => slots[s].name = Some(peer),
                // The older one has not been seen since: something in view has changed, the present counts.
                Some(old) if at.seconds_since(slots[old].last) > FRESH_S => {
                    slots[s].name = Some(peer);
                    slots.remove(old);
                    return;
                }
                Some(_) => {}
            }
        }
    }

    /// Tries to place standing robots that have no place among the standing ones.
    pub(super) fn name_strangers(&mut self, at: Timestamp) {
        let strangers = self.robots.iter().any(|(r, robot)| robot.standing_since.is_some() && !self.block.contains(r));
        // What all robots saw at one instant is complete only with the last of them.
        let just_tried = |t: Timestamp| t != at && at.seconds_since(t) < NAMING_INTERVAL_S;
        if !strangers || self.last_naming.is_some_and(just_tried) {
            return;
        }
        self.last_naming = Some(at);
        if !self.block.members().is_empty() {
            let views = self.views(at, |r| match (self.block.pose(r), &self.robots[r].rover) {
                (Some(pose), _) => Known::Fixed(pose),
                (None, Some(rover)) => Known::Hint(rover.pose_at(at), rover.covariance(&self.block)),
                (None, None) => Known::Nothing,
            });
            let naming = naming::name(&views, self.config.common_width_rad, self.config.naming_margin);
            self.take_names(&naming, &views, at);
            return;
        }
        // Nobody is placed: the first that stands and is tied to somebody carries the frame. Who is about to stand may be the one
        // that others see.
        let since_s = || self.robots.iter().filter_map(|(_, robot)| Some(at.seconds_since(robot.standing_since?)));
        if since_s().any(|s| s < SETTLED_S) && since_s().all(|s| s < STRAGGLERS_S) {
            return;
        }
        let mut roots: Vec<usize> = self.robots.numbers().filter(|&r| self.settled(r, at)).collect();
        roots.sort_by_key(|&r| self.robots[r].standing_since);
        if roots.len() > MAX_ROOTS {
            self.next_root = (self.next_root + MAX_ROOTS) % roots.len();
            roots.rotate_left(self.next_root);
            roots.truncate(MAX_ROOTS);
        }
        let remembered = self.gauge.is_some();
        self.ambiguous.clear();
        // Of remembered places the root's is believed: one that most others agree with.
        let mut best: Option<Rooted> = None;
        for root in roots {
            let (pose, covariance) = match (&self.robots[root].rover, remembered, self.anchor) {
                (Some(rover), true, _) => (rover.pose_at(at), rover.covariance(&self.block)),
                (None, true, _) => continue,
                (_, false, Some((anchor, pose))) if anchor == root => (pose, Matrix3::identity() * GAUGE_VAR),
                (_, false, Some(_)) => continue,
                (_, false, None) => (Pose2::IDENTITY, Matrix3::identity() * GAUGE_VAR),
            };
            let views = self.views(at, |r| if r == root { Known::Fixed(pose) } else { Known::Nothing });
            let views = naming::around(views, root);
            let naming = naming::name(&views, self.config.common_width_rad, self.config.naming_margin);
            if naming.placed.len() >= 2 {
                let agreeing = if remembered { self.agreeing(&naming, root, at) } else { 0 };
                if best.as_ref().is_none_or(|best| agreeing > best.agreeing) {
                    best = Some(Rooted { root, pose, covariance, naming, views, agreeing });
                }
                if !remembered || agreeing + 1 == self.robots.len() {
                    break;
                }
            } else if self.ambiguous.is_empty() {
                self.ambiguous.clone_from(&naming.ambiguous);
            }
        }
        if let Some(Rooted { root, pose, covariance, naming, views, .. }) = best {
            self.robots[root].rover = None;
            self.robots[root].unsure = false;
            self.block.insert(root, pose, &covariance);
            self.gauge = self.gauge.or(Some(root));
            self.take_names(&naming, &views, at);
        }
    }

    /// Looks at everything afresh from one member; whoever stands elsewhere than believed, again and again, is given up.
    pub(super) fn check_names(&mut self, at: Timestamp) {
        if self.block.members().len() < 2 || self.last_check.is_some_and(|t| at.seconds_since(t) < CHECK_INTERVAL_S) {
            return;
        }
        self.last_check = Some(at);
        let doubtful = self.block.members().iter().any(|&m| {
            self.robots[m].slots.iter().any(|s| {
                let fresh = at.seconds_since(s.last) < FRESH_S;
                (s.name.is_none() && fresh && s.count() >= 8) || (s.name.is_some() && !fresh)
            })
        });
        // A robot that has no place may be the one that is seen where another is said to stand.
        if !doubtful && self.strangers(at).next().is_none() {
            return;
        }
        let fresh_names = |m: usize| {
            let slots = self.robots[m].slots.iter();
            slots.filter(|s| s.name.is_some() && at.seconds_since(s.last) < FRESH_S).count()
        };
        let Some(root) = self.block.members().iter().copied().rev().max_by_key(|&m| fresh_names(m)) else { return };
        let Some(pose) = self.block.pose(root) else { return };
        let views = self.views(at, |r| if r == root { Known::Fixed(pose) } else { Known::Nothing });
        let naming = naming::name(&views, self.config.common_width_rad, self.config.naming_margin);
        let mut elsewhere = Vec::new();
        let mut checked = 0;
        for (robot, found) in &naming.placed {
            let (Some(believed), true) = (self.block.pose(*robot), *robot != root) else { continue };
            checked += 1;
            let cov = self.block.covariance(*robot, *robot).unwrap_or_else(Matrix3::zeros);
            let away_m = (found.position() - believed.position()).norm();
            let turned_rad = wrap(found.heading_rad - believed.heading_rad).abs();
            let moved = away_m > 0.1 + 5.0 * (cov[(0, 0)] + cov[(1, 1)]).sqrt()
                || turned_rad > 0.035 + 5.0 * cov[(2, 2)].sqrt();
            self.robots[*robot].contradictions = if moved { self.robots[*robot].contradictions + 1 } else { 0 };
            if self.robots[*robot].contradictions >= CONTRADICTIONS {
                elsewhere.push(*robot);
            }
        }
        for robot in naming.replaceable.into_iter().filter(|r| *r != root) {
            if !self.block.contains(robot) {
                continue;
            }
            self.robots[robot].contradictions += 1;
            if self.robots[robot].contradictions >= CONTRADICTIONS {
                self.depart(robot, at);
                self.robots[robot].rover = None;
                self.robots[robot].contradictions = 0;
            }
        }
        // If everybody seems to have moved, it was the one they were looked at from.
        if checked > 1 && elsewhere.len() == checked {
            elsewhere = vec![root];
        }
        for robot in elsewhere {
            self.depart(robot, at);
            self.robots[robot].rover = None;
            self.new_findings.push(Finding::Carried { robot });
            for r in self.robots.iter_mut() {
                r.contradictions = 0;
            }
        }
    }

    /// The joint solution; notes by how much it moved the members.
    pub(super) fn solve(&mut self, at: Timestamp) {
        let members = self.block.members().to_vec();
        if members.is_empty()
            || ((self.thrifty || members.len() > LARGE_BLOCK)
                && self.last_solve.is_some_and(|t| at.seconds_since(t) < LARGE_BLOCK_INTERVAL_S))
        {
            return;
        }
        self.last_solve = Some(at);
        let links = self.links();
        let before: Vec<Option<Pose2>> = members.iter().map(|&m| self.block.pose(m)).collect();
        self.block.solve(&links);
        let (_, dof) = self.block.chi2();
        if dof != self.fit.dof {
            let quantile = |p| protocol::estimate::chi2_quantile(p, dof);
            self.fit = Fit { dof, usual: quantile(0.95), utmost: quantile(1.0 - 1e-6) };
        }
        for (&m, old) in members.iter().zip(before) {
            let (Some(new), Some(old)) = (self.block.pose(m), old) else { continue };
            let shift = Vector3::new(new.x_m - old.x_m, new.y_m - old.y_m, wrap(new.heading_rad - old.heading_rad));
            if shift.amax() > 0.0 {
                self.changes.shifts.push((m, shift));
            }
        }
        for (m, shift) in &self.changes.shifts {
            for robot in self.robots.iter_mut() {
                if let Some(rover) = &mut robot.rover {
                    rover.shift(*m, shift);
                }
            }
        }
    }

    /// What the members see of each other.
    pub(super) fn links(&self) -> Vec<crate::calibration::block::Link> {
        let mut links = Vec::new();
        for &observer in self.block.members() {
            for slot in &self.robots[observer].slots {
                if let Some(peer) = slot.name.filter(|p| self.block.contains(*p)) {
                    links.push(self.link(observer, peer, &slot.mean()));
                }
            }
        }
        links
    }

    fn settled(&self, robot: usize, at: Timestamp) -> bool {
        self.robots[robot].standing_since.is_some_and(|t| at.seconds_since(t) >= SETTLED_S)
    }

    /// Slots that prove something now.
    pub(super) fn fresh_slots(&self, robot: usize, at: Timestamp) -> Vec<usize> {
        let slots = &self.robots[robot].slots;
        (0..slots.len())
            .filter(|&s| slots[s].count() >= LEAST_COUNT && at.seconds_since(slots[s].last) < FRESH_S)
            .collect()
    }

    pub(super) fn views(&self, at: Timestamp, known: impl Fn(usize) -> Known) -> Vec<View> {
        let standing = self.robots.numbers().filter(|&r| self.settled(r, at) || self.block.contains(r));
        standing
            .map(|robot| {
                let mean = |s: usize| self.with_floors(&self.robots[robot].slots[s].mean());
                let slots = self.fresh_slots(robot, at).into_iter().map(mean).collect();
                View { robot, slots, known: known(robot), doubt: self.robots[robot].doubt }
            })
            .collect()
    }

    pub(super) fn take_names(&mut self, naming: &Naming, views: &[View], at: Timestamp) {
        self.ambiguous.clone_from(&naming.ambiguous);
        for (robot, pose) in &naming.placed {
            if self.block.contains(*robot) {
                continue;
            }
            let mut covariance = Matrix3::from_diagonal(&Vector3::from(WEAK));
            let mut start = *pose;
            let agrees = self.stands_as_remembered(*robot, pose, at);
            let was_unsure = std::mem::take(&mut self.robots[*robot].unsure);
            if let Some(rover) = self.robots[*robot].rover.take() {
                if agrees {
                    // The sightings since it stands come with its slots. Twice, because its correlation with the standing ones is
                    // lost here.
                    let before = rover.before_it_stood();
                    covariance = 2.0 * before.covariance(&self.block);
                    if was_unsure {
                        covariance += remembered::nudged();
                    }
                    start = before.pose();
                } else if was_unsure {
                    self.moved.push(*robot);
                }
            }
            self.block.insert(*robot, start, &covariance);
        }
        for (view, names) in views.iter().zip(&naming.names) {
            let fresh = self.fresh_slots(view.robot, at);
            let slots = &mut self.robots[view.robot].slots;
            for (s, name) in fresh.into_iter().zip(names) {
                if name.is_some() && slots.iter().all(|slot| slot.name != *name) {
                    slots[s].name = *name;
                }
            }
        }
    }
}
