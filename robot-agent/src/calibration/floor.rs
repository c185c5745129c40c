//! Whether a camera file fits its camera, from points seen on lines of a known floor plan: a playing field, tiles, tape.
//!
//! Problem: a calibration that was copied from another robot, or that a knock has made stale, looks like any other. Insight:
//! points on lines of the floor must fall on the plan's lines for one pose of the robot, and a wrong camera bends them, which
//! no pose can mend. Algorithm: the pixels' rays meet the floor; the pose whose points lie nearest to the plan is searched on
//! a grid of places and headings over the plan with a capped distance, so that what is no line does not matter, and then
//! found by reweighted Gauss–Newton. Distances are told in metres and in sigmas of what pixels and the lines' width explain.
//!
//! No counterpart in the report; the way RoboCup's teams check their mirrors.

use nalgebra::{Matrix3, Rotation2, Vector2, Vector3};
use serde::Deserialize;

use crate::optics::MountedCamera;

/// Farther from any line a point counts as no line's, metres.
const CAP_M: f64 = 0.4;
/// The search's steps.
const STEP_M: f64 = 0.3;
const HEADINGS: usize = 120;
/// Cells of the map of distances.
const CELL_M: f64 = 0.1;
/// Points that the search looks at.
const SEARCH_POINTS: usize = 250;
/// Places that are refined.
const REFINED: usize = 8;
/// Largest plan along a side, metres.
const MAX_PLAN_M: f64 = 60.0;
const MIN_POINTS: usize = 30;
/// A median distance beyond this many sigmas is a camera file that does not fit; of a right one it is about 0.7.
const MISFIT_SIGMAS: f64 = 1.5;

/// Lines on the floor, metres, in any frame of the floor.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    /// Straight lines' middles: x and y of both ends.
    #[serde(default)]
    pub lines_m: Vec<[f64; 4]>,
    /// Circles' middles: x and y of the centre, radius.
    #[serde(default)]
    pub circles_m: Vec<[f64; 3]>,
    /// How wide the lines are painted: points may lie anywhere on them.
    #[serde(default)]
    pub line_width_m: f64,
}

/// Where the robot stands on the plan, and how well the points fall on the lines.
#[derive(Debug, Clone, PartialEq)]
pub struct FloorFit {
    /// x and y, metres, and heading, radians.
    pub pose: [f64; 3],
    /// Of the pose, scaled up where the points scatter more than they should.
    pub covariance: Matrix3<f64>,
    /// Points that were used.
    pub points: usize,
    /// Points that see no floor, or floor beyond the range.
    pub left_out: usize,
    /// Median distance from the nearest line's middle, metres.
    pub median_m: f64,
    /// Distance that four fifths of the points stay below, metres.
    pub four_fifths_m: f64,
    /// Median distance in sigmas of pixels and the lines' width.
    pub median_sigmas: f64,
}

/// Why nothing was found.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FloorError {
    /// A plan that is none.
    #[error("plan: {0}")]
    Plan(String),
    /// A number that cannot be.
    #[error("{what} {value}: {expected}")]
    Wrong {
        /// Which.
        what: &'static str,
        /// As given.
        value: f64,
        /// What would be right.
        expected: &'static str,
    },
    /// No height.
    #[error("the camera's height above the floor is unknown; give [mounting] height_m in the camera file")]
    NoHeight,
    /// Too few points.
    #[error(
        "{points} of {all} points are on the floor within {range_m} m; at least {MIN_POINTS} are wanted (does the camera file say how \
         the camera hangs?)"
    )]
    TooFewPoints {
        /// On the floor.
        points: usize,
        /// Given.
        all: usize,
        /// Largest distance.
        range_m: f64,
    },
    /// All poses are alike.
    #[error("the lines that were seen do not determine where the robot stands")]
    Undetermined,
}

impl FloorFit {
    /// Whether the points fall on the lines as they should.
    pub fn fits(&self) -> bool {
        self.median_sigmas <= MISFIT_SIGMAS
    }

