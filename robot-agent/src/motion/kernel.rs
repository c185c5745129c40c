//! The loops over pixels: plain functions over slices whose lengths the caller has made equal. Written so that the
//! compiler vectorises them: no branches on data, no allocation, one element of each slice a step.
//!
//! `wide!` compiles each of them three times from one source, for any processor and for x86-64 with AVX2 and with AVX-512, and
//! takes the last that the processor has. All are the same integer arithmetic, so the plain one is the oracle of the others.

use std::sync::OnceLock;

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod learn;
mod mark;
mod median;
#[cfg(target_arch = "x86_64")]
mod middle;
mod most;
#[cfg(target_arch = "x86_64")]
mod narrow;
#[cfg(target_arch = "x86_64")]
mod narrow_avx2;
mod planes;
mod products;
mod runs;
mod squares;

pub use learn::{Counting, KEEP, LEARN, LEARN_SLOWLY, Looks, count_looks, learn};
pub use mark::{Compared, INDOOR_NOISE_MAX, Layers, Marked, NOISE_MAX, known_look, mark_changes};
pub use median::median;
pub use most::{ALIKE, MOST_FRAMES, more_often_seen};
pub use planes::{Counts, Needs, PLANES, ROWS, majority, pitch};
pub use products::{Fours, products_by_fours};
pub(crate) use runs::{
    BLOCK as RUN_BLOCK, add_to_cells, add_to_columns, add_to_rows, count_differences, count_not_darker, fill_runs,
};
pub(crate) use squares::{spread_by_one, spread_over_rows};

/// Compiles a function for any processor, for AVX2 and for AVX-512, and calls the best that this one has.
macro_rules! wide {
    ($(#[$meta:meta])* $vis:vis fn $name:ident($($argument:ident: $kind:ty),* $(,)?) $(-> $result:ty)? $body:block) => {
        $(#[$meta])*
        $vis fn $name($($argument: $kind),*) $(-> $result)? {
            #[inline(always)]
            #[allow(clippy::too_many_arguments)]
            fn plain($($argument: $kind),*) $(-> $result)? $body
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
                #[allow(clippy::too_many_arguments)]
                fn avx2($($argument: $kind),*) $(-> $result)? {
                    plain($($argument),*)
                }
                #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx512vbmi,avx2,bmi1,bmi2,lzcnt,popcnt")]
                #[allow(clippy::too_many_arguments)]
                fn avx512($($argument: $kind),*) $(-> $result)? {
                    plain($($argument),*)
                }
                match $crate::motion::kernel::available() {
                    // SAFETY: the processor has these instructions.
                    $crate::motion::kernel::Level::Avx512 => return unsafe { avx512($($argument),*) },
                    // SAFETY: the processor has these instructions.
                    $crate::motion::kernel::Level::Avx2 => return unsafe { avx2($($argument),*) },
                    $crate::motion::kernel::Level::Portable => {}
                }
            }
            plain($($argument),*)
        }
    };
}
pub(crate) use wide;

/// Instructions that the loops are compiled for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Level {
    /// Any processor.
    Portable,
    /// x86-64 with AVX2.
    Avx2,
    /// x86-64 with AVX-512 on bytes.
    Avx512,
}

/// The best that this processor has, found once. In tests [`at_most`] limits it.
#[inline(always)]
pub(crate) fn available() -> Level {
    static FOUND: OnceLock<Level> = OnceLock::new();
    let found = *FOUND.get_or_init(detect);
    #[cfg(test)]
    let found = found.min(MOST.with(std::cell::Cell::get));
    found
}

#[cold]
fn detect() -> Level {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::is_x86_feature_detected as has;
        if has!("avx2") && has!("bmi1") && has!("bmi2") && has!("lzcnt") && has!("popcnt") {
            let wider = has!("avx512f") && has!("avx512bw") && has!("avx512dq") && has!("avx512vl");
            return if wider && has!("avx512vbmi") { Level::Avx512 } else { Level::Avx2 };
        }
    }
    Level::Portable
}

/// Which instructions the loops run on here: "avx512", "avx2" or "portable".
pub fn level() -> &'static str {
    match available() {
        Level::Avx512 => "avx512",
        Level::Avx2 => "avx2",
        Level::Portable => "portable",
    }
}

/// Bytes of a line of the cache.
const LINE: usize = 64;

/// Fetches values into the first-level cache: for what will be needed soon, and does not lie in one piece. Of values that begin within
/// a line the last line may be left out.
#[inline(always)]
pub(crate) fn fetch<T>(values: &[T]) {
    #[cfg(target_arch = "x86_64")]
    fetch_lines::<{ std::arch::x86_64::_MM_HINT_T0 }>(values.as_ptr().cast(), size_of_val(values));
    #[cfg(not(target_arch = "x86_64"))]
    let _ = values;
}

