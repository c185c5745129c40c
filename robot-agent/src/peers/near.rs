//! A body so near that only its topmost ring is in view: below one metre a camera at 0.6 m sees no more of it.
//!
//! Problem: without two rings there is no pattern to find. Insight: the upper end of the marker is a curve that bends with the
//! distance to the near surface, R² being known; it gives the axis' bearing and range as the rings do further away, and the
//! outlines, 20° and more apart, give both again. Only what satisfies both is a robot. Algorithm: at every bearing and range
//! the contrast across the predicted curve is taken at eleven places, and must have one sign nearly everywhere; there the
//! curve is measured column by column to a fraction of a pixel and (bearing, distance) fitted to it, strays left out. Shelves
//! and table tops have such curves, too, and stronger ones: the places are tried in the order of what the two outlines show
//! that would stand there, and only then of the curve. In a team that wears bars, plain bodies are looked for by themselves,
//! since a contrast that must keep its sign is met by chance much more rarely.

use std::f64::consts::TAU;

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use super::blur;
use super::geometry::Cylinder;
use super::look::CylinderLook;
use super::rays::Sample;
use super::rings::{BLUR_PX, Column, EndFit, RingFit, median};
use super::search::{Candidate, Grid, Peak, strongest};
use super::shades;

/// Step between ranges, and most of them.
const RANGE_STEP: f64 = 1.03;
const MAX_LEVELS: usize = 80;
/// A ring edge counts as seen where the picture goes on below it for so much, metres.
const BELOW_EDGE_M: f64 = 0.02;
/// Places on the curve: sines of the angle of incidence.
const PLACES: usize = 11;
const WIDEST_SINE: f64 = 0.85;
/// Of them may miss the contrast; on bodies with bars, which may be as bright as the lid above them.
const STRAYS: usize = 2;
const BARRED_STRAYS: usize = 6;
/// Least contrast, as [`shades`] has it.
const LEAST_STEP: i32 = 4;
/// Every so many columns.
const STRIDE: usize = 2;
/// An outline is looked at in every third row from so many below the curve on, in so many rows at most, where there are as many
/// as the last.
pub(super) const OUTLINE_BELOW: usize = 3;
pub(super) const OUTLINE_EVERY: usize = 3;
const OUTLINE_ROWS: [usize; 2] = [3, 6];
/// Contrast beyond this says little more, as [`shades`] has it: of an outline in one row, of an outline, of the curve; and how little.
const MOST_ROW: f32 = 20.0;
const MOST_OUTLINE: f32 = 15.0;
const MOST_CURVE: f32 = 30.0;
const BEYOND: f32 = 0.1;
/// An outline counts so many times as much as the curve; the most that both outlines and the curve come to ([`Curve::shows`]).
const OUTLINE_WEIGHT: f32 = 6.0;
const MOST_SHOWN: f32 = 2.0 * OUTLINE_WEIGHT * MOST_OUTLINE + MOST_CURVE;
/// Places nearer to each other than this share of half the body's width are one.
const SAME_SHARE: f64 = 0.35;
/// Most candidates of a picture. In 700 rooms (seed 500000) eight near robots were not among the first 14 places of plain bodies and
/// 24 of barred ones; six of them are among so many.
const MAX_PLAIN: usize = 42;
const MAX_BARRED: usize = 72;
/// The curve is fitted this far round the body.
const FITTED_SINE: f64 = 0.93;
/// How far from the prediction a column is looked at, pixels.
const REACH_PX: [f64; 2] = [3.5, 5.0];
/// From the start the curve may turn out to be this far away, pixels.
const MOST_WAY_PX: f64 = 12.0;
/// Least share of the columns that agree, and their largest RMS distance from the curve, pixels.
const LEAST_AGREEING: f64 = 0.6;
const LEAST_AGREEING_BARRED: f64 = 0.45;
const WORST_RMS_PX: f64 = 0.7;
/// In the dark a column shows the curve only together with so many others; what is no brighter than this in the mean, grey levels, is dark.
const DARK_COLUMNS: f64 = 4.0;
const DARK: f64 = 40.0;
/// What all columns are wrong by alike: shading, sampling, the lens. Pixels.
const SHARED_PX: f64 = 0.05;
/// What a curve is worth beside rings: where both are to be had, rings are taken,
/// with the curve's distance where one edge between rings alone is in view (`CylinderFinder::with_upper_end`).
const CORRELATION: f64 = 0.97;
const ROUNDS: usize = 6;
/// The far side of the upper end is looked for so far above the near side, in so many columns, and counts this near to where it should be.
const OVER_NEAR_PX: f64 = 2.5;
const LEAST_LID_COLUMNS: usize = 6;
const MOST_LID_PX: f64 = 1.0;
/// A step in a column is looked for this far from the prediction, pixels.
const MOST_STEP_PX: f64 = 2.8;

