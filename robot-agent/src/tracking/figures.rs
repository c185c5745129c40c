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
//! Shadows, robots and chairs explain nothing as a person and are left. What a person covers is learnt while nobody is near
//! (see [`Shape`]), so that the next one who comes beside stands out, and clothes like the wall are not missed.

pub mod bodily;
mod grey;
mod silhouette;

pub(super) use silhouette::Shape;

use std::sync::Arc;

use bodily::MarkedCell;
use silhouette::{CELL, LEVELS, Silhouette, Silhouettes};

use protocol::appearance::Appearance;

use super::View;
use super::people::Robot;
use super::proof::Doubts;
use crate::motion::{Raster, Region, Run, Scene};

/// Log-likelihood by which a fully visible body is better than none, for the fit: cells are not independent.
const FULL_EVIDENCE: f64 = 25.0;
/// Widest search for a known body, cells each side; of finer panoramas more, as far in angle.
const MOST_REACH: i64 = 12;
/// Columns of the panorama for which what is in cells was chosen.
const USUAL_COLUMNS: f64 = 1080.0;
/// Levels each side that are tried for a known body.
const LEVEL_REACH: f64 = 4.5;
/// Levels and cells each side of a figure at which an average person is tried.
const AVERAGE_LEVELS: usize = 6;
const AVERAGE_CELLS: i64 = 2;
/// A distance is never looked for more narrowly than this, for errors of the fit last.
const LEAST_LOG_RANGE_SIGMA: f64 = 0.2;
/// The same of a distance that others have measured.
const LEAST_KNOWN_LOG_RANGE_SIGMA: f64 = 0.08;
/// One body is rather two further away if those explain so much more, as a part of what one of them fully gains; heads no
/// nearer than this to each other, metres.
const SPLIT_GAIN: f32 = 0.1;
const SPLIT_APART_M: f64 = 0.33;
/// Lowest height that the picture must show where two are told apart by their heads.
const HEADS_M: f64 = 1.55;
/// A gap down the middle of the upper part of what should be one body: cells, and shares of marks in it and beside it.
const GAP_CELLS: usize = 2;
const GAP_MARKED: [f32; 2] = [0.15, 0.5];
/// Half of the breadth in which nobody has a gap, and the distance from which on heads and feet tell more, metres.
const SOLID_M: f64 = 0.2;
const GAP_RANGE_M: f64 = 2.3;
/// Gaps are looked for in the upper one of so many parts of the picture, where there are no legs at lower than this, metres.
const UPPER_SHARE: usize = 4;
const HIPS_M: f64 = 0.72;
/// The same as [`SPLIT_GAIN`] where there is such a gap.
const SPLIT_GAIN_AT_GAP: f32 = -0.15;
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
/// Cells that are less likely somebody's body are nobody's.
const LEAST_BODY: f32 = 0.5;
/// Most new bodies of a frame.
const MOST_NEW: usize = 8;
/// Cover from which a cell may be owned, and from which the nearest body owns it.
const OWNED: [f32; 2] = [0.08, 0.3];
/// Support below which nobody is there, and own share below which somebody is hidden by others.
const LEAST_SUPPORT: f32 = 0.25;
const LEAST_OWN: f32 = 0.25;
/// Seniority (sightings) from which on a body is no part of one that does not show.
const ESTABLISHED: u32 = 15;
/// Levels by which one body is nearer than another for sure.
const NEARER: f64 = 1.0;

/// Columns of the panorama.
#[derive(Debug, Clone, Copy)]
pub(super) struct Span {
    pub(super) middle: f64,
    pub(super) half: f64,
}

impl Span {
    pub(super) fn contains(&self, column: f64, raster: &Raster) -> bool {
        raster.column_difference(column, self.middle).abs() < self.half
    }
}

/// A body that is looked for.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sought<'a> {
    /// Predicted column of the axis and its sigma, pixels.
    pub(super) column: f64,
    pub(super) column_sigma: f64,
    /// Predicted distance and the sigma of its logarithm.
    pub(super) range_m: f64,
    pub(super) log_range_sigma: f64,
    /// Others have measured that.
    pub(super) known_range: bool,
    /// What it looked like alone.
    pub(super) shape: &'a Shape,
    /// Of two at one distance the one with more owns what both cover.
    pub(super) seniority: u32,
    /// Grey levels by height, where enough is known of them.
    pub(super) looks: Option<&'a Appearance>,
}

