//! `robot-agent calibrate` as a user meets it.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

fn calibrate(folder: &Path, arguments: &[&str]) -> Output {
    let program = env!("CARGO_BIN_EXE_robot-agent");
    Command::new(program).arg("calibrate").args(arguments).current_dir(folder).output().unwrap()
}

#[track_caller]
fn json(output: &Output) -> Value {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

#[track_caller]
fn assert_fails(output: &Output, code: i32, parts: &[&str]) {
    let error = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{error}");
    for part in parts {
        assert!(error.contains(part), "{part:?} is not in: {error}");
    }
}

const KALIBR: &str = "cam0:\n  camera_model: omni\n  distortion_coeffs: [-0.05, 0.01, 0.002, -0.001]\n  \
                      distortion_model: radtan\n  intrinsics: [0.94, 265.0, 265.0, 388.0, 284.0]\n  resolution: [768, 576]\n";

/// Corners of eight boards in front of the camera, by the program's own projection; the fit must find that camera again.
fn corners(folder: &Path) -> String {
    use nalgebra::{UnitQuaternion, Vector3};
    let camera = robot_agent::optics::MountedCamera::load(&folder.join("camera.toml")).unwrap();
    let mut views = serde_json::Map::new();
    for i in 0..8 {
        let bearing = f64::from(i) * 2.4;
        let elevation = 0.35 + f64::from(i * 5 % 8) * 0.08;
        let place = robot_agent::optics::direction(bearing, elevation) * 0.35;
        let facing = UnitQuaternion::rotation_between(&Vector3::z(), &place).unwrap();
        let rotation =
            facing * UnitQuaternion::from_euler_angles(0.3 * bearing.sin(), 0.3 * (1.7 * bearing).cos(), bearing);
        let points: Vec<[f64; 2]> = (0..35)
            .map(|n| {
                let object = Vector3::new(f64::from(n % 7) * 0.03 - 0.09, f64::from(n / 7) * 0.03 - 0.06, 0.0);
                let pixel = camera.camera().project(&(rotation * object + place)).unwrap();
                // Rounded to a hundredth, which is noise enough.
                [(pixel.x * 100.0).round() / 100.0, (pixel.y * 100.0).round() / 100.0]
            })
            .collect();
        views.insert(format!("{i}.png"), points.into());
    }
    let file = serde_json::json!({ "board": { "cols": 7, "rows": 5, "square_m": 0.03 }, "image_size": [768, 576], "corners": views });
    file.to_string()
}

#[test]
fn a_camera_goes_to_other_tools_and_back_and_is_calibrated_again_from_corners() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::write(folder.join("camchain.yaml"), KALIBR).unwrap();
    let read = json(&calibrate(folder, &["import", "camchain.yaml", "--out", "camera.toml", "--format", "json"]));
    assert_eq!(read["model"], "unified-sphere");
    let exported = json(&calibrate(
        folder,
        &["export", "--camera", "camera.toml", "--to", "opencv", "--out", "omni.yml", "--format", "json"],
    ));
    assert_eq!(exported["worst_px"], 0.0);
    json(&calibrate(folder, &["import", "omni.yml", "--out", "again.toml", "--format", "json"]));
    let text = |name: &str| std::fs::read_to_string(folder.join(name)).unwrap();
    assert_eq!(text("camera.toml"), text("again.toml"));

    std::fs::write(folder.join("corners.json"), corners(folder)).unwrap();
    let fit = json(&calibrate(
        folder,
        &[
            "model",
            "--corners",
            "corners.json",
            "--model",
            "unified-sphere",
            "--out",
            "fitted.toml",
            "--report",
            "report",
            "--format",
            "json",
        ],
    ));
    assert_eq!(fit["variant"], "unified sphere, radial and tangential", "{fit:#}");
    assert!(fit["rms_px"].as_f64().unwrap() < 0.01, "{fit:#}");
    let find = |name: &str| fit["unknowns"].as_array().unwrap().iter().find(|u| u["name"] == name).unwrap().clone();
    for (name, truth) in [("centre_px[0]", 388.0), ("centre_px[1]", 284.0)] {
        let (value, sigma) = (find(name)["value"].as_f64().unwrap(), find(name)["sigma"].as_f64().unwrap());
        assert!((value - truth).abs() < 4.0 * sigma && sigma < 0.1, "{name}: {value} ± {sigma}");
    }
    let page = text("report/index.html");
    assert_eq!(page.matches("<svg").count(), 6);
    assert!(page.contains("misaligned"), "the verdict must say so");
    assert!(robot_agent::optics::MountedCamera::load(&folder.join("fitted.toml")).is_ok());

    let verified = json(&calibrate(
        folder,
        &["verify", "--camera", "fitted.toml", "--corners", "corners.json", "--sigma-px", "0.01", "--format", "json"],
    ));
    assert!(
        verified["views"].as_array().unwrap().iter().all(|v| v["p_value"].as_f64().unwrap() > 1e-4),
        "{verified:#}"
    );
}

