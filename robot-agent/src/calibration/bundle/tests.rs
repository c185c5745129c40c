use std::sync::Arc;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

use super::*;
use crate::calibration::axis;
use crate::calibration::candidate::{Kind, of_design};
use crate::calibration::observation::View;
use crate::calibration::summary::Summary;
use crate::calibration::{Board, BoardSize};
use crate::optics::{Camera, Pal, PalDesign, UnifiedSphere, UnifiedSphereParameters};

mod designs;

const SIGMA_PX: f64 = 0.15;
const RUNS: u64 = 100;

fn pose(rotation: [f64; 3], translation: [f64; 3]) -> ViewPose {
    ViewPose {
        camera_from_object: Isometry3::from_parts(
            Translation3::from(Vector3::from(translation)),
            UnitQuaternion::from_scaled_axis(Vector3::from(rotation)),
        ),
    }
}

/// Projections with noise of those object points that the camera sees.
fn seen(camera: &dyn Camera, pose: &ViewPose, objects: &[Vector3<f64>], random: &mut ChaCha8Rng) -> View {
    let noise = Normal::new(0.0, SIGMA_PX).unwrap();
    let points = objects.iter().filter_map(|object| {
        let pixel = camera.project(&pose.in_camera(object))?;
        let noisy = pixel + Vector2::new(noise.sample(random), noise.sample(random));
        crate::optics::is_in_image(&noisy, camera.image_size_px()).then_some((*object, noisy))
    });
    View { name: "simulated".into(), points: points.collect() }
}

/// Mean χ²/dof and mean NEES/unknowns over many draws of noise, and the number of unknowns.
fn honesty(truth: &FreeCamera, poses: &[ViewPose], objects: &[Vec<Vector3<f64>>]) -> (f64, f64, f64) {
    let expected = DVector::from_vec(truth.unknown_values());
    let (mut chi2, mut dof, mut nees) = (0.0, 0.0, 0.0);
    for seed in 0..RUNS {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let views = poses.iter().zip(objects).map(|(p, o)| seen(truth.camera().as_ref(), p, o, &mut random));
        let observations = Observations::new(truth.camera().image_size_px(), views.collect()).unwrap();
        let fit = Fit::from_poses(&observations, truth, poses.to_vec()).unwrap();
        chi2 += fit.weighted_squares_px2() / (SIGMA_PX * SIGMA_PX);
        dof += fit.dof as f64;
        let error = DVector::from_vec(fit.camera.unknown_values()) - &expected;
        let covariance = fit.point_covariance(SIGMA_PX).unwrap();
        nees += error.dot(&(covariance.try_inverse().unwrap() * &error));
    }
    let unknowns = expected.len() as f64;
    (chi2 / dof, nees / (unknowns * RUNS as f64), unknowns)
}

#[track_caller]
fn assert_honest((chi2, nees, unknowns): (f64, f64, f64), dof_a_run: f64) {
    let runs = RUNS as f64;
    // 95 % bounds of means of χ²; a normal approximation with so many degrees of freedom.
    let bound = |dof: f64| 1.96 * (2.0 / dof).sqrt();
    println!("χ²/dof {chi2:.4} ± {:.4}, NEES {nees:.3} ± {:.3}", bound(runs * dof_a_run), bound(runs * unknowns));
    assert!((chi2 - 1.0).abs() < bound(runs * dof_a_run), "χ²/dof {chi2}");
    assert!((nees - 1.0).abs() < bound(runs * unknowns), "NEES {nees}");
}

/// The set-up of `MATHS.md` §3.8 with half of its points: all round, 0.4 to 2.5 m away, the rig's pose unknown.
#[test]
fn the_report_s_lens_is_calibrated_with_an_honest_covariance() {
    let design = PalDesign { centre_px: [384.7, 287.1], aspect: 1.003, ..PalDesign::REFERENCE };
    let camera = Pal::new(design, [768, 576]).unwrap();
    let truth = of_design(&camera).unwrap().remove(1).start;
    assert_eq!(truth.unknowns().len(), 5);
    let mut random = ChaCha8Rng::seed_from_u64(1000);
    let objects: Vec<Vector3<f64>> = (0..200)
        .map(|_| {
            let (bearing, elevation) =
                (random.random::<f64>() * std::f64::consts::TAU, (random.random::<f64>() * 30.0 - 12.0).to_radians());
            crate::optics::direction(bearing, elevation) * (0.4 + 2.1 * random.random::<f64>())
        })
        .collect();
    let pose = pose([0.0227, 0.0, 0.3], [0.012, -0.008, 0.005]);
    assert_honest(honesty(&truth, &[pose], &[objects]), 388.0);
}

fn boards(seed: u64, views: usize) -> (Vec<ViewPose>, Vec<Vector3<f64>>) {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let size = BoardSize { cols: 7, rows: 5 };
    let board = Board::new(size, 0.04).unwrap().view("board".into(), &vec![Vector2::zeros(); 35]).unwrap();
    let objects: Vec<Vector3<f64>> = board.points.iter().map(|(o, _)| o - Vector3::new(0.12, 0.08, 0.0)).collect();
    let poses = (0..views)
        .map(|i| {
            let bearing = i as f64 * 2.4;
            let place = crate::optics::direction(bearing, random.random::<f64>() * 0.9 - 0.3)
                * (0.3 + 0.1 * random.random::<f64>());
            // Faces the camera roughly: the board's normal along the ray, then turned by up to half a radian.
            let facing = UnitQuaternion::rotation_between(&Vector3::z(), &place).unwrap();
            let turn = Vector3::new(random.random::<f64>(), random.random::<f64>(), random.random::<f64>())
                - Vector3::repeat(0.5);
            let rotation = facing * UnitQuaternion::from_scaled_axis(turn);
            ViewPose { camera_from_object: Isometry3::from_parts(Translation3::from(place), rotation) }
        })
        .collect();
    (poses, objects)
}