/// A body in this frame.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Figure {
    /// Column of the axis from the fit, pixels, wrapped.
    pub(super) column: f64,
    /// Distance that fits best, metres.
    pub(super) range_m: f64,
    /// Share of it that nobody nearer covers.
    pub(super) own: f32,
    /// Log-likelihood gained by what is its own, against what an average body would gain there: 1 as expected, 0 nothing.
    pub(super) support: f32,
    /// Share of it that nobody covers or is covered by.
    pub(super) apart: f32,
    /// Log-likelihood gained by what no senior explains, against what the whole body would: whether it exists at all.
    pub(super) evidence: f32,
    place: Place,
    seniority: u32,
}

impl Figure {
    /// Whether something of it shows, and looks like it.
    pub(super) fn shows(&self) -> bool {
        self.own >= LEAST_OWN && self.support >= LEAST_SUPPORT
    }
}

/// A silhouette at a place.
#[derive(Debug, Clone, PartialEq)]
struct Place {
    cell: i64,
    level: usize,
    silhouette: Arc<Silhouette>,
}

/// What is left to be explained of a frame: weights of the cells' marked and unmarked parts.
#[derive(Debug, Clone)]
struct Rest {
    marked: Vec<f32>,
    unmarked: Vec<f32>,
}

/// The model and the evidence of a frame.
#[derive(Debug)]
pub(super) struct Figures {
    raster: Raster,
    silhouettes: Silhouettes,
    /// The highest place of the picture at each distance.
    highest_m: Vec<f64>,
    /// See [`MOST_REACH`].
    most_reach: i64,
    /// Rows of cells in which gaps are looked for, and from which distance on hips and trunks are there, not legs; `None`: nowhere.
    upper_rows: usize,
    least_gap_range_m: Option<f64>,
    columns: usize,
    rows: usize,
    /// Cells repeated at both ends of a row, so that no sum has to wrap.
    pad: usize,
    /// Share of a cell's pixels that are marked, as far as that is a body, and weight of the cell (0: not tested).
    marked: Vec<f32>,
    weight: Vec<f32>,
    /// Logarithm of the mean grey level of the marked pixels of each cell.
    log_grey: Vec<f32>,
    /// Share marked in the upper quarter of each column of cells.
    upper: Vec<f32>,
    /// Tells what is marked of somebody's body.
    cells: bodily::Cells,
    /// Whether marks in a column of cells count only as far as they are a body, and how far those of each cell do.
    doubted: Vec<bool>,
    body: Vec<f32>,
    column_rad: f64,
}

impl Figures {
    /// For a panorama from a known height; `None` for others.
    pub(super) fn new(view: &View, raster: &Raster) -> Option<Self> {
        let (camera_m, _) = view.height_m.filter(|_| view.is_panoramic())?;
        let silhouettes = Silhouettes::new(view, raster, camera_m);
        let columns = raster.width.div_ceil(CELL[0]);
        let pad = (0..LEVELS).map(|l| silhouettes.average(l).half).max()?;
        let rows = raster.height.div_ceil(CELL[1]);
        let len = rows * (columns + 2 * pad);
        let highest = view.angles_rad(0.0, 0.0)?.1;
        let upper_rows = (rows / UPPER_SHARE).max(1);
        let fineness = raster.width as f64 / USUAL_COLUMNS;
        let upper_tan = view.angles_rad(0.0, 0.5 * (upper_rows * CELL[1]) as f64)?.1.tan();
        let highest_m = (0..LEVELS).map(|l| camera_m + silhouettes.average(l).range_m * highest.tan()).collect();
        let column_rad = view.steps_rad(0.0, raster.height as f64 / 2.0)[0];
        let (marked, weight, log_grey) = (vec![0.0; len], vec![0.0; len], vec![0.0; len]);
        // A ring that is narrower than somebody nearby is no panorama.
        (2 * pad < columns).then_some(Self {
            raster: *raster,
            silhouettes,
            highest_m,
            most_reach: ((MOST_REACH as f64 * fineness) as i64).max(MOST_REACH),
            upper_rows,
            least_gap_range_m: (upper_tan > 0.0).then(|| (HIPS_M - camera_m) / upper_tan),
            columns,
            rows,
            pad,
            marked,
            weight,
            log_grey,
            upper: vec![0.0; columns],
            cells: bodily::Cells::new(columns, rows),
            doubted: vec![false; columns],
            body: vec![1.0; columns * rows],
            column_rad,
        })
    }

