use super::still::ROBOT_KEYS;
use super::*;
use crate::scenario::Scenario;

/// Two robots at known places in a room without furniture; `people` is the body of the people table.
fn two_robots(distance_m: f64, people: &str, camera: &str) -> Arc<World> {
    let text = format!(
        "name = \"two\"\nduration_s = 4.0\n[robots]\ncount = 2\nposes = [[-1.0, 0.3, 25.0], [{}, 0.3, 0.0]]\n\
         [people]\n{people}\n[camera]\n{camera}\n",
        distance_m - 1.0
    );
    Arc::new(World::new(&Scenario::parse(&text, "two").unwrap(), 3).unwrap())
}

const NOBODY: &str = "count = 0\ncamouflaged = 0";
const SMALL: &str = "image_size_px = [384, 288]\nfocal_length_px = 375.924772535\ncentre_px = [191.5, 143.5]\nelevation_deg = [-15.0, 20.0]";

#[test]
fn a_cylinder_covers_exactly_the_bearings_between_its_tangents() {
    for distance in [1.2, 3.0] {
        let world = two_robots(distance, NOBODY, "");
        let renderer = &Renderer::team(&world)[0];
        let half = (0.2f64 / distance).asin();
        // The other robot is along the room's x; this one's heading is 25°.
        let middle = -25f64.to_radians();
        // Elevations at which the near rim and the tangent points both show the body's side.
        let (low, high) = ((0.1 - 0.6) / (distance - 0.2), (0.48 - 0.6) / (distance - 0.02));
        let (mut inside, mut edges) = (0, 0);
        for pixel in renderer.rays.lit.iter().map(|p| *p as usize) {
            let slope = f64::from(renderer.rays.slope[pixel]);
            let off = f64::from(renderer.rays.bearing[pixel]) - middle;
            if slope < low * 0.8 || slope > high || off.abs() > 0.5 || (off.abs() - half).abs() < 3e-6 {
                continue;
            }
            let is_robot = (ROBOT_KEYS..u32::MAX).contains(&renderer.still.key[pixel]);
            assert_eq!(is_robot, off.abs() < half, "bearing {off} of ±{half} at {distance} m");
            inside += usize::from(is_robot);
            edges += usize::from((off.abs() - half).abs() < 0.003);
        }
        assert!(inside > 100 && edges > 10, "{inside} {edges}");
    }
}

#[test]
fn an_edge_in_the_grey_levels_stands_at_the_tangent_to_a_tenth_of_a_pixel() {
    // Without noise: the light missing across the edge of the dark ring, summed along the bearing, gives the edge's place.
    let distance = 2.0;
    let world = two_robots(distance, NOBODY, "noise_gray = 0.0\nblur_px = 0.0");
    let empty = {
        let text = "name = \"one\"\nduration_s = 4.0\n[robots]\ncount = 1\nposes = [[-1.0, 0.3, 25.0]]\n[people]\ncount = 0\ncamouflaged = 0\n";
        Arc::new(World::new(&Scenario::parse(text, "one").unwrap(), 3).unwrap())
    };
    let (with, without) = (&Renderer::team(&world)[0], &Renderer::team(&empty)[0]);
    let strength = [1.0; crate::world::MAX_LAMPS];
    let (half, middle) = ((0.2f64 / distance).asin(), -25f64.to_radians());
    let rays = &with.rays;
    // The dark upper ring's own light is nearly even; weigh it out by the share of the body's light at the ring's middle.
    let (mut off_sum, mut count) = (0.0, 0);
    for pixel in rays.lit.iter().map(|p| *p as usize) {
        let slope = f64::from(rays.slope[pixel]);
        let bearing = f64::from(rays.bearing[pixel]) - middle;
        let ring = (-0.2 + 0.03) / distance..(-0.1 - 0.02) / distance;
        let across = 1.0 / (rays.width as f64 / 2.0 - 160.0);
        if !ring.contains(&slope) || (bearing.abs() - half).abs() > across || !with.still.mixed[pixel] {
            continue;
        }
        let (now, before) = (with.still.glow[pixel].total(&strength), without.still.glow[pixel].total(&strength));
        let dark = 0.1 * 0.5 * before / 0.56;
        let covered = f64::from(((before - now) / (before - dark)).clamp(0.0, 1.0));
        // A pixel covered to one half has its middle on the edge.
        if covered > 0.15 && covered < 0.85 {
            let inside_px = covered - 0.5;
            let size = f64::from(rays.pixel_rad);
            off_sum += (half - bearing.abs()) / size - inside_px;
            count += 1;
        }
    }
    assert!(count >= 4, "{count}");
    let mean = off_sum / f64::from(count);
    assert!(mean.abs() < 0.1, "edge off by {mean} px over {count} pixels");
}

