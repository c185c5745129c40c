//! Laws every camera model keeps, as one macro applied to each.

use nalgebra::{Vector2, Vector3};
use serde_json::Value;

use super::jacobian::ParameterJacobian;
use super::{Camera, CameraFile, camera_toml, is_in_image};

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
            fn jacobians_are_the_slopes_of_the_projection() {
                crate::optics::laws::jacobians_are_slopes(&$camera);
            }
            #[test]
            fn parameters_make_the_same_camera_again_and_so_does_its_table() {
                crate::optics::laws::parameters_come_back(&$camera);
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

/// The point Jacobian against differences over a step 30 times that of the numerical one, and each parameter's column
/// against the projection by the camera with that parameter changed.
pub(crate) fn jacobians_are_slopes(camera: &dyn Camera) {
    let parameters = camera.parameters();
    let values: Vec<f64> = parameters.iter().map(|p| p.value).collect();
    let by_parameters = ParameterJacobian::new(camera, 0..values.len()).unwrap();
    let steps: Vec<f64> = by_parameters.steps().collect();
    let mut tried = 0;
    for pixel in grid(camera).step_by(37) {
        let Some(ray) = camera.unproject(&pixel) else { continue };
        let point = ray.origin_m + ray.direction * 1.3;
        let Some(jacobian) = camera.point_jacobian(&point) else { continue };
        let step = 3e-6;
        for axis in 0..3 {
            let mut offset = Vector3::zeros();
            offset[axis] = step;
            let sides = (camera.image_of_point(&(point + offset)), camera.image_of_point(&(point - offset)));
            let (Some(plus), Some(minus)) = sides else { continue };
            let (slope, ours) = ((plus - minus) / (2.0 * step), jacobian.column(axis));
            assert!((slope - ours).norm() < 1e-6 * (1.0 + jacobian.norm()), "{point:?}, axis {axis}: {ours} {slope}");
        }
        let Some(columns) = by_parameters.at(&point) else { continue };
        for (i, column) in columns.iter().enumerate() {
            let step = 0.4 * steps[i];
            let moved = |step: f64| {
                let mut values = values.clone();
                values[i] += step;
                camera.with_values(&values).ok()?.image_of_point(&point)
            };
            let (Some(plus), Some(minus)) = (moved(step), moved(-step)) else { continue };
            let slope = (plus - minus) / (2.0 * step);
            let name = &parameters[i].name;
            assert!((slope - column).norm() < 1e-5 * (1.0 + column.norm()), "{name} at {point:?}: {column} {slope}");
        }
        tried += 1;
    }
    assert!(tried > 5, "only {tried} points were tried");
}

pub(crate) fn parameters_come_back(camera: &dyn Camera) {
    let values: Vec<f64> = camera.parameters().iter().map(|p| p.value).collect();
    let again = camera.with_values(&values).unwrap();
    assert_eq!(again.parameters(), camera.parameters());
    let text = camera_toml(camera);
    let read = CameraFile::parse(&text, std::path::Path::new("camera.toml")).unwrap().mount().unwrap();
    assert_eq!(read.camera().model(), camera.model());
    assert_eq!(read.camera().parameters(), camera.parameters());
    for pixel in grid(camera).step_by(11) {
        assert_eq!(again.unproject(&pixel), camera.unproject(&pixel));
        assert_eq!(read.camera().unproject(&pixel), camera.unproject(&pixel));
    }
}

/// (inputs, outputs, relative tolerance) of a group of golden numbers.
pub(crate) fn golden(group: &str) -> (Value, Value, f64) {
    let all: Value = serde_json::from_str(include_str!("../../../tests/golden/golden.json")).unwrap();
    let group = &all[group];
    (group["inputs"].clone(), group["outputs"].clone(), group["rel_tol"].as_f64().unwrap())
}

#[track_caller]
pub(crate) fn assert_rel(ours: f64, golden: &Value, rel_tol: f64) {
    let golden = golden.as_f64().unwrap();
    assert!((ours - golden).abs() <= rel_tol * golden.abs().max(1e-3), "{ours} is not {golden}");
}
