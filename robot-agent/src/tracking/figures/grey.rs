//! Who of several people beside each other is who: where marks could be anybody's, each is where it looks like him.

use protocol::appearance::{Appearance, BAND_M};

use super::{Figure, Figures, Place, Rest, Sought};

/// What looks count beside marks ([`super::FULL_EVIDENCE`]): nats for a body all of which is seen, times the mean of the cells.
const LOOKS_EVIDENCE: f64 = 12.0;
/// Scatter of the logarithm of a cell's level about that of its band, and of anybody's.
const SAME: f32 = 0.3;
const ANYBODY: f32 = 0.7;
/// Nothing speaks more against somebody than this, nats a cell.
const MOST_AGAINST: f32 = -1.5;
/// Cover from which a cell is looked at.
const LEAST_COVER: f32 = 0.3;
/// Half of the room that two people need beside each other, metres: nearer, marks may be either's.
const BESIDE_M: f64 = 0.45;

impl Figures {
    /// For each whether somebody else is so near that marks may be either's.
    pub(super) fn contested(&self, sought: &[Sought<'_>]) -> Vec<bool> {
        let mut contested = vec![false; sought.len()];
        for a in 0..sought.len() {
            for b in 0..a {
                if self.are_near(&sought[a], &sought[b]) {
                    (contested[a], contested[b]) = (true, true);
                }
            }
        }
        contested
    }

    fn are_near(&self, a: &Sought<'_>, b: &Sought<'_>) -> bool {
        let room = |s: &Sought<'_>| self.columns_of(BESIDE_M, s.range_m) + s.column_sigma;
        self.raster.column_difference(a.column, b.column).abs() < room(a) + room(b)
    }

    /// Whether marks of one figure may be the other's.
    pub(in crate::tracking) fn are_beside(&self, a: &Figure, b: &Figure) -> bool {
        let room = |f: &Figure| self.columns_of(BESIDE_M, f.range_m);
        self.raster.column_difference(a.column, b.column).abs() < room(a) + room(b)
    }

    /// How much what is marked at a place, and not explained by others, looks like somebody, nats.
    pub(super) fn likeness(&self, place: &Place, looks: &Appearance, rest: &Rest) -> f64 {
        let s = &place.silhouette;
        let first = place.cell.rem_euclid(self.columns as i64) as usize + self.pad - s.half;
        let (stride, width) = (self.stride(), s.width());
        let best = (ANYBODY / SAME).ln();
        let (mut nats, mut all) = (0f32, 1e-3f32);
        for (row, cover) in s.cover.chunks_exact(width).enumerate() {
            let height = self.silhouettes.height_m(place.level, row);
            let band = if height >= 0.0 { looks.0.get((height / BAND_M) as usize).copied().flatten() } else { None };
            let at = row * stride + first;
            let Some(band) = band else {
                continue;
            };
            let cells = rest.marked[at..at + width].iter().zip(&self.log_grey[at..at + width]);
            for ((marked, grey), (c, weight)) in cells.zip(cover.iter().zip(&self.weight[at..at + width])) {
                if *c >= LEAST_COVER {
                    let away = (grey - band.log_level as f32) / SAME;
                    nats += c * marked * (best - 0.5 * away * away).max(MOST_AGAINST);
                    all += c * weight;
                }
            }
        }
        LOOKS_EVIDENCE * f64::from(nats / all)
    }
}
