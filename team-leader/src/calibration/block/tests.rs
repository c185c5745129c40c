use nalgebra::Vector3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

use super::*;

const BEARING_SIGMA: f64 = 8e-4;
const WIDTH_SIGMA: f64 = 9e-4;
const COMMON: f64 = 5e-4;

fn gauge() -> Matrix3<f64> {
    Matrix3::identity() * 1e-12
}

fn weak() -> Matrix3<f64> {
    Matrix3::from_diagonal(&Vector3::new(100.0, 100.0, 9.0))
}

fn truth() -> Vec<Pose2> {
    vec![Pose2::IDENTITY, Pose2::new(2.4, 0.6, 2.0), Pose2::new(0.9, 2.9, -1.2)]
}

fn normal(rng: &mut ChaCha8Rng, sigma: f64) -> f64 {
    Normal::new(0.0, sigma).unwrap().sample(rng)
}

/// From geometry alone: atan2 and asin on differences of positions.
fn links(truth: &[Pose2], rng: &mut ChaCha8Rng, common: f64) -> Vec<Link> {
    let mut links = Vec::new();
    for (observer, a) in truth.iter().enumerate() {
        for (peer, b) in truth.iter().enumerate().filter(|(p, _)| *p != observer) {
            let (dx, dy) = (b.x_m - a.x_m, b.y_m - a.y_m);
            links.push(Link {
                observer,
                peer,
                bearing_rad: wrap(dy.atan2(dx) - a.heading_rad + normal(rng, BEARING_SIGMA)),
                bearing_var: BEARING_SIGMA * BEARING_SIGMA,
                width_rad: Some((
                    2.0 * (0.2 / dx.hypot(dy)).asin() + common + normal(rng, WIDTH_SIGMA),
                    WIDTH_SIGMA * WIDTH_SIGMA,
                )),
            });
        }
    }
    links
}

fn solved(truth: &[Pose2], rng: &mut ChaCha8Rng) -> (Block, Vec<Link>) {
    let common = normal(rng, COMMON);
    let links = links(truth, rng, common);
    let mut block = Block::new(COMMON);
    for (robot, pose) in truth.iter().enumerate() {
        let start = Pose2::new(pose.x_m + 0.05, pose.y_m - 0.03, pose.heading_rad + 0.02);
        if robot == 0 {
            block.insert(0, *pose, &gauge());
        } else {
            block.insert(robot, start, &weak());
        }
    }
    block.solve(&links);
    assert!(block.converged());
    (block, links)
}

/// Squared Mahalanobis distance of robots 1 and 2, six numbers.
fn nees(block: &Block, truth: &[Pose2], robots: &[usize]) -> f64 {
    let n = 3 * robots.len();
    let mut error = DVector::zeros(n);
    let mut cov = DMatrix::zeros(n, n);
    for (a, &ra) in robots.iter().enumerate() {
        let (p, t) = (block.pose(ra).unwrap(), truth[ra]);
        error[3 * a] = p.x_m - t.x_m;
        error[3 * a + 1] = p.y_m - t.y_m;
        error[3 * a + 2] = wrap(p.heading_rad - t.heading_rad);
        for (b, &rb) in robots.iter().enumerate() {
            cov.fixed_view_mut::<3, 3>(3 * a, 3 * b).copy_from(&block.covariance(ra, rb).unwrap());
        }
    }
    error.dot(&cov.cholesky().unwrap().solve(&error))
}

#[test]
fn joint_covariance_is_honest_over_many_draws() {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let (runs, truth) = (400, truth());
    let (mut sum, mut chi2, mut dof) = (0.0, 0.0, 0);
    for _ in 0..runs {
        let (block, _) = solved(&truth, &mut rng);
        sum += nees(&block, &truth, &[1, 2]);
        chi2 += block.chi2().0;
        dof += block.chi2().1;
    }
    let mean = sum / f64::from(runs) / 6.0;
    // Standard deviation of the mean of χ²₆/6 over 400 draws is 0.029.
    assert!((mean - 1.0).abs() < 0.09, "NEES {mean}");
    let fit = chi2 / dof as f64;
    assert!((fit - 1.0).abs() < 0.1, "χ²/dof {fit}");
}

#[test]
fn what_a_leaving_robot_told_about_the_others_stays() {
    let mut rng = ChaCha8Rng::seed_from_u64(12);
    let truth = truth();
    let (mut sum, runs) = (0.0, 400);
    for _ in 0..runs {
        let (mut block, all) = solved(&truth, &mut rng);
        let before = block.covariance(2, 2).unwrap();
        let (gone, kept): (Vec<Link>, Vec<Link>) = all.into_iter().partition(|l| l.observer == 1 || l.peer == 1);
        block.absorb(&gone);
        let departed = block.remove(1).unwrap();
        assert!((departed.team_from_body.position() - truth[1].position()).norm() < 0.1);
        block.solve(&kept);
        let after = block.covariance(2, 2).unwrap();
        assert!((after - before).norm() < 0.02 * before.norm(), "{before} {after}");
        sum += nees(&block, &truth, &[2]);
    }
    let mean = sum / f64::from(runs) / 3.0;
    assert!((mean - 1.0).abs() < 0.13, "NEES {mean}");
}

#[test]
fn the_gauge_survives_its_robot() {
    let mut rng = ChaCha8Rng::seed_from_u64(13);
    let truth = truth();
    let (mut block, all) = solved(&truth, &mut rng);
    let (gone, kept): (Vec<Link>, Vec<Link>) = all.into_iter().partition(|l| l.observer == 0 || l.peer == 0);
    block.absorb(&gone);
    block.remove(0).unwrap();
    block.solve(&kept);
    assert!(block.converged());
    for robot in [1, 2] {
        assert!((block.pose(robot).unwrap().position() - truth[robot].position()).norm() < 0.1);
        assert!(block.covariance(robot, robot).unwrap()[(0, 0)].sqrt() < 0.05);
    }
}
