//! Where a plate ends: its sides and its upper end, and that it does end there.

use std::f64::consts::FRAC_PI_2;

use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, Vector2};
use protocol::angle::{difference, wrap};

use super::super::edges::{self, EdgeFit, Pixel, Side};
use super::super::look::MAX_RINGS;
use super::super::rays::Sample;
use super::super::rings::{self, BLUR_PX, median};
use super::plane::{Plane, PlaneFit, shown, shows_edge};
use super::{PlateFinder, TURN_FLOOR_RAD};

/// The upper end is right to this, pixels, when noise has averaged out: as a whole, and in how it is tilted, at its ends.
pub(super) const END_FLOOR_PX: f64 = 0.1;
/// From so far above and below where it should be, pixels, it is looked for in a column.
pub(super) const END_STARTS_PX: &[f64] = &[-1.5, 0.0, 1.5];
/// It must tell the plane's distance to this share.
const WORST_END_SHARE: f64 = 0.1;
/// Each column's place is right to this at best, squared pixels; so many columns make an end.
const STEP_FLOOR_PX2: f64 = 0.01;
const LEAST_END_COLUMNS: usize = 6;
/// Share of the columns that must agree on the upper end.
const LEAST_END_AGREEMENT: f64 = 0.5;
/// A column so far from the others, pixels, counts half; so far beside its noise it is something else.
const END_STRAY_PX: f64 = 0.4;
/// In a column it is where it should be to this, pixels.
const END_PLACE_PX: f64 = 0.8;
/// Rounds in which a lone edge and the upper end settle distance and height.
const END_ROUNDS: usize = 5;
/// Beyond an end of the plate a further stripe is like its second to this share of their contrast, and ends with this share of
/// it.
const LIKE: f64 = 0.25;
const ENDS: f64 = 0.3;
/// An edge is in view where the picture goes on beyond it for so much.
const BEYOND_EDGE_PX: f64 = 3.0;
/// Of a box's next face so much is looked at, metres, from so far beside the corner on, pixels, where so many columns are in view.
const FACE_M: f64 = 0.25;
const CORNER_PX: f64 = 1.5;
const LEAST_FACE_COLUMNS: usize = 3;
/// Stripes round a corner have at least this share of the plate's contrast, those beside it this.
const LEAST_FACE_GAIN: f64 = 0.15;
const LEAST_GOING_ON: f64 = 0.3;
const EDGE_FLOOR_PX: f64 = 0.06;
/// A side further than this from where it should be, pixels, is that of something else.
const MOST_MOVED_PX: f64 = 4.0;
/// A sheet has a rim of its own, metres.
const RIM_FLOOR_M: f64 = 2e-3;
/// Columns of one picture's width looked at on either side of where the plate may end.
const BESIDE_PX: f64 = 9.0;

/// Where sides are looked for beyond an end, pixels beside and beyond, and the contrast that is one, as a share of the plate's.
const BESIDE_SIDE_PX: std::ops::Range<f64> = 1.5..5.0;
const BEYOND_END_PX: std::ops::Range<f64> = 2.5..12.0;
const MOST_BEYOND: f64 = 0.25;

/// An end of a plate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum End {
    Upper,
    Lower,
}

/// What one edge between stripes tells of its plane: the turn, and the height over the distance.
struct LoneEdge {
    alpha: f64,
    /// Of the edge below the camera over the plane's distance.
    drop: f64,
    covariance: Matrix2<f64>,
    /// Of the edge below the camera, as announced.
    lone_m: f64,
}

impl LoneEdge {
    /// Of an edge at the camera's own height, which tells no distance, nothing.
    fn of(fit: &PlaneFit, lone_m: f64) -> Option<Self> {
        let drop = (lone_m + fit.plane.lower_m) / fit.plane.c;
        if !(lone_m / drop > 0.5 * fit.plane.c && lone_m / drop < 2.0 * fit.plane.c) {
            return None;
        }
        let mut edge = Self { alpha: fit.plane.alpha, drop, covariance: Matrix2::zeros(), lone_m };
        let j = edge.residual(&fit.plane).0;
        edge.covariance = j * fit.covariance * j.transpose();
        edge.covariance[(0, 0)] += TURN_FLOOR_RAD * TURN_FLOOR_RAD;
        Some(edge)
    }