#[derive(Debug)]
struct Level {
    range_m: f64,
    half_columns: f64,
    rim: Curve,
}

/// A level line or curve of a body as it lies in a panorama, and the upright outlines at its ends.
#[derive(Debug)]
pub(super) struct Curve {
    /// Column beside the middle's and row of the lower side there; at most [`PLACES`].
    pub(super) places: Vec<(i64, usize)>,
    /// Columns of right and left outline beside the middle's, and the rows in which they are looked at.
    pub(super) sides: [(i64, Vec<usize>); 2],
}

impl Curve {
    /// What the outlines show and then the curve, with its middle in column `u`; `None` where the curve has less contrast than `least`.
    /// `evened` comes of [`shades`].
    pub(super) fn shows(&self, evened: &[u8], width: usize, u: usize, least: i32, rim: Rim) -> Option<f32> {
        let contrast = contrast_across(evened, width, &self.places, u, least, rim);
        let outline =
            |(beside, rows): &(i64, Vec<usize>)| worth(contrast_beside(evened, width, *beside, rows, u), MOST_OUTLINE);
        (contrast >= least)
            .then(|| OUTLINE_WEIGHT * self.sides.iter().map(outline).sum::<f32>() + worth(contrast as f32, MOST_CURVE))
    }
}

/// How the marker's upper end looks all along.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rim {
    /// On a plain body: its contrast keeps its sign.
    Plain,
    /// On a body with bars, which show the negative: it may change.
    Barred,
}

/// Between which ranges a camera sees of a body what, metres to the axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reach {
    /// From here on the upper end of the marker is in view.
    pub rim_m: f64,
    /// From here on one edge between two rings, too.
    pub one_edge_m: f64,
    /// From here on two: they are a pattern.
    pub two_edges_m: f64,
}

impl Reach {
    /// For a camera at `camera_height_m` that sees down to the tangent `lowest`. Where it does not look down, or stands below the
    /// marker, everything is in view from the body's surface on.
    pub fn new(look: &CylinderLook, camera_height_m: f64, lowest: f64) -> Self {
        let from = |height_m: f64| {
            let rise = camera_height_m - height_m;
            let near_m = if lowest < 0.0 && rise > 0.0 { rise / -lowest } else { 0.0 };
            look.radius_m + near_m
        };
        let inner = &look.edges_m[1..look.edges_m.len() - 1];
        let edge = |from_top: usize| inner.iter().rev().nth(from_top).map_or(look.low_m(), |edge| edge - BELOW_EDGE_M);
        Self { rim_m: from(look.high_m()), one_edge_m: from(edge(0)), two_edges_m: from(edge(1)) }
    }
}

impl Rim {
    /// Of places that may miss the contrast.
    fn strays(self) -> usize {
        if self == Self::Barred { BARRED_STRAYS } else { STRAYS }
    }
}

/// The coarse search for near bodies.
#[derive(Debug)]
pub struct NearSearch {
    grid: Grid,
    /// What is worn in this paint, and the most candidates of each.
    rims: Vec<(Rim, usize)>,
    levels: Vec<Level>,
}

