//! A reduced form of the statistics.

use super::*;

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
