//! A robot with a valid certificate that lies: it can neither stop the leader nor move the others.

use protocol::id::RobotId;
use protocol::message::{MapStatus, Observation, TeamMap};
use protocol::quantity::Angle16;
use protocol::time::Timestamp;
use sim_harness::scale::room::Room;
use sim_harness::scale::sender::announcement;
use team_leader::leader::{Input, Leader, LeaderCoreConfig, Output};

const START: Timestamp = Timestamp(1_800_000_000_000_000_000);

/// The liar is the last of four: three others see each other.
const LIAR: usize = 3;

/// What it does to its own observations.
type Lie = fn(&mut Observation);

#[test]
fn false_sightings_move_no_other_robot_by_more_than_a_sigma() {
    // Where robots stand follows from sightings alone, so nobody walks here.
    let honest = last_map(4, 12, false, |_| {});
    assert_eq!(honest.status, MapStatus::Converged, "{}", honest.explanation);
    let lies: [(&str, Lie); 4] = [
        ("all bearings turned by 10°, as a false heading would", |o| turn(o, |_| 0.17)),
        ("one fellow seen 10° aside", |o| turn(o, |i| if i == 0 { 0.17 } else { 0.0 })),
        ("fellows seen where others stand", |o| turn(o, |i| 0.4 * (i as f64 - 1.0))),
        ("fellows half as far as they are", |o| {
            for sighting in &mut o.sightings {
                let middle = sighting.bearing.rad();
                for feature in &mut sighting.features {
                    feature.bearing = Angle16::from_rad(middle + 2.0 * (feature.bearing.rad() - middle));
                    feature.elevation = None;
                }
            }
        }),
    ];
    let mut moved_by_lie = Vec::new();
    for (what, lie) in lies {
        let map = last_map(4, 12, false, lie);
        moved_by_lie.push((what, moved(&honest, &map)));
    }
    println!("{moved_by_lie:?}");
    for (what, moved) in &moved_by_lie {
        assert!(*moved <= 1.0, "{what}: another robot was moved by {moved:.2} sigma; all: {moved_by_lie:?}");
    }
}

#[test]
fn whoever_three_others_could_prove_wrong_is_verifiable_and_in_a_team_of_three_nobody_is() {
    let verifiable = |robots| -> Vec<bool> {
        let map = last_map(robots, 6, false, |_| {});
        map.robots.iter().map(|robot| robot.team_from_body.is_some() && robot.verifiable).collect()
    };
    assert_eq!(verifiable(4), [true; 4]);
    assert_eq!(verifiable(3), [false; 3]);
}

#[test]
fn nonsense_of_every_kind_does_not_stop_the_leader() {
    let map = last_map(4, 5, true, |o| {
        let nonsense = o.sequence;
        o.tracks = (0..64)
            .map(|n| {
                let mut t = o.tracks[n % 4].clone();
                t.track.0 = nonsense * 64 + n as u32;
                t
            })
            .collect();
        o.sightings = (0..32)
            .map(|n| {
                let mut s = o.sightings[n % 3].clone();
                s.robot = RobotId::new(&format!("ghost{n}")).ok();
                s
            })
            .collect();
        o.capture = Timestamp(o.capture.0.wrapping_add(u64::from(nonsense % 7) * 1_000_000_000_000));
    });
    let liar = map.robots.iter().find(|robot| robot.id.as_str() == "r3").unwrap();
    assert!(liar.observations_lost > 30, "what it stamps in the future is refused and counted: {liar:?}");
    // The honest three are placed, and maps go on to the end.
    let placed = map.robots.iter().filter(|r| r.team_from_body.is_some() && r.id.as_str() != "r3").count();
    assert_eq!(placed, 3, "{}", map.explanation);
    assert!(map.stamp.seconds_since(START) < 6.0, "the liar's clock became the map's: {}", map.stamp);
}

fn turn(observation: &mut Observation, by_rad: impl Fn(usize) -> f64) {
    for (index, sighting) in observation.sightings.iter_mut().enumerate() {
        let by = by_rad(index);
        sighting.bearing = Angle16::from_rad(sighting.bearing.rad() + by);
        for feature in &mut sighting.features {
            feature.bearing = Angle16::from_rad(feature.bearing.rad() + by);
        }
    }
}

/// The last map of a team of three or four after some seconds at 10 Hz, among people or not; the fourth lies.
fn last_map(robots: usize, length_s: u64, people: bool, lie: impl Fn(&mut Observation)) -> TeamMap {
    let mut config = LeaderCoreConfig::new("l1".parse().unwrap());
    config.clock.trusted = true;
    let mut leader = Leader::new(config);
    let (mut out, mut last) = (Vec::new(), None);
    let ids: Vec<RobotId> = (0..robots).map(|n| RobotId::new(&format!("r{n}")).unwrap()).collect();
    for (n, robot) in ids.iter().enumerate() {
        leader.handle(START, Input::RobotAlive(*robot), &mut out);
        leader.handle(START, Input::Announcement(announcement(*robot, n as u64 + 1, 10.0)), &mut out);
    }
    let mut rooms: Vec<Room> = (0..4).map(|_| Room::new(0, 7)).collect();
    for frame in 0..length_s * 10 {
        for (n, robot) in ids.iter().enumerate() {
            let capture = START.offset_by_secs(0.1 * frame as f64 + 0.02 * n as f64);
            let mut seen = rooms[n].observe(n, capture, n as u64 + 1);
            seen.sightings.truncate(robots - 1);
            if !people {
                seen.tracks.clear();
            }
            if n == LIAR {
                lie(&mut seen);
            }
            leader.handle(capture.offset_by_secs(0.01), Input::Observation(*robot, seen), &mut out);
            last = out
                .drain(..)
                .filter_map(|o| if let Output::Map(map) = o { Some(map) } else { None })
                .next_back()
                .or(last);
        }
    }
    last.unwrap()
}

/// How far the honest robots are from where they are without the lie, relative to the first of them, in sigmas: the worst.
fn moved(honest: &TeamMap, lied: &TeamMap) -> f64 {
    let pose =
        |map: &TeamMap, name: &str| map.robots.iter().find(|r| r.id.as_str() == name).and_then(|r| r.team_from_body);
    let sigma = |map: &TeamMap, name: &str| {
        // The variance of x, y and heading of this robot in the joint covariance's upper triangle.
        let placed: Vec<&str> =
            map.robots.iter().filter(|r| r.team_from_body.is_some()).map(|r| r.id.as_str()).collect();
        let (n, at) = (3 * placed.len(), 3 * placed.iter().position(|p| *p == name).unwrap());
        let diagonal = |i: usize| f64::from(map.joint_covariance[i * n - i * (i + 1) / 2 + i]);
        [0, 1, 2].map(|k| diagonal(at + k).sqrt().max(1e-4))
    };
    let mut worst: f64 = 0.0;
    for name in ["r1", "r2"] {
        let relative = |map: &TeamMap| {
            let (base, own) = (pose(map, "r0"), pose(map, name));
            base.zip(own).map(|(base, own)| {
                let (dx, dy) = (own.x_m - base.x_m, own.y_m - base.y_m);
                let (sin, cos) = base.heading_rad.sin_cos();
                [cos * dx + sin * dy, cos * dy - sin * dx, own.heading_rad - base.heading_rad]
            })
        };
        let (Some(before), Some(after)) = (relative(honest), relative(lied)) else { return f64::INFINITY };
        for ((before, after), sigma) in before.iter().zip(after).zip(sigma(honest, name)) {
            worst = worst.max((after - before).abs() / sigma);
        }
    }
    worst
}