impl NearSearch {
    /// Prepares the curves of a look for a camera at this height.
    pub fn new(grid: Grid, look: &CylinderLook, camera_height_m: f64, reach: &Reach) -> Self {
        let rise = look.high_m() - camera_height_m;
        let mut levels = Vec::new();
        // Round the body the upper end is further away, and may be in view there before it is in the middle.
        let mut range_m = (0.9 * reach.rim_m).max(1.6 * look.radius_m);
        while range_m < reach.two_edges_m && levels.len() < MAX_LEVELS {
            let half_columns = (look.radius_m / range_m).asin() / TAU * grid.width as f64;
            let places = (0..PLACES).filter_map(|k| {
                let sine = WIDEST_SINE * (2.0 * k as f64 / (PLACES - 1) as f64 - 1.0);
                let aside = (look.radius_m * sine / range_m).asin();
                let distance = range_m * aside.cos() - look.radius_m * (1.0 - sine * sine).sqrt();
                let row = grid.row(rise / distance);
                // Three rows above, two below.
                let fits = row >= 4.0 && row + 3.0 < grid.height as f64;
                fits.then(|| ((-aside / TAU * grid.width as f64).round() as i64, row.round() as usize))
            });
            let places: Vec<_> = places.collect();
            // The curve meets the outlines at their distance.
            let side = grid.row(rise / (range_m * range_m - look.radius_m * look.radius_m).sqrt());
            let first = side.round().max(0.0) as usize + OUTLINE_BELOW;
            let rows: Vec<usize> = (first..grid.height).step_by(OUTLINE_EVERY).take(OUTLINE_ROWS[1]).collect();
            if places.len() > PLACES / 2 {
                let sides = [-1, 1].map(|sign| (sign * half_columns.round() as i64, rows.clone()));
                levels.push(Level { range_m, half_columns, rim: Curve { places, sides } });
            }
            range_m *= RANGE_STEP;
        }
        let has = |barred: bool| look.patterns.iter().any(|pattern| pattern.bars.is_empty() != barred);
        let rims = [(Rim::Plain, MAX_PLAIN), (Rim::Barred, MAX_BARRED)];
        let rims = rims.into_iter().filter(|(rim, _)| has(*rim == Rim::Barred)).collect();
        Self { grid, rims, levels }
    }

    /// Candidates, best first. `panorama` holds one byte a pixel of the grid.
    pub fn run(&self, panorama: &[u8]) -> Vec<Candidate> {
        let evened = shades::evened(panorama, self.grid.width);
        self.rims.iter().flat_map(|(rim, most)| self.of(*rim, *most, &evened)).collect()
    }

    fn of(&self, rim: Rim, most: usize, evened: &[u8]) -> Vec<Candidate> {
        let width = self.grid.width;
        let mut peaks: Vec<Peak> = Vec::new();
        for (l, level) in self.levels.iter().enumerate() {
            for u in (0..width).step_by(STRIDE) {
                peaks.extend(level.rim.shows(evened, width, u, LEAST_STEP, rim).map(|shows| (shows, l, u)));
            }
        }
        let is_near = |l: usize, other: usize, apart: f64| {
            let ratio = self.levels[other].range_m / self.levels[l].range_m;
            apart < SAME_SHARE * self.levels[l].half_columns && (0.9..1.11).contains(&ratio)
        };
        strongest(peaks, width, most, is_near)
            .into_iter()
            .map(|(shows, l, u)| {
                let bearing_rad = self.grid.bearing_rad(u as f64);
                let range_m = self.levels[l].range_m;
                Candidate {
                    bearing_rad,
                    range_m,
                    support: f64::from((shows / MOST_SHOWN).min(1.0)),
                    seen_rad: [bearing_rad; 2],
                    known: false,
                    rim: Some(rim),
                    behind: None,
                }
            })
            .collect()
    }
}

