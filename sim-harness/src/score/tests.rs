//! The score against cases worked by hand.

use protocol::id::LeaderId;
use protocol::message::{MapRobot, MapStatus, Presence, Trust};

use super::*;

#[test]
fn the_gauge_robots_true_pose_brings_map_and_truth_together() {
    // The gauge stands at (1, 2) turned by 90°; a peer 3 m ahead of it is at (1, 5) in the room, (3, 0) in the team.
    let mut scorer = Scorer::default();
    let truth = truth(5.0, &[("r1", 1.0, 2.0, 90.0), ("r2", 1.0, 5.0, 180.0)], &[[1.0, 4.0]]);
    let mut map = map(&[("r1", 0.0, 0.0, 0.0), ("r2", 3.03, 0.04, 91.0)]);
    map.targets.push(target(7, [2.0, -0.1], [0.01, 0.0, 0.01]));
    let errors = scorer.add(&truth, &map).unwrap();
    let scores = Scores::new(&scorer, Run::default());
    close(scores.robots.position_rms_m, 0.05);
    close(scores.robots.heading_rms_deg, 1.0);
    close(scores.targets.rms_m, 0.1);
    close(scores.targets.coverage, 1.0);
    // e = (0, −0.1), σ = 0.1: eᵀP⁻¹e / 2 = 0.5.
    close(scores.targets.nees, 0.5);
    assert!((errors.targets[0].error_m[0]).abs() < 1e-9 && (errors.targets[0].error_m[1] + 0.1).abs() < 1e-9);
}

#[test]
fn nothing_counts_before_five_seconds_but_the_gauge_is_taken_at_its_first_map() {
    let mut scorer = Scorer::default();
    scorer.add(&truth(1.0, &[("r1", 1.0, 0.0, 0.0)], &[[2.0, 0.0]]), &map(&[("r1", 0.0, 0.0, 0.0)]));
    assert_eq!(Scores::new(&scorer, Run::default()).targets.coverage, None);
    // The gauge has driven 1 m since: its map pose says so, and the frame stays.
    let mut later = map(&[("r1", 1.0, 0.0, 0.0)]);
    later.targets.push(target(1, [1.0, 0.2], [0.01, 0.0, 0.01]));
    scorer.add(&truth(6.0, &[("r1", 2.0, 0.0, 0.0)], &[[2.0, 0.0]]), &later);
    close(Scores::new(&scorer, Run::default()).targets.rms_m, 0.2);
}

#[test]
fn gospa_of_a_pair_a_miss_and_a_ghost() {
    // One pair at 0.3 m, one person alone, one target alone: √(0.09 + ½ + ½).
    let mut scorer = Scorer::default();
    let mut map = map(&[("r1", 0.0, 0.0, 0.0)]);
    map.targets.push(target(1, [1.3, 0.0], [0.01, 0.0, 0.01]));
    map.targets.push(target(2, [-3.0, 0.0], [0.01, 0.0, 0.01]));
    scorer.add(&truth(5.0, &[("r1", 0.0, 0.0, 0.0)], &[[1.0, 0.0], [3.0, 3.0]]), &map);
    let scores = Scores::new(&scorer, Run::default());
    close(scores.targets.gospa_m, 1.09_f64.sqrt());
    close(scores.targets.coverage, 0.5);
    assert_eq!(scores.targets.false_tracks, 1);
}

#[test]
fn a_map_that_places_nothing_covers_nobody() {
    let mut scorer = Scorer::default();
    let mut map = map(&[]);
    map.gauge = None;
    scorer.add(&truth(5.0, &[("r1", 0.0, 0.0, 0.0)], &[[1.0, 0.0], [2.0, 0.0]]), &map);
    let scores = Scores::new(&scorer, Run::default());
    close(scores.targets.coverage, 0.0);
    close(scores.targets.gospa_m, 1.0);
    close(scores.robots.placed, 0.0);
}

#[test]
fn robot_errors_are_weighed_jointly_without_the_gauge() {
    // Variances 0.01 m², 0.01 m², 0.01 rad² of r2 alone; e = (0.1, 0.2, 0): (1 + 4) / 3.
    let mut scorer = Scorer::default();
    let mut map = map(&[("r1", 0.0, 0.0, 0.0), ("r2", 2.1, 0.2, 0.0)]);
    map.joint_covariance = vec![0.0; 21];
    for diagonal in [15, 18, 20] {
        map.joint_covariance[diagonal] = 0.01;
    }
    let truth = truth(5.0, &[("r1", 0.0, 0.0, 0.0), ("r2", 2.0, 0.0, 0.0)], &[]);
    scorer.add(&truth, &map);
    close(Scores::new(&scorer, Run::default()).robots.nees, 5.0 / 3.0);
}