    /// Columns of a length across the line of sight at a distance.
    pub(super) fn columns_of(&self, length_m: f64, range_m: f64) -> f64 {
        (length_m / range_m).atan() / self.column_rad
    }

    /// Takes the marks of a frame. `skip`: columns and first row of what is known to be something else (fellow robots). `doubts`: where
    /// marks count only as far as they are a body.
    pub(super) fn look(&mut self, scene: &Scene<'_>, skip: &[Robot], doubts: &Doubts) {
        let (w, h) = (self.raster.width, self.raster.height);
        let stride = self.stride();
        for row in 0..self.rows {
            let lines = row * CELL[1]..((row + 1) * CELL[1]).min(h);
            for cell in 0..self.columns {
                let across = cell * CELL[0]..((cell + 1) * CELL[0]).min(w);
                let (mut marks, mut tested, mut grey) = (0u32, 0u32, 0u32);
                for y in lines.clone() {
                    let at = y * w + across.start..y * w + across.end;
                    let levels = scene.mask[at.clone()].iter().zip(&scene.picture[at.clone()]);
                    grey += levels.map(|(m, p)| u32::from(*m) * u32::from(*p)).sum::<u32>();
                    marks += scene.mask[at.clone()].iter().map(|m| u32::from(*m)).sum::<u32>();
                    tested += scene.valid[at].iter().map(|v| u32::from(*v)).sum::<u32>();
                }
                let middle = (across.start + across.end - 1) as f64 / 2.0;
                let known = skip.iter().any(|(column, half, first_row)| {
                    lines.end > *first_row && self.raster.column_difference(middle, *column).abs() < *half
                });
                let i = row * stride + self.pad + cell;
                self.marked[i] = marks as f32 / tested.max(1) as f32;
                self.log_grey[i] = if marks > 0 { (grey as f32 / marks as f32).max(1.0).ln() } else { 0.0 };
                self.weight[i] = if known { 0.0 } else { tested as f32 / (CELL[0] * CELL[1]) as f32 };
                self.cells.take(scene, [row, cell], [marks, tested]);
            }
        }
        self.cells.close();
        self.doubt(doubts);
        let upper_rows = self.upper_rows;
        for (cell, upper) in self.upper.iter_mut().enumerate() {
            let sum: f32 = (0..upper_rows).map(|row| self.marked[row * stride + self.pad + cell]).sum();
            *upper = sum / upper_rows as f32;
        }
        for values in [&mut self.marked, &mut self.weight, &mut self.log_grey] {
            repeat_ends(values, self.columns, self.pad);
        }
    }

    /// Lets marks count only as far as they are a body.
    fn doubt(&mut self, doubts: &Doubts) {
        self.body.fill(1.0);
        let stride = self.stride();
        for cell in 0..self.columns {
            self.doubted[cell] = doubts.hold_at(self.column_of(cell as i64), &self.raster);
            if !self.doubted[cell] {
                continue;
            }
            for row in 0..self.rows {
                let body = self.cells.body(row, cell);
                self.body[row * self.columns + cell] = body;
                self.marked[row * stride + self.pad + cell] *= body;
            }
        }
    }

    /// Share of what is marked where a figure is that looks like a body; `None` where too little is marked to say.
    pub(super) fn bodily_share(&self, figure: &Figure) -> Option<f64> {
        const COVERED: f32 = 0.5;
        const LEAST_CELLS: f32 = 3.0;
        let (mut bodily, mut all) = (0.0, 0.0);
        self.for_cells(&figure.place, |i, c| {
            let [row, cell] = [i / self.stride(), i % self.stride() - self.pad];
            let share = self.weight[i] * self.cells.marked_share(row, cell);
            if c > COVERED && share > 0.0 {
                let said = self.doubted[cell].then(|| self.body[row * self.columns + cell]);
                bodily += share * said.unwrap_or_else(|| self.cells.body(row, cell));
                all += share;
            }
        });
        (all > LEAST_CELLS).then(|| f64::from(bodily / all))
    }