    /// How (α, drop) of a plane vary with (α, c, height), and what they are short of.
    fn residual(&self, plane: &Plane) -> (SMatrix<f64, 2, 3>, Vector2<f64>) {
        let drop = (self.lone_m + plane.lower_m) / plane.c;
        let j = SMatrix::<f64, 2, 3>::new(1.0, 0.0, 0.0, 0.0, -drop / plane.c, 1.0 / plane.c);
        (j, Vector2::new(difference(self.alpha, plane.alpha), self.drop - drop))
    }

    /// The plane where its stripes are as high as announced.
    fn as_announced(&self) -> Plane {
        Plane { alpha: self.alpha, c: self.lone_m / self.drop, lower_m: 0.0 }
    }

    /// Covariance of (α, c, height) where that is known so well.
    fn covariance_as_announced(&self, sigma_m: f64) -> Matrix3<f64> {
        let by_drop = -self.lone_m / self.drop.powi(2);
        let j = Matrix3::new(1.0, 0.0, 0.0, 0.0, by_drop, 1.0 / self.drop, 0.0, 0.0, 1.0);
        let mut known = self.covariance.fixed_resize(0.0);
        known[(2, 2)] = sigma_m * sigma_m;
        j * known * j.transpose()
    }
}

impl PlateFinder {
    /// A pixel so far inside of an end, of the paint `ring` or, on the back, of its negative.
    fn pixel(&self, fit: &PlaneFit, sample: &Sample, inside_rad: f64, px_per_rad: f64, ring: f64) -> Pixel {
        let middle = self.pillar.middle_reflectance();
        let ring = middle + fit.sign * (ring - middle);
        Pixel { gray: sample.gray, row: 0, inside_rad, px_per_rad, half_px: BESIDE_PX, ring }
    }

    /// A lone edge tells the turn, and distance and height together; so does the upper end: they are four numbers for three. The height of the
    /// stripes beside the announced one is still free ([`Self::with_height`]).
    pub(super) fn with_end(
        &self,
        samples: &[Sample],
        fit: &PlaneFit,
        edge_m: f64,
        camera_height_m: f64,
    ) -> Option<PlaneFit> {
        let [lone, top] = [edge_m, self.pillar.high_m()].map(|z| camera_height_m - z);
        let edge = LoneEdge::of(fit, lone)?;
        let weight = edge.covariance.try_inverse()?;
        // To begin with the announced height holds, which leaves the edge where it is.
        let start = edge.as_announced();
        let mut fit = PlaneFit { plane: start, ..fit.clone() };
        for round in 0..END_ROUNDS {
            let (steps, count) = self.crossings(samples, &fit.plane, fit.seen_rad, END_STARTS_PX);
            let middle_px = match round {
                0 => median(&mut steps.iter().map(|step| step.higher_px).collect::<Vec<_>>()),
                _ => 0.0,
            };
            // Unknown: α, c, height, and by how much something moves the whole end and tilts it, pixels.
            let (mut h, mut g) = (SMatrix::<f64, 5, 5>::zeros(), SVector::<f64, 5>::zeros());
            let (middle_rad, half_rad) = (fit.middle_rad(), 0.5 * difference(fit.seen_rad[1], fit.seen_rad[0]));
            let plane = &mut fit.plane;
            let (j, apart) = edge.residual(plane);
            h.fixed_view_mut::<3, 3>(0, 0).copy_from(&(j.transpose() * weight * j));
            g.fixed_rows_mut::<3>(0).copy_from(&(j.transpose() * weight * apart));
            h[(3, 3)] = END_FLOOR_PX.powi(-2);
            h[(4, 4)] = END_FLOOR_PX.powi(-2);
            let mut agreeing = 0;
            for step in &steps {
                let (distance, rise_m) = (plane.distance(step.bearing_rad), -(top + plane.lower_m));
                let px_per_m = step.px_per_rad * distance / distance.hypot(rise_m).powi(2);
                let rise = rise_m * px_per_m;
                // How much lower than predicted the end is then.
                let row = SVector::<f64, 5>::new(
                    rise * (step.bearing_rad - plane.alpha).tan(),
                    -rise / plane.c,
                    -px_per_m,
                    1.0,
                    difference(step.bearing_rad, middle_rad) / half_rad,
                );
                let away_px = (step.higher_px - middle_px).abs();
                let stray = away_px / END_STRAY_PX.hypot(step.variance_px2.sqrt());
                let weight = 1.0 / (step.variance_px2 + STEP_FLOOR_PX2) / (1.0 + stray * stray);
                agreeing += usize::from(away_px < END_STRAY_PX + 3.0 * step.variance_px2.sqrt());
                h += weight * row * row.transpose();
                g += weight * row * step.higher_px;
            }
            // At first their turn may be wrong.
            let wanted = if round == 0 { 0.0 } else { LEAST_END_AGREEMENT * count as f64 };
            if agreeing < LEAST_END_COLUMNS || (agreeing as f64) < wanted {
                return None;
            }
            let inverse = h.try_inverse()?;
            let delta = inverse * g;
            plane.step(middle_rad, [delta[0], delta[1]], [0.25, 0.3]);
            plane.lower_m += delta[2];
            // The number too many is the turn: as they disagree about that all is uncertain.
            let short = edge.residual(plane).1[0];
            let chi2 = short * short / (edge.covariance[(0, 0)] - inverse[(0, 0)]).max(1e-12);
            fit.covariance = inverse.fixed_view::<3, 3>(0, 0) * chi2.max(1.0);
            let farther = fit.plane.distance(fit.middle_rad()) / start.distance(fit.middle_rad());
            if !(farther > 0.7 && farther < 1.4) {
                return None;
            }
            if round == 1 {
                fit.seen_rad = self.stripes_or_end(samples, &fit);
            }
        }
        (fit.covariance[(1, 1)].sqrt() < WORST_END_SHARE * fit.plane.c).then_some(fit)
    }

