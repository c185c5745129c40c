//! `robot-agent calibrate floor`.

use std::path::PathBuf;

use robot_agent::calibration::floor::{self, Plan};
use robot_agent::optics::MountedCamera;
use serde_json::json;

use super::super::{Failure, Format};

/// Tests a camera file on points seen on lines of a known floor: is it this camera's, and still right?
///
/// The plan: {"lines_m":[[x0,y0,x1,y1],…],"circles_m":[[x,y,radius],…],"line_width_m":0.05}. The points: [[u,v],…]. Where the
/// robot stands on the plan is found, too. A camera file that does not fit is exit code 1.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// The lines on the floor (JSON).
    plan: PathBuf,
    /// Pixels on them, from one picture (JSON).
    points: PathBuf,
    /// The camera file (camera.toml), with its height in [mounting].
    #[arg(long, value_name = "FILE")]
    camera: PathBuf,
    /// Noise of a pixel in each component, px.
    #[arg(long, value_name = "PX", default_value_t = 0.5)]
    sigma_px: f64,
    /// Floor farther from the robot does not count, metres.
    #[arg(long, value_name = "M", default_value_t = 5.0)]
    range_m: f64,
    /// How to print the result.
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

/// Runs the command.
pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let camera = MountedCamera::load(&arguments.camera).map_err(Failure::usage)?;
    let plan: Plan = super::read_json(&arguments.plan)?;
    let points: Vec<[f64; 2]> = super::read_json(&arguments.points)?;
    let fit = floor::fit(&camera, &plan, &points, arguments.sigma_px, arguments.range_m).map_err(Failure::usage)?;
    let covariance: Vec<Vec<f64>> = fit.covariance.row_iter().map(|row| row.iter().copied().collect()).collect();
    let [x_m, y_m, heading] = fit.pose;
    let numbers = json!({
        "finding": fit.words(), "fits": fit.fits(), "x_m": x_m, "y_m": y_m, "heading_deg": heading.to_degrees(),
        "covariance": covariance, "points": fit.points, "left_out": fit.left_out, "median_m": fit.median_m,
        "four_fifths_m": fit.four_fifths_m, "median_sigmas": fit.median_sigmas,
    });
    super::print(arguments.format, &[fit.words()], &numbers)?;
    if fit.fits() { Ok(()) } else { Err(Failure::job(format!("{}: does not fit", arguments.camera.display()))) }
}