    /// The cells of the last frame in which something was marked.
    pub(super) fn marked_cells(&self) -> impl Iterator<Item = MarkedCell> {
        self.cells.marked()
    }

    /// Where the known bodies are, together.
    pub(super) fn fit(&self, sought: &[Sought<'_>]) -> Vec<Figure> {
        // Each as it looks at the distances that are tried.
        let choices: Vec<Vec<Place>> = sought.iter().map(|s| self.choices(s)).collect();
        let mut places: Vec<Place> = sought
            .iter()
            .zip(&choices)
            .map(|(s, choices)| {
                let away = |p: &&Place| (silhouette::level_of_range(s.range_m) - p.level as f64).abs();
                choices.iter().min_by(|a, b| away(a).total_cmp(&away(b))).unwrap_or(&choices[0]).clone()
            })
            .collect();
        let mut order: Vec<usize> = (0..sought.len()).collect();
        order.sort_by(|a, b| sought[*a].range_m.total_cmp(&sought[*b].range_m));
        let contested = self.contested(sought);
        // Who stands beside somebody known, taken for one with him until now.
        let mut beside: Vec<Place> = Vec::new();
        for round in 0..ROUNDS {
            let before = places.clone();
            for &k in &order {
                let others = places.iter().enumerate().filter(|(j, _)| *j != k).map(|(_, p)| p);
                let rest = self.rest(others.chain(&beside));
                places[k] = self.best_place(&sought[k], &choices[k], &rest, contested[k]);
                if round == 0
                    && let Some(pair) = self.two_instead(&places[k], &rest)
                {
                    let away =
                        |p: &Place| self.raster.column_difference(self.column_of(p.cell), sought[k].column).abs();
                    let [a, b] = pair;
                    let (nearer, other) = if away(&a) <= away(&b) { (a, b) } else { (b, a) };
                    places[k] = nearer;
                    beside.push(other);
                }
            }
            if round > 0 && places == before {
                break;
            }
        }
        let figures = sought.iter().zip(places).map(|(s, place)| self.bare_figure(place, s.seniority)).collect();
        self.judge(figures)
    }

    /// New bodies in what `known` leave unexplained.
    pub(super) fn find(&self, known: &[Figure]) -> Vec<Figure> {
        let mut all = known.to_vec();
        let mut rest = self.rest(known.iter().map(|f| &f.place));
        while all.len() < known.len() + MOST_NEW {
            let Some(place) = self.best_new(&rest) else { break };
            self.explain(&mut rest, &place);
            all.push(self.bare_figure(place, 0));
        }
        if all.len() == known.len() {
            return Vec::new();
        }
        self.judge(all).split_off(known.len())
    }

    /// Lets a shape follow a figure that is seen alone.
    pub(super) fn learn(&self, figure: &Figure, shape: &mut Shape) {
        let Place { cell, level, .. } = figure.place;
        let half = self.silhouettes.average(level).half as i64;
        let stride = self.stride();
        self.silhouettes.learn(shape, level, |row, column| {
            let at = (cell + column as i64 - half).rem_euclid(self.columns as i64) as usize;
            let i = row * stride + self.pad + at;
            (self.weight[i] > 0.5).then(|| self.marked[i])
        });
    }

    /// How far away an average person is who is seen like a figure that is apart, by this frame alone. The figure's own distance lags
    /// behind who comes or goes: it is looked for near the last ones, and what was learnt there fits best there.
    pub(super) fn average_range_m(&self, figure: &Figure) -> f64 {
        let Place { cell, level, .. } = figure.place;
        let rest = self.rest(std::iter::empty());
        let gain = |l: usize| {
            let silhouette = self.silhouettes.average(l);
            (-AVERAGE_CELLS..=AVERAGE_CELLS)
                .map(|step| self.gain(cell + step, silhouette, &rest))
                .fold(f32::MIN, f32::max)
        };
        let levels = level.saturating_sub(AVERAGE_LEVELS)..=(level + AVERAGE_LEVELS).min(LEVELS - 1);
        let best = levels.map(|l| (gain(l), l)).max_by(|a, b| a.0.total_cmp(&b.0));
        best.map_or(figure.range_m, |(_, l)| self.silhouettes.average(l).range_m)
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
                let body = |x: usize| self.body[y / CELL[1] * self.columns + x / CELL[0]];
                let here = (x < self.raster.width && mask[x] != 0)
                    .then(|| owners[x / CELL[0]])
                    .filter(|o| *o != NOBODY)
                    .map(usize::from)
                    .filter(|_| body(x) > LEAST_BODY);
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
                row_weight.push((
                    run.row,
                    if z > 1.3 {
                        1.5
                    } else if z > 0.72 {
                        1.0
                    } else {
                        0.4
                    },
                ));
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

    fn column_of(&self, cell: i64) -> f64 {
        self.raster.wrap_column(cell as f64 * CELL[0] as f64 + 0.5 * (CELL[0] as f64 - 1.0))
    }

    fn average_at(&self, cell: i64, level: usize) -> Place {
        Place {
            cell: cell.rem_euclid(self.columns as i64),
            level,
            silhouette: Arc::clone(self.silhouettes.average(level)),
        }
    }

    fn bare_figure(&self, place: Place, seniority: u32) -> Figure {
        let (column, range_m) = (self.column_of(place.cell), place.silhouette.range_m);
        Figure { column, range_m, own: 1.0, support: 0.0, apart: 1.0, evidence: 0.0, place, seniority }
    }

    /// What is left to explain when some bodies explain theirs.
    fn rest<'a>(&self, bodies: impl Iterator<Item = &'a Place>) -> Rest {
        let mut rest = Rest {
            marked: self.weight.iter().zip(&self.marked).map(|(w, m)| w * m).collect(),
            unmarked: self.weight.iter().zip(&self.marked).map(|(w, m)| w * (1.0 - m)).collect(),
        };
        for place in bodies {
            self.explain(&mut rest, place);
        }
        rest
    }

    /// Takes away what a body explains: a mark that it makes half of the time says little about another body there, an
    /// unmarked cell nearly as much as ever. (Ratios of the log-likelihoods with and without the body.)
    fn explain(&self, rest: &mut Rest, place: &Place) {
        self.for_cells(place, |i, c| {
            rest.marked[i] *= (1.0 - c).sqrt() / (1.0 + 6.0 * c);
            rest.unmarked[i] *= 1.0 - 0.8 * c * c;
        });
        repeat_ends(&mut rest.marked, self.columns, self.pad);
        repeat_ends(&mut rest.unmarked, self.columns, self.pad);
    }

    /// Weight of the cells that is not hidden by some bodies.
    fn visible<'a>(&self, bodies: impl Iterator<Item = &'a Place>) -> Vec<f32> {
        let mut visible = self.weight.clone();
        for place in bodies {
            self.for_cells(place, |i, c| visible[i] *= 1.0 - OPAQUE * c);
        }
        visible
    }

