//! The viewpoint's locus on the axis, measured directly: which height the rays of each image radius come from.
//!
//! Method: a ruler (or any upright thing with marks of known heights) stands at two or more known distances D from the
//! camera's axis. Points of one image radius r lie on one cone of rays, so where they hit the rulers
//!
//! ```text
//! h_i(r) = z(r) + D_i · slope(r)
//! ```
//!
//! and z(r), where the cone meets the axis, follows without any camera model; for two distances that is
//! z = (h₁ D₂ − h₂ D₁)/(D₂ − D₁). Heights at the same radius are interpolated between a ruler's marks. Everything is linear
//! in the marks, so the covariance of all z is exact to first order; of it follows whether z is one height for all radii.
//!
//! Source: `MATHS.md` §4.2, §4.3.

use nalgebra::{DMatrix, DVector, Vector2};
use serde::Deserialize;
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Marks that a height is interpolated from.
const NEIGHBOURS: usize = 4;
/// Probability of calling one point a locus.
pub const SIGNIFICANCE: f64 = 0.01;

/// What was measured, as it stands in a file.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Measured {
    /// The rulers, at two different distances or more.
    pub rulers: Vec<Ruler>,
    /// Standard deviation of a pixel in each component, px.
    #[serde(default = "tenth_of_a_pixel")]
    pub sigma_px: f64,
    /// Standard deviation of a mark's height, metres.
    #[serde(default = "half_a_millimetre")]
    pub height_sigma_m: f64,
    /// Standard deviation of a ruler's distance, metres.
    #[serde(default = "half_a_millimetre")]
    pub distance_sigma_m: f64,
}

fn tenth_of_a_pixel() -> f64 {
    0.1
}

fn half_a_millimetre() -> f64 {
    5e-4
}

/// An upright ruler.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ruler {
    /// From the camera's axis, metres.
    pub distance_m: f64,
    /// Its marks, in any order.
    pub marks: Vec<Mark>,
}

/// A mark on a ruler.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mark {
    /// Above any level that is the same for all rulers, metres.
    pub height_m: f64,
    /// Where it is seen.
    pub px: [f64; 2],
}

/// The locus.
#[derive(Debug, Clone)]
pub struct Locus {
    /// By growing image radius.
    pub points: Vec<LocusPoint>,
    /// Of all heights together, m².
    pub covariance_m2: DMatrix<f64>,
    /// The best single height and its standard deviation, metres.
    pub single_m: (f64, f64),
    /// Misfit of a single height, and its degrees of freedom.
    pub chi2: f64,
    /// Points minus one.
    pub dof: usize,
    /// Probability of a larger misfit if there were one viewpoint.
    pub p_value: f64,
}

/// Where the rays of an image radius meet the axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LocusPoint {
    /// Image radius, px along v.
    pub radius_px: f64,
    /// Height, above the level of the marks' heights, metres.
    pub height_m: f64,
    /// Its standard deviation.
    pub sigma_m: f64,
    /// Elevation of the rays, radians.
    pub elevation_rad: f64,
}

/// Why there is no locus.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LocusError {
    /// One distance tells nothing.
    #[error(
        "{rulers} rulers at {distances} different distances: two distances that differ by a tenth or more are wanted"
    )]
    TooFewDistances {
        /// How many rulers.
        rulers: usize,
        /// How many distances.
        distances: usize,
    },
    /// Too few marks.
    #[error("ruler {ruler}: {marks} marks, must be {NEIGHBOURS} or more")]
    TooFewMarks {
        /// Index from 0.
        ruler: usize,
        /// How many.
        marks: usize,
    },
    /// A number that cannot be.
    #[error("{what} = {value}: {expected}")]
    Wrong {
        /// Which.
        what: String,
        /// As given.
        value: f64,
        /// What would be right.
        expected: &'static str,
    },
    /// Marks in another order than their radii.
    #[error(
        "ruler {ruler}: with growing radius its heights go up and down (marks at {first_m} m and {second_m} m); wrong marks, or \
         a wrong centre?"
    )]
    Unordered {
        /// Index from 0.
        ruler: usize,
        /// A mark's height.
        first_m: f64,
        /// The next one's.
        second_m: f64,
    },
    /// No image radius is on all rulers.
    #[error("fewer than 2 image radii are on all rulers: the nearer one needs marks over a larger range of heights")]
    NoOverlap,
}

/// A ruler's marks by growing radius.
struct Curve {
    distance_m: f64,
    radius_px: Vec<f64>,
    height_m: Vec<f64>,
}

