use super::*;

fn world(name: &str, seed: u64) -> World {
    World::new(&Scenario::builtin(name).unwrap().unwrap(), seed).unwrap()
}

fn flat(a: (f64, f64), b: (f64, f64)) -> f64 {
    (a.0 - b.0).hypot(a.1 - b.1)
}

#[test]
fn nobody_walks_through_walls_robots_or_each_other_and_nobody_jumps() {
    for (name, seed) in [("default", 0), ("default", 1), ("moving_start", 2), ("tiny", 3)] {
        let world = world(name, seed);
        let [x, y, _] = world.room_size_m();
        let mut last: Option<State> = None;
        for i in 0..(world.duration_s() * 20.0) as usize {
            let now = world.at(i as f64 * 0.05);
            for (n, p) in now.people.iter().enumerate() {
                let here = (p.x_m, p.y_m);
                assert!(p.x_m.abs() < x / 2.0 - 0.1 && p.y_m.abs() < y / 2.0 - 0.1, "{name} {seed}: {p:?}");
                assert!(now.robots.iter().all(|r| flat(here, (r.x_m, r.y_m)) > 0.4), "{name} {seed}: {p:?}");
                assert!(now.people[..n].iter().all(|q| flat(here, (q.x_m, q.y_m)) > 0.45), "{name} {seed}: {p:?}");
                if let Some(last) = &last {
                    let before = &last.people[n];
                    assert!(flat(here, (before.x_m, before.y_m)) < 0.05 * 2.0, "{name} {seed}: {p:?}");
                }
            }
            last = Some(now);
        }
    }
}

#[test]
fn robots_stand_apart_and_off_the_furniture_before_and_after_their_drives() {
    for seed in 0..6 {
        let world = world("default", seed);
        let floor = Floor::new([8.0, 6.0], world.blocks());
        for time in [0.0, 19.9, 30.1, 60.0] {
            let robots = world.at(time).robots;
            for (n, r) in robots.iter().enumerate() {
                let place = Vector2::new(r.x_m, r.y_m);
                assert!(floor.clearance(place) > 0.59);
                for other in &robots[..n] {
                    assert!(flat((r.x_m, r.y_m), (other.x_m, other.y_m)) > 1.19);
                    assert!(floor.is_clear(place, Vector2::new(other.x_m, other.y_m), 0.25));
                }
            }
        }
    }
}

#[test]
fn the_second_robot_drives_two_metres_and_turns_a_quarter_between_20_and_30_seconds() {
    let world = world("default", 1);
    let at = |t: f64| world.at(t).robots[1];
    assert_eq!((at(0.0).x_m, at(0.0).moving), (at(19.99).x_m, false));
    assert!(at(25.0).moving && !at(30.01).moving);
    assert!((flat((at(0.0).x_m, at(0.0).y_m), (at(60.0).x_m, at(60.0).y_m)) - 2.0).abs() < 1e-9);
    assert!((at(60.0).heading_rad - at(0.0).heading_rad - std::f64::consts::FRAC_PI_2).abs() < 1e-9);
}

#[test]
fn clocks_and_capture_times_stay_within_what_the_scenario_says() {
    let world = world("default", 4);
    for robot in world.robots() {
        assert!(robot.clock_offset_s.abs() <= 0.020);
        assert!(robot.captures.len() >= 598);
        for pair in robot.captures.windows(2) {
            assert!((pair[1].true_time_s - pair[0].true_time_s - 0.1).abs() <= 0.0201);
        }
        let capture = robot.captures[7];
        let offset = capture.stamp.as_secs_f64() - robot::START_STAMP_S - capture.true_time_s;
        assert!((offset - robot.clock_offset_s).abs() < 1e-8);
    }
}

#[test]
fn a_seed_gives_one_world_and_another_seed_another() {
    let (a, b, c) = (world("tiny", 7), world("tiny", 7), world("tiny", 8));
    assert_eq!(a.at(2.2), b.at(2.2));
    assert_ne!(a.at(2.2), c.at(2.2));
}