#[test]
fn the_same_instant_gives_the_same_bytes_in_any_order_and_another_instant_others() {
    let world = Arc::new(World::new(&Scenario::builtin("tiny").unwrap().unwrap(), 5).unwrap());
    let (mut a, mut b) = (Renderer::team(&world), Renderer::team(&world));
    let first = a[0].render(1.0);
    b[0].render(2.0);
    assert_eq!(first, b[0].render(1.0));
    assert_ne!(first.gray, b[0].render(1.1).gray);
}

#[test]
fn a_picture_while_driving_is_the_picture_of_the_same_place_but_for_its_fineness() {
    // A drive of no length makes the robot "moving" where it stands.
    let text = "name = \"x\"\nduration_s = 4.0\n[robots]\ncount = 2\nposes = [[-1.0, 0.3, 25.0], [1.0, 0.3, 0.0]]\n\
                [[robots.drives]]\nrobot = \"r1\"\nstart_s = 1.0\nend_s = 3.0\ndistance_m = 0.0\nturn_deg = 0.0\n\
                [people]\ncount = 1\ncamouflaged = 0\n";
    let world = Arc::new(World::new(&Scenario::parse(text, "x").unwrap(), 3).unwrap());
    let renderer = &mut Renderer::team(&world)[0];
    let (fine, quick) = (renderer.render(0.999), renderer.render(1.001));
    let different = fine.gray.iter().zip(&quick.gray).filter(|(a, b)| a.abs_diff(**b) > 20).count();
    assert!(different < 300, "{different} pixels");
}

#[test]
fn somebody_alone_is_seen_whole_and_behind_a_wall_of_somebody_else_less() {
    let people = "count = 2\ncamouflaged = 0\nheight_m = [1.6, 1.9]\nstanding = [[1.6, 0.3], [2.8, 0.35]]";
    let world = two_robots(3.6, people, SMALL);
    let renderer = &mut Renderer::team(&world)[0];
    let [near, far] = renderer.render(1.0).visible_fraction[..] else { panic!("two people") };
    assert!(near > 0.97, "{near}");
    assert!(far < 0.6, "{far}");
    assert_eq!(renderer.visible_fraction(1.0), vec![near, far]);
}

#[test]
fn camouflaged_clothes_are_within_fifteen_grey_levels_of_what_is_behind() {
    let scenario = std::str::from_utf8(include_bytes!("../../scenarios/tiny.toml")).unwrap();
    let scenario = Scenario::parse(&scenario.replace("camouflaged = 0", "camouflaged = 1"), "tiny").unwrap();
    let world = Arc::new(World::new(&scenario, 4).unwrap());
    for renderer in &mut Renderer::team(&world) {
        let (mut sum, mut count) = (0.0, 0.0);
        for i in 0..8 {
            let state = world.at(0.3 + 0.5 * f64::from(i));
            let movers = renderer.movers(&state);
            let strength = [1.0; crate::world::MAX_LAMPS];
            renderer.draw(&movers);
            let touched: Vec<usize> = renderer.canvas.touched.iter().map(|p| *p as usize).collect();
            for pixel in &touched {
                renderer.canvas.light[*pixel] = renderer.still.glow[*pixel].total(&strength);
            }
            let before: f32 = touched.iter().map(|p| renderer.canvas.light[*p]).sum();
            renderer.paint(&movers, &strength);
            let after: f32 = touched.iter().map(|p| renderer.canvas.light[*p]).sum();
            renderer.clear();
            sum += f64::from((after - before) * renderer.gain);
            count += touched.len() as f64;
        }
        assert!(count > 0.0);
        assert!((sum / count).abs() < 15.0, "{} grey levels", sum / count);
    }
}
