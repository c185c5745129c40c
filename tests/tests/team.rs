//! The whole team in virtual time: what a seed fixes, and what names do not change.

use std::collections::BTreeMap;
use std::path::Path;

use nalgebra::Vector2;
use protocol::frames::Pose2;
use protocol::id::RobotId;
use protocol::message::TeamMap;
use sim_harness::replay::Recording;
use sim_harness::scenario::{EyeSpec, OtherCamera, Scenario};
use sim_harness::team::{Outcome, TeamSettings, output, simulated};

#[test]
fn the_same_seed_gives_the_same_bytes_and_another_seed_others() {
    let scenario = tiny();
    let settings = TeamSettings { duration_s: Some(2.0), ..TeamSettings::default() };
    let files = |seed| {
        let folder = tempfile::tempdir().unwrap();
        let outcome = simulated::run(&scenario, seed, &settings, &|_| {}).unwrap();
        output::write_all(&outcome, &outcome.score(), folder.path()).unwrap();
        bytes(folder.path())
    };
    let (first, again, other) = (files(7), files(7), files(8));
    for name in ["map.jsonl", "truth.jsonl", "scores.json", "observations.jsonl", "map.png", "r1-pal.png"] {
        assert!(first.contains_key(name), "{name} is missing among {:?}", first.keys());
        assert!(first[name] != other[name], "{name} is the same for another seed");
    }
    assert!(first == again);
}

/// All robots are in the last map, no farther off than this.
fn assert_poses_within(run: &Outcome, limit_m: f64) {
    let map = run.maps.last().unwrap();
    let truth = run.world.at(run.true_time_s(map.stamp));
    let room = |n: usize| Pose2::new(truth.robots[n].x_m, truth.robots[n].y_m, truth.robots[n].heading_rad);
    let gauge = map.robots.iter().position(|r| Some(r.id) == map.gauge).unwrap();
    let room_from_team = room(gauge) * map.robots[gauge].team_from_body.unwrap().inverse();
    for (n, robot) in map.robots.iter().enumerate() {
        let off = (room(n).inverse() * room_from_team * robot.team_from_body.unwrap()).position().norm();
        assert!(off < limit_m, "{} is {off} m off", robot.id);
    }
}

#[test]
fn a_fisheye_and_a_mirror_that_see_the_pole_take_part_in_a_team() {
    let mut scenario = tiny();
    scenario.robots.count = 3;
    let zoo = |name: &str| EyeSpec::Zoo { specimen: name.to_owned().try_into().unwrap() };
    scenario.camera.others = [("r2", "fisheye-equidistant"), ("r3", "hyperboloidal")]
        .map(|(robot, name)| OtherCamera { robot: RobotId::new(robot).unwrap(), camera: zoo(name) })
        .into();
    let settings = TeamSettings { duration_s: Some(3.0), ..TeamSettings::default() };
    let run = simulated::run(&scenario, 3, &settings, &|_| {}).unwrap();
    assert_poses_within(&run, 0.02);
}

#[test]
fn a_pinhole_and_a_turning_slit_take_part_in_a_team() {
    let mut scenario = tiny();
    scenario.robots.count = 3;
    scenario.camera.others = ["r2", "r3"]
        .into_iter()
        .zip([
            EyeSpec::Pinhole { image_size_px: [240, 180], field_deg: 60.0 },
            EyeSpec::Rotating { image_size_px: [1080, 114], turn_s: 0.2, elevation_deg: [-15.0, 20.0] },
        ])
        .map(|(robot, camera)| OtherCamera { robot: RobotId::new(robot).unwrap(), camera })
        .collect();
    let settings = TeamSettings { duration_s: Some(5.0), ..TeamSettings::default() };
    let run = simulated::run(&scenario, 3, &settings, &|_| {}).unwrap();
    // A turn takes 0.2 s and 5 s have 25 of them, the last of which is not over.
    let of = |robot: &str| run.observations.iter().filter(|(id, _)| id.as_str() == robot).count();
    assert!((24..=25).contains(&of("r3")) && of("r2") >= 48, "{} {}", of("r2"), of("r3"));
    assert_poses_within(&run, 0.02);
}

#[test]
fn a_replayed_recording_gives_the_maps_and_the_score_of_the_run() {
    let settings = TeamSettings { duration_s: Some(6.0), ..TeamSettings::default() };
    let run = simulated::run(&tiny(), 7, &settings, &|_| {}).unwrap();
    let folder = tempfile::tempdir().unwrap();
    output::write_all(&run, &run.score(), folder.path()).unwrap();
    let replayed = Recording::read(folder.path()).unwrap().replay().unwrap();
    assert!(!run.maps.is_empty() && run.heard == replayed.heard);
    assert_eq!(format!("{:?}", run.maps), format!("{:?}", replayed.maps));
    let figures = |outcome: &Outcome| {
        let scores = outcome.score().scores;
        serde_json::to_string(&(scores.robots, scores.targets)).unwrap()
    };
    assert_eq!(figures(&run), figures(&replayed));
}

