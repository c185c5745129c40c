//! Where a marker's features appear in a fellow's picture, with derivatives.
//!
//! Everything follows from two facts of geometry. A point of the marker at q (seen from the observer's axis, in its body
//! frame) has bearing atan2(q_y, q_x). The occluding edges of a cylinder are the tangents, asin(R/B) either side of its
//! axis (`MATHS.md` §5.2, erratum to 5-2). Bars and plate edges are points of the peer's body, so they turn with it and
//! tell its heading. An end at height z appears at elevation atan2(z − camera, distance), where the distance is that of
//! the near surface: B − R on a cylinder's axis ray, |q| for a point.
//!
//! ```text
//!            Left, Edge(1)                     q = t + R(h) p     t, h: the peer's pose in the observer's body frame
//!           /                                                     p: the feature in the peer's body frame
//! observer ---------- axis of the peer         bars       p = R (cos κ, sin κ)
//!           \                                  rectangle  p = (d, −L₁) and (d, W − L₁): the plate looks forward,
//!            Right, Edge(0)                               its edges named as an observer in front sees them
//! ```

use std::f64::consts::PI;

use nalgebra::{Matrix3, RowVector3, Vector2};

use super::Marker;
use crate::angle::{difference, wrap};
use crate::frames::Pose2;
use crate::message::observation::FeaturePart;

/// A predicted feature. Derivatives are to (x, y, heading) of the peer in the observer's body frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PredictedFeature {
    /// Which; a bar always with its index in `azimuths_deg`.
    pub part: FeaturePart,
    /// In the observer's body frame, in (−π, π].
    pub bearing_rad: f64,
    /// d bearing.
    pub bearing_jacobian: RowVector3<f64>,
    /// Of the lower and upper end.
    pub elevation_rad: [f64; 2],
    /// d elevation of the two ends.
    pub elevation_jacobian: [RowVector3<f64>; 2],
}

impl Marker {
    /// The features of a peer with this marker that stands at `observer_from_peer` in the body frame of an observer whose
    /// camera is `camera_height_m` above the floor: from right to left, only those turned to the observer. Occlusion by
    /// others and the field of view are the caller's. Empty where the observer stands inside the marker.
    pub fn features(&self, observer_from_peer: &Pose2, camera_height_m: f64) -> Vec<PredictedFeature> {
        let rise = |height_m: [f64; 2]| height_m.map(|z| z - camera_height_m);
        match self {
            Self::Cylinder { radius_m, height_m, .. } => tangents(observer_from_peer, *radius_m, rise(*height_m)),
            Self::Bars { radius_m, azimuths_deg, height_m, .. } => {
                bars(observer_from_peer, *radius_m, azimuths_deg, rise(*height_m))
            }
            Self::Rectangle { bottom_m, height_m, .. } => {
                let rise = rise([*bottom_m, bottom_m + height_m]);
                plate(observer_from_peer, self.edge_points().unwrap_or_default(), rise)
            }
        }
    }

    /// The right and left edge (0 and 1) of a rectangle in the peer's body frame; `None` for other markers.
    pub fn edge_points(&self) -> Option<[Vector2<f64>; 2]> {
        match self {
            Self::Rectangle { width_m, left_edge_m, behind_m, .. } => {
                Some([Vector2::new(*behind_m, width_m - left_edge_m), Vector2::new(*behind_m, -left_edge_m)])
            }
            _ => None,
        }
    }
}

/// d(x, y, heading) / d(range, bearing, heading) of a peer's pose in the observer's body frame: multiply a feature's
/// Jacobian with it from the right.
pub fn polar_jacobian(observer_from_peer: &Pose2) -> Matrix3<f64> {
    let range_m = observer_from_peer.position().norm();
    let (s, c) = observer_from_peer.y_m.atan2(observer_from_peer.x_m).sin_cos();
    Matrix3::new(c, -range_m * s, 0.0, s, range_m * c, 0.0, 0.0, 0.0, 1.0)
}

fn tangents(observer_from_peer: &Pose2, radius_m: f64, rise_m: [f64; 2]) -> Vec<PredictedFeature> {
    let axis = observer_from_peer.position();
    let range_m = axis.norm();
    if range_m <= radius_m {
        return Vec::new();
    }
    let bearing_rad = axis.y.atan2(axis.x);
    let to_bearing = RowVector3::new(-axis.y, axis.x, 0.0) / range_m.powi(2);
    let to_range = RowVector3::new(axis.x, axis.y, 0.0) / range_m;
    // d asin(R/B) = −R / (B √(B² − R²)) dB.
    let half_rad = (radius_m / range_m).asin();
    let half_slope = -radius_m / (range_m * (range_m.powi(2) - radius_m.powi(2)).sqrt());
    let (elevation_rad, elevation_jacobian) = elevations(rise_m, range_m - radius_m, &to_range);
    [(FeaturePart::Right, -1.0), (FeaturePart::Left, 1.0)]
        .map(|(part, side)| PredictedFeature {
            part,
            bearing_rad: wrap(bearing_rad + side * half_rad),
            bearing_jacobian: to_bearing + to_range * (side * half_slope),
            elevation_rad,
            elevation_jacobian,
        })
        .to_vec()
}

