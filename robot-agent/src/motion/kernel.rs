//! The loops over pixels: plain functions over slices whose lengths the caller has made equal. Written so that the
//! compiler vectorises them: no branches on data, no allocation, one element of each slice a step.
//!
//! `wide!` compiles each of them twice from one source, for any processor and for x86-64 with AVX2, and takes the second where the
//! processor has it. Both are the same integer arithmetic, so the plain one is the oracle of the other.

mod learn;
mod mark;
mod median;

pub use learn::{KEEP, LEARN, LEARN_SLOWLY, Looks, count_looks, learn};
pub use mark::{INDOOR_NOISE_MAX, Layers, NOISE_MAX, count_differences, forgive_known, keep_valid, mark_changes};
pub use median::median;

/// Compiles a function for any processor and for AVX2, and calls the best that this one has.
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
                if $crate::motion::kernel::has_avx2() {
                    // SAFETY: the processor has these instructions.
                    return unsafe { avx2($($argument),*) };
                }
            }
            plain($($argument),*)
        }
    };
}
pub(crate) use wide;

/// Whether the vectorised forms run here. In tests [`portable`] turns them off.
#[cfg(target_arch = "x86_64")]
#[inline]
pub(crate) fn has_avx2() -> bool {
    #[cfg(test)]
    if PORTABLE.with(std::cell::Cell::get) {
        return false;
    }
    std::arch::is_x86_feature_detected!("avx2")
        && std::arch::is_x86_feature_detected!("bmi2")
        && std::arch::is_x86_feature_detected!("lzcnt")
        && std::arch::is_x86_feature_detected!("popcnt")
}

/// Which instructions the loops run on here: "avx2" or "portable".
pub fn level() -> &'static str {
    #[cfg(target_arch = "x86_64")]
    if has_avx2() {
        return "avx2";
    }
    "portable"
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

/// Bit i is byte i of a block of zeros and ones.
#[inline(always)]
pub(super) fn bits_of(block: &[u8; 64]) -> u64 {
    // Multiplied, the eight ones of a word meet in its highest byte.
    const GATHER: u64 = 0x0102_0408_1020_4080;
    block
        .as_chunks::<8>()
        .0
        .iter()
        .enumerate()
        .fold(0, |bits, (i, bytes)| bits | (u64::from_le_bytes(*bytes).wrapping_mul(GATHER) >> 56) << (8 * i))
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
/// The largest of each eight values, of a length that eight divides. `values` are lost.
pub fn largest_of_eights(values: &mut [u8], out: &mut [u8]) {
    // Each value becomes the largest of itself and the next 1, then 3, then 7.
    for step in [1, 2, 4] {
        let n = values.len().saturating_sub(step);
        for i in 0..n {
            values[i] = values[i].max(values[i + step]);
        }
    }
    for (o, v) in out.iter_mut().zip(values.as_chunks::<8>().0) {
        *o = v[0];
    }
}
}

wide! {
/// Takes away marks where `values` is below `least`.
pub fn keep_at_least(values: &[u8], least: &[u8], marks: &mut [u8]) {
    for ((m, &v), &l) in marks.iter_mut().zip(values).zip(least) {
        *m &= u8::from(v >= l);
    }
}
}

wide! {
/// `sums += values`, for as few rows that nothing overflows.
pub fn add_row(values: &[u8], sums: &mut [u8]) {
    for (s, &v) in sums.iter_mut().zip(values) {
        *s = s.wrapping_add(v);
    }
}
}

wide! {
/// One row of sums down the columns: `sums += enter − leave`.
pub fn slide_column_sums(enter: &[u8], leave: &[u8], sums: &mut [u8]) {
    let n = sums.len();
    let (enter, leave) = (&enter[..n], &leave[..n]);
    for i in 0..n {
        sums[i] = sums[i].wrapping_add(enter[i]).wrapping_sub(leave[i]);
    }
}
}

