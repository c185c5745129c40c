//! Bearing and range from the raw features, with the covariance that they deserve.
//!
//! The outlines give B = R/sin(α/2) (report eq. 5-2, corrected), the elevations of the marker's ends give B − R through the
//! camera's height. Weighted least squares over (β, B); the mounting's tilt and height are errors that both elevations share,
//! so they enter as covariance. Two kinds of evidence that contradict each other widen the result instead of averaging quietly.

use nalgebra::{DMatrix, DVector, Matrix2, Vector2};

/// What is known of one body.
#[derive(Debug, Clone, Copy)]
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
    pub elevation_covariance: Matrix2<f64>,
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
    /// Of (bearing, range), inflated by the misfit.
    pub covariance: Matrix2<f64>,
}

/// Least squares from a start (bearing, range). `None` where the evidence does not determine both.
pub fn combine(
    evidence: &Evidence,
    radius_m: f64,
    ends_m: [f64; 2],
    mount: &Mount,
    start: (f64, f64),
) -> Option<Position> {
    let (mut bearing, mut range) = start;
    for iteration in 0..12 {
        let near = range - radius_m;
        if !(near > 0.02 && range < 50.0) {
            return None;
        }
        let half = (radius_m / range).asin();
        let half_by_range = -radius_m / (range * (range * range - radius_m * radius_m).sqrt());
        let mut rows: Vec<(f64, [f64; 2])> = Vec::with_capacity(5);
        let mut sigma = Vec::with_capacity(5);
        for (edge, sign) in [(evidence.left, 1.0), (evidence.right, -1.0)] {
            if let Some([b, s]) = edge {
                rows.push((protocol::angle::difference(b, bearing + sign * half), [1.0, sign * half_by_range]));
                sigma.push(s);
            }
        }
        if rows.len() < 2 {
            rows.push((protocol::angle::difference(evidence.middle[0], bearing), [1.0, 0.0]));
            sigma.push(evidence.middle[1]);
        }
        let edges = rows.len();
        let n = edges + 2;
        let mut covariance = DMatrix::<f64>::zeros(n, n);
        for (i, s) in sigma.iter().enumerate() {
            covariance[(i, i)] = s * s;
        }
        let mut by_height = [0.0; 2];
        for k in 0..2 {
            let drop = ends_m[k] - mount.height_m;
            let square = near * near + drop * drop;
            rows.push((evidence.elevation_rad[k] - drop.atan2(near), [0.0, -drop / square]));
            by_height[k] = -near / square;
        }
        for i in 0..2 {
            for j in 0..2 {
                covariance[(edges + i, edges + j)] = evidence.elevation_covariance[(i, j)]
                    + mount.tilt_sigma_rad.powi(2)
                    + by_height[i] * by_height[j] * mount.height_sigma_m.powi(2);
            }
        }
        let weight = covariance.cholesky()?.inverse();
        let jacobian = DMatrix::from_fn(n, 2, |i, j| rows[i].1[j]);
        let residual = DVector::from_fn(n, |i, _| rows[i].0);
        let normal = jacobian.transpose() * &weight * &jacobian;
        let gradient = jacobian.transpose() * &weight * &residual;
        let normal = Matrix2::new(normal[(0, 0)], normal[(0, 1)], normal[(1, 0)], normal[(1, 1)]);
        let inverse = normal.try_inverse()?;
        let delta = inverse * Vector2::new(gradient[0], gradient[1]);
        if !(delta[0].is_finite() && delta[1].is_finite()) {
            return None;
        }
        bearing += delta[0];
        range += delta[1].clamp(-0.3 * near, 0.5 * near);
        if (delta[0].abs() < 1e-9 && delta[1].abs() < 1e-8) || iteration == 11 {
            let chi2 = (residual.transpose() * &weight * &residual)[0];
            let dof = n - 2;
            return Some(Position {
                bearing_rad: protocol::angle::wrap(bearing),
                range_m: range,
                covariance: inverse * (chi2 / dof as f64).max(1.0),
            });
        }
    }
    None
}

#[cfg(test)]
mod tests {
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
        }
    }

    #[test]
    fn exact_features_give_the_exact_place_across_the_seam() {
        let mount = Mount { height_m: 0.6, height_sigma_m: 0.005, tilt_sigma_rad: 0.002 };
        for (bearing, range) in [(3.12, 1.0), (-3.13, 3.0), (0.3, 6.0)] {
            let found = combine(&seen(bearing, range, &mount), 0.2, [0.1, 0.5], &mount, (bearing + 0.02, range * 1.1));
            let found = found.unwrap();
            assert!(protocol::angle::difference(found.bearing_rad, bearing).abs() < 1e-9);
            assert!((found.range_m - range).abs() < 1e-7);
        }
    }

    #[test]
    fn outlines_alone_have_the_sigma_of_the_closed_form() {
        // MATHS §5.2: σ_B = B√(B²−R²)/(2R)·√2σ; the elevations are made worthless by the tilt.
        let mount = Mount { height_m: 0.6, height_sigma_m: 10.0, tilt_sigma_rad: 10.0 };
        let mut evidence = seen(0.0, 3.0, &mount);
        evidence.elevation_covariance = Matrix2::identity() * 100.0;
        let found = combine(&evidence, 0.2, [0.1, 0.5], &mount, (0.0, 3.0)).unwrap();
        let expected = 3.0 * (9.0_f64 - 0.04).sqrt() / 0.4 * 2_f64.sqrt() * 1e-4;
        assert!((found.covariance[(1, 1)].sqrt() / expected - 1.0).abs() < 1e-3);
    }

    #[test]
    fn contradicting_evidence_widens_the_answer() {
        let mount = Mount { height_m: 0.6, height_sigma_m: 0.0, tilt_sigma_rad: 0.0 };
        let mut evidence = seen(0.0, 3.0, &mount);
        let honest = combine(&evidence, 0.2, [0.1, 0.5], &mount, (0.0, 3.0)).unwrap();
        evidence.elevation_rad = [-0.5_f64.atan2(4.0), -0.1_f64.atan2(4.0)];
        let torn = combine(&evidence, 0.2, [0.1, 0.5], &mount, (0.0, 3.0)).unwrap();
        assert!(torn.covariance[(1, 1)] > 100.0 * honest.covariance[(1, 1)]);
    }
}
