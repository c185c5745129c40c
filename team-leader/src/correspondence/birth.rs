//! The best explanation of all tracks: new targets, and old ones that other tracks explain better.
//!
//! Problem: of n people two robots make up to n² crossings of rays, n of which are real, and some tracks are nobody.
//!
//! Insight: the tracks are shared out once for all of them. A candidate (tracks of two robots, and of every further robot
//! whose ray passes there) is weighed against its tracks being clutter ([`super::explanation`]); the set of candidates that
//! share no track and weigh most together explains the pictures best. So a ghost may look as good as a person by itself: it
//! takes away the tracks of two. Candidates that are targets already are in the set with a bonus. A new one that stays in it
//! over frames, clearly ahead of the best set without it, becomes a target; whose number it gets says [`super::identity`].

mod packing;

use nalgebra::Vector2;
use protocol::angle::wrap;
use protocol::appearance::Appearance;
use protocol::frames::Pose2;
use protocol::id::{TargetId, TrackId};
use protocol::time::Timestamp;

use super::explanation::{Explanation, RANGE_WORTH};
use super::identity::{Looks, Past};
use super::likelihood::log_student;
use super::memory::Memory;
use super::{Followed, Follower, Frame, MAX_TARGETS, PRESENT_S, Sight};
use crate::calibration::live::Calibrator;
use crate::stereo::target::Target;

/// Frames in which a track must have been seen before it counts.
const LEAST_COUNT: u32 = 3;
/// Nobody stands inside a robot, metres from its axis.
const ROBOT_M: f64 = 0.3;
/// A robot that left its place leaves a false change there, for so long (s) and so near (m).
const VACATED: (f64, f64) = (15.0, 0.45);
/// A further robot's ray passes within so many squared sigmas.
const THIRD_GATE: f64 = 12.0;
/// What it says that a further robot sees nothing, and how far away it may miss people, metres.
const UNSEEN: f64 = -1.2;
const SURE_RANGE_M: f64 = 6.0;
/// Frames of evidence, and the lead over the best set without it that is needed with so many.
const EVIDENCE: [(u32, f64); 3] = [(5, 1.5), (10, 0.75), (20, 0.25)];
/// Frames over which a candidate's weight is averaged.
const MEAN_OVER: u32 = 20;
/// What it is worth that the tracks are one target's already, nats.
const STANDING_WORTH: f64 = 6.0;
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
}

/// A candidate as one frame shows it.
struct Weighed {
    log_ratio: f64,
    position: Vector2<f64>,
    tracks: Vec<Key>,
}

impl Follower {
    /// Gathers evidence for the loose tracks of this frame, and makes targets of the clear ones.
    pub(super) fn give_birth(&mut self, frame: &Frame<'_>, sights: &[Sight], calibrator: &Calibrator) {
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
            placed.extend(self.make_target(frame, &tracks, &placed, calibrator));
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
            None if self.candidates.len() < MAX_CANDIDATES => self.candidates.push(Candidate {
                pair,
                tracks: weighed.tracks,
                position: weighed.position,
                mean: weighed.log_ratio,
                count: 1,
                last: at,
            }),
            None => {}
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
        hopeful.truncate(packing::MOST);
        let of = |x: usize| &self.candidates[hopeful[x]];
        let weights: Vec<f64> = hopeful.iter().map(|k| worth(*k)).collect();
        let shares = |x: usize, y: usize| of(x).tracks.iter().any(|t| of(y).tracks.contains(t));
        let (best, chosen) = packing::best(&weights, &|_| true, &shares);
        let clear = chosen.into_iter().filter(|&k| !standing[hopeful[k]]).filter(|&k| {
            let same = |j: usize| shares(j, k) && (of(j).position - of(k).position).norm() < ROBOT_M;
            let lead = || best - packing::best(&weights, &|j| !same(j), &shares).0;
            EVIDENCE.iter().any(|(enough, needed)| of(k).count >= *enough && lead() > *needed)
        });
        clear.map(|k| of(k).tracks.clone()).collect()
    }

