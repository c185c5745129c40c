//! Halos: blur, compression and soft shadow round a strong object are faint changes too, but beside it they are not it.
//!
//! A faint mark counts only if it reaches a share of the strongest change nearby (cells of 8 × 8 pixels and their
//! neighbours). Beside somebody in black that trims the halo; of somebody dressed like the wall it takes nothing.

use super::kernel;
use super::marks::{Marks, WORD};
use super::raster::Raster;

/// Side of a cell, pixels.
pub(super) const CELL: usize = 8;

/// Local maxima with their working memory.
#[derive(Debug)]
pub(crate) struct Halo {
    raster: Raster,
    cells: [usize; 2],
    /// Strongest change of each cell.
    maxima: Vec<u8>,
    /// Of a row of cells and those above and below.
    column: Vec<u8>,
    /// Below which marks are taken away in each cell of that row, cells of whole words of marks.
    thresholds: Vec<u8>,
    /// The largest of them of each word.
    most_of_words: Vec<u8>,
    row: Vec<u8>,
}

impl Halo {
    pub(crate) fn new(raster: Raster) -> Self {
        let cells = [raster.width.div_ceil(CELL), raster.height.div_ceil(CELL)];
        let maxima = vec![0; cells[0] * cells[1]];
        let words = raster.width.div_ceil(WORD);
        Self {
            raster,
            cells,
            maxima,
            column: vec![0; cells[0]],
            thresholds: vec![0; words * WORD / CELL],
            most_of_words: vec![0; words],
            row: vec![0; cells[0] * CELL],
        }
    }

    /// Begins a band of [`CELL`] rows.
    pub(super) fn band(&mut self) {
        self.row.fill(0);
    }

    /// The strongest change of each column of the band so far: to be raised while it is marked, and then noted. As many as there are
    /// columns at least.
    pub(super) fn most(&mut self) -> &mut [u8] {
        &mut self.row
    }

    /// Takes note of what a band's columns came to.
    pub(super) fn note(&mut self, band: usize) {
        let columns = self.cells[0];
        kernel::largest_of_eights(&self.row[..columns * CELL], &mut self.maxima[band * columns..][..columns]);
    }

    /// Takes away marks whose `magnitude` (grey levels) is below `share_q8` / 256 of the strongest nearby, after all bands were
    /// noted. No mark has a magnitude below `least`.
    pub(super) fn trim(&mut self, magnitude: &[u8], share_q8: u8, least: u8, marks: &mut Marks) {
        let Raster { width, height, wraps } = self.raster;
        let [columns, rows] = self.cells;
        for band in 0..rows {
            self.column.copy_from_slice(&self.maxima[band * columns..][..columns]);
            for near in [band.wrapping_sub(1), band + 1] {
                if near < rows {
                    kernel::raise(&self.maxima[near * columns..][..columns], &mut self.column);
                }
            }
            kernel::thresholds(&self.column, wraps, share_q8, &mut self.thresholds[..columns]);
            kernel::largest_of_eights(&self.thresholds, &mut self.most_of_words);
            for (word, most) in self.most_of_words.iter().enumerate() {
                // Where something is to be taken away.
                if *most <= least {
                    continue;
                }
                let columns = word * WORD..((word + 1) * WORD).min(width);
                let cells = word * WORD / CELL..columns.end.div_ceil(CELL);
                for (cell, threshold) in cells.clone().zip(&self.thresholds[cells]) {
                    self.row[cell * CELL..][..CELL].fill(*threshold);
                }
                let (first, stride) = (band * CELL, marks.stride());
                let lines = CELL.min(height - first);
                let values = &magnitude[first * width + columns.start..];
                let words = &mut marks.words_mut()[first * stride + word..];
                kernel::keep_at_least(values, width, lines, &self.row[columns], words, stride);
            }
        }
    }
}
