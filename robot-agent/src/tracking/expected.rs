//! Where the team says that people are: figures are looked for there, and measured as ever.

use protocol::id::TrackId;
use protocol::time::Timestamp;

use super::Tracker;
use super::figures::{Shape, Sought};
use super::track::Track;

/// Further from what a track itself predicts, the team means somebody else, standard deviations.
const ANOTHER: f64 = 3.0;
/// By how much sigmas of columns and distances are widened: the robot's own bearings are among what the team goes by.
const SHARED: [f64; 2] = [2.0, 1.5];
/// Least sigma of the logarithm of a distance that others have measured.
const LEAST_LOG_RANGE_SIGMA: f64 = 0.05;
/// Somebody within so many metres to the side of a track, and about as far away (difference of logarithms), may be that track.
const SAME_M: f64 = 0.35;
const SAME_LOG_RANGE: f64 = 0.35;
/// Whose distance is known to so much is seen by others, too, standard deviation in metres.
const VOUCHED_M: f64 = 0.3;
/// People further away are not missed, metres.
const FURTHEST_M: f64 = 6.0;

/// Somebody whom the team sees, in this robot's body frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Expected {
    /// The robot's own track that is he, as far as the team knows.
    pub track: Option<TrackId>,
    /// Bearing and its sigma, radians.
    pub bearing_rad: f64,
    /// See there.
    pub bearing_sigma_rad: f64,
    /// Distance along the floor, metres, and the sigma of its logarithm.
    pub range_m: f64,
    /// See there.
    pub log_range_sigma: f64,
}

impl Tracker {
    /// Who should be where in the next frame; until the next call.
    pub fn expect(&mut self, people: Vec<Expected>) {
        self.expected = people;
    }

    /// Where a track's figure should be, by itself and by the team.
    pub(super) fn sought<'a>(&self, track: &'a Track) -> Sought<'a> {
        let own = track.sought();
        let known = self.expected.iter().find(|e| e.track == Some(track.id));
        let Some(told) = known.and_then(|e| self.told(e, own.shape)) else { return own };
        let away = self.raster.column_difference(told.column, own.column);
        if away.abs() > ANOTHER * told.column_sigma.hypot(own.column_sigma) {
            return own;
        }
        let (column, column_sigma) = joined((0.0, own.column_sigma), (away, told.column_sigma));
        let (log_range, log_range_sigma) =
            joined((own.range_m.ln(), own.log_range_sigma), (told.range_m.ln(), told.log_range_sigma));
        Sought {
            column: self.raster.wrap_column(own.column + column),
            column_sigma: column_sigma.max(1.0),
            range_m: log_range.exp(),
            log_range_sigma,
            known_range: true,
            ..own
        }
    }

    /// Those whom others see and none of the tracks `sought` may be.
    pub(super) fn missed<'a>(&self, sought: &[Sought<'_>], anybody: &'a Shape) -> Vec<Sought<'a>> {
        let followed = |id: TrackId| self.tracks.iter().any(|t| t.id == id);
        let alone = |told: &Sought<'_>| {
            let room = (SAME_M / told.range_m).atan() / self.column_rad(told.column);
            // Who is covered himself speaks for nobody who is seen.
            let shown = sought.iter().zip(&self.tracks).filter(|(_, track)| !track.behind);
            !shown.map(|(s, _)| s).any(|s| {
                let aside = self.raster.column_difference(s.column, told.column).abs();
                aside < room + s.column_sigma.min(room) && (s.range_m / told.range_m).ln().abs() < SAME_LOG_RANGE
            })
        };
        let unseen = self.expected.iter().filter(|e| e.range_m < FURTHEST_M && !e.track.is_some_and(followed));
        unseen.filter_map(|e| self.told(e, anybody)).filter(alone).collect()
    }

    /// Notes of the tracks which of them the team sees, too: they are people though they do not move. A place that only this
    /// robot's bearings tell is not sure enough for that.
    pub(super) fn vouch(&mut self, now: Timestamp) {
        let sure = |e: &&Expected| e.range_m < FURTHEST_M && e.log_range_sigma * e.range_m < VOUCHED_M;
        let seen: Vec<(Option<TrackId>, f64, f64, f64)> = (self.expected.iter().filter(sure))
            .filter_map(|e| {
                let column = self.view.column_of_bearing(e.bearing_rad)?;
                Some((e.track, column, (SAME_M / e.range_m).atan() / self.column_rad(column), e.range_m.ln()))
            })
            .collect();
        for (known, column, room, log_range) in seen {
            let track = match known {
                Some(id) => self.tracks.iter_mut().find(|t| t.id == id),
                None => {
                    let aside = |t: &Track| self.raster.column_difference(t.filter.column, column).abs();
                    let near = |t: &&mut Track| {
                        !t.confirmed && aside(t) < room && (t.log_range - log_range).abs() < SAME_LOG_RANGE
                    };
                    self.tracks.iter_mut().filter(near).min_by(|a, b| aside(a).total_cmp(&aside(b)))
                }
            };
            if let Some(track) = track.filter(|t| t.misses == 0) {
                (track.vouched, track.vouched_hits) = (now, track.vouched_hits.saturating_add(1));
            }
        }
    }

    /// As the figures are looked for; `None` in an image.
    fn told<'a>(&self, expected: &Expected, shape: &'a Shape) -> Option<Sought<'a>> {
        let column = self.view.column_of_bearing(expected.bearing_rad)?;
        Some(Sought {
            column,
            column_sigma: (SHARED[0] * expected.bearing_sigma_rad / self.column_rad(column)).max(1.0),
            range_m: expected.range_m,
            log_range_sigma: SHARED[1] * expected.log_range_sigma.max(LEAST_LOG_RANGE_SIGMA),
            known_range: true,
            shape,
            seniority: 0,
            looks: None,
        })
    }

    fn column_rad(&self, column: f64) -> f64 {
        self.view.steps_rad(column, self.raster.height as f64 / 2.0)[0]
    }
}

/// Two values with their sigmas as one.
fn joined(a: (f64, f64), b: (f64, f64)) -> (f64, f64) {
    let gain = a.1.powi(2) / (a.1.powi(2) + b.1.powi(2));
    (a.0 + gain * (b.0 - a.0), a.1 * (1.0 - gain).sqrt())
}
