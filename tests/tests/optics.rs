//! The agent's closed-form optics against rays that the renderer traces from surface to surface. The two share no
//! formula: what both say is so.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use nalgebra::{Vector2, Vector3};
use robot_agent::optics::{CameraFile, MountedCamera};
use sim_harness::render::eyes::ray as ray_of;
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

#[test]
fn the_rays_of_robots_without_a_pal_are_the_agent_s() {
    let scenario = Scenario::builtin("mixed").unwrap().unwrap();
    assert_eq!(scenario.camera.others.len(), 2);
    for other in &scenario.camera.others {
        let file = CameraFile::parse(&scenario.camera_toml_of(&other.robot), "camera.toml".as_ref()).unwrap();
        let camera = file.mount().unwrap();
        let [w, h] = camera.image_size_px().map(f64::from);
        for (i, j) in (0..41).flat_map(|i| (0..31).map(move |j| (f64::from(i), f64::from(j)))) {
            let pixel = Vector2::new(i / 41.0 * w + 0.29, j / 31.0 * h + 0.17);
            let ray = camera.camera().unproject(&pixel).unwrap();
            let (origin_m, direction) = ray_of(&other.camera, pixel.x, pixel.y).unwrap();
            assert!(
                (ray.origin_m - origin_m).norm() < 1e-12 && (ray.direction - direction).norm() < 1e-12,
                "{pixel:?}"
            );
        }
    }
}

/// Every camera of the zoo: traced rays are the agent's, and points on them appear where they were traced from.
#[test]
fn every_camera_s_traced_rays_are_the_agent_s() {
    for specimen in sim_harness::zoo::specimens() {
        let mounted = specimen.agents_camera().unwrap();
        let camera = mounted.camera();
        let [w, h] = specimen.size_px.map(f64::from);
        let (mut compared, mut worst_px, mut worst_rad) = (0, 0.0_f64, 0.0_f64);
        for (i, j) in (0..61).flat_map(|i| (0..47).map(move |j| (f64::from(i), f64::from(j)))) {
            let pixel = Vector2::new(i / 61.0 * w + 0.29, j / 47.0 * h + 0.17);
            let Some(ray) = camera.unproject(&pixel) else { continue };
            let traced = (specimen.trace)(pixel.x, pixel.y).unwrap_or_else(|| {
                panic!("{}: the agent sees something at {pixel:?}, no light comes from there", specimen.name)
            });
            worst_rad = worst_rad.max(ray.direction.cross(&traced.direction).norm());
            let far = camera.project_direction(&traced.direction).unwrap();
            worst_px = worst_px.max((far - pixel).norm());
            for distance_m in [0.3, 1.0, 3.0, 20.0] {
                let near = camera.project(&(traced.origin_mm * 1e-3 + traced.direction * distance_m)).unwrap();
                worst_px = worst_px.max((near - pixel).norm());
            }
            compared += 1;
        }
        println!("{:26} {compared:5} pixels, worst {worst_px:.1e} px, {worst_rad:.1e} rad", specimen.name);
        assert!(compared > 300, "{}: {compared}", specimen.name);
        assert!(worst_px < 1e-6, "{}: {worst_px} px", specimen.name);
    }
}

#[test]
fn the_zoo_shows_every_camera_and_unwraps_it() {
    let scenario = Scenario::builtin("tiny").unwrap().unwrap();
    let world = sim_harness::world::World::new(&scenario, 1).unwrap().into();
    // One with its own glass, one that sees straight up, one that does not see all around.
    for name in ["spherical", "fisheye-equidistant", "pinhole"] {
        let specimens = sim_harness::zoo::specimens();
        let specimen = specimens.iter().find(|s| s.name == name).unwrap();
        let [raw, panorama] = specimen.pictures(&world).unwrap();
        assert_eq!([raw.width(), raw.height()], specimen.size_px);
        let shown =
            panorama.pixels().filter(|p| p.0[0] > 5).count() as f64 / f64::from(panorama.width() * panorama.height());
        assert!(shown > 0.6, "{name}: {shown}");
    }
}
