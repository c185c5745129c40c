//! New targets from loose tracks of two robots.
//!
//! Every pair of loose tracks of two robots whose rays meet is a candidate; of n people two robots make up to n² of them,
//! n of which are real. Evidence is gathered over frames: the ranges that each robot knows by itself, the height of the
//! top from both sides, whether a third robot sees something there. A pair becomes a target when it is clearly better than
//! every other use of its two tracks.

use nalgebra::Vector2;
use protocol::angle::wrap;
use protocol::id::{TargetId, TrackId};
use protocol::time::Timestamp;

use super::memory::Memory;
use super::{Followed, Follower, Frame, MAX_TARGETS, Sight};
use crate::calibration::live::Calibrator;
use crate::stereo::target::{BearingFrom, Target};
use crate::stereo::triangulate::{StereoBearings, triangulate};

/// Frames in which a track must have been seen before it is paired.
const LEAST_COUNT: u32 = 3;
/// A track of another robot counts as present for so long, seconds.
const PRESENT_S: f64 = 0.3;
/// Rays that meet at a flatter angle (sine) say nothing about range.
const LEAST_PARALLAX: f64 = 0.08;
/// Where targets may be, metres from each robot.
const RANGE_M: [f64; 2] = [0.35, 15.0];
/// Nobody stands inside a robot, metres from its axis.
const ROBOT_M: f64 = 0.3;
/// A robot that left its place leaves a false change there, for so long (s) and so near (m).
const VACATED: (f64, f64) = (15.0, 0.45);
/// How far from its axis a body reaches with arms and steps, metres.
const BODY_REACH_M: f64 = 0.3;
/// What it costs that a track shares its region with others.
const MERGED_DOUBT: f64 = 0.5;
/// Log-likelihood of an impossible pair.
const IMPOSSIBLE: f64 = -10.0;
/// Log-likelihood below which no pair is believed.
const LEAST_BELIEF: f64 = -4.5;
/// A third robot sees a loose track there, something, nothing although it should.
const THIRD: [f64; 3] = [1.5, 0.0, -2.0];
/// A third robot further away may miss it, metres.
const THIRD_RANGE_M: f64 = 6.0;
/// Frames of evidence, and the lead that is needed with few and with many.
const EVIDENCE: [(u32, f64); 2] = [(4, 1.0), (12, 0.4)];
/// Most pairs under consideration.
const MAX_PAIRS: usize = 1024;
/// How long a dropped target may get its number back, seconds, and how far it may have gone: metres, m/s.
const REMEMBERED_S: f64 = 5.0;
const STRAYED: (f64, f64) = (0.6, 1.0);

/// Evidence for a pair of tracks.
#[derive(Debug, Clone)]
pub struct Pair {
    /// Robot and track.
    pub a: (usize, TrackId),
    /// Robot and track.
    pub b: (usize, TrackId),
    mean: f64,
    count: u32,
    last: Timestamp,
}

/// A dropped target.
#[derive(Debug, Clone)]
pub struct Departed {
    /// Its number.
    pub id: TargetId,
    /// Last known.
    pub position: Vector2<f64>,
    /// When.
    pub at: Timestamp,
}

impl Follower {
    /// Gathers evidence for the loose tracks of this frame, and makes targets of the clear ones.
    pub(super) fn give_birth(&mut self, frame: &Frame<'_>, sights: &[Sight], calibrator: &Calibrator) {
        let loose = |m: &&Memory| m.bound.is_none() && !m.peer && m.count >= LEAST_COUNT;
        let present = |m: &&Memory| frame.at.seconds_since(m.last).abs() < PRESENT_S;
        let mine: Vec<Memory> = sights
            .iter()
            .filter_map(|s| self.memories.iter().find(|m| m.is(frame.robot, s.track)))
            .filter(loose)
            .cloned()
            .collect();
        if mine.is_empty() {
            return;
        }
        let others: Vec<Memory> =
            self.memories.iter().filter(|m| m.robot != frame.robot).filter(loose).filter(present).cloned().collect();
        let mut touched = Vec::new();
        for a in &mine {
            for b in &others {
                let Some(pose_b) = calibrator.station(b.robot) else { continue };
                let (belief, _) = self.belief(frame, a, b, pose_b, calibrator);
                touched.push(self.gather((a.robot, a.track), (b.robot, b.track), belief, frame.at));
            }
        }
        let newest = self.newest;
        self.pairs.retain(|p| newest.seconds_since(p.last) < 1.0);
        for (a, b) in self.clear_pairs(&touched) {
            self.make_target(frame, a, b, calibrator);
        }
    }

