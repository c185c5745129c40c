//! Design D against golden numbers of an independent ray tracer, and the laws of every camera.

use serde_json::Value;

use super::*;
use nalgebra::{Vector2, Vector3};

use crate::optics::Camera;
use crate::optics::laws::{assert_rel, camera_laws, golden};

camera_laws!(laws_of_design_d, Pal::reference());
camera_laws!(
    laws_with_aspect_and_wide_view,
    Pal::new(
        PalDesign { aspect: 1.07, centre_px: [390.25, 280.0], elevation_deg: [-19.0, 40.0], ..PalDesign::REFERENCE },
        [768, 576]
    )
    .unwrap()
);
camera_laws!(
    laws_without_refraction,
    Pal::new(PalDesign { refractive_index: 1.0, elevation_deg: [5.0, 60.0], ..PalDesign::REFERENCE }, [768, 576])
        .unwrap()
);
camera_laws!(
    laws_with_total_reflection_near,
    Pal::new(PalDesign { refractive_index: 1.8, elevation_deg: [-10.0, 25.0], ..PalDesign::REFERENCE }, [768, 576])
        .unwrap()
);

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}

/// D with the digits the golden numbers were computed with.
fn design() -> PalDesign {
    PalDesign {
        ellipsoid_a_mm: 23.8095238095238,
        ellipsoid_c_mm: 9.52380952380952,
        hyperboloid_a_mm: 6.47619047619048,
        hyperboloid_c_mm: 16.5238095238095,
        focal_length_px: 751.849545069511,
        ..PalDesign::REFERENCE
    }
}

fn camera(change: impl FnOnce(&mut PalDesign)) -> Pal {
    let mut design = design();
    change(&mut design);
    Pal::new(design, [1536, 1152]).unwrap()
}

/// Radius of the image of a point at azimuth 0.7 about the centre.
fn radius(camera: &Pal, pixel: Option<Vector2<f64>>) -> f64 {
    let offset = pixel.unwrap() - Vector2::from(camera.design().centre_px);
    assert!((offset.y.atan2(offset.x) - 0.7).abs() < 1e-12);
    offset.norm()
}

fn at_azimuth(r: f64, z: f64) -> Vector3<f64> {
    Vector3::new(r * 0.7_f64.cos(), r * 0.7_f64.sin(), z)
}

#[test]
fn derived_constants_are_golden() {
    let (_, golden, tol) = golden("pal.design.derived");
    let m = *camera(|_| {}).optics();
    let gain = m.half_angle_gain;
    let e_r = m.window.eccentricity;
    let a_r = m.window.p_mm / (1.0 - e_r * e_r);
    for (key, ours) in [
        ("be", m.ellipsoid_b_mm),
        ("bh", m.hyperboloid_b_mm),
        ("ee", m.ellipsoid_eccentricity),
        ("eh", m.hyperboloid_eccentricity),
        ("K", gain),
        ("zO", m.pinhole_z_mm),
        ("zB", m.focus_z_mm),
        ("xi", (gain * gain - 1.0) / (gain * gain + 1.0)),
        ("gamma", 2.0 * m.focal_length_px * gain / (gain * gain + 1.0)),
        ("cR", a_r * e_r),
        ("bR", a_r * (1.0 - e_r * e_r).sqrt()),
        ("pR", m.window.p_mm),
        ("kappa", m.window.kappa),
    ] {
        assert_rel(ours, &golden[key], tol);
    }
}

#[test]
fn backprojection_meets_every_surface_where_the_tracer_does() {
    let (_, golden, tol) = golden("pal.backproject");
    let m = *camera(|_| {}).optics();
    for row in golden.as_array().unwrap() {
        let r_image = number(&row["r_I"]);
        let ray = m.ray_of_radius(r_image).unwrap();
        let h = m.point_on_hyperboloid_mm(r_image).unwrap();
        let e = m.point_on_ellipsoid_mm(&ray);
        let caustic = m.window.caustic_mm(&ray);
        for i in 0..2 {
            assert_rel(h[i], &row["H"][i], tol);
            assert_rel(e[i], &row["E"][i], tol);
            assert_rel(ray.exit_mm[i], &row["R"][i], tol);
            assert_rel(caustic[i], &row["caustic"][i], tol);
        }
        assert_rel(ray.zeta_in, &row["zeta_in"], tol);
        assert_rel(ray.zeta_out, &row["zeta_out"], tol);
        assert_rel(90.0 - ray.zeta_out.to_degrees(), &row["elev_out_deg"], tol);
        assert_rel(m.window.axis_crossing_mm(&ray), &row["z_axis_cross"], tol);
    }
}

