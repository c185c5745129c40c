//! Targets that move, robots whose stamps or bearings are off, real errors; truth from plain trigonometry.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde_json::{Value, json};

use super::{Solution, SolveStatus, solved};

/// Robots that stand in a room and walkers among them, seen at 10 Hz.
struct Walk {
    robots: Vec<[f64; 3]>,
    walkers: usize,
    seconds: f64,
    /// By how much each robot's stamps are late.
    late_s: Vec<f64>,
    /// Added to each robot's bearings, degrees.
    bias_deg: Vec<f64>,
    /// Share of errors of ten sigmas.
    tails: f64,
    seed: u64,
}

const SIGMA_DEG: f64 = 0.1;

impl Walk {
    fn new(robots: usize, walkers: usize, seconds: f64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let robot = |k: usize| {
            let around = std::f64::consts::TAU * k as f64 / robots as f64;
            [4.0 + 3.0 * around.cos(), 3.0 + 2.5 * around.sin(), rng.random_range(-180.0..180.0)]
        };
        let zeros = vec![0.0; robots];
        let robots = (0..robots).map(robot).collect();
        Self { robots, walkers, seconds, late_s: zeros.clone(), bias_deg: zeros, tails: 0.0, seed: 11 }
    }

    /// A walker goes round an ellipse.
    fn walker(&self, walker: usize, time_s: f64) -> [f64; 2] {
        let phase = 0.5 * time_s + 1.7 * walker as f64;
        let size = 0.4 + 0.6 * walker as f64 / self.walkers as f64;
        [4.0 + 2.5 * size * phase.cos(), 3.0 + 2.0 * size * phase.sin()]
    }

    fn json(&self) -> Value {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        let mut error = |sigma: f64| {
            let normal: f64 = StandardNormal.sample(&mut rng);
            sigma * normal * if rng.random_range(0.0..1.0) < self.tails { 10.0 } else { 1.0 }
        };
        let toward = |from: &[f64; 3], to: [f64; 2]| {
            let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
            (dy.atan2(dx).to_degrees() - from[2], dx.hypot(dy))
        };
        let (mut sightings, mut bearings) = (Vec::new(), Vec::new());
        for frame in 0..(10.0 * self.seconds) as u32 {
            let time_s = f64::from(frame) / 10.0;
            for (i, robot) in self.robots.iter().enumerate() {
                for (j, other) in self.robots.iter().enumerate().filter(|(j, _)| *j != i) {
                    let (bearing, range) = toward(robot, [other[0], other[1]]);
                    sightings.push(json!({"observer": format!("r{i}"), "peer": format!("r{j}"),
                        "bearing_deg": bearing + self.bias_deg[i] + error(SIGMA_DEG), "bearing_sigma_deg": SIGMA_DEG,
                        "range_m": range + error(0.05), "range_sigma_m": 0.05}));
                }
                for walker in 0..self.walkers {
                    let (bearing, _) = toward(robot, self.walker(walker, time_s - self.late_s[i]));
                    bearings
                        .push(json!({"observer": format!("r{i}"), "target": format!("w{walker}"), "time_s": time_s,
                        "bearing_deg": bearing + self.bias_deg[i] + error(SIGMA_DEG), "bearing_sigma_deg": SIGMA_DEG}));
                }
            }
        }
        let robots: Vec<Value> = (0..self.robots.len()).map(|k| json!({"id": format!("r{k}")})).collect();
        let [x, y, heading] = self.robots[0];
        let mut problem = json!({"robots": robots, "sightings": sightings, "bearings": bearings});
        problem["robots"][0]["pose"] = json!({"x_m": x, "y_m": y, "heading_deg": heading});
        problem
    }

    /// Largest squared error of a robot's position in its sigmas, and the largest error in metres.
    fn robots_off(&self, solution: &Solution) -> (f64, f64) {
        let mut worst = (0.0, 0.0);
        for (robot, truth) in solution.robots.iter().zip(&self.robots).skip(1) {
            let e = nalgebra::Vector2::new(robot.x_m - truth[0], robot.y_m - truth[1]);
            let c = robot.covariance.unwrap();
            let cov = nalgebra::Matrix2::new(c[0][0], c[0][1], c[1][0], c[1][1]);
            worst = (f64::max(worst.0, e.dot(&(cov.try_inverse().unwrap() * e))), f64::max(worst.1, e.norm()));
        }
        worst
    }
}

