//! The best explanation of all tracks: new targets, and old ones that other tracks explain better.
//!
//! Problem: of n people two robots make up to n² crossings of rays, n of which are real, and some tracks are nobody.
//!
//! Insight: the tracks are shared out once for all of them. A candidate (tracks of two robots, and of every further robot
//! whose ray passes there) is weighed against its tracks being clutter ([`super::explanation`]); the set of candidates that
//! share no track and weigh most together explains the pictures best. So a ghost may look as good as a person by itself: it
//! takes away the tracks of two. Candidates that are targets already are in the set with a bonus. A new one that stays in it
//! over frames, clearly ahead of the best set without it, becomes a target if the window is explained better with it, also
//! where it takes tracks from others ([`super::window`]); whose number it gets says [`super::identity`].

mod packing;

use nalgebra::Vector2;
use protocol::angle::wrap;
use protocol::frames::Pose2;
use protocol::id::{TargetId, TrackId};
use protocol::time::Timestamp;

use super::explanation::{Explanation, RANGE_WORTH};
use super::identity::{Looks, Past};
use super::memory::Memory;
use super::moves::LEAST_COUNT;
use super::state::{Context, SURE_RANGE_M, State};
use super::window::{Change, Proposal};
use super::{Followed, Follower, Frame, MAX_TARGETS, PRESENT_S, Sight};
use crate::calibration::live::Calibrator;
use crate::stereo::tails::log_student;
use crate::stereo::target::Target;

/// Nobody stands inside a robot, metres from its axis.
const ROBOT_M: f64 = 0.3;
/// A robot that left its place leaves a false change there, for so long (s) and so near (m).
const VACATED: (f64, f64) = (15.0, 0.45);
/// A further robot's ray passes within so many squared sigmas.
const THIRD_GATE: f64 = 12.0;
/// What it says that a further robot sees nothing.
const UNSEEN: f64 = -1.2;
/// Frames of evidence, and the lead over the best set without it that is needed with so many.
const EVIDENCE: [(u32, f64); 3] = [(5, 1.5), (10, 0.75), (20, 0.25)];
/// Frames over which a candidate's weight is averaged.
const MEAN_OVER: u32 = 20;
/// What it is worth that the tracks are one target's already, nats.
const STANDING_WORTH: f64 = 3.0;
/// A new target may have begun so short a time ago, seconds.
const RECENT_S: f64 = 0.6;
/// What a new target must gain, nats.
const BIRTH: f64 = 9.0;
/// The same where somebody was lost of late: so long ago (seconds) and so near (metres, and metres more a second, for so many
/// seconds). He is still about, so less has to speak for him than for one whom nobody knows.
const BIRTH_AGAIN: f64 = 3.0;
const MISSED_S: f64 = 12.0;
const MISSED_M: (f64, f64, f64) = (0.8, 1.0, 4.0);
/// What it says for one who lost most of his tracks to a new target that he is it, nats.
const CONTINUED: f64 = 3.0;
/// Most candidates, and most loose tracks of other robots that one frame is paired with.
const MAX_CANDIDATES: usize = 512;
const MAX_OTHERS: usize = 64;
/// A robot's track.
type Key = (usize, TrackId);

/// Tracks that may be one object, with the evidence so far.
#[derive(Debug, Clone)]
pub struct Candidate {
    /// The two whose rays were crossed.
    pair: [Key; 2],
    /// These, and those of further robots that pass there, as of the last frame.
    tracks: Vec<Key>,
    position: Vector2<f64>,
    mean: f64,
    count: u32,
    last: Timestamp,
}

impl Candidate {
    /// Whether a track of the robot is in it.
    pub fn concerns(&self, robot: usize) -> bool {
        self.tracks.iter().any(|(r, _)| *r == robot)
    }

    /// Whether a track is in both: only one of them can be somebody.
    fn shares(&self, other: &Self) -> bool {
        self.tracks.iter().any(|track| other.tracks.contains(track))
    }

    fn has_tracks_of(&self, other: &Self) -> bool {
        self.tracks.len() == other.tracks.len() && other.tracks.iter().all(|track| self.tracks.contains(track))
    }
}

/// A candidate as one frame shows it.
struct Weighed {
    log_ratio: f64,
    position: Vector2<f64>,
    tracks: Vec<Key>,
}

