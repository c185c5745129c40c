//! What files may say of sightings: the output of `peers` goes in as it is, and nothing that does not fit is lost silently.

use serde_json::{Value, json};

use super::{Problem, SolveStatus, solved};

/// A line of `robot-agent peers` each of r1 and r2: r2 stands at (3.1, 0.4), 120°.
const PEERS: [&str; 2] = [
    r#"{"frame":0,"peers":[{"bearing_deg":7.35237935989236,"bearing_sigma_deg":0.035,"confidence":0.97,"features":[{"bearing_deg":3.68376435776593,"elevation_deg":[-9.698115374528696,-1.9575993609722329],"elevation_sigma_deg":0.02,"index":null,"part":"right","sigma_deg":0.05},{"bearing_deg":11.02099436201879,"elevation_deg":null,"elevation_sigma_deg":null,"index":null,"part":"left","sigma_deg":0.05}],"heading_deg":null,"heading_sigma_deg":null,"marker":"cylinder","range_m":3.12,"range_sigma_m":0.03,"robot":null}],"time_s":0.0}"#,
    r#"{"frame":0,"peers":[{"bearing_deg":67.35237935989236,"bearing_sigma_deg":0.035,"confidence":0.97,"features":[{"bearing_deg":63.683764357765924,"elevation_deg":[-9.698115374528696,-1.9575993609722329],"elevation_sigma_deg":0.02,"index":null,"part":"right","sigma_deg":0.05},{"bearing_deg":71.02099436201878,"elevation_deg":null,"elevation_sigma_deg":null,"index":null,"part":"left","sigma_deg":0.05}],"heading_deg":null,"heading_sigma_deg":null,"marker":"cylinder","range_m":3.12,"range_sigma_m":0.03,"robot":"r1"}],"time_s":0.0}"#,
];

fn pasted() -> Value {
    let peer = |k: usize| serde_json::from_str::<Value>(PEERS[k]).unwrap()["peers"][0].clone();
    let (mut first, mut second) = (peer(0), peer(1));
    (first["observer"], first["peer"], second["observer"]) = (json!("r1"), json!("r2"), json!("r2"));
    json!({"robots": [{"id": "r1"}, {"id": "r2"}], "sightings": [first, second]})
}

#[test]
fn what_peers_prints_is_a_sighting_once_it_says_whose() {
    let solution = solved(&pasted());
    assert_eq!(solution.status, SolveStatus::Converged, "{}", solution.explanation);
    assert!(solution.warnings.is_empty(), "{:?}", solution.warnings);
    let r2 = &solution.robots[1];
    assert!((r2.x_m - 3.1).hypot(r2.y_m - 0.4) < 1e-5 && (r2.heading_deg - 120.0).abs() < 1e-3, "{r2:?}");
    // Two outlines and two ends each way, for three unknowns.
    assert_eq!(solution.dof, 8 - 3);
}

#[test]
fn ends_count_by_their_own_sigma() {
    let along = |sigma_deg: f64| {
        let mut problem = pasted();
        for sighting in problem["sightings"].as_array_mut().unwrap() {
            sighting["features"][0]["elevation_sigma_deg"] = json!(sigma_deg);
        }
        solved(&problem).robots[1].covariance.unwrap()[0][0].sqrt()
    };
    // As sure as the outlines; a guess.
    let (sharp, blunt) = (along(0.001), along(30.0));
    assert!(sharp < 0.1 * blunt && blunt < 0.05, "{sharp} {blunt}");
}

fn refused(problem: &Value) -> String {
    Problem::parse(&problem.to_string()).unwrap_err().to_string()
}

/// r1 sees r2, who wears `marker`, by `features` alone.
fn seen(marker: &Value, features: &Value) -> Value {
    json!({"robots": [{"id": "r1"}, {"id": "r2", "marker": marker}],
        "sightings": [{"observer": "r2", "peer": "r1", "bearing_deg": 10, "bearing_sigma_deg": 0.1, "range_m": 2, "range_sigma_m": 0.1},
                      {"observer": "r1", "peer": "r2", "features": features}]})
}

