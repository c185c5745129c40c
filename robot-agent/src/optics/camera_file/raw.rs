//! The text of `camera.toml` as serde sees it, and the checks that turn it into cameras.

use std::path::PathBuf;
use std::sync::Arc;

use nalgebra::Vector3;
use protocol::document::{Document, DocumentError};
use serde::Deserialize;

use super::models;
use crate::optics::{Camera, Mounting, MountingSigma, ParameterError, Timing};

/// Pictures larger than this on a side are taken for a mistake.
const MAX_SIDE_PX: u32 = 16_384;

/// Checked content.
pub(super) struct Checked {
    pub(super) camera: Arc<dyn Camera>,
    pub(super) mounting: Mounting,
    pub(super) timing: Timing,
    pub(super) mask_file: Option<PathBuf>,
}

/// Parses and checks.
pub(super) fn parse(document: &Document) -> Result<Checked, DocumentError> {
    models::check_name(document)?;
    let file: models::File = document.parse()?;
    let check = || {
        if file.image_size_px.iter().any(|n| *n == 0 || *n > MAX_SIDE_PX) {
            let expected = format!("[width, height] in pixels, each from 1 to {MAX_SIDE_PX}");
            return Err(Problem::new("image_size_px", file.image_size_px, expected));
        }
        Ok(Checked {
            camera: file.camera()?,
            mounting: file.mounting.checked()?,
            timing: file.timing.checked()?,
            mask_file: file.mask.as_ref().map(|m| m.file.clone()),
        })
    };
    check().map_err(|problem: Problem| document.invalid(&problem.key, problem.value, problem.expected))
}

/// A value that cannot be, before its place in the file is found.
pub(super) struct Problem {
    key: String,
    value: String,
    expected: String,
}

impl Problem {
    pub(super) fn new(key: &str, value: impl std::fmt::Debug, expected: impl std::fmt::Display) -> Self {
        Self { key: key.into(), value: format!("{value:?}"), expected: format!("must be {expected}") }
    }

    pub(super) fn parameter(table: &str, error: ParameterError) -> Self {
        let ParameterError { key, value, expected } = error;
        Self { key: format!("{table}.{key}"), value, expected: format!("must be {expected}") }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MaskTable {
    pub(super) file: PathBuf,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields)]
pub(super) struct TimingTable {
    #[serde(default)]
    exposure_ms: f64,
    #[serde(default)]
    readout_ms: f64,
    #[serde(default)]
    latency_ms: f64,
}

impl TimingTable {
    fn checked(&self) -> Result<Timing, Problem> {
        let seconds = |key: &str, ms: f64| {
            if (0.0..=10_000.0).contains(&ms) {
                return Ok(ms * 1e-3);
            }
            Err(Problem::new(&format!("timing.{key}"), ms, "milliseconds from 0 to 10000"))
        };
        Ok(Timing {
            exposure_s: seconds("exposure_ms", self.exposure_ms)?,
            readout_s: seconds("readout_ms", self.readout_ms)?,
            latency_s: seconds("latency_ms", self.latency_ms)?,
        })
    }
}

/// One sigma for all components, or one each.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(untagged, expecting = "one number, or one number for each component")]
enum Sigma<const N: usize>
where
    [f64; N]: for<'a> Deserialize<'a>,
{
    All(f64),
    #[serde(bound = "")]
    Each([f64; N]),
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields)]
pub(super) struct MountingTable {
    height_m: Option<f64>,
    height_m_sigma: Option<f64>,
    position_m: Option<[f64; 3]>,
    position_m_sigma: Option<Sigma<3>>,
    azimuth_offset_deg: Option<f64>,
    azimuth_offset_deg_sigma: Option<f64>,
    tilt_deg: Option<[f64; 2]>,
    tilt_deg_sigma: Option<Sigma<2>>,
    rotation_rpy_deg: Option<[f64; 3]>,
    rotation_rpy_deg_sigma: Option<Sigma<3>>,
    #[serde(default)]
    mirrored: bool,
}