    /// The stripes are as high as announced, as surely as `height_sigma_m` says; where that disagrees, all is as uncertain as it disagrees.
    pub(super) fn with_height(fit: &PlaneFit, height_sigma_m: f64) -> PlaneFit {
        let PlaneFit { plane, covariance, .. } = fit;
        let variance = covariance[(2, 2)] + height_sigma_m * height_sigma_m;
        let gain = covariance.column(2) / variance;
        let chi2 = plane.lower_m * plane.lower_m / variance;
        let by = -gain * plane.lower_m;
        let plane = Plane { alpha: plane.alpha + by[0], c: plane.c + by[1], lower_m: plane.lower_m + by[2] };
        let covariance = (covariance - gain * gain.transpose() * variance) * chi2.max(1.0);
        PlaneFit { plane, covariance, ..fit.clone() }
    }

    /// The same where too little can be seen of the upper end because somebody hides it or what is behind it is as dark or as bright:
    /// the lone edge has the announced height, as surely as `height_sigma_m` says.
    pub(super) fn by_height(
        fit: &PlaneFit,
        edge_m: f64,
        camera_height_m: f64,
        height_sigma_m: f64,
    ) -> Option<PlaneFit> {
        let edge = LoneEdge::of(fit, camera_height_m - edge_m)?;
        Some(PlaneFit {
            plane: edge.as_announced(),
            covariance: edge.covariance_as_announced(height_sigma_m),
            ..fit.clone()
        })
    }

    /// Shares of the columns between two bearings in which the upper end is where it should be, and in which one is seen elsewhere.
    pub(super) fn end_shown(&self, samples: &[Sample], fit: &PlaneFit, [right, left]: [f64; 2]) -> [f64; 2] {
        let (steps, count) = self.crossings(samples, &fit.plane, [right, left], END_STARTS_PX);
        let there = steps.iter().filter(|step| step.higher_px.abs() < END_PLACE_PX).count();
        [there, steps.len() - there].map(|n| n as f64 / count.max(1) as f64)
    }

    /// Share of the columns between two bearings that show the plate's stripes.
    pub(super) fn share_of_stripes(&self, samples: &[Sample], fit: &PlaneFit, from: f64, to: f64) -> f64 {
        let Some(scale) = samples.first().map(|s| f64::from(s.ray.px_per_bearing)) else { return 0.0 };
        let reach = 0.5 * difference(to, from).abs();
        let count = ((2.0 * reach * scale) as usize).max(3);
        let wide = 2.0 * reach / count as f64;
        let grams = self.sums(samples, &fit.plane, wrap(from + reach), reach, wide, count, BLUR_PX);
        // Near at hand some columns show one stripe alone.
        let measured = grams.iter().filter(|gram| shows_edge(gram)).count();
        let goes_on = shown(&grams, self.noise2, 0.0)
            .iter()
            .flatten()
            .filter(|(correlation, gain)| correlation * fit.sign > 0.0 && gain.abs() > LEAST_GOING_ON * fit.gain)
            .count();
        goes_on as f64 / measured.max(1) as f64
    }

