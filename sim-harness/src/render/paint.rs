//! Light of what moves, and the shadows it throws on what stands still.
//!
//! Shadows go tile by tile: one test of a tile against each mover and lamp leaves few pixels to test one by one. Pixels
//! inside a mover take one sample, pixels on an edge several, each of them traced through the glass at its own place.

use super::Renderer;
use super::light::{Caster, PerLamp};
use super::moving::{Mover, Shaders};
use super::rays::TILE_PX;
use super::scene::Glow;
use super::still::{EDGE_SAMPLES, FEW_SAMPLES, ROBOT_KEYS, Still};
use crate::world::vector::V3;

impl Renderer {
    /// Takes the light away that movers keep from what stands still, tile by tile.
    pub(super) fn throw_shadows(&mut self, movers: &[Mover], strength: &PerLamp) {
        let lights = self.scene.lights();
        // Shadows of standing robots are in the picture already, unless it was made in haste.
        let standing: &[Caster] = if self.still.is_fine { &[] } else { &self.standing };
        let casters: Vec<&Caster> = movers.iter().map(|m| &m.caster).chain(standing).collect();
        let mut shading = Vec::new();
        for (tile, (middle, radius)) in self.rays.tiles.iter().zip(&self.still.balls) {
            for (k, strength) in strength.iter().enumerate().take(lights.count()) {
                let lamp = lights.position(k);
                shading.clear();
                shading.extend(
                    casters
                        .iter()
                        .enumerate()
                        .filter_map(|(n, caster)| caster.parts_shading(*middle, *radius, lamp).map(|parts| (n, parts))),
                );
                if shading.is_empty() {
                    continue;
                }
                let open_at = |pixel: usize| {
                    let p: V3 = self.still.point[pixel];
                    let is_robot = self.still.key[pixel] >= ROBOT_KEYS;
                    shading
                        .iter()
                        .filter(|(n, _)| !(is_robot && *n >= movers.len()))
                        .fold(1.0, |open, (n, parts)| open * (1.0 - casters[*n].shade_by(*parts, p, lamp)))
                };
                let light = &mut self.canvas.light;
                let mut take = |pixel: usize, open: f32| {
                    light[pixel] -= (1.0 - open) * self.still.glow[pixel].lamps[k] * strength;
                };
                if tile.len() < TILE_PX * TILE_PX {
                    tile.iter().for_each(|p| take(*p as usize, open_at(*p as usize)));
                    continue;
                }
                // Shadows are soft: where four pixels show one surface, one test serves them.
                for n in 0..TILE_PX * TILE_PX / 4 {
                    let first = 2 * (n / (TILE_PX / 2)) * TILE_PX + 2 * (n % (TILE_PX / 2));
                    let four = [first, first + 1, first + TILE_PX, first + TILE_PX + 1].map(|i| tile[i] as usize);
                    let key = self.still.key[four[0]];
                    if four.iter().all(|p| self.still.key[*p] == key) {
                        let open = open_at(four[0]);
                        four.into_iter().for_each(|p| take(p, open));
                    } else {
                        four.into_iter().for_each(|p| take(p, open_at(p)));
                    }
                }
            }
        }
    }

    /// Gives the movers' pixels their light: one sample inside, sixteen where a pixel shows an edge.
    pub(super) fn paint(&mut self, movers: &[Mover], strength: &PerLamp) {
        let casters: Vec<&Caster> = self.standing.iter().chain(movers.iter().map(|m| &m.caster)).collect();
        let shaders: Vec<Shaders<'_>> = movers.iter().map(|m| m.shaders(&self.scene, &casters)).collect();
        let still = Still::new(&self.scene, self.still.stand, &self.standing);
        let mut edges = Vec::new();
        for pixel in self.canvas.touched.iter().map(|p| *p as usize) {
            let key = self.canvas.key[pixel];
            let mut is_edge = self.still.mixed[pixel];
            for n in self.rays.neighbours(pixel) {
                if self.rays.is_lit[n] && self.canvas.key[n] != key {
                    is_edge = true;
                    // The pixel outside the edge shows a part of it too; inside ones find themselves.
                    if self.canvas.key[n] == 0 {
                        edges.push(n as u32);
                    }
                }
            }
            if is_edge {
                edges.push(pixel as u32);
                continue;
            }
            let ray = self.still.stand.room_from_body(self.rays.ray(pixel, 0.0, 0.0));
            let (n, part) = self.canvas.shown[pixel];
            let mover = &movers[usize::from(n)];
            if let Some(hit) = mover.hit_part(usize::from(part), &ray, f32::INFINITY) {
                let open = shaders[usize::from(n)].open(ray.at(hit.t), &self.scene);
                self.canvas.light[pixel] = mover.glow(&hit, &ray, &self.scene, &open).total(strength);
            }
        }
        edges.sort_unstable();
        edges.dedup();
        for pixel in edges.into_iter().map(|p| p as usize) {
            let light = self.edge_light(pixel, movers, &shaders, &still, strength);
            self.canvas.light[pixel] = light;
        }
    }

    fn edge_light(
        &self,
        pixel: usize,
        movers: &[Mover],
        shaders: &[Shaders<'_>],
        still: &Still<'_>,
        strength: &PerLamp,
    ) -> f32 {
        let bearing = self.rays.bearing[pixel];
        let stand = &self.still.stand;
        let middle = stand.room_from_body(self.rays.ray(pixel, 0.0, 0.0));
        let is_mixed = self.still.mixed[pixel];
        // What the pixel can show of movers: parts that a ray through its middle meets once they are a pixel thicker.
        let mut near: Vec<(usize, usize)> = Vec::new();
        for (n, mover) in movers.iter().enumerate() {
            mover.near_parts(&middle, 1.5 * self.rays.pixel_rad, |part| near.push((n, part)));
        }
        // Shadows are soft: once a pixel and mover.
        let mut open: Vec<Option<PerLamp>> = vec![None; movers.len()];
        // Robots are measured to a twentieth of a pixel, people are not.
        let is_fine = self.still.shows_robot(&self.rays, pixel) || near.iter().any(|(n, _)| movers[*n].is_robot());
        let samples: &[[f32; 2]] = if is_fine { &EDGE_SAMPLES } else { &FEW_SAMPLES };
        let mut sum = 0.0;
        for [du, dv] in samples.iter().copied() {
            let ray = stand.room_from_body(self.rays.ray(pixel, du, dv));
            let behind = if is_mixed { Some(still.hit(&ray, bearing)) } else { None };
            let mut limit = behind.map_or(self.still.depth[pixel], |h| h.t);
            let mut first = None;
            for (n, part) in &near {
                if let Some(hit) = movers[*n].hit_part(*part, &ray, limit) {
                    limit = hit.t;
                    first = Some((*n, hit));
                }
            }
            sum += match (first, behind) {
                (Some((n, hit)), _) => {
                    let mover = &movers[n];
                    let open = open[n].get_or_insert_with(|| shaders[n].open(ray.at(hit.t), &self.scene));
                    mover.glow(&hit, &ray, &self.scene, open).total(strength)
                }
                (None, Some(hit)) => {
                    let mut glow: Glow = still.glow(&hit, &ray, 0.5 * self.rays.pixel_rad);
                    let p = ray.at(hit.t);
                    for k in 0..self.scene.lights().count() {
                        for mover in movers {
                            glow.lamps[k] *= 1.0 - mover.caster.shade(p, self.scene.lights().position(k));
                        }
                    }
                    glow.total(strength)
                }
                (None, None) => self.canvas.light[pixel],
            };
        }
        sum / samples.len() as f32
    }
}