/// The contrast across a line or curve that all but a few places reach (at most [`PLACES`]: columns beside `u`, and rows of its
/// lower side there), whichever side is the brighter one; 0 where more than a few have less than `least`.
fn contrast_across(evened: &[u8], width: usize, places: &[(i64, usize)], u: usize, least: i32, rim: Rim) -> i32 {
    let most_strays = rim.strays();
    let mut steps = [0i32; PLACES];
    let (mut not_up, mut not_down) = (0, 0);
    for (step, (aside, row)) in steps.iter_mut().zip(places) {
        let column = (u as i64 + aside).rem_euclid(width as i64) as usize;
        let gray = |row: usize| i32::from(evened[row * width + column]);
        *step = (gray(row - 3) + gray(row - 2) - gray(row + 1) - gray(row + 2)) / 2;
        if rim == Rim::Barred {
            *step = step.abs();
        }
        not_up += usize::from(*step < least);
        not_down += usize::from(*step > -least);
        if not_up > most_strays && not_down > most_strays {
            return 0;
        }
    }
    let steps = &mut steps[..places.len()];
    steps.sort_unstable();
    let last = steps.len() - 1;
    let strays = most_strays.min(last);
    steps[strays].max(-steps[last - strays])
}

/// Mean contrast across an upright outline `beside` columns from `u`, whichever half is the brighter one in a row; 0 where too few
/// rows are in view.
fn contrast_beside(evened: &[u8], width: usize, beside: i64, rows: &[usize], u: usize) -> f32 {
    if rows.len() < OUTLINE_ROWS[0] {
        return 0.0;
    }
    let column = |out: i64| (u as i64 + beside + out).rem_euclid(width as i64) as usize;
    let [a, b, c, d] = [-3, -2, 2, 3].map(column);
    let contrast = |row: &usize| {
        let gray = |column: usize| i32::from(evened[row * width + column]);
        worth((gray(a) + gray(b) - gray(c) - gray(d)).abs() as f32 / 2.0, MOST_ROW)
    };
    rows.iter().map(contrast).sum::<f32>() / rows.len() as f32
}

/// What a contrast says: beyond `most` little more, so that the place that shows best is told from those beside it that would do as well.
fn worth(contrast: f32, most: f32) -> f32 {
    contrast.min(most) + BEYOND * (contrast - most).max(0.0)
}

/// One column across the curve.
struct Crossing {
    aside_rad: f64,
    /// The curve is so much higher than predicted, pixels, and its variance.
    higher_px: f64,
    variance_px2: f64,
    /// Gray levels from below to above.
    step: f64,
    noise: f64,
    px_per_rad: f64,
}

/// Fits bearing and distance to the marker's upper end. `start`: bearing and range to the axis. `None` where there is no such
/// curve.
pub fn fit(samples: &[Sample], look: &CylinderLook, height_m: f64, start: (f64, f64), rim: Rim) -> Option<RingFit> {
    let about = about(samples, look, start);
    let fit = |columns: f64| fit_columns((samples, &about), look, height_m, start, rim, columns);
    let is_dark = || about.iter().map(|sample| sample.gray).sum::<f64>() < DARK * about.len() as f64;
    fit(1.0).or_else(|| is_dark().then(|| fit(DARK_COLUMNS)).flatten())
}

