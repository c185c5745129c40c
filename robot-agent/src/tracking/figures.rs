//! Upright people in a panorama: which bodies, standing where, explain what is marked?
//!
//! Connected regions are not people: legs are two regions, a coat like the wall is a head and some feet, two friends are
//! one. A camera whose height is known can do better. At each distance a person covers known cells (see [`silhouette`]), and
//! marks are explained by silhouettes, as in probabilistic occupancy maps (Fleuret et al., PAMI 2008), each frame from where
//! people are predicted:
//!
//! ```text
//! marks ▶ share marked a cell ─┬─▶ fit     known people, one after the other, each to what the others leave unexplained
//!                              ├─▶ find    somebody new where much is left and has the shape of a person
//!                              └─▶ own     who is seen in which pixels: the nearer one in front
//! ```
//!
//! Whoever stands on the floor and is seen at all is seen at the height of the camera, if that is below people's heads: what
//! does not reach there (shadows, robots, chairs) explains nothing as a person and is left.

mod silhouette;

use silhouette::{CELL, LEVELS, Silhouette};

use super::View;
use crate::motion::{Raster, Region, Run, Scene};

/// Log-likelihood by which a fully visible body is better than none, for the fit: cells are not independent.
const FULL_EVIDENCE: f64 = 25.0;
/// Widest search for a known body, cells each side.
const MOST_REACH: i64 = 12;
/// Levels each side that are tried for a known body.
const LEVEL_REACH: f64 = 2.5;
/// Rounds of the joint fit.
const ROUNDS: usize = 2;
/// What one body hides of those behind it, at most.
const OPAQUE: f32 = 0.95;
/// A new body must explain at least this part of what it would if all of it were seen …
const LEAST_GAIN: f32 = 0.3;
/// … this much at all …
const LEAST_TOTAL: f32 = 30.0;
/// … and not be a part of something broader: marked share beside it against that inside.
const MOST_BESIDE: f32 = 0.75;
/// Most new bodies of a frame.
const MOST_NEW: usize = 8;
/// Cover from which a cell may be owned, and from which the nearest body owns it.
const OWNED: [f32; 2] = [0.08, 0.3];
/// Levels by which one body is nearer than another for sure.
const NEARER: f64 = 1.0;

/// A body that is looked for.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sought {
    /// Predicted column of the axis and its sigma, pixels.
    pub(super) column: f64,
    pub(super) column_sigma: f64,
    /// Predicted distance and the sigma of its logarithm.
    pub(super) range_m: f64,
    pub(super) log_range_sigma: f64,
    /// Of two at one distance the one with more owns what both cover.
    pub(super) seniority: u32,
}

/// A body in this frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Figure {
    /// Column of the axis from the fit, pixels, wrapped.
    pub(super) column: f64,
    /// Distance that fits best, metres.
    pub(super) range_m: f64,
    /// Share of it that nobody nearer covers.
    pub(super) own: f32,
    /// Log-likelihood gained by what is its own, against what an average body would gain there: 1 as expected, 0 nothing.
    pub(super) support: f32,
    cell: i64,
    level: usize,
    seniority: u32,
}

/// The model and the evidence of a frame.
#[derive(Debug)]
pub(super) struct Figures {
    raster: Raster,
    silhouettes: Vec<Silhouette>,
    /// Gain of a fully visible body.
    full: Vec<f32>,
    columns: usize,
    rows: usize,
    /// Cells repeated at both ends of a row, so that no sum has to wrap.
    pad: usize,
    /// Share of a cell's pixels that are marked, and weight of the cell (0: not tested).
    marked: Vec<f32>,
    weight: Vec<f32>,
    column_rad: f64,
}

impl Figures {
    /// For a view of known height; `None` for others.
    pub(super) fn new(view: &View, raster: &Raster) -> Option<Self> {
        view.upright_row()?;
        let (camera_m, _) = view.height_m?;
        let silhouettes = silhouette::all(view, raster, camera_m);
        let columns = raster.width.div_ceil(CELL[0]);
        let pad = silhouettes.iter().map(|s| s.half).max()?.min(columns / 2);
        let rows = raster.height.div_ceil(CELL[1]);
        let len = rows * (columns + 2 * pad);
        let full = silhouettes.iter().map(expected).collect();
        let column_rad = view.steps_rad(0.0, raster.height as f64 / 2.0)[0];
        Some(Self {
            raster: *raster,
            silhouettes,
            full,
            columns,
            rows,
            pad,
            marked: vec![0.0; len],
            weight: vec![0.0; len],
            column_rad,
        })
    }

