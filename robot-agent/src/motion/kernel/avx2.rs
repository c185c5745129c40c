//! What several loops need of AVX2.

use std::arch::x86_64::*;

#[target_feature(enable = "avx2")]
#[inline]
pub(super) fn load_bytes(bytes: &[u8; 32]) -> __m256i {
    // SAFETY: 32 bytes are read of 32; the pointer need not be aligned.
    unsafe { _mm256_loadu_si256(bytes.as_ptr().cast()) }
}

#[target_feature(enable = "avx2")]
#[inline]
pub(super) fn load_levels(levels: &[u16; 16]) -> __m256i {
    // SAFETY: 32 bytes are read of 32; the pointer need not be aligned.
    unsafe { _mm256_loadu_si256(levels.as_ptr().cast()) }
}

#[target_feature(enable = "avx2")]
#[inline]
pub(super) fn store_bytes(to: &mut [u8; 32], bytes: __m256i) {
    // SAFETY: 32 bytes are written of 32; the pointer need not be aligned.
    unsafe { _mm256_storeu_si256(to.as_mut_ptr().cast(), bytes) }
}

#[target_feature(enable = "avx2")]
#[inline]
pub(super) fn store_levels(to: &mut [u16; 16], levels: __m256i) {
    // SAFETY: 32 bytes are written of 32; the pointer need not be aligned.
    unsafe { _mm256_storeu_si256(to.as_mut_ptr().cast(), levels) }
}

/// [`super::expose`] of 32 pixels, the first sixteen and the others.
#[target_feature(enable = "avx2")]
#[inline]
pub(super) fn exposed(pixels: __m256i, exposure_q15: __m256i) -> [__m256i; 2] {
    let pixels = in_order(pixels);
    let zero = _mm256_setzero_si256();
    [_mm256_unpacklo_epi8(zero, pixels), _mm256_unpackhi_epi8(zero, pixels)].map(|level| {
        let half = _mm256_min_epu16(high_product(level, exposure_q15), _mm256_set1_epi16(i16::MAX));
        _mm256_slli_epi16::<1>(half)
    })
}

/// The absolute differences of levels.
#[target_feature(enable = "avx2")]
#[inline]
pub(super) fn difference(a: __m256i, b: __m256i) -> __m256i {
    _mm256_or_si256(_mm256_subs_epu16(a, b), _mm256_subs_epu16(b, a))
}

/// The upper 16 bits of products. The intrinsic is arithmetic to the compiler, which widens what is the same in all rounds of a
/// loop before the loop and then multiplies in four times as many instructions.
#[target_feature(enable = "avx2")]
#[inline]
fn high_product(a: __m256i, b: __m256i) -> __m256i {
    let product;
    // SAFETY: the processor has the instruction, which touches nothing but these registers.
    unsafe {
        std::arch::asm!("vpmulhuw {}, {}, {}", out(ymm_reg) product, in(ymm_reg) a, in(ymm_reg) b,
            options(pure, nomem, nostack, preserves_flags));
    }
    product
}

/// Exchanges the middle quarters: packing and unpacking work in halves.
#[target_feature(enable = "avx2")]
#[inline]
pub(super) fn in_order(bytes: __m256i) -> __m256i {
    _mm256_permute4x64_epi64::<0b11_01_10_00>(bytes)
}
