//! Sums for the sector fits, sixteen columns at a time in whole quarters of grey levels, and the match of column profiles over
//! the ring.

use std::ops::Range;

use nalgebra::{Matrix4, Vector4};

use crate::motion::kernel::{Level, available, fetch, wide};
use crate::motion::raster::Raster;

const TERMS: usize = 15;
const W: usize = 0;
const P: usize = 1;
const X: usize = 2;
const Y: usize = 3;
const R: usize = 4;
const PP: usize = 5;
const PX: usize = 6;
const PY: usize = 7;
const PR: usize = 8;
const XX: usize = 9;
const XY: usize = 10;
const XR: usize = 11;
const YY: usize = 12;
const YR: usize = 13;
const RR: usize = 14;
/// What a unit of each whole sum is, grey levels (squared): values are quarters, gradients over two pixels eighths.
const UNITS: [f64; TERMS] = {
    let (v, g) = (1.0 / 4.0, 1.0 / 8.0);
    [1.0, v, g, g, v, v * v, v * g, v * g, v * v, g * g, g * g, g * v, g * g, g * v, v * v]
};

/// Sums over a sector of products of: weight, reference (P), its gradients (X, Y) and the change (R).
#[derive(Debug)]
pub(super) struct Sums([f64; TERMS]);

/// Least squares of one sector.
#[derive(Debug)]
pub(super) struct Fit {
    /// (s, t), columns and rows, of the picture's content against the reference.
    pub(super) shift_px: [f64; 2],
    /// Sigma of s for noise of one grey level in the change.
    pub(super) sigma_per_noise: f64,
    /// Of the change, after the fit, grey levels².
    pub(super) residual_variance: f64,
    /// Absolute mean change in grey levels.
    pub(super) mean_change: f64,
    /// Relative change of contrast.
    pub(super) gain_change: f64,
}

impl Sums {
    /// The fit of a sector; `None` without texture.
    pub(super) fn solve(&self) -> Option<Fit> {
        let s = &self.0;
        let n = s[W];
        if n < 50.0 {
            return None;
        }
        // Unknowns: offset, gain, s, t; the shift enters with minus the gradient.
        #[rustfmt::skip]
        let a = Matrix4::new(
            n,     s[P],  -s[X],  -s[Y],
            s[P],  s[PP], -s[PX], -s[PY],
            -s[X], -s[PX], s[XX],  s[XY],
            -s[Y], -s[PY], s[XY],  s[YY],
        );
        // A little ridge (gradients of 0.2 grey levels a pixel) keeps textureless sectors solvable: their sigma says it.
        let ridge = Matrix4::from_diagonal(&Vector4::new(1e-6 * n, 1e-3 * n, 0.04 * n, 0.04 * n));
        let b = Vector4::new(s[R], s[PR], -s[XR], -s[YR]);
        let inverse = (a + ridge).try_inverse()?;
        let z = inverse * b;
        let residual = s[RR] - 2.0 * z.dot(&b) + z.dot(&(a * z));
        Some(Fit {
            shift_px: [z[2], z[3]],
            sigma_per_noise: inverse[(2, 2)].max(0.0).sqrt(),
            residual_variance: residual.max(0.0) / n,
            mean_change: (s[R] / n).abs(),
            gain_change: z[1],
        })
    }
}

/// Columns that are summed together.
const LANES: usize = 16;
/// Every third row, for neighbours are blurred into each other anyway; of tall pictures so many.
const ROW_STEP: usize = 3;
const ROWS: usize = 54;

/// A grey level in whole quarters.
trait Gray: Copy {
    fn quarters(self) -> i16;

    /// The same of sixteen.
    ///
    /// # Safety
    /// The processor has AVX2.
    #[cfg(target_arch = "x86_64")]
    unsafe fn quarters_avx2(values: &[Self; LANES]) -> std::arch::x86_64::__m256i;
}

