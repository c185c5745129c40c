//! Connected regions of a mask on a ring.
//!
//! Two pixels belong together when their squares of (2g_x+1) × (2g_y+1) touch (8-connected): the report's dilation and
//! labelling in one (`MATHS.md` §7.5). The squares are drawn 64 pixels a word, their runs joined row by row; a region is the runs
//! of the mask in the runs of one set of squares: work by the number of runs, not of pixels.
//! The box is the minimal covering arc: the complement of the longest stretch of empty columns. Golden group `grouping`.

use std::ops::Range;

use super::kernel;
use super::marks::{Marks, WORD, mark_between};
use super::raster::{Arc, Raster};

/// Most runs looked at in one mask; later ones (lower in the picture) are left out.
pub const MAX_RUNS: usize = 1 << 16;

/// A connected region.
#[derive(Debug, Clone, PartialEq)]
pub struct Region {
    /// Number of its pixels in the mask.
    pub area: usize,
    /// Minimal covering arc of its columns.
    pub arc: Arc,
    /// First and last row.
    pub rows: [usize; 2],
    /// Mean column (unrolled from `arc.start`, so it may exceed the width on a ring) and mean row.
    pub centroid: [f64; 2],
    /// Its runs in the order of rows.
    pub(crate) runs: Vec<Run>,
}

impl Region {
    /// The pieces of rows it consists of: (row, first column, number of columns), in the order of rows.
    pub fn spans(&self) -> impl Iterator<Item = (usize, usize, usize)> + '_ {
        self.runs.iter().map(|r| (r.row as usize, r.start as usize, r.len as usize))
    }

    /// Number of rows it spans.
    pub fn height(&self) -> usize {
        self.rows[1] - self.rows[0] + 1
    }

    /// A region from the runs of several; in the order of rows.
    pub fn joined(parts: &[&Self], raster: &Raster) -> Self {
        let mut runs: Vec<Run> = parts.iter().flat_map(|p| p.runs.iter().copied()).collect();
        runs.sort_by_key(|r| (r.row, r.start));
        Self::of_runs(runs, raster)
    }

    /// The part of a region in some of its arc's columns, counted from the arc's first; `None` where nothing is there.
    pub fn columns(&self, columns: Range<usize>, raster: &Raster) -> Option<Self> {
        let mut runs = Vec::new();
        for run in &self.runs {
            let offset = (run.start as usize + raster.width - self.arc.start) % raster.width;
            let from = offset.max(columns.start);
            let to = (offset + run.len as usize).min(columns.end);
            if from < to {
                runs.push(Run { row: run.row, start: run.start + (from - offset) as u32, len: (to - from) as u32 });
            }
        }
        (!runs.is_empty()).then(|| Self::of_runs(runs, raster))
    }

    /// All pixels of a box (left, top, width, height); columns may run over the seam of a ring. `None` outside the picture.
    pub fn of_box([x, y, w, h]: [f64; 4], raster: &Raster) -> Option<Self> {
        let whole = |v: f64, most: usize| v.round().clamp(0.0, most as f64) as usize;
        let rows = whole(y, raster.height)..whole(y + h, raster.height);
        let arc = if raster.wraps {
            Arc { start: raster.wrap_column(x).floor() as usize % raster.width, width: whole(w, raster.width).max(1) }
        } else {
            let (start, end) = (whole(x, raster.width), whole(x + w, raster.width));
            Arc { start, width: end.saturating_sub(start) }
        };
        if rows.is_empty() || arc.width == 0 {
            return None;
        }
        let first = arc.width.min(raster.width - arc.start);
        let pieces = [(0, arc.width - first), (arc.start, first)];
        let runs = rows.flat_map(|row| {
            let run = move |(start, len): (usize, usize)| Run { row: row as u32, start: start as u32, len: len as u32 };
            pieces.into_iter().filter(|(_, len)| *len > 0).map(run)
        });
        Some(Self::of_runs(runs.collect(), raster))
    }

    /// From runs in the order of rows; at least one.
    pub(crate) fn of_runs(runs: Vec<Run>, raster: &Raster) -> Self {
        Self::from_runs(runs, raster, &mut Vec::new())
    }

    fn from_runs(runs: Vec<Run>, raster: &Raster, columns: &mut Vec<u64>) -> Self {
        let mut sums = Sums::default();
        let (mut first, mut end) = (u32::MAX, 0);
        for r in &runs {
            (first, end) = (first.min(r.start), end.max(r.start + r.len));
            sums.add(r);
        }
        let width = end.saturating_sub(first) as usize;
        // Nothing inside half a ring is wider than what is outside.
        if 0 < width && 2 * width <= raster.width {
            return Self::of_arc(runs, Arc { start: first as usize, width }, &sums, raster);
        }
        columns.clear();
        columns.resize(raster.width.div_ceil(WORD), 0);
        runs.iter().for_each(|r| mark_between(columns, r.start as usize..(r.start + r.len) as usize));
        let arc = covering_arc(columns, raster);
        Self::of_arc(runs, arc, &sums, raster)
    }

    /// The same columns and rows with other runs, in the order of rows.
    pub(super) fn with_runs(self, runs: Vec<Run>, raster: &Raster) -> Self {
        let mut sums = Sums::default();
        runs.iter().for_each(|run| sums.add(run));
        Self::of_arc(runs, self.arc, &sums, raster)
    }

    /// From runs, the arc that they cover, and the sums over them.
    fn of_arc(runs: Vec<Run>, arc: Arc, sums: &Sums, raster: &Raster) -> Self {
        let Sums { area, rows, columns } = *sums;
        // Those beyond the seam come after those before it.
        let is_beyond = |run: &&Run| (run.start as usize) < arc.start;
        let is_over_seam = arc.start + arc.width > raster.width;
        let beyond = if is_over_seam { runs.iter().filter(is_beyond).map(|run| run.len as usize).sum() } else { 0 };
        let twice = columns + 2 * raster.width * beyond;
        let n = area.max(1) as f64;
        let offset = (twice as f64 - 2.0 * (area * arc.start) as f64) / 2.0 / n;
        let centroid = [arc.start as f64 + offset, rows as f64 / n];
        let rows = [runs.first().map_or(0, |r| r.row as usize), runs.last().map_or(0, |r| r.row as usize)];
        Self { area, arc, rows, centroid, runs }
    }
}

