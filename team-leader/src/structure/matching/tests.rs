use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha12Rng;
use rand_distr::{Distribution, StandardNormal};

use super::*;

const SIGMA_RAD: f64 = 0.0012;
const CAMERA_M: f64 = 0.6;

/// What stands in a room: where, the grey levels beside it, from where to where.
struct Post {
    at: Vector2<f64>,
    levels: [f64; 2],
    z_m: [f64; 2],
}

fn normal(rng: &mut impl Rng) -> f64 {
    StandardNormal.sample(rng)
}

fn posts(rng: &mut impl Rng, count: usize) -> Vec<Post> {
    let mut level = || rng.random_range(20.0..220.0);
    let levels: Vec<[f64; 2]> = (0..count).map(|_| [level(), level()]).collect();
    let mut post = |levels| Post {
        at: Vector2::new(rng.random_range(-4.0..4.0), rng.random_range(-3.0..3.0)),
        levels,
        z_m: [rng.random_range(0.0..0.5), rng.random_range(0.9..2.5)],
    };
    levels.into_iter().map(&mut post).collect()
}

/// What a robot at `pose` sees of them, where its place is thought to be `believed`: six of seven, and a third as much that
/// nobody else sees.
fn seen(rng: &mut impl Rng, posts: &[Post], pose: &Pose2) -> Vec<Edge> {
    let mut edges = Vec::new();
    for post in posts {
        let range_m = (post.at - pose.position()).norm();
        if range_m < 0.6 || rng.random_bool(0.15) {
            continue;
        }
        let ends = post.z_m.map(|z| (z - CAMERA_M) / range_m);
        let [low, high] = [-0.26f64, 0.36];
        edges.push(Edge {
            // Each sees another side of what is round.
            bearing_rad: wrap(pose.bearing_to(post.at) + SIGMA_RAD.hypot(ROUND_M / range_m) * normal(rng)),
            sigma_rad: SIGMA_RAD,
            log_levels: post.levels.map(|l| (l * (1.0 + 0.08 * normal(rng)) + 8.0).ln()),
            tangents: ends.map(|t| t.clamp(low, high) + 0.005 * normal(rng)),
            ends: ends.map(|t| (low..high).contains(&t)),
        });
    }
    for _ in 0..posts.len() / 3 {
        edges.push(Edge {
            bearing_rad: rng.random_range(-3.1..3.1),
            sigma_rad: SIGMA_RAD,
            log_levels: [0, 1].map(|_| rng.random_range(28.0f64..228.0).ln()),
            tangents: [rng.random_range(-0.26..0.0), rng.random_range(0.05..0.36)],
            ends: [false, true],
        });
    }
    edges
}

#[test]
fn what_three_robots_see_is_found_where_it_is_and_as_surely_as_is_said() {
    let (mut found, mut right, mut nees, mut all) = (0u32, 0u32, 0.0, 0);
    for seed in 0..20 {
        let mut rng = ChaCha12Rng::seed_from_u64(seed);
        let posts = posts(&mut rng, 30);
        let sigmas = [0.008, 0.008, 0.004];
        let truth: Vec<Pose2> = [[-1.5, -1.0], [1.6, -0.8], [0.2, 1.7]]
            .iter()
            .map(|[x, y]| Pose2::new(*x, *y, rng.random_range(-3.0..3.0)))
            .collect();
        let edges: Vec<Vec<Edge>> = truth.iter().map(|pose| seen(&mut rng, &posts, pose)).collect();
        // Calibration errs too, each robot by itself.
        let mut erred = |pose: &Pose2| {
            let [x, y, h] = sigmas.map(|s| s * normal(&mut rng));
            Pose2::new(pose.x_m + x, pose.y_m + y, pose.heading_rad + h)
        };
        let covariance = Matrix3::from_diagonal(&nalgebra::Vector3::from(sigmas.map(|s| s * s)));
        let views: Vec<Posed<'_>> = truth
            .iter()
            .enumerate()
            .map(|(robot, pose)| Posed {
                robot,
                pose: erred(pose),
                covariance,
                height_m: CAMERA_M,
                edges: &edges[robot],
            })
            .collect();
        let joint = |a: usize, b: usize| if a == b { covariance } else { Matrix3::zeros() };
        // Seen by two robots at least, from where their rays cross.
        all += posts.iter().filter(|p| p.at.norm() < 2.5).count() as u32;
        for landmark in landmarks(&views, &joint) {
            found += 1;
            let near = |p: &&Post| (p.at - landmark.position).norm();
            let post = posts.iter().min_by(|a, b| near(a).total_cmp(&near(b))).unwrap();
            let error = landmark.position - post.at;
            let d2 = (error.transpose() * landmark.covariance.try_inverse().unwrap() * error)[0];
            if d2 < 25.0 {
                right += 1;
                nees += 0.5 * d2;
            }
        }
    }
    let nees = nees / f64::from(right);
    println!("{all} near, {found} found, {right} right, NEES {nees:.2}");
    assert!(found > all / 4, "{found} of {all}");
    assert!(f64::from(right) > 0.97 * f64::from(found), "{right} of {found}");
    assert!((0.7..1.3).contains(&nees), "{nees}");
}

#[test]
fn rooms_in_which_nothing_is_seen_by_two_robots_have_no_landmarks() {
    let mut found = 0;
    for seed in 0..20 {
        let mut rng = ChaCha12Rng::seed_from_u64(1000 + seed);
        let poses = [Pose2::new(-1.5, -1.0, 0.0), Pose2::new(1.6, -0.8, 1.0), Pose2::new(0.2, 1.7, 2.0)];
        // Each looks at a room of its own.
        let edges: Vec<Vec<Edge>> = poses
            .iter()
            .map(|pose| {
                let posts = posts(&mut rng, 30);
                seen(&mut rng, &posts, pose)
            })
            .collect();
        let covariance = Matrix3::identity() * 1e-5;
        let views: Vec<Posed<'_>> = (0..3)
            .map(|k| Posed { robot: k, pose: poses[k], covariance, height_m: CAMERA_M, edges: &edges[k] })
            .collect();
        found += landmarks(&views, &|a, b| if a == b { covariance } else { Matrix3::zeros() }).len();
    }
    println!("{found} in twenty rooms");
    assert!(found <= 20, "{found} in twenty rooms");
}
