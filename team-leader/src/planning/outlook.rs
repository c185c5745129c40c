//! What the running leader's map would say of its targets if a robot stood elsewhere.
//!
//! The error of a target in the map has two parts (`cov = own + J Σ Jᵀ`). Its own: what the filter of [`crate::stereo::target`]
//! comes to rest at under a stream of bearings. Along each axis of the bearings' information that is a filter of position and
//! velocity by itself, so its end is found in a few steps of two by two. Where robots and target are nearly in line that end
//! would be metres, but who walks is past before it is reached: there the filter goes on for a second from where it usually
//! rests. The robots': their joint covariance after the move,
//! through the weights that the rays have. So what is expected is what the same leader will state, and achieve where its
//! covariances are honest.

use nalgebra::{DMatrix, Matrix2, Matrix2x3, Matrix3, RowVector2, RowVector3, Vector2};
use protocol::frames::Pose2;

use crate::calibration::kernel;
use crate::correspondence::MOST_REPEAT;
use crate::leader::config::TargetConfig;
use crate::stereo::target::VELOCITY_MEMORY_S;

/// Nobody's bearing counts from further away, metres.
const REACH_M: f64 = 10.0;
/// Nearer than this a robot does not see a target as a whole, metres.
const LEAST_RANGE_M: f64 = 0.4;
/// Mean widening of a bearing's variance by its tails' weights, errors being Gaussian.
const STRETCH: f64 = 1.15;
/// Whoever comes to a place of few sights passes it in about this time, seconds.
const PASSING_S: f64 = 1.0;
/// What bearings state follows within so many bearings; a smaller spread of squares of distances says little of how errors depend on them, m⁴.
const LINE_MEMORY: f64 = 300.0;
const LEAST_SPREAD_M4: f64 = 1.0;
/// Steps of the filter until it rests.
const STEPS: usize = 60;

/// A robot that sees targets.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Post {
    /// Where it stands.
    pub pose: Pose2,
    /// Radius of its body, metres.
    pub radius_m: f64,
    /// What it states of bearings.
    pub blur: Blur,
    /// Frames a second.
    pub rate_hz: f64,
}

/// Variance of a bearing of a body by the body's distance: what blurs its axis lies on the body (gait, clothes, company: metres
/// aside) or in the camera (an angle).
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Blur {
    /// Metres aside, m².
    pub aside_m2: f64,
    /// Angle, rad².
    pub angle_rad2: f64,
}

impl Blur {
    /// Variance at a distance, rad².
    pub fn var_rad2(&self, range_m: f64) -> f64 {
        self.aside_m2 / (range_m * range_m) + self.angle_rad2
    }
}

/// How a robot's stated variances depend on distance, learnt as it goes: the straight line of (distance · σ)² over distance².
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct BlurLine {
    count: f64,
    /// Means of distance² and of (distance · σ)², m².
    mean: [f64; 2],
    /// Variance of distance² and covariance of the two, m⁴.
    spread: [f64; 2],
}

impl BlurLine {
    /// One more bearing.
    pub fn note(&mut self, range_m: f64, sigma_rad: f64) {
        let seen = [range_m * range_m, (range_m * sigma_rad).powi(2)];
        if !(seen[0] > 0.0 && seen[1].is_finite()) {
            return;
        }
        self.count = (self.count + 1.0).min(LINE_MEMORY);
        let (part, from) = (1.0 / self.count, self.mean);
        for k in 0..2 {
            self.mean[k] += part * (seen[k] - from[k]);
            self.spread[k] += part * ((seen[0] - from[0]) * (seen[k] - self.mean[k]) - self.spread[k]);
        }
    }

    /// The line; `None` before the first bearing. Where all distances are alike all lies on the body.
    pub fn blur(&self) -> Option<Blur> {
        let [range2, aside2] = self.mean;
        let angle_rad2 = (self.spread[1] / (self.spread[0] + LEAST_SPREAD_M4)).max(0.0).min(aside2 / range2);
        (self.count > 0.0).then_some(Blur { aside_m2: aside2 - angle_rad2 * range2, angle_rad2 })
    }
}

