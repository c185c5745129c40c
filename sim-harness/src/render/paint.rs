//! Light of what moves, and the shadows it throws on what stands still.
//!
//! Shadows go tile by tile: one test of a tile against each mover and lamp leaves few pixels to test one by one. Pixels
//! inside a mover take one sample, pixels on an edge several, each of them traced through the glass at its own place.

use super::Renderer;
use super::light::{Caster, PerLamp, Shade};
use super::moving::{Mover, MoverHit, Shaders};
use super::rays::TILE_PX;
use super::scene::{Glow, Scene};
use super::still::{EDGE_SAMPLES, FEW_SAMPLES, ROBOT_KEYS, Still, StillPicture};
use crate::world::vector::Ray;

/// Shadows are soft: where four pixels of a tile show one surface, one test serves them.
#[derive(Default)]
struct Tested {
    shade: Shade,
    on_robot: Vec<bool>,
    /// Of each pixel of the tile, in its order.
    place_of: Vec<u8>,
}

impl Tested {
    fn clear(&mut self) {
        self.shade.clear();
        self.on_robot.clear();
        self.place_of.clear();
    }

    /// The places of a tile.
    fn choose(&mut self, tile: &[u32], still: &StillPicture) {
        self.place_of.resize(tile.len(), 0);
        if tile.len() < TILE_PX * TILE_PX {
            (0..tile.len()).for_each(|i| self.add(&[i], tile[i] as usize, still));
            return;
        }
        for n in 0..TILE_PX * TILE_PX / 4 {
            let first = 2 * (n / (TILE_PX / 2)) * TILE_PX + 2 * (n % (TILE_PX / 2));
            let four = [first, first + 1, first + TILE_PX, first + TILE_PX + 1];
            let key = |i: usize| still.key[tile[i] as usize];
            if four.iter().all(|i| key(*i) == key(first)) {
                self.add(&four, tile[first] as usize, still);
            } else {
                four.into_iter().for_each(|i| self.add(&[i], tile[i] as usize, still));
            }
        }
    }

    fn add(&mut self, of: &[usize], pixel: usize, still: &StillPicture) {
        of.iter().for_each(|i| self.place_of[*i] = self.on_robot.len() as u8);
        self.shade.push(still.point[pixel]);
        self.on_robot.push(still.key[pixel] >= ROBOT_KEYS);
    }

    /// Share of the light that is left, of each pixel of the tile.
    fn open(&self) -> impl Iterator<Item = f32> {
        self.place_of.iter().map(|place| self.shade.open()[usize::from(*place)])
    }
}

/// Most pixels of a mover that are painted together.
const PATCH: usize = 64;

/// A pixel inside a mover: whose, which, its ray and what it meets.
type Inside = (u16, usize, Ray, MoverHit);

impl Renderer {
    /// Takes the light away that movers keep from what stands still, tile by tile.
    pub(super) fn throw_shadows(&mut self, movers: &[Mover], strength: &PerLamp) {
        let lights = self.scene.lights();
        // Shadows of standing robots are in the picture already, unless it was made in haste.
        let standing: &[Caster] = if self.still.is_fine { &[] } else { &self.standing };
        let casters: Vec<&Caster> = movers.iter().map(|m| &m.caster).chain(standing).collect();
        let mut shading = Vec::new();
        let mut tested = Tested::default();
        for (tile, (middle, radius)) in self.rays.tiles.iter().zip(&self.still.balls) {
            tested.clear();
            for (k, strength) in strength.iter().enumerate().take(lights.count()) {
                let lamp = lights.position(k);
                shading.clear();
                let by = |caster: &&Caster| caster.parts_shading(*middle, *radius, lamp);
                shading
                    .extend(casters.iter().map(by).enumerate().filter_map(|(n, parts)| parts.map(|parts| (n, parts))));
                if shading.is_empty() {
                    continue;
                }
                if tested.place_of.is_empty() {
                    tested.choose(tile, &self.still);
                }
                tested.shade.reopen();
                for (n, parts) in &shading {
                    let spared = (*n >= movers.len()).then_some(&tested.on_robot[..]);
                    tested.shade.close(casters[*n], *parts, lamp, spared);
                }
                for (pixel, open) in tile.iter().map(|p| *p as usize).zip(tested.open()) {
                    self.canvas.light[pixel] -= (1.0 - open) * self.still.glow[pixel].lamps[k] * strength;
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
        let mut patch: Vec<Inside> = Vec::with_capacity(PATCH);
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
            let (n, part) = self.canvas.shown[pixel];
            if patch.len() == PATCH || patch.first().is_some_and(|p| p.0 != n) {
                paint_patch(&mut patch, &shaders, movers, &self.scene, strength, &mut self.canvas.light);
            }
            let ray = self.still.ray[pixel];
            if let Some(hit) = movers[usize::from(n)].hit_part(usize::from(part), &ray, f32::INFINITY) {
                patch.push((n, pixel, ray, hit));
            }
        }
        paint_patch(&mut patch, &shaders, movers, &self.scene, strength, &mut self.canvas.light);
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
        let middle = self.still.ray[pixel];
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

/// Paints some pixels inside one mover.
fn paint_patch(
    patch: &mut Vec<Inside>,
    shaders: &[Shaders<'_>],
    movers: &[Mover],
    scene: &Scene,
    strength: &PerLamp,
    light: &mut [f32],
) {
    let Some(n) = patch.first().map(|p| usize::from(p.0)) else { return };
    let open = shaders[n].open_all(patch.iter().map(|(_, _, ray, hit)| ray.at(hit.t)), scene);
    for ((_, pixel, ray, hit), open) in patch.drain(..).zip(open) {
        light[pixel] = movers[n].glow(&hit, &ray, scene, &open).total(strength);
    }
}
