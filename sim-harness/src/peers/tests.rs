//! A reduced form of the statistics.

use super::*;
use crate::scenario::{Scenario, WearOf, WearSpec};

#[test]
fn robots_in_rooms_drawn_anew_are_found_where_they_are() {
    let plan = Plan {
        layouts: 3,
        pictures: 1,
        seed: 6,
        threads: 2,
        robots: true,
        team: Team::Mixed,
        camera: CameraSpec::default(),
    };
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
fn a_plate_so_near_that_one_stripe_shows_is_placed_between_what_front_and_back_would_mean() {
    let far = plate_seen(1.0);
    assert!(far.heading_rad.is_some() && far.features.len() == 2, "{far:?}");
    assert_place(&far, 1.0, 0.0..0.02);
    let near = plate_seen(0.68);
    assert!(near.heading_rad.is_none() && near.features.is_empty(), "{near:?}");
    assert_place(&near, 0.68, 0.05..0.09);
}

#[test]
fn a_turned_plate_of_which_one_edge_and_the_upper_end_show_is_where_it_is() {
    // Its columns are farther away than its plane, twice as far where it is turned by 60°. At 1.3 m and −52° it was 5 σ off, at 1.05 m
    // and 45°, where few columns show the edge, 4 σ and 3°.
    let places = [(1.05, 60.0), (1.17, -62.0), (1.17, 55.0), (1.3, -52.0), (1.05, 45.0), (1.1, 45.0), (0.9, -60.0)];
    for (range_m, turn_deg) in places {
        let seen = seen_behind_a_plate(&[[range_m, 0.0]], turn_deg, 1).concat();
        assert_eq!(seen.len(), 1, "{range_m} {turn_deg}: {seen:?}");
        assert_place(&seen[0], range_m, 0.0..0.03);
        let [heading, sigma] = seen[0].heading_rad.unwrap();
        let off = protocol::angle::difference(heading, (180.0 + turn_deg).to_radians());
        assert!(off.abs() < 3.5 * sigma && sigma < 0.04, "{range_m} {turn_deg}: {off} ± {sigma}");
    }
}

#[test]
fn a_turned_plate_three_metres_away_is_found_though_the_search_cannot_tell_its_turn() {
    for (range_m, turn_deg) in [(3.25, 42.0), (3.0, -50.0), (2.7, 20.0)] {
        let seen = seen_behind_a_plate(&[[range_m, 0.0]], turn_deg, 1).concat();
        assert_eq!(seen.len(), 1, "{range_m} {turn_deg}: {seen:?}");
        assert_place(&seen[0], range_m, 0.0..0.1);
    }
}

/// An empty room in which a robot sees others at (ahead, aside), metres, the first of which wears a plate, its front turned from it by an angle.
fn seen_behind_a_plate(places_m: &[[f64; 2]], turn_deg: f64, pictures: usize) -> Vec<Vec<robot_agent::peers::Peer>> {
    let mut scenario = Scenario::builtin("default").unwrap().unwrap();
    scenario.room.furniture.clear();
    scenario.robots.count = 1 + places_m.len();
    let others = places_m.iter().map(|[ahead_m, aside_m]| [ahead_m - 3.0, *aside_m, 180.0]);
    scenario.robots.poses = std::iter::once([-3.0, 0.0, 0.0]).chain(others).collect();
    scenario.robots.poses[1][2] += turn_deg;
    scenario.robots.drives.clear();
    let marker = WearSpec::Plate { width_m: 0.4, left_edge_m: 0.2, behind_m: 0.06 };
    scenario.robots.wear = vec![WearOf { robot: scenario.robot_ids()[1], marker, beacon: None }];
    scenario.people.count = 0;
    let eyes = Eyes::of(&scenario.camera).unwrap();
    trial::follow(&eyes, &scenario, pictures)
}

/// The one peer that is to be seen: one with a plate, so far straight ahead.
fn plate_seen(range_m: f64) -> robot_agent::peers::Peer {
    let mut seen = seen_behind_a_plate(&[[range_m, 0.0]], 0.0, 1).concat();
    assert_eq!(seen.len(), 1, "{seen:?}");
    seen.remove(0)
}

#[test]
fn a_robot_behind_a_plate_is_found_and_followed_by_what_the_plate_leaves_of_it() {
    let place_m = [1.35_f64, 0.28];
    let seen = seen_behind_a_plate(&[[0.9, 0.0], place_m], 0.0, 4);
    for (n, peers) in seen.iter().enumerate() {
        assert_eq!(peers.len(), 2, "picture {n}: {peers:?}");
        let peer = peers.iter().find(|peer| peer.kind == protocol::marker::Marker::CYLINDER).unwrap();
        let chi2 = chi2(peer, (place_m[1].atan2(place_m[0]), place_m[0].hypot(place_m[1])));
        assert!(chi2 < 13.8, "picture {n}: {chi2} {peer:?}");
    }
}

/// Squared sigmas from a place (bearing, range).
fn chi2(peer: &robot_agent::peers::Peer, (bearing, range): (f64, f64)) -> f64 {
    let error = nalgebra::Vector2::new(peer.bearing_rad - bearing, peer.range_m - range);
    (error.transpose() * peer.covariance.try_inverse().unwrap() * error)[0]
}

/// Within three sigmas of a place straight ahead, and the range's sigma as it should be.
fn assert_place(peer: &robot_agent::peers::Peer, range_m: f64, sigma_m: std::ops::Range<f64>) {
    let chi2 = chi2(peer, (0.0, range_m));
    assert!(chi2 < 11.8 && sigma_m.contains(&peer.range_sigma_m()), "{chi2} {peer:?}");
}

#[test]
fn a_miss_says_what_spoke_most_against_a_robot() {
    use robot_agent::peers::Basis;
    // Much is as it should be; paint that should be black is or is not.
    let with_black = |black: f64| {
        let value = |name: &str| match name {
            "black" => black,
            "correlation" | "paint" | "contrast" => 4.0,
            "visible" => 1.0,
            "outlines" | "bars" | "range" => 2.0,
            "width" => 3.5,
            "bend unknown" => -3.0,
            _ => 0.0,
        };
        Traits::new(Basis::Rings, Basis::Rings.names().iter().map(|name| value(name)).collect(), Vec::new)
    };
    let (dark, bright) = (with_black(0.0), with_black(0.5));
    assert!(bright.log_odds() < dark.log_odds() - 2.0, "{} {}", bright.log_odds(), dark.log_odds());
    let text = statistics::doubt(&bright);
    assert!(text.starts_with("Rings fit, log-odds ") && text.contains(": black -"), "{text}");
    assert!(!statistics::doubt(&dark).contains(": black -"));
}
