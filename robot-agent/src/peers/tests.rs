//! Pictures with known truth.

use std::f64::consts::PI;
use std::time::Instant;

use protocol::angle::difference;
use protocol::marker::{Look, Marker, Ring};

use super::test_scene::{self, Dice, Scene};
use super::*;

pub(super) fn marker() -> Marker {
    let rings = [0.85, 0.10, 0.85, 0.10]
        .iter()
        .enumerate()
        .map(|(k, r)| Ring { height_m: [0.1 + 0.1 * k as f64, 0.2 + 0.1 * k as f64], reflectance: *r })
        .collect();
    Marker::Cylinder {
        radius_m: 0.2,
        height_m: [0.1, 0.5],
        look: Some(Look { rings, bar_width_deg: None, beacon: None }),
    }
}

pub(super) fn grid() -> Grid {
    let tan = |deg: f64| deg.to_radians().tan();
    Grid { width: 1080, height: 162, seam_rad: PI, tangents: [tan(20.0), tan(-15.0)] }
}

pub(super) fn camera() -> MountedCamera {
    MountedCamera::reference(test_scene::CAMERA_HEIGHT_M)
}

fn detector() -> PeerDetector {
    PeerDetector::new(&camera(), grid(), &[marker()])
}

/// Sees robots at (bearing, range) in a room with whatever else `others` holds.
fn sighted(seed: u64, robots: &[(f64, f64)], others: Vec<test_scene::Pillar>) -> Vec<Peer> {
    let mut scene = Scene::room(seed, 1.0).with_walls(6.5);
    scene.pillars = others;
    for (bearing, range) in robots {
        scene.pillars.extend(test_scene::robot(range * bearing.cos(), range * bearing.sin()));
    }
    let raw = scene.picture(2.0, seed);
    detector().detect(&raw, &test_scene::panorama(&raw))
}

fn nearest(peers: &[Peer], bearing: f64) -> &Peer {
    let distance = |p: &&Peer| (difference(p.bearing_rad, bearing).abs() * 1e9) as u64;
    peers.iter().min_by_key(distance).expect("no peer at all")
}

/// χ²₂ at 0.1 %.
fn assert_place(peer: &Peer, bearing: f64, range: f64) {
    let error = nalgebra::Vector2::new(difference(peer.bearing_rad, bearing), peer.range_m - range);
    let nees = (error.transpose() * peer.covariance.try_inverse().unwrap() * error)[0];
    assert!(nees < 13.8, "{range} m: error {error:?}, nees {nees}");
}

fn assert_consistent(peer: &Peer, bearing: f64, range: f64) {
    assert_place(peer, bearing, range);
    for feature in &peer.features {
        let sign = if feature.part == FeaturePart::Left { 1.0 } else { -1.0 };
        let error = difference(feature.bearing_rad, bearing + sign * (0.2 / range).asin());
        assert!(error.abs() < 4.0 * feature.sigma_rad, "{range} m: {feature:?} is off by {error}");
    }
}

#[test]
fn robots_from_1_to_6_metres_are_measured_within_their_sigmas_across_the_seam() {
    let robots = [(3.1, 1.05), (-1.6, 2.2), (0.4, 3.7), (1.9, 5.8)];
    let peers = sighted(5, &robots, vec![]);
    assert_eq!(peers.len(), 4, "{peers:?}");
    for (bearing, range) in robots {
        let peer = nearest(&peers, bearing);
        assert_eq!(peer.features.len(), 2, "{range} m");
        assert_consistent(peer, bearing, range);
        assert!((peer.range_m / range - 1.0).abs() < 0.015, "{range} m: {}", peer.range_m);
        assert!(difference(peer.bearing_rad, bearing).abs() < 0.06_f64.to_radians());
    }
}

#[test]
fn robots_below_a_metre_are_measured_by_the_upper_end_of_their_marker() {
    let robots = [(-0.7, 0.78)];
    let peers = sighted(7, &robots, vec![]);
    assert_eq!(peers.len(), 1, "{peers:?}");
    for (bearing, range) in robots {
        let peer = nearest(&peers, bearing);
        assert_consistent(peer, bearing, range);
        assert!((peer.range_m / range - 1.0).abs() < 0.01, "{range} m: {}", peer.range_m);
    }
}

