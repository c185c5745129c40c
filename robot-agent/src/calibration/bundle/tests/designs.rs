//! Mirrors of known design: what assembly changes of them is found again from boards in unknown poses.

use protocol::estimate::chi2_quantile;

use super::*;
use crate::calibration::selection::select;
use crate::optics::CameraFile;

/// A design, set before its camera as a workshop does: focal length, centre and aspect a little off, and what else is
/// named. The calibration starts at the design; every unknown must come back within the covariance of all, and the noise
/// with it.
#[track_caller]
fn assert_found_again(model: &str, table: &str, assembly: &[(&str, f64)]) {
    let text =
        format!("model = \"{model}\"\nimage_size_px = [768, 576]\n[{model}]\n{table}centre_px = [383.5, 287.5]\n");
    let mounted = CameraFile::parse(&text, "camera.toml".as_ref()).unwrap().mount().unwrap();
    let design = mounted.camera();
    let values: Vec<f64> = design
        .parameters()
        .iter()
        .map(|p| match p.name.as_str() {
            "centre_px[0]" => p.value + 1.7,
            "centre_px[1]" => p.value - 1.1,
            "aspect" => 1.003,
            "focal_length_px" | "magnification_px_per_mm" => 1.012 * p.value,
            name => p.value * assembly.iter().find(|(n, _)| *n == name).map_or(1.0, |(_, factor)| *factor),
        })
        .collect();
    let truth = design.with_values(&values).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(21);
    let [low, high] = design.elevation_rad();
    let (_, objects) = boards(1, 1);
    let mut views = Vec::new();
    for i in 0..60 {
        let elevation = low + (high - low) * (0.1 + 0.8 * random.random::<f64>());
        let place = crate::optics::direction(f64::from(i) * 2.4, elevation) * (0.3 + 0.2 * random.random::<f64>());
        let facing = UnitQuaternion::rotation_between(&Vector3::z(), &place).unwrap_or_else(UnitQuaternion::identity);
        let turn = Vector3::new(random.random::<f64>(), random.random::<f64>(), random.random::<f64>());
        let rotation = facing * UnitQuaternion::from_scaled_axis(turn - Vector3::repeat(0.5));
        let pose = ViewPose { camera_from_object: Isometry3::from_parts(Translation3::from(place), rotation) };
        let view = seen(truth.as_ref(), &pose, &objects, &mut random);
        // Boards that the picture shows most of.
        if view.points.len() >= 25 && views.len() < 14 {
            views.push(view);
        }
    }
    assert_eq!(views.len(), 14, "{model}");
    let observations = Observations::new([768, 576], views).unwrap();
    let selection = select(&observations, &of_design(design).unwrap()).unwrap();
    let fit = &selection.best().fit;
    let true_values: Vec<f64> = fit
        .camera
        .unknowns()
        .iter()
        .map(|u| truth.parameters().iter().find(|p| p.name == u.name).map_or(0.0, |p| p.value))
        .collect();
    let error = DVector::from_vec(fit.camera.unknown_values()) - DVector::from_vec(true_values);
    let covariance = fit.covariance().unwrap();
    let chi2 = error.dot(&(covariance.matrix.clone().try_inverse().unwrap() * &error));
    println!(
        "{}: σ {:.4} px, χ² {chi2:.1} of {}, {:?}",
        selection.best().name,
        fit.sigma_px,
        error.len(),
        covariance.source
    );
    for (name, _) in assembly {
        assert!(fit.camera.unknown(name).is_some(), "{name} was not turned: {}", selection.best().name);
    }
    assert!((fit.sigma_px / SIGMA_PX - 1.0).abs() < 0.1, "{model}: {} px", fit.sigma_px);
    assert!(chi2 < chi2_quantile(0.99, error.len()), "{model}: {error} {chi2}");
}

#[test]
fn a_hyperboloidal_mirror_is_found_again() {
    assert_found_again(
        "hyperboloidal",
        "a_mm = 28.0955\nc_mm = 38.658\nfocal_length_px = 600.0\ncamera = \"below\"\n",
        &[],
    );
}

#[test]
fn an_ellipsoidal_mirror_is_found_again() {
    assert_found_again("ellipsoidal", "a_mm = 60.0\nc_mm = 30.0\nfocal_length_px = 420.0\ncamera = \"below\"\n", &[]);
}

#[test]
fn a_sphere_is_found_again_with_its_distance() {
    let table = "rho_mm = 40.0\nh_mm = 120.0\nfocal_length_px = 780.0\ncamera = \"below\"\n";
    assert_found_again("spherical", table, &[("h_mm", 1.1)]);
}

#[test]
fn a_cone_is_found_again_with_its_distance() {
    let table = "gamma_deg = 55.0\nh_mm = 80.0\nfocal_length_px = 420.0\ncamera = \"below\"\n";
    assert_found_again("conic", table, &[("h_mm", 1.03)]);
}
