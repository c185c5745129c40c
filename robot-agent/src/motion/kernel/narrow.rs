//! Sums over the pixels of a region of at most 64 columns, as most bodies have: with AVX-512 they stay in registers from row to row.

use std::arch::x86_64::*;

use super::avx512::load_block;
use super::runs::{BLOCK, lowest};
use crate::motion::regions::Run;

/// Values that may be added up in 16 bits, and ones in 8.
pub(super) const BYTES: usize = 257;
const ONES: usize = 255;

/// A region's runs by the band of `height` / `bands` rows that they lie in, in pieces of no more than may be counted in 8 bits.
#[inline(always)]
pub(super) fn by_bands(runs: &[Run], height: usize, bands: usize) -> impl Iterator<Item = (usize, &[Run])> {
    let mut left = runs;
    std::iter::from_fn(move || {
        let band = left.first()?.row as usize * bands / height;
        let end = ((band + 1) * height).div_ceil(bands) as u32;
        let here = left.iter().position(|run| run.row >= end).unwrap_or(left.len()).min(ONES);
        let (these, later) = left.split_at(here);
        left = later;
        Some((band, these))
    })
}

/// Counts and sums of the cells from `first` on.
#[inline(always)]
pub(super) fn cells_from<'a>(
    counts: &'a mut [u16],
    sums: &'a mut [u32],
    first: usize,
) -> Option<(&'a mut [u16; BLOCK], &'a mut [u32; BLOCK])> {
    Some((counts.get_mut(first..)?.first_chunk_mut()?, sums.get_mut(first..)?.first_chunk_mut()?))
}

/// A run's pixels, each at the place of its column counted from column `start` of a ring of `width`, and which places those are. None
/// of a run that is not within 64 columns, or not in the picture.
#[target_feature(enable = "avx512f,avx512bw")]
#[inline]
fn pixels_of(run: &Run, width: usize, start: usize, values: &[u8]) -> (u64, __m512i) {
    let (offset, len) = (run.offset(start, width), run.len as usize);
    let first = run.row as usize * width + run.start as usize;
    if len == 0 || offset + len > BLOCK || first + len > values.len() {
        return (0, _mm512_setzero_si512());
    }
    let inside = lowest(len) << offset;
    let at = values.as_ptr().wrapping_add(first).wrapping_sub(offset);
    // SAFETY: those read are `len` bytes of `values` from `first` on; the pointer need not be aligned.
    (inside, unsafe { _mm512_maskz_loadu_epi8(inside, at.cast()) })
}

/// Adds bytes to 64 sums of 16 bits.
#[target_feature(enable = "avx512f,avx512bw")]
#[inline]
fn add_bytes([low, high]: &mut [__m512i; 2], bytes: __m512i) {
    *low = _mm512_add_epi16(*low, _mm512_cvtepu8_epi16(_mm512_castsi512_si256(bytes)));
    *high = _mm512_add_epi16(*high, _mm512_cvtepu8_epi16(_mm512_extracti64x4_epi64::<1>(bytes)));
}

/// Adds them to sums of 32 bits.
#[target_feature(enable = "avx512f,avx512bw")]
#[inline]
fn spill([low, high]: [__m512i; 2], sums: &mut [u32; BLOCK]) {
    let mut all = [0u16; BLOCK];
    // SAFETY: 128 bytes are written of 128; the pointer need not be aligned.
    unsafe {
        _mm512_storeu_si512(all.as_mut_ptr().cast(), low);
        _mm512_storeu_si512(all.as_mut_ptr().add(32).cast(), high);
    }
    for (sum, part) in sums.iter_mut().zip(all) {
        *sum = sum.wrapping_add(u32::from(part));
    }
}

/// See [`super::add_to_columns`].
#[target_feature(enable = "avx512f,avx512bw")]
pub(super) fn add_to_columns(
    runs: &[Run],
    width: usize,
    start: usize,
    values: &[u8],
    [least, most]: [u8; 2],
    sums: &mut [u32; BLOCK],
) {
    let (least, most) = (_mm512_set1_epi8(least as i8), _mm512_set1_epi8(most as i8));
    for runs in runs.chunks(BYTES) {
        let mut columns = [_mm512_setzero_si512(); 2];
        for run in runs {
            let (inside, pixels) = pixels_of(run, width, start, values);
            add_bytes(&mut columns, _mm512_maskz_min_epu8(inside, _mm512_max_epu8(pixels, least), most));
        }
        spill(columns, sums);
    }
}

/// See [`super::add_to_cells`].
#[target_feature(enable = "avx512f,avx512bw")]
pub(super) fn add_to_cells(
    runs: &[Run],
    [width, height]: [usize; 2],
    start: usize,
    [columns, bands]: [usize; 2],
    pixels: &[u8],
    counts: &mut [u16],
    sums: &mut [u32],
) {
    for (band, these) in by_bands(runs, height, bands) {
        let (mut ones, mut cells) = (_mm512_setzero_si512(), [_mm512_setzero_si512(); 2]);
        for run in these {
            let (inside, pixels) = pixels_of(run, width, start, pixels);
            ones = _mm512_mask_add_epi8(ones, inside, ones, _mm512_set1_epi8(1));
            add_bytes(&mut cells, pixels);
        }
        let Some((counts, sums)) = cells_from(counts, sums, band * columns) else { return };
        let mut all = [0u8; BLOCK];
        // SAFETY: 64 bytes are written of 64; the pointer need not be aligned.
        unsafe { _mm512_storeu_si512(all.as_mut_ptr().cast(), ones) };
        for (count, ones) in counts.iter_mut().zip(all) {
            *count = count.wrapping_add(u16::from(ones));
        }
        spill(cells, sums);
    }
}

/// The sum of the first `n` values, at most `most` each; sums of eight neighbours are one instruction.
#[target_feature(enable = "avx512f,avx512bw")]
#[inline]
pub(super) fn sum_of_first(values: &[u8; BLOCK], n: usize, most: u8) -> u32 {
    let values = _mm512_maskz_min_epu8(lowest(n), load_block(values), _mm512_set1_epi8(most as i8));
    _mm512_reduce_add_epi64(_mm512_sad_epu8(values, _mm512_setzero_si512())) as u32
}
