//! Geometry and table against golden numbers, and the pictures' sense.

use nalgebra::Vector2;
use serde_json::Value;

use super::*;
use crate::optics::{
    CameraFile, Mounting, Pal, PalDesign, Pinhole, bearing_rad, elevation_rad, pinhole::PinholeParameters,
};

fn golden(group: &str) -> Value {
    let all: Value = serde_json::from_str(include_str!("../../../tests/golden/golden.json")).unwrap();
    all[group].clone()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}

#[track_caller]
fn assert_close(ours: f64, golden: f64, tolerance: f64) {
    assert!((ours - golden).abs() <= tolerance, "{ours} is not {golden}");
}

fn cylinder(width: u32, height: u32, degrees: [f64; 2]) -> PanoramaGeometry {
    PanoramaGeometry::new(width, height, Projection::Cylinder, degrees.map(f64::to_radians)).unwrap()
}

#[test]
fn forward_is_in_the_middle_and_left_is_left() {
    let panorama = cylinder(1080, 162, [-15.0, 20.0]);
    assert_close(panorama.column_of_bearing(0.0), 539.5, 1e-9);
    assert_close(panorama.column_of_bearing(PI / 2.0), 269.5, 1e-9);
    assert_close(panorama.column_of_bearing(-PI / 2.0), 809.5, 1e-9);
    assert_close(panorama.column_of_bearing(PI), -0.5, 1e-9);
    assert_close(panorama.bearing_of_column(0.0), PI - PI / 1080.0, 1e-12);
    assert_close(panorama.elevation_of_row(-0.5).to_degrees(), 20.0, 1e-9);
    assert_close(panorama.elevation_of_row(161.5).to_degrees(), -15.0, 1e-9);
}

#[test]
fn columns_and_rows_are_inverse_to_bearings_and_elevations() {
    for projection in [Projection::Cylinder, Projection::Sphere] {
        let panorama = PanoramaGeometry::new(720, 100, projection, [-0.4, 0.9]).unwrap().with_theta0(1.234);
        for i in 0..720 {
            let u = f64::from(i) + 0.3;
            if u < 719.5 {
                assert_close(panorama.column_of_bearing(panorama.bearing_of_column(u)), u, 1e-9);
            }
            let v = f64::from(i % 100) - 0.2;
            assert_close(panorama.row_of_elevation(panorama.elevation_of_row(v)), v, 1e-9);
            let slope = (panorama.elevation_of_row(v - 1e-4) - panorama.elevation_of_row(v + 1e-4)) / 2e-4;
            assert_close(panorama.elevation_step_rad(v), slope, 1e-9);
        }
    }
}

#[test]
fn the_reference_camera_gets_the_report_s_panorama() {
    let panorama = PanoramaGeometry::for_camera(&MountedCamera::reference(0.6)).unwrap();
    assert_eq!((panorama.width(), panorama.height()), (1080, 162));
    assert_eq!(panorama.projection(), Projection::Cylinder);
}

#[test]
fn a_finer_camera_gets_a_larger_panorama_and_an_ordinary_one_none() {
    let design = PalDesign { focal_length_px: 1879.623862675, centre_px: [959.5, 719.5], ..PalDesign::REFERENCE };
    let camera = MountedCamera::new(Pal::new(design, [1920, 1440]).unwrap(), Mounting::default());
    let panorama = PanoramaGeometry::for_camera(&camera).unwrap();
    assert_eq!((panorama.width(), panorama.height()), (2880, 434));

    let lens = PinholeParameters { focal_length_px: [700.0; 2], centre_px: [320.0, 240.0], distortion: [0.0; 5] };
    let camera = MountedCamera::new(Pinhole::new(lens, [640, 480]).unwrap(), Mounting::default());
    assert_eq!(PanoramaGeometry::for_camera(&camera), Err(GeometryError::NotPanoramic { model: "pinhole" }));
}

