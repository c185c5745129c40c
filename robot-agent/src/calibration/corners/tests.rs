use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use rand::SeedableRng;
use rand_distr::{Distribution, Normal};

use super::*;
use crate::optics::{Camera, UnifiedSphere, UnifiedSphereParameters};

const SIZE: BoardSize = BoardSize { cols: 7, rows: 5 };

fn camera() -> UnifiedSphere {
    let parameters = UnifiedSphereParameters {
        xi: 0.95,
        focal_length_px: [230.0; 2],
        centre_px: [321.0, 238.0],
        skew: 0.0,
        distortion: [0.0; 4],
    };
    UnifiedSphere::new(parameters, [640, 480]).unwrap()
}

/// Squares of 3 cm and a white border, 0.3 m away, obliquely.
fn camera_from_board() -> Isometry3<f64> {
    let place = crate::optics::direction(0.6, 0.35) * 0.3;
    let facing = UnitQuaternion::rotation_between(&Vector3::z(), &place).unwrap();
    Isometry3::from_parts(Translation3::from(place), facing * UnitQuaternion::from_euler_angles(0.4, -0.3, 0.5))
}

/// What the camera sees of a board with 8×6 squares, with 4×4 samples a pixel, unevenly lit, with noise. `hidden` is a
/// share of the board, from its left, that something gray covers.
fn picture(hidden: f64) -> GrayPicture {
    let (camera, board_from_camera) = (camera(), camera_from_board().inverse());
    let shade = |u: f64, v: f64| {
        let Some(ray) = camera.ray_of_image(&Vector2::new(u, v)) else { return 90.0 };
        let (origin, direction) = (board_from_camera.translation.vector, board_from_camera.rotation * ray.direction);
        let distance = -origin.z / direction.z;
        let at = (origin + direction * distance) / 0.03;
        let (x, y) = (at.x + 4.0, at.y + 3.0);
        if distance <= 0.0 || !(-0.7..8.7).contains(&x) || !(-0.7..6.7).contains(&y) || x < hidden * 8.0 {
            return 90.0 + 20.0 * (u * 0.05).sin() * (v * 0.04).cos();
        }
        let on_squares = (0.0..8.0).contains(&x) && (0.0..6.0).contains(&y);
        let dark = on_squares && (x.floor() + y.floor()).rem_euclid(2.0) < 1.0;
        (if dark { 35.0 } else { 170.0 }) * (0.8 + 0.05 * x)
    };
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(4);
    let noise = Normal::new(0.0, 2.0).unwrap();
    let gray = (0..480)
        .flat_map(|v| (0..640).map(move |u| (f64::from(u), f64::from(v))))
        .map(|(u, v)| {
            let offset = |k: i32| (f64::from(k) - 1.5) / 4.0;
            let light: f64 = (0..16).map(|k| shade(u + offset(k % 4), v + offset(k / 4))).sum();
            (light / 16.0 + noise.sample(&mut random)).round().clamp(0.0, 255.0) as u8
        })
        .collect();
    GrayPicture { width: 640, height: 480, gray }
}

#[test]
fn a_board_that_the_camera_bends_is_found_to_a_tenth_of_a_pixel() {
    let found = find_board(&picture(0.0), SIZE).unwrap();
    let truth: Vec<Vector2<f64>> = (0..35)
        .map(|n| {
            let object = Vector3::new(f64::from(n % 7) - 3.0, f64::from(n / 7) - 2.0, 0.0) * 0.03;
            camera().image_of_point(&(camera_from_board() * nalgebra::Point3::from(object)).coords).unwrap()
        })
        .collect();
    // Which end comes first is arbitrary, and so is the side that rows are counted from.
    let orders: [fn(usize) -> usize; 4] = [|n| n, |n| 34 - n, |n| (n / 7) * 7 + 6 - n % 7, |n| (4 - n / 7) * 7 + n % 7];
    let rms = |order: fn(usize) -> usize| {
        let squares: f64 = found.iter().enumerate().map(|(n, c)| (c - truth[order(n)]).norm_squared()).sum();
        (squares / 35.0).sqrt()
    };
    let best = orders.into_iter().map(rms).fold(f64::INFINITY, f64::min);
    assert!(best < 0.1, "{best} px");
}

#[test]
fn a_board_of_another_size_or_half_hidden_is_refused_with_what_is_there() {
    let larger = find_board(&picture(0.0), BoardSize { cols: 6, rows: 5 }).unwrap_err();
    assert!(matches!(larger, BoardNotFound::Larger { found: BoardSize { cols: 7 | 5, rows: 7 | 5 }, .. }), "{larger}");
    let hidden = find_board(&picture(0.4), SIZE).unwrap_err();
    assert!(matches!(hidden, BoardNotFound::Incomplete { corners: 15..=30, .. }), "{hidden}");
    assert!(hidden.to_string().contains("hidden"), "{hidden}");
}

#[test]
fn a_picture_without_a_board_has_none() {
    let hidden = find_board(&picture(1.2), SIZE).unwrap_err();
    assert!(matches!(hidden, BoardNotFound::NoGrid { .. }), "{hidden}");
}