#[test]
fn a_targets_covariance_holds_what_the_poses_add() {
    // J = I on (x, y) of r1: own 0.01 plus 0.03.
    let mut map = map(&[("r1", 0.0, 0.0, 0.0)]);
    map.joint_covariance = vec![0.03, 0.0, 0.0, 0.03, 0.0, 0.0];
    let mut target = target(1, [0.0, 0.0], [0.01, 0.0, 0.01]);
    target.pose_jacobian = vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    let covariance = map.covariance_of(&target).unwrap();
    assert!((covariance[(0, 0)] - 0.04).abs() < 1e-6 && covariance[(0, 1)].abs() < 1e-9);
}

#[test]
fn samples_are_two_seconds_apart() {
    let mut scorer = Scorer::default();
    for step in 0..=40 {
        let mut map = map(&[("r1", 0.0, 0.0, 0.0)]);
        map.targets.push(target(1, [1.0, 0.1], [0.01, 0.0, 0.01]));
        scorer.add(&truth(5.0 + 0.1 * f64::from(step), &[("r1", 0.0, 0.0, 0.0)], &[[1.0, 0.0]]), &map);
    }
    assert_eq!(Scores::new(&scorer, Run::default()).targets.nees_sum.dimensions, 3 * 2);
}

#[test]
fn a_driving_robot_is_reported_apart() {
    let mut scorer = Scorer::default();
    let mut truth = truth(5.0, &[("r1", 0.0, 0.0, 0.0), ("r2", 2.0, 0.0, 0.0), ("r3", 0.0, 2.0, 0.0)], &[]);
    truth.robots[1].drives = true;
    scorer.add(&truth, &map(&[("r1", 0.0, 0.0, 0.0), ("r2", 2.0, 0.5, 10.0), ("r3", 0.1, 2.0, 1.0)]));
    let scores = Scores::new(&scorer, Run::default());
    close(scores.robots.position_rms_m, 0.1);
    close(scores.robots.driving.position_rms_m, 0.5);
    assert_eq!(scores.robots.driving.moving_position_rms_m, None);
}

#[test]
fn several_seeds_give_mean_worst_and_pooled_nees() {
    let run = |error: f64| {
        let mut scorer = Scorer::default();
        let mut map = map(&[("r1", 0.0, 0.0, 0.0)]);
        map.targets.push(target(1, [1.0, error], [0.01, 0.0, 0.01]));
        scorer.add(&truth(5.0, &[("r1", 0.0, 0.0, 0.0)], &[[1.0, 0.0]]), &map);
        Scores::new(&scorer, Run::default())
    };
    let summary = Summary::new(vec![run(0.1), run(0.3)]).unwrap();
    close(summary.mean.targets.rms_m, 0.2);
    close(summary.worst.targets.rms_m, 0.3);
    // (1 + 9) / 4, and the worst alone 9 / 2.
    close(summary.mean.targets.nees, 2.5);
    close(summary.worst.targets.nees, 4.5);
}

fn close(value: Option<f64>, wanted: f64) {
    let value = value.unwrap();
    assert!((value - wanted).abs() < 1e-5, "{value} instead of {wanted}");
}

fn truth(time_s: f64, robots: &[(&str, f64, f64, f64)], people: &[[f64; 2]]) -> Truth {
    Truth {
        time_s,
        robots: robots
            .iter()
            .map(|(id, x, y, heading_deg)| RobotTruth {
                id: RobotId::new(id).unwrap(),
                room_from_body: Pose2::new(*x, *y, heading_deg.to_radians()),
                moving: false,
                drives: false,
            })
            .collect(),
        people: people
            .iter()
            .enumerate()
            .map(|(n, at)| PersonTruth { id: format!("p{}", n + 1), position_m: *at, coverable: true })
            .collect(),
    }
}

fn map(robots: &[(&str, f64, f64, f64)]) -> TeamMap {
    TeamMap {
        leader: LeaderId::new("l").unwrap(),
        term: 1,
        sequence: 0,
        stamp: Default::default(),
        oldest_contribution_s: 0.0,
        status: MapStatus::Converged,
        explanation: String::new(),
        gauge: Some(RobotId::new("r1").unwrap()),
        robots: robots
            .iter()
            .map(|(id, x, y, heading_deg)| MapRobot {
                id: RobotId::new(id).unwrap(),
                team_from_body: Some(Pose2::new(*x, *y, heading_deg.to_radians())),
                component: 0,
                presence: Presence::Online,
                moving: false,
                clock_offset_s: None,
                lag_s: None,
                bias_rad: None,
                trust: Trust::Full,
                verifiable: true,
                trouble: None,
                observations_lost: 0,
            })
            .collect(),
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