    /// Columns of a length across the line of sight at a distance.
    pub(super) fn columns_of(&self, length_m: f64, range_m: f64) -> f64 {
        (length_m / range_m).atan() / self.column_rad
    }

    /// Takes the marks of a frame. `skip`: columns and first row of what is known to be something else (fellow robots).
    pub(super) fn look(&mut self, scene: &Scene<'_>, skip: &[(f64, f64, usize)]) {
        let (w, h) = (self.raster.width, self.raster.height);
        let stride = self.stride();
        for row in 0..self.rows {
            let lines = row * CELL[1]..((row + 1) * CELL[1]).min(h);
            for cell in 0..self.columns {
                let across = cell * CELL[0]..((cell + 1) * CELL[0]).min(w);
                let (mut marks, mut tested) = (0u32, 0u32);
                for y in lines.clone() {
                    let at = y * w + across.start..y * w + across.end;
                    marks += scene.mask[at.clone()].iter().map(|m| u32::from(*m)).sum::<u32>();
                    tested += scene.valid[at].iter().map(|v| u32::from(*v)).sum::<u32>();
                }
                let middle = (across.start + across.end - 1) as f64 / 2.0;
                let known = skip.iter().any(|(column, half, first_row)| {
                    lines.end > *first_row && self.raster.column_difference(middle, *column).abs() < *half
                });
                let i = row * stride + self.pad + cell;
                self.marked[i] = marks as f32 / tested.max(1) as f32;
                self.weight[i] = if known { 0.0 } else { tested as f32 / (CELL[0] * CELL[1]) as f32 };
            }
        }
        for values in [&mut self.marked, &mut self.weight] {
            repeat_ends(values, self.columns, self.pad);
        }
    }

    /// Where the known bodies are, together.
    pub(super) fn fit(&self, sought: &[Sought]) -> Vec<Figure> {
        let mut places: Vec<(i64, usize)> =
            sought.iter().map(|s| (self.cell_of(s.column), level_of(s.range_m))).collect();
        let mut order: Vec<usize> = (0..sought.len()).collect();
        order.sort_by(|a, b| sought[*a].range_m.total_cmp(&sought[*b].range_m));
        for _ in 0..ROUNDS {
            let before = places.clone();
            for &k in &order {
                let others = places.iter().enumerate().filter(|(j, _)| *j != k).map(|(_, p)| *p);
                let free = self.free(others);
                places[k] = self.best_place(&sought[k], &free);
            }
            if places == before {
                break;
            }
        }
        let figures: Vec<Figure> =
            sought.iter().zip(&places).map(|(s, &(cell, level))| self.bare_figure(cell, level, s.seniority)).collect();
        self.judge(figures)
    }

    /// New bodies in what `known` leave unexplained.
    pub(super) fn find(&self, known: &[Figure]) -> Vec<Figure> {
        let mut all = known.to_vec();
        let mut free = self.free(known.iter().map(|f| (f.cell, f.level)));
        while all.len() < known.len() + MOST_NEW {
            let Some((cell, level)) = self.best_new(&free) else { break };
            self.cover(&mut free, cell, level);
            all.push(self.bare_figure(cell, level, 0));
        }
        if all.len() == known.len() {
            return Vec::new();
        }
        self.judge(all).split_off(known.len())
    }

    /// The marked pixels that show each figure; `None` where there are none.
    pub(super) fn own(&self, figures: &[Figure], scene: &Scene<'_>) -> Vec<Option<Region>> {
        let owner = self.owners(figures);
        let mut runs: Vec<Vec<Run>> = vec![Vec::new(); figures.len()];
        for y in 0..self.raster.height {
            let owners = &owner[y / CELL[1] * self.columns..][..self.columns];
            let mask = &scene.mask[y * self.raster.width..][..self.raster.width];
            let mut open: Option<(usize, usize)> = None; // figure, first column
            for x in 0..=self.raster.width {
                let here = (x < self.raster.width && mask[x] != 0)
                    .then(|| owners[x / CELL[0]])
                    .filter(|o| *o != NOBODY)
                    .map(usize::from);
                if let Some((figure, start)) = open
                    && here != Some(figure)
                {
                    runs[figure].push(Run { row: y as u32, start: start as u32, len: (x - start) as u32 });
                    open = None;
                }
                if let (None, Some(figure)) = (open, here) {
                    open = Some((figure, x));
                }
            }
        }
        runs.into_iter().map(|r| (!r.is_empty()).then(|| Region::of_runs(r, &self.raster))).collect()
    }