/// Over the pixels of runs.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    /// How many there are.
    area: usize,
    rows: usize,
    /// Twice the sum of their columns.
    columns: usize,
}

impl Sums {
    #[inline(always)]
    fn add(&mut self, run: &Run) {
        let [row, start, len] = [run.row, run.start, run.len].map(|n| n as usize);
        self.area += len;
        self.rows += len * row;
        self.columns += len * (2 * start + len.saturating_sub(1));
    }
}

/// Consecutive marked pixels of one row; never crosses the seam.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Run {
    pub(crate) row: u32,
    pub(crate) start: u32,
    pub(crate) len: u32,
}

impl Run {
    /// The column of its first pixel, counted from column `start` of a ring of `width`.
    #[inline(always)]
    pub(super) fn offset(&self, start: usize, width: usize) -> usize {
        let column = self.start as usize;
        if column >= start { column - start } else { column + width - start }
    }
}

/// The regions of a mask (0 or 1 a pixel) with at least `min_area` pixels, in the order of their first pixel.
/// `gap` is (g_x, g_y): half the distance that is bridged.
pub fn group(mask: &[u8], raster: &Raster, gap: [usize; 2], min_area: usize) -> Vec<Region> {
    Grouping::default().group(&Marks::of_bytes(mask, *raster), raster, gap, min_area)
}

/// Groups marks, with its working memory.
#[derive(Debug, Default)]
pub(super) struct Grouping {
    runs: Runs,
    /// The squares of all marked pixels, and their runs.
    squares: Vec<u64>,
    spread: Vec<u64>,
    square_runs: Runs,
    /// Of the runs of squares.
    parent: Vec<u32>,
    /// Of the region whose first run of squares this is.
    sizes: Vec<Size>,
    /// Which run of squares is the first of the region of each run.
    roots: Vec<u32>,
    columns: Vec<u64>,
}

/// How large a region is.
#[derive(Debug, Clone, Copy, Default)]
struct Size {
    area: usize,
    runs: usize,
    /// Its place among those that are large enough, once it has one.
    place: Option<u32>,
}

/// Runs in the order of rows.
#[derive(Debug, Default)]
struct Runs {
    all: Vec<Run>,
    /// Index of the first run of each row, and the number of runs.
    row_starts: Vec<usize>,
}