#[test]
fn features_that_the_peers_marker_does_not_have_are_refused_by_number() {
    let cylinder = json!({"kind": "cylinder", "radius_m": 0.2});
    let bars = json!({"kind": "bars", "radius_m": 0.2, "azimuths_deg": [0, 90, 180], "height_m": [0.1, 0.5]});
    let plate = json!({"kind": "rectangle", "width_m": 0.4, "height_m": 0.3, "left_edge_m": 0.2, "behind_m": 0.1, "bottom_m": 0.2});
    let edge = json!([{"part": "edge", "index": 0, "bearing_deg": 1, "sigma_deg": 0.1}]);
    let error = refused(&seen(&cylinder, &edge));
    assert!(error.contains("sightings[1].features[0].part is edge 0; \"left\" or \"right\""), "{error}");
    assert!(error.contains("r2 wears a marker of kind cylinder"), "{error}");
    let bar = json!([{"part": "bar", "index": 2, "bearing_deg": 1, "sigma_deg": 0.1},
                     {"part": "bar", "index": 3, "bearing_deg": 1, "sigma_deg": 0.1}]);
    let error = refused(&seen(&bars, &bar));
    assert!(error.contains("sightings[1].features[1].part is bar 3") && error.contains("index up to 2"), "{error}");
    let mut short = seen(&plate, &json!([]));
    (short["sightings"][1]["features_deg"], short["sightings"][1]["feature_sigma_deg"]) = (json!([1, 2]), json!(0.1));
    let error = refused(&short);
    assert!(error.contains("sightings[1].features_deg") && error.contains("\"edge\""), "{error}");
}

#[test]
fn a_bearing_beside_features_that_do_not_fit_is_used_and_that_is_said() {
    let cylinder = json!({"kind": "cylinder", "radius_m": 0.2});
    let mut problem = seen(&cylinder, &json!([{"part": "edge", "index": 0, "bearing_deg": 1, "sigma_deg": 0.1}]));
    for (key, value) in [("bearing_deg", 30.0), ("bearing_sigma_deg", 0.1), ("range_m", 2.0), ("range_sigma_m", 0.1)] {
        problem["sightings"][1][key] = json!(value);
    }
    let solution = solved(&problem);
    assert_eq!(solution.status, SolveStatus::Converged, "{}", solution.explanation);
    let r2 = &solution.robots[1];
    assert!((r2.y_m.atan2(r2.x_m).to_degrees() - 30.0).abs() < 1e-3, "{r2:?}");
    let [said] = &solution.warnings[..] else { panic!("{:?}", solution.warnings) };
    assert!(
        said.contains("sightings[1]: r1 sees r2") && said.contains("edge 0") && said.contains("its bearing is used"),
        "{said}"
    );
}

#[test]
fn a_marker_that_nobody_wears_and_a_peer_who_is_two_are_refused() {
    let error = |key: &str, value: &str| {
        let mut problem = pasted();
        problem["sightings"][0][key] = json!(value);
        refused(&problem)
    };
    let other = error("marker", "bars");
    assert!(other.contains("sightings[0].marker is \"bars\"; \"cylinder\", which r2 wears"), "{other}");
    let unknown = error("marker", "cone");
    assert!(unknown.contains("\"cone\"; one of cylinder, bars, rectangle"), "{unknown}");
    let two = error("robot", "r1");
    assert!(two.contains("sightings[0].robot is \"r1\"; \"r2\", as `peer` says"), "{two}");
    let mut unnamed = pasted();
    (unnamed["sightings"][0]["peer"], unnamed["sightings"][0]["marker"]) = (Value::Null, json!("rectangle"));
    assert!(refused(&unnamed).contains("that one of the other robots wears"), "{}", refused(&unnamed));
}

#[test]
fn one_problem_has_no_odometry_and_a_heading_without_sigma_is_said_to_be_left_out() {
    let with = |key: &str, value: Value| {
        let mut problem = pasted();
        problem[key] = value;
        refused(&problem)
    };
    let odometry = with("odometry", json!([{"robot": "r1", "dx_m": 1, "dy_m": 0, "dheading_deg": 0}]));
    assert!(odometry.contains("odometry is given 1 times") && odometry.contains("moved_from"), "{odometry}");
    let mut heading = pasted();
    heading["sightings"][0]["heading_deg"] = json!(120);
    heading["time_s"] = json!(3);
    let warnings = solved(&heading).warnings;
    assert!(warnings.iter().any(|w| w.contains("sightings[0]") && w.contains("heading_sigma_deg")), "{warnings:?}");
}
