//! Golden bytes, hostile bytes, memory.

mod fuzz;
mod golden;
mod hostile;
mod memory;
mod observation;

use super::*;
use crate::message::*;

/// Runs a generic check on one example of every message.
macro_rules! for_every_message {
    ($check:ident) => {
        $check("announcement", &samples::announcement());
        $check("observation", &samples::observation());
        $check("observation_full", &samples::full_observation());
        $check("alarm", &samples::alarm());
        $check("health", &samples::health());
        $check("command", &samples::command());
        $check("command_reply", &samples::command_reply());
        $check("clock_probe", &samples::clock_probe());
        $check("clock_reply", &samples::clock_reply());
        $check("replay_start", &samples::replay_start());
        $check("team_map", &samples::map());
        $check("guidance", &samples::guidance());
        $check("surroundings", &samples::surroundings());
        $check("edges", &samples::edges());
        $check("candidacy", &samples::candidacy());
        $check("recent", &samples::recent());
    };
}
use for_every_message;

#[test]
fn every_kind_has_its_number_for_ever() {
    for (i, kind) in Kind::ALL.into_iter().enumerate() {
        assert_eq!((kind as u8, Kind::from_u8(i as u8 + 1)), (i as u8 + 1, Some(kind)));
    }
    assert_eq!((Kind::from_u8(0), Kind::from_u8(Kind::ALL.len() as u8 + 1)), (None, None));
}

#[test]
fn another_version_is_refused_and_the_error_says_which_side_to_upgrade() {
    let mut envelope = encode(&samples::clock_probe()).unwrap();
    envelope[2] = WIRE_VERSION + 1;
    let newer = decode::<ClockProbe>(&envelope).unwrap_err();
    assert!(matches!(newer, DecodeError::ReceiverTooOld { .. }));
    assert!(newer.to_string().contains("upgrade this program"), "{newer}");
    envelope[2] = OLDEST_VERSION - 1;
    let older = decode::<ClockProbe>(&envelope).unwrap_err();
    assert!(matches!(older, DecodeError::SenderTooOld { .. }));
    assert!(older.to_string().contains("upgrade the sender"), "{older}");
}

#[test]
fn strangers_and_other_kinds_are_told_apart() {
    assert!(matches!(decode::<Alarm>(b""), Err(DecodeError::NoEnvelope { len: 0 })));
    assert!(matches!(decode::<Alarm>(b"GET / HTTP/1.1"), Err(DecodeError::Magic { found: [b'G', b'E'] })));
    let health = encode(&samples::health()).unwrap();
    assert!(matches!(decode::<Alarm>(&health), Err(DecodeError::Kind { expected: Kind::Alarm, found: 4 })));
    assert_eq!(claimed_kind(&health), Some(Kind::Health));
    assert_eq!(claimed_kind(b"GET "), None);
}

#[test]
fn what_one_program_refuses_no_program_sends() {
    let refused = |why: Result<Vec<u8>, EncodeError>, part: &str| {
        let text = why.unwrap_err().to_string();
        assert!(text.contains(part), "{text}");
    };
    refused(encode(&Command::SetFrameRate(f32::NAN)), "rate_hz");
    refused(encode(&Command::SetFrameRate(121.0)), "120");
    refused(encode(&CommandReply::Refused("x".repeat(257))), "256");
    refused(encode(&Alarm { kind: AlarmKind::SensorFailure("x".repeat(129)), ..samples::alarm() }), "128");
    refused(encode(&Guidance { error_here_m: f64::INFINITY, ..samples::guidance() }), "error_here_m");
    let mut map = samples::map();
    map.joint_covariance[0] = -1.0;
    refused(encode(&map), "joint_covariance");
    map = samples::map();
    map.joint_covariance.pop();
    refused(encode(&map), "joint_covariance");
    map = samples::map();
    map.targets[0].pose_jacobian[3] = f32::NAN;
    refused(encode(&map), "pose_jacobian");
    map = samples::map();
    map.robots = vec![map.robots[2].clone(); map::MAX_ROBOTS + 1];
    refused(encode(&map), "256");
    let mut observation = samples::observation();
    observation.tracks[0].elevation.swap(0, 1);
    refused(encode(&observation), "lower end");
    observation = samples::observation();
    observation.stages = Stages(64);
    refused(encode(&observation), "stages");
    let driven = |dx_m: f32, variance: f32| {
        let covariance = [variance, 0.0, 0.0, 1e-4, 0.0, 1e-5];
        let odometry = Some(Odometry { dx_m, dy_m: 0.0, dheading_rad: 0.0, covariance });
        encode(&Observation { odometry, ..samples::observation() })
    };
    assert!(driven(-0.3, 1e-4).is_ok());
    refused(driven(1e20, 1e-4), "odometry");
    refused(driven(0.1, 3e38), "odometry.covariance");
    let mut announcement = samples::announcement();
    announcement.host = "h".repeat(65);
    refused(encode(&announcement), "host");
    announcement = samples::announcement();
    announcement.camera.height_m = 0.0;
    refused(encode(&announcement), "height_m");
    announcement = samples::announcement();
    announcement.marker = crate::marker::Marker::Cylinder { radius_m: 0.2, height_m: [0.5, 0.1], look: None };
    refused(encode(&announcement), "marker.height_m");
    announcement = samples::announcement();
    announcement.marker = crate::marker::Marker::Cylinder { radius_m: -0.2, height_m: [0.1, 0.5], look: None };
    refused(encode(&announcement), "marker.radius_m is -0.2; legal is more than 0, at most 10");
}

#[test]
fn a_term_that_nobody_could_follow_is_refused() {
    let most = crate::fence::MAX_TERM;
    for (term, is_legal) in [(most, true), (most + 1, false), (u64::MAX, false)] {
        assert_eq!(encode(&Candidacy { term, ..samples::candidacy() }).is_ok(), is_legal, "{term}");
        assert_eq!(encode(&TeamMap { term, ..samples::map() }).is_ok(), is_legal, "{term}");
        assert_eq!(encode(&Guidance { term, ..samples::guidance() }).is_ok(), is_legal, "{term}");
        assert_eq!(encode(&Surroundings { term, ..samples::surroundings() }).is_ok(), is_legal, "{term}");
    }
}

#[test]
fn an_illegal_value_in_well_formed_bytes_is_refused() {
    let mut envelope = encode(&Command::SetFrameRate(5.0)).unwrap();
    let at = envelope.len() - 4;
    envelope[at..].copy_from_slice(&f32::INFINITY.to_le_bytes());
    assert!(matches!(decode::<Command>(&envelope), Err(DecodeError::Invalid { kind: Kind::Command, .. })));
}
