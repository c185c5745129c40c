//! A reduced form of the statistics.

use super::*;
use crate::scenario::Scenario;

#[test]
fn robots_in_rooms_drawn_anew_are_found_where_they_are() {
    let plan = Plan { layouts: 3, pictures: 1, seed: 6, threads: 2, robots: true, camera: CameraSpec::default() };
    let report = statistics::report(&run(&plan, &|| {}).unwrap());
    assert_eq!((report.layouts, report.pictures), (3, 3));
    let cylinders: Vec<_> = report.cells.iter().filter(|c| c.marker == "cylinder").collect();
    let shown: usize = cylinders.iter().map(|c| c.half_seen.shown).sum();
    assert!(shown >= 1 && cylinders.iter().all(|c| c.half_seen.found == c.half_seen.shown), "{report:#?}");
    assert_eq!(report.without_robot, 0, "{:#?}", report.faults);
}

#[test]
fn robots_of_one_paint_are_told_apart_by_their_lamps_near_and_far() {
    let mut scenario = Scenario::builtin("beacons").unwrap().unwrap();
    scenario.robots.poses = vec![[-3.2, 0.0, 0.0], [-1.9, 0.8, 0.0], [1.9, -0.6, 90.0]];
    scenario.people.count = 0;
    let eyes = Eyes::of(&scenario.camera).unwrap();
    let seen = trial::follow(&eyes, &scenario, 32);
    let named = |robot: &str, from: usize| {
        let names =
            seen[from..].iter().map(|peers| peers.iter().filter(|p| p.robot.is_some_and(|r| r.to_string() == robot)));
        names.map(Iterator::count).sum::<usize>()
    };
    // A cycle takes 1.4 s, two are enough.
    assert_eq!((named("r2", 0).min(1), named("r2", 28), named("r3", 28)), (1, 4, 4), "{:?}", seen.last());
    for peer in seen.iter().flatten().filter(|p| p.robot.is_some()) {
        let right = if peer.range_m < 3.0 { "r2" } else { "r3" };
        assert_eq!(peer.robot.map(|r| r.to_string()).as_deref(), Some(right), "{peer:?}");
    }
}

#[test]
#[ignore = "a measurement: PICTURES=100 cargo test --workspace --lib peers::tests::measure -- --ignored --nocapture"]
fn measure() {
    let number = |name: &str, or: usize| std::env::var(name).ok().and_then(|n| n.parse().ok()).unwrap_or(or);
    let plan = Plan {
        layouts: number("LAYOUTS", 60),
        pictures: number("PICTURES", 1),
        seed: number("SEED", 0) as u64,
        threads: 2,
        robots: true,
        camera: CameraSpec::default(),
    };
    let report = statistics::report(&run(&plan, &|| {}).unwrap());
    println!("{}", crate::cli::peers::table(&report));
    for fault in &report.faults {
        println!("seed {} picture {}: {}", fault.seed, fault.picture, fault.what);
    }
}
