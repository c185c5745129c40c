//! How a calibrated camera sits on its robot: yaw, tilt and height.
//!
//! Whatever was seen that says something about it is a residual of one problem in roll, pitch, yaw and position:
//!
//! | seen | says | residual |
//! |---|---|---|
//! | vertical line | tilt | z-component of the normal of the plane that its rays span |
//! | point of known place (body frame) | all | its image minus its projection |
//! | upright thing of known height on the floor | height, tilt | that its top is above its foot, by its height |
//! | pixel straight ahead | yaw | its bearing |
//! | the same far things before and after a straight drive | yaw, a little tilt | flow (d₁ × d₂)·x, which is 0 for a drive along x |
//!
//! What the mounting was before counts as a very weak measurement, so that what nothing was seen of stays as it was; such
//! numbers are named. Lines that are not vertical are outvoted (residuals beyond a few sigmas count less).
//!
//! Source: `MATHS.md` §4.1 (tilt), §7 (11) (heights).

use nalgebra::{DMatrix, DVector, Matrix3, Rotation3, SymmetricEigen, Vector2, Vector3};
use serde::Deserialize;

use super::bundle::OUTLIER_SIGMAS;
use super::least_squares::{Minimum, minimise};
use crate::optics::{Camera, MountedCamera, Mounting, bearing_rad, elevation_rad};

/// Sigma of what the mounting was before: radians and metres.
const PRIOR: [f64; 6] = [0.5, 0.5, 3.0, 1.0, 1.0, 1.0];
/// A sigma above this share of the prior's: nothing was seen of it.
const UNSEEN: f64 = 0.5;
/// Rounds of reweighting.
const ROUNDS: usize = 15;
/// Tilt that lines differ by among themselves in a real room, radians: edges of doors and shelves are not plumb.
const PLUMB_SIGMA_RAD: f64 = 0.002;
/// Lines whose bearings differ by less are one edge of the room, in pieces or in several pictures, radians. What is wrong with
/// an edge is wrong in all of them, so they count as one line, seen better.
const SAME_LINE_RAD: f64 = 0.006;

/// What was seen, as it stands in a file.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Seen {
    /// Points on each vertical line, px.
    #[serde(default)]
    pub vertical_lines_px: Vec<Vec<[f64; 2]>>,
    /// Points of known place.
    #[serde(default)]
    pub points: Vec<KnownPoint>,
    /// Upright things of known height that stand on the floor.
    #[serde(default)]
    pub uprights: Vec<Upright>,
    /// Pixels that are straight ahead.
    #[serde(default)]
    pub ahead_px: Vec<[f64; 2]>,
    /// Pixels of the same things before and after a straight drive forwards.
    #[serde(default)]
    pub drive_px: Vec<[[f64; 2]; 2]>,
    /// Noise of a pixel in each component, px.
    #[serde(default = "half_pixel")]
    pub sigma_px: f64,
}

fn half_pixel() -> f64 {
    0.5
}

/// A point of known place.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KnownPoint {
    /// In the body frame, metres.
    pub body_m: [f64; 3],
    /// Where it was seen.
    pub px: [f64; 2],
}

/// An upright thing on the floor: a person, a robot, a pole.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Upright {
    /// Its foot.
    pub foot_px: [f64; 2],
    /// Its top.
    pub top_px: [f64; 2],
    /// Metres.
    pub height_m: f64,
}

/// A mounting that was found.
#[derive(Debug, Clone)]
pub struct MountingFit {
    /// Old numbers where nothing was seen of them.
    pub mounting: Mounting,
    /// Of roll, pitch, yaw (radians) and x, y, z (metres).
    pub covariance: DMatrix<f64>,
    /// Sum of squared standardised residuals of what was seen.
    pub chi2: f64,
    /// Residuals minus numbers that they determine.
    pub dof: usize,
    /// Residuals that count less than fully.
    pub outliers: usize,
    /// Numbers that nothing was seen of.
    pub undetermined: Vec<&'static str>,
    /// Edges of the room that the vertical lines are pieces or repetitions of.
    pub edges: usize,
}