#[test]
fn upright_edges_that_robots_see_together_are_where_something_stands() {
    let settings = TeamSettings { duration_s: Some(7.0), ..TeamSettings::default() };
    let run = simulated::run(&Scenario::load(Path::new("default")).unwrap(), 1, &settings, &|_| {}).unwrap();
    let found = run.score().scores.structure;
    assert!(found.edges >= 3 && 4 * found.false_edges <= found.edges, "{found:?}");
    assert!(found.rms_m.is_some_and(|rms| rms < 0.04), "{found:?}");
    let folder = tempfile::tempdir().unwrap();
    output::write_all(&run, &run.score(), folder.path()).unwrap();
    assert_eq!(Recording::read(folder.path()).unwrap().replay().unwrap().edges, run.edges);
}

#[test]
fn a_recording_that_is_none_is_refused_with_file_line_and_reason() {
    let settings = TeamSettings { duration_s: Some(0.5), ..TeamSettings::default() };
    let run = simulated::run(&tiny(), 7, &settings, &|_| {}).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("leader.jsonl");
    sim_harness::replay::write(&run, &path).unwrap();
    let whole = std::fs::read_to_string(&path).unwrap();
    for (text, said) in [
        (String::new(), "empty"),
        ("{}".to_owned(), "line 1"),
        (whole.replacen("\"envelope\":\"", "\"envelope\":\"x", 1), "hexadecimal"),
        (whole.replacen("robot/r1/", "robot/R 1/", 1), "line 2"),
        (whole[..whole.len() - 20].to_owned(), "neither a message nor"),
    ] {
        std::fs::write(&path, text).unwrap();
        let error = Recording::read(folder.path()).unwrap_err().to_string();
        assert!(error.contains("leader.jsonl") && error.contains(said), "{error}");
    }
    let error = Recording::read(&folder.path().join("none.jsonl")).unwrap_err().to_string();
    assert!(error.contains("none.jsonl") && error.contains("--transport simulated"), "{error}");
}

#[test]
fn permuting_the_robots_names_permutes_the_map() {
    // Were a name, an order or a place of the simulation to reach an agent or the leader, this would not hold.
    let mut scenario = tiny();
    scenario.robots.count = 3;
    let run = |names: &[&str]| {
        let names = names.iter().map(|name| RobotId::new(name).unwrap()).collect();
        let settings = TeamSettings { duration_s: Some(3.0), names: Some(names), ..TeamSettings::default() };
        simulated::run(&scenario, 3, &settings, &|_| {}).unwrap()
    };
    let (straight, permuted) = (run(&["a", "b", "c"]), run(&["c", "a", "b"]));
    assert_eq!(straight.maps.len(), permuted.maps.len());
    let mut placed = 0;
    for (one, other) in straight.maps.iter().zip(&permuted.maps) {
        assert_eq!(one.stamp, other.stamp);
        let ([one, their_targets], [other, other_targets]) =
            (seen_from_first(&straight, one), seen_from_first(&permuted, other));
        placed += one.len();
        assert_near(&one, &other);
        assert_near(&their_targets, &other_targets);
    }
    assert!(placed > 0, "no robot was ever placed");
}

/// Robots, in the order of the world, and targets in the frame of the world's first robot, so that neither names nor the
/// choice of the gauge matter: x, y and heading each.
fn seen_from_first(outcome: &Outcome, map: &TeamMap) -> [Vec<[f64; 3]>; 2] {
    let pose = |name: &RobotId| map.robots.iter().find(|r| r.id == *name).and_then(|r| r.team_from_body);
    let Some(first_from_team) = pose(&outcome.names[0]).map(|p: Pose2| p.inverse()) else { return [vec![], vec![]] };
    let robots = outcome.names.iter().filter_map(pose).map(|team_from_body| {
        let seen = first_from_team * team_from_body;
        [seen.x_m, seen.y_m, seen.heading_rad]
    });
    let mut targets: Vec<[f64; 3]> = map
        .targets
        .iter()
        .map(|t| first_from_team.transform(Vector2::new(t.position_m[0], t.position_m[1])))
        .map(|p| [p.x, p.y, 0.0])
        .collect();
    targets.sort_by(|a, b| a[0].total_cmp(&b[0]));
    [robots.collect(), targets]
}

fn assert_near(one: &[[f64; 3]], other: &[[f64; 3]]) {
    assert_eq!(one.len(), other.len());
    for (a, b) in one.iter().zip(other) {
        // Sums over robots are taken in the order of names: rounding only.
        assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6), "{a:?} and {b:?}");
    }
}

fn tiny() -> Scenario {
    Scenario::load(Path::new("tiny")).unwrap()
}

fn bytes(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap());
    entries.map(|e| (e.file_name().into_string().unwrap(), std::fs::read(e.path()).unwrap())).collect()
}
