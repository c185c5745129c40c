//! Lines of a sequence: what is wrong is named with its line, what is not used is said.

use serde_json::{Value, json};

use super::sequence::Sequence;
use super::{look, world};

fn line(time_s: f64) -> Value {
    let mut line = world().json(true);
    line["time_s"] = json!(time_s);
    line
}

fn fed(lines: &[Value]) -> (Sequence, Result<crate::team_map::json::MapJson, String>) {
    let mut sequence = Sequence::new();
    let mut last = Err("no line".to_owned());
    for line in lines {
        last = sequence.line(&line.to_string()).map_err(|e| e.to_string());
    }
    (sequence, last)
}

fn refused(lines: &[Value]) -> String {
    fed(lines).1.unwrap_err()
}

#[test]
fn time_that_goes_back_is_an_error_with_both_times() {
    let error = refused(&[line(4.0), line(3.5)]);
    assert!(error.contains("line 2: time_s is 3.5; 4 (the time of the line before) or later"), "{error}");
    let again = refused(&[line(4.0), line(4.0)]);
    assert!(again.contains("line 2") && again.contains("r1 has measured at this time"), "{again}");
}

#[test]
fn odometry_of_nobody_and_values_that_cannot_be_are_refused() {
    let with = |odometry: Value| {
        let mut second = line(0.1);
        second["odometry"] = odometry;
        refused(&[line(0.0), second])
    };
    let step = |robot: &str| json!({"robot": robot, "dx_m": 0.1, "dy_m": 0, "dheading_deg": 0});
    let nobody = with(json!([step("r1"), step("r9")]));
    assert!(nobody.contains("line 2: odometry[1].robot: \"r9\" is not among `robots`"), "{nobody}");
    assert!(with(json!([step("r1"), step("r1")])).contains("odometry of robot \"r1\" stands there twice"));
    let mut negative = step("r1");
    negative["covariance"] = json!([[-1, 0, 0], [0, 1, 0], [0, 0, 1]]);
    let negative = with(json!([negative]));
    assert!(negative.contains("odometry[0].covariance") && negative.contains("symmetric"), "{negative}");
    let mut biased = line(0.0);
    biased["robots"][1]["bearing_bias_sigma_deg"] = json!(1);
    let biased = refused(&[biased]);
    assert!(biased.contains("line 1: robots[r2].bearing_bias_sigma_deg"), "{biased}");
}

#[test]
fn robots_are_placed_by_lines_that_come_seldom() {
    let lines: Vec<Value> = (0..6).map(|k| line(2.4 * f64::from(k))).collect();
    let map = fed(&lines).1.unwrap();
    assert_eq!(map.status, "converged", "{}", map.explanation);
    assert!(map.robots.iter().all(|r| r.x_m.is_some()));
}

#[test]
fn a_robot_that_comes_in_a_later_line_is_placed() {
    let full = line(0.0);
    let mut lines = Vec::new();
    for k in 0..30 {
        let mut now = line(0.1 * f64::from(k));
        if k < 10 {
            let without = |list: &Value| -> Vec<Value> {
                let is_other = |v: &&Value| ["id", "observer", "peer"].iter().all(|key| v[*key] != "r3");
                list.as_array().unwrap().iter().filter(is_other).cloned().collect()
            };
            for key in ["robots", "sightings", "bearings"] {
                now[key] = json!(without(&now[key]));
            }
        } else if k == 10 {
            // The others stay as they are.
            now["robots"] = json!([full["robots"][2]]);
        }
        if k != 0 && k != 10 {
            now.as_object_mut().unwrap().remove("robots");
        }
        lines.push(now);
    }
    let (mut sequence, last) = fed(&lines);
    let map = last.unwrap();
    assert_eq!((map.status.as_str(), map.robots.len()), ("converged", 3), "{}", map.explanation);
    let r3 = map.robots.iter().find(|r| r.id == "r3").unwrap();
    assert!((r3.x_m.unwrap() - 1.2).hypot(r3.y_m.unwrap() - 2.2) < 0.05, "{r3:?}");
    assert!(sequence.take_notices().is_empty());
}

#[test]
fn bars_and_plates_are_bearings_with_ranges() {
    // r2 at (2, 1) turned to 210°, seen by r1 and seeing it.
    let pose = [2.0, 1.0, 210.0f64];
    let (turn, body) = (pose[2].to_radians(), |x: f64, y: f64, turn: f64| {
        [pose[0] + turn.cos() * x - turn.sin() * y, pose[1] + turn.sin() * x + turn.cos() * y]
    });
    let bars: Vec<Value> = [-30.0f64, 0.0, 30.0]
        .iter()
        .enumerate()
        .map(|(k, azimuth)| {
            let (sin, cos) = azimuth.to_radians().sin_cos();
            let bearing = look([0.0; 3], body(0.2 * cos, 0.2 * sin, turn)).0;
            json!({"part": "bar", "index": k, "bearing_deg": bearing, "sigma_deg": 0.02})
        })
        .collect();
    let edges: Vec<Value> = [0.3, -0.1]
        .iter()
        .enumerate()
        .map(|(k, y)| {
            let (bearing, range) = look([0.0; 3], body(0.1, *y, turn));
            let ends = [0.2f64, 0.5].map(|z| (z - 0.6).atan2(range).to_degrees());
            json!({"part": "edge", "index": k, "bearing_deg": bearing, "sigma_deg": 0.02, "elevation_deg": ends})
        })
        .collect();
    let worn_bars = json!({"kind": "bars", "radius_m": 0.2, "azimuths_deg": [-30, 0, 30], "height_m": [0.1, 0.5]});
    let worn_plate = json!({"kind": "rectangle", "width_m": 0.4, "height_m": 0.3, "left_edge_m": 0.1, "behind_m": 0.1, "bottom_m": 0.2});
    for (marker, features) in [(worn_bars, bars), (worn_plate, edges)] {
        let back = look(pose, [0.0, 0.0]).0;
        let lines: Vec<Value> = (0..20)
            .map(|k| {
                json!({"time_s": 0.1 * f64::from(k), "robots": [{"id": "r1"}, {"id": "r2", "marker": marker}],
                    "sightings": [{"observer": "r1", "peer": "r2", "features": features},
                                  {"observer": "r2", "peer": "r1", "bearing_deg": back, "bearing_sigma_deg": 0.02}]})
            })
            .collect();
        let (mut sequence, last) = fed(&lines);
        let map = last.unwrap();
        let r2 = map.robots.iter().find(|r| r.id == "r2").unwrap();
        let (x, y) = (r2.x_m.unwrap(), r2.y_m.unwrap());
        assert!((x - 2.0).hypot(y - 1.0) < 0.06, "{}: {x} {y}, {}", marker["kind"], map.explanation);
        assert!(sequence.take_notices().is_empty());
    }
}

#[test]
fn what_a_sequence_does_not_use_is_said_once_with_its_line() {
    let mut first = line(0.0);
    first["sightings"][0]["heading_deg"] = json!(120);
    first["sightings"][0]["heading_sigma_deg"] = json!(1);
    let mut second = first.clone();
    second["time_s"] = json!(0.1);
    second["landmarks"] = json!([{"id": "a", "x_m": 1.5, "y_m": 1.2}]);
    let (mut sequence, last) = fed(&[first, second]);
    last.unwrap();
    let notices = sequence.take_notices();
    assert_eq!(notices.len(), 2, "{notices:?}");
    assert!(notices[0].starts_with("line 1: `heading_deg`") && notices[1].starts_with("line 2: `landmarks`"));
}
