//! Where a picture is worked: in most frames most of it shows what it showed before.
//!
//! Problem: unwarping, comparing and learning cost time a pixel, and a standing robot's picture changes in a tenth of them. Insight:
//! whether a piece of the raw picture still shows what it showed when it was last unwarped is seen far more cheaply (see
//! [`crate::panorama::Watch`]), and more surely than pixel by pixel, for a block averages the camera's noise. So the picture is cut
//! into cells. A cell is worked where something changed, where something is or was of late, and in turns a few times a second, which
//! is all that background and noise need; elsewhere its last panorama stands and it has no marks. All cells are worked while there
//! is no background and while the robot moves.

use std::ops::Range;

use super::marks::{Marks, WORD};
use super::raster::Raster;
use super::{Patch, halo};

/// Rows of a cell.
pub(crate) const ROWS: usize = 2 * halo::CELL;
/// Columns of a cell.
pub(crate) const COLUMNS: usize = WORD;
/// Time within which each cell is worked, seconds, and frames at most.
const REST_S: f64 = 0.4;
const MOST_REST: usize = 12;
/// Frames for which a cell is worked after something was in it.
const WARM_FRAMES: u8 = 4;
/// Pixels round an object within which cells are worked.
const MARGIN: usize = 8;
/// A picture of which a larger share of cells changes is worked whole.
const MOST_CHANGED: f64 = 0.4;

/// How a cell is worked in this frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum Cell {
    /// Not at all: it shows what it showed.
    #[default]
    Rests,
    /// It is its turn.
    Visited,
    /// Something changed, or somebody wants to see it.
    Drawn,
    /// As in the frames before: something is there, or all is worked.
    Followed,
}

/// What is learnt of a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Learning {
    /// The rows whose turn it is.
    InTurn,
    /// All of it, for the frames since it was visited last.
    ForAll,
}

/// The cells of a picture: which of them are worked.
#[derive(Debug)]
pub struct Work {
    raster: Raster,
    columns: usize,
    cells: Vec<Cell>,
    /// Frames for which each cell stays worked.
    warm: Vec<u8>,
    /// Worked in the frame before: what is left there must be wiped.
    before: Vec<bool>,
    frame: usize,
    rest: usize,
    whole: bool,
    /// Whether the robot stands.
    steady: bool,
    /// Whether it was noted what the last picture showed.
    noted: bool,
}

impl Work {
    pub(super) fn new(raster: Raster) -> Self {
        let columns = raster.width.div_ceil(COLUMNS);
        let n = columns * raster.height.div_ceil(ROWS);
        Self {
            raster,
            columns,
            cells: vec![Cell::Followed; n],
            warm: vec![0; n],
            before: vec![true; n],
            frame: 0,
            rest: 1,
            whole: true,
            steady: false,
            noted: false,
        }
    }

    /// Nothing is worked yet.
    #[cfg(test)]
    pub(crate) fn resting(raster: Raster) -> Self {
        let mut work = Self::new(raster);
        work.cells.fill(Cell::Rests);
        work.whole = false;
        work
    }

    /// Takes note whether the robot stands.
    pub(super) fn set_steady(&mut self, steady: bool) {
        self.steady = steady;
    }

    /// Whether the picture shows what it showed but for what moves.
    pub(crate) fn is_steady(&self) -> bool {
        self.steady
    }

    /// All of the next picture is worked.
    pub(super) fn plan_all(&mut self) {
        self.note_before();
        self.work_all();
    }

    /// The next picture is worked where something is, and where it is a cell's turn. `spacing_s`: between frames.
    pub(super) fn plan(&mut self, spacing_s: f64) {
        // Nobody looked what was there.
        if !std::mem::take(&mut self.noted) {
            return self.plan_all();
        }
        self.note_before();
        self.whole = false;
        self.rest = ((REST_S / spacing_s).round() as usize).clamp(1, MOST_REST);
        self.frame = (self.frame + 1) % self.rest;
        let cells = self.cells.len();
        for (i, (cell, warm)) in self.cells.iter_mut().zip(&self.warm).enumerate() {
            // Neighbours have their turns together: what lies in one piece is read faster.
            let turn = i * self.rest / cells;
            *cell = if *warm > 0 {
                Cell::Followed
            } else if turn == self.frame {
                Cell::Visited
            } else {
                Cell::Rests
            };
        }
    }

    fn note_before(&mut self) {
        for (before, cell) in self.before.iter_mut().zip(&self.cells) {
            *before = *cell != Cell::Rests;
        }
    }

    /// Cells a row and rows of cells.
    pub(crate) fn size(&self) -> [usize; 2] {
        [self.columns, self.cells.len() / self.columns.max(1)]
    }

    /// Whether a cell is worked.
    pub(crate) fn is_worked(&self, column: usize, band: usize) -> bool {
        self.cells[band * self.columns + column] != Cell::Rests
    }

    /// Whether all cells are.
    pub(crate) fn is_whole(&self) -> bool {
        self.whole
    }

