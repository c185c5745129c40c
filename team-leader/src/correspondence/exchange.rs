//! Tracks that two targets have exchanged, given back.
//!
//! Where two people pass each other in one robot's picture, the robot may go on with their tracks exchanged. While only two
//! robots see them, no bearing contradicts: the rays of the wrong pairs meet as well, somewhere else. What the robots know of
//! the ranges does, and so every two targets that a robot follows are weighed with their tracks there exchanged, over some
//! frames. A track that nobody has may be exchanged for one that a target has, too.

use protocol::frames::Pose2;
use protocol::id::{TargetId, TrackId};
use protocol::time::Timestamp;

use super::memory::Memory;
use super::{Follower, Frame, PRESENT_S};
use crate::calibration::live::Calibrator;
use crate::stereo::target::{BearingFrom, Target};

/// What tracks are worth that no place on the floor explains, nats.
const IMPOSSIBLE: f64 = -12.0;
/// Frames of evidence, and the gain that is needed with so many, nats.
const EVIDENCE: [(u32, f64); 2] = [(6, 4.0), (12, 2.0)];
/// Frames over which a gain is averaged.
const MEAN_OVER: u32 = 20;
/// Most exchanges under consideration.
const MAX_EXCHANGES: usize = 128;

/// Two tracks of one robot that may be each other's target's.
#[derive(Debug, Clone)]
pub struct Exchange {
    robot: usize,
    tracks: [TrackId; 2],
    mean: f64,
    count: u32,
    last: Timestamp,
}

impl Follower {
    /// Weighs the exchanges that this frame allows and makes those that have proved better.
    pub(super) fn exchange(&mut self, frame: &Frame<'_>, calibrator: &Calibrator) {
        let newest = self.newest;
        self.exchanges.retain(|e| newest.seconds_since(e.last) < PRESENT_S);
        let mine: Vec<(TrackId, Option<TargetId>)> = self
            .memories
            .iter()
            .filter(|m| m.robot == frame.robot && m.last == frame.at && !m.peer && m.count > 3)
            .map(|m| (m.track, m.bound))
            .collect();
        for (n, (a, of_a)) in mine.iter().enumerate() {
            for (b, of_b) in &mine[n + 1..] {
                if of_a == of_b {
                    continue;
                }
                let Some(gain) = self.gain(frame, (*a, *of_a), (*b, *of_b), calibrator) else { continue };
                self.note_exchange(frame, [*a, *b], gain);
            }
        }
        let proved = self
            .exchanges
            .iter()
            .filter(|e| e.robot == frame.robot && e.last == frame.at)
            .filter(|e| EVIDENCE.iter().any(|(count, gain)| e.count >= *count && e.mean > *gain))
            .max_by(|x, y| x.mean.total_cmp(&y.mean))
            .map(|e| e.tracks);
        if let Some([a, b]) = proved {
            self.make_exchange(frame, a, b, calibrator);
            self.exchanges.retain(|e| e.robot != frame.robot || !e.tracks.iter().any(|t| *t == a || *t == b));
        }
    }

    fn note_exchange(&mut self, frame: &Frame<'_>, tracks: [TrackId; 2], gain: f64) {
        let found = self.exchanges.iter().position(|e| e.robot == frame.robot && e.tracks == tracks);
        if let Some(k) = found {
            let e = &mut self.exchanges[k];
            e.count += 1;
            e.mean += (gain - e.mean) / f64::from(e.count.min(MEAN_OVER));
            e.last = frame.at;
        } else if self.exchanges.len() < MAX_EXCHANGES {
            self.exchanges.push(Exchange { robot: frame.robot, tracks, mean: gain, count: 1, last: frame.at });
        }
    }

    /// By how much the tracks are explained better when the targets of `a` and `b` are exchanged; `None` where nothing tells.
    fn gain(
        &self,
        frame: &Frame<'_>,
        (a, of_a): (TrackId, Option<TargetId>),
        (b, of_b): (TrackId, Option<TargetId>),
        calibrator: &Calibrator,
    ) -> Option<f64> {
        let find = |track| self.memories.iter().find(|m| m.is(frame.robot, track));
        let (a, b) = (find(a)?, find(b)?);
        let rest = |target: Option<TargetId>| match target {
            Some(id) => self.others_of(id, frame, calibrator),
            None => Vec::new(),
        };
        let (rest_a, rest_b) = (rest(of_a), rest(of_b));
        if (of_a.is_some() && rest_a.is_empty()) || (of_b.is_some() && rest_b.is_empty()) {
            return None;
        }
        let worth = |track: &Memory, rest: &[(&Memory, Pose2)]| {
            if rest.is_empty() {
                return 0.0;
            }
            let mut set = rest.to_vec();
            set.push((track, frame.pose));
            self.explain(&set, frame.at).map_or(IMPOSSIBLE, |e| e.log_ratio.max(IMPOSSIBLE))
        };
        Some(worth(a, &rest_b) + worth(b, &rest_a) - worth(a, &rest_a) - worth(b, &rest_b))
    }

