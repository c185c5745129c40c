//! The same unwarping in an order that suits processors; bit for bit what the plain loop gives.
//!
//! Read pixel by pixel a source costs cache misses: a row of the panorama runs round the ring. So the panorama is cut into tiles
//! whose source, a piece of a wedge of the ring, fits the first-level cache. For each tile that source is copied first, row by
//! row as far as it is used, every pixel beside the one below it; then one 32-bit load gives all four pixels of a sample, found
//! by a 16-bit offset. While a tile is worked on the source of the next one is fetched. Rows of pictures whose width is a power of two, which
//! fall on the same lines of the cache, do no harm then, and the table needs four bytes a pixel.
//!
//! ```text
//! copy    … a c │ b d …               a b: pixels of a row, c d: those below them, all less 128; one word
//! left    256 a + (c − a) fy          right  256 b + (d − b) fy
//! value   ((256 − fx) left + fx right + 2²³ + 2¹⁵) >> 16
//! ```
//! With 128 taken away both sums fit 16 signed bits, so that AVX2 works on sixteen at a time and adds left and right up in one
//! instruction.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::{Arc, Mutex};

use super::super::LutEntry;
use crate::motion::kernel::{self, Level, available, wide};
use crate::motion::{CELL_COLUMNS, CELL_ROWS, Canvas, Work};

/// Columns of a tile.
const COLUMNS: usize = CELL_COLUMNS;
/// Pixels of a tile's copy at most, if it has more than one row: 28 KB.
const MOST_PIXELS: usize = 14 * 1024;
/// Pixels that are copied together.
const BLOCK: usize = 16;
/// Bytes of the copy: all that 16-bit offsets reach.
const COPY_BYTES: usize = 2 * (1 << 16) + 2;
/// Rows of a tile between which source is fetched.
const FETCH_ROWS: usize = 4;
/// Cells ahead of the one that is worked whose source is fetched: about 100 KB, which stay in the second-level cache until then.
const AHEAD_CELLS: usize = 64;
/// Rows ahead of which is fetched what is drawn over.
const DRAW_AHEAD: usize = 3;

/// The table in the order of work.
#[derive(Debug, Clone)]
pub(crate) struct Tiles {
    tiles: Vec<Tile>,
    spans: Vec<Span>,
    /// Of cells: their spans block by block, and the lines of the cache that these lie on. Short loops of ever other lengths would cost
    /// more than what is done in them.
    blocks: Vec<Block>,
    lines: Vec<u32>,
    /// Places in the tile's copy.
    offsets: Vec<u16>,
    /// fx | fy << 8, those of each sixteen pixels in the order of [`weight_place`].
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
    /// Rows of offsets and weights before its own.
    first: usize,
    /// Of the source, as it is copied.
    spans: Range<usize>,
    /// What each band of [`CELL_ROWS`] rows needs of them, from the band of its first row on.
    pieces: Vec<Piece>,
}

/// Which blocks and lines a cell needs.
#[derive(Debug, Clone)]
struct Piece {
    blocks: Range<usize>,
    lines: Range<usize>,
}

/// [`BLOCK`] pixels of a row of the source, and which block they are in the copy.
#[derive(Debug, Clone, Copy)]
struct Block {
    start: u32,
    at: u32,
}