const CODE: [[f64; 2]; 6] = [[60.0, 15.0], [120.0, 15.0], [157.5, 7.5], [187.5, 7.5], [247.5, 22.5], [345.0, 30.0]];

fn coded(robot: &str, turn_deg: f64) -> (Option<RobotId>, Marker) {
    let Marker::Cylinder { radius_m, height_m, look } = marker() else { panic!() };
    let look = look.map(|look| Look { bar_width_deg: Some(15.0), ..look });
    let azimuths_deg = CODE.iter().enumerate().map(|(n, [a, _])| a + turn_deg * f64::from(n as u8)).collect();
    let code = Some(CODE.iter().map(|[_, half]| (half / 7.5) as u8).collect());
    (RobotId::new(robot).ok(), Marker::Bars { radius_m, azimuths_deg, height_m, code, look })
}

/// Robots at (bearing, range, heading) with the bars of r2; r3 wears others, r4 only rings.
fn sighted_bars(seed: u64, robots: &[(f64, f64, f64)], others: Vec<test_scene::Pillar>) -> Vec<Peer> {
    let mut scene = Scene::room(seed, 1.0).with_walls(6.5);
    scene.pillars = others;
    for (bearing, range, heading) in robots {
        let mut body = test_scene::robot(range * bearing.cos(), range * bearing.sin());
        body[0].side = test_scene::Paint::Barred(*heading, &CODE);
        scene.pillars.extend(body);
    }
    let raw = scene.picture(2.0, seed);
    let camera = camera();
    let fellows = [coded("r2", 0.0), coded("r3", 2.0), (RobotId::new("r4").ok(), marker())];
    let mut detector = PeerDetector::for_team(&camera, grid(), &fellows);
    assert_eq!((detector.finders.len(), detector.unsupported()), (2, &[][..]));
    detector.detect(&raw, &test_scene::panorama(&raw))
}

#[test]
fn coded_bars_say_who_it_is_and_which_way_it_looks() {
    let robots = [(0.3, 1.4, 2.0), (2.2, 2.3, -1.1), (-2.0, 3.2, 0.4)];
    let peers = sighted_bars(19, &robots, vec![]);
    assert_eq!(peers.len(), 3, "{peers:?}");
    for (bearing, range, heading) in robots {
        let peer = nearest(&peers, bearing);
        assert_eq!((peer.kind, peer.robot), (Marker::BARS, RobotId::new("r2").ok()), "{range} m");
        let [found, sigma] = peer.heading_rad.unwrap();
        let error = difference(found, heading);
        assert!(error.abs() < 4.0 * sigma && error.abs() < 0.07, "{range} m: heading off by {error}, sigma {sigma}");
        assert!((peer.range_m / range - 1.0).abs() < 0.015, "{range} m: {}", peer.range_m);
        let numbers = peer.features.iter().filter(|f| matches!(f.part, FeaturePart::Bar(Some(_)))).count();
        assert!(numbers >= 1, "{range} m: {:?}", peer.features);
    }
}

#[test]
fn plain_rings_beside_barred_fellows_are_a_cylinder_without_a_heading() {
    let others = test_scene::robot(1.5, 1.0);
    let peers = sighted_bars(23, &[], others);
    assert_eq!(peers.len(), 1, "{peers:?}");
    assert_eq!((peers[0].kind, peers[0].robot, peers[0].heading_rad), (Marker::CYLINDER, None, None));
    assert_consistent(&peers[0], 1.0_f64.atan2(1.5), 1.0_f64.hypot(1.5));
}

#[test]
fn a_room_with_people_in_striped_clothes_and_no_robot_has_no_peer() {
    let mut others = Vec::new();
    for k in 0..5 {
        let (b, d) = (f64::from(k) * 1.25 - 2.9, 1.6 + 0.8 * f64::from(k));
        let mut person = test_scene::person(d * b.cos(), d * b.sin(), b, k as u64);
        for leg in &mut person[..2] {
            // As much like the rings as cloth can be.
            leg.side = test_scene::Paint::Stripes(0.1, 0.85, 0.2);
        }
        others.extend(person);
    }
    assert_eq!(sighted(9, &[], others), vec![]);
}