    /// Whether the candidate is a target as it stands: all its tracks are that one's.
    fn stands(&self, c: &Candidate) -> bool {
        let mut targets = c.pair.iter().map(|key| self.memories.iter().find(|m| m.is(key.0, key.1))?.bound);
        let first = targets.next().flatten();
        first.is_some() && targets.all(|t| t == first)
    }

    /// Makes a target of tracks, or places one anew that most of them were of. Gives which.
    fn make_target(
        &mut self,
        frame: &Frame<'_>,
        tracks: &[Key],
        placed: &[TargetId],
        calibrator: &Calibrator,
    ) -> Option<TargetId> {
        let find = |key: &Key| self.memories.iter().find(|m| m.is(key.0, key.1)).cloned();
        let members: Vec<(Memory, Pose2)> =
            tracks.iter().filter_map(|key| Some((find(key)?, calibrator.station(key.0)?))).collect();
        if members.len() < tracks.len() || self.targets.len() >= MAX_TARGETS {
            return None;
        }
        let set: Vec<(&Memory, Pose2)> = members.iter().map(|(m, pose)| (m, *pose)).collect();
        let Explanation { position, .. } = self.explain(&set, frame.at)?;
        let mut target =
            Target::new(position, self.newest, self.config.acceleration_m2ps3, self.config.person_height_m);
        for (m, pose) in &members {
            target.update(&self.bearing_of(m, pose, position, frame.at));
        }
        let top = Self::top_of(&set, position);
        let newest = self.newest;
        let looks = Self::looks_of(&set);
        let id = self.former(&members, placed, position, top, &looks).unwrap_or_else(|| {
            let seen = |f: &Followed| tracks.iter().any(|(robot, _)| f.is_seen_by(*robot, newest, PRESENT_S));
            self.recognise(position, top, &looks, |f| placed.contains(&f.id) || seen(f))
        });
        for m in self.memories.iter_mut().filter(|m| tracks.contains(&(m.robot, m.track))) {
            if m.bound != Some(id) {
                m.bind(id);
            }
        }
        let observers: Vec<(usize, Timestamp)> = members.iter().map(|(m, _)| (m.robot, m.last)).collect();
        if let Some(old) = self.targets.iter_mut().find(|f| f.id == id) {
            target.keep_top(&old.target);
            (old.target, old.observers, old.last) = (target, observers, frame.at);
            // What it had beside these is not its own any more.
            let robots: Vec<usize> = tracks.iter().map(|(robot, _)| *robot).collect();
            let others =
                self.memories.iter_mut().filter(|m| m.bound == Some(id) && !tracks.contains(&(m.robot, m.track)));
            others.filter(|m| robots.contains(&m.robot)).for_each(Memory::release);
            return Some(id);
        }
        self.targets.push(Followed {
            id,
            target,
            observers,
            last: frame.at,
            updates: 2,
            two_robots: true,
            half_width_m: 0.23,
            past: Past::default(),
            looks: Looks::default(),
        });
        Some(id)
    }

    /// Of the targets that the tracks belonged to, the one that keeps its number: that it resembles most, if it resembles it
    /// at all and the target has not as many tracks elsewhere.
    fn former(
        &self,
        members: &[(Memory, Pose2)],
        placed: &[TargetId],
        position: Vector2<f64>,
        top_m: Option<f64>,
        looks: &[Appearance],
    ) -> Option<TargetId> {
        let newest = self.newest;
        let value = |f: &Followed| {
            let own = members.iter().filter(|(m, _)| m.bound == Some(f.id)).count();
            let present = |m: &&Memory| m.bound == Some(f.id) && newest.seconds_since(m.last) < PRESENT_S;
            let all = self.memories.iter().filter(present).count();
            let nats = self.resemblance(f, position, top_m, looks);
            (own > 0 && 2 * own >= all && nats > 0.0).then_some(nats)
        };
        let candidates = self.targets.iter().filter(|f| !placed.contains(&f.id));
        candidates.filter_map(|f| Some((value(f)?, f.id))).max_by(|x, y| x.0.total_cmp(&y.0)).map(|(_, id)| id)
    }

    pub(super) fn forget_vacated(&mut self) {
        let newest = self.newest;
        self.vacated.retain(|(_, at)| newest.seconds_since(*at) < VACATED.0);
        self.vacated.truncate(64);
    }
}