#[test]
fn impossible_panoramas_are_named() {
    let new = |w, h, p, e: [f64; 2]| PanoramaGeometry::new(w, h, p, e.map(f64::to_radians)).unwrap_err().to_string();
    assert!(new(0, 10, Projection::Sphere, [0.0, 1.0]).contains("0x10"));
    assert!(new(100, 10, Projection::Sphere, [5.0, -5.0]).contains("lower"));
    assert!(new(100, 10, Projection::Cylinder, [0.0, 89.9]).contains("cylinder"));
    assert!(new(100, 10, Projection::Sphere, [f64::NAN, 1.0]).contains("NaN"));
}

#[test]
fn unwarping_with_8_bit_weights_is_golden_to_the_gray_level() {
    let golden = golden("unwarp");
    let input = &golden["inputs"];
    let (x0, y0) = (number(&input["x0"]), number(&input["y0"]));
    let (inner, outer) = (number(&input["r_in"]), number(&input["r_out"]));
    let source: Vec<u8> = (0..24_u32)
        .flat_map(|y| (0..24_u32).map(move |x| ((7 * x * x + 13 * y * y + 5 * x * y + 11 * x) % 256) as u8))
        .collect();
    let panorama = cylinder(16, 5, [-15.0, 20.0]).with_theta0(0.0);
    let position = |u: u32, v: u32| {
        let theta = panorama.bearing_of_column(f64::from(u));
        let r = inner + (f64::from(v) + 0.5) * (outer - inner) / 5.0;
        Vector2::new(x0 + r * theta.cos(), y0 + r * theta.sin())
    };
    for (u, xy) in golden["outputs"]["first_xy"].as_array().unwrap().iter().enumerate() {
        let ours = position(u as u32, 0);
        assert_close(ours.x, number(&xy[0]), 1e-10);
        assert_close(ours.y, number(&xy[1]), 1e-10);
    }
    let lut = Lut::from_map([16, 5], [24, 24], |u, v| Some(position(u, v)));
    let mut out = vec![0; 80];
    lut.unwarp(&source, &mut out).unwrap();
    let expected: Vec<u8> = golden["outputs"]["pano"]
        .as_array()
        .unwrap()
        .iter()
        .flat_map(|row| row.as_array().unwrap().iter().map(|p| p.as_u64().unwrap() as u8))
        .collect();
    assert_eq!(out, expected);
}

#[test]
fn gaze_is_golden_in_the_picture_and_in_the_panorama() {
    let golden = golden("gaze");
    let input = &golden["inputs"];
    let window = GazeWindow {
        width: 160,
        height: 120,
        hfov_rad: number(&input["hfov_deg"]).to_radians(),
        pan_rad: number(&input["pan_deg"]).to_radians(),
        tilt_rad: number(&input["tilt_deg"]).to_radians(),
    };
    // The digits the golden numbers were computed with.
    let design = PalDesign {
        ellipsoid_a_mm: 23.8095238095238,
        ellipsoid_c_mm: 9.52380952380952,
        hyperboloid_a_mm: 6.47619047619048,
        hyperboloid_c_mm: 16.5238095238095,
        focal_length_px: 751.849545069511,
        centre_px: [384.0, 288.0],
        ..PalDesign::REFERENCE
    };
    let camera = MountedCamera::new(Pal::new(design, [768, 576]).unwrap(), Mounting::at_height(0.6));
    let (f_c, horizon) = (number(&input["pan"]["fc"]), number(&input["pan"]["row_h"]));
    let top = (horizon + 0.5) / f_c;
    let degrees = [(top - 126.0 / f_c).atan().to_degrees(), top.atan().to_degrees()];
    let panorama = cylinder(1080, 126, degrees).with_theta0(0.0);
    for case in golden["outputs"].as_array().unwrap() {
        let d = window.direction(number(&case["u"]), number(&case["v"]));
        assert_close(bearing_rad(&d), number(&case["az"]), 1e-11);
        assert_close(elevation_rad(&d), number(&case["el"]), 1e-11);
        let raw = camera.project_body_direction(&d).unwrap();
        assert_close(raw.x, number(&case["raw"][0]), 1e-8);
        assert_close(raw.y, number(&case["raw"][1]), 1e-8);
        assert_close(panorama.column_of_bearing(bearing_rad(&d)), number(&case["pan"][0]), 1e-8);
        assert_close(panorama.row_of_elevation(elevation_rad(&d)), number(&case["pan"][1]), 1e-8);
    }
}

