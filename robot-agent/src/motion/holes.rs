//! Bodies are whole, and what is not whole is no body.
//!
//! A coat's patch of the wall's grey is a hole in a body: pixels of a row between two pieces of a region, with the region
//! above and below them. They are filled. The gap between legs is open below and stays. Moving leaves make regions that are
//! mostly gaps: pieces here and there, near enough to be one region, that fill less than half of what they span.

use std::ops::Range;

use super::marks::{WORD, bits_between, mark_between};
use super::raster::Raster;
use super::regions::{Region, Run};

/// Least share of the pixels between the first and the last of each row that a body fills.
const LEAST_FILLED: f64 = 0.5;

/// Fills holes, with its working memory. Columns are counted from the first one of a region's arc, and are bits.
#[derive(Debug, Default)]
pub(super) struct Holes {
    /// For each row of a region from the first one of several pieces on, and below its last one: columns in which something of it is
    /// there or lower.
    below: Vec<u64>,
    /// Columns in which something of it is higher than a row.
    above: Vec<u64>,
    /// The pieces of a row, from left to right in the arc.
    pieces: Vec<Range<usize>>,
    /// The rows of a region of at most 64 columns.
    rows: Vec<u64>,
}

impl Holes {
    /// The region with its holes filled; `None` if even so it does not fill enough of what it spans.
    pub(super) fn fill(&mut self, region: Region, raster: &Raster) -> Option<Region> {
        let arc = region.arc;
        if arc.width <= WORD && arc.start + arc.width <= raster.width {
            return self.fill_narrow(region, raster);
        }
        self.fill_wide(region, raster)
    }

    fn fill_wide(&mut self, region: Region, raster: &Raster) -> Option<Region> {
        let arc = region.arc;
        let is_divided = |pair: &[Run]| pair[0].row == pair[1].row;
        let Some(first) = region.runs.windows(2).position(is_divided) else { return Some(region) };
        // Nothing is filled above the first row of several pieces, and below the last one.
        let end = region.runs.windows(2).rposition(is_divided).map_or(first, |last| last + 2);
        let (top, words) = (region.runs[first].row, arc.width.div_ceil(WORD));
        let columns_of = |run: &Run| {
            let offset = run.offset(arc.start, raster.width);
            offset.min(arc.width)..(offset + run.len as usize).min(arc.width)
        };
        self.note_below(&region.runs[first..], words, columns_of);
        self.above.clear();
        self.above.resize(words, 0);
        let mut runs = Vec::with_capacity(region.runs.len());
        runs.extend_from_slice(&region.runs[..first]);
        region.runs[..first].iter().for_each(|run| mark_between(&mut self.above, columns_of(run)));
        let mut gaps = 0;
        for row_runs in region.runs[first..end].chunk_by(|a, b| a.row == b.row) {
            let row = row_runs[0].row;
            if let [run] = row_runs {
                runs.push(*run);
                mark_between(&mut self.above, columns_of(run));
                continue;
            }
            let first = runs.len();
            runs.extend_from_slice(row_runs);
            let below = &self.below[((row - top) as usize + 1) * words..][..words];
            self.pieces.clear();
            self.pieces.extend(row_runs.iter().map(columns_of));
            self.pieces.sort_unstable_by_key(|piece| piece.start);
            let between = self.pieces.windows(2).map(|pair| pair[0].end..pair[1].start);
            for gap in between.filter(|gap| !gap.is_empty()) {
                let open = |w: usize| bits_between(w, gap.start, gap.end) & !(self.above[w] & below[w]) != 0;
                if (gap.start / WORD..gap.end.div_ceil(WORD)).any(open) {
                    gaps += gap.len();
                    continue;
                }
                let start = raster.column(arc.start, gap.start);
                let run = |start: usize, len: usize| Run { row, start: start as u32, len: len as u32 };
                let length = gap.len().min(raster.width - start);
                runs.push(run(start, length));
                if length < gap.len() {
                    runs.push(run(0, gap.len() - length));
                }
            }
            join_neighbours(&mut runs, first);
            for run in row_runs {
                mark_between(&mut self.above, columns_of(run));
            }
        }
        runs.extend_from_slice(&region.runs[end..]);
        let region = region.with_runs(runs, raster);
        is_solid(&region, gaps).then_some(region)
    }

    /// The same where a row is a word, as in most bodies, and the region is not over the seam.
    fn fill_narrow(&mut self, region: Region, raster: &Raster) -> Option<Region> {
        let (top, start) = (region.rows[0], region.arc.start);
        let Self { rows, below, .. } = self;
        rows.clear();
        rows.resize(region.height(), 0);
        for run in &region.runs {
            let offset = (run.start as usize).saturating_sub(start);
            rows[run.row as usize - top] |= bits_between(0, offset, offset + run.len as usize);
        }
        // Nothing is filled above the first row with a gap, and below the last one.
        let is_divided = |row: &u64| gap_of(*row) != 0;
        let Some(first) = rows.iter().position(is_divided) else { return Some(region) };
        let end = rows.iter().rposition(is_divided).map_or(first, |last| last + 1);
        let in_rows = |end: usize| region.runs.partition_point(|run| (run.row as usize) < top + end);
        let (upper, lower) = (&region.runs[..in_rows(first)], &region.runs[in_rows(end)..]);
        // Of each row: what is lower.
        below.clear();
        below.resize(rows.len(), 0);
        let mut lower_rows = rows[end..].iter().fold(0, |all, row| all | row);
        for (below, row) in below[first..end].iter_mut().zip(&rows[first..end]).rev() {
            *below = lower_rows;
            lower_rows |= row;
        }
        let (mut above, mut gaps) = (rows[..first].iter().fold(0, |all, row| all | row), 0);
        let mut runs = Vec::with_capacity(region.runs.len());
        runs.extend_from_slice(upper);
        for (y, (row, below)) in ((top + first) as u32..).zip(rows[first..end].iter().zip(&below[first..end])) {
            let mut whole = *row;
            for gap in pieces(gap_of(*row)) {
                if gap & !(above & *below) == 0 {
                    whole |= gap;
                } else {
                    gaps += gap.count_ones() as usize;
                }
            }
            above |= row;
            runs.extend(pieces(whole).map(|piece| Run {
                row: y,
                start: start as u32 + piece.trailing_zeros(),
                len: piece.count_ones(),
            }));
        }
        runs.extend_from_slice(lower);
        let region = region.with_runs(runs, raster);
        is_solid(&region, gaps).then_some(region)
    }

