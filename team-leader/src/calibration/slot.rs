//! One place where one standing robot sees another, averaged.
//!
//! ```text
//!  first sighting ──▶ growing (mean of all frames that fit) ──▶ ended: the observer or the peer moves, or forgotten
//! ```
//!
//! The last half second is kept apart: a robot notices its own motion late, and what was seen in between must not spoil
//! the mean of the place it left.

use std::collections::VecDeque;

use protocol::angle::wrap;
use protocol::time::Timestamp;

/// How late a robot may notice that it moves, seconds.
pub const NOTICE_S: f64 = 0.5;
/// Most sightings kept apart.
const MAX_PENDING: usize = 64;
/// A sighting further from the mean than this many sigmas belongs elsewhere.
const GATE_SIGMAS: f64 = 5.0;

/// One sighting of a fellow robot: bearing, and apparent width of the reference cylinder (from its range) where known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sighted {
    /// In the observer's body frame, radians.
    pub bearing_rad: f64,
    /// Variance, rad².
    pub bearing_var: f64,
    /// Width, and its variance, rad and rad².
    pub width_rad: Option<(f64, f64)>,
    /// Variances that a single frame states for bearing and width: what does not average out is a part of them.
    pub frame_var: (f64, f64),
    /// Who it is, where the marker says so.
    pub robot: Option<usize>,
}

impl Sighted {
    /// Squared distances of two sightings in sigmas: by bearing, and by width where both have one.
    pub fn squares(&self, other: &Self, floor_var: f64) -> (f64, Option<f64>) {
        let away_rad = wrap(other.bearing_rad - self.bearing_rad);
        let by_bearing = away_rad * away_rad / (other.bearing_var + self.bearing_var + floor_var);
        let widths = other.width_rad.zip(self.width_rad);
        (by_bearing, widths.map(|((a, va), (b, vb))| (a - b) * (a - b) / (va + vb + floor_var)))
    }

    /// This frame as the `n`th of the same view, with variances for a filter that takes each frame for independent: of n frames
    /// with white variance w and a lasting one f the mean has w/n + f, so the nth adds 1/(w/n + f) − 1/(w/(n−1) + f).
    /// `floored` has w + f.
    pub fn nth(&self, floored: &Self, n: u32) -> Self {
        let n = f64::from(n);
        let var = |white: f64, sum: f64| {
            let white = white.max(1e-3 * sum);
            let lasting = (sum - white).max(0.0);
            (white + n * lasting) * (white + (n - 1.0) * lasting) / white
        };
        let widths = self.width_rad.zip(floored.width_rad);
        Self {
            bearing_var: var(self.bearing_var, floored.bearing_var),
            width_rad: widths.map(|((width, white), (_, sum))| (width, var(white, sum))),
            ..*self
        }
    }
}

/// The mean of a slot; variances are of the white part alone.
pub type SlotMean = Sighted;

/// A place where an observer sees a robot.
#[derive(Debug, Clone)]
pub struct Slot {
    /// Who it is, as far as the team knows.
    pub name: Option<usize>,
    /// Who it is, as the marker says.
    pub told: Option<usize>,
    /// When it was seen first and last, leader's clock.
    pub first: Timestamp,
    /// See `first`.
    pub last: Timestamp,
    /// How far from the mean it was seen last, whether that fits or not.
    pub off: Option<Off>,
    reference_rad: f64,
    bearing: Sums,
    width: Sums,
    pending: VecDeque<(Timestamp, Sighted)>,
}

/// How far from a slot's mean its robot was seen: χ² and its degrees of freedom.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Off {
    /// When.
    pub at: Timestamp,
    /// See [`Off`].
    pub chi2: f64,
    /// See [`Off`].
    pub n: u32,
}

/// Weighted sums for mean and scatter.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    n: u32,
    w: f64,
    wx: f64,
    wxx: f64,
}

impl Sums {
    fn add(&mut self, x: f64, var: f64) {
        let w = 1.0 / var;
        self.n += 1;
        self.w += w;
        self.wx += w * x;
        self.wxx += w * x * x;
    }

    /// Mean and its variance. Sightings that scatter more than their sigmas say raise it.
    fn mean(&self) -> Option<(f64, f64)> {
        if self.n == 0 {
            return None;
        }
        let mean = self.wx / self.w;
        let excess =
            if self.n < 5 { 1.0 } else { ((self.wxx - self.w * mean * mean) / f64::from(self.n - 1)).max(1.0) };
        Some((mean, excess / self.w))
    }
}

impl Slot {
    /// A slot of one sighting.
    pub fn new(at: Timestamp, sighted: Sighted) -> Self {
        let mut slot = Self {
            name: None,
            told: sighted.robot,
            first: at,
            last: at,
            off: None,
            reference_rad: sighted.bearing_rad,
            bearing: Sums::default(),
            width: Sums::default(),
            pending: VecDeque::new(),
        };
        slot.add(at, sighted);
        slot
    }

    /// One more sighting that fits.
    pub fn add(&mut self, at: Timestamp, sighted: Sighted) {
        self.last = self.last.max(at);
        self.told = self.told.or(sighted.robot);
        self.pending.push_back((at, sighted));
        while let Some(&(then, old)) = self.pending.front()
            && (at.seconds_since(then) > NOTICE_S || self.pending.len() > MAX_PENDING)
        {
            let _ = self.pending.pop_front();
            commit(&mut self.bearing, &mut self.width, self.reference_rad, old);
        }
    }

