//! The report's closed forms from one picture to the peer's place, corrected (errata 5-2 … 5-13), with covariance.
//!
//! They need no iteration and no start, so they start the least-squares solutions, and check them. Covariances are those
//! of the geometry: the features' Jacobian at the result, inverted. Angles in the observer's body frame.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::{Matrix2, Matrix3, RowVector3, Vector2, Vector3};

use super::{Marker, polar_jacobian};
use crate::angle::{difference, wrap};
use crate::estimate::Estimate;
use crate::frames::Pose2;
use crate::message::observation::FeaturePart;

/// A peer's axis from the edges of its cylinder of `radius_m`: (range, bearing), with α = left − right,
/// B = R/sin(α/2) (5-2 corrected) and β = right + α/2. Sigmas of the right and left edge, radians.
/// `None` unless 0 < α < π.
pub fn cylinder(edges_rad: [f64; 2], sigmas_rad: [f64; 2], radius_m: f64) -> Option<Estimate<2>> {
    let [right, left] = edges_rad;
    let alpha = difference(left, right);
    if !(alpha > 0.0 && alpha < PI) {
        return None;
    }
    let (s, c) = (0.5 * alpha).sin_cos();
    let slope = -0.5 * radius_m * c / (s * s);
    let jacobian = Matrix2::new(-slope, slope, 0.5, 0.5);
    let noise = Matrix2::from_diagonal(&Vector2::from(sigmas_rad.map(|sigma| sigma * sigma)));
    let value = Vector2::new(radius_m / s, wrap(right + 0.5 * alpha));
    Some(Estimate::new(value, jacobian * noise * jacobian.transpose()))
}

/// A peer's axis from three adjacent bars on the near side of a circle of `radius_m`: (range, bearing, azimuth of the
/// middle bar seen from the peer's axis, in the observer's frame; the peer's heading is that minus the bar's own azimuth).
/// Bearings increase (right to left), `gaps_rad` are the angles between neighbours at the peer's axis.
/// (5-3) … (5-9) corrected. `None` where no such layout exists.
pub fn three_bars(bearings_rad: [f64; 3], sigma_rad: f64, gaps_rad: [f64; 2], radius_m: f64) -> Option<Estimate<3>> {
    let [b1, b2, b3] = bearings_rad;
    let [alpha_1, alpha_2] = [difference(b2, b1), difference(b3, b2)];
    let [l_1, l_2] = gaps_rad.map(|gap| 2.0 * radius_m * (0.5 * gap).sin());
    if !(alpha_1 > 0.0 && alpha_2 > 0.0 && l_1 > 0.0 && l_2 > 0.0) {
        return None;
    }
    let (a_1, a_2) = (l_1 * alpha_2.sin(), l_2 * alpha_1.sin());
    let alpha = alpha_1 + alpha_2 + 0.5 * (gaps_rad[0] + gaps_rad[1]);
    let phi_1 = (a_2 * alpha.sin()).atan2(a_1 - a_2 * alpha.cos());
    let to_middle_m = l_1 * phi_1.sin() / alpha_1.sin();
    if to_middle_m.is_nan() || to_middle_m <= 0.0 {
        return None;
    }
    let xi = FRAC_PI_2 + alpha_1 + phi_1 + 0.5 * gaps_rad[0];
    let (side, along) = (radius_m * xi.sin(), to_middle_m - radius_m * xi.cos());
    let (range_m, bearing_rad) = (side.hypot(along), wrap(b2 + side.atan2(along)));
    // From the axis to the middle bar.
    let out = at(to_middle_m, b2) - at(range_m, bearing_rad);
    let azimuth_rad = out.y.atan2(out.x);

    // The same layout as a marker whose middle bar is at its own azimuth 0; larger azimuths are further right.
    let azimuths_deg = vec![gaps_rad[0].to_degrees(), 0.0, -gaps_rad[1].to_degrees()];
    let marker = Marker::Bars { radius_m, azimuths_deg, height_m: [0.0, 1.0], code: None, look: None };
    let axis = at(range_m, bearing_rad);
    let peer = Pose2::new(axis.x, axis.y, azimuth_rad);
    let features = marker.features(&peer, 0.0);
    let [first, middle, last] = features[..] else { return None };
    let rows = [first, middle, last].map(|feature| feature.bearing_jacobian);
    let covariance = inverted(rows, [sigma_rad; 3], &peer)?;
    Some(Estimate::new(Vector3::new(range_m, bearing_rad, azimuth_rad), covariance))
}

