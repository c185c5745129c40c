//! Sums of products over marked pixels: what a shadow is told by.

#[cfg(target_arch = "x86_64")]
use super::{Level, available};

/// Columns of a word of marks.
const COLUMNS: usize = 64;
/// Of picture², picture · background, background², noise² and background, each four columns apart.
pub type Fours = [[u32; COLUMNS / 4]; 5];

/// Sums over each four columns of a word of marks (its column 0 is pixel 0 of each slice, `width` pixels a row, as many rows
/// as there are `marks`): picture², picture · background, background² in (1/8 grey level)², noise², and background in 1/8 grey
/// level, of marked pixels.
/// Background and noise are 8.8 fixed point, noise at most [`super::NOISE_MAX`].
pub fn products_by_fours(
    marks: &[u64],
    picture: &[u8],
    background: &[u16],
    noise: &[u16],
    width: usize,
    fours: &mut Fours,
) {
    *fours = Fours::default();
    // Only the picture's last rows are not followed by as many pixels as are read.
    #[cfg(target_arch = "x86_64")]
    let reach = marks.len().saturating_sub(1) * width + COLUMNS;
    #[cfg(target_arch = "x86_64")]
    match available() {
        _ if reach > picture.len().min(background.len()).min(noise.len()) => {}
        Level::Avx512 => {
            for half in 0..COLUMNS / HALF {
                // SAFETY: the processor has these instructions.
                unsafe { sum_half_avx512(marks, picture, background, noise, width, half, fours) };
            }
            return;
        }
        Level::Avx2 => {
            for group in 0..COLUMNS / GROUP {
                // SAFETY: the processor has these instructions, and `reach` values are there.
                unsafe { sum_group_avx2(marks, picture, background, noise, width, group, fours) };
            }
            return;
        }
        Level::Portable => {}
    }
    for (row, &bits) in marks.iter().enumerate() {
        for i in (0..COLUMNS).filter(|i| bits >> i & 1 != 0) {
            let at = row * width + i;
            let (Some(c), Some(b), Some(s)) = (picture.get(at), background.get(at), noise.get(at)) else { continue };
            let (c, b, s) = (u32::from(*c) << 3, u32::from(*b >> 5), u32::from(*s));
            for (sums, product) in fours.iter_mut().zip([c * c, c * b, b * b, s * s, b]) {
                sums[i / 4] += product;
            }
        }
    }
}

/// Columns that AVX2 works together.
#[cfg(target_arch = "x86_64")]
const GROUP: usize = 16;
/// Columns that AVX-512 works together.
#[cfg(target_arch = "x86_64")]
const HALF: usize = 32;