    /// The finding in words.
    pub fn words(&self) -> String {
        let Self { points, median_m, four_fifths_m, median_sigmas, pose: [x, y, heading], .. } = self;
        let numbers = format!(
            "half of {points} points are within {:.1} cm of a line, four fifths within {:.1} cm, the median is {median_sigmas:.1} sigmas; \
             best place [{x:.2}, {y:.2}] m, {:.1}°",
            median_m * 100.0,
            four_fifths_m * 100.0,
            heading.to_degrees()
        );
        if self.fits() {
            format!("the camera file fits: {numbers}")
        } else {
            format!("the camera file does not fit its camera (another camera's, stale, or another floor?): {numbers}")
        }
    }
}

/// A point on the floor in the body frame, and how far half a pixel's diagonal moves it for one pixel of noise, metres.
struct Seen {
    place: Vector2<f64>,
    sigma_m: f64,
}

/// Finds where the robot stands; `sigma_px` is the noise of a point in each component, and only floor within `range_m` of
/// the camera counts.
///
/// # Errors
/// A plan or numbers that cannot be, too few points on the floor, or lines that leave the place open.
pub fn fit(
    camera: &MountedCamera,
    plan: &Plan,
    points_px: &[[f64; 2]],
    sigma_px: f64,
    range_m: f64,
) -> Result<FloorFit, FloorError> {
    check(plan, sigma_px, range_m)?;
    camera.mounting().height_m().ok_or(FloorError::NoHeight)?;
    let seen: Vec<Seen> = points_px
        .iter()
        .filter_map(|px| Seen::of(camera, Vector2::from(*px), sigma_px, plan.line_width_m))
        .filter(|seen| seen.place.norm() <= range_m)
        .collect();
    if seen.len() < MIN_POINTS {
        return Err(FloorError::TooFewPoints { points: seen.len(), all: points_px.len(), range_m });
    }
    let refined = search(plan, &seen).into_iter().filter_map(|start| refine(plan, &seen, start));
    let (_, pose, covariance) = refined.min_by(|a, b| a.0.total_cmp(&b.0)).ok_or(FloorError::Undetermined)?;
    let mut distances: Vec<(f64, f64)> = seen
        .iter()
        .map(|s| {
            let distance = plan.nearest(&moved(&pose, &s.place)).0.abs();
            (distance, distance / s.sigma_m)
        })
        .collect();
    let count = distances.len();
    distances.sort_by(|a, b| a.1.total_cmp(&b.1));
    let median_sigmas = distances[count / 2].1;
    distances.sort_by(|a, b| a.0.total_cmp(&b.0));
    Ok(FloorFit {
        pose: [pose.x, pose.y, protocol::angle::wrap(pose.z)],
        covariance,
        points: count,
        left_out: points_px.len() - count,
        median_m: distances[count / 2].0,
        four_fifths_m: distances[count * 4 / 5].0,
        median_sigmas,
    })
}

impl Seen {
    fn of(camera: &MountedCamera, pixel: Vector2<f64>, sigma_px: f64, line_width_m: f64) -> Option<Self> {
        let floor = |pixel: &Vector2<f64>| {
            let ray = camera.unproject_body(pixel)?;
            let down = -ray.origin_m.z / ray.direction.z;
            (down > 0.0 && down.is_finite()).then(|| (ray.origin_m + ray.direction * down).xy())
        };
        let place = floor(&pixel)?;
        let half = 0.5;
        let along =
            |step: Vector2<f64>| Some((floor(&(pixel + step))? - floor(&(pixel - step))?).norm() / (2.0 * half));
        let scale = along(Vector2::new(half, 0.0))?.max(along(Vector2::new(0.0, half))?);
        // A point anywhere on a line's width: a uniform distribution.
        Some(Self { place, sigma_m: (sigma_px * scale).hypot(line_width_m / 12.0_f64.sqrt()).max(1e-4) })
    }
}

