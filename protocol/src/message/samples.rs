//! One legal example of every message, for tests.

use super::*;
use crate::frames::Pose2;
use crate::id::{LeaderId, RobotId, TargetId, TrackId};
use crate::marker::{Beacon, Look, Marker, Ring};
use crate::message::observation::FeaturePart;
use crate::quantity::{Angle16, Fraction8, LogSigma, Millimetres};
use crate::time::Timestamp;

const NOON: Timestamp = Timestamp(1_790_000_000_123_456_789);

fn robot(name: &str) -> RobotId {
    RobotId::new(name).unwrap()
}

pub(crate) fn announcement() -> Announcement {
    let ring = |low: f64, reflectance| Ring { height_m: [low, low + 0.1], reflectance };
    Announcement {
        robot: robot("r1"),
        epoch: 0x0123_4567_89AB_CDEF,
        host: "robot-1.local".into(),
        version: "0.1.0".into(),
        marker: Marker::Cylinder {
            radius_m: 0.2,
            height_m: [0.1, 0.5],
            look: Some(Look {
                rings: vec![ring(0.1, 0.85), ring(0.2, 0.1), ring(0.3, 0.85), ring(0.4, 0.1)],
                bar_width_deg: None,
                beacon: Some(Beacon { height_mm: 540, code: "1101000".to_owned(), bit_ms: 200 }),
            }),
        },
        camera: CameraSummary {
            model: "pal".into(),
            height_m: 0.6,
            height_sigma_m: 0.002,
            tilt_sigma_rad: 0.003,
            elevation_rad: [-0.26, 0.35],
            frame_rate_hz: 10.0,
        },
    }
}

pub(crate) fn track(id: u32) -> TrackObservation {
    TrackObservation {
        track: TrackId(id),
        state: TrackState::Visible,
        bearing: Angle16::from_rad(0.5 + 0.1 * f64::from(id % 10)),
        bearing_sigma: LogSigma::from_value(0.003),
        elevation: [Angle16::from_rad(-0.2), Angle16::from_rad(0.3)],
        elevation_sigma: LogSigma::from_value(0.004),
        ends: [ElevationEnd::Seen, ElevationEnd::Seen],
        width: Angle16::from_rad(0.15),
        range: Some(SightedRange { range: Millimetres::from_m(3.2), sigma: LogSigma::from_value(0.2) }),
        class: ObjectClass::Person,
        confidence: Fraction8::from_value(0.9),
        doubtful: false,
        appearance: None,
    }
}

pub(crate) fn sighting() -> PeerSighting {
    let edge = |part, bearing| Feature {
        part,
        bearing: Angle16::from_rad(bearing),
        sigma: LogSigma::from_value(0.0006),
        elevation: Some(([Angle16::from_rad(-0.25), Angle16::from_rad(-0.05)], LogSigma::from_value(0.002))),
    };
    PeerSighting {
        marker: Marker::CYLINDER,
        robot: None,
        bearing: Angle16::from_rad(-1.0),
        bearing_sigma: LogSigma::from_value(0.0004),
        range: Some(SightedRange { range: Millimetres::from_m(2.0), sigma: LogSigma::from_value(0.01) }),
        heading: None,
        confidence: Fraction8::from_value(0.95),
        features: vec![edge(FeaturePart::Right, -1.1), edge(FeaturePart::Left, -0.9)],
    }
}

/// Four tracks, all with range and both ends seen, and two cylinder sightings with all their features: the one that must
/// not be longer than 160 bytes.
pub(crate) fn observation() -> Observation {
    Observation {
        epoch: 0x0123_4567_89AB_CDEF,
        sequence: 4711,
        capture: NOON,
        motion: Motion::Standing,
        odometry: None,
        stages: Stages::ALL,
        sightings: vec![sighting(), sighting()],
        tracks: vec![track(7), track(12), track(13), track(300)],
    }
}

/// Everything that an observation can hold, in every form.
pub(crate) fn full_observation() -> Observation {
    let mut bars = PeerSighting {
        marker: Marker::BARS,
        robot: Some(robot("r2")),
        range: None,
        heading: Some((Angle16::from_rad(2.0), LogSigma::from_value(0.05))),
        features: Vec::new(),
        ..sighting()
    };
    let elevation = sighting().features[0].elevation;
    for (part, elevation) in [
        (FeaturePart::Bar(None), None),
        (FeaturePart::Bar(Some(200)), elevation),
        (FeaturePart::Edge(0), elevation),
        (FeaturePart::Edge(1), None),
        (FeaturePart::Left, elevation),
    ] {
        bars.features.push(Feature {
            part,
            bearing: Angle16::from_rad(-3.1),
            sigma: LogSigma::from_value(0.001),
            elevation,
        });
    }
    let mut hidden = track(u32::MAX);
    hidden.state = TrackState::Hidden;
    hidden.ends = [ElevationEnd::Hidden, ElevationEnd::Cut];
    hidden.range = None;
    hidden.class = ObjectClass::Other;
    hidden.appearance = Some([0xA5; 16]);
    Observation {
        sequence: u32::MAX,
        motion: Motion::Unknown,
        odometry: Some(Odometry {
            dx_m: 0.1,
            dy_m: -0.01,
            dheading_rad: 0.02,
            covariance: [1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-5],
        }),
        stages: Stages(Stages::MOTION | Stages::PEERS),
        sightings: vec![bars, sighting()],
        tracks: vec![hidden, track(0), track(5)],
        ..observation()
    }
}

