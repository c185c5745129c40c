//! Panoramas by image radius: the report's (4-1), and with (4-2) the rectified one.
//!
//! ```text
//! column u:  θ = θ₀ − 2π(u + ½)/W                     x = x₀ + a·r cos θ
//! row v:     R(r) = R₀ + (v + ½)(R₁ − R₀)/H           y = y₀ + r sin θ         R(r) = v₀ + v₁r + v₂r² + …
//! ```
//!
//! With R = r this is (4-1) alone: an unwrapped ring in which upright things are bent out of scale. With R ∝ tan(elevation)
//! (as equal bars on a vertical board give it) heights keep their ratios, as on a cylinder. Row 0 shows the end of the
//! ring that is higher in the world. Unlike [`super::PanoramaGeometry`] it needs no camera model, only a centre, two radii
//! and a polynomial. Source: report (4-1), (4-2), `MATHS.md` §4.1 and §4.2.

use std::f64::consts::{PI, TAU};

use nalgebra::{DMatrix, DVector, Vector2};

use super::GeometryError;
use crate::optics::{MountedCamera, direction};

/// Orders of the polynomial of a camera's own map: the lowest that leaves less than [`GOOD_ROWS`]. (Bars in a picture
/// cannot tell more than order 3, `MATHS.md` §4.2; a model has no noise.)
const ORDERS: std::ops::RangeInclusive<usize> = 3..=9;
/// Rows that a polynomial may be off.
const GOOD_ROWS: f64 = 0.05;

/// A panorama by image radius. Pixel centres are at integers; all 360° are there.
#[derive(Debug, Clone, PartialEq)]
pub struct RadialPanorama {
    width: u32,
    height: u32,
    centre_px: [f64; 2],
    aspect: f64,
    /// At the upper and the lower border.
    radius_px: [f64; 2],
    /// R(r), ascending.
    polynomial: Vec<f64>,
    theta0_rad: f64,
}

impl RadialPanorama {
    /// The ring of a picture as it is, (4-1): rows equally spaced in the image radius from `radius_px[0]` at the upper
    /// border to `radius_px[1]` at the lower one.
    ///
    /// # Errors
    /// An impossible size.
    pub fn new(
        [width, height]: [u32; 2],
        centre_px: [f64; 2],
        aspect: f64,
        radius_px: [f64; 2],
    ) -> Result<Self, GeometryError> {
        let max = super::PanoramaGeometry::MAX_SIDE_PX;
        if !(1..=max).contains(&width) || !(1..=max).contains(&height) {
            return Err(GeometryError::Size { width, height });
        }
        Ok(Self { width, height, centre_px, aspect, radius_px, polynomial: vec![0.0, 1.0], theta0_rad: PI })
    }

    /// The same rectified by (4-2): rows equally spaced in R(r), whose coefficients are given ascending in px.
    ///
    /// # Errors
    /// A polynomial that does not run in one sense between the two radii.
    pub fn rectified(mut self, polynomial: Vec<f64>) -> Result<Self, GeometryError> {
        const STEPS: u32 = 256;
        self.polynomial = polynomial;
        let [upper, lower] = self.radius_px;
        let slope = |i: u32| self.rectify(upper + (lower - upper) * f64::from(i) / f64::from(STEPS)).1;
        let first = slope(0);
        if (0..=STEPS).all(|i| slope(i) * first > 0.0) {
            return Ok(self);
        }
        Err(GeometryError::Folded { inner_px: upper.min(lower), outer_px: upper.max(lower) })
    }

    /// The rectified panorama of a camera with an axis of symmetry: R fitted to its own tan(elevation) over its field of
    /// view, within the limits of a cylinder (±60°).
    ///
    /// # Errors
    /// A camera without one axis or that does not see all around.
    pub fn for_camera(camera: &MountedCamera, size_px: [u32; 2]) -> Result<Self, GeometryError> {
        const SAMPLES: u32 = 200;
        let model = camera.camera();
        let not_panoramic = || GeometryError::NotPanoramic { model: model.model() };
        let plane = model.normalised_plane().filter(|_| model.is_panoramic()).ok_or_else(not_panoramic)?;
        let aspect = plane.focal_length_px[0] / plane.focal_length_px[1];
        let limit = 60_f64.to_radians();
        let [low, high] = model.elevation_rad();
        let (low, high) = (low.max(-limit), high.min(limit));
        let samples: Vec<(f64, f64)> = (0..=SAMPLES)
            .filter_map(|i| {
                let elevation = low + (high - low) * f64::from(i) / f64::from(SAMPLES);
                let pixel = model.image_of_direction(&direction(0.0, elevation))?;
                let offset = pixel - Vector2::from(plane.centre_px);
                Some(((offset.x / aspect).hypot(offset.y), elevation.tan()))
            })
            .collect();
        let (Some((lower, _)), Some((upper, _))) = (samples.first(), samples.last()) else {
            return Err(not_panoramic());
        };
        let panorama = Self::new(size_px, plane.centre_px, aspect, [*upper, *lower])?;
        let rows_per_px = f64::from(size_px[1]) / (upper - lower).abs();
        let mut best: Option<(f64, Vec<f64>)> = None;
        for (residual_px, polynomial) in ORDERS.filter_map(|order| fit(&samples, order)) {
            if best.as_ref().is_none_or(|(least, _)| residual_px < *least) {
                best = Some((residual_px, polynomial));
            }
            if residual_px * rows_per_px < GOOD_ROWS {
                break;
            }
        }
        panorama.rectified(best.ok_or_else(not_panoramic)?.1)
    }

