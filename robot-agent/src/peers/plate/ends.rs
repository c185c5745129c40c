//! Where a plate ends: its sides and its upper end, and that it does end there.

use std::f64::consts::FRAC_PI_2;

use nalgebra::{Matrix2, Vector2};
use protocol::angle::{difference, wrap};

use super::super::edges::{self, EdgeFit, Pixel, Side};
use super::super::look::MAX_RINGS;
use super::super::near;
use super::super::rays::Sample;
use super::super::rings::{self, BLUR_PX, median};
use super::PlateFinder;
use super::plane::{Plane, PlaneFit, shown, shows_edge};

/// The upper end is right to this, pixels, when noise has averaged out; noise may leave it so uncertain.
const END_FLOOR_PX: f64 = 0.1;
const WORST_END_PX: f64 = 0.5;
/// Its columns are so wide, and pixels so far above and below it are looked at.
const END_COLUMN_PX: f64 = 1.5;
const END_REACH_PX: [f64; 2] = [3.5, 5.0];
/// So near to the next stripe a pixel may have something of it.
const NEXT_STRIPE_PX: f64 = 0.8;
/// Each column's place is right to this at best, squared pixels; so many columns make an end.
const STEP_FLOOR_PX2: f64 = 0.01;
const LEAST_END_COLUMNS: usize = 6;
/// Share of the columns that must agree on the upper end.
const LEAST_END_AGREEMENT: f64 = 0.5;
/// In a column it is where it should be to this, pixels.
const END_PLACE_PX: f64 = 0.8;
/// Rounds in which a lone edge and the upper end settle distance and height.
const END_ROUNDS: usize = 3;
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

/// One column across the upper end.
struct EndStep {
    /// Higher than predicted, and that place's variance.
    higher_px: f64,
    variance_px2: f64,
    px_per_rad: f64,
    /// Predicted.
    distance_m: f64,
}

/// Pixels of a column about the upper end (how much higher, gray), and sums of their scales and of how far away they are predicted to be.
#[derive(Clone, Default)]
struct EndColumn {
    pixels: Vec<(f64, f64)>,
    scales: f64,
    distances_m: f64,
}

/// Where the upper end of a plate is.
struct EndFit {
    /// Higher than predicted, and the standard deviation.
    higher_px: f64,
    sigma_px: f64,
    /// Share of the columns that agree.
    agreement: f64,
    px_per_rad: f64,
    /// Of the columns that agree, predicted.
    distance_m: f64,
}

impl PlateFinder {
    /// A pixel so far inside of an end, of the paint `ring` or, on the back, of its negative.
    fn pixel(&self, fit: &PlaneFit, sample: &Sample, inside_rad: f64, px_per_rad: f64, ring: f64) -> Pixel {
        let middle = self.pillar.middle_reflectance();
        let ring = middle + fit.sign * (ring - middle);
        Pixel { gray: sample.gray, row: 0, inside_rad, px_per_rad, half_px: BESIDE_PX, ring }
    }

    /// How much further up the plate goes than it should, column by column: each has its own light, and some have a mast.
    fn end(&self, samples: &[Sample], fit: &PlaneFit) -> Option<EndFit> {
        let (steps, count) = self.end_steps(samples, fit, fit.seen_rad);
        let middle = median(&mut steps.iter().map(|step| step.higher_px).collect::<Vec<_>>());
        let is_near = |step: &&EndStep| (step.higher_px - middle).abs() < 0.4 + 3.0 * step.variance_px2.sqrt();
        let agreeing: Vec<_> = steps.iter().filter(is_near).collect();
        let weight = |step: &EndStep| 1.0 / (step.variance_px2 + STEP_FLOOR_PX2);
        let weights: f64 = agreeing.iter().map(|step| weight(step)).sum();
        let n = agreeing.len() as f64;
        (agreeing.len() >= LEAST_END_COLUMNS).then(|| EndFit {
            higher_px: agreeing.iter().map(|step| step.higher_px * weight(step)).sum::<f64>() / weights,
            sigma_px: (1.0 / weights).sqrt(),
            agreement: n / count as f64,
            px_per_rad: agreeing.iter().map(|step| step.px_per_rad).sum::<f64>() / n,
            distance_m: agreeing.iter().map(|step| step.distance_m).sum::<f64>() / n,
        })
    }