impl Grouping {
    /// See [`group`].
    pub(super) fn group(&mut self, mask: &Marks, raster: &Raster, gap: [usize; 2], min_area: usize) -> Vec<Region> {
        find_runs(mask.words(), raster, &mut self.runs);
        if self.runs.all.is_empty() {
            return Vec::new();
        }
        self.draw_squares(mask, raster, gap);
        find_runs(&self.squares, raster, &mut self.square_runs);
        let Self { runs, square_runs, parent, sizes, roots, columns, .. } = self;
        parent.clear();
        parent.extend(0..square_runs.all.len() as u32);
        join_touching(square_runs, raster, parent);
        // No parent comes after its child: one pass makes each a root.
        for i in 0..parent.len() {
            parent[i] = parent[parent[i] as usize];
        }
        sizes.clear();
        sizes.resize(parent.len(), Size::default());
        roots.clear();
        for_roots(runs, square_runs, parent, raster, |run, root| {
            roots.push(root);
            let size = &mut sizes[root as usize];
            size.area += run.len as usize;
            size.runs += 1;
        });
        let mut members: Vec<Vec<Run>> = Vec::new();
        for (run, root) in runs.all.iter().zip(roots) {
            let size = &mut sizes[*root as usize];
            if size.area < min_area.max(1) {
                continue;
            }
            // Regions have their places in the order of first pixels.
            let place = *size.place.get_or_insert_with(|| {
                members.push(Vec::with_capacity(size.runs));
                members.len() as u32 - 1
            });
            members[place as usize].push(*run);
        }
        members.into_iter().map(|runs| Region::from_runs(runs, raster, columns)).collect()
    }

    /// The squares of (2g_x+1) × (2g_y+1) round all marked pixels.
    fn draw_squares(&mut self, mask: &Marks, raster: &Raster, gap: [usize; 2]) {
        let stride = mask.stride();
        let Self { spread, squares, .. } = self;
        spread.resize(mask.words().len(), 0);
        squares.resize(mask.words().len(), 0);
        spread.copy_from_slice(mask.words());
        for _ in 0..gap[0] {
            kernel::spread_by_one(spread, stride, raster.width, raster.wraps, squares);
            std::mem::swap(spread, squares);
        }
        kernel::spread_over_rows(spread, stride, gap[1], squares);
    }
}

/// Each run with the root of the run of squares that it lies in, in order. Squares are cut off where there are too many of them: runs
/// that lie in none are left out.
fn for_roots(runs: &Runs, squares: &Runs, roots: &[u32], raster: &Raster, mut f: impl FnMut(Run, u32)) {
    for y in 0..raster.height {
        let mut square = squares.row_starts[y];
        for run in &runs.all[runs.row_starts[y]..runs.row_starts[y + 1]] {
            while squares.all.get(square).is_some_and(|s| s.row == run.row && s.start + s.len <= run.start) {
                square += 1;
            }
            if square >= squares.row_starts[y + 1] {
                return;
            }
            f(*run, roots[square]);
        }
    }
}

kernel::wide! {
fn find_runs(words: &[u64], raster: &Raster, runs: &mut Runs) {
    let stride = raster.width.div_ceil(WORD);
    let Runs { all, row_starts } = runs;
    all.clear();
    row_starts.clear();
    for (y, row) in words.chunks_exact(stride).enumerate() {
        row_starts.push(all.len());
        // Most of a mask is empty.
        if row.iter().fold(0, |any, word| any | word) == 0 {
            continue;
        }
        let mut add = |start: usize, end: usize| {
            if all.len() < MAX_RUNS {
                all.push(Run { row: y as u32, start: start as u32, len: (end - start) as u32 });
            }
        };
        // First column of a run that has not ended yet.
        let mut open: Option<usize> = None;
        let mut next = 0;
        while let Some(&word) = row.get(next) {
            let column = next * WORD;
            next += 1;
            if word == 0 && open.is_none() {
                while row.get(next..next + 4).is_some_and(|four| four.iter().fold(0, |any, word| any | word) == 0) {
                    next += 4;
                }
                continue;
            }
            let mut bits = word;
            if let Some(start) = open {
                let more = bits.trailing_ones() as usize;
                if more == WORD {
                    continue;
                }
                add(start, column + more);
                open = None;
                bits = bits >> more << more;
            }
            while bits != 0 {
                let first = bits.trailing_zeros() as usize;
                // Added its lowest bit a run becomes the bit after it.
                let after = bits.wrapping_add(1 << first);
                let start = column + first;
                if after == 0 {
                    open = Some(start);
                    break;
                }
                add(start, column + after.trailing_zeros() as usize);
                bits &= after;
            }
        }
        if let Some(start) = open {
            add(start, raster.width);
        }
    }
    row_starts.push(all.len());
}
}

