//! Sums of products over marked pixels: what a shadow is told by.

use super::{Level, available, padded};

/// Columns of a word of marks.
const COLUMNS: usize = 64;
/// Of picture², picture · background, background², noise², each four columns apart.
type Fours = [[u32; COLUMNS / 4]; 4];

/// Sums over each four columns of a word of marks (its column 0 is pixel 0 of each slice, `width` pixels a row, as many rows
/// as there are `marks`): picture², picture · background, background² in (1/8 grey level)², and noise², of marked pixels.
/// Background and noise are 8.8 fixed point, noise at most [`super::NOISE_MAX`].
pub fn products_by_fours(marks: &[u64], picture: &[u8], background: &[u16], noise: &[u16], width: usize) -> Fours {
    let mut fours = Fours::default();
    let level = available();
    for (row, &bits) in marks.iter().enumerate() {
        if bits == 0 {
            continue;
        }
        let pixels = (row * width).min(picture.len())..(row * width + COLUMNS).min(picture.len());
        let (c, b, s) = (&picture[pixels.clone()], &background[pixels.clone()], &noise[pixels]);
        match (c.first_chunk(), b.first_chunk(), s.first_chunk()) {
            (Some(c), Some(b), Some(s)) => add_row(level, bits, c, b, s, &mut fours),
            _ => add_row(level, bits, &padded(c), &padded(b), &padded(s), &mut fours),
        }
    }
    fours
}

#[inline(always)]
fn add_row(
    level: Level,
    bits: u64,
    picture: &[u8; COLUMNS],
    background: &[u16; COLUMNS],
    noise: &[u16; COLUMNS],
    fours: &mut Fours,
) {
    #[cfg(target_arch = "x86_64")]
    if level >= Level::Avx2 {
        // SAFETY: the processor has these instructions.
        return unsafe { add_row_avx2(bits, picture, background, noise, fours) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = level;
    for i in (0..COLUMNS).filter(|i| bits >> i & 1 != 0) {
        let (c, b, s) = (u32::from(picture[i]) << 3, u32::from(background[i] >> 5), u32::from(noise[i]));
        for (sums, product) in fours.iter_mut().zip([c * c, c * b, b * b, s * s]) {
            sums[i / 4] += product;
        }
    }
}

/// The same, sixteen columns at a time: all values have at most 15 bits.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn add_row_avx2(
    bits: u64,
    picture: &[u8; COLUMNS],
    background: &[u16; COLUMNS],
    noise: &[u16; COLUMNS],
    fours: &mut Fours,
) {
    use std::arch::x86_64::*;
    let bit = _mm256_setr_epi16(1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1024, 2048, 4096, 8192, 16384, i16::MIN);
    let blocks = picture.as_chunks::<16>().0.iter().zip(background.as_chunks::<16>().0).zip(noise.as_chunks::<16>().0);
    for (k, ((c, b), s)) in blocks.enumerate() {
        let marked = _mm256_and_si256(_mm256_set1_epi16((bits >> (16 * k)) as i16), bit);
        let marked = _mm256_cmpeq_epi16(marked, bit);
        // SAFETY: 16 and 32 bytes are read of as many.
        let (c, b, s) = unsafe {
            (
                _mm256_cvtepu8_epi16(_mm_loadu_si128(c.as_ptr().cast())),
                _mm256_loadu_si256(b.as_ptr().cast()),
                _mm256_loadu_si256(s.as_ptr().cast()),
            )
        };
        let c = _mm256_and_si256(_mm256_slli_epi16::<3>(c), marked);
        let b = _mm256_and_si256(_mm256_srli_epi16::<5>(b), marked);
        let s = _mm256_and_si256(s, marked);
        // Sums of two columns become those of four, of two kinds side by side in each half.
        let both = |x, y| _mm256_permute4x64_epi64::<0b11_01_10_00>(_mm256_hadd_epi32(x, y));
        let first = both(_mm256_madd_epi16(c, c), _mm256_madd_epi16(c, b));
        let second = both(_mm256_madd_epi16(b, b), _mm256_madd_epi16(s, s));
        let [cc, cb, bb, ss] = &mut *fours;
        for (pair, sums) in [(first, [cc, cb]), (second, [bb, ss])] {
            let halves = [_mm256_castsi256_si128(pair), _mm256_extracti128_si256::<1>(pair)];
            for (half, sums) in halves.into_iter().zip(sums) {
                if let Some(four) = sums[4 * k..].first_chunk_mut::<4>() {
                    // SAFETY: 16 bytes are read and written of 16.
                    unsafe {
                        let before = _mm_loadu_si128(four.as_ptr().cast());
                        _mm_storeu_si128(four.as_mut_ptr().cast(), _mm_add_epi32(before, half));
                    }
                }
            }
        }
    }
}