    /// Calls `f` with the index and the cover of each cell of a silhouette.
    fn for_cells(&self, place: &Place, mut f: impl FnMut(usize, f32)) {
        let s = &place.silhouette;
        let (stride, columns) = (self.stride(), self.columns as i64);
        for (row, cover) in s.cover.chunks_exact(s.width()).enumerate() {
            for (i, c) in cover.iter().enumerate() {
                let at = (place.cell + i as i64 - s.half as i64).rem_euclid(columns) as usize;
                f(row * stride + self.pad + at, *c);
            }
        }
    }

    /// Log-likelihood gained by a body, given what is left to explain.
    fn gain(&self, cell: i64, s: &Silhouette, rest: &Rest) -> f32 {
        let first = cell.rem_euclid(self.columns as i64) as usize + self.pad - s.half;
        let (stride, width) = (self.stride(), s.width());
        let rows = s.unmarked.chunks_exact(width).zip(s.marked.chunks_exact(width));
        rows.enumerate()
            .map(|(row, (unmarked, marked))| {
                let at = row * stride + first;
                gain_of_row(&rest.marked[at..at + width], &rest.unmarked[at..at + width], marked, unmarked)
            })
            .sum()
    }

    /// The distances that are tried for a body, at its predicted cell.
    fn choices(&self, sought: &Sought<'_>) -> Vec<Place> {
        let level = silhouette::level_of_range(sought.range_m);
        let bound = |level: f64| level.clamp(0.0, (LEVELS - 1) as f64) as usize;
        let cell = self.cell_of(sought.column);
        (bound((level - LEVEL_REACH).ceil())..=bound((level + LEVEL_REACH).floor()))
            .map(|level| Place { cell, level, silhouette: self.silhouettes.of(sought.shape, level) })
            .collect()
    }