/// Joins runs that touch, also by a corner.
fn join_touching(runs: &Runs, raster: &Raster, parent: &mut [u32]) {
    let Runs { all, row_starts } = runs;
    let last_column = raster.width as u32 - 1;
    let ends = |row: &Range<usize>| all[row.clone()].first().zip(all[row.clone()].last());
    // Whether two runs touch over the seam.
    let over_seam = |left: &Run, right: &Run| left.start == 0 && right.start + right.len == last_column + 1;
    for y in 0..raster.height {
        let here = row_starts[y]..row_starts[y + 1];
        let Some((first, last)) = ends(&here) else { continue };
        if raster.wraps && over_seam(first, last) {
            join(parent, here.end as u32 - 1, here.start as u32);
        }
        let above = row_starts[y.saturating_sub(1)]..row_starts[y];
        let Some((first_above, last_above)) = ends(&above) else { continue };
        let (mut i, mut j) = (here.start, above.start);
        while i < here.end && j < above.end {
            let (run, other) = (&all[i], &all[j]);
            let (end, other_end) = (run.start + run.len, other.start + other.len);
            if other.start <= end && run.start <= other_end {
                if parent[i] == i as u32 {
                    // Nothing is joined to it yet; all above come before it.
                    parent[i] = find(parent, j as u32);
                } else {
                    join(parent, i as u32, j as u32);
                }
            }
            if end < other_end {
                i += 1;
            } else {
                j += 1;
            }
        }
        if raster.wraps {
            if over_seam(first, last_above) {
                join(parent, here.start as u32, above.end as u32 - 1);
            }
            if over_seam(first_above, last) {
                join(parent, here.end as u32 - 1, above.start as u32);
            }
        }
    }
}

fn find(parent: &mut [u32], mut i: u32) -> u32 {
    while parent[i as usize] != i {
        parent[i as usize] = parent[parent[i as usize] as usize];
        i = parent[i as usize];
    }
    i
}

/// Makes one of the two sets; its root.
fn join(parent: &mut [u32], a: u32, b: u32) -> u32 {
    let (a, b) = (find(parent, a), find(parent, b));
    // The smaller index stays root, so labels keep the order of first pixels.
    let (root, other) = (a.min(b), a.max(b));
    parent[other as usize] = root;
    root
}

/// The first column from `from` on that is marked, or that is not; the width where there is none.
fn next_column(columns: &[u64], from: usize, marked: bool, width: usize) -> usize {
    let flip = if marked { 0 } else { u64::MAX };
    let mut below = from % WORD;
    for (w, word) in columns.iter().enumerate().skip(from / WORD) {
        let found = (word ^ flip) >> below << below;
        if found != 0 {
            return (w * WORD + found.trailing_zeros() as usize).min(width);
        }
        below = 0;
    }
    width
}