/// Something round that stands on the floor at (bearing, distance).
fn post((bearing, away): (f64, f64), radius_m: f64, high_m: f64, side: test_scene::Paint) -> test_scene::Pillar {
    let (x_m, y_m) = (away * bearing.cos(), away * bearing.sin());
    test_scene::Pillar { x_m, y_m, radius_m, height_m: [0.0, high_m], side, top: 0.3 }
}

#[test]
fn a_robot_half_hidden_by_a_person_keeps_its_free_outline() {
    let (bearing, range) = (0.8_f64, 3.0_f64);
    let half = (0.2 / range).asin();
    let (b, d) = (bearing + half, 1.8);
    let post = post((b, d), 0.08, 1.6, test_scene::Paint::Texture(3, 0.4, 0.4, 15.0));
    let peers = sighted(11, &[(bearing, range)], vec![post]);
    assert_eq!(peers.len(), 1, "{peers:?}");
    let parts: Vec<_> = peers[0].features.iter().map(|f| f.part).collect();
    assert_eq!(parts, [FeaturePart::Right]);
    assert_consistent(&peers[0], bearing, range);
}

#[test]
fn a_robot_behind_a_box_is_found_by_what_shows_over_it() {
    // What is below 0.2 m is behind the box: the lowest ring.
    let (bearing, range, away) = (0.5_f64, 2.9, 1.8);
    let low = post((bearing, away), 0.25, 0.3, test_scene::Paint::Plain(0.4));
    let low = test_scene::Pillar { top: 0.5, ..low };
    let peers = sighted(31, &[(bearing, range)], vec![low]);
    assert_eq!(peers.len(), 1, "{peers:?}");
    assert_consistent(&peers[0], bearing, range);
}

#[test]
fn robots_half_behind_other_robots_are_found_where_they_are() {
    for (n, (near, far)) in [(1.2, 2.0), (1.6, 2.6), (2.0, 3.0)].into_iter().enumerate() {
        for side in [-1.0, 1.0] {
            let seed = 40 + n as u64;
            // The middle of the far one is at the near one's outline.
            let places = [(0.7_f64, near), (0.7 + side * (0.2_f64 / near).asin(), far)];
            let peers = sighted(seed, &places, vec![]);
            assert_eq!(peers.len(), 2, "{places:?}: {peers:?}");
            for (bearing, range) in places {
                assert_consistent(nearest(&peers, bearing), bearing, range);
            }
        }
    }
}

#[test]
fn near_robots_of_which_one_ring_is_in_view_are_measured_in_the_dark() {
    for (n, (bearing, range)) in [(0.5_f64, 0.65), (-2.6, 0.8), (2.0, 0.72)].into_iter().enumerate() {
        let seed = 70 + n as u64;
        let mut scene = Scene::room(seed, 1.0);
        // The upper end is at 20 grey levels or so.
        scene.ambient *= 0.6;
        scene.lamps.iter_mut().for_each(|lamp| lamp[3] *= 0.6);
        scene.pillars.extend(test_scene::robot(range * bearing.cos(), range * bearing.sin()));
        let raw = scene.picture(2.0, seed);
        let mut detector = detector();
        detector.take_fits();
        detector.detect(&raw, &test_scene::panorama(&raw));
        let fits = detector.take_fits();
        let best = fits.iter().max_by(|a, b| a.traits.log_odds().total_cmp(&b.traits.log_odds())).unwrap();
        assert_consistent(&best.peer, bearing, range);
        assert!(best.traits.log_odds() > 0.0, "{bearing} {range}: {best:?}");
    }
}