/// Why there is no mounting.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MountingError {
    /// Nothing to go by.
    #[error(
        "nothing was seen: at least 3 vertical lines, 3 known points, an upright thing, a pixel ahead or a drive is wanted"
    )]
    Nothing,
    /// A number that cannot be.
    #[error("{what} {index}: {problem}")]
    Wrong {
        /// Kind of observation.
        what: &'static str,
        /// Index from 0.
        index: usize,
        /// What is wrong and what would be right.
        problem: String,
    },
    /// No fit.
    #[error("the fit failed: what was seen contradicts itself")]
    NoFit,
}

/// Names of the six numbers.
const NAMES: [&str; 6] = ["roll", "pitch", "yaw", "x", "y", "height"];

/// Finds the mounting of a camera from what it saw; the camera's present mounting is where it starts.
///
/// # Errors
/// Nothing was seen, a pixel has no ray, or nothing fits.
pub fn find(camera: &MountedCamera, seen: &Seen) -> Result<MountingFit, MountingError> {
    let terms = Terms::new(camera, seen)?;
    let start = camera.mounting();
    let prior = DVector::from_vec(start.rotation_rpy_rad.iter().chain(start.position_m.iter()).copied().collect());
    let mut weights = vec![1.0; terms.count()];
    let mut found: Option<Minimum> = None;
    for _ in 0..ROUNDS {
        let from = found.as_ref().map_or_else(|| prior.clone(), |m| m.x.clone());
        let minimum = minimise(from, &[1e-6; 6], |x| {
            let mut all = terms.residuals(x)?;
            all.iter_mut().zip(&weights).for_each(|(r, w)| *r *= f64::sqrt(*w));
            all.extend(x.iter().zip(prior.iter()).zip(PRIOR).map(|((x, p), sigma)| (x - p) / sigma));
            Some(DVector::from_vec(all))
        });
        let minimum = minimum.ok_or(MountingError::NoFit)?;
        let residuals = terms.residuals(&minimum.x).ok_or(MountingError::NoFit)?;
        found = Some(minimum);
        let mut changed = false;
        for (weight, residual) in weights.iter_mut().zip(&residuals) {
            // Falls so fast because many a straight edge of a room is not vertical, and more may lean one way than the other.
            let new = (OUTLIER_SIGMAS / residual.abs().max(1e-9)).powi(4).min(1.0);
            changed |= (new - *weight).abs() > 0.01;
            *weight = new;
        }
        if !changed {
            break;
        }
    }
    let minimum = found.ok_or(MountingError::NoFit)?;
    terms.finish(start, &minimum, &weights)
}

/// Everything seen as rays in the camera's frame (mirror reversal removed), and its sigmas.
struct Terms<'a> {
    camera: &'a MountedCamera,
    /// Normals of vertical planes, and the sigma of each.
    planes: Vec<(Vector3<f64>, f64)>,
    points: Vec<(Vector3<f64>, Vector2<f64>)>,
    /// Rays of foot and top, and the height.
    uprights: Vec<(Vector3<f64>, Vector3<f64>, f64)>,
    ahead: Vec<Vector3<f64>>,
    drive: Vec<(Vector3<f64>, f64)>,
    sigma_px: f64,
    /// Radians a pixel, about.
    rad_per_px: f64,
}

