use std::f64::consts::PI;

use serde_json::Value;

use super::*;
use crate::efficiency::scene::{PLATE_M, RADIUS_M, Worn};

/// Of the golden numbers: 1 px on 1080 columns.
const SIGMA: f64 = 2.0 * PI / 1080.0;

fn golden(group: &str) -> Value {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/golden/golden.json");
    let all: Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    all[group]["outputs"].clone()
}

fn agree(found: f64, golden: &Value, tolerance: f64, what: &str) {
    let golden = golden.as_f64().unwrap();
    assert!((found / golden - 1.0).abs() < tolerance, "{what}: {found}, golden {golden}");
}

#[test]
fn numerically_differentiated_bounds_of_a_baseline_seen_one_way_are_the_golden_ones() {
    for case in golden("crlb_baseline").as_array().unwrap() {
        let b = case["B"].as_f64().unwrap();
        // Unknowns of one sighting: range, bearing and, where it shows, the direction of the body.
        let sigma_b = |x: &[f64], rows: usize, measure: &dyn Fn(&[f64], usize) -> f64, sigmas: &[f64]| {
            let mut j = derivatives(x, rows, measure);
            for (k, sigma) in sigmas.iter().enumerate() {
                j.row_mut(k).scale_mut(sigma.recip());
            }
            (j.transpose() * j).try_inverse().unwrap()[(0, 0)].sqrt()
        };
        let cylinder = |x: &[f64], k: usize| x[1] + [1.0, -1.0][k] * (RADIUS_M / x[0]).asin();
        agree(sigma_b(&[b, 0.1], 2, &cylinder, &[SIGMA; 2]), &case["cyl"], 1e-4, "cylinder");
        for (tilt_deg, name) in [(0.0f64, "rect0H"), (30.0, "rect30H"), (60.0, "rect60H")] {
            let plate = |x: &[f64], k: usize| {
                let at = |e: f64| {
                    let (s, c) = x[2].sin_cos();
                    [x[0] * x[1].cos() - e * s, x[0] * x[1].sin() + e * c]
                };
                let p = at(0.5 * PLATE_M[0] * if k.is_multiple_of(2) { 1.0 } else { -1.0 });
                // Heights on the cylinder: rows of a height, of which both ends are measured.
                if k < 2 { p[1].atan2(p[0]) } else { PLATE_M[1] / p[0].hypot(p[1]) }
            };
            let heights = 2f64.sqrt() * SIGMA;
            let sigmas = [SIGMA, SIGMA, heights, heights];
            agree(sigma_b(&[b, 0.1, 0.1 + tilt_deg.to_radians()], 4, &plate, &sigmas), &case[name], 0.02, name);
        }
    }
}

#[test]
fn the_bound_of_a_target_between_two_cylinders_is_the_golden_one() {
    for case in golden("crlb_target").as_array().unwrap() {
        let [d1, d2, phi0, b] = ["D1", "D2", "phi0_deg", "B"].map(|key| case[key].as_f64().unwrap());
        // The angle at the first robot, by the law of sines.
        let phi1 = (d2 * phi0.to_radians().sin() / b).asin();
        let phi1 = if d1 * d1 + b * b < d2 * d2 { PI - phi1 } else { phi1 };
        let scene = Scene {
            worn: Worn::Cylinder,
            robots: vec![[0.0; 3], [b, 0.0, 2.0]],
            targets: vec![[d1 * phi1.cos(), d1 * phi1.sin()]],
        };
        let cov = bound(&scene, &scene.measurements(), SIGMA).unwrap();
        agree((cov[(3, 3)] + cov[(4, 4)]).sqrt(), &case["drms"], 1e-4, "target");
    }
}