/// Neighbouring pixels of a row of the source.
#[derive(Debug, Clone, Copy)]
struct Span {
    start: u32,
    blocks: u32,
    /// First block in the copy.
    at: u32,
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
            blocks: Vec::new(),
            lines: Vec::new(),
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
        let (spans, first_row) = (self.spans.len(), self.offsets.len() / COLUMNS);
        let mut base = 0;
        // Where a row's pixel 0 would be in the copy.
        let mut bases: BTreeMap<usize, isize> = BTreeMap::new();
        for (source_row, span) in used {
            let length = length(span);
            // The last row's span must not run out of the picture.
            let start = span[0].min(self.source_len.checked_sub(stride + length)?);
            bases.insert(source_row, base as isize - start as isize);
            let [start, blocks, at] = [start, length / BLOCK, base / BLOCK].map(|n| n as u32);
            self.spans.push(Span { start, blocks, at });
            base += length;
        }
        let mut pieces = Vec::new();
        // First and last block of each row of the source that a band needs.
        let mut blocks: BTreeMap<usize, [usize; 2]> = BTreeMap::new();
        for v in first..end {
            let mut weights = [0; COLUMNS];
            for (i, entry) in row(v).iter().enumerate() {
                let (offset, weight) = place(entry);
                let base = bases.get(&(offset / stride))?;
                let place = u16::try_from(offset as isize + base).ok()?;
                let [low, high] = [usize::from(place) / BLOCK, (usize::from(place) + 1) / BLOCK];
                let span = blocks.entry(offset / stride).or_insert([low, high]);
                *span = [span[0].min(low), span[1].max(high)];
                self.offsets.push(place);
                weights[weight_place(i)] = weight.unwrap_or(0);
                if weight.is_none() {
                    self.rim.push(((v * self.width + column + i) as u32, *entry));
                }
            }
            self.weights.extend_from_slice(&weights);
            if v + 1 == end || (v + 1).is_multiple_of(CELL_ROWS) {
                let (first_block, first_line) = (self.blocks.len(), self.lines.len());
                for (source_row, [low, high]) in std::mem::take(&mut blocks) {
                    let base = bases.get(&source_row)?;
                    self.blocks.extend((low..=high).map(|at| {
                        let start = (at * BLOCK) as isize - base;
                        Block { start: start as u32, at: at as u32 }
                    }));
                }
                // The blocks', and the pixels' below them.
                let starts =
                    self.blocks[first_block..].iter().flat_map(|block| [block.start, block.start + stride as u32]);
                self.lines.extend(kernel::lines_of(starts, BLOCK as u32));
                pieces.push(Piece { blocks: first_block..self.blocks.len(), lines: first_line..self.lines.len() });
            }
        }
        let spans = spans..self.spans.len();
        self.tiles.push(Tile { column, rows: first..end, first: first_row, spans, pieces });
        Some(end)
    }

    /// Bytes held.
    pub(crate) fn memory_bytes(&self) -> usize {
        size_of_val(&*self.tiles)
            + size_of_val(&*self.spans)
            + size_of_val(&*self.blocks)
            + size_of_val(&*self.lines)
            + size_of_val(&*self.offsets)
            + size_of_val(&*self.weights)
            + size_of_val(&*self.rim)
            + COPY_BYTES
    }

    /// Unwarps; whether it could: a source or output of another size is left to the plain loop.
    pub(crate) fn unwarp(&self, source: &[u8], out: &mut [u8]) -> bool {
        self.work_with_copy(source, out, |copy, out| draw(self, source, copy, out))
    }

    /// The same where the cells of a canvas are worked, of which the old picture is kept.
    pub(crate) fn unwarp_cells(&self, source: &[u8], canvas: &mut Canvas<'_>) -> bool {
        let Canvas { picture, work, kept } = canvas;
        let kept = kept.as_deref_mut().unwrap_or(&mut []);
        self.work_with_copy(source, picture, |copy, out| draw_cells(self, source, work, copy, out, kept))
    }

    /// Fetches what the first of the cells are drawn from that are known to be worked: as much as will stay in the cache until then.
    pub(crate) fn fetch_first(&self, source: &[u8], work: &Work) {
        for (_, _, piece) in worked_cells(self, work).take(AHEAD_CELLS) {
            kernel::fetch_far_lines(source, &self.lines[piece.lines.clone()]);
        }
    }

    fn work_with_copy(
        &self,
        source: &[u8],
        out: &mut [u8],
        work: impl FnOnce(&mut [u8; COPY_BYTES], &mut [u8]),
    ) -> bool {
        if source.len() != self.source_len || out.len() != self.width * self.height {
            return false;
        }
        let Ok(mut copy) = self.copy.try_lock() else { return false };
        copy.resize(COPY_BYTES, 0);
        let Some(copy) = copy.first_chunk_mut() else { return false };
        work(copy, out);
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

/// Where the weights of a pixel are: AVX2 works in halves, one of pixels 0 … 3 and 8 … 11, the other of 4 … 7 and 12 … 15.
const fn weight_place(i: usize) -> usize {
    i & !12 | (i & 4) << 1 | (i & 8) >> 1
}

/// All tiles, one after the other.
fn draw(tiles: &Tiles, source: &[u8], copy: &mut [u8; COPY_BYTES], out: &mut [u8]) {
    let (stride, width) = (tiles.stride, tiles.width);
    let (mut offsets, mut weights) = (tiles.offsets.as_chunks::<COLUMNS>().0, tiles.weights.as_chunks::<COLUMNS>().0);
    let (level, gathers) = (available(), gathers_are_fast());
    for (t, tile) in tiles.tiles.iter().enumerate() {
        fill(copy, source, stride, &tiles.spans[tile.spans.clone()]);
        let next = tiles.tiles.get(t + 1).map_or(&[][..], |next| &tiles.spans[next.spans.clone()]);
        let mut fetched = 0;
        for (k, v) in tile.rows.clone().enumerate() {
            if k % FETCH_ROWS == 0 {
                let until = (next.len() * (k + FETCH_ROWS) / tile.rows.len()).min(next.len());
                fetch(source, &next[fetched..until]);
                fetched = until;
            }
            let (Some((row, later)), Some((weight, later_weights))) = (offsets.split_first(), weights.split_first())
            else {
                return;
            };
            if let Some(out) = out[v * width + tile.column..].first_chunk_mut() {
                sample_row(level, gathers, copy, row, weight, out);
            }
            (offsets, weights) = (later, later_weights);
        }
    }
}

/// The cells that are worked, tile by tile: tile, band, and what of the source they need.
fn worked_cells<'a>(tiles: &'a Tiles, work: &'a Work) -> impl Iterator<Item = (&'a Tile, usize, &'a Piece)> {
    let bands = |tile: &'a Tile| {
        (tile.rows.start / CELL_ROWS..).zip(&tile.pieces).map(move |(band, piece)| (tile, band, piece))
    };
    let cells = tiles.tiles.iter().flat_map(bands);
    cells.filter(|(tile, band, _)| work.is_worked(tile.column.div_ceil(COLUMNS), *band))
}