impl<'a> Terms<'a> {
    fn new(camera: &'a MountedCamera, seen: &Seen) -> Result<Self, MountingError> {
        let wrong = |what, index, problem: String| MountingError::Wrong { what, index, problem };
        if !(0.001..=50.0).contains(&seen.sigma_px) {
            return Err(wrong("sigma_px", 0, format!("{} px, must be between 0.001 and 50", seen.sigma_px)));
        }
        let ray = |what: &'static str, index: usize, px: [f64; 2]| {
            let ray = camera.camera().ray_of_image(&Vector2::from(px)).map(|ray| camera.reversed(ray.direction));
            ray.ok_or_else(|| wrong(what, index, format!("the camera sees nothing at {px:?} px")))
        };
        let rad_per_px = rad_per_px(camera.camera());
        let sigma_rad = seen.sigma_px * rad_per_px;
        let mut terms = Self {
            camera,
            planes: Vec::new(),
            points: Vec::new(),
            uprights: Vec::new(),
            ahead: Vec::new(),
            drive: Vec::new(),
            sigma_px: seen.sigma_px,
            rad_per_px,
        };
        let mut planes = Vec::with_capacity(seen.vertical_lines_px.len());
        for (index, line) in seen.vertical_lines_px.iter().enumerate() {
            if line.len() < 3 {
                return Err(wrong("vertical_lines_px", index, format!("{} points, must be 3 or more", line.len())));
            }
            let rays = line.iter().map(|px| ray("vertical_lines_px", index, *px)).collect::<Result<Vec<_>, _>>()?;
            planes.push(plane(&rays, sigma_rad));
        }
        terms.planes = edges_of_the_room(&planes);
        for (index, p) in seen.points.iter().enumerate() {
            if !p.body_m.iter().chain(&p.px).all(|x| x.is_finite()) {
                return Err(wrong("points", index, "body_m and px must be finite numbers".into()));
            }
            terms.points.push((Vector3::from(p.body_m), Vector2::from(p.px)));
        }
        for (index, u) in seen.uprights.iter().enumerate() {
            if !(u.height_m > 0.05 && u.height_m < 10.0) {
                return Err(wrong("uprights", index, format!("height_m {}, must be between 0.05 and 10", u.height_m)));
            }
            let (foot, top) = (ray("uprights", index, u.foot_px)?, ray("uprights", index, u.top_px)?);
            terms.uprights.push((foot, top, u.height_m));
        }
        for (index, px) in seen.ahead_px.iter().enumerate() {
            terms.ahead.push(ray("ahead_px", index, *px)?);
        }
        for (index, [before, after]) in seen.drive_px.iter().enumerate() {
            let (a, b) = (ray("drive_px", index, *before)?, ray("drive_px", index, *after)?);
            let cross = a.cross(&b);
            // Where nothing moved the normal is noise.
            let turned = cross.norm();
            if turned > 3.0 * sigma_rad {
                terms.drive.push((cross / turned, sigma_rad * std::f64::consts::SQRT_2 / turned));
            }
        }
        if terms.count() == 0 {
            return Err(MountingError::Nothing);
        }
        Ok(terms)
    }

    fn count(&self) -> usize {
        self.planes.len() + 2 * self.points.len() + 2 * self.uprights.len() + self.ahead.len() + self.drive.len()
    }

    /// Standardised residuals for roll, pitch, yaw, x, y, z. `None` where a known point has no image.
    fn residuals(&self, x: &DVector<f64>) -> Option<Vec<f64>> {
        let body_from_camera = Rotation3::from_euler_angles(x[0], x[1], x[2]);
        let position = Vector3::new(x[3], x[4], x[5]);
        let sigma_rad = self.sigma_px * self.rad_per_px;
        // The height that rays without an origin come from.
        let eye = position.z + (body_from_camera * self.camera.reversed(self.camera.camera().viewpoint_m())).z;
        let mut all = Vec::with_capacity(self.count());
        all.extend(self.planes.iter().map(|(normal, sigma)| (body_from_camera * normal).z / sigma));
        for (point, pixel) in &self.points {
            let in_camera = self.camera.reversed(body_from_camera.inverse() * (point - position));
            let offset = self.camera.camera().image_of_point(&in_camera)? - pixel;
            all.extend([offset.x / self.sigma_px, offset.y / self.sigma_px]);
        }
        for (foot, top, height) in &self.uprights {
            let (foot, top) = (body_from_camera * foot, body_from_camera * top);
            let along = protocol::angle::wrap(bearing_rad(&top) - bearing_rad(&foot));
            all.push(along / (std::f64::consts::SQRT_2 * sigma_rad / elevation_rad(&foot).cos().max(0.1)));
            // Foot and top at one distance D: D tan(−e_foot) = eye, D tan(e_top) = height − eye. The top's elevation from the foot's.
            let tangent = -elevation_rad(&foot).tan();
            let distance = eye / tangent;
            let expected = ((height - eye) / distance).atan();
            // The foot's noise moves the expected top by the ratio of the two heights.
            let ratio = (height - eye) / eye;
            let scale = (1.0 + ratio * ratio).sqrt() * sigma_rad;
            all.push(if tangent > 1e-4 { (elevation_rad(&top) - expected) / scale } else { 1e3 });
        }
        all.extend(self.ahead.iter().map(|ray| bearing_rad(&(body_from_camera * ray)) / sigma_rad));
        all.extend(self.drive.iter().map(|(normal, sigma)| (body_from_camera * normal).x / sigma));
        Some(all)
    }

    fn finish(&self, start: &Mounting, minimum: &Minimum, weights: &[f64]) -> Result<MountingFit, MountingError> {
        let information = minimum.jacobian.tr_mul(&minimum.jacobian);
        let chi2 = minimum.residuals.rows(0, weights.len()).norm_squared();
        let covariance = information.try_inverse().ok_or(MountingError::NoFit)?;
        let unseen: [bool; 6] = std::array::from_fn(|i| covariance[(i, i)].sqrt() > UNSEEN * PRIOR[i]);
        let undetermined: Vec<&'static str> = (0..6).filter(|i| unseen[*i]).map(|i| NAMES[i]).collect();
        let dof = weights.len().saturating_sub(6 - undetermined.len());
        // Where the residuals are larger than they should be, so are the sigmas.
        let scale = if dof > 0 { (chi2 / dof as f64).max(1.0) } else { 1.0 };
        let covariance = covariance * scale;
        let mut mounting = *start;
        for i in 0..3 {
            if !unseen[i] {
                mounting.rotation_rpy_rad[i] = protocol::angle::wrap(minimum.x[i]);
                mounting.sigma.rotation_rpy_rad[i] = covariance[(i, i)].sqrt();
            }
            if !unseen[3 + i] {
                mounting.position_m[i] = minimum.x[3 + i];
                mounting.sigma.position_m[i] = covariance[(3 + i, 3 + i)].sqrt();
                mounting.height_is_given |= i == 2;
            }
        }
        let outliers = weights.iter().filter(|w| **w < 1.0).count();
        let edges = self.planes.len();
        Ok(MountingFit { mounting, covariance, chi2, dof, outliers, undetermined, edges })
    }
}