/// A PAL's file with a mask beside it, in a folder of its own.
fn masked_camera(folder: &Path) {
    std::fs::create_dir(folder.join("old")).unwrap();
    image::GrayImage::from_pixel(160, 120, image::Luma([255])).save(folder.join("old/mask.png")).unwrap();
    let text = "model = \"unified-sphere\"\nimage_size_px = [160, 120]\n[unified-sphere]\nxi = 0.9\n\
                focal_length_px = [60.0, 60.0]\ncentre_px = [79.5, 59.5]\n[mask]\nfile = \"mask.png\"\n\
                [mounting]\nheight_m = 0.6\n";
    std::fs::write(folder.join("old/camera.toml"), text).unwrap();
}

#[test]
fn a_camera_file_that_is_written_elsewhere_still_finds_its_mask() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    masked_camera(folder);
    std::fs::create_dir(folder.join("new")).unwrap();
    let seen = r#"{"points":[{"body_m":[2.0,0.0,0.0],"px":[79.5,90.0]},{"body_m":[0.0,2.0,0.0],"px":[110.0,59.5]},
                   {"body_m":[-2.0,0.0,0.0],"px":[79.5,29.0]}],"sigma_px":0.5}"#;
    std::fs::write(folder.join("seen.json"), seen).unwrap();
    let arguments = [
        "mounting",
        "--camera",
        "old/camera.toml",
        "--seen",
        "seen.json",
        "--out",
        "new/camera.toml",
        "--format",
        "json",
    ];
    json(&calibrate(folder, &arguments));
    let described = Command::new(env!("CARGO_BIN_EXE_robot-agent"))
        .args(["camera", "describe", "--camera", "new/camera.toml"])
        .current_dir(folder)
        .output()
        .unwrap();
    assert!(described.status.success(), "{}", String::from_utf8_lossy(&described.stderr));
}

#[test]
fn a_centre_goes_into_a_camera_file_and_a_report() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    masked_camera(folder);
    // A bright disc on a dark ground, off the file's centre.
    let disc = image::GrayImage::from_fn(160, 120, |u, v| {
        let r = (f64::from(u) - 82.0).hypot(f64::from(v) - 58.0);
        image::Luma([(40.0 + 160.0 / (1.0 + ((r - 45.0) / 0.7).exp())) as u8])
    });
    disc.save(folder.join("disc.png")).unwrap();
    let arguments =
        ["centre", "disc.png", "--camera", "old/camera.toml", "--out", "old/found.toml", "--report", "report"];
    let found = json(&calibrate(folder, &[&arguments[..], &["--rims", "1", "--format", "json"]].concat()));
    let written: toml::Table = std::fs::read_to_string(folder.join("old/found.toml")).unwrap().parse().unwrap();
    let centre: Vec<f64> = written["unified-sphere"]["centre_px"].clone().try_into().unwrap();
    assert!((centre[0] - 82.0).hypot(centre[1] - 58.0) < 0.2, "{centre:?}");
    let report: Value = serde_json::from_slice(&std::fs::read(folder.join("report/report.json")).unwrap()).unwrap();
    assert_eq!(report, found);
    assert!(std::fs::read_to_string(folder.join("report/index.html")).unwrap().contains("rim: centre"));
}

#[test]
fn wrong_input_is_named_with_what_would_be_right() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::write(
        folder.join("c.json"),
        r#"{"board":{"cols":3,"rows":2,"square_m":0.03},"image_size":[64,48],"corners":{"a":[[1,1]]}}"#,
    )
    .unwrap();
    assert_fails(&calibrate(folder, &["model", "--corners", "c.json"]), 2, &["c.json", "\"a\"", "3x2"]);
    assert_fails(&calibrate(folder, &["model", "--corners", "none.json"]), 2, &["none.json"]);
    assert_fails(
        &calibrate(folder, &["model", "--pictures", ".", "--board", "7by5", "--square-mm", "3"]),
        2,
        &["11x7"],
    );
    assert_fails(&calibrate(folder, &["import", "c.json", "--out", "x.toml"]), 2, &["c.json", "OCamCalib"]);
    assert_fails(&calibrate(folder, &["radial", "--edges-px", "10,12,11,15,20", "--order", "2"]), 2, &["edge 2"]);
    let wall = image::GrayImage::from_pixel(64, 48, image::Luma([120]));
    wall.save(folder.join("wall.png")).unwrap();
    assert_fails(&calibrate(folder, &["centre", "wall.png"]), 1, &["lines", "rim"]);
    image::GrayImage::new(32, 24).save(folder.join("small.png")).unwrap();
    assert_fails(
        &calibrate(folder, &["centre", "wall.png", "small.png"]),
        1,
        &["small.png", "32x24", "wall.png", "64x48"],
    );
    std::fs::remove_file(folder.join("small.png")).unwrap();
    let bars = |more: &[&str]| {
        calibrate(folder, &[&["radial", "--picture", "wall.png", "--centre-px", "32,24"], more].concat())
    };
    assert_fails(&bars(&["--radii-px", "9,20", "--angle-deg", "nan"]), 2, &["--angle-deg", "NaN"]);
    assert_fails(&bars(&["--radii-px", "20,9"]), 2, &["--radii-px", "[20, 9]"]);
    assert_fails(&bars(&["--radii-px", "2,20"]), 1, &["wall.png", "0 edges"]);
    assert_fails(
        &calibrate(folder, &["model", "--pictures", ".", "--board", "7x5", "--square-mm", "30"]),
        1,
        &["no board", "wall.png"],
    );
}

