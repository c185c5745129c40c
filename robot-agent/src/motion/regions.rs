//! Connected regions of a mask on a ring.
//!
//! Two pixels belong together when their squares of (2g_x+1) × (2g_y+1) touch (8-connected): the report's dilation and
//! labelling in one (`MATHS.md` §7.5). Touching squares are the same as |Δx| ≤ 2g_x+1 and |Δy| ≤ 2g_y+1, so it is enough to
//! join *runs* of the mask's rows that are that close: no dilated picture, and work by the number of runs, not of pixels.
//! The box is the minimal covering arc: the complement of the longest stretch of empty columns. Golden group `grouping`.

use super::marks::{Marks, WORD};
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
    pub fn columns(&self, columns: std::ops::Range<usize>, raster: &Raster) -> Option<Self> {
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

    fn from_runs(runs: Vec<Run>, raster: &Raster, columns: &mut Vec<u8>) -> Self {
        columns.clear();
        columns.resize(raster.width, 0);
        let (mut area, mut sum_y) = (0usize, 0usize);
        for r in &runs {
            columns[r.start as usize..(r.start + r.len) as usize].fill(1);
            area += r.len as usize;
            sum_y += r.len as usize * r.row as usize;
        }
        let arc = covering_arc(columns, raster);
        let mut sum_x = 0.0;
        for r in &runs {
            let offset = (r.start as usize + raster.width - arc.start) % raster.width;
            sum_x += f64::from(r.len) * (offset as f64 + (f64::from(r.len) - 1.0) / 2.0);
        }
        let rows = [runs.first().map_or(0, |r| r.row as usize), runs.last().map_or(0, |r| r.row as usize)];
        let n = area.max(1) as f64;
        Self { area, arc, rows, centroid: [arc.start as f64 + sum_x / n, sum_y as f64 / n], runs }
    }
}

/// Consecutive marked pixels of one row; never crosses the seam.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Run {
    pub(crate) row: u32,
    pub(crate) start: u32,
    pub(crate) len: u32,
}

/// The regions of a mask (0 or 1 a pixel) with at least `min_area` pixels, in the order of their first pixel.
/// `gap` is (g_x, g_y): half the distance that is bridged.
pub fn group(mask: &[u8], raster: &Raster, gap: [usize; 2], min_area: usize) -> Vec<Region> {
    Grouping::default().group(&Marks::of_bytes(mask, *raster), raster, gap, min_area)
}

/// Groups marks, with its working memory.
#[derive(Debug, Default)]
pub(super) struct Grouping {
    runs: Vec<Run>,
    /// Index of the first run of each row, and the number of runs.
    row_starts: Vec<usize>,
    parent: Vec<u32>,
    /// Pixels of the region whose first run this is, and its place among those that are large enough.
    areas: Vec<usize>,
    columns: Vec<u8>,
}

impl Grouping {
    /// See [`group`].
    pub(super) fn group(&mut self, mask: &Marks, raster: &Raster, gap: [usize; 2], min_area: usize) -> Vec<Region> {
        find_runs(mask, raster, &mut self.runs, &mut self.row_starts);
        let Self { runs, row_starts, parent, areas, columns } = self;
        parent.clear();
        parent.extend(0..runs.len() as u32);
        join_near_runs(runs, row_starts, raster, gap, parent);
        areas.clear();
        areas.resize(runs.len(), 0);
        for i in 0..runs.len() {
            let root = find(parent, i as u32);
            parent[i] = root;
            areas[root as usize] += runs[i].len as usize;
        }
        // Roots are the first runs of their regions; from here on `areas` says where a large enough one is.
        let mut members: Vec<Vec<Run>> = Vec::new();
        for i in 0..runs.len() {
            let root = parent[i] as usize;
            if root == i {
                areas[i] = if areas[i] >= min_area.max(1) { members.len() } else { usize::MAX };
                members.extend((areas[i] != usize::MAX).then(Vec::new));
            }
            if let Some(member) = members.get_mut(areas[root]) {
                member.push(runs[i]);
            }
        }
        members.into_iter().map(|runs| Region::from_runs(runs, raster, columns)).collect()
    }
}

