//! Sums for the sector fits, sixteen columns at a time so that they vectorise, and the match of column profiles over the ring.

use std::ops::Range;

use nalgebra::{Matrix4, Vector4};

use crate::motion::kernel::wide;
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

/// Grey levels of a reference.
trait Gray: Copy {
    fn gray(self) -> f32;
}

impl Gray for u8 {
    #[inline(always)]
    fn gray(self) -> f32 {
        f32::from(self)
    }
}

/// 8.8 fixed point.
impl Gray for u16 {
    #[inline(always)]
    fn gray(self) -> f32 {
        f32::from(self) * (1.0 / 256.0)
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

#[inline(always)]
fn sums<T: Gray>(reference: &[T], picture: &[u8], valid: &[u8], raster: &Raster, columns: Range<usize>) -> Sums {
    let Raster { width, height, wraps } = *raster;
    let row_step = (height / ROWS).max(ROW_STEP);
    let mut total = [0f64; TERMS];
    let mut lanes = [[0f32; LANES]; TERMS];
    for x0 in columns.clone().step_by(LANES) {
        // The column of each lane and its neighbours; columns beyond the sector or without a gradient have no weight.
        let at: [usize; LANES + 2] = std::array::from_fn(|i| {
            let x = x0 + i + width - 1;
            if wraps { x % width } else { x.saturating_sub(width).min(width - 1) }
        });
        let inside: [f32; LANES] = std::array::from_fn(|l| {
            let x = x0 + l;
            f32::from(u8::from(x < columns.end && (wraps || (x > 0 && x + 1 < width))))
        });
        let plain = x0 > 0 && x0 + LANES < width;
        lanes.fill([0.0; LANES]);
        for y in (1..height.saturating_sub(1)).step_by(row_step) {
            let i = y * width;
            let row = &reference[i..i + width];
            let (left, row, right) = (
                columns_of(row, x0, 0, plain, &at),
                columns_of(row, x0, 1, plain, &at),
                columns_of(row, x0, 2, plain, &at),
            );
            let above = columns_of(&reference[i - width..i], x0, 1, plain, &at);
            let below = columns_of(&reference[i + width..i + 2 * width], x0, 1, plain, &at);
            let now = columns_of(&picture[i..i + width], x0, 1, plain, &at);
            let tested = columns_of(&valid[i..i + width], x0, 1, plain, &at);
            for l in 0..LANES {
                let w = tested[l] * inside[l];
                let p = w * (row[l] - 128.0);
                let x = w * 0.5 * (right[l] - left[l]);
                let y = w * 0.5 * (below[l] - above[l]);
                let r = w * (now[l] - row[l]);
                lanes[W][l] += w;
                lanes[P][l] += p;
                lanes[X][l] += x;
                lanes[Y][l] += y;
                lanes[R][l] += r;
                lanes[PP][l] += p * p;
                lanes[PX][l] += p * x;
                lanes[PY][l] += p * y;
                lanes[PR][l] += p * r;
                lanes[XX][l] += x * x;
                lanes[XY][l] += x * y;
                lanes[XR][l] += x * r;
                lanes[YY][l] += y * y;
                lanes[YR][l] += y * r;
                lanes[RR][l] += r * r;
            }
        }
        for (t, row) in total.iter_mut().zip(&lanes) {
            *t += row.iter().map(|&v| f64::from(v)).sum::<f64>();
        }
    }
    Sums(total)
}

/// Sixteen columns of a row in grey levels, from place `shift` of `at` on: column `x0` + `shift` − 1, where that is `plain`.
#[inline(always)]
fn columns_of<T: Gray>(row: &[T], x0: usize, shift: usize, plain: bool, at: &[usize; LANES + 2]) -> [f32; LANES] {
    let mut out = [0.0; LANES];
    if plain && let Some(values) = row[x0 + shift - 1..].first_chunk::<LANES>() {
        for l in 0..LANES {
            out[l] = values[l].gray();
        }
    } else {
        for (o, x) in out.iter_mut().zip(&at[shift..]) {
            *o = row[*x].gray();
        }
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
