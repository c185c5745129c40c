//! A plate so near that at most a corner of its second stripe is in view: measured by its upper end.
//!
//! Problem: below 0.8 m a camera at 0.6 m sees one stripe of a plate, and stripes are what it is found by. Insight: the upper end
//! is a straight level line of announced height, whose place in each column gives the plane as stripes do; it must end on both
//! sides in upright edges just as far apart as the plate is wide. Algorithm: what was found by its line (`super::line`) is fitted
//! column by column. Where a corner of the second stripe is in view it must be the announced one, and says which side one looks at.
//! Where none is, front and back look alike and doors look like either (one in 370 rooms): such plates are taken only very near,
//! where everything fits better than it need, and are put midway between what front and back would mean.

use nalgebra::{Matrix2, Matrix3, Matrix4, Vector3, Vector4};
use protocol::angle::{difference, wrap};

use super::super::near;
use super::super::rays::Sample;
use super::super::rings::{BLUR_PX, median};
use super::ends::{END_FLOOR_PX, END_STARTS_PX};
use super::plane::{Plane, PlaneFit, black, longest_run, shown, shows_edge};
use super::{PlateFinder, Posed};

/// Columns of the fit: so many at most, so wide at least, pixels.
const MOST_COLUMNS: f64 = 80.0;
const COLUMN_PX: f64 = 1.5;
/// A column is in view with so many pixels.
const LEAST_PIXELS: usize = 4;
/// So far above and below the line a column is looked at, pixels.
const REACH_PX: [f64; 2] = [3.5, 5.0];
/// So near to the next stripe a pixel may have something of it.
const NEXT_STRIPE_PX: f64 = 0.8;
const ROUNDS: usize = 6;
/// Least columns and share of them that agree.
const LEAST_COLUMNS: usize = 10;
const LEAST_AGREEING: f64 = 0.4;
/// A column that is as near to the line as this agrees, round by round; from so far on it counts less. Pixels.
const GATES_PX: [f64; ROUNDS] = [1.5, 1.5, 0.9, 0.6, 0.6, 0.6];
const STRAY_PX: f64 = 0.3;
/// The line is straight and level to this, pixels.
const LINE_FLOOR_PX: f64 = 0.05;
/// What a line is worth beside stripes: where both are to be had, stripes are taken.
const CORRELATION: f64 = 0.97;
/// The line is looked for so far beside where it was searched for, as a share of its width; a column of it has this share of its usual step.
const MOST_ASIDE: f64 = 0.3;
const LIKE_STEP: f64 = 0.25;
/// A line that bends by more than this beside four sigmas is a cylinder's or none, cylinders of the plate's width.
const STRAIGHT: f64 = 0.06;
/// So many columns must show two stripes: without, chairs, boxes and doors are taken for plates.
const DECIDING_COLUMNS: usize = 5;
/// A side is seen by at least this share of them: a mast before the plate may hide the others.
const LEAST_SAME_SIDE: f64 = 0.4;
/// With one stripe in view a robot, midway between what front and back would mean, must be within these bounds (nearer than 0.6 m from
/// axis to axis are none), metres. A turned plate's plane is nearer.
const EITHER_SIDE_M: std::ops::Range<f64> = 0.5..1.0;
/// Paint is as even as this share of the contrast, or as noise; looked at so far from its borders, in so many pixels at least.
const UNEVEN: f64 = 0.2;
const PAINT_MARGIN_PX: f64 = 2.5;
const LEAST_PAINT: f64 = 60.0;
/// Its sides are measured as the front's and as the back's: the place is no better than this, metres.
const EITHER_SIDE_SIGMA_M: f64 = 0.012;
/// The line goes on beyond a side in columns where its place is as near as this.
const GOES_ON_PX: f64 = 0.6;

/// Which side of a plate shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum SideShown {
    /// By this share of the columns that could tell.
    By {
        /// 1: the front, −1: the back.
        sign: f64,
        share: f64,
        /// Gray level of black over white's less black's.
        black: f64,
    },
    /// Too few columns tell.
    Unseen,
    /// Something else shows.
    Neither,
}

/// Pixels of a column about the line (how much higher, gray), and sums of their bearings and scales.
#[derive(Clone, Default)]
struct Column {
    pixels: Vec<(f64, f64)>,
    along: f64,
    scale: f64,
}

/// One column across the line.
pub(super) struct Crossing {
    pub(super) bearing_rad: f64,
    /// Than predicted, and that place's variance.
    pub(super) higher_px: f64,
    pub(super) variance_px2: f64,
    step: f64,
    noise: f64,
    pub(super) px_per_rad: f64,
}

