//! How far the seen axis of a person's track may be from the person's.
//!
//! Problem: an axis is a centimetre off where somebody walks by himself in the middle of a room, and a quarter of a metre where a
//! shadow was taken for a body, where shelves look like a part of one, or where others hide it. One sigma for all says too much of the
//! one and too little of the other. Insight: how somebody is seen tells which it is. Algorithm: the logarithm of the error's variance is a
//! weighed sum of traits, with weights for each state of a track by gamma regression (maximum of Σ −ln σ² − e²/σ²; McCullagh & Nelder,
//! "Generalized Linear Models", 1989, chapter 8) over 52,000 bearings of eight runs of the default scenario (seeds 0 … 7) and, half as heavy, of the
//! motion cases `approach` and `stroll` (seeds 100 … 111), where somebody is alone. Fitted to one half of the runs, e²/σ² of the other half is 0.8 and 1.5
//! visible, 1.1 and 1.3 merged, 1.0 and 1.0 hidden in the exam, and 0.8 and 1.0 of visible people who are alone.

use protocol::message::{ElevationEnd, TrackState};
use protocol::time::Timestamp;

use super::people::SHOULDERS_M;
use super::track::Track;
use super::{Extent, Tracker};

/// Told sigmas are within these, metres.
const SIGMA_M: [f64; 2] = [0.012, 0.6];
/// Height of a top that is nobody's wrong end, metres.
const TOP_M: f64 = 1.75;
/// Logarithms of the distances from which on errors grow with it, and up to which they grow with nearness.
const FAR_LOG_M: f64 = 1.1;
const CLOSE_LOG_M: f64 = 0.4;
/// Whoever is nearer and within so much aside stands in front, metres.
const ASIDE_M: f64 = 0.8;
/// How far aside the next person is, metres: nearer and farther ones count as these.
const BESIDE_M: [f64; 2] = [0.2, 3.0];
/// Recent innovations follow the present one by this part.
const FOLLOW: f64 = 0.2;

/// How somebody was seen last.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Manner {
    /// Share of the figure that nobody covers or is covered by.
    pub(super) apart: f64,
    /// How well the figure fits.
    pub(super) support: f64,
    /// From the fitted figure's axis to that of its own pixels, metres.
    pub(super) aside_m: f64,
}

/// What a track's sightings say of each other.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Agreement {
    manner: Manner,
    /// Mean of the last innovations of the axis, metres.
    wander_m: f64,
}

impl Agreement {
    /// Of somebody new.
    pub(super) fn of(manner: Manner) -> Self {
        Self { manner, ..Self::default() }
    }

    /// One more sighting, `innovation_m` from where it was expected.
    pub(super) fn see(&mut self, manner: Manner, innovation_m: f64) {
        self.wander_m += FOLLOW * (innovation_m.abs() - self.wander_m);
        self.manner = manner;
    }
}

impl Tracker {
    /// Sigma of the axis to be told, metres.
    pub(super) fn told_sigma_m(&self, track: &Track, extent: &Extent, now: Timestamp) -> f64 {
        (0.5 * self.log_variance(track, extent, now)).exp().clamp(SIGMA_M[0], SIGMA_M[1])
    }

    fn log_variance(&self, track: &Track, extent: &Extent, now: Timestamp) -> f64 {
        let column_m = SHOULDERS_M / track.trunk_width.max(1.0);
        let range_m = track.log_range.exp();
        let Agreement { manner, wander_m } = track.agreement;
        let end = |end| f64::from(u8::from(extent.ends[1] == end));
        let aside_a_column_m = self.view.steps_rad(track.axis, self.raster.height as f64 / 2.0)[0] * range_m;
        let aside_m =
            |o: &Track| aside_a_column_m * self.raster.column_difference(o.filter.column, track.filter.column).abs();
        let others = || self.tracks.iter().filter(|o| o.id != track.id && o.confirmed);
        let in_front = others().any(|o| aside_m(o) < ASIDE_M && o.log_range < track.log_range);
        let nearest_m = others().map(aside_m).fold(BESIDE_M[1], f64::min);

        let near = track.log_range;
        let far = (track.log_range - FAR_LOG_M).max(0.0);
        let joined = 1.0 - manner.apart.clamp(0.0, 1.0);
        let wander = wander_m.clamp(0.005, 0.3).ln();
        let stuck = (-track.travelled.min(1e6) * column_m / 0.3).exp();
        let young = (-now.seconds_since(track.born) / 2.0).exp();
        let speed = (track.filter.rate * column_m).abs().min(1.5);
        let in_front = f64::from(u8::from(in_front));
        let room = nearest_m.max(BESIDE_M[0]).ln();
        if track.state == TrackState::Hidden {
            let predicted = (track.filter.sigma() * column_m).clamp(0.01, 0.5).ln();
            return -1.189
                + 0.42 * near
                + 0.833 * far
                + 0.388 * joined
                + 0.5 * wander
                + 1.33 * stuck
                + 0.937 * young
                + 0.133 * speed
                + 0.381 * in_front
                + 0.296 * predicted
                - 0.468 * track.evidence.clamp(-0.5, 1.0)
                + 1.5 * room;
        }
        let broad = (track.arc.width as f64 * column_m).clamp(0.2, 1.6);
        let still = 1.0 - (-now.seconds_since(track.moved) / 0.5).exp();
        let fits = manner.support.min(0.6);
        if track.state == TrackState::Merged {
            return -1.413
                + 0.398 * near
                + 1.222 * far
                + 1.005 * joined
                + 0.694 * wander
                + 2.564 * stuck
                + 1.06 * young
                + 0.096 * speed
                - 0.199 * broad
                + 1.101 * still
                - 0.678 * fits
                + 1.414 * room;
        }
        let (cut, hidden) = (end(ElevationEnd::Cut), end(ElevationEnd::Hidden));
        let fits_alone = if others().next().is_none() { fits } else { 0.0 };
        let close = (CLOSE_LOG_M - track.log_range).max(0.0);
        let aside = manner.aside_m.abs().min(0.3);
        let top_m = self.view.angles_rad(track.axis, track.rows[0] as f64 - 0.5).zip(self.view.height_m);
        let top_m = top_m.map_or(TOP_M, |((_, elevation), (camera_m, _))| camera_m + range_m * elevation.tan());
        let tall = end(ElevationEnd::Seen) * (top_m - TOP_M).clamp(-1.0, 0.5);
        -6.009 - 0.83 * near
            + 0.763 * close
            + 3.747 * far
            + 1.409 * joined
            + 0.528 * wander
            + 5.167 * stuck
            + 0.917 * young
            - 0.219 * speed
            + 0.473 * in_front
            + 4.016 * broad
            + 0.83 * still
            - 3.415 * fits
            - 0.739 * fits_alone
            + 0.796 * cut
            + 1.25 * hidden
            + 10.866 * aside
            - 0.674 * tall
    }
}
