use serde_json::{Value, json};

use super::*;
use crate::golden::golden;
use crate::solve::{solve, solve_and_explain};

/// Two robots with cylinders that see each other and a target, as in the golden numbers.
fn layout(d1: f64, b: f64, phi1: f64, shift_deg: f64) -> Value {
    let sigma_deg = 360.0 / 1080.0;
    let half = (0.2 / b).asin().to_degrees();
    let see = |observer: &str, peer: &str, at: f64| json!({"observer": observer, "peer": peer, "features_deg": [at - half, at + half], "feature_sigma_deg": sigma_deg});
    let target = [d1 * phi1.cos(), d1 * phi1.sin()];
    let bearing = |observer: &str, x: f64, shift: f64| {
        json!({"observer": observer, "target": "t", "bearing_sigma_deg": sigma_deg,
            "bearing_deg": target[1].atan2(target[0] - x).to_degrees() + shift})
    };
    json!({"robots": [{"id": "r1"}, {"id": "r2"}], "sightings": [see("r1", "r2", 0.0), see("r2", "r1", 180.0)],
        "bearings": [bearing("r1", 0.0, shift_deg), bearing("r2", b, 0.0)]})
}

fn parse(problem: &Value) -> Problem {
    Problem::parse(&problem.to_string()).unwrap()
}

#[test]
fn the_parts_sum_to_the_golden_bound_of_a_target() {
    for case in golden("crlb_target")["outputs"].as_array().unwrap() {
        let [d1, d2, phi0, b] = ["D1", "D2", "phi0_deg", "B"].map(|key| case[key].as_f64().unwrap());
        let phi1 = ((d1 * d1 + b * b - d2 * d2) / (2.0 * d1 * b)).acos();
        let _ = phi0;
        let solution = solve_and_explain(parse(&layout(d1, b, phi1, 0.0)));
        let explained = &solution.explained[0];
        let drms = case["drms"].as_f64().unwrap();
        assert!((explained.rms_m / drms - 1.0).abs() < 1e-4, "{} {drms}", explained.rms_m);
        assert!((explained.bound_m / drms - 1.0).abs() < 1e-4);
        assert!((explained.parts.iter().map(|p| p.share).sum::<f64>() - 1.0).abs() < 1e-12);
        let sources: Vec<&str> = explained.parts.iter().map(|p| p.source.as_str()).collect();
        for source in ["baseline r1 r2", "bearings of t by r1", "bearings of t by r2"] {
            assert!(sources.contains(&source), "{sources:?}");
        }
    }
}

#[test]
fn a_sensitivity_is_what_a_bearing_that_is_off_does() {
    let at = |shift_deg: f64| {
        let target = &solve(parse(&layout(3.0, 1.5, 1.2, shift_deg))).targets[0];
        [target.x_m, target.y_m]
    };
    let (after, before) = (at(0.01), at(-0.01));
    let measured = (after[0] - before[0]).hypot(after[1] - before[1]) / 0.02;
    let solution = solve_and_explain(parse(&layout(3.0, 1.5, 1.2, 0.0)));
    let part = solution.explained[0].parts.iter().find(|p| p.source == "bearings of t by r1").unwrap();
    assert!((part.m_per_deg.unwrap() / measured - 1.0).abs() < 1e-3, "{part:?} {measured}");
}