    /// In which share of the columns of a next face the stripes go on round a corner, as a box's do; the larger of both sides.
    pub(super) fn corner(&self, samples: &[Sample], fit: &PlaneFit, [right, left]: [f64; 2]) -> f64 {
        let Some(scale) = samples.first().map(|s| f64::from(s.ray.px_per_bearing)) else { return 0.0 };
        let (sin, cos) = fit.plane.alpha.sin_cos();
        let share = |(at, outside): (f64, f64)| {
            // The next face goes straight back from the corner; it is in view where the observer is on its outer side.
            let corner = Vector2::new(at.cos(), at.sin()) * fit.plane.distance(at);
            let c = outside * (cos * corner.y - sin * corner.x);
            let back = corner + Vector2::new(cos, sin) * FACE_M;
            let wide = difference(back.y.atan2(back.x), at).abs() - CORNER_PX / scale;
            let count = (wide * scale) as usize;
            if c <= 0.02 || count < LEAST_FACE_COLUMNS {
                return 0.0;
            }
            let alpha = wrap(fit.plane.alpha + outside * FRAC_PI_2);
            let face = Plane { alpha, c, lower_m: fit.plane.lower_m };
            let reach = 0.5 * wide;
            let middle = wrap(at - outside * (CORNER_PX / scale + reach));
            let grams = self.sums(samples, &face, middle, reach, wide / count as f64, count, BLUR_PX);
            let measured = grams.iter().filter(|gram| shows_edge(gram)).count();
            let shown = shown(&grams, self.noise2, 0.1);
            let is_alike = |(c, gain): &&(f64, f64)| c * fit.sign > 0.0 && gain.abs() > LEAST_FACE_GAIN * fit.gain;
            let alike = shown.iter().flatten().filter(is_alike).count();
            if measured < LEAST_FACE_COLUMNS { 0.0 } else { alike as f64 / measured as f64 }
        };
        [(right, 1.0), (left, -1.0)].into_iter().map(share).fold(0.0, f64::max)
    }

    /// How many of the sides go on beyond an end: then it is the border of a stripe of something taller.
    pub(super) fn sides_beyond(&self, samples: &[Sample], fit: &PlaneFit, sides: [f64; 2], end: End) -> usize {
        let goes_on = |side: &f64| {
            let mut sums = [[0.0f64; 2]; 2];
            for sample in samples {
                let aside_px =
                    difference(f64::from(sample.ray.bearing_rad), *side) * f64::from(sample.ray.px_per_bearing);
                let (distance, height) = fit.plane.meet(&sample.ray);
                let height = height + fit.plane.lower_m;
                let beyond_m = match end {
                    End::Upper => height - self.pillar.high_m(),
                    End::Lower => self.pillar.low_m() - height,
                };
                let beyond_px = beyond_m / sample.ray.m_per_px(distance);
                if BESIDE_SIDE_PX.contains(&aside_px.abs()) && BEYOND_END_PX.contains(&beyond_px) {
                    let sum = &mut sums[usize::from(aside_px > 0.0)];
                    *sum = [sum[0] + sample.gray, sum[1] + 1.0];
                }
            }
            let [right, left] = sums.map(|[sum, n]| sum / n);
            (right - left).abs() > (MOST_BEYOND * fit.gain).max(2.0 * self.noise2.sqrt())
        };
        sides.iter().filter(|side| goes_on(side)).count()
    }

    /// In which share of the columns the stripes go on above or below the plate, as a part's of something taller do.
    pub(super) fn further_stripe(&self, samples: &[Sample], fit: &PlaneFit, ends: [f64; 2]) -> f64 {
        let edges = &self.pillar.edges_m;
        let n = edges.len();
        let Some(scale) = samples.first().map(|s| f64::from(s.ray.px_per_bearing)) else { return 0.0 };
        let count = ((difference(ends[1], ends[0]) * scale) as usize).max(1);
        let upper = (End::Upper, [edges[n - 1], edges[n - 2], edges[n - 3]]);
        let lower = (End::Lower, [edges[0], edges[1], edges[2]]);
        let share = |(which, [end, next, second]): (End, [f64; 3])| {
            let high = end - next;
            // By column: the last stripe, the second last, where a further one would be, and what is beyond that.
            let mut columns = vec![[[0.0f64; 2]; 4]; count];
            for sample in samples {
                let along = difference(f64::from(sample.ray.bearing_rad), ends[0]) * scale;
                if !(0.0..count as f64).contains(&along) {
                    continue;
                }
                let height = fit.plane.meet(&sample.ray).1 + fit.plane.lower_m;
                let part = if (height - next) * high < 0.0 {
                    // The second last may have another height.
                    let share = (height - next) / (second - next);
                    if (0.2..0.8).contains(&share) { 1 } else { continue }
                } else {
                    let share = (height - next) / high;
                    if !(0.2..0.8).contains(&(share - share.floor())) || share >= 3.0 {
                        continue;
                    }
                    [0, 2, 3][share as usize]
                };
                let cell = &mut columns[along as usize][part];
                cell[0] += sample.gray;
                cell[1] += 1.0;
            }
            let measured = columns.iter().filter(|c| c.iter().all(|cell| cell[1] > 0.0));
            let (mut all, mut further) = (0usize, 0usize);
            for column in measured {
                let [last, second, further_one, beyond] = column.map(|[sum, n]| sum / n);
                let contrast = (second - last).abs();
                all += 1;
                further += usize::from(
                    (further_one - second).abs() < LIKE * contrast && (beyond - further_one).abs() > ENDS * contrast,
                );
            }
            // A wall may be as bright as a stripe, but it does not end where the plate does.
            let goes_on = further > 0 && self.sides_beyond(samples, fit, ends, which) > 0;
            if goes_on { further as f64 / all as f64 } else { 0.0 }
        };
        share(upper).max(share(lower))
    }