wide! {
/// `out[i]` = 1 where the sum of `padded[i ..= i + 2·reach]` is at least `need[i]`; `padded` has `2·reach` more elements.
pub fn threshold_row_sums(padded: &[u8], reach: usize, need: &[u8], out: &mut [u8]) {
    let n = out.len();
    let need = &need[..n];
    if reach == 2 {
        let p = &padded[..n + 4];
        for i in 0..n {
            let sum = p[i].wrapping_add(p[i + 1]).wrapping_add(p[i + 2]).wrapping_add(p[i + 3]).wrapping_add(p[i + 4]);
            out[i] = u8::from(sum >= need[i]);
        }
    } else {
        for i in 0..n {
            let sum = padded[i..=i + 2 * reach].iter().fold(0u8, |s, &p| s.wrapping_add(p));
            out[i] = u8::from(sum >= need[i]);
        }
    }
}
}

wide! {
/// The same with one `need` for the whole row.
pub fn threshold_row_sums_alike(padded: &[u8], reach: usize, need: u8, out: &mut [u8]) {
    let n = out.len();
    if reach == 2 {
        let p = &padded[..n + 4];
        for i in 0..n {
            let sum = p[i].wrapping_add(p[i + 1]).wrapping_add(p[i + 2]).wrapping_add(p[i + 3]).wrapping_add(p[i + 4]);
            out[i] = u8::from(sum >= need);
        }
    } else {
        for i in 0..n {
            let sum = padded[i..=i + 2 * reach].iter().fold(0u8, |s, &p| s.wrapping_add(p));
            out[i] = u8::from(sum >= need);
        }
    }
}
}

wide! {
/// Adds to the sums of each column where `marks` is 1: picture², picture · background, background² in (1/8 grey level)², and
/// noise². Background and noise are 8.8 fixed point.
pub fn add_products(marks: &[u8], picture: &[u8], background: &[u16], noise: &[u16], sums: [&mut [u32]; 4]) {
    let n = marks.len();
    let (picture, background, noise) = (&picture[..n], &background[..n], &noise[..n]);
    let [cc, cb, bb, nn] = sums.map(|s| &mut s[..n]);
    for i in 0..n {
        let m = u32::from(marks[i]);
        let (c, b, s) = (m * (u32::from(picture[i]) << 3), m * u32::from(background[i] >> 5), m * u32::from(noise[i]));
        cc[i] += c * c;
        cb[i] += c * b;
        bb[i] += b * b;
        nn[i] += s * s;
    }
}
}

wide! {
/// Number of ones.
pub fn count_ones(marks: &[u8]) -> usize {
    let mut total = 0;
    // Sixty-four counters beside each other, emptied before they overflow.
    for chunk in marks.chunks(64 * 255) {
        let mut counters = [0u8; 64];
        let (blocks, rest) = chunk.as_chunks::<64>();
        for block in blocks {
            for (n, m) in counters.iter_mut().zip(block) {
                *n = n.wrapping_add(*m);
            }
        }
        total += counters.iter().chain(rest).map(|n| usize::from(*n)).sum::<usize>();
    }
    total
}
}

wide! {
/// The sums of each four values, of a length that four divides. `values` are lost; no sum may overflow.
pub fn sums_of_fours(values: &mut [u8], out: &mut [u8]) {
    for step in [1, 2] {
        let n = values.len().saturating_sub(step);
        for i in 0..n {
            values[i] = values[i].wrapping_add(values[i + step]);
        }
    }
    for (o, v) in out.iter_mut().zip(values.as_chunks::<4>().0) {
        *o = v[0];
    }
}
}

wide! {
/// Pixels of which the background is darkened, by less than half.
pub fn count_darker(picture: &[u8], background: &[u16]) -> usize {
    let darker = |p: u8, b: u16| {
        let half = u16::from(p) << 7;
        u16::from((half < b >> 1) & (half > b >> 2))
    };
    picture.iter().zip(background).fold(0u16, |n, (&p, &b)| n.wrapping_add(darker(p, b))).into()
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
    static PORTABLE: std::cell::Cell<bool> = const { std::cell::Cell::new(false) };
}

/// Runs something on this thread without vector instructions.
#[cfg(test)]
pub(crate) fn portable<T>(run: impl FnOnce() -> T) -> T {
    PORTABLE.with(|p| p.set(true));
    let result = run();
    PORTABLE.with(|p| p.set(false));
    result
}

#[cfg(test)]
mod tests;
