//! The same unwarping in an order that suits processors; bit for bit what the plain loop gives.
//!
//! Read pixel by pixel a source costs cache misses: a row of the panorama runs round the ring. So the panorama is cut into tiles
//! whose source, a piece of a wedge of the ring, fits the first-level cache. For each tile that source is copied first, row by
//! row as far as it is used, every pixel beside the one below it; then one 32-bit load gives all four pixels of a sample, found
//! by a 16-bit offset. While a tile is worked on the source of the next one is fetched. Rows of pictures whose width is a power of two, which
//! fall on the same lines of the cache, do no harm then, and the table needs four bytes a pixel.
//!
//! ```text
//! copy    … a c │ b d …               a b: pixels of a row, c d: those below them; one word
//! left    256 a + (c − a) fy          right  256 b + (d − b) fy
//! value   (256 left + (right − left) fx + 2¹⁵) >> 16
//! ```

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::{Arc, Mutex};

use super::super::LutEntry;
use crate::motion::kernel::wide;

/// Columns of a tile.
const COLUMNS: usize = 64;
/// Pixels of a tile's copy at most, if it has more than one row: 28 KB.
const MOST_PIXELS: usize = 14 * 1024;
/// Pixels that are copied together.
const BLOCK: usize = 32;
/// Bytes of the copy: all that 16-bit offsets reach.
const COPY_BYTES: usize = 2 * (1 << 16) + 2;
/// Rows of a tile that are worked on together.
const TOGETHER: usize = 4;
/// Bytes of a line of the cache.
const LINE: usize = 64;

/// The table in the order of work.
#[derive(Debug, Clone)]
pub(crate) struct Tiles {
    tiles: Vec<Tile>,
    spans: Vec<Span>,
    /// Places in the tile's copy, and fx | fy << 8.
    offsets: Vec<u16>,
    weights: Vec<u16>,
    /// Pixels with a weight of 256, which eight bits do not hold: at the source's last column or row.
    rim: Vec<(u32, LutEntry)>,
    stride: usize,
    source_len: usize,
    width: usize,
    height: usize,
    /// One copy for all clones of a table; whoever finds it in use takes the plain loop.
    copy: Arc<Mutex<Vec<u8>>>,
}

/// A piece of the panorama, [`COLUMNS`] wide.
#[derive(Debug, Clone)]
struct Tile {
    column: usize,
    rows: Range<usize>,
    /// Of the source, as it is copied.
    spans: Range<usize>,
}

/// Neighbouring pixels of a row of the source.
#[derive(Debug, Clone, Copy)]
struct Span {
    start: u32,
    blocks: u32,
}

impl Tiles {
    /// From the table by rows; `None` where it is left to the plain loop: panoramas narrower than a tile, tiny sources, maps
    /// that jump about.
    pub(crate) fn new(entries: &[LutEntry], width: usize, source: [usize; 2]) -> Option<Self> {
        let [stride, rows] = source;
        let (source_len, height) = (stride * rows, entries.len() / width.max(1));
        if width < COLUMNS || !entries.len().is_multiple_of(width) || source_len < stride + BLOCK {
            return None;
        }
        let mut tiles = Self {
            tiles: Vec::new(),
            spans: Vec::new(),
            offsets: Vec::with_capacity(entries.len()),
            weights: Vec::with_capacity(entries.len()),
            rim: Vec::new(),
            stride,
            source_len,
            width,
            height,
            copy: Arc::default(),
        };
        for column in (0..width).step_by(COLUMNS).map(|start| start.min(width - COLUMNS)) {
            let mut first = 0;
            while first < height {
                first = tiles.add_tile(entries, column, first)?;
            }
        }
        Some(tiles)
    }

    /// Adds a tile with as many rows as its copy holds; the row after its last.
    fn add_tile(&mut self, entries: &[LutEntry], column: usize, first: usize) -> Option<usize> {
        let (stride, rows) = (self.stride, self.source_len / self.stride);
        let row = |v: usize| &entries[v * self.width + column..][..COLUMNS];
        let place = |entry: &LutEntry| match in_eight_bits(*entry, [stride, rows]) {
            Some((offset, weight)) => (offset as usize, Some(weight)),
            None => (entry.offset as usize, None),
        };
        // First and last pixel of each row of the source, as far as the tile goes, and how many there are in all.
        let mut used: BTreeMap<usize, [usize; 2]> = BTreeMap::new();
        let length = |[low, high]: [usize; 2]| (high + 2 - low).next_multiple_of(BLOCK);
        let mut pixels = 0;
        let mut end = first;
        for v in first..self.height {
            for entry in row(v) {
                let (offset, _) = place(entry);
                if offset + stride + 1 >= self.source_len {
                    return None;
                }
                match used.get_mut(&(offset / stride)) {
                    Some(span) => {
                        pixels -= length(*span);
                        *span = [span[0].min(offset), span[1].max(offset)];
                        pixels += length(*span);
                    }
                    None => {
                        used.insert(offset / stride, [offset; 2]);
                        pixels += BLOCK;
                    }
                }
            }
            // What the row one too many used stays: it does no harm.
            if pixels > MOST_PIXELS && v > first {
                break;
            }
            end = v + 1;
        }
        if pixels > usize::from(u16::MAX) {
            return None;
        }
        let spans = self.spans.len();
        let mut base = 0;
        // Where a row's pixel 0 would be in the copy.
        let mut bases: BTreeMap<usize, isize> = BTreeMap::new();
        for (source_row, span) in used {
            let length = length(span);
            // The last row's span must not run out of the picture.
            let start = span[0].min(self.source_len.checked_sub(stride + length)?);
            bases.insert(source_row, base as isize - start as isize);
            self.spans.push(Span { start: start as u32, blocks: (length / BLOCK) as u32 });
            base += length;
        }
        for v in first..end {
            for (i, entry) in row(v).iter().enumerate() {
                let (offset, weight) = place(entry);
                let base = bases.get(&(offset / stride))?;
                self.offsets.push(u16::try_from(offset as isize + base).ok()?);
                self.weights.push(weight.unwrap_or(0));
                if weight.is_none() {
                    self.rim.push(((v * self.width + column + i) as u32, *entry));
                }
            }
        }
        self.tiles.push(Tile { column, rows: first..end, spans: spans..self.spans.len() });
        Some(end)
    }

