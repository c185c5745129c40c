//! Kalibr's `camchain.yaml`, its first camera: `camera_model`, `intrinsics`, `distortion_model`, `distortion_coeffs`,
//! `resolution`.

use std::collections::BTreeMap;
use std::sync::Arc;

use serde::Deserialize;

use super::{Exported, Imported, Tool, in_model, number, numbers, parameter};
use crate::calibration::candidate::Kind;
use crate::optics::{
    Camera, Fisheye, FisheyeLaw, FisheyeParameters, Pinhole, PinholeParameters, UnifiedSphere, UnifiedSphereParameters,
};

#[derive(Deserialize)]
struct CameraEntry {
    camera_model: String,
    intrinsics: Vec<f64>,
    distortion_model: String,
    #[serde(default)]
    distortion_coeffs: Vec<f64>,
    resolution: [u32; 2],
}

pub(super) fn parse(text: &str) -> Result<Imported, String> {
    let chain: BTreeMap<String, CameraEntry> = serde_saphyr::from_str(text).map_err(|e| {
        format!("{e}; wanted is cam0 with camera_model, intrinsics, distortion_model, distortion_coeffs, resolution")
    })?;
    let (name, entry) = chain.iter().next().ok_or("no camera in the chain")?;
    let mut remarks = Vec::new();
    if chain.len() > 1 {
        remarks.push(format!("{name} was taken, the chain's other {} cameras were left out", chain.len() - 1));
    }
    let camera = entry.camera().map_err(|reason| format!("{name}: {reason}"))?;
    Ok(Imported { camera, tool: Tool::Kalibr, remarks })
}

impl CameraEntry {
    fn camera(&self) -> Result<Arc<dyn Camera>, String> {
        let four = |list: &[f64]| -> Result<[f64; 4], String> {
            if self.distortion_model == "none" {
                return Ok([0.0; 4]);
            }
            list.try_into().map_err(|_| format!("distortion_coeffs has {} numbers, must have 4", list.len()))
        };
        let distortion = four(&self.distortion_coeffs)?;
        let intrinsics = |n: usize, what: &str| {
            if self.intrinsics.len() == n {
                return Ok(self.intrinsics.as_slice());
            }
            Err(format!("intrinsics has {} numbers, must have {n}: {what}", self.intrinsics.len()))
        };
        let known = |e: crate::optics::ParameterError| parameter(&e);
        match (self.camera_model.as_str(), self.distortion_model.as_str()) {
            ("omni", "radtan" | "none") => {
                let i = intrinsics(5, "xi, fx, fy, cx, cy")?;
                let parameters = UnifiedSphereParameters {
                    xi: i[0],
                    focal_length_px: [i[1], i[2]],
                    centre_px: [i[3], i[4]],
                    skew: 0.0,
                    distortion,
                };
                Ok(Arc::new(UnifiedSphere::new(parameters, self.resolution).map_err(known)?))
            }
            ("pinhole", "equi") => {
                let i = intrinsics(4, "fx, fy, cx, cy")?;
                let parameters = FisheyeParameters {
                    law: FisheyeLaw::KannalaBrandt,
                    focal_length_px: [i[0], i[1]],
                    centre_px: [i[2], i[3]],
                    k: distortion,
                };
                Ok(Arc::new(Fisheye::new(parameters, self.resolution).map_err(known)?))
            }
            ("pinhole", "radtan" | "none") => {
                let i = intrinsics(4, "fx, fy, cx, cy")?;
                let [k1, k2, p1, p2] = distortion;
                let parameters = PinholeParameters {
                    focal_length_px: [i[0], i[1]],
                    centre_px: [i[2], i[3]],
                    distortion: [k1, k2, p1, p2, 0.0],
                };
                Ok(Arc::new(Pinhole::new(parameters, self.resolution).map_err(known)?))
            }
            (model, distortion) => Err(format!(
                "camera_model {model:?} with distortion_model {distortion:?} is not known; known are omni with radtan or none, \
                 pinhole with equi, radtan or none"
            )),
        }
    }
}

pub(super) fn write(camera: &dyn Camera) -> Result<Exported, String> {
    let [w, h] = camera.image_size_px();
    let entry = |model: &str, intrinsics: &[f64], distortion_model: &str, distortion: &[f64]| {
        format!(
            "cam0:\n  camera_model: {model}\n  intrinsics: {intrinsics:?}\n  distortion_model: {distortion_model}\n  \
             distortion_coeffs: {distortion:?}\n  resolution: [{w}, {h}]\n"
        )
    };
    let [fx, fy]: [f64; 2] = numbers(camera, "focal_length_px");
    let [cx, cy]: [f64; 2] = numbers(camera, "centre_px");
    let exact = |text| Ok(Exported { text, worst_px: 0.0, rms_px: 0.0 });
    let aligned = camera.misalignment().is_none();
    if aligned && camera.model() == "fisheye" {
        let table = camera.table();
        let law = table.get("law").and_then(toml::Value::as_str).unwrap_or("");
        if law == "kannala-brandt" || law == "equidistant" {
            return exact(entry("pinhole", &[fx, fy, cx, cy], "equi", &numbers::<4>(camera, "k")));
        }
    }
    if aligned && camera.model() == "pinhole" {
        let [k1, k2, p1, p2, k3]: [f64; 5] = numbers(camera, "distortion");
        if k3 != 0.0 {
            return Err(format!("Kalibr's radtan has no k3, which is {k3}: calibrate without it"));
        }
        return exact(entry("pinhole", &[fx, fy, cx, cy], "radtan", &[k1, k2, p1, p2]));
    }
    let converted = in_model(camera, Kind::UnifiedSphere, "unified-sphere")?;
    let sphere = converted.camera.as_ref();
    let skew = number(sphere, "skew");
    let [fx, fy]: [f64; 2] = numbers(sphere, "focal_length_px");
    let [cx, cy]: [f64; 2] = numbers(sphere, "centre_px");
    let text = entry("omni", &[number(sphere, "xi"), fx, fy, cx, cy], "radtan", &numbers::<4>(sphere, "distortion"));
    // Kalibr knows no skew: half the picture's height of it is what a pixel may be off.
    let lost_px = 0.5 * f64::from(h) / fy * skew.abs();
    Ok(Exported { text, worst_px: converted.worst_px + lost_px, rms_px: converted.rms_px.hypot(lost_px / 2.0) })
}