    fn best_place(&self, sought: &Sought<'_>, choices: &[Place], rest: &Rest, contested: bool) -> Place {
        let reach = ((2.5 * sought.column_sigma / CELL[0] as f64).ceil() as i64 + 1).min(self.most_reach);
        let full = choices.iter().map(|p| p.silhouette.full).fold(1.0, f32::max);
        let mut best = (f64::NEG_INFINITY, choices[0].clone());
        for place in choices {
            for step in -reach..=reach {
                let place = Place { cell: (place.cell + step).rem_euclid(self.columns as i64), ..place.clone() };
                let total = self.score(sought, &place, rest, full, contested);
                if total > best.0 {
                    best = (total, place);
                }
            }
        }
        best.1
    }

    /// How much speaks for somebody at a place, nats: marks, where he should be, and what he looks like if that is `contested`.
    fn score(&self, sought: &Sought<'_>, place: &Place, rest: &Rest, full: f32, contested: bool) -> f64 {
        let least = if sought.known_range { LEAST_KNOWN_LOG_RANGE_SIGMA } else { LEAST_LOG_RANGE_SIGMA };
        let level_sigma = sought.log_range_sigma.max(least) / level_log_step();
        let pull_level = (place.level as f64 - silhouette::level_of_range(sought.range_m)) / level_sigma;
        let pull = self.raster.column_difference(self.column_of(place.cell), sought.column).abs() / sought.column_sigma;
        let gain = f64::from(self.gain(place.cell, &place.silhouette, rest));
        let likeness = sought.looks.filter(|_| contested).map_or(0.0, |looks| self.likeness(place, looks, rest));
        FULL_EVIDENCE / f64::from(full) * gain + likeness - 0.5 * (pull * pull + pull_level * pull_level)
    }

    /// Whether there is a gap down the middle of a body so near that trunk or hips must close it: they are several.
    fn has_gap(&self, cell: i64, range_m: f64) -> bool {
        if range_m > GAP_RANGE_M || self.least_gap_range_m.is_none_or(|least_m| range_m < least_m) {
            return false;
        }
        let half = (self.columns_of(SOLID_M, range_m) / CELL[0] as f64).round() as i64;
        let mut empty = None; // cells without marks since the last solid one
        for step in -half..=half {
            let marked = self.upper[(cell + step).rem_euclid(self.columns as i64) as usize];
            if marked >= GAP_MARKED[1] {
                if empty.is_some_and(|n| n >= GAP_CELLS) {
                    return true;
                }
                empty = Some(0);
            } else if marked < GAP_MARKED[0]
                && let Some(n) = &mut empty
            {
                *n += 1;
            }
        }
        false
    }

    /// Two bodies beside each other, further away than a body, that explain its marks better.
    fn two_instead(&self, place: &Place, rest: &Rest) -> Option<[Place; 2]> {
        let one = self.gain(place.cell, &place.silhouette, rest);
        let reach = self.columns_of(0.5, place.silhouette.range_m) / CELL[0] as f64;
        let reach = (reach.ceil() as i64).min(self.columns as i64 / 4);
        let gap = self.has_gap(place.cell, place.silhouette.range_m);
        let more = if gap { SPLIT_GAIN_AT_GAP } else { SPLIT_GAIN };
        let mut best: Option<(f32, [(i64, usize); 2])> = None;
        for l in place.level..LEVELS.min(place.level + 14) {
            if !gap && self.highest_m[l] < HEADS_M {
                continue;
            }
            let s = self.silhouettes.average(l);
            let apart = (self.columns_of(SPLIT_APART_M, s.range_m) / CELL[0] as f64).ceil() as usize;
            let gains: Vec<f32> = (-reach..=reach).map(|step| self.gain(place.cell + step, s, rest)).collect();
            for i in 0..gains.len() {
                for j in i + apart.max(1)..gains.len() {
                    let both = gains[i] + gains[j];
                    if gains[i].min(gains[j]) > LEAST_GAIN * s.full
                        && both > one + more * s.full
                        && best.is_none_or(|(most, _)| both > most)
                    {
                        best = Some((both, [i, j].map(|i| (place.cell - reach + i as i64, l))));
                    }
                }
            }
        }
        let (_, pair) = best?;
        let [a, b] = pair.map(|(cell, level)| self.average_at(cell, level));
        let mut left = rest.clone();
        self.explain(&mut left, &a);
        let both = self.gain(a.cell, &a.silhouette, rest) + self.gain(b.cell, &b.silhouette, &left);
        (both > one + more * a.silhouette.full).then_some([a, b])
    }

