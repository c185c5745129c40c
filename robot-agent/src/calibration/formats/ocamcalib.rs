//! OCamCalib's `calib_results.txt`: the polynomial `ss`, its inverse, the centre (row, column), affine c d e, height and
//! width, each on a line of its own, with comments and blank lines between.

use std::fmt::Write;
use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use super::{Exported, Imported, Tool, in_model, numbers, parameter};
use crate::calibration::candidate::Kind;
use crate::optics::{Camera, Polynomial, PolynomialParameters};

/// Degrees of the inverse that are tried.
const INVERSE_DEGREES: std::ops::RangeInclusive<usize> = 5..=14;
/// An inverse this near to the polynomial is good enough, px.
const GOOD_INVERSE_PX: f64 = 0.005;

pub(super) fn parse(text: &str) -> Result<Imported, String> {
    let mut rows = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let row: Result<Vec<f64>, String> = line
            .split_ascii_whitespace()
            .map(|word| word.parse().map_err(|_| format!("line {}: {word:?} is no number", index + 1)))
            .collect();
        rows.push((index + 1, row?));
    }
    let [direct, inverse, centre, affine, size] = rows.as_slice() else {
        return Err(format!(
            "{} lines of numbers; calib_results.txt has five: polynomial, inverse, centre, affine, image size",
            rows.len()
        ));
    };
    let polynomial = |(line, row): &(usize, Vec<f64>)| -> Result<Vec<f64>, String> {
        match row.split_first() {
            Some((count, rest)) if *count == rest.len() as f64 && !rest.is_empty() => Ok(rest.to_vec()),
            _ => Err(format!("line {line}: the number of coefficients must come first, then as many coefficients")),
        }
    };
    let exactly = |(line, row): &(usize, Vec<f64>), n: usize, what: &str| {
        if row.len() == n {
            Ok(row.clone())
        } else {
            Err(format!("line {line}: {} numbers, must be {n}: {what}", row.len()))
        }
    };
    let (row_column, cde) = (exactly(centre, 2, "row and column of the centre")?, exactly(affine, 3, "c, d, e")?);
    let height_width = exactly(size, 2, "height and width")?;
    let is_side = |n: f64| (1.0..=16384.0).contains(&n) && n.fract() == 0.0;
    if !height_width.iter().all(|n| is_side(*n)) {
        return Err(format!("line {}: height and width must be whole numbers of pixels, not {height_width:?}", size.0));
    }
    let mut parameters = PolynomialParameters {
        forward: polynomial(direct)?,
        inverse: polynomial(inverse)?,
        centre_px: [row_column[1], row_column[0]],
        affine: [cde[0], cde[1], cde[2]],
    };
    let image_size_px = [height_width[1] as u32, height_width[0] as u32];
    let mut remarks = Vec::new();
    let camera = match Polynomial::new(parameters.clone(), image_size_px) {
        Ok(camera) => {
            remarks.push(format!("the file's two polynomials differ by up to {:.3} px", camera.disagreement_px()));
            camera
        }
        Err(error) if error.key == "inverse" => {
            remarks.push(format!("the inverse polynomial was left out: {error}"));
            parameters.inverse.clear();
            Polynomial::new(parameters, image_size_px).map_err(|e| parameter(&e))?
        }
        Err(error) => return Err(parameter(&error)),
    };
    Ok(Imported { camera: Arc::new(camera), tool: Tool::OCamCalib, remarks })
}

pub(super) fn write(camera: &dyn Camera) -> Result<Exported, String> {
    let converted = in_model(camera, Kind::Polynomial, "polynomial")?;
    let polynomial = converted.camera.as_ref();
    let forward: Vec<f64> = coefficients(polynomial, "forward");
    if forward.is_empty() {
        return Err("its polynomial runs from angle to radius only: OCamCalib needs the one from radius to ray".into());
    }
    let [w, h] = polynomial.image_size_px();
    let [u0, v0]: [f64; 2] = numbers(polynomial, "centre_px");
    let [c, d, e]: [f64; 3] = numbers(polynomial, "affine");
    let (inverse, inverse_px) = inverse(&forward, 0.5 * f64::from(w).hypot(f64::from(h)));
    let list = |values: &[f64]| {
        values.iter().fold(values.len().to_string(), |mut line, value| {
            let _ = write!(line, " {value:e}");
            line
        })
    };
    let text = format!(
        "#polynomial coefficients for the DIRECT mapping function (ocam_model.ss in MATLAB). These are used by cam2world\n\n\
         {}\n\n\
         #polynomial coefficients for the inverse mapping function (ocam_model.invpol in MATLAB). These are used by world2cam\n\n\
         {}\n\n\
         #center: \"row\" and \"column\", starting from 0 (C convention)\n\n{v0} {u0}\n\n\
         #affine parameters \"c\", \"d\", \"e\"\n\n{c} {d} {e}\n\n\
         #image size: \"height\" and \"width\"\n\n{h} {w}\n\n",
        list(&forward),
        list(&inverse)
    );
    Ok(Exported { text, worst_px: converted.worst_px.max(inverse_px), rms_px: converted.rms_px })
}

/// All coefficients of a list.
fn coefficients(camera: &dyn Camera, key: &str) -> Vec<f64> {
    let prefix = format!("{key}[");
    camera.parameters().iter().filter(|p| p.name.starts_with(&prefix)).map(|p| p.value).collect()
}

/// The polynomial ρ(θ), θ = atan(f(ρ)/ρ), of the lowest degree that is good enough up to a radius, and its largest error.
fn inverse(forward: &[f64], reach_px: f64) -> (Vec<f64>, f64) {
    const SAMPLES: usize = 400;
    let points: Vec<(f64, f64)> = (1..=SAMPLES)
        .map(|i| {
            let rho = reach_px * i as f64 / SAMPLES as f64;
            let f = forward.iter().rev().fold(0.0, |value, c| value * rho + c);
            (f.atan2(rho), rho)
        })
        .collect();
    let mut best = (Vec::new(), f64::INFINITY);
    for degree in INVERSE_DEGREES {
        let matrix = DMatrix::from_fn(points.len(), degree + 1, |i, n| points[i].0.powi(n as i32));
        let right = DVector::from_iterator(points.len(), points.iter().map(|p| p.1));
        let Ok(solution) = matrix.clone().svd(true, true).solve(&right, 1e-14) else { continue };
        let worst = (matrix * &solution - right).amax();
        if worst < best.1 {
            best = (solution.iter().copied().collect(), worst);
        }
        if worst < GOOD_INVERSE_PX {
            break;
        }
    }
    best
}
