//! Bearing, range and heading from the raw features, with the covariance that they deserve.
//!
//! The outlines give B = R/sin(α/2) (report eq. 5-2, corrected), the elevations of the marker's ends give B − R through the
//! camera's height, bars lie at β + atan2(R sin ψ, B − R cos ψ) with ψ = β + π − azimuth − heading (5.2.2). Weighted least
//! squares over (β, B, heading); the mounting's tilt and height are errors that both elevations share, so they enter as
//! covariance. Kinds of evidence that contradict each other widen the result instead of averaging quietly.

use std::f64::consts::PI;

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use protocol::angle::{difference, wrap};

/// What is known of one body.
#[derive(Debug, Clone)]
pub struct Evidence {
    /// Bearing and standard deviation of the left outline.
    pub left: Option<[f64; 2]>,
    /// Bearing and standard deviation of the right outline.
    pub right: Option<[f64; 2]>,
    /// Bearing of the middle from the bend of the rings, and its standard deviation.
    pub middle: [f64; 2],
    /// Elevations of the marker's ends.
    pub elevation_rad: [f64; 2],
    /// Their covariance from the picture alone.
    pub elevation_covariance: nalgebra::Matrix2<f64>,
    /// Bars: azimuth in the body frame, bearing, standard deviation.
    pub bars: Vec<[f64; 3]>,
}

/// What the mounting leaves open.
#[derive(Debug, Clone, Copy)]
pub struct Mount {
    /// Of the viewpoint above the floor, metres.
    pub height_m: f64,
    /// Metres.
    pub height_sigma_m: f64,
    /// Radians.
    pub tilt_sigma_rad: f64,
}

/// The answer.
#[derive(Debug, Clone, Copy)]
pub struct Position {
    /// Of the axis, radians.
    pub bearing_rad: f64,
    /// To the axis along the floor, metres.
    pub range_m: f64,
    /// Of the peer less the observer's; its start where no bar tells.
    pub heading_rad: f64,
    /// Of (bearing, range, heading), inflated by the misfit.
    pub covariance: Matrix3<f64>,
}

/// A residual beyond so many sigmas widens the answer.
const WORST_RESIDUAL: f64 = 2.0;
/// Without bars the heading is anything.
const HEADING_SIGMA_RAD: f64 = 10.0;

