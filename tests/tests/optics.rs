//! The agent's closed-form optics against rays that the renderer traces from surface to surface. The two share no
//! formula: what both say is so.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use nalgebra::{Vector2, Vector3};
use robot_agent::optics::{CameraFile, MountedCamera};
use sim_harness::render::pal::Pal;
use sim_harness::scenario::{CameraSpec, Scenario};

fn agents_camera(scenario: &Scenario) -> MountedCamera {
    let file = CameraFile::parse(&scenario.camera_toml(), "camera.toml".as_ref()).unwrap();
    file.mount().unwrap()
}

/// Pixels all over the picture, off any grid of its own symmetry.
fn pixels() -> impl Iterator<Item = Vector2<f64>> {
    (0..97).flat_map(|i| (0..71).map(move |j| Vector2::new(f64::from(i) * 7.93, f64::from(j) * 8.17)))
}

#[test]
fn the_agent_s_rays_are_the_traced_ones() {
    let scenario = Scenario::builtin("default").unwrap().unwrap();
    let (camera, glass) = (agents_camera(&scenario), Pal::new(&CameraSpec::default()));
    let mut compared = 0;
    for pixel in pixels() {
        let Some(ray) = camera.camera().unproject(&pixel) else { continue };
        let traced = glass.trace(pixel.x, pixel.y).unwrap();
        let origin_m = Vector3::from(traced.origin_mm) * 1e-3;
        assert!((ray.origin_m - origin_m).norm() < 1e-12, "{pixel:?}: {ray:?} against {traced:?}");
        assert!((ray.direction - traced.direction).norm() < 1e-12, "{pixel:?}: {ray:?} against {traced:?}");
        compared += 1;
    }
    assert!(compared > 1500, "{compared}");
}

#[test]
fn the_agent_projects_points_on_traced_rays_to_their_pixels_at_every_distance() {
    let scenario = Scenario::builtin("default").unwrap().unwrap();
    let (camera, glass) = (agents_camera(&scenario), Pal::new(&CameraSpec::default()));
    let height = Vector3::new(0.0, 0.0, camera.mounting().height_m().unwrap());
    let mut worst: f64 = 0.0;
    for pixel in pixels() {
        if camera.camera().unproject(&pixel).is_none() {
            continue;
        }
        let traced = glass.trace(pixel.x, pixel.y).unwrap();
        for distance_m in [0.02, 0.3, 1.0, 3.0, 20.0] {
            let point_m = height + traced.origin_mm * 1e-3 + traced.direction * distance_m;
            worst = worst.max((camera.project_body(&point_m).unwrap() - pixel).norm());
        }
        worst = worst.max((camera.project_body_direction(&traced.direction).unwrap() - pixel).norm());
    }
    assert!(worst < 1e-8, "{worst} px");
}
