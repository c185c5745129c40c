//! One outline of a lit cylinder before an unknown background, to a few hundredths of a pixel.
//!
//! Problem: an edge's place is biased by three things: the body darkens towards its outline (lamps), the background has
//! texture and slope, and parts of the outline may be somebody else's. Insight: with the rings known, each row of the
//! picture across the outline is (body's light) · (ring) · coverage + (1 − coverage) · (this row's background). The light is
//! a combination of 1, t and √t (t = distance inside), each blurred analytically ([`super::blur`]); every row has its own
//! background level and slope, eliminated row by row; texture makes background pixels noisier, and that noise is measured.
//! Rows whose own edge disagrees with the others are outvoted (Tukey's weights): there the outline belongs to something else.

use nalgebra::{SMatrix, SVector};

use super::bars::Signal;
use super::blur;
use super::look::{CylinderLook, MAX_RINGS};
use super::rays::Sample;
use super::rings::{self, RingFit, median};

/// How far out the background is used, pixels.
const OUTSIDE_PX: f64 = 6.0;
/// How far in the body is used, pixels (less where the body is narrower).
const INSIDE_PX: f64 = 9.0;
const MARGIN: f64 = 2.0;
/// Starts beside the prediction, pixels.
const OTHER_STARTS_PX: [f64; 2] = [-1.2, 1.2];
/// A fit from the prediction that moves less, and that most rows agree with, needs no other start.
const SURE_SHIFT_PX: f64 = 0.4;
const SURE_AGREEMENT: f64 = 0.8;
const ROUNDS: usize = 3;
const STEPS: usize = 4;
const SETTLED_PX: f64 = 0.003;
/// Rows that disagree by more than this many sigmas are outvoted.
const TUKEY: f64 = 4.0;
/// Slope of the background over [`OUTSIDE_PX`], grey levels, a priori.
const SLOPE_SIGMA: f64 = 25.0;
const LEVEL_SIGMA: f64 = 150.0;

/// Unknowns common to all rows: shift, black level, light (1, t, √t).
const COMMON: usize = 5;
/// Unknowns of each row: level and slope of the background.
const OWN: usize = 2;
const GRAM: usize = OWN + COMMON + 1;

/// Which side of the body.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// Larger bearing.
    Left,
    /// Smaller bearing.
    Right,
}

/// What one outline says.
#[derive(Debug, Clone, Copy)]
pub struct EdgeFit {
    /// The outline is this far outside of where the rings put it, radians.
    pub outwards_rad: f64,
    /// Standard deviation from noise and texture, radians.
    pub sigma_rad: f64,
    /// Share of the information that rows give which agree with each other.
    pub agreement: f64,
    /// Rows that agree.
    pub rows: usize,
    /// Pixels per radian there.
    pub px_per_rad: f64,
}

/// A pixel beside an outline.
pub struct Pixel {
    /// 0 … 255.
    pub gray: f64,
    /// Of the picture across the outline.
    pub row: usize,
    /// Distance inside the predicted outline, radians.
    pub inside_rad: f64,
    /// Pixels per radian of bearing.
    pub px_per_rad: f64,
    /// Half of the body's width.
    pub half_px: f64,
    /// What the body's paint shows there, 0 … 1.
    pub ring: f64,
}

struct Row {
    weight: f64,
    background: [f64; OWN],
}

/// Fits one outline of a body that shows these bars, if any. `None` where too little of it is in view.
pub fn fit(
    samples: &[Sample],
    look: &CylinderLook,
    rings: &RingFit,
    bars: Option<&Signal>,
    side: Side,
) -> Option<EdgeFit> {
    let (mut pixels, places) = select(samples, look, rings, bars, side);
    let row_count = number_rows(&mut pixels, &places);
    if pixels.len() < 12 || row_count == 0 {
        return None;
    }
    let body = (rings.noise, rings.blur_px);
    // The rings know within a fraction of a pixel where it is; only where that fails are other starts worth their time.
    let first = from_start(&pixels, row_count, body, 0.0);
    if let Some((fit, _)) = &first
        && fit.outwards_rad.abs() * fit.px_per_rad < SURE_SHIFT_PX
        && fit.agreement > SURE_AGREEMENT
    {
        return Some(*fit);
    }
    let others = OTHER_STARTS_PX.iter().filter_map(|start| from_start(&pixels, row_count, body, *start));
    first.into_iter().chain(others).min_by(|a, b| a.1.total_cmp(&b.1)).map(|(fit, _)| fit)
}

