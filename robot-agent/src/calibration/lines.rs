//! Straight edges that run towards the picture's middle: what vertical lines of a room look like to an upright panoramic
//! camera, whatever its mirror.
//!
//! Edge points are where the gradient is largest across the edge, to a fraction of a pixel. Neighbours whose gradients
//! agree are grown into pieces; a piece that is long, thin and points towards the middle is a line.

use std::collections::VecDeque;

use nalgebra::{Matrix2, SymmetricEigen, Vector2};

use super::gradient::Gradients;
use crate::capture::GrayPicture;

/// Gray levels per px below which there is no edge.
const MIN_STRENGTH: f32 = 6.0;
/// Gradients in one piece agree to within this angle, radians.
const MAX_TURN_RAD: f64 = 0.26;
/// A line's direction may miss the middle of the picture by this much, radians: the centre is only roughly there.
const MAX_OFF_RADIAL_RAD: f64 = 0.25;
/// Shortest line, as a share of the picture's shorter side.
const MIN_LENGTH: f64 = 0.05;
/// Rms distance of the points from their line, px.
const MAX_RMS_PX: f64 = 0.5;

/// Points of each line, px.
pub fn radial_lines(picture: &GrayPicture, middle_px: Vector2<f64>) -> Vec<Vec<Vector2<f64>>> {
    let gradients = Gradients::new(picture);
    let (width, height) = (gradients.width, gradients.height);
    let min_length = MIN_LENGTH * width.min(height) as f64;
    let mut edges: Vec<Option<(Vector2<f64>, f64)>> = vec![None; width * height];
    for v in 2..height.saturating_sub(2) {
        for u in 2..width.saturating_sub(2) {
            let gradient = gradients.at(u, v);
            if gradient.norm() < MIN_STRENGTH {
                continue;
            }
            let out = Vector2::new(u as f64, v as f64) - middle_px;
            // Across the radius, so along the edge.
            let off = (gradient.map(f64::from).dot(&out) / (f64::from(gradient.norm()) * out.norm())).abs();
            if off < MAX_OFF_RADIAL_RAD.sin() {
                let angle = f64::from(gradient.y).atan2(f64::from(gradient.x));
                edges[v * width + u] = gradients.edge_at(u, v).map(|(at, _)| (at, angle));
            }
        }
    }
    let mut lines = Vec::new();
    for start in 0..edges.len() {
        let Some((_, angle)) = edges[start] else { continue };
        let piece = grow(&mut edges, width, start, angle);
        if piece.len() as f64 >= 0.8 * min_length && is_line(&piece, min_length) {
            lines.push(piece);
        }
    }
    lines
}

/// All edge points that hang together with one and have gradients like its own; they are taken out.
fn grow(edges: &mut [Option<(Vector2<f64>, f64)>], width: usize, start: usize, angle: f64) -> Vec<Vector2<f64>> {
    let mut points = Vec::new();
    let mut queue = VecDeque::from([start]);
    let agrees = |other: f64| protocol::angle::wrap(other - angle).abs() < MAX_TURN_RAD;
    while let Some(index) = queue.pop_front() {
        let Some((at, _)) = edges[index].take() else { continue };
        points.push(at);
        // The picture's border has no edges, so all eight neighbours exist. A gap of one pixel is passed over.
        let (u, v) = ((index % width) as isize, (index / width) as isize);
        for dv in -2..=2 {
            for du in -2..=2 {
                let (x, y) = (u + du, v + dv);
                if x < 0 || y < 0 || x as usize >= width {
                    continue;
                }
                let neighbour = y as usize * width + x as usize;
                if edges.get(neighbour).is_some_and(|e| e.is_some_and(|(_, other)| agrees(other))) {
                    queue.push_back(neighbour);
                }
            }
        }
    }
    points
}

fn is_line(points: &[Vector2<f64>], min_length_px: f64) -> bool {
    let n = points.len() as f64;
    let mean = points.iter().sum::<Vector2<f64>>() / n;
    let scatter: Matrix2<f64> = points.iter().map(|p| (p - mean) * (p - mean).transpose()).sum::<Matrix2<f64>>() / n;
    let eigen = SymmetricEigen::new(scatter);
    let across = eigen.eigenvalues.min().max(0.0).sqrt();
    // Points spread evenly over a length L have a standard deviation of L/√12.
    across < MAX_RMS_PX && eigen.eigenvalues.max().sqrt() * 12.0_f64.sqrt() > min_length_px
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::centre;

    /// Dark wedges from (203.3, 148.8), drawn with 4×4 samples a pixel, and a slanted bar that is no radius.
    fn picture() -> GrayPicture {
        let (width, height) = (400u32, 300u32);
        let shade = |x: f64, y: f64| {
            let (dx, dy) = (x - 203.3, y - 148.8);
            let (radius, angle) = (dx.hypot(dy), dy.atan2(dx));
            let wedge = (40.0..135.0).contains(&radius) && (angle * 4.0 + 0.3).sin() > 0.8;
            let bar = (x * 0.8 + y * 0.6 - 150.0).abs() < 3.0 && radius > 40.0 && x < 120.0;
            if wedge || bar { 60.0 } else { 180.0 }
        };
        let gray = (0..height)
            .flat_map(|v| (0..width).map(move |u| (u, v)))
            .map(|(u, v)| {
                let samples = (0..16).map(|k| {
                    shade(f64::from(u) + (f64::from(k % 4) - 1.5) / 4.0, f64::from(v) + (f64::from(k / 4) - 1.5) / 4.0)
                });
                (samples.sum::<f64>() / 16.0).round() as u8
            })
            .collect();
        GrayPicture { width, height, gray }
    }

    #[test]
    fn lines_of_a_picture_meet_in_its_centre() {
        let lines = radial_lines(&picture(), Vector2::new(199.5, 149.5));
        assert!(lines.len() >= 8, "{}", lines.len());
        let centre = centre::of_lines(&lines).unwrap();
        let error = (centre.centre_px - Vector2::new(203.3, 148.8)).norm();
        assert!(error < 0.15, "{error}: {centre:?}");
    }
}
