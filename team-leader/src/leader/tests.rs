//! The leader against a synthetic world that shares no formula with it.

mod score;
mod world;

use score::Score;
use world::{Settings, World};

use super::*;

fn run(settings: &Settings, seed: u64) -> Score {
    let mut score = Score::default();
    let mut world = World::new(settings.clone(), seed);
    let mut leader = Leader::new(LeaderCoreConfig::new("lead".parse().unwrap()));
    world.run(&mut leader, |world, map| score.take(world, map));
    score
}

#[test]
fn the_default_team_meets_its_limits() {
    let mut total = Score::default();
    let seeds: u64 = std::env::var("SEEDS").map_or(4, |s| s.parse().unwrap());
    for seed in 0..seeds {
        let score = run(&Settings::default(), seed);
        println!("seed {seed}: {score}");
        total.merge(&score);
    }
    println!("all: {total}");
    assert!(total.standing_m() < 0.05 && total.standing_deg() < 0.5, "{total}");
    assert!(total.driving_m() < 0.2 && total.driving_deg() < 2.0, "{total}");
    assert!(total.targets_m() < 0.15, "{total}");
    assert!(total.coverage() > 0.95, "{total}");
    assert!(total.id_switches <= seeds as u32, "{total}");
    assert!((0.4..1.2).contains(&total.target_nees()), "{total}");
    assert!((0.2..1.2).contains(&total.robot_nees()), "{total}");
}