/// What is measured on the edges of a plate: bearings of the left and right edge, and the apparent heights there,
/// tan(upper) − tan(lower).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlateView {
    /// Left (P₁) and right (P₂), radians.
    pub bearings_rad: [f64; 2],
    /// Of each bearing.
    pub bearing_sigma_rad: f64,
    /// h₁ and h₂, in any common unit.
    pub heights: [f64; 2],
    /// Of each height, relative to it.
    pub relative_height_sigma: f64,
}

/// A peer's pose (range, bearing, heading, of its axis in the observer's body frame) from the edges of its plate, whose
/// true height need not be known: (5-10) … (5-13) corrected, in vectors. `None` for other markers and impossible views.
pub fn plate(view: &PlateView, marker: &Marker) -> Option<Estimate<3>> {
    let Marker::Rectangle { width_m, left_edge_m, behind_m, .. } = marker else { return None };
    let ([b1, b2], [h1, h2]) = (view.bearings_rad, view.heights);
    let alpha = difference(b1, b2);
    if !(alpha > 0.0 && alpha < PI && h1 > 0.0 && h2 > 0.0) {
        return None;
    }
    let scale = width_m / (h1 * h1 + h2 * h2 - 2.0 * h1 * h2 * alpha.cos()).sqrt();
    let (p_1, p_2) = (at(scale * h2, b1), at(scale * h1, b2));
    let along = (p_2 - p_1) / *width_m;
    // Away from the observer, who is in front: along turned to the right... to the left would point back.
    let away = Vector2::new(-along.y, along.x);
    let away = if away.dot(&p_1) < 0.0 { -away } else { away };
    let axis = p_1 + along * *left_edge_m + away * *behind_m;
    let heading_rad = wrap((-away.y).atan2(-away.x));
    let peer = Pose2::new(axis.x, axis.y, heading_rad);

    let features = marker.features(&peer, 0.0);
    let edge = |index| features.iter().find(|feature| feature.part == FeaturePart::Edge(index));
    let (right, left) = (edge(0)?, edge(1)?);
    // The third measurement is ln(h₁/h₂) = ln(B₂/B₁).
    let [right_at, left_at] = marker.edge_points()?;
    let log_distance = |point: Vector2<f64>| -> RowVector3<f64> {
        let q = peer.transform(point);
        q.transpose() / q.norm_squared() * peer.transform_jacobians(point).0
    };
    let ratio = log_distance(right_at) - log_distance(left_at);
    let ratio_sigma = view.relative_height_sigma * 2f64.sqrt();
    let sigmas = [view.bearing_sigma_rad, view.bearing_sigma_rad, ratio_sigma];
    let covariance = inverted([left.bearing_jacobian, right.bearing_jacobian, ratio], sigmas, &peer)?;
    Some(Estimate::new(Vector3::new(axis.norm(), axis.y.atan2(axis.x), heading_rad), covariance))
}

/// Covariance of (range, bearing, heading) from three measurements: J⁻¹ Σ J⁻ᵀ. `None` where they do not determine it.
fn inverted(rows: [RowVector3<f64>; 3], sigmas: [f64; 3], peer: &Pose2) -> Option<Matrix3<f64>> {
    let inverse = (Matrix3::from_rows(&rows) * polar_jacobian(peer)).try_inverse()?;
    let noise = Matrix3::from_diagonal(&Vector3::from(sigmas.map(|sigma| sigma * sigma)));
    Some(inverse * noise * inverse.transpose())
}

