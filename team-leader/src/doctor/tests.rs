//! A healthy team has no complaints; each trouble is named with its cure.

use protocol::frames::Pose2;
use protocol::marker::Marker;
use protocol::message::map::Trust;
use protocol::message::observation::FeaturePart;
use protocol::message::{CameraSummary, Feature, KindTraffic, MapRobot, Motion, PeerSighting, Stages};
use protocol::quantity::{Angle16, Fraction8, LogSigma};
use protocol::time::Timestamp;

use super::*;

#[test]
fn a_healthy_team_has_no_complaints_and_who_sees_whom_is_known() {
    let diagnosis = diagnose(&healthy());
    assert!(diagnosis.is_fine());
    let complaints: Vec<_> = diagnosis.findings.iter().filter(|f| f.severity > Severity::Fine).collect();
    assert!(complaints.is_empty(), "{complaints:?}");
    let pairs: Vec<_> = diagnosis.sees.iter().map(|s| (s.observer.to_string(), s.peer.unwrap().to_string())).collect();
    assert_eq!(pairs, [("r1".to_owned(), "r2".to_owned()), ("r2".to_owned(), "r1".to_owned())]);
    for sight in &diagnosis.sees {
        assert!((sight.radius_m.unwrap() - 0.2).abs() < 0.002, "{sight:?}");
        assert!(sight.elevation_error_deg.unwrap().abs() < 0.05, "{sight:?}");
    }
}

#[test]
fn each_trouble_is_named_with_its_cure() {
    type Trouble = (fn(&mut Heard), Severity, &'static str, &'static str);
    let troubles: Vec<Trouble> = vec![
        (|h| h.leaders.clear(), Severity::Problem, "no leader", "team-leader run"),
        (|h| h.present.clear(), Severity::Problem, "no robot is there", "[network] connect"),
        (|h| h.map = None, Severity::Warning, "no map", "first observation"),
        (|h| drop(h.announcements.remove(&robot("r1"))), Severity::Problem, "who it is", "version"),
        (|h| drop(h.observations.remove(&robot("r1"))), Severity::Problem, "no observations", "camera"),
        (|h| h.paused.extend([robot("r1")]), Severity::Problem, "paused", "resume"),
        (|h| h.listened_s = 10.0, Severity::Warning, "nominally 10", "budget_ms"),
        (|h| h.version = "0.2.0".to_owned(), Severity::Warning, "beside team-leader 0.2.0", "same version"),
        (|h| announce_again(h), Severity::Problem, "two sessions", "another [robot] id"),
        (|h| health(h).frames_dropped = 100, Severity::Warning, "100 of 1000 frames", "slow"),
        (|h| health(h).frames_bad = 3, Severity::Warning, "3 frames", "camera file"),
        (|h| health(h).messages_dropped = 400, Severity::Warning, "400 messages dropped", "max_bytes_per_s"),
        (|h| health(h).messages_refused = 4, Severity::Warning, "could not be read", "versions"),
        (|h| health(h).latency_ms = [50.0, 900.0], Severity::Warning, "900 ms", "budget_ms"),
        (|h| drop(h.healths.remove(&robot("r1"))), Severity::Warning, "no health", "link"),
        (|h| map_robot(h).clock_offset_s = Some((-3.0, 0.001)), Severity::Warning, "-3000 ms off", "chrony"),
        (|h| map_robot(h).clock_offset_s = Some((0.0, 0.05)), Severity::Warning, "to 50 ms", "link"),
        (|h| map_robot(h).clock_offset_s = None, Severity::Warning, "not been measured", "probes"),
        (|h| map_robot(h).presence = Presence::Offline, Severity::Warning, "offline", "start"),
        (|h| map_robot(h).trust = Trust::SetAside, Severity::Warning, "contradicts the others", "[mounting]"),
        (|h| map_robot(h).team_from_body = None, Severity::Warning, "no place", "sees"),
        (|h| h.map.as_mut().unwrap().status = MapStatus::Inconsistent, Severity::Problem, "contradicts", "radius"),
        (|h| blind(h), Severity::Warning, "sees no fellow", "mask"),
        (|h| set_radius(h, 0.25), Severity::Warning, "looks 0.200 m in radius", "measure the marker"),
        (|h| set_height(h, 0.7), Severity::Warning, "higher than it should", "[mounting]"),
        (|h| picture(h).mean = 12.0, Severity::Warning, "too dark", "longer"),
        (|h| picture(h).clipped = 0.4, Severity::Warning, "40 % of its picture", "[mask]"),
        (|h| picture(h).sharpness = 0.1, Severity::Warning, "blurred", "focus"),
    ];
    for (change, severity, what, cure) in troubles {
        let mut heard = healthy();
        change(&mut heard);
        let findings = diagnose(&heard).findings;
        let found =
            findings.iter().find(|f| f.what.contains(what)).unwrap_or_else(|| panic!("{what:?} not in {findings:#?}"));
        assert_eq!(found.severity, severity, "{found:?}");
        assert!(found.cure.contains(cure), "{found:?}");
    }
}

#[test]
fn figures_of_pictures_tell_sharp_from_blurred_and_dark_from_bright() {
    let fine: Vec<u8> = (0..64 * 64).map(|i| if i % 2 == 0 { 60 } else { 180 }).collect();
    let coarse: Vec<u8> = (0..64 * 64).map(|i| 100 + (i % 64) as u8).collect();
    let [fine, coarse] = [fine, coarse].map(|gray| picture_figures(&gray, 64).unwrap());
    assert!((fine.mean - 120.0).abs() < 1.0 && fine.clipped == 0.0);
    assert!(fine.sharpness > 10.0 * coarse.sharpness);
    assert!((picture_figures(&[255; 90], 9).unwrap().clipped - 1.0).abs() < 1e-9);
    assert_eq!(picture_figures(&[], 0), None);
}

