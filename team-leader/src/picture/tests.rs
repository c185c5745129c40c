use protocol::id::{LeaderId, RobotId};

use super::*;

#[test]
fn a_target_is_drawn_where_it_is_and_its_ellipse_is_as_long_as_its_covariance_says() {
    // A view of 10 × 8 m on 1000 × 896 px: 100 px a metre, (0, 0) in the middle.
    let mut map = map();
    map.targets.push(target(1, [1.0, 2.05], [0.04, 0.0, 0.0001]));
    let picture = draw(&map, &Trails::default(), Some(&room()), 1000, 896);
    let ink = TARGETS[1];
    assert_eq!(*picture.get_pixel(600, 243), ink);
    // Half the long axis is 2.447 · 0.2 m = 48.9 px.
    let coloured = |u: u32| *picture.get_pixel(u, 243) != PAPER;
    assert!(coloured(600 - 48) && coloured(600 + 48));
    assert!(!coloured(600 - 53) && !coloured(600 + 53));
}

#[test]
fn north_is_up() {
    let mut map = map();
    map.targets.push(target(1, [0.0, 3.0], [0.0001, 0.0, 0.0001]));
    let picture = draw(&map, &Trails::default(), Some(&room()), 1000, 896);
    assert_eq!(*picture.get_pixel(500, 148), TARGETS[1]);
}

#[test]
fn an_empty_map_and_one_with_impossible_numbers_are_drawn_all_the_same() {
    let mut map = map();
    draw(&map, &Trails::default(), None, 10, 10);
    map.targets.push(target(1, [f64::NAN, 1e300], [f32::NAN, 0.0, 1e30]));
    draw(&map, &Trails::default(), None, 300, 300);
}

#[test]
fn a_trail_forgets_what_is_older_than_five_seconds() {
    let mut trails = Trails::default();
    for step in 0..100_u32 {
        let mut map = map();
        map.stamp = Timestamp(u64::from(step) * 100_000_000);
        map.targets.push(target(1, [f64::from(step), 0.0], [0.01, 0.0, 0.01]));
        trails.record(&map);
    }
    assert_eq!(trails.points[&TargetId(1)].len(), 51);
}

#[test]
fn components_stand_in_panels_of_their_own() {
    let mut map = map();
    for (name, component, x_m) in [("r1", 0, -1.0), ("r2", 0, 2.0), ("r3", 1, 0.0), ("r4", 1, 1.5), ("r5", 2, 0.0)] {
        map.robots.push(robot_at(name, component, [x_m, 0.5 * x_m]));
    }
    map.joint_covariance = vec![1e-4; 21 + 21 + 6];
    map.targets = vec![target(1, [0.0, 0.0], [0.04, 0.0, 0.01]), target(2, [0.5, -1.0], [0.02, 0.0, 0.02])];
    map.targets[1].component = 1;
    map.targets.iter_mut().for_each(|target| target.pose_jacobian = vec![0.0; 12]);
    let picture = draw(&map, &Trails::default(), None, 1000, 848);
    if let Some(folder) = std::env::var_os("PICTURES") {
        picture.save(std::path::Path::new(&folder).join("components.png")).unwrap();
    }
    // Two columns and two rows below 48 rows of text: each target in its own panel.
    let count = |ink: Rgb<u8>, [u, v]: [u32; 2]| {
        let pixels = (u..u + 500).flat_map(|u| (v..v + 400).map(move |v| (u, v)));
        pixels.filter(|(u, v)| *picture.get_pixel(*u, *v) == ink).count()
    };
    for (ink, own, other) in [(TARGETS[1], [0, 48], [500, 48]), (TARGETS[2], [500, 48], [0, 48])] {
        assert!(count(ink, own) > 10 && count(ink, other) == 0 && count(ink, [0, 448]) == 0);
    }
}

fn robot_at(name: &str, component: u8, [x_m, y_m]: [f64; 2]) -> MapRobot {
    MapRobot {
        id: RobotId::new(name).unwrap(),
        team_from_body: Some(Pose2::new(x_m, y_m, 0.3)),
        component,
        presence: Presence::Online,
        moving: false,
        clock_offset_s: None,
        lag_s: None,
        bias_rad: None,
        trust: protocol::message::Trust::Full,
        verifiable: true,
        trouble: None,
        observations_lost: 0,
    }
}

fn room() -> Overlay {
    // With the margin of 0.4 m: 10 × 8 m.
    Overlay { outlines: vec![vec![[-4.6, -3.6], [4.6, -3.6], [4.6, 3.6], [-4.6, 3.6]]], ..Overlay::default() }
}

fn map() -> TeamMap {
    TeamMap {
        leader: LeaderId::new("l").unwrap(),
        term: 1,
        sequence: 3,
        stamp: Timestamp(0),
        oldest_contribution_s: 0.0,
        status: MapStatus::Converged,
        explanation: String::new(),
        gauge: RobotId::new("r1").ok(),
        robots: Vec::new(),
        joint_covariance: Vec::new(),
        targets: Vec::new(),
        next_target: TargetId(1),
        alarms: Vec::new(),
    }
}

fn target(id: u32, at: [f64; 2], [xx, xy, yy]: [f32; 3]) -> MapTarget {
    MapTarget {
        id: TargetId(id),
        component: 0,
        position_m: [at[0], at[1], 0.9],
        velocity_mps: [0.0; 2],
        height_m: None,
        own_covariance: [xx, xy, 0.0, yy, 0.0, 0.01],
        pose_jacobian: Vec::new(),
        observers: Vec::new(),
        pair: None,
        age_s: 0.0,
    }
}
