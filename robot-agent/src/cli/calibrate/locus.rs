//! `robot-agent calibrate locus`.

use std::path::{Path, PathBuf};

use robot_agent::calibration::axis;
use robot_agent::calibration::locus::{self, Measured};
use robot_agent::optics::MountedCamera;
use serde_json::json;

use super::super::{Failure, Format};

/// Measures without any camera model where the rays come from: a ruler is seen at two or more known distances.
///
/// The file: {"rulers":[{"distance_m":0.25,"marks":[{"height_m":0.02,"px":[u,v]},…]},…]} with optional sigma_px (0.1),
/// height_sigma_m and distance_sigma_m (0.0005). Distances are from the camera's axis, heights above any one level; the
/// heights found are above the same. The nearer the nearer ruler, the surer the result.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// What was measured (JSON).
    measured: PathBuf,
    /// A camera file: only the image of its axis and its pixels' aspect are used.
    #[arg(long, value_name = "FILE", required_unless_present = "centre_px", conflicts_with = "centre_px")]
    camera: Option<PathBuf>,
    /// The image of the camera's axis instead, as 383.5,287.5, for square pixels (`calibrate centre` finds it).
    #[arg(long, value_name = "U,V", value_parser = super::pair)]
    centre_px: Option<[f64; 2]>,
    /// How to print the result.
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

/// Runs the command.
pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let measured: Measured = super::read_json(&arguments.measured)?;
    let (centre_px, aspect) = match (&arguments.camera, arguments.centre_px) {
        (Some(path), _) => of_camera(path)?,
        (None, Some(centre_px)) => (centre_px, 1.0),
        (None, None) => return Err(Failure::usage("either --camera or --centre-px is wanted")),
    };
    let locus = locus::measure(&measured, centre_px, aspect)
        .map_err(|e| Failure::usage(format!("{}: {e}", arguments.measured.display())))?;
    let mut words = vec![locus.words(), "radius, px   elevation, °   height on the axis, mm".to_owned()];
    words.extend(locus.points.iter().map(|p| {
        let (height, sigma) = (p.height_m * 1e3, p.sigma_m * 1e3);
        format!("{:10.2} {:14.2} {height:17.3} ± {sigma:.3}", p.radius_px, p.elevation_rad.to_degrees())
    }));
    let points: Vec<_> = locus
        .points
        .iter()
        .map(|p| {
            json!({
                "radius_px": p.radius_px, "elevation_deg": p.elevation_rad.to_degrees(), "height_m": p.height_m,
                "sigma_m": p.sigma_m,
            })
        })
        .collect();
    let covariance: Vec<Vec<f64>> = locus.covariance_m2.row_iter().map(|row| row.iter().copied().collect()).collect();
    let (length_m, length_sigma_m) = locus.length_m();
    let numbers = json!({
        "finding": locus.words(), "points": points, "covariance_m2": covariance, "length_m": length_m,
        "length_sigma_m": length_sigma_m, "single_viewpoint_m": locus.single_m.0,
        "single_viewpoint_sigma_m": locus.single_m.1, "chi2": locus.chi2, "dof": locus.dof, "p_value": locus.p_value,
        "is_one_point": locus.p_value >= locus::SIGNIFICANCE,
    });
    super::print(arguments.format, &words, &numbers)
}

fn of_camera(path: &Path) -> Result<([f64; 2], f64), Failure> {
    let camera = MountedCamera::load(path).map_err(Failure::usage)?;
    let model = camera.camera();
    let centre = axis::image_px(model).ok_or_else(|| {
        Failure::usage(format!(
            "{}: a {} camera has no image of its axis; give --centre-px",
            path.display(),
            model.model()
        ))
    })?;
    let aspect = model.parameters().iter().find(|p| p.name == "aspect").map_or(1.0, |p| p.value);
    Ok((centre.into(), aspect))
}
