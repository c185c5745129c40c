//! Robots are told who is round them.

use super::world::{Settings, World};
use super::*;

#[test]
fn every_standing_robot_is_told_where_people_are_in_its_own_frame_and_time() {
    let settings = Settings { robots: 3, drives: vec![(1, 10.0, 14.0)], duration_s: 20.0, ..Settings::default() };
    let mut world = World::new(settings, 17);
    let mut leader = Leader::new(LeaderCoreConfig::new("lead".parse().unwrap()));
    world.run(&mut leader, |_, _| {});
    for robot in 0..3 {
        let told: Vec<_> = world.neighbours.iter().filter(|(k, at_s, ..)| *k == robot && *at_s > 6.0).collect();
        let share = |what: &dyn Fn(f64, bool) -> bool| {
            told.iter().filter(|(_, _, away_m, track)| what(*away_m, *track)).count() as f64 / told.len() as f64
        };
        let (near, named) = (share(&|away_m, _| away_m < 0.5), share(&|_, track| track));
        println!(
            "robot {robot}: {} neighbours, {near:.3} within 0.5 m of somebody, {named:.3} with a track",
            told.len()
        );
        // The one that drove follows nobody until it has stood for a while.
        let least_named = if robot == 1 { 0.5 } else { 0.8 };
        assert!(told.len() > 200 && near > 0.93 && named > least_named);
        let driving = |at_s: f64| robot == 1 && (10.5..13.9).contains(&at_s);
        assert!(!told.iter().any(|(_, at_s, ..)| driving(*at_s)), "a robot that moves has no place to look from");
    }
}

#[test]
fn whom_a_robot_does_not_see_it_is_told_of_where_somebody_is() {
    let mut told = Vec::new();
    for seed in 60..64 {
        let mut world = World::new(Settings::unkind(), seed);
        let mut leader = Leader::new(LeaderCoreConfig::new("lead".parse().unwrap()));
        world.run(&mut leader, |_, _| {});
        told.extend(
            world
                .neighbours
                .iter()
                .filter(|(_, at_s, _, track)| *at_s > 6.0 && !track)
                .map(|(_, _, away_m, _)| *away_m),
        );
    }
    let near = told.iter().filter(|away_m| **away_m < 0.5).count() as f64 / told.len() as f64;
    println!("{} neighbours without a track, {near:.3} within 0.5 m of somebody", told.len());
    assert!(told.len() > 200 && near > 0.9);
}
