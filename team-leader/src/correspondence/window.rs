//! The last seconds, kept so that they can be explained anew.
//!
//! Problem: where two people stand together a robot may take one for the other. The frame in which it happens does not tell.
//! The frames after it do, but by then a filter that believed it is somewhere between the two.
//!
//! Insight: frames are kept for some seconds with the owner of each track in them, and every target keeps its state before each
//! of them. A change of owners is tried from where it may have happened on: the targets concerned are filtered again over the
//! frames since, and their scores say whether the change explains them better.

use std::collections::VecDeque;

use protocol::id::{TargetId, TrackId};

use super::state::{Context, Seen, State};
use super::{Followed, Follower};
use crate::calibration::systematic::SettledFrame;

/// How long frames are kept, seconds, and how many at most.
const WINDOW_S: f64 = 3.0;
const MAX_WINDOW: usize = 600;

/// A frame, and whose each of its sights is.
#[derive(Debug, Clone)]
pub struct Kept {
    /// What was seen.
    pub seen: Seen,
    /// Whose each sight is.
    pub owners: Vec<Option<TargetId>>,
}

impl Kept {
    /// The sights that show one body alone, with their owners.
    fn settled(&self) -> SettledFrame {
        let owned = self.seen.sights.iter().zip(&self.owners).filter(|(s, _)| !s.merged && !s.doubtful);
        let bearings = owned.filter_map(|(s, owner)| Some(((*owner)?, s.bearing_rad, s.sigma_rad))).collect();
        SettledFrame { robot: self.seen.robot, at: self.seen.at, bearings }
    }

    fn owned(&self, id: TargetId, changes: &[Change]) -> Option<usize> {
        (0..self.owners.len()).find(|&k| {
            let track = self.seen.sights[k].track;
            change_of(changes, self.seen.robot, track).map_or(self.owners[k], |c| c.to) == Some(id)
        })
    }
}

/// From some frame on, a track is another's.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Change {
    /// Whose track.
    pub robot: usize,
    /// Which.
    pub track: TrackId,
    /// Whose it is.
    pub to: Option<TargetId>,
}

/// What becomes of a track.
pub fn change_of(changes: &[Change], robot: usize, track: TrackId) -> Option<&Change> {
    changes.iter().find(|c| c.robot == robot && c.track == track)
}

/// A change of owners, worked out.
#[derive(Debug, Clone)]
pub struct Proposal {
    /// First frame of the window in which it holds.
    pub from: usize,
    /// What changes.
    pub changes: Vec<Change>,
    /// By how much the frames since are explained better, nats.
    pub gain: f64,
    /// How the targets concerned would end.
    ends: Vec<(TargetId, State)>,
}

impl Proposal {
    /// How a target would end.
    pub fn last_state(&self, id: TargetId) -> Option<&State> {
        self.ends.iter().find(|(r, _)| *r == id).map(|(_, state)| state)
    }
}

impl Followed {
    /// Index in the window of the first frame before which its state is kept.
    fn first(&self, window: &VecDeque<Kept>) -> usize {
        window.len().saturating_sub(self.trail.len())
    }

    /// Its state before frame `i` of the window.
    pub(super) fn before(&self, window: &VecDeque<Kept>, i: usize) -> Option<&State> {
        self.trail.get(i.checked_sub(self.first(window))?)
    }

    /// How it would end if these changes were made from frame `from` on; `pass` sees its state before each frame.
    fn rerun(
        &self,
        window: &VecDeque<Kept>,
        from: usize,
        changes: &[Change],
        context: &Context<'_>,
        mut pass: impl FnMut(&State),
    ) -> State {
        let first = self.first(window);
        let from = from.max(first);
        let mut state = self.trail.get(from - first).unwrap_or(&self.state).clone();
        for kept in window.range(from..) {
            pass(&state);
            let sight = kept.owned(self.id, changes).map(|k| &kept.seen.sights[k]);
            state.take(&kept.seen, sight, &self.looks, context);
        }
        state
    }
}