impl PlateFinder {
    /// The plane of an upper end near a bearing. `rise_m`: of the end above the camera.
    pub(super) fn fit_rim(&self, samples: &[Sample], start: Plane, bearing: f64, rise_m: f64) -> Option<PlaneFit> {
        let mut plane = start;
        let half = 0.5 * self.look.width_m;
        let mut fitted = None;
        for (round, gate_px) in GATES_PX.into_iter().enumerate() {
            let middle = plane.along(bearing);
            let [right, left] =
                [-0.96, 0.96].map(|share| wrap(plane.alpha + ((middle + share * half) / plane.c).atan()));
            let starts: &[f64] = if round < 2 { END_STARTS_PX } else { &[0.0] };
            let (crossings, asked) = self.crossings(samples, &plane, [right, left], starts);
            let up = crossings.iter().filter(|c| c.step > 0.0).count();
            let is_up = 2 * up >= crossings.len();
            let one_sign = || crossings.iter().filter(|c| (c.step > 0.0) == is_up);
            let centre = match round {
                0 | 1 => median(&mut one_sign().map(|c| c.higher_px).collect::<Vec<_>>()),
                _ => 0.0,
            };
            let agreeing: Vec<&Crossing> = one_sign().filter(|c| (c.higher_px - centre).abs() < gate_px).collect();
            if agreeing.len() < LEAST_COLUMNS || (agreeing.len() as f64) < LEAST_AGREEING * asked as f64 {
                return None;
            }
            let elevation = |alpha: f64, c: f64, bend: f64, at: f64| {
                let along = c * (at - alpha).tan() - middle;
                let farther = bend * along * along / self.look.width_m;
                rise_m.atan2(c / (at - alpha).cos().max(0.05) + farther)
            };
            let (mut h, mut g, mut chi2, mut squares) = (Matrix4::zeros(), Vector4::zeros(), 0.0, 0.0);
            h[(2, 2)] = END_FLOOR_PX.powi(-2);
            for crossing in &agreeing {
                let (alpha, c, at) = (plane.alpha, plane.c, crossing.bearing_rad);
                let here = elevation(alpha, c, 0.0, at);
                let aside = 2.0 * difference(at, right) / difference(left, right) - 1.0;
                let row = Vector4::new(
                    (elevation(alpha + 1e-4, c, 0.0, at) - here) / 1e-4,
                    (elevation(alpha, c * 1.0001, 0.0, at) - here) / (c * 1e-4),
                    aside / crossing.px_per_rad,
                    (elevation(alpha, c, 1e-3, at) - here) / 1e-3,
                ) * crossing.px_per_rad;
                // What is beside the line in the background pulls no column far.
                let away = (crossing.higher_px - centre) / STRAY_PX;
                let weight = 1.0 / (crossing.variance_px2 + LINE_FLOOR_PX * LINE_FLOOR_PX) / (1.0 + away * away);
                h += weight * row * row.transpose();
                g += weight * row * crossing.higher_px;
                chi2 += weight * crossing.higher_px * crossing.higher_px;
                // What the sensor's noise has in it is no fault of the line.
                squares += crossing.higher_px * crossing.higher_px - crossing.variance_px2;
            }
            let n = agreeing.len() as f64;
            let inflate = (chi2 / (n - 2.0)).max(1.0);
            // Of one that does not bend.
            let inverse = h.fixed_view::<3, 3>(0, 0).into_owned().try_inverse()?;
            let delta = inverse * g.fixed_rows::<3>(0);
            let free = h.try_inverse()?;
            // Not `Plane::step`: what was searched for may be beside the line, where the distance is not to be kept.
            plane.alpha += delta[0].clamp(-0.2, 0.2);
            plane.c += delta[1].clamp(-0.08 * plane.c, 0.08 * plane.c);
            let drift = plane.distance(bearing) / start.distance(bearing);
            if !(plane.c > 0.15 && (0.75..1.33).contains(&drift)) {
                return None;
            }
            let stray_px = (squares / n).max(0.0).sqrt();
            let step = median(&mut agreeing.iter().map(|c| c.step).collect::<Vec<_>>());
            let seen_rad =
                if round + 1 < ROUNDS { [right, left] } else { self.seen_about(samples, &plane, [right, left], step)? };
            fitted = Some(PlaneFit {
                plane,
                covariance: (inverse * inflate).fixed_resize::<2, 2>(0.0).fixed_resize(0.0),
                noise: median(&mut agreeing.iter().map(|c| c.noise).collect::<Vec<_>>()).max(0.5),
                sign: 1.0,
                seen_rad,
                correlation: CORRELATION,
                gain: step.abs(),
                black: 0.0,
                bend: [(free * g)[3], (free[(3, 3)] * inflate).sqrt()],
                stray_px,
            });
        }
        fitted
    }