impl Plan {
    /// From the nearest line's middle to a point: the distance, signed, and the unit vector along which it counts.
    fn nearest(&self, point: &Vector2<f64>) -> (f64, Vector2<f64>) {
        let lines = self.lines_m.iter().map(|[x0, y0, x1, y1]| {
            let (from, along) = (Vector2::new(*x0, *y0), Vector2::new(x1 - x0, y1 - y0));
            let share = (point - from).dot(&along) / along.norm_squared();
            let off = point - from - along * share.clamp(0.0, 1.0);
            if (0.0..=1.0).contains(&share) {
                // Across the line also where the point lies on it.
                let across = Vector2::new(-along.y, along.x).normalize();
                (off.dot(&across), across)
            } else {
                let distance = off.norm().max(1e-12);
                (distance, off / distance)
            }
        });
        let circles = self.circles_m.iter().map(|[x, y, radius]| {
            let off = point - Vector2::new(*x, *y);
            let distance = off.norm().max(1e-12);
            (distance - radius, off / distance)
        });
        let nearest = lines.chain(circles).min_by(|a, b| a.0.abs().total_cmp(&b.0.abs()));
        nearest.unwrap_or((0.0, Vector2::x()))
    }

    /// Lowest and highest x and y.
    fn extent_m(&self) -> [Vector2<f64>; 2] {
        let ends = self.lines_m.iter().flat_map(|[x0, y0, x1, y1]| [Vector2::new(*x0, *y0), Vector2::new(*x1, *y1)]);
        let rims = self.circles_m.iter().flat_map(|[x, y, r]| [Vector2::new(x - r, y - r), Vector2::new(x + r, y + r)]);
        let infinity = Vector2::repeat(f64::INFINITY);
        ends.chain(rims).fold([infinity, -infinity], |[low, high], p| [low.inf(&p), high.sup(&p)])
    }
}

fn moved(pose: &Vector3<f64>, place: &Vector2<f64>) -> Vector2<f64> {
    Rotation2::new(pose.z) * place + pose.xy()
}

/// The best places and headings on a grid, best first.
fn search(plan: &Plan, seen: &[Seen]) -> Vec<Vector3<f64>> {
    let [low, high] = plan.extent_m();
    let reach = seen.iter().map(|s| s.place.norm()).fold(0.0, f64::max) + CELL_M;
    let origin = low - Vector2::repeat(reach);
    let cells = (high - low + Vector2::repeat(2.0 * reach)).map(|side| (side / CELL_M).ceil() as usize + 1);
    let mut distance = vec![0.0f32; cells.x * cells.y];
    for j in 0..cells.y {
        for i in 0..cells.x {
            let middle = origin + Vector2::new(i as f64 + 0.5, j as f64 + 0.5) * CELL_M;
            distance[j * cells.x + i] = plan.nearest(&middle).0.abs().min(CAP_M) as f32;
        }
    }
    let step = (seen.len() / SEARCH_POINTS).max(1);
    let steps = ((high - low) / STEP_M).map(|n| n.ceil() as usize);
    let mut found: Vec<(f32, Vector3<f64>)> = Vec::new();
    for h in 0..HEADINGS {
        let heading = std::f64::consts::TAU * h as f64 / HEADINGS as f64;
        let turn = Rotation2::new(heading);
        let turned: Vec<Vector2<f64>> = seen.iter().step_by(step).map(|s| turn * s.place - origin).collect();
        for j in 0..=steps.y {
            for i in 0..=steps.x {
                let place = low + Vector2::new(i as f64, j as f64) * STEP_M;
                let cost: f32 = turned
                    .iter()
                    .map(|p| {
                        let cell = (p + place) / CELL_M;
                        distance[(cell.y as usize).min(cells.y - 1) * cells.x + (cell.x as usize).min(cells.x - 1)]
                    })
                    .sum();
                if found.len() < REFINED || cost < found[REFINED - 1].0 {
                    let at = found.partition_point(|(c, _)| *c <= cost);
                    found.insert(at, (cost, place.push(heading)));
                    found.truncate(REFINED);
                }
            }
        }
    }
    found.into_iter().map(|(_, pose)| pose).collect()
}