    /// Where something ends near the upper end, in each column between two bearings that shows it, and how many columns there are.
    fn end_steps(&self, samples: &[Sample], fit: &PlaneFit, [right, left]: [f64; 2]) -> (Vec<EndStep>, usize) {
        let high_m = self.pillar.high_m();
        let edges = &self.pillar.edges_m;
        let stripe_m = high_m - edges[edges.len() - 2];
        let Some(scale) = samples.first().map(|s| f64::from(s.ray.px_per_bearing)) else { return (Vec::new(), 0) };
        let count = (difference(left, right) * scale / END_COLUMN_PX) as usize;
        let mut columns = vec![EndColumn::default(); count];
        for sample in samples {
            let along = difference(f64::from(sample.ray.bearing_rad), right) * scale / END_COLUMN_PX;
            if !(0.0..count as f64).contains(&along) {
                continue;
            }
            let (distance, height) = fit.plane.meet(&sample.ray);
            let m_per_px = sample.ray.m_per_px(distance);
            let higher_px = (height + fit.plane.lower_m - high_m) / m_per_px;
            // Far away the next stripe begins sooner.
            let down_px = END_REACH_PX[1].min(stripe_m / m_per_px - NEXT_STRIPE_PX);
            if (-down_px..=END_REACH_PX[0]).contains(&higher_px) {
                let column = &mut columns[along as usize];
                column.pixels.push((higher_px, sample.gray));
                column.scales += f64::from(sample.ray.px_per_elevation);
                column.distances_m += distance;
            }
        }
        let step = |column: &EndColumn| {
            let (higher_px, variance_px2, ..) = near::step_at(&column.pixels, &[-1.5, 0.0, 1.5])?;
            let n = column.pixels.len() as f64;
            let [px_per_rad, distance_m] = [column.scales, column.distances_m].map(|sum| sum / n);
            Some(EndStep { higher_px, variance_px2, px_per_rad, distance_m })
        };
        (columns.iter().filter_map(step).collect(), count)
    }

    /// A lone edge leaves distance and height open together; with the upper end they are two of two. To which share of it the distance is known
    /// by that goes with the plane, for [`Self::with_height`]; the covariance is as it was.
    pub(super) fn with_end(
        &self,
        samples: &[Sample],
        fit: &PlaneFit,
        edge_m: f64,
        camera_height_m: f64,
    ) -> Option<(PlaneFit, f64)> {
        let [lone, top] = [edge_m, self.pillar.high_m()].map(|z| camera_height_m - z);
        // To begin with the announced heights hold, which leaves the edge where it is.
        let mut fit = PlaneFit { plane: Self::at_announced_height(fit, lone), ..fit.clone() };
        let mut share = None;
        for _ in 0..END_ROUNDS {
            let end = self.end(samples, &fit)?;
            if end.agreement < LEAST_END_AGREEMENT || end.sigma_px > WORST_END_PX {
                return None;
            }
            // Of a turned plate the columns are farther away than its plane.
            let drops = [lone, top].map(|drop| (drop + fit.plane.lower_m) / end.distance_m);
            let per_px = (1.0 + drops[1] * drops[1]) / end.px_per_rad;
            let distance_m = (lone - top) / (drops[0] - (drops[1] - end.higher_px * per_px));
            let farther = distance_m / end.distance_m;
            if !(farther > 0.7 && farther < 1.4) {
                return None;
            }
            fit.plane.c *= farther;
            fit.plane.lower_m = distance_m * drops[0] - lone;
            let sigma_px = end.sigma_px.hypot(END_FLOOR_PX);
            share = Some(distance_m / (lone - top) * sigma_px * per_px);
        }
        Some((fit, share?))
    }

