//! Whether a camera looks from a single point, tested on a board nearby.
//!
//! Problem: a lens whose rays do not meet in one point still looks right far away; near, a plane's image is no perspective
//! of it. Insight: under a single viewpoint the rays of a plane's points are a homography of the plane, whatever its pose.
//! T_H, the least Σ|x − π(H·U)|²/σ² over all H with π the far-field map in raw pixels (where the noise is isotropic), is
//! then χ² with 2n − 8 degrees of freedom. T_P, the same for a rigid board of the stated squares, has 2n − 6, and T_P − T_H
//! (2 degrees) tests the board's proportions. A test that finds nothing says little without its power: what it would
//! have found had the rays missed one another as in the report's lens.
//!
//! Source: `MATHS.md` §4.3, report 4.3.

use nalgebra::{DVector, Matrix3, Rotation3, SymmetricEigen, Vector2, Vector3};
use statrs::distribution::{ChiSquared, ContinuousCDF};

use super::least_squares::minimise;
use super::observation::View;
use crate::optics::{Camera, Pal};

/// Probability of a false alarm.
pub const SIGNIFICANCE: f64 = 0.01;
/// Length of the viewpoint's locus on the axis of the report's lens, metres (`MATHS.md` §3.4): what a test looks for where
/// nothing else is said. `calibrate locus` measures that of any camera.
pub const REFERENCE_LOCUS_M: f64 = 3.15e-3;
/// Power from which a test that finds nothing says something.
const ENOUGH_POWER: f64 = 0.8;

/// What a test found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// The rays do not meet in one point, or the camera's numbers are wrong.
    NotOnePoint,
    /// They do, and a locus of the length that was looked for would have been seen.
    OnePoint,
    /// Nothing was found, but nothing could have been: the board must be nearer, or larger.
    Undecided,
}

/// The test on one view.
#[derive(Debug, Clone)]
pub struct SingleViewpointTest {
    /// The view's name.
    pub view: String,
    /// T_H.
    pub statistic: f64,
    /// 2n − 8.
    pub dof: usize,
    /// Probability of a larger T_H under a single viewpoint.
    pub p_value: f64,
    /// T_P − T_H, which has two degrees of freedom: whether width and height of the board are in the stated proportion.
    pub shape_statistic: f64,
    /// Its probability.
    pub shape_p_value: f64,
    /// Length of the locus that was looked for, metres; its shape is that of the report's lens.
    pub locus_m: f64,
    /// Probability to detect it at [`SIGNIFICANCE`].
    pub power: f64,
    /// Distance of the board's middle, metres.
    pub distance_m: f64,
    /// In short.
    pub verdict: Verdict,
}

/// Why there is no test.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum VerifyError {
    /// Points that are no board.
    #[error("view {view:?} is no board: its points must lie in the plane z = 0, and be more than 4")]
    NotPlanar {
        /// Its name.
        view: String,
    },
    /// A pixel without a ray.
    #[error(
        "view {view:?}, point {index} at [{u:.1}, {v:.1}] px: the camera sees nothing there; is it the right camera file?"
    )]
    Unseen {
        /// Its name.
        view: String,
        /// Index from 0.
        index: usize,
        /// Column.
        u: f64,
        /// Row.
        v: f64,
    },
    /// A fit that failed.
    #[error("view {view:?}: no plane explains the points (wrong corner order?)")]
    NoFit {
        /// Its name.
        view: String,
    },
    /// A length that cannot be.
    #[error("locus of {locus_m} m: must be between 0.00001 and 1 (is it in millimetres?)")]
    Locus {
        /// As given.
        locus_m: f64,
    },
    /// A noise that cannot be.
    #[error("sigma {sigma_px} px: must be between 0.001 and 10")]
    Sigma {
        /// As given.
        sigma_px: f64,
    },
}

