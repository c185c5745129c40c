//! `robot-agent calibrate mounting`.

use std::path::{Path, PathBuf};

use nalgebra::Vector2;
use robot_agent::calibration::lines;
use robot_agent::calibration::mounting::{self, MountingFit, Seen};
use robot_agent::capture::read_gray;
use robot_agent::optics::{MountedCamera, Mounting};
use serde_json::json;

use super::super::{Failure, Format};

/// How a calibrated camera sits on its robot: yaw, tilt and height, written into the camera file's `[mounting]`.
///
/// Vertical lines are found in the pictures; what else was seen stands in a JSON file: vertical_lines_px, points
/// ({"body_m","px"}), uprights ({"foot_px","top_px","height_m"}), ahead_px, drive_px ([[before],[after]] of far things in a
/// straight drive forwards), sigma_px. What nothing was seen of stays as it was.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Pictures in which vertical lines are looked for, while the robot stands level.
    pictures: Vec<PathBuf>,
    /// The camera file (camera.toml).
    #[arg(long, value_name = "FILE")]
    camera: PathBuf,
    /// What else was seen (JSON).
    #[arg(long, value_name = "FILE")]
    seen: Option<PathBuf>,
    /// Where to write the camera file with its mounting; may be the same file. Comments are not kept.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// How to print the result.
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

/// Runs the command.
pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let camera = MountedCamera::load(&arguments.camera).map_err(Failure::usage)?;
    let mut seen = match &arguments.seen {
        Some(path) => read_seen(path)?,
        None => Seen { sigma_px: 0.3, ..Seen::default() },
    };
    let axis = camera.camera().image_of_direction(&nalgebra::Vector3::z());
    let [w, h] = camera.image_size_px().map(f64::from);
    let middle = axis.unwrap_or(Vector2::new(0.5 * w, 0.5 * h));
    for path in &arguments.pictures {
        let picture = read_gray(path, Some(camera.image_size_px())).map_err(Failure::job)?;
        // Only what the camera says it sees: beyond are its own rim and the robot.
        let lines = lines::radial_lines(&picture, middle).into_iter().map(|line| {
            line.into_iter().filter(|p| camera.is_tested(p)).map(|p| [p.x, p.y]).collect::<Vec<[f64; 2]>>()
        });
        seen.vertical_lines_px.extend(lines.filter(|line| line.len() >= 3));
    }
    let fit = mounting::find(&camera, &seen).map_err(Failure::job)?;
    let mut words = words(&fit, seen.vertical_lines_px.len());
    if let Some(out) = &arguments.out {
        super::save(out, &with_mounting(&arguments.camera, out, &fit.mounting)?)?;
        words.push(format!("{}: written", out.display()));
    }
    let Mounting { rotation_rpy_rad, position_m, sigma, .. } = &fit.mounting;
    let covariance: Vec<Vec<f64>> = fit.covariance.row_iter().map(|row| row.iter().copied().collect()).collect();
    let numbers = json!({
        "rotation_rpy_deg": rotation_rpy_rad.map(f64::to_degrees),
        "rotation_rpy_deg_sigma": sigma.rotation_rpy_rad.map(f64::to_degrees),
        "position_m": position_m.as_slice(), "position_m_sigma": sigma.position_m.as_slice(),
        "covariance": covariance, "chi2": fit.chi2, "dof": fit.dof, "outliers": fit.outliers,
        "undetermined": fit.undetermined, "vertical_lines": seen.vertical_lines_px.len(), "edges": fit.edges,
    });
    super::print(arguments.format, &words, &numbers)
}

fn read_seen(path: &Path) -> Result<Seen, Failure> {
    let text = std::fs::read_to_string(path)
        .map_err(|e| Failure::usage(format!("{}: cannot be read: {e}", path.display())))?;
    serde_json::from_str(&text).map_err(|e| Failure::usage(format!("{}: {e}", path.display())))
}

fn words(fit: &MountingFit, lines: usize) -> Vec<String> {
    let Mounting { rotation_rpy_rad: [roll, pitch, yaw], position_m, sigma, .. } = &fit.mounting;
    let angle =
        |name: &str, value: f64, sigma: f64| format!("{name} {:.3}° ± {:.3}°", value.to_degrees(), sigma.to_degrees());
    let [s_roll, s_pitch, s_yaw] = sigma.rotation_rpy_rad;
    let mut words = vec![
        [angle("roll", *roll, s_roll), angle("pitch", *pitch, s_pitch), angle("yaw", *yaw, s_yaw)].join(", "),
        format!("height {:.4} m ± {:.4} m", position_m.z, sigma.position_m.z),
        format!(
            "{lines} vertical lines of {} edges; χ² = {:.1} with {} degrees of freedom; {} residuals count less because they lie far off",
            fit.edges, fit.chi2, fit.dof, fit.outliers
        ),
    ];
    if !fit.undetermined.is_empty() {
        words.push(format!("nothing was seen of {}: as it was", fit.undetermined.join(", ")));
    }
    words
}

/// The camera file with another mounting, as it stands in `out`.
fn with_mounting(path: &Path, out: &Path, mounting: &Mounting) -> Result<String, Failure> {
    let mut file = super::read_table(path)?;
    let mut table = toml::Table::new();
    let list = |values: &[f64]| toml::Value::Array(values.iter().map(|x| toml::Value::Float(*x)).collect());
    if mounting.height_is_given {
        table.insert("position_m".into(), list(mounting.position_m.as_slice()));
        table.insert("position_m_sigma".into(), list(mounting.sigma.position_m.as_slice()));
    }
    table.insert("rotation_rpy_deg".into(), list(&mounting.rotation_rpy_rad.map(f64::to_degrees)));
    table.insert("rotation_rpy_deg_sigma".into(), list(&mounting.sigma.rotation_rpy_rad.map(f64::to_degrees)));
    table.insert("mirrored".into(), toml::Value::Boolean(mounting.mirrored));
    file.insert("mounting".into(), table.into());
    super::moved(file, path, out)
}