#[test]
fn rings_that_go_on_beside_a_body_are_told() {
    let goes_on = |beside: &[f64]| {
        let mut scene = Scene::room(61, 0.3);
        scene.pillars.extend(test_scene::robot(2.0, 0.0));
        scene.pillars.extend(beside.iter().flat_map(|y_m| test_scene::robot(2.0, *y_m)));
        let raw = scene.picture(2.0, 61);
        let mut detector = detector();
        detector.take_fits();
        detector.detect(&raw, &test_scene::panorama(&raw));
        let at = Basis::Rings.names().iter().position(|name| *name == "goes on").unwrap();
        let is_there = |fit: &&Fit| {
            fit.traits.basis == Basis::Rings
                && fit.peer.bearing_rad.abs() < 0.01
                && (fit.peer.range_m - 2.0).abs() < 0.05
        };
        let shares: Vec<f64> = detector.take_fits().iter().filter(is_there).map(|fit| fit.traits.values[at]).collect();
        assert!(!shares.is_empty());
        shares.into_iter().fold(0.0, f64::max)
    };
    assert!(goes_on(&[]) < 0.2 && goes_on(&[-0.4, 0.4]) > 0.8, "{} {}", goes_on(&[]), goes_on(&[-0.4, 0.4]));
}

#[test]
fn every_fit_says_something_of_each_trait() {
    let mut scene = Scene::room(51, 1.0);
    scene.pillars.extend(test_scene::robot(1.4, 0.9));
    scene.pillars.extend(test_scene::robot(-0.6, -0.5));
    let raw = scene.picture(2.0, 51);
    let mut detector =
        PeerDetector::for_team(&camera(), grid(), &[coded("r2", 0.0), (RobotId::new("r4").ok(), marker())]);
    detector.take_fits();
    detector.detect(&raw, &test_scene::panorama(&raw));
    let fits = detector.take_fits();
    for basis in [Basis::Rings, Basis::CylinderEnd] {
        assert!(fits.iter().any(|fit| fit.traits.basis == basis), "{basis:?}");
    }
    // All but the mast shows the far side of the upper end.
    let by_end = fits.iter().filter(|fit| fit.traits.basis == Basis::CylinderEnd && fit.is_taken);
    let at = Basis::CylinderEnd.names().iter().position(|name| *name == "lid").unwrap();
    let lid = by_end.map(|fit| fit.traits.values[at]).fold(0.0, f64::max);
    assert!(lid > 0.7, "{lid}");
    for fit in &fits {
        assert_eq!(fit.traits.values.len(), fit.traits.basis.names().len(), "{:?}", fit.traits.basis);
        assert!(fit.traits.values.iter().all(|value| value.is_finite()), "{fit:?}");
    }
}

#[test]
fn a_robot_with_bars_is_read_beside_a_dark_leg_before_its_middle() {
    let mut named = 0;
    for (seed, (bearing, range, aside)) in (60..).zip([(0.5_f64, 2.4_f64, 0.0), (0.5, 1.5, 0.03), (-2.0, 3.0, -0.02)]) {
        // As even and as dark as the bars' black, and wider than any of their borders.
        let leg = post((bearing + aside, 0.7 * range), 0.035, 0.75, test_scene::Paint::Plain(0.1));
        let peers = sighted_bars(seed, &[(bearing, range, 1.3)], vec![leg]);
        assert_eq!(peers.len(), 1, "{range} m: {peers:?}");
        let peer = &peers[0];
        assert_eq!(peer.kind, Marker::BARS, "{range} m");
        assert_place(peer, bearing, range);
        assert!((peer.range_m / range - 1.0).abs() < 0.02, "{range} m: {peer:?}");
        assert!(peer.robot.is_none_or(|robot| robot.to_string() == "r2"), "{range} m: {:?}", peer.robot);
        named += usize::from(peer.robot.is_some());
    }
    assert!(named >= 1);
}

#[test]
fn a_half_hidden_plain_robot_is_found_in_a_team_that_wears_bars() {
    let (x, y) = (1.9_f64, 1.1_f64);
    let (bearing, range) = (y.atan2(x), x.hypot(y));
    // Before its left half.
    let (b, d) = (bearing + (0.2 / range).asin(), 1.2);
    let mut others = test_scene::robot(x, y);
    others.push(post((b, d), 0.1, 1.6, test_scene::Paint::Plain(0.45)));
    let peers = sighted_bars(23, &[], others);
    assert_eq!(peers.len(), 1, "{peers:?}");
    assert_eq!((peers[0].robot, peers[0].heading_rad), (None, None));
    assert_consistent(&peers[0], bearing, range);
}