/// Fits any outline from pixels beside it. `places` are the pixels' places along the outline, in pixels; `noise` and blur of the
/// body; starts in pixels outwards.
pub fn fit_rows(
    mut pixels: Vec<Pixel>,
    places: &[f64],
    (noise, blur_px): (f64, f64),
    starts_px: &[f64],
) -> Option<EdgeFit> {
    let row_count = number_rows(&mut pixels, places);
    if pixels.len() < 12 || row_count == 0 {
        return None;
    }
    let fits = starts_px.iter().filter_map(|start| from_start(&pixels, row_count, (noise, blur_px), *start));
    fits.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(fit, _)| fit)
}

/// Rows of one pixel's height; how many there are.
fn number_rows(pixels: &mut [Pixel], places: &[f64]) -> usize {
    let (lowest, highest) = places.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), p| (l.min(*p), h.max(*p)));
    if pixels.is_empty() {
        return 0;
    }
    for (pixel, place) in pixels.iter_mut().zip(places) {
        pixel.row = (place - lowest) as usize;
    }
    (highest - lowest) as usize + 1
}

fn select(
    samples: &[Sample],
    look: &CylinderLook,
    rings: &RingFit,
    bars: Option<&Signal>,
    side: Side,
) -> (Vec<Pixel>, Vec<f64>) {
    let middle = look.middle_reflectance();
    let cylinder = rings.cylinder(look.radius_m);
    let sign = if side == Side::Left { 1.0 } else { -1.0 };
    let mut pixels = Vec::new();
    let mut by_ring = [0.0; MAX_RINGS];
    let mut places = Vec::new();
    for sample in samples {
        let met = cylinder.meet(&sample.ray);
        let px_per_rad = f64::from(sample.ray.px_per_bearing);
        let inside_rad = cylinder.outline_rad - sign * met.aside_rad;
        let half_px = cylinder.outline_rad * px_per_rad;
        let inside_px = inside_rad * px_per_rad;
        if inside_px < -OUTSIDE_PX || inside_px > INSIDE_PX.min(half_px) {
            continue;
        }
        let blur_m = rings.blur_px * sample.ray.m_per_px(met.distance_m);
        let height = met.height_m + rings.lower_m;
        if height < look.low_m() + MARGIN * blur_m || height > look.high_m() - MARGIN * blur_m {
            continue;
        }
        let mut ring = rings::profile(look, &rings.reflectance, height, blur_m, &mut by_ring);
        if let Some(bars) = bars {
            // Outside of the outline what it is just inside.
            let aside = met.aside_rad.clamp(-cylinder.outline_rad, cylinder.outline_rad);
            ring = middle + (ring - middle) * bars.at(aside, rings.blur_px / px_per_rad);
        }
        places.push(sample.ray.elevation_px());
        pixels.push(Pixel { gray: sample.gray, row: 0, inside_rad, px_per_rad, half_px, ring });
    }
    (pixels, places)
}

/// Blurred coverage and light at one pixel: (A, L, C) and their derivatives by pixels outwards.
fn coverage(inside_px: f64, half_px: f64, blur_px: f64) -> ([f64; 3], [f64; 3]) {
    let y = inside_px / blur_px;
    let (step, bell, root, root_slope) = (blur::step(y), blur::bell(y), blur::root(y), blur::root_slope(y));
    let bend2 = 2.0 - inside_px.clamp(0.0, half_px) / half_px;
    let bend = bend2.sqrt();
    let by_bend = if (0.0..half_px).contains(&inside_px) { -0.5 / (half_px * bend) } else { 0.0 };
    let widening = (blur_px / half_px).sqrt();
    (
        [step, blur_px * (y * step + bell) / half_px, bend * widening * root],
        [bell / blur_px, step / half_px, widening * (by_bend * root + bend * root_slope / blur_px)],
    )
}

fn from_start(
    pixels: &[Pixel],
    row_count: usize,
    (noise, blur_px): (f64, f64),
    start_px: f64,
) -> Option<(EdgeFit, f64)> {
    let scale = pixels.iter().map(|p| p.px_per_rad).sum::<f64>() / pixels.len() as f64;
    let mut shift_px = start_px;
    let mut common = SVector::<f64, COMMON>::zeros();
    let mut rows: Vec<Row> = (0..row_count).map(|_| Row { weight: 1.0, background: [0.0; OWN] }).collect();
    let noise2 = noise * noise;
    let mut texture2 = 4.0 * noise2;
    let mut grams = vec![SMatrix::<f64, GRAM, GRAM>::zeros(); row_count];
    let mut fit = None;
    let mut linear_known = false;
    for round in 0..ROUNDS {
        let mut settled = false;
        for step in 0..=STEPS {
            let last = settled || step == STEPS;
            accumulate(pixels, blur_px, shift_px, scale, &common, &rows, (noise2, texture2), &mut grams);
            let (delta, inverse) = solve(&mut rows, &grams, linear_known)?;
            if !last {
                if linear_known {
                    settled = delta[0].abs() < SETTLED_PX;
                    shift_px += delta[0].clamp(-0.7, 0.7);
                }
                for k in 1..COMMON {
                    common[k] = delta[k];
                }
                linear_known = true;
                if (shift_px - start_px).abs() > 3.0 {
                    return None;
                }
            } else {
                let votes = vote(&mut rows, &grams, &delta);
                let (texture, misfit, cost) =
                    residuals(pixels, blur_px, shift_px, scale, &common, &rows, (noise2, texture2));
                texture2 = (texture - noise2).max(0.25 * noise2);
                if round + 1 == ROUNDS {
                    let inflate = misfit.max(1.0) * votes.scatter.max(1.0);
                    let sigma_px = (inverse * inflate).sqrt();
                    fit = Some((
                        EdgeFit {
                            outwards_rad: shift_px / scale,
                            sigma_rad: sigma_px / scale,
                            agreement: votes.agreement,
                            rows: votes.rows,
                            px_per_rad: scale,
                        },
                        cost,
                    ));
                }
                break;
            }
        }
    }
    fit
}

