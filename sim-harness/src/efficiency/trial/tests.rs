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