#[test]
fn a_sighting_carries_the_features_right_first_with_elevations_once() {
    let peers = sighted(13, &[(0.0, 2.5)], vec![]);
    let sighting = peers[0].to_sighting();
    let parts: Vec<_> = sighting.features.iter().map(|f| f.part).collect();
    assert_eq!(parts, [FeaturePart::Right, FeaturePart::Left]);
    assert!(sighting.features[0].elevation.is_some() && sighting.features[1].elevation.is_none());
    assert!(sighting.features[0].sigma.value() >= peers[0].features[0].sigma_rad);
}

#[test]
fn a_stream_leaves_alone_what_was_no_robot_and_finds_a_robot_that_comes() {
    let mut scene = Scene::room(11, 1.0).with_walls(4.5);
    let mut stream = detector();
    let mut look = |scene: &Scene, frame: u64| {
        let raw = scene.picture(2.0, frame);
        let peers =
            stream.follow(&raw, &test_scene::panorama(&raw), Timestamp::from_secs_f64(100.0 + 0.1 * frame as f64));
        (peers, stream.looks())
    };
    let (_, first) = look(&scene, 0);
    let later: usize = (1..41).map(|frame| look(&scene, frame).1).sum();
    // Nobody is known, so every frame is searched.
    assert!(first >= 20 && later < 40 * first / 5, "{first} places at first, {later} in forty more frames");
    scene.pillars.extend(test_scene::robot(1.8, -0.9));
    let (peers, _) = look(&scene, 41);
    assert_consistent(nearest(&peers, (-0.9f64).atan2(1.8)), (-0.9f64).atan2(1.8), 1.8f64.hypot(0.9));
}

#[test]
fn following_a_stream_measures_as_single_pictures_do_and_predicts_nothing() {
    let scene = Scene::room(17, 0.5).with_walls(6.5);
    let scene = Scene { pillars: test_scene::robot(2.0, 1.0), ..scene };
    let (mut single, mut stream) = (detector(), detector());
    for frame in 0..4 {
        let raw = scene.picture(2.0, frame);
        let panorama = test_scene::panorama(&raw);
        let now = Timestamp::from_secs_f64(0.1 * frame as f64);
        for peers in [single.detect(&raw, &panorama), stream.follow(&raw, &panorama, now)] {
            assert_eq!(peers.len(), 1, "frame {frame}");
            assert_consistent(&peers[0], 1.0_f64.atan2(2.0), 5.0_f64.sqrt());
        }
    }
    let empty = vec![0; test_scene::WIDTH * test_scene::HEIGHT];
    let later = Timestamp::from_secs_f64(0.4);
    assert_eq!(
        stream.follow(&empty, &test_scene::panorama(&empty), later),
        vec![],
        "a robot that is gone is not predicted"
    );
}

#[test]
fn pictures_of_another_size_have_no_peers_and_do_no_harm() {
    assert_eq!(detector().detect(&[0; 100], &[0; 100]), vec![]);
    assert_eq!(detector().follow(&[], &[], Timestamp::default()), vec![]);
}

#[test]
fn markers_without_rings_are_reported_and_the_others_work() {
    let plain = Marker::Cylinder { radius_m: 0.2, height_m: [0.1, 0.5], look: None };
    let camera = MountedCamera::reference(test_scene::CAMERA_HEIGHT_M);
    let detector = PeerDetector::new(&camera, grid(), &[plain, marker(), marker()]);
    assert_eq!(detector.unsupported(), [PeerError::NoLook]);
    assert_eq!(detector.finders.len(), 2, "of its whole and of its upper part");
}

