//! The plane of a plate's stripes, from all of its pixels.

use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, Vector2};
use protocol::angle::{difference, wrap};

use super::super::look::MAX_RINGS;
use super::super::rays::{PixelRay, Sample};
use super::super::rings::{self, BLUR_PX, median};
use super::{MOST_TURN_RAD, PlateFinder};

/// A column shows the stripes at this correlation.
const LEAST_CORRELATION: f64 = 0.85;
/// Median correlation of a plate's columns: what stands before it may spoil a few.
const LEAST_MEDIAN: f64 = 0.96;
/// A column's contrast is at least this share of that of its run.
const LEAST_GAIN: f64 = 0.3;
/// Least contrast over the residual noise.
const LEAST_CONTRAST: f64 = 4.0;
const ROUNDS: usize = 8;
/// Height of the camera over the peer's floor: mounting, tilt and floor together, metres.
const HEIGHT_SIGMA_M: f64 = 0.015;
/// Most pixels of a fit: a plate near at hand has more than it needs.
const MOST_PIXELS: usize = 1500;
/// A first round whose stripes correlate less is not worth a second.
const HOPELESS: f64 = 0.65;
const LEAST_COLUMNS: usize = 4;
/// A column counts half from which its rest is so many times what is usual, squared: the border of something else is in it.
const STRAY: f64 = 3.0;
/// What the bend is a priori, cylinders of the plate's width.
const BEND_FREE: f64 = 3.0;
/// A plate bends less than this beside noise, cylinders of its width.
const FLAT: f64 = 0.12;

impl PlaneFit {
    /// Whether it may be flat.
    pub(super) fn is_flat(&self) -> bool {
        let [bend, sigma] = self.bend;
        bend.abs() <= FLAT + 5.0 * sigma
    }

    /// By how much χ² a cylinder of its width fits worse than a plane.
    pub(super) fn flat_chi2(&self) -> f64 {
        let [bend, sigma] = self.bend;
        (1.0 - 2.0 * bend) / (sigma * sigma + FLAT * FLAT / 4.0)
    }
}

/// A vertical plane cosα·x + sinα·y = c, the observer at its near side.
#[derive(Debug, Clone, Copy)]
pub(super) struct Plane {
    pub(super) alpha: f64,
    pub(super) c: f64,
    pub(super) lower_m: f64,
}

impl Plane {
    /// Along the floor from a ray's origin, and the height there.
    pub(super) fn meet(&self, ray: &PixelRay) -> (f64, f64) {
        let (s, c) = self.alpha.sin_cos();
        let along = c * f64::from(ray.cosine) + s * f64::from(ray.sine);
        let from = self.c - c * f64::from(ray.origin_m[0]) - s * f64::from(ray.origin_m[1]);
        let distance = from / along.max(0.05);
        (distance, f64::from(ray.origin_m[2]) + f64::from(ray.slope) * distance)
    }

    /// Distance along a bearing from the axis.
    pub(super) fn distance(&self, bearing: f64) -> f64 {
        self.c / (bearing - self.alpha).cos().max(0.05)
    }

    /// From the foot of the normal to where a bearing meets it, metres, to the left.
    pub(super) fn along(&self, bearing: f64) -> f64 {
        self.c * (bearing - self.alpha).tan()
    }

    /// A step of (α, c) of a fit, no longer than so many radians and so large a share of the distance at a bearing: there, where the fit's
    /// pixels are, distance and turn hardly depend on each other, however long the step.
    pub(super) fn step(&mut self, bearing: f64, [by_alpha, by_c]: [f64; 2], [most_rad, most_share]: [f64; 2]) {
        let distance = self.distance(bearing);
        let farther = by_c / self.c - by_alpha * difference(bearing, self.alpha).tan();
        self.alpha += by_alpha.clamp(-most_rad, most_rad);
        let distance = distance * (1.0 + farther.clamp(-most_share, most_share));
        self.c = distance * difference(bearing, self.alpha).cos().max(0.05);
    }