    /// Between which bearings the line of a plane is seen with about this step, about where the plate was searched for. It may have been searched
    /// for too far to one side; what is much longer than a plate goes on in the background.
    fn seen_about(&self, samples: &[Sample], plane: &Plane, [right, left]: [f64; 2], step: f64) -> Option<[f64; 2]> {
        let beside = MOST_ASIDE * difference(left, right);
        let wide = self.line_run(samples, plane, [right - beside, left + beside], step);
        let column_rad = COLUMN_PX / f64::from(samples.first()?.ray.px_per_bearing);
        let ends_within = |[first, last]: &[f64; 2]| {
            difference(*first, right - beside) > 2.0 * column_rad && difference(left + beside, *last) > 2.0 * column_rad
        };
        wide.filter(ends_within).or_else(|| self.line_run(samples, plane, [right, left], step))
    }

    /// Between which bearings a plate shows of which stripes or the upper end show: the lower stripe of a near one is in view
    /// in few columns.
    pub(super) fn stripes_or_end(&self, samples: &[Sample], fit: &PlaneFit) -> [f64; 2] {
        let [right, left] = fit.seen_rad;
        let (crossings, _) = self.crossings(samples, &fit.plane, [right, left], &[0.0]);
        let step = median(&mut crossings.iter().map(|c| c.step).collect::<Vec<_>>());
        let wide_m = self.look.width_m;
        let window = [fit.plane.beside(left, -wide_m), fit.plane.beside(right, wide_m)];
        match self.line_run(samples, &fit.plane, window, step) {
            Some([first, last]) if difference(last, right) > 0.0 && difference(left, first) > 0.0 => [
                if difference(first, right) < 0.0 { first } else { right },
                if difference(last, left) > 0.0 { last } else { left },
            ],
            _ => [right, left],
        }
    }

    /// Between which of two bearings the line of a plane is seen with about this step, in the longest run.
    fn line_run(&self, samples: &[Sample], plane: &Plane, [right, left]: [f64; 2], step: f64) -> Option<[f64; 2]> {
        let (crossings, _) = self.crossings(samples, plane, [right, left], &[0.0]);
        let is_line =
            |c: &&Crossing| c.higher_px.abs() < GATES_PX[ROUNDS - 1] && c.step * step > LIKE_STEP * step * step;
        let column_rad = COLUMN_PX / f64::from(samples.first()?.ray.px_per_bearing);
        let bearings = crossings.iter().filter(is_line).map(|c| difference(c.bearing_rad, right));
        longest_run(bearings, column_rad).map(|(_, ends)| ends.map(|at| wrap(right + at)))
    }

    /// Whether an upper end is a straight line.
    pub(super) fn is_straight(fit: &PlaneFit) -> bool {
        let [bend, sigma] = fit.bend;
        bend.abs() < STRAIGHT + 4.0 * sigma && fit.is_flat()
    }

    /// Where the upper end is in each column between two bearings, and how many columns there are.
    pub(super) fn crossings(
        &self,
        samples: &[Sample],
        plane: &Plane,
        [right, left]: [f64; 2],
        starts_px: &[f64],
    ) -> (Vec<Crossing>, usize) {
        let Some(scale) = samples.first().map(|s| f64::from(s.ray.px_per_bearing)) else { return (Vec::new(), 0) };
        let edges = &self.pillar.edges_m;
        let stripe_m = edges[edges.len() - 1] - edges[edges.len() - 2];
        let wide = difference(left, right);
        let count = (wide * scale / COLUMN_PX).clamp(1.0, MOST_COLUMNS) as usize;
        let mut columns = vec![Column::default(); count];
        for sample in samples {
            let along = difference(f64::from(sample.ray.bearing_rad), right);
            let at = along / wide * count as f64;
            if !(0.0..count as f64).contains(&at) {
                continue;
            }
            let (distance, height) = plane.meet(&sample.ray);
            let m_per_px = sample.ray.m_per_px(distance);
            let higher_px = (height + plane.lower_m - self.pillar.high_m()) / m_per_px;
            // Far away the next stripe begins sooner.
            let down_px = REACH_PX[1].min(stripe_m / m_per_px - NEXT_STRIPE_PX);
            if (-down_px..=REACH_PX[0]).contains(&higher_px) {
                let column = &mut columns[at as usize];
                column.pixels.push((higher_px, sample.gray));
                column.along += along;
                column.scale += f64::from(sample.ray.px_per_elevation);
            }
        }
        let crossing = |column: &Column| {
            let n = column.pixels.len() as f64;
            let (higher_px, variance_px2, step, noise) = near::step_at(&column.pixels, starts_px)?;
            let bearing_rad = wrap(right + column.along / n);
            Some(Crossing { bearing_rad, higher_px, variance_px2, step, noise, px_per_rad: column.scale / n })
        };
        let count = columns.iter().filter(|column| column.pixels.len() >= LEAST_PIXELS).count();
        (columns.iter().filter_map(crossing).collect(), count)
    }

