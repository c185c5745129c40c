//! Gray values, a little blurred, with their gradient: what lines and rims are found in.

use nalgebra::Vector2;

use crate::capture::GrayPicture;

/// Gradients of a picture by Scharr's kernel, which blurs as much as it differentiates.
pub(super) struct Gradients {
    pub(super) width: usize,
    pub(super) height: usize,
    /// Gray levels per px, pixel by pixel; zero on the border.
    values: Vec<Vector2<f32>>,
}

impl Gradients {
    pub(super) fn new(picture: &GrayPicture) -> Self {
        let (width, height) = (picture.width as usize, picture.height as usize);
        let mut values = vec![Vector2::zeros(); width * height];
        for v in 1..height.saturating_sub(1) {
            for u in 1..width.saturating_sub(1) {
                let g = |x: usize, y: usize| f32::from(picture.gray[y * width + x]);
                let du = 3.0 * (g(u + 1, v - 1) - g(u - 1, v - 1) + g(u + 1, v + 1) - g(u - 1, v + 1))
                    + 10.0 * (g(u + 1, v) - g(u - 1, v));
                let dv = 3.0 * (g(u - 1, v + 1) - g(u - 1, v - 1) + g(u + 1, v + 1) - g(u + 1, v - 1))
                    + 10.0 * (g(u, v + 1) - g(u, v - 1));
                values[v * width + u] = Vector2::new(du, dv) / 32.0;
            }
        }
        Self { width, height, values }
    }

    /// At a pixel.
    pub(super) fn at(&self, u: usize, v: usize) -> Vector2<f32> {
        self.values[v * self.width + u]
    }

    /// Between pixels; `None` off the picture.
    pub(super) fn between(&self, at: &Vector2<f64>) -> Option<Vector2<f32>> {
        if !(at.x >= 0.0 && at.y >= 0.0 && at.x < (self.width - 1) as f64 && at.y < (self.height - 1) as f64) {
            return None;
        }
        let (u, v) = (at.x as usize, at.y as usize);
        let (a, b) = ((at.x - u as f64) as f32, (at.y - v as f64) as f32);
        let top = self.at(u, v) * (1.0 - a) + self.at(u + 1, v) * a;
        let bottom = self.at(u, v + 1) * (1.0 - a) + self.at(u + 1, v + 1) * a;
        Some(top * (1.0 - b) + bottom * b)
    }

    /// The edge point nearest to a pixel along its gradient, where the gradient is largest, and the strength there; `None`
    /// where a neighbour along the gradient is stronger.
    pub(super) fn edge_at(&self, u: usize, v: usize) -> Option<(Vector2<f64>, f32)> {
        let gradient = self.at(u, v);
        let strength = gradient.norm();
        if strength <= 0.0 {
            return None;
        }
        let along = (gradient / strength).map(f64::from);
        let here = Vector2::new(u as f64, v as f64);
        let (before, after) = (self.between(&(here - along))?.norm(), self.between(&(here + along))?.norm());
        if before > strength || after >= strength {
            return None;
        }
        // The peak of the parabola through three strengths.
        let bend = before - 2.0 * strength + after;
        let offset = if bend < 0.0 { f64::from(0.5 * (before - after) / bend) } else { 0.0 };
        Some((here + along * offset, strength))
    }
}
