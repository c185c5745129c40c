//! Sees in a camera's own picture where its panorama need not be drawn again.
//!
//! Each cell of the panorama (see [`Work`]) has blocks of 128 pixels of the picture, taken from some rows of what the cell shows,
//! every one of small pictures to every eighth of large ones. Their sum of absolute differences to the picture that the cell was last drawn from is, where nothing changed,
//! the camera's noise, which is learnt block by block: it scatters by 7 %, so a threshold 28 % above it is passed by one block in
//! 10⁵ by chance. It sees a block that is 1.2, and half a block that is 1.6 standard deviations of the noise brighter or darker than it was; the
//! change stage needs 4 of them somewhere in each body. What changes slowly is seen when it has changed as much, since the reference stays.

use std::ops::Range;

use super::kernel::{self, Segment};
use super::{Lut, UnwarpError};
use crate::motion::{CELL_COLUMNS, CELL_ROWS, Drawing, Work};

/// Segments of a block.
const SEGMENTS: usize = 8;
/// Pixels of a segment.
const LENGTH: usize = size_of::<Segment>();
/// Pixels of a cell that are looked at, about: large cells are looked at in fewer of their rows.
const CELL_PIXELS: usize = 400;
/// Most rows of the picture from one that is looked at to the next.
const MOST_STEP: usize = 8;
/// A block's expected difference follows what it is by one part in so many; the second where it changed, in case its noise did.
const FOLLOW: i32 = 8;
const SLOWLY: i32 = 64;
/// Where a larger share of the cells that are looked at has changed all others are looked at, too: the light may have.
const MANY: f64 = 0.15;
/// More than the expected difference: a share of it in 1/256, and so much for rounding.
const MORE_Q8: u32 = 72;
const ROUNDING: u32 = 16;
/// A block is expected to differ by at most so many times what the middle one does.
const MOST_NOISY: u16 = 3;
/// Frames in which blocks learn what to expect before they judge.
const LEARNING_FRAMES: u32 = 8;

/// What a panorama was drawn from.
#[derive(Debug)]
pub struct Watch {
    columns: usize,
    /// Blocks of each cell, column by column.
    cells: Vec<Range<usize>>,
    /// Lines of the cache that each cell's blocks lie on, and all of them.
    cell_lines: Vec<Range<usize>>,
    lines: Vec<u32>,
    places: Vec<[u32; SEGMENTS]>,
    reference: Vec<[Segment; SEGMENTS]>,
    /// What each block differs by if nothing changes, and at most.
    expected: Vec<u16>,
    most_expected: u16,
    sums: Vec<u16>,
    /// Cells that are looked at in a frame, and all of their blocks.
    looked: Vec<Place>,
    looked_blocks: Vec<u32>,
    looked_lines: Vec<u32>,
    source_len: usize,
    /// Frames since the reference was begun.
    frames: u32,
}

/// A cell: its place among all of them, and in the panorama.
#[derive(Debug, Clone, Copy)]
struct Place {
    cell: usize,
    column: usize,
    band: usize,
}

impl Watch {
    /// For the pictures of a table.
    pub fn new(lut: &Lut) -> Self {
        let [width, height] = lut.size_px().map(|n| n as usize);
        let size = [width.div_ceil(CELL_COLUMNS), height.div_ceil(CELL_ROWS)];
        let source = lut.source_size_px().map(|n| n as usize);
        let (mut cells, mut places) = (Vec::new(), Vec::new());
        let (mut cell_lines, mut lines) = (Vec::new(), Vec::new());
        for column in 0..size[0] {
            for band in 0..size[1] {
                let first = places.len();
                let columns = column * CELL_COLUMNS..((column + 1) * CELL_COLUMNS).min(width);
                let rows = band * CELL_ROWS..((band + 1) * CELL_ROWS).min(height);
                add_blocks(&segments(lut, columns, rows, source), &mut places);
                cells.push(first..places.len());
                let first_line = lines.len();
                let starts = places[first..].iter().flatten().copied();
                lines.extend(crate::motion::kernel::lines_of(starts, LENGTH as u32));
                cell_lines.push(first_line..lines.len());
            }
        }
        let n = places.len();
        Self {
            columns: size[0],
            cells,
            cell_lines,
            looked_lines: Vec::with_capacity(lines.len()),
            lines,
            places,
            reference: vec![[[0; LENGTH]; SEGMENTS]; n],
            expected: vec![0; n],
            most_expected: 0,
            sums: vec![0; n],
            looked: Vec::with_capacity(size[0] * size[1]),
            looked_blocks: Vec::with_capacity(n),
            source_len: source[0] * source[1],
            frames: 0,
        }
    }

