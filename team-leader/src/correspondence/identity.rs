//! Who is who: whether what is found at a place is a target that was known before.
//!
//! Two things tell. A target goes on from where it was: its states of the last seconds are kept, because the newest may
//! already be of a wrong pair of tracks. And it keeps its height: the top over the floor, seen from any side; hands, chairs
//! and other people hide tops, so a lower one says little.

use std::collections::VecDeque;
use std::f64::consts::TAU;

use nalgebra::Vector2;
use protocol::appearance::Appearance;
use protocol::frames::Pose2;
use protocol::id::TargetId;
use protocol::time::Timestamp;

use super::memory::Memory;
use super::{Followed, Follower, PRESENT_S};
use crate::stereo::tails::log_student;

/// States of a target that are kept: how many, and how far apart, seconds.
const MOST_STATES: usize = 12;
const STATES_APART_S: f64 = 0.2;
/// States younger than this may be of a wrong pair already, seconds.
const DOUBTFUL_S: f64 = 0.6;
/// How far from a state's prediction a target is after so long: metres, m/s, metres at most.
const STRAYED: (f64, f64, f64) = (0.3, 0.5, 2.5);
/// A velocity leads so far, seconds.
const HEADED_S: f64 = 1.0;
/// Standard deviation of a top seen by one frame, metres, and the part of tops that are somebody's hand or hat.
const TOP_M: f64 = 0.06;
const WRONG_TOP: f64 = 0.15;
/// What a new target is worth against an old one: densities of places (1/m²) and of tops (1/m) of anybody.
const NEW_PLACE: f64 = 1.0 / 40.0;
const NEW_TOP: f64 = 1.5;
/// How long a dropped target may get its number back, seconds.
const REMEMBERED_S: f64 = 12.0;
/// How fast what is known of a target's looks follows what robots tell; what looks count for beside place and height, and
/// what one sight tells at most, nats.
const FOLLOW_LOOKS: f64 = 0.02;
const LOOKS_WORTH: f64 = 0.5;
const MOST_LOOKS: f64 = 4.0;
/// The same of the height of its top, and from how many sights of it on that is known.
const FOLLOW_TOP: f64 = 0.01;
const KNOWN_TOP: u32 = 30;
/// Most dropped targets remembered.
const MAX_DEPARTED: usize = 64;

/// Where a target was of late.
#[derive(Debug, Clone, Default)]
pub struct Past(VecDeque<(Timestamp, Vector2<f64>, Vector2<f64>)>);

impl Past {
    /// Keeps a state, now and then.
    pub fn keep(&mut self, at: Timestamp, position: Vector2<f64>, velocity: Vector2<f64>) {
        if self.0.back().is_none_or(|(last, ..)| at.seconds_since(*last) >= STATES_APART_S) {
            self.0.push_back((at, position, velocity));
        }
        if self.0.len() > MOST_STATES {
            self.0.pop_front();
        }
    }

    /// Log-density (1/m²) of `position` at `now`, by the state that explains it best.
    fn log_density(&self, position: Vector2<f64>, now: Timestamp) -> f64 {
        let age_s = |at: &Timestamp| now.seconds_since(*at);
        let trusted = self.0.iter().filter(|(at, ..)| age_s(at) >= DOUBTFUL_S).count();
        let states = self.0.iter().filter(|(at, ..)| trusted == 0 || age_s(at) >= DOUBTFUL_S);
        let densities = states.map(|(at, was, velocity)| {
            let sigma = (STRAYED.0 + STRAYED.1 * age_s(at)).min(STRAYED.2);
            let apart = (position - was - velocity * age_s(at).min(HEADED_S)).norm();
            log_student((apart / sigma).powi(2), sigma * sigma) - 0.5 * (TAU * sigma * sigma).ln()
        });
        densities.fold(f64::NEG_INFINITY, f64::max)
    }
}

/// What a target looks like: its clothes as each robot sees them, and how tall it is, of late.
#[derive(Debug, Clone, Default)]
pub struct Looks {
    clothes: Vec<(usize, Appearance)>,
    /// Mean height of its top over the floor, metres, and how many sights that is of.
    top: (f64, u32),
}

impl Looks {
    /// What a robot tells of its clothes.
    pub fn see(&mut self, robot: usize, appearance: &Appearance) {
        match self.clothes.iter_mut().find(|(r, _)| *r == robot) {
            Some((_, known)) => known.follow(appearance, FOLLOW_LOOKS),
            None => self.clothes.push((robot, *appearance)),
        }
    }

    /// A height of its top, metres.
    pub fn see_top(&mut self, top_m: f64) {
        let (mean, sights) = &mut self.top;
        *sights = sights.saturating_add(1);
        *mean += (top_m - *mean) * (1.0 / f64::from(*sights)).max(FOLLOW_TOP);
    }

    /// How much speaks for somebody whose top is seen at a height (m, with variance) being the target, nats; 0 where too little is known.
    pub fn as_tall(&self, top_m: f64, var: f64) -> f64 {
        let (mean, sights) = self.top;
        if sights < KNOWN_TOP {
            return 0.0;
        }
        log_ratio_of_tops(top_m - mean, var + TOP_M * TOP_M)
    }

