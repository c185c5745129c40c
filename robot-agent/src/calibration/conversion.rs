//! One camera model in the words of another: the numbers of the second that image the first's rays nearest to where the
//! first does, and how far off they remain.

use std::sync::Arc;

use nalgebra::{DVector, Vector2, Vector3};

use super::candidate::Candidate;
use super::least_squares::minimise;
use crate::optics::Camera;

/// Rows and columns of the grid of pixels that are compared.
const GRID: u32 = 24;
/// Fewer rays describe no camera.
const MIN_RAYS: usize = 20;

/// A converted camera.
#[derive(Debug, Clone)]
pub struct Conversion {
    /// In the other model.
    pub camera: Arc<dyn Camera>,
    /// Distance between the two cameras' images of one ray over the picture, px: rms and largest.
    pub rms_px: f64,
    /// The largest.
    pub worst_px: f64,
}

/// The best match of a candidate to a camera, over the camera's whole field of view. Rays are taken at infinity, so the
/// origins of a camera without a single viewpoint are lost. `None` where the candidate cannot see what the camera sees.
pub fn convert(camera: &dyn Camera, candidate: &Candidate) -> Option<Conversion> {
    let rays = rays(camera);
    if rays.len() < MIN_RAYS {
        return None;
    }
    let mut best: Option<Conversion> = None;
    for scale in [1.0, 0.7, 1.4, 0.5, 2.0] {
        let Some(start) = candidate.start.scaled(scale) else { continue };
        let sample: Vec<Vector3<f64>> = rays.iter().map(|(d, _)| *d).collect();
        let Some(steps) = start.differences(&sample) else { continue };
        let residuals = |x: &DVector<f64>| {
            let mut turned = start.clone();
            turned.set_unknowns(x.as_slice());
            turned.is_sound().then_some(())?;
            let offsets: Option<Vec<f64>> = rays
                .iter()
                .map(|(ray, pixel)| turned.camera().image_of_direction(ray).map(|image| image - pixel))
                .try_fold(Vec::with_capacity(2 * rays.len()), |mut all, offset| {
                    all.extend(offset?.iter());
                    Some(all)
                });
            Some(DVector::from_vec(offsets?))
        };
        let Some(found) = minimise(DVector::from_vec(start.unknown_values()), &steps, residuals) else { continue };
        let lengths: Vec<f64> =
            found.residuals.as_slice().chunks_exact(2).map(|r| Vector2::new(r[0], r[1]).norm()).collect();
        let rms_px = (lengths.iter().map(|l| l * l).sum::<f64>() / lengths.len() as f64).sqrt();
        if best.as_ref().is_none_or(|b| rms_px < b.rms_px) {
            let mut turned = start.clone();
            turned.set_unknowns(found.x.as_slice());
            let worst_px = lengths.iter().copied().fold(0.0, f64::max);
            best = Some(Conversion { camera: turned.camera().clone(), rms_px, worst_px });
        }
    }
    best
}

/// Directions and pixels all over the field of view.
fn rays(camera: &dyn Camera) -> Vec<(Vector3<f64>, Vector2<f64>)> {
    let [w, h] = camera.image_size_px().map(f64::from);
    let grid = (0..GRID).flat_map(|i| (0..GRID).map(move |j| (f64::from(i) + 0.5, f64::from(j) + 0.5)));
    grid.map(|(i, j)| Vector2::new(i / f64::from(GRID) * w - 0.5, j / f64::from(GRID) * h - 0.5))
        .filter_map(|pixel| Some((camera.unproject(&pixel)?.direction, pixel)))
        .collect()
}