    /// Bearing of what is so much further to the left in the plane than what a bearing meets.
    pub(super) fn beside(&self, bearing: f64, left_m: f64) -> f64 {
        wrap(self.alpha + (self.along(bearing) + left_m).atan2(self.c))
    }
}

#[derive(Clone)]
pub(super) struct PlaneFit {
    pub(super) plane: Plane,
    /// Of (α, c, height), metres and radians.
    pub(super) covariance: Matrix3<f64>,
    pub(super) noise: f64,
    /// −1 where it is the back.
    pub(super) sign: f64,
    /// Bearings between which columns show the stripes: right, left.
    pub(super) seen_rad: [f64; 2],
    pub(super) correlation: f64,
    pub(super) gain: f64,
    /// Gray level of black over that of white less that of black.
    pub(super) black: f64,
    /// How much it bends away at its sides as a share of what a cylinder of its width does, and the standard deviation.
    pub(super) bend: [f64; 2],
    /// Of an upper end, by how many pixels (RMS) its columns are elsewhere, noise taken out.
    pub(super) stray_px: f64,
}

impl PlaneFit {
    /// Covariance of (α, c) where these are right to so much when noise has averaged out.
    pub(super) fn with_floors(&self, turn_rad: f64, c_m: f64) -> Matrix2<f64> {
        self.covariance.fixed_view::<2, 2>(0, 0) + Matrix2::from_diagonal(&Vector2::new(turn_rad * turn_rad, c_m * c_m))
    }

    /// Bearing of the middle of what is seen.
    pub(super) fn middle_rad(&self) -> f64 {
        let [right, left] = self.seen_rad;
        wrap(right + 0.5 * difference(left, right))
    }
}

/// Unknowns of a plate (α, c, height, bend) and entries of a column's sums: one, the profile, its derivatives, gray.
const UNKNOWNS: usize = 4;
const N: usize = UNKNOWNS + 3;
const GRAY: usize = N - 1;
pub(super) type Sums = SMatrix<f64, N, N>;

impl PlateFinder {
    /// The pixels that may show a plate near a bearing at about a distance.
    pub(super) fn few(&self, samples: &[Sample], bearing: f64, distance: f64) -> Vec<Sample> {
        let reach = (self.look.width_m / distance).atan() + 0.05;
        let is_about = |s: &&Sample| {
            let height = f64::from(s.ray.origin_m[2]) + f64::from(s.ray.slope) * distance;
            let spread = f64::from(s.ray.slope).abs() * (0.15 * distance + 0.6 * self.look.width_m);
            difference(f64::from(s.ray.bearing_rad), bearing).abs() < reach
                && height + spread > self.pillar.low_m()
                && height - spread < self.pillar.high_m()
        };
        let about: Vec<Sample> = samples.iter().filter(is_about).copied().collect();
        let every = about.len().div_ceil(MOST_PIXELS).max(1);
        about.into_iter().step_by(every).collect()
    }

