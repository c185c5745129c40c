//! The leader sends robots where they see better; who goes there does.

use super::world::{Settings, World, clock};
use super::*;
use nalgebra::Vector2;

/// All at one end of the room.
const PLACES: [[f64; 3]; 3] = [[1.4, 1.6, 0.4], [1.5, 3.0, 2.5], [1.3, 4.4, -1.8]];

fn badly_placed(duration_s: f64, follows_from_s: Option<f64>, seed: u64) -> World {
    let settings = Settings {
        robots: 3,
        drives: vec![],
        people: 3,
        duration_s,
        places: Some(PLACES.to_vec()),
        follows_from_s,
        ..Settings::default()
    };
    World::new(settings, seed)
}

#[test]
fn guidance_is_rare_worth_the_way_and_within_what_is_known() {
    let mut world = badly_placed(22.0, None, 500);
    let mut leader = Leader::new(LeaderCoreConfig::new("lead".parse().unwrap()));
    let mut maps = Vec::new();
    world.run(&mut leader, |_, map| maps.push(map.clone()));
    assert!(!world.guidance.is_empty());
    assert!(world.guidance.windows(2).all(|w| w[1].0 - w[0].0 >= 5.0), "{:?}", world.guidance);
    for (at_s, guidance) in &world.guidance {
        println!("{at_s:.1} {guidance:?}");
        assert!(guidance.error_there_m < 0.86 * guidance.error_here_m);
        let goal = guidance.team_from_goal.position();
        let map = maps.iter().rev().find(|m| m.stamp <= clock(*at_s)).unwrap();
        for robot in &map.robots {
            let pose = robot.team_from_body.unwrap();
            let apart = (pose.position() - goal).norm();
            assert!(robot.id == guidance.robot || apart > 0.6, "{} {apart}", robot.id);
            assert!(robot.id != guidance.robot || apart < 3.3, "{apart}");
        }
    }
}

#[test]
fn who_goes_where_it_is_told_sees_the_error_fall() {
    // Before and after: squares of errors and how many.
    let mut errors = [(0.0, 0u32); 2];
    for seed in 500..516 {
        let mut world = badly_placed(42.0, Some(18.0), seed);
        let mut leader = Leader::new(LeaderCoreConfig::new("lead".parse().unwrap()));
        world.run(&mut leader, |world, map| {
            let t = map.stamp.seconds_since(clock(0.0));
            let part = match world.arrived_s {
                None if t > 6.0 => 0,
                Some(arrived_s) if t > arrived_s + 4.0 => 1,
                _ => return,
            };
            // The team's frame, by a robot that has not gone anywhere.
            let stays = |k: &usize| world.robots[*k].pose == PLACES[*k];
            let placed = |k: usize| {
                let robot = map.robots.iter().find(|r| r.id == world.robots[k].id)?;
                let [x, y, heading] = PLACES[k];
                Some(protocol::frames::Pose2::new(x, y, heading) * robot.team_from_body?.inverse())
            };
            let Some(frame) = (0..PLACES.len()).filter(stays).find_map(placed) else { return };
            let (_, people) = world.truth_at(t);
            for target in &map.targets {
                let at =
                    (frame * protocol::frames::Pose2::new(target.position_m[0], target.position_m[1], 0.0)).position();
                let away = people.iter().map(|p| (Vector2::from(p.position) - at).norm()).fold(f64::MAX, f64::min);
                if away < 0.5 {
                    errors[part] = (errors[part].0 + away * away, errors[part].1 + 1);
                }
            }
        });
        let told = &world.guidance.iter().find(|(at_s, _)| *at_s > 18.0).unwrap().1;
        println!("{seed}: {} → {} expected, {errors:?}", told.error_here_m, told.error_there_m);
    }
    let [before, after] = errors.map(|(squares, n)| (squares / f64::from(n.max(1))).sqrt());
    println!("achieved {before} → {after}");
    assert!(errors[1].1 > 200, "{errors:?}");
    assert!(after < 0.9 * before, "{before} {after}");
}