    /// Bytes held.
    pub fn memory_bytes(&self) -> usize {
        size_of_val(&*self.cells)
            + size_of_val(&*self.cell_lines)
            + size_of_val(&*self.lines)
            + size_of_val(&*self.places)
            + size_of_val(&*self.reference)
            + size_of_val(&*self.expected)
            + size_of_val(&*self.sums)
            + self.looked.capacity() * size_of::<Place>()
            + (self.looked_blocks.capacity() + self.looked_lines.capacity()) * size_of::<u32>()
    }

    /// Unwarps a picture as far as the drawing's [`Work`] says and wherever it shows something else than it did, and tells it where
    /// that was. All pictures must come here, one after the other.
    ///
    /// # Errors
    /// A source or output of another size than the table's.
    pub fn unwarp(&mut self, lut: &Lut, source: &[u8], mut drawing: Drawing<'_>) -> Result<(), UnwarpError> {
        let work = drawing.work();
        let bands = self.cells.len() / self.columns.max(1);
        if source.len() != self.source_len || work.size() != [self.columns, bands] {
            work.work_all();
            return lut.unwarp(source, drawing.canvas().picture);
        }
        if !work.is_steady() {
            self.frames = 0;
            work.work_all();
            return lut.unwarp(source, drawing.canvas().picture);
        }
        if work.is_whole() {
            self.learn(source);
        } else if self.frames < LEARNING_FRAMES {
            self.learn(source);
            for (column, band) in (0..self.columns).flat_map(|column| (0..bands).map(move |band| (column, band))) {
                work.draw(column, band);
            }
        } else {
            self.look(lut, source, work);
            work.settle();
        }
        let canvas = drawing.canvas();
        let work = canvas.work;
        lut.unwarp_cells(source, canvas)?;
        // A cell that will be drawn again before anybody looks at it needs no reference, but to learn from.
        let learns = self.frames < LEARNING_FRAMES;
        for Place { cell, column, band } in places(self.columns, bands) {
            if work.is_worked(column, band) && (learns || !work.stays_worked(column, band)) {
                let blocks = self.cells[cell].clone();
                kernel::copy(source, &self.places[blocks.clone()], &mut self.reference[blocks]);
            }
        }
        Ok(())
    }

    /// Tells `work` of the cells that have changed, of those that are to be looked at; of all where many of those have.
    fn look(&mut self, lut: &Lut, source: &[u8], work: &mut Work) {
        lut.fetch_first(source, work);
        self.choose(|at| work.is_looked_at(at.column, at.band));
        let changed = self.look_at(source, work);
        let many = changed as f64 > MANY * self.looked.len() as f64;
        work.set_calm(!many && !self.looked.is_empty());
        if many {
            self.choose(|at| work.is_passed_over(at.column, at.band));
            self.look_at(source, work);
        }
    }

    /// Chooses the cells to be looked at, of those of which the camera sees something.
    fn choose(&mut self, wanted: impl Fn(Place) -> bool) {
        let Self { cells, columns, looked, looked_blocks, looked_lines, .. } = self;
        looked.clear();
        looked_blocks.clear();
        looked_lines.clear();
        for at in places(*columns, cells.len() / (*columns).max(1)).filter(|at| wanted(*at)) {
            let blocks = cells[at.cell].clone();
            if !blocks.is_empty() {
                looked.push(at);
                looked_blocks.extend(blocks.map(|block| block as u32));
                looked_lines.extend_from_slice(&self.lines[self.cell_lines[at.cell].clone()]);
            }
        }
    }

    /// By how much the blocks of the cells that were chosen differ from their reference.
    fn measure(&mut self, source: &[u8]) {
        let Self { places, reference, looked_blocks, looked_lines, sums, .. } = self;
        kernel::differences(source, places, reference, looked_blocks, looked_lines, sums);
    }