    /// The plane of the stripes near a bearing.
    pub(super) fn fit(&self, samples: &[Sample], start: Plane, bearing: f64) -> Option<PlaneFit> {
        let mut plane = start;
        let scale = samples.first().map(|s| f64::from(s.ray.px_per_bearing))?;
        let reach = (self.look.width_m / plane.distance(bearing)).atan() + 0.05;
        let wide = (1.0 / scale).max(reach / 60.0);
        let count = (2.0 * reach / wide).ceil() as usize;
        let mut fitted = None;
        for round in 0..ROUNDS {
            let blur_px = if round < 2 { BLUR_PX.hypot(1.4) } else { BLUR_PX };
            let grams = self.sums(samples, &plane, bearing, reach, wide, count, blur_px);
            let mut shown = shown(&grams, self.noise2, if round < 2 { 0.25 } else { 0.0 });
            let (first, last, sign) = clear_run(&mut shown, bearing_column(reach, wide))?;
            let (mut h, mut g) = (SMatrix::<f64, UNKNOWNS, UNKNOWNS>::zeros(), SVector::<f64, UNKNOWNS>::zeros());
            let (mut rest2, mut dof, mut correlation, mut used) = (0.0, 0.0, 0.0, 0);
            let (mut gains, mut correlations, mut blacks) = (Vec::new(), Vec::new(), Vec::new());
            let darkest = self.darkest(sign);
            let columns: Vec<Column> = columns(&grams, &shown, first..=last, sign).collect();
            let variances = columns.iter().map(|column| column.rest2 / column.dof());
            let stray2 = STRAY * median(&mut variances.collect::<Vec<_>>()).max(0.25);
            for column in &columns {
                let Column { gram, correlation: own, gain, rest2: column_rest2 } = *column;
                let n = gram[(0, 0)];
                let weight = 1.0 / (1.0 + (column_rest2 / column.dof() / stray2).powi(2));
                let pp = gram[(1, 1)] - gram[(0, 1)].powi(2) / n;
                let free = |i: usize, j: usize| {
                    let pi = gram[(1, i)] - gram[(0, 1)] * gram[(0, i)] / n;
                    let pj = gram[(1, j)] - gram[(0, 1)] * gram[(0, j)] / n;
                    gram[(i, j)] - gram[(0, i)] * gram[(0, j)] / n - pi * pj / pp
                };
                for i in 0..UNKNOWNS {
                    for j in 0..UNKNOWNS {
                        h[(i, j)] += weight * gain * gain * free(2 + i, 2 + j);
                    }
                    g[i] += weight * gain * free(2 + i, GRAY);
                }
                rest2 += weight * column_rest2;
                dof += weight * column.dof();
                correlation += own.abs();
                used += 1;
                gains.push(gain.abs());
                blacks.push(black(gram, gain, darkest));
                correlations.push(own.abs());
            }
            if used < LEAST_COLUMNS || dof < 8.0 || correlation < HOPELESS * used as f64 {
                return None;
            }
            let noise2 = (rest2 / dof).max(0.25);
            let priors = [(0, 0.0, 0.6), (1, 0.0, 0.3 * plane.c), (2, -plane.lower_m, HEIGHT_SIGMA_M)];
            for (k, value, sigma) in priors {
                h[(k, k)] += noise2 / (sigma * sigma);
                g[k] += noise2 * value / (sigma * sigma);
            }
            let bend = bend(h, g, noise2)?;
            // A plate is flat: what bends is held while the plane is fitted.
            let inverse = h.fixed_view::<3, 3>(0, 0).into_owned().try_inverse()?;
            let delta = inverse * g.fixed_rows::<3>(0);
            plane.step(bearing, [delta[0], delta[1]], [0.25, 0.08]);
            plane.lower_m += delta[2].clamp(-0.02, 0.02);
            let drift = plane.distance(bearing) / start.distance(bearing);
            let turn = difference(plane.alpha, bearing).abs();
            if !(plane.c > 0.15 && (0.7..1.4).contains(&drift) && turn < MOST_TURN_RAD + 0.1) {
                return None;
            }
            let at = |column: usize| wrap(bearing - reach + (column as f64 + 0.5) * wide);
            fitted = Some(PlaneFit {
                plane,
                covariance: inverse * noise2,
                noise: noise2.sqrt(),
                sign,
                seen_rad: [at(first), at(last)],
                correlation: median(&mut correlations),
                gain: median(&mut gains),
                black: median(&mut blacks),
                bend,
                stray_px: 0.0,
            });
        }
        fitted.filter(|f| f.correlation > LEAST_MEDIAN && f.gain > LEAST_CONTRAST * f.noise)
    }

    /// Which reflectance of the front is black on the side of a sign.
    pub(super) fn darkest(&self, sign: f64) -> f64 {
        if sign > 0.0 { 0.0 } else { 2.0 * self.pillar.middle_reflectance() }
    }

