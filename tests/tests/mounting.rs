//! A camera that stands askew: what its pictures say about its tilt, and what the team's map becomes with that.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector, Vector2, Vector3};
use protocol::estimate::chi2_quantile;
use protocol::id::RobotId;
use protocol::message::TeamMap;
use robot_agent::calibration::lines::radial_lines;
use robot_agent::calibration::mounting::{MountingFit, Seen, find};
use robot_agent::capture::GrayPicture;
use robot_agent::optics::{CameraFile, MountedCamera};
use sim_harness::render::Renderer;
use sim_harness::render::rays::Rays;
use sim_harness::scenario::{Scenario, TiltSpec};
use sim_harness::score::nees::mahalanobis2;
use sim_harness::team::{TeamSettings, simulated};
use sim_harness::world::World;

fn mounted(text: &str) -> MountedCamera {
    CameraFile::parse(text, "camera.toml".as_ref()).unwrap().mount().unwrap()
}

/// The scenario of the exam, short and with the first robot's camera tilted; nobody told the agent.
fn tilted(tilt_deg: [f64; 2]) -> Scenario {
    let mut scenario = Scenario::builtin("default").unwrap().unwrap();
    scenario.robots.drives.clear();
    scenario.people.count = 0;
    scenario.people.camouflaged = 0;
    scenario.capture.rate_hz = 4.0;
    let robot = scenario.robot_ids()[0];
    scenario.camera.tilts = vec![TiltSpec { robot, tilt_deg, known: false }];
    scenario
}

#[test]
fn the_renderer_tilts_a_camera_as_the_camera_file_says() {
    let mut scenario = tilted([2.0, -3.0]);
    scenario.camera.tilts[0].known = true;
    let camera = mounted(&scenario.camera_toml_of(&scenario.robot_ids()[0]));
    let rays = Rays::trace_tilted(&scenario.camera, [2.0, -3.0]);
    let mut worst = 0.0_f64;
    for pixel in rays.lit.iter().filter(|p| rays.is_nominal[**p as usize]).step_by(173) {
        let (u, v) = (f64::from(*pixel % 768), f64::from(*pixel / 768));
        let ray = rays.ray(*pixel as usize, 0.0, 0.0);
        let [o, d] = [ray.origin, ray.direction].map(|c| Vector3::new(c.x, c.y, c.z).map(f64::from));
        let seen = camera.project_body(&(o + d * 3.0)).unwrap();
        worst = worst.max((seen - Vector2::new(u, v)).norm());
    }
    // Rays are kept as 32-bit numbers, mixed from the pixel's corners.
    assert!(worst < 2e-3, "{worst} px");
}

/// What `calibrate mounting` finds in pictures of a robot that stands, and the camera file with it.
fn calibrated(scenario: &Scenario, seed: u64) -> (MountingFit, String) {
    let robot = scenario.robot_ids()[0];
    let level = mounted(&scenario.camera_toml_of(&robot));
    let world = World::new(scenario, seed).unwrap().into();
    let mut renderer = Renderer::team(&world).remove(0);
    let mut seen = Seen { sigma_px: 0.3, ..Seen::default() };
    for k in 0..3 {
        let picture = renderer.render(0.5 * f64::from(k));
        let picture = GrayPicture { width: picture.width, height: picture.height, gray: picture.gray };
        for line in radial_lines(&picture, Vector2::from(scenario.camera.centre_px)) {
            let line: Vec<[f64; 2]> = line.iter().filter(|p| level.is_tested(p)).map(|p| [p.x, p.y]).collect();
            seen.vertical_lines_px.extend((line.len() >= 3).then_some(line));
        }
    }
    let fit = find(&level, &seen).unwrap();
    let [roll, pitch, _] = fit.mounting.rotation_rpy_rad.map(f64::to_degrees);
    let [roll_sigma, pitch_sigma, _] = fit.mounting.sigma.rotation_rpy_rad.map(f64::to_degrees);
    let tilt = format!("tilt_deg = [{roll:?}, {pitch:?}]\ntilt_deg_sigma = [{roll_sigma:?}, {pitch_sigma:?}]\n");
    (fit, scenario.camera_toml() + &tilt)
}

/// The last map of a short run with these camera files.
fn last_map(scenario: &Scenario, cameras: BTreeMap<RobotId, String>) -> TeamMap {
    let settings = TeamSettings { duration_s: Some(RUN_S), cameras, ..TeamSettings::default() };
    simulated::run(scenario, SEED, &settings, &|_| {}).unwrap().maps.pop().unwrap()
}

/// Poses of the robots that have one and are not the gauge, as one vector with its covariance.
fn poses(map: &TeamMap) -> (DVector<f64>, DMatrix<f64>) {
    let joint = map.joint_covariance_of(0).unwrap();
    let placed: Vec<_> = map.placed(0).filter_map(|r| Some((r.id, r.team_from_body?))).collect();
    let free: Vec<usize> = (0..placed.len()).filter(|n| Some(placed[*n].0) != map.gauge).collect();
    let values = free.iter().flat_map(|n| [placed[*n].1.x_m, placed[*n].1.y_m, placed[*n].1.heading_rad]).collect();
    let rows: Vec<usize> = free.iter().flat_map(|n| [3 * n, 3 * n + 1, 3 * n + 2]).collect();
    (DVector::from_vec(values), DMatrix::from_fn(rows.len(), rows.len(), |i, j| joint[(rows[i], rows[j])]))
}

/// Long enough for a map with all robots in it.
const RUN_S: f64 = 2.0;
const SEED: u64 = 1;

#[test]
fn a_camera_mounted_askew_and_calibrated_gives_the_map_of_an_upright_one() {
    let scenario = tilted([1.5, -2.0]);
    let robot = scenario.robot_ids()[0];
    let (fit, file) = calibrated(&scenario, SEED);
    let error = Vector2::new(
        fit.mounting.rotation_rpy_rad[0] - 1.5_f64.to_radians(),
        fit.mounting.rotation_rpy_rad[1] + 2.0_f64.to_radians(),
    );
    let covariance = fit.covariance.fixed_view::<2, 2>(0, 0).into_owned();
    let nees = error.dot(&(covariance.try_inverse().unwrap() * error));
    println!("tilt off by {:?} deg, χ² {nees:.2}", error.map(f64::to_degrees).as_slice());
    assert!(error.norm().to_degrees() < 0.25 && nees < chi2_quantile(0.99, 2), "{error} {nees}");

    let mut upright = scenario.clone();
    upright.camera.tilts.clear();
    let upright = last_map(&upright, BTreeMap::new());
    let askew = last_map(&scenario, BTreeMap::from([(robot, file)]));
    assert_eq!(upright.gauge, askew.gauge);
    let ((a, a_covariance), (b, b_covariance)) = (poses(&upright), poses(&askew));
    let apart = &a - &b;
    let chi2 = mahalanobis2(&apart, &(a_covariance + b_covariance)).unwrap();
    println!("poses apart by {:?}, χ² {chi2:.1} of {}", apart.as_slice(), apart.len());
    assert!(apart.len() >= 6 && chi2 < chi2_quantile(0.99, apart.len()), "{apart} {chi2}");
}