/// As [`fit`], so many columns at a time; of the samples those about the curve.
fn fit_columns(
    (all, samples): (&[Sample], &[Sample]),
    look: &CylinderLook,
    height_m: f64,
    start: (f64, f64),
    rim: Rim,
    together: f64,
) -> Option<RingFit> {
    let (mut bearing, mut range) = start;
    let rise = look.high_m() - height_m;
    let mut fitted = None;
    for round in 0..ROUNDS {
        let starts_px: &[f64] = if round < 2 { &[-1.5, 0.0, 1.5] } else { &[0.0] };
        // Most candidates are none: a third of the columns shows it.
        let every = if round == 0 && together < 2.0 { 3 } else { 1 };
        let crossings = crossings(samples, look, (bearing, range), Half::Near, starts_px, (together, every));
        let crossings: Vec<Crossing> = crossings.into_iter().flatten().collect();
        let asked = crossings.len();
        if asked < 8 {
            return None;
        }
        let side = |is_up: bool| crossings.iter().filter(move |c| rim == Rim::Barred || (c.step > 0.0) == is_up);
        let is_up = side(true).count() >= side(false).count();
        let mut agreeing: Vec<&Crossing> = side(is_up).collect();
        let mut places: Vec<f64> = agreeing.iter().map(|c| c.higher_px).collect();
        let middle = median(&mut places);
        let mut away: Vec<f64> = agreeing.iter().map(|c| (c.higher_px - middle).abs()).collect();
        let gate = (4.0 * median(&mut away)).max(if round < 2 { 1.5 } else { 0.5 });
        let centre = if round < 2 { middle } else { 0.0 };
        agreeing.retain(|c| (c.higher_px - centre).abs() < gate);
        let least = if rim == Rim::Barred { LEAST_AGREEING_BARRED } else { LEAST_AGREEING };
        if (agreeing.len() as f64) < least * asked as f64 {
            return None;
        }
        // d elevation / d(bearing, range), by differences.
        let elevation = |bearing: f64, range: f64, at: f64| {
            let aside = protocol::angle::difference(at, bearing);
            let sine = (range * aside.sin() / look.radius_m).clamp(-1.0, 1.0);
            rise.atan2(range * aside.cos() - look.radius_m * (1.0 - sine * sine).sqrt())
        };
        let (mut h, mut g, mut chi2, mut rms2, mut weights) = (Matrix2::zeros(), Vector2::zeros(), 0.0, 0.0, 0.0);
        for c in &agreeing {
            let at = bearing + c.aside_rad;
            let here = elevation(bearing, range, at);
            let row = Vector2::new(
                (elevation(bearing + 1e-4, range, at) - here) / 1e-4,
                (elevation(bearing, range * 1.0001, at) - here) / (range * 1e-4),
            ) * c.px_per_rad;
            // Rings and rim are painted and cut to a few hundredths of a pixel.
            let weight = 1.0 / (c.variance_px2 + 0.05 * 0.05);
            h += weight * row * row.transpose();
            g += weight * row * c.higher_px;
            chi2 += weight * c.higher_px * c.higher_px;
            // What the sensor's noise has in it is no fault of the curve; where the contrast is low there is much.
            rms2 += weight * (c.higher_px * c.higher_px - c.variance_px2);
            weights += weight;
        }
        let inverse = h.try_inverse()?;
        let delta = inverse * g;
        bearing += delta[0].clamp(-0.06, 0.06);
        range += delta[1].clamp(-0.06 * range, 0.06 * range);
        if !range.is_finite() || range < 1.3 * look.radius_m || (range / start.1 - 1.0).abs() > 0.2 {
            return None;
        }
        let n = agreeing.len() as f64;
        let mut noises: Vec<f64> = agreeing.iter().map(|c| c.noise).collect();
        let mut sizes: Vec<f64> = agreeing.iter().map(|c| c.step.abs()).collect();
        let inflate = (chi2 / (n - 2.0).max(1.0)).max(1.0);
        let px_per_rad = agreeing.iter().map(|c| c.px_per_rad).sum::<f64>() / n;
        let by_range =
            (elevation(bearing, range * 1.0001, bearing) - elevation(bearing, range, bearing)) / (range * 1e-4);
        let shared = Matrix2::new(0.0, 0.0, 0.0, (SHARED_PX / px_per_rad / by_range).powi(2));
        fitted = Some((
            inverse * inflate + shared,
            (rms2 / weights).max(0.0).sqrt(),
            n / asked as f64,
            median(&mut noises),
            median(&mut sizes),
        ));
    }
    let (covariance, rms_px, agreeing, noise, gain) = fitted?;
    if rms_px > WORST_RMS_PX {
        return None;
    }
    let cylinder = Cylinder::new(bearing, range, look.radius_m);
    let columns = vec![Column { gain, offset: 0.0, correlation: 1.0, visible: true, is_mixed: false }; 8];
    Some(RingFit {
        bearing_rad: protocol::angle::wrap(bearing),
        near_m: cylinder.range_m - look.radius_m,
        lower_m: 0.0,
        blur_px: BLUR_PX,
        reflectance: look.reflectance.clone(),
        covariance: [
            [covariance[(0, 0)], covariance[(0, 1)], 0.0],
            [covariance[(1, 0)], covariance[(1, 1)], 0.0],
            [0.0; 3],
        ],
        noise: noise.max(0.5),
        columns,
        half_rad: cylinder.outline_rad,
        visible: agreeing,
        correlation: CORRELATION,
        gain,
        bend: [0.0; 2],
        edges_seen: 1,
        end: Some(EndFit { stray_px: rms_px, lid: lid_shown(all, look, (bearing, range), together), together }),
    })
}

