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
            target.update(&BearingFrom {
                robot,
                pose: believed[robot],
                bearing_rad,
                var: sigma * sigma,
                lasting: 0.0,
                at: now,
                interval_s: 0.12,
            });
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
    // Somebody walks by at a metre a second.
    let poses = [Pose2::IDENTITY, Pose2::new(4.0, 0.0, 0.0)];
    let place = |time_s: f64| Vector2::new(2.0, time_s - 2.0);
    let seen = |robot: usize, time_s: f64| {
        let bearing_rad = poses[robot].bearing_to(place(time_s));
        BearingFrom { robot, pose: poses[robot], bearing_rad, var: 1e-5, lasting: 0.0, at: at(time_s), interval_s: 0.2 }
    };
    let mut target = Target::new(place(0.0), at(0.0), 0.1, (1.7, 0.1));
    for k in 1..=20 {
        target.predict(at(0.1 * f64::from(k)));
        target.update(&seen(k as usize % 2, 0.1 * f64::from(k)));
    }
    assert!((target.velocity().y - 1.0).abs() < 0.1, "{:?}", target.velocity());
    assert!(target.innovation(&seen(0, 1.9)).residual_rad.abs() < 0.004);
}

/// Somebody stands for six seconds, then walks off at 1 m/s: mean squared error over covariance, and sigmas at the end of either.
#[test]
fn who_stands_is_known_better_than_who_walks_and_who_starts_is_soon_followed() {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let poses = [Pose2::new(0.0, 0.0, 0.3), Pose2::new(4.0, 0.0, 2.0)];
    let (sigma, runs) = (0.015, 200);
    let (mut nees, mut sigmas, mut speed) = ([0.0; 3], [0.0; 2], 0.0);
    for _ in 0..runs {
        let way = rng.random_range(0.0..std::f64::consts::TAU);
        let start = Vector2::new(rng.random_range(1.5..2.5), rng.random_range(2.0..3.0));
        let mut target = Target::new(start, at(0.0), 0.6, (1.7, 0.1));
        for k in 1..=160_u32 {
            let time_s = 0.05 * f64::from(k);
            let walked = (time_s - 6.0).max(0.0);
            let p = start + Vector2::new(way.cos(), way.sin()) * walked;
            let robot = k as usize % 2;
            let bearing_rad = wrap(poses[robot].bearing_to(p) + normal(&mut rng, sigma));
            target.predict(at(time_s));
            target.update(&BearingFrom {
                robot,
                pose: poses[robot],
                bearing_rad,
                var: sigma * sigma,
                lasting: 0.0,
                at: at(time_s),
                interval_s: 0.1,
            });
            let e = target.position() - p;
            let now = e.dot(&target.own_covariance().cholesky().unwrap().solve(&e)) / 2.0 / f64::from(runs);
            match k {
                // Standing, starting, walking.
                21..=120 => nees[0] += now / 100.0,
                121..=140 => nees[1] += now / 20.0,
                141.. => nees[2] += now / 20.0,
                _ => {}
            }
            if k == 120 || k == 160 {
                sigmas[usize::from(k == 160)] += target.sigma_m() / f64::from(runs);
            }
        }
        speed += target.velocity().norm() / f64::from(runs);
    }
    assert!(sigmas[0] < 0.7 * sigmas[1], "{sigmas:?}");
    assert!((speed - 1.0).abs() < 0.1, "{speed}");
    // Nobody can know of the first step at once.
    assert!(nees[0] < 1.1 && nees[1] < 2.0 && nees[2] < 1.1, "{nees:?}");
}

/// Somebody stands while the errors of each robot's bearings last as long as they do of people in rooms: squared error over the
/// covariance after ten seconds, and the covariance's larger axis.
fn stands_seen_by(robots: usize) -> (f64, f64) {
    let mut rng = ChaCha8Rng::seed_from_u64(12);
    let around = |k: usize| std::f64::consts::TAU * k as f64 / robots as f64;
    let poses: Vec<_> =
        (0..robots).map(|k| Pose2::new(2.0 + 2.5 * around(k).cos(), 2.5 + 2.5 * around(k).sin(), k as f64)).collect();
    let (sigma, runs, frames) = (0.02, 300, 100);
    let keep = (-0.1 / ERRORS_LAST_S[0]).exp();
    let (mut nees, mut sigma_m) = (0.0, 0.0);
    for _ in 0..runs {
        let p = Vector2::new(rng.random_range(1.5..2.5), rng.random_range(2.0..3.0));
        let mut target = Target::new(p, at(0.0), 0.6, (1.7, 0.1));
        let mut errors: Vec<_> = (0..robots).map(|_| normal(&mut rng, 1.0)).collect();
        for k in 1..=frames {
            let now = at(0.1 * f64::from(k));
            target.predict(now);
            for (robot, error) in errors.iter_mut().enumerate() {
                *error = keep * *error + normal(&mut rng, (1.0 - keep * keep).sqrt());
                let part = LASTING.sqrt() * *error + normal(&mut rng, (1.0 - LASTING).sqrt());
                let pose = poses[robot];
                let bearing_rad = wrap(pose.bearing_to(p) + sigma * part);
                let (var, lasting) = (sigma * sigma, LASTING * sigma * sigma);
                target.update(&BearingFrom { robot, pose, bearing_rad, var, lasting, at: now, interval_s: 0.1 });
            }
        }
        let e = target.position() - p;
        nees += e.dot(&target.own_covariance().cholesky().unwrap().solve(&e)) / 2.0 / f64::from(runs);
        sigma_m += target.sigma_m() / f64::from(runs);
    }
    (nees, sigma_m)
}