    /// Bytes held.
    pub(crate) fn memory_bytes(&self) -> usize {
        size_of_val(&*self.tiles)
            + size_of_val(&*self.spans)
            + size_of_val(&*self.offsets)
            + size_of_val(&*self.weights)
            + size_of_val(&*self.rim)
            + COPY_BYTES
    }

    /// Unwarps; whether it could: a source or output of another size is left to the plain loop.
    pub(crate) fn unwarp(&self, source: &[u8], out: &mut [u8]) -> bool {
        if source.len() != self.source_len || out.len() != self.width * self.height {
            return false;
        }
        let Ok(mut copy) = self.copy.try_lock() else { return false };
        copy.resize(COPY_BYTES, 0);
        let Some(copy) = copy.first_chunk_mut() else { return false };
        work(self, source, copy, out);
        for (i, entry) in &self.rim {
            out[*i as usize] = super::sample(source, self.stride, *entry);
        }
        true
    }
}

/// Offset and weights below 256 of the same place: a weight of 256 is the next pixel with weight 0. `None` at the rim.
fn in_eight_bits(entry: LutEntry, [stride, rows]: [usize; 2]) -> Option<(u32, u16)> {
    let LutEntry { mut offset, mut fx, mut fy } = entry;
    if fx == 256 && offset as usize % stride + 2 < stride {
        (offset, fx) = (offset + 1, 0);
    }
    if fy == 256 && offset as usize / stride + 2 < rows {
        (offset, fy) = (offset + stride as u32, 0);
    }
    (fx < 256 && fy < 256).then_some((offset, fx | fy << 8))
}

wide! {
/// All tiles, one after the other.
fn work(tiles: &Tiles, source: &[u8], copy: &mut [u8; COPY_BYTES], out: &mut [u8]) {
    let (stride, width) = (tiles.stride, tiles.width);
    let (mut offsets, mut weights) = (tiles.offsets.as_chunks::<COLUMNS>().0, tiles.weights.as_chunks::<COLUMNS>().0);
    let mut words = [[0u32; COLUMNS]; TOGETHER];
    for (t, tile) in tiles.tiles.iter().enumerate() {
        fill(copy, source, stride, &tiles.spans[tile.spans.clone()]);
        let next = tiles.tiles.get(t + 1).map_or(&[][..], |next| &tiles.spans[next.spans.clone()]);
        let (rows, mut fetched) = (tile.rows.len(), 0);
        // Some rows are collected before the first of them is worked on: what was just stored in small pieces cannot be read
        // at once in a large one.
        for first in (0..rows).step_by(TOGETHER) {
            let n = TOGETHER.min(rows - first);
            let until = next.len() * (first + n) / rows;
            fetch(source, &next[fetched..until]);
            fetched = until;
            let (Some((here, later)), Some((weight, later_weights))) =
                (offsets.split_at_checked(n), weights.split_at_checked(n))
            else {
                return;
            };
            collect(copy, here, &mut words);
            for (k, (words, weights)) in words.iter().zip(weight).enumerate() {
                let v = tile.rows.start + first + k;
                if let Some(out) = out[v * width + tile.column..].first_chunk_mut() {
                    interpolate(words, weights, out);
                }
            }
            (offsets, weights) = (later, later_weights);
        }
    }
}
}

/// Copies the spans, each pixel beside the one below it.
#[inline(always)]
fn fill(copy: &mut [u8; COPY_BYTES], source: &[u8], stride: usize, spans: &[Span]) {
    let mut blocks = copy.as_chunks_mut::<{ 2 * BLOCK }>().0.iter_mut();
    for span in spans {
        let length = span.blocks as usize * BLOCK;
        let upper = &source[span.start as usize..][..length];
        let lower = &source[span.start as usize + stride..][..length];
        let pairs = upper.as_chunks::<BLOCK>().0.iter().zip(lower.as_chunks::<BLOCK>().0);
        for ((upper, lower), block) in pairs.zip(&mut blocks) {
            for (pair, (a, c)) in block.as_chunks_mut::<2>().0.iter_mut().zip(upper.iter().zip(lower)) {
                *pair = [*a, *c];
            }
        }
    }
}

