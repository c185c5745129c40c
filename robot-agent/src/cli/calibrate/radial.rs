//! `robot-agent calibrate radial`.

use std::path::PathBuf;

use nalgebra::Vector2;
use robot_agent::calibration::bars::{self, BarsError};
use robot_agent::calibration::radial;
use robot_agent::capture::read_gray;
use serde_json::json;

use super::super::{Failure, Format};

/// The radial polynomial from the edges of bars of equal width along a meridian.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Radii of the edges, px, in the order of the bars, with commas between them.
    #[arg(long, value_name = "R0,R1,…", value_delimiter = ',', required_unless_present = "picture")]
    edges_px: Vec<f64>,
    /// A picture of the bars instead, in which their edges are found.
    #[arg(long, value_name = "FILE", conflicts_with = "edges_px", requires = "centre_px", requires = "radii_px")]
    picture: Option<PathBuf>,
    /// The picture's centre.
    #[arg(long, value_name = "U,V", value_parser = super::pair)]
    centre_px: Option<[f64; 2]>,
    /// Direction of the meridian in the picture, degrees from u towards v.
    #[arg(long, value_name = "DEG", default_value_t = 0.0, allow_negative_numbers = true)]
    angle_deg: f64,
    /// Radii between which the bars lie, px.
    #[arg(long, value_name = "FROM,TO", value_parser = super::pair)]
    radii_px: Option<[f64; 2]>,
    /// Order of the polynomial.
    #[arg(long, value_name = "N", default_value_t = radial::DEFAULT_ORDER)]
    order: usize,
    /// Where to write a page and the numbers as JSON.
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    /// How to print the result.
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

/// Runs the command.
pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    if !arguments.angle_deg.is_finite() {
        return Err(Failure::usage(format!("--angle-deg {}: must be a number of degrees", arguments.angle_deg)));
    }
    let edges_px = match (&arguments.picture, arguments.centre_px, arguments.radii_px) {
        (Some(path), Some(centre), Some(radii)) => {
            let picture = read_gray(path, None).map_err(Failure::job)?;
            bars::edges(&picture, Vector2::from(centre), arguments.angle_deg.to_radians(), radii).map_err(|error| {
                match error {
                    BarsError::Radii { .. } => Failure::usage(format!("--radii-px: {error}")),
                    BarsError::TooFew { .. } => Failure::job(format!("{}: {error}", path.display())),
                }
            })?
        }
        _ => arguments.edges_px.clone(),
    };
    let polynomial = radial::from_equal_bars(&edges_px, arguments.order).map_err(Failure::usage)?;
    let monomials = polynomial.monomials();
    let [low, high] = polynomial.domain_px;
    let terms: Vec<String> = monomials.iter().enumerate().map(|(n, v)| format!("v{n} = {v:.9e}")).collect();
    let words = [
        format!("{} edges", edges_px.len()),
        format!("R(r) = Σ vₙ rⁿ from {low:.2} to {high:.2} px: {}", terms.join(", ")),
        format!(
            "edges against equal bars: rms {:.3} px, at most {:.3} px, {} degrees of freedom",
            polynomial.rms_px, polynomial.worst_px, polynomial.dof
        ),
    ];
    let numbers = json!({
        "edges_px": edges_px, "monomials": monomials, "domain_px": polynomial.domain_px, "rms_px": polynomial.rms_px,
        "worst_px": polynomial.worst_px, "dof": polynomial.dof,
    });
    super::tell(arguments.format, arguments.report.as_deref(), "radial polynomial", &words, &numbers)
}
