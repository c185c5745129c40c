//! What does not fit together, and whose fault it is.
//!
//! A robot whose marker is not as it announces is seen at wrong distances by all others while its own distances are right: it
//! cannot be named by pairs of equal distance. So who is left without a place is tried again without the distances that the
//! others measure to it, and without its own. The trial that places it where every sighting agrees tells what is wrong.
//! Among placed robots, the one without which the rest fits is at fault.

use std::collections::BTreeSet;

use protocol::time::Timestamp;

use super::{Calibrator, Changes, FRESH_S};
use crate::calibration::kernel;
use crate::calibration::naming::{self, Doubt, Known, Naming, View};

/// How long a robot must stand without a place before what it announces is doubted, seconds.
const PATIENCE_S: f64 = 2.5;
/// Between looks at what does not fit, seconds.
const INTERVAL_S: f64 = 1.0;
/// Robots examined at a time.
const MAX_SUSPECTS: usize = 4;
/// Findings kept.
const MAX_FINDINGS: usize = 64;
/// How often in a row a robot must be the one at fault.
const PERSISTENT: u32 = 3;
/// χ² per degree of freedom that a trial may have, and sizes closer to one than this are no fault of the marker.
const FIT: f64 = 4.0;
const LEAST_RATIO: f64 = 0.03;
/// Sigmas by which two robots' distances of each other differ where one is surely wrong.
const PAIR_SIGMAS: f64 = 6.0;
/// Sightings of a slot before it accuses somebody.
const LEAST_COUNT: u32 = 10;
/// Looks at its own name, no more than so many seconds apart, after which a robot's name is not believed.
const OWN_NAME_LOOKS: u32 = 3;
const OWN_NAME_S: f64 = 2.0;
/// Chance that a solution without faults looks worse.
const UNUSUAL: f64 = 0.999;

/// Something that is wrong with a robot. Robots by their numbers.
#[derive(Debug, Clone, PartialEq)]
pub enum Finding {
    /// Its marker is not as it announces.
    Size {
        /// Whose.
        robot: usize,
        /// Everybody sees it so many times as thick.
        ratio: f64,
    },
    /// Its camera is not as it announces.
    Ranges {
        /// Whose.
        robot: usize,
        /// It measures so many times the distances.
        ratio: f64,
    },
    /// Two robots measure their distance differently, and nobody tells which is right.
    Pair {
        /// One.
        a: usize,
        /// The other.
        b: usize,
        /// As the one measures it, and the other.
        ranges_m: [f64; 2],
    },
    /// What it sees or how it is seen contradicts the rest.
    Contradicts {
        /// Which.
        robot: usize,
    },
    /// A robot sees its own name on another.
    OwnName {
        /// Which.
        observer: usize,
    },
    /// It stands elsewhere without having said that it moved.
    Carried {
        /// Which.
        robot: usize,
    },
}

impl Finding {
    fn is_like(&self, other: &Self) -> bool {
        std::mem::discriminant(self) == std::mem::discriminant(other) && self.robots() == other.robots()
    }

    /// Whom it concerns.
    pub fn robots(&self) -> Vec<usize> {
        match self {
            Self::Size { robot, .. }
            | Self::Ranges { robot, .. }
            | Self::Contradicts { robot }
            | Self::Carried { robot } => vec![*robot],
            Self::Pair { a, b, .. } => vec![*a, *b],
            Self::OwnName { observer } => vec![*observer],
        }
    }
}

impl Calibrator {
    /// What is wrong at present.
    pub fn findings(&self) -> &[Finding] {
        &self.findings
    }

    /// Findings that are new since the last call.
    pub fn take_new_findings(&mut self) -> Vec<Finding> {
        std::mem::take(&mut self.new_findings)
    }

    /// Whether something that a robot announces or sees is not believed.
    pub fn is_set_aside(&self, robot: usize) -> bool {
        self.robots.get(robot).is_some_and(|r| r.doubt.is_some() || r.aside > 1.0)
    }

    /// Whether what a robot sees can be verified: at least three others see each other, so that a lie of this one contradicts
    /// more than it agrees with.
    pub fn is_verifiable(&self, robot: usize) -> bool {
        self.verifiable.contains(&robot)
    }

    fn find_verifiable(&mut self) {
        let sees: BTreeSet<(usize, usize)> = self.links().iter().map(|link| (link.observer, link.peer)).collect();
        let mutual = |a: usize, b: usize| sees.contains(&(a, b)) && sees.contains(&(b, a));
        let members = self.block.members();
        let without = |robot: usize| {
            let mut pairs = sees.iter().filter(|(a, b)| a < b && *a != robot && *b != robot && mutual(*a, *b));
            pairs.any(|(a, b)| members.iter().any(|&c| c > *b && c != robot && mutual(*a, c) && mutual(*b, c)))
        };
        self.verifiable = members.iter().copied().filter(|&robot| without(robot)).collect();
    }

    pub(super) fn find(&mut self, finding: Finding) {
        if let Some(known) = self.findings.iter_mut().find(|f| f.is_like(&finding)) {
            *known = finding;
        } else if self.findings.len() < MAX_FINDINGS {
            self.new_findings.push(finding.clone());
            self.findings.push(finding);
        }
    }