    /// Column of the axis of a figure from its own pixels: their mean, hips to head weighing most, within the trunk's breadth.
    pub(super) fn axis(&self, figure: &Figure, region: &Region, view: &View) -> f64 {
        /// Half of the breadth that is averaged, metres: shoulders, not arms.
        const HALF_M: f64 = 0.26;
        let camera_m = view.height_m.map_or(0.6, |(h, _)| h);
        let half = self.columns_of(HALF_M, figure.range_m);
        let mut axis = figure.column;
        let mut row_weight: Vec<(u32, f64)> = Vec::new();
        for run in &region.runs {
            if row_weight.last().is_none_or(|(row, _)| *row != run.row) {
                let z = view
                    .angles_rad(0.0, f64::from(run.row))
                    .map_or(0.0, |(_, elevation)| camera_m + figure.range_m * elevation.tan());
                row_weight.push((run.row, if z > 1.3 { 1.5 } else if z > 0.72 { 1.0 } else { 0.4 }));
            }
        }
        for _ in 0..3 {
            let (mut sum, mut moment, mut next) = (0.0, 0.0, 0);
            for run in &region.runs {
                while row_weight[next].0 != run.row {
                    next += 1;
                }
                let first = self.raster.column_difference(f64::from(run.start), axis);
                let (from, to) = (first.max(-half), (first + f64::from(run.len) - 1.0).min(half));
                if from <= to {
                    let n = (to - from + 1.0) * row_weight[next].1;
                    sum += n;
                    moment += n * 0.5 * (from + to);
                }
            }
            if sum <= 0.0 {
                return figure.column;
            }
            axis = self.raster.wrap_column(axis + moment / sum);
        }
        axis
    }

    fn stride(&self) -> usize {
        self.columns + 2 * self.pad
    }

    fn cell_of(&self, column: f64) -> i64 {
        (((column - 1.0) / CELL[0] as f64).round() as i64).rem_euclid(self.columns as i64)
    }

    fn bare_figure(&self, cell: i64, level: usize, seniority: u32) -> Figure {
        let column = self.raster.wrap_column(cell as f64 * CELL[0] as f64 + 0.5 * (CELL[0] as f64 - 1.0));
        Figure { column, range_m: self.silhouettes[level].range_m, own: 1.0, support: 0.0, cell, level, seniority }
    }

    /// Weight of each cell that is left when some bodies cover theirs.
    fn free(&self, bodies: impl Iterator<Item = (i64, usize)>) -> Vec<f32> {
        let mut free = self.weight.clone();
        for (cell, level) in bodies {
            self.cover(&mut free, cell, level);
        }
        free
    }

    fn cover(&self, free: &mut [f32], cell: i64, level: usize) {
        let s = &self.silhouettes[level];
        let (stride, columns) = (self.stride(), self.columns as i64);
        for (row, cover) in s.cover.chunks_exact(s.width()).enumerate() {
            for (i, c) in cover.iter().enumerate() {
                let at = (cell + i as i64 - s.half as i64).rem_euclid(columns) as usize;
                free[row * stride + self.pad + at] *= 1.0 - OPAQUE * c;
            }
        }
        repeat_ends(free, self.columns, self.pad);
    }

    /// Log-likelihood gained by a body, given the weights of the cells.
    fn gain(&self, cell: i64, level: usize, free: &[f32]) -> f32 {
        let s = &self.silhouettes[level];
        let first = (cell.rem_euclid(self.columns as i64) as usize + self.pad) - s.half.min(self.pad);
        let (stride, width) = (self.stride(), s.width());
        let rows = s.unmarked.chunks_exact(width).zip(s.marked_more.chunks_exact(width));
        rows.enumerate()
            .map(|(row, (unmarked, more))| {
                let at = row * stride + first;
                gain_of_row(&free[at..at + width], &self.marked[at..at + width], unmarked, more)
            })
            .sum()
    }