wide! {
/// The cells that are worked, tile by tile; what is drawn over is kept. [`Tiles::fetch_first`] came before.
fn draw_cells(tiles: &Tiles, source: &[u8], work: &Work, copy: &mut [u8; COPY_BYTES], out: &mut [u8], kept: &mut [u8]) {
    let (offsets, weights) = (tiles.offsets.as_chunks::<COLUMNS>().0, tiles.weights.as_chunks::<COLUMNS>().0);
    let (level, gathers) = (available(), gathers_are_fast());
    let mut later = worked_cells(tiles, work).skip(AHEAD_CELLS);
    for (tile, band, piece) in worked_cells(tiles, work) {
        if let Some((_, _, piece)) = later.next() {
            kernel::fetch_far_lines(source, &tiles.lines[piece.lines.clone()]);
        }
        fill_blocks(copy, source, tiles.stride, &tiles.blocks[piece.blocks.clone()]);
        let rows = tile.rows.start.max(band * CELL_ROWS)..tile.rows.end.min((band + 1) * CELL_ROWS);
        let before = tile.column.next_multiple_of(COLUMNS) - tile.column;
        for v in rows {
            let at = tile.first + v - tile.rows.start;
            let place = v * tiles.width + tile.column;
            for picture in [&*out, &*kept] {
                let later = place + DRAW_AHEAD * tiles.width;
                kernel::fetch(picture.get(later..later + COLUMNS).unwrap_or_default());
            }
            let Some(out) = out[place..].first_chunk_mut::<COLUMNS>() else { continue };
            match kept.get_mut(place..).and_then(|kept| kept.first_chunk_mut::<COLUMNS>()) {
                // The last tile begins in the cell before its own, which has been drawn if it is.
                Some(kept) if before > 0 => kept[before..].copy_from_slice(&out[before..]),
                Some(kept) => *kept = *out,
                None => {}
            }
            sample_row(level, gathers, copy, &offsets[at], &weights[at], out);
        }
    }
}
}