/// Fetches spans into the cache.
#[inline(always)]
fn fetch(source: &[u8], spans: &[Span]) {
    #[cfg(target_arch = "x86_64")]
    for span in spans {
        let pixels = span.start as usize..(span.start + span.blocks * BLOCK as u32) as usize;
        for line in source.get(pixels).unwrap_or(&[]).chunks(LINE) {
            use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
            // SAFETY: a hint on a place inside the source; nothing is read.
            unsafe { _mm_prefetch::<_MM_HINT_T0>(line.as_ptr().cast()) };
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (source, spans, LINE);
}

/// The four pixels of each sample of some rows. Not compiled for wider vectors: one load a pixel is faster than a gather
/// instruction.
#[inline(never)]
fn collect(copy: &[u8; COPY_BYTES], offsets: &[[u16; COLUMNS]], words: &mut [[u32; COLUMNS]; TOGETHER]) {
    for (words, offsets) in words.iter_mut().zip(offsets) {
        for (word, offset) in words.iter_mut().zip(offsets) {
            let at = 2 * usize::from(*offset);
            *word = u32::from_le_bytes([copy[at], copy[at + 1], copy[at + 2], copy[at + 3]]);
        }
    }
}

/// A row of a tile. Left and right are worked on together in halves of a word: what one half borrows from the other, it gives
/// back with the sum.
#[inline(always)]
fn interpolate(words: &[u32; COLUMNS], weights: &[u16; COLUMNS], out: &mut [u8; COLUMNS]) {
    for i in 0..COLUMNS {
        let (word, fx, fy) = (words[i], u32::from(weights[i] & 255), u32::from(weights[i] >> 8));
        let (upper, lower) = (word & 0x00ff_00ff, word >> 8 & 0x00ff_00ff);
        let both = (upper << 8).wrapping_add(lower.wrapping_sub(upper).wrapping_mul(fy));
        let (left, right) = (both & 0xffff, both >> 16);
        let value = (left << 8).wrapping_add(right.wrapping_sub(left).wrapping_mul(fx)).wrapping_add(1 << 15);
        out[i] = (value >> 16) as u8;
    }
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};

    use super::*;
    use crate::motion::kernel::{Level, at_most};

    fn check(entries: &[LutEntry], width: usize, [stride, rows]: [usize; 2], rng: &mut rand_chacha::ChaCha8Rng) {
        let source: Vec<u8> = (0..stride * rows).map(|_| (rng.next_u32() >> 24) as u8).collect();
        let tiles = Tiles::new(entries, width, [stride, rows]).unwrap();
        let mut want = vec![0; entries.len()];
        super::super::unwarp(&source, stride, entries, width, &mut want);
        for level in [Level::Portable, Level::Avx2, Level::Avx512] {
            let mut got = vec![0; entries.len()];
            assert!(at_most(level, || tiles.unwarp(&source, &mut got)));
            assert_eq!(got, want, "{width} columns, {level:?}");
        }
    }

    #[test]
    fn tiles_give_what_the_plain_loop_gives_at_any_place_and_weight() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(4);
        for (width, stride, rows) in [(64, 70, 40), (65, 200, 90), (150, 33, 20), (192, 16, 16), (130, 1024, 30)] {
            let entries: Vec<LutEntry> = (0..width * 9)
                .map(|_| {
                    let (x, y) = (rng.next_u32() % (stride as u32 - 1), rng.next_u32() % (rows as u32 - 1));
                    let weight = |r: u32| if r.is_multiple_of(5) { 256 } else { (r / 5 % 257) as u16 };
                    LutEntry { offset: y * stride as u32 + x, fx: weight(rng.next_u32()), fy: weight(rng.next_u32()) }
                })
                .collect();
            check(&entries, width, [stride, rows], &mut rng);
        }
    }

    #[test]
    fn tiles_give_what_the_plain_loop_gives_on_a_ring() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let (width, height, stride, rows) = (700, 90, 512, 300);
        let entries: Vec<LutEntry> = (0..width * height)
            .map(|i| {
                let (column, radius) = (i % width, 149.0 - 1.1 * (i / width) as f64);
                let (sin, cos) = (std::f64::consts::TAU * column as f64 / width as f64).sin_cos();
                let (x, y) = (250.0 + radius * cos, 149.6 + radius * sin);
                let weight = |v: f64| (256.0 * v.fract()) as u16;
                LutEntry { offset: y as u32 * stride as u32 + x as u32, fx: weight(x), fy: weight(y) }
            })
            .collect();
        check(&entries, width, [stride, rows], &mut rng);
    }

    #[test]
    fn a_table_that_points_out_of_its_source_makes_no_tiles() {
        let mut entries = vec![LutEntry::default(); 64 * 2];
        entries[70].offset = 16 * 15;
        assert!(Tiles::new(&entries, 64, [16, 16]).is_none());
    }
}
