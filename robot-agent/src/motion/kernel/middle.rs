//! The middle of up to 32 pictures' pixels with all of a stack in registers: what is loaded once is compared there, where a loop over
//! a list of comparators loads and stores each value at every comparison.

use std::arch::x86_64::*;

use super::median::{Batcher, keep_needed};

/// Values that are sorted. Fewer are made as many by zeros and 255s, which leave the middle where it is.
pub(super) const VALUES: usize = 32;
/// Comparators of Batcher's network for so many, and those on which the middle two depend.
const SORTING: usize = 191;
const COMPARATORS: usize = 157;
const NETWORK: [(u16, u16); COMPARATORS] = network();

/// Those comparators, as for any number in [`super::median`].
const fn network() -> [(u16, u16); COMPARATORS] {
    let mut batcher = Batcher::new(VALUES);
    let mut sorting = [(0, 0); SORTING];
    let mut len = 0;
    while let Some(comparator) = batcher.next() {
        sorting[len] = comparator;
        len += 1;
    }
    let first = keep_needed(&mut sorting, &mut [false; VALUES]);
    let mut network = [(0, 0); COMPARATORS];
    network.copy_from_slice(sorting.split_at(first).1);
    network
}

/// A register of bytes.
///
/// # Safety
/// The processor must have its instructions; pointers must be good for [`Self::BYTES`], and need not be aligned.
trait Register: Copy {
    const BYTES: usize;
    unsafe fn all(value: u8) -> Self;
    unsafe fn load(from: *const u8) -> Self;
    unsafe fn store(self, to: *mut u8);
    unsafe fn min(self, other: Self) -> Self;
    unsafe fn max(self, other: Self) -> Self;
    /// (a + b + 1) >> 1.
    unsafe fn mean(self, other: Self) -> Self;
}

// SAFETY, of each block here: the caller's.
macro_rules! register {
    ($register:ty, $bytes:literal, $all:ident, $load:ident, $store:ident, $min:ident, $max:ident, $mean:ident) => {
        impl Register for $register {
            const BYTES: usize = $bytes;
            #[inline(always)]
            unsafe fn all(value: u8) -> Self {
                unsafe { $all(value as i8) }
            }
            #[inline(always)]
            unsafe fn load(from: *const u8) -> Self {
                unsafe { $load(from.cast()) }
            }
            #[inline(always)]
            unsafe fn store(self, to: *mut u8) {
                unsafe { $store(to.cast(), self) }
            }
            #[inline(always)]
            unsafe fn min(self, other: Self) -> Self {
                unsafe { $min(self, other) }
            }
            #[inline(always)]
            unsafe fn max(self, other: Self) -> Self {
                unsafe { $max(self, other) }
            }
            #[inline(always)]
            unsafe fn mean(self, other: Self) -> Self {
                unsafe { $mean(self, other) }
            }
        }
    };
}
register!(
    __m512i,
    64,
    _mm512_set1_epi8,
    _mm512_loadu_si512,
    _mm512_storeu_si512,
    _mm512_min_epu8,
    _mm512_max_epu8,
    _mm512_avg_epu8
);
register!(
    __m256i,
    32,
    _mm256_set1_epi8,
    _mm256_loadu_si256,
    _mm256_storeu_si256,
    _mm256_min_epu8,
    _mm256_max_epu8,
    _mm256_avg_epu8
);

/// See [`of_stack`].
#[target_feature(enable = "avx512f,avx512bw")]
pub(super) fn of_stack_avx512(frames: &[&[u8]], out: &mut [u8]) -> bool {
    // SAFETY: the processor has these instructions.
    unsafe { of_stack::<__m512i>(frames, out) }
}

/// See [`of_stack`].
#[target_feature(enable = "avx2")]
pub(super) fn of_stack_avx2(frames: &[&[u8]], out: &mut [u8]) -> bool {
    // SAFETY: the processor has these instructions.
    unsafe { of_stack::<__m256i>(frames, out) }
}

/// Medians of at most [`VALUES`] pictures, each at least as long as `out`; `false` and nothing done where `out` is shorter than a register.
///
/// # Safety
/// The processor must have the register's instructions.
#[inline(always)]
unsafe fn of_stack<R: Register>(frames: &[&[u8]], out: &mut [u8]) -> bool {
    let (n, len) = (frames.len(), out.len());
    assert!((1..=VALUES).contains(&n) && frames.iter().all(|frame| frame.len() >= len));
    let Some(last) = len.checked_sub(R::BYTES) else { return false };
    // As many below the middle as above it; of an odd number the lower of the middle two is the middle.
    let ones = n + (VALUES - n) / 2;
    let upper = if n % 2 == 0 { VALUES / 2 } else { VALUES / 2 - 1 };
    let mut at = 0;
    loop {
        // SAFETY: `at + R::BYTES` is at most `len`, which every frame has.
        unsafe {
            let mut values = [R::all(0); VALUES];
            for (value, frame) in values.iter_mut().zip(frames) {
                *value = R::load(frame.as_ptr().add(at));
            }
            for value in &mut values[ones..] {
                *value = R::all(255);
            }
            compare_all(&mut values);
            values[VALUES / 2 - 1].mean(values[upper]).store(out.as_mut_ptr().add(at));
        }
        if at == last {
            return true;
        }
        // The last ones begin sooner.
        at = (at + R::BYTES).min(last);
    }
}

/// # Safety
/// The processor must have the register's instructions.
#[inline(always)]
unsafe fn compare<const K: usize, R: Register>(values: &mut [R; VALUES]) {
    let (low, high) = const { (NETWORK[K].0 as usize, NETWORK[K].1 as usize) };
    let (a, b) = (values[low], values[high]);
    // SAFETY: the caller's.
    (values[low], values[high]) = unsafe { (a.min(b), a.max(b)) };
}

/// One comparator after the other, in so many words: only so each has its registers.
///
/// # Safety
/// The processor must have the register's instructions.
#[inline(always)]
unsafe fn compare_all<R: Register>(values: &mut [R; VALUES]) {
    macro_rules! each {
        ($($k:literal)*) => {
            // SAFETY: the caller's.
            unsafe { $(compare::<$k, R>(values);)* }
        };
    }
    each!(
        0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21 22 23 24 25 26 27 28 29 30 31 32 33 34 35 36 37 38 39
        40 41 42 43 44 45 46 47 48 49 50 51 52 53 54 55 56 57 58 59 60 61 62 63 64 65 66 67 68 69 70 71 72 73 74 75 76
        77 78 79 80 81 82 83 84 85 86 87 88 89 90 91 92 93 94 95 96 97 98 99 100 101 102 103 104 105 106 107 108 109
        110 111 112 113 114 115 116 117 118 119 120 121 122 123 124 125 126 127 128 129 130 131 132 133 134 135 136 137
        138 139 140 141 142 143 144 145 146 147 148 149 150 151 152 153 154 155 156
    );
}