/// Planes of lines, each with the sigma of its points' noise, as planes of the edges that they are pieces or repetitions of;
/// the sigmas now with what edges differ by among themselves.
fn edges_of_the_room(planes: &[(Vector3<f64>, f64)]) -> Vec<(Vector3<f64>, f64)> {
    // Sum of the normals weighted by information, and the information.
    let mut edges: Vec<(Vector3<f64>, f64)> = Vec::new();
    for (normal, sigma) in planes {
        let information = (sigma * sigma).recip();
        // Where a line stands is known well; how it leans, only as well as it is long.
        let aside = |sum: &Vector3<f64>| {
            let level = sum.xy().norm() * normal.xy().norm();
            (sum.x * normal.y - sum.y * normal.x).abs() / level.max(1e-12)
        };
        let lean = |(sum, total): &(Vector3<f64>, f64)| {
            let same_way = sum.dot(normal).signum();
            let apart = (sum.z / sum.norm() - same_way * normal.z).abs();
            apart / total.sqrt().recip().hypot(*sigma).hypot(PLUMB_SIGMA_RAD)
        };
        let known = edges.iter_mut().filter(|e| aside(&e.0) < SAME_LINE_RAD && lean(e) < OUTLIER_SIGMAS);
        match known.min_by(|a, b| aside(&a.0).total_cmp(&aside(&b.0))) {
            Some((sum, total)) => {
                *sum += normal * (information * sum.dot(normal).signum());
                *total += information;
            }
            None => edges.push((normal * information, information)),
        }
    }
    edges.into_iter().map(|(sum, total)| (sum.normalize(), total.sqrt().recip().hypot(PLUMB_SIGMA_RAD))).collect()
}

