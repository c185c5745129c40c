//! `robot-agent unwarp`.

use std::io::{self, Write};
use std::path::PathBuf;

use clap::ValueEnum;
use image::ImageFormat;
use robot_agent::capture;
use robot_agent::optics::MountedCamera;
use robot_agent::panorama::{GazeWindow, Lut, PanoramaGeometry, Projection, RadialPanorama};
use serde_json::json;

use super::{Failure, Format};

/// Unwarps one picture: to a panorama, or to what a virtual camera looking somewhere would see.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// The camera's picture (PNG, JPEG, BMP, PGM).
    image: PathBuf,
    /// The camera file (camera.toml).
    #[arg(long, value_name = "FILE")]
    camera: PathBuf,
    /// Where to write the result; the ending chooses the format: .png, .jpg, .bmp or .pgm.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// What to make. The default is what the camera's panorama would be: a cylinder, or a sphere where the camera sees
    /// beyond 60°.
    #[arg(long, value_enum)]
    projection: Option<Kind>,
    /// Columns; the camera's default panorama, or 640 for perspective.
    #[arg(long, value_name = "PX")]
    width: Option<u32>,
    /// Rows; the camera's default panorama, or 480 for perspective.
    #[arg(long, value_name = "PX")]
    height: Option<u32>,
    /// Lowest and highest elevation of a panorama, degrees; all that the camera sees.
    #[arg(long, value_names = ["LOW", "HIGH"], num_args = 2, allow_negative_numbers = true)]
    elevation_deg: Option<Vec<f64>>,
    /// Bearing that a perspective view looks in, degrees, counter-clockwise from straight ahead. [default: 0]
    #[arg(long, value_name = "DEG", allow_negative_numbers = true)]
    pan_deg: Option<f64>,
    /// Elevation that a perspective view looks in, degrees. [default: 0]
    #[arg(long, value_name = "DEG", allow_negative_numbers = true)]
    tilt_deg: Option<f64>,
    /// Horizontal field of view of a perspective view, degrees, 0.1 to 170. [default: 60]
    #[arg(long, value_name = "DEG")]
    hfov_deg: Option<f64>,
    /// How to print what was done.
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Kind {
    /// All bearings; rows equally spaced in the tangent of the elevation.
    Cylinder,
    /// All bearings; rows equally spaced in elevation.
    Sphere,
    /// The ring by its image radius, rows rectified by a polynomial (the report's 4-1 with 4-2).
    Rectified,
    /// A virtual camera: straight lines stay straight.
    Perspective,
}

/// Runs the command.
pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let format = arguments.picture_format()?;
    let camera = MountedCamera::load(&arguments.camera).map_err(Failure::usage)?;
    let lut = arguments.table(&camera)?;
    let source = capture::read_gray(&arguments.image, Some(camera.image_size_px())).map_err(Failure::job)?;
    let [width, height] = lut.size_px();
    let mut out = image::GrayImage::new(width, height);
    lut.unwarp(&source.gray, &mut out).map_err(Failure::job)?;
    let path = arguments.out.display();
    let cannot_write = |e: &dyn std::fmt::Display| Failure::job(format!("{path}: cannot write the picture: {e}"));
    // Encoded before the file is touched: what cannot be encoded must not cost a picture that was there.
    let mut encoded = io::Cursor::new(Vec::new());
    out.write_to(&mut encoded, format).map_err(|e| cannot_write(&e))?;
    std::fs::write(&arguments.out, encoded.into_inner()).map_err(|e| cannot_write(&e))?;
    let valid = lut.valid().iter().filter(|valid| **valid).count();
    let share = valid as f64 / lut.valid().len() as f64;
    if valid == 0 {
        tracing::warn!("{path}: the camera sees nothing there; `camera describe` says which elevations it sees");
    }
    let mut output = io::stdout().lock();
    match arguments.format {
        Format::Text => writeln!(output, "{path}: {width}x{height}, {:.1} % seen by the camera", 100.0 * share)?,
        Format::Json => {
            let report =
                json!({ "out": path.to_string(), "width_px": width, "height_px": height, "valid_share": share });
            writeln!(output, "{report}")?;
        }
    }
    Ok(())
}