/// Measures the locus; `centre_px` is the image of the axis, `aspect` the pixels' width over height as in a camera file.
///
/// # Errors
/// Too few distances or marks, numbers that cannot be, marks in no order, or rulers without a common image radius.
pub fn measure(measured: &Measured, centre_px: [f64; 2], aspect: f64) -> Result<Locus, LocusError> {
    check(measured)?;
    let curves: Vec<Curve> = measured
        .rulers
        .iter()
        .enumerate()
        .map(|(index, ruler)| Curve::new(index, ruler, centre_px, aspect))
        .collect::<Result<_, _>>()?;
    let low = curves.iter().map(|c| c.radius_px[0]).fold(0.0, f64::max);
    let high = curves.iter().map(|c| c.radius_px[c.radius_px.len() - 1]).fold(f64::INFINITY, f64::min);
    // At the marks of the ruler with the fewest there: those need no interpolation.
    let inside = |c: &Curve| c.radius_px.iter().copied().filter(|r| (low..=high).contains(r)).collect::<Vec<f64>>();
    let radii = curves.iter().map(inside).min_by_key(Vec::len).filter(|r| r.len() >= 2).ok_or(LocusError::NoOverlap)?;

    // Heights z and slopes by least squares over the rulers, for which these are the weights.
    let n = curves.len() as f64;
    let mean = curves.iter().map(|c| c.distance_m).sum::<f64>() / n;
    let spread: f64 = curves.iter().map(|c| (c.distance_m - mean).powi(2)).sum();
    let of_height: Vec<f64> = curves.iter().map(|c| 1.0 / n - mean * (c.distance_m - mean) / spread).collect();
    let of_slope: Vec<f64> = curves.iter().map(|c| (c.distance_m - mean) / spread).collect();

    let count = radii.len();
    let (mut heights, mut slopes) = (DVector::zeros(count), DVector::zeros(count));
    let mut covariance = DMatrix::zeros(count, count);
    for (curve, (height_weight, slope_weight)) in curves.iter().zip(of_height.iter().zip(&of_slope)) {
        let mut by_mark = DMatrix::zeros(count, curve.radius_px.len());
        for (k, radius) in radii.iter().enumerate() {
            curve.weights(*radius, &mut by_mark, k);
        }
        let on_ruler = &by_mark * DVector::from_column_slice(&curve.height_m);
        heights += &on_ruler * *height_weight;
        slopes += &on_ruler * *slope_weight;
        let noise = DVector::from_fn(curve.radius_px.len(), |j, _| {
            (curve.slope_m_per_px(j) * measured.sigma_px).powi(2) + measured.height_sigma_m.powi(2)
        });
        covariance += &by_mark * DMatrix::from_diagonal(&noise) * by_mark.transpose() * height_weight.powi(2);
    }
    // A ruler that is farther than stated shifts z by −slope·weight: shared by all radii.
    for weight in &of_height {
        covariance += &slopes * slopes.transpose() * (weight * measured.distance_sigma_m).powi(2);
    }
    let points = (0..count)
        .map(|k| LocusPoint {
            radius_px: radii[k],
            height_m: heights[k],
            sigma_m: covariance[(k, k)].sqrt(),
            elevation_rad: slopes[k].atan(),
        })
        .collect();
    let information = covariance.clone().try_inverse().ok_or(LocusError::NoOverlap)?;
    let total = information.sum();
    let single = (&information * &heights).sum() / total;
    let apart = heights.add_scalar(-single);
    let (chi2, dof) = (apart.dot(&(&information * &apart)), count - 1);
    let p_value = ChiSquared::new(dof as f64).map_or(f64::NAN, |d| d.sf(chi2));
    Ok(Locus { points, covariance_m2: covariance, single_m: (single, total.sqrt().recip()), chi2, dof, p_value })
}

impl Locus {
    /// The difference between the highest and the lowest point and its standard deviation, metres.
    pub fn length_m(&self) -> (f64, f64) {
        let by_height = |a: &usize, b: &usize| self.points[*a].height_m.total_cmp(&self.points[*b].height_m);
        let all = || 0..self.points.len();
        let (low, high) = (all().min_by(by_height).unwrap_or(0), all().max_by(by_height).unwrap_or(0));
        let c = &self.covariance_m2;
        let variance = c[(low, low)] + c[(high, high)] - 2.0 * c[(low, high)];
        (self.points[high].height_m - self.points[low].height_m, variance.max(0.0).sqrt())
    }

    /// The finding in words.
    pub fn words(&self) -> String {
        let (length, sigma) = self.length_m();
        let Self { chi2, dof, p_value, single_m: (single, single_sigma), .. } = self;
        let numbers = format!("χ² of one height = {chi2:.1} with {dof} degrees of freedom, p = {p_value:.3}");
        if *p_value < SIGNIFICANCE {
            return format!(
                "the rays do not come from one point: their heights on the axis differ by {:.2} ± {:.2} mm ({numbers})",
                length * 1e3,
                sigma * 1e3
            );
        }
        format!(
            "one viewpoint at {:.2} ± {:.2} mm explains everything ({numbers}); a locus shorter than about {:.2} mm would not \
             have been noticed",
            single * 1e3,
            single_sigma * 1e3,
            // About three sigmas of the largest difference.
            3.0 * sigma * 1e3
        )
    }
}