/// Gauss–Newton with Tukey's weights, whose width shrinks: mean capped distance, pose and its covariance.
fn refine(plan: &Plan, seen: &[Seen], mut pose: Vector3<f64>) -> Option<(f64, Vector3<f64>, Matrix3<f64>)> {
    let mut covariance = Matrix3::identity();
    for round in 0..40 {
        let width = (0.5 * 0.9_f64.powi(round)).max(0.12);
        let (mut information, mut right) = (Matrix3::zeros(), Vector3::zeros());
        let (mut squares, mut weights) = (0.0, 0.0);
        for s in seen {
            let at = moved(&pose, &s.place);
            let (distance, normal) = plan.nearest(&at);
            // Where pixels are coarse, so is what counts as near.
            let t = distance.abs() / width.max(3.0 * s.sigma_m);
            if t >= 1.0 {
                continue;
            }
            let weight = (1.0 - t * t).powi(2) / (s.sigma_m * s.sigma_m);
            let arm = at - pose.xy();
            let row = Vector3::new(normal.x, normal.y, normal.y * arm.x - normal.x * arm.y);
            information += row * row.transpose() * weight;
            right += row * (distance * weight);
            squares += weight * distance * distance;
            weights += (1.0 - t * t).powi(2);
        }
        covariance = information.try_inverse()?;
        let step = covariance * right;
        pose -= step;
        covariance *= (squares / (weights - 3.0).max(1.0)).max(1.0);
        if round > 15 && step.norm() < 1e-7 {
            break;
        }
    }
    let cost = seen.iter().map(|s| plan.nearest(&moved(&pose, &s.place)).0.abs().min(CAP_M)).sum::<f64>();
    Some((cost / seen.len() as f64, pose, covariance))
}

