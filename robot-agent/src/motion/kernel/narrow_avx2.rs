//! [`super::narrow`] with AVX2, whose loads cannot leave bytes out: the whole block is read where it is all in the picture, else a copy.

use std::arch::x86_64::*;

use super::avx2::{in_order, load_bytes, store_bytes, store_levels};
use super::narrow::{BYTES, by_bands, cells_from};
use super::runs::BLOCK;
use crate::motion::regions::Run;

/// Of 64 bytes from place 64 − n on the first n are zero; of those from place 128 − n on, all but these.
const STAIRS: [u8; 3 * BLOCK] = {
    let mut stairs = [0; 3 * BLOCK];
    let mut i = BLOCK;
    while i < 2 * BLOCK {
        stairs[i] = u8::MAX;
        i += 1;
    }
    stairs
};

/// 255 in the places `from` to `end` of a block, of which there are 64.
#[target_feature(enable = "avx2")]
#[inline]
fn inside(from: usize, end: usize) -> [__m256i; 2] {
    let stairs = |at: usize| halves(STAIRS[at..].first_chunk().unwrap_or(&[0; BLOCK]));
    let ([a, b], [c, d]) = (stairs(BLOCK - from.min(BLOCK)), stairs(2 * BLOCK - end.min(BLOCK)));
    [_mm256_and_si256(a, c), _mm256_and_si256(b, d)]
}

#[target_feature(enable = "avx2")]
#[inline]
fn halves(block: &[u8; BLOCK]) -> [__m256i; 2] {
    let (halves, _) = block.as_chunks::<32>();
    [load_bytes(&halves[0]), load_bytes(&halves[1])]
}

/// 255 at the places of a run's pixels, counted from column `start` of a ring of `width`, and those pixels there. Zeros of a run that is
/// not within 64 columns, or not in the picture.
#[target_feature(enable = "avx2")]
#[inline]
fn pixels_of(run: &Run, width: usize, start: usize, values: &[u8]) -> ([__m256i; 2], [__m256i; 2]) {
    let (offset, len) = (run.offset(start, width), run.len as usize);
    let first = run.row as usize * width + run.start as usize;
    let nothing = [_mm256_setzero_si256(); 2];
    let Some(pixels) = values.get(first..first + len).filter(|_| offset + len <= BLOCK) else {
        return (nothing, nothing);
    };
    let mut copy = [0; BLOCK];
    let all = first.checked_sub(offset).and_then(|at| values.get(at..)?.first_chunk::<BLOCK>());
    let block = all.unwrap_or_else(|| {
        copy[offset..offset + len].copy_from_slice(pixels);
        &copy
    });
    let (inside, [low, high]) = (inside(offset, offset + len), halves(block));
    (inside, [_mm256_and_si256(inside[0], low), _mm256_and_si256(inside[1], high)])
}

/// Adds bytes to 64 sums of 16 bits.
#[target_feature(enable = "avx2")]
#[inline]
fn add_bytes(sums: &mut [__m256i; 4], bytes: [__m256i; 2]) {
    let zero = _mm256_setzero_si256();
    for (sums, bytes) in sums.as_chunks_mut::<2>().0.iter_mut().zip(bytes) {
        let bytes = in_order(bytes);
        sums[0] = _mm256_add_epi16(sums[0], _mm256_unpacklo_epi8(bytes, zero));
        sums[1] = _mm256_add_epi16(sums[1], _mm256_unpackhi_epi8(bytes, zero));
    }
}

/// Adds them to sums of 32 bits.
#[target_feature(enable = "avx2")]
#[inline]
fn spill(parts: [__m256i; 4], sums: &mut [u32; BLOCK]) {
    for (sums, part) in sums.as_chunks_mut::<16>().0.iter_mut().zip(parts) {
        let mut all = [0u16; 16];
        store_levels(&mut all, part);
        for (sum, part) in sums.iter_mut().zip(all) {
            *sum = sum.wrapping_add(u32::from(part));
        }
    }
}

/// See [`super::add_to_columns`].
#[target_feature(enable = "avx2")]
pub(super) fn add_to_columns(
    runs: &[Run],
    width: usize,
    start: usize,
    values: &[u8],
    [least, most]: [u8; 2],
    sums: &mut [u32; BLOCK],
) {
    let (least, most) = (_mm256_set1_epi8(least as i8), _mm256_set1_epi8(most as i8));
    for runs in runs.chunks(BYTES) {
        let mut columns = [_mm256_setzero_si256(); 4];
        for run in runs {
            let (inside, pixels) = pixels_of(run, width, start, values);
            let within =
                |k: usize| _mm256_and_si256(inside[k], _mm256_min_epu8(_mm256_max_epu8(pixels[k], least), most));
            add_bytes(&mut columns, [within(0), within(1)]);
        }
        spill(columns, sums);
    }
}

/// See [`super::add_to_cells`].
#[target_feature(enable = "avx2")]
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
        let (mut ones, mut cells) = ([_mm256_setzero_si256(); 2], [_mm256_setzero_si256(); 4]);
        for run in these {
            let (inside, pixels) = pixels_of(run, width, start, pixels);
            // 255 is −1.
            ones = [_mm256_sub_epi8(ones[0], inside[0]), _mm256_sub_epi8(ones[1], inside[1])];
            add_bytes(&mut cells, pixels);
        }
        let Some((counts, sums)) = cells_from(counts, sums, band * columns) else { return };
        for (counts, ones) in counts.as_chunks_mut::<32>().0.iter_mut().zip(ones) {
            let mut all = [0; 32];
            store_bytes(&mut all, ones);
            for (count, ones) in counts.iter_mut().zip(all) {
                *count = count.wrapping_add(u16::from(ones));
            }
        }
        spill(cells, sums);
    }
}

/// See [`super::narrow::sum_of_first`].
#[target_feature(enable = "avx2")]
#[inline]
pub(super) fn sum_of_first(values: &[u8; BLOCK], n: usize, most: u8) -> u32 {
    let (inside, values, most) = (inside(0, n), halves(values), _mm256_set1_epi8(most as i8));
    let sum = |k: usize| {
        let within = _mm256_and_si256(inside[k], _mm256_min_epu8(values[k], most));
        _mm256_sad_epu8(within, _mm256_setzero_si256())
    };
    let fours = _mm256_add_epi64(sum(0), sum(1));
    let twos = _mm_add_epi64(_mm256_castsi256_si128(fours), _mm256_extracti128_si256::<1>(fours));
    (_mm_cvtsi128_si64(twos) + _mm_extract_epi64::<1>(twos)) as u32
}
