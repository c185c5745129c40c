//! The same unwarping eight pixels at a time, for processors with AVX2; bit for bit what the plain loop gives.
//!
//! Most of the time goes to cache misses in the source and to the table. So the table is stored in the order of work, six
//! bytes a pixel: tiles of 64 columns from top to bottom, whose source is a wedge of the ring, and while a tile is worked on
//! the source of the next one is fetched. The four source pixels are collected into one 32-bit word a pixel by plain loads
//! (gather instructions are slower), a row of a tile ahead of the arithmetic. Rows of a source whose width is a multiple of 1024
//! fall on the same lines of the cache; such a source is first copied, as far as it is used, to rows a line longer.
//!
//! ```text
//! word  a | b<<8 | c<<16 | d<<24      upper pair (a b), lower pair (c d)
//! left  a(256−fy) + c·fy     right  b(256−fy) + d·fy        16 bits each: at most 255·256
//! value (left(256−fx) + right·fx + 2¹⁵) >> 16               signed 16-bit multiply-add: both less 2¹⁵ before, 256·2¹⁵ after
//! ```

use std::sync::{Arc, Mutex};

use super::super::LutEntry;

/// Columns of a tile.
const COLUMNS: usize = 64;
/// Pixels of the next tile's row whose source is fetched ahead.
const AHEAD: [usize; 3] = [0, 32, 63];

/// The table in the order of work. Every pixel's four source pixels lie inside a source of `source_len`: [`Tiles::new`] has
/// checked it, nothing changes it.
#[derive(Debug, Clone)]
pub(crate) struct Tiles {
    offsets: Vec<u32>,
    /// fx | fy << 8.
    weights: Vec<u16>,
    /// Pixels with a weight of 256, which eight bits do not hold: at the source's last column or row.
    rim: Vec<(u32, LutEntry)>,
    stride: usize,
    source_len: usize,
    width: usize,
    height: usize,
    copy: Option<PaddedCopy>,
}

/// Where a source is copied to whose rows would fall on the same lines of the cache.
#[derive(Debug, Clone)]
struct PaddedCopy {
    stride: usize,
    /// First column that is used and the one after the last, for each row of the source.
    used: Vec<[u32; 2]>,
    /// One for all clones of a table; whoever finds it in use takes the plain loop.
    pixels: Arc<Mutex<Vec<u8>>>,
}

/// Widths of sources that are copied: multiples of this …
const ALIASING: usize = 1024;
/// … to rows longer by this: a line of the cache.
const PADDING: usize = 64;

impl Tiles {
    /// From the table by rows; `None` where this processor, or a panorama narrower than a tile, is left to the plain loop.
    pub(crate) fn new(entries: &[LutEntry], width: usize, source: [usize; 2]) -> Option<Self> {
        if !is_available() || width < COLUMNS || !entries.len().is_multiple_of(width) {
            return None;
        }
        let [stride, rows] = source;
        let (source_len, height) = (stride * rows, entries.len() / width);
        let mut tiles = Self {
            offsets: Vec::with_capacity(entries.len()),
            weights: Vec::with_capacity(entries.len()),
            rim: Vec::new(),
            stride,
            source_len,
            width,
            height,
            copy: PaddedCopy::new(entries, source),
        };
        let inner = tiles.inner_stride();
        for start in starts(width) {
            for v in 0..height {
                for (i, entry) in entries[v * width + start..][..COLUMNS].iter().enumerate() {
                    let (packed, weight) = match in_eight_bits(*entry, source) {
                        Some(narrow) => narrow,
                        None => {
                            tiles.rim.push(((v * width + start + i) as u32, *entry));
                            (entry.offset, 0)
                        }
                    };
                    if packed as usize + stride + 1 >= source_len {
                        return None;
                    }
                    tiles.offsets.push((packed as usize / stride * inner + packed as usize % stride) as u32);
                    tiles.weights.push(weight);
                }
            }
        }
        Some(tiles)
    }

    /// Pixels of a row in what the offsets point into.
    fn inner_stride(&self) -> usize {
        self.copy.as_ref().map_or(self.stride, |copy| copy.stride)
    }

    /// Bytes held.
    pub(crate) fn memory_bytes(&self) -> usize {
        let copy = self.copy.as_ref().map_or(0, |copy| copy.stride * copy.used.len());
        copy + size_of_val(&*self.offsets) + size_of_val(&*self.weights) + size_of_val(&*self.rim)
    }

