//! Faint marks become whole bodies: a pixel belongs to an object where most of its neighbourhood is marked.
//!
//! A person whose clothes are a few grey levels from the wall behind marks only about half of its pixels at a threshold
//! near the noise, while noise alone marks a tenth. Counting marks in a window separates the two by many standard
//! deviations, and asking for *half* of the window keeps edges where they are (it is the binary median), so bodies are
//! found whole without growing.
//!
//! The counts are kept in planes: plane p holds bit p of the count of each pixel, 64 pixels a word (see `kernel::planes`). Bodies are
//! higher than wide, and most of a picture is empty: so words are worked several rows at a time, those one below the other, where
//! anything is near them.

use super::kernel::{self, Counts, PLANES, ROWS};
use super::marks::{Marks, WORD};
use super::raster::Raster;

/// Windowed majority with its working memory.
#[derive(Debug)]
pub(crate) struct Majority {
    raster: Raster,
    reach: [usize; 2],
    stride: usize,
    /// Least number of marks in the window of each pixel: half of the window's valid pixels, rounded up. In planes, columns of words
    /// that are the same stored once.
    need: Vec<u64>,
    /// Where in `need` the planes of a column of words begin.
    need_of_column: Vec<usize>,
    /// Of a column of words: whether marks in its neighbours are never enough for any of its pixels.
    alone: Vec<bool>,
    /// Marks, column of words by column, as [`kernel::majority`] reads them.
    columns: Vec<u64>,
    counts: Counts,
}

impl Majority {
    /// For windows of (2·reach[0] + 1) × (2·reach[1] + 1) pixels, each reach at most 5; `valid` is 0 or 1.
    pub(crate) fn new(raster: Raster, reach: [usize; 2], valid: &[u8]) -> Self {
        let Raster { width, height, .. } = raster;
        let stride = width.div_ceil(WORD);
        let mut majority = Self {
            raster,
            reach,
            stride,
            need: Vec::new(),
            need_of_column: Vec::new(),
            alone: vec![true; stride],
            columns: vec![0; (stride + 2) * kernel::pitch(height)],
            counts: Counts::new(stride, height),
        };
        let rows = height.next_multiple_of(ROWS);
        let mut needs = vec![0u64; stride * PLANES * rows];
        let mut sums = vec![0u32; width];
        for y in 0..height {
            sums.fill(0);
            for row in y.saturating_sub(reach[1])..(y + reach[1] + 1).min(height) {
                for (s, &v) in sums.iter_mut().zip(&valid[row * width..]) {
                    *s += u32::from(v);
                }
            }
            let lines = (y + reach[1] + 1).min(height) - y.saturating_sub(reach[1]);
            majority.add_needs(&sums, lines, &mut needs[y..], rows);
        }
        let mut before: &[u64] = &[];
        for need in needs.chunks_exact(PLANES * rows) {
            if need != before {
                majority.need_of_column.push(majority.need.len());
                majority.need.extend_from_slice(need);
                before = need;
            } else {
                majority.need_of_column.push(majority.need.len() - need.len());
            }
        }
        majority
    }

    /// Adds the needs of a row to planes of words `pitch` apart, from the valid pixels of the window's `lines` rows in each column. Columns
    /// beyond the last need what none has.
    fn add_needs(&mut self, sums: &[u32], lines: usize, planes: &mut [u64], pitch: usize) {
        let width = self.raster.width as isize;
        let reach = self.reach[0] as isize;
        for x in 0..(self.stride * WORD) as isize {
            let window = (x - reach..=x + reach)
                .map(|column| if self.raster.wraps { column.rem_euclid(width) } else { column })
                .filter(|column| (0..width).contains(column));
            let need =
                if x < width { window.map(|column| sums[column as usize]).sum::<u32>() / 2 + 1 } else { u32::MAX };
            let (word, bit) = (x as usize / WORD, x as usize % WORD);
            let others = (reach as usize).saturating_sub(bit) + (bit + reach as usize).saturating_sub(WORD - 1);
            self.alone[word] &= need as usize > others * lines;
            for p in 0..PLANES {
                planes[(word * PLANES + p) * pitch] |= u64::from(need >> p & 1) << bit;
            }
        }
    }

