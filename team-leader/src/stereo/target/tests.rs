use nalgebra::Matrix3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

use super::*;

fn at(s: f64) -> Timestamp {
    Timestamp::from_secs_f64(1000.0 + s)
}

fn normal(rng: &mut ChaCha8Rng, sigma: f64) -> f64 {
    Normal::new(0.0, sigma).unwrap().sample(rng)
}

/// Position error and full covariance after ten seconds of a target that moves as the filter believes, seen by robots
/// whose believed poses are wrong by a draw of `pose_sigma`.
fn run(rng: &mut ChaCha8Rng, pose_sigma: [f64; 3]) -> Option<f64> {
    let truth_poses = [Pose2::new(0.0, 0.0, 0.3), Pose2::new(3.0, 0.0, 2.0), Pose2::new(1.0, 3.0, -1.0)];
    let believed: Vec<Pose2> = truth_poses
        .iter()
        .map(|p| {
            Pose2::new(
                p.x_m + normal(rng, pose_sigma[0]),
                p.y_m + normal(rng, pose_sigma[1]),
                p.heading_rad + normal(rng, pose_sigma[2]),
            )
        })
        .collect();
    let (q, sigma) = (0.3, 0.006);
    let mut p = Vector2::new(rng.random_range(0.5..3.0), rng.random_range(0.5..2.5));
    let mut v = Vector2::new(normal(rng, 0.5), normal(rng, 0.5));
    let mut target = Target::new(p + Vector2::new(0.1, -0.1), at(0.0), q, (1.7, 0.1));
    let (dt, steps) = (0.01, 300);
    for k in 0..steps {
        for axis in 0..2 {
            v[axis] += -v[axis] * dt / VELOCITY_MEMORY_S + normal(rng, (q * dt).sqrt());
        }
        p += v * dt;
        // At arm's length the linearisation fails, and people do not walk through robots.
        if truth_poses.iter().any(|r| (r.position() - p).norm() < 0.7) {
            return None;
        }
        if k % 4 == 0 {
            let robot = (k / 4) % 3;
            let d = p - truth_poses[robot].position();
            let bearing_rad = wrap(d.y.atan2(d.x) - truth_poses[robot].heading_rad + normal(rng, sigma));
            let now = at(f64::from(k as u32 + 1) * dt);
            target.predict(now);
            target.update(&BearingFrom { robot, pose: believed[robot], bearing_rad, var: sigma * sigma, at: now });
        }
    }
    target.predict(at(f64::from(steps as u32) * dt));
    let pose_cov = Matrix3::from_diagonal(&Vector3::from(pose_sigma.map(|s| s * s)));
    let mut cov = target.own_covariance();
    for (_, d) in target.dependence() {
        cov += d * pose_cov * d.transpose();
    }
    let e = target.position() - p;
    Some(e.dot(&cov.cholesky().unwrap().solve(&e)))
}

#[test]
fn nees_is_one_with_exact_and_with_wrong_poses() {
    let mut rng = ChaCha8Rng::seed_from_u64(21);
    for pose_sigma in [[1e-9; 3], [0.02, 0.02, 0.01], [0.05, 0.05, 0.002]] {
        let runs = 400;
        let draws: Vec<f64> = std::iter::repeat_with(|| run(&mut rng, pose_sigma)).flatten().take(runs).collect();
        let mean = draws.iter().sum::<f64>() / runs as f64 / 2.0;
        // χ²₂/2 over 400 runs: standard deviation 0.05.
        assert!((mean - 1.0).abs() < 0.16, "NEES {mean} at {pose_sigma:?}");
    }
}

#[test]
fn a_bearing_older_than_the_state_is_taken_for_its_own_time() {
    let mut early = Target::new(Vector2::new(2.0, 0.0), at(0.0), 0.1, (1.7, 0.1));
    early.mean[3] = 1.0;
    early.predict(at(0.2));
    let m = BearingFrom { robot: 0, pose: Pose2::IDENTITY, bearing_rad: (0.1f64 / 2.0).atan(), var: 1e-5, at: at(0.1) };
    assert!(early.innovation(&m).residual_rad.abs() < 0.004);
}
