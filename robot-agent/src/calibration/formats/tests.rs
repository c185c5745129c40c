use nalgebra::Vector2;

use super::*;
use crate::optics::Pal;

const OCAM: &str =
    "#polynomial coefficients for the DIRECT mapping function (ocam_model.ss in MATLAB). These are used by cam2world

 5 -1.211000e+02 0.000000e+00 1.730000e-03 4.400000e-07 7.100000e-09

#polynomial coefficients for the inverse mapping function (ocam_model.invpol in MATLAB). These are used by world2cam

1 0.0

#center: \"row\" and \"column\", starting from 0 (C convention)

241.5 322.25

#affine parameters \"c\", \"d\", \"e\"

1.000100 0.000100 -0.000200

#image size: \"height\" and \"width\"

480 640
";

const OPENCV: &str = "%YAML:1.0
---
calibration_time: \"Mon\"
image_width: 1280
image_height: 960
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 386.8, -0.79, 630.39, 0., 388.6, 432.48, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 1
   cols: 4
   dt: d
   data: [ -0.0616, 0.0125, 0.019, -0.0036 ]
xi: 0.9396
";

const KALIBR: &str = "cam0:
  cam_overlaps: []
  camera_model: omni
  distortion_coeffs: [-0.2, 0.05, 0.001, -0.002]
  distortion_model: radtan
  intrinsics: [1.2, 520.0, 521.0, 370.0, 240.0]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
";

/// Largest distance between two cameras' images of the rays of the first, px.
fn apart_px(a: &dyn Camera, b: &dyn Camera) -> f64 {
    let [w, h] = a.image_size_px();
    let mut worst: f64 = 0.0;
    let mut seen = 0;
    for u in (0..w).step_by(23) {
        for v in (0..h).step_by(19) {
            let pixel = Vector2::new(f64::from(u), f64::from(v));
            let Some(ray) = a.unproject(&pixel) else { continue };
            worst = worst.max((b.image_of_direction(&ray.direction).unwrap() - pixel).norm());
            seen += 1;
        }
    }
    assert!(seen > 100);
    worst
}

#[test]
fn files_are_told_apart_by_their_content() {
    assert_eq!(parse(OCAM).unwrap().tool, Tool::OCamCalib);
    assert_eq!(parse(OPENCV).unwrap().tool, Tool::OpenCv);
    assert_eq!(parse(KALIBR).unwrap().tool, Tool::Kalibr);
    assert!(parse("hello").unwrap_err().contains("OCamCalib"));
}

#[test]
fn ocamcalib_s_row_and_column_are_v_and_u() {
    let camera = parse(OCAM).unwrap().camera;
    assert_eq!(numbers::<2>(camera.as_ref(), "centre_px"), [322.25, 241.5]);
    // By hand: 100 px to the right of the centre, f(100) = -121.1 + 17.3 + 0.44 + 0.71 = -102.65.
    let ray = camera.ray_of_image(&Vector2::new(422.25, 241.5 + 0.01)).unwrap().direction;
    assert!((ray.z / ray.x - 1.0265).abs() < 1e-3, "{ray}");
}

#[test]
fn what_is_written_is_read_back_as_the_same_camera() {
    for (text, tool, within_px) in
        [(OCAM, Tool::OCamCalib, 1e-9), (OPENCV, Tool::OpenCv, 1e-9), (KALIBR, Tool::Kalibr, 1e-9)]
    {
        let camera = parse(text).unwrap().camera;
        let exported = export(camera.as_ref(), tool).unwrap();
        assert!(exported.worst_px < 0.01, "{}", exported.worst_px);
        let back = parse(&exported.text).unwrap();
        assert_eq!(back.tool, tool);
        let apart = apart_px(camera.as_ref(), back.camera.as_ref());
        assert!(apart < within_px, "{tool:?}: {apart}");
    }
}

#[test]
fn a_camera_of_another_model_is_converted_and_the_rest_is_told_truly() {
    let camera = Pal::reference();
    for tool in [Tool::OCamCalib, Tool::OpenCv, Tool::Kalibr] {
        let exported = export(&camera, tool).unwrap();
        let back = parse(&exported.text).unwrap().camera;
        let apart = apart_px(&camera, back.as_ref());
        assert!(apart < 1.3 * exported.worst_px + 0.05, "{tool:?}: {apart} px, said {}", exported.worst_px);
        assert!(exported.worst_px > 0.001 && exported.worst_px < 3.0, "{tool:?}: {}", exported.worst_px);
    }
}

#[test]
fn wrong_files_say_what_would_be_right() {
    let wrong = |text: &str, from: &str, to: &str| parse(&text.replace(from, to)).unwrap_err();
    assert!(wrong(OCAM, "480 640", "480").contains("height and width"));
    assert!(wrong(OCAM, " 5 -1.2", " 4 -1.2").contains("number of coefficients"));
    assert!(wrong(OCAM, "-1.211000e+02", "1.211000e+02").contains("below 0"));
    assert!(wrong(OCAM, "322.25", "abc").contains("\"abc\""));
    assert!(wrong(OPENCV, "xi: 0.9396", "xi: -2").contains("xi"));
    assert!(wrong(OPENCV, "[ -0.0616, 0.0125, 0.019, -0.0036 ]", "[ 1. ]").contains("must have 4"));
    assert!(wrong(OPENCV, "image_width: 1280", "").contains("image_width"));
    assert!(wrong(KALIBR, "omni", "ds").contains("ds"));
    assert!(wrong(KALIBR, "[1.2, ", "[").contains("xi, fx, fy"));
}