    /// Of the rows of some runs from the first one's on.
    fn note_below(&mut self, runs: &[Run], words: usize, columns_of: impl Fn(&Run) -> Range<usize>) {
        let (Some(first), Some(last)) = (runs.first(), runs.last()) else { return };
        let rows = (last.row - first.row) as usize + 1;
        self.below.clear();
        self.below.resize((rows + 1) * words, 0);
        for run in runs {
            let row = (run.row - first.row) as usize;
            mark_between(&mut self.below[row * words..][..words], columns_of(run));
        }
        for i in (0..rows * words).rev() {
            self.below[i] |= self.below[i + words];
        }
    }
}

/// Whether a region fills enough of what it spans.
fn is_solid(region: &Region, gaps: usize) -> bool {
    region.area as f64 >= LEAST_FILLED * (region.area + gaps) as f64
}

/// What is between the first and the last of a row, and not in it.
#[inline(always)]
fn gap_of(row: u64) -> u64 {
    // All from the lowest bit on, less all above the highest.
    let from_first = row | row.wrapping_neg();
    let to_last = u64::MAX.checked_shr(row.leading_zeros()).unwrap_or(0);
    from_first & to_last & !row
}

/// The pieces of a row, from its first.
fn pieces(mut row: u64) -> impl Iterator<Item = u64> {
    std::iter::from_fn(move || {
        // Added its lowest bit the first piece becomes the bit after it.
        let piece = row & !row.wrapping_add(row & row.wrapping_neg());
        row &= !piece;
        (piece != 0).then_some(piece)
    })
}

/// Puts the runs of one row, from `first` on, in order; neighbours become one.
fn join_neighbours(runs: &mut Vec<Run>, first: usize) {
    runs[first..].sort_unstable_by_key(|r| r.start);
    let mut kept = first;
    for i in first + 1..runs.len() {
        let run = runs[i];
        if runs[kept].start + runs[kept].len == run.start {
            runs[kept].len += run.len;
        } else {
            kept += 1;
            runs[kept] = run;
        }
    }
    runs.truncate(kept + 1);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::group;

    const RING: Raster = Raster { width: 40, height: 20, wraps: true };

    fn region(rows: &[&str], at: usize) -> Region {
        let mut mask = vec![0u8; RING.len()];
        for (y, row) in rows.iter().enumerate() {
            for (x, c) in row.bytes().enumerate() {
                mask[(y + 2) * RING.width + (at + x) % RING.width] = u8::from(c == b'#');
            }
        }
        group(&mask, &RING, [2, 2], 1).remove(0)
    }

    #[test]
    fn a_hole_is_filled_and_the_gap_between_legs_is_not_also_on_the_seam() {
        for at in [5, 37] {
            let body = region(&["######", "##..##", "######", "##..##", "##..##"], at);
            let body = Holes::default().fill(body, &RING).unwrap();
            assert_eq!(body.area, 6 + 6 + 6 + 4 + 4, "at {at}");
            assert_eq!((body.arc.start, body.arc.width), (at, 6));
        }
    }

    #[test]
    fn narrow_and_wide_regions_are_filled_alike() {
        use rand::{Rng, SeedableRng};
        let raster = Raster { width: 80, height: 30, wraps: true };
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(15);
        let (mut filled, mut scattered) = (0, 0);
        for n in 0..300 {
            // Dense ones have holes, thin ones are scattered.
            let marked_of_8 = 1 + n % 6;
            let is_marked =
                |x: usize, y: usize, r: u32| (8..70).contains(&x) && (3..27).contains(&y) && r % 8 < marked_of_8;
            let mask: Vec<u8> =
                (0..raster.len()).map(|i| u8::from(is_marked(i % 80, i / 80, rng.next_u32() >> 8))).collect();
            for region in group(&mask, &raster, [1, 1], 20) {
                let area = region.area;
                let narrow = Holes::default().fill_narrow(region.clone(), &raster);
                assert_eq!(narrow, Holes::default().fill_wide(region, &raster));
                filled += usize::from(narrow.as_ref().is_some_and(|narrow| narrow.area > area));
                scattered += usize::from(narrow.is_none());
            }
        }
        assert!(filled > 50 && scattered > 20, "{filled} {scattered}");
    }

    #[test]
    fn a_body_is_solid_and_scattered_leaves_are_not() {
        let fill = |rows: &[&str]| Holes::default().fill(region(rows, 5), &RING);
        assert!(fill(&["..##..", "######", "######", "##..##", "##..##"]).is_some());
        assert!(fill(&["#....#", "#...##", ".....#", "#....#"]).is_none());
    }
}