#[allow(clippy::too_many_arguments)]
fn accumulate(
    pixels: &[Pixel],
    blur_px: f64,
    shift_px: f64,
    scale: f64,
    common: &SVector<f64, COMMON>,
    rows: &[Row],
    (noise2, texture2): (f64, f64),
    grams: &mut [SMatrix<f64, GRAM, GRAM>],
) {
    for gram in grams.iter_mut() {
        *gram = SMatrix::zeros();
    }
    for pixel in pixels {
        let stretch = pixel.px_per_rad / scale;
        let t = pixel.inside_rad * pixel.px_per_rad + shift_px * stretch;
        let ([a, l, c], [da, dl, dc]) = coverage(t, pixel.half_px, blur_px);
        let out = 1.0 - a;
        let along = t / OUTSIDE_PX;
        let [b0, b1] = rows[pixel.row].background;
        let by_shift = stretch
            * (da * (common[1] + pixel.ring * common[2] - b0 - b1 * along)
                + pixel.ring * (dl * common[3] + dc * common[4]));
        let entry = [out, out * along, by_shift, a, pixel.ring * a, pixel.ring * l, pixel.ring * c, pixel.gray];
        let weight = 1.0 / (noise2 + out * out * texture2);
        let gram = &mut grams[pixel.row];
        for i in 0..GRAM {
            for j in i..GRAM {
                gram[(i, j)] += weight * entry[i] * entry[j];
            }
        }
    }
    for gram in grams.iter_mut() {
        gram[(0, 0)] += 1.0 / (LEVEL_SIGMA * LEVEL_SIGMA);
        gram[(0, GRAM - 1)] += 100.0 / (LEVEL_SIGMA * LEVEL_SIGMA);
        gram[(1, 1)] += 1.0 / (SLOPE_SIGMA * SLOPE_SIGMA);
        for i in 0..GRAM {
            for j in 0..i {
                gram[(i, j)] = gram[(j, i)];
            }
        }
    }
}

/// Takes the row's own unknowns out: what is left of the common ones and the picture.
fn reduce(gram: &SMatrix<f64, GRAM, GRAM>) -> SMatrix<f64, { COMMON + 1 }, { COMMON + 1 }> {
    let [p, q, r] = [gram[(0, 0)], gram[(0, 1)], gram[(1, 1)]];
    let det = (p * r - q * q).max(1e-300);
    SMatrix::from_fn(|i, j| {
        let (ai, bi) = (gram[(0, OWN + i)], gram[(1, OWN + i)]);
        let (aj, bj) = (gram[(0, OWN + j)], gram[(1, OWN + j)]);
        gram[(OWN + i, OWN + j)] - (ai * (r * aj - q * bj) + bi * (p * bj - q * aj)) / det
    })
}

/// One step: the common unknowns (shift as an increment) and the variance of the shift; fills the rows' backgrounds.
fn solve(
    rows: &mut [Row],
    grams: &[SMatrix<f64, GRAM, GRAM>],
    with_shift: bool,
) -> Option<(SVector<f64, COMMON>, f64)> {
    let mut h = SMatrix::<f64, COMMON, COMMON>::zeros();
    let mut g = SVector::<f64, COMMON>::zeros();
    for (gram, row) in grams.iter().zip(rows.iter()) {
        let reduced = reduce(gram);
        h += row.weight * reduced.fixed_view::<COMMON, COMMON>(0, 0);
        g += row.weight * reduced.fixed_view::<COMMON, 1>(0, COMMON);
    }
    // Black level near zero, light unknown: weak, so that a body of few rows has an answer.
    for (k, sigma) in [(1, 15.0), (2, 500.0), (3, 300.0), (4, 300.0)] {
        h[(k, k)] += 1.0 / (sigma * sigma);
    }
    h[(0, 0)] += if with_shift { 1e-4 } else { 1e6 };
    let factor = h.cholesky()?;
    let delta = factor.solve(&g);
    for (gram, row) in grams.iter().zip(rows.iter_mut()) {
        let mut rest = [gram[(0, GRAM - 1)], gram[(1, GRAM - 1)]];
        for k in 0..COMMON {
            rest[0] -= gram[(0, OWN + k)] * delta[k];
            rest[1] -= gram[(1, OWN + k)] * delta[k];
        }
        let [p, q, r] = [gram[(0, 0)], gram[(0, 1)], gram[(1, 1)]];
        let det = (p * r - q * q).max(1e-300);
        row.background = [(r * rest[0] - q * rest[1]) / det, (p * rest[1] - q * rest[0]) / det];
    }
    Some((delta, factor.inverse()[(0, 0)]))
}