/// Figures over random rooms, for the notes: detection, errors in pixels and per cent, consistency.
#[test]
#[ignore = "a measurement, minutes long: cargo test --release -p robot-agent peers::tests::measure -- --ignored --nocapture"]
fn measure() {
    let rooms: u64 = std::env::var("ROOMS").ok().and_then(|n| n.parse().ok()).unwrap_or(40);
    let clutter: f64 = std::env::var("CLUTTER").ok().and_then(|n| n.parse().ok()).unwrap_or(1.0);
    let noise: f64 = std::env::var("NOISE").ok().and_then(|n| n.parse().ok()).unwrap_or(2.0);
    let verbose = std::env::var("VERBOSE").is_ok();
    let mut detector = detector();
    let mut bins = vec![Vec::new(); 7];
    let mut false_sightings = Vec::new();
    let (mut micros, mut tracked, mut searched, mut placed) = (0u128, 0u128, 0u128, [0usize; 7]);
    for seed in 0..rooms {
        let mut dice = Dice(seed * 7919 + 13);
        let mut scene = Scene::room(seed, clutter);
        scene.pillars.retain(|p| p.x_m.hypot(p.y_m) > 0.8);
        let mut truth = Vec::new();
        for k in 0..3 {
            let bearing = dice.uniform(-PI, PI);
            let range = (dice.uniform(1.0_f64.ln(), 6.0_f64.ln())).exp();
            if truth.iter().any(|(b, _): &(f64, f64)| difference(*b, bearing).abs() < 0.5) && k > 0 {
                continue;
            }
            // Nothing of the clutter may stand before it.
            scene
                .pillars
                .retain(|p| difference(p.y_m.atan2(p.x_m), bearing).abs() > 0.3 || p.x_m.hypot(p.y_m) > range + 0.7);
            let (x, y) = (range * bearing.cos(), range * bearing.sin());
            if x > scene.walls_m[0] - 0.3
                || -x > scene.walls_m[1] - 0.3
                || y > scene.walls_m[2] - 0.3
                || -y > scene.walls_m[3] - 0.3
            {
                continue;
            }
            scene.pillars.extend(test_scene::robot(x, y));
            truth.push((bearing, range));
        }
        for k in 0..3 {
            let (b, d) = (dice.uniform(-PI, PI), dice.uniform(1.5, 5.0));
            if truth.iter().all(|(t, _)| difference(*t, b).abs() > 0.35) {
                scene.pillars.extend(test_scene::person(
                    d * b.cos(),
                    d * b.sin(),
                    dice.uniform(0.0, 3.0),
                    seed * 10 + k,
                ));
            }
        }
        let raw = scene.picture(noise, seed);
        let panorama = test_scene::panorama(&raw);
        detector.detect(&raw, &panorama);
        let start = Instant::now();
        let peers = detector.detect(&raw, &panorama);
        micros += start.elapsed().as_micros();
        let start = Instant::now();
        detector.find(&raw, None, None, &truth);
        tracked += start.elapsed().as_micros();
        let start = Instant::now();
        detector.finders[0].search_only(&panorama);
        searched += start.elapsed().as_micros();
        let mut used = vec![false; peers.len()];
        for (bearing, range) in &truth {
            let bin = (*range as usize).min(6);
            placed[bin] += 1;
            let hit = peers.iter().position(|p| {
                difference(p.bearing_rad, *bearing).abs() < 0.05 && (p.range_m / range - 1.0).abs() < 0.15
            });
            let Some(hit) = hit else {
                println!("room {seed}: missed at {:.1}° {range:.2} m", bearing.to_degrees());
                continue;
            };
            used[hit] = true;
            let p = &peers[hit];
            if verbose {
                println!(
                    "room {seed} {range:.2} m: {} features, error {:+.4} m sigma {:.4}, conf {:.2}",
                    p.features.len(),
                    p.range_m - range,
                    p.range_sigma_m(),
                    p.confidence
                );
            }
            bins[bin].push((*bearing, *range, p.clone()));
        }
        for (peer, used) in peers.iter().zip(&used) {
            if !used {
                if std::env::var("DUMP").is_ok() {
                    image::GrayImage::from_raw(1080, 162, panorama.clone())
                        .unwrap()
                        .save(format!("/tmp/peers_{seed}.png"))
                        .unwrap();
                }
                println!(
                    "room {seed}: false at {:.1}° {:.2} m ± {:.3}, conf {:.2} features {}",
                    peer.bearing_rad.to_degrees(),
                    peer.range_m,
                    peer.range_sigma_m(),
                    peer.confidence,
                    peer.features.len()
                );
                false_sightings.push(seed);
            }
        }
        if verbose {
            println!("places looked at closely {}", detector.looks());
        }
    }
    println!(
        "{:.0} µs a picture, search {:.0}, known only {:.0}, {} false in {rooms}",
        micros as f64 / rooms as f64,
        searched as f64 / rooms as f64,
        tracked as f64 / rooms as f64,
        false_sightings.len()
    );
    let rms = |v: &[f64]| (v.iter().map(|x| x * x).sum::<f64>() / v.len().max(1) as f64).sqrt();
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len().max(1) as f64;
    for (bin, found) in bins.iter().enumerate() {
        if placed[bin] == 0 {
            continue;
        }
        let (mut be, mut re, mut z, mut wide, mut zl, mut zh, mut ze, mut zel, mut es) =
            (vec![], vec![], vec![], vec![], vec![], vec![], vec![], vec![], vec![]);
        for (b, r, p) in found {
            let scale = 220.0;
            be.push(difference(p.bearing_rad, *b) * scale);
            re.push((p.range_m - r) / r * 100.0);
            let e = nalgebra::Vector2::new(difference(p.bearing_rad, *b), p.range_m - r);
            z.push((e.transpose() * p.covariance.try_inverse().unwrap() * e)[0] / 2.0);
            let half = (0.2 / r).asin();
            for f in &p.features {
                let sign = if f.part == FeaturePart::Left { 1.0 } else { -1.0 };
                let outward = sign * difference(f.bearing_rad, *b + sign * half);
                wide.push(outward * scale);
                zl.push(outward / f.sigma_rad);
                es.push(f.sigma_rad * scale);
                if let Some([low, high]) = f.elevation_rad {
                    let h = 0.6 + 0.004956;
                    let e = [low - (0.1_f64 - h).atan2(r - 0.2), high - (0.5_f64 - h).atan2(r - 0.2)];
                    zh.push(e[1] * 215.0);
                    ze.push(e[0] * 215.0);
                    zel.push(e[0] / f.elevation_sigma_rad);
                    zel.push(e[1] / f.elevation_sigma_rad);
                }
            }
        }
        println!(
            "{bin}-{} m: found {}/{}  two edges {}  bearing px rms {:.3}  range % bias {:+.2} rms {:.2}  nees {:.2} | edge outward px bias {:+.3} rms {:.3} sigma {:.3} z {:.2} | elev px low {:+.3} rms {:.3} high {:+.3} rms {:.3} z {:.2}",
            bin + 1,
            found.len(),
            placed[bin],
            found.iter().filter(|f| f.2.features.len() == 2).count(),
            rms(&be),
            mean(&re),
            rms(&re),
            mean(&z),
            mean(&wide),
            rms(&wide),
            mean(&es),
            rms(&zl),
            mean(&ze),
            rms(&ze),
            mean(&zh),
            rms(&zh),
            rms(&zel)
        );
    }
}