impl Follower {
    /// Gathers evidence for the loose tracks of this frame, and makes targets of the clear ones.
    pub(super) fn give_birth(&mut self, frame: &Frame<'_>, sights: &[Sight], context: &Context<'_>) {
        let calibrator = context.calibrator;
        let loose = |m: &&Memory| !m.peer && m.count >= LEAST_COUNT;
        let mine: Vec<Memory> = sights
            .iter()
            .filter_map(|s| self.memories.iter().find(|m| m.is(frame.robot, s.track)))
            .filter(loose)
            .cloned()
            .collect();
        let newest = self.newest;
        self.candidates.retain(|c| newest.seconds_since(c.last) < 2.0 * PRESENT_S);
        if mine.is_empty() {
            return;
        }
        let others: Vec<(Memory, Pose2)> = self
            .memories
            .iter()
            .filter(|m| m.robot != frame.robot && frame.at.seconds_since(m.last).abs() < PRESENT_S)
            .filter(loose)
            .filter_map(|m| Some((m.clone(), calibrator.station(m.robot)?)))
            .take(MAX_OTHERS)
            .collect();
        for a in &mine {
            for (b, pose_b) in &others {
                let weighed = self.weigh_pair(frame, (a, &frame.pose), (b, pose_b), &others, &mine, calibrator);
                self.gather([(a.robot, a.track), (b.robot, b.track)], weighed, frame.at);
            }
        }
        let mut placed = Vec::new();
        for tracks in self.clear_candidates() {
            placed.extend(self.make_target(&tracks, &placed, context));
        }
    }

    /// Where the rays of two tracks cross, who else looks there, and how much speaks for it. `None`: nobody can be there.
    fn weigh_pair(
        &self,
        frame: &Frame<'_>,
        (a, pose_a): (&Memory, &Pose2),
        (b, pose_b): (&Memory, &Pose2),
        others: &[(Memory, Pose2)],
        mine: &[Memory],
        calibrator: &Calibrator,
    ) -> Option<Weighed> {
        let explained = self.explain(&[(a, *pose_a), (b, *pose_b)], frame.at)?;
        let position = explained.position;
        let in_robot = calibrator.poses(frame.at).any(|(_, p)| (p.position() - position).norm() < ROBOT_M);
        let ghost_of_robot = self.vacated.iter().any(|(p, _)| (p - position).norm() < VACATED.1);
        if in_robot || ghost_of_robot {
            return None;
        }
        let mut log_ratio = explained.log_ratio;
        let mut tracks = vec![(a.robot, a.track), (b.robot, b.track)];
        for (robot, pose) in calibrator.stations().filter(|(r, _)| *r != a.robot && *r != b.robot) {
            let seen = others.iter().map(|(m, _)| m).chain(mine).filter(|m| m.robot == robot);
            let (nats, track) = self.third_opinion(frame.at, robot, &pose, &explained, seen);
            log_ratio += nats;
            tracks.extend(track.map(|t| (robot, t)));
        }
        Some(Weighed { log_ratio, position, tracks })
    }