impl Curve {
    fn new(index: usize, ruler: &Ruler, centre_px: [f64; 2], aspect: f64) -> Result<Self, LocusError> {
        let radius = |mark: &Mark| {
            let off = Vector2::from(mark.px) - Vector2::from(centre_px);
            (off.x / aspect).hypot(off.y)
        };
        let mut marks: Vec<(f64, f64)> = ruler.marks.iter().map(|m| (radius(m), m.height_m)).collect();
        marks.sort_by(|a, b| a.0.total_cmp(&b.0));
        let rises = marks[marks.len() - 1].1 > marks[0].1;
        for pair in marks.windows(2) {
            let ((r0, h0), (r1, h1)) = (pair[0], pair[1]);
            if r1 <= r0 || (h1 > h0) != rises || h1 == h0 {
                return Err(LocusError::Unordered { ruler: index, first_m: h0, second_m: h1 });
            }
        }
        let (radius_px, height_m) = marks.into_iter().unzip();
        Ok(Self { distance_m: ruler.distance_m, radius_px, height_m })
    }

    /// Lagrange's weights of the marks round a radius, into a row.
    fn weights(&self, radius: f64, rows: &mut DMatrix<f64>, row: usize) {
        let after = self.radius_px.partition_point(|r| *r < radius);
        let first = after.saturating_sub(NEIGHBOURS / 2).min(self.radius_px.len() - NEIGHBOURS);
        let near = first..first + NEIGHBOURS;
        for j in near.clone() {
            let others = near.clone().filter(|k| *k != j);
            let own = self.radius_px[j];
            rows[(row, j)] = others.map(|k| (radius - self.radius_px[k]) / (own - self.radius_px[k])).product::<f64>();
        }
    }

    /// dh/dr at a mark.
    fn slope_m_per_px(&self, mark: usize) -> f64 {
        let (a, b) = (mark.saturating_sub(1), (mark + 1).min(self.radius_px.len() - 1));
        (self.height_m[b] - self.height_m[a]) / (self.radius_px[b] - self.radius_px[a])
    }
}