#[test]
fn gaze_zoom_is_golden() {
    let golden = golden("gaze.zoom");
    let input = &golden["inputs"];
    let elevations = [number(&input["e1"]), number(&input["e2"])];
    let window = GazeWindow::around(0.3, number(&input["dw"]), elevations, [160, 120], number(&input["rho"]));
    assert_close(window.tilt_rad, number(&golden["outputs"][0]), 1e-12);
    assert_close(window.focal_px(), number(&golden["outputs"][1]), 1e-8);
    assert_eq!(window.pan_rad, 0.3);
}

/// A picture whose gray value is the bearing that the camera sees there, left out around the seam.
fn bearings_as_gray(camera: &MountedCamera) -> Vec<u8> {
    let [w, h] = camera.image_size_px();
    let mut picture = vec![0; (w * h) as usize];
    for v in 0..h {
        for u in 0..w {
            let pixel = Vector2::new(f64::from(u), f64::from(v));
            if let Some((bearing, _)) = camera.bearing_elevation_rad(&pixel) {
                picture[(v * w + u) as usize] = (128.0 + 40.0 * bearing).round() as u8;
            }
        }
    }
    picture
}

#[test]
fn a_panorama_shows_each_bearing_at_its_column_under_any_mounting() {
    let mut mounting = Mounting::at_height(0.6);
    mounting.rotation_rpy_rad = [0.02, -0.01, 0.7];
    mounting.mirrored = true;
    let camera = MountedCamera::new(Pal::reference(), mounting);
    let panorama = PanoramaGeometry::for_camera(&camera).unwrap();
    let lut = Lut::panorama(&camera, &panorama);
    let mut out = vec![0; panorama.pixels()];
    lut.unwarp(&bearings_as_gray(&camera), &mut out).unwrap();
    for u in (20..1060).step_by(13) {
        for v in [40, 81, 120] {
            let expected = 128.0 + 40.0 * panorama.bearing_of_column(f64::from(u));
            let got = f64::from(out[(v * 1080 + u) as usize]);
            assert!((got - expected).abs() < 1.2, "column {u}, row {v}: {got} is not {expected}");
        }
    }
}

#[test]
fn the_whole_default_panorama_of_an_unmasked_level_camera_is_valid() {
    let camera = MountedCamera::reference(0.6);
    let lut = Lut::panorama(&camera, &PanoramaGeometry::for_camera(&camera).unwrap());
    assert!(lut.valid().iter().all(|valid| *valid));
}

#[test]
fn a_tilted_camera_s_panorama_is_invalid_where_nothing_was_seen_and_zero_there() {
    let mut mounting = Mounting::at_height(0.6);
    mounting.rotation_rpy_rad[1] = 0.05;
    let camera = MountedCamera::new(Pal::reference(), mounting);
    let panorama = PanoramaGeometry::for_camera(&camera).unwrap();
    let lut = Lut::panorama(&camera, &panorama);
    // Nose down: ahead the top of the panorama is above what the camera sees.
    let valid = |u: usize, v: usize| lut.valid()[v * 1080 + u];
    assert!(!valid(540, 0) && valid(540, 161) && valid(540, 40));
    assert!(valid(0, 0) && !valid(0, 161));
    let mut out = vec![7; panorama.pixels()];
    lut.unwarp(&vec![200; 768 * 576], &mut out).unwrap();
    for (value, valid) in out.iter().zip(lut.valid()) {
        assert_eq!(*value, if *valid { 200 } else { 0 });
    }
}

