use super::*;

/// The example of the format's definition.
const REFERENCE: &str = r#"
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
aspect = 1.0
elevation_deg = [-15.0, 20.0]
[mounting]
height_m = 0.6
azimuth_offset_deg = 0.0
tilt_deg = [0.0, 0.0]
mirrored = false
[mask]
file = "mask.png"
[timing]
exposure_ms = 5.0
"#;

const PINHOLE: &str = r#"
model = "pinhole"
image_size_px = [640, 480]
[pinhole]
focal_length_px = [700, 710.5]
centre_px = [320, 240]
"#;

fn parse(text: &str) -> Result<CameraFile, DocumentError> {
    CameraFile::parse(text, Path::new("robots/camera.toml"))
}

#[track_caller]
fn assert_error(text: &str, parts: &[&str]) {
    let error = parse(text).unwrap_err().to_string();
    for part in ["robots/camera.toml:"].iter().chain(parts) {
        assert!(error.contains(part), "{part:?} is not in: {error}");
    }
}

fn without_mask(text: &str) -> String {
    text.replace("[mask]\nfile = \"mask.png\"\n", "")
}

#[test]
fn the_example_of_the_format_is_design_d() {
    let camera = parse(&without_mask(REFERENCE)).unwrap().mount().unwrap();
    assert_eq!(camera.camera().model(), "pal");
    assert_eq!(camera.image_size_px(), [768, 576]);
    assert_eq!(camera.mounting().height_m(), Some(0.6));
    assert_eq!(camera.timing().exposure_s, 0.005);
    let ours = camera.camera().project_direction(&nalgebra::Vector3::x());
    assert_eq!(ours, super::super::Pal::reference().project_direction(&nalgebra::Vector3::x()));
}

#[test]
fn everything_optional_has_a_default() {
    let text = without_mask(REFERENCE);
    let short = text.split("[mounting]").next().unwrap();
    let mounting = *parse(short).unwrap().mount().unwrap().mounting();
    assert_eq!(mounting, Mounting::default());
    assert_eq!(mounting.height_m(), None, "a default is not a measurement");
    let pinhole = parse(PINHOLE).unwrap().mount().unwrap();
    assert_eq!(pinhole.camera().model(), "pinhole");
}

#[test]
fn sigmas_are_read_as_one_number_or_one_each() {
    let text = format!(
        "{PINHOLE}[mounting]\nrotation_rpy_deg = [1.0, 2.0, 3.0]\nrotation_rpy_deg_sigma = 0.5\n\
         position_m = [0.1, 0.2, 1.5]\nposition_m_sigma = [0.01, 0.02, 0.03]\n"
    );
    let mounting = *parse(&text).unwrap().mount().unwrap().mounting();
    assert_eq!(mounting.rotation_rpy_rad, [1.0, 2.0, 3.0].map(f64::to_radians));
    assert_eq!(mounting.sigma.rotation_rpy_rad, [0.5_f64.to_radians(); 3]);
    assert_eq!(mounting.sigma.position_m.z, 0.03);
    assert_eq!(mounting.height_m(), Some(1.5));
}

#[test]
fn wrong_values_are_reported_with_file_key_value_and_remedy() {
    let change = |from: &str, to: &str| {
        assert!(REFERENCE.contains(from));
        REFERENCE.replace(from, to)
    };
    let cases: [(String, &[&str]); 12] = [
        (change("c_mm = 9.52", "c_mm = 99.52"), &["pal.ellipsoid_c_mm", "99.52", "less than"]),
        (change("751.84954507", "nan"), &["toml:9: `pal.focal_length_px`", "NaN", "positive"]),
        (change("751.84954507", "6.26"), &["pal.focal_length_px", "6.26", "millimetres"]),
        (change("[-15.0, 20.0]", "[20.0, -15.0]"), &["pal.elevation_deg", "[20.0, -15.0]", "swapped"]),
        (change("[383.5, 287.5]", "[383.5, 600.0]"), &["pal.centre_px", "600.0", "768x576"]),
        (change("height_m = 0.6", "height_m = 600.0"), &["mounting.height_m", "600.0", "millimetres"]),
        (change("[768, 576]", "[768, 0]"), &["image_size_px", "[768, 0]"]),
        (change("tilt_deg = [0.0, 0.0]", "tilt_deg = [0.0, inf]"), &["mounting.tilt_deg", "inf", "degrees"]),
        (change("exposure_ms = 5.0", "exposure_ms = -1.0"), &["timing.exposure_ms", "-1"]),
        (change("exposure_ms = 5.0", "exposure_s = 5.0"), &["exposure_s", "toml:24", "unknown field", "exposure_ms"]),
        (change("refractive_index = 1.5168\n", ""), &["refractive_index", "missing"]),
        (change("aspect = 1.0", "aspect = \"one\""), &["aspect", "toml:14"]),
    ];
    for (text, parts) in cases {
        assert_error(&text, parts);
    }
}

