//! Equation (5-1) and the covariance of its target, in the frame of robot 1.
//!
//! `D₁ = B sin s₂ / sin(s₁ + s₂)` with s₁ = wrap(θ₁ − β₂₁), s₂ = wrap(β₁₂ − θ₂): bearings counter-clockwise, β₂₁ robot 2 in
//! picture 1, β₁₂ robot 1 in picture 2. Valid only where s₁ s₂ > 0 and |s₁| + |s₂| < π: else the rays part. The printed
//! (5-14) lacks the term D₁ cot φ₀ ∂φ₁; it is here (`MATHS.md` §5.4).

use std::f64::consts::PI;

use nalgebra::{Matrix2, Vector2};
use protocol::angle::wrap;

/// What both robots measured, radians and metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StereoBearings {
    /// θ₁: the target in picture 1.
    pub target_1_rad: f64,
    /// θ₂: the target in picture 2.
    pub target_2_rad: f64,
    /// β₂₁: robot 2 in picture 1.
    pub bearing_21_rad: f64,
    /// β₁₂: robot 1 in picture 2.
    pub bearing_12_rad: f64,
    /// B.
    pub baseline_m: f64,
}

/// A target seen by two robots.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Triangulated {
    /// D₁: from robot 1.
    pub range_1_m: f64,
    /// D₂: from robot 2.
    pub range_2_m: f64,
    /// φ₀: angle at the target, in (0, π).
    pub parallax_rad: f64,
    /// In robot 1's body frame.
    pub position_m: Vector2<f64>,
    /// +1: left of the line from robot 1 to robot 2.
    pub side: f64,
}

/// Standard deviations of what was measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StereoSigmas {
    /// Of θ₁ and θ₂, rad.
    pub target_rad: [f64; 2],
    /// Of β₂₁ and β₁₂, rad.
    pub peer_rad: [f64; 2],
    /// Of B, m.
    pub baseline_m: f64,
}

/// Intersects the two rays; `None` where they part or run on the line of the robots.
pub fn triangulate(m: &StereoBearings) -> Option<Triangulated> {
    let s1 = wrap(m.target_1_rad - m.bearing_21_rad);
    let s2 = wrap(m.bearing_12_rad - m.target_2_rad);
    if s1 * s2 <= 0.0 || s1.abs() + s2.abs() >= PI {
        return None;
    }
    let d = (s1 + s2).sin();
    let range_1_m = m.baseline_m * s2.sin() / d;
    let range_2_m = m.baseline_m * s1.sin() / d;
    let (s, c) = m.target_1_rad.sin_cos();
    (range_1_m.is_finite() && range_2_m.is_finite()).then_some(Triangulated {
        range_1_m,
        range_2_m,
        parallax_rad: PI - s1.abs() - s2.abs(),
        position_m: Vector2::new(range_1_m * c, range_1_m * s),
        side: s1.signum(),
    })
}

impl Triangulated {
    /// Covariance along and across robot 1's line of sight: [[rr, rt], [rt, tt]], m².
    pub fn covariance_radial(&self, baseline_m: f64, sigmas: &StereoSigmas) -> Matrix2<f64> {
        let (d1, d2, phi0) = (self.range_1_m, self.range_2_m, self.parallax_rad);
        let along_1 = d1 / phi0.tan();
        let along_2 = d2 / phi0.sin();
        let rr = (d1 / baseline_m * sigmas.baseline_m).powi(2)
            + along_2.powi(2) * (sigmas.target_rad[1].powi(2) + sigmas.peer_rad[1].powi(2))
            + along_1.powi(2) * (sigmas.target_rad[0].powi(2) + sigmas.peer_rad[0].powi(2));
        let tt = (d1 * sigmas.target_rad[0]).powi(2);
        let rt = self.side * d1 * along_1 * sigmas.target_rad[0].powi(2);
        Matrix2::new(rr, rt, rt, tt)
    }

    /// The same in robot 1's body frame.
    pub fn covariance(&self, baseline_m: f64, sigmas: &StereoSigmas) -> Matrix2<f64> {
        let u = self.position_m.normalize();
        let axes = Matrix2::new(u.x, -u.y, u.y, u.x);
        axes * self.covariance_radial(baseline_m, sigmas) * axes.transpose()
    }

    /// Height above the floor from the elevation in picture 1, with its variance from the angle and the range.
    pub fn height_m(
        &self,
        camera_height_m: f64,
        elevation_rad: f64,
        elevation_sigma_rad: f64,
        range_var: f64,
    ) -> (f64, f64) {
        height_m(camera_height_m, self.range_1_m, elevation_rad, elevation_sigma_rad, range_var)
    }
}