wide! {
/// Copies the spans, each pixel beside the one below it, less 128.
fn fill(copy: &mut [u8; COPY_BYTES], source: &[u8], stride: usize, spans: &[Span]) {
    let blocks = copy.as_chunks_mut::<{ 2 * BLOCK }>().0;
    for span in spans {
        let length = span.blocks as usize * BLOCK;
        let upper = &source[span.start as usize..][..length];
        let lower = &source[span.start as usize + stride..][..length];
        let Some(here) = blocks.get_mut(span.at as usize..(span.at + span.blocks) as usize) else { return };
        let pairs = upper.as_chunks::<BLOCK>().0.iter().zip(lower.as_chunks::<BLOCK>().0);
        for ((upper, lower), block) in pairs.zip(here) {
            for (pair, (a, c)) in block.as_chunks_mut::<2>().0.iter_mut().zip(upper.iter().zip(lower)) {
                *pair = [*a ^ 128, *c ^ 128];
            }
        }
    }
}
}

/// The same of blocks.
#[inline(always)]
fn fill_blocks(copy: &mut [u8; COPY_BYTES], source: &[u8], stride: usize, blocks: &[Block]) {
    let copy = copy.as_chunks_mut::<{ 2 * BLOCK }>().0;
    for block in blocks {
        let start = block.start as usize;
        let upper = source[start..].first_chunk::<BLOCK>();
        let (Some(upper), Some(lower)) = (upper, source[start + stride..].first_chunk::<BLOCK>()) else { return };
        for (pair, (a, c)) in copy[block.at as usize].as_chunks_mut::<2>().0.iter_mut().zip(upper.iter().zip(lower)) {
            *pair = [*a ^ 128, *c ^ 128];
        }
    }
}

/// Fetches spans into the cache.
#[inline(always)]
fn fetch(source: &[u8], spans: &[Span]) {
    for span in spans {
        let Some(pixels) = source.get(span.start as usize..) else { return };
        kernel::fetch_far(&pixels[..pixels.len().min(span.blocks as usize * BLOCK)]);
    }
}

/// Whether one gather instruction takes less time than sixteen loads: on Intel's processors with half-precision numbers (Sapphire
/// Rapids and later), where it takes a third off. Microcode makes gathers slow on the ones before, and AMD's never are fast.
fn gathers_are_fast() -> bool {
    #[cfg(target_arch = "x86_64")]
    return std::arch::is_x86_feature_detected!("avx512fp16");
    #[cfg(not(target_arch = "x86_64"))]
    false
}

/// A row of a tile.
#[inline(always)]
fn sample_row(
    level: Level,
    gathers: bool,
    copy: &[u8; COPY_BYTES],
    offsets: &[u16; COLUMNS],
    weights: &[u16; COLUMNS],
    out: &mut [u8; COLUMNS],
) {
    #[cfg(target_arch = "x86_64")]
    match level {
        // SAFETY: the processor has these instructions.
        Level::Avx512 if gathers => return unsafe { sample_row_avx512::<true>(copy, offsets, weights, out) },
        // SAFETY: as above.
        Level::Avx512 => return unsafe { sample_row_avx512::<false>(copy, offsets, weights, out) },
        // SAFETY: the processor has these instructions.
        Level::Avx2 => return unsafe { sample_row_avx2(copy, offsets, weights, out) },
        Level::Portable => {}
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (level, gathers);
    for (i, (out, offset)) in out.iter_mut().zip(offsets).enumerate() {
        let [a, c, b, d] = word(copy, *offset).to_le_bytes().map(|p| i32::from(p as i8));
        let weight = i32::from(weights[weight_place(i)]);
        let (fx, fy) = (weight & 255, weight >> 8);
        let (left, right) = (256 * a + (c - a) * fy, 256 * b + (d - b) * fy);
        *out = (((256 - fx) * left + fx * right + (1 << 23) + (1 << 15)) >> 16) as u8;
    }
}

/// The four pixels of a sample.
#[inline(always)]
fn word(copy: &[u8; COPY_BYTES], offset: u16) -> i32 {
    let at = 2 * usize::from(offset);
    i32::from_le_bytes([copy[at], copy[at + 1], copy[at + 2], copy[at + 3]])
}

/// Four offsets out of one load. Loaded one by one the compiler would load them as a vector, double them there, and take each out
/// again, which costs more than the doubling that addresses do anyway.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn apart(offsets: &[u16; 4]) -> [u16; 4] {
    // SAFETY: eight bytes are read of eight; the pointer need not be aligned.
    let all = unsafe { offsets.as_ptr().cast::<u64>().read_unaligned() };
    [all as u16, (all >> 16) as u16, (all >> 32) as u16, (all >> 48) as u16]
}

