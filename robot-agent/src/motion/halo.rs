//! Halos: blur, compression and soft shadow round a strong object are faint changes too, but beside it they are not it.
//!
//! A faint mark counts only if it reaches a share of the strongest change nearby (cells of 8 × 8 pixels and their
//! neighbours). Beside somebody in black that trims the halo; of somebody dressed like the wall it takes nothing.

use super::kernel;
use super::raster::Raster;

const CELL: usize = 8;

/// Local maxima with their working memory.
#[derive(Debug)]
pub(crate) struct Halo {
    raster: Raster,
    cells: [usize; 2],
    maxima: Vec<u8>,
    spread: Vec<u8>,
    row: Vec<u8>,
}

impl Halo {
    pub(crate) fn new(raster: Raster) -> Self {
        let cells = [raster.width.div_ceil(CELL), raster.height.div_ceil(CELL)];
        let n = cells[0] * cells[1];
        Self { raster, cells, maxima: vec![0; n], spread: vec![0; n], row: vec![0; cells[0] * CELL] }
    }

    /// Takes away marks whose `magnitude` (grey levels) is below `share_q8` / 256 of the strongest nearby.
    pub(crate) fn trim(&mut self, magnitude: &[u8], share_q8: u8, marks: &mut [u8]) {
        let Raster { width, height, wraps } = self.raster;
        let [columns, rows] = self.cells;
        for cy in 0..rows {
            self.row.fill(0);
            for y in cy * CELL..((cy + 1) * CELL).min(height) {
                kernel::raise(&magnitude[y * width..(y + 1) * width], &mut self.row);
            }
            for (cell, pixels) in self.maxima[cy * columns..].iter_mut().zip(self.row.chunks_exact(CELL)) {
                *cell = pixels.iter().copied().fold(0, u8::max);
            }
        }
        for cy in 0..rows {
            for cx in 0..columns {
                let mut most = 0;
                for ny in cy.saturating_sub(1)..(cy + 2).min(rows) {
                    for dx in [columns - 1, 0, 1] {
                        let inside = wraps || (cx + dx >= columns && dx > 1) || (dx <= 1 && cx + dx < columns);
                        if inside {
                            most = most.max(self.maxima[ny * columns + (cx + dx) % columns]);
                        }
                    }
                }
                self.spread[cy * columns + cx] = ((u16::from(most) * u16::from(share_q8)) >> 8) as u8;
            }
            for (pixels, &cell) in self.row.chunks_exact_mut(CELL).zip(&self.spread[cy * columns..]) {
                pixels.fill(cell);
            }
            for y in cy * CELL..((cy + 1) * CELL).min(height) {
                let range = y * width..(y + 1) * width;
                kernel::keep_at_least(&magnitude[range.clone()], &self.row, &mut marks[range]);
            }
        }
    }
}