fn bars(observer_from_peer: &Pose2, radius_m: f64, azimuths_deg: &[f64], rise_m: [f64; 2]) -> Vec<PredictedFeature> {
    let back = observer_from_peer.inverse().position();
    let range_m = back.norm();
    if range_m <= radius_m {
        return Vec::new();
    }
    // ψ, the bar's angle at the peer's axis from the observer, is seen below acos(R/B).
    let limit_rad = (radius_m / range_m).acos();
    let towards_observer_rad = back.y.atan2(back.x);
    let mut seen: Vec<(f64, PredictedFeature)> = Vec::new();
    for (index, azimuth_deg) in azimuths_deg.iter().enumerate() {
        let azimuth_rad = azimuth_deg.to_radians();
        let psi_rad = difference(azimuth_rad, towards_observer_rad);
        if psi_rad.abs() >= limit_rad {
            continue;
        }
        let (s, c) = azimuth_rad.sin_cos();
        let part = FeaturePart::Bar(u8::try_from(index).ok());
        let feature = point(observer_from_peer, Vector2::new(radius_m * c, radius_m * s), part, rise_m);
        seen.push((psi_rad, feature));
    }
    // Seen from the observer, a larger azimuth on the near side lies further to the right.
    seen.sort_by(|a, b| b.0.total_cmp(&a.0));
    seen.into_iter().map(|(_, feature)| feature).collect()
}

fn plate(observer_from_peer: &Pose2, edges: [Vector2<f64>; 2], rise_m: [f64; 2]) -> Vec<PredictedFeature> {
    // In front of the plate: further along the peer's x than the plate is.
    if observer_from_peer.inverse().x_m <= edges[0].x {
        return Vec::new();
    }
    [0, 1].map(|edge| point(observer_from_peer, edges[usize::from(edge)], FeaturePart::Edge(edge), rise_m)).to_vec()
}

fn point(observer_from_peer: &Pose2, at_peer: Vector2<f64>, part: FeaturePart, rise_m: [f64; 2]) -> PredictedFeature {
    let q = observer_from_peer.transform(at_peer);
    let (to_pose, _) = observer_from_peer.transform_jacobians(at_peer);
    let distance_m = q.norm();
    let to_bearing = nalgebra::RowVector2::new(-q.y, q.x) / distance_m.powi(2) * to_pose;
    let to_distance = q.transpose() / distance_m * to_pose;
    let (elevation_rad, elevation_jacobian) = elevations(rise_m, distance_m, &to_distance);
    let bearing_rad = q.y.atan2(q.x);
    let bearing_rad = if bearing_rad <= -PI { PI } else { bearing_rad };
    PredictedFeature { part, bearing_rad, bearing_jacobian: to_bearing, elevation_rad, elevation_jacobian }
}

