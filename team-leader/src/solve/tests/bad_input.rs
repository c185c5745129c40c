//! What is wrong in the world or in the file: the status says so, and nothing wrong is said with confidence.

use serde_json::{Value, json};

use super::{Solution, SolveStatus, solved, world};

/// Robots further from the truth than five of their own sigmas and a centimetre.
fn confidently_wrong(solution: &Solution) -> Vec<String> {
    let world = world();
    let off = |id: &str, x: f64, y: f64| {
        let (_, truth) = world.robots.iter().find(|(r, _)| *r == id).unwrap();
        (x - truth[0]).hypot(y - truth[1])
    };
    let wrong = solution
        .robots
        .iter()
        .filter(|r| r.covariance.is_some_and(|c| off(&r.id, r.x_m, r.y_m) > 0.01 + 5.0 * (c[0][0] + c[1][1]).sqrt()));
    wrong.map(|r| r.id.clone()).collect()
}

fn sightings(problem: &mut Value) -> &mut Vec<Value> {
    problem["sightings"].as_array_mut().unwrap()
}

#[test]
fn a_robot_with_a_wrong_radius_is_in_the_pairs_that_disagree() {
    let mut problem = world().json(true);
    for s in sightings(&mut problem) {
        let (range, bearing) = (s["range_m"].as_f64().unwrap(), s["bearing_deg"].as_f64().unwrap());
        // r2 announces 0.2 m and is 0.25 m thick.
        let radius = if s["peer"] == "r2" { 0.25 } else { 0.2 };
        let half = f64::asin(radius / range).to_degrees();
        let o = s.as_object_mut().unwrap();
        o.retain(|key, _| key == "observer" || key == "peer");
        o.insert("features_deg".into(), json!([bearing - half, bearing + half]));
        o.insert("feature_sigma_deg".into(), json!(0.05));
    }
    let solution = solved(&problem);
    assert_eq!(solution.status, SolveStatus::Inconsistent, "{}", solution.explanation);
    let pairs: Vec<&String> = solution.warnings.iter().filter(|w| w.contains("disagree")).collect();
    assert_eq!(pairs.len(), 2, "{:?}", solution.warnings);
    assert!(pairs.iter().all(|w| w.contains("r2")), "{pairs:?}");
}

#[test]
fn two_robots_with_exchanged_names_are_inconsistent() {
    let mut problem = world().json(true);
    for s in sightings(&mut problem).iter_mut().filter(|s| s["observer"] == "r1") {
        s["peer"] = if s["peer"] == "r2" { json!("r3") } else { json!("r2") };
    }
    let solution = solved(&problem);
    assert_eq!(solution.status, SolveStatus::Inconsistent, "{}", solution.explanation);
    assert!(solution.warnings.iter().any(|w| w.contains("disagree")), "{:?}", solution.warnings);
}

#[test]
fn a_bearing_that_points_backwards_is_named() {
    let mut problem = world().json(true);
    let bearing = problem["bearings"][4]["bearing_deg"].as_f64().unwrap();
    problem["bearings"][4]["bearing_deg"] = json!(bearing + 180.0);
    let solution = solved(&problem);
    assert_eq!(solution.status, SolveStatus::Inconsistent, "{}", solution.explanation);
    assert!(solution.explanation.contains("the bearing of b from r2"), "{}", solution.explanation);
    assert_eq!(confidently_wrong(&solution), Vec::<String>::new());
}

#[test]
fn collinear_robots_without_distances_are_degenerate_and_told_what_would_cure_them() {
    let robots = [("r1", [0.0, 0.0, 0.0]), ("r2", [2.0, 0.0, 90.0]), ("r3", [4.5, 0.0, 200.0])];
    let mut sightings = Vec::new();
    for (a, p) in robots {
        for (b, q) in robots.iter().filter(|(b, _)| *b != a) {
            let bearing = f64::atan2(q[1] - p[1], q[0] - p[0]).to_degrees() - p[2];
            let mut s = json!({"observer": a, "peer": b, "bearing_deg": bearing, "bearing_sigma_deg": 0.05});
            if (a, *b) == ("r1", "r3") {
                s["range_m"] = json!(4.5);
                s["range_sigma_m"] = json!(0.02);
            }
            sightings.push(s);
        }
    }
    let solution = solved(&json!({"robots": robots.map(|(id, _)| json!({"id": id})), "sightings": sightings}));
    assert_eq!(solution.status, SolveStatus::Degenerate, "{}", solution.explanation);
    assert_eq!(solution.undetermined.len(), 1);
    assert!(solution.undetermined[0].contains("position of r2 along"), "{:?}", solution.undetermined);
    assert!(solution.cures.iter().any(|c| c.contains("distance") && c.contains("r2")), "{:?}", solution.cures);
}

#[test]
fn a_target_on_the_baseline_is_undetermined_and_a_third_robot_would_cure_it() {
    let robots = [("r1", [0.0, 0.0, 0.0]), ("r2", [3.0, 0.0, 180.0]), ("r3", [1.0, 2.0, 0.0])];
    let mut sightings = Vec::new();
    for (a, p) in robots {
        for (b, q) in robots.iter().filter(|(b, _)| *b != a) {
            let bearing = f64::atan2(q[1] - p[1], q[0] - p[0]).to_degrees() - p[2];
            sightings.push(json!({"observer": a, "peer": b, "bearing_deg": bearing, "bearing_sigma_deg": 0.05,
                "range_m": (q[0] - p[0]).hypot(q[1] - p[1]), "range_sigma_m": 0.02}));
        }
    }
    let bearing = |robot: &str| json!({"observer": robot, "target": "t", "bearing_deg": 0.0, "bearing_sigma_deg": 0.1});
    let solution = solved(&json!({"robots": robots.map(|(id, _)| json!({"id": id})), "sightings": sightings,
        "bearings": [bearing("r1"), bearing("r2")]}));
    assert_eq!(solution.status, SolveStatus::Degenerate, "{}", solution.explanation);
    assert!(solution.undetermined[0].contains("position of t along 0°"), "{:?}", solution.undetermined);
    assert!(solution.cures.iter().any(|c| c == "a bearing of t by r3"), "{:?}", solution.cures);
}

#[test]
fn one_way_sightings_alone_do_not_give_a_heading() {
    let mut problem = world().json(true);
    sightings(&mut problem).retain(|s| s["observer"] == "r1");
    problem["bearings"] = json!([]);
    let solution = solved(&problem);
    assert_ne!(solution.status, SolveStatus::Converged, "{solution:?}");
    assert!(solution.robots.iter().all(|r| r.id == "r1" || r.covariance.is_none()), "{:?}", solution.robots);
}