/// Share of the columns in which the picture has an edge where the far side of the upper end is, as of a body that ends there: a table's or
/// a chair's front has none, or elsewhere. Its middle may be hidden by what the body carries.
fn lid_shown(samples: &[Sample], look: &CylinderLook, at: (f64, f64), together: f64) -> f64 {
    let columns = crossings(samples, look, at, Half::Far, &[0.0], (together, 1));
    let shown = columns.iter().flatten().filter(|crossing| crossing.higher_px.abs() < MOST_LID_PX).count();
    shown as f64 / columns.len().max(LEAST_LID_COLUMNS) as f64
}

/// The samples that the fit may come to need.
fn about(samples: &[Sample], look: &CylinderLook, at: (f64, f64)) -> Vec<Sample> {
    let cylinder = Cylinder::new(at.0, at.1, look.radius_m);
    let is_about = |sample: &&Sample| {
        let met = cylinder.meet(&sample.ray);
        let m_per_px = sample.ray.m_per_px(met.distance_m);
        met.sine.abs() < 1.2 && ((met.height_m - look.high_m()) / m_per_px).abs() < MOST_WAY_PX
    };
    samples.iter().filter(is_about).copied().collect()
}

/// Of the upper end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Half {
    /// Towards the camera.
    Near,
    /// What the body itself would hide were it any higher.
    Far,
}

/// Where the curve is in every `every`-th column of the picture that could show it, so many of the picture's columns being one.
fn crossings(
    samples: &[Sample],
    look: &CylinderLook,
    at: (f64, f64),
    half_of_it: Half,
    starts_px: &[f64],
    (together, every): (f64, usize),
) -> Vec<Option<Crossing>> {
    let cylinder = Cylinder::new(at.0, at.1, look.radius_m);
    let half = cylinder.outline_rad;
    let Some(scale) = samples.first().map(|s| f64::from(s.ray.px_per_bearing)) else { return Vec::new() };
    let wide = together * (1.5 / scale).max(half / 40.0);
    let count = (2.0 * half / wide).ceil().max(1.0) as usize;
    let mut columns: Vec<Vec<(f64, f64)>> = vec![Vec::new(); count];
    let mut sums = vec![[0.0f64; 2]; count];
    for sample in samples {
        let met = cylinder.meet(&sample.ray);
        if met.sine.abs() > FITTED_SINE {
            continue;
        }
        let m_per_px = sample.ray.m_per_px(met.distance_m);
        let mut higher_px = (met.height_m - look.high_m()) / m_per_px;
        if half_of_it == Half::Far {
            if higher_px < OVER_NEAR_PX {
                continue;
            }
            // A line of sight meets the body's surface twice, a chord apart.
            let chord_m = 2.0 * look.radius_m * (1.0 - met.sine * met.sine).max(0.0).sqrt();
            let height_m = met.height_m + f64::from(sample.ray.slope) * chord_m;
            higher_px = (height_m - look.high_m()) / sample.ray.m_per_px(met.distance_m + chord_m);
        }
        if !reaches(higher_px) {
            continue;
        }
        let column = (((met.aside_rad + half) / wide) as usize).min(count - 1);
        columns[column].push((higher_px, sample.gray));
        sums[column][0] += met.aside_rad;
        sums[column][1] += f64::from(sample.ray.px_per_elevation);
    }
    let crossing = |(pixels, [aside, scale]): (&Vec<(f64, f64)>, &[f64; 2])| {
        let n = pixels.len() as f64;
        let (higher_px, variance_px2, step, noise) = step_at(pixels, starts_px)?;
        Some(Crossing { aside_rad: aside / n, higher_px, variance_px2, step, noise, px_per_rad: scale / n })
    };
    columns.iter().zip(&sums).step_by(every).filter(|(pixels, _)| tells(pixels)).map(crossing).collect()
}