/// Mean square error (trace of the position's covariance, m²) over places where targets are. `poses`: the posts' joint
/// covariance (x, y, heading each). `None` where some place is not determined by two rays.
pub fn mean_square_m2(
    posts: &[Post],
    poses: &DMatrix<f64>,
    places: &[Vector2<f64>],
    config: &TargetConfig,
) -> Option<f64> {
    let seen = places.iter().map(|place| at_place(posts, poses, *place, config)).collect::<Option<Vec<Place>>>()?;
    let mut worse: Vec<&Axis> =
        seen.iter().map(|place| place.axes.iter().max_by(|a, b| by_var(a, b))).collect::<Option<_>>()?;
    worse.sort_by(|a, b| by_var(a, b));
    let usual = worse.get(worse.len() / 2)?.rest;
    let own = |axis: &Axis| match axis.rest[0] > usual[0] {
        true => settle(axis.information, axis.interval_s, config.acceleration_m2ps3, usual, PASSING_S)[0],
        false => axis.rest[0],
    };
    let sum: f64 = seen.iter().map(|place| place.shared_m2 + place.axes.iter().map(own).sum::<f64>()).sum();
    Some(sum / places.len() as f64)
}

/// What a target at a place comes to.
struct Place {
    axes: [Axis; 2],
    /// Part of the robots' errors, m².
    shared_m2: f64,
}

/// One axis of the bearings' information.
struct Axis {
    information: f64,
    interval_s: f64,
    /// The filter's variances there in the end: position, both, velocity.
    rest: [f64; 3],
}

fn by_var(a: &Axis, b: &Axis) -> std::cmp::Ordering {
    a.rest[0].total_cmp(&b.rest[0])
}

fn at_place(posts: &[Post], poses: &DMatrix<f64>, place: Vector2<f64>, config: &TargetConfig) -> Option<Place> {
    let seeing: Vec<(usize, RowVector2<f64>, [f64; 3], f64)> = posts
        .iter()
        .enumerate()
        .filter(|(k, _)| sees(posts, *k, place))
        .map(|(k, post)| {
            let from = [post.pose.x_m, post.pose.y_m, post.pose.heading_rad];
            let (_, to_pose, to_point) = kernel::bearing(from, [place.x, place.y]);
            let range_m = (place - post.pose.position()).norm();
            let repeat = config.repeat(1.0 / post.rate_hz, MOST_REPEAT);
            let var = config.bearing_var(post.blur.var_rad2(range_m).sqrt(), range_m) * repeat * STRETCH;
            // As a density: information a second.
            (k, RowVector2::from(to_point), to_pose, post.rate_hz / var)
        })
        .collect();
    let rate_hz = seeing.iter().map(|(k, ..)| posts[*k].rate_hz).fold(0.0, f64::max);
    let density: Matrix2<f64> = seeing.iter().map(|(_, h, _, w)| h.transpose() * h * *w).sum();
    let inverse = density.try_inverse()?;
    let eigen = density.symmetric_eigen();
    let axis = |value: f64| {
        let (information, interval_s) = (value / rate_hz, 1.0 / rate_hz);
        let rest = resting(information, interval_s, config.acceleration_m2ps3)?;
        Some(Axis { information, interval_s, rest })
    };
    let axes = [axis(eigen.eigenvalues[0])?, axis(eigen.eigenvalues[1])?];
    // Errors that last go through the weights of the rays.
    let mut by_poses = DMatrix::zeros(2, 3 * posts.len());
    for (k, h, to_pose, w) in &seeing {
        let block: Matrix2x3<f64> = -(inverse * h.transpose()) * RowVector3::from(*to_pose) * *w;
        by_poses.fixed_view_mut::<2, 3>(0, 3 * k).copy_from(&block);
    }
    let shared_m2 = (&by_poses * poses * by_poses.transpose()).trace();
    (shared_m2.is_finite() && shared_m2 >= 0.0).then_some(Place { axes, shared_m2 })
}