fn check(measured: &Measured) -> Result<(), LocusError> {
    let within = |what: String, value: f64, low: f64, high: f64, expected: &'static str| {
        let right = value >= low && value <= high;
        right.then_some(()).ok_or(LocusError::Wrong { what, value, expected })
    };
    within("sigma_px".into(), measured.sigma_px, 1e-4, 10.0, "a standard deviation from 0.0001 to 10 px")?;
    for (what, sigma) in [("height_sigma_m", measured.height_sigma_m), ("distance_sigma_m", measured.distance_sigma_m)]
    {
        within(what.into(), sigma, 0.0, 0.1, "a standard deviation from 0 to 0.1 metres")?;
    }
    let mut distances: Vec<f64> = Vec::new();
    for (i, ruler) in measured.rulers.iter().enumerate() {
        let expected = "from 0.02 to 50 metres (is it in millimetres?)";
        within(format!("rulers[{i}].distance_m"), ruler.distance_m, 0.02, 50.0, expected)?;
        if ruler.marks.len() < NEIGHBOURS {
            return Err(LocusError::TooFewMarks { ruler: i, marks: ruler.marks.len() });
        }
        for (j, mark) in ruler.marks.iter().enumerate() {
            let key = |name: &str| format!("rulers[{i}].marks[{j}].{name}");
            within(key("height_m"), mark.height_m, -50.0, 50.0, "a height in metres")?;
            for x in mark.px {
                within(key("px"), x, -1e5, 1e5, "a place in the picture, px")?;
            }
        }
        if distances.iter().all(|d| (d - ruler.distance_m).abs() > 0.1 * d.max(ruler.distance_m)) {
            distances.push(ruler.distance_m);
        }
    }
    if distances.len() < 2 {
        return Err(LocusError::TooFewDistances { rulers: measured.rulers.len(), distances: distances.len() });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, Normal};

    use super::*;
    use crate::optics::{Camera, Pal, UnifiedSphere, UnifiedSphereParameters};

    /// Marks every centimetre (nearer) or more that a camera sees at these distances, with noise.
    fn seen(camera: &dyn Camera, distances_m: &[f64], sigma_px: f64, sigma_m: f64, seed: u64) -> Measured {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut noise = |sigma: f64| Normal::new(0.0, sigma).unwrap().sample(&mut random);
        let rulers = distances_m
            .iter()
            .map(|distance_m| {
                let place = distance_m + noise(sigma_m);
                let marks = (-40..=40).filter_map(|k| {
                    let height_m = f64::from(k) * 0.02 * distance_m;
                    let pixel = camera.project(&Vector3::new(place * 0.6, place * 0.8, height_m + noise(sigma_m)))?;
                    Some(Mark { height_m, px: [pixel.x + noise(sigma_px), pixel.y + noise(sigma_px)] })
                });
                Ruler { distance_m: *distance_m, marks: marks.collect() }
            })
            .collect();
        Measured { rulers, sigma_px: sigma_px.max(1e-4), height_sigma_m: sigma_m, distance_sigma_m: sigma_m }
    }

    /// `MATHS.md` §3.4: z_x runs from 6.511 mm at −15° to 3.358 mm at +20°.
    #[test]
    fn the_locus_of_the_report_s_lens_is_the_golden_one() {
        let lens = Pal::reference();
        let locus = measure(&seen(&lens, &[0.25, 0.9], 0.0, 0.0, 1), [383.5, 287.5], 1.0).unwrap();
        for point in &locus.points {
            let ray = lens.ray_of_image(&Vector2::new(383.5 + point.radius_px, 287.5)).unwrap();
            let (sin, cos) = ray.direction.z.acos().sin_cos();
            let crossing = ray.origin_m.z - ray.origin_m.x * cos / sin;
            assert!((point.height_m - crossing).abs() < 2e-6, "{point:?} {crossing}");
        }
        let (length, _) = locus.length_m();
        assert!(length > 2.8e-3 && length < 3.16e-3, "{length}");
    }

    #[test]
    fn heights_have_an_honest_covariance_and_the_lens_is_told_from_a_single_viewpoint() {
        let lens = Pal::reference();
        let sphere = UnifiedSphereParameters {
            xi: 0.93,
            focal_length_px: [270.0; 2],
            centre_px: [383.5, 287.5],
            skew: 0.0,
            distortion: [0.0; 4],
        };
        let sphere = UnifiedSphere::new(sphere, [768, 576]).unwrap();
        let (mut nees, mut dof, mut false_alarms, mut alarms) = (0.0, 0.0, 0, 0);
        let runs = 100;
        for seed in 0..runs {
            let locus = measure(&seen(&lens, &[0.15, 0.3, 0.9], 0.05, 1e-4, seed), [383.5, 287.5], 1.0).unwrap();
            let truth = DVector::from_iterator(
                locus.points.len(),
                locus.points.iter().map(|p| {
                    let ray = lens.ray_of_image(&Vector2::new(383.5 + p.radius_px, 287.5)).unwrap();
                    let (sin, cos) = ray.direction.z.acos().sin_cos();
                    ray.origin_m.z - ray.origin_m.x * cos / sin
                }),
            );
            let error = DVector::from_iterator(truth.len(), locus.points.iter().map(|p| p.height_m)) - &truth;
            nees += error.dot(&(locus.covariance_m2.clone().try_inverse().unwrap() * &error));
            dof += truth.len() as f64;
            alarms += usize::from(locus.p_value < SIGNIFICANCE);
            let locus = measure(&seen(&sphere, &[0.15, 0.3, 0.9], 0.05, 1e-4, seed), [383.5, 287.5], 1.0).unwrap();
            false_alarms += usize::from(locus.p_value < SIGNIFICANCE);
        }
        println!("NEES {:.3}, alarms {alarms}, false alarms {false_alarms} of {runs}", nees / dof);
        // 95 % bounds of χ² with so many degrees of freedom, and of a binomial with 100 draws of 1 %.
        assert!((nees / dof - 1.0).abs() < 1.96 * (2.0 / dof).sqrt(), "{}", nees / dof);
        assert!(alarms == 100 && false_alarms <= 4, "{alarms} {false_alarms}");
    }

    #[test]
    fn one_distance_unordered_marks_and_wrong_units_are_errors_in_words() {
        let lens = Pal::reference();
        let good = seen(&lens, &[0.25, 0.9], 0.0, 0.0, 1);
        let says = |change: &dyn Fn(&mut Measured), word: &str| {
            let mut wrong = good.clone();
            change(&mut wrong);
            let error = measure(&wrong, [383.5, 287.5], 1.0).unwrap_err().to_string();
            assert!(error.contains(word), "{error}");
        };
        says(&|m| m.rulers.truncate(1), "two distances");
        says(&|m| m.rulers[1].distance_m = 0.26, "1 different distances");
        says(&|m| m.rulers[1].marks[3].height_m += 0.3, "ruler 1");
        says(&|m| m.rulers[0].distance_m = 250.0, "millimetres");
        says(&|m| m.rulers[0].marks.truncate(3), "3 marks");
        says(&|m| m.sigma_px = f64::NAN, "sigma_px");
    }
}
