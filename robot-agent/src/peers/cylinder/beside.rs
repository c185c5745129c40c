//! Whether what was fitted goes on beside the body that it would be.
//!
//! Problem: shelves, blinds and table tops look like a painted cylinder for as far as one is wide. Insight: a body ends at its outlines, these
//! go on. Algorithm: in each column beside either outline the rings, or the marker's upper end, are looked for where they would be if what is
//! there went on as far away as the outline is.

use super::super::look::MAX_RINGS;
use super::super::near;
use super::super::rays::Sample;
use super::super::rings::{self, RingFit};
use super::CylinderFinder;

/// From so many pixels beside an outline on, which its blur does not reach, and so far: a share of the half width and radians.
const FROM_PX: f64 = 2.5;
const TO_SHARE: f64 = 1.1;
const TO_RAD: f64 = 0.04;
/// A column is so wide, pixels, and has so many pixels.
const COLUMN_PX: f64 = 1.0;
const LEAST_PIXELS: usize = 5;
/// Least correlation of a column that shows rings, and least contrast of one as a share of the body's.
const LEAST_CORRELATION: f64 = 0.8;
const LEAST_GAIN: f64 = 0.25;
/// The profile varies by so much, else a column says nothing.
const LEAST_VARIANCE: f64 = 2e-3;
/// An upper end that is this near to where it would go on does, pixels.
const END_PX: f64 = 1.0;
/// A side of fewer columns says less.
const LEAST_COLUMNS: usize = 2;

impl CylinderFinder {
    /// In which share of the columns beside a body what was fitted goes on, the larger of both sides.
    pub(super) fn goes_on(&self, samples: &[Sample], rings: &RingFit) -> f64 {
        let Some(scale) = samples.first().map(|s| f64::from(s.ray.px_per_bearing)) else { return 0.0 };
        let cylinder = rings.cylinder(self.look.radius_m);
        let from = cylinder.outline_rad + FROM_PX / scale;
        let to = cylinder.outline_rad * TO_SHARE + TO_RAD;
        let wide = COLUMN_PX * rings.end.map_or(1.0, |end| end.together) / scale;
        let count = ((to - from) / wide).max(0.0) as usize;
        // Of either side the columns outwards: height above the floor, metres a pixel, and gray level.
        let mut columns: [Vec<Vec<[f64; 3]>>; 2] = [vec![Vec::new(); count], vec![Vec::new(); count]];
        for sample in samples {
            let met = cylinder.meet(&sample.ray);
            let out = (met.aside_rad.abs() - from) / wide;
            if let Some(column) = columns[usize::from(met.aside_rad > 0.0)].get_mut(out as usize).filter(|_| out >= 0.0)
            {
                column.push([met.height_m + rings.lower_m, sample.ray.m_per_px(met.distance_m), sample.gray]);
            }
        }
        let says = |column: &Vec<[f64; 3]>| match rings.end {
            Some(_) => self.end_goes_on(column),
            None => self.rings_go_on(rings, column),
        };
        let share = |side: Vec<Vec<[f64; 3]>>| {
            let said: Vec<bool> = side.iter().filter(|c| c.len() >= LEAST_PIXELS).filter_map(says).collect();
            let many = said.len().max(LEAST_COLUMNS);
            said.into_iter().filter(|goes_on| *goes_on).count() as f64 / many as f64
        };
        columns.into_iter().map(share).fold(0.0, f64::max)
    }

    /// Whether a column shows the rings; `None` where it could not.
    fn rings_go_on(&self, rings: &RingFit, column: &[[f64; 3]]) -> Option<bool> {
        let look = &self.look;
        let mut by_ring = [0.0; MAX_RINGS];
        let (mut n, mut p, mut pp, mut g, mut pg, mut gg) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        for [height_m, m_per_px, gray] in column {
            let blur_m = rings.blur_px * m_per_px;
            if *height_m < look.low_m() + 2.0 * blur_m || *height_m > look.high_m() - 2.0 * blur_m {
                continue;
            }
            let paint = rings::profile(look, &rings.reflectance, *height_m, blur_m, &mut by_ring);
            n += 1.0;
            p += paint;
            pp += paint * paint;
            g += gray;
            pg += paint * gray;
            gg += gray * gray;
        }
        let (vpp, vpg, vgg) = (pp - p * p / n, pg - p * g / n, gg - g * g / n);
        if n < LEAST_PIXELS as f64 || vpp < LEAST_VARIANCE * n {
            return None;
        }
        let (gain, correlation) = (vpg / vpp, rings::correlation([vpp, vpg, vgg], n, self.noise2));
        let (gain, correlation) = if look.is_barred() { (gain.abs(), correlation.abs()) } else { (gain, correlation) };
        Some(correlation > LEAST_CORRELATION && gain > LEAST_GAIN * rings.gain)
    }

    /// Whether a column shows an edge at the height of the marker's upper end; `None` where it could not.
    fn end_goes_on(&self, column: &[[f64; 3]]) -> Option<bool> {
        let about = |[height_m, m_per_px, gray]: &[f64; 3]| ((height_m - self.look.high_m()) / m_per_px, *gray);
        let pixels: Vec<(f64, f64)> = column.iter().map(about).filter(|(px, _)| near::reaches(*px)).collect();
        near::tells(&pixels).then(|| near::step_at(&pixels, &[0.0]).is_some_and(|(place, ..)| place.abs() < END_PX))
    }
}
