//! Derivatives of the operations on poses, in the coordinates (x, y, heading), and the adjoint.
//!
//! With R the rotation of the heading h and R' = dR/dh:
//!
//! ```text
//! compose    (R q + p, h + k)       to outer: [I  R'q; 0 1]      to inner: [R 0; 0 1]
//! inverse    (−Rᵀp, −h)             [−Rᵀ  −R'ᵀp; 0 −1]
//! transform  R q + p                to pose: [I  R'q]            to point: R
//! bearing    atan2(d) − h, d = q − p   to pose: [d_y −d_x]/|d|² and −1    to point: [−d_y d_x]/|d|²
//! ```

use nalgebra::{Matrix2, Matrix2x3, Matrix3, RowVector2, RowVector3, Vector2};

use super::Pose2;

impl Pose2 {
    /// Derivatives of `self * inner` to the coordinates of `self` and of `inner`.
    pub fn compose_jacobians(&self, inner: &Self) -> (Matrix3<f64>, Matrix3<f64>) {
        let turned = self.rotation_rate() * inner.position();
        let to_outer = Matrix3::new(1.0, 0.0, turned.x, 0.0, 1.0, turned.y, 0.0, 0.0, 1.0);
        let mut to_inner = Matrix3::identity();
        to_inner.fixed_view_mut::<2, 2>(0, 0).copy_from(&self.rotation());
        (to_outer, to_inner)
    }

    /// Derivative of `self.inverse()` to the coordinates of `self`.
    pub fn inverse_jacobian(&self) -> Matrix3<f64> {
        let back = self.rotation().transpose();
        let turned = self.rotation_rate().transpose() * self.position();
        let mut jacobian = Matrix3::zeros();
        jacobian.fixed_view_mut::<2, 2>(0, 0).copy_from(&-back);
        jacobian.fixed_view_mut::<2, 1>(0, 2).copy_from(&-turned);
        jacobian[(2, 2)] = -1.0;
        jacobian
    }

    /// Derivatives of `self.transform(point)` to the coordinates of `self` and to the point.
    pub fn transform_jacobians(&self, point: Vector2<f64>) -> (Matrix2x3<f64>, Matrix2<f64>) {
        let turned = self.rotation_rate() * point;
        (Matrix2x3::new(1.0, 0.0, turned.x, 0.0, 1.0, turned.y), self.rotation())
    }

    /// Derivatives of `self.bearing_to(point)` to the coordinates of `self` and to the point. Not finite at the point itself.
    pub fn bearing_jacobians(&self, point: Vector2<f64>) -> (RowVector3<f64>, RowVector2<f64>) {
        let d = point - self.position();
        let squared = d.norm_squared();
        let to_point = RowVector2::new(-d.y / squared, d.x / squared);
        (RowVector3::new(-to_point.x, -to_point.y, -1.0), to_point)
    }

    /// Carries a small motion (forward, left, turn) of the inner frame into the outer one:
    /// `self * small * self.inverse()` moves by `adjoint · small` to first order.
    pub fn adjoint(&self) -> Matrix3<f64> {
        let (s, c) = self.heading_rad.sin_cos();
        Matrix3::new(c, -s, self.y_m, s, c, -self.x_m, 0.0, 0.0, 1.0)
    }