/// Variances (position, both, velocity) at rest, seen `interval_s` apart with this information each time, just after a sight.
fn resting(information: f64, interval_s: f64, acceleration_m2ps3: f64) -> Option<[f64; 3]> {
    if information.is_nan() || information <= 1e-6 {
        return None;
    }
    let start = [1.0 / information, 0.0, acceleration_m2ps3 * 0.5 * VELOCITY_MEMORY_S];
    let rest = settle(information, interval_s, acceleration_m2ps3, start, STEPS as f64 * interval_s);
    rest.iter().all(|v| v.is_finite()).then_some(rest)
}

/// The same after `time_s` from other ones.
fn settle(information: f64, interval_s: f64, acceleration_m2ps3: f64, from: [f64; 3], time_s: f64) -> [f64; 3] {
    let keep = (-interval_s / VELOCITY_MEMORY_S).exp();
    let reach = VELOCITY_MEMORY_S * (1.0 - keep);
    let q = acceleration_m2ps3;
    let (dt, r) = (interval_s, 1.0 / information);
    let [mut p, mut c, mut v] = from;
    for _ in 0..((time_s / interval_s).round() as usize).clamp(1, STEPS) {
        let (pp, cc, vv) = (p + 2.0 * reach * c + reach * reach * v, keep * (c + reach * v), keep * keep * v);
        (p, c, v) = (pp + q * dt.powi(3) / 3.0, cc + q * dt * dt / 2.0, vv + q * dt);
        let gain = 1.0 / (p + r);
        (p, c, v) = (p - p * p * gain, c - p * c * gain, v - c * c * gain);
    }
    [p, c, v]
}

/// Whether a post sees a place: near enough, past the other robots.
fn sees(posts: &[Post], k: usize, place: Vector2<f64>) -> bool {
    let eye = posts[k].pose.position();
    let range_m = (place - eye).norm();
    (LEAST_RANGE_M..REACH_M).contains(&range_m)
        && posts.iter().enumerate().all(|(o, other)| {
            let to = other.pose.position();
            o == k
                || !super::hides(eye.into(), place.into(), super::HALF_WIDTH_M, to.into(), other.radius_m)
                || (to - eye).norm() > range_m
        })
}

