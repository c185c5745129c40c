//! Faint marks become whole bodies: a pixel belongs to an object where most of its neighbourhood is marked.
//!
//! A person whose clothes are a few grey levels from the wall behind marks only about half of its pixels at a threshold
//! near the noise, while noise alone marks a tenth. Counting marks in a window separates the two by many standard
//! deviations, and asking for *half* of the window keeps edges where they are (it is the binary median), so bodies are
//! found whole without growing.
//!
//! The counts are kept in planes: plane p holds bit p of the count of each pixel, 64 pixels a word (see `kernel::planes`).

use super::kernel::{self, COLUMN_PLANES, PLANES};
use super::marks::{Marks, WORD, bits_between};
use super::raster::Raster;

/// Windowed majority with its working memory.
#[derive(Debug)]
pub(crate) struct Majority {
    raster: Raster,
    reach: [usize; 2],
    stride: usize,
    /// Least number of marks in the window of each pixel: half of the window's valid pixels, rounded up. In planes, rows that
    /// are the same in the picture stored once.
    need: Vec<u64>,
    /// Where in `need` a row's planes begin.
    need_of_row: Vec<usize>,
    /// Marks in the window's rows, a column each, in planes of `stride` + 2 words: a word before and one after.
    columns: Vec<u64>,
    zeros: Vec<u64>,
    /// Whether rows have marks ([`ANY`]), and some so near the seam that windows reach over it ([`AT_SEAM`]).
    rows: Vec<u8>,
}

const ANY: u8 = 1;
const AT_SEAM: u8 = 2;

impl Majority {
    /// For windows of (2·reach[0] + 1) × (2·reach[1] + 1) pixels, each reach at most 5; `valid` is 0 or 1.
    pub(crate) fn new(raster: Raster, reach: [usize; 2], valid: &[u8]) -> Self {
        let stride = raster.width.div_ceil(WORD);
        let mut majority = Self {
            raster,
            reach,
            stride,
            need: Vec::new(),
            need_of_row: Vec::new(),
            columns: vec![0; COLUMN_PLANES * (stride + 2)],
            zeros: vec![0; stride],
            rows: Vec::with_capacity(raster.height),
        };
        let mut before = Vec::new();
        let mut sums = vec![0u32; raster.width];
        for y in 0..raster.height {
            sums.fill(0);
            for row in y.saturating_sub(reach[1])..(y + reach[1] + 1).min(raster.height) {
                for (s, &v) in sums.iter_mut().zip(&valid[row * raster.width..]) {
                    *s += u32::from(v);
                }
            }
            let need = majority.need_of(&sums);
            if need != before {
                majority.need_of_row.push(majority.need.len());
                majority.need.extend_from_slice(&need);
                before = need;
            } else {
                majority.need_of_row.push(majority.need.len() - need.len());
            }
        }
        majority
    }

    /// The needs of a row in planes, from the valid pixels of the window's rows in each column.
    fn need_of(&self, sums: &[u32]) -> Vec<u64> {
        let width = self.raster.width as isize;
        let reach = self.reach[0] as isize;
        let mut planes = vec![0u64; PLANES * self.stride];
        for x in 0..width {
            let window = (x - reach..=x + reach)
                .map(|column| if self.raster.wraps { column.rem_euclid(width) } else { column })
                .filter(|column| (0..width).contains(column));
            let need = window.map(|column| sums[column as usize]).sum::<u32>() / 2 + 1;
            let (word, bit) = (x as usize / WORD, x as usize % WORD);
            for p in 0..PLANES {
                planes[p * self.stride + word] |= u64::from(need >> p & 1) << bit;
            }
        }
        planes
    }

    /// Bytes held.
    pub(crate) fn memory_bytes(&self) -> usize {
        [&self.need, &self.columns, &self.zeros].map(|v| size_of_val(&**v)).iter().sum::<usize>()
            + size_of_val(&*self.need_of_row)
            + self.rows.capacity()
    }

    /// `out` is marked where more than half of the window's valid pixels are.
    pub(super) fn apply(&mut self, marks: &Marks, out: &mut Marks) {
        let Raster { width, height, wraps } = self.raster;
        let [rx, ry] = self.reach;
        let stride = self.stride;
        self.columns.fill(0);
        look_at_rows(marks.words(), width, rx, &mut self.rows);
        for y in 0..ry.min(height) {
            kernel::slide_counts(marks.row(y), &self.zeros, &mut self.columns);
        }
        for y in 0..height {
            let window = y.saturating_sub(ry + 1)..(y + ry + 1).min(height);
            let found = self.rows[window].iter().fold(0, |found, row| found | row);
            // Nothing in the window, and nothing leaves it.
            if found == 0 {
                out.words_mut()[y * stride..][..stride].fill(0);
                continue;
            }
            let enter = if y + ry < height { marks.row(y + ry) } else { &self.zeros };
            let leave = if y > ry { marks.row(y - ry - 1) } else { &self.zeros };
            kernel::slide_counts(enter, leave, &mut self.columns);
            let closed = wraps && found & AT_SEAM != 0;
            if closed {
                self.columns.chunks_exact_mut(stride + 2).for_each(|plane| close_ring(plane, width, rx));
            }
            let need = &self.need[self.need_of_row[y]..][..PLANES * stride];
            let row = &mut out.words_mut()[y * stride..][..stride];
            kernel::majority_of_counts(&self.columns, 2 * ry + 1, rx, need, row);
            if !width.is_multiple_of(WORD) {
                row[stride - 1] &= (1 << (width % WORD)) - 1;
            }
            if closed {
                self.columns.chunks_exact_mut(stride + 2).for_each(|plane| open_ring(plane, width));
            }
        }
    }
}

kernel::wide! {
/// What rows of marks have.
fn look_at_rows(marks: &[u64], width: usize, reach: usize, rows: &mut Vec<u8>) {
    let words = width.div_ceil(WORD);
    let (first, last) = (bits_between(0, 0, reach), bits_between(words - 1, width.saturating_sub(reach), width));
    // The last columns may begin in the word before.
    let before = words.saturating_sub(2);
    let before_last = if words > 1 { bits_between(before, width.saturating_sub(reach), width) } else { 0 };
    rows.clear();
    rows.extend(marks.chunks_exact(words).map(|row| {
        let any = row.iter().fold(0, |any, word| any | word) != 0;
        let at_seam = (row[0] & first) | (row[words - 1] & last) | (row[before] & before_last) != 0;
        (u8::from(any) * ANY) | (u8::from(at_seam) * AT_SEAM)
    }));
}
}

/// Copies the last `reach` columns before the first one and the first ones behind the last one. `row` has a word before and one after
/// its columns.
fn close_ring(row: &mut [u64], width: usize, reach: usize) {
    let bit = |row: &[u64], x: usize| row[1 + x / WORD] >> (x % WORD) & 1;
    for k in 0..reach {
        row[0] |= bit(row, width - reach + k) << (WORD - reach + k);
        let x = width + k;
        row[1 + x / WORD] |= bit(row, k) << (x % WORD);
    }
}

/// Takes away what [`close_ring`] wrote.
fn open_ring(row: &mut [u64], width: usize) {
    row[0] = 0;
    let words = width.div_ceil(WORD);
    row[1 + words] = 0;
    if !width.is_multiple_of(WORD) {
        row[words] &= (1 << (width % WORD)) - 1;
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