fn at(range_m: f64, bearing_rad: f64) -> Vector2<f64> {
    Vector2::new(range_m * bearing_rad.cos(), range_m * bearing_rad.sin())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::marker::golden::{golden, number, numbers};

    #[test]
    fn a_cylinders_range_is_the_golden_one() {
        let group = golden("cylinder");
        let radius_m = number(&group["inputs"], "R");
        for case in group["outputs"].as_array().unwrap() {
            let half = 0.5 * number(case, "alpha");
            // Over the seam behind.
            let edges = [wrap(PI - half), wrap(PI + half)];
            let estimate = cylinder(edges, [1e-3; 2], radius_m).unwrap();
            assert!((estimate.value[0] / number(case, "exact") - 1.0).abs() < 1e-11);
            assert!(difference(estimate.value[1], PI).abs() < 1e-12);
        }
        assert_eq!(cylinder([0.1, 0.0], [1e-3; 2], 0.2), None);
        assert_eq!(cylinder([0.1, 0.1], [1e-3; 2], 0.2), None);
        assert_eq!(cylinder([f64::NAN, 0.1], [1e-3; 2], 0.2), None);
    }

    #[test]
    fn a_cylinders_sigmas_are_those_of_the_tables() {
        // MATHS §5.2: σ_B = B√(B²−R²)/(2R)·√2σ, 1 px on 1080 columns: 0.082 m at 2 m, 0.514 m at 5 m; σ_β = σ/√2.
        let sigma: f64 = 5.818e-3;
        for (range_m, table_m) in [(1.0, 0.020), (2.0, 0.082), (3.0, 0.185), (5.0, 0.514)] {
            let half = (0.2f64 / range_m).asin();
            let estimate = cylinder([-half, half], [sigma; 2], 0.2).unwrap();
            assert!((estimate.sigma(0) - table_m).abs() < 6e-4, "{} at {range_m}", estimate.sigma(0));
            assert!((estimate.sigma(1) - sigma / 2f64.sqrt()).abs() < 1e-12);
        }
    }

    #[test]
    fn three_bars_give_the_golden_place() {
        for case in golden("bars3")["outputs"].as_array().unwrap() {
            let [b, g] = ["b", "g"].map(|name| numbers(case, name));
            let estimate = three_bars([b[0], b[1], b[2]], 1e-3, [g[0], g[1]], 0.2).unwrap();
            assert!((estimate.value[0] / number(case, "B") - 1.0).abs() < 1e-9, "{}", estimate.value[0]);
            assert!(difference(estimate.value[1], number(case, "beta21")).abs() < 1e-10);
        }
        assert_eq!(three_bars([0.1, 0.0, 0.2], 1e-3, [0.5, 0.5], 0.2), None);
    }

    #[test]
    fn three_symmetric_far_bars_have_the_sigma_of_the_table() {
        // MATHS §5.2: σ_B = B²σ/(√2 R sinγ) far away; 2 % at twenty radii.
        let (range_m, gap, sigma) = (8.0, 0.6, 1e-3);
        let bar = |psi: f64| (-0.2 * psi.sin()).atan2(range_m - 0.2 * psi.cos());
        let estimate = three_bars([bar(gap), 0.0, bar(-gap)], sigma, [gap, gap], 0.2).unwrap();
        // Three bars tell (range, bearing, heading) apart: only the symmetric range has a simple far-field form,
        // from b₃ + b₁ − 2b₂ ≈ 0 and b₃ − b₁ ≈ 2R sinγ / (B − R cosγ).
        let table_m = (range_m - 0.2 * gap.cos()).powi(2) * sigma / (2f64.sqrt() * 0.2 * gap.sin());
        assert!((estimate.sigma(0) / table_m - 1.0).abs() < 0.02, "{} {table_m}", estimate.sigma(0));
    }

    #[test]
    fn a_plate_gives_the_golden_place() {
        for case in golden("rectangle")["outputs"].as_array().unwrap() {
            let marker = Marker::Rectangle {
                width_m: number(case, "W"),
                height_m: 0.5,
                left_edge_m: number(case, "L1"),
                behind_m: number(case, "off"),
                bottom_m: 0.1,
                look: None,
            };
            let view = PlateView {
                bearings_rad: ["b1", "b2"].map(|name| number(case, name)),
                bearing_sigma_rad: 1e-3,
                heights: ["h1", "h2"].map(|name| number(case, name)),
                relative_height_sigma: 1e-2,
            };
            let estimate = plate(&view, &marker).unwrap();
            assert!((estimate.value[0] / number(case, "B") - 1.0).abs() < 1e-10);
            assert!(difference(estimate.value[1], number(case, "beta21")).abs() < 1e-11);
        }
    }

    proptest! {
        #[test]
        fn covariances_are_what_central_differences_of_the_closed_forms_give(
            range_m in 0.8f64..5.0, bearing_rad in -3.0f64..3.0, turn in -0.4f64..0.4, left_edge_m in 0.05f64..0.35,
        ) {
            let sigma = 1e-3;
            // Bars.
            let psi = [turn + 0.5, turn, turn - 0.4];
            let b = psi.map(|psi| wrap(bearing_rad + (-0.2 * f64::sin(psi)).atan2(range_m - 0.2 * f64::cos(psi))));
            let solve = |b: [f64; 3]| three_bars(b, sigma, [0.5, 0.4], 0.2);
            let estimate = solve(b).unwrap();
            prop_assert!((estimate.value[0] - range_m).abs() < 1e-8);
            prop_assert!(difference(estimate.value[1], bearing_rad).abs() < 1e-9);
            prop_assert!(difference(estimate.value[2], bearing_rad + PI + turn).abs() < 1e-7);
            let numeric = spread(b, [sigma; 3], |b| solve(b).unwrap().value);
            prop_assert!((estimate.covariance - numeric).amax() < 1e-3 * numeric.amax());

            // Plate.
            let marker = Marker::Rectangle {
                width_m: 0.4, height_m: 0.5, left_edge_m, behind_m: 0.1, bottom_m: 0.1, look: None,
            };
            let peer = { let p = at(range_m, bearing_rad); Pose2::new(p.x, p.y, bearing_rad + PI + turn) };
            let distances = marker.edge_points().unwrap().map(|point| peer.transform(point));
            let [right, left] = distances;
            let solve = |m: [f64; 3]| {
                let view = PlateView {
                    bearings_rad: [m[0], m[1]],
                    bearing_sigma_rad: sigma,
                    heights: [m[2].exp(), 1.0],
                    relative_height_sigma: 5e-3,
                };
                plate(&view, &marker)
            };
            let measured = [left.y.atan2(left.x), right.y.atan2(right.x), (right.norm() / left.norm()).ln()];
            let estimate = solve(measured).unwrap();
            prop_assert!((estimate.value[0] - range_m).abs() < 1e-8);
            prop_assert!(difference(estimate.value[2], peer.heading_rad).abs() < 1e-8);
            let sigmas = [sigma, sigma, 5e-3 * 2f64.sqrt()];
            let numeric = spread(measured, sigmas, |m| solve(m).unwrap().value);
            prop_assert!((estimate.covariance - numeric).amax() < 1e-3 * numeric.amax());
        }
    }

    /// First-order covariance by central differences.
    fn spread(at: [f64; 3], sigmas: [f64; 3], f: impl Fn([f64; 3]) -> Vector3<f64>) -> Matrix3<f64> {
        let step = 1e-6;
        let mut covariance = Matrix3::zeros();
        for (k, sigma) in sigmas.into_iter().enumerate() {
            let (mut after, mut before) = (at, at);
            after[k] += step;
            before[k] -= step;
            let mut change = f(after) - f(before);
            (change[1], change[2]) = (wrap(change[1]), wrap(change[2]));
            let slope = change / (2.0 * step);
            covariance += slope * slope.transpose() * sigma * sigma;
        }
        covariance
    }
}