/// Z = H + D tan α, with variance (D/cos²α σ)² + tan²α σ_D².
pub fn height_m(
    camera_height_m: f64,
    range_m: f64,
    elevation_rad: f64,
    elevation_sigma_rad: f64,
    range_var: f64,
) -> (f64, f64) {
    let (t, c) = (elevation_rad.tan(), elevation_rad.cos());
    let var = (range_m / (c * c) * elevation_sigma_rad).powi(2) + t * t * range_var;
    (camera_height_m + range_m * t, var)
}

/// Height from two elevations (camera height, range, elevation and its sigma each): mean by the weights cos⁴α/(Dσ)², and
/// how far the two disagree in sigmas of the angles alone: the matching test.
pub fn fuse_heights(one: (f64, f64, f64, f64), two: (f64, f64, f64, f64)) -> (f64, f64) {
    let of = |(camera_m, range_m, elevation, sigma): (f64, f64, f64, f64)| {
        height_m(camera_m, range_m, elevation, sigma, 0.0)
    };
    let ((z1, v1), (z2, v2)) = (of(one), of(two));
    ((z1 * v2 + z2 * v1) / (v1 + v2), (z1 - z2) / (v1 + v2).sqrt())
}

/// Mean of values with standard deviations, by inverse variance, and its own; `None` of none.
pub fn weighted_mean(values: impl IntoIterator<Item = (f64, f64)>) -> Option<(f64, f64)> {
    let (mut weight, mut sum) = (0.0, 0.0);
    for (x, sigma) in values {
        weight += f64::powi(sigma, -2);
        sum += x * f64::powi(sigma, -2);
    }
    (weight > 0.0).then(|| (sum / weight, weight.sqrt().recip()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::golden::golden;

    #[test]
    fn equation_5_1_matches_the_golden_numbers() {
        for case in golden("pvs")["outputs"].as_array().unwrap() {
            let f = |k: &str| case[k].as_f64().unwrap();
            let found = triangulate(&StereoBearings {
                target_1_rad: f("t1"),
                target_2_rad: f("t2"),
                bearing_21_rad: f("b21"),
                bearing_12_rad: f("b12"),
                baseline_m: f("B"),
            })
            .unwrap();
            assert!((found.range_1_m / f("D1") - 1.0).abs() < 1e-11);
            assert!((found.range_2_m / f("D2") - 1.0).abs() < 1e-11);
            assert!((found.parallax_rad / f("phi0") - 1.0).abs() < 1e-11);
            assert_eq!(found.side, f("side"));
            for k in 0..2 {
                let truth = case["T_cam1"][k].as_f64().unwrap();
                assert!((found.position_m[k] / truth - 1.0).abs() < 1e-10);
            }
        }
    }

    #[test]
    fn covariance_matches_the_golden_numbers_on_both_sides() {
        for case in golden("cov_target")["outputs"].as_array().unwrap() {
            let f = |k: &str| case[k].as_f64().unwrap();
            let cov = |k: &str| case["cov"][k].as_f64().unwrap();
            for side in [1.0, -1.0] {
                let t = Triangulated {
                    range_1_m: f("D1"),
                    range_2_m: f("D2"),
                    parallax_rad: f("phi0"),
                    position_m: Vector2::new(f("D1"), 0.0),
                    side,
                };
                let s = cov("s");
                let sigmas = StereoSigmas { target_rad: [s, s], peer_rad: [s, s], baseline_m: cov("sB") };
                let c = t.covariance_radial(f("B"), &sigmas);
                assert!((c[(0, 0)] / cov("rr") - 1.0).abs() < 1e-10, "{} {}", c[(0, 0)], cov("rr"));
                assert!((c[(1, 1)] / cov("tt") - 1.0).abs() < 1e-10);
                assert!((side * c[(0, 1)] / cov("rt") - 1.0).abs() < 1e-10);
            }
        }
    }

    #[test]
    fn fused_height_and_disagreement_match_the_golden_numbers() {
        let group = golden("pvs.height");
        let i = |k: &str| group["inputs"][k].as_f64().unwrap();
        let (z, disagreement) =
            fuse_heights((i("H1"), i("D1"), i("a1"), i("sigma")), (i("H2"), i("D2"), i("a2"), i("sigma")));
        assert!((z / group["outputs"][0].as_f64().unwrap() - 1.0).abs() < 1e-11);
        assert!((disagreement / group["outputs"][1].as_f64().unwrap() - 1.0).abs() < 1e-11);
    }

    #[test]
    fn rays_that_part_have_no_intersection() {
        let m = StereoBearings {
            target_1_rad: 2.0,
            target_2_rad: 1.0,
            bearing_21_rad: 0.0,
            bearing_12_rad: PI,
            baseline_m: 1.0,
        };
        assert_eq!(triangulate(&m), None);
        assert_eq!(triangulate(&StereoBearings { target_1_rad: 0.0, target_2_rad: 0.0, ..m }), None);
    }
}
