//! How far off the running leader's map would be of its targets if a robot stood elsewhere.
//!
//! The error of a target in the map has two parts (`cov = own + J Σ Jᵀ`). Its own: what the two filters of [`crate::stereo::target`]
//! come to rest at under a stream of bearings, weighted by how much of their time people walk. Along each axis of the bearings'
//! information that is a filter of position, velocity and error that lasts by itself, so its end is found once for some
//! informations and read off between them. Who walks is past a place before the filter rests there: the information of a
//! place is that of its neighbourhood. The robots': their joint covariance after the move, through the weights that the rays
//! have.
//!
//! Filters hold a reserve: robots take people who hide each other for one another, and people turn at any time. Nobody can say where that
//! will happen, so what is expected is the error where it does not: of a filter that weighs bearings and motion as the leader's does, while
//! bearings err as robots say and people move as they usually do. The map states about a quarter more.

use std::sync::OnceLock;

use nalgebra::{DMatrix, Matrix2, Matrix3, RowVector2, RowVector3, Vector2, Vector3};
use protocol::frames::Pose2;

use crate::calibration::kernel;
use crate::leader::config::{FILTER_VAR, TargetConfig};
use crate::stereo::motion::Step;
use crate::stereo::target::{ERRORS_LAST_S, LASTING, SHIFTS_M2PS, STANDS_S, VELOCITY_MEMORY_S, WALKS_S};

/// Nobody's bearing counts from further away, metres.
const REACH_M: f64 = 10.0;
/// Nearer than this a robot does not see a target as a whole, metres.
const LEAST_RANGE_M: f64 = 0.4;
/// Mean widening of a bearing's variance by its tails' weights, errors being Gaussian.
const STRETCH: f64 = 1.15;
/// A place's information is that of as far around, metres: people walk through it while the filter remembers.
const AROUND_M: f64 = 0.9;
/// What bearings state follows within so many bearings; a smaller spread of squares of distances says little of how errors depend on them, m⁴.
const LINE_MEMORY: f64 = 300.0;
const LEAST_SPREAD_M4: f64 = 1.0;
/// Part of their time that people walk.
const WALKING: f64 = WALKS_S / (WALKS_S + STANDS_S);
/// Frames a second: what a faster camera tells is spread over so many.
const RATES_HZ: [f64; 2] = [1.0, 50.0];
/// The filter rests after this time, seconds.
const RESTS_S: f64 = 6.0;
/// Logarithms of variances (m²) of one frame for which rests are found, how many a unit, and how many in all.
const FIRST_LOG: f64 = -18.0;
const A_UNIT: f64 = 2.0;
const RESTS: usize = 48;

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

/// What targets' filters come to, by what their bearings tell.
#[derive(Debug, Clone)]
pub struct Outlook {
    config: TargetConfig,
    rate_hz: f64,
    /// Logarithms of the errors' variances at rest, found when they are asked for: a look round needs few of them.
    rests: [OnceLock<f64>; RESTS],
}

impl Outlook {
    /// Of robots that see no oftener than `rate_hz`.
    pub fn new(config: &TargetConfig, rate_hz: f64) -> Self {
        let rate_hz = rate_hz.clamp(RATES_HZ[0], RATES_HZ[1]);
        Self { config: *config, rate_hz, rests: std::array::from_fn(|_| OnceLock::new()) }
    }

    /// Mean square error (trace of the position's covariance, m²) over places where targets are. `poses`: the posts' joint
    /// covariance (x, y, heading each). `None` where some place is not seen by two.
    pub fn mean_square_m2(&self, posts: &[Post], poses: &DMatrix<f64>, places: &[Vector2<f64>]) -> Option<f64> {
        let sum: f64 = places.iter().map(|place| self.at_place(posts, poses, *place)).sum::<Option<f64>>()?;
        Some(sum / places.len() as f64)
    }

    fn at_place(&self, posts: &[Post], poses: &DMatrix<f64>, place: Vector2<f64>) -> Option<f64> {
        let around = [[0.0, 0.0], [AROUND_M, 0.0], [-AROUND_M, 0.0], [0.0, AROUND_M], [0.0, -AROUND_M]]
            .map(|d| place + Vector2::from(d));
        if (0..posts.len()).filter(|k| around.iter().any(|place| sees(posts, *k, *place))).count() < 2 {
            return None;
        }
        // Information a second, and what of it errors of the robots' poses take along.
        let mut density = Matrix2::zeros();
        let mut by_poses = DMatrix::zeros(2, 3 * posts.len());
        for place in around {
            for (k, post) in posts.iter().enumerate().filter(|(k, _)| sees(posts, *k, place)) {
                let from = [post.pose.x_m, post.pose.y_m, post.pose.heading_rad];
                let (range_m, _, _) = kernel::distance(from, [place.x, place.y]);
                let (_, to_pose, to_point) = kernel::bearing(from, [place.x, place.y]);
                let row = RowVector2::from(to_point);
                let var = self.config.filter_var(post.blur.var_rad2(range_m).sqrt(), range_m) * STRETCH;
                let weighted = row.transpose() * (post.rate_hz / var / around.len() as f64);
                density += weighted * row;
                let mut block = by_poses.fixed_view_mut::<2, 3>(0, 3 * k);
                block -= weighted * RowVector3::from(to_pose);
            }
        }
        let by_poses = density.try_inverse()? * by_poses;
        let own = density.symmetric_eigen().eigenvalues.map(|of_axis| self.rest_m2(self.rate_hz / of_axis));
        let shared_m2 = (&by_poses * poses * by_poses.transpose()).trace();
        let sum = own.sum() + shared_m2;
        (sum.is_finite() && shared_m2 >= 0.0).then_some(sum)
    }