/// Fetches all of values that lie in main memory into the second-level cache: more lines can be under way to it at once, and those
/// that are too many for the first level are dropped.
#[inline(always)]
pub(crate) fn fetch_far<T>(values: &[T]) {
    #[cfg(target_arch = "x86_64")]
    {
        let (first, before) = (values.as_ptr().cast::<i8>(), values.as_ptr().addr() % LINE);
        fetch_lines::<{ std::arch::x86_64::_MM_HINT_T1 }>(first.wrapping_sub(before), before + size_of_val(values));
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = values;
}

/// The same of lines that begin at some places; of values that do not begin with a line a part of some may be left out.
#[inline(always)]
pub(crate) fn fetch_far_lines(values: &[u8], lines: &[u32]) {
    #[cfg(target_arch = "x86_64")]
    for line in lines {
        use std::arch::x86_64::{_MM_HINT_T1, _mm_prefetch};
        // SAFETY: a hint; nothing is read.
        unsafe { _mm_prefetch::<_MM_HINT_T1>(values.as_ptr().cast::<i8>().wrapping_add(*line as usize)) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (values, lines);
}

/// Where the lines of the cache begin, in order, that pieces of so many bytes, at most a line's, lie on.
pub(crate) fn lines_of(starts: impl Iterator<Item = u32>, bytes: u32) -> impl Iterator<Item = u32> {
    let line = LINE as u32;
    let lines: std::collections::BTreeSet<u32> =
        starts.flat_map(|start| [start, start + bytes - 1]).map(|at| at / line).collect();
    lines.into_iter().map(move |at| at * line)
}

#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn fetch_lines<const HINT: i32>(first: *const i8, bytes: usize) {
    for line in (0..bytes).step_by(LINE) {
        // SAFETY: a hint; nothing is read.
        unsafe { std::arch::x86_64::_mm_prefetch::<HINT>(first.wrapping_add(line)) };
    }
}

/// A grey level in 8.8 fixed point times a factor (32768 is 1), saturating. Exact for a factor of 1.
#[inline(always)]
fn expose(level: u8, exposure_q15: u16) -> u16 {
    let half = ((u32::from(u16::from(level) << 8) * u32::from(exposure_q15)) >> 16) as u16;
    half.min(32767) << 1
}

/// How near a level must be to be the same look: 3.2 σ, at least four grey levels.
#[inline(always)]
fn tolerance(noise: u16) -> u16 {
    (noise * 4).max(1024)
}

/// Bit i is the highest bit of byte i.
#[inline(always)]
pub(super) fn bits_of(block: &[u8; 64]) -> u64 {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_mm_loadu_si128, _mm_movemask_epi8};
        let mut bits = 0;
        for (i, bytes) in block.as_chunks::<16>().0.iter().enumerate() {
            // SAFETY: every x86-64 processor has these instructions; 16 bytes are read of 16.
            let sixteen = unsafe { _mm_movemask_epi8(_mm_loadu_si128(bytes.as_ptr().cast())) };
            bits |= u64::from(sixteen as u16) << (16 * i);
        }
        bits
    }
    #[cfg(not(target_arch = "x86_64"))]
    {
        // Multiplied, the eight bits of a word meet in its highest byte.
        const GATHER: u64 = 0x0102_0408_1020_4080;
        const LOWEST: u64 = 0x0101_0101_0101_0101;
        block.as_chunks::<8>().0.iter().enumerate().fold(0, |bits, (i, bytes)| {
            let ones = u64::from_le_bytes(*bytes) >> 7 & LOWEST;
            bits | (ones.wrapping_mul(GATHER) >> 56) << (8 * i)
        })
    }
}

/// The first values of a slice, as many as a block has, and zeros.
#[inline(always)]
pub(super) fn padded<T: Copy + Default>(values: &[T]) -> [T; 64] {
    if let Some(whole) = values.first_chunk() {
        return *whole;
    }
    let mut block = [T::default(); 64];
    block[..values.len()].copy_from_slice(values);
    block
}

wide! {
/// `most[i]` = the larger of both.
pub fn raise(values: &[u8], most: &mut [u8]) {
    for (m, &v) in most.iter_mut().zip(values) {
        *m = (*m).max(v);
    }
}
}