pub(crate) fn alarm() -> Alarm {
    Alarm {
        robot: robot("r1"),
        epoch: 0x0123_4567_89AB_CDEF,
        number: 3,
        at: NOON,
        kind: AlarmKind::SensorFailure("frames are black".into()),
    }
}

pub(crate) fn health() -> Health {
    Health {
        robot: robot("r1"),
        epoch: 0x0123_4567_89AB_CDEF,
        at: NOON,
        frame_rate_hz: 9.9,
        frames: 1000,
        frames_dropped: 3,
        frames_bad: 1,
        stages_skipped: 2,
        messages_dropped: 0,
        messages_refused: 1,
        latency_ms: [12.5, 31.0],
        traffic: vec![KindTraffic { kind: 2, messages: 996, payload_bytes: 150_000 }],
    }
}

pub(crate) fn command() -> Command {
    Command::SetFrameRate(5.0)
}

pub(crate) fn command_reply() -> CommandReply {
    CommandReply::Status { epoch: 5, frames: 600, background_ready: true, paused: false, tracks: 4, peers: 2 }
}

pub(crate) fn clock_probe() -> ClockProbe {
    ClockProbe { sent: NOON }
}

pub(crate) fn clock_reply() -> ClockReply {
    ClockReply { probe_sent: NOON, received: Timestamp(NOON.0 + 1000), replied: Timestamp(NOON.0 + 2000), epoch: 5 }
}

pub(crate) fn map() -> TeamMap {
    let on_floor = |name: &str, pose| MapRobot {
        id: robot(name),
        team_from_body: pose,
        component: 0,
        presence: Presence::Online,
        moving: false,
        clock_offset_s: Some((0.012, 0.0005)),
        lag_s: Some((0.06, 0.004)),
        bias_rad: None,
        trust: Trust::Full,
        verifiable: false,
        trouble: None,
        observations_lost: 0,
    };
    let mut joint_covariance = vec![0.0; 21];
    for (entry, variance) in [(0, 1e-8), (6, 1e-8), (11, 1e-8), (15, 1e-4), (18, 1e-4), (20, 1e-6)] {
        joint_covariance[entry] = variance;
    }
    TeamMap {
        leader: LeaderId::new("l1").unwrap(),
        term: 2,
        sequence: 77,
        stamp: NOON,
        oldest_contribution_s: 0.15,
        status: MapStatus::Converged,
        explanation: "r1 holds the frame".into(),
        gauge: Some(robot("r1")),
        robots: vec![
            on_floor("r1", Some(Pose2::new(0.0, 0.0, 0.0))),
            on_floor("r2", Some(Pose2::new(2.0, 1.0, -1.5))),
            MapRobot { trouble: Some(Trouble::ClockUncertain), observations_lost: 7, ..on_floor("r3", None) },
        ],
        joint_covariance,
        targets: vec![MapTarget {
            id: TargetId(9),
            component: 0,
            position_m: [1.0, 2.5, 0.9],
            velocity_mps: [0.4, -0.2],
            height_m: Some((1.75, 0.03)),
            own_covariance: [0.01, 0.001, 0.0, 0.02, 0.0, 0.005],
            pose_jacobian: vec![0.25; 12],
            observers: vec![robot("r1"), robot("r2")],
            pair: Some((robot("r1"), robot("r2"))),
            age_s: 0.1,
        }],
        next_target: TargetId(10),
        alarms: vec![alarm()],
    }
}

pub(crate) fn guidance() -> Guidance {
    Guidance {
        robot: robot("r2"),
        at: NOON,
        team_from_goal: Pose2::new(1.5, -0.5, 3.0),
        error_here_m: 0.12,
        error_there_m: 0.05,
        term: 2,
    }
}

pub(crate) fn surroundings() -> Surroundings {
    let neighbour = |track, bearing_rad, range_m| Neighbour {
        track,
        bearing: Angle16::from_rad(bearing_rad),
        range: Millimetres::from_m(range_m),
        sigma: [0.12, 0.05].map(LogSigma::from_value),
        velocity_mmps: [800, -350],
    };
    Surroundings {
        robot: robot("r2"),
        epoch: 0x0123_4567_89AB_CDEF,
        leader: LeaderId::new("l1").unwrap(),
        term: 2,
        at: NOON,
        people: vec![neighbour(Some(TrackId(7)), 0.5, 1.25), neighbour(None, -2.75, 4.5)],
    }
}

pub(crate) fn edges() -> Edges {
    let edge = |bearing_rad: f64, levels, ends| UprightEdge {
        bearing: Angle16::from_rad(bearing_rad),
        sigma: LogSigma::from_value(0.001),
        levels,
        elevation: [-0.2, 0.3].map(Angle16::from_rad),
        ends,
    };
    let edges = vec![edge(1.25, [40, 180], [true, false]), edge(-3.0, [96, 90], [true, true])];
    Edges { epoch: 0x0123_4567_89AB_CDEF, at: NOON, edges }
}

pub(crate) fn candidacy() -> Candidacy {
    Candidacy {
        leader: LeaderId::new("l1").unwrap(),
        epoch: 0x0123_4567_89AB_CDEF,
        term: 2,
        rules: true,
        robots: 3,
        replay_start: Some(NOON),
    }
}

pub(crate) fn replay_start() -> ReplayStart {
    let at = |ns| Timestamp(NOON.0 + ns);
    ReplayStart { probe_sent: NOON, received: at(1000), replied: at(2000), start: Some(at(3_000_000_000)) }
}

pub(crate) fn recent() -> Recent {
    Recent { observations: vec![observation(), Observation { sequence: 78, ..observation() }] }
}