    /// How much speaks for somebody who looks like this being the target, nats; 0 where nothing is known.
    pub fn resemblance(&self, appearance: &Appearance) -> f64 {
        let sum: f64 = self.clothes.iter().map(|(_, known)| known.log_ratio(appearance)).sum();
        (sum / self.clothes.len().max(1) as f64).clamp(-MOST_LOOKS, MOST_LOOKS)
    }
}

/// How much a top so far from where somebody's is speaks for its being his, nats against anybody's.
fn log_ratio_of_tops(apart_m: f64, var: f64) -> f64 {
    let right = (-0.5 * apart_m * apart_m / var).exp() / (TAU * var).sqrt();
    ((1.0 - WRONG_TOP) * right / NEW_TOP + WRONG_TOP).ln()
}

impl Follower {
    /// Keeps the states of all targets that have been measured.
    pub(super) fn keep_past(&mut self) {
        let newest = self.newest;
        for f in self.targets.iter_mut().filter(|f| newest.seconds_since(f.state.last) < PRESENT_S) {
            f.past.keep(newest, f.state.target.position(), f.state.target.velocity());
        }
    }

    /// How much speaks for a target being at `position` with a top there, nats against anybody else.
    pub(super) fn resemblance(
        &self,
        known: &Followed,
        position: Vector2<f64>,
        top_m: Option<f64>,
        looks: &[Appearance],
    ) -> f64 {
        let by_place = known.past.log_density(position, self.newest) - NEW_PLACE.ln();
        let ((mean, var), seen) = known.state.target.top_m();
        let by_top = top_m.filter(|_| seen).map_or(0.0, |top| log_ratio_of_tops(top - mean, var + TOP_M * TOP_M));
        let by_looks: f64 = looks.iter().map(|a| known.looks.resemblance(a)).sum::<f64>() / looks.len().max(1) as f64;
        by_place + by_top + LOOKS_WORTH * by_looks
    }

    /// What tracks look like that tell it.
    pub(super) fn looks_of(tracks: &[(&Memory, Pose2)]) -> Vec<Appearance> {
        tracks.iter().filter_map(|(m, _)| m.appearance).collect()
    }

    /// The highest top that tracks show of something at `position`, metres above the floor.
    pub(super) fn top_of(tracks: &[(&Memory, Pose2)], position: Vector2<f64>) -> Option<f64> {
        let top = |(m, pose): &(&Memory, Pose2)| {
            let (elevation, _) = m.top?;
            Some(m.camera_height_m + (position - pose.position()).norm() * elevation.tan())
        };
        tracks.iter().filter_map(top).max_by(f64::total_cmp)
    }

    /// The number for something new at `position`: of a target that was lost and that it resembles, or a new one. `taken`
    /// says which targets are somewhere else for certain.
    pub(super) fn recognise(
        &mut self,
        position: Vector2<f64>,
        top_m: Option<f64>,
        looks: &[Appearance],
        taken: impl Fn(&Followed) -> bool,
    ) -> TargetId {
        let newest = self.newest;
        self.departed.retain(|d| newest.seconds_since(d.state.last) < REMEMBERED_S);
        let coasting = self.targets.iter().filter(|f| f.is_confirmed() && !taken(f));
        let found = coasting
            .chain(&self.departed)
            .map(|f| (self.resemblance(f, position, top_m, looks), f.id))
            .filter(|(nats, _)| *nats > 0.0)
            .max_by(|x, y| x.0.total_cmp(&y.0));
        if let Some((_, id)) = found {
            return id;
        }
        self.next_id += 1;
        TargetId(self.next_id - 1)
    }

    /// Remembers a target that is dropped.
    pub(super) fn remember_departed(&mut self, followed: Followed) {
        if self.departed.len() >= MAX_DEPARTED {
            self.departed.remove(0);
        }
        self.departed.push(followed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_walker_is_expected_ahead_and_the_last_wrong_state_does_not_count() {
        let at = |s: f64| Timestamp::from_secs_f64(1000.0 + s);
        let mut past = Past::default();
        for k in 0..10 {
            let t = 0.2 * f64::from(k);
            past.keep(at(t), Vector2::new(t, 0.0), Vector2::new(1.0, 0.0));
        }
        past.keep(at(2.0), Vector2::new(5.0, 5.0), Vector2::zeros());
        let density = |x: f64, y: f64| past.log_density(Vector2::new(x, y), at(2.1));
        assert!(density(2.1, 0.0) > density(1.2, 0.0) + 0.5);
        assert!(density(2.1, 0.0) > density(5.0, 5.0) + 3.0);
    }

    #[test]
    fn who_is_known_to_be_tall_is_not_who_shows_a_low_top() {
        let mut looks = Looks::default();
        for k in 0..KNOWN_TOP {
            assert_eq!(looks.as_tall(1.9, 0.002), 0.0, "after {k} sights");
            looks.see_top(if k % 2 == 0 { 1.88 } else { 1.92 });
        }
        let (own, others, hat) = (looks.as_tall(1.93, 0.002), looks.as_tall(1.6, 0.002), looks.as_tall(2.6, 0.002));
        assert!(own > 0.5 && others < -0.5, "{own} {others}");
        // One wrong end never says much.
        assert!(hat > -3.0, "{hat}");
    }
}
