//! Where a plate ends: its sides and its upper end, and that it does end there.

use nalgebra::Matrix2;
use protocol::angle::{difference, wrap};

use super::super::edges::{self, EdgeFit, Pixel, Side};
use super::super::look::MAX_RINGS;
use super::super::rays::Sample;
use super::super::rings::{self, BLUR_PX};
use super::PlateFinder;
use super::plane::{PlaneFit, shown};

/// The upper end is right to this, pixels, when noise has averaged out; noise may leave it so uncertain.
const END_FLOOR_PX: f64 = 0.1;
const WORST_END_PX: f64 = 0.5;
/// Share of the columns that must agree on the upper end.
const LEAST_END_AGREEMENT: f64 = 0.5;
/// Rounds in which a lone edge and the upper end settle distance and height.
const END_ROUNDS: usize = 3;
/// Beyond an end of the plate a further stripe is like its second to this share of their contrast, and ends with this share of
/// it; more than this share of the columns with one, and it is a taller box.
const LIKE: f64 = 0.25;
const ENDS: f64 = 0.3;
const MOST_FURTHER: f64 = 0.5;
const EDGE_FLOOR_PX: f64 = 0.06;
/// A sheet has a rim of its own, metres.
const RIM_FLOOR_M: f64 = 2e-3;
/// Columns of one picture's width looked at on either side of where the plate may end.
const BESIDE_PX: f64 = 9.0;

impl PlateFinder {
    /// A pixel so far inside of an end, of the paint `ring` or, on the back, of its negative.
    fn pixel(&self, fit: &PlaneFit, sample: &Sample, inside_rad: f64, px_per_rad: f64, ring: f64) -> Pixel {
        let middle = self.pillar.middle_reflectance();
        let ring = middle + fit.sign * (ring - middle);
        Pixel { gray: sample.gray, row: 0, inside_rad, px_per_rad, half_px: BESIDE_PX, ring }
    }

    /// How much further up the plate goes than it should.
    pub(super) fn end(&self, samples: &[Sample], fit: &PlaneFit) -> Option<EdgeFit> {
        let look = &self.pillar;
        let wide = difference(fit.seen_rad[1], fit.seen_rad[0]);
        let mut by_ring = [0.0; MAX_RINGS];
        let mut pixels = Vec::new();
        let mut places = Vec::new();
        for sample in samples {
            let along = difference(f64::from(sample.ray.bearing_rad), fit.seen_rad[0]);
            if along < 0.05 * wide || along > 0.95 * wide {
                continue;
            }
            let (distance, height) = fit.plane.meet(&sample.ray);
            let m_per_px = sample.ray.m_per_px(distance);
            let height = height + fit.plane.lower_m;
            let inside_px = (look.high_m() - height) / m_per_px;
            if !(-BESIDE_PX..=BESIDE_PX).contains(&inside_px) {
                continue;
            }
            let px_per_rad = f64::from(sample.ray.px_per_elevation);
            let paint = height.min(look.high_m() - 2.0 * BLUR_PX * m_per_px);
            let ring = rings::profile(look, &look.reflectance, paint, BLUR_PX * m_per_px, &mut by_ring);
            pixels.push(self.pixel(fit, sample, inside_px / px_per_rad, px_per_rad, ring));
            places.push(along * f64::from(sample.ray.px_per_bearing));
        }
        edges::fit_rows(pixels, &places, (fit.noise, BLUR_PX), &[-1.5, 0.0, 1.5])
    }

    /// A lone edge leaves distance and height open together; with the upper end they are two of two.
    pub(super) fn with_end(
        &self,
        samples: &[Sample],
        fit: &PlaneFit,
        edge_m: f64,
        camera_height_m: f64,
    ) -> Option<PlaneFit> {
        let mut fit = fit.clone();
        let [lone, top] = [edge_m, self.pillar.high_m()].map(|z| camera_height_m - z);
        let mut sigma_rad = None;
        for _ in 0..END_ROUNDS {
            let end = self.end(samples, &fit)?;
            let noise_px = end.sigma_rad * end.px_per_rad;
            if end.agreement < LEAST_END_AGREEMENT || noise_px > WORST_END_PX {
                return None;
            }
            let drops = [lone, top].map(|drop| (drop + fit.plane.lower_m) / fit.plane.c);
            // Outwards is upwards.
            let seen_top = drops[1] - end.outwards_rad * (1.0 + drops[1] * drops[1]);
            let c = (lone - top) / (drops[0] - seen_top);
            if !(c > 0.7 * fit.plane.c && c < 1.4 * fit.plane.c) {
                return None;
            }
            fit.plane.c = c;
            fit.plane.lower_m = c * drops[0] - lone;
            sigma_rad = Some(noise_px.hypot(END_FLOOR_PX) / end.px_per_rad);
        }
        let c_sigma = fit.plane.c * fit.plane.c / (lone - top) * sigma_rad?;
        fit.covariance = Matrix2::new(fit.covariance[(0, 0)], 0.0, 0.0, c_sigma * c_sigma);
        Some(fit)
    }

    /// Share of the columns between two bearings that show the plate's stripes.
    pub(super) fn share_of_stripes(&self, samples: &[Sample], fit: &PlaneFit, from: f64, to: f64) -> f64 {
        let Some(scale) = samples.first().map(|s| f64::from(s.ray.px_per_bearing)) else { return 0.0 };
        let reach = 0.5 * difference(to, from).abs();
        let count = ((2.0 * reach * scale) as usize).max(3);
        let wide = 2.0 * reach / count as f64;
        let grams = self.sums(samples, &fit.plane, wrap(from + reach), reach, wide, count, BLUR_PX);
        let measured = grams.iter().filter(|gram| gram[(0, 0)] >= 4.0).count();
        let goes_on = shown(&grams, 0.0)
            .iter()
            .flatten()
            .filter(|(correlation, gain)| correlation * fit.sign > 0.0 && gain.abs() > 0.3 * fit.gain)
            .count();
        goes_on as f64 / measured.max(1) as f64
    }

    /// Whether the stripes go on above or below the plate: then it is a part of something taller.
    pub(super) fn has_further_stripe(&self, samples: &[Sample], fit: &PlaneFit, ends: [f64; 2]) -> bool {
        let edges = &self.pillar.edges_m;
        let n = edges.len();
        let Some(scale) = samples.first().map(|s| f64::from(s.ray.px_per_bearing)) else { return false };
        let count = ((difference(ends[1], ends[0]) * scale) as usize).max(1);
        [[edges[n - 1], edges[n - 2], edges[n - 3]], [edges[0], edges[1], edges[2]]].iter().any(
            |[end, next, second]| {
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
                        (further_one - second).abs() < LIKE * contrast
                            && (beyond - further_one).abs() > ENDS * contrast,
                    );
                }
                all > 0 && further as f64 > MOST_FURTHER * all as f64
            },
        )
    }

    /// Heights of the edges between two stripes that the picture reaches on both sides in the plate's middle.
    pub(super) fn edges_in_view(&self, samples: &[Sample], fit: &PlaneFit, middle: f64) -> Vec<f64> {
        let heights = samples
            .iter()
            .filter(|s| difference(f64::from(s.ray.bearing_rad), middle).abs() * f64::from(s.ray.px_per_bearing) < 3.0)
            .map(|s| fit.plane.meet(&s.ray).1 + fit.plane.lower_m);
        let (low, high) = heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), z| (l.min(z), h.max(z)));
        let inner = &self.pillar.edges_m[1..self.pillar.edges_m.len() - 1];
        inner.iter().copied().filter(|edge| *edge > low + 0.02 && *edge < high - 0.02).collect()
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