    /// Sums over (1, profile, d/dα, d/dc, d/dlower, d/dbend, gray) by column.
    #[allow(clippy::too_many_arguments)]
    pub(super) fn sums(
        &self,
        samples: &[Sample],
        plane: &Plane,
        bearing: f64,
        reach: f64,
        wide: f64,
        count: usize,
        blur_px: f64,
    ) -> Vec<Sums> {
        let look = &self.pillar;
        let mut grams = vec![Sums::zeros(); count];
        let mut by_ring = [0.0; MAX_RINGS];
        let turned = Plane { alpha: plane.alpha + 1e-4, ..*plane };
        let farther = Plane { c: plane.c * 1.0001, ..*plane };
        for sample in samples {
            let aside = difference(f64::from(sample.ray.bearing_rad), bearing);
            if aside.abs() >= reach {
                continue;
            }
            let (distance, height) = plane.meet(&sample.ray);
            let m_per_px = sample.ray.m_per_px(distance);
            let height_m = height + plane.lower_m;
            let margin = 2.4 * BLUR_PX * m_per_px;
            if height_m < look.low_m() + margin || height_m > look.high_m() - margin {
                continue;
            }
            let blur_m = blur_px * m_per_px;
            let mut value = |z: f64| rings::profile(look, &look.reflectance, z, blur_m, &mut by_ring);
            let here = value(height_m);
            let up = 0.05 * m_per_px;
            let by_height = (value(height_m + up) - value(height_m - up)) / (2.0 * up);
            let row = SVector::<f64, N>::from([
                1.0,
                here,
                by_height * (turned.meet(&sample.ray).1 - height) / 1e-4,
                by_height * (farther.meet(&sample.ray).1 - height) / (plane.c * 1e-4),
                by_height,
                // About the plane's middle; where that is, turn and distance make up for.
                by_height * f64::from(sample.ray.slope) * (distance * aside.sin()).powi(2) / self.look.width_m,
                sample.gray,
            ]);
            grams[(((aside + reach) / wide) as usize).min(count - 1)] += row * row.transpose();
        }
        grams
    }
}

/// The bend let go beside the plane.
fn bend(mut h: SMatrix<f64, UNKNOWNS, UNKNOWNS>, g: SVector<f64, UNKNOWNS>, noise2: f64) -> Option<[f64; 2]> {
    h[(3, 3)] += noise2 / (BEND_FREE * BEND_FREE);
    let inverse = h.try_inverse()?;
    Some([(inverse * g)[3], (inverse[(3, 3)] * noise2).sqrt()])
}

/// A column that shows stripes.
struct Column<'a> {
    gram: &'a Sums,
    correlation: f64,
    gain: f64,
    /// Squared grey levels by which its pixels are apart from stripes of its own light, in all.
    rest2: f64,
}

impl Column<'_> {
    /// Of the rest: level and gain are the column's own.
    fn dof(&self) -> f64 {
        self.gram[(0, 0)] - 2.0
    }
}

/// The columns of a run that show stripes of its sign.
fn columns<'a>(
    grams: &'a [Sums],
    shown: &'a [Option<(f64, f64)>],
    run: std::ops::RangeInclusive<usize>,
    sign: f64,
) -> impl Iterator<Item = Column<'a>> {
    grams[run.clone()].iter().zip(&shown[run]).filter_map(move |(gram, column)| {
        let (correlation, gain) = column.filter(|(correlation, _)| correlation * sign > 0.0)?;
        let free = |i: usize, j: usize| gram[(i, j)] - gram[(0, i)] * gram[(0, j)] / gram[(0, 0)];
        let rest2 = (free(GRAY, GRAY) - free(1, GRAY).powi(2) / free(1, 1)).max(0.0);
        Some(Column { gram, correlation, gain, rest2 })
    })
}

fn bearing_column(reach: f64, wide: f64) -> usize {
    (reach / wide) as usize
}

/// Gray level of black over white's less black's in a column.
pub(super) fn black(gram: &Sums, gain: f64, darkest: f64) -> f64 {
    ((gram[(0, GRAY)] - gain * gram[(0, 1)]) / gram[(0, 0)] + gain * darkest) / gain.abs()
}

/// Whether a column has pixels of different stripes.
pub(super) fn shows_edge(gram: &Sums) -> bool {
    let n = gram[(0, 0)];
    n >= 4.0 && gram[(1, 1)] - gram[(0, 1)].powi(2) / n >= 2e-3 * n
}

