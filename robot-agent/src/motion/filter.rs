//! Faint marks become whole bodies: a pixel belongs to an object where most of its neighbourhood is marked.
//!
//! A person whose clothes are a few grey levels from the wall behind marks only about half of its pixels at a threshold
//! near the noise, while noise alone marks a tenth. Counting marks in a window separates the two by many standard
//! deviations, and asking for *half* of the window keeps edges where they are (it is the binary median), so bodies are
//! found whole without growing.

use super::kernel;
use super::raster::Raster;

/// Windowed majority with its working memory.
#[derive(Debug)]
pub(crate) struct Majority {
    raster: Raster,
    reach: [usize; 2],
    /// Least number of marks in the window of each pixel: half of the window's valid pixels, rounded up.
    need: Vec<u8>,
    /// Of each row, where it is the same in all columns.
    alike: Vec<Option<u8>>,
    sums: Vec<u8>,
    padded: Vec<u8>,
    zeros: Vec<u8>,
}

impl Majority {
    /// For windows of (2·reach[0] + 1) × (2·reach[1] + 1) pixels, at most 255; `valid` is 0 or 1.
    pub(crate) fn new(raster: Raster, reach: [usize; 2], valid: &[u8]) -> Self {
        let mut majority = Self {
            raster,
            reach,
            need: vec![0; raster.len()],
            alike: Vec::new(),
            sums: vec![0; raster.width],
            padded: vec![0; raster.width + 2 * reach[0]],
            zeros: vec![0; raster.width],
        };
        for y in 0..raster.height {
            for x in 0..raster.width {
                let mut count = 0u32;
                for dy in y.saturating_sub(reach[1])..(y + reach[1] + 1).min(raster.height) {
                    for dx in 0..=2 * reach[0] {
                        let column = (x + dx) as isize - reach[0] as isize;
                        let w = raster.width as isize;
                        let column = if raster.wraps { column.rem_euclid(w) } else { column };
                        if (0..w).contains(&column) {
                            count += u32::from(valid[dy * raster.width + column as usize]);
                        }
                    }
                }
                majority.need[y * raster.width + x] = (count / 2 + 1) as u8;
            }
        }
        let rows = majority.need.chunks_exact(raster.width);
        majority.alike = rows.map(|row| row.iter().all(|n| *n == row[0]).then_some(row[0])).collect();
        majority
    }

    /// Bytes held.
    pub(crate) fn memory_bytes(&self) -> usize {
        self.need.len() + size_of_val(&*self.alike) + self.sums.len() + self.padded.len() + self.zeros.len()
    }

    /// `out` = 1 where more than half of the window's valid pixels are marked.
    pub(crate) fn apply(&mut self, marks: &[u8], out: &mut [u8]) {
        let Raster { width, height, wraps } = self.raster;
        let [rx, ry] = self.reach;
        let row = |y: usize| &marks[y * width..(y + 1) * width];
        self.sums.fill(0);
        for y in 0..ry.min(height) {
            kernel::slide_column_sums(row(y), &self.zeros, &mut self.sums);
        }
        for y in 0..height {
            let enter = if y + ry < height { row(y + ry) } else { &self.zeros };
            let leave = if y > ry { row(y - ry - 1) } else { &self.zeros };
            kernel::slide_column_sums(enter, leave, &mut self.sums);
            self.padded[rx..rx + width].copy_from_slice(&self.sums);
            if wraps {
                self.padded[..rx].copy_from_slice(&self.sums[width - rx..]);
                self.padded[rx + width..].copy_from_slice(&self.sums[..rx]);
            }
            let range = y * width..(y + 1) * width;
            match self.alike[y] {
                Some(need) => kernel::threshold_row_sums_alike(&self.padded, rx, need, &mut out[range]),
                None => kernel::threshold_row_sums(&self.padded, rx, &self.need[range.clone()], &mut out[range]),
            }
        }
    }
}