#[test]
fn a_fisheye_that_looks_ahead_or_down_gets_a_panorama_of_what_it_sees() {
    let parameters = crate::optics::FisheyeParameters {
        law: crate::optics::FisheyeLaw::Equidistant,
        focal_length_px: [170.0; 2],
        centre_px: [383.5, 287.5],
        k: [0.0; 4],
    };
    let fisheye = crate::optics::Fisheye::new(parameters, [768, 576]).unwrap();
    let looking = |pitch_deg: f64| {
        let mut mounting = Mounting::at_height(0.6);
        mounting.rotation_rpy_rad[1] = pitch_deg.to_radians();
        MountedCamera::new(fisheye.clone(), mounting)
    };
    let ahead = looking(90.0);
    let panorama = PanoramaGeometry::for_camera(&ahead).unwrap();
    let [low, high] = panorama.elevation_rad().map(f64::to_degrees);
    assert!(low < -80.0 && high > 80.0, "{low} {high}");
    let lut = Lut::panorama(&ahead, &panorama);
    let valid = |bearing_deg: f64, elevation_deg: f64| {
        let column = panorama.column_of_bearing(bearing_deg.to_radians()).round() as usize;
        let row = panorama.row_of_elevation(elevation_deg.to_radians()).round() as usize;
        lut.valid()[row * panorama.width() as usize + column]
    };
    assert!(valid(0.0, 0.0) && valid(0.0, -60.0) && valid(0.0, 60.0) && valid(-60.0, -20.0) && !valid(180.0, 0.0));
    // What is looked for in it is on a cylinder.
    let work = PanoramaGeometry::for_work(&looking(0.0)).unwrap();
    let [low, high] = work.elevation_rad().map(f64::to_degrees);
    assert!(work.projection() == Projection::Cylinder && low < -20.0 && (high - 45.0).abs() < 1e-9, "{low} {high}");
    assert_eq!(work.width(), 960, "170 px a radian along the meridians");
    let reference = MountedCamera::reference(0.6);
    assert_eq!(PanoramaGeometry::for_work(&reference), PanoramaGeometry::for_camera(&reference));
    // Straight down it sees what straight up it would see above.
    let [low, high] = PanoramaGeometry::for_camera(&looking(180.0)).unwrap().elevation_rad();
    let [up_low, up_high] = PanoramaGeometry::for_camera(&looking(0.0)).unwrap().elevation_rad();
    assert!((low + up_high).abs() < 1e-9 && (high + up_low).abs() < 1e-9, "{low} {high} {up_low} {up_high}");
}

#[test]
fn a_masked_source_pixel_makes_every_pixel_invalid_that_would_mix_it_in() {
    let map = |u: u32, v: u32| Some(Vector2::new(f64::from(u) * 0.5, f64::from(v) * 0.5));
    let mut lut = Lut::from_map([9, 9], [5, 5], map);
    let mut tested = vec![true; 25];
    tested[2 * 5 + 2] = false;
    lut.exclude(&tested);
    for v in 0..9_u32 {
        for u in 0..9_u32 {
            // Source position (u/2, v/2): the masked pixel (2, 2) has weight nearer than one pixel on both axes.
            let mixes = u.abs_diff(4) < 2 && v.abs_diff(4) < 2;
            assert_eq!(lut.valid()[(v * 9 + u) as usize], !mixes, "{u}, {v}");
        }
    }
}

#[test]
fn a_picture_of_another_size_is_an_error() {
    let camera = MountedCamera::reference(0.6);
    let panorama = cylinder(90, 10, [-10.0, 10.0]);
    let lut = Lut::panorama(&camera, &panorama);
    let error = lut.unwarp(&[0; 100], &mut [0; 900]).unwrap_err();
    assert_eq!((error.got, error.expected), (100, 768 * 576));
    assert!(lut.unwarp(&vec![0; 768 * 576], &mut [0; 90]).is_err());
}