    /// Log-likelihood that two tracks are one object, and where it would be.
    fn belief(
        &self,
        frame: &Frame<'_>,
        a: &Memory,
        b: &Memory,
        pose_b: protocol::frames::Pose2,
        calibrator: &Calibrator,
    ) -> (f64, Option<Vector2<f64>>) {
        let pose_a = frame.pose;
        let bearing_b = b.bearing_at(frame.at);
        let met = triangulate(&StereoBearings {
            target_1_rad: a.bearing_rad,
            target_2_rad: bearing_b,
            bearing_21_rad: pose_a.bearing_to(pose_b.position()),
            bearing_12_rad: pose_b.bearing_to(pose_a.position()),
            baseline_m: (pose_b.position() - pose_a.position()).norm(),
        });
        let Some(met) = met.filter(|t| {
            t.parallax_rad.sin() > LEAST_PARALLAX
                && [t.range_1_m, t.range_2_m].iter().all(|r| (RANGE_M[0]..RANGE_M[1]).contains(r))
        }) else {
            return (IMPOSSIBLE, None);
        };
        let position = pose_a.transform(met.position_m);
        let in_robot = calibrator.poses(frame.at).any(|(_, p)| (p.position() - position).norm() < ROBOT_M);
        let ghost_of_robot = self.vacated.iter().any(|(p, _)| (p - position).norm() < VACATED.1);
        if in_robot || ghost_of_robot {
            return (IMPOSSIBLE, None);
        }
        if self.is_piece_of_known(a, b, pose_b, frame) {
            return (IMPOSSIBLE, None);
        }
        let mut belief = -0.5 * (a.cue.cost(met.range_1_m) + b.cue.cost(met.range_2_m));
        belief -= MERGED_DOUBT * f64::from(u8::from(a.merged) + u8::from(b.merged));
        if let (Some((ea, sa)), Some((eb, sb))) = (a.top, b.top) {
            let (za, zb) = (met.range_1_m * ea.tan(), met.range_2_m * eb.tan());
            let sigma = (met.range_1_m * sa).hypot(met.range_2_m * sb).hypot(0.1);
            belief -= 0.5 * ((za - zb) / sigma).powi(2).min(9.0);
        }
        for (robot, pose) in calibrator.stations().filter(|(r, _)| *r != a.robot && *r != b.robot) {
            belief += self.third_opinion(frame.at, robot, &pose, position);
        }
        (belief, Some(position))
    }

    /// Whether a target that both robots follow already covers both tracks: a second piece of the same body.
    fn is_piece_of_known(&self, a: &Memory, b: &Memory, pose_b: protocol::frames::Pose2, frame: &Frame<'_>) -> bool {
        let covers = |f: &Followed, m: &Memory, pose: &protocol::frames::Pose2| {
            let range_m = (f.target.position() - pose.position()).norm().max(0.3);
            let away = wrap(m.bearing_at(frame.at) - pose.bearing_to(f.target.position())).abs();
            away < (BODY_REACH_M / range_m).atan() + m.sigma_rad
        };
        let followed = |f: &Followed, robot: usize| {
            let lately = |at: Timestamp| frame.at.seconds_since(at).abs() < 2.0 * PRESENT_S;
            f.observers.iter().any(|(r, at)| *r == robot && lately(*at))
        };
        self.targets.iter().any(|f| {
            f.is_confirmed()
                && followed(f, a.robot)
                && followed(f, b.robot)
                && covers(f, a, &frame.pose)
                && covers(f, b, &pose_b)
        })
    }

    fn third_opinion(
        &self,
        at: Timestamp,
        robot: usize,
        pose: &protocol::frames::Pose2,
        position: Vector2<f64>,
    ) -> f64 {
        let bearing = pose.bearing_to(position);
        let range_m = (position - pose.position()).norm();
        let mut recent = self.memories.iter().filter(|m| m.robot == robot && at.seconds_since(m.last) < PRESENT_S);
        let near: Vec<&Memory> = recent
            .by_ref()
            .filter(|m| wrap(m.bearing_at(at) - bearing).abs() < m.half_width_rad.max(3.0 * m.sigma_rad) + 0.02)
            .collect();
        if near.iter().any(|m| m.bound.is_none() && !m.peer) {
            THIRD[0]
        } else if !near.is_empty() || range_m > THIRD_RANGE_M || !self.watches(robot, at) {
            THIRD[1]
        } else {
            THIRD[2]
        }
    }

    /// Whether the robot follows anything at present: one that has just stopped sees nobody yet.
    pub(super) fn watches(&self, robot: usize, at: Timestamp) -> bool {
        self.memories.iter().any(|m| m.robot == robot && at.seconds_since(m.last) < PRESENT_S)
    }

    fn gather(&mut self, a: (usize, TrackId), b: (usize, TrackId), belief: f64, at: Timestamp) -> usize {
        let found = self.pairs.iter().position(|p| (p.a == a && p.b == b) || (p.a == b && p.b == a));
        let k = found.unwrap_or_else(|| {
            if self.pairs.len() >= MAX_PAIRS {
                self.pairs.remove(0);
            }
            self.pairs.push(Pair { a, b, mean: 0.0, count: 0, last: at });
            self.pairs.len() - 1
        });
        let pair = &mut self.pairs[k];
        pair.count += 1;
        pair.mean += (belief - pair.mean) / f64::from(pair.count.min(20));
        pair.last = at;
        k
    }