impl Follower {
    /// What these changes from frame `from` on would gain.
    pub(super) fn evaluate(
        &self,
        from: usize,
        changes: Vec<Change>,
        newborn: Option<&Followed>,
        context: &Context<'_>,
    ) -> Proposal {
        let mut affected: Vec<TargetId> = changes.iter().filter_map(|c| c.to).collect();
        for kept in self.window.iter().skip(from) {
            for (sight, owner) in kept.seen.sights.iter().zip(&kept.owners) {
                let hit = change_of(&changes, kept.seen.robot, sight.track);
                affected.extend(owner.filter(|_| hit.is_some()));
            }
        }
        affected.sort_unstable();
        affected.dedup();
        let mut gain = 0.0;
        let mut ends = Vec::with_capacity(affected.len());
        for followed in self.targets.iter().chain(newborn).filter(|f| affected.contains(&f.id)) {
            let end = followed.rerun(&self.window, from, &changes, context, |_| {});
            gain += end.score - followed.state.score;
            ends.push((followed.id, end));
        }
        Proposal { from, changes, gain, ends }
    }

    /// Makes a change; a newborn target must be among the targets already.
    pub(super) fn accept(&mut self, proposal: Proposal, context: &Context<'_>) {
        let Proposal { from, changes, ends, .. } = proposal;
        for (id, end) in ends {
            let Some(k) = self.targets.iter().position(|f| f.id == id) else { continue };
            let mut states = Vec::with_capacity(self.window.len());
            self.targets[k].rerun(&self.window, from, &changes, context, |state| states.push(state.clone()));
            let followed = &mut self.targets[k];
            followed.state = end;
            followed.trail.truncate(followed.trail.len().saturating_sub(states.len()));
            followed.trail.extend(states);
            debug_assert!(followed.trail.len() <= self.window.len());
        }
        for kept in self.window.iter_mut().skip(from) {
            for (sight, owner) in kept.seen.sights.iter().zip(&mut kept.owners) {
                if let Some(c) = change_of(&changes, kept.seen.robot, sight.track) {
                    *owner = c.to;
                }
            }
        }
        for change in &changes {
            if let Some(m) = self.memories.iter_mut().find(|m| m.is(change.robot, change.track)) {
                m.bind(change.to);
            }
        }
    }

    /// Takes a frame in: every target goes on by it.
    pub(super) fn keep(&mut self, kept: Kept, context: &Context<'_>) {
        for followed in &mut self.targets {
            followed.trail.push_back(followed.state.clone());
            let sight = kept.owned(followed.id, &[]).map(|k| &kept.seen.sights[k]);
            followed.state.take(&kept.seen, sight, &followed.looks, context);
        }
        self.window.push_back(kept);
        let newest = self.newest;
        let old = |k: &Kept| newest.seconds_since(k.seen.at) > WINDOW_S;
        while self.window.len() > MAX_WINDOW || self.window.front().is_some_and(old) {
            self.settle_first();
        }
    }

    /// The oldest frame is settled: what it tells of looks is learnt.
    fn settle_first(&mut self) {
        let window = self.window.len();
        let Some(kept) = self.window.pop_front() else { return };
        for followed in &mut self.targets {
            if followed.trail.len() == window {
                followed.trail.pop_front();
            }
        }
        if self.settled.len() < MAX_WINDOW {
            self.settled.push(kept.settled());
        }
        for (sight, owner) in kept.seen.sights.iter().zip(&kept.owners).filter(|(sight, _)| !sight.doubtful) {
            let Some(followed) = self.targets.iter_mut().find(|f| Some(f.id) == *owner) else { continue };
            if let Some(appearance) = &sight.appearance {
                followed.looks.see(kept.seen.robot, appearance);
            }
            // As its state was just after the frame.
            let state = followed.trail.front().unwrap_or(&followed.state);
            if let Some((top, _)) = state.top_of(&kept.seen, sight) {
                followed.looks.see_top(top);
            }
        }
    }

    /// All frames are settled: nothing of the past is explained anew.
    pub(super) fn settle(&mut self) {
        while !self.window.is_empty() {
            self.settle_first();
        }
    }

    /// Index of the first frame of the window in which the track was seen.
    pub(super) fn first_seen(&self, robot: usize, track: TrackId) -> Option<usize> {
        self.window.iter().position(|k| k.seen.robot == robot && k.seen.sights.iter().any(|s| s.track == track))
    }

    /// Index of the first frame of the last time in the window in which the track was with others.
    pub(super) fn last_unsure(&self, robot: usize, track: TrackId) -> Option<usize> {
        let mut start = None;
        for (i, kept) in self.window.iter().enumerate().rev().filter(|(_, k)| k.seen.robot == robot) {
            let Some(sight) = kept.seen.sights.iter().find(|s| s.track == track) else { continue };
            match (sight.doubtful || sight.merged, start) {
                (true, _) => start = Some(i),
                (false, Some(_)) => break,
                (false, None) => {}
            }
        }
        start
    }
}
