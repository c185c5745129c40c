use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::*;

const SIGMA_BEARING: f64 = 0.008;
const SIGMA_RANGE: f64 = 0.05;
/// Of a step of 0.1 s: m, m, rad.
const STEP: [f64; 3] = [0.004, 0.001, 0.004];

/// Three robots drive circles; who looks which way sees whom. Truth by small exact steps.
struct Drive {
    truth: Vec<Pose2>,
    rng: ChaCha8Rng,
    convoy: Convoy,
    time_s: f64,
}

impl Drive {
    fn new(seed: u64) -> Self {
        let truth = vec![Pose2::new(0.0, 0.0, 0.3), Pose2::new(3.0, 0.5, 2.5), Pose2::new(1.0, 3.0, -1.2)];
        Self { truth, rng: ChaCha8Rng::seed_from_u64(seed), convoy: Convoy::default(), time_s: 1000.0 }
    }

    fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.rng)
    }

    fn step(&mut self) {
        self.time_s += 0.1;
        let now = Timestamp::from_secs_f64(self.time_s);
        let covariance = Matrix3::from_diagonal(&Vector3::from(STEP.map(|s| s * s)));
        for robot in 0..3 {
            let exact = Pose2::new(0.015, 0.0, [0.02, -0.015, 0.025][robot]);
            self.truth[robot] = self.truth[robot] * exact;
            let [x, y, h] = STEP.map(|s| s * self.normal());
            let told = Pose2::new(exact.x_m + x, exact.y_m + y, exact.heading_rad + h);
            self.convoy.drive(robot, now, told, &covariance, 0.1);
        }
        for observer in 0..3 {
            for peer in (0..3).filter(|p| *p != observer) {
                let p = self.truth[observer].inverse().transform(self.truth[peer].position());
                let bearing = p.y.atan2(p.x);
                if bearing.abs() > 1.0 {
                    continue;
                }
                let bearing_rad = bearing + SIGMA_BEARING * self.normal();
                let (width, slope) = kernel::width(p.norm() + SIGMA_RANGE * self.normal());
                let width_rad = Some((width, (slope * SIGMA_RANGE).powi(2)));
                let bearing_var = SIGMA_BEARING.powi(2);
                let sighted = Sighted { bearing_rad, bearing_var, width_rad, frame_var: (0.0, 0.0), robot: Some(peer) };
                self.convoy.sight(observer, peer, now, &sighted);
            }
        }
    }

    /// Error and squared normalised error of the pose of `b` seen from `a`.
    fn relative(&self, a: usize, b: usize) -> Option<(f64, f64)> {
        let now = Timestamp::from_secs_f64(self.time_s);
        let (pa, pb) = (self.convoy.pose(a, now)?, self.convoy.pose(b, now)?);
        let (found, truth) = (pa.inverse() * pb, self.truth[a].inverse() * self.truth[b]);
        let e = Vector3::new(found.x_m - truth.x_m, found.y_m - truth.y_m, wrap(found.heading_rad - truth.heading_rad));
        let (s, c) = pa.heading_rad.sin_cos();
        let back = Matrix3::new(c, s, 0.0, -s, c, 0.0, 0.0, 0.0, 1.0);
        let (dx, dy) = (pb.x_m - pa.x_m, pb.y_m - pa.y_m);
        let by_a = back * Matrix3::new(-1.0, 0.0, dy, 0.0, -1.0, -dx, 0.0, 0.0, -1.0);
        let cov = |i, j| self.convoy.covariance(i, j).unwrap();
        let cross = by_a * cov(a, b) * back.transpose();
        let total =
            by_a * cov(a, a) * by_a.transpose() + back * cov(b, b) * back.transpose() + cross + cross.transpose();
        Some((e.x.hypot(e.y), e.dot(&(total.try_inverse()? * e))))
    }
}

#[test]
fn driving_robots_find_each_other_and_say_how_sure_they_are() {
    let (mut sum, mut count, mut square) = (0.0, 0.0, 0.0);
    for seed in 0..40 {
        let mut drive = Drive::new(seed);
        for k in 0..300 {
            drive.step();
            if k >= 100 && k % 100 == 99 {
                for (a, b) in [(0, 1), (0, 2), (1, 2)] {
                    let (error_m, nees) = drive.relative(a, b).expect("everybody has been seen");
                    (sum, count, square) = (sum + nees, count + 3.0, square + error_m * error_m);
                }
            }
        }
    }
    // 720 numbers, of which those of one run hang together: three sigmas of a third as many independent ones.
    let nees = sum / count;
    assert!((0.72..1.28).contains(&nees), "NEES/3 {nees}");
    // Odometry alone is off by 0.5 m and more after 20 to 30 s of these circles.
    let rms_m = (3.0 * square / count).sqrt();
    assert!(rms_m < 0.15, "{rms_m} m");
}

#[test]
fn a_robot_that_is_put_down_elsewhere_is_lost_and_found_again() {
    let mut drive = Drive::new(3);
    for _ in 0..150 {
        drive.step();
    }
    assert!(drive.relative(0, 1).unwrap().0 < 0.3);
    drive.truth[1] = Pose2::new(-2.0, 2.0, 0.4);
    for _ in 0..450 {
        drive.step();
    }
    let (error_m, _) = drive.relative(0, 1).unwrap();
    assert!(error_m < 0.35, "{error_m} m");
}
