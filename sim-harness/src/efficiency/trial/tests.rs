use super::*;
use crate::efficiency::cases::cases;

/// A reduced grid of `sim-harness efficiency`: RMSE 1 ± 0.06 (three sigmas of 1,500 draws), NEES within its bounds.
#[test]
fn the_solver_reaches_the_bound_and_says_how_sure_it_is() {
    let all = cases();
    let chosen = all.iter().filter(|c| match (c.baseline_m, c.parallax_deg) {
        (Some(b), Some(p)) => b == 3.0 && p == 60.0 && c.noise_px == 0.1,
        _ => c.scene.robots.len() == 3 && c.number.is_multiple_of(10),
    });
    let chosen: Vec<Case> = chosen.cloned().collect();
    assert!(chosen.len() >= 9, "{}", chosen.len());
    let plan = Plan { draws: 1500, reference: 0, noise: Noise::Gaussian, threads: 2 };
    for outcome in run(&chosen, &plan, &|| {}) {
        assert_eq!(outcome.failed, 0, "{}", outcome.name);
        let ratios = outcome.to_bound;
        for ratio in [ratios.baseline, ratios.positions, ratios.headings, ratios.targets] {
            assert!((0.94..1.06).contains(&ratio), "{}: {ratios:?}", outcome.name);
        }
        for nees in [Some(outcome.nees_robots), Some(outcome.nees_target), outcome.nis].into_iter().flatten() {
            assert!(nees.holds() && nees.p > 0.01 / 30.0, "{}: {nees:?}", outcome.name);
        }
    }
}

/// With errors as MRCLAM's, RMSE at most 10 % above the least that any estimator makes, and no covariance that says nothing of who may
/// be wrong: one that believes its choice makes a NEES of 1.9 of pairs of cylinders and 1.65 of plates.
#[test]
fn errors_with_tails_cost_little_more_than_they_must_and_are_owned_up_to() {
    let all = cases();
    let chosen = all.iter().filter(|c| c.baseline_m == Some(3.0) && c.parallax_deg == Some(60.0) && c.noise_px == 0.1);
    let chosen: Vec<Case> = chosen.filter(|c| c.marker != "24 bars").cloned().collect();
    assert_eq!(chosen.len(), 5);
    let plan = Plan { draws: 1000, reference: 1, noise: Noise::Tailed, threads: 2 };
    for outcome in run(&chosen, &plan, &|| {}) {
        assert_eq!((outcome.failed, outcome.reference), (0, Reference::LeastSquareError), "{}", outcome.name);
        let ratios = outcome.to_reference.unwrap();
        for ratio in [ratios.baseline, ratios.positions, ratios.headings, ratios.targets] {
            assert!((0.95..1.1).contains(&ratio), "{}: {ratios:?}", outcome.name);
        }
        assert!(outcome.nees_robots.mean < 1.5, "{}: {:?}", outcome.name, outcome.nees_robots);
    }
}
