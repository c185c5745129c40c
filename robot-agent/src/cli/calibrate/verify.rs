//! `robot-agent calibrate verify`.

use std::path::PathBuf;

use robot_agent::calibration::corner_file;
use robot_agent::calibration::verify::{self, Verdict};
use robot_agent::optics::MountedCamera;
use serde_json::json;

use super::super::{Failure, Format};

/// Tests on views of a board nearby whether a camera looks from a single point.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// The camera file (camera.toml).
    #[arg(long, value_name = "FILE")]
    camera: PathBuf,
    /// Corners of the board: this tool's JSON, or OpenCV's XML.
    #[arg(long, value_name = "FILE")]
    corners: PathBuf,
    /// Noise of a corner in each component, px.
    #[arg(long, value_name = "PX", default_value_t = 0.1)]
    sigma_px: f64,
    /// How to print the result.
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

/// Runs the command.
pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let camera = MountedCamera::load(&arguments.camera).map_err(Failure::usage)?;
    let observations = corner_file::read(&arguments.corners).map_err(Failure::usage)?;
    if observations.image_size_px != camera.image_size_px() {
        let ([w, h], [cw, ch]) = (observations.image_size_px, camera.image_size_px());
        let file = arguments.corners.display();
        return Err(Failure::usage(format!(
            "{file}: corners of pictures of {w}x{h} pixels, the camera's have {cw}x{ch}"
        )));
    }
    let tests =
        observations.views.iter().map(|view| verify::single_viewpoint(camera.camera(), view, arguments.sigma_px));
    let tests = tests.collect::<Result<Vec<_>, _>>().map_err(Failure::job)?;
    let words: Vec<String> = tests.iter().map(verify::SingleViewpointTest::words).collect();
    let numbers: Vec<_> = tests
        .iter()
        .map(|t| {
            json!({
                "view": t.view, "statistic": t.statistic, "dof": t.dof, "p_value": t.p_value,
                "shape_statistic": t.shape_statistic, "shape_p_value": t.shape_p_value, "power": t.power,
                "distance_m": t.distance_m,
                "verdict": match t.verdict {
                    Verdict::NotOnePoint => "not_one_point",
                    Verdict::OnePoint => "one_point",
                    Verdict::Undecided => "undecided",
                },
            })
        })
        .collect();
    super::print(arguments.format, &words, &json!({ "views": numbers }))
}