/// Two robots 3 m apart that look at each other, 10 Hz, heard for 4 s.
fn healthy() -> Heard {
    let ids = ["r1", "r2"].map(robot);
    let pose = |x_m, heading_rad| Some(Pose2::new(x_m, 0.0, heading_rad));
    let map_robot = |id, team_from_body| MapRobot {
        id,
        team_from_body,
        component: 0,
        presence: Presence::Online,
        moving: false,
        clock_offset_s: Some((0.01, 0.001)),
        lag_s: None,
        bias_rad: None,
        trust: Trust::Full,
        verifiable: true,
        trouble: None,
        observations_lost: 0,
    };
    Heard {
        team: "blue".parse().unwrap(),
        version: "0.1.0".to_owned(),
        listened_s: 4.0,
        leaders: BTreeSet::from(["l1".parse().unwrap()]),
        present: ids.into_iter().collect(),
        announcements: ids.map(|id| (id, vec![announcement(id)])).into(),
        healths: ids.map(|id| (id, a_health(id))).into(),
        observations: ids.map(|id| (id, (0..40).map(observation).collect())).into(),
        paused: BTreeSet::new(),
        map: Some(TeamMap {
            leader: "l1".parse().unwrap(),
            term: 1,
            sequence: 1,
            stamp: Timestamp(1),
            oldest_contribution_s: 0.1,
            status: MapStatus::Converged,
            explanation: "why".to_owned(),
            gauge: None,
            // r1 looks along x, r2 back: each sees the other straight ahead.
            robots: vec![map_robot(ids[0], pose(0.0, 0.0)), map_robot(ids[1], pose(3.0, std::f64::consts::PI))],
            joint_covariance: vec![1e-6; 21],
            targets: Vec::new(),
            next_target: protocol::id::TargetId(1),
            alarms: Vec::new(),
        }),
        pictures: ids.map(|id| (id, PictureFigures { mean: 120.0, clipped: 0.01, sharpness: 0.8 })).into(),
    }
}

/// A fellow's cylinder of 0.2 m straight ahead at 3 m, from a camera at 0.6 m.
fn observation(sequence: u32) -> Observation {
    let half = (0.2f64 / 3.0).asin();
    let ends = [0.1, 0.5].map(|height: f64| Angle16::from_rad(((height - 0.6) / 2.8).atan()));
    let feature = |part, bearing| Feature {
        part,
        bearing: Angle16::from_rad(bearing),
        sigma: LogSigma::from_value(0.001),
        elevation: Some((ends, LogSigma::from_value(0.001))),
    };
    let sighting = PeerSighting {
        marker: Marker::CYLINDER,
        robot: None,
        bearing: Angle16::from_rad(0.0),
        bearing_sigma: LogSigma::from_value(0.001),
        range: None,
        heading: None,
        confidence: Fraction8::from_value(1.0),
        features: vec![feature(FeaturePart::Right, -half), feature(FeaturePart::Left, half)],
    };
    Observation {
        epoch: 1,
        sequence,
        capture: Timestamp(1),
        motion: Motion::Standing,
        odometry: None,
        stages: Stages::ALL,
        sightings: vec![sighting],
        tracks: Vec::new(),
    }
}

fn announcement(robot: RobotId) -> Announcement {
    let camera = CameraSummary {
        model: "pal".to_owned(),
        height_m: 0.6,
        height_sigma_m: 0.0,
        tilt_sigma_rad: 0.0,
        elevation_rad: [-0.2, 0.3],
        frame_rate_hz: 10.0,
    };
    let marker = Marker::Cylinder { radius_m: 0.2, height_m: [0.1, 0.5], look: None };
    Announcement { robot, epoch: 1, host: "alpha".to_owned(), version: "0.1.0".to_owned(), marker, camera }
}

fn a_health(robot: RobotId) -> Health {
    Health {
        robot,
        epoch: 1,
        at: Timestamp(1),
        frame_rate_hz: 10.0,
        frames: 1000,
        frames_dropped: 1,
        frames_bad: 0,
        stages_skipped: 0,
        messages_dropped: 0,
        messages_refused: 0,
        latency_ms: [30.0, 60.0],
        traffic: vec![KindTraffic { kind: 2, messages: 1000, payload_bytes: 160_000 }],
    }
}

fn announce_again(heard: &mut Heard) {
    let mut second = announcement(robot("r1"));
    second.epoch = 2;
    heard.announcements.get_mut(&robot("r1")).unwrap().push(second);
}

fn health(heard: &mut Heard) -> &mut Health {
    heard.healths.get_mut(&robot("r1")).unwrap()
}

fn map_robot(heard: &mut Heard) -> &mut MapRobot {
    &mut heard.map.as_mut().unwrap().robots[0]
}

fn picture(heard: &mut Heard) -> &mut PictureFigures {
    heard.pictures.get_mut(&robot("r1")).unwrap()
}

fn blind(heard: &mut Heard) {
    for observation in heard.observations.get_mut(&robot("r1")).unwrap() {
        observation.sightings.clear();
    }
}

fn set_radius(heard: &mut Heard, radius: f64) {
    let Marker::Cylinder { radius_m, .. } = &mut heard.announcements.get_mut(&robot("r2")).unwrap()[0].marker else {
        panic!("another marker");
    };
    *radius_m = radius;
}

fn set_height(heard: &mut Heard, height_m: f64) {
    heard.announcements.get_mut(&robot("r1")).unwrap()[0].camera.height_m = height_m;
}

fn robot(name: &str) -> RobotId {
    RobotId::new(name).unwrap()
}