/// Least squares from a start (bearing, range, heading). `None` where the evidence does not determine bearing and range.
pub fn combine(
    evidence: &Evidence,
    radius_m: f64,
    ends_m: [f64; 2],
    mount: &Mount,
    start: (f64, f64, f64),
) -> Option<Position> {
    let (mut bearing, mut range, mut heading) = start;
    for iteration in 0..12 {
        let near = range - radius_m;
        if !(near > 0.02 && range < 50.0) {
            return None;
        }
        let half = (radius_m / range).asin();
        let half_by_range = -radius_m / (range * (range * range - radius_m * radius_m).sqrt());
        let mut rows: Vec<(f64, [f64; 3])> = Vec::with_capacity(8 + evidence.bars.len());
        let mut sigma = Vec::with_capacity(8 + evidence.bars.len());
        for (edge, sign) in [(evidence.left, 1.0), (evidence.right, -1.0)] {
            if let Some([b, s]) = edge {
                rows.push((difference(b, bearing + sign * half), [1.0, sign * half_by_range, 0.0]));
                sigma.push(s);
            }
        }
        rows.push((difference(evidence.middle[0], bearing), [1.0, 0.0, 0.0]));
        sigma.push(evidence.middle[1]);
        for [azimuth, b, s] in &evidence.bars {
            let (sin, cos) = (bearing + PI - azimuth - heading).sin_cos();
            let (across, along) = (radius_m * sin, range - radius_m * cos);
            let square = across * across + along * along;
            // d aside / dψ; ψ turns with the bearing and against the heading.
            let by_psi = radius_m * (range * cos - radius_m) / square;
            let by_range = -across / square;
            rows.push((difference(*b, bearing + across.atan2(along)), [1.0 + by_psi, by_range, -by_psi]));
            sigma.push(*s);
        }
        rows.push((0.0, [0.0, 0.0, 1.0]));
        sigma.push(HEADING_SIGMA_RAD);
        let white = rows.len();
        let n = white + 2;
        let mut covariance = DMatrix::<f64>::zeros(n, n);
        for (i, s) in sigma.iter().enumerate() {
            covariance[(i, i)] = s * s;
        }
        let mut by_height = [0.0; 2];
        for k in 0..2 {
            let drop = ends_m[k] - mount.height_m;
            let square = near * near + drop * drop;
            rows.push((evidence.elevation_rad[k] - drop.atan2(near), [0.0, -drop / square, 0.0]));
            by_height[k] = -near / square;
        }
        for i in 0..2 {
            for j in 0..2 {
                covariance[(white + i, white + j)] = evidence.elevation_covariance[(i, j)]
                    + mount.tilt_sigma_rad.powi(2)
                    + by_height[i] * by_height[j] * mount.height_sigma_m.powi(2);
            }
        }
        let weight = covariance.cholesky()?.inverse();
        let jacobian = DMatrix::from_fn(n, 3, |i, j| rows[i].1[j]);
        let residual = DVector::from_fn(n, |i, _| rows[i].0);
        let weighted = jacobian.transpose() * &weight;
        let normal: Matrix3<f64> = (&weighted * &jacobian).fixed_view::<3, 3>(0, 0).into_owned();
        let gradient: Vector3<f64> = (&weighted * &residual).fixed_rows::<3>(0).into_owned();
        let inverse = normal.try_inverse()?;
        let delta = inverse * gradient;
        if !delta.iter().all(|d| d.is_finite()) {
            return None;
        }
        bearing += delta[0];
        range += delta[1].clamp(-0.3 * near, 0.5 * near);
        heading += delta[2].clamp(-0.2, 0.2);
        let is_small = delta[0].abs() < 1e-9 && delta[1].abs() < 1e-8 && delta[2].abs() < 1e-7;
        if is_small || iteration == 11 {
            let chi2 = (residual.transpose() * &weight * &residual)[0];
            // The heading and its prior take each other away.
            let dof = if evidence.bars.is_empty() { n - 3 } else { n - 4 };
            // One that contradicts all the others is not made good by their number.
            let worst =
                (0..white).map(|i| (residual[i] / sigma[i]).powi(2)).fold(0.0, f64::max) / WORST_RESIDUAL.powi(2);
            return Some(Position {
                bearing_rad: wrap(bearing),
                range_m: range,
                heading_rad: wrap(heading),
                covariance: inverse * (chi2 / dof as f64).max(worst).max(1.0),
            });
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix2;

    use super::*;

    fn seen(bearing: f64, range: f64, mount: &Mount) -> Evidence {
        let half = (0.2 / range).asin();
        let end = |z: f64| (z - mount.height_m).atan2(range - 0.2);
        Evidence {
            left: Some([bearing + half, 1e-4]),
            right: Some([bearing - half, 1e-4]),
            middle: [bearing, 1e-3],
            elevation_rad: [end(0.1), end(0.5)],
            elevation_covariance: Matrix2::identity() * 1e-8,
            bars: Vec::new(),
        }
    }

    #[test]
    fn exact_features_give_the_exact_place_across_the_seam() {
        let mount = Mount { height_m: 0.6, height_sigma_m: 0.005, tilt_sigma_rad: 0.002 };
        for (bearing, range) in [(3.12, 1.0), (-3.13, 3.0), (0.3, 6.0)] {
            let found =
                combine(&seen(bearing, range, &mount), 0.2, [0.1, 0.5], &mount, (bearing + 0.02, range * 1.1, 0.0));
            let found = found.unwrap();
            assert!(difference(found.bearing_rad, bearing).abs() < 1e-9);
            assert!((found.range_m - range).abs() < 1e-7);
        }
    }

    #[test]
    fn outlines_alone_have_the_sigma_of_the_closed_form() {
        // MATHS §5.2: σ_B = B√(B²−R²)/(2R)·√2σ; the elevations are made worthless by the tilt.
        let mount = Mount { height_m: 0.6, height_sigma_m: 10.0, tilt_sigma_rad: 10.0 };
        let mut evidence = seen(0.0, 3.0, &mount);
        evidence.elevation_covariance = Matrix2::identity() * 100.0;
        let found = combine(&evidence, 0.2, [0.1, 0.5], &mount, (0.0, 3.0, 0.0)).unwrap();
        let expected = 3.0 * (9.0_f64 - 0.04).sqrt() / 0.4 * 2_f64.sqrt() * 1e-4;
        assert!((found.covariance[(1, 1)].sqrt() / expected - 1.0).abs() < 1e-3);
    }

    #[test]
    fn exact_bars_give_the_exact_heading_and_sharpen_the_range() {
        let mount = Mount { height_m: 0.6, height_sigma_m: 0.005, tilt_sigma_rad: 0.002 };
        let mut evidence = seen(3.0, 2.0, &mount);
        let plain = combine(&evidence, 0.2, [0.1, 0.5], &mount, (3.0, 2.0, 0.0)).unwrap();
        let marker = protocol::marker::Marker::Bars {
            radius_m: 0.2,
            azimuths_deg: vec![0.0, 40.0, 95.0, 150.0, 200.0, 260.0, 310.0],
            height_m: [0.1, 0.5],
            code: None,
            look: None,
        };
        let peer = protocol::frames::Pose2::new(2.0 * 3f64.cos(), 2.0 * 3f64.sin(), -2.5);
        let protocol::marker::Marker::Bars { azimuths_deg, .. } = &marker else { panic!() };
        for feature in marker.features(&peer, 0.6) {
            let protocol::message::observation::FeaturePart::Bar(Some(n)) = feature.part else { panic!() };
            evidence.bars.push([azimuths_deg[usize::from(n)].to_radians(), feature.bearing_rad, 1e-4]);
        }
        let found = combine(&evidence, 0.2, [0.1, 0.5], &mount, (3.01, 2.05, -2.45)).unwrap();
        assert!(difference(found.heading_rad, -2.5).abs() < 1e-6 && (found.range_m - 2.0).abs() < 1e-6);
        assert!(found.covariance[(1, 1)] < 0.9 * plain.covariance[(1, 1)]);
        // MATHS §5.2: eight bars alone give 9.3° at 2 m for bearings of 5.818 mrad.
        assert!(found.covariance[(2, 2)].sqrt() < 9.3_f64.to_radians() * 1e-4 / 5.818e-3);
    }

    #[test]
    fn contradicting_evidence_widens_the_answer() {
        let mount = Mount { height_m: 0.6, height_sigma_m: 0.0, tilt_sigma_rad: 0.0 };
        let mut evidence = seen(0.0, 3.0, &mount);
        let honest = combine(&evidence, 0.2, [0.1, 0.5], &mount, (0.0, 3.0, 0.0)).unwrap();
        evidence.elevation_rad = [-0.5_f64.atan2(4.0), -0.1_f64.atan2(4.0)];
        let torn = combine(&evidence, 0.2, [0.1, 0.5], &mount, (0.0, 3.0, 0.0)).unwrap();
        assert!(torn.covariance[(1, 1)] > 100.0 * honest.covariance[(1, 1)]);
    }
}