/// Tests one view of a board for noise of `sigma_px` in each component of a corner; the power is that of finding a locus of
/// `locus_m` metres ([`REFERENCE_LOCUS_M`] for the report's lens).
///
/// # Errors
/// The view is no board, the camera does not see its points, or nothing fits.
pub fn single_viewpoint(
    camera: &dyn Camera,
    view: &View,
    sigma_px: f64,
    locus_m: f64,
) -> Result<SingleViewpointTest, VerifyError> {
    let name = || view.name.clone();
    if !(1e-5..=1.0).contains(&locus_m) {
        return Err(VerifyError::Locus { locus_m });
    }
    if !(0.001..=10.0).contains(&sigma_px) {
        return Err(VerifyError::Sigma { sigma_px });
    }
    if !view.is_planar() || view.points.len() < 5 {
        return Err(VerifyError::NotPlanar { view: name() });
    }
    let rays = view.points.iter().enumerate().map(|(index, (_, pixel))| {
        let ray = camera.ray_of_image(pixel).map(|ray| ray.direction);
        ray.ok_or_else(|| VerifyError::Unseen { view: name(), index, u: pixel.x, v: pixel.y })
    });
    let rays: Vec<Vector3<f64>> = rays.collect::<Result<_, _>>()?;
    let pixels: Vec<Vector2<f64>> = view.points.iter().map(|(_, pixel)| *pixel).collect();
    let plane = Plane::of(view);
    let no_fit = || VerifyError::NoFit { view: name() };
    let (squares, homography) = plane.homography(camera, &rays, &pixels).ok_or_else(no_fit)?;
    let far = |ray: &Vector3<f64>| camera.image_of_direction(ray);
    let (rigid_squares, _) = plane.rigid(far, &homography, &pixels).ok_or_else(no_fit)?;
    // Where the board truly is, as far as the camera's own model knows about its viewpoint.
    let near = |point: &Vector3<f64>| camera.image_of_point(point);
    let (_, pose) = plane.rigid(near, &homography, &pixels).ok_or_else(no_fit)?;
    let variance = sigma_px * sigma_px;
    let dof = 2 * pixels.len() - 8;
    let (statistic, rigid) = (squares / variance, rigid_squares / variance);
    let p_value = upper_tail(statistic, dof);
    let shape_statistic = (rigid - statistic).max(0.0);
    let non_centrality = plane.non_centrality(camera, &pose, sigma_px, locus_m).ok_or_else(no_fit)?;
    let power = noncentral_upper_tail(critical_value(dof), dof, non_centrality);
    let verdict = if p_value < SIGNIFICANCE {
        Verdict::NotOnePoint
    } else if power >= ENOUGH_POWER {
        Verdict::OnePoint
    } else {
        Verdict::Undecided
    };
    Ok(SingleViewpointTest {
        view: name(),
        statistic,
        dof,
        p_value,
        shape_statistic,
        shape_p_value: upper_tail(shape_statistic, 2),
        locus_m,
        power,
        distance_m: pose.translation.norm(),
        verdict,
    })
}

impl SingleViewpointTest {
    /// The verdict in words.
    pub fn words(&self) -> String {
        let Self { view, statistic, dof, p_value, power, locus_m, distance_m, .. } = self;
        let numbers =
            format!("χ² = {statistic:.1} with {dof} degrees of freedom, p = {p_value:.3}, board at {distance_m:.2} m");
        match self.verdict {
            Verdict::NotOnePoint => {
                format!(
                    "{view}: the plane is no perspective image ({numbers}): no single viewpoint, a wrong calibration, or a bent board"
                )
            }
            Verdict::OnePoint => {
                format!(
                    "{view}: consistent with a single viewpoint ({numbers}); a locus of {:.2} mm would have been found with \
                         probability {power:.2}",
                    locus_m * 1e3
                )
            }
            Verdict::Undecided => {
                format!(
                    "{view}: nothing found, but a locus of {:.2} mm would have been found with probability {power:.2} only \
                         ({numbers}): hold the board nearer (at 0.2 m for a locus like that of the report's lens)",
                    locus_m * 1e3
                )
            }
        }
    }
}

/// The height on the axis from which the rays of one image radius come, from points of two known distances that appear on
/// it: (r₁, h₁) and (r₂, h₂) are distance from the axis and height, in one unit. `None` for equal distances.
pub fn locus_from_two_distances(first: (f64, f64), second: (f64, f64)) -> Option<f64> {
    let ((r1, h1), (r2, h2)) = (first, second);
    let spread = r2 - r1;
    (spread.abs() > 1e-9 * r1.abs().max(r2.abs())).then(|| (h1 * r2 - h2 * r1) / spread)
}