    /// Unwarps; whether it could: a source or output of another size is left to the plain loop.
    pub(crate) fn unwarp(&self, source: &[u8], out: &mut [u8]) -> bool {
        if source.len() != self.source_len || out.len() != self.width * self.height {
            return false;
        }
        #[cfg(target_arch = "x86_64")]
        {
            if let Some(copy) = &self.copy {
                let Ok(mut pixels) = copy.pixels.try_lock() else { return false };
                copy.fill(source, self.stride, &mut pixels);
                // SAFETY: as below; the copy has as many rows as the source, each at least as long.
                unsafe { avx2::unwarp(self, &pixels, out) };
            } else {
                // SAFETY: `new` gives no table where AVX2 is not there; the lengths were compared above.
                unsafe { avx2::unwarp(self, source, out) };
            }
            for (i, entry) in &self.rim {
                out[*i as usize] = super::sample(source, self.stride, *entry);
            }
            true
        }
        #[cfg(not(target_arch = "x86_64"))]
        false
    }
}

impl PaddedCopy {
    fn new(entries: &[LutEntry], [stride, rows]: [usize; 2]) -> Option<Self> {
        if !stride.is_multiple_of(ALIASING) || u32::try_from((stride + PADDING) * rows).is_err() {
            return None;
        }
        let mut used = vec![[u32::MAX, 0]; rows];
        for entry in entries {
            let (row, column) = (entry.offset as usize / stride, (entry.offset as usize % stride) as u32);
            // A weight of 256 makes the pixel after the next the second of a pair.
            for [first, end] in used.iter_mut().skip(row).take(3) {
                *first = (*first).min(column);
                *end = (*end).max((column + 3).min(stride as u32));
            }
        }
        Some(Self { stride: stride + PADDING, used, pixels: Arc::default() })
    }

    #[cfg(target_arch = "x86_64")]
    fn fill(&self, source: &[u8], stride: usize, pixels: &mut Vec<u8>) {
        pixels.resize(self.stride * self.used.len(), 0);
        let rows = source.chunks_exact(stride).zip(pixels.chunks_exact_mut(self.stride));
        for ((from, to), [first, end]) in rows.zip(&self.used) {
            if first < end {
                let columns = *first as usize..*end as usize;
                to[columns.clone()].copy_from_slice(&from[columns]);
            }
        }
    }
}

fn is_available() -> bool {
    #[cfg(target_arch = "x86_64")]
    {
        std::arch::is_x86_feature_detected!("avx2")
    }
    #[cfg(not(target_arch = "x86_64"))]
    false
}

