//! `robot-agent calibrate import|export`.

use std::path::PathBuf;

use clap::ValueEnum;
use robot_agent::calibration::formats::{self, Tool};
use robot_agent::optics::{MountedCamera, camera_toml};
use serde_json::json;

use super::super::{Failure, Format};

/// Makes a camera file from another tool's calibration.
///
/// OCamCalib's calib_results.txt, OpenCV's omnidir YAML, Kalibr's camchain.yaml: the content decides which it is.
#[derive(Debug, clap::Args)]
pub(super) struct Import {
    /// The other tool's file.
    file: PathBuf,
    /// Where to write the camera file.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// How to print what was done.
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

/// Writes a camera for another tool, and says how far off what the tool reads will be.
#[derive(Debug, clap::Args)]
pub(super) struct Export {
    /// The camera file (camera.toml).
    #[arg(long, value_name = "FILE")]
    camera: PathBuf,
    /// Whose file.
    #[arg(long, value_enum)]
    to: To,
    /// Where to write it.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// How to print what was done.
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum To {
    /// calib_results.txt.
    Ocamcalib,
    /// OpenCV's omnidir, YAML.
    Opencv,
    /// camchain.yaml.
    Kalibr,
}

/// Runs `import`.
pub(super) fn import(arguments: &Import) -> Result<(), Failure> {
    let imported = formats::import(&arguments.file).map_err(Failure::usage)?;
    let camera = imported.camera.as_ref();
    super::save(&arguments.out, &camera_toml(camera))?;
    let mut words = vec![format!("{}: a {} camera", arguments.out.display(), camera.model())];
    words.extend(imported.remarks.iter().cloned());
    super::print(arguments.format, &words, &json!({ "model": camera.model(), "remarks": imported.remarks }))
}

/// Runs `export`.
pub(super) fn export(arguments: &Export) -> Result<(), Failure> {
    let camera = MountedCamera::load(&arguments.camera).map_err(Failure::usage)?;
    let tool = match arguments.to {
        To::Ocamcalib => Tool::OCamCalib,
        To::Opencv => Tool::OpenCv,
        To::Kalibr => Tool::Kalibr,
    };
    let exported = formats::export(camera.camera(), tool).map_err(Failure::job)?;
    super::save(&arguments.out, &exported.text)?;
    let out = arguments.out.display();
    let words = if exported.worst_px == 0.0 {
        format!("{out}: the same model, nothing is lost")
    } else {
        format!("{out}: differs from the camera by {:.3} px rms, {:.3} px at most", exported.rms_px, exported.worst_px)
    };
    super::print(arguments.format, &[words], &json!({ "rms_px": exported.rms_px, "worst_px": exported.worst_px }))
}
