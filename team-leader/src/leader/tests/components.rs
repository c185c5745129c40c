//! Rooms that nothing ties together: a frame each, until a door opens or a robot changes rooms.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Vector2;
use protocol::frames::Pose2;
use protocol::id::TargetId;

use super::world::{Fault, PersonTruth, Settings, World, clock};
use super::*;

/// Three robots on each side of a wall.
const PLACES: [[f64; 3]; 6] =
    [[1.4, 1.5, 0.3], [5.4, 1.3, -2.0], [3.0, 4.3, 1.7], [7.0, 2.4, 2.9], [1.2, 4.6, -0.8], [6.2, 4.7, 0.6]];
const LEFT: [usize; 3] = [0, 2, 4];
const RIGHT: [usize; 3] = [1, 3, 5];
const WALL_M: f64 = 4.2;

fn settings(duration_s: f64, opens_s: f64) -> Settings {
    Settings {
        robots: 6,
        people: 4,
        drives: vec![],
        places: Some(PLACES.to_vec()),
        wall: Some((WALL_M, opens_s)),
        duration_s,
        ..Settings::default()
    }
}

fn leader(name: &str) -> Leader {
    let mut config = LeaderCoreConfig::new(name.parse().unwrap());
    config.listens_s = 0.3;
    Leader::new(config)
}

fn number(world: &World, id: RobotId) -> usize {
    world.robots.iter().position(|r| r.id == id).unwrap()
}

/// Robots of each component.
fn rooms(world: &World, map: &TeamMap) -> BTreeMap<u8, Vec<usize>> {
    let robots = |c: u8| map.placed(c).map(|r| number(world, r.id)).collect();
    map.components().into_iter().map(|c| (c, robots(c))).collect()
}

/// By its first robot: where the component's frame is in the world.
fn world_from_team(world: &World, map: &TeamMap, component: u8) -> Pose2 {
    let first = map.placed(component).next().unwrap();
    let (robots, _) = world.truth_at(map.stamp.seconds_since(clock(0.0)));
    let [x, y, heading] = robots[number(world, first.id)];
    Pose2::new(x, y, heading) * first.team_from_body.unwrap().inverse()
}

/// The worst error of a placed robot beside the first of its component, metres.
fn worst_m(world: &World, map: &TeamMap) -> f64 {
    let (robots, _) = world.truth_at(map.stamp.seconds_since(clock(0.0)));
    let mut worst: f64 = 0.0;
    for component in map.components() {
        let frame = world_from_team(world, map, component);
        for robot in map.placed(component) {
            let found = frame.transform(robot.team_from_body.unwrap().position());
            let [x, y, _] = robots[number(world, robot.id)];
            worst = worst.max((found - Vector2::new(x, y)).norm());
        }
    }
    worst
}

/// Number in the map of each person who is in it.
fn people(world: &World, map: &TeamMap) -> BTreeMap<usize, TargetId> {
    let (_, people) = world.truth_at(map.stamp.seconds_since(clock(0.0)));
    let mut found = BTreeMap::new();
    for target in &map.targets {
        let at = world_from_team(world, map, target.component)
            .transform(Vector2::new(target.position_m[0], target.position_m[1]));
        let near = |p: &&PersonTruth| (Vector2::from(p.position) - at).norm() < 0.5;
        if let Some(n) = people.iter().position(|p| near(&p)) {
            found.insert(n, target.id);
        }
    }
    found
}

#[test]
fn two_rooms_have_a_frame_each_with_their_people_and_are_one_when_the_door_opens() {
    for seed in [1, 2, 3] {
        let (mut apart_s, mut joined_s) = (None, None);
        let (mut seen, mut expected, mut kept) = (0, 0, (0, 0));
        let mut before = BTreeMap::new();
        World::new(settings(20.0, 12.0), seed).run(&mut leader("l1"), |world, map| {
            let t = map.stamp.seconds_since(clock(0.0));
            let rooms = rooms(world, map);
            assert!(worst_m(world, map) < 0.06, "seed {seed} at {t}: {}", worst_m(world, map));
            for robots in rooms.values() {
                let mixed = LEFT.iter().any(|r| robots.contains(r)) && RIGHT.iter().any(|r| robots.contains(r));
                assert!(!mixed || t > 12.0, "seed {seed}: {rooms:?} at {t}");
            }
            let placed: usize = rooms.values().map(Vec::len).sum();
            if placed == 6 && rooms.len() == 2 {
                apart_s.get_or_insert(t);
            }
            if t > 12.0 && placed == 6 && rooms.len() == 1 {
                joined_s.get_or_insert(t);
            }
            let numbers = people(world, map);
            if (6.0..12.0).contains(&t) {
                expected += world.truth_at(t).1.iter().filter(|p| p.seen_by.len() > 1).count();
                seen += numbers.len();
                assert_eq!(rooms.len(), 2, "seed {seed}: {rooms:?} at {t}");
                before = numbers;
            } else if t > 19.9 {
                kept.1 += before.len();
                kept.0 += before.iter().filter(|(n, id)| numbers.get(n) == Some(id)).count();
            }
        });
        let (apart_s, joined_s) = (apart_s.unwrap(), joined_s.unwrap());
        println!("seed {seed}: apart {apart_s:.2}, joined {joined_s:.2}, {seen}/{expected}, {kept:?}");
        assert!(apart_s < 3.0 && joined_s < 13.5, "seed {seed}: {apart_s} {joined_s}");
        assert!(f64::from(seen as u32) > 0.93 * f64::from(expected as u32), "seed {seed}: {seen} of {expected}");
        assert!(3 * kept.0 >= 2 * kept.1 && kept.1 > 0, "seed {seed}: {kept:?} numbers kept");
    }
}

