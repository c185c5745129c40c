//! How long the joint solution, a live step and the matching of upright edges take, and how that grows. `cargo bench -p team-leader`
//!
//! Robots on a circle see each other and walkers among them at 10 Hz. `solve` gets everything at once as a problem; a live
//! step is one robot's observation through the leader (`solve --sequence`), the time includes reading its line.

#![allow(clippy::print_stdout, clippy::expect_used, reason = "a benchmark prints, and its input is its own")]

use std::time::Instant;

use nalgebra::{Matrix3, Vector2};
use protocol::frames::Pose2;
use protocol::message::edges::MAX_EDGES;
use serde_json::{Value, json};
use team_leader::solve::input::Problem;
use team_leader::solve::sequence::Sequence;
use team_leader::solve::solve;
use team_leader::structure::MAX_VIEWS;
use team_leader::structure::matching::{Edge, Posed, landmarks};

const SIGMA_DEG: f64 = 0.1;

fn main() {
    // The test runner of `cargo test --benches` only wants to know that it runs.
    let quick = std::env::args().any(|a| a == "--test");
    let (rounds, sizes): (usize, &[(usize, usize, f64)]) = if quick {
        (1, &[(3, 2, 0.5)])
    } else {
        (3, &[(10, 20, 10.0), (10, 20, 20.0), (10, 20, 40.0), (20, 20, 10.0), (50, 20, 10.0), (100, 20, 10.0)])
    };
    println!("robots targets seconds  measurements    solve s   status");
    for &(robots, walkers, seconds) in sizes {
        let frames: Vec<Value> = frames(robots, walkers, seconds);
        let problem = Problem::parse(&at_once(&frames).to_string()).expect("a problem");
        let measurements = 2 * problem.sightings.len() + problem.bearings.len();
        let mut best = f64::INFINITY;
        let mut status = String::new();
        for _ in 0..rounds {
            let problem = problem.clone();
            let begin = Instant::now();
            let solution = solve(problem);
            best = best.min(begin.elapsed().as_secs_f64());
            status = format!("{:?}", solution.status);
        }
        println!("{robots:>6} {walkers:>7} {seconds:>7} {measurements:>13} {best:>10.3}   {status}");
    }
    println!("\nrobots targets   live step ms: median, 99 %");
    for (robots, walkers) in if quick { vec![(3, 2)] } else { vec![(3, 4), (10, 20), (20, 20)] } {
        let mut sequence = Sequence::new();
        let mut steps: Vec<f64> = Vec::new();
        for frame in frames(robots, walkers, if quick { 0.5 } else { 10.0 }) {
            let line = frame.to_string();
            let begin = Instant::now();
            sequence.line(&line).expect("a line");
            steps.push(1e3 * begin.elapsed().as_secs_f64() / robots as f64);
        }
        let mut late = steps.split_off(steps.len() / 5);
        late.sort_by(f64::total_cmp);
        let at = |p: f64| late[((late.len() - 1) as f64 * p) as usize];
        println!("{robots:>6} {walkers:>7} {:>14.3} {:>10.3}", at(0.5), at(0.99));
    }
    println!("\nviews  edges       ms  found");
    for views in if quick { vec![3] } else { vec![3, 5, MAX_VIEWS] } {
        structure(views, rounds);
    }
}

