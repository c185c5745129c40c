//! Laws every camera model keeps, as one macro applied to each.

use nalgebra::{Vector2, Vector3};

use super::{Camera, is_in_image};

/// A module of tests for one camera.
macro_rules! camera_laws {
    ($name:ident, $camera:expr) => {
        mod $name {
            #[allow(unused_imports)]
            use super::*;

            #[test]
            fn unproject_then_project_gives_the_pixel_back() {
                crate::optics::laws::pixels_come_back(&$camera);
            }
            #[test]
            fn project_then_unproject_gives_a_ray_through_the_point() {
                crate::optics::laws::rays_meet_their_points(&$camera);
            }
            #[test]
            fn what_is_not_finite_or_off_the_picture_is_outside_the_domain() {
                crate::optics::laws::nonsense_is_outside(&$camera);
            }
        }
    };
}
pub(crate) use camera_laws;

fn grid(camera: &dyn Camera) -> impl Iterator<Item = Vector2<f64>> {
    let [w, h] = camera.image_size_px().map(f64::from);
    (0..40).flat_map(move |i| {
        (0..40)
            .map(move |j| Vector2::new((f64::from(i) + 0.37) / 40.0 * w - 0.5, (f64::from(j) + 0.61) / 40.0 * h - 0.5))
    })
}

pub(crate) fn pixels_come_back(camera: &dyn Camera) {
    let mut tried = 0;
    for pixel in grid(camera) {
        let Some(ray) = camera.unproject(&pixel) else { continue };
        assert!((ray.direction.norm() - 1.0).abs() < 1e-12);
        let far = camera.project_direction(&ray.direction).unwrap();
        assert!((far - pixel).norm() < 1e-8, "far: {pixel:?} came back as {far:?}");
        for distance_m in [1e-3, 0.1, 0.7, 5.0, 200.0] {
            let near = camera.project(&(ray.origin_m + ray.direction * distance_m)).unwrap();
            assert!((near - pixel).norm() < 1e-8, "{distance_m} m: {pixel:?} came back as {near:?}");
        }
        tried += 1;
    }
    assert!(tried > 300, "only {tried} pixels are in the domain");
}

pub(crate) fn rays_meet_their_points(camera: &dyn Camera) {
    let mut tried = 0;
    for i in 0..72 {
        for j in 0..24 {
            for distance_m in [0.3, 2.0, 9.0] {
                let (bearing, elevation) = (f64::from(i - 36) * 0.0873, f64::from(j - 12) * 0.06);
                let point = super::direction(bearing, elevation) * distance_m;
                let Some(pixel) = camera.project(&point) else { continue };
                assert!(is_in_image(&pixel, camera.image_size_px()));
                let ray = camera.unproject(&pixel).unwrap();
                let miss = (point - ray.origin_m).cross(&ray.direction).norm();
                assert!(miss < 1e-10 * (1.0 + distance_m), "{point:?} missed by {miss} m");
                assert!((point - ray.origin_m).dot(&ray.direction) > 0.0);
                tried += 1;
            }
        }
    }
    assert!(tried > 100, "only {tried} points are in the domain");
}

pub(crate) fn nonsense_is_outside(camera: &dyn Camera) {
    let [w, h] = camera.image_size_px().map(f64::from);
    for pixel in [[-0.6, 5.0], [5.0, h], [w, 5.0], [f64::NAN, 1.0], [f64::INFINITY, 1.0]] {
        assert!(camera.unproject(&Vector2::from(pixel)).is_none(), "{pixel:?}");
    }
    for point in [[f64::NAN, 1.0, 0.0], [1.0, f64::INFINITY, 0.0], [1.0, 0.0, f64::NAN], [0.0, 0.0, 0.0]] {
        assert!(camera.project(&Vector3::from(point)).is_none(), "{point:?}");
        assert!(camera.project_direction(&Vector3::from(point)).is_none(), "{point:?}");
    }
}