/// atan2(rise, distance) and its derivative −rise / (rise² + distance²) d distance.
fn elevations(rise_m: [f64; 2], distance_m: f64, to_distance: &RowVector3<f64>) -> ([f64; 2], [RowVector3<f64>; 2]) {
    let slope = |rise: f64| -rise / (rise.powi(2) + distance_m.powi(2));
    (rise_m.map(|rise| rise.atan2(distance_m)), rise_m.map(|rise| to_distance * slope(rise)))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::marker::golden::{golden, number, numbers};

    const CAMERA_M: f64 = 0.6;

    #[test]
    fn a_cylinders_edges_are_as_far_apart_as_the_golden_numbers_say() {
        let group = golden("cylinder");
        let radius_m = number(&group["inputs"], "R");
        for case in group["outputs"].as_array().unwrap() {
            let peer = Pose2::new(number(case, "B"), 0.0, 1.0);
            let features = cylinder(radius_m).features(&peer, CAMERA_M);
            assert_eq!([features[0].part, features[1].part], [FeaturePart::Right, FeaturePart::Left]);
            let width_rad = features[1].bearing_rad - features[0].bearing_rad;
            assert!((width_rad / number(case, "alpha") - 1.0).abs() < 1e-11);
        }
    }

    #[test]
    fn bars_appear_where_the_golden_least_squares_fit_puts_them() {
        let group = golden("barsN");
        let (inputs, outputs) = (&group["inputs"], &group["outputs"]);
        let [range_m, bearing_rad, omega] = ["B", "beta21", "omega"].map(|name| number(outputs, name));
        // ψ_k = ω − g_k from the direction back to the observer: a body turned by β + π + ω with bars at −g_k.
        let azimuths_deg = numbers(inputs, "g").iter().map(|g| -g.to_degrees()).collect();
        let marker =
            Marker::Bars { radius_m: number(inputs, "R"), azimuths_deg, height_m: [0.1, 0.5], code: None, look: None };
        let features = marker.features(&polar(range_m, bearing_rad, bearing_rad + PI + omega), CAMERA_M);
        let (measured, residuals) = (numbers(inputs, "b"), numbers(outputs, "resid"));
        assert_eq!(features.len(), measured.len());
        for ((feature, b), residual) in features.iter().zip(&measured).zip(&residuals) {
            assert!(((feature.bearing_rad - b).abs() - residual.abs()).abs() < 1e-8, "{feature:?}");
        }
        // JᵀJ in (range, bearing, heading) is the inverse of the golden covariance for unit noise.
        let polar_j = polar_jacobian(&polar(range_m, bearing_rad, bearing_rad + PI + omega));
        let mut information = Matrix3::zeros();
        for feature in &features {
            // ω = heading − bearing − π: the golden parameters are (B, β, ω), so d heading/dβ = 1.
            let mut j = feature.bearing_jacobian * polar_j;
            j[1] += j[2];
            information += j.transpose() * j;
        }
        let covariance = information.try_inverse().unwrap();
        for (row, golden_row) in outputs["cov_unit"].as_array().unwrap().iter().enumerate() {
            for (column, value) in golden_row.as_array().unwrap().iter().enumerate() {
                let golden = value.as_f64().unwrap();
                assert!((covariance[(row, column)] - golden).abs() < 1e-5 * golden.abs().max(100.0));
            }
        }
    }

    #[test]
    fn three_bars_appear_at_the_golden_bearings() {
        for case in golden("bars3")["outputs"].as_array().unwrap() {
            let (b, g) = (numbers(case, "b"), numbers(case, "g"));
            let [range_m, bearing_rad, middle_m] = ["B", "beta21", "B1"].map(|name| number(case, name));
            // The middle bar is on the circle, at B₁ on its ray: that gives its azimuth at the axis.
            let axis = polar(range_m, bearing_rad, 0.0).position();
            let out = polar(middle_m, b[1], 0.0).position() - axis;
            let azimuth_deg = out.y.atan2(out.x).to_degrees();
            let [first, last] = [azimuth_deg + g[0].to_degrees(), azimuth_deg - g[1].to_degrees()];
            let marker = Marker::Bars {
                radius_m: 0.2,
                azimuths_deg: vec![last, azimuth_deg, first],
                height_m: [0.1, 0.5],
                code: None,
                look: None,
            };
            assert!((out.norm() - 0.2).abs() < 1e-11);
            let features = marker.features(&polar(range_m, bearing_rad, 0.0), CAMERA_M);
            for (feature, b) in features.iter().zip(&b) {
                assert!(difference(feature.bearing_rad, *b).abs() < 1e-11, "{feature:?} {b}");
            }
            let order = [2, 1, 0].map(|index| FeaturePart::Bar(Some(index)));
            assert_eq!(features.iter().map(|feature| feature.part).collect::<Vec<_>>(), order);
        }
    }

    #[test]
    fn a_plates_edges_appear_at_the_golden_bearings_and_distances() {
        for case in golden("rectangle")["outputs"].as_array().unwrap() {
            let [b1, b2, d1, d2, range_m, bearing_rad] =
                ["b1", "b2", "B1", "B2", "B", "beta21"].map(|name| number(case, name));
            // The plate's own direction, from its golden edges: P₁ to P₂ is the peer's left.
            let along = polar(d2, b2, 0.0).position() - polar(d1, b1, 0.0).position();
            let heading_rad = along.y.atan2(along.x) - 0.5 * PI;
            let marker = Marker::Rectangle {
                width_m: number(case, "W"),
                height_m: 0.3,
                left_edge_m: number(case, "L1"),
                behind_m: number(case, "off"),
                bottom_m: 0.1,
                look: None,
            };
            let features = marker.features(&polar(range_m, bearing_rad, heading_rad), CAMERA_M);
            let [right, left] = features[..] else { panic!("{} edges", features.len()) };
            assert_eq!([right.part, left.part], [FeaturePart::Edge(0), FeaturePart::Edge(1)]);
            assert!(difference(left.bearing_rad, b1).abs() < 1e-11 && difference(right.bearing_rad, b2).abs() < 1e-11);
            // Heights on the cylinder, tan(top) − tan(bottom), are as the inverse distances (5-10 corrected).
            let height = |feature: &PredictedFeature| feature.elevation_rad[1].tan() - feature.elevation_rad[0].tan();
            let golden_ratio = number(case, "h1") / number(case, "h2");
            assert!((height(&left) / height(&right) / golden_ratio - 1.0).abs() < 1e-11);
        }
    }

    #[test]
    fn ends_appear_where_a_line_to_them_on_the_near_side_goes() {
        let features = cylinder(0.2).features(&polar(1.2, 0.3, 0.0), CAMERA_M);
        // One metre to the near side; 0.5 m and 0.1 m below the camera.
        for (elevation, expected) in features[0].elevation_rad.iter().zip([-0.5f64, -0.1]) {
            assert!((elevation.tan() - expected).abs() < 1e-12);
        }
    }

    #[test]
    fn nothing_is_seen_from_inside_or_from_behind() {
        assert!(cylinder(0.2).features(&Pose2::new(0.1, 0.1, 0.0), CAMERA_M).is_empty());
        let plate = Marker::Rectangle {
            width_m: 0.4,
            height_m: 0.3,
            left_edge_m: 0.1,
            behind_m: 0.1,
            bottom_m: 0.1,
            look: None,
        };
        // The peer looks away from the observer, and to it.
        assert!(plate.features(&Pose2::new(2.0, 0.0, 0.0), CAMERA_M).is_empty());
        let features = plate.features(&Pose2::new(2.0, 0.0, PI), CAMERA_M);
        assert!(features[0].bearing_rad < features[1].bearing_rad);
        // L₁ = 0.1 m is on the observer's left: 0.1 m at a distance of 1.9 m; the other 0.3 m.
        assert!((features[1].bearing_rad - (0.1f64 / 1.9).atan()).abs() < 1e-12);
        assert!((features[0].bearing_rad + (0.3f64 / 1.9).atan()).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn jacobians_are_what_central_differences_give(
            range_m in 0.6..6.0, bearing_rad in -3.1..3.1, heading_rad in -3.1..3.1, kind in 0usize..3,
        ) {
            let marker = &markers()[kind];
            let peer = polar(range_m, bearing_rad, heading_rad);
            let step = 1e-6;
            for feature in marker.features(&peer, CAMERA_M) {
                for (axis, moved) in [(0, [step, 0.0, 0.0]), (1, [0.0, step, 0.0]), (2, [0.0, 0.0, step])] {
                    let at = |sign: f64| {
                        let [dx, dy, dh] = moved.map(|d| sign * d);
                        let pose = Pose2::new(peer.x_m + dx, peer.y_m + dy, peer.heading_rad + dh);
                        marker.features(&pose, CAMERA_M).into_iter().find(|f| f.part == feature.part)
                    };
                    // A bar may vanish between the two sides.
                    let (Some(after), Some(before)) = (at(1.0), at(-1.0)) else { continue };
                    let slope = difference(after.bearing_rad, before.bearing_rad) / (2.0 * step);
                    prop_assert!((feature.bearing_jacobian[axis] - slope).abs() < 1e-6);
                    for end in 0..2 {
                        let slope = (after.elevation_rad[end] - before.elevation_rad[end]) / (2.0 * step);
                        prop_assert!((feature.elevation_jacobian[end][axis] - slope).abs() < 1e-6);
                    }
                }
            }
        }

        #[test]
        fn features_come_from_right_to_left_of_the_axis_within_the_outline(
            range_m in 0.6..6.0, bearing_rad in -3.1..3.1, heading_rad in -3.1..3.1, kind in 0usize..2,
        ) {
            let features = markers()[kind].features(&polar(range_m, bearing_rad, heading_rad), CAMERA_M);
            let offsets: Vec<f64> = features.iter().map(|f| difference(f.bearing_rad, bearing_rad)).collect();
            prop_assert!(offsets.windows(2).all(|pair| pair[0] < pair[1]));
            prop_assert!(offsets.iter().all(|offset| offset.abs() <= (0.2f64 / range_m).asin() + 1e-12));
            prop_assert!(!features.is_empty());
        }
    }

    fn cylinder(radius_m: f64) -> Marker {
        Marker::Cylinder { radius_m, height_m: [0.1, 0.5], look: None }
    }

    fn markers() -> [Marker; 3] {
        let azimuths_deg = vec![0.0, 30.0, 75.0, 120.0, 180.0, 220.0, 260.0, 310.0];
        let (height_m, code, look) = ([0.1, 0.5], None, None);
        let plate = Marker::Rectangle {
            width_m: 0.4,
            height_m: 0.3,
            left_edge_m: 0.15,
            behind_m: 0.1,
            bottom_m: 0.2,
            look: None,
        };
        [cylinder(0.2), Marker::Bars { radius_m: 0.2, azimuths_deg, height_m, code, look }, plate]
    }

    fn polar(range_m: f64, bearing_rad: f64, heading_rad: f64) -> Pose2 {
        Pose2::new(range_m * bearing_rad.cos(), range_m * bearing_rad.sin(), heading_rad)
    }
}