/// Matching upright edges: some views of as many edges each, of which half are of what all see.
fn structure(views: usize, rounds: usize) {
    let mut state = 7u64;
    let mut uniform = move |low: f64, high: f64| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        low + (high - low) * ((state >> 33) as f64 / f64::from(1u32 << 31))
    };
    let posts: Vec<[f64; 4]> = (0..MAX_EDGES / 2)
        .map(|_| [uniform(-4.0, 4.0), uniform(-3.0, 3.0), uniform(3.0, 5.5), uniform(3.0, 5.5)])
        .collect();
    let poses: Vec<Pose2> =
        (0..views).map(|_| Pose2::new(uniform(-3.0, 3.0), uniform(-2.0, 2.0), uniform(-3.0, 3.0))).collect();
    let edges: Vec<Vec<Edge>> = poses
        .iter()
        .map(|pose| {
            let mut edge = |bearing_rad, log_levels| Edge {
                bearing_rad,
                sigma_rad: 1e-3,
                log_levels,
                tangents: [uniform(-0.2, 0.0), uniform(0.1, 0.3)],
                ends: [false; 2],
            };
            let mut edges: Vec<Edge> =
                posts.iter().map(|[x, y, l, r]| edge(pose.bearing_to(Vector2::new(*x, *y)), [*l, *r])).collect();
            for post in &posts {
                edges.push(edge(post[0] * 0.75, [post[3], post[2]]));
            }
            edges
        })
        .collect();
    let covariance = Matrix3::identity() * 1e-5;
    let posed: Vec<Posed<'_>> = (0..views)
        .map(|robot| Posed { robot, pose: poses[robot], covariance, height_m: 0.6, edges: &edges[robot] })
        .collect();
    let (mut best_ms, mut found) = (f64::INFINITY, 0);
    for _ in 0..rounds {
        let begin = Instant::now();
        found = landmarks(&posed, &|a, b| if a == b { covariance } else { Matrix3::zeros() }).len();
        best_ms = best_ms.min(1e3 * begin.elapsed().as_secs_f64());
    }
    println!("{views:>5} {:>6} {best_ms:>8.2} {found:>6}", edges[0].len());
}

/// What all robots see, a line of a sequence each frame.
fn frames(robots: usize, walkers: usize, seconds: f64) -> Vec<Value> {
    let mut state = 1u64;
    // Sum of twelve uniform numbers of a linear congruence: near enough to normal.
    let mut error = move || {
        (0..12)
            .map(|_| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 33) as f64 / f64::from(1u32 << 31)
            })
            .sum::<f64>()
            - 6.0
    };
    let places: Vec<[f64; 3]> = (0..robots)
        .map(|k| {
            let around = std::f64::consts::TAU * k as f64 / robots as f64;
            [4.0 + 3.0 * around.cos(), 3.0 + 2.5 * around.sin(), 77.0 * k as f64 % 360.0 - 180.0]
        })
        .collect();
    let walker = |w: usize, t: f64| {
        let (phase, size) = (0.5 * t + 1.7 * w as f64, 0.3 + 0.5 * w as f64 / walkers as f64);
        [4.0 + 2.5 * size * phase.cos(), 3.0 + 2.0 * size * phase.sin()]
    };
    let mut all = Vec::new();
    for frame in 0..(10.0 * seconds) as u32 {
        let time_s = f64::from(frame) / 10.0;
        let (mut sightings, mut bearings) = (Vec::new(), Vec::new());
        for (i, from) in places.iter().enumerate() {
            let mut toward = |to: [f64; 2]| {
                let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
                (dy.atan2(dx).to_degrees() - from[2] + SIGMA_DEG * error(), dx.hypot(dy))
            };
            for (j, to) in places.iter().enumerate().filter(|(j, _)| *j != i) {
                let (bearing, range) = toward([to[0], to[1]]);
                sightings.push(json!({"observer": format!("r{i}"), "peer": format!("r{j}"),
                    "bearing_deg": bearing, "bearing_sigma_deg": SIGMA_DEG, "range_m": range, "range_sigma_m": 0.05}));
            }
            for w in 0..walkers {
                let (bearing, _) = toward(walker(w, time_s));
                bearings.push(json!({"observer": format!("r{i}"), "target": format!("w{w}"), "time_s": time_s,
                    "bearing_deg": bearing, "bearing_sigma_deg": SIGMA_DEG}));
            }
        }
        let mut line = json!({"time_s": time_s, "sightings": sightings, "bearings": bearings});
        if frame == 0 {
            line["robots"] = (0..robots).map(|k| json!({"id": format!("r{k}")})).collect();
        }
        all.push(line);
    }
    all
}

/// All frames as one problem.
fn at_once(frames: &[Value]) -> Value {
    let join =
        |key: &str| -> Vec<Value> { frames.iter().filter_map(|f| f[key].as_array()).flatten().cloned().collect() };
    json!({"robots": join("robots"), "sightings": join("sightings"), "bearings": join("bearings")})
}