/// The same, sixteen at a time. Each pixel is loaded on its own: gather instructions of eight are no faster.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
#[inline]
fn sample_row_avx2(
    copy: &[u8; COPY_BYTES],
    offsets: &[u16; COLUMNS],
    weights: &[u16; COLUMNS],
    out: &mut [u8; COLUMNS],
) {
    use std::arch::x86_64::*;
    let four = |at: &[u16; 4]| {
        let at = apart(at);
        let first = _mm_cvtsi32_si128(word(copy, at[0]));
        let two = _mm_insert_epi32::<1>(first, word(copy, at[1]));
        _mm_insert_epi32::<3>(_mm_insert_epi32::<2>(two, word(copy, at[2])), word(copy, at[3]))
    };
    let eight = |at: [&[u16; 4]; 2]| _mm256_inserti128_si256::<1>(_mm256_castsi128_si256(four(at[0])), four(at[1]));
    // SAFETY: 32 bytes are read of 32, and written; the pointers need not be aligned.
    let load = |sixteen: &[u16; 16]| unsafe { _mm256_loadu_si256(sixteen.as_ptr().cast()) };
    let store = |to: &mut [u8; 32], v| unsafe { _mm256_storeu_si256(to.as_mut_ptr().cast(), v) };
    // The weights of four pixels of a half, each twice in 16 bits: fx of bytes 0, 2, 4, 6; fy beside; of the next four 8 on.
    let fx = _mm256_setr_epi64x(
        0x8002_8002_8000_8000_u64 as i64,
        0x8006_8006_8004_8004_u64 as i64,
        0x8002_8002_8000_8000_u64 as i64,
        0x8006_8006_8004_8004_u64 as i64,
    );
    let later = _mm256_add_epi8(fx, _mm256_set1_epi16(8));
    let next = _mm256_set1_epi16(1);
    let (left_half, left_256) = (_mm256_set1_epi32(0xffff), _mm256_set1_epi32(257));
    let offset = _mm256_set1_epi32((1 << 23) + (1 << 15));
    let values = |words, weights, fx| {
        let (x, y) = (_mm256_shuffle_epi8(weights, fx), _mm256_shuffle_epi8(weights, _mm256_add_epi8(fx, next)));
        let upper = _mm256_slli_epi16::<8>(words);
        let change = _mm256_sub_epi16(_mm256_srai_epi16::<8>(words), _mm256_srai_epi16::<8>(upper));
        let sums = _mm256_add_epi16(upper, _mm256_mullo_epi16(change, y));
        let x = _mm256_add_epi16(_mm256_xor_si256(x, left_half), left_256);
        _mm256_srli_epi32::<16>(_mm256_add_epi32(_mm256_madd_epi16(sums, x), offset))
    };
    let sixteen = |at: &[[u16; 4]], weights| {
        let (first, second) = (eight([&at[0], &at[1]]), eight([&at[2], &at[3]]));
        _mm256_packus_epi32(values(first, weights, fx), values(second, weights, later))
    };
    let order = _mm256_setr_epi32(0, 4, 1, 5, 2, 6, 3, 7);
    let blocks = offsets.as_chunks::<32>().0.iter().zip(weights.as_chunks::<32>().0);
    for ((offsets, weights), out) in blocks.zip(out.as_chunks_mut::<32>().0) {
        let (offsets, weights) = (offsets.as_chunks::<4>().0, weights.as_chunks::<16>().0);
        let low = sixteen(&offsets[..4], load(&weights[0]));
        let high = sixteen(&offsets[4..], load(&weights[1]));
        store(out, _mm256_permutevar8x32_epi32(_mm256_packus_epi16(low, high), order));
    }
}