    /// The variance of the error that a filter rests at along an axis that a frame of all robots tells with this variance.
    fn rest_m2(&self, frame_m2: f64) -> f64 {
        let place = ((frame_m2.ln() - FIRST_LOG) * A_UNIT).clamp(0.0, (RESTS - 1) as f64);
        let (first, part) = (place as usize, place.fract());
        let next = (first + 1).min(RESTS - 1);
        (self.log_rest(first) * (1.0 - part) + self.log_rest(next) * part).exp()
    }

    fn log_rest(&self, k: usize) -> f64 {
        let found = || rest_m2((FIRST_LOG + k as f64 / A_UNIT).exp(), 1.0 / self.rate_hz, &self.config).ln();
        *self.rests[k].get_or_init(found)
    }
}

/// Position, velocity and error that lasts of a filter along one axis: what it believes of their errors, and their errors.
struct Axis {
    believed: Matrix3<f64>,
    actual: Matrix3<f64>,
}

impl Axis {
    /// Goes on for so long with frames of this variance, as it believes.
    fn go_on(&mut self, frame_m2: f64, frames: usize, step: &Matrix3<f64>, [believed, actual]: [&Matrix3<f64>; 2]) {
        let sight = RowVector3::new(1.0, 0.0, (LASTING * frame_m2).sqrt());
        let new_m2 = (1.0 - LASTING) * frame_m2;
        for _ in 0..frames {
            self.believed = step * self.believed * step.transpose() + believed;
            self.actual = step * self.actual * step.transpose() + actual;
            let seen = self.believed * sight.transpose();
            let gain = seen / ((sight * seen)[0] + new_m2);
            self.believed -= gain * seen.transpose();
            let left = Matrix3::identity() - gain * sight;
            self.actual = left * self.actual * left.transpose() + gain * gain.transpose() * (new_m2 / FILTER_VAR);
        }
    }
}