impl Gray for u8 {
    #[inline(always)]
    fn quarters(self) -> i16 {
        i16::from(self) << 2
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    #[inline]
    unsafe fn quarters_avx2(values: &[Self; LANES]) -> std::arch::x86_64::__m256i {
        use std::arch::x86_64::*;
        // SAFETY: 16 bytes are read of 16.
        let wide = unsafe { _mm256_cvtepu8_epi16(_mm_loadu_si128(values.as_ptr().cast())) };
        _mm256_slli_epi16::<2>(wide)
    }
}

/// 8.8 fixed point.
impl Gray for u16 {
    #[inline(always)]
    fn quarters(self) -> i16 {
        (self >> 6) as i16
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    #[inline]
    unsafe fn quarters_avx2(values: &[Self; LANES]) -> std::arch::x86_64::__m256i {
        use std::arch::x86_64::*;
        // SAFETY: 32 bytes are read of 32.
        _mm256_srli_epi16::<6>(unsafe { _mm256_loadu_si256(values.as_ptr().cast()) })
    }
}

wide! {
/// The sums of some columns against a picture.
pub(super) fn against_picture(reference: &[u8], picture: &[u8], valid: &[u8], raster: &Raster, columns: Range<usize>) -> Sums {
    sums(reference, picture, valid, raster, columns)
}
}

wide! {
/// The sums of some columns against a background in 8.8 fixed point.
pub(super) fn against_background(reference: &[u16], picture: &[u8], valid: &[u8], raster: &Raster, columns: Range<usize>) -> Sums {
    sums(reference, picture, valid, raster, columns)
}
}

/// Sums in pairs of lanes: two columns of at most 72 rows of products below 2²⁰.
type Lanes = [[i32; LANES / 2]; TERMS];
type Columns = [i16; LANES];

#[inline(always)]
fn sums<T: Gray>(reference: &[T], picture: &[u8], valid: &[u8], raster: &Raster, columns: Range<usize>) -> Sums {
    let Raster { width, height, wraps } = *raster;
    let row_step = (height / ROWS).max(ROW_STEP);
    let mut total = [0i64; TERMS];
    let level = available();
    for x0 in columns.clone().step_by(LANES) {
        // The column of each lane and its neighbours; columns beyond the sector or without a gradient have no weight.
        let at: [usize; LANES + 2] = std::array::from_fn(|i| {
            let x = x0 + i + width - 1;
            if wraps { x % width } else { x.saturating_sub(width).min(width - 1) }
        });
        let inside: Columns = std::array::from_fn(|l| {
            let x = x0 + l;
            -i16::from(x < columns.end && (wraps || (x > 0 && x + 1 < width)))
        });
        let plain = x0 > 0 && x0 + LANES < width;
        let mut lanes = [[0; LANES / 2]; TERMS];
        for y in (1..height.saturating_sub(1)).step_by(row_step) {
            let i = y * width;
            let ahead = i + 2 * row_step * width + x0;
            for near in [ahead - width, ahead, ahead + width] {
                fetch(reference.get(near..near + LANES).unwrap_or_default());
            }
            fetch(picture.get(ahead..ahead + LANES).unwrap_or_default());
            fetch(valid.get(ahead..ahead + LANES).unwrap_or_default());
            #[cfg(target_arch = "x86_64")]
            if plain && level >= Level::Avx2 {
                // SAFETY: the processor has these instructions.
                unsafe { add_plain_avx2(reference, picture, valid, width, i + x0, &inside, &mut lanes) };
                continue;
            }
            let (around, now, mut tested) = if plain {
                let Some((around, [now, tested])) = plain_pixels(reference, picture, valid, width, i + x0) else {
                    continue;
                };
                (around.map(quarters), quarters(now), quarters(tested))
            } else {
                let row = &reference[i..i + width];
                let around = [
                    columns_of(row, 1, &at),
                    columns_of(row, 0, &at),
                    columns_of(row, 2, &at),
                    columns_of(&reference[i - width..i], 1, &at),
                    columns_of(&reference[i + width..i + 2 * width], 1, &at),
                ];
                let [now, tested] = [picture, valid].map(|values| columns_of(&values[i..i + width], 1, &at));
                (around, now, tested)
            };
            for (tested, inside) in tested.iter_mut().zip(inside) {
                *tested = if *tested != 0 { inside } else { 0 };
            }
            add_products(level, &around, &now, &tested, &mut lanes);
        }
        for (t, row) in total.iter_mut().zip(&lanes) {
            *t += row.iter().map(|&v| i64::from(v)).sum::<i64>();
        }
    }
    Sums(std::array::from_fn(|t| total[t] as f64 * UNITS[t]))
}

/// Adds the products of sixteen pixels: `around` is the reference there, left, right, above and below; `tested` is −1 or 0.
#[inline(always)]
fn add_products(level: Level, around: &[Columns; 5], now: &Columns, tested: &Columns, lanes: &mut Lanes) {
    #[cfg(target_arch = "x86_64")]
    if level >= Level::Avx2 {
        // SAFETY: the processor has these instructions.
        return unsafe { add_products_avx2(around, now, tested, lanes) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = level;
    let [row, left, right, above, below] = around;
    for l in 0..LANES {
        let w = tested[l];
        let [p, x, y, r] =
            [row[l] - 512, right[l] - left[l], below[l] - above[l], now[l] - row[l]].map(|v| i32::from(v & w));
        let terms = [i32::from(-w), p, x, y, r, p * p, p * x, p * y, p * r, x * x, x * y, x * r, y * y, y * r, r * r];
        for (sums, term) in lanes.iter_mut().zip(terms) {
            sums[l / 2] += term;
        }
    }
}

/// The same.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
#[inline]
fn add_products_avx2(around: &[Columns; 5], now: &Columns, tested: &Columns, lanes: &mut Lanes) {
    use std::arch::x86_64::*;
    // SAFETY: 32 bytes are read of 32; the pointers need not be aligned.
    let load = |columns: &Columns| unsafe { _mm256_loadu_si256(columns.as_ptr().cast()) };
    let around = [0, 1, 2, 3, 4].map(|i: usize| load(&around[i]));
    add_terms_avx2(around, load(now), load(tested), lanes);
}

/// The products of sixteen pixels from place `at` on that are at no row's end, read into registers at once: written to memory in
/// pieces first, they would have to be waited for.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
#[inline]
fn add_plain_avx2<T: Gray>(
    reference: &[T],
    picture: &[u8],
    valid: &[u8],
    width: usize,
    at: usize,
    inside: &Columns,
    lanes: &mut Lanes,
) {
    use std::arch::x86_64::*;
    let Some((around, bytes)) = plain_pixels(reference, picture, valid, width, at) else { return };
    // SAFETY: the processor has these instructions.
    let around = around.map(|values| unsafe { T::quarters_avx2(values) });
    // SAFETY: the same.
    let [now, tested] = bytes.map(|values| unsafe { u8::quarters_avx2(values) });
    // SAFETY: 32 bytes are read of 32.
    let inside = unsafe { _mm256_loadu_si256(inside.as_ptr().cast()) };
    let tested = _mm256_andnot_si256(_mm256_cmpeq_epi16(tested, _mm256_setzero_si256()), inside);
    add_terms_avx2(around, now, tested, lanes);
}

/// Adds the products of pixels in registers.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
#[inline]
fn add_terms_avx2(
    [row, left, right, above, below]: [std::arch::x86_64::__m256i; 5],
    now: std::arch::x86_64::__m256i,
    w: std::arch::x86_64::__m256i,
    lanes: &mut Lanes,
) {
    use std::arch::x86_64::*;
    let masked = |v| _mm256_and_si256(v, w);
    let p = masked(_mm256_sub_epi16(row, _mm256_set1_epi16(512)));
    let (x, y) = (masked(_mm256_sub_epi16(right, left)), masked(_mm256_sub_epi16(below, above)));
    let r = masked(_mm256_sub_epi16(now, row));
    let one = _mm256_set1_epi16(1);
    let pairs = [
        (w, w),
        (p, one),
        (x, one),
        (y, one),
        (r, one),
        (p, p),
        (p, x),
        (p, y),
        (p, r),
        (x, x),
        (x, y),
        (x, r),
        (y, y),
        (y, r),
        (r, r),
    ];
    for (sums, (a, b)) in lanes.iter_mut().zip(pairs) {
        let products = _mm256_madd_epi16(a, b);
        // SAFETY: 32 bytes are read and written of 32.
        unsafe {
            let before = _mm256_loadu_si256(sums.as_ptr().cast());
            _mm256_storeu_si256(sums.as_mut_ptr().cast(), _mm256_add_epi32(before, products));
        }
    }
}

/// The reference at sixteen pixels from one on, left of them, right, above and below.
type Around<'a, T> = [&'a [T; LANES]; 5];

/// Those of the pixels from place `at` on, the picture and what is tested there; none of them at a row's end.
#[inline(always)]
fn plain_pixels<'a, T>(
    reference: &'a [T],
    picture: &'a [u8],
    valid: &'a [u8],
    width: usize,
    at: usize,
) -> Option<(Around<'a, T>, [&'a [u8; LANES]; 2])> {
    let here = reference.get(at..)?.first_chunk()?;
    let left = reference.get(at.checked_sub(1)?..)?.first_chunk()?;
    let right = reference.get(at + 1..)?.first_chunk()?;
    let above = reference.get(at.checked_sub(width)?..)?.first_chunk()?;
    let below = reference.get(at + width..)?.first_chunk()?;
    let (now, tested) = (picture.get(at..)?.first_chunk()?, valid.get(at..)?.first_chunk()?);
    Some(([here, left, right, above, below], [now, tested]))
}

#[inline(always)]
fn quarters<T: Gray>(values: &[T; LANES]) -> Columns {
    let mut out = [0; LANES];
    for i in 0..LANES {
        out[i] = values[i].quarters();
    }
    out
}

/// Sixteen columns of a row, those of `at` from place `shift` on.
#[inline(always)]
fn columns_of<T: Gray>(row: &[T], shift: usize, at: &[usize; LANES + 2]) -> Columns {
    let mut out = [0; LANES];
    for (o, x) in out.iter_mut().zip(&at[shift..]) {
        *o = row[*x].quarters();
    }
    out
}

/// How far the ring of columns has turned.
#[derive(Debug)]
pub(super) struct RingShift {
    /// Content moved right by so many columns.
    pub(super) columns: f64,
    /// Mean absolute difference of the profiles there, and without a shift.
    pub(super) misfit: f64,
    pub(super) misfit_at_zero: f64,
}

const BANDS: usize = 4;

/// Matches column profiles (means of four bands of rows) of two pictures over the ring, shifts up to a sixth of a turn.
pub(super) fn ring_shift(before: &[u8], now: &[u8], width: usize, height: usize) -> RingShift {
    let (a, b) = (profiles(before, width, height), profiles(now, width, height));
    let reach = (width / 6) as isize;
    let misfit = |shift: isize| {
        let s = shift.rem_euclid(width as isize) as usize;
        let sum: f32 = a
            .iter()
            .zip(&b)
            .map(|(a, b)| {
                // Content at column x before is at x + s now.
                let split = width - s;
                difference_sum(&a[..split], &b[s..]) + difference_sum(&a[split..], &b[..s])
            })
            .sum();
        f64::from(sum) / (BANDS * width) as f64
    };
    let best = (-reach..=reach).map(|s| (s, misfit(s))).min_by(|x, y| x.1.total_cmp(&y.1)).unwrap_or((0, 0.0));
    RingShift { columns: best.0 as f64, misfit: best.1, misfit_at_zero: misfit(0) }
}

fn difference_sum(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum()
}

fn profiles(picture: &[u8], width: usize, height: usize) -> Vec<Vec<f32>> {
    (0..BANDS)
        .map(|band| {
            let rows = band * height / BANDS..(band + 1) * height / BANDS;
            let n = rows.len().max(1) as f32;
            let mut sums = vec![0.0f32; width];
            for y in rows {
                for (s, &p) in sums.iter_mut().zip(&picture[y * width..(y + 1) * width]) {
                    *s += f32::from(p) / n;
                }
            }
            sums
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};

    use super::*;
    use crate::motion::kernel::at_most;

    #[test]
    fn sums_are_the_same_on_any_processor_also_at_the_ends_of_rows() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(12);
        for wraps in [true, false] {
            let raster = Raster { width: 75, height: 41, wraps };
            let [before, now, valid] = [256, 256, 9]
                .map(|below| (0..raster.len()).map(|_| (rng.next_u32() % below) as u8).collect::<Vec<u8>>());
            let valid: Vec<u8> = valid.iter().map(|v| u8::from(*v > 0)).collect();
            let background: Vec<u16> = before.iter().map(|b| u16::from(*b) << 8 | 0x5a).collect();
            for columns in [0..75, 3..20, 16..31, 58..75] {
                let [plain, avx2, avx512] = [Level::Portable, Level::Avx2, Level::Avx512].map(|level| {
                    at_most(level, || {
                        let picture = against_picture(&before, &now, &valid, &raster, columns.clone());
                        [picture, against_background(&background, &now, &valid, &raster, columns.clone())].map(|s| s.0)
                    })
                });
                assert!(plain.iter().all(|sums| sums[W] > 0.0 && sums[RR] > 0.0));
                assert_eq!(plain, avx2, "{columns:?}, {wraps}");
                assert_eq!(plain, avx512, "{columns:?}, {wraps}");
            }
        }
    }
}