#[test]
fn walkers_are_found_along_their_way_with_their_velocity() {
    let walk = Walk::new(4, 3, 2.0);
    let solution = solved(&walk.json());
    assert_eq!(solution.status, SolveStatus::Converged, "{}", solution.explanation);
    let (chi2, _) = walk.robots_off(&solution);
    assert!(chi2 < 14.0, "{chi2}");
    assert_eq!(solution.targets.len(), 3 * 5);
    for target in &solution.targets {
        let walker: usize = target.id[1..].parse().unwrap();
        let time_s = target.time_s.unwrap();
        let [x, y] = walk.walker(walker, time_s);
        assert!((target.x_m - x).hypot(target.y_m - y) < 0.02, "{target:?} {x} {y}");
        let (after, before) = (walk.walker(walker, time_s + 0.01), walk.walker(walker, time_s - 0.01));
        let [vx, vy] = target.velocity_mps.unwrap();
        let off = (vx - (after[0] - before[0]) / 0.02).hypot(vy - (after[1] - before[1]) / 0.02);
        assert!(off < 0.2, "{off} m/s");
    }
}

#[test]
fn sixty_milliseconds_of_latency_that_no_probe_sees_are_recovered_to_ten() {
    let mut walk = Walk::new(4, 3, 4.0);
    walk.late_s[2] = 0.06;
    let mut problem = walk.json();
    for robot in problem["robots"].as_array_mut().unwrap().iter_mut().skip(1) {
        robot["time_offset_sigma_s"] = json!(0.1);
    }
    let solution = solved(&problem);
    assert_eq!(solution.status, SolveStatus::Converged, "{}", solution.explanation);
    for (robot, late_s) in solution.robots.iter().zip(&walk.late_s).skip(1) {
        let (offset, sigma) = (robot.nuisance.time_offset_s.unwrap(), robot.nuisance.time_offset_sigma_s.unwrap());
        assert!(
            (offset - late_s).abs() < 0.01 && (offset - late_s).abs() < 4.0 * sigma,
            "{}: {offset} ± {sigma}",
            robot.id
        );
    }
}

#[test]
fn a_bias_of_all_bearings_shows_where_the_pose_is_known() {
    let mut walk = Walk::new(4, 3, 2.0);
    walk.bias_deg = vec![0.0, 0.6, -0.4, 0.8];
    let mut problem = walk.json();
    for (robot, [x, y, heading]) in problem["robots"].as_array_mut().unwrap().iter_mut().zip(&walk.robots) {
        robot["pose"] = json!({"x_m": x, "y_m": y, "heading_deg": heading});
        robot["bearing_bias_sigma_deg"] = json!(1.0);
    }
    let solution = solved(&problem);
    assert_eq!(solution.status, SolveStatus::Converged, "{}", solution.explanation);
    for (robot, bias) in solution.robots.iter().zip(&walk.bias_deg) {
        let (found, sigma) = (robot.nuisance.bearing_bias_deg.unwrap(), robot.nuisance.bearing_bias_sigma_deg.unwrap());
        assert!((found - bias).abs() < 4.0 * sigma && sigma < 0.05, "{}: {found} ± {sigma}", robot.id);
    }
}

#[test]
fn bearings_with_the_tails_of_real_ones_do_not_spoil_the_layout() {
    let mut walk = Walk::new(4, 3, 3.0);
    let (_, clean_m) = walk.robots_off(&solved(&walk.json()));
    walk.tails = 0.03;
    let solution = solved(&walk.json());
    assert_eq!(solution.status, SolveStatus::Converged, "{}", solution.explanation);
    let (chi2, off_m) = walk.robots_off(&solution);
    assert!(chi2 < 14.0 && off_m < clean_m + 0.01, "{chi2} {off_m} {clean_m}");
    assert!(solution.warnings.iter().any(|w| w.contains("set aside")), "{:?}", solution.warnings);
}

#[test]
fn ten_robots_and_twenty_walkers_are_solved_with_the_truth_inside_their_sigmas() {
    let walk = Walk::new(10, 20, 1.0);
    let solution = solved(&walk.json());
    assert_eq!(solution.status, SolveStatus::Converged, "{}", solution.explanation);
    let (chi2, off_m) = walk.robots_off(&solution);
    // The largest of nine χ² with two degrees of freedom, once in ten thousand.
    assert!(chi2 < 23.0 && off_m < 0.02, "{chi2} {off_m}");
}
