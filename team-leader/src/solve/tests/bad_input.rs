//! What is wrong in the world or in the file: the status says so, and nothing wrong is said with confidence.

use nalgebra::{Matrix3, Vector3};
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
    // Only where it is along the line is open: how sure the robots are is known.
    assert!(
        solution.robots.iter().all(|r| r.covariance.is_some_and(|c| c[0][0] < 0.02 * 0.02)),
        "{:?}",
        solution.robots
    );
    assert_eq!(solution.targets[0].covariance, None);
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

/// Two robots that see each other's outlines have one number more than they need: if one of the four is wrong, each may be. Whichever
/// it is, the truth is within what is stated (95 %); one that settles on a culprit made a NEES of 160 to 1,758.
#[test]
fn an_outline_of_two_robots_that_is_wrong_leaves_the_truth_within_the_covariance() {
    let (truth, sigma_deg) = ([3.0_f64, 0.4, 150.0_f64], 0.02);
    let range = truth[0].hypot(truth[1]);
    let (there, half) = (truth[1].atan2(truth[0]).to_degrees(), f64::asin(0.2 / range).to_degrees());
    for (wrong, off_sigmas) in (0..4).flat_map(|k| [-40.0, -8.0, 8.0, 40.0].map(|off| (k, off))) {
        let outline = |robot: usize, side: usize, centre: f64| {
            let off = if wrong == 2 * robot + side { off_sigmas * sigma_deg } else { 0.0 };
            centre + if side == 0 { -half } else { half } + off
        };
        let sighting = |robot: usize, names: [&str; 2], centre: f64| {
            let edges = [outline(robot, 0, centre), outline(robot, 1, centre)];
            json!({"observer": names[0], "peer": names[1], "features_deg": edges, "feature_sigma_deg": sigma_deg})
        };
        let robot = |id: &str| json!({"id": id, "marker": {"kind": "cylinder", "radius_m": 0.2}});
        let problem = json!({
            "robots": [robot("r1"), robot("r2")],
            "sightings": [sighting(0, ["r1", "r2"], there), sighting(1, ["r2", "r1"], there + 180.0 - truth[2])],
        });
        let solution = solved(&problem);
        let r2 = solution.robots.iter().find(|r| r.id == "r2").unwrap();
        let covariance = Matrix3::from_fn(|r, c| r2.covariance.unwrap()[r][c]);
        let turn = protocol::angle::wrap((r2.heading_deg - truth[2]).to_radians());
        let off = Vector3::new(r2.x_m - truth[0], r2.y_m - truth[1], turn);
        let nees = off.dot(&covariance.cholesky().unwrap().solve(&off));
        assert!(nees < 7.8, "{wrong} off by {off_sigmas} sigmas: {nees:.1}, {off:?}");
    }
}