/// First columns of the tiles. The last one ends with the row, so it may repeat a part of the one before.
fn starts(width: usize) -> impl Iterator<Item = usize> {
    (0..width).step_by(COLUMNS).map(move |start| start.min(width - COLUMNS))
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

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use std::arch::x86_64::*;

    use super::{AHEAD, COLUMNS, Tiles, starts};

    /// # Safety
    /// The processor has AVX2; `source` and `out` have the table's lengths.
    #[target_feature(enable = "avx2")]
    pub(super) unsafe fn unwarp(tiles: &Tiles, source: &[u8], out: &mut [u8]) {
        let (width, height, stride) = (tiles.width, tiles.height, tiles.inner_stride());
        let mut words = [[0u32; COLUMNS]; 2];
        let tile = height * COLUMNS;
        for (t, start) in starts(width).enumerate() {
            let offsets = &tiles.offsets[t * tile..][..tile];
            let weights = &tiles.weights[t * tile..][..tile];
            let next = tiles.offsets.get((t + 1) * tile..(t + 2) * tile).unwrap_or(offsets);
            for v in 0..=height {
                if v < height {
                    let here: &[u32; COLUMNS] = offsets[v * COLUMNS..].first_chunk().unwrap_or(&[0; COLUMNS]);
                    for i in AHEAD {
                        let offset = next[v * COLUMNS + i] as usize;
                        // SAFETY: inside the source, as for every offset of the table; a prefetch reads nothing.
                        unsafe { _mm_prefetch::<_MM_HINT_T0>(source.as_ptr().add(offset).cast()) };
                    }
                    for (word, offset) in words[v & 1].iter_mut().zip(here) {
                        // SAFETY: `Tiles::new` has checked offset + stride + 1 < source length.
                        let (upper, lower) = unsafe {
                            let at = source.as_ptr().add(*offset as usize);
                            (at.cast::<u16>().read_unaligned(), at.add(stride).cast::<u16>().read_unaligned())
                        };
                        *word = u32::from(u16::from_le(upper)) | u32::from(u16::from_le(lower)) << 16;
                    }
                }
                if let Some(done) = v.checked_sub(1) {
                    let weights: &[u16; COLUMNS] = weights[done * COLUMNS..].first_chunk().unwrap_or(&[0; COLUMNS]);
                    let row: Option<&mut [u8; COLUMNS]> = out[done * width + start..].first_chunk_mut();
                    if let Some(row) = row {
                        interpolate(&words[done & 1], weights, row);
                    }
                }
            }
        }
    }

    #[target_feature(enable = "avx2")]
    fn interpolate(words: &[u32; COLUMNS], weights: &[u16; COLUMNS], out: &mut [u8; COLUMNS]) {
        for half in 0..COLUMNS / 32 {
            let mut values = [_mm256_setzero_si256(); 4];
            for (k, value) in values.iter_mut().enumerate() {
                let i = half * 32 + k * 8;
                // SAFETY: eight words and eight weights from i on: i + 8 <= COLUMNS.
                let (word, weight) = unsafe {
                    (_mm256_loadu_si256(words.as_ptr().add(i).cast()), _mm_loadu_si128(weights.as_ptr().add(i).cast()))
                };
                *value = eight(word, _mm256_cvtepu16_epi32(weight));
            }
            let low = _mm256_packus_epi32(values[0], values[1]);
            let high = _mm256_packus_epi32(values[2], values[3]);
            let bytes = _mm256_packus_epi16(low, high);
            // Packing works on halves of the register: put the words in order again.
            let ordered = _mm256_permutevar8x32_epi32(bytes, _mm256_setr_epi32(0, 4, 1, 5, 2, 6, 3, 7));
            // SAFETY: 32 bytes from half · 32 on, of COLUMNS.
            unsafe { _mm256_storeu_si256(out.as_mut_ptr().add(half * 32).cast(), ordered) };
        }
    }

    /// Eight pixels from their words and weights, 32 bits each.
    #[target_feature(enable = "avx2")]
    fn eight(word: __m256i, weight: __m256i) -> __m256i {
        let pair = |part: __m256i| {
            // part << 16 | 256 − part, for parts below 256.
            _mm256_add_epi32(_mm256_sub_epi32(_mm256_slli_epi32::<16>(part), part), _mm256_set1_epi32(256))
        };
        let bytes = _mm256_set1_epi32(0x00ff_00ff);
        let fx = pair(_mm256_and_si256(weight, _mm256_set1_epi32(0xff)));
        let fy = pair(_mm256_srli_epi32::<8>(weight));
        let left = _mm256_madd_epi16(_mm256_and_si256(word, bytes), fy);
        let right = _mm256_madd_epi16(_mm256_and_si256(_mm256_srli_epi32::<8>(word), bytes), fy);
        let both = _mm256_or_si256(left, _mm256_slli_epi32::<16>(right));
        let signed = _mm256_xor_si256(both, _mm256_set1_epi32(0x8000_8000_u32 as i32));
        let sum = _mm256_madd_epi16(signed, fx);
        _mm256_srli_epi32::<16>(_mm256_add_epi32(sum, _mm256_set1_epi32((256 << 15) + (1 << 15))))
    }
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};

    use super::*;

    #[test]
    fn tiles_give_what_the_plain_loop_gives_at_any_place_and_weight() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(4);
        for (width, stride, rows) in [(64, 70, 40), (65, 200, 90), (150, 33, 20), (192, 16, 16), (130, 1024, 30)] {
            let source: Vec<u8> = (0..stride * rows).map(|_| (rng.next_u32() >> 24) as u8).collect();
            let entries: Vec<LutEntry> = (0..width * 9)
                .map(|_| {
                    let (x, y) = (rng.next_u32() % (stride as u32 - 1), rng.next_u32() % (rows as u32 - 1));
                    let weight = |r: u32| if r.is_multiple_of(5) { 256 } else { (r / 5 % 257) as u16 };
                    LutEntry { offset: y * stride as u32 + x, fx: weight(rng.next_u32()), fy: weight(rng.next_u32()) }
                })
                .collect();
            let Some(tiles) = Tiles::new(&entries, width, [stride, rows]) else {
                assert!(!is_available(), "no tiles for {width} columns");
                continue;
            };
            let (mut want, mut got) = (vec![0; entries.len()], vec![0; entries.len()]);
            super::super::unwarp(&source, stride, &entries, width, &mut want);
            assert!(tiles.unwarp(&source, &mut got));
            assert_eq!(got, want, "{width} columns");
        }
    }

    #[test]
    fn a_table_that_points_out_of_its_source_makes_no_tiles() {
        let mut entries = vec![LutEntry::default(); 64 * 2];
        entries[70].offset = 16 * 15;
        assert!(Tiles::new(&entries, 64, [16, 16]).is_none());
    }
}