impl Arguments {
    /// By the ending of the file.
    fn picture_format(&self) -> Result<ImageFormat, Failure> {
        let ending = self.out.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
        match ending.as_str() {
            "png" => Ok(ImageFormat::Png),
            "jpg" | "jpeg" => Ok(ImageFormat::Jpeg),
            "bmp" => Ok(ImageFormat::Bmp),
            "pgm" | "pnm" => Ok(ImageFormat::Pnm),
            _ => {
                let path = self.out.display();
                Err(Failure::usage(format!("--out {path}: the ending must be .png, .jpg, .bmp or .pgm")))
            }
        }
    }

    fn table(&self, camera: &MountedCamera) -> Result<Lut, Failure> {
        if self.projection == Some(Kind::Perspective) {
            if self.elevation_deg.is_some() {
                return Err(Failure::usage(
                    "--elevation-deg: a perspective view looks where --tilt-deg says; leave it out",
                ));
            }
            return Ok(Lut::gaze(camera, &self.window()?));
        }
        let of_views = [("--pan-deg", self.pan_deg), ("--tilt-deg", self.tilt_deg), ("--hfov-deg", self.hfov_deg)];
        if let Some((name, _)) = of_views.iter().find(|(_, given)| given.is_some()) {
            return Err(Failure::usage(format!(
                "{name}: only a perspective view has one; give --projection perspective, or leave it out"
            )));
        }
        let default = PanoramaGeometry::for_camera(camera).map_err(Failure::usage)?;
        let projection = match self.projection {
            Some(Kind::Cylinder) => Projection::Cylinder,
            Some(Kind::Sphere) => Projection::Sphere,
            _ => default.projection(),
        };
        let elevation_rad = match self.elevation_deg.as_deref() {
            Some([low, high]) => [low.to_radians(), high.to_radians()],
            _ => default.elevation_rad(),
        };
        let width = self.width.unwrap_or(default.width());
        let height = self.height.unwrap_or(default.height());
        if self.projection == Some(Kind::Rectified) {
            if self.elevation_deg.is_some() {
                return Err(Failure::usage("--elevation-deg: a rectified panorama shows the whole ring; leave it out"));
            }
            let panorama = RadialPanorama::for_camera(camera, [width, height]).map_err(Failure::usage)?;
            return Ok(Lut::radial(camera, &panorama));
        }
        let geometry = PanoramaGeometry::new(width, height, projection, elevation_rad).map_err(Failure::usage)?;
        Ok(Lut::panorama(camera, &geometry))
    }

    fn window(&self) -> Result<GazeWindow, Failure> {
        let (width, height) = (self.width.unwrap_or(640), self.height.unwrap_or(480));
        let max = PanoramaGeometry::MAX_SIDE_PX;
        if !(1..=max).contains(&width) || !(1..=max).contains(&height) {
            return Err(Failure::usage(format!("{width}x{height} pixels: each side must be from 1 to {max}")));
        }
        let (pan, tilt) = (self.pan_deg.unwrap_or(0.0), self.tilt_deg.unwrap_or(0.0));
        let hfov = self.hfov_deg.unwrap_or(60.0);
        if !(0.1..=170.0).contains(&hfov) {
            return Err(Failure::usage(format!("--hfov-deg {hfov}: must be from 0.1 to 170")));
        }
        if !((-90.0..=90.0).contains(&tilt) && pan.is_finite()) {
            return Err(Failure::usage(format!("--pan-deg {pan} --tilt-deg {tilt}: tilt must be from -90 to 90")));
        }
        Ok(GazeWindow {
            width,
            height,
            hfov_rad: hfov.to_radians(),
            pan_rad: pan.to_radians(),
            tilt_rad: tilt.to_radians(),
        })
    }
}