/// A rigid pose.
struct Pose {
    rotation: Rotation3<f64>,
    translation: Vector3<f64>,
}

/// A board's points, scaled to size one.
struct Plane {
    points: Vec<Vector3<f64>>,
    size: f64,
}

impl Plane {
    fn of(view: &View) -> Self {
        let n = view.points.len() as f64;
        let centre = view.points.iter().map(|(o, _)| o).sum::<Vector3<f64>>() / n;
        let size = (view.points.iter().map(|(o, _)| (o - centre).norm_squared()).sum::<f64>() / n).sqrt();
        let points = view.points.iter().map(|(o, _)| ((o - centre) / size).xy().push(1.0)).collect();
        Self { points, size }
    }

    /// Σ|x − π(H U)|² at its least, and H.
    fn homography(
        &self,
        camera: &dyn Camera,
        rays: &[Vector3<f64>],
        pixels: &[Vector2<f64>],
    ) -> Option<(f64, Matrix3<f64>)> {
        let mut normal = nalgebra::SMatrix::<f64, 9, 9>::zeros();
        for (point, ray) in self.points.iter().zip(rays) {
            let cross = ray.cross_matrix();
            let mut rows = nalgebra::SMatrix::<f64, 3, 9>::zeros();
            for k in 0..3 {
                rows.fixed_view_mut::<3, 3>(0, 3 * k).copy_from(&(cross * point[k]));
            }
            normal += rows.tr_mul(&rows);
        }
        let eigen = SymmetricEigen::new(normal);
        let least = eigen.eigenvectors.column(eigen.eigenvalues.imin());
        let start = Matrix3::from_column_slice(least.as_slice());
        let along: f64 = self.points.iter().zip(rays).map(|(p, ray)| ray.dot(&(start * p))).sum();
        let start = start * along.signum();
        // The scale of H is free: its largest entry stays as it is.
        let fixed = start.iamax_full();
        let free: Vec<(usize, usize)> = (0..9).map(|k| (k % 3, k / 3)).filter(|index| *index != fixed).collect();
        let assemble = |x: &DVector<f64>| {
            let mut h = start;
            for (value, index) in x.iter().zip(&free) {
                h[*index] = *value;
            }
            h
        };
        let found = minimise(DVector::from_iterator(8, free.iter().map(|i| start[*i])), &[1e-6; 8], |x| {
            let h = assemble(x);
            residuals(|ray| camera.image_of_direction(ray), self.points.iter().map(|p| h * p), pixels)
        })?;
        Some((found.residuals.norm_squared(), assemble(&found.x)))
    }

    /// The same for a rigid board, from the homography; `image` gives where a point (metres) appears.
    fn rigid(
        &self,
        image: impl Fn(&Vector3<f64>) -> Option<Vector2<f64>>,
        homography: &Matrix3<f64>,
        pixels: &[Vector2<f64>],
    ) -> Option<(f64, Pose)> {
        let (a, b, t) = (homography.column(0), homography.column(1), homography.column(2));
        let scale = 0.5 * (a.norm() + b.norm());
        let svd = Matrix3::from_columns(&[a / scale, b / scale, a.cross(&b) / (scale * scale)]).svd(true, true);
        let rotation = Rotation3::from_matrix_unchecked(svd.u? * svd.v_t?);
        let translation: Vector3<f64> = t / scale;
        let pose = |x: &DVector<f64>| Pose {
            rotation: Rotation3::new(Vector3::new(x[0], x[1], x[2])) * rotation,
            translation: translation + Vector3::new(x[3], x[4], x[5]),
        };
        let found = minimise(DVector::zeros(6), &[1e-6; 6], |x| {
            let Pose { rotation, translation } = pose(x);
            let points = self.points.iter().map(|p| (rotation * p.xy().push(0.0) + translation) * self.size);
            residuals(&image, points, pixels)
        })?;
        let Pose { rotation, translation } = pose(&found.x);
        Some((found.residuals.norm_squared(), Pose { rotation, translation: translation * self.size }))
    }

