//! One robot that looks from two places: stereo over time. Truth from plain trigonometry.

use nalgebra::{Cholesky, Matrix2, Matrix3, Vector2, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde_json::{Value, json};

use super::{Problem, Solution, SolveStatus, solved};
use crate::solve::solve_and_explain;

const SIGMA_DEG: f64 = 0.1;
const RANGE_SIGMA_M: f64 = 0.01;
/// Where r1 goes from the origin, and what it looks at.
const STEP: [f64; 3] = [1.1, 0.5, 30.0];
const TARGETS: [(&str, [f64; 2]); 3] = [("a", [1.5, 2.0]), ("b", [-1.0, 2.4]), ("c", [2.8, -1.5])];
const WATCHER: [f64; 3] = [2.5, 1.6, 200.0];

/// Of the odometry: slip and turn go together.
fn odometry(scale: f64) -> Matrix3<f64> {
    let sigma = Vector3::new(0.012, 0.008, 0.3f64.to_radians()) * scale;
    let correlation = Matrix3::new(1.0, 0.3, 0.2, 0.3, 1.0, 0.6, 0.2, 0.6, 1.0);
    Matrix3::from_diagonal(&sigma) * correlation * Matrix3::from_diagonal(&sigma)
}

fn look(from: [f64; 3], to: [f64; 2]) -> (f64, f64) {
    let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
    (dy.atan2(dx).to_degrees() - from[2], dx.hypot(dy))
}

struct Draw {
    covariance: Matrix3<f64>,
    /// Another robot sees r1 at both places, and is seen.
    watched: bool,
    /// Shared by all of r1's bearings.
    bias_deg: Option<f64>,
}

impl Draw {
    fn json(&self, seed: u64) -> Value {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let bias = self.bias_deg.map_or(0.0, |sigma| sigma * normal());
        let slip = Cholesky::new(self.covariance).unwrap().l() * Vector3::from_fn(|_, _| normal());
        let places = [("r1", [0.0; 3]), ("r1_later", STEP)];
        let mut bearings = Vec::new();
        let mut sightings = Vec::new();
        for (id, place) in places {
            for (target, at) in TARGETS {
                let bearing = look(place, at).0 + SIGMA_DEG * normal() + bias;
                bearings.push(
                    json!({"observer": id, "target": target, "bearing_deg": bearing, "bearing_sigma_deg": SIGMA_DEG}),
                );
            }
            if self.watched {
                for (observer, peer, from, to) in [(id, "r2", place, WATCHER), ("r2", id, WATCHER, place)] {
                    let (bearing, range) = look(from, [to[0], to[1]]);
                    let own = if observer == "r2" { 0.0 } else { bias };
                    sightings.push(json!({"observer": observer, "peer": peer,
                        "bearing_deg": bearing + SIGMA_DEG * normal() + own, "bearing_sigma_deg": SIGMA_DEG,
                        "range_m": range + RANGE_SIGMA_M * normal(), "range_sigma_m": RANGE_SIGMA_M}));
                }
            }
        }
        let rows: Vec<Vec<f64>> = (0..3).map(|r| (0..3).map(|c| self.covariance[(r, c)]).collect()).collect();
        let mut robots = vec![
            json!({"id": "r1", "bearing_bias_sigma_deg": self.bias_deg}),
            json!({"id": "r1_later", "moved_from": {"robot": "r1", "dx_m": STEP[0] + slip[0], "dy_m": STEP[1] + slip[1],
                "dheading_deg": STEP[2] + slip[2].to_degrees(), "covariance": rows}}),
        ];
        if self.watched {
            robots.push(json!({"id": "r2"}));
        }
        json!({"anchor": "r1", "robots": robots, "sightings": sightings, "bearings": bearings})
    }

    /// Mean of eᵀ C⁻¹ e over two, of all targets, and their RMS error; over so many draws.
    fn consistency(&self, draws: u64) -> (f64, f64) {
        let (mut nees, mut square) = (0.0, 0.0);
        for seed in 0..draws {
            let solution = solved(&self.json(seed));
            assert_eq!(solution.status, SolveStatus::Converged, "{}", solution.explanation);
            for (name, truth) in TARGETS {
                let (error, covariance) = error_of(&solution, name, truth);
                nees += error.dot(&(covariance.try_inverse().unwrap() * error)) / 2.0;
                square += error.norm_squared();
            }
        }
        let count = draws as f64 * TARGETS.len() as f64;
        (nees / count, (square / count).sqrt())
    }
}

fn error_of(solution: &Solution, name: &str, truth: [f64; 2]) -> (Vector2<f64>, Matrix2<f64>) {
    let target = solution.targets.iter().find(|t| t.id == name).unwrap();
    let c = target.covariance.unwrap();
    let error = Vector2::new(target.x_m - truth[0], target.y_m - truth[1]);
    (error, Matrix2::new(c[0][0], c[0][1], c[1][0], c[1][1]))
}

const DRAWS: u64 = 1000;
/// Targets of one draw share the way's error: no more is sure than with one target a draw. χ² with 2000 degrees of freedom
/// over their number, at 1 %.
const BOUNDS: [f64; 2] = [0.92, 1.08];

fn assert_consistent(nees: f64) {
    assert!(BOUNDS[0] < nees && nees < BOUNDS[1], "{nees}");
}

#[test]
fn a_standing_target_is_placed_from_two_places_of_one_robot_and_the_odometry_between_them() {
    let (nees, rms) = Draw { covariance: odometry(1.0), watched: false, bias_deg: None }.consistency(DRAWS);
    assert_consistent(nees);
    // One bearing alone, 0.1° of 2.5 m and a parallax of 25°, would be 1 cm: the way's error is most of it.
    assert!((0.01..0.06).contains(&rms), "{rms}");
}

#[test]
fn what_others_see_of_the_robot_at_both_places_counts_beside_the_odometry() {
    let alone = Draw { covariance: odometry(1.0), watched: false, bias_deg: None }.consistency(DRAWS / 4).1;
    let (nees, rms) = Draw { covariance: odometry(1.0), watched: true, bias_deg: None }.consistency(DRAWS);
    assert_consistent(nees);
    assert!(rms < 0.7 * alone, "{rms} {alone}");
    // And without an odometry worth the name it is the calibration alone.
    let (nees, lost) = Draw { covariance: odometry(30.0), watched: true, bias_deg: None }.consistency(DRAWS);
    assert_consistent(nees);
    assert!(rms < lost && lost < alone, "{rms} {lost} {alone}");
}

#[test]
fn a_bias_of_the_camera_is_the_same_at_both_places() {
    // Odometry that turns well: what is off is the camera, which nothing but the odometry and the watcher tells.
    let biased = Draw { covariance: odometry(1.0), watched: true, bias_deg: Some(0.5) };
    assert_consistent(biased.consistency(DRAWS).0);
    let solution = solved(&biased.json(0));
    let of = |id: &str| solution.robots.iter().find(|r| r.id == id).unwrap().nuisance.bearing_bias_deg.unwrap();
    assert_eq!(of("r1"), of("r1_later"));
}

#[test]
fn the_way_is_named_among_the_sources_of_the_error() {
    let draw = Draw { covariance: odometry(1.0), watched: false, bias_deg: None };
    let solution = solve_and_explain(Problem::parse(&draw.json(0).to_string()).unwrap());
    for explained in &solution.explained {
        assert_eq!(explained.parts[0].source, "way r1 r1_later");
        assert!((explained.parts.iter().map(|p| p.share).sum::<f64>() - 1.0).abs() < 1e-9);
        let target = solution.targets.iter().find(|t| t.id == explained.target).unwrap();
        let c = target.covariance.unwrap();
        assert!((explained.rms_m / (c[0][0] + c[1][1]).sqrt() - 1.0).abs() < 1e-6);
    }
}

#[test]
fn ways_that_cannot_be_are_refused_by_name() {
    let good = Draw { covariance: odometry(1.0), watched: false, bias_deg: None }.json(0);
    let refused = |change: &dyn Fn(&mut Value)| {
        let mut problem = good.clone();
        change(&mut problem);
        Problem::parse(&problem.to_string()).unwrap_err().to_string()
    };
    let moved = |p: &mut Value, key: &str, value: Value| p["robots"][1]["moved_from"][key] = value;
    let later = refused(&|p| moved(p, "robot", json!("r1_later")));
    assert!(later.contains("robots[r1_later].moved_from.robot") && later.contains("listed before"), "{later}");
    let flat = refused(&|p| moved(p, "covariance", json!([[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]])));
    assert!(flat.contains("moved_from.covariance") && flat.contains("positive definite"), "{flat}");
    let itself = refused(&|p| {
        p["sightings"] = json!([{"observer": "r1", "peer": "r1_later", "bearing_deg": 1.0, "bearing_sigma_deg": 1.0}]);
    });
    assert!(itself.contains("another robot than the observer"), "{itself}");
    let twice = refused(&|p| p["robots"][1]["bearing_bias_sigma_deg"] = json!(1.0));
    assert!(twice.contains("a camera keeps its errors"), "{twice}");
}