    /// What a further robot says, and by which loose track.
    fn third_opinion<'a>(
        &self,
        at: Timestamp,
        robot: usize,
        pose: &Pose2,
        explained: &Explanation,
        loose: impl Iterator<Item = &'a Memory>,
    ) -> (f64, Option<TrackId>) {
        let away = explained.position - pose.position();
        let (bearing, range_m) = (pose.bearing_to(explained.position), away.norm().max(ROBOT_M));
        let across = Vector2::new(-away.y, away.x) / range_m;
        let spread_var = across.dot(&(explained.covariance * across));
        let best = loose
            .filter_map(|m| {
                let var = m.sigma_rad.powi(2) + (spread_var + self.config.axis_sway_m.powi(2)) / range_m.powi(2);
                let seen_at = m.bearing_at(at);
                let d2 = wrap(seen_at - bearing).powi(2) / var;
                let nats = log_student(d2, var) - self.clutter(robot, pose, seen_at, at, None).ln() + RANGE_WORTH
                    - 0.5 * m.cue.cost(range_m);
                (d2 < THIRD_GATE).then_some((nats, m.track))
            })
            .max_by(|x, y| x.0.total_cmp(&y.0));
        if let Some((nats, track)) = best.filter(|(nats, _)| *nats > 0.0) {
            return (nats, Some(track));
        }
        let mut recent = self.memories.iter().filter(|m| m.robot == robot && at.seconds_since(m.last) < PRESENT_S);
        let covered = recent.any(|m| wrap(m.bearing_at(at) - bearing).abs() < m.half_width_rad + 0.15 / range_m);
        let blind = covered || range_m > SURE_RANGE_M || !self.watches(robot, at);
        (if blind { 0.0 } else { UNSEEN }, None)
    }

    /// Whether the robot follows anything at present: one that has just stopped sees nobody yet.
    pub(super) fn watches(&self, robot: usize, at: Timestamp) -> bool {
        self.memories.iter().any(|m| m.robot == robot && at.seconds_since(m.last) < PRESENT_S)
    }

    fn gather(&mut self, pair: [Key; 2], weighed: Option<Weighed>, at: Timestamp) {
        let reversed = [pair[1], pair[0]];
        let found = self.candidates.iter().position(|c| c.pair == pair || c.pair == reversed);
        let Some(weighed) = weighed else {
            if let Some(k) = found {
                self.candidates.swap_remove(k);
            }
            return;
        };
        match found {
            Some(k) => {
                let c = &mut self.candidates[k];
                c.count += 1;
                c.mean += (weighed.log_ratio - c.mean) / f64::from(c.count.min(MEAN_OVER));
                (c.tracks, c.position, c.last) = (weighed.tracks, weighed.position, at);
            }
            None => {
                let (mean, tracks, position) = (weighed.log_ratio, weighed.tracks, weighed.position);
                let new = Candidate { pair, tracks, position, mean, count: 1, last: at };
                if self.candidates.len() < MAX_CANDIDATES {
                    self.candidates.push(new);
                } else if let Some(least) = self.candidates.iter_mut().min_by(|a, b| a.mean.total_cmp(&b.mean))
                    && least.mean < new.mean
                {
                    *least = new;
                }
            }
        }
    }

    /// Tracks of the candidates that belong to the best explanation of all tracks, clearly, and are not targets yet.
    fn clear_candidates(&self) -> Vec<Vec<Key>> {
        let standing: Vec<bool> = self.candidates.iter().map(|c| self.stands(c)).collect();
        let worth = |k: usize| self.candidates[k].mean + if standing[k] { STANDING_WORTH } else { 0.0 };
        let mut hopeful: Vec<usize> = (0..self.candidates.len()).filter(|k| worth(*k) > 0.0).collect();
        if hopeful.iter().all(|k| standing[*k]) {
            return Vec::new();
        }
        hopeful.sort_by(|x, y| worth(*y).total_cmp(&worth(*x)));
        let mut hopeful = self.contested(&hopeful, &standing);
        hopeful.truncate(packing::MOST);
        let of = |x: usize| &self.candidates[hopeful[x]];
        let weights: Vec<f64> = hopeful.iter().map(|k| worth(*k)).collect();
        let shares = |x: usize, y: usize| of(x).shares(of(y));
        let exclude = packing::exclusions(hopeful.len(), shares);
        let (best, chosen) = packing::best(&weights, &|_| true, &exclude);
        let clear = chosen.into_iter().filter(|&k| !standing[hopeful[k]]).filter(|&k| {
            let same = |j: usize| shares(j, k) && (of(j).position - of(k).position).norm() < ROBOT_M;
            let lead = || best - packing::best(&weights, &|j| !same(j), &exclude).0;
            (of(k).count >= LEAST_COUNT && self.is_missed_near(of(k).position))
                || EVIDENCE.iter().any(|(enough, needed)| of(k).count >= *enough && lead() > *needed)
        });
        clear.map(|k| of(k).tracks.clone()).collect()
    }

    /// Of candidates, best first, those on which it depends whether one that does not stand is chosen: they share tracks with it, or
    /// with others that do; of the same tracks the best. Many robots pair everybody many times.
    fn contested(&self, hopeful: &[usize], standing: &[bool]) -> Vec<usize> {
        let of = |k: usize| &self.candidates[k];
        let mut distinct: Vec<usize> = Vec::new();
        for &k in hopeful {
            if !distinct.iter().any(|j| of(*j).has_tracks_of(of(k))) {
                distinct.push(k);
            }
        }
        let mut reached: Vec<bool> = distinct.iter().map(|k| !standing[*k]).collect();
        let mut next: Vec<usize> = (0..distinct.len()).filter(|n| reached[*n]).collect();
        while let Some(n) = next.pop() {
            for m in 0..distinct.len() {
                if !reached[m] && of(distinct[m]).shares(of(distinct[n])) {
                    reached[m] = true;
                    next.push(m);
                }
            }
        }
        distinct.into_iter().zip(reached).filter(|(_, reached)| *reached).map(|(k, _)| k).collect()
    }

    /// Whether the candidate is a target as it stands: all its tracks are that one's.
    fn stands(&self, c: &Candidate) -> bool {
        let mut targets = c.pair.iter().map(|key| self.memories.iter().find(|m| m.is(key.0, key.1))?.bound);
        let first = targets.next().flatten();
        first.is_some() && targets.all(|t| t == first)
    }

    /// Makes a target of tracks where that explains the window better. Gives which.
    fn make_target(&mut self, tracks: &[Key], placed: &[TargetId], context: &Context<'_>) -> Option<TargetId> {
        let find = |key: &Key| self.memories.iter().find(|m| m.is(key.0, key.1)).cloned();
        let members: Vec<(Memory, Pose2)> =
            tracks.iter().filter_map(|key| Some((find(key)?, context.calibrator.station(key.0)?))).collect();
        if members.len() < tracks.len() || self.targets.len() >= MAX_TARGETS {
            return None;
        }
        let set: Vec<(&Memory, Pose2)> = members.iter().map(|(m, pose)| (m, *pose)).collect();
        let (proposal, newborn) = self.best_birth(tracks, context)?;
        let state = proposal.last_state(newborn.id)?;
        if self.is_double(newborn.id, state) {
            return None;
        }
        let position = state.target.position();
        let top = Self::top_of(&set, position);
        let looks = Self::looks_of(&set);
        let id = newborn.id;
        // Those whom it takes half of their tracks or more from, and who resemble it, are it.
        let half_taken = |f: &Followed| {
            let own = members.iter().filter(|(m, _)| m.bound == Some(f.id)).count();
            own > 0 && 2 * own >= self.present_tracks(f.id).len()
        };
        let robbed: Vec<TargetId> = self.targets.iter().filter(|f| half_taken(f)).map(|f| f.id).collect();
        self.targets.push(newborn);
        self.accept(proposal, context);
        let bereft = |f: &Followed| robbed.contains(&f.id);
        let former = self
            .targets
            .iter()
            .filter(|f| bereft(f) && !placed.contains(&f.id))
            .map(|f| (self.resemblance(f, position, top, &looks), f.id))
            .filter(|(nats, _)| *nats > -CONTINUED)
            .max_by(|x, y| x.0.total_cmp(&y.0))
            .map(|(_, id)| id);
        let name = former.unwrap_or_else(|| {
            let elsewhere: Vec<TargetId> = self
                .targets
                .iter()
                .filter(|f| {
                    f.id == id || self.present_tracks(f.id).iter().any(|(r, _)| tracks.iter().any(|(o, _)| o == r))
                })
                .map(|f| f.id)
                .collect();
            self.recognise(position, top, &looks, |f| placed.contains(&f.id) || elsewhere.contains(&f.id))
        });
        self.rename(id, name);
        Some(name)
    }

    /// The newborn gets its number; who had it before is gone.
    fn rename(&mut self, id: TargetId, name: TargetId) {
        let old = self.targets.iter().position(|f| f.id == name).map(|k| self.targets.remove(k));
        let old = old.or_else(|| {
            let k = self.departed.iter().position(|f| f.id == name)?;
            Some(self.departed.swap_remove(k))
        });
        for m in &mut self.memories {
            if m.bound == Some(name) {
                m.bind(None);
            }
            if m.bound == Some(id) {
                m.bound = Some(name);
            }
        }
        for owner in self.window.iter_mut().flat_map(|k| &mut k.owners) {
            if *owner == Some(name) {
                *owner = None;
            }
            if *owner == Some(id) {
                *owner = Some(name);
            }
        }
        if let Some(f) = self.targets.iter_mut().find(|f| f.id == id) {
            f.id = name;
            if let Some(old) = old {
                f.state.target.keep_top(&old.state.target);
                (f.past, f.looks) = (old.past, old.looks);
                f.state.updates = f.state.updates.max(old.state.updates);
            }
        }
    }

    /// A target of these tracks, from where in the window it explains most; `None` where it explains nothing better.
    fn best_birth(&self, tracks: &[Key], context: &Context<'_>) -> Option<(Proposal, Followed)> {
        let id = TargetId(u32::MAX);
        let changes: Vec<Change> =
            tracks.iter().map(|(robot, track)| Change { robot: *robot, track: *track, to: Some(id) }).collect();
        let price: f64 = changes.iter().map(|c| if self.is_owned(c) { self.price(c, 0) } else { 0.0 }).sum();
        let firsts: Vec<usize> = tracks.iter().filter_map(|(r, t)| self.first_seen(*r, *t)).collect();
        let together = firsts.iter().copied().max()?;
        let recent = self.window.iter().position(|k| self.newest.seconds_since(k.seen.at) < RECENT_S).unwrap_or(0);
        let unsure = tracks.iter().filter_map(|(r, t)| self.last_unsure(*r, *t)).max().unwrap_or(0);
        let mut starts = [together, recent.max(together), unsure.max(together)];
        starts.sort_unstable();
        let mut best: Option<(f64, Proposal, Followed)> = None;
        for (n, &from) in starts.iter().enumerate() {
            if n > 0 && starts[n - 1] == from {
                continue;
            }
            let Some(position) = self.crossing_at(tracks, from, context) else { continue };
            let at = self.window[from].seen.newest;
            let target = Target::new(position, at, self.config.acceleration_m2ps3, self.config.person_height_m);
            let state = State::new(target, at);
            let newborn = Followed {
                id,
                trail: std::iter::repeat_n(state.clone(), self.window.len() - from).collect(),
                state,
                past: Past::default(),
                looks: Looks::default(),
            };
            let proposal = self.evaluate(from, changes.clone(), Some(&newborn), context);
            let birth = if self.is_missed_near(position) { BIRTH_AGAIN } else { BIRTH };
            let net = proposal.gain - price - birth;
            if net > best.as_ref().map_or(0.0, |(b, ..)| *b) {
                best = Some((net, proposal, newborn));
            }
        }
        best.map(|(_, proposal, newborn)| (proposal, newborn))
    }

    /// Whether somebody was lost of late who may be there.
    fn is_missed_near(&self, position: Vector2<f64>) -> bool {
        self.departed.iter().any(|lost| {
            let ago_s = self.newest.seconds_since(lost.state.last);
            let reach_m = MISSED_M.0 + MISSED_M.1 * ago_s.min(MISSED_M.2);
            ago_s < MISSED_S && (lost.state.target.position() - position).norm() < reach_m
        })
    }

    fn is_owned(&self, c: &Change) -> bool {
        self.memories.iter().any(|m| m.is(c.robot, c.track) && m.bound.is_some())
    }

    /// Where the rays of tracks cross in the frames from `from` on.
    fn crossing_at(&self, tracks: &[Key], from: usize, context: &Context<'_>) -> Option<Vector2<f64>> {
        let rays: Vec<(Pose2, f64)> = tracks
            .iter()
            .filter_map(|(robot, track)| {
                let pose = context.calibrator.station(*robot)?;
                let sights = self.window.iter().skip(from).filter(|k| k.seen.robot == *robot);
                let sight = sights.flat_map(|k| &k.seen.sights).find(|s| s.track == *track)?;
                Some((pose, sight.bearing_rad))
            })
            .collect();
        super::explanation::widest_crossing(&rays)
    }

    pub(super) fn forget_vacated(&mut self) {
        let newest = self.newest;
        self.vacated.retain(|(_, at)| newest.seconds_since(*at) < VACATED.0);
        self.vacated.truncate(64);
    }
}