/// Whether a column is looked at so much higher than the curve is predicted, pixels.
pub(super) fn reaches(higher_px: f64) -> bool {
    (-REACH_PX[1]..=REACH_PX[0]).contains(&higher_px)
}

/// Whether a column has pixels enough on either side.
pub(super) fn tells(pixels: &[(f64, f64)]) -> bool {
    let below = pixels.iter().filter(|(x, _)| *x < -1.0).count();
    let above = pixels.iter().filter(|(x, _)| *x > 1.0).count();
    below >= 2 && above >= 2
}

/// A blurred step in one column: place, variance of the place, height of the step, residual.
pub(super) fn step_at(pixels: &[(f64, f64)], starts_px: &[f64]) -> Option<(f64, f64, f64, f64)> {
    if !tells(pixels) {
        return None;
    }
    let mut best: Option<(f64, f64, f64, f64)> = None;
    for start in starts_px {
        let mut place = *start;
        let mut found = None;
        for _ in 0..6 {
            let sums = StepSums::of(pixels, place);
            let linear = sums.level_and_step()?;
            let (mut h, g, chi2) = sums.normal_equations(linear);
            h[(2, 2)] += 1.0;
            let inverse = h.try_inverse()?;
            let delta = (inverse * g)[2].clamp(-0.8, 0.8);
            place += delta;
            let noise2 = (chi2 / (pixels.len() as f64 - 3.0).max(1.0)).max(0.5);
            found = Some((inverse[(2, 2)] * noise2, linear[1], noise2.sqrt()));
            if delta.abs() < 5e-3 || place.abs() > MOST_STEP_PX {
                break;
            }
        }
        let Some((variance, step, noise)) = found else { continue };
        let fine = place.abs() < MOST_STEP_PX && variance < 0.25 && step.abs() > 3.0 * noise;
        if fine && best.is_none_or(|b| noise < b.3) {
            best = Some((place, variance, step, noise));
        }
    }
    best
}

/// Sums over a column's pixels for one place of the step: of its blurred form `s`, its slope `b` and the gray values `g`.
#[derive(Default)]
struct StepSums {
    n: f64,
    s: f64,
    ss: f64,
    b: f64,
    sb: f64,
    bb: f64,
    g: f64,
    sg: f64,
    bg: f64,
    gg: f64,
}

impl StepSums {
    fn of(pixels: &[(f64, f64)], place: f64) -> Self {
        let mut sums = Self { n: pixels.len() as f64, ..Self::default() };
        for (x, g) in pixels {
            let y = (x - place) / BLUR_PX;
            let (s, b) = (blur::step(y), blur::bell(y) / BLUR_PX);
            sums.s += s;
            sums.ss += s * s;
            sums.b += b;
            sums.sb += s * b;
            sums.bb += b * b;
            sums.g += g;
            sums.sg += s * g;
            sums.bg += b * g;
            sums.gg += g * g;
        }
        sums
    }

    /// Level and step by least squares.
    fn level_and_step(&self) -> Option<[f64; 2]> {
        let h = Matrix2::new(self.n + 1e-9, self.s, self.s, self.ss + 1e-3);
        let solved = h.try_inverse()? * Vector2::new(self.g, self.sg);
        Some([solved[0], solved[1]])
    }

    /// Those of (level, step, place) about a level and a step, and the sum of the squared residuals.
    fn normal_equations(&self, [level, step]: [f64; 2]) -> (Matrix3<f64>, Vector3<f64>, f64) {
        let h = Matrix3::new(
            self.n,
            self.s,
            -step * self.b,
            self.s,
            self.ss,
            -step * self.sb,
            -step * self.b,
            -step * self.sb,
            step * step * self.bb,
        );
        let (rest, rest_s) = (self.g - level * self.n - step * self.s, self.sg - level * self.s - step * self.ss);
        let rest_b = self.bg - level * self.b - step * self.sb;
        let chi2 = self.gg - level * (self.g + rest) - step * (self.sg + rest_s);
        (h, Vector3::new(rest, rest_s, -step * rest_b), chi2.max(0.0))
    }
}