    /// How much farther away than fitted a plate is whose lone edge, so far below the camera, has the announced height.
    fn farther(fit: &PlaneFit, lone_m: f64) -> f64 {
        1.0 / (1.0 + fit.plane.lower_m / lone_m).max(0.5)
    }

    /// The plane in which the lone edge, so far below the camera, has the announced height.
    fn at_announced_height(fit: &PlaneFit, lone_m: f64) -> Plane {
        Plane { c: fit.plane.c * Self::farther(fit, lone_m), lower_m: 0.0, ..fit.plane }
    }

    /// The distance by the upper end (known to a share of it) and by the announced height of the lone edge, weighed; where they disagree,
    /// it is as uncertain as that says.
    pub(super) fn with_height(
        (fit, share): &(PlaneFit, f64),
        edge_m: f64,
        camera_height_m: f64,
        height_sigma_m: f64,
    ) -> PlaneFit {
        let lone = camera_height_m - edge_m;
        let farther = Self::farther(fit, lone) - 1.0;
        let variances = [share.powi(2), (height_sigma_m / lone.abs().max(1e-3)).powi(2)];
        let both = variances[0] + variances[1];
        let by = 1.0 + farther * variances[0] / both;
        let plane = Plane { c: fit.plane.c * by, lower_m: (lone + fit.plane.lower_m) * by - lone, ..fit.plane };
        let chi2 = farther * farther / both;
        let share = (variances[0] * variances[1] / both * chi2.max(1.0)).sqrt();
        PlaneFit { plane, covariance: Self::by_distance(fit, &plane, share), ..fit.clone() }
    }

    /// Covariance of (α, c) of a plane where it is the distance of what is seen that is known, to this share of it: c follows from that and α, which
    /// is known as in the fit.
    fn by_distance(fit: &PlaneFit, plane: &Plane, share: f64) -> Matrix2<f64> {
        let turn_variance = fit.covariance[(0, 0)];
        let c_by_turn = plane.along(fit.middle_rad());
        let both = c_by_turn * turn_variance;
        Matrix2::new(turn_variance, both, both, c_by_turn * both + (share * plane.c).powi(2))
    }

    /// The same where too little can be seen of the upper end because somebody hides it or what is behind it is as dark or as bright:
    /// the lone edge has the announced height, as surely as `height_sigma_m` says.
    pub(super) fn by_height(fit: &PlaneFit, edge_m: f64, camera_height_m: f64, height_sigma_m: f64) -> PlaneFit {
        let lone = camera_height_m - edge_m;
        let plane = Self::at_announced_height(fit, lone);
        let covariance = Self::by_distance(fit, &plane, height_sigma_m / lone.abs().max(1e-3));
        PlaneFit { plane, covariance, ..fit.clone() }
    }

    /// Shares of the columns between two bearings in which the upper end is where it should be, and in which one is seen elsewhere.
    pub(super) fn end_shown(&self, samples: &[Sample], fit: &PlaneFit, [right, left]: [f64; 2]) -> [f64; 2] {
        let (steps, count) = self.end_steps(samples, fit, [right, left]);
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
        let fine = edge.rows >= 2 && edge.agreement >= 0.5 && edge.sigma_rad * edge.px_per_rad < 0.5;
        fine.then(|| (wrap(at + sign * edge.outwards_rad), edge))
    }
}

/// Standard deviation of a side's bearing, and the part of it that successive frames share.
pub(super) fn side_sigma(fit: &PlaneFit, (at, edge): &(f64, EdgeFit)) -> [f64; 2] {
    let floor = (EDGE_FLOOR_PX / edge.px_per_rad).hypot(RIM_FLOOR_M / fit.plane.distance(*at));
    [edge.sigma_rad.hypot(floor), floor]
}