    /// Bytes held.
    pub(crate) fn memory_bytes(&self) -> usize {
        [&self.need, &self.columns].map(|v| size_of_val(&**v)).iter().sum::<usize>()
            + size_of_val(&*self.need_of_column)
            + self.alone.len()
            + self.counts.memory_bytes()
    }

    /// `out` is marked where more than half of the window's valid pixels are.
    pub(super) fn apply(&mut self, marks: &Marks, out: &mut Marks) {
        self.turn(marks);
        let Self { raster, reach, need, need_of_column, alone, columns, counts, .. } = self;
        let needs = kernel::Needs { planes: need, of_column: need_of_column, alone };
        kernel::majority(columns, raster.height, *reach, needs, counts, out.words_mut());
    }

    /// Takes marks column of words by column; on a ring the columns at each end of a row go beyond the other, too.
    fn turn(&mut self, marks: &Marks) {
        let Raster { width, height, wraps } = self.raster;
        let (pitch, stride, reach) = (kernel::pitch(height), self.stride, self.reach[0]);
        let (last, columns) = (width % WORD, &mut self.columns);
        for (y, row) in marks.words().chunks_exact(stride).enumerate() {
            let y = ROWS + y;
            for (word, column) in row.iter().zip(columns.chunks_exact_mut(pitch).skip(1)) {
                column[y] = *word;
            }
            if !wraps {
                continue;
            }
            let first = row[0] & ((1 << reach) - 1);
            let ends = if last == 0 {
                row[stride - 1]
            } else {
                // The last columns may begin in the word before.
                let before = if stride > 1 { row[stride - 2] >> last } else { 0 };
                row[stride - 1] << (WORD - last) | before
            };
            columns[y] = ends >> (WORD - reach) << (WORD - reach);
            let [in_last, after] = if last == 0 { [0, first] } else { [first << last, first >> (WORD - last)] };
            columns[stride * pitch + y] |= in_last;
            columns[(stride + 1) * pitch + y] = after;
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};

    use super::*;

    #[test]
    fn the_majority_is_that_of_counting_each_window() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        for (width, wraps, reach) in
            [(130, true, [2, 3]), (64, true, [5, 5]), (150, false, [2, 3]), (17, true, [1, 1]), (100, false, [5, 1])]
        {
            let raster = Raster { width, height: 20, wraps };
            let mut bytes: Vec<u8> = (0..raster.len()).map(|_| u8::from(rng.next_u32() % 5 < 2)).collect();
            bytes[..8 * width].fill(0);
            let valid: Vec<u8> = (0..raster.len()).map(|_| u8::from(rng.next_u32() % 9 > 0)).collect();
            let marks: Vec<u8> = bytes.iter().zip(&valid).map(|(b, v)| b & v).collect();
            let mut out = Marks::new(raster);
            let mut majority = Majority::new(raster, reach, &valid);
            for _ in 0..2 {
                majority.apply(&Marks::of_bytes(&marks, raster), &mut out);
            }
            for y in 0..raster.height {
                for x in 0..width {
                    let (mut marked, mut tested) = (0, 0);
                    for row in y.saturating_sub(reach[1])..(y + reach[1] + 1).min(raster.height) {
                        for dx in -(reach[0] as isize)..=reach[0] as isize {
                            let column = x as isize + dx;
                            let column = if wraps { column.rem_euclid(width as isize) } else { column };
                            if (0..width as isize).contains(&column) {
                                let i = row * width + column as usize;
                                marked += u32::from(marks[i]);
                                tested += u32::from(valid[i]);
                            }
                        }
                    }
                    assert_eq!(out.is_marked(x, y), marked > tested / 2, "{width} {reach:?}: {x} {y}");
                }
            }
        }
    }
}
