//! The lens distortion of OpenCV, k₁, k₂, p₁, p₂, k₃, on the normalised image plane, and its inverse.
//!
//! Problem: the polynomial turns back far from the axis, and a point there would appear inside the picture where it is
//! not. Insight: up to the first turning point of r(1 + k₁r² + k₂r⁴ + k₃r⁶) the map is one to one, so that radius
//! bounds the domain, and within it the inverse is a Newton iteration from the distorted point itself.
//! Source: OpenCV's `calib3d` camera model.

use nalgebra::{Matrix2, Vector2};

/// The coefficients and the radius up to which they are one to one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LensDistortion {
    coefficients: [f64; 5],
    /// Square of the undistorted radius where the distortion turns back.
    pub(crate) turning_radius_squared: f64,
}

impl LensDistortion {
    /// k₁, k₂, p₁, p₂, k₃ as OpenCV orders them.
    pub(crate) fn new(coefficients: [f64; 5]) -> Self {
        Self { coefficients, turning_radius_squared: turning_radius_squared(coefficients) }
    }

    /// Distorted point and its Jacobian; `None` where the distortion is not one to one.
    pub(crate) fn distort(&self, p: &Vector2<f64>) -> Option<(Vector2<f64>, Matrix2<f64>)> {
        let (distorted, jacobian) = self.evaluate(p);
        let regular = p.norm_squared() < self.turning_radius_squared && jacobian.determinant() > 0.0;
        regular.then_some((distorted, jacobian))
    }

    fn evaluate(&self, p: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        let [k1, k2, p1, p2, k3] = self.coefficients;
        let (x, y) = (p.x, p.y);
        let s = x * x + y * y;
        let radial = 1.0 + s * (k1 + s * (k2 + s * k3));
        let slope = k1 + s * (2.0 * k2 + s * 3.0 * k3);
        let distorted = Vector2::new(
            x * radial + 2.0 * p1 * x * y + p2 * (s + 2.0 * x * x),
            y * radial + p1 * (s + 2.0 * y * y) + 2.0 * p2 * x * y,
        );
        let mixed = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y;
        let jacobian = Matrix2::new(
            radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x,
            mixed,
            mixed,
            radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x,
        );
        (distorted, jacobian)
    }

    /// The point that the distortion moved there; `None` beyond the turning radius.
    pub(crate) fn undistort(&self, distorted: &Vector2<f64>) -> Option<Vector2<f64>> {
        const STEPS: usize = 50;
        if self.coefficients == [0.0; 5] {
            return Some(*distorted);
        }
        let limit = self.turning_radius_squared.sqrt();
        let mut point = *distorted;
        if point.norm() >= limit {
            point *= 0.99 * limit / point.norm();
        }
        for _ in 0..STEPS {
            let (value, jacobian) = self.evaluate(&point);
            let error = value - distorted;
            if error.norm() < 1e-14 * (1.0 + distorted.norm()) {
                break;
            }
            let mut step = jacobian.try_inverse()? * error;
            // Near the turning point a full step may leave the one-to-one disc: halve it.
            let mut halvings = 0;
            while (point - step).norm() >= limit && halvings < 40 {
                step *= 0.5;
                halvings += 1;
            }
            point -= step;
        }
        let (value, _) = self.distort(&point)?;
        ((value - distorted).norm() < 1e-11 * (1.0 + distorted.norm())).then_some(point)
    }
}

/// The least s = r² > 0 with 1 + 3k₁s + 5k₂s² + 7k₃s³ = 0, infinite where there is none: bracketed on a geometric grid
/// from 10⁻⁶ to 10⁶ (0.06° to 89.94° off the axis), then bisected.
fn turning_radius_squared([k1, k2, _, _, k3]: [f64; 5]) -> f64 {
    let slope = |s: f64| 1.0 + s * (3.0 * k1 + s * (5.0 * k2 + s * 7.0 * k3));
    if [k1, k2, k3].iter().all(|k| *k >= 0.0) {
        return f64::INFINITY;
    }
    let ratio: f64 = 1.01;
    let mut low = 1e-6;
    while low < 1e6 {
        let high = low * ratio;
        if slope(high) <= 0.0 {
            let (mut a, mut b) = (low, high);
            for _ in 0..60 {
                let middle = 0.5 * (a + b);
                if slope(middle) > 0.0 { a = middle } else { b = middle }
            }
            return a;
        }
        low = high;
    }
    f64::INFINITY
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distortion_agrees_with_opencv_by_hand() {
        // (x, y) = (0.3, -0.2): r² = 0.13, radial = 1 + 0.13·(-0.28) + 0.0169·0.09 + 0.002197·(-0.012)
        let radial = 1.0 - 0.0364 + 0.001521 - 0.000026364;
        let x = 0.3 * radial + 2.0 * 1e-3 * 0.3 * -0.2 + -5e-4 * (0.13 + 0.18);
        let y = -0.2 * radial + 1e-3 * (0.13 + 0.08) + 2.0 * -5e-4 * 0.3 * -0.2;
        let lens = LensDistortion::new([-0.28, 0.09, 1e-3, -5e-4, -0.012]);
        let (distorted, _) = lens.distort(&Vector2::new(0.3, -0.2)).unwrap();
        assert!((distorted - Vector2::new(x, y)).norm() < 1e-15);
    }

    #[test]
    fn there_is_no_image_beyond_the_turning_radius() {
        // k1 = -1: r(1 - r²) turns at r = 1/√3 = 0.577 and would come back to the centre at r = 1.
        let lens = LensDistortion::new([-1.0, 0.0, 0.0, 0.0, 0.0]);
        assert!((lens.turning_radius_squared - 1.0 / 3.0).abs() < 1e-9);
        assert!(lens.distort(&Vector2::new(0.9, 0.0)).is_none());
        assert!(lens.distort(&Vector2::new(0.4, 0.0)).is_some());
    }
}