/// The complement of the longest stretch of empty columns (the first of equals).
fn covering_arc(columns: &[u64], raster: &Raster) -> Arc {
    let w = raster.width;
    let first = next_column(columns, 0, true, w);
    let Some(last) = columns.iter().rposition(|&word| word != 0) else { return Arc { start: 0, width: 1 } };
    let last = last * WORD + WORD - 1 - columns[last].leading_zeros() as usize;
    if !raster.wraps {
        return Arc { start: first, width: last - first + 1 };
    }
    // The empty stretch over the seam, then those between.
    let (mut best, mut best_end) = (first + w - 1 - last, first);
    let mut x = next_column(columns, first, false, w);
    while x < last {
        let end = next_column(columns, x, true, w);
        if end - x > best {
            (best, best_end) = (end - x, end);
        }
        x = next_column(columns, end, false, w);
    }
    Arc { start: best_end % w, width: w - best }
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};

    use super::*;
    use crate::motion::golden;

    fn golden_mask() -> (Vec<u8>, Raster) {
        let golden = golden("grouping");
        let rows = golden["inputs"]["mask"].as_array().unwrap();
        let mask: Vec<u8> =
            rows.iter().flat_map(|r| r.as_str().unwrap().bytes().map(|b| u8::from(b == b'#'))).collect();
        (mask, Raster { width: 24, height: rows.len(), wraps: true })
    }

    fn labels(regions: &[Region], raster: &Raster) -> Vec<u64> {
        let mut out = vec![0; raster.len()];
        for (i, r) in regions.iter().enumerate() {
            for (row, start, len) in r.spans() {
                out[row * raster.width + start..][..len].fill(i as u64 + 1);
            }
        }
        out
    }

    #[test]
    fn grouping_over_the_seam_equals_the_golden_labels() {
        let (mask, raster) = golden_mask();
        let golden = golden("grouping");
        for (gap, key) in [(0, "labels_gap0"), (1, "labels_gap1")] {
            let regions = group(&mask, &raster, [gap, gap], 1);
            let want: Vec<u64> = golden["outputs"][key]
                .as_array()
                .unwrap()
                .iter()
                .flat_map(|r| r.as_array().unwrap().iter().map(|v| v.as_u64().unwrap()))
                .collect();
            assert_eq!(labels(&regions, &raster), want, "{key}");
        }
    }

    #[test]
    fn boxes_are_minimal_arcs_and_centroids_unroll_from_their_start() {
        let (mask, raster) = golden_mask();
        let regions = group(&mask, &raster, [1, 1], 1);
        let golden = golden("grouping");
        for (region, want) in regions.iter().zip(golden["outputs"]["regions_gap1"].as_array().unwrap()) {
            let pair = |k: &str| [want[k][0].as_f64().unwrap(), want[k][1].as_f64().unwrap()];
            assert_eq!(region.area as u64, want["area"].as_u64().unwrap());
            assert_eq!([region.arc.start as f64, region.arc.width as f64], pair("arc"));
            assert_eq!(region.rows.map(|r| r as f64), pair("rows"));
            for (a, b) in region.centroid.iter().zip(pair("centroid")) {
                assert!((a - b).abs() < 1e-9, "{a} {b}");
            }
        }
    }

    /// Pixels of one region by the definition: |Δx| ≤ 2g_x+1 and |Δy| ≤ 2g_y+1, one after the other.
    fn by_definition(mask: &[u8], raster: &Raster, [gx, gy]: [usize; 2], least: usize) -> Vec<Vec<usize>> {
        let mut left: Vec<usize> = (0..mask.len()).filter(|i| mask[*i] != 0).collect();
        let mut regions = Vec::new();
        while !left.is_empty() {
            let mut region = vec![left.remove(0)];
            let mut next = 0;
            while let Some(&p) = region.get(next) {
                next += 1;
                left.retain(|q| {
                    let dx = (p % raster.width).abs_diff(q % raster.width);
                    let dx = if raster.wraps { dx.min(raster.width - dx) } else { dx };
                    let near = dx <= 2 * gx + 1 && (p / raster.width).abs_diff(q / raster.width) <= 2 * gy + 1;
                    if near {
                        region.push(*q);
                    }
                    !near
                });
            }
            region.sort_unstable();
            regions.extend((region.len() >= least).then_some(region));
        }
        regions
    }

    #[test]
    fn regions_are_what_the_definition_says_at_any_width_and_gap() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(6);
        for n in 0..120 {
            let raster = Raster { width: [20, 64, 65, 130][n % 4], height: 17, wraps: n % 3 > 0 };
            let gap = [n % 5, n / 5 % 4];
            let mask: Vec<u8> = (0..raster.len()).map(|_| u8::from(rng.next_u32() % 40 == 0)).collect();
            let least = 1 + n % 3;
            let found: Vec<Vec<usize>> = group(&mask, &raster, gap, least)
                .iter()
                .map(|r| r.spans().flat_map(|(row, start, len)| (0..len).map(move |k| (row, start + k))))
                .map(|pixels| pixels.map(|(row, x)| row * raster.width + x).collect())
                .collect();
            assert_eq!(found, by_definition(&mask, &raster, gap, least), "{raster:?} {gap:?}");
        }
    }

    #[test]
    fn turning_the_picture_turns_the_regions() {
        let raster = Raster { width: 60, height: 20, wraps: true };
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        for _ in 0..200 {
            let mask: Vec<u8> = (0..raster.len()).map(|_| u8::from(rng.next_u32() % 16 == 0)).collect();
            let shift = rng.next_u32() as usize % raster.width;
            let mut turned = vec![0; raster.len()];
            for y in 0..raster.height {
                for x in 0..raster.width {
                    turned[y * raster.width + (x + shift) % raster.width] = mask[y * raster.width + x];
                }
            }
            let mut a: Vec<_> = group(&mask, &raster, [1, 1], 1)
                .iter()
                .map(|r| (r.area, (r.arc.start + shift) % raster.width, r.arc.width, r.rows))
                .collect();
            let mut b: Vec<_> =
                group(&turned, &raster, [1, 1], 1).iter().map(|r| (r.area, r.arc.start, r.arc.width, r.rows)).collect();
            a.sort_unstable();
            b.sort_unstable();
            // Arcs with two longest gaps may start at either.
            let key = |v: &[(usize, usize, usize, [usize; 2])]| v.iter().map(|r| (r.0, r.2, r.3)).collect::<Vec<_>>();
            let (mut ka, mut kb) = (key(&a), key(&b));
            ka.sort_unstable();
            kb.sort_unstable();
            assert_eq!(ka, kb);
        }
    }
}
