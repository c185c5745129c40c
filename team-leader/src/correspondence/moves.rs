//! Which changes of owners are tried.

use protocol::angle::difference;
use protocol::id::{TargetId, TrackId};

use super::memory::Memory;
use super::state::Context;
use super::window::{Change, Proposal, change_of};
use super::{Follower, PRESENT_S};

/// Frames in which a track must have been seen before it counts.
pub const LEAST_COUNT: u32 = 3;
/// Most changes made with one frame.
const MOST_CHANGES: usize = 3;
/// What it must gain, nats, that a track goes over to another target (of a robot that is sure of it, and that is not), that a
/// target takes one on that is nobody's, that it lets one go.
const CHANGE: f64 = 3.0;
const CHANGE_DOUBTFUL: f64 = 1.5;
/// By what part of it more, where the track was its owner's for so many frames beyond doubt: what a robot follows in one go for long
/// is one body.
const OF_LONG: f64 = 4.0 / 3.0;
const LONG: f64 = 20.0;
const ADOPT: f64 = 0.8;
const RELEASE: f64 = 1.5;
/// A change may be as recent as this, seconds.
const RECENT_S: f64 = 0.5;
/// What a track is worth to a target that was not there yet, nats.
const NOT_YET: f64 = -2.0;

impl Follower {
    /// Makes the changes of owners of the newest frame's tracks that explain the window better.
    pub(super) fn reconsider(&mut self, context: &Context<'_>) {
        for _ in 0..MOST_CHANGES {
            let Some(best) = self.best_change(context) else { return };
            self.accept(best, context);
        }
    }

    fn best_change(&self, context: &Context<'_>) -> Option<Proposal> {
        let newest = self.window.back()?;
        let robot = newest.seen.robot;
        let present: Vec<&Memory> = newest
            .seen
            .sights
            .iter()
            .filter_map(|s| self.memories.iter().find(|m| m.is(robot, s.track)))
            .filter(|m| m.count >= LEAST_COUNT && !m.peer)
            .collect();
        let mut best: Option<(f64, Proposal)> = None;
        let mut consider = |changes: Vec<Change>| {
            for from in self.starts(&changes, context) {
                let needed: f64 = changes.iter().map(|c| self.price(c, from)).sum();
                let proposal = self.evaluate(from, changes.clone(), None, context);
                let net = proposal.gain - needed;
                if net > best.as_ref().map_or(0.0, |(n, _)| *n) {
                    best = Some((net, proposal));
                }
            }
        };
        // Targets that a track may be.
        let near = |m: &Memory| {
            let bearing_rad = m.bearing_rad;
            self.targets.iter().filter(move |f| {
                let target = &f.state.target;
                let range_m = (target.position() - newest.seen.pose.position()).norm().max(0.3);
                let reach = 0.1 + (0.5 + 2.0 * target.sigma_m().min(1.0)) / range_m;
                difference(newest.seen.pose.bearing_to(target.position()), bearing_rad).abs() < reach
            })
        };
        for m in &present {
            for followed in near(m).filter(|f| m.bound != Some(f.id)) {
                let change = Change { robot, track: m.track, to: Some(followed.id) };
                let holders: Vec<&Memory> = self
                    .memories
                    .iter()
                    .filter(|o| o.robot == robot && o.bound == Some(followed.id) && o.track != m.track)
                    .collect();
                let released = |to: Option<TargetId>| -> Vec<Change> {
                    let mut changes = vec![change];
                    changes.extend(holders.iter().map(|o| Change { robot, track: o.track, to }));
                    changes
                };
                consider(released(None));
                if let [holder] = holders[..] {
                    if m.bound.is_some() {
                        consider(released(m.bound));
                    }
                    for free in near(holder).filter(|f| {
                        f.id != followed.id
                            && Some(f.id) != m.bound
                            && self.memories.iter().all(|o| o.robot != robot || o.bound != Some(f.id))
                    }) {
                        consider(released(Some(free.id)));
                    }
                }
            }
            if m.bound.is_some() {
                consider(vec![Change { robot, track: m.track, to: None }]);
            }
        }
        best.map(|(_, proposal)| proposal)
    }

    /// What a change from frame `from` on must gain at least, nats.
    pub(super) fn price(&self, change: &Change, from: usize) -> f64 {
        let memory = self.memories.iter().find(|m| m.is(change.robot, change.track));
        let Some(m) = memory else { return 0.0 };
        let unsure = || {
            let mut frames = self.window.iter().skip(from).filter(|k| k.seen.robot == change.robot);
            let sight = frames.find_map(|k| k.seen.sights.iter().find(|s| s.track == change.track));
            m.doubtful || sight.is_some_and(|s| s.doubtful || s.merged)
        };
        let of_long = 1.0 + OF_LONG * (f64::from(m.tenure) / LONG).min(1.0);
        match (m.bound, change.to) {
            (Some(_), Some(_)) if unsure() => CHANGE_DOUBTFUL * of_long,
            (Some(_), Some(_)) => CHANGE * of_long,
            (None, Some(_)) => ADOPT,
            (Some(_), None) => RELEASE,
            (None, None) => 0.0,
        }
    }

    /// Frames from which on the change may hold.
    fn starts(&self, changes: &[Change], context: &Context<'_>) -> Vec<usize> {
        let mut starts = Vec::new();
        for c in changes {
            starts.extend(self.first_seen(c.robot, c.track));
            starts.extend(self.last_unsure(c.robot, c.track));
        }
        starts.extend(self.turning_point(changes, context));
        starts.extend(self.window.iter().position(|k| self.newest.seconds_since(k.seen.at) < RECENT_S));
        starts.sort_unstable();
        starts.dedup();
        starts
    }

    /// The frame from which on the new owners explain the tracks better than the old ones, as the targets are now.
    fn turning_point(&self, changes: &[Change], context: &Context<'_>) -> Option<usize> {
        let robot = changes.first()?.robot;
        let worth = |id: Option<TargetId>, i: usize, sight: &super::Sight| {
            let Some(f) = id.and_then(|id| self.targets.iter().find(|f| f.id == id)) else { return 0.0 };
            f.before(&self.window, i).map_or(NOT_YET, |state| state.worth(&self.window[i].seen, sight, context))
        };
        let (mut sum, mut best) = (0.0, (0.0, None));
        for (i, kept) in self.window.iter().enumerate().rev().filter(|(_, k)| k.seen.robot == robot) {
            for (sight, owner) in kept.seen.sights.iter().zip(&kept.owners) {
                if let Some(c) = change_of(changes, robot, sight.track) {
                    sum += worth(c.to, i, sight) - worth(*owner, i, sight);
                }
            }
            if sum > best.0 {
                best = (sum, Some(i));
            }
        }
        best.1
    }

    /// Tracks of a target that are present.
    pub(super) fn present_tracks(&self, id: TargetId) -> Vec<(usize, TrackId)> {
        let present = |m: &&Memory| m.bound == Some(id) && self.newest.seconds_since(m.last) < PRESENT_S;
        self.memories.iter().filter(present).map(|m| (m.robot, m.track)).collect()
    }
}