    /// Heights of the edges between two stripes that the picture reaches on both sides in the middle of what shows stripes.
    pub(super) fn edges_in_view(&self, samples: &[Sample], fit: &PlaneFit) -> Vec<f64> {
        let middle = fit.middle_rad();
        let (mut low, mut high, mut margin) = (f64::INFINITY, f64::NEG_INFINITY, 0.0f64);
        for sample in samples {
            let aside = difference(f64::from(sample.ray.bearing_rad), middle);
            if aside.abs() * f64::from(sample.ray.px_per_bearing) >= 3.0 {
                continue;
            }
            let (distance, height) = fit.plane.meet(&sample.ray);
            (low, high) = (low.min(height + fit.plane.lower_m), high.max(height + fit.plane.lower_m));
            margin = margin.max(BEYOND_EDGE_PX * sample.ray.m_per_px(distance));
        }
        let inner = &self.pillar.edges_m[1..self.pillar.edges_m.len() - 1];
        inner.iter().copied().filter(|edge| *edge > low + margin && *edge < high - margin).collect()
    }

    /// Bearing of one side of the plate, near `at`.
    pub(super) fn side(&self, samples: &[Sample], fit: &PlaneFit, side: Side, at: f64) -> Option<(f64, EdgeFit)> {
        let look = &self.pillar;
        let sign = if side == Side::Left { 1.0 } else { -1.0 };
        let mut by_ring = [0.0; MAX_RINGS];
        let mut pixels = Vec::new();
        let mut places = Vec::new();
        for sample in samples {
            let px_per_rad = f64::from(sample.ray.px_per_bearing);
            let inside_rad = -sign * difference(f64::from(sample.ray.bearing_rad), at);
            if (inside_rad * px_per_rad).abs() > BESIDE_PX {
                continue;
            }
            let (distance, height) = fit.plane.meet(&sample.ray);
            let blur_m = BLUR_PX * sample.ray.m_per_px(distance);
            let height = height + fit.plane.lower_m;
            if height < look.low_m() + 2.0 * blur_m || height > look.high_m() - 2.0 * blur_m {
                continue;
            }
            let ring = rings::profile(look, &look.reflectance, height, blur_m, &mut by_ring);
            pixels.push(self.pixel(fit, sample, inside_rad, px_per_rad, ring));
            places.push(sample.ray.elevation_px());
        }
        let edge = edges::fit_rows(pixels, &places, (fit.noise, BLUR_PX), &[-3.0, -1.5, 0.0, 1.5, 3.0])?;
        let [sigma_px, moved_px] = [edge.sigma_rad, edge.outwards_rad.abs()].map(|rad| rad * edge.px_per_rad);
        let fine = edge.rows >= 2 && edge.agreement >= 0.5 && sigma_px < 0.5 && moved_px < MOST_MOVED_PX;
        fine.then(|| (wrap(at + sign * edge.outwards_rad), edge))
    }
}

/// Standard deviation of a side's bearing, and the part of it that successive frames share.
pub(super) fn side_sigma(fit: &PlaneFit, (at, edge): &(f64, EdgeFit)) -> [f64; 2] {
    let floor = (EDGE_FLOOR_PX / edge.px_per_rad).hypot(RIM_FLOOR_M / fit.plane.distance(*at));
    [edge.sigma_rad.hypot(floor), floor]
}
