//! The command line as a user meets it: output, errors, exit codes.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::io::Write;
use std::path::Path;
use std::process::{Command, Output, Stdio};

use serde_json::Value;

const CAMERA: &str = r#"
model = "pal"
image_size_px = [768, 576]
[pal]
ellipsoid_a_mm = 23.8095238095
ellipsoid_c_mm = 9.52380952381
hyperboloid_a_mm = 6.47619047619
hyperboloid_c_mm = 16.5238095238
focal_length_px = 751.84954507
refraction_a_mm = 31.25
refraction_eccentricity = 0.6
refractive_index = 1.5168
centre_px = [383.5, 287.5]
elevation_deg = [-15.0, 20.0]
"#;

fn robot_agent(folder: &Path, arguments: &[&str], input: &str) -> Output {
    let mut child = Command::new(env!("CARGO_BIN_EXE_robot-agent"))
        .args(arguments)
        .current_dir(folder)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    child.stdin.take().unwrap().write_all(input.as_bytes()).unwrap();
    child.wait_with_output().unwrap()
}

fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("camera.toml"), CAMERA).unwrap();
    folder
}

fn lines(output: &Output) -> Vec<Value> {
    let text = String::from_utf8(output.stdout.clone()).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[track_caller]
fn assert_fails(output: &Output, code: i32, parts: &[&str]) {
    let error = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{error}");
    for part in parts {
        assert!(error.contains(part), "{part:?} is not in: {error}");
    }
}

#[test]
fn points_become_pixels_and_pixels_rays_line_by_line() {
    let folder = folder();
    let input = "[10.0, 0.0, -1.0]\n[0.0, 0.0, 1.0]\n\n[0.1, 0, 0]\n";
    let output = robot_agent(folder.path(), &["camera", "project", "--camera", "camera.toml"], input);
    assert!(output.status.success());
    let pixels = lines(&output);
    assert_eq!(pixels.len(), 3);
    // Golden pal.project_finite: r = 10 m, z = -1 m and r = 0.1 m, z = 0.
    assert!((pixels[0][0].as_f64().unwrap() - 383.5 - 235.875655992128).abs() < 1e-6);
    assert!(pixels[1].is_null());
    assert!((pixels[2][0].as_f64().unwrap() - 383.5 - 226.049291383822).abs() < 1e-6);

    let output = robot_agent(
        folder.path(),
        &["camera", "unproject", "--camera", "camera.toml"],
        &format!("{}\n[383.5, 287.5]\n", pixels[0]),
    );
    let rays = lines(&output);
    let (origin, direction) = (&rays[0]["origin_m"], &rays[0]["direction"]);
    let along = (10.0 - origin[0].as_f64().unwrap()) / direction[0].as_f64().unwrap();
    assert!((origin[2].as_f64().unwrap() + along * direction[2].as_f64().unwrap() + 1.0).abs() < 1e-8);
    assert!(rays[1].is_null());
}

#[test]
fn a_bad_line_or_camera_file_is_named_with_its_exit_code() {
    let folder = folder();
    let output = robot_agent(folder.path(), &["camera", "project", "--camera", "camera.toml"], "[1,2,3]\n[1,2]\n");
    assert_fails(&output, 1, &["line 2", "[1,2]", "[x_m, y_m, z_m]"]);
    assert_eq!(lines(&output).len(), 1);
    let output = robot_agent(folder.path(), &["camera", "describe", "--camera", "nowhere.toml"], "");
    assert_fails(&output, 2, &["nowhere.toml"]);
    std::fs::write(folder.path().join("bad.toml"), CAMERA.replace("index = 1.5", "index = 0.5")).unwrap();
    let output = robot_agent(folder.path(), &["camera", "describe", "--camera", "bad.toml"], "");
    assert_fails(&output, 2, &["bad.toml", "pal.refractive_index", "0.5168", "[1, 4)"]);
    assert_fails(&robot_agent(folder.path(), &["camera", "guess"], ""), 2, &["guess"]);
}

#[test]
fn describe_speaks_json() {
    let folder = folder();
    let arguments = ["camera", "describe", "--camera", "camera.toml", "--format", "json"];
    let facts = &lines(&robot_agent(folder.path(), &arguments, ""))[0];
    assert_eq!(facts["model"], "pal");
    assert_eq!(facts["default_panorama"]["width_px"], 1080);
    assert_eq!(facts["default_panorama"]["height_px"], 162);
}

#[test]
fn unwarp_writes_a_panorama_with_left_on_the_left() {
    let folder = folder();
    // Bright where the camera sees the robot's left: v > v0.
    let picture = image::GrayImage::from_fn(768, 576, |_, v| image::Luma([if v > 287 { 200 } else { 50 }]));
    picture.save(folder.path().join("picture.png")).unwrap();
    let arguments = ["unwarp", "picture.png", "--camera", "camera.toml", "--out", "panorama.png", "--format", "json"];
    let output = robot_agent(folder.path(), &arguments, "");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(lines(&output)[0]["width_px"], 1080);
    let panorama = image::open(folder.path().join("panorama.png")).unwrap().into_luma8();
    assert_eq!(panorama.dimensions(), (1080, 162));
    assert_eq!((panorama.get_pixel(270, 80)[0], panorama.get_pixel(810, 80)[0]), (200, 50));

    let view = ["--projection", "perspective", "--pan-deg", "90", "--tilt-deg", "2", "--hfov-deg", "25"];
    let arguments = [&["unwarp", "picture.png", "--camera", "camera.toml", "--out", "left.png"], &view[..]].concat();
    assert!(robot_agent(folder.path(), &arguments, "").status.success());
    let left = image::open(folder.path().join("left.png")).unwrap().into_luma8();
    assert_eq!((left.dimensions(), left.get_pixel(320, 240)[0]), ((640, 480), 200));
}

#[test]
fn unwarp_says_what_is_wrong_with_a_picture() {
    let folder = folder();
    let unwarp = |picture: &str, out: &str| {
        robot_agent(folder.path(), &["unwarp", picture, "--camera", "camera.toml", "--out", out], "")
    };
    assert_fails(&unwarp("none.png", "out.png"), 1, &["none.png"]);
    image::GrayImage::new(640, 480).save(folder.path().join("small.png")).unwrap();
    assert_fails(&unwarp("small.png", "out.png"), 1, &["small.png", "640x480", "768x576"]);
    let noise = image::GrayImage::from_fn(768, 576, |u, v| image::Luma([(u * 7 + v * 13) as u8]));
    noise.save(folder.path().join("whole.png")).unwrap();
    let bytes = std::fs::read(folder.path().join("whole.png")).unwrap();
    std::fs::write(folder.path().join("half.png"), &bytes[..bytes.len() / 2]).unwrap();
    assert_fails(&unwarp("half.png", "out.png"), 1, &["half.png", "cannot decode"]);
    assert_fails(&unwarp("whole.png", "no/such/folder/out.png"), 1, &["no/such/folder/out.png"]);
    std::fs::write(folder.path().join("out.gif"), "kept").unwrap();
    assert_fails(&unwarp("whole.png", "out.gif"), 2, &["out.gif", ".png", ".pgm"]);
    assert_eq!(std::fs::read(folder.path().join("out.gif")).unwrap(), b"kept");
    assert!(!folder.path().join("out.png").exists());
    let with = |more: &[&str]| {
        let arguments = ["unwarp", "whole.png", "--camera", "camera.toml", "--out", "out.png"];
        robot_agent(folder.path(), &[&arguments, more].concat(), "")
    };
    assert_fails(&with(&["--pan-deg", "3"]), 2, &["--pan-deg", "perspective"]);
    assert_fails(&with(&["--projection", "cylinder", "--hfov-deg", "90"]), 2, &["--hfov-deg", "perspective"]);
    let perspective = ["--projection", "perspective"];
    assert_fails(&with(&[&perspective[..], &["--elevation-deg", "0", "9"]].concat()), 2, &["--elevation-deg"]);
    assert_fails(&with(&[&perspective[..], &["--hfov-deg", "1000"]].concat()), 2, &["1000", "170"]);
}

const PINHOLE: &str = r#"
model = "pinhole"
image_size_px = [160, 120]
[pinhole]
focal_length_px = [150.0, 150.0]
centre_px = [79.5, 59.5]
"#;

/// A textured picture in which a bright box has come some way.
fn walk_past(n: u32, size: [u32; 2]) -> image::GrayImage {
    image::GrayImage::from_fn(size[0], size[1], |u, v| {
        let inside = (4 * n..4 * n + 16).contains(&u) && (40..90).contains(&v);
        let noise = (u * 7919 + v * 104_729 + n * 15_485_863) % 4;
        image::Luma([(if inside { 210 } else { 90 + 20 * u32::from(u / 8 % 2 == v / 8 % 2) } + noise) as u8])
    })
}

#[test]
fn tracking_goes_on_over_bad_frames_and_leaves_pictures_and_an_animation() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::write(at("camera.toml"), PINHOLE).unwrap();
    std::fs::create_dir(at("frames")).unwrap();
    for n in 0..30 {
        let size = if n == 17 { [80, 60] } else { [160, 120] };
        walk_past(n, size).save(at(&format!("frames/{n:03}.png"))).unwrap();
    }
    let whole = std::fs::read(at("frames/020.png")).unwrap();
    std::fs::write(at("frames/020.png"), &whole[..whole.len() / 2]).unwrap();
    let arguments = ["track", "frames", "--camera", "camera.toml", "--frame-rate-hz", "10", "--out", "out"];
    let output = robot_agent(folder.path(), &arguments, "");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let lines = lines(&output);
    assert_eq!(lines.len(), 30);
    for (n, line) in lines.iter().enumerate() {
        assert_eq!(line["frame"], n);
        assert_eq!(line["error"].is_null(), n != 17 && n != 20, "{line}");
    }
    assert!(lines[17]["error"].as_str().unwrap().contains("80x60"));
    assert_eq!((&lines[17]["alarm"], &lines[17]["background"]), (&Value::Null, &Value::from("ready")));
    let log = String::from_utf8_lossy(&output.stderr);
    assert!(log.contains("80x60") && !log.contains("020.png"), "the first is told: {log}");
    assert!(log.contains("2 of 30 frames"), "{log}");
    for n in 0..30 {
        let mask = image::open(at(&format!("out/mask/{n:06}.png"))).unwrap().into_luma8();
        assert_eq!(mask.dimensions(), (160, 120));
        assert!(n != 20 || mask.pixels().all(|p| p[0] == 0));
    }
    assert!(!lines[28]["objects"].as_array().unwrap().is_empty(), "{}", lines[28]);
    for name in ["background.png", "objects.png", "tracks.png", "synopsis.png", "gaze.png", "animation.png"] {
        assert!(image::open(at(&format!("out/{name}"))).is_ok(), "{name}");
    }
    let animation = std::fs::read(at("out/animation.png")).unwrap();
    assert!(animation.windows(4).any(|w| w == b"acTL"), "it is animated");
    // A shorter run leaves nothing of a longer one.
    let arguments = ["track", "frames/001.png", "--camera", "camera.toml", "--out", "out"];
    assert!(robot_agent(folder.path(), &arguments, "").status.success());
    assert_eq!(std::fs::read_dir(at("out/mask")).unwrap().count(), 1);
}

