//! Sums for the sector fits, column by column so that they vectorise, and the match of column profiles over the ring.

use nalgebra::{Matrix4, Vector4};

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

/// Sums a column of products of: weight, reference (P), its gradients (X, Y) and the change (R).
#[derive(Debug)]
pub(super) struct Sums {
    columns: [Vec<f32>; TERMS],
}

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
    pub(super) fn new(width: usize) -> Self {
        Self { columns: std::array::from_fn(|_| vec![0.0; width]) }
    }

    pub(super) fn clear(&mut self) {
        for c in &mut self.columns {
            c.fill(0.0);
        }
    }

    /// The fit of a sector; `None` without texture.
    pub(super) fn solve(&self, columns: std::ops::Range<usize>) -> Option<Fit> {
        let s: [f64; TERMS] =
            std::array::from_fn(|k| self.columns[k][columns.clone()].iter().map(|&v| f64::from(v)).sum());
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

/// Adds one row: the reference's rows above, at and below, and the picture's row. The first and last column have no
/// gradient where the picture does not wrap.
#[allow(clippy::too_many_arguments)]
pub(super) fn accumulate(
    above: &[u8],
    row: &[u8],
    below: &[u8],
    picture: &[u8],
    valid: &[u8],
    wraps: bool,
    sums: &mut Sums,
) {
    let n = row.len();
    if n < 3 {
        return;
    }
    // Slices of one known length: without bounds checks the loop vectorises.
    let [w_, p_, x_, y_, r_, pp, px, py, pr, xx, xy, xr, yy, yr, rr] = sums.columns.each_mut().map(|c| &mut c[..n]);
    let (above, row, below, picture, valid) = (&above[..n], &row[..n], &below[..n], &picture[..n], &valid[..n]);
    let mut add = |i: usize, left: u8, right: u8| {
        let w = f32::from(valid[i]);
        let p = w * (f32::from(row[i]) - 128.0);
        let x = w * 0.5 * (f32::from(right) - f32::from(left));
        let y = w * 0.5 * (f32::from(below[i]) - f32::from(above[i]));
        let r = w * (f32::from(picture[i]) - f32::from(row[i]));
        w_[i] += w;
        p_[i] += p;
        x_[i] += x;
        y_[i] += y;
        r_[i] += r;
        pp[i] += p * p;
        px[i] += p * x;
        py[i] += p * y;
        pr[i] += p * r;
        xx[i] += x * x;
        xy[i] += x * y;
        xr[i] += x * r;
        yy[i] += y * y;
        yr[i] += y * r;
        rr[i] += r * r;
    };
    if wraps {
        add(0, row[n - 1], row[1]);
        add(n - 1, row[n - 2], row[0]);
    }
    for i in 1..n - 1 {
        add(i, row[i - 1], row[i + 1]);
    }
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
