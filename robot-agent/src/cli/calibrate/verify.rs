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
    /// Length of the viewpoint's locus that is looked for: the power is that of finding one so long, spread like that of the
    /// report's lens, whose length is the default. `calibrate locus` measures a camera's own.
    #[arg(long, value_name = "MM", default_value_t = 1e3 * verify::REFERENCE_LOCUS_M)]
    locus_mm: f64,
    /// Where to write a page and the numbers as JSON.
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
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
    if !(arguments.sigma_px > 0.0 && arguments.sigma_px.is_finite()) {
        return Err(Failure::usage(format!("--sigma-px {}: must be a positive number", arguments.sigma_px)));
    }
    if !(0.01..=1000.0).contains(&arguments.locus_mm) {
        return Err(Failure::usage(format!("--locus-mm {}: must be from 0.01 to 1000", arguments.locus_mm)));
    }
    let locus_m = 1e-3 * arguments.locus_mm;
    let test = |view| verify::single_viewpoint(camera.camera(), view, arguments.sigma_px, locus_m);
    let tests = observations.views.iter().map(test);
    let tests = tests.collect::<Result<Vec<_>, _>>().map_err(Failure::job)?;
    let words: Vec<String> = tests.iter().map(verify::SingleViewpointTest::words).collect();
    let numbers: Vec<_> = tests
        .iter()
        .map(|t| {
            json!({
                "view": t.view, "statistic": t.statistic, "dof": t.dof, "p_value": t.p_value,
                "shape_statistic": t.shape_statistic, "shape_p_value": t.shape_p_value, "power": t.power,
                "locus_m": t.locus_m,
                "distance_m": t.distance_m,
                "verdict": match t.verdict {
                    Verdict::NotOnePoint => "not_one_point",
                    Verdict::OnePoint => "one_point",
                    Verdict::Undecided => "undecided",
                },
            })
        })
        .collect();
    let numbers = json!({ "views": numbers });
    super::tell(arguments.format, arguments.report.as_deref(), "one viewpoint?", &words, &numbers)
}
