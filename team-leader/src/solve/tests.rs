use serde_json::{Value, json};

use super::*;

mod bad_input;
mod files;
mod lines;
mod over_time;
mod places;

/// Robots at true poses; numbers straight from atan2 and asin.
struct World {
    robots: Vec<(&'static str, [f64; 3])>,
    targets: Vec<(&'static str, [f64; 3])>,
}

fn world() -> World {
    World {
        robots: vec![("r1", [0.0, 0.0, 0.0]), ("r2", [3.1, 0.4, 120.0]), ("r3", [1.2, 2.2, -75.0])],
        targets: vec![("a", [1.5, 1.2, 1.1]), ("b", [-0.8, 1.9, 0.9]), ("c", [2.6, 2.9, 1.0])],
    }
}

fn look(from: [f64; 3], to: [f64; 2]) -> (f64, f64) {
    let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
    (dy.atan2(dx).to_degrees() - from[2], dx.hypot(dy))
}

impl World {
    fn json(&self, named: bool) -> Value {
        let mut sightings = Vec::new();
        let mut bearings = Vec::new();
        for (id, pose) in &self.robots {
            for (other, at) in self.robots.iter().filter(|(o, _)| o != id) {
                let (bearing, range) = look(*pose, [at[0], at[1]]);
                sightings.push(json!({"observer": id, "peer": if named { json!(other) } else { Value::Null },
                    "bearing_deg": bearing, "bearing_sigma_deg": 0.05, "range_m": range, "range_sigma_m": 0.02}));
            }
            for (target, at) in &self.targets {
                let (bearing, range) = look(*pose, [at[0], at[1]]);
                let elevation = (at[2] - 0.6).atan2(range).to_degrees();
                bearings.push(json!({"observer": id, "target": if named { json!(target) } else { Value::Null },
                    "bearing_deg": bearing, "bearing_sigma_deg": 0.1,
                    "elevation_deg": elevation, "elevation_sigma_deg": 0.1}));
            }
        }
        let robots: Vec<Value> = self
            .robots
            .iter()
            .map(|(id, _)| json!({"id": id, "camera_height_m": 0.6, "marker": {"kind": "cylinder", "radius_m": 0.2}}))
            .collect();
        json!({"anchor": "r1", "robots": robots, "sightings": sightings, "bearings": bearings})
    }
}

fn solved(problem: &Value) -> Solution {
    solve(Problem::parse(&problem.to_string()).unwrap())
}

fn assert_true(solution: &Solution, world: &World, tolerance: f64) {
    assert_eq!(solution.robots.len(), world.robots.len());
    for robot in &solution.robots {
        let (_, truth) = world.robots.iter().find(|(id, _)| *id == robot.id).unwrap();
        let turn = protocol::angle::wrap((robot.heading_deg - truth[2]).to_radians());
        assert!((robot.x_m - truth[0]).hypot(robot.y_m - truth[1]) < tolerance && turn.abs() < tolerance, "{robot:?}");
    }
    assert_eq!(solution.targets.len(), world.targets.len());
    for (_, truth) in &world.targets {
        let near = solution
            .targets
            .iter()
            .any(|t| (t.x_m - truth[0]).hypot(t.y_m - truth[1]).hypot(t.z_m.unwrap() - truth[2]) < tolerance);
        assert!(near, "nothing at {truth:?}: {:?}", solution.targets);
    }
}

#[test]
fn exact_measurements_give_the_exact_layout_by_both_methods() {
    let world = world();
    let joint = solved(&world.json(true));
    assert_eq!(joint.status, SolveStatus::Converged, "{}", joint.explanation);
    assert_true(&joint, &world, 1e-6);
    assert_eq!(joint.dof, 12 + 18 - 6 - 9);
    let closed = closed_form::solve(Problem::parse(&world.json(true).to_string()).unwrap());
    assert_eq!(closed.status, SolveStatus::Converged);
    assert_true(&closed, &world, 1e-6);
}

#[test]
fn names_of_robots_and_targets_are_found_when_none_is_given() {
    let world = world();
    let solution = solved(&world.json(false));
    assert_eq!(solution.status, SolveStatus::Converged, "{}", solution.explanation);
    assert_true(&solution, &world, 1e-6);
}

#[test]
fn a_symmetric_layout_without_names_is_ambiguous() {
    let h = 1.5 * 3f64.sqrt();
    let world = World {
        robots: vec![("r1", [0.0, 0.0, 10.0]), ("r2", [3.0, 0.0, 130.0]), ("r3", [1.5, h, -70.0])],
        targets: vec![],
    };
    assert_eq!(solved(&world.json(false)).status, SolveStatus::Ambiguous);
    assert_eq!(solved(&world.json(true)).status, SolveStatus::Converged);
}

#[test]
fn a_wrong_range_is_inconsistent_and_named() {
    let mut problem = world().json(true);
    problem["sightings"][0]["range_m"] = json!(4.5);
    let solution = solved(&problem);
    assert_eq!(solution.status, SolveStatus::Inconsistent);
    assert!(solution.explanation.contains("range of r2 from r1"), "{}", solution.explanation);
}

#[test]
fn without_any_range_the_scale_is_the_undetermined_direction() {
    let mut problem = world().json(true);
    for s in problem["sightings"].as_array_mut().unwrap() {
        s.as_object_mut().unwrap().retain(|k, _| !k.starts_with("range"));
    }
    for b in problem["bearings"].as_array_mut().unwrap() {
        b.as_object_mut().unwrap().retain(|k, _| !k.starts_with("elevation"));
    }
    let solution = solved(&problem);
    assert_eq!(solution.status, SolveStatus::Degenerate, "{solution:?}");
    assert!(solution.weakest_direction.contains("scale"), "{}", solution.weakest_direction);
    assert!(solution.robots.iter().all(|r| r.covariance.is_none()));
}

#[test]
fn a_robot_that_nothing_ties_is_insufficient() {
    let mut problem = world().json(true);
    problem["robots"].as_array_mut().unwrap().push(json!({"id": "r9"}));
    let solution = solved(&problem);
    assert_eq!(solution.status, SolveStatus::Insufficient);
    assert!(solution.explanation.contains("r9"));
    assert_eq!(solution.robots.len(), 3);
}

#[test]
fn tangents_and_heights_of_a_cylinder_are_the_measurement() {
    let world = world();
    let mut problem = world.json(true);
    for (k, s) in problem["sightings"].as_array_mut().unwrap().iter_mut().enumerate() {
        let range = s["range_m"].as_f64().unwrap();
        let bearing = s["bearing_deg"].as_f64().unwrap();
        let half = (0.2 / range).asin().to_degrees();
        let o = s.as_object_mut().unwrap();
        o.retain(|key, _| key == "observer" || key == "peer");
        if k % 2 == 0 {
            o.insert("features_deg".into(), json!([bearing - half, bearing + half]));
            o.insert("feature_sigma_deg".into(), json!(0.05));
        } else {
            let e = |z: f64| ((z - 0.6) / (range - 0.2)).atan().to_degrees();
            let ends = json!([e(0.1), e(0.5)]);
            o.insert(
                "features".into(),
                json!([{"part": "right", "bearing_deg": bearing - half, "sigma_deg": 0.05, "elevation_deg": ends},
                       {"part": "left", "bearing_deg": bearing + half, "sigma_deg": 0.05, "elevation_deg": ends}]),
            );
        }
    }
    let solution = solved(&problem);
    assert_eq!(solution.status, SolveStatus::Converged, "{}", solution.explanation);
    assert_true(&solution, &world, 1e-6);
}

#[test]
fn bars_and_plates_tell_the_heading_without_being_seen_back() {
    let (bearing_of, r2) = (look, [2.0, 1.0, 40.0f64]);
    let body = |x: f64, y: f64| {
        let (s, c) = r2[2].to_radians().sin_cos();
        [r2[0] + c * x - s * y, r2[1] + s * x + c * y]
    };
    let features: Vec<Value> = [150.0f64, 190.0, 230.0]
        .iter()
        .enumerate()
        .map(|(k, a)| {
            let (s, c) = a.to_radians().sin_cos();
            let (bearing, _) = bearing_of([0.0; 3], body(0.2 * c, 0.2 * s));
            json!({"part": "bar", "index": k, "bearing_deg": bearing, "sigma_deg": 0.05})
        })
        .collect();
    let problem = json!({"robots": [{"id": "r1"}, {"id": "r2",
        "marker": {"kind": "bars", "radius_m": 0.2, "azimuths_deg": [150, 190, 230], "height_m": [0.1, 0.5]}}],
        "sightings": [{"observer": "r1", "peer": "r2", "features": features}], "bearings": []});
    let solution = solved(&problem);
    assert_eq!(solution.status, SolveStatus::Converged, "{}", solution.explanation);
    let found = &solution.robots[1];
    assert!((found.x_m - 2.0).hypot(found.y_m - 1.0) < 1e-6 && (found.heading_deg - 40.0).abs() < 1e-4, "{found:?}");
}

#[test]
fn a_robot_finds_itself_among_landmarks() {
    let truth = [1.3, 0.7, 33.0];
    let marks = [("m1", [0.0, 4.0]), ("m2", [5.0, 3.0]), ("m3", [4.0, -2.0]), ("m4", [-2.0, -1.0])];
    let problem = json!({"robots": [{"id": "r1"}], "sightings": [],
        "landmarks": marks.iter().map(|(id, p)| json!({"id": id, "x_m": p[0], "y_m": p[1]})).collect::<Vec<_>>(),
        "bearings": marks.iter().map(|(id, p)| json!({"observer": "r1", "target": id,
            "bearing_deg": look(truth, *p).0, "bearing_sigma_deg": 0.1})).collect::<Vec<_>>()});
    let solution = solved(&problem);
    assert_eq!(solution.status, SolveStatus::Converged, "{}", solution.explanation);
    let found = &solution.robots[0];
    assert!((found.x_m - 1.3).hypot(found.y_m - 0.7) < 1e-6 && (found.heading_deg - 33.0).abs() < 1e-4);
}

#[test]
fn rays_without_elevation_that_could_be_of_several_targets_are_left_open() {
    let world = World {
        robots: vec![("r1", [0.0, 0.0, 0.0]), ("r2", [3.0, 0.0, 90.0])],
        targets: vec![("a", [1.0, 2.0, 1.0]), ("b", [2.0, 2.5, 1.0])],
    };
    let mut problem = world.json(false);
    for b in problem["bearings"].as_array_mut().unwrap() {
        b.as_object_mut().unwrap().retain(|k, _| !k.starts_with("elevation"));
    }
    let solution = solved(&problem);
    assert_eq!(solution.status, SolveStatus::Ambiguous);
    assert!(solution.targets.is_empty());
}

#[test]
fn wrong_values_are_named() {
    let world = world();
    let error = |change: &dyn Fn(&mut Value)| {
        let mut problem = world.json(true);
        change(&mut problem);
        Problem::parse(&problem.to_string()).unwrap_err().to_string()
    };
    let unknown = error(&|p| p["sightings"][1]["observer"] = json!("r7"));
    assert!(unknown.contains("sightings[1].observer") && unknown.contains("r7"), "{unknown}");
    let negative = error(&|p| p["bearings"][2]["bearing_sigma_deg"] = json!(-0.1));
    assert!(negative.contains("bearings[2].bearing_sigma_deg") && negative.contains("-0.1"), "{negative}");
    let twice = error(&|p| p["robots"][1]["id"] = json!("r1"));
    assert!(twice.contains("r1") && twice.contains("twice"), "{twice}");
    let key = error(&|p| p["robot"] = json!([]));
    assert!(key.contains("robot"), "{key}");
    let nan = Problem::parse(r#"{"robots":[{"id":"r1","camera_height_m":NaN}]}"#).unwrap_err().to_string();
    assert!(nan.contains("line 1"), "{nan}");
}

#[test]
fn a_sequence_follows_a_robot_that_moves_and_a_target() {
    let mut sequence = sequence::Sequence::new();
    let mut last = None;
    for k in 0..120 {
        let t = f64::from(k) * 0.1;
        let mut world = world();
        let drive = (t - 5.0).clamp(0.0, 3.0);
        world.robots[2].1[0] += 0.3 * drive;
        world.robots[2].1[2] += 10.0 * drive;
        world.targets.truncate(1);
        world.targets[0].1[0] += 0.1 * t;
        let mut line = world.json(true);
        line["time_s"] = json!(t);
        if k > 0 {
            line.as_object_mut().unwrap().remove("robots");
        }
        let map = sequence.line(&line.to_string()).unwrap();
        if k > 30 {
            for robot in &map.robots {
                let (_, truth) = world.robots.iter().find(|(id, _)| *id == robot.id).unwrap();
                let away = (robot.x_m.unwrap() - truth[0]).hypot(robot.y_m.unwrap() - truth[1]);
                assert!(away < 0.1, "t {t}: {} is {away} m away ({})", robot.id, map.status);
            }
            assert_eq!(map.targets.len(), 1, "t {t}");
            let target = &map.targets[0];
            assert!((target.x_m - 1.5 - 0.1 * t).hypot(target.y_m - 1.2) < 0.1, "t {t}: {target:?}");
        }
        last = Some(map);
    }
    assert_eq!(last.unwrap().status, "converged");
    let bad = sequence.line(r#"{"time_s":20,"sightings":[{"observer":"rx"}]}"#).unwrap_err().to_string();
    assert!(bad.contains("line 121") && bad.contains("rx"), "{bad}");
}