#[test]
fn inputs_of_which_nothing_can_be_used_say_so() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::write(at("camera.toml"), PINHOLE).unwrap();
    std::fs::write(at("empty.y4m"), "YUV4MPEG2 W160 H120 F25:1 Cmono\n").unwrap();
    let track = |input: &str, more: &[&str]| {
        robot_agent(folder.path(), &[&["track", input, "--camera", "camera.toml"], more].concat(), "")
    };
    assert_fails(&track("empty.y4m", &[]), 1, &["empty.y4m", "not one frame"]);
    assert_fails(&track("/dev/video-none", &[]), 1, &["/dev/video-none", "cannot open the camera"]);
    walk_past(0, [160, 120]).save(at("one.png")).unwrap();
    std::fs::write(at("nan.txt"), "1,1,NaN,2,3,4\n1,1,1,2,-3,4\n").unwrap();
    assert_fails(&track("one.png", &["--detections", "nan.txt"]), 2, &["nan.txt", "NaN"]);
    std::fs::write(at("far.txt"), "1,1,900,2,30,40\n").unwrap();
    assert_fails(&track("one.png", &["--detections", "far.txt"]), 2, &["far.txt", "160 x 120", "--detections-scale"]);
}

#[test]
fn pictures_of_a_turning_arm_become_a_mosaic_that_knows_the_time_of_its_columns() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let camera = |turn_s: f64| {
        let table = format!("focal_length_px = 40.0\nhorizon_px = 19.5\nturn_s = {turn_s:?}\n");
        std::fs::write(path("mosaic.toml"), format!("model = \"mosaic\"\nimage_size_px = [90, 40]\n[mosaic]\n{table}"))
    };
    camera(9.0).unwrap();
    std::fs::create_dir(path("frames")).unwrap();
    // A picture every 4°, and five of a second turn.
    for n in 0..95u8 {
        image::GrayImage::from_pixel(5, 40, image::Luma([n])).save(path("frames").join(format!("{n:03}.png"))).unwrap();
    }
    let run = |more: &[&str]| {
        let arguments = ["mosaic", "frames", "--camera", "mosaic.toml", "--out", "mosaic.png", "--times", "times.csv"];
        robot_agent(folder.path(), &[&arguments[..], more].concat(), "")
    };
    let output = run(&["--frame-rate-hz", "10", "--format", "json"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let report = &lines(&output)[0];
    assert_eq!((&report["pictures"], &report["left_out"]), (&90.into(), &5.into()));
    let mosaic = image::open(path("mosaic.png")).unwrap().to_luma8();
    assert_eq!(mosaic.dimensions(), (90, 40));
    for u in 0..90u32 {
        // The column's middle is half a picture after the u-th.
        let late = (f64::from(mosaic.get_pixel(u, 7).0[0]) - f64::from(u) - 0.5).rem_euclid(90.0);
        assert!(late.min(90.0 - late) < 0.5 + 1e-6, "column {u}: {late}");
    }
    let times = std::fs::read_to_string(path("times.csv")).unwrap();
    assert!(times.starts_with("column,picture,capture_ns\n") && times.lines().count() == 91);
    let row: Vec<u64> = times.lines().nth(46).unwrap().split(',').map(|n| n.parse().unwrap()).collect();
    assert_eq!(row[2], row[1] * 100_000_000, "{row:?}");

    camera(30.0).unwrap();
    assert_fails(&run(&["--frame-rate-hz", "10"]), 1, &["frames", "turn_s"]);
    std::fs::write(path("mosaic.toml"), CAMERA).unwrap();
    assert_fails(&run(&[]), 2, &["mosaic.toml", "must be \"mosaic\""]);
}

#[test]
fn markers_of_peers_may_be_one_or_many_and_a_bad_one_is_named() {
    let folder = folder();
    image::GrayImage::new(768, 576).save(folder.path().join("dark.png")).unwrap();
    let peers = |markers: &str| {
        std::fs::write(folder.path().join("markers.json"), markers).unwrap();
        let arguments = ["peers", "dark.png", "--camera", "camera.toml", "--markers", "markers.json"];
        robot_agent(folder.path(), &arguments, "")
    };
    let look = r#"{"rings":[{"height_m":[0.1,0.2],"reflectance":0.85},{"height_m":[0.2,0.3],"reflectance":0.05},{"height_m":[0.3,0.5],"reflectance":0.85}]}"#;
    let one = format!(r#"{{"kind":"cylinder","radius_m":0.2,"height_m":[0.1,0.5],"look":{look}}}"#);
    let named = one.replacen('{', "{\"robot\":\"r2\",", 1);
    for markers in [one.clone(), format!("[{one},{named}]")] {
        let output = peers(&markers);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        assert_eq!(lines(&output)[0]["peers"], serde_json::json!([]));
    }
    assert_fails(&peers("[]"), 2, &["markers.json", "empty array"]);
    assert_fails(&peers("{"), 2, &["markers.json", "not JSON"]);
    assert_fails(&peers(r#"{"kind":"cylinder","radius_m":-0.2}"#), 2, &["markers.json", "radius_m"]);
    assert_fails(&peers(r#"{"robot":"R 2","kind":"cylinder","radius_m":0.2}"#), 2, &["marker 0"]);
    assert_fails(&peers(r#"[{"kind":"cylinder","radius":0.2}]"#), 2, &["markers.json", "marker 0", "radius"]);
}

#[test]
fn what_cannot_be_printed_is_an_error_and_no_panic() {
    let folder = folder();
    let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    let config = folder.path().join("agent.toml");
    std::fs::write(&config, "").unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_robot-agent"))
        .args(["check", "--config", "agent.toml", "--format", "json"])
        .current_dir(folder.path())
        .stdout(full)
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
        .wait_with_output()
        .unwrap();
    assert_fails(&output, 1, &["cannot write to standard output"]);
}

const AGENT: &str = r#"
[robot]
id = "r1"
team = "lab"
camera = "camera.toml"
marker = { kind = "cylinder", radius_m = 0.2, height_m = [0.1, 0.5] }
[capture]
source = "frames"
frame_rate_hz = 10.0
"#;

#[test]
fn check_finds_what_run_would_refuse_and_remarks_on_what_nobody_could_see() {
    let folder = folder();
    let at = |name: &str| folder.path().join(name);
    std::fs::write(at("camera.toml"), format!("{CAMERA}[mounting]\nheight_m = 0.6\n")).unwrap();
    std::fs::create_dir(at("frames")).unwrap();
    image::GrayImage::new(768, 576).save(at("frames/000.png")).unwrap();
    let check = |config: &str| {
        std::fs::write(at("agent.toml"), config).unwrap();
        robot_agent(folder.path(), &["check", "--config", "agent.toml", "--format", "json"], "")
    };
    let with = |key: &str| AGENT.replace("[capture]", &format!("{key}\n[capture]"));
    let output = check(&with("state_dir = \"made/later\""));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(!at("made").exists(), "nothing is left behind");
    let remarks = lines(&output)[0]["remarks"].to_string();
    assert!(remarks.contains("no `look`"), "{remarks}");
    assert!(!remarks.contains("frame_rate_hz"), "{remarks}");
    let slow = lines(&check(&AGENT.replace("frame_rate_hz = 10.0", "frame_rate_hz = 1.0")))[0]["remarks"].to_string();
    assert!(slow.contains("capture.frame_rate_hz = 1: "), "{slow}");
    std::fs::write(at("file"), "").unwrap();
    assert_fails(&check(&with("state_dir = \"file/state\"")), 2, &["state_dir", "file"]);
    let narrow = format!("{AGENT}[work]\npanorama_columns = 64\n");
    assert_fails(&check(&narrow), 2, &["agent.toml", "work.panorama_columns", "64"]);
}

#[test]
fn what_cannot_be_learnt_from_is_named() {
    let folder = folder();
    image::GrayImage::new(768, 576).save(folder.path().join("dark.png")).unwrap();
    let learn = |places: &str, more: &[&str]| {
        std::fs::write(folder.path().join("places.json"), places).unwrap();
        let asked = ["learn", "dark.png", "--camera", "camera.toml", "--places", "places.json", "--radius-m", "0.2"];
        robot_agent(folder.path(), &[&asked, more].concat(), "")
    };
    let painted = ["--height-m", "0.1", "0.5"];
    let one = r#"[{"bearing_deg": 10.0, "range_m": 2.5}]"#;
    assert_fails(&learn("[]", &painted), 2, &["places.json", "empty array"]);
    assert_fails(&learn(r#"[{"bearing": 1.0}]"#, &painted), 2, &["places.json", "bearing"]);
    assert_fails(
        &learn(r#"[{"bearing_deg": 10.0, "range_m": 0.1}]"#, &painted),
        2,
        &["place 0", "0.1 m", "0.22 to 20 m"],
    );
    assert_fails(&learn(&format!("[{0},{0}]", &one[1..one.len() - 1]), &painted), 2, &["2 places for 1 pictures"]);
    assert_fails(&learn(one, &["--height-m", "0.5", "0.1"]), 2, &["--height-m", "0.05 or more above"]);
    assert_fails(
        &learn(one, &["--height-m", "0.1", "0.5", "--out", "marker.yaml"]),
        2,
        &["marker.yaml", ".toml or a .json"],
    );
    assert_fails(&learn(one, &painted), 1, &["dark.png", "no rings"]);
}