/// Covariance of posts in one vector order from a function of pairs.
pub fn joint(robots: &[usize], covariance: impl Fn(usize, usize) -> Matrix3<f64>) -> DMatrix<f64> {
    let mut full = DMatrix::zeros(3 * robots.len(), 3 * robots.len());
    for (i, &a) in robots.iter().enumerate() {
        for (j, &b) in robots.iter().enumerate() {
            full.fixed_view_mut::<3, 3>(3 * i, 3 * j).copy_from(&covariance(a, b));
        }
    }
    full
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stereo::target::{BearingFrom, Target};
    use protocol::time::Timestamp;

    fn post(x: f64, y: f64) -> Post {
        Post {
            pose: Pose2::new(x, y, 0.3),
            radius_m: 0.2,
            blur: Blur { aside_m2: 4e-4, angle_rad2: 1.6e-5 },
            rate_hz: 10.0,
        }
    }

    /// What the target's filter itself comes to, fed frame by frame.
    fn filtered(posts: &[Post], place: Vector2<f64>, config: &TargetConfig) -> f64 {
        let start = Timestamp::from_secs_f64(1000.0);
        let mut target = Target::new(place, start, config.acceleration_m2ps3, (1.7, 0.1));
        for frame in 0..200 {
            let at = start.offset_by_secs(0.1 * f64::from(frame));
            target.predict(at);
            for (robot, post) in posts.iter().enumerate() {
                let range_m = (place - post.pose.position()).norm();
                let var = (1.6e-5 + (4e-4 + config.axis_sway_m.powi(2)) / range_m.powi(2)) * MOST_REPEAT * STRETCH;
                let bearing_rad = post.pose.bearing_to(place);
                target.update(&BearingFrom { robot, pose: post.pose, bearing_rad, var, at });
            }
        }
        target.own_covariance().trace()
    }

    #[test]
    fn what_is_expected_is_what_the_filter_comes_to() {
        let config = TargetConfig::default();
        for posts in [vec![post(0.0, 0.0), post(4.0, 0.0)], vec![post(0.0, 0.0), post(4.0, 0.5), post(1.0, 5.0)]] {
            for place in [Vector2::new(2.0, 2.0), Vector2::new(1.0, 3.0)] {
                let poses = DMatrix::zeros(3 * posts.len(), 3 * posts.len());
                let expected = mean_square_m2(&posts, &poses, &[place], &config).unwrap();
                let truth = filtered(&posts, place, &config);
                assert!((expected / truth - 1.0).abs() < 0.02, "{expected} {truth}");
            }
        }
    }

    #[test]
    fn what_lies_on_the_body_is_told_from_what_lies_in_the_camera() {
        let truth = Blur { aside_m2: 9e-4, angle_rad2: 4e-5 };
        let mut line = BlurLine::default();
        assert_eq!(line.blur(), None);
        // All at one distance, then at many.
        (0..200).for_each(|_| line.note(2.0, truth.var_rad2(2.0).sqrt()));
        let blur = line.blur().unwrap();
        assert!((blur.var_rad2(2.0) / truth.var_rad2(2.0) - 1.0).abs() < 1e-9 && blur.angle_rad2 < 1e-9, "{blur:?}");
        (0..2000)
            .map(|k| 1.0 + 0.01 * f64::from(k % 400))
            .for_each(|range_m| line.note(range_m, truth.var_rad2(range_m).sqrt()));
        let blur = line.blur().unwrap();
        for range_m in [1.0, 3.0, 6.0] {
            assert!((blur.var_rad2(range_m) / truth.var_rad2(range_m) - 1.0).abs() < 0.1, "{range_m} {blur:?}");
        }
        // Errors that fall with distance are nobody's camera.
        (0..2000)
            .map(|k| 1.0 + 0.01 * f64::from(k % 400))
            .for_each(|range_m| line.note(range_m, 0.05 / range_m.powi(2)));
        let blur = line.blur().unwrap();
        assert!(blur.angle_rad2 == 0.0 && blur.aside_m2 > 0.0, "{blur:?}");
    }

    #[test]
    fn errors_of_the_robots_add_theirs() {
        let config = TargetConfig::default();
        let posts = [post(0.0, 0.0), post(4.0, 0.0)];
        let place = [Vector2::new(2.0, 2.0)];
        let none = mean_square_m2(&posts, &DMatrix::zeros(6, 6), &place, &config).unwrap();
        // Both a centimetre to the side along x: so is the target.
        let mut shift = DMatrix::zeros(6, 6);
        for (a, b) in [(0, 0), (0, 3), (3, 0), (3, 3)] {
            shift[(a, b)] = 1e-4;
        }
        let with = mean_square_m2(&posts, &shift, &place, &config).unwrap();
        assert!((with - none - 1e-4).abs() < 1e-9, "{}", with - none);
    }

    #[test]
    fn one_robot_alone_or_two_in_line_with_a_target_determine_nothing() {
        let config = TargetConfig::default();
        let place = [Vector2::new(2.0, 0.0)];
        assert_eq!(mean_square_m2(&[post(0.0, 0.0)], &DMatrix::zeros(3, 3), &place, &config), None);
        assert_eq!(mean_square_m2(&[post(0.0, 0.0), post(4.0, 0.0)], &DMatrix::zeros(6, 6), &place, &config), None);
    }
}