/// Cameras of every kind, mounted askew.
fn cameras() -> Vec<MountedCamera> {
    let tables = [
        "[hyperboloidal]\na_mm = 28.0955\nc_mm = 38.658\nfocal_length_px = 600\ncamera = \"below\"",
        "[paraboloidal]\np_mm = 30\nmagnification_px_per_mm = 6.5\ncamera = \"below\"",
        "[ellipsoidal]\na_mm = 60\nc_mm = 30\nfocal_length_px = 420\ncamera = \"below\"",
        "[spherical]\nrho_mm = 40\nh_mm = 120\nfocal_length_px = 780\ncamera = \"below\"",
        "[conic]\ngamma_deg = 55\nh_mm = 80\nfocal_length_px = 420\ncamera = \"below\"",
        "[fisheye]\nlaw = \"equidistant\"\nfocal_length_px = [184, 180]",
        "[unified-sphere]\nxi = 0.93\nfocal_length_px = 270",
        "[polynomial]\nforward = [-190.0, 0.0, 1.1e-3, 6e-7, 2e-9]",
    ];
    let mounting = "[mounting]\nheight_m = 0.6\ntilt_deg = [1.0, -2.0]\nazimuth_offset_deg = 30.0\n";
    let parse = |table: &&str| {
        let model = &table[1..table.find(']').unwrap()];
        let text =
            format!("model = \"{model}\"\nimage_size_px = [768, 576]\n{table}\ncentre_px = [380.0, 290.0]\n{mounting}");
        CameraFile::parse(&text, "camera.toml".as_ref()).unwrap().mount().unwrap()
    };
    let pal = MountedCamera::new(
        Pal::reference(),
        Mounting { rotation_rpy_rad: [0.02, -0.03, 0.5], ..Mounting::at_height(0.6) },
    );
    tables.iter().map(parse).chain([pal]).collect()
}

#[test]
fn every_projection_of_every_camera_comes_back_to_its_pixel() {
    for camera in cameras() {
        let model = camera.camera().model();
        let sphere = PanoramaGeometry::new(720, 240, Projection::Sphere, [-1.5, 1.5]).unwrap();
        let cylinder = PanoramaGeometry::new(720, 240, Projection::Cylinder, [-1.2, 1.2]).unwrap();
        let window = GazeWindow { width: 320, height: 240, hfov_rad: 1.4, pan_rad: 0.7, tilt_rad: -0.1 };
        let mut seen = 0;
        let mut check = |u: f64, v: f64, source: Option<Vector2<f64>>, back: &dyn Fn(f64, f64) -> Vector2<f64>| {
            let Some(source) = source else { return };
            let (bearing, elevation) = camera.bearing_elevation_rad(&source).unwrap();
            let off = (back(bearing, elevation) - Vector2::new(u, v)).norm();
            assert!(off < 0.01, "{model}: {off} px at {u}, {v}");
            seen += 1;
        };
        for (i, j) in (0..90).flat_map(|i| (0..30).map(move |j| (i, j))) {
            for geometry in [sphere, cylinder] {
                let (u, v) = (f64::from(i) * 8.0 + 0.1, f64::from(j) * 8.0 + 0.3);
                let d = crate::optics::direction(geometry.bearing_of_column(u), geometry.elevation_of_row(v));
                check(u, v, camera.project_body_direction(&d), &|b, e| {
                    Vector2::new(geometry.column_of_bearing(b), geometry.row_of_elevation(e))
                });
            }
            let (u, v) = (f64::from(i) * 3.5, f64::from(j) * 8.0);
            check(u, v, camera.project_body_direction(&window.direction(u, v)), &|b, e| {
                window.pixel(&crate::optics::direction(b, e)).unwrap()
            });
        }
        assert!(seen > 500, "{model}: {seen}");
    }
}

#[test]
fn every_ring_and_rectified_ring_comes_back_to_its_pixel() {
    for camera in cameras() {
        let rectified = RadialPanorama::for_camera(&camera, [720, 120]);
        let Ok(rectified) = rectified else { panic!("{}: {rectified:?}", camera.camera().model()) };
        for (i, j) in (0..90).flat_map(|i| (0..30).map(move |j| (i, j))) {
            let (u, v) = (f64::from(i) * 8.0 + 0.1, f64::from(j) * 4.0);
            let off = (rectified.pixel_of(&rectified.source_of(u, v)) - Vector2::new(u, v)).norm();
            assert!(off < 0.01, "{}: {off} px", camera.camera().model());
        }
        let valid = Lut::radial(&camera, &rectified).valid().iter().filter(|v| **v).count();
        assert!(valid > 720 * 120 / 2, "{}: {valid}", camera.camera().model());
    }
}
