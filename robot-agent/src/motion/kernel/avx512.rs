//! What several loops need of AVX-512.

use std::arch::x86_64::*;

#[target_feature(enable = "avx512f")]
#[inline]
pub(super) fn load_levels(levels: &[u16; 32]) -> __m512i {
    // SAFETY: 64 bytes are read of 64; the pointer need not be aligned.
    unsafe { _mm512_loadu_si512(levels.as_ptr().cast()) }
}

#[target_feature(enable = "avx512f")]
#[inline]
pub(super) fn load_block(bytes: &[u8; 64]) -> __m512i {
    // SAFETY: 64 bytes are read of 64; the pointer need not be aligned.
    unsafe { _mm512_loadu_si512(bytes.as_ptr().cast()) }
}

/// [`super::expose`] of 32 pixels.
#[target_feature(enable = "avx512f,avx512bw,avx2")]
#[inline]
pub(super) fn exposed(pixels: __m256i, exposure_q15: __m512i) -> __m512i {
    let level = _mm512_slli_epi16::<8>(_mm512_cvtepu8_epi16(pixels));
    let half = _mm512_min_epu16(high_product(level, exposure_q15), _mm512_set1_epi16(i16::MAX));
    _mm512_slli_epi16::<1>(half)
}

/// The absolute differences of levels.
#[target_feature(enable = "avx512f,avx512bw")]
#[inline]
pub(super) fn difference(a: __m512i, b: __m512i) -> __m512i {
    _mm512_or_si512(_mm512_subs_epu16(a, b), _mm512_subs_epu16(b, a))
}

/// See [`super::avx2`]'s.
#[target_feature(enable = "avx512f,avx512bw")]
#[inline]
fn high_product(a: __m512i, b: __m512i) -> __m512i {
    let product;
    // SAFETY: the processor has the instruction, which touches nothing but these registers.
    unsafe {
        std::arch::asm!("vpmulhuw {}, {}, {}", out(zmm_reg) product, in(zmm_reg) a, in(zmm_reg) b,
            options(pure, nomem, nostack, preserves_flags));
    }
    product
}