#[test]
fn the_locus_is_measured_from_a_ruler_at_two_distances() {
    let folder = tempfile::tempdir().unwrap();
    let lens = robot_agent::optics::Pal::reference();
    let mark = |distance: f64, height: f64| {
        let point = nalgebra::Vector3::new(distance, 0.0, height);
        let pixel = robot_agent::optics::Camera::project(&lens, &point)?;
        Some(serde_json::json!({ "height_m": height, "px": [pixel.x, pixel.y] }))
    };
    let ruler = |distance: f64| {
        let marks: Vec<Value> = (-20..30).filter_map(|k| mark(distance, f64::from(k) * 0.02 * distance)).collect();
        serde_json::json!({ "distance_m": distance, "marks": marks })
    };
    let write = |rulers: &[Value]| {
        let file =
            serde_json::json!({ "rulers": rulers, "sigma_px": 0.02, "height_sigma_m": 1e-5, "distance_sigma_m": 1e-5 });
        std::fs::write(folder.path().join("rulers.json"), file.to_string()).unwrap();
    };
    write(&[ruler(0.2), ruler(0.8)]);
    let arguments = ["locus", "rulers.json", "--centre-px", "383.5,287.5", "--format", "json"];
    let report = json(&calibrate(folder.path(), &arguments));
    // `MATHS.md` §3.4: from 6.51 mm at −15° to 3.36 mm at +20°.
    let length_mm = 1e3 * report["length_m"].as_f64().unwrap();
    assert!((2.8..3.2).contains(&length_mm) && report["is_one_point"] == false, "{report}");
    let words = calibrate(folder.path(), &arguments[..4]);
    assert!(String::from_utf8_lossy(&words.stdout).contains("do not come from one point"));
    write(&[ruler(0.2)]);
    assert_fails(&calibrate(folder.path(), &arguments), 2, &["rulers.json", "two distances"]);
    assert_fails(&calibrate(folder.path(), &["locus", "rulers.json"]), 2, &["--camera"]);
}

#[test]
fn a_camera_file_that_does_not_fit_the_floor_s_lines_is_refused() {
    use robot_agent::optics::MountedCamera;
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let file = |focal: f64| {
        let mounting = "[mounting]\nheight_m = 0.8\nrotation_rpy_deg = [180.0, 0.0, 0.0]\n";
        format!(
            "model = \"fisheye\"\nimage_size_px = [640, 480]\n[fisheye]\nlaw = \"equidistant\"\nfocal_length_px = {focal:?}\n\
             centre_px = [320.0, 240.0]\n{mounting}"
        )
    };
    std::fs::write(path("right.toml"), file(150.0)).unwrap();
    std::fs::write(path("wrong.toml"), file(138.0)).unwrap();
    let camera = MountedCamera::load(&path("right.toml")).unwrap();
    // Two lines and a circle round a robot at (0.4, 0.2) m.
    let circle = |t: f64| [1.5 * t.cos(), 1.5 * t.sin()];
    let places = (0..120).flat_map(|k| {
        let t = f64::from(k) * 0.052;
        [[0.4 * t - 1.2, -1.8], [-1.9, 0.5 * t - 1.5], circle(t)]
    });
    let points: Vec<[f64; 2]> = places
        .filter_map(|[x, y]| camera.project_body(&nalgebra::Vector3::new(x - 0.4, y - 0.2, 0.0)).map(|p| [p.x, p.y]))
        .collect();
    std::fs::write(path("points.json"), serde_json::to_string(&points).unwrap()).unwrap();
    let plan = serde_json::json!({ "lines_m": [[-3.0, -1.8, 3.0, -1.8], [-1.9, -3.0, -1.9, 3.0]], "circles_m": [[0.0, 0.0, 1.5]] });
    std::fs::write(path("plan.json"), plan.to_string()).unwrap();
    let arguments =
        |file| ["floor", "plan.json", "points.json", "--camera", file, "--sigma-px", "0.3", "--format", "json"];
    let report = json(&calibrate(folder.path(), &arguments("right.toml")));
    assert_eq!(report["fits"], true);
    let off = (report["x_m"].as_f64().unwrap() - 0.4).hypot(report["y_m"].as_f64().unwrap() - 0.2);
    assert!(off < 1e-3, "{report}");
    let refused = calibrate(folder.path(), &arguments("wrong.toml"));
    assert_fails(&refused, 1, &["wrong.toml", "does not fit"]);
    assert!(String::from_utf8_lossy(&refused.stdout).contains("\"fits\":false"));
    std::fs::write(path("plan.json"), "{\"lines\":[]}").unwrap();
    assert_fails(&calibrate(folder.path(), &arguments("right.toml")), 2, &["plan.json", "lines"]);
}
