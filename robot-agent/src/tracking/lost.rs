//! People who stood still when they were lost: whoever walks past covers them, and they do not move when they are seen again.
//!
//! A new track needs motion, for what stands still since nobody came is furniture. Somebody who was followed to where he
//! stands needs none: a figure that is found there again is he, until his looks say otherwise (see [`super::looks`]). The
//! background does not learn there meanwhile.
//!
//! And people who were last behind others: whoever comes out near there and looks like one of them is he.

use protocol::id::TrackId;
use protocol::time::Timestamp;

use super::looks::Looks;
use super::track::{Sighting, Track};
use crate::motion::{Patch, Raster};

/// How long a place is remembered after somebody was last seen standing there, seconds.
const REMEMBERED_S: f64 = 8.0;
/// How long somebody who is behind others is remembered, seconds.
const BEHIND_S: f64 = 6.0;
/// Most places.
const MOST: usize = 16;
/// How far from the place a figure may be found: in shoulders' breadths, and as a ratio of distances (logarithm).
const NEAR: f64 = 0.7;
const NEAR_LOG_RANGE: f64 = 0.4;
/// The same ratio of somebody who was behind others: how far away he was is known badly.
const BEHIND_LOG_RANGE: f64 = 0.6;
/// Whoever is seen anew is somebody lost if he looks so much like him, nats.
const ALIKE: f64 = 0.5;

/// Where somebody was last seen apart from others and standing.
#[derive(Debug, Clone, Copy)]
pub(super) struct Stand {
    pub(super) at: Timestamp,
    pub(super) column: f64,
    pub(super) log_range: f64,
    pub(super) patch: Patch,
}

/// Somebody who stood there, or went behind others there, and is not followed any more.
#[derive(Debug, Clone)]
pub(super) struct Lost {
    pub(super) id: TrackId,
    pub(super) looks: Looks,
    stand: Stand,
    breadth: f64,
    /// He was behind others.
    behind: bool,
}

impl Lost {
    fn is_over(&self, now: Timestamp) -> bool {
        now.seconds_since(self.stand.at) >= if self.behind { BEHIND_S } else { REMEMBERED_S }
    }
}

/// All of them.
#[derive(Debug, Clone, Default)]
pub(super) struct LostPeople(Vec<Lost>);

impl LostPeople {
    /// Remembers a track that ends, if it stood of late or was with others.
    pub(super) fn note(&mut self, track: &Track, now: Timestamp) {
        self.forget(now);
        let stood = track.stand.filter(|s| now.seconds_since(s.at) < REMEMBERED_S);
        let hidden = || {
            let known = track.looks.in_doubt() && track.looks.firm().is_some();
            let (column, log_range, patch) = (track.filter.column, track.log_range, track.patch());
            known.then_some(Stand { at: now, column, log_range, patch })
        };
        let Some(stand) = stood.or_else(hidden) else { return };
        if track.confirmed && track.has_come() && self.0.len() < MOST {
            let mut looks = track.looks.clone();
            looks.doubt();
            self.0.push(Lost { id: track.id, looks, stand, breadth: track.trunk_width, behind: stood.is_none() });
        }
    }

    /// Takes out who stood where a figure is found now, or else who went behind others within `reach` columns and looks like it.
    pub(super) fn take(&mut self, found: &Sighting, reach: f64, now: Timestamp, raster: &Raster) -> Option<Lost> {
        let (k, _) = self.best(found, reach, now, raster)?;
        Some(self.0.swap_remove(k))
    }

    /// How much the one that [`Self::take`] would give looks like the figure, nats.
    pub(super) fn alike(&self, found: &Sighting, reach: f64, now: Timestamp, raster: &Raster) -> Option<f64> {
        Some(self.best(found, reach, now, raster)?.1)
    }

    fn best(&self, found: &Sighting, reach: f64, now: Timestamp, raster: &Raster) -> Option<(usize, f64)> {
        let away = |l: &Lost| raster.column_difference(found.axis, l.stand.column).abs();
        let farther = |l: &Lost| (found.range_m.ln() - l.stand.log_range).abs();
        let places = |l: &Lost| away(l) / l.breadth.max(1.0);
        let stands = |l: &Lost| !l.behind && places(l) < NEAR && farther(l) < NEAR_LOG_RANGE;
        let all = || self.0.iter().enumerate().filter(|(_, l)| !l.is_over(now));
        let stood = all().filter(|(_, l)| stands(l)).min_by(|a, b| places(a.1).total_cmp(&places(b.1)));
        let alike = |l: &Lost| l.looks.firm().map_or(f64::NEG_INFINITY, |known| found.appearance.log_ratio(known));
        let comes_out = |l: &Lost| l.behind && away(l) < reach && farther(l) < BEHIND_LOG_RANGE && alike(l) > ALIKE;
        let hidden = || all().filter(|(_, l)| comes_out(l)).max_by(|a, b| alike(a.1).total_cmp(&alike(b.1)));
        stood.or_else(hidden).map(|(k, l)| (k, alike(l)))
    }

    /// Columns where they were.
    pub(super) fn columns(&self) -> impl Iterator<Item = f64> + '_ {
        self.0.iter().map(|l| l.stand.column)
    }

    /// Where they stood.
    pub(super) fn patches(&self) -> impl Iterator<Item = Patch> + '_ {
        self.0.iter().filter(|l| !l.behind).map(|l| l.stand.patch)
    }

    /// Nobody is remembered any more.
    pub(super) fn clear(&mut self) {
        self.0.clear();
    }

    /// Those who were lost too long ago are not remembered any more.
    pub(super) fn forget(&mut self, now: Timestamp) {
        self.0.retain(|l| !l.is_over(now));
    }
}