    /// dR/dh.
    fn rotation_rate(&self) -> Matrix2<f64> {
        let (s, c) = self.heading_rad.sin_cos();
        Matrix2::new(-s, -c, c, -s)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{SMatrix, Vector3};
    use proptest::prelude::*;

    use super::*;
    use crate::angle::difference;

    proptest! {
        #[test]
        fn poses_are_a_group(a in pose(), b in pose(), c in pose()) {
            prop_assert!(distance(&((a * b) * c), &(a * (b * c))) < 1e-12);
            prop_assert!(distance(&(a * a.inverse()), &Pose2::IDENTITY) < 1e-12);
            prop_assert!(distance(&(a.inverse() * a), &Pose2::IDENTITY) < 1e-12);
            prop_assert!(distance(&(Pose2::IDENTITY * a), &a) < 1e-12);
            prop_assert!(distance(&(a * Pose2::IDENTITY), &a) < 1e-12);
            prop_assert!(distance(&(a * b).inverse(), &(b.inverse() * a.inverse())) < 1e-12);
        }

        #[test]
        fn a_product_acts_like_its_factors_one_after_the_other(a in pose(), b in pose(), q in point()) {
            prop_assert!(((a * b).transform(q) - a.transform(b.transform(q))).norm() < 1e-12);
            prop_assert!((a.inverse().transform(a.transform(q)) - q).norm() < 1e-12);
            // A bearing is that of the point seen from inside.
            let inside = a.inverse().transform(q);
            prop_assert!(difference(a.bearing_to(q), inside.y.atan2(inside.x)).abs() < 1e-9);
        }

        #[test]
        fn jacobians_are_what_central_differences_give(a in pose(), b in pose(), q in point()) {
            let (to_a, to_b) = a.compose_jacobians(&b);
            prop_assert!((to_a - numeric(&coordinates(&a), |v| coordinates(&(from(v) * b)))).amax() < 1e-7);
            prop_assert!((to_b - numeric(&coordinates(&b), |v| coordinates(&(a * from(v))))).amax() < 1e-7);
            let inverse = numeric(&coordinates(&a), |v| coordinates(&from(v).inverse()));
            prop_assert!((a.inverse_jacobian() - inverse).amax() < 1e-7);
            let (to_pose, to_point) = a.transform_jacobians(q);
            prop_assert!((to_pose - numeric(&coordinates(&a), |v| from(v).transform(q))).amax() < 1e-7);
            prop_assert!((to_point - numeric(&q, |p| a.transform(p))).amax() < 1e-7);
            // Bearings near the point itself bend too much for differences.
            prop_assume!((q - a.position()).norm() > 0.1);
            let (to_pose, to_point) = a.bearing_jacobians(q);
            let unwrapped = |bearing: f64| nalgebra::SVector::<f64, 1>::new(difference(bearing, a.bearing_to(q)));
            prop_assert!((to_pose - numeric(&coordinates(&a), |v| unwrapped(from(v).bearing_to(q)))).amax() < 1e-5);
            prop_assert!((to_point - numeric(&q, |p| unwrapped(a.bearing_to(p)))).amax() < 1e-5);
        }

        #[test]
        fn the_adjoint_carries_small_motions_from_inside_to_outside(a in pose(), d in (-1.0..1.0, -1.0..1.0, -1.0..1.0)) {
            let small = Vector3::new(d.0, d.1, d.2) * 1e-6;
            let outside = coordinates(&(a * from(small) * a.inverse()));
            prop_assert!((outside - a.adjoint() * small).amax() < 1e-10);
        }
    }

    fn pose() -> impl Strategy<Value = Pose2> {
        (-8.0..8.0, -8.0..8.0, -3.1..3.1).prop_map(|(x, y, h)| Pose2::new(x, y, h))
    }

    fn point() -> impl Strategy<Value = Vector2<f64>> {
        (-8.0..8.0, -8.0..8.0).prop_map(|(x, y)| Vector2::new(x, y))
    }

    fn coordinates(pose: &Pose2) -> Vector3<f64> {
        Vector3::new(pose.x_m, pose.y_m, pose.heading_rad)
    }

    fn from(v: Vector3<f64>) -> Pose2 {
        Pose2::new(v.x, v.y, v.z)
    }

    fn distance(a: &Pose2, b: &Pose2) -> f64 {
        (a.position() - b.position()).norm() + difference(a.heading_rad, b.heading_rad).abs()
    }

    fn numeric<const N: usize, const M: usize>(
        at: &nalgebra::SVector<f64, N>,
        f: impl Fn(nalgebra::SVector<f64, N>) -> nalgebra::SVector<f64, M>,
    ) -> SMatrix<f64, M, N> {
        let step = 1e-6;
        SMatrix::from_fn(|row, column| {
            let mut d = nalgebra::SVector::<f64, N>::zeros();
            d[column] = step;
            // The third coordinate may wrap between the two sides.
            let change = f(at + d)[row] - f(at - d)[row];
            if row == 2 { difference(change, 0.0) / (2.0 * step) } else { change / (2.0 * step) }
        })
    }
}