    /// A name that a robot reads on another and that is its own means nothing. Who reads it again and again, and has not just misread
    /// once, shows that it is not to be believed of anybody.
    pub(super) fn believed_name(&mut self, observer: usize, told: Option<usize>, at: Timestamp) -> Option<usize> {
        let told = told?;
        if told != observer {
            return (!self.is_misnamed(told)).then_some(told);
        }
        let (looks, last) = self.own_names.entry(told).or_insert((0, at));
        let goes_on = *looks >= OWN_NAME_LOOKS || at.seconds_since(*last).abs() < OWN_NAME_S;
        *looks = if goes_on { looks.saturating_add(1) } else { 1 };
        *last = at;
        if *looks == OWN_NAME_LOOKS {
            self.find(Finding::OwnName { observer });
            for robot in self.robots.iter_mut() {
                for slot in robot.slots.iter_mut().filter(|s| s.told == Some(told)) {
                    slot.told = None;
                }
            }
        }
        None
    }

    fn is_misnamed(&self, robot: usize) -> bool {
        self.own_names.get(&robot).is_some_and(|(looks, _)| *looks >= OWN_NAME_LOOKS)
    }

    /// Looks for what does not fit.
    pub(super) fn watch(&mut self, at: Timestamp) {
        if self.last_watch.is_some_and(|t| at.seconds_since(t) < INTERVAL_S) {
            return;
        }
        self.last_watch = Some(at);
        self.find_verifiable();
        let (chi2, dof) = self.block.chi2();
        let over = !self.block.members().is_empty() && dof == self.fit.dof && chi2 < self.fit.usual;
        self.findings.retain(|f| !(over && matches!(f, Finding::Pair { .. })));
        let stands = |r: usize| self.robots[r].standing_since.is_some_and(|t| at.seconds_since(t) > PATIENCE_S);
        let strangers: Vec<usize> =
            self.robots.numbers().filter(|&r| stands(r) && !self.block.contains(r)).take(MAX_SUSPECTS).collect();
        if self.block.members().is_empty() {
            self.find_pairs(&strangers, at);
        }
        if self.block.members().len() >= 2 {
            strangers.into_iter().for_each(|robot| self.doubt(robot, at));
        }
        self.find_culprit();
    }

    /// Two robots that only see each other, at two distances.
    fn find_pairs(&mut self, strangers: &[usize], at: Timestamp) {
        let [a, b] = strangers else { return };
        let sees = |r: usize| {
            let slots: Vec<_> = self.robots[r].slots.iter().filter(|s| at.seconds_since(s.last) < FRESH_S).collect();
            match slots[..] {
                [slot] if slot.count() >= LEAST_COUNT => self.with_floors(&slot.mean()).width_rad,
                _ => None,
            }
        };
        let (Some((one, one_var)), Some((other, other_var))) = (sees(*a), sees(*b)) else { return };
        if (one - other).abs() > PAIR_SIGMAS * (one_var + other_var).sqrt() {
            let ranges_m = [kernel::range(one), kernel::range(other)];
            self.find(Finding::Pair { a: *a, b: *b, ranges_m });
        }
    }

    /// Tries to place a robot without the distances to it, and without its own.
    fn doubt(&mut self, robot: usize, at: Timestamp) {
        if self.robots[robot].doubt.is_some() {
            return;
        }
        let mut trials: Vec<(f64, Doubt, Naming, Vec<View>)> = Vec::new();
        for doubt in [Doubt::Size, Doubt::Ranges] {
            let mut views = self.views(at, |r| self.block.pose(r).map_or(Known::Nothing, Known::Fixed));
            views.retain(|v| v.robot == robot || !matches!(v.known, Known::Nothing));
            let Some(me) = views.iter().position(|v| v.robot == robot) else { return };
            views[me].doubt = Some(doubt);
            let naming = naming::name(&views, self.config.common_width_rad, self.config.naming_margin);
            let seen_by = naming.names.iter().flatten().filter(|n| **n == Some(robot)).count();
            let sees = naming.names.get(me).map_or(0, |n| n.iter().flatten().count());
            let whole = sees >= 2 && seen_by >= 2 && naming.placed.iter().any(|(r, _)| *r == robot);
            // Bearings both ways and half of the distances, less the pose.
            let dof = (3 * seen_by.min(sees)).saturating_sub(3).max(1);
            if whole && naming.fits[me] < FIT * dof as f64 {
                trials.push((naming.cost, doubt, naming, views));
            }
        }
        trials.sort_by(|a, b| a.0.total_cmp(&b.0));
        let clear = trials.len() < 2 || trials[1].0 > trials[0].0 + self.config.naming_margin;
        let Some((_, doubt, naming, views)) = trials.into_iter().next().filter(|_| clear) else { return };
        self.robots[robot].doubt = Some(doubt);
        self.take_names(&naming, &views, at);
        if let Some(ratio) = self.ratio(robot, doubt) {
            self.find(if (ratio - 1.0).abs() < LEAST_RATIO {
                Finding::Contradicts { robot }
            } else if doubt == Doubt::Size {
                Finding::Size { robot, ratio }
            } else {
                Finding::Ranges { robot, ratio }
            });
        }
    }