/// The sums of one group of columns, sixteen products at a time: all values have at most 15 bits. Sums of two columns stay in
/// registers.
///
/// # Safety
/// The slices have the word's 64 columns in each of the rows.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
unsafe fn sum_group_avx2(
    marks: &[u64],
    picture: &[u8],
    background: &[u16],
    noise: &[u16],
    width: usize,
    group: usize,
    fours: &mut Fours,
) {
    use std::arch::x86_64::*;
    let bit = _mm256_setr_epi16(1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1024, 2048, 4096, 8192, 16384, i16::MIN);
    let zero = _mm256_setzero_si256();
    let one = _mm256_set1_epi16(1);
    let (mut cc, mut cb, mut bb, mut ss, mut b1) = (zero, zero, zero, zero, zero);
    let any = marks.iter().fold(0, |any, bits| any | bits);
    if (any >> (GROUP * group)) as u16 == 0 {
        return;
    }
    // Rows without marks add nothing; to ask for them costs more.
    for (row, &bits) in marks.iter().enumerate() {
        let marked = _mm256_and_si256(_mm256_set1_epi16((bits >> (GROUP * group)) as i16), bit);
        let marked = _mm256_cmpeq_epi16(marked, bit);
        let at = row * width + GROUP * group;
        // SAFETY: the group's columns are there; to ask again costs as much as to add.
        let (c, b, s) = unsafe {
            (
                _mm256_cvtepu8_epi16(_mm_loadu_si128(picture.as_ptr().add(at).cast())),
                _mm256_loadu_si256(background.as_ptr().add(at).cast()),
                _mm256_loadu_si256(noise.as_ptr().add(at).cast()),
            )
        };
        let c = _mm256_and_si256(_mm256_slli_epi16::<3>(c), marked);
        let b = _mm256_and_si256(_mm256_srli_epi16::<5>(b), marked);
        let s = _mm256_and_si256(s, marked);
        cc = _mm256_add_epi32(cc, _mm256_madd_epi16(c, c));
        cb = _mm256_add_epi32(cb, _mm256_madd_epi16(c, b));
        bb = _mm256_add_epi32(bb, _mm256_madd_epi16(b, b));
        ss = _mm256_add_epi32(ss, _mm256_madd_epi16(s, s));
        b1 = _mm256_add_epi32(b1, _mm256_madd_epi16(b, one));
    }
    // Sums of two columns become those of four, of two kinds side by side in each half.
    let both = |x, y| _mm256_permute4x64_epi64::<0b11_01_10_00>(_mm256_hadd_epi32(x, y));
    let pairs = [both(cc, cb), both(bb, ss), both(b1, zero)];
    let halves = pairs.into_iter().flat_map(|p| [_mm256_castsi256_si128(p), _mm256_extracti128_si256::<1>(p)]);
    for (half, sums) in halves.zip(fours) {
        if let Some(four) = sums[GROUP / 4 * group..].first_chunk_mut::<4>() {
            // SAFETY: 16 bytes are written of 16.
            unsafe { _mm_storeu_si128(four.as_mut_ptr().cast(), half) };
        }
    }
}

/// The same of a half of the columns.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512bw,avx512vl")]
fn sum_half_avx512(
    marks: &[u64],
    picture: &[u8],
    background: &[u16],
    noise: &[u16],
    width: usize,
    half: usize,
    fours: &mut Fours,
) {
    use std::arch::x86_64::*;
    let any = marks.iter().fold(0, |any, bits| any | bits);
    if (any >> (HALF * half)) as u32 == 0 {
        return;
    }
    let zero = _mm512_setzero_si512();
    let one = _mm512_set1_epi16(1);
    let (mut cc, mut cb, mut bb, mut ss, mut b1) = (zero, zero, zero, zero, zero);
    for (row, &bits) in marks.iter().enumerate() {
        let marked = (bits >> (HALF * half)) as u32;
        let at = row * width + HALF * half;
        let pixels = (picture[at..].first_chunk::<HALF>(), background[at..].first_chunk::<HALF>());
        let ((Some(c), Some(b)), Some(s)) = (pixels, noise[at..].first_chunk::<HALF>()) else { return };
        // SAFETY: 32 and 64 bytes are read of as many.
        let (c, b, s) = unsafe {
            (
                _mm512_maskz_cvtepu8_epi16(marked, _mm256_loadu_si256(c.as_ptr().cast())),
                _mm512_loadu_si512(b.as_ptr().cast()),
                _mm512_loadu_si512(s.as_ptr().cast()),
            )
        };
        let c = _mm512_slli_epi16::<3>(c);
        let (b, s) = (_mm512_maskz_srli_epi16::<5>(marked, b), _mm512_maskz_mov_epi16(marked, s));
        cc = _mm512_add_epi32(cc, _mm512_madd_epi16(c, c));
        cb = _mm512_add_epi32(cb, _mm512_madd_epi16(c, b));
        bb = _mm512_add_epi32(bb, _mm512_madd_epi16(b, b));
        ss = _mm512_add_epi32(ss, _mm512_madd_epi16(s, s));
        b1 = _mm512_add_epi32(b1, _mm512_madd_epi16(b, one));
    }
    for (pairs, sums) in [cc, cb, bb, ss, b1].into_iter().zip(fours) {
        let four = _mm512_add_epi32(pairs, _mm512_srli_epi64::<32>(pairs));
        if let Some(eight) = sums[HALF / 4 * half..].first_chunk_mut::<8>() {
            // SAFETY: 32 bytes are written of 32.
            unsafe { _mm256_storeu_si256(eight.as_mut_ptr().cast(), _mm512_cvtepi64_epi32(four)) };
        }
    }
}