/// Correlation and gain of each column that shows stripes or their negative.
pub(super) fn shown(grams: &[Sums], noise2: f64, slack: f64) -> Vec<Option<(f64, f64)>> {
    grams
        .iter()
        .map(|gram| {
            let n = gram[(0, 0)];
            let pp = gram[(1, 1)] - gram[(0, 1)].powi(2) / n;
            if !shows_edge(gram) {
                return None;
            }
            let pi = gram[(1, GRAY)] - gram[(0, 1)] * gram[(0, GRAY)] / n;
            let ii = gram[(GRAY, GRAY)] - gram[(0, GRAY)].powi(2) / n;
            let correlation = pi / (pp * rings::without_noise(ii, n, noise2).max(pi * pi / pp)).sqrt();
            (correlation.abs() > LEAST_CORRELATION - slack).then_some((correlation, pi / pp))
        })
        .collect()
}

/// The longest run of columns of one sign through or near the middle.
fn run(shown: &[Option<(f64, f64)>], middle: usize) -> Option<(usize, usize, f64)> {
    let of_sign = |sign: f64| {
        let shows = |column: &Option<(f64, f64)>| column.is_some_and(|(c, _)| c * sign > 0.0);
        let places = shown.iter().enumerate().filter(|(_, column)| shows(column)).map(|(i, _)| i as f64);
        longest_run(places, 1.0).map(|(count, ends)| (count, ends.map(|end| end as usize), sign))
    };
    let runs = [1.0, -1.0].into_iter().filter_map(of_sign).filter(|(count, ..)| *count >= LEAST_COLUMNS);
    let (_, [first, last], sign) = runs.reduce(|best, run| if run.0 > best.0 { run } else { best })?;
    let slack = (last - first) / 2 + 2;
    (first <= middle + slack && last + slack >= middle).then_some((first, last, sign))
}

/// The same of the columns whose contrast is not far below that of the others in the run: where a plate ends, a wall goes on for some columns with what
/// its shade and noise have in common with stripes. What is left out is not shown.
fn clear_run(shown: &mut [Option<(f64, f64)>], middle: usize) -> Option<(usize, usize, f64)> {
    let (first, last, sign) = run(shown, middle)?;
    let of_run = shown[first..=last].iter().flatten().filter(|(correlation, _)| correlation * sign > 0.0);
    let usual = median(&mut of_run.map(|(_, gain)| gain.abs()).collect::<Vec<_>>());
    for column in shown.iter_mut() {
        *column = column.filter(|(_, gain)| gain.abs() >= LEAST_GAIN * usual);
    }
    run(shown, middle)
}

/// How many columns are in the longest run, and its ends; gaps (a mast) of up to a third of it are jumped. Places ascend, a column is so wide.
pub(super) fn longest_run(places: impl Iterator<Item = f64>, column: f64) -> Option<(usize, [f64; 2])> {
    let (mut best, mut run) = ((0, [0.0; 2]), (0, [f64::NEG_INFINITY; 2]));
    for at in places {
        let (n, [first, last]) = run;
        let is_next = at - last < column * ((n / 3).max(2) as f64 + 1.5);
        run = if is_next { (n + 1, [first, at]) } else { (1, [at; 2]) };
        if run.0 > best.0 {
            best = run;
        }
    }
    (best.0 > 0).then_some(best)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_ends_where_the_contrast_does_and_not_where_noise_happens_to_correlate() {
        let plate = |column: usize| -70.0 - column as f64;
        let mut shown: Vec<Option<(f64, f64)>> = vec![None; 10];
        shown.extend((0..20).map(|column| Some((-0.98, plate(column)))));
        // A mast, the rest of the plate in a lamp's shadow, and the wall.
        shown.extend([None; 3]);
        shown.extend([Some((-0.97, -45.0)); 4]);
        shown.extend([Some((-1.0, -5.0)); 9]);
        assert_eq!(run(&shown, 20), Some((10, 45, -1.0)));
        assert_eq!(clear_run(&mut shown, 20), Some((10, 36, -1.0)));
        assert!(shown[37..].iter().all(Option::is_none) && shown[33..37].iter().all(Option::is_some));
    }
}