#[test]
fn far_points_appear_at_the_golden_radii() {
    let (_, golden, tol) = golden("pal.project_far");
    let camera = camera(|_| {});
    for row in golden.as_array().unwrap() {
        let elevation = number(&row["elev_out_deg"]).to_radians();
        let pixel = camera.project_direction(&at_azimuth(elevation.cos(), elevation.sin()));
        assert_rel(radius(&camera, pixel), &row["r_I"], tol);
    }
}

#[test]
fn without_refraction_far_points_appear_at_the_golden_radii() {
    let (_, golden, tol) = golden("pal.project_norefraction");
    let camera = camera(|d| {
        d.refractive_index = 1.0;
        d.elevation_deg = [0.0, 81.0];
        d.centre_px = [400.0, 400.0];
    });
    for row in golden.as_array().unwrap() {
        let elevation = number(&row["elev_deg"]).to_radians();
        let pixel = camera.project_direction(&at_azimuth(elevation.cos(), elevation.sin()));
        assert_rel(radius(&camera, pixel), &row["r_I"], tol);
    }
}

#[test]
fn near_points_appear_at_the_golden_radii() {
    let (_, golden, tol) = golden("pal.project_finite");
    let camera = camera(|_| {});
    for row in golden.as_array().unwrap() {
        let point_mm = at_azimuth(number(&row["r"]), number(&row["z"]));
        assert_rel(radius(&camera, camera.project(&(point_mm * 1e-3))), &row["r_I"], tol);
    }
}

#[test]
fn the_viewpoint_s_locus_is_golden() {
    let (_, golden, tol) = golden("pal.caustic");
    let camera = camera(|d| d.elevation_deg = [-15.0, 20.0]);
    let crossing = |zenith_deg: f64| {
        camera.optics().window.axis_crossing_mm(&camera.optics().window.ray_of_zenith(zenith_deg.to_radians()).unwrap())
    };
    assert_rel(crossing(70.0), &golden["zx_min"], tol);
    assert_rel(crossing(105.0), &golden["zx_max"], tol);
    assert_rel(camera.viewpoint_m().z * 1e3, &golden["best_zv"], tol);
    assert_rel(camera.viewpoint_miss_m() * 1e3, &golden["max_miss"], tol);
}

#[test]
fn the_ends_of_the_elevation_range_belong_to_the_domain_and_nothing_beyond() {
    let camera = Pal::reference();
    for (elevation_deg, seen) in [(-15.0, true), (20.0, true), (-15.001, false), (20.001, false), (89.0, false)] {
        let e = f64::to_radians(elevation_deg);
        assert_eq!(camera.project_direction(&Vector3::new(e.cos(), 0.0, e.sin())).is_some(), seen, "{elevation_deg}");
    }
    assert!(camera.unproject(&Vector2::new(383.5, 287.5)).is_none(), "the hole");
    assert!(camera.unproject(&Vector2::new(383.5 + 271.0, 287.5)).is_none(), "beyond the rim");
}

#[test]
fn points_inside_the_glass_and_on_the_axis_have_no_image() {
    let camera = Pal::reference();
    for point in [[0.005, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0, 0.019, 0.0005]] {
        assert!(camera.project(&Vector3::from(point)).is_none(), "{point:?}");
    }
}

type Change = fn(&mut PalDesign);

#[test]
fn impossible_designs_are_named() {
    let wrong: [(Change, &str, &str); 8] = [
        (|d| d.ellipsoid_c_mm = 30.0, "ellipsoid_c_mm", "less than"),
        (|d| d.hyperboloid_a_mm = 17.0, "hyperboloid_c_mm", "more than"),
        (|d| d.refraction_a_mm = 0.03125, "refraction_a_mm", "metres"),
        (|d| d.focal_length_px = 6.26, "focal_length_px", "millimetres"),
        (|d| d.focal_length_px = f64::NAN, "focal_length_px", "positive"),
        (|d| d.elevation_deg = [20.0, -15.0], "elevation_deg", "swapped"),
        (|d| d.elevation_deg = [-0.2618, 0.349], "elevation_deg", "radians"),
        (|d| d.centre_px = [800.0, 287.5], "centre_px", "768x576"),
    ];
    for (change, key, hint) in wrong {
        let mut design = PalDesign::REFERENCE;
        change(&mut design);
        let error = Pal::new(design, [768, 576]).unwrap_err();
        assert_eq!(error.key, key);
        assert!(error.to_string().contains(hint), "{error}");
    }
}

#[test]
fn elevations_the_mirrors_cannot_reach_are_named() {
    let design = PalDesign { elevation_deg: [-80.0, 20.0], ..PalDesign::REFERENCE };
    let error = Pal::new(design, [768, 576]).unwrap_err();
    assert_eq!(error.key, "elevation_deg");
    assert!(error.to_string().contains("-20.33"), "{error}");
}
