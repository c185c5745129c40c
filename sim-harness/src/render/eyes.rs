//! Cameras that are no PAL: one that looks one way, a slit that turns, and those of the zoo.
//!
//! A turning slit sees each column at its own instant: its picture is joined from strips of few columns, each drawn as the
//! world is when the slit passes it.

use nalgebra::Vector3;
use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use super::Renderer;
use super::rays::Rays;
use super::scene::Scene;
use crate::scenario::{EyeSpec, Slopes};
use crate::world::World;

/// Light beyond the picture's border, so that the lens' blur takes none from the border.
pub(super) const PAD_PX: usize = 8;
/// Columns of a strip: 1 to 2 ms of a turn in 0.2 s.
const STRIP_PX: usize = 8;
/// Drawn on both sides of a strip, for edges.
const STRIP_PAD_PX: usize = 2;

/// Origin (m, from the camera's middle) and unit direction in the body frame.
pub type OutwardRay = (Vector3<f64>, Vector3<f64>);

/// What a place on a picture sees whose rows are slopes.
pub fn ray(eye: &EyeSpec, u: f64, v: f64) -> Option<OutwardRay> {
    let Slopes { focal_length_px: f, horizon_px } = eye.slopes()?;
    let (width, up) = (f64::from(eye.image_size_px()[0]), horizon_px - v);
    let direction = if eye.turn_s().is_some() {
        let slit = PI - TAU * (u + 0.5) / width;
        Vector3::new(f * slit.cos(), f * slit.sin(), up)
    } else {
        Vector3::new(f, 0.5 * (width - 1.0) - u, up)
    };
    Some((Vector3::zeros(), direction.normalize()))
}

/// All rays of a camera and [`PAD_PX`] beyond; none of one of the zoo that the agent cannot read (a test reads all).
pub(super) fn rays(eye: &EyeSpec, height_m: f64) -> Rays {
    let rays = |ray: &dyn Fn(f64, f64) -> Option<OutwardRay>| {
        Rays::of_camera_with_margin(eye.image_size_px(), [PAD_PX; 2], height_m, ray)
    };
    match eye {
        EyeSpec::Zoo { specimen } => {
            let specimen = specimen.specimen();
            let camera = specimen.agents_camera().ok();
            rays(&|u, v| specimen.ray(camera.as_ref()?, u, v))
        }
        EyeSpec::Pinhole { .. } | EyeSpec::Rotating { .. } => rays(&|u, v| ray(eye, u, v)),
    }
}

/// A turn of a slit.
pub(super) struct Turn {
    strips: Vec<Strip>,
    columns: usize,
}

struct Strip {
    renderer: Renderer,
    first: usize,
    columns: usize,
    /// The picture's capture time.
    after_s: f64,
}

impl Turn {
    /// For a robot's camera, if it turns.
    pub(super) fn new(world: &Arc<World>, scene: &Arc<Scene>, eye: &EyeSpec, robot: usize) -> Option<Self> {
        let EyeSpec::Rotating { image_size_px: [width, height], turn_s, .. } = *eye else { return None };
        let strip = |first: usize| {
            let columns = STRIP_PX.min(width as usize - first);
            let rays = Rays::of_camera_with_margin(
                [columns as u32, height],
                [STRIP_PAD_PX, PAD_PX],
                world.camera().height_m,
                |u, v| ray(eye, u + first as f64, v),
            );
            let share = (first as f64 + 0.5 * columns as f64) / f64::from(width);
            let renderer = Renderer::new(world, scene, &Arc::new(rays), robot);
            Strip { renderer, first, columns, after_s: turn_s * (share - 0.5) }
        };
        Some(Self { strips: (0..width as usize).step_by(STRIP_PX).map(strip).collect(), columns: width as usize })
    }

    /// The renderers of its strips.
    pub(super) fn renderers(&mut self) -> impl Iterator<Item = &mut Renderer> {
        self.strips.iter_mut().map(|s| &mut s.renderer)
    }

    /// The light of a picture (with its margins) whose middle is seen at a true time, and of each person the pixels seen and
    /// those it would cover alone.
    pub(super) fn expose(&mut self, time_s: f64, light: &mut [f32], people: usize) -> Vec<[u32; 2]> {
        let wide = self.columns + 2 * PAD_PX;
        let mut pixels = vec![[0; 2]; people];
        for strip in &mut self.strips {
            let counted = strip.renderer.gather(time_s + strip.after_s);
            for (sum, [seen, alone]) in pixels.iter_mut().zip(counted) {
                *sum = [sum[0] + seen, sum[1] + alone];
            }
            let from = strip.renderer.canvas.light.chunks_exact(strip.columns + 2 * STRIP_PAD_PX);
            for (row, from) in light.chunks_exact_mut(wide).zip(from) {
                let to = PAD_PX + strip.first..PAD_PX + strip.first + strip.columns;
                row[to].copy_from_slice(&from[STRIP_PAD_PX..STRIP_PAD_PX + strip.columns]);
            }
        }
        // The last column borders on the first.
        for row in light.chunks_exact_mut(wide) {
            row.copy_within(self.columns..self.columns + PAD_PX, 0);
            row.copy_within(PAD_PX..2 * PAD_PX, PAD_PX + self.columns);
        }
        pixels
    }
}

#[cfg(test)]
mod tests;