#[test]
fn a_misspelt_model_is_told_which_there_are() {
    assert_error("model = \"plas\"", &["plas", "not a camera model", "pal, ", "pinhole"]);
    assert_error("image_size_px = [1, 1]", &["missing field `model`"]);
}

#[test]
fn a_table_of_another_model_or_a_missing_one_is_an_error() {
    assert_error("model = \"pal\"\nimage_size_px = [768, 576]", &["toml:1: `model`", "[pal]", "missing"]);
    assert_error(&REFERENCE.replace("\"pal\"", "\"pinhole\""), &["toml:2: `model`", "\"pal\"", "pinhole"]);
}

#[test]
fn a_position_said_twice_is_an_error() {
    let text = REFERENCE.replace("height_m = 0.6", "height_m = 0.6\nposition_m = [0.0, 0.0, 0.6]");
    assert_error(&text, &["height_m", "position_m"]);
}

#[test]
fn a_mask_must_exist_and_have_the_picture_s_size() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("camera.toml");
    std::fs::write(&path, REFERENCE).unwrap();
    let error = MountedCamera::load(&path).unwrap_err().to_string();
    assert!(error.contains("mask.png") && error.contains("camera.toml"), "{error}");

    image::GrayImage::new(10, 10).save(folder.path().join("mask.png")).unwrap();
    let error = MountedCamera::load(&path).unwrap_err().to_string();
    assert!(error.contains("10x10") && error.contains("768x576"), "{error}");

    let mut mask = image::GrayImage::from_pixel(768, 576, image::Luma([255]));
    mask.put_pixel(600, 287, image::Luma([0]));
    mask.save(folder.path().join("mask.png")).unwrap();
    let camera = MountedCamera::load(&path).unwrap();
    assert!(!camera.is_tested(&nalgebra::Vector2::new(600.2, 286.8)));
    assert!(camera.is_tested(&nalgebra::Vector2::new(601.0, 287.0)));
}

#[test]
fn a_missing_file_is_named() {
    let error = MountedCamera::load(Path::new("/nowhere/camera.toml")).unwrap_err().to_string();
    assert!(error.contains("/nowhere/camera.toml"), "{error}");
}

#[test]
fn every_model_has_a_file_and_its_wrong_values_are_named() {
    let file =
        |model: &str, table: &str| format!("model = \"{model}\"\nimage_size_px = [640, 480]\n[{model}]\n{table}");
    let mirror = "focal_length_px = 500\ncentre_px = [320, 240]\n";
    let cases = [
        (
            "hyperboloidal",
            format!("a_mm = 28.0955\nc_mm = 38.658\n{mirror}"),
            "c_mm = 38.658",
            "c_mm = 20.0",
            "eccentricity",
        ),
        ("ellipsoidal", format!("a_mm = 60\nc_mm = 30\n{mirror}"), "c_mm = 30", "c_mm = 61", "eccentricity"),
        ("spherical", format!("rho_mm = 40\nh_mm = 120\n{mirror}"), "h_mm = 120", "h_mm = 30", "inside the mirror"),
        ("conic", format!("h_mm = 80\ngamma_deg = 50\n{mirror}"), "gamma_deg = 50", "gamma_deg = nan", "degrees"),
        (
            "paraboloidal",
            "p_mm = 30\nmagnification_px_per_mm = 6\ncentre_px = [320, 240]\n".into(),
            "p_mm = 30",
            "p_mm = 0.03",
            "metres",
        ),
        (
            "pyramid",
            "h_mm = 60\nfocal_length_px = 200\ncentre_px = [80, 240]\n".into(),
            "h_mm = 60",
            "h_mm = -60",
            "millimetres",
        ),
        (
            "fisheye",
            "law = \"equisolid\"\nfocal_length_px = 200\ncentre_px = [320, 240]\n".into(),
            "equisolid",
            "equisold",
            "equisolid",
        ),
        ("unified-sphere", format!("xi = 0.9\n{mirror}"), "xi = 0.9", "xi = -1.0", "pinhole"),
        ("polynomial", "forward = [-120.0, 0.0, 1.7e-3]\ncentre_px = [320, 240]\n".into(), "-120.0", "120.0", "ss"),
        ("mosaic", "focal_length_px = 500\nhorizon_px = 240\n".into(), "500", "0", "positive"),
    ];
    for (model, table, right, wrong, hint) in cases {
        let text = file(model, &table);
        assert_eq!(parse(&text).unwrap().mount().unwrap().camera().model(), model);
        assert!(text.contains(right), "{model}");
        assert_error(&text.replace(right, wrong), &["camera.toml:", hint]);
        assert_error(&format!("{text}colour = 3\n"), &["unknown field `colour`"]);
        let misaligned = format!("{text}[misalignment]\ntilt_deg = [0.5, 0.0]\n");
        match model {
            "pyramid" | "mosaic" => assert_error(&misaligned, &["misalignment", "left out"]),
            _ => assert!(parse(&misaligned).unwrap().mount().unwrap().camera().misalignment().is_some()),
        }
    }
}