#[test]
fn who_stands_is_not_better_known_the_longer_the_same_errors_are_seen_but_the_more_robots_see_him() {
    let mut before_m = f64::INFINITY;
    // More than the errors that one filter follows.
    for robots in [3, 5, 12] {
        let (nees, sigma_m) = stands_seen_by(robots);
        // He may move a little, which nobody here does.
        assert!((0.5..1.2).contains(&nees), "{nees} seen by {robots}");
        assert!(sigma_m < before_m, "{sigma_m} m seen by {robots}, {before_m} m by fewer");
        before_m = sigma_m;
    }
}

/// Somebody of unknown height stands, seen by two robots for two seconds, and then walks away from the one that still sees him. Error of
/// his range from there and squared error of his place over the covariance, with and without the tops.
fn walks_away(rng: &mut ChaCha8Rng) -> ([f64; 2], [f64; 2]) {
    let poses = [Pose2::new(0.0, 0.0, 0.3), Pose2::new(3.0, 0.0, 2.0)];
    const SPEED_MPS: f64 = 0.4;
    let (q, sigma, camera_height_m) = (0.1, 0.01, 0.6);
    let start = Vector2::new(rng.random_range(1.0..2.5), rng.random_range(2.0..3.5));
    let mut p = start;
    let height_m = 1.7 + normal(rng, 0.1);
    let by_tops = Target::new(p + Vector2::new(0.2, -0.2), at(0.0), q, (1.7, 0.1));
    let mut targets = [by_tops.clone(), by_tops];
    for k in 1..150 {
        let now = at(f64::from(k) * 0.05);
        let robot = if k < 40 { k as usize % 2 } else { 0 };
        p = start + start.normalize() * SPEED_MPS * (0.05 * f64::from(k) - 2.0).max(0.0);
        let (pose, away) = (poses[robot], p - poses[robot].position());
        let bearing_rad = wrap(away.y.atan2(away.x) - pose.heading_rad + normal(rng, sigma));
        let head_m = height_m + normal(rng, TOP_SWAY_M);
        let elevation = ((head_m - camera_height_m) / away.norm()).atan() + normal(rng, sigma);
        for (target, with_tops) in targets.iter_mut().zip([true, false]) {
            target.predict(now);
            target.update(&BearingFrom {
                robot,
                pose,
                bearing_rad,
                var: sigma * sigma,
                lasting: 0.0,
                at: now,
                interval_s: 0.1,
            });
            if with_tops {
                let elevation_rad = (elevation, sigma);
                target.update_top(&TopFrom { robot, pose, camera_height_m, elevation_rad, at: now, repeat: 1.0 });
            }
        }
    }
    let range_error = targets.each_ref().map(|t| ((t.position() - poses[0].position()).norm() - p.norm()).abs());
    let nees = targets.map(|t| {
        let e = t.position() - p;
        e.dot(&t.own_covariance().cholesky().unwrap().solve(&e))
    });
    (range_error, nees)
}

#[test]
fn who_was_measured_by_two_keeps_a_range_by_its_top_when_one_is_left_and_an_honest_one() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let runs = 300;
    let (errors, nees): (Vec<_>, Vec<_>) = (0..runs).map(|_| walks_away(&mut rng)).unzip();
    let mean = |values: &[[f64; 2]], k: usize| values.iter().map(|v| v[k]).sum::<f64>() / f64::from(runs);
    let [with, without] = [0, 1].map(|k| mean(&errors, k));
    // The height is known to 2 or 3 cm, which is 8 to 12 cm in range at 4.2 m.
    let nees = mean(&nees, 0) / 2.0;
    assert!(with < 0.2 && with < 0.6 * without, "{with} m with tops, {without} m without");
    assert!((0.3..1.2).contains(&nees), "NEES {nees}");
}

#[test]
fn a_hand_above_the_head_moves_nobody() {
    let mut target = Target::new(Vector2::new(2.0, 0.0), at(0.0), 0.1, (1.7, 0.05));
    target.update_range(&Pose2::IDENTITY, 2.0, 0.01);
    let before = target.clone();
    let elevation_rad = ((2.4f64 - 0.6) / 2.0).atan();
    let hand = TopFrom {
        robot: 0,
        pose: Pose2::IDENTITY,
        camera_height_m: 0.6,
        elevation_rad: (elevation_rad, 0.01),
        at: at(0.0),
        repeat: 1.0,
    };
    target.update_top(&hand);
    assert_eq!(target.position(), before.position());
    assert!(!target.top_m().1);
}
