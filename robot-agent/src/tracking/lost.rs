//! People who stood still when they were lost: whoever walks past covers them, and they do not move when they are seen again.
//!
//! A new track needs motion, for what stands still since nobody came is furniture. Somebody who was followed to where he
//! stands needs none: a figure that is found there again is he, until his looks say otherwise (see [`super::looks`]). The
//! background does not learn there meanwhile.

use protocol::id::TrackId;
use protocol::time::Timestamp;

use super::looks::Looks;
use super::track::Track;
use crate::motion::{Patch, Raster};

/// How long a place is remembered after somebody was last seen standing there, seconds.
const REMEMBERED_S: f64 = 8.0;
/// Most places.
const MOST: usize = 16;
/// How far from the place a figure may be found: in shoulders' breadths, and as a ratio of distances (logarithm).
const NEAR: f64 = 0.7;
const NEAR_LOG_RANGE: f64 = 0.4;

/// Where somebody was last seen apart from others and standing.
#[derive(Debug, Clone, Copy)]
pub(super) struct Stand {
    pub(super) at: Timestamp,
    pub(super) column: f64,
    pub(super) log_range: f64,
    pub(super) patch: Patch,
}

/// Somebody who stood there and is not followed any more.
#[derive(Debug, Clone)]
pub(super) struct Lost {
    pub(super) id: TrackId,
    pub(super) looks: Looks,
    stand: Stand,
    breadth: f64,
}

/// All of them.
#[derive(Debug, Clone, Default)]
pub(super) struct LostPeople(Vec<Lost>);

impl LostPeople {
    /// Remembers a track that ends, if it stood of late.
    pub(super) fn note(&mut self, track: &Track, now: Timestamp) {
        self.forget(now);
        let Some(stand) = track.stand.filter(|s| now.seconds_since(s.at) < REMEMBERED_S) else { return };
        if track.confirmed && track.has_come() && self.0.len() < MOST {
            let mut looks = track.looks.clone();
            looks.doubt();
            self.0.push(Lost { id: track.id, looks, stand, breadth: track.trunk_width });
        }
    }

    /// Takes out who stood where a figure is found now.
    pub(super) fn take(&mut self, column: f64, range_m: f64, now: Timestamp, raster: &Raster) -> Option<Lost> {
        self.forget(now);
        let away = |l: &Lost| raster.column_difference(column, l.stand.column).abs() / l.breadth.max(1.0);
        let fits = |l: &Lost| away(l) < NEAR && (range_m.ln() - l.stand.log_range).abs() < NEAR_LOG_RANGE;
        let (k, _) =
            self.0.iter().enumerate().filter(|(_, l)| fits(l)).min_by(|a, b| away(a.1).total_cmp(&away(b.1)))?;
        Some(self.0.swap_remove(k))
    }

    /// Where they stood.
    pub(super) fn patches(&self) -> impl Iterator<Item = Patch> + '_ {
        self.0.iter().map(|l| l.stand.patch)
    }

    /// Nobody is remembered any more.
    pub(super) fn clear(&mut self) {
        self.0.clear();
    }

    fn forget(&mut self, now: Timestamp) {
        self.0.retain(|l| now.seconds_since(l.stand.at) < REMEMBERED_S);
    }
}
