//! `robot-agent calibrate centre`.

use std::path::{Path, PathBuf};

use nalgebra::Vector2;
use robot_agent::calibration::{centre, lines, rim, tilt};
use robot_agent::capture::read_gray;
use robot_agent::optics::MountedCamera;
use serde_json::json;

use super::super::{Failure, Format};

/// The picture's centre from the images of vertical lines and, whatever the tilt, from the rim circles.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Pictures of one camera (PNG, JPEG, BMP, PGM), with long vertical edges all round.
    #[arg(required = true)]
    pictures: Vec<PathBuf>,
    /// A camera file: the tilt that the two centres' difference implies is then given, too.
    #[arg(long, value_name = "FILE")]
    camera: Option<PathBuf>,
    /// Where to write the camera file with the centre that was found: the rims', or the lines' where no rim is seen.
    #[arg(long, value_name = "FILE", requires = "camera")]
    out: Option<PathBuf>,
    /// Where to write a page and the numbers as JSON.
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    /// Rim circles to look for in each picture.
    #[arg(long, value_name = "N", default_value_t = 2)]
    rims: usize,
    /// How to print the result.
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

/// Runs the command.
pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let camera = arguments.camera.as_deref().map(MountedCamera::load).transpose().map_err(Failure::usage)?;
    let mut size: Option<(&PathBuf, [u32; 2])> = None;
    let (mut all_lines, mut rims) = (Vec::new(), Vec::new());
    for path in &arguments.pictures {
        let picture = read_gray(path, camera.as_ref().map(MountedCamera::image_size_px)).map_err(Failure::job)?;
        let found = [picture.width, picture.height];
        if let Some((first, [w, h])) = size.filter(|(_, size)| *size != found) {
            let (path, first) = (path.display(), first.display());
            return Err(Failure::job(format!(
                "{path}: {}x{} pixels, but {first} has {w}x{h}; all must be of one camera",
                found[0], found[1]
            )));
        }
        size = Some((path, found));
        rims.extend(rim::find(&picture, arguments.rims));
        let middle = Vector2::new(f64::from(picture.width), f64::from(picture.height)) * 0.5;
        let middle = rims.first().map_or(middle, |r| r.centre_px);
        all_lines.extend(lines::radial_lines(&picture, middle));
    }
    let by_lines = centre::of_lines(&all_lines);
    let by_rims = rim::common_centre(&rims);
    let mut words = Vec::new();
    match &by_lines {
        Ok(c) => words.push(format!(
            "vertical lines: centre [{:.2}, {:.2}] ± [{:.2}, {:.2}] px from {} of {} lines, which scatter {:.1} times what \
             their points' noise of {:.2} px explains",
            c.centre_px.x,
            c.centre_px.y,
            c.covariance_px2[(0, 0)].sqrt(),
            c.covariance_px2[(1, 1)].sqrt(),
            c.weights.iter().filter(|w| **w > 0.0).count(),
            c.weights.len(),
            c.line_scatter,
            c.sigma_px
        )),
        Err(reason) => words.push(format!("vertical lines: {reason}")),
    }
    for r in &rims {
        words.push(format!(
            "rim: centre [{:.2}, {:.2}] ± [{:.2}, {:.2}] px, radius {:.2} px, seen in {:.0} % of the directions",
            r.centre_px.x,
            r.centre_px.y,
            r.covariance_px2[(0, 0)].sqrt(),
            r.covariance_px2[(1, 1)].sqrt(),
            r.radius_px,
            100.0 * r.coverage
        ));
    }
    if by_lines.is_err() && by_rims.is_none() {
        return Err(Failure::job(format!("{}, and no rim circle is in the pictures", words.join("; "))));
    }
    let mut implied = None;
    if let (Ok(lines), Some(rims)) = (&by_lines, &by_rims) {
        let offset = lines.centre_px - rims.centre_px;
        words.push(format!("the lines' centre is [{:.2}, {:.2}] px from the rims'", offset.x, offset.y));
        if let Some(camera) = &camera {
            let covariance = lines.covariance_px2 + rims.covariance_px2;
            implied = tilt::from_centres(camera.camera(), &offset, &covariance);
            words.push(match &implied {
                Some(t) => format!(
                    "implied tilt {:.3}° ± {:.3}° towards {:.1}° (with this camera a degree moves the lines' centre by {:.2} px)",
                    t.angle_rad.to_degrees(),
                    t.sigma_rad.to_degrees(),
                    t.towards_rad.to_degrees(),
                    t.px_per_rad.to_radians()
                ),
                None => "this camera sees too little of vertical lines to tell a tilt".into(),
            });
        }
    }
    let circle =
        |r: &rim::Rim| json!({ "centre_px": r.centre_px.as_slice(), "radius_px": r.radius_px, "coverage": r.coverage });
    let numbers = json!({
        "lines": by_lines.as_ref().ok().map(|c| json!({
            "centre_px": c.centre_px.as_slice(),
            "covariance_px2": [[c.covariance_px2[(0, 0)], c.covariance_px2[(0, 1)]], [c.covariance_px2[(1, 0)], c.covariance_px2[(1, 1)]]],
            "sigma_px": c.sigma_px, "line_scatter": c.line_scatter, "weights": c.weights,
        })),
        "rims": rims.iter().map(circle).collect::<Vec<_>>(),
        "rim_centre_px": by_rims.as_ref().map(|r| r.centre_px.as_slice().to_vec()),
        "tilt": implied.map(|t| json!({
            "angle_deg": t.angle_rad.to_degrees(), "sigma_deg": t.sigma_rad.to_degrees(),
            "towards_deg": t.towards_rad.to_degrees(), "px_per_deg": t.px_per_rad.to_radians(),
        })),
    });
    let found = by_rims.as_ref().map(|r| r.centre_px).or(by_lines.as_ref().ok().map(|c| c.centre_px));
    if let (Some(out), Some(path), Some(centre)) = (&arguments.out, &arguments.camera, found) {
        super::save(out, &with_centre(path, out, centre)?)?;
        words.push(format!("{}: written", out.display()));
    }
    super::tell(arguments.format, arguments.report.as_deref(), "centre", &words, &numbers)
}

/// The camera file with another centre, as it stands in `out`.
fn with_centre(path: &Path, out: &Path, centre_px: Vector2<f64>) -> Result<String, Failure> {
    let mut file = super::read_table(path)?;
    let model = file.get("model").and_then(toml::Value::as_str).unwrap_or_default().to_owned();
    let table =
        file.get_mut(&model).and_then(toml::Value::as_table_mut).filter(|table| table.contains_key("centre_px"));
    let Some(table) = table else {
        return Err(Failure::usage(format!("{}: a {model} camera has no `centre_px` to write", path.display())));
    };
    let numbers = centre_px.iter().map(|x| toml::Value::Float(*x)).collect();
    table.insert("centre_px".into(), toml::Value::Array(numbers));
    super::moved(file, path, out)
}