    /// Looks at the cells that were chosen; how many have changed.
    fn look_at(&mut self, source: &[u8], work: &mut Work) -> usize {
        self.measure(source);
        let mut all_changed = 0;
        for at in &self.looked {
            let blocks = self.cells[at.cell].clone();
            let (sums, expected) = (&self.sums[blocks.clone()], &mut self.expected[blocks]);
            let changed = sums.iter().zip(&*expected).any(|(sum, expected)| has_changed(*sum, *expected));
            if changed {
                work.draw(at.column, at.band);
                all_changed += 1;
            }
            let (most, pace) = (self.most_expected, if changed { SLOWLY } else { FOLLOW });
            sums.iter().zip(expected).for_each(|(sum, expected)| follow(*sum, pace, most, expected));
        }
        all_changed
    }

    /// Learns what to expect in the first frames, in which all is drawn: each block its own noise, but, since somebody may walk
    /// there, not far more than the middle one's.
    fn learn(&mut self, source: &[u8]) {
        if (1..LEARNING_FRAMES).contains(&self.frames) {
            self.choose(|_| true);
            self.measure(source);
            let mut sorted = self.sums.clone();
            let middle = sorted.len() / 2;
            if middle < sorted.len() {
                self.most_expected = (*sorted.select_nth_unstable(middle).1).saturating_mul(MOST_NOISY);
            }
            let (most, first) = (self.most_expected, self.frames == 1);
            for (sum, expected) in self.sums.iter().zip(&mut self.expected) {
                if first {
                    *expected = (*sum).min(most / 2);
                } else {
                    follow(*sum, FOLLOW, most, expected);
                }
            }
        }
        self.frames = self.frames.saturating_add(1);
    }
}

/// All cells, column by column.
fn places(columns: usize, bands: usize) -> impl Iterator<Item = Place> {
    (0..columns).flat_map(move |column| (0..bands).map(move |band| Place { cell: column * bands + band, column, band }))
}

fn has_changed(sum: u16, expected: u16) -> bool {
    let expected = u32::from(expected);
    u32::from(sum) > expected + ((expected * MORE_Q8) >> 8) + ROUNDING
}

/// The expected difference follows the measured one; what is far above it counts for little.
fn follow(sum: u16, pace: i32, most: u16, expected: &mut u16) {
    let sum = sum.min(expected.saturating_add(*expected / 2 + ROUNDING as u16));
    let change = (i32::from(sum) - i32::from(*expected)) / pace;
    *expected = (i32::from(*expected) + change).clamp(0, i32::from(most)) as u16;
}

/// Where the segments of a cell begin in the picture: what the cell shows, in some of the picture's rows.
fn segments(lut: &Lut, columns: Range<usize>, rows: Range<usize>, [stride, source_rows]: [usize; 2]) -> Vec<u32> {
    let width = lut.size_px()[0] as usize;
    // First and last pixel of each row of the picture.
    let mut used = std::collections::BTreeMap::<usize, [usize; 2]>::new();
    for i in rows.flat_map(|v| columns.clone().map(move |u| v * width + u)).filter(|i| lut.valid()[*i]) {
        let offset = lut.entries()[i].offset as usize;
        for offset in [offset, offset + stride] {
            let span = used.entry(offset / stride).or_insert([offset, offset + 1]);
            *span = [span[0].min(offset), span[1].max(offset + 1)];
        }
    }
    let pixels: usize = used.values().map(|[first, last]| last + 1 - first).sum();
    let step = (pixels / CELL_PIXELS).clamp(1, MOST_STEP).min(used.len().max(1));
    let mut segments = Vec::new();
    for [start, last] in used.into_values().skip(step / 2).step_by(step) {
        let n = (last + 1 - start).div_ceil(LENGTH);
        let start = start.min((stride * source_rows).saturating_sub(n * LENGTH));
        segments.extend((0..n).map(|k| (start + k * LENGTH) as u32));
    }
    segments
}

/// Adds whole blocks; the last one has some of the cell's other segments once more.
fn add_blocks(segments: &[u32], places: &mut Vec<[u32; SEGMENTS]>) {
    let n = segments.len();
    for first in (0..n).step_by(SEGMENTS) {
        let first = if n >= SEGMENTS { first.min(n - SEGMENTS) } else { first };
        places.push(std::array::from_fn(|k| segments[(first + k) % n]));
    }
}

#[cfg(test)]
mod tests;