#[cfg(test)]
mod tests {
    use protocol::appearance::{Appearance, BANDS, Band};

    use super::*;
    use crate::leader::config::TargetConfig;

    #[test]
    fn who_was_lost_and_comes_back_is_known_by_what_he_looked_like() {
        let config = TargetConfig::default();
        let (place, now) = (Vector2::new(1.0, 2.0), Timestamp::from_secs_f64(1000.0));
        let clothes = Appearance([Some(Band::of(40.0, 5.0)); BANDS]);
        let somebody = |id| {
            let target = Target::new(place, now, config.acceleration_m2ps3, config.person_height_m);
            let (trail, past, looks) = (Default::default(), Past::default(), Looks::default());
            Followed { id, state: State::new(target, now), trail, past, looks }
        };
        let mut follower = Follower::new(config);
        follower.newest = now;
        let mut lost = somebody(TargetId(7));
        lost.looks.see(0, &clothes);
        lost.past.keep(now, place, Vector2::zeros());
        follower.remember_departed(lost);
        follower.targets.push(somebody(TargetId(u32::MAX)));
        let name = follower.recognise(place, None, &[clothes], |_| false);
        follower.rename(TargetId(u32::MAX), name);
        assert_eq!(follower.targets.iter().map(|f| f.id).collect::<Vec<_>>(), [TargetId(7)]);
        assert!(follower.targets[0].looks.resemblance(&clothes) > 1.0, "his looks are known again");
        assert!(follower.departed.is_empty());
    }
}