    /// Pairs of this frame that are better than every other use of their tracks.
    fn clear_pairs(&self, touched: &[usize]) -> Vec<((usize, TrackId), (usize, TrackId))> {
        // Positions shift when old pairs are removed, so the touched ones are found by their time.
        if touched.is_empty() {
            return Vec::new();
        }
        let shares = |p: &Pair, q: &Pair| {
            let same_robots = [q.a.0, q.b.0].iter().all(|r| *r == p.a.0 || *r == p.b.0);
            same_robots && (p.a == q.a || p.a == q.b || p.b == q.a || p.b == q.b)
        };
        let mut clear: Vec<&Pair> = Vec::new();
        for (k, p) in self.pairs.iter().enumerate().filter(|(_, p)| p.last == self.newest || p.count >= EVIDENCE[0].0) {
            let rivals = self.pairs.iter().enumerate().filter(|(j, q)| *j != k && q.count >= 2 && shares(p, q));
            let best_rival = rivals.map(|(_, q)| q.mean).fold(f64::NEG_INFINITY, f64::max);
            let lead = p.mean - best_rival;
            let enough = EVIDENCE.iter().any(|(count, needed)| p.count >= *count && lead > *needed);
            if enough && p.mean > LEAST_BELIEF {
                clear.push(p);
            }
        }
        clear.sort_by(|p, q| q.mean.total_cmp(&p.mean));
        clear.into_iter().map(|p| (p.a, p.b)).collect()
    }

    fn make_target(&mut self, frame: &Frame<'_>, a: (usize, TrackId), b: (usize, TrackId), calibrator: &Calibrator) {
        let free = |m: &&Memory| m.bound.is_none() && !m.peer;
        let find = |key: (usize, TrackId)| self.memories.iter().find(|m| m.is(key.0, key.1)).filter(free).cloned();
        let (Some(a), Some(b)) = (find(a), find(b)) else { return };
        // `a` is the newer one: a frame of its robot is being worked on.
        let (a, b) = if a.robot == frame.robot { (a, b) } else { (b, a) };
        let Some(pose_b) = calibrator.station(b.robot).filter(|_| a.robot == frame.robot) else { return };
        let (belief, Some(position)) = self.belief(frame, &a, &b, pose_b, calibrator) else { return };
        if belief < LEAST_BELIEF || self.targets.len() >= MAX_TARGETS {
            return;
        }
        let id = self.recognise(position);
        let mut target =
            Target::new(position, self.newest, self.config.acceleration_m2ps3, self.config.person_height_m);
        for (m, pose) in [(&b, pose_b), (&a, frame.pose)] {
            let range_m = (position - pose.position()).norm();
            let var = m.sigma_rad.powi(2) + (self.config.axis_sway_m / range_m).powi(2);
            target.update(&BearingFrom { robot: m.robot, pose, bearing_rad: m.bearing_rad, var, at: m.last });
        }
        for m in &mut self.memories {
            if m.is(a.robot, a.track) || m.is(b.robot, b.track) {
                let _ = m.hit(id, 0.0);
            }
        }
        self.pairs.retain(|p| {
            let gone = |k: (usize, TrackId)| k == (a.robot, a.track) || k == (b.robot, b.track);
            !gone(p.a) && !gone(p.b)
        });
        let observers = vec![(b.robot, b.last), (a.robot, a.last)];
        if let Some(old) = self.targets.iter_mut().find(|f| f.id == id) {
            (old.target, old.observers, old.last) = (target, observers, frame.at);
            old.absent.clear();
            return;
        }
        self.targets.push(Followed {
            id,
            target,
            observers,
            last: frame.at,
            updates: 2,
            two_robots: true,
            half_width_m: 0.23,
            misfit: 0.0,
            absent: Vec::new(),
        });
    }

    /// The number of a target that was lost nearby of late, or a new one.
    fn recognise(&mut self, position: Vector2<f64>) -> TargetId {
        let newest = self.newest;
        self.departed.retain(|d| newest.seconds_since(d.at) < REMEMBERED_S);
        let reach_m = |since: Timestamp| STRAYED.0 + STRAYED.1 * newest.seconds_since(since);
        let unseen = self.targets.iter().filter(|f| newest.seconds_since(f.last) > PRESENT_S && f.is_confirmed());
        let coasting = unseen.map(|f| ((f.target.position() - position).norm(), f.last, f.id));
        let dropped = self.departed.iter().map(|d| ((d.position - position).norm(), d.at, d.id));
        let found = coasting
            .chain(dropped)
            .filter(|(distance, since, _)| *distance < reach_m(*since))
            .min_by(|x, y| x.0.total_cmp(&y.0));
        if let Some((_, _, id)) = found {
            self.departed.retain(|d| d.id != id);
            return id;
        }
        self.next_id += 1;
        TargetId(self.next_id - 1)
    }

    pub(super) fn forget_vacated(&mut self) {
        let newest = self.newest;
        self.vacated.retain(|(_, at)| newest.seconds_since(*at) < VACATED.0);
        self.vacated.truncate(64);
    }
}