struct Votes {
    agreement: f64,
    rows: usize,
    scatter: f64,
}

/// Each row's own edge against the common one; rows that disagree lose their weight.
fn vote(rows: &mut [Row], grams: &[SMatrix<f64, GRAM, GRAM>], delta: &SVector<f64, COMMON>) -> Votes {
    let mut own = Vec::with_capacity(rows.len());
    for gram in grams {
        let reduced = reduce(gram);
        let information = reduced[(0, 0)];
        let mut gradient = reduced[(0, COMMON)];
        for k in 1..COMMON {
            gradient -= reduced[(0, k)] * delta[k];
        }
        own.push((gradient / information.max(1e-12), information));
    }
    // Weighted median, so that a minority of rows cannot pull it.
    let mut sorted: Vec<(f64, f64)> = own.iter().copied().filter(|(_, w)| *w > 0.2).collect();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let total: f64 = sorted.iter().map(|(_, w)| w).sum();
    let mut sum = 0.0;
    let middle = sorted.iter().find(|(_, w)| {
        sum += w;
        sum >= 0.5 * total
    });
    let middle = middle.map_or(0.0, |(x, _)| *x);
    let mut deviations: Vec<f64> = sorted.iter().map(|(x, w)| (x - middle).abs() * w.sqrt()).collect();
    let spread = (median(&mut deviations) / 0.6745).clamp(1.0, 4.0);
    let (mut agreeing, mut count, mut chi2, mut all) = (0.0, 0, 0.0, 0.0);
    for (row, (x, information)) in rows.iter_mut().zip(&own) {
        let z = (x - middle) * information.sqrt() / spread;
        let inside = (1.0 - (z / TUKEY).powi(2)).max(0.0);
        row.weight = inside * inside;
        all += information;
        agreeing += information * row.weight.min(1.0);
        if row.weight > 0.3 && *information > 0.2 {
            count += 1;
            chi2 += (x - middle).powi(2) * information;
        }
    }
    Votes {
        agreement: if all > 0.0 { agreeing / all } else { 0.0 },
        rows: count,
        scatter: chi2 / (count as f64 - 1.0).max(1.0),
    }
}

/// Variance of background pixels, mean squared weighted residual, and robust cost.
#[allow(clippy::too_many_arguments)]
fn residuals(
    pixels: &[Pixel],
    blur_px: f64,
    shift_px: f64,
    scale: f64,
    common: &SVector<f64, COMMON>,
    rows: &[Row],
    (noise2, texture2): (f64, f64),
) -> (f64, f64, f64) {
    let (mut outside, mut outside_n) = (0.0, 0.0);
    let (mut chi2, mut n, mut cost) = (0.0, 0.0, 0.0);
    for pixel in pixels {
        let t = pixel.inside_rad * pixel.px_per_rad + shift_px * pixel.px_per_rad / scale;
        let ([a, l, c], _) = coverage(t, pixel.half_px, blur_px);
        let [b0, b1] = rows[pixel.row].background;
        let model = a * common[1]
            + pixel.ring * (a * common[2] + l * common[3] + c * common[4])
            + (1.0 - a) * (b0 + b1 * t / OUTSIDE_PX);
        let residual2 = (pixel.gray - model).powi(2);
        let weight = rows[pixel.row].weight;
        if a < 0.02 {
            outside += weight * residual2;
            // Level and slope take about two of a row's five or six pixels.
            outside_n += 0.65 * weight;
        }
        let expected = noise2 + (1.0 - a).powi(2) * texture2;
        chi2 += weight * residual2 / expected;
        n += weight;
        let z2 = pixel_cost(pixel.gray - model, expected);
        cost += z2 + expected.ln();
    }
    (outside / f64::max(outside_n, 1.0), chi2 / (0.75 * f64::max(n, 1.0)), cost / pixels.len() as f64)
}

/// Geman–McClure: a few strays cost no more than being strays.
fn pixel_cost(residual: f64, expected: f64) -> f64 {
    let z2 = residual * residual / expected;
    z2 / (1.0 + z2 / 25.0)
}