    /// Columns and rows.
    pub fn size_px(&self) -> [u32; 2] {
        [self.width, self.height]
    }

    /// Where in the picture a point of the panorama lies; any real column and row.
    pub fn source_of(&self, u: f64, v: f64) -> Vector2<f64> {
        let (sin, cos) = (self.theta0_rad - TAU * (u + 0.5) / f64::from(self.width)).sin_cos();
        let r = self.radius_of_row(v);
        Vector2::new(self.centre_px[0] + self.aspect * r * cos, self.centre_px[1] + r * sin)
    }

    /// Column in [−½, W − ½) and row of a point of the picture.
    pub fn pixel_of(&self, source: &Vector2<f64>) -> Vector2<f64> {
        let offset = Vector2::new((source.x - self.centre_px[0]) / self.aspect, source.y - self.centre_px[1]);
        let width = f64::from(self.width);
        let column = ((self.theta0_rad - offset.y.atan2(offset.x)) / TAU * width).rem_euclid(width);
        let [top, bottom] = self.radius_px.map(|r| self.rectify(r).0);
        let row = (self.rectify(offset.norm()).0 - top) / (bottom - top) * f64::from(self.height);
        Vector2::new((if column < width { column } else { 0.0 }) - 0.5, row - 0.5)
    }

    /// R(r) and its slope.
    fn rectify(&self, r: f64) -> (f64, f64) {
        self.polynomial.iter().rev().fold((0.0, 0.0), |(value, slope), c| (value * r + c, slope * r + value))
    }

    fn radius_of_row(&self, v: f64) -> f64 {
        const STEPS: usize = 50;
        let [upper, lower] = self.radius_px;
        let [top, bottom] = self.radius_px.map(|r| self.rectify(r).0);
        let share = (v + 0.5) / f64::from(self.height);
        let wanted = top + (bottom - top) * share;
        // R runs in one sense between the radii, and a little beyond them it is still a polynomial.
        let mut r = upper + (lower - upper) * share;
        for _ in 0..STEPS {
            let (value, slope) = self.rectify(r);
            let step = (value - wanted) / slope;
            r -= step;
            if step.abs() < 1e-12 * r.abs() {
                break;
            }
        }
        r
    }
}

/// The polynomial through samples (r, tan elevation), brought to pixels: R(r) = r at both ends, as equal bars give it.
/// With its largest residual, px.
fn fit(samples: &[(f64, f64)], order: usize) -> Option<(f64, Vec<f64>)> {
    let (first, last) = (samples.first()?, samples.last()?);
    // Well conditioned in s = r/r_max; the unknowns are the coefficients of s^k.
    let scale = samples.iter().map(|(r, _)| *r).fold(0.0, f64::max);
    let target = |t: f64| first.0 + (t - first.1) * (last.0 - first.0) / (last.1 - first.1);
    let a = DMatrix::from_fn(samples.len(), order + 1, |i, k| (samples[i].0 / scale).powi(k as i32));
    let b = DVector::from_iterator(samples.len(), samples.iter().map(|(_, t)| target(*t)));
    let solution = a.clone().svd(true, true).solve(&b, 1e-14).ok()?;
    let residual_px = (a * &solution - b).amax();
    Some((residual_px, solution.iter().enumerate().map(|(k, c)| c / scale.powi(k as i32)).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::laws::{assert_rel, golden};

    #[test]
    fn the_ring_as_it_is_is_golden() {
        let (inputs, golden, tol) = golden("map41");
        let number = |key: &str| inputs[key].as_f64().unwrap();
        let radii = [number("r_first"), number("r_last")];
        let mut panorama = RadialPanorama::new([1080, 162], [number("x0"), number("y0")], 1.0, radii).unwrap();
        // The project's seam is behind, the golden one ahead.
        panorama.theta0_rad = 0.0;
        for case in golden.as_array().unwrap() {
            let source = panorama.source_of(case["col"].as_f64().unwrap(), case["row"].as_f64().unwrap());
            assert_rel(source.x, &case["xy"][0], tol);
            assert_rel(source.y, &case["xy"][1], tol);
        }
    }

    #[test]
    fn rectified_rows_are_those_of_a_cylinder_to_a_tenth_of_a_row() {
        let camera = MountedCamera::reference(0.6);
        let rectified = RadialPanorama::for_camera(&camera, [1080, 162]).unwrap();
        let [low, high] = [-15.0_f64, 20.0].map(|e| e.to_radians().tan());
        let mut worst = 0.0_f64;
        for elevation_deg in -15..=20 {
            let tan = f64::from(elevation_deg).to_radians().tan();
            let row = (high - tan) / (high - low) * 162.0 - 0.5;
            let source = camera.camera().image_of_direction(&direction(0.3, tan.atan())).unwrap();
            worst = worst.max((rectified.pixel_of(&source).y - row).abs());
        }
        // MATHS §4.2: order 4 leaves 0.012 px of the picture, where a pixel is 1.44 rows.
        assert!(worst < 0.1, "{worst} rows");
    }

    #[test]
    fn a_polynomial_that_folds_is_an_error() {
        let ring = RadialPanorama::new([1080, 162], [383.5, 287.5], 1.0, [158.0, 270.0]).unwrap();
        let error = ring.rectified(vec![0.0, 400.0, -1.0]).unwrap_err().to_string();
        assert!(error.contains("158") && error.contains("270"), "{error}");
    }
}