/// The same with half as many instructions but the loads, which are one where it `GATHERS`.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx2")]
#[inline]
fn sample_row_avx512<const GATHERS: bool>(
    copy: &[u8; COPY_BYTES],
    offsets: &[u16; COLUMNS],
    weights: &[u16; COLUMNS],
    out: &mut [u8; COLUMNS],
) {
    use std::arch::x86_64::*;
    let four = |at: &[u16; 4]| {
        let at = apart(at);
        let first = _mm_cvtsi32_si128(word(copy, at[0]));
        let two = _mm_insert_epi32::<1>(first, word(copy, at[1]));
        _mm_insert_epi32::<3>(_mm_insert_epi32::<2>(two, word(copy, at[2])), word(copy, at[3]))
    };
    let eight = |at: [&[u16; 4]; 2]| _mm256_inserti128_si256::<1>(_mm256_castsi128_si256(four(at[0])), four(at[1]));
    // Weights as in `sample_row_avx2`: those of the first eight pixels, then those of the others.
    let fx = _mm256_setr_epi64x(
        0x8002_8002_8000_8000_u64 as i64,
        0x8006_8006_8004_8004_u64 as i64,
        0x8002_8002_8000_8000_u64 as i64,
        0x8006_8006_8004_8004_u64 as i64,
    );
    let later = _mm256_add_epi8(fx, _mm256_set1_epi16(8));
    let fx = _mm512_inserti64x4::<1>(_mm512_castsi256_si512(fx), later);
    let fy = _mm512_add_epi8(fx, _mm512_set1_epi16(1));
    let (left_half, left_256) = (_mm512_set1_epi32(0xffff), _mm512_set1_epi32(257));
    let offset = _mm512_set1_epi32((1 << 23) + (1 << 15));
    let blocks = offsets.as_chunks::<16>().0.iter().zip(weights.as_chunks::<16>().0);
    for ((offsets, weights), out) in blocks.zip(out.as_chunks_mut::<16>().0) {
        let words = if GATHERS {
            // SAFETY: 32 bytes are read of 32, then four from each place in twos on; the last one begins 65535 twos on and ends with
            // the copy.
            unsafe {
                let at = _mm512_cvtepu16_epi32(_mm256_loadu_si256(offsets.as_ptr().cast()));
                _mm512_i32gather_epi32::<2>(at, copy.as_ptr().cast())
            }
        } else {
            let at = offsets.as_chunks::<4>().0;
            let words = _mm512_castsi256_si512(eight([&at[0], &at[1]]));
            _mm512_inserti64x4::<1>(words, eight([&at[2], &at[3]]))
        };
        // SAFETY: 32 bytes are read of 32; the pointer need not be aligned.
        let weights = unsafe { _mm256_loadu_si256(weights.as_ptr().cast()) };
        let weights = _mm512_broadcast_i64x4(weights);
        let (x, y) = (_mm512_shuffle_epi8(weights, fx), _mm512_shuffle_epi8(weights, fy));
        let upper = _mm512_slli_epi16::<8>(words);
        let change = _mm512_sub_epi16(_mm512_srai_epi16::<8>(words), _mm512_srai_epi16::<8>(upper));
        let sums = _mm512_add_epi16(upper, _mm512_mullo_epi16(change, y));
        let x = _mm512_add_epi16(_mm512_xor_si512(x, left_half), left_256);
        let values = _mm512_srli_epi32::<16>(_mm512_add_epi32(_mm512_madd_epi16(sums, x), offset));
        // SAFETY: 16 bytes are written of 16.
        unsafe { _mm_storeu_si128(out.as_mut_ptr().cast(), _mm512_cvtepi32_epi8(values)) };
    }
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};

    use super::*;
    use crate::motion::Raster;
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
    fn rows_are_the_same_however_they_are_loaded() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(7);
        let mut copy = vec![0; COPY_BYTES];
        copy.iter_mut().for_each(|byte| *byte = (rng.next_u32() >> 24) as u8);
        let copy = copy.first_chunk().unwrap();
        for _ in 0..20 {
            let mut random = || std::array::from_fn(|_| (rng.next_u32() >> 16) as u16);
            let (mut offsets, weights): ([u16; COLUMNS], _) = (random(), random());
            offsets[17] = u16::MAX;
            let mut want = [0; COLUMNS];
            sample_row(Level::Portable, false, copy, &offsets, &weights, &mut want);
            for gathers in [false, true] {
                let mut got = [0; COLUMNS];
                sample_row(available(), gathers, copy, &offsets, &weights, &mut got);
                assert_eq!(got, want, "gathers: {gathers}");
            }
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

    const RING: [usize; 2] = [512, 300];

    /// A panorama of a ring in a picture of that size.
    fn ring(width: usize, height: usize) -> Vec<LutEntry> {
        let entry = |i: usize| {
            let (column, radius) = (i % width, 149.0 - 1.1 * (i / width) as f64);
            let (sin, cos) = (std::f64::consts::TAU * column as f64 / width as f64).sin_cos();
            let (x, y) = (250.0 + radius * cos, 149.6 + radius * sin);
            let weight = |v: f64| (256.0 * v.fract()) as u16;
            LutEntry { offset: y as u32 * RING[0] as u32 + x as u32, fx: weight(x), fy: weight(y) }
        };
        (0..width * height).map(entry).collect()
    }

    #[test]
    fn tiles_give_what_the_plain_loop_gives_on_a_ring() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        check(&ring(700, 90), 700, RING, &mut rng);
    }

    #[test]
    fn cells_give_what_the_plain_loop_gives_and_others_are_left_alone() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(6);
        let [stride, rows] = RING;
        let (width, height) = (700, 90);
        let entries = ring(width, height);
        let source: Vec<u8> = (0..stride * rows).map(|_| (rng.next_u32() >> 24) as u8).collect();
        let tiles = Tiles::new(&entries, width, RING).unwrap();
        let mut want = vec![0; entries.len()];
        super::super::unwarp(&source, stride, &entries, width, &mut want);
        for one_in in [1, 3, 40] {
            let mut work = Work::resting(Raster { width, height, wraps: true });
            let [columns, bands] = work.size();
            for cell in (0..columns * bands).filter(|_| rng.next_u32().is_multiple_of(one_in)) {
                work.draw(cell % columns, cell / columns);
            }
            for level in [Level::Portable, Level::Avx2, Level::Avx512] {
                // What no unwarping of this source leaves there.
                let before: Vec<u8> = want.iter().map(|p| p ^ 255).collect();
                let (mut got, mut kept) = (before.clone(), vec![0; before.len()]);
                let mut canvas = Canvas { picture: &mut got, work: &work, kept: Some(&mut kept) };
                assert!(at_most(level, || tiles.unwarp_cells(&source, &mut canvas)));
                for (i, got) in got.iter().enumerate() {
                    let (column, row) = (i % width, i / width);
                    // The last tile begins before the last cell, so that it is as wide as the others.
                    let is_shared = (width - COLUMNS..width / COLUMNS * COLUMNS).contains(&column);
                    let is_worked = work.is_worked(column / COLUMNS, row / CELL_ROWS);
                    assert_eq!(kept[i], if is_worked { before[i] } else { 0 }, "({column}, {row}), {level:?}");
                    if is_worked || !is_shared {
                        assert_eq!(*got, if is_worked { want[i] } else { before[i] }, "({column}, {row}), {level:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn a_table_that_points_out_of_its_source_makes_no_tiles() {
        let mut entries = vec![LutEntry::default(); 64 * 2];
        entries[70].offset = 16 * 15;
        assert!(Tiles::new(&entries, 64, [16, 16]).is_none());
    }
}