#[test]
fn more_plates_than_were_announced_must_be_beyond_doubt() {
    let find = |kind: u8, bearing_rad: f64, log_odds: f64| {
        let peer = Peer {
            kind,
            robot: None,
            bearing_rad,
            range_m: 2.0,
            covariance: Matrix2::identity() * 1e-4,
            heading_rad: None,
            confidence: 0.9,
            features: Vec::new(),
        };
        Find { peer, log_odds, half_m: 0.2, high_m: 0.4 }
    };
    let stay = |announced| -> Vec<f64> {
        let finds =
            vec![find(2, 0.1, 0.7), find(0, 0.9, 2.0), find(2, 2.0, 4.0), find(1, -1.0, 1.3), find(2, -2.0, 3.5)];
        as_announced(without_doubles(finds), announced).iter().map(|peer| peer.bearing_rad).collect()
    };
    // Likeliest first: a second plate that is beyond doubt stays though one was announced, a doubtful one does not.
    assert_eq!(stay(1), [2.0, -2.0, 0.9, -1.0]);
    assert_eq!(stay(3), [2.0, -2.0, 0.9, -1.0, 0.1]);
    // Cylinders are not counted: they stay by their own odds.
    assert_eq!(stay(0), [2.0, -2.0, 0.9, -1.0]);
}