    /// T_H of the board's noise-free image through rays that meet the axis where those of the report's lens do, stretched to
    /// a length.
    fn non_centrality(&self, camera: &dyn Camera, pose: &Pose, sigma_px: f64, locus_m: f64) -> Option<f64> {
        let locus = ReferenceLocus::new(locus_m / REFERENCE_LOCUS_M);
        let images = self.points.iter().map(|p| {
            let point = pose.rotation * (p.xy().push(0.0) * self.size) + pose.translation;
            // Where the ray starts on the axis depends on its elevation: a fixed point, three rounds suffice.
            let point = point - camera.viewpoint_m();
            let mut direction = point;
            for _ in 0..3 {
                direction = point - Vector3::z() * locus.height_m(crate::optics::elevation_rad(&direction));
            }
            camera.image_of_direction(&direction)
        });
        let images = images.collect::<Option<Vec<Vector2<f64>>>>()?;
        let rays = images.iter().map(|pixel| camera.ray_of_image(pixel).map(|ray| ray.direction));
        let rays = rays.collect::<Option<Vec<Vector3<f64>>>>()?;
        Some(self.homography(camera, &rays, &images)?.0 / (sigma_px * sigma_px))
    }
}

/// Where the rays of the report's lens meet its axis, by elevation; beyond its field of view as at its ends.
struct ReferenceLocus {
    /// (elevation in radians, height on the axis in metres from the best single viewpoint), by falling elevation.
    points: Vec<(f64, f64)>,
}

impl ReferenceLocus {
    fn new(stretch: f64) -> Self {
        let lens = Pal::reference();
        let [inner, outer] = lens.annulus_px();
        let [u0, v0] = lens.design().centre_px;
        let points = (0..=64).filter_map(|i| {
            let radius = inner + (outer - inner) * f64::from(i) / 64.0;
            let ray = lens.ray_of_image(&Vector2::new(u0 + radius, v0))?;
            let crossing = ray.origin_m.z - ray.origin_m.x * ray.direction.z / ray.direction.x;
            let height = (crossing - lens.viewpoint_m().z) * stretch;
            Some((crate::optics::elevation_rad(&ray.direction), height))
        });
        Self { points: points.collect() }
    }

    fn height_m(&self, elevation_rad: f64) -> f64 {
        let after = self.points.partition_point(|(e, _)| *e > elevation_rad).clamp(1, self.points.len() - 1);
        let ((e0, z0), (e1, z1)) = (self.points[after - 1], self.points[after]);
        let share = ((elevation_rad - e0) / (e1 - e0)).clamp(0.0, 1.0);
        z0 + (z1 - z0) * share
    }
}

fn residuals(
    image: impl Fn(&Vector3<f64>) -> Option<Vector2<f64>>,
    points: impl Iterator<Item = Vector3<f64>>,
    pixels: &[Vector2<f64>],
) -> Option<DVector<f64>> {
    let mut all = Vec::with_capacity(2 * pixels.len());
    for (point, pixel) in points.zip(pixels) {
        let offset = image(&point)? - pixel;
        all.extend([offset.x, offset.y]);
    }
    Some(DVector::from_vec(all))
}

fn upper_tail(statistic: f64, dof: usize) -> f64 {
    ChiSquared::new(dof as f64).map_or(f64::NAN, |chi2| chi2.sf(statistic))
}

fn critical_value(dof: usize) -> f64 {
    protocol::estimate::chi2_quantile(1.0 - SIGNIFICANCE, dof)
}