    fn best_place(&self, sought: &Sought, free: &[f32]) -> (i64, usize) {
        let centre = self.cell_of(sought.column);
        let reach = ((2.5 * sought.column_sigma / CELL[0] as f64).ceil() as i64 + 1).min(MOST_REACH);
        let level = silhouette::level_of_range(sought.range_m);
        let level_sigma = sought.log_range_sigma / level_log_step();
        let first = (level - LEVEL_REACH).ceil().clamp(0.0, (LEVELS - 1) as f64) as usize;
        let last = (level + LEVEL_REACH).floor().clamp(0.0, (LEVELS - 1) as f64) as usize;
        let scale = FULL_EVIDENCE / f64::from(self.full[level_of(sought.range_m)]);
        let mut best = (f64::NEG_INFINITY, (centre, level_of(sought.range_m)));
        for l in first..=last {
            let pull_level = (l as f64 - level) / level_sigma;
            for step in -reach..=reach {
                let column = (centre + step) as f64 * CELL[0] as f64 + 1.0;
                let pull = self.raster.column_difference(column, sought.column) / sought.column_sigma;
                let cell = (centre + step).rem_euclid(self.columns as i64);
                let total =
                    scale * f64::from(self.gain(cell, l, free)) - 0.5 * (pull * pull + pull_level * pull_level);
                if total > best.0 {
                    best = (total, (cell, l));
                }
            }
        }
        best.1
    }

    fn best_new(&self, free: &[f32]) -> Option<(i64, usize)> {
        /// Cells of a column that must be unexplained for its middle to be somebody's axis.
        const LEAST_CELLS: f32 = 2.5;
        let stride = self.stride();
        let mut left = vec![0f32; self.columns];
        for row in 0..self.rows {
            let at = row * stride + self.pad;
            for (sum, (f, m)) in left.iter_mut().zip(free[at..].iter().zip(&self.marked[at..])) {
                *sum += f * m;
            }
        }
        let mut best: Option<(f32, (i64, usize))> = None;
        for cell in (0..self.columns).filter(|c| left[*c] >= LEAST_CELLS) {
            for level in 0..LEVELS {
                let gain = self.gain(cell as i64, level, free);
                if best.is_none_or(|(most, _)| gain > most) {
                    best = Some((gain, (cell as i64, level)));
                }
            }
        }
        let (gain, place) = best?;
        let enough = gain > LEAST_TOTAL && gain > LEAST_GAIN * self.full[place.1];
        (enough && !self.is_part_of_more(place, free)).then_some(place)
    }

    /// Whether what is marked goes on beside the body as densely as inside.
    fn is_part_of_more(&self, (cell, level): (i64, usize), free: &[f32]) -> bool {
        let s = &self.silhouettes[level];
        let stride = self.stride();
        let beyond = (s.half / 2).max(2);
        let (mut inside, mut beside) = ([0f32; 2], [[0f32; 2]; 2]);
        for (row, cover) in s.cover.chunks_exact(s.width()).enumerate() {
            if cover[s.half] < 0.5 {
                continue;
            }
            for step in -((s.half + beyond) as i64)..=(s.half + beyond) as i64 {
                let at = row * stride + self.pad + (cell + step).rem_euclid(self.columns as i64) as usize;
                let i = step + s.half as i64;
                let c = if (0..s.width() as i64).contains(&i) { cover[i as usize] } else { 0.0 };
                let sums = if c > 0.5 {
                    &mut inside
                } else if c < 0.05 {
                    &mut beside[usize::from(step > 0)]
                } else {
                    continue;
                };
                sums[0] += free[at] * self.marked[at];
                sums[1] += free[at];
            }
        }
        let share = |[marked, all]: [f32; 2]| marked / all.max(1e-3);
        beside.iter().all(|b| share(*b) > MOST_BESIDE * share(inside))
    }

