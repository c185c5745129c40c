use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

use super::*;

const SIGMA: f64 = 8e-4;

fn pose(x: f64, y: f64, deg: f64) -> Pose2 {
    Pose2::new(x, y, deg.to_radians())
}

/// What each robot sees of all others, from geometry, in an order that tells nothing.
fn views(truth: &[Pose2], rng: &mut ChaCha8Rng) -> Vec<View> {
    let noise = Normal::new(0.0, SIGMA).unwrap();
    let mut views = Vec::new();
    for (i, a) in truth.iter().enumerate() {
        let mut slots = Vec::new();
        for (_, b) in truth.iter().enumerate().filter(|(j, _)| *j != i) {
            let (dx, dy) = (b.x_m - a.x_m, b.y_m - a.y_m);
            slots.push(SlotMean {
                bearing_rad: wrap(dy.atan2(dx) - a.heading_rad + noise.sample(rng)),
                bearing_var: SIGMA * SIGMA,
                width_rad: Some((2.0 * (0.2 / dx.hypot(dy)).asin() + noise.sample(rng), SIGMA * SIGMA)),
                frame_var: (0.0, 0.0),
                robot: None,
            });
        }
        slots.sort_by(|a, b| a.bearing_rad.total_cmp(&b.bearing_rad));
        let known = if i == 0 { Known::Fixed(truth[0]) } else { Known::Nothing };
        views.push(View { robot: i, slots, known, doubt: None });
    }
    views
}

fn assert_true(naming: &Naming, truth: &[Pose2]) {
    assert_eq!(naming.placed.len(), truth.len(), "{naming:?}");
    for (robot, found) in &naming.placed {
        assert!((found.position() - truth[*robot].position()).norm() < 0.1, "{naming:?}");
        assert!(wrap(found.heading_rad - truth[*robot].heading_rad).abs() < 0.02);
    }
}

#[test]
fn three_robots_anywhere_are_named_rightly_or_called_ambiguous() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let (mut placed, runs) = (0, 300);
    for _ in 0..runs {
        let truth: Vec<Pose2> = loop {
            let t: Vec<Pose2> = (0..3)
                .map(|_| pose(rng.random_range(0.0..7.0), rng.random_range(0.0..5.0), rng.random_range(-180.0..180.0)))
                .collect();
            let apart = |a: usize, b: usize| (t[a].position() - t[b].position()).norm() > 1.0;
            if apart(0, 1) && apart(1, 2) && apart(0, 2) {
                break t;
            }
        };
        let naming = name(&views(&truth, &mut rng), 5e-4, 14.0);
        if naming.placed.len() == 3 {
            assert_true(&naming, &truth);
            placed += 1;
        }
    }
    assert!(placed > runs * 9 / 10, "only {placed} of {runs} placed");
}

#[test]
fn an_equilateral_triangle_is_ambiguous_and_not_guessed() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let truth = [pose(0.0, 0.0, 10.0), pose(3.0, 0.0, 130.0), pose(1.5, 1.5 * 3f64.sqrt(), -70.0)];
    let naming = name(&views(&truth, &mut rng), 5e-4, 14.0);
    assert_eq!(naming.placed.iter().map(|p| p.0).collect::<Vec<_>>(), vec![0]);
    assert_eq!(naming.ambiguous, vec![1, 2]);
    assert!(naming.names.iter().flatten().all(Option::is_none));
}

#[test]
fn a_robot_that_moved_and_is_remembered_breaks_the_symmetry() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let truth = [pose(0.0, 0.0, 10.0), pose(3.0, 0.0, 130.0), pose(1.5, 1.5 * 3f64.sqrt(), -70.0)];
    let mut views = views(&truth, &mut rng);
    views[1].known = Known::Hint(pose(3.1, 0.1, 133.0), Matrix3::from_diagonal(&Vector3::new(0.04, 0.04, 0.01)));
    assert_true(&name(&views, 5e-4, 14.0), &truth);
}

#[test]
fn false_sightings_get_no_name() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let truth = [pose(0.0, 0.0, 10.0), pose(3.4, 0.5, 130.0), pose(1.0, 2.6, -70.0)];
    let mut views = views(&truth, &mut rng);
    for (view, bearing_rad) in views.iter_mut().zip([2.5, -0.4, 1.9]) {
        let width_rad = Some((2.0 * (0.2f64 / 2.2).asin(), SIGMA * SIGMA));
        view.slots.push(SlotMean {
            bearing_rad,
            bearing_var: SIGMA * SIGMA,
            width_rad,
            frame_var: (0.0, 0.0),
            robot: None,
        });
    }
    let naming = name(&views, 5e-4, 14.0);
    assert_true(&naming, &truth);
    assert!(naming.names.iter().all(|n| n.last() == Some(&None)));
}

#[test]
fn ten_robots_are_named_in_reasonable_time() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut truth: Vec<Pose2> = Vec::new();
    while truth.len() < 10 {
        let p = pose(rng.random_range(0.0..12.0), rng.random_range(0.0..9.0), rng.random_range(-180.0..180.0));
        if truth.iter().all(|q| (q.position() - p.position()).norm() > 1.2) {
            truth.push(p);
        }
    }
    assert_true(&name(&views(&truth, &mut rng), 5e-4, 14.0), &truth);
}

#[test]
fn one_robot_that_nobody_sees_stays_without_a_place() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let truth = [pose(0.0, 0.0, 0.0), pose(3.0, 0.5, 130.0), pose(1.0, 2.8, -70.0)];
    let mut views = views(&truth[..2], &mut rng);
    views.push(View { robot: 2, slots: Vec::new(), known: Known::Nothing, doubt: None });
    let naming = name(&views, 5e-4, 14.0);
    assert_eq!(naming.placed.iter().map(|p| p.0).collect::<Vec<_>>(), vec![0, 1]);
}