fn check(plan: &Plan, sigma_px: f64, range_m: f64) -> Result<(), FloorError> {
    let all = || plan.lines_m.iter().flatten().chain(plan.circles_m.iter().flatten());
    if all().next().is_none() {
        return Err(FloorError::Plan("no lines and no circles".into()));
    }
    if !all().all(|x| x.is_finite()) || !(0.0..=1.0).contains(&plan.line_width_m) {
        return Err(FloorError::Plan("finite numbers of metres are wanted, line_width_m from 0 to 1".into()));
    }
    if let Some(n) = plan.lines_m.iter().position(|[x0, y0, x1, y1]| (x1 - x0).hypot(y1 - y0) < 1e-6) {
        return Err(FloorError::Plan(format!("lines_m[{n}] has no length")));
    }
    if let Some(n) = plan.circles_m.iter().position(|[_, _, r]| *r <= 0.0) {
        return Err(FloorError::Plan(format!("circles_m[{n}] has no radius")));
    }
    let [low, high] = plan.extent_m();
    let side = (high - low).max();
    if side > MAX_PLAN_M {
        return Err(FloorError::Plan(format!("{side:.0} m long, at most {MAX_PLAN_M} (is it in millimetres?)")));
    }
    let within = |what, value: f64, low: f64, high: f64, expected| {
        let right = value >= low && value <= high;
        right.then_some(()).ok_or(FloorError::Wrong { what, value, expected })
    };
    within("sigma_px", sigma_px, 0.01, 10.0, "must be between 0.01 and 10 px")?;
    within("range_m", range_m, 0.1, 30.0, "must be between 0.1 and 30 m")
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, Normal};

    use super::*;
    use crate::optics::{Fisheye, FisheyeLaw, FisheyeParameters, Mounting};

    /// A camera that looks down from 0.8 m; every pixel an equal angle.
    fn camera(focal_length_px: f64, centre_px: [f64; 2]) -> MountedCamera {
        let parameters = FisheyeParameters {
            law: FisheyeLaw::Equidistant,
            focal_length_px: [focal_length_px; 2],
            centre_px,
            k: [0.0; 4],
        };
        let mut mounting = Mounting::at_height(0.8);
        mounting.rotation_rpy_rad[0] = std::f64::consts::PI;
        MountedCamera::new(Fisheye::new(parameters, [640, 480]).unwrap(), mounting)
    }

    fn plan() -> Plan {
        let lines_m = vec![
            [-4.5, -3.0, 4.5, -3.0],
            [-4.5, 3.0, 4.5, 3.0],
            [-4.5, -3.0, -4.5, 3.0],
            [4.5, -3.0, 4.5, 3.0],
            [0.0, -3.0, 0.0, 3.0],
            [3.5, -1.5, 3.5, 1.5],
        ];
        Plan { lines_m, circles_m: vec![[0.0, 0.0, 0.75]], line_width_m: 0.05 }
    }

    const POSE: [f64; 3] = [1.3, -0.7, 0.4];

    /// Points on the lines within 3 m of the robot, seen by a camera with noise, and a tenth that are on no line.
    fn seen(camera: &MountedCamera, seed: u64) -> Vec<[f64; 2]> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let noise = Normal::new(0.0, 0.4).unwrap();
        let mut points = Vec::new();
        while points.len() < 500 {
            let line = plan().lines_m[random.random_range(0..6)];
            let (share, aside) = (random.random::<f64>(), (random.random::<f64>() - 0.5) * 0.05);
            let along = Vector2::new(line[2] - line[0], line[3] - line[1]);
            let across = Vector2::new(-along.y, along.x).normalize() * aside;
            let mut place = Vector2::new(line[0], line[1]) + along * share + across;
            if points.len() % 10 == 0 {
                place = Vector2::new(random.random::<f64>() * 6.0 - 2.0, random.random::<f64>() * 4.0 - 2.0);
            }
            let in_body = Rotation2::new(-POSE[2]) * (place - Vector2::new(POSE[0], POSE[1]));
            if in_body.norm() < 3.0
                && let Some(pixel) = camera.project_body(&in_body.push(0.0))
            {
                points.push([pixel.x + noise.sample(&mut random), pixel.y + noise.sample(&mut random)]);
            }
        }
        points
    }

    #[test]
    fn a_right_camera_file_fits_and_says_where_the_robot_stands() {
        let camera = camera(150.0, [320.0, 241.0]);
        let found = fit(&camera, &plan(), &seen(&camera, 1), 0.4, 4.0).unwrap();
        assert!(found.fits() && found.words().contains("fits"), "{found:?}");
        // The field looks the same turned by half a turn but for one line, so the place is unique.
        let error = Vector3::from(found.pose) - Vector3::from(POSE);
        let chi2 = error.dot(&(found.covariance.try_inverse().unwrap() * error));
        assert!(error.xy().norm() < 0.02 && error.z.abs() < 0.01 && chi2 < 16.3, "{error} {chi2}");
    }

    #[test]
    fn a_camera_file_of_another_camera_is_noticed() {
        let points = seen(&camera(150.0, [320.0, 241.0]), 2);
        for wrong in [camera(140.0, [320.0, 241.0]), camera(150.0, [331.0, 241.0])] {
            let found = fit(&wrong, &plan(), &points, 0.4, 4.0).unwrap();
            assert!(!found.fits() && found.words().contains("does not fit"), "{found:?}");
        }
    }

    #[test]
    fn plans_and_points_that_cannot_be_are_errors_in_words() {
        let camera = camera(150.0, [320.0, 241.0]);
        let points = seen(&camera, 3);
        let says = |plan: &Plan, points: &[[f64; 2]], word: &str| {
            let error = fit(&camera, plan, points, 0.4, 4.0).unwrap_err().to_string();
            assert!(error.contains(word), "{error}");
        };
        says(&Plan::default(), &points, "no lines");
        says(&Plan { lines_m: vec![[0.0, 0.0, 9000.0, 0.0]], ..Plan::default() }, &points, "millimetres");
        says(&Plan { circles_m: vec![[0.0, 0.0, 0.0]], ..Plan::default() }, &points, "circles_m[0]");
        says(&plan(), &points[..10], "10 of 10");
    }
}
