//! A pose from bearings of known points, in closed form.
//!
//! With h the heading and θ the bearing of a point (X, Y), the point seen in the body frame has no part across the ray:
//!
//! ```text
//!   −sin θ (cX + sY − p) + cos θ (−sX + cY − q) = 0      c = cos h, s = sin h, (p, q) = R(−h) (x, y)
//! ```
//!
//! which is linear and homogeneous in (c, s, p, q): the smallest singular vector, scaled to c² + s² = 1, with the sign by which
//! the points are in front. Three points suffice unless they and the observer lie on one circle.

use nalgebra::{DMatrix, Vector2};
use protocol::frames::Pose2;

/// The pose from which points (metres) are seen at bearings (radians, body frame); `None` for fewer than three, or where
/// they do not determine it.
pub fn resect(points: &[([f64; 2], f64)]) -> Option<Pose2> {
    if points.len() < 3 {
        return None;
    }
    let n = points.len() as f64;
    let centre = points.iter().map(|(p, _)| Vector2::from(*p)).sum::<Vector2<f64>>() / n;
    let spread = points.iter().map(|(p, _)| (Vector2::from(*p) - centre).norm()).fold(0.0, f64::max);
    if spread <= 0.0 {
        return None;
    }
    let mut rows = DMatrix::zeros(points.len().max(4), 4);
    for (k, (p, bearing)) in points.iter().enumerate() {
        let (sin, cos) = bearing.sin_cos();
        let [x, y] = ((Vector2::from(*p) - centre) / spread).into();
        rows.row_mut(k).copy_from_slice(&[y * cos - x * sin, -y * sin - x * cos, sin, -cos]);
    }
    let svd = rows.svd(false, true);
    let v_t = svd.v_t?;
    let least = svd.singular_values.imin();
    let second = svd
        .singular_values
        .iter()
        .enumerate()
        .filter(|(k, _)| *k != least)
        .map(|(_, v)| *v)
        .fold(f64::INFINITY, f64::min);
    if second < 1e-9 {
        return None;
    }
    let v = v_t.row(least);
    let length = v[0].hypot(v[1]);
    if length < 1e-12 {
        return None;
    }
    let at = |sign: f64| {
        let [c, s, p, q] = [0, 1, 2, 3].map(|k| sign * v[k] / length);
        let place = centre + spread * Vector2::new(c * p - s * q, s * p + c * q);
        Pose2::new(place.x, place.y, s.atan2(c))
    };
    let front = |pose: &Pose2| {
        points.iter().map(|(p, bearing)| (pose.bearing_to(Vector2::from(*p)) - bearing).cos()).sum::<f64>()
    };
    let (a, b) = (at(1.0), at(-1.0));
    Some(if front(&a) > front(&b) { a } else { b })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exact_bearings_of_three_and_of_five_points_give_the_pose() {
        let all = [[0.0, 0.0], [6.0, 0.0], [6.0, 6.0], [0.0, 6.0], [2.0, 9.0]];
        for (x, y, heading) in [(1.5, 3.0, 1.6), (4.5, 4.5, -2.9), (8.0, -3.0, 0.3)] {
            for count in [3, 5] {
                let bearing = |p: &[f64; 2]| (p[1] - y).atan2(p[0] - x) - heading;
                let seen: Vec<_> = all[..count].iter().map(|p| (*p, bearing(p))).collect();
                let pose = resect(&seen).unwrap();
                let turn = protocol::angle::wrap(pose.heading_rad - heading);
                assert!((pose.x_m - x).hypot(pose.y_m - y) < 1e-9 && turn.abs() < 1e-9, "{pose:?}");
            }
        }
        assert_eq!(resect(&[([0.0, 0.0], 0.1), ([1.0, 0.0], 0.2)]), None);
    }

    #[test]
    fn a_circle_through_points_and_observer_determines_nothing() {
        let at = |a: f64| [a.cos(), a.sin()];
        // Inscribed angles do not change along the circle.
        let eye = at(3.0);
        let seen = [0.2, 1.1, 1.9].map(|a| (at(a), (at(a)[1] - eye[1]).atan2(at(a)[0] - eye[0])));
        assert_eq!(resect(&seen), None);
    }
}