wide! {
/// A share (of 256) of the largest of each value and its two neighbours; the first and the last are neighbours on a ring. At least
/// two values.
pub fn thresholds(values: &[u8], wraps: bool, share_q8: u8, out: &mut [u8]) {
    let n = values.len();
    let share = |most: u8| ((u16::from(most) * u16::from(share_q8)) >> 8) as u8;
    let (left, middle, right) = (&values[..n - 2], &values[1..n - 1], &values[2..]);
    for (((o, l), m), r) in out[1..n - 1].iter_mut().zip(left).zip(middle).zip(right) {
        *o = share((*l).max(*m).max(*r));
    }
    let over_seam = if wraps { values[0].max(values[n - 1]) } else { 0 };
    out[0] = share(values[0].max(values[1]).max(over_seam));
    out[n - 1] = share(values[n - 1].max(values[n - 2]).max(over_seam));
}
}

wide! {
/// The largest of each eight values, of a length that eight divides.
pub fn largest_of_eights(values: &[u8], out: &mut [u8]) {
    let level = available();
    let (blocks, rest) = values.as_chunks::<64>();
    let (whole, last) = out.split_at_mut((8 * blocks.len()).min(out.len()));
    for (block, out) in blocks.iter().zip(whole.as_chunks_mut::<8>().0) {
        #[cfg(target_arch = "x86_64")]
        if level >= Level::Avx2 {
            // SAFETY: the processor has these instructions.
            *out = unsafe { largest_of_eights_avx2(block) };
            continue;
        }
        #[cfg(not(target_arch = "x86_64"))]
        let _ = level;
        // Most of a picture is not worked.
        if block.iter().fold(0, |any, value| any | value) == 0 {
            *out = [0; 8];
            continue;
        }
        // Each value becomes the largest of itself and the next 1, then 3, then 7 of its eight.
        let mut eights: [u64; 8] = std::array::from_fn(|k| u64::from_le_bytes(std::array::from_fn(|i| block[8 * k + i])));
        for shift in [8, 16, 32] {
            for eight in &mut eights {
                let (a, b) = (eight.to_le_bytes(), (*eight >> shift).to_le_bytes());
                *eight = u64::from_le_bytes(std::array::from_fn(|i| a[i].max(b[i])));
            }
        }
        *out = eights.map(|eight| eight as u8);
    }
    for (o, v) in last.iter_mut().zip(rest.as_chunks::<8>().0) {
        *o = v.iter().fold(0, |most, v| most.max(*v));
    }
}
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
#[inline]
fn largest_of_eights_avx2(block: &[u8; 64]) -> [u8; 8] {
    use std::arch::x86_64::*;
    let lowest = _mm256_set1_epi64x(0xff);
    let halves: [__m256i; 2] = std::array::from_fn(|half| {
        let values = avx2::load_bytes(&block.as_chunks::<32>().0[half]);
        let most = _mm256_max_epu8(values, _mm256_srli_epi64::<8>(values));
        let most = _mm256_max_epu8(most, _mm256_srli_epi64::<16>(most));
        _mm256_and_si256(_mm256_max_epu8(most, _mm256_srli_epi64::<32>(most)), lowest)
    });
    // Each packing takes half of the zeros away.
    let twos = avx2::in_order(_mm256_packus_epi32(halves[0], halves[1]));
    let fours = _mm_packus_epi32(_mm256_castsi256_si128(twos), _mm256_extracti128_si256::<1>(twos));
    (_mm_cvtsi128_si64(_mm_packus_epi16(fours, fours)) as u64).to_le_bytes()
}

wide! {
/// Takes away marks of rows of at most 64 pixels, `width` pixels and `stride` words apart, where `values` is below the column's
/// `least`: as many columns as there are of these, `rows` rows.
pub fn keep_at_least(values: &[u8], width: usize, rows: usize, least: &[u8], words: &mut [u64], stride: usize) {
    let level = available();
    let whole = least.first_chunk();
    let padded_least = padded(least);
    for (values, word) in values.chunks(width).zip(words.iter_mut().step_by(stride)).take(rows) {
        if *word != 0 {
            *word &= match (values.first_chunk(), whole) {
                (Some(values), Some(least)) => block_at_least(level, values, least),
                _ => block_at_least(level, &padded(&values[..least.len().min(values.len())]), &padded_least),
            };
        }
    }
}
}

#[inline(always)]
fn block_at_least(level: Level, values: &[u8; 64], least: &[u8; 64]) -> u64 {
    #[cfg(target_arch = "x86_64")]
    match level {
        // SAFETY: the processor has these instructions.
        Level::Avx512 => return unsafe { block_at_least_avx512(values, least) },
        // SAFETY: as above.
        Level::Avx2 => return unsafe { block_at_least_avx2(values, least) },
        Level::Portable => {}
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = level;
    let mut large = [0u8; 64];
    for i in 0..64 {
        large[i] = if values[i] >= least[i] { u8::MAX } else { 0 };
    }
    bits_of(&large)
}

/// The same; a comparison's bits are its result here.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512bw")]
#[inline]
fn block_at_least_avx512(values: &[u8; 64], least: &[u8; 64]) -> u64 {
    use std::arch::x86_64::_mm512_cmpge_epu8_mask;
    _mm512_cmpge_epu8_mask(avx512::load_block(values), avx512::load_block(least))
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
#[inline]
fn block_at_least_avx2(values: &[u8; 64], least: &[u8; 64]) -> u64 {
    use std::arch::x86_64::{_mm256_cmpeq_epi8, _mm256_max_epu8, _mm256_movemask_epi8};
    let halves = values.as_chunks::<32>().0.iter().zip(least.as_chunks::<32>().0);
    halves.rev().fold(0, |bits, (values, least)| {
        let values = avx2::load_bytes(values);
        let large = _mm256_cmpeq_epi8(_mm256_max_epu8(values, avx2::load_bytes(least)), values);
        bits << 32 | u64::from(_mm256_movemask_epi8(large) as u32)
    })
}

/// Columns of a step in [`compare_steps`].
pub const STEP: usize = 3;

wide! {
/// Sums over the pixels of a run (at most 2¹⁵) but the last [`STEP`] ones: by how much the picture's step to the pixel [`STEP`] columns on differs from the
/// background's, and the noise; all in 8.8 fixed point.
pub fn compare_steps(picture: &[u8], background: &[u16], noise: &[u16]) -> (u32, u32) {
    let n = picture.len().saturating_sub(STEP);
    let (now, then) = (&picture[..n], &picture[picture.len() - n..]);
    let (here, there) = (&background[..n], &background[background.len() - n..]);
    let noise = &noise[..n];
    let (mut steps, mut deviations) = (0u32, 0u32);
    for i in 0..n {
        let step = (i32::from(then[i]) - i32::from(now[i])) << 8;
        let before = i32::from(there[i]) - i32::from(here[i]);
        steps = steps.wrapping_add(step.abs_diff(before));
        deviations = deviations.wrapping_add(u32::from(noise[i]));
    }
    (steps, deviations)
}
}

wide! {
/// Which of `bins` for each 1 of the ratio picture / background (8.8 fixed point) a pixel falls into, at most the last of two times
/// `bins`; `u16::MAX` where there is no ratio: not valid, saturated, or a background below `least`.
pub fn ratio_bins(picture: &[u8], background: &[u16], valid: &[u8], least: u16, bins: u16, out: &mut [u16]) {
    let n = out.len();
    let (picture, background, valid) = (&picture[..n], &background[..n], &valid[..n]);
    for i in 0..n {
        let ratio = f32::from(picture[i]) / f32::from(background[i].max(1)) * (256.0 * f32::from(bins));
        let usable = (valid[i] != 0) & (background[i] >= least) & (picture[i] < 250);
        // SAFETY: finite, from 0 to below 2¹⁷; a cast that asks for that is not vectorised.
        let bin = unsafe { ratio.min(f32::from(2 * bins - 1)).to_int_unchecked::<i32>() } as u16;
        out[i] = if usable { bin } else { u16::MAX };
    }
}
}

wide! {
/// Of at most 255 pixels that are valid: how many there are, how many are black, how many saturated.
pub fn count_extremes(picture: &[u8], valid: &[u8]) -> [usize; 3] {
    let (mut n, mut dark, mut bright) = (0u8, 0u8, 0u8);
    for (&p, &v) in picture.iter().zip(valid) {
        let v = v.min(1);
        n = n.wrapping_add(v);
        dark = dark.wrapping_add(v & u8::from(p <= 2));
        bright = bright.wrapping_add(v & u8::from(p >= 253));
    }
    [n, dark, bright].map(usize::from)
}
}

wide! {
/// Rounds 8.8 fixed point to grey levels.
pub fn round_levels(level: &[u16], out: &mut [u8]) {
    for (o, &b) in out.iter_mut().zip(level) {
        *o = (b.saturating_add(128) >> 8) as u8;
    }
}
}

#[cfg(test)]
thread_local! {
    static MOST: std::cell::Cell<Level> = const { std::cell::Cell::new(Level::Avx512) };
}

/// Runs something on this thread with instructions of a level or below.
#[cfg(test)]
pub(crate) fn at_most<T>(level: Level, run: impl FnOnce() -> T) -> T {
    MOST.with(|m| m.set(level));
    let result = run();
    MOST.with(|m| m.set(Level::Avx512));
    result
}

#[cfg(test)]
mod tests;