fn sphere() -> Arc<dyn Camera> {
    sphere_with([-0.05, 0.01, 2e-3, -1e-3])
}

fn sphere_with(distortion: [f64; 4]) -> Arc<dyn Camera> {
    let parameters = UnifiedSphereParameters {
        xi: 0.94,
        focal_length_px: [265.0; 2],
        centre_px: [388.0, 284.0],
        skew: 0.0,
        distortion,
    };
    Arc::new(UnifiedSphere::new(parameters, [768, 576]).unwrap())
}

const MISALIGNED: [&str; 8] = [
    "xi",
    "focal_length_px[0]=focal_length_px[1]",
    "centre_px[0]",
    "centre_px[1]",
    "distortion[0]",
    "distortion[1]",
    "distortion[2]",
    "distortion[3]",
];

#[test]
fn boards_in_unknown_poses_give_an_honest_covariance() {
    let truth = FreeCamera::new(sphere(), &MISALIGNED);
    let views = 14;
    let (poses, objects) = boards(3, views);
    let numbers = 2 * views * objects.len() - 6 * views - MISALIGNED.len();
    let objects = vec![objects; views];
    assert_honest(honesty(&truth, &poses, &objects), numbers as f64);
}

#[test]
fn a_search_from_nothing_finds_camera_and_poses() {
    let (poses, objects) = boards(5, 8);
    let mut random = ChaCha8Rng::seed_from_u64(9);
    let camera = sphere();
    let views = poses.iter().map(|p| seen(camera.as_ref(), p, &objects, &mut random)).collect();
    let observations = Observations::new([768, 576], views).unwrap();
    let candidates = Kind::UnifiedSphere.candidates([768, 576], None).unwrap();
    let selection = crate::calibration::selection::select(&observations, &candidates).unwrap();
    assert_eq!(selection.best().name, "unified sphere, radial and tangential");
    let fit = &selection.best().fit;
    let centre = Vector2::new(fit.camera.unknown_values()[2], fit.camera.unknown_values()[3]);
    assert!((centre - Vector2::new(388.0, 284.0)).norm() < 1.0, "{centre}");
    assert!((fit.sigma_px - SIGMA_PX).abs() < 0.1 * SIGMA_PX, "{}", fit.sigma_px);
}

/// The axis of a misaligned camera is what depends on the model: a fit of another family must find the true one's rays, and
/// the true axis among them within its own covariance.
#[test]
fn another_misaligned_model_images_the_true_axis_within_its_covariance() {
    let truth = sphere_with([-0.05, 0.01, 8e-3, -4e-3]);
    let (poses, objects) = boards(11, 16);
    let mut random = ChaCha8Rng::seed_from_u64(12);
    let views = poses.iter().map(|p| seen(truth.as_ref(), p, &objects, &mut random)).collect();
    let observations = Observations::new([768, 576], views).unwrap();
    let candidates = Kind::KannalaBrandt.candidates([768, 576], None).unwrap();
    let selection = crate::calibration::selection::select(&observations, &candidates).unwrap();
    assert_eq!(selection.best().name, "fisheye, Kannala-Brandt, misaligned");
    let summary = Summary::new(&observations, &selection);
    let pixels = observations.views.iter().flat_map(|v| &v.points).map(|(_, pixel)| *pixel);
    let found = axis::shared(truth.as_ref(), selection.best().fit.camera.camera().as_ref(), pixels).unwrap();
    let apart = found.image_px.unwrap() - Vector2::new(388.0, 284.0);
    let covariance = summary.centre_covariance_px2().unwrap();
    let chi2 = apart.dot(&(covariance.try_inverse().unwrap() * apart));
    println!("{found:?} {covariance} χ² {chi2:.2}, aligned {:?}", selection.judged[0].fit.camera.unknown_values());
    // χ² with 2 degrees of freedom at 1 %.
    assert!(chi2 < 9.21, "{chi2}");
    let off_aligned =
        axis::image_px(selection.judged[0].fit.camera.camera().as_ref()).unwrap() - Vector2::new(388.0, 284.0);
    assert!(off_aligned.norm() > 5.0 * apart.norm(), "{off_aligned} {apart}");
}

#[test]
fn shuffled_corners_and_too_few_points_are_refused_in_words() {
    let (poses, objects) = boards(5, 6);
    let mut random = ChaCha8Rng::seed_from_u64(9);
    let camera = sphere();
    let mut views: Vec<View> = poses.iter().map(|p| seen(camera.as_ref(), p, &objects, &mut random)).collect();
    for view in &mut views[..4] {
        let pixels: Vec<Vector2<f64>> = view.points.iter().map(|(_, p)| *p).collect();
        let n = pixels.len();
        for (i, (_, pixel)) in view.points.iter_mut().enumerate() {
            *pixel = pixels[(i * 13) % n];
        }
    }
    let start = FreeCamera::new(camera.clone(), &MISALIGNED);
    let observations = Observations::new([768, 576], views).unwrap();
    let error = Fit::search(&observations, &start).unwrap_err().to_string();
    assert!(error.contains("order"), "{error}");
    let every_sixth: Vec<Vector3<f64>> = objects.iter().step_by(5).copied().collect();
    let view = seen(camera.as_ref(), &poses[0], &every_sixth, &mut random);
    let few = Observations::new([768, 576], vec![view]).unwrap();
    let error = Fit::from_poses(&few, &start, vec![poses[0].clone()]).unwrap_err().to_string();
    assert!(error.contains("more views"), "{error}");
}
