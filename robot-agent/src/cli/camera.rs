//! `robot-agent camera project|unproject|describe`.

use std::io::{self, BufRead, Write};
use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum};
use nalgebra::{Vector2, Vector3};
use robot_agent::optics::{MountedCamera, Ray, fixed_viewpoint};
use robot_agent::panorama::PanoramaGeometry;
use serde_json::{Value, json};

use super::{Failure, Format};

/// Asks a camera file where points appear and what pixels see.
#[derive(Debug, Args)]
pub(super) struct Arguments {
    #[command(subcommand)]
    question: Question,
}

#[derive(Debug, Subcommand)]
enum Question {
    /// Points on standard input, a line `[x_m, y_m, z_m]` each; pixels `[u_px, v_px]` or `null` on standard output.
    Project(Points),
    /// Pixels on standard input, a line `[u_px, v_px]` each; rays `{"origin_m":[x,y,z],"direction":[x,y,z]}` or `null`
    /// on standard output.
    Unproject(Points),
    /// What the camera is: model, field of view, mounting, resolution, viewpoint locus, what a fixed viewpoint costs at
    /// 0.25 to 10 m, default panorama.
    Describe {
        /// The camera file (camera.toml).
        #[arg(long, value_name = "FILE")]
        camera: PathBuf,
        /// How to print it.
        #[arg(long, value_enum, default_value_t)]
        format: Format,
    },
}

#[derive(Debug, Args)]
struct Points {
    /// The camera file (camera.toml).
    #[arg(long, value_name = "FILE")]
    camera: PathBuf,
    /// The frame that points and rays are in.
    #[arg(long, value_enum, default_value_t)]
    frame: Frame,
}

#[derive(Debug, Clone, Copy, Default, ValueEnum)]
enum Frame {
    /// Origin at the model's origin, axes parallel to the body's: the mounting's rotation counts, its position not.
    #[default]
    Camera,
    /// Origin on the robot's axis at the floor: rotation and position of the mounting count.
    Body,
    /// The model alone, without its mounting.
    Model,
}

/// Runs the command.
pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    match &arguments.question {
        Question::Project(points) => each_line(points, "[x_m, y_m, z_m]", project),
        Question::Unproject(points) => each_line(points, "[u_px, v_px]", unproject),
        Question::Describe { camera, format } => {
            describe(&MountedCamera::load(camera).map_err(Failure::usage)?, *format)
        }
    }
}

fn project(camera: &MountedCamera, frame: Frame, point: [f64; 3]) -> Value {
    let point = Vector3::from(point);
    let pixel = match frame {
        Frame::Camera => camera.project_parallel(&point),
        Frame::Body => camera.project_body(&point),
        Frame::Model => camera.camera().project(&point),
    };
    pixel.map_or(Value::Null, |p| json!([p.x, p.y]))
}

fn unproject(camera: &MountedCamera, frame: Frame, pixel: [f64; 2]) -> Value {
    let pixel = Vector2::from(pixel);
    let ray = match frame {
        Frame::Camera => camera.unproject_parallel(&pixel),
        Frame::Body => camera.unproject_body(&pixel),
        Frame::Model => camera.camera().unproject(&pixel),
    };
    ray.map_or(
        Value::Null,
        |Ray { origin_m: o, direction: d }| json!({ "origin_m": [o.x, o.y, o.z], "direction": [d.x, d.y, d.z] }),
    )
}

/// Answers every line of standard input; blank lines are skipped.
fn each_line<const N: usize>(
    points: &Points,
    expected: &str,
    answer: impl Fn(&MountedCamera, Frame, [f64; N]) -> Value,
) -> Result<(), Failure>
where
    [f64; N]: for<'a> serde::Deserialize<'a>,
{
    let camera = MountedCamera::load(&points.camera).map_err(Failure::usage)?;
    let mut output = io::stdout().lock();
    for (number, line) in io::stdin().lock().lines().enumerate() {
        let line = line.map_err(|e| Failure::job(format!("standard input, line {}: {e}", number + 1)))?;
        if line.trim().is_empty() {
            continue;
        }
        let input = serde_json::from_str(&line).map_err(|e| {
            Failure::job(format!("standard input, line {}: {:?} must be {expected}: {e}", number + 1, line.trim()))
        })?;
        writeln!(output, "{}", answer(&camera, points.frame, input))?;
    }
    Ok(())
}

