//! One picture of the recent past: everybody at several places of the way, never over themselves (`MATHS.md` §7.9, golden
//! group `synopsis`).

use std::collections::{BTreeMap, VecDeque};

use protocol::id::TrackId;

use crate::motion::{Patch, Raster, Scene};
use crate::tracking::TrackView;

/// Most cut-outs kept; the oldest go first.
pub const MAX_CUTOUTS: usize = 200;

/// Pixels to which the room for a cut-out is rounded up.
const ROOM: usize = 1024;

/// Whether the object is pasted again: its box does not overlap the one last pasted.
pub fn is_pasted(last: Option<&Patch>, now: &Patch, raster: &Raster) -> bool {
    last.is_none_or(|last| {
        let apart_in_rows = last.rows[1] < now.rows[0] || now.rows[1] < last.rows[0];
        apart_in_rows || last.arc.overlap(&now.arc, raster) == 0
    })
}

/// The cut-outs of the recent past.
#[derive(Debug, Default)]
pub(crate) struct Synopsis {
    last: BTreeMap<TrackId, Patch>,
    pub(crate) cutouts: VecDeque<Cutout>,
}

/// An object's pixels at one instant.
#[derive(Debug)]
pub(crate) struct Cutout {
    pub(crate) track: TrackId,
    pub(crate) patch: Patch,
    /// Row by row over the patch; 0 in `mask` where it is not the object.
    pub(crate) gray: Vec<u8>,
    pub(crate) mask: Vec<u8>,
}

impl Synopsis {
    pub(crate) fn record(&mut self, scene: &Scene<'_>, tracks: &[&TrackView]) {
        for track in tracks {
            let patch = Patch { arc: track.arc, rows: track.rows };
            if is_pasted(self.last.get(&track.id), &patch, scene.raster) {
                self.last.insert(track.id, patch);
                self.cutouts.push_back(Cutout::of(scene, track.id, patch));
            }
        }
        while self.cutouts.len() > MAX_CUTOUTS {
            self.cutouts.pop_front();
        }
        // Tracks are never numbered again: those whose cut-outs are gone are over.
        if self.last.len() > 2 * MAX_CUTOUTS {
            let oldest = self.cutouts.iter().map(|c| c.track).min();
            self.last.retain(|id, _| oldest.is_none_or(|o| *id >= o));
        }
    }
}

impl Cutout {
    pub(crate) fn of(scene: &Scene<'_>, track: TrackId, patch: Patch) -> Self {
        let mut cutout = Self { track, patch, gray: Vec::new(), mask: Vec::new() };
        cutout.take(scene, patch);
        cutout
    }

    /// The object at another instant.
    pub(crate) fn take(&mut self, scene: &Scene<'_>, patch: Patch) {
        self.patch = patch;
        // Over the seam in two pieces.
        let first = patch.arc.width.min(scene.raster.width - patch.arc.start);
        let pieces = [patch.arc.start..patch.arc.start + first, 0..patch.arc.width - first];
        for (from, to) in [(scene.picture, &mut self.gray), (scene.mask, &mut self.mask)] {
            // Some room, so that a box that grows a little needs no more.
            to.clear();
            to.reserve(patch.area().next_multiple_of(ROOM));
            for row in from.chunks_exact(scene.raster.width).take(patch.rows[1] + 1).skip(patch.rows[0]) {
                pieces.iter().for_each(|piece| to.extend_from_slice(&row[piece.clone()]));
            }
        }
    }

    /// Pastes the object into a picture.
    pub(crate) fn paste(&self, raster: &Raster, picture: &mut [u8]) {
        let pixels = self.gray.iter().zip(&self.mask);
        for (k, (&gray, _)) in pixels.enumerate().filter(|(_, (_, m))| **m != 0) {
            let (row, offset) = (self.patch.rows[0] + k / self.patch.arc.width, k % self.patch.arc.width);
            picture[row * raster.width + raster.column(self.patch.arc.start, offset)] = gray;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::{Arc, golden};

    #[test]
    fn a_walker_over_the_seam_is_pasted_in_the_golden_frames() {
        let golden = golden("synopsis");
        let raster = Raster { width: golden["inputs"]["W"].as_u64().unwrap() as usize, height: 162, wraps: true };
        let mut last = None;
        let mut pasted = Vec::new();
        for (i, b) in golden["inputs"]["boxes"].as_array().unwrap().iter().enumerate() {
            let v = |a: usize, b_: usize| b[a][b_].as_u64().unwrap() as usize;
            let patch = Patch { arc: Arc { start: v(0, 0), width: v(0, 1) }, rows: [v(1, 0), v(1, 0) + v(1, 1) - 1] };
            if is_pasted(last.as_ref(), &patch, &raster) {
                pasted.push(i as u64);
                last = Some(patch);
            }
        }
        let want: Vec<u64> = golden["outputs"].as_array().unwrap().iter().map(|v| v.as_u64().unwrap()).collect();
        assert_eq!(pasted, want);
    }
}
