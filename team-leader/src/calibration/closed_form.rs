//! The report's closed forms for two robots, corrected (`MATHS.md` §5.1, §5.2).

use std::f64::consts::PI;

use protocol::angle::wrap;
use protocol::frames::Pose2;

/// Distance to the axis of a cylinder of `radius_m` whose edges are `width_rad` apart: B = R / sin(α/2). Corrects (5-2),
/// which prints R·cot(α/2), the length of the tangent. `None` outside (0, π).
pub fn cylinder_range_m(width_rad: f64, radius_m: f64) -> Option<f64> {
    (width_rad > 0.0 && width_rad < PI).then(|| radius_m / (0.5 * width_rad).sin())
}

/// Angle between the edges of a cylinder of `radius_m` at `range_m`: α = 2 asin(R/B). `None` inside the cylinder.
pub fn cylinder_width_rad(range_m: f64, radius_m: f64) -> Option<f64> {
    (range_m > radius_m).then(|| 2.0 * (radius_m / range_m).asin())
}

/// `one_from_two` of two robots that see each other: `bearing_21_rad` is robot 2 in picture 1, `bearing_12_rad` robot 1 in
/// picture 2, `range_m` the distance of their axes. Relative heading h₂ − h₁ = wrap(β₂₁ − β₁₂ + π).
pub fn relative_pose(bearing_21_rad: f64, bearing_12_rad: f64, range_m: f64) -> Pose2 {
    let (s, c) = bearing_21_rad.sin_cos();
    Pose2::new(range_m * c, range_m * s, wrap(bearing_21_rad - bearing_12_rad + PI))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::golden::golden;

    #[test]
    fn cylinder_range_matches_the_golden_numbers_and_inverts() {
        let group = golden("cylinder");
        let radius_m = group["inputs"]["R"].as_f64().unwrap();
        for case in group["outputs"].as_array().unwrap() {
            let (range_m, width_rad) = (case["exact"].as_f64().unwrap(), case["alpha"].as_f64().unwrap());
            assert!((cylinder_range_m(width_rad, radius_m).unwrap() / range_m - 1.0).abs() < 1e-11);
            assert!((cylinder_width_rad(range_m, radius_m).unwrap() / width_rad - 1.0).abs() < 1e-11);
        }
        assert_eq!(cylinder_width_rad(0.1, radius_m), None);
        assert_eq!(cylinder_range_m(-0.1, radius_m), None);
    }

    #[test]
    fn relative_heading_matches_the_golden_numbers() {
        for case in golden("pvs")["outputs"].as_array().unwrap() {
            let f = |k: &str| case[k].as_f64().unwrap();
            let pose = relative_pose(f("b21"), f("b12"), f("B"));
            assert!(wrap(pose.heading_rad - f("rel_heading")).abs() < 1e-11);
            assert!((pose.position().norm() - f("B")).abs() < 1e-11 * f("B"));
            assert!(wrap(pose.bearing_to(nalgebra::Vector2::zeros()) - f("b12")).abs() < 1e-11);
        }
    }
}