    fn best_new(&self, rest: &Rest) -> Option<Place> {
        /// Cells of a column that must be unexplained for its middle to be somebody's axis.
        const LEAST_CELLS: f32 = 2.5;
        let stride = self.stride();
        let mut left = vec![0f32; self.columns];
        for row in 0..self.rows {
            let at = row * stride + self.pad;
            for (sum, m) in left.iter_mut().zip(&rest.marked[at..]) {
                *sum += m;
            }
        }
        let mut found: Vec<(f32, i64, usize)> = Vec::new();
        for cell in (0..self.columns as i64).filter(|c| left[*c as usize] >= LEAST_CELLS) {
            let gain = |l: usize| {
                let s = self.silhouettes.average(l);
                (!self.has_gap(cell, s.range_m)).then(|| (self.gain(cell, s, rest), cell, l))
            };
            // Every other distance, then those beside the best.
            let more = |a: &(f32, i64, usize), b: &(f32, i64, usize)| a.0.total_cmp(&b.0);
            let Some(rough) = (0..LEVELS).step_by(2).filter_map(gain).max_by(more) else { continue };
            let beside = [rough.2.wrapping_sub(1), rough.2 + 1].into_iter().filter(|l| *l < LEVELS).filter_map(gain);
            found.extend(beside.chain([rough]).max_by(more));
        }
        found.sort_by(|a, b| b.0.total_cmp(&a.0));
        found.into_iter().find_map(|(gain, cell, level)| {
            let place = self.average_at(cell, level);
            let enough = gain > LEAST_TOTAL && gain > LEAST_GAIN * place.silhouette.full;
            (enough && !self.is_part_of_more(&place, rest)).then_some(place)
        })
    }

    /// Whether what is marked goes on beside the body as densely as inside.
    fn is_part_of_more(&self, place: &Place, rest: &Rest) -> bool {
        let s = &place.silhouette;
        let stride = self.stride();
        let beyond = (s.half / 2).max(2);
        let (mut inside, mut beside) = ([0f32; 2], [[0f32; 2]; 2]);
        for (row, cover) in s.cover.chunks_exact(s.width()).enumerate() {
            if cover[s.half] < 0.5 {
                continue;
            }
            for step in -((s.half + beyond) as i64)..=(s.half + beyond) as i64 {
                let at = row * stride + self.pad + (place.cell + step).rem_euclid(self.columns as i64) as usize;
                let i = step + s.half as i64;
                let c = if (0..s.width() as i64).contains(&i) { cover[i as usize] } else { 0.0 };
                let sums = if c > 0.5 {
                    &mut inside
                } else if c < 0.05 {
                    &mut beside[usize::from(step > 0)]
                } else {
                    continue;
                };
                sums[0] += rest.marked[at];
                sums[1] += rest.marked[at] + rest.unmarked[at];
            }
        }
        let share = |[marked, all]: [f32; 2]| marked / all.max(1e-3);
        beside.iter().all(|b| share(*b) > MOST_BESIDE * share(inside))
    }