    /// Something changed in a cell.
    pub(crate) fn draw(&mut self, column: usize, band: usize) {
        let cell = &mut self.cells[band * self.columns + column];
        if *cell == Cell::Rests {
            *cell = Cell::Drawn;
        }
    }

    /// All cells are drawn, because somebody wants to see them.
    pub(super) fn draw_all(&mut self) {
        for cell in self.cells.iter_mut().filter(|cell| **cell == Cell::Rests) {
            *cell = Cell::Drawn;
        }
    }

    /// After all changes are known: where nearly everything changes, everything is worked.
    pub(crate) fn settle(&mut self) {
        let drawn = self.cells.iter().filter(|cell| **cell == Cell::Drawn).count();
        if drawn as f64 > MOST_CHANGED * self.cells.len() as f64 {
            self.work_all();
        }
    }

    /// All of this picture is worked.
    pub(crate) fn work_all(&mut self) {
        self.cells.fill(Cell::Followed);
        self.whole = true;
    }

    /// Neighbouring cells of a band that are alike, as columns of pixels and of words.
    fn runs(&self, band: usize, alike: impl Fn(usize) -> bool) -> impl Iterator<Item = Run> {
        let first = band * self.columns;
        let (columns, width) = (self.columns, self.raster.width);
        let mut at = 0;
        std::iter::from_fn(move || {
            let start = (at..columns).find(|c| alike(first + c))?;
            let end = (start + 1..columns).find(|c| !alike(first + c)).unwrap_or(columns);
            at = end;
            Some(Run { words: start..end, columns: start * COLUMNS..(end * COLUMNS).min(width) })
        })
    }

    /// Bands of cells and their rows.
    pub(super) fn bands(&self) -> impl Iterator<Item = (usize, Range<usize>)> + use<> {
        let height = self.raster.height;
        (0..height.div_ceil(ROWS)).map(move |band| (band, band * ROWS..((band + 1) * ROWS).min(height)))
    }

    /// Where a band is worked.
    pub(super) fn worked(&self, band: usize) -> impl Iterator<Item = Run> {
        self.runs(band, move |i| self.cells[i] != Cell::Rests)
    }

    /// Where a band was worked in the frame before, and is not in this one.
    pub(super) fn left(&self, band: usize) -> impl Iterator<Item = Run> {
        self.runs(band, move |i| self.cells[i] == Cell::Rests && self.before[i])
    }

    /// Where a band is learnt so.
    pub(super) fn learnt(&self, band: usize, learning: Learning) -> impl Iterator<Item = Run> {
        self.runs(band, move |i| match learning {
            Learning::InTurn => self.cells[i] == Cell::Followed,
            Learning::ForAll => self.cells[i] == Cell::Visited && self.warm[i] == 0,
        })
    }

    /// Frames from one visit to the next.
    pub(super) fn rest(&self) -> usize {
        self.rest
    }

    /// Takes note of what was found: cells with marks of bodies stay worked.
    pub(super) fn note_marks(&mut self, bodies: &Marks) {
        self.noted = true;
        for (band, warm) in self.warm.chunks_exact_mut(self.columns).enumerate() {
            let rows = band * ROWS..((band + 1) * ROWS).min(self.raster.height);
            for (column, warm) in warm.iter_mut().enumerate() {
                if self.cells[band * self.columns + column] == Cell::Rests {
                    continue;
                }
                let any = rows.clone().fold(0, |any, y| any | bodies.row(y)[column]);
                *warm = if any != 0 { WARM_FRAMES } else { warm.saturating_sub(1) };
            }
        }
    }

    /// Cells near a place stay worked.
    pub(super) fn note_patch(&mut self, patch: &Patch) {
        let arc = patch.arc.grown(MARGIN, &self.raster);
        let last = (patch.rows[1] + MARGIN).min(self.raster.height - 1);
        let bands = patch.rows[0].saturating_sub(MARGIN) / ROWS..last / ROWS + 1;
        let first = arc.width.min(self.raster.width - arc.start);
        for columns in [arc.start..arc.start + first, 0..arc.width - first].iter().filter(|c| !c.is_empty()) {
            for band in bands.clone() {
                let cells = columns.start / COLUMNS..(columns.end - 1) / COLUMNS + 1;
                for warm in &mut self.warm[band * self.columns + cells.start..band * self.columns + cells.end] {
                    *warm = (*warm).max(1);
                }
            }
        }
    }
}

/// Neighbouring cells of a row.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Run {
    /// In words of marks.
    pub(super) words: Range<usize>,
    /// In pixels.
    pub(super) columns: Range<usize>,
}

impl Run {
    /// Where it lies in a picture of some width, in row `y`.
    pub(super) fn pixels(&self, y: usize, width: usize) -> Range<usize> {
        y * width + self.columns.start..y * width + self.columns.end
    }

    /// The same in rows of `stride` words.
    pub(super) fn marks(&self, y: usize, stride: usize) -> Range<usize> {
        y * stride + self.words.start..y * stride + self.words.end
    }
}
