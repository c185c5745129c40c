//! Leaders that follow one another: frame, places and numbers go on.

use std::collections::BTreeMap;

use nalgebra::Vector2;
use protocol::frames::Pose2;
use protocol::id::TargetId;

use super::world::{Settings, World, clock};
use super::*;

fn leader(name: &str) -> Leader {
    Leader::new(LeaderCoreConfig::new(name.parse().unwrap()))
}

fn settings(duration_s: f64) -> Settings {
    Settings { drives: vec![], people: 3, duration_s, ..Settings::default() }
}

fn poses(map: &TeamMap) -> BTreeMap<RobotId, Pose2> {
    map.robots.iter().filter_map(|r| Some((r.id, r.team_from_body?))).collect()
}

/// The number in the map of each person who is in it.
fn numbers(world: &World, map: &TeamMap) -> BTreeMap<usize, TargetId> {
    let gauge = map.gauge.and_then(|g| map.robots.iter().find(|r| r.id == g)?.team_from_body);
    let (Some(pose), Some(id)) = (gauge, map.gauge) else { return BTreeMap::new() };
    let k = world.robots.iter().position(|r| r.id == id).unwrap();
    let (robots, people) = world.truth_at(map.stamp.seconds_since(clock(0.0)));
    let [x, y, heading] = robots[k];
    let team_from_world = pose * Pose2::new(x, y, heading).inverse();
    let mut found = BTreeMap::new();
    for (n, person) in people.iter().enumerate() {
        let at = team_from_world.transform(Vector2::new(person.position[0], person.position[1]));
        let near = |t: &&MapTarget| (t.position_m[0] - at.x).hypot(t.position_m[1] - at.y) < 0.4;
        if let Some(target) = map.targets.iter().find(near) {
            found.insert(n, target.id);
        }
    }
    found
}

#[test]
fn whoever_takes_over_goes_on_in_the_same_frame_with_the_same_numbers_at_once() {
    for seed in [70, 73] {
        let mut leaders = ["l1", "l2", "l3"].map(|name| {
            let mut config = LeaderCoreConfig::new(name.parse().unwrap());
            config.listens_s = 0.3;
            Leader::new(config)
        });
        let mut last: BTreeMap<usize, (f64, TeamMap, BTreeMap<usize, TargetId>)> = BTreeMap::new();
        let mut taken_over = None;
        // The third comes late and follows the second, which follows the first.
        let lives = |t: f64, k: usize| match k {
            0 => t < 6.0,
            1 => t < 10.0,
            _ => t > 7.0,
        };
        World::new(settings(13.0), seed).run_many(&mut leaders, lives, |world, k, map| {
            let t = map.stamp.seconds_since(clock(0.0));
            if k > 0 && !last.contains_key(&k) && t > 5.5 {
                let (then, before, named) = &last[&(k - 1)];
                assert!(t - then < 0.5, "seed {seed}: {t} after {then}");
                assert_eq!(map.term, before.term + 1);
                for (id, pose) in poses(before) {
                    let now = poses(map)[&id];
                    let away_m = (now.position() - pose.position()).norm();
                    assert!(away_m < 0.03, "seed {seed}: {id} is {away_m} m from where it was");
                }
                taken_over = Some((t, named.clone()));
            }
            if let Some((since, before)) = &taken_over
                && t > since + 0.5
                && t < since + 0.6
            {
                for (person, id) in numbers(world, map) {
                    if let Some(old) = before.get(&person) {
                        assert_eq!(id, *old, "seed {seed}: person {person} has another number {t}");
                    }
                }
            }
            if leaders_turn(k, t) {
                last.insert(k, (t, map.clone(), numbers(world, map)));
            }
        });
        assert_eq!(last.len(), 3, "seed {seed}: each has led");
        assert!(last[&2].1.targets.len() >= 2, "seed {seed}");
    }
}

/// Whose turn it is: two that begin together both lead for a moment.
fn leaders_turn(k: usize, t: f64) -> bool {
    (k == 0 && t < 6.0) || (k == 1 && (6.0..10.0).contains(&t)) || (k == 2 && t > 10.0)
}

#[test]
fn a_sole_leader_that_was_restarted_goes_on_where_sightings_agree_and_says_whom_it_dropped() {
    // The same room before and after; r2 is carried away while the leader is down.
    let places = vec![[2.0, 2.0, 0.4], [6.0, 2.2, 2.0], [4.2, 4.6, -1.2]];
    let mut saved = None;
    let before = Settings { places: Some(places.clone()), ..settings(10.0) };
    World::new(before, 3).run(&mut leader("l1"), |_, map| saved = Some(map.clone()));
    let saved = saved.unwrap();
    let mut moved = places.clone();
    moved[1] = [6.2, 3.4, -2.0];
    for (places, carried) in [(places, false), (moved, true)] {
        let after = Settings { places: Some(places), ..settings(8.0) };
        let mut again = leader("l1");
        let mut outputs = Vec::new();
        again.resume(clock(0.0), &saved, &mut outputs);
        let mut first = None;
        let mut last = None;
        World::new(after, 4).run(&mut again, |_, map| {
            assert_eq!(map.term, saved.term + 1);
            let placed = poses(map);
            if placed.len() == 3 && first.is_none() {
                first = Some(map.stamp.seconds_since(clock(0.0)));
            }
            for (id, pose) in &placed {
                let away_m = (pose.position() - poses(&saved)[id].position()).norm();
                let is_carried = carried && id.as_str() == "r2";
                assert_eq!(away_m > 0.5, is_carried, "{id} is {away_m} m from where it was");
            }
            last = Some(map.clone());
        });
        assert!(first.is_some_and(|t| t < 2.0), "placed at {first:?}");
        assert_eq!(last.unwrap().gauge, saved.gauge);
        assert_eq!(again.told.iter().any(|text| text.contains("r2") && text.contains("dropped")), carried);
    }
}

#[test]
fn numbers_given_an_hour_before_a_restart_are_not_given_again() {
    let mut saved = None;
    World::new(settings(10.0), 3).run(&mut leader("l1"), |_, map| saved = Some(map.clone()));
    let mut saved = saved.unwrap();
    assert!(!saved.targets.is_empty());
    saved.stamp = saved.stamp.offset_by_secs(-3600.0);
    let mut again = leader("l1");
    again.resume(clock(0.0), &saved, &mut Vec::new());
    let mut seen = 0;
    World::new(settings(8.0), 9).run(&mut again, |_, map| {
        assert!(map.targets.iter().all(|target| target.id >= saved.next_target), "{:?}", map.targets);
        seen = seen.max(map.targets.len());
    });
    assert!(seen > 0);
}