    /// By how much a robot looks too thick, or measures too far.
    fn ratio(&self, robot: usize, doubt: Doubt) -> Option<f64> {
        let mut ratios = Vec::new();
        for &observer in self.block.members() {
            for slot in &self.robots[observer].slots {
                let Some(peer) = slot.name else { continue };
                let concerned = if doubt == Doubt::Size { peer == robot } else { observer == robot };
                let (Some(p), Some(q), Some((width, _))) =
                    (self.block.pose(observer), self.block.pose(peer), slot.mean().width_rad)
                else {
                    continue;
                };
                if concerned {
                    let ratio = (p.position() - q.position()).norm() / kernel::range(width);
                    ratios.push(if doubt == Doubt::Size { ratio } else { ratio.recip() });
                }
            }
        }
        (!ratios.is_empty()).then(|| ratios.iter().sum::<f64>() / ratios.len() as f64)
    }

    /// Where the placed robots do not fit: the one without which the rest does.
    fn find_culprit(&mut self) {
        let (chi2, dof) = self.block.chi2();
        if dof == 0 || dof != self.fit.dof || chi2 <= self.fit.utmost {
            return;
        }
        let links = self.links();
        let mut shares: Vec<(f64, usize)> = self.block.members().iter().map(|&m| (0.0, m)).collect();
        for link in &links {
            let Some((bearing2, width2)) = self.block.residual2(link) else { continue };
            for (share, m) in &mut shares {
                if *m == link.observer || *m == link.peer {
                    *share += bearing2 + width2.unwrap_or(0.0);
                }
            }
        }
        shares.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut best: Option<(f64, usize, f64)> = None;
        for &(_, suspect) in shares.iter().take(MAX_SUSPECTS) {
            let rest: Vec<_> = links.iter().filter(|l| l.observer != suspect && l.peer != suspect).copied().collect();
            if rest.is_empty() {
                continue;
            }
            let mut without = self.block.clone();
            without.solve(&rest);
            let scalars: usize = rest.iter().map(|l| 1 + usize::from(l.width_rad.is_some())).sum();
            let left = scalars.saturating_sub(3 * self.block.members().len().saturating_sub(2));
            if left == 0 || !without.converged() {
                continue;
            }
            let fits = without.chi2().0 / protocol::estimate::chi2_quantile(UNUSUAL, left);
            let blame = (chi2 - without.chi2().0) / (dof - left).max(1) as f64;
            if fits < 1.0 && best.is_none_or(|(b, ..)| fits < b) {
                best = Some((fits, suspect, blame));
            }
        }
        match best {
            Some((_, robot, blame)) => {
                self.robots[robot].blamed += 1;
                if self.robots[robot].blamed >= PERSISTENT {
                    self.robots[robot].blamed = 0;
                    self.robots[robot].aside *= blame.clamp(2.0, 1e4);
                    self.find(Finding::Contradicts { robot });
                }
            }
            None => {
                let worst = shares.first().map(|s| s.1).unwrap_or_default();
                let of_worst = links.iter().filter(|l| l.observer == worst || l.peer == worst);
                let pair = of_worst.max_by(|a, b| {
                    let size = |l| self.block.residual2(l).map_or(0.0, |(x, y)| x + y.unwrap_or(0.0));
                    size(a).total_cmp(&size(b))
                });
                if let Some(link) = pair {
                    let (a, b) = (link.observer.min(link.peer), link.observer.max(link.peer));
                    let of = |from: usize, to: usize| {
                        let link = links.iter().find(|l| l.observer == from && l.peer == to);
                        link.and_then(|l| l.width_rad).map_or(f64::NAN, |(w, _)| kernel::range(w))
                    };
                    self.find(Finding::Pair { a, b, ranges_m: [of(a, b), of(b, a)] });
                }
            }
        }
    }

    /// The robot's program has begun anew, maybe with another configuration: what it announced before is no reason to doubt it.
    pub fn new_session(&mut self, robot: usize, at: Timestamp) -> Changes {
        self.changes = Changes::default();
        if self.robots.get(robot).is_some_and(|r| r.doubt.is_some()) {
            // Its distances were measured by what it announced before.
            self.depart(robot, at);
            self.robots[robot].doubt = None;
        }
        self.own_names.remove(&robot);
        self.findings.retain(|finding| match finding {
            Finding::Size { .. } | Finding::Ranges { .. } | Finding::OwnName { .. } => finding.robots() != [robot],
            _ => true,
        });
        std::mem::take(&mut self.changes)
    }

    /// The robot is gone from its place: what was found of its sightings is over, what it announces stays in doubt.
    pub(super) fn absolve(&mut self, robot: usize) {
        self.robots[robot].aside = 1.0;
        self.robots[robot].blamed = 0;
        self.findings.retain(|f| *f != Finding::Contradicts { robot });
    }
}
