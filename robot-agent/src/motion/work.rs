//! Where a picture is worked: in most frames most of it shows what it showed before.
//!
//! Problem: unwarping, comparing and learning cost time a pixel, and a standing robot's picture changes in a tenth of them. Insight:
//! whether a piece of the raw picture still shows what it showed when it was last unwarped is seen far more cheaply (see
//! [`crate::panorama::Watch`]), and more surely than pixel by pixel, for a block averages the camera's noise. So the picture is cut
//! into cells. A cell is worked where something changed, where something is or was of late, and in turns every second or two, which
//! is all that background and noise need; elsewhere its last panorama stands and it has no marks. All cells are worked while there
//! is no background and while the robot moves. A look costs time, too: cells into which an object may come until the next frame are
//! looked at in every frame, the others about ten times a second.

use std::ops::Range;

use super::marks::{Marks, WORD};
use super::raster::Raster;
use super::{Patch, TIE, halo};

/// Rows of a cell.
pub(crate) const ROWS: usize = 2 * halo::CELL;
/// Columns of a cell.
pub(crate) const COLUMNS: usize = WORD;
/// Time within which each cell is worked, seconds, and frames at most.
const REST_S: f64 = 1.6;
const MOST_REST: usize = 48;
/// A cell with nothing beside it is looked at for changes so often, seconds: a fast camera's frames say little more.
const LOOK_S: f64 = 0.1;
const MOST_LOOK_TURNS: usize = 8;
/// Frames for which a cell is worked after something was in it.
const WARM_FRAMES: u8 = 2;
/// Pixels round an object into which it may come until the next frame: its blurred outline, and how far somebody walks who walks fast
/// and near, as a share of a ring a second.
const OUTLINE: usize = 3;
const WALKS: f64 = 0.05;
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
    /// Where an object is, or somebody is followed, or may come until the next frame.
    held: Vec<bool>,
    /// The same as it was noted in the last frame.
    near: Vec<bool>,
    frame: usize,
    rest: usize,
    /// Frames from one look at a cell to the next, and whose turn it is.
    look_turns: usize,
    look: usize,
    /// Pixels round an object into which it may come until the next frame.
    margin: usize,
    /// Whether all cells are drawn, because somebody wants to see them.
    all_drawn: bool,
    whole: bool,
    /// Whether the robot stands.
    steady: bool,
    /// Whether little of what was looked at in this picture has changed.
    calm: bool,
    /// Whether it was noted what the last picture showed.
    noted: bool,
    /// Of a row of cells: whether anything is marked.
    any: Vec<u64>,
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
            held: vec![false; n],
            near: vec![true; n],
            frame: 0,
            rest: 1,
            look_turns: 1,
            look: 0,
            margin: OUTLINE,
            all_drawn: false,
            whole: true,
            steady: false,
            calm: false,
            noted: false,
            any: Vec::new(),
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

    /// Takes note whether little has changed of what was looked at in this picture.
    pub(crate) fn set_calm(&mut self, calm: bool) {
        self.calm = calm;
    }

    /// Whether this picture was looked at and shows what it showed, but for what people change.
    pub(super) fn is_calm(&self) -> bool {
        self.calm && !self.whole
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
        self.calm = false;
        self.whole = false;
        self.rest = ((REST_S / spacing_s).round() as usize).clamp(1, MOST_REST);
        self.frame = (self.frame + 1) % self.rest;
        self.look_turns = ((LOOK_S / spacing_s + TIE).round() as usize).clamp(1, MOST_LOOK_TURNS);
        self.look = self.look.wrapping_add(1);
        self.all_drawn = false;
        self.margin = OUTLINE + (WALKS * self.raster.width as f64 * spacing_s).ceil() as usize;
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
        std::mem::swap(&mut self.near, &mut self.held);
        self.held.fill(false);
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

    /// Columns of the picture.
    pub(super) fn width(&self) -> usize {
        self.raster.width
    }

    /// Whether a cell is worked.
    #[inline]
    pub(crate) fn is_worked(&self, column: usize, band: usize) -> bool {
        self.cells[band * self.columns + column] != Cell::Rests
    }

    /// Whether no cell shows anything but this picture.
    pub(super) fn is_fresh(&self) -> bool {
        self.whole || self.all_drawn
    }

    /// Whether a cell is worked in the next frame, too, whatever is found in it now.
    pub(crate) fn stays_worked(&self, column: usize, band: usize) -> bool {
        self.warm[band * self.columns + column] >= WARM_FRAMES
    }

    /// How many pixels are worked at most.
    pub(super) fn worked_pixels(&self) -> usize {
        self.cells.iter().filter(|cell| **cell != Cell::Rests).count() * COLUMNS * ROWS
    }

    /// Whether all cells are.
    pub(crate) fn is_whole(&self) -> bool {
        self.whole
    }

    /// Whether a cell that rests is to be looked at in this frame: where something may come into it, or in its turn.
    #[inline]
    pub(crate) fn is_looked_at(&self, column: usize, band: usize) -> bool {
        let cell = band * self.columns + column;
        let its_turn = (column + self.look).is_multiple_of(self.look_turns);
        self.cells[cell] == Cell::Rests && (its_turn || self.near[cell])
    }

    /// Whether a cell that rests is not.
    pub(crate) fn is_passed_over(&self, column: usize, band: usize) -> bool {
        !self.is_looked_at(column, band) && !self.is_worked(column, band)
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
        self.all_drawn = true;
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
            Learning::ForAll => self.cells[i] == Cell::Visited && self.warm[i] == 0 && !self.held[i],
        })
    }

    /// Frames from one visit to the next.
    pub(super) fn rest(&self) -> usize {
        self.rest
    }

    /// Takes note of what was found: cells with marks of bodies stay worked.
    pub(super) fn note_marks(&mut self, bodies: &Marks) {
        self.noted = true;
        let mut any = std::mem::take(&mut self.any);
        for (band, rows) in self.bands() {
            any.clear();
            any.resize(self.columns, 0);
            for y in rows {
                any.iter_mut().zip(bodies.row(y)).for_each(|(any, word)| *any |= word);
            }
            let cells = band * self.columns..(band + 1) * self.columns;
            for ((warm, cell), any) in self.warm[cells.clone()].iter_mut().zip(&self.cells[cells]).zip(&any) {
                if *cell != Cell::Rests {
                    *warm = if *any != 0 { WARM_FRAMES } else { warm.saturating_sub(1) };
                }
            }
        }
        self.any = any;
    }

    /// Cells at a place are looked at, and are not learnt as what nothing is in.
    pub(super) fn note_patch(&mut self, patch: &Patch) {
        let arc = patch.arc.grown(self.margin, &self.raster);
        let last = (patch.rows[1] + self.margin).min(self.raster.height - 1);
        let bands = patch.rows[0].saturating_sub(self.margin) / ROWS..last / ROWS + 1;
        let first = arc.width.min(self.raster.width - arc.start);
        for columns in [arc.start..arc.start + first, 0..arc.width - first].iter().filter(|c| !c.is_empty()) {
            for band in bands.clone() {
                let cells = columns.start / COLUMNS..(columns.end - 1) / COLUMNS + 1;
                self.held[band * self.columns + cells.start..band * self.columns + cells.end].fill(true);
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
    #[inline]
    pub(super) fn pixels(&self, y: usize, width: usize) -> Range<usize> {
        y * width + self.columns.start..y * width + self.columns.end
    }

    /// The same in rows of `stride` words.
    #[inline]
    pub(super) fn marks(&self, y: usize, stride: usize) -> Range<usize> {
        y * stride + self.words.start..y * stride + self.words.end
    }
}