impl MountingTable {
    fn checked(&self) -> Result<Mounting, Problem> {
        self.check_alternatives()?;
        let mut mounting = Mounting { mirrored: self.mirrored, ..Mounting::default() };
        if let Some(height) = self.height_m {
            mounting.position_m = position("mounting.height_m", [0.0, 0.0, height])?;
            mounting.height_is_given = true;
        }
        if let Some(p) = self.position_m {
            mounting.position_m = position("mounting.position_m", p)?;
            mounting.height_is_given = true;
        }
        if let Some(yaw) = self.azimuth_offset_deg {
            mounting.rotation_rpy_rad[2] = angle("mounting.azimuth_offset_deg", yaw, 360.0)?;
        }
        if let Some([roll, pitch]) = self.tilt_deg {
            mounting.rotation_rpy_rad[0] = angle("mounting.tilt_deg", roll, 90.0)?;
            mounting.rotation_rpy_rad[1] = angle("mounting.tilt_deg", pitch, 90.0)?;
        }
        if let Some(rpy) = self.rotation_rpy_deg {
            for (radians, degrees) in mounting.rotation_rpy_rad.iter_mut().zip(rpy) {
                *radians = angle("mounting.rotation_rpy_deg", degrees, 360.0)?;
            }
        }
        mounting.sigma = self.sigma()?;
        Ok(mounting)
    }

    fn sigma(&self) -> Result<MountingSigma, Problem> {
        let mut sigma = MountingSigma::default();
        if let Some(s) = self.height_m_sigma {
            sigma.position_m.z = deviation("mounting.height_m_sigma", s)?;
        }
        if let Some(s) = self.position_m_sigma {
            sigma.position_m = Vector3::from(each("mounting.position_m_sigma", s)?);
        }
        if let Some(s) = self.tilt_deg_sigma {
            let [roll, pitch] = each("mounting.tilt_deg_sigma", s)?.map(f64::to_radians);
            sigma.rotation_rpy_rad[..2].copy_from_slice(&[roll, pitch]);
        }
        if let Some(s) = self.azimuth_offset_deg_sigma {
            sigma.rotation_rpy_rad[2] = deviation("mounting.azimuth_offset_deg_sigma", s)?.to_radians();
        }
        if let Some(s) = self.rotation_rpy_deg_sigma {
            sigma.rotation_rpy_rad = each("mounting.rotation_rpy_deg_sigma", s)?.map(f64::to_radians);
        }
        Ok(sigma)
    }

    /// Two ways to say one thing must not both be there.
    fn check_alternatives(&self) -> Result<(), Problem> {
        let height = self.height_m.is_some() || self.height_m_sigma.is_some();
        let full_position = self.position_m.is_some() || self.position_m_sigma.is_some();
        let tilt = self.tilt_deg.is_some() || self.tilt_deg_sigma.is_some();
        let yaw = self.azimuth_offset_deg.is_some() || self.azimuth_offset_deg_sigma.is_some();
        let full_rotation = self.rotation_rpy_deg.is_some() || self.rotation_rpy_deg_sigma.is_some();
        let clash = |a: &str, b: &str| {
            let key = format!("mounting.{b}");
            Err(Problem { key, value: "given".into(), expected: format!("but so is {a}: give one of them") })
        };
        if height && full_position {
            return clash("height_m", "position_m");
        }
        if full_rotation && tilt {
            return clash("tilt_deg", "rotation_rpy_deg");
        }
        if full_rotation && yaw {
            return clash("azimuth_offset_deg", "rotation_rpy_deg");
        }
        Ok(())
    }
}

fn position(key: &str, p: [f64; 3]) -> Result<Vector3<f64>, Problem> {
    if p.iter().all(|x| x.abs() <= 100.0) {
        return Ok(Vector3::from(p));
    }
    Err(Problem::new(key, p, "in metres, at most 100 (is it in millimetres?)"))
}

fn angle(key: &str, degrees: f64, limit: f64) -> Result<f64, Problem> {
    if degrees.abs() <= limit {
        return Ok(degrees.to_radians());
    }
    Err(Problem::new(key, degrees, format!("in degrees between -{limit} and {limit}")))
}

fn deviation(key: &str, sigma: f64) -> Result<f64, Problem> {
    if (0.0..1e3).contains(&sigma) {
        return Ok(sigma);
    }
    Err(Problem::new(key, sigma, "a standard deviation, 0 or more"))
}

fn each<const N: usize>(key: &str, sigma: Sigma<N>) -> Result<[f64; N], Problem>
where
    [f64; N]: for<'a> Deserialize<'a>,
{
    let all = match sigma {
        Sigma::All(s) => [s; N],
        Sigma::Each(s) => s,
    };
    all.iter().try_for_each(|s| deviation(key, *s).map(drop)).map(|()| all)
}
