//! Walkers on ellipses among robots that stand; truth from plain trigonometry.

use super::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

const SIGMA_RAD: f64 = 0.003;

struct Errors {
    late_s: Vec<f64>,
    bias_rad: Vec<f64>,
    /// By how much errors are larger than stated.
    larger: Vec<f64>,
    /// From when to when the first robot takes whoever walks so many seconds behind people for them.
    mistaken_s: [f64; 3],
}

fn errors(robots: usize) -> Errors {
    Errors { late_s: vec![0.0; robots], bias_rad: vec![0.0; robots], larger: vec![1.0; robots], mistaken_s: [0.0; 3] }
}

fn walker(n: u32, t: f64) -> [f64; 2] {
    let phase = (0.45 + 0.1 * f64::from(n)) * t + 1.7 * f64::from(n);
    let size = 0.5 + 0.2 * f64::from(n);
    [4.0 + 2.2 * size * phase.cos(), 3.0 + 1.8 * size * (1.3 * phase).sin()]
}

fn watch(errors: &Errors, seconds: f64, seed: u64) -> Systematic {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let n = errors.late_s.len();
    let pose = |k: usize| {
        let around = std::f64::consts::TAU * k as f64 / n as f64;
        Pose2::new(4.0 + 3.5 * around.cos(), 3.0 + 3.0 * around.sin(), 1.3 * k as f64)
    };
    let config = TargetConfig { axis_sway_m: 0.0, correlation_s: 0.05, ..TargetConfig::default() };
    let mut systematic = Systematic::new(config);
    for frame in 0..(10.0 * seconds) as u32 {
        for r in 0..n {
            let stamp_s = 0.1 * f64::from(frame) + 0.03 * r as f64 + rng.random_range(0.0..0.01);
            let at = Timestamp::from_secs_f64(1000.0 + stamp_s);
            let p = pose(r);
            let bearings = (0..3)
                .map(|w| {
                    let [from_s, to_s, behind_s] = errors.mistaken_s;
                    let mistaken = r == 0 && (from_s..to_s).contains(&stamp_s);
                    let [x, y] = walker(w, stamp_s - errors.late_s[r] - if mistaken { behind_s } else { 0.0 });
                    let noise: f64 = StandardNormal.sample(&mut rng);
                    let b = (y - p.y_m).atan2(x - p.x_m) - p.heading_rad;
                    (TargetId(w), b + errors.bias_rad[r] + errors.larger[r] * SIGMA_RAD * noise, SIGMA_RAD)
                })
                .collect();
            systematic.expect(r, at, at, 0.0, p);
            systematic.learn(&SettledFrame { robot: r, at, bearings });
        }
    }
    systematic
}

#[test]
fn sixty_milliseconds_of_hidden_latency_are_found_to_ten() {
    for (robots, seed) in [(3, 1), (4, 2), (5, 3)] {
        let mut errors = errors(robots);
        errors.late_s[1] = 0.06;
        let found = watch(&errors, 30.0, seed);
        for (r, late_s) in errors.late_s.iter().enumerate() {
            let (lag_s, sigma_s) = found.of(r).lag_s.unwrap();
            assert!((lag_s - late_s).abs() < 0.01 && sigma_s < 0.01, "{robots} robots, {r}: {lag_s} ± {sigma_s}");
            assert_eq!(found.of(r).sure_lag_s != 0.0, r == 1, "{robots} robots, {r}: {lag_s} ± {sigma_s}");
        }
    }
}

#[test]
fn people_taken_for_others_for_seconds_make_no_lag_and_no_bias() {
    let mut furthest: f64 = 0.0;
    for (robots, seed) in [(3, 11), (3, 12), (4, 13), (4, 14)] {
        for begin_s in [3.0, 6.0, 9.0] {
            let mut errors = errors(robots);
            errors.mistaken_s = [begin_s, begin_s + 3.0, 0.4];
            let found = watch(&errors, 13.5, seed);
            for r in 0..robots {
                let Shared { lag_s, bias_rad, sure_lag_s, sure_bias_rad, .. } = found.of(r);
                assert_eq!(
                    [sure_lag_s, sure_bias_rad],
                    [0.0; 2],
                    "{robots} robots, {r}, {begin_s} s: {lag_s:?} {bias_rad:?}"
                );
                let sigmas = [lag_s, bias_rad].into_iter().flatten().map(|(value, sigma)| value.abs() / sigma);
                furthest = sigmas.fold(furthest, f64::max);
            }
        }
    }
    println!("at most {furthest:.1} sigmas");
    assert!(furthest < 4.0, "{furthest}");
}

#[test]
fn a_bias_of_a_robots_bearings_is_found_and_the_others_have_none() {
    let mut errors = errors(4);
    errors.bias_rad[2] = 0.02;
    let found = watch(&errors, 30.0, 4);
    for (r, bias) in errors.bias_rad.iter().enumerate() {
        let (b, sigma) = found.of(r).bias_rad.unwrap();
        assert!((b - bias).abs() < 0.002 && sigma < 0.002, "{r}: {b} ± {sigma}");
        assert_eq!(found.of(r).sure_bias_rad != 0.0, r == 2);
    }
}

#[test]
fn lags_and_biases_are_honest_over_seeds() {
    let (mut nees, mut n) = (0.0, 0.0);
    for seed in 0..12 {
        let mut errors = errors(3);
        let mut rng = ChaCha8Rng::seed_from_u64(100 + seed);
        for r in 0..3 {
            errors.bias_rad[r] = 0.005 * rng.random_range(-1.0..1.0);
        }
        errors.late_s[0] = 0.04;
        let found = watch(&errors, 20.0, 200 + seed);
        for r in 0..3 {
            let (lag, lag_sigma) = found.of(r).lag_s.unwrap();
            let (bias, bias_sigma) = found.of(r).bias_rad.unwrap();
            nees += ((lag - errors.late_s[r]) / lag_sigma).powi(2) + ((bias - errors.bias_rad[r]) / bias_sigma).powi(2);
            n += 2.0;
        }
    }
    let nees: f64 = nees / n;
    println!("NEES {nees}");
    assert!((0.2..1.6).contains(&nees), "{nees}");
}

#[test]
fn errors_larger_than_stated_are_widened_for_the_robot_that_has_them_alone() {
    let mut errors = errors(4);
    errors.larger[3] = 3.0;
    let found = watch(&errors, 30.0, 5);
    for r in 0..3 {
        assert_eq!(found.of(r).widened, 1.0, "{r}");
    }
    let widened = found.of(3).widened;
    assert!((2.2..4.0).contains(&widened), "{widened}");
    assert_eq!(found.of(3).set_aside, widened > SET_ASIDE);
}

#[test]
fn a_robot_that_leaves_its_station_keeps_its_lag_and_one_that_begins_anew_nothing() {
    let mut errors = errors(3);
    (errors.late_s[1], errors.bias_rad[1]) = (0.06, 0.02);
    let mut found = watch(&errors, 20.0, 6);
    found.left_station(1);
    assert_eq!(found.of(1).bias_rad, None);
    found.solve(0.0);
    assert!((found.of(1).lag_s.unwrap().0 - 0.06).abs() < 0.01, "{:?}", found.of(1));
    found.new_session(1);
    assert_eq!(found.of(1), Shared { widened: 1.0, ..Shared::default() });
    found.solve(0.0);
    assert_eq!(found.of(1).lag_s, None);
}