    /// Which side of a plate one looks at by the columns that show two stripes.
    pub(super) fn side_shown(&self, samples: &[Sample], fit: &PlaneFit) -> SideShown {
        let Some(scale) = samples.first().map(|s| f64::from(s.ray.px_per_bearing)) else { return SideShown::Neither };
        let reach = 0.48 * difference(fit.seen_rad[1], fit.seen_rad[0]);
        let middle = fit.middle_rad();
        let count = ((2.0 * reach * scale) as usize).max(1);
        let grams = self.sums(samples, &fit.plane, middle, reach, 2.0 * reach / count as f64, count, BLUR_PX);
        let measured = grams.iter().filter(|gram| shows_edge(gram)).count();
        if measured < DECIDING_COLUMNS {
            return SideShown::Unseen;
        }
        let shown = shown(&grams, self.noise2, 0.0);
        let share = |sign: f64| shown.iter().flatten().filter(|(c, _)| c * sign > 0.0).count() as f64 / measured as f64;
        let Some(sign) = [1.0, -1.0].into_iter().find(|sign| share(*sign) >= LEAST_SAME_SIDE) else {
            return SideShown::Neither;
        };
        let columns = grams.iter().zip(&shown).filter_map(|(gram, column)| Some((gram, column.as_ref()?.1)));
        let mut blacks: Vec<f64> = columns.map(|(gram, gain)| black(gram, gain, self.darkest(sign))).collect();
        SideShown::By { sign, share: share(sign), black: median(&mut blacks) }
    }

    /// The pose of a plate of which one stripe is in view, so that front and back look alike: midway between the two places.
    pub(super) fn of_either_side(
        &self,
        samples: &[Sample],
        fit: &PlaneFit,
        plane_covariance: &Matrix2<f64>,
        searched_rad: [f64; 2],
    ) -> Option<Posed> {
        let of = |sign: f64| {
            let fit = PlaneFit { sign, ..fit.clone() };
            self.between_sides(samples, &fit, plane_covariance, searched_rad)
        };
        let mut posed = of(1.0)?.or_as_likely(&of(-1.0)?);
        if !EITHER_SIDE_M.contains(&posed.pose[0].hypot(posed.pose[1])) {
            return None;
        }
        posed.has_heading = false;
        posed.covariance += Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, 0.0)) * EITHER_SIDE_SIGMA_M.powi(2);
        Some(posed)
    }

    /// How far what is in view of the upper stripe is from one paint: 1 is as uneven as paint may be.
    pub(super) fn unevenness(&self, samples: &[Sample], fit: &PlaneFit) -> f64 {
        let edges = &self.pillar.edges_m;
        let [low, high] = [edges[edges.len() - 2], edges[edges.len() - 1]];
        let (mut n, mut sum, mut squares) = (0.0, 0.0, 0.0);
        for sample in samples {
            let margin_rad = PAINT_MARGIN_PX / f64::from(sample.ray.px_per_bearing);
            let bearing = f64::from(sample.ray.bearing_rad);
            let inside = difference(bearing, fit.seen_rad[0]).min(difference(fit.seen_rad[1], bearing));
            let (distance, height) = fit.plane.meet(&sample.ray);
            let margin_m = PAINT_MARGIN_PX * sample.ray.m_per_px(distance);
            if inside > margin_rad && height > low + margin_m && height < high - margin_m {
                n += 1.0;
                sum += sample.gray;
                squares += sample.gray * sample.gray;
            }
        }
        let spread = (squares / n - (sum / n).powi(2)).max(0.0).sqrt();
        if n < LEAST_PAINT {
            return f64::INFINITY;
        }
        spread / (3.0 * self.noise2.sqrt()).max(UNEVEN * fit.gain)
    }

    /// In which share of the columns beside a plate its upper end goes on, the larger of both sides.
    pub(super) fn rim_goes_on(&self, samples: &[Sample], fit: &PlaneFit, [right, left]: [f64; 2], out: f64) -> f64 {
        let beside = 0.2 * difference(left, right);
        let sectors = [[right - out - beside, right - out], [left + out, left + out + beside]].into_iter();
        let share = |sector: [f64; 2]| {
            let (crossings, asked) = self.crossings(samples, &fit.plane, sector, &[0.0]);
            crossings.iter().filter(|c| c.higher_px.abs() < GOES_ON_PX).count() as f64 / asked.max(1) as f64
        };
        sectors.map(share).fold(0.0, f64::max)
    }
}
