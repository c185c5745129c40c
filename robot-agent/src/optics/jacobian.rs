//! How a pixel moves with the point and with the camera's parameters.
//!
//! Central differences of smooth maps: with steps that move pixels by a few thousandths, truncation and rounding both
//! stay below 10⁻⁶ of the derivative for every model here (the laws compare with other steps, and with closed forms).

use std::sync::Arc;

use nalgebra::{Matrix2x3, Vector2, Vector3};

use super::{Camera, ParameterError};

/// Step along a point's coordinates over its distance.
const STEP: f64 = 1e-5;
/// How far a parameter's step moves the pixel that it moves most.
const MOVE_PX: f64 = 0.003;

/// ∂pixel/∂point, 2×3, px/m.
pub fn of_point(
    image_of_point: impl Fn(&Vector3<f64>) -> Option<Vector2<f64>>,
    point_m: &Vector3<f64>,
) -> Option<Matrix2x3<f64>> {
    let step = STEP * point_m.norm();
    let mut jacobian = Matrix2x3::zeros();
    for axis in 0..3 {
        let mut offset = Vector3::zeros();
        offset[axis] = step;
        let (plus, minus) = (image_of_point(&(point_m + offset))?, image_of_point(&(point_m - offset))?);
        jacobian.set_column(axis, &((plus - minus) / (2.0 * step)));
    }
    Some(jacobian)
}

/// The cameras on both sides of one, for derivatives to its parameters at any number of points.
#[derive(Debug)]
pub struct ParameterJacobian {
    /// For each parameter the cameras above and below, with their steps.
    sides: Vec<[(Arc<dyn Camera>, f64); 2]>,
}

impl ParameterJacobian {
    /// Prepares the derivatives to the parameters with these indices.
    ///
    /// # Errors
    /// A parameter so close to its limit that no step to either side makes a camera.
    pub fn new(camera: &dyn Camera, indices: impl IntoIterator<Item = usize>) -> Result<Self, ParameterError> {
        let values: Vec<f64> = camera.parameters().into_iter().map(|p| p.value).collect();
        let probes = probes(camera);
        let sides = indices
            .into_iter()
            .filter(|i| *i < values.len())
            .map(|i| {
                let side = |step: f64| moved(camera, &values, i, step).map(|camera| (camera, step));
                let here = || camera.with_values(&values).map(|camera| (camera, 0.0));
                let step = suited_step(camera, &values, i, &probes);
                // At a limit one side is enough.
                match (side(step), side(-step)) {
                    (Ok(plus), Ok(minus)) => Ok([plus, minus]),
                    (Ok(plus), Err(_)) => Ok([plus, here()?]),
                    (Err(_), Ok(minus)) => Ok([here()?, minus]),
                    (Err(error), Err(_)) => Err(error),
                }
            })
            .collect::<Result<_, _>>()?;
        Ok(Self { sides })
    }

    /// ∂pixel/∂parameter at a point (metres), a column each, px per unit of the parameter; `None` where one of the
    /// cameras does not image the point.
    pub fn at(&self, point_m: &Vector3<f64>) -> Option<Vec<Vector2<f64>>> {
        self.sides
            .iter()
            .map(|[(plus, above), (minus, below)]| {
                Some((plus.image_of_point(point_m)? - minus.image_of_point(point_m)?) / (above - below))
            })
            .collect()
    }

    /// How far each parameter is moved, in its own unit.
    pub fn steps(&self) -> impl Iterator<Item = f64> {
        self.sides.iter().map(|[(_, above), (_, below)]| 0.5 * (above - below))
    }
}

fn moved(camera: &dyn Camera, values: &[f64], i: usize, step: f64) -> Result<Arc<dyn Camera>, ParameterError> {
    let mut values = values.to_vec();
    values[i] += step;
    camera.with_values(&values)
}

/// Points 1 m along the rays of a grid of pixels, with those pixels.
fn probes(camera: &dyn Camera) -> Vec<(Vector3<f64>, Vector2<f64>)> {
    const SIDE: u32 = 9;
    let [w, h] = camera.image_size_px().map(f64::from);
    let at = |i: u32, side: f64| (f64::from(i) + 0.5) / f64::from(SIDE) * side - 0.5;
    (0..SIDE * SIDE)
        .filter_map(|n| {
            let pixel = Vector2::new(at(n % SIDE, w), at(n / SIDE, h));
            let ray = camera.unproject(&pixel)?;
            let point = ray.origin_m + ray.direction;
            Some((point, camera.image_of_point(&point)?))
        })
        .collect()
}

/// The step that moves the probes by [`MOVE_PX`] at most: parameters are lengths, ratios and coefficients of any power,
/// so only the picture can say what a small step is.
fn suited_step(camera: &dyn Camera, values: &[f64], i: usize, probes: &[(Vector3<f64>, Vector2<f64>)]) -> f64 {
    const ROUNDS: usize = 8;
    /// Steps of parameters that hardly move anything stay below this share of their value (or of 1).
    const LARGEST: f64 = 1e-3;
    let scale = if values[i] == 0.0 { 1.0 } else { values[i].abs() };
    let mut step = 1e-6 * scale;
    for _ in 0..ROUNDS {
        let largest_move = |camera: &Arc<dyn Camera>| {
            let moves = probes.iter().filter_map(|(point, pixel)| Some((camera.image_of_point(point)? - pixel).norm()));
            moves.fold(0.0, f64::max)
        };
        let moved_px = [step, -step].iter().find_map(|s| moved(camera, values, i, *s).ok()).map(|c| largest_move(&c));
        let factor = moved_px.map_or(1e-3, |px| (MOVE_PX / px).clamp(1e-4, 1e4));
        step = (step * factor).min(LARGEST * scale);
        if (0.5..2.0).contains(&factor) {
            break;
        }
    }
    step
}
