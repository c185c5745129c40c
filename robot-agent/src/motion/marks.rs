//! Marks on a picture, one bit a pixel: an eighth of the bytes, and 64 pixels an operation.
//!
//! Each row begins with a word of its own. Bit i of word w is column 64·w + i; bits beyond the last column are 0.

use std::ops::Range;

use super::kernel;
use super::raster::Raster;

/// Pixels of a word.
pub(super) const WORD: usize = 64;

/// A mark or none for each pixel of a picture.
#[derive(Debug, Clone)]
pub(super) struct Marks {
    stride: usize,
    words: Vec<u64>,
}

impl Marks {
    /// None.
    pub(super) fn new(raster: Raster) -> Self {
        let stride = raster.width.div_ceil(WORD);
        Self { stride, words: vec![0; stride * raster.height] }
    }

    /// Marks where bytes are not 0.
    pub(super) fn of_bytes(bytes: &[u8], raster: Raster) -> Self {
        let mut marks = Self::new(raster);
        let rows = bytes.chunks_exact(raster.width).zip(marks.words.chunks_exact_mut(marks.stride.max(1)));
        for (row, words) in rows {
            for (pixels, word) in row.chunks(WORD).zip(words) {
                *word = kernel::bits_of(&kernel::padded(pixels).map(|p| if p == 0 { 0 } else { u8::MAX }));
            }
        }
        marks
    }

    /// Words of a row.
    #[inline]
    pub(super) fn stride(&self) -> usize {
        self.stride
    }

    /// All words, row by row.
    #[inline]
    pub(super) fn words(&self) -> &[u64] {
        &self.words
    }

    /// All words, row by row; bits beyond the last column must stay 0.
    #[inline]
    pub(super) fn words_mut(&mut self) -> &mut [u64] {
        &mut self.words
    }

    /// The words of a row.
    #[inline]
    pub(super) fn row(&self, y: usize) -> &[u64] {
        &self.words[y * self.stride..][..self.stride]
    }

    /// Whether a pixel is marked.
    #[inline]
    pub(super) fn is_marked(&self, x: usize, y: usize) -> bool {
        self.row(y)[x / WORD] >> (x % WORD) & 1 != 0
    }

    /// Marks among `len` pixels of a row from column `start` on.
    #[inline]
    pub(super) fn count(&self, y: usize, start: usize, len: usize) -> usize {
        let row = self.row(y);
        (start / WORD..(start + len).div_ceil(WORD))
            .map(|w| (row[w] & bits_between(w, start, start + len)).count_ones() as usize)
            .sum()
    }

    /// Bytes held.
    pub(super) fn memory_bytes(&self) -> usize {
        size_of_val(&*self.words)
    }
}

/// The bits of word `w` of a row that are columns `from` to `to` − 1.
#[inline]
pub(super) fn bits_between(w: usize, from: usize, to: usize) -> u64 {
    let below = |column: usize| match column.saturating_sub(w * WORD) {
        n if n >= WORD => u64::MAX,
        n => (1 << n) - 1,
    };
    below(to) & !below(from)
}

/// Marks some columns of a row of words.
#[inline]
pub(super) fn mark_between(row: &mut [u64], columns: Range<usize>) {
    for (w, word) in row.iter_mut().enumerate().take(columns.end.div_ceil(WORD)).skip(columns.start / WORD) {
        *word |= bits_between(w, columns.start, columns.end);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_are_counted_over_the_borders_of_words() {
        let raster = Raster { width: 150, height: 3, wraps: true };
        let bytes: Vec<u8> = (0..raster.len()).map(|i| u8::from(i % 3 == 0)).collect();
        let marks = Marks::of_bytes(&bytes, raster);
        assert_eq!(marks.words().iter().map(|w| w.count_ones()).sum::<u32>(), 150);
        for (start, len) in [(0, 150), (63, 2), (10, 100), (64, 64), (149, 1), (5, 0)] {
            let want = bytes[150 + start..150 + start + len].iter().map(|b| usize::from(*b)).sum::<usize>();
            assert_eq!(marks.count(1, start, len), want, "{start} {len}");
        }
        assert!(marks.is_marked(147, 2) && !marks.is_marked(148, 2));
    }
}