    /// What is each figure's own, how well it is supported, and whether it exists.
    fn judge(&self, mut figures: Vec<Figure>) -> Vec<Figure> {
        for k in 0..figures.len() {
            let me = &figures[k];
            let others = || figures.iter().enumerate().filter(|(j, _)| *j != k);
            let in_front = || others().filter(|(j, f)| precedes(f, *j, me, k)).map(|(_, f)| &f.place);
            let free = self.visible(in_front());
            let alone = self.visible(others().map(|(_, f)| &f.place));
            let s = &me.place.silhouette;
            let (mut own, mut apart, mut all, mut expected, mut next) = (0f32, 0f32, 0f32, 0f32, 0);
            self.for_cells(&me.place, |i, c| {
                let gain = s.expected_gain(next, c);
                next += 1;
                own += free[i] * c;
                apart += alone[i] * c;
                all += self.weight[i] * c;
                expected += free[i] * gain;
            });
            let gain = self.gain(me.place.cell, s, &self.rest(in_front()));
            let all = all.max(1e-3);
            let figure = &mut figures[k];
            (figure.own, figure.apart, figure.support) = (own / all, apart / all, gain / expected.max(1e-3));
        }
        for k in 0..figures.len() {
            let me = &figures[k];
            // Who is hidden, by whomever, explains nothing to those who are established.
            let explains = |f: &Figure| f.shows() || me.seniority < ESTABLISHED;
            let others = figures.iter().enumerate().filter(|(j, _)| *j != k);
            let seniors = others.filter(|(j, f)| (f.seniority, k) > (me.seniority, *j) && explains(f));
            figures[k].evidence = self.share_beyond(me, seniors.map(|(_, f)| &f.place));
        }
        figures
    }

    /// How much is missing without one of the figures: its evidence by what none of the others explains.
    pub(super) fn needed(&self, figures: &[Figure], k: usize) -> f32 {
        let others = figures.iter().enumerate().filter(|(j, _)| *j != k);
        self.share_beyond(&figures[k], others.map(|(_, f)| &f.place))
    }

    /// Log-likelihood gained by what `others` do not explain, against what the whole body would.
    fn share_beyond<'a>(&self, me: &Figure, others: impl Iterator<Item = &'a Place>) -> f32 {
        let s = &me.place.silhouette;
        let (mut full, mut next) = (0f32, 0);
        self.for_cells(&me.place, |i, c| {
            full += self.weight[i] * s.expected_gain(next, c);
            next += 1;
        });
        self.gain(me.place.cell, s, &self.rest(others)) / full.max(1e-3)
    }

    fn owners(&self, figures: &[Figure]) -> Vec<u8> {
        let mut owner = vec![NOBODY; self.rows * self.columns];
        let mut strength = vec![0f32; owner.len()];
        let mut order: Vec<usize> = (0..figures.len().min(usize::from(NOBODY))).collect();
        // Those in front first.
        order.sort_by(|&a, &b| {
            if precedes(&figures[a], a, &figures[b], b) {
                std::cmp::Ordering::Less
            } else {
                std::cmp::Ordering::Greater
            }
        });
        for k in order {
            let f = &figures[k];
            let s = &f.place.silhouette;
            for (row, cover) in s.cover.chunks_exact(s.width()).enumerate() {
                for (i, c) in cover.iter().enumerate() {
                    let column = (f.place.cell + i as i64 - s.half as i64).rem_euclid(self.columns as i64) as usize;
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
    let step = |f: &Figure| (f.place.level as f64 / (NEARER + 1.0)) as usize;
    (step(a), std::cmp::Reverse(a.seniority), index_a) < (step(b), std::cmp::Reverse(b.seniority), index_b)
}

fn level_log_step() -> f64 {
    (silhouette::range_of_level(1.0) / silhouette::range_of_level(0.0)).ln()
}

fn gain_of_row(marked: &[f32], unmarked: &[f32], if_marked: &[f32], if_unmarked: &[f32]) -> f32 {
    let mut sums = [0f32; 8];
    let [m, u, a, b] = [marked, unmarked, if_marked, if_unmarked].map(|s| s.chunks_exact(8));
    let [mt, ut, at, bt] = [&m, &u, &a, &b].map(|c| c.remainder());
    for (((m, u), a), b) in m.zip(u).zip(a).zip(b) {
        for i in 0..8 {
            sums[i] += m[i] * a[i] + u[i] * b[i];
        }
    }
    let tail: f32 = mt.iter().zip(at).chain(ut.iter().zip(bt)).map(|(w, g)| w * g).sum();
    sums.iter().sum::<f32>() + tail
}

/// Cells at the ends of each row are repeated beyond the other end.
fn repeat_ends(values: &mut [f32], columns: usize, pad: usize) {
    for row in values.chunks_exact_mut(columns + 2 * pad) {
        row.copy_within(columns..columns + pad, 0);
        row.copy_within(pad..2 * pad, pad + columns);
    }
}

#[cfg(test)]
mod tests;