/// The same, found by going on until it rests: who walks for as long as it takes, and who then has stood for as long as people do.
fn rest_m2(frame_m2: f64, interval_s: f64, config: &TargetConfig) -> f64 {
    let dt = interval_s;
    let frames = |time_s: f64| (time_s / dt).ceil() as usize;
    let keep = |lasts_s: f64| (-dt / lasts_s).exp();
    let [standing_error, error] = ERRORS_LAST_S.map(keep);
    let step = Step::over(dt, VELOCITY_MEMORY_S);
    let walk = Matrix3::new(1.0, step.reach_s, 0.0, 0.0, step.keep_velocity, 0.0, 0.0, 0.0, error);
    let walked = |acceleration_m2ps3: f64, lasting: f64| {
        let [place, both, velocity] = step.grows(acceleration_m2ps3);
        Matrix3::new(place, both, 0.0, both, velocity, 0.0, 0.0, 0.0, lasting * (1.0 - error * error))
    };
    let stand = Matrix3::from_diagonal(&Vector3::new(1.0, 0.0, standing_error));
    let stood = |shifts_m2ps: f64, lasting: f64| {
        Matrix3::from_diagonal(&Vector3::new(shifts_m2ps * dt, 0.0, lasting * (1.0 - standing_error.powi(2))))
    };
    let start = |acceleration_m2ps3: f64, lasting: f64| {
        Matrix3::from_diagonal(&Vector3::new(frame_m2, acceleration_m2ps3 * 0.5 * VELOCITY_MEMORY_S, lasting))
    };
    let (believed, actual) = ((config.acceleration_m2ps3, 1.0), (config.usual_acceleration_m2ps3, 1.0 / FILTER_VAR));
    let mut axis = Axis { believed: start(believed.0, believed.1), actual: start(actual.0, actual.1) };
    axis.go_on(frame_m2, frames(RESTS_S), &walk, [&walked(believed.0, believed.1), &walked(actual.0, actual.1)]);
    let walks_m2 = axis.actual[(0, 0)];
    axis.go_on(frame_m2, frames(STANDS_S), &stand, [&stood(SHIFTS_M2PS, believed.1), &stood(0.0, actual.1)]);
    WALKING * walks_m2 + (1.0 - WALKING) * axis.actual[(0, 0)]
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
    use crate::stereo::tails::stretch;
    use crate::stereo::target::{BearingFrom, Target};
    use protocol::time::Timestamp;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    fn post(x: f64, y: f64) -> Post {
        Post {
            pose: Pose2::new(x, y, 0.3),
            radius_m: 0.2,
            blur: Blur { aside_m2: 4e-4, angle_rad2: 1.6e-5 },
            rate_hz: 10.0,
        }
    }

    fn expected(posts: &[Post], poses: &DMatrix<f64>, places: &[Vector2<f64>]) -> Option<f64> {
        Outlook::new(&TargetConfig::default(), 10.0).mean_square_m2(posts, poses, places)
    }

    /// Mean square error of the target's own filter, and what it says of it, of somebody who walks and stands as people do. The robots
    /// go along with him, so that he stays where he is among them.
    fn followed(posts: &[Post], place: Vector2<f64>, config: &TargetConfig) -> [f64; 2] {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mut normal = |sigma: f64| -> f64 { sigma * Distribution::<f64>::sample(&StandardNormal, &mut rng) };
        let start = Timestamp::from_secs_f64(1000.0);
        let mut target = Target::new(place, start, config.acceleration_m2ps3, (1.7, 0.1));
        let (mut moved, mut velocity) = (Vector2::zeros(), Vector2::zeros());
        let mut errors = vec![0.0; posts.len()];
        let (mut sums, frames) = ([0.0; 2], 6000);
        for frame in 0..frames {
            let at = start.offset_by_secs(0.1 * f64::from(frame));
            // Ten seconds of walking, two of standing.
            let walks = frame % 120 < 100;
            let turn = normal(1.0);
            velocity = match (walks, frame % 120) {
                (false, _) => Vector2::zeros(),
                (true, 0) => Vector2::new(turn.cos(), turn.sin()) * 0.9,
                // Ways bend a little.
                (true, _) => nalgebra::Rotation2::new(0.08 * turn) * velocity,
            };
            moved += velocity * 0.1;
            target.predict(at);
            for (robot, post) in posts.iter().enumerate() {
                let range_m = (place - post.pose.position()).norm();
                let said = 1.6e-5 + (4e-4 + config.axis_sway_m.powi(2)) / range_m.powi(2);
                let var = FILTER_VAR * said;
                let lasts_s = ERRORS_LAST_S[usize::from(walks)];
                let keep = (-0.1 / lasts_s).exp();
                errors[robot] = keep * errors[robot] + normal((1.0 - keep * keep).sqrt());
                let error = LASTING.sqrt() * errors[robot] + normal((1.0 - LASTING).sqrt());
                let bearing_rad = post.pose.bearing_to(place) + said.sqrt() * error;
                let pose = Pose2::new(post.pose.x_m + moved.x, post.pose.y_m + moved.y, post.pose.heading_rad);
                let m = BearingFrom { robot, pose, bearing_rad, var, lasting: LASTING * var, at, interval_s: 0.1 };
                let innovation = target.innovation(&m);
                target.update_stretched(&m, stretch(innovation.residual_rad.powi(2) / innovation.var));
            }
            sums[0] += (target.position() - place - moved).norm_squared() / f64::from(frames);
            sums[1] += target.own_covariance().trace() / f64::from(frames);
        }
        sums
    }

    #[test]
    fn what_is_expected_is_how_far_off_the_filter_is() {
        let config = TargetConfig::default();
        for posts in [vec![post(0.0, 0.0), post(4.0, 0.0)], vec![post(0.0, 0.0), post(4.0, 0.5), post(1.0, 5.0)]] {
            for place in [Vector2::new(2.0, 2.0), Vector2::new(1.0, 3.0)] {
                let poses = DMatrix::zeros(3 * posts.len(), 3 * posts.len());
                let expected = expected(&posts, &poses, &[place]).unwrap().sqrt();
                let [truth, stated] = followed(&posts, place, &config).map(f64::sqrt);
                assert!((expected / truth - 1.0).abs() < 0.08, "{expected} m expected, {truth} m achieved");
                assert!((1.1..1.4).contains(&(stated / expected)), "{expected} m expected, {stated} m stated");
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
        let posts = [post(0.0, 0.0), post(4.0, 0.0)];
        let place = [Vector2::new(2.0, 2.0)];
        let none = expected(&posts, &DMatrix::zeros(6, 6), &place).unwrap();
        // Both a centimetre to the side along x: so is the target.
        let mut shift = DMatrix::zeros(6, 6);
        for (a, b) in [(0, 0), (0, 3), (3, 0), (3, 3)] {
            shift[(a, b)] = 1e-4;
        }
        let with = expected(&posts, &shift, &place).unwrap();
        assert!((with - none - 1e-4).abs() < 1e-9, "{}", with - none);
    }

    #[test]
    fn one_robot_alone_determines_nothing_and_two_in_line_with_a_target_little() {
        let (place, poses) = ([Vector2::new(2.0, 0.0)], DMatrix::zeros(6, 6));
        assert_eq!(expected(&[post(0.0, 0.0)], &DMatrix::zeros(3, 3), &place), None);
        let in_line = expected(&[post(0.0, 0.0), post(4.0, 0.0)], &poses, &place).unwrap();
        let across = expected(&[post(0.0, 0.0), post(2.0, 2.0)], &poses, &place).unwrap();
        assert!(in_line > 3.0 * across, "{in_line} {across}");
    }
}
