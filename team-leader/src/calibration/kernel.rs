//! What one robot sees of another, with derivatives. Plain numbers in, plain numbers out.

/// Radius that turns a range into an apparent width, metres. A range's error grows with its square, that of the width is
/// the same everywhere: averages and sums of squares are taken there, whatever the marker (2 asin(R₀/B), errata of 5-2).
pub const REFERENCE_RADIUS_M: f64 = 0.2;

/// Ranges below are inside the other robot, metres.
pub const LEAST_RANGE_M: f64 = 1.05 * REFERENCE_RADIUS_M;

/// Apparent width of the reference cylinder at `range_m` (clamped from below at [`LEAST_RANGE_M`]) and its derivative.
pub fn width(range_m: f64) -> (f64, f64) {
    let b = range_m.max(LEAST_RANGE_M);
    let r = REFERENCE_RADIUS_M;
    (2.0 * (r / b).asin(), -2.0 * r / (b * (b * b - r * r).sqrt()))
}

/// Range of the reference cylinder of apparent `width_rad` (clamped to the domain).
pub fn range(width_rad: f64) -> f64 {
    REFERENCE_RADIUS_M / (0.5 * width_rad.clamp(1e-3, 2.5)).sin()
}

/// Bearing of the point (px, py) from the pose (x, y, h) and its derivatives to x, y, h and to px, py.
pub fn bearing(pose: [f64; 3], point: [f64; 2]) -> (f64, [f64; 3], [f64; 2]) {
    let (dx, dy) = (point[0] - pose[0], point[1] - pose[1]);
    let d2 = (dx * dx + dy * dy).max(1e-6);
    (dy.atan2(dx) - pose[2], [dy / d2, -dx / d2, -1.0], [-dy / d2, dx / d2])
}

/// Distance of the point from the pose and its derivatives to x, y, h and to px, py.
pub fn distance(pose: [f64; 3], point: [f64; 2]) -> (f64, [f64; 3], [f64; 2]) {
    let (dx, dy) = (point[0] - pose[0], point[1] - pose[1]);
    let d = (dx * dx + dy * dy).sqrt().max(1e-3);
    (d, [-dx / d, -dy / d, 0.0], [dx / d, dy / d])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivatives_agree_with_central_differences() {
        let (pose, point) = ([0.3, -0.7, 0.9], [2.1, 1.4]);
        let h = 1e-6;
        for f in [bearing, distance] {
            let (_, to_pose, to_point) = f(pose, point);
            for k in 0..3 {
                let (mut a, mut b) = (pose, pose);
                a[k] += h;
                b[k] -= h;
                assert!(((f(a, point).0 - f(b, point).0) / (2.0 * h) - to_pose[k]).abs() < 1e-8);
            }
            for k in 0..2 {
                let (mut a, mut b) = (point, point);
                a[k] += h;
                b[k] -= h;
                assert!(((f(pose, a).0 - f(pose, b).0) / (2.0 * h) - to_point[k]).abs() < 1e-8);
            }
        }
        let d = (width(3.0 + h).0 - width(3.0 - h).0) / (2.0 * h);
        assert!((d - width(3.0).1).abs() < 1e-9);
        assert!((range(width(3.0).0) - 3.0).abs() < 1e-12);
    }
}