    /// What is each figure's own, and how well it is supported.
    fn judge(&self, mut figures: Vec<Figure>) -> Vec<Figure> {
        for k in 0..figures.len() {
            let me = figures[k];
            let before = figures.iter().enumerate().filter(|(j, f)| *j != k && precedes(f, *j, &me, k));
            let free = self.free(before.map(|(_, f)| (f.cell, f.level)));
            let s = &self.silhouettes[me.level];
            let (mut own, mut all, mut expected) = (0f32, 0f32, 0f32);
            let stride = self.stride();
            for (row, cover) in s.cover.chunks_exact(s.width()).enumerate() {
                for (i, c) in cover.iter().enumerate() {
                    let column = (me.cell + i as i64 - s.half as i64).rem_euclid(self.columns as i64) as usize;
                    let at = row * stride + self.pad + column;
                    let k = row * s.width() + i;
                    own += free[at] * c;
                    all += self.weight[at] * c;
                    expected += free[at] * (s.unmarked[k] + c * s.marked_more[k]);
                }
            }
            let gain = self.gain(me.cell, me.level, &free);
            figures[k].own = own / all.max(1e-3);
            figures[k].support = gain / expected.max(1e-3);
        }
        figures
    }

    fn owners(&self, figures: &[Figure]) -> Vec<u8> {
        let mut owner = vec![NOBODY; self.rows * self.columns];
        let mut strength = vec![0f32; owner.len()];
        let mut order: Vec<usize> = (0..figures.len().min(usize::from(NOBODY))).collect();
        // Those in front first.
        order.sort_by(|&a, &b| {
            if precedes(&figures[a], a, &figures[b], b) { std::cmp::Ordering::Less } else { std::cmp::Ordering::Greater }
        });
        for k in order {
            let f = &figures[k];
            let s = &self.silhouettes[f.level];
            for (row, cover) in s.cover.chunks_exact(s.width()).enumerate() {
                for (i, c) in cover.iter().enumerate() {
                    let column = (f.cell + i as i64 - s.half as i64).rem_euclid(self.columns as i64) as usize;
                    let at = row * self.columns + column;
                    let taken = strength[at] >= OWNED[1] || strength[at] >= *c;
                    if *c >= OWNED[0] && !taken {
                        (owner[at], strength[at]) = (k as u8, *c);
                    }
                }
            }
        }
        owner
    }
}

const NOBODY: u8 = u8::MAX;

/// Whether a figure is in front of another.
fn precedes(a: &Figure, index_a: usize, b: &Figure, index_b: usize) -> bool {
    // By distance in whole steps, so that the order is one.
    let step = |f: &Figure| (f.level as f64 / (NEARER + 1.0)) as usize;
    (step(a), std::cmp::Reverse(a.seniority), index_a) < (step(b), std::cmp::Reverse(b.seniority), index_b)
}

fn level_of(range_m: f64) -> usize {
    silhouette::level_of_range(range_m).round().clamp(0.0, (LEVELS - 1) as f64) as usize
}

fn level_log_step() -> f64 {
    (silhouette::range_of_level(1.0) / silhouette::range_of_level(0.0)).ln()
}

fn expected(s: &Silhouette) -> f32 {
    s.cover.iter().zip(s.unmarked.iter().zip(&s.marked_more)).map(|(c, (u, m))| u + c * m).sum()
}

fn gain_of_row(free: &[f32], marked: &[f32], unmarked: &[f32], more: &[f32]) -> f32 {
    let mut sums = [0f32; 8];
    let mut chunks = [free, marked, unmarked, more].map(|s| s.chunks_exact(8));
    let tails = chunks.each_ref().map(|c| c.remainder());
    let [f, m, u, d] = &mut chunks;
    for (((f, m), u), d) in f.zip(m).zip(u).zip(d) {
        for i in 0..8 {
            sums[i] += f[i] * (u[i] + m[i] * d[i]);
        }
    }
    let [f, m, u, d] = tails;
    let tail: f32 = f.iter().zip(m).zip(u.iter().zip(d)).map(|((f, m), (u, d))| f * (u + m * d)).sum();
    sums.iter().sum::<f32>() + tail
}

/// Cells at the ends of each row are repeated beyond the other end.
fn repeat_ends(values: &mut [f32], columns: usize, pad: usize) {
    for row in values.chunks_exact_mut(columns + 2 * pad) {
        row.copy_within(columns..columns + pad, 0);
        row.copy_within(pad..2 * pad, pad + columns);
    }
}