/// P(χ'² > x) for a non-central χ²: a Poisson mixture of central ones.
fn noncentral_upper_tail(x: f64, dof: usize, non_centrality: f64) -> f64 {
    let half = 0.5 * non_centrality;
    // Terms beyond eight sigmas of the Poisson distribution are below 1e-14.
    let (first, last) = ((half - 8.0 * half.sqrt()).max(0.0) as usize, (half + 8.0 * half.sqrt()) as usize + 20);
    let mut log_factorial: f64 = (1..=first).map(|k| (k as f64).ln()).sum();
    let mut total = 0.0;
    for j in first..=last {
        if j > first {
            log_factorial += (j as f64).ln();
        }
        let log_weight = if half > 0.0 {
            -half + j as f64 * half.ln() - log_factorial
        } else if j == 0 {
            0.0
        } else {
            f64::NEG_INFINITY
        };
        total += log_weight.exp() * upper_tail(x, dof + 2 * j);
    }
    total.clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The golden grid of 7×7 points, seen through design D about its centre.
    fn golden_view() -> (View, serde_json::Value) {
        let golden = crate::calibration::golden("svp_stat");
        let raw: Vec<[f64; 2]> = serde_json::from_value(golden["inputs"]["raw"].clone()).unwrap();
        let grid = |n: usize| Vector3::new((n % 7) as f64 / 3.0 - 1.0, (n / 7) as f64 / 3.0 - 1.0, 0.0);
        let points = raw.iter().enumerate().map(|(n, p)| (grid(n), Vector2::new(383.5 + p[0], 287.5 + p[1])));
        (View { name: "golden".into(), points: points.collect() }, golden["outputs"].clone())
    }

    #[test]
    fn the_statistic_is_the_golden_one() {
        let (view, expected) = golden_view();
        let test = single_viewpoint(&Pal::reference(), &view, 0.1, REFERENCE_LOCUS_M).unwrap();
        assert_eq!(test.dof, 90);
        assert!((test.statistic - expected["T"].as_f64().unwrap()).abs() < 1e-6 * test.statistic * 10.0, "{test:?}");
        assert!((test.p_value - expected["p"].as_f64().unwrap()).abs() < 1e-6, "{test:?}");
    }

    /// A 7×7 board over ±20° of bearing and the whole field of view in front of the report's lens, exact rays, no noise.
    fn near_board(distance_m: f64) -> View {
        let camera = Pal::reference();
        let half = distance_m * 20.0_f64.to_radians().tan();
        let points = (0..49).filter_map(|n| {
            let (i, j) = ((n % 7) as f64 / 3.0 - 1.0, (n / 7) as f64 / 3.0 - 1.0);
            let object = Vector3::new(i * half, j * 0.28 * distance_m, 0.0);
            let point = Vector3::new(distance_m, object.x, object.y + 0.062 * distance_m);
            Some((object, camera.image_of_point(&point)?))
        });
        View { name: format!("{distance_m} m"), points: points.collect() }
    }

    #[test]
    fn the_report_s_lens_is_found_out_near_and_not_far() {
        let camera = Pal::reference();
        let near = single_viewpoint(&camera, &near_board(0.1), 0.1, REFERENCE_LOCUS_M).unwrap();
        assert!(near.verdict == Verdict::NotOnePoint && near.power > 0.99, "{near:?}");
        // Without noise T_H is the non-centrality itself: the power that is told must be the one it gives.
        let medium = single_viewpoint(&camera, &near_board(0.3), 0.1, REFERENCE_LOCUS_M).unwrap();
        let power = noncentral_upper_tail(critical_value(medium.dof), medium.dof, medium.statistic);
        assert!((medium.power - power).abs() < 0.05, "{power}, {medium:?}");
        let far = single_viewpoint(&camera, &near_board(1.0), 0.1, REFERENCE_LOCUS_M).unwrap();
        assert!(far.verdict == Verdict::Undecided && far.power < 0.1, "{far:?}");
        assert!(far.words().contains("nearer"));
        // A locus ten times as long is found from three times as far (`MATHS.md` §4.3: the non-centrality is as its square).
        let long = single_viewpoint(&camera, &near_board(1.0), 0.1, 10.0 * REFERENCE_LOCUS_M).unwrap();
        assert!(long.power > 0.99 && long.words().contains("31.50 mm"), "{long:?}");
        let error = single_viewpoint(&camera, &near_board(1.0), 0.1, 3.15).unwrap_err().to_string();
        assert!(error.contains("millimetres"), "{error}");
    }

    #[test]
    fn two_distances_give_the_point_on_the_axis_exactly() {
        // A ray from z = 4.6 upwards by 0.3 a unit.
        let at = |r: f64| (r, 4.6 + 0.3 * r);
        assert!((locus_from_two_distances(at(250.0), at(900.0)).unwrap() - 4.6).abs() < 1e-12);
        assert_eq!(locus_from_two_distances(at(250.0), at(250.0)), None);
    }

    #[test]
    fn the_non_central_tail_agrees_with_tables() {
        // One degree of freedom: the two tails of a normal distribution about 1, beyond ±1.96.
        assert!((noncentral_upper_tail(3.841_459, 1, 1.0) - 0.170_075).abs() < 1e-4);
        assert!((noncentral_upper_tail(5.991_465, 2, 0.0) - 0.05).abs() < 1e-6);
    }
}