fn find_runs(mask: &Marks, raster: &Raster, runs: &mut Vec<Run>, row_starts: &mut Vec<usize>) {
    runs.clear();
    row_starts.clear();
    for y in 0..raster.height {
        row_starts.push(runs.len());
        // First column of a run that has not ended yet.
        let mut open: Option<usize> = None;
        let mut add = |start: usize, end: usize| {
            if runs.len() < MAX_RUNS {
                runs.push(Run { row: y as u32, start: start as u32, len: (end - start) as u32 });
            }
        };
        for (w, &bits) in mask.row(y).iter().enumerate() {
            // Most of a mask is empty.
            if bits == 0 && open.is_none() {
                continue;
            }
            let mut x = 0;
            while x < WORD as u32 {
                let ahead = if open.is_some() { (bits >> x).trailing_ones() } else { (bits >> x).trailing_zeros() };
                x += ahead;
                if x >= WORD as u32 {
                    break;
                }
                match open.take() {
                    Some(start) => add(start, w * WORD + x as usize),
                    None => open = Some(w * WORD + x as usize),
                }
            }
        }
        if let Some(start) = open {
            add(start, raster.width);
        }
    }
    row_starts.push(runs.len());
}

fn join_near_runs(runs: &[Run], row_starts: &[usize], raster: &Raster, gap: [usize; 2], parent: &mut [u32]) {
    let reach_x = 2 * gap[0] as i32 + 1;
    let reach_y = 2 * gap[1] + 1;
    let w = raster.width as i32;
    let first = |run: &Run| run.start as i32;
    let last = |run: &Run| (run.start + run.len) as i32 - 1;
    let near = |a: &Run, b: &Run| {
        let plain = |shift: i32| first(b) + shift - last(a) <= reach_x && first(a) - (last(b) + shift) <= reach_x;
        plain(0) || (raster.wraps && (plain(w) || plain(-w)))
    };
    for y in 0..raster.height {
        let here = row_starts[y]..row_starts[y + 1];
        let Some((left_most, right_most)) = runs[here.clone()].first().zip(runs[here.clone()].last()) else { continue };
        // In one row the nearest run on the left decides, and over the seam the first and the last.
        for i in here.start + 1..here.end {
            if near(&runs[i - 1], &runs[i]) {
                join(parent, i as u32, i as u32 - 1);
            }
        }
        if raster.wraps && near(left_most, right_most) {
            join(parent, here.end as u32 - 1, here.start as u32);
        }
        for dy in 1..=reach_y.min(y) {
            let above = row_starts[y - dy]..row_starts[y - dy + 1];
            let Some((left_above, right_above)) = runs[above.clone()].first().zip(runs[above.clone()].last()) else {
                continue;
            };
            let mut skipped = 0;
            for (i, run) in here.clone().zip(&runs[here.clone()]) {
                // Runs are sorted: skip those that end too far left of this one.
                let rest = &runs[above.start + skipped..above.end];
                skipped += rest.iter().take_while(|r| last(r) + reach_x < first(run)).count();
                let mut root = find(parent, i as u32);
                let reached = runs[above.start + skipped..above.end].iter().zip(above.start + skipped..);
                for (_, j) in reached.take_while(|(r, _)| first(r) <= last(run) + reach_x) {
                    // Most are together already.
                    if parent[j] != root {
                        root = join(parent, root, j as u32);
                    }
                }
                if raster.wraps && (first(run) < reach_x || last(run) + 1 + reach_x > w) {
                    for (j, other) in [(above.start, left_above), (above.end - 1, right_above)] {
                        if near(other, run) {
                            join(parent, i as u32, j as u32);
                        }
                    }
                }
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

/// The complement of the longest stretch of empty columns (the first of equals).
fn covering_arc(columns: &[u8], raster: &Raster) -> Arc {
    let w = raster.width;
    let Some(first) = columns.iter().position(|&c| c != 0) else {
        return Arc { start: 0, width: 1 };
    };
    let last = columns.iter().rposition(|&c| c != 0).unwrap_or(first);
    if !raster.wraps {
        return Arc { start: first, width: last - first + 1 };
    }
    // The empty stretch over the seam, then those between.
    let (mut best, mut best_end) = (first + w - 1 - last, first);
    let mut x = first;
    while x <= last {
        if columns[x] != 0 {
            x += 1;
            continue;
        }
        let end = x + columns[x..].iter().position(|&c| c != 0).unwrap_or(w - x);
        if end - x > best {
            (best, best_end) = (end - x, end);
        }
        x = end;
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