#[test]
fn a_robot_that_drives_into_another_room_belongs_there() {
    let settings = Settings {
        drives: vec![(4, 6.0, 12.0)],
        goals: BTreeMap::from([(4, [5.0, 3.2, 1.1])]),
        ..settings(20.0, f64::INFINITY)
    };
    let mut arrived_s = None;
    World::new(settings, 4).run(&mut leader("l1"), |world, map| {
        let t = map.stamp.seconds_since(clock(0.0));
        let there = rooms(world, map).into_values().find(|robots| robots.contains(&4));
        if t > 12.0 && there.is_some_and(|robots| RIGHT.iter().all(|r| robots.contains(r))) {
            arrived_s.get_or_insert(t);
            assert!(worst_m(world, map) < 0.06, "{} at {t}", worst_m(world, map));
        }
    });
    let arrived_s = arrived_s.unwrap();
    assert!(arrived_s < 14.0, "{arrived_s}");
}

#[test]
fn who_takes_over_keeps_every_rooms_frame_and_numbers() {
    let mut leaders = [leader("l1"), leader("l2")];
    let mut last: Option<TeamMap> = None;
    let (mut numbers, mut compared) = (BTreeMap::new(), false);
    World::new(settings(12.0, f64::INFINITY), 5).run_many(
        &mut leaders,
        |t, k| k == 1 || t < 8.0,
        |world, k, map| {
            let t = map.stamp.seconds_since(clock(0.0));
            if k == 0 {
                numbers = people(world, map);
                last = Some(map.clone());
                return;
            }
            let Some(before) = last.as_ref().filter(|_| t > 8.0) else { return };
            for robot in &before.robots {
                let now = map.robots.iter().find(|r| r.id == robot.id).unwrap();
                assert_eq!(now.component, robot.component, "{} at {t}", robot.id);
                let away = now.team_from_body.unwrap().position() - robot.team_from_body.unwrap().position();
                assert!(away.norm() < 0.03, "{}: {} m at {t}", robot.id, away.norm());
            }
            if t > 9.0 && !compared {
                compared = true;
                let now = people(world, map);
                let same = numbers.iter().filter(|(n, id)| now.get(n) == Some(id)).count();
                assert!(same >= 2 && now.len() >= 2, "{numbers:?} {now:?}");
            }
        },
    );
    assert!(compared);
}

#[test]
fn a_restarted_leader_goes_on_in_every_rooms_frame() {
    let mut saved = None;
    World::new(settings(8.0, f64::INFINITY), 9).run(&mut leader("l1"), |_, map| saved = Some(map.clone()));
    let saved = saved.unwrap();
    assert_eq!(saved.components().len(), 2);
    let mut restarted = leader("l1");
    restarted.resume(clock(0.0), &saved, &mut Vec::new());
    let mut last = None;
    World::new(settings(4.0, f64::INFINITY), 9).run(&mut restarted, |_, map| last = Some(map.clone()));
    let now = last.unwrap();
    for before in &saved.robots {
        let robot = now.robots.iter().find(|r| r.id == before.id).unwrap();
        assert_eq!(robot.component, before.component, "{}: {}", before.id, now.explanation);
        let away = robot.team_from_body.unwrap().position() - before.team_from_body.unwrap().position();
        assert!(away.norm() < 0.03, "{}: {} m", before.id, away.norm());
    }
}

#[test]
fn rooms_that_are_alike_are_not_mixed() {
    // The right room is the left one, 4 m on: distances do not tell which three belong together, names do.
    let mut places = PLACES.to_vec();
    for (right, left) in RIGHT.into_iter().zip(LEFT) {
        places[right] = [PLACES[left][0] + 4.0, PLACES[left][1], PLACES[left][2] + 0.5 * left as f64];
    }
    let alike = Settings { places: Some(places), people: 0, ..settings(6.0, f64::INFINITY) };
    let named = Settings { faults: vec![Fault::Called(0, 0)], ..alike.clone() };
    for (settings, tells) in [(alike, false), (named, true)] {
        let mut ever = BTreeSet::new();
        let mut last = None;
        World::new(settings, 6).run(&mut leader("l1"), |world, map| {
            ever.extend(rooms(world, map).into_values());
            last = Some(map.clone());
        });
        let whole = [LEFT.to_vec(), RIGHT.to_vec()];
        let right = |robots: &Vec<usize>| whole.iter().any(|room| robots.iter().all(|r| room.contains(r)));
        assert!(ever.iter().all(right), "{ever:?}");
        let map = last.unwrap();
        assert_eq!(ever.contains(&whole[0]) && ever.contains(&whole[1]), tells, "{ever:?}: {}", map.explanation);
        if !tells {
            assert_eq!(map.status, MapStatus::Ambiguous, "{}", map.explanation);
        }
    }
}