    /// Squared distance of a sighting from the mean in sigmas, worst coordinate; `None` outside the gate.
    pub fn distance2(&self, sighted: &Sighted, floor_var: f64) -> Option<f64> {
        let (by_bearing, by_width) = self.mean().squares(sighted, floor_var);
        let worst = by_width.map_or(by_bearing, |by_width| by_bearing.max(by_width));
        (self.may_show(sighted) && worst < GATE_SIGMAS * GATE_SIGMAS).then_some(worst)
    }

    /// Whether the marker that was sighted says nothing against it.
    pub fn may_show(&self, sighted: &Sighted) -> bool {
        self.told.is_none() || sighted.robot.is_none() || self.told == sighted.robot
    }

    /// How many sightings it has.
    pub fn count(&self) -> u32 {
        self.bearing.n + self.pending.len() as u32
    }

    /// The mean of everything, up to now.
    pub fn mean(&self) -> SlotMean {
        let (mut bearing, mut width) = (self.bearing, self.width);
        for &(_, sighted) in &self.pending {
            commit(&mut bearing, &mut width, self.reference_rad, sighted);
        }
        self.mean_of(&bearing, &width)
    }

    /// The mean of what was seen for certain before a motion that was noticed at `noticed`; `None` if there is nothing.
    pub fn mean_before(&self, noticed: Timestamp) -> Option<SlotMean> {
        let (mut bearing, mut width) = (self.bearing, self.width);
        for &(at, sighted) in &self.pending {
            if noticed.seconds_since(at) > NOTICE_S {
                commit(&mut bearing, &mut width, self.reference_rad, sighted);
            }
        }
        (bearing.n > 0).then(|| self.mean_of(&bearing, &width))
    }

    fn mean_of(&self, bearing: &Sums, width: &Sums) -> SlotMean {
        let (offset_rad, bearing_var) = bearing.mean().unwrap_or((0.0, 1.0));
        let single = |sums: &Sums| if sums.n == 0 { 0.0 } else { f64::from(sums.n) / sums.w };
        Sighted {
            bearing_rad: wrap(self.reference_rad + offset_rad),
            bearing_var,
            width_rad: width.mean(),
            frame_var: (single(bearing), single(width)),
            robot: self.told,
        }
    }
}

fn commit(bearing: &mut Sums, width: &mut Sums, reference_rad: f64, sighted: Sighted) {
    bearing.add(wrap(sighted.bearing_rad - reference_rad), sighted.bearing_var);
    if let Some((w, var)) = sighted.width_rad {
        width.add(w, var);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(s: f64) -> Timestamp {
        Timestamp::from_secs_f64(1000.0 + s)
    }

    fn sighted(bearing_rad: f64) -> Sighted {
        Sighted { bearing_rad, bearing_var: 1e-6, width_rad: Some((0.2, 4e-6)), frame_var: (1e-6, 4e-6), robot: None }
    }

    #[test]
    fn the_mean_of_a_slot_behind_the_robot_does_not_break_at_the_seam() {
        let mut slot = Slot::new(at(0.0), sighted(std::f64::consts::PI - 0.001));
        slot.add(at(0.1), sighted(0.001 - std::f64::consts::PI));
        assert!(wrap(slot.mean().bearing_rad - std::f64::consts::PI).abs() < 1e-6);
        assert!((slot.mean().bearing_var - 5e-7).abs() < 1e-12);
    }

    #[test]
    fn what_was_seen_after_the_motion_began_is_left_out() {
        let mut slot = Slot::new(at(0.0), sighted(0.0));
        for k in 1..20 {
            slot.add(at(0.1 * f64::from(k)), sighted(0.0));
        }
        slot.add(at(2.0), sighted(0.004));
        assert!(slot.mean().bearing_rad > 1e-4);
        assert_eq!(slot.mean_before(at(2.1)).unwrap().bearing_rad, 0.0);
        assert!(Slot::new(at(0.0), sighted(0.0)).mean_before(at(0.1)).is_none());
    }

    #[test]
    fn scatter_beyond_the_stated_sigma_raises_the_variance() {
        let mut slot = Slot::new(at(0.0), sighted(0.003));
        for k in 1..20 {
            slot.add(at(0.1 * f64::from(k)), sighted(if k % 2 == 0 { 0.003 } else { -0.003 }));
        }
        assert!(slot.mean().bearing_var > 5.0 * 1e-6 / 20.0);
    }

    #[test]
    fn frames_of_one_view_never_know_more_than_their_lasting_error_leaves() {
        let frame = sighted(0.0);
        let lasting = 4e-6;
        let floored = Sighted { bearing_var: 1e-6 + lasting, width_rad: Some((0.2, 8e-6)), ..frame };
        let var = |n: u32| (1..=n).map(|k| frame.nth(&floored, k).bearing_var.recip()).sum::<f64>().recip();
        assert!((var(1) - 5e-6).abs() < 1e-15);
        assert!((var(10) - (1e-7 + lasting)).abs() < 1e-15);
        assert!(var(10_000) > lasting);
    }

    #[test]
    fn a_sighting_elsewhere_is_refused() {
        let slot = Slot::new(at(0.0), sighted(0.0));
        assert!(slot.distance2(&sighted(0.001), 0.0).is_some());
        assert!(slot.distance2(&sighted(0.02), 0.0).is_none());
    }
}
