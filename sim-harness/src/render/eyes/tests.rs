use std::sync::Arc;

use super::super::still::ROBOT_KEYS;
use super::super::{Picture, Renderer};
use super::PAD_PX;
use crate::scenario::Scenario;
use crate::world::World;

const TURN_S: f64 = 0.8;

/// An observer at the origin that faces 20°, another robot 3 m along x, a person on the way given.
fn world(camera: &str, people: &str) -> Arc<World> {
    let text = format!(
        "name = \"eyes\"\nduration_s = 4.0\n[robots]\ncount = 2\nposes = [[0.0, 0.0, 20.0], [3.0, 0.0, 0.0]]\n[people]\n{people}\n\
         [camera]\nnoise_gray = 0.0\n[[camera.others]]\nrobot = \"r1\"\ncamera = {camera}\n"
    );
    Arc::new(World::new(&Scenario::parse(&text, "eyes").unwrap(), 3).unwrap())
}

const NOBODY: &str = "count = 0\ncamouflaged = 0";
const PINHOLE: &str = "{ kind = \"pinhole\", image_size_px = [320, 240], field_deg = 60.0 }";

fn rotating(turn_s: f64) -> String {
    format!(
        "{{ kind = \"rotating\", image_size_px = [1440, 152], turn_s = {turn_s:?}, elevation_deg = [-15.0, 20.0] }}"
    )
}

#[test]
fn a_pinhole_shows_a_cylinder_between_the_images_of_its_tangents() {
    let renderer = &Renderer::team(&world(PINHOLE, NOBODY))[0];
    // Half of 320 columns is 30° wide; the robot's axis is 20° to the right.
    let column = |bearing_deg: f64| 159.5 - 160.0 / 30f64.to_radians().tan() * bearing_deg.to_radians().tan();
    let half_deg = (0.2f64 / 3.0).asin().to_degrees();
    let [left, right] = [column(-20.0 + half_deg), column(-20.0 - half_deg)];
    // 0.2 m below the camera, 2.8 m away.
    let row = PAD_PX + (119.5f64 + 160.0 / 30f64.to_radians().tan() * 0.2 / 2.8).round() as usize;
    let shows = |u: usize| {
        let pixel = row * renderer.rays.width + PAD_PX + u;
        (ROBOT_KEYS..u32::MAX).contains(&renderer.still.key[pixel])
    };
    for u in 0..320 {
        let inside = f64::min(u as f64 - left, right - u as f64);
        assert!(inside.abs() < 1.0 || shows(u) == (inside > 0.0), "column {u} of {left} … {right}");
    }
}

#[test]
fn who_is_half_beside_a_pinhole_s_picture_is_half_seen() {
    let half = 30f64.to_radians();
    let place = |bearing: f64| [2.0 * bearing.cos(), 2.0 * bearing.sin()];
    // The observer faces 20°.
    let turned = 20f64.to_radians();
    let [a, b, c] = [half + turned, 0.5 * half + turned, 1.5 * half + turned].map(place);
    let people = format!("count = 3\ncamouflaged = 0\nstanding = [{a:?}, {b:?}, {c:?}]");
    let seen = Renderer::team(&world(PINHOLE, &people))[0].render(1.0).visible_fraction;
    assert!((seen[0] - 0.5).abs() < 0.1 && seen[1] > 0.95 && seen[2] == 0.0, "{seen:?}");
}

/// Mean column of what differs, by how much it does.
fn middle(picture: &Picture, empty: &Picture) -> f64 {
    let (mut sum, mut weight) = (0.0, 0.0);
    for (n, (a, b)) in picture.gray.iter().zip(&empty.gray).enumerate() {
        let (column, row) = (n % picture.width as usize, n / picture.width as usize);
        let differs = f64::from(a.abs_diff(*b));
        // Above the floor, where there is no shadow.
        if differs > 12.0 && row < 80 {
            sum += differs * column as f64;
            weight += differs;
        }
    }
    sum / weight
}

#[test]
fn each_column_of_a_turning_slit_is_seen_at_its_own_time() {
    // 20° + 90° is left of the observer, a quarter of a turn before the middle.
    let (walks, capture_s) = ("[[0.0, -3.0, 1.8], [4.0, 3.0, 2.2]]", 2.0);
    let seen_s = |walker: [f64; 2]| {
        let bearing = walker[1].atan2(walker[0]) - 20f64.to_radians();
        capture_s - TURN_S * bearing / std::f64::consts::TAU
    };
    let at = |t: f64| [-3.0 + 1.5 * t, 1.8 + 0.1 * t];
    // Where it is when the slit sees it, by iteration.
    let seen = (0..20).fold(capture_s, |t, _| seen_s(at(t)));
    let people = format!("count = 1\ncamouflaged = 0\nways = [{walks}]");
    let column = |turn_s: f64, capture_s: f64| {
        let picture = |people: &str| Renderer::team(&world(&rotating(turn_s), people))[0].render(capture_s);
        middle(&picture(&people), &picture(NOBODY))
    };
    // A slit that turns so fast that it sees all at one time sees it there, then.
    let [found, expected] = [column(TURN_S, capture_s), column(0.02, seen)];
    // At the capture time it would be so many columns further.
    let late = (seen - capture_s) * 1.5 / 2.0 * 1440.0 / std::f64::consts::TAU;
    assert!(late.abs() > 20.0 && (found - expected).abs() < 0.15 * late.abs(), "{found} {expected} {late}");
}