    /// Present tracks of a target by the other robots.
    fn others_of<'a>(&'a self, id: TargetId, frame: &Frame<'_>, calibrator: &Calibrator) -> Vec<(&'a Memory, Pose2)> {
        self.tracks_of(id, frame.at, calibrator).into_iter().filter(|(m, _)| m.robot != frame.robot).collect()
    }

    /// Present tracks of a target.
    fn tracks_of<'a>(&'a self, id: TargetId, at: Timestamp, calibrator: &Calibrator) -> Vec<(&'a Memory, Pose2)> {
        self.memories
            .iter()
            .filter(|m| m.bound == Some(id) && at.seconds_since(m.last).abs() < PRESENT_S)
            .filter_map(|m| Some((m, calibrator.station(m.robot)?)))
            .collect()
    }

    fn make_exchange(&mut self, frame: &Frame<'_>, a: TrackId, b: TrackId, calibrator: &Calibrator) {
        let bound =
            |memories: &[Memory], track| memories.iter().find(|m| m.is(frame.robot, track)).and_then(|m| m.bound);
        let (of_a, of_b) = (bound(&self.memories, a), bound(&self.memories, b));
        for (track, to) in [(a, of_b), (b, of_a)] {
            let found = self.memories.iter_mut().find(|m| m.is(frame.robot, track));
            match (found, to) {
                (Some(m), Some(id)) => m.bind(id),
                (Some(m), None) => m.release(),
                (None, _) => {}
            }
        }
        if let (Some(x), Some(y)) = (of_a, of_b)
            && self.better_renamed(x, y, frame, calibrator)
        {
            for m in &mut self.memories {
                match m.bound {
                    Some(id) if id == x => m.bind(y),
                    Some(id) if id == y => m.bind(x),
                    _ => {}
                }
            }
        }
        for id in [of_a, of_b].into_iter().flatten() {
            self.place_anew(id, frame, calibrator);
        }
    }

    /// Whether each of two targets resembles more what is found where the other's tracks meet.
    fn better_renamed(&self, x: TargetId, y: TargetId, frame: &Frame<'_>, calibrator: &Calibrator) -> bool {
        let place = |id| {
            let tracks = self.tracks_of(id, frame.at, calibrator);
            let position = self.explain(&tracks, frame.at)?.position;
            Some((position, Self::top_of(&tracks, position), Self::looks_of(&tracks)))
        };
        let known = |id| self.targets.iter().find(|f| f.id == id);
        let (Some(fx), Some(fy), Some(px), Some(py)) = (known(x), known(y), place(x), place(y)) else { return false };
        let fits = |f, (position, top, looks): &(_, _, Vec<_>)| self.resemblance(f, *position, *top, looks);
        fits(fx, &py) + fits(fy, &px) > fits(fx, &px) + fits(fy, &py)
    }

    /// A target's state from its present tracks alone.
    fn place_anew(&mut self, id: TargetId, frame: &Frame<'_>, calibrator: &Calibrator) {
        let tracks = self.tracks_of(id, frame.at, calibrator);
        let Some(explained) = self.explain(&tracks, frame.at) else { return };
        let (acceleration, height) = (self.config.acceleration_m2ps3, self.config.person_height_m);
        let mut target = Target::new(explained.position, self.newest, acceleration, height);
        for (m, pose) in &tracks {
            target.update(&self.bearing_of(m, pose, explained.position, frame.at));
        }
        let observers = tracks.iter().map(|(m, _)| (m.robot, m.last)).collect();
        if let Some(followed) = self.targets.iter_mut().find(|f| f.id == id) {
            target.keep_top(&followed.target);
            (followed.target, followed.observers) = (target, observers);
        }
    }

    /// A remembered track as a bearing of something at `position`.
    pub(super) fn bearing_of(
        &self,
        m: &Memory,
        pose: &Pose2,
        position: nalgebra::Vector2<f64>,
        at: Timestamp,
    ) -> BearingFrom {
        let range_m = (position - pose.position()).norm().max(0.3);
        let var = m.sigma_rad.powi(2) + (self.config.axis_sway_m / range_m).powi(2);
        BearingFrom { robot: m.robot, pose: *pose, bearing_rad: m.bearing_at(at), var, at }
    }
}
