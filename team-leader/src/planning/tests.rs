use serde_json::json;

use super::*;
use crate::golden::golden;

/// Robot 1 in the origin, robot 2 to be placed, 1 px on 1080 columns.
fn problem(targets: &[[f64; 2]]) -> PlanProblem {
    let targets: Vec<_> =
        targets.iter().enumerate().map(|(k, t)| json!({"id": format!("t{k}"), "x_m": t[0], "y_m": t[1]})).collect();
    let input = json!({"robots": [{"id": "r1", "x_m": 0, "y_m": 0}, {"id": "r2", "x_m": 0.5, "y_m": 0.9}],
        "targets": targets, "sigma_deg": 360.0 / 1080.0});
    PlanProblem::parse(&input.to_string()).unwrap()
}

fn number(value: &serde_json::Value) -> f64 {
    value.as_f64().unwrap()
}

#[test]
fn the_expected_covariance_of_a_target_is_the_golden_one() {
    let group = golden("view.cov");
    let at = |key: &str| [0, 1].map(|k| number(&group["inputs"][key][k]));
    let found = expected(&problem(&[at("T")]), &[[0.0, 0.0], at("p2")]).unwrap()[0];
    for (r, c) in [(0, 0), (0, 1), (1, 1)] {
        let golden = number(&group["outputs"][r][c]);
        assert!((found[(r, c)] / golden - 1.0).abs() < 1e-7, "{found} {golden}");
    }
}

#[test]
fn the_best_place_for_one_target_is_the_golden_one() {
    // Nearer than half a metre nobody goes to a target, as the best place for one at 1 m would be.
    for case in golden("view.free")["outputs"].as_array().unwrap().iter().skip(1).take(5) {
        let d1 = number(&case["D1"]);
        let best = plan(&problem(&[[d1, 0.0]])).unwrap();
        let (value, golden) = (best.error_there_m, number(&case["trace"]["value"]));
        assert!((value / golden - 1.0).abs() < 1e-4, "D1 {d1}: {value} {golden}");
        let b = best.robots[1].x_m.hypot(best.robots[1].y_m);
        // The optimum is flat, so the place is less exact than the value.
        assert!((b / number(&case["trace"]["B"]) - 1.0).abs() < 5e-3, "D1 {d1}: {b}");
    }
}

#[test]
fn the_best_place_for_three_targets_is_the_golden_one() {
    let group = golden("view.multi");
    let targets: Vec<[f64; 2]> = (0..3).map(|t| [0, 1].map(|k| number(&group["inputs"]["targets"][t][k]))).collect();
    let mut problem = problem(&targets);
    problem.robots[1].pose = protocol::frames::Pose2::new(-0.9, -0.9, 0.0);
    let best = plan(&problem).unwrap();
    let sum = 3.0 * best.error_there_m.powi(2);
    assert!((sum / number(&group["outputs"]["sum_trace"]) - 1.0).abs() < 1e-4, "{sum}");
    let [x, y] = [0, 1].map(|k| number(&group["outputs"]["p2"][k]));
    assert!((best.robots[1].x_m - x).hypot(best.robots[1].y_m - y) < 0.01, "{:?}", best.robots[1]);
    assert!(best.error_here_m.unwrap() > best.error_there_m);
}

#[test]
fn nobody_is_sent_where_he_may_not_be_or_sees_nothing() {
    let mut walled = problem(&[[3.0, 0.0]]);
    let free = plan(&walled).unwrap();
    let [x, y] = [free.robots[1].x_m, free.robots[1].y_m];
    walled.obstacles.push(input::Box2 { x_m: [x - 0.3, x + 0.3], y_m: [y - 0.3, y + 0.3] });
    let round = plan(&walled).unwrap();
    let [u, v] = [round.robots[1].x_m, round.robots[1].y_m];
    assert!((u - x).abs().max((v - y).abs()) > 0.3 + 0.2 - 1e-9, "{u} {v} beside {x} {y}");
    assert!(walled.line_is_free([u, v], [3.0, 0.0]) && walled.line_is_free([u, v], [0.0, 0.0]));
    // The mirror image of the free optimum may be as good.
    assert!(round.error_there_m > free.error_there_m * (1.0 - 1e-6));
    walled.area = Some(input::Box2 { x_m: [-0.2, 0.2], y_m: [-0.2, 0.2] });
    assert_eq!(plan(&walled), None);
}

#[test]
fn robots_that_hide_the_target_from_each_other_all_find_a_place() {
    let robots: Vec<_> = (1..=4).map(|k| json!({"id": format!("r{k}"), "x_m": k, "y_m": 0})).collect();
    let input = json!({"robots": robots, "targets": [{"id": "t", "x_m": 5.5, "y_m": 0}], "sigma_deg": 0.3});
    let problem = PlanProblem::parse(&input.to_string()).unwrap();
    let here: Vec<[f64; 2]> = (1..=4).map(|k| [f64::from(k), 0.0]).collect();
    assert!((1..3).all(|r| faults(&problem, &here, r) > 0));
    let found = plan(&problem).unwrap();
    assert_eq!(found.error_here_m, None);
    let there: Vec<[f64; 2]> = found.robots.iter().map(|r| [r.x_m, r.y_m]).collect();
    assert!((1..4).all(|r| faults(&problem, &there, r) == 0), "{there:?}");
}

#[test]
fn wrong_values_are_named() {
    let error = |input: serde_json::Value| PlanProblem::parse(&input.to_string()).unwrap_err().to_string();
    let robot = json!({"id": "r1", "x_m": 0, "y_m": 0});
    assert!(error(json!({"robots": [robot], "targets": []})).contains("robots is 1 robots"));
    let twice = error(json!({"robots": [robot, robot], "targets": [{"id": "t", "x_m": 1, "y_m": 1}]}));
    assert!(twice.contains("r1") && twice.contains("twice"), "{twice}");
    let with = |key: &str, thing: serde_json::Value| {
        let mut input = json!({"robots": [robot, {"id": "r2", "x_m": 2, "y_m": 0}],
            "targets": [{"id": "t", "x_m": 1, "y_m": 1}]});
        input[key] = thing;
        error(input)
    };
    // Each would be free space, silently.
    let reversed = with("obstacles", json!([{"x_m": [0, 1], "y_m": [0, 1]}, {"x_m": [0, 1], "y_m": [1.5, 1]}]));
    assert_eq!(reversed, "obstacles[1].y_m is [1.5, 1]; two finite numbers, the lower one first would be right");
    let outside_in = with("area", json!({"x_m": [4, -4], "y_m": [-3, 3]}));
    assert!(outside_in.contains("area.x_m is [4, -4]"), "{outside_in}");
    let thin = json!({"id": "r2", "x_m": 2, "y_m": 0, "marker": {"kind": "cylinder", "radius_m": -0.2}});
    let thin = with("robots", json!([robot, thin]));
    assert!(thin.contains("robots[1].marker") && thin.contains("radius_m is -0.2; legal is more than 0"), "{thin}");
}
