//! OpenCV's omnidirectional calibration as its sample writes it: `camera_matrix` (or `K`), `distortion_coefficients` (or
//! `D`), `xi`, `image_width` and `image_height`.

use std::sync::Arc;

use serde::Deserialize;

use super::{Exported, Imported, Tool, in_model, number, numbers, parameter};
use crate::calibration::candidate::Kind;
use crate::optics::{Camera, UnifiedSphere, UnifiedSphereParameters};

#[derive(Deserialize)]
struct File {
    #[serde(alias = "K")]
    camera_matrix: Matrix,
    #[serde(alias = "D")]
    distortion_coefficients: Matrix,
    xi: Number,
    image_width: u32,
    image_height: u32,
}

#[derive(Deserialize)]
struct Matrix {
    data: Vec<f64>,
}

#[derive(Deserialize)]
#[serde(untagged)]
enum Number {
    Plain(f64),
    Matrix(Matrix),
}

pub(super) fn parse(text: &str) -> Result<Imported, String> {
    // OpenCV's header is no YAML directive (`%YAML:1.0`), and its matrices carry a tag of its own.
    let body: Vec<&str> = text.lines().filter(|line| !line.starts_with("%YAML")).collect();
    let body = body.join("\n").replace("!!opencv-matrix", "");
    let file: File = serde_saphyr::from_str(&body).map_err(|e| {
        format!("{e}; wanted are camera_matrix, distortion_coefficients, xi, image_width, image_height")
    })?;
    let &[fx, skew, cx, _, fy, cy, ..] = file.camera_matrix.data.as_slice() else {
        return Err(format!("camera_matrix has {} numbers, must have 9", file.camera_matrix.data.len()));
    };
    let &[k1, k2, p1, p2] = file.distortion_coefficients.data.as_slice() else {
        let n = file.distortion_coefficients.data.len();
        return Err(format!("distortion_coefficients has {n} numbers, must have 4: k1, k2, p1, p2"));
    };
    let xi = match &file.xi {
        Number::Plain(xi) => *xi,
        Number::Matrix(m) => *m.data.first().ok_or("xi is an empty matrix, must be one number")?,
    };
    let parameters = UnifiedSphereParameters {
        xi,
        focal_length_px: [fx, fy],
        centre_px: [cx, cy],
        skew,
        distortion: [k1, k2, p1, p2],
    };
    let camera = UnifiedSphere::new(parameters, [file.image_width, file.image_height]).map_err(|e| parameter(&e))?;
    Ok(Imported { camera: Arc::new(camera), tool: Tool::OpenCv, remarks: Vec::new() })
}

pub(super) fn write(camera: &dyn Camera) -> Result<Exported, String> {
    let converted = in_model(camera, Kind::UnifiedSphere, "unified-sphere")?;
    let sphere = converted.camera.as_ref();
    let [w, h] = sphere.image_size_px();
    let [fx, fy]: [f64; 2] = numbers(sphere, "focal_length_px");
    let [cx, cy]: [f64; 2] = numbers(sphere, "centre_px");
    let [k1, k2, p1, p2]: [f64; 4] = numbers(sphere, "distortion");
    let (xi, skew) = (number(sphere, "xi"), number(sphere, "skew"));
    let text = format!(
        "%YAML:1.0\n---\nimage_width: {w}\nimage_height: {h}\n\
         camera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   \
         data: [ {fx:?}, {skew:?}, {cx:?}, 0., {fy:?}, {cy:?}, 0., 0., 1. ]\n\
         distortion_coefficients: !!opencv-matrix\n   rows: 1\n   cols: 4\n   dt: d\n   \
         data: [ {k1:?}, {k2:?}, {p1:?}, {p2:?} ]\nxi: {xi:?}\n"
    );
    Ok(Exported { text, worst_px: converted.worst_px, rms_px: converted.rms_px })
}
