//! Bodies are whole, and what is not whole is no body.
//!
//! A coat's patch of the wall's grey is a hole in a body: pixels of a row between two pieces of a region, with the region
//! above and below them. They are filled. The gap between legs is open below and stays. Moving leaves make regions that are
//! mostly gaps: pieces here and there, near enough to be one region, that fill less than half of what they span.

use super::raster::Raster;
use super::regions::{Region, Run};

/// Least share of the pixels between the first and the last of each row that a body fills.
const LEAST_FILLED: f64 = 0.5;

/// The region with its holes filled.
pub(super) fn filled(region: Region, raster: &Raster) -> Region {
    if !region.runs.windows(2).any(|pair| pair[0].row == pair[1].row) {
        return region;
    }
    let width = raster.width;
    let (arc, offset_of) = (region.arc, |start: usize| (start + width - region.arc.start) % width);
    // First and last row in each column: rows come from top to bottom, what is written last stays.
    let mut top = vec![u32::MAX; arc.width];
    let mut bottom = vec![0u32; arc.width];
    let columns_of = |run: &Run| {
        let offset = offset_of(run.start as usize);
        offset.min(arc.width)..(offset + run.len as usize).min(arc.width)
    };
    for run in &region.runs {
        bottom[columns_of(run)].fill(run.row);
    }
    for run in region.runs.iter().rev() {
        top[columns_of(run)].fill(run.row);
    }
    let mut holes: Vec<Run> = Vec::new();
    for_gaps(&region, raster, |row, gap| {
        let ends = top[gap.clone()].iter().zip(&bottom[gap.clone()]);
        let open = ends.fold(false, |open, (t, b)| open | (*t >= row as u32) | (*b <= row as u32));
        if !open {
            let start = (arc.start + gap.start) % width;
            let first = gap.len().min(width - start);
            let run = |start: usize, len: usize| Run { row: row as u32, start: start as u32, len: len as u32 };
            holes.push(run(start, first));
            if first < gap.len() {
                holes.push(run(0, gap.len() - first));
            }
        }
    });
    if holes.is_empty() {
        return region;
    }
    let mut runs = region.runs;
    runs.extend(holes);
    // Both were in order: such a sort merges them.
    runs.sort_by_key(|r| (r.row, r.start));
    // Neighbours become one.
    runs.dedup_by(|next, run| {
        let touch = run.row == next.row && run.start + run.len == next.start;
        if touch {
            run.len += next.len;
        }
        touch
    });
    Region::of_runs(runs, raster)
}

/// Whether a region fills enough of what it spans.
pub(super) fn is_solid(region: &Region, raster: &Raster) -> bool {
    let mut gaps = 0;
    for_gaps(region, raster, |_, gap| gaps += gap.len());
    region.area as f64 >= LEAST_FILLED * (region.area + gaps) as f64
}

/// The gaps between pieces of one row, as columns counted from the arc's first.
fn for_gaps(region: &Region, raster: &Raster, mut f: impl FnMut(usize, std::ops::Range<usize>)) {
    let mut row_runs: Vec<(usize, usize)> = Vec::new();
    for runs in region.runs.chunk_by(|a, b| a.row == b.row) {
        if runs.len() < 2 {
            continue;
        }
        row_runs.clear();
        row_runs.extend(runs.iter().map(|r| {
            let offset = (r.start as usize + raster.width - region.arc.start) % raster.width;
            (offset, offset + r.len as usize)
        }));
        row_runs.sort_unstable();
        for pair in row_runs.windows(2) {
            if pair[0].1 < pair[1].0 {
                f(runs[0].row as usize, pair[0].1..pair[1].0);
            }
        }
    }
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
            let body = filled(region(&["######", "##..##", "######", "##..##", "##..##"], at), &RING);
            assert_eq!(body.area, 6 + 6 + 6 + 4 + 4, "at {at}");
            assert_eq!((body.arc.start, body.arc.width), (at, 6));
        }
    }

    #[test]
    fn a_body_is_solid_and_scattered_leaves_are_not() {
        assert!(is_solid(&region(&["..##..", "######", "######", "##..##", "##..##"], 5), &RING));
        assert!(!is_solid(&region(&["#....#", "#...##", ".....#", "#....#"], 5), &RING));
    }
}