fn describe(camera: &MountedCamera, format: Format) -> Result<(), Failure> {
    let facts = facts(camera);
    let mut output = io::stdout().lock();
    if format == Format::Json {
        return Ok(writeln!(output, "{facts}")?);
    }
    writeln!(output, "{}", camera.summary())?;
    for (group, value) in facts.as_object().into_iter().flatten() {
        match value {
            Value::Object(entries) => {
                writeln!(output, "{group}:")?;
                for (key, value) in entries {
                    writeln!(output, "  {key}: {value}")?;
                }
            }
            Value::Array(rows) if rows.iter().all(Value::is_object) => {
                writeln!(output, "{group}:")?;
                for row in rows {
                    let cells: Vec<String> =
                        row.as_object().into_iter().flatten().map(|(k, v)| format!("{k} {v}")).collect();
                    writeln!(output, "  {}", cells.join(", "))?;
                }
            }
            value => writeln!(output, "{group}: {value}")?,
        }
    }
    Ok(())
}

fn facts(camera: &MountedCamera) -> Value {
    let model = camera.camera();
    let [low, high] = model.elevation_rad();
    let mounting = camera.mounting();
    let panorama = PanoramaGeometry::for_camera(camera).ok().map(|p| {
        json!({ "width_px": p.width(), "height_px": p.height(), "projection": format!("{:?}", p.projection()).to_lowercase() })
    });
    const ROWS: u32 = 8;
    let scales: Vec<Value> = (0..ROWS)
        .filter_map(|i| {
            let elevation = low + (high - low) * f64::from(i) / f64::from(ROWS - 1);
            let at = camera.resolution(0.0, elevation)?;
            let per_deg = |px_per_rad: f64| rounded(px_per_rad.to_radians());
            Some(json!({
                "elevation_deg": rounded(elevation.to_degrees()),
                "bearing_px_per_deg": per_deg(at.bearing_px_per_rad),
                "elevation_px_per_deg": per_deg(at.elevation_px_per_rad),
            }))
        })
        .collect();
    let viewpoint = camera.viewpoint_body_m();
    const LOCUS_POINTS: u32 = 8;
    let locus: Vec<Value> = fixed_viewpoint::locus(model, LOCUS_POINTS)
        .into_iter()
        .map(|p| {
            json!({
                "elevation_deg": rounded(p.elevation_rad.to_degrees()),
                "axis_z_mm": rounded(p.axis_z_m * 1e3),
                "caustic_r_mm": rounded(p.caustic_m[0] * 1e3),
                "caustic_z_mm": rounded(p.caustic_m[1] * 1e3),
            })
        })
        .collect();
    let costs: Vec<Value> = [0.25, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0]
        .into_iter()
        .map(|distance_m| {
            let cost = fixed_viewpoint::cost(model, distance_m);
            json!({
                "distance_m": distance_m,
                "bearing_deg": rounded(cost.bearing_rad.to_degrees()),
                "elevation_deg": rounded(cost.elevation_rad.to_degrees()),
            })
        })
        .collect();
    json!({
        "model": model.model(),
        "image_size_px": model.image_size_px(),
        "panoramic": model.is_panoramic(),
        "elevation_deg": [rounded(low.to_degrees()), rounded(high.to_degrees())],
        "viewpoint_body_m": [rounded(viewpoint.x), rounded(viewpoint.y), rounded(viewpoint.z)],
        "viewpoint_miss_mm": rounded(model.viewpoint_miss_m() * 1e3),
        "viewpoint_locus": locus,
        "fixed_viewpoint_cost": costs,
        "misalignment": model.misalignment(),
        "mounting": {
            "position_m": mounting.position_m.as_slice(),
            "position_sigma_m": mounting.sigma.position_m.as_slice(),
            "height_is_given": mounting.height_is_given,
            "rotation_rpy_deg": mounting.rotation_rpy_rad.map(f64::to_degrees).map(rounded),
            "rotation_rpy_sigma_deg": mounting.sigma.rotation_rpy_rad.map(f64::to_degrees).map(rounded),
            "mirrored": mounting.mirrored,
        },
        "masked_pixels": camera.mask().map_or(0, |m| m.tested.iter().filter(|tested| !**tested).count()),
        "timing_ms": {
            "exposure": camera.timing().exposure_s * 1e3,
            "readout": camera.timing().readout_s * 1e3,
            "latency": camera.timing().latency_s * 1e3,
        },
        "resolution_ahead": scales,
        "default_panorama": panorama,
    })
}

/// To a millionth, for people.
fn rounded(value: f64) -> f64 {
    (value * 1e6).round() / 1e6
}