/// The normal of the plane that a line's rays span, and the sigma of its direction by the points' noise.
fn plane(rays: &[Vector3<f64>], sigma_rad: f64) -> (Vector3<f64>, f64) {
    let scatter: Matrix3<f64> = rays.iter().map(|r| r * r.transpose()).sum();
    let eigen = SymmetricEigen::new(scatter);
    let normal = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
    // The plane can turn about the rays' mean; their spread is the lever.
    let mut values: [f64; 3] = eigen.eigenvalues.into();
    values.sort_by(f64::total_cmp);
    let lever = values[1].max(1e-12).sqrt();
    (normal, sigma_rad / lever)
}

/// Radians a pixel in the middle of the field of view.
fn rad_per_px(camera: &dyn Camera) -> f64 {
    let [low, high] = camera.elevation_rad();
    let point = crate::optics::direction(0.0, 0.5 * (low + high));
    let slope = camera.point_jacobian(&point).map_or(0.0, |j| j.norm() / std::f64::consts::SQRT_2);
    if slope > 0.0 { slope.recip() } else { 1e-3 }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal};

    use super::*;
    use crate::optics::Pal;

    fn mounted(rpy_deg: [f64; 3], height_m: f64) -> MountedCamera {
        let mut mounting = Mounting::at_height(height_m);
        mounting.rotation_rpy_rad = rpy_deg.map(f64::to_radians);
        MountedCamera::new(Pal::reference(), mounting)
    }

    /// What a camera sees of vertical lines, uprights and things ahead, with noise.
    fn seen(camera: &MountedCamera, seed: u64, sigma_px: f64) -> Seen {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let noise = Normal::new(0.0, sigma_px).unwrap();
        let mut look = |x: f64, y: f64, z: f64| {
            let pixel = camera.project_body(&Vector3::new(x, y, z))?;
            Some([pixel.x + noise.sample(&mut random), pixel.y + noise.sample(&mut random)])
        };
        let mut seen = Seen { sigma_px, ..Seen::default() };
        for i in 0..16 {
            let bearing = f64::from(i) * 0.39;
            let (x, y) = (3.5 * bearing.cos(), 3.5 * bearing.sin());
            seen.vertical_lines_px.push((0..40).filter_map(|k| look(x, y, 0.05 + 0.04 * f64::from(k))).collect());
        }
        for i in 0..8 {
            let bearing = f64::from(i) * 0.77;
            let (x, y) = (3.0 * bearing.cos(), 3.0 * bearing.sin());
            if let (Some(foot_px), Some(top_px)) = (look(x, y, 0.0), look(x, y, 1.2)) {
                seen.uprights.push(Upright { foot_px, top_px, height_m: 1.2 });
            }
        }
        seen.ahead_px = [4.0, 5.0, 6.0].iter().filter_map(|x| look(*x, 0.0, 0.7)).collect();
        seen
    }

    #[test]
    fn tilts_of_up_to_three_degrees_are_found_within_their_covariance() {
        // Squared standardised errors of roll, pitch, yaw and height: 4 a run.
        let (mut nees, mut runs) = (0.0, 0);
        for seed in 0..40 {
            let t = seed as f64;
            let truth = mounted([1.5 + 1.5 * (t * 1.1).sin(), 3.0 * (t * 0.7).cos(), 10.0 * (t * 0.3).sin()], 0.62);
            let level = mounted([0.0; 3], 0.55);
            let fit = find(&level, &seen(&truth, seed, 0.3)).unwrap();
            assert_eq!(fit.undetermined, ["x", "y"], "{fit:?}");
            let error = DVector::from_vec(vec![
                fit.mounting.rotation_rpy_rad[0] - truth.mounting().rotation_rpy_rad[0],
                fit.mounting.rotation_rpy_rad[1] - truth.mounting().rotation_rpy_rad[1],
                fit.mounting.rotation_rpy_rad[2] - truth.mounting().rotation_rpy_rad[2],
                fit.mounting.position_m.z - truth.mounting().position_m.z,
            ]);
            let index = [0, 1, 2, 5];
            let covariance = DMatrix::from_fn(4, 4, |i, j| fit.covariance[(index[i], index[j])]);
            assert!(error.rows(0, 2).norm().to_degrees() < 0.2, "{error}");
            nees += error.dot(&(covariance.try_inverse().unwrap() * &error));
            runs += 1;
        }
        let mean = nees / (4.0 * f64::from(runs));
        // 95 % bounds of χ² with 160 degrees of freedom reach to 1.23; the lines' plumb sigma is part of the covariance and
        // not of this world, so a little less than one is honest.
        assert!(mean > 0.6 && mean < 1.23, "{mean}");
    }

    #[test]
    fn the_same_lines_in_more_pictures_do_not_make_the_tilt_surer_than_the_room_is_plumb() {
        let truth = mounted([1.0, -2.0, 0.0], 0.6);
        let level = mounted([0.0; 3], 0.6);
        let mut many =
            Seen { vertical_lines_px: seen(&truth, 3, 0.2).vertical_lines_px, sigma_px: 0.2, ..Seen::default() };
        let one = find(&level, &many).unwrap();
        for seed in 4..12 {
            many.vertical_lines_px.extend(seen(&truth, seed, 0.2).vertical_lines_px);
        }
        let many = find(&level, &many).unwrap();
        assert!(one.edges == 16 && many.edges == 16, "{} {}", one.edges, many.edges);
        for i in 0..2 {
            let (few, more) = (one.covariance[(i, i)].sqrt(), many.covariance[(i, i)].sqrt());
            // Sixteen edges that are plumb to 0.002 rad, half of which tell about each axis.
            assert!(more < few && more > 0.9 * PLUMB_SIGMA_RAD / 8.0_f64.sqrt(), "{few} {more}");
        }
    }

    #[test]
    fn a_slanted_edge_among_vertical_lines_is_outvoted() {
        let truth = mounted([1.0, -2.0, 0.0], 0.6);
        let mut seen = seen(&truth, 7, 0.2);
        for (k, px) in seen.vertical_lines_px[3].iter_mut().enumerate() {
            px[0] += 0.6 * k as f64;
        }
        let fit = find(&mounted([0.0; 3], 0.6), &seen).unwrap();
        let error = (fit.mounting.rotation_rpy_rad[1] - truth.mounting().rotation_rpy_rad[1]).to_degrees();
        assert!(error.abs() < 0.15 && fit.outliers >= 1, "{error} {fit:?}");
    }

    #[test]
    fn a_straight_drive_gives_the_yaw() {
        let truth = mounted([0.0, 0.0, 25.0], 0.6);
        let mut seen = Seen { sigma_px: 0.1, ..Seen::default() };
        for i in 0..24 {
            let bearing = f64::from(i) * 0.26;
            let place = Vector3::new(3.0 * bearing.cos(), 3.0 * bearing.sin(), 0.3 + 0.05 * f64::from(i % 8));
            let (before, after) = (truth.project_body(&place), truth.project_body(&(place - Vector3::x() * 0.5)));
            if let (Some(a), Some(b)) = (before, after) {
                seen.drive_px.push([[a.x, a.y], [b.x, b.y]]);
            }
        }
        let fit = find(&mounted([0.0; 3], 0.6), &seen).unwrap();
        assert!((fit.mounting.rotation_rpy_rad[2].to_degrees() - 25.0).abs() < 0.3, "{fit:?}");
        assert!(fit.undetermined.contains(&"height"));
    }

    #[test]
    fn nothing_seen_and_pixels_without_rays_are_errors_in_words() {
        let camera = mounted([0.0; 3], 0.6);
        assert_eq!(find(&camera, &Seen { sigma_px: 0.5, ..Seen::default() }).unwrap_err(), MountingError::Nothing);
        let short = Seen { vertical_lines_px: vec![vec![[500.0, 280.0]; 2]], sigma_px: 0.5, ..Seen::default() };
        assert!(find(&camera, &short).unwrap_err().to_string().contains("3 or more"));
    }
}
