//! Pictures of the world as the robots' PAL cameras take them: solid geometry, light and glass.
//!
//! The mirrors are traced once a camera ([`rays`]); the room is painted and lit once ([`scene`]); what stands still is drawn
//! once while a camera stands ([`still`]); every picture adds what moves, its shadows, flicker, blur and noise. All of it is
//! a function of (world, robot, time): the same instant gives the same bytes.
//!
//! Nothing here uses the team's frames, markers or camera models: this is the physics that they are tested against.

mod camouflage;
pub mod light;
pub mod moving;
pub mod pal;
pub mod rays;
pub mod scene;
pub mod sensor;
pub mod still;

use std::sync::Arc;

use crate::world::vector::V3;
use crate::world::wardrobe::Clothes;
use crate::world::{State, World};
use light::Caster;
use moving::{Mover, Shaders};
use rays::{Rays, Stand, TILE_PX};
use scene::{Glow, Scene};
use sensor::Sensor;
use still::{EDGE_SAMPLES, FEW_SAMPLES, ROBOT_KEYS, Still, StillPicture};

/// Grey level of the light that all but [`BRIGHTEST_SHARE`] of the pixels stay below.
const FULL_GRAY: f32 = 215.0;
const BRIGHTEST_SHARE: f64 = 0.01;

/// A picture and what is seen in it.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Row by row.
    pub gray: Vec<u8>,
    /// Of each person: unhidden pixels / pixels the person would cover alone, within the design's field of view; 0 where
    /// it would cover none.
    pub visible_fraction: Vec<f64>,
}

/// One robot's camera in the world.
pub struct Renderer {
    world: Arc<World>,
    scene: Arc<Scene>,
    rays: Arc<Rays>,
    clothes: Arc<[Clothes]>,
    robot: usize,
    standing: Vec<Caster>,
    still: StillPicture,
    sensor: Sensor,
    gain: f32,
    canvas: Canvas,
}

/// What moves in one picture, by pixel.
struct Canvas {
    light: Vec<f32>,
    key: Vec<u32>,
    /// Mover and part.
    shown: Vec<(u16, u16)>,
    depth: Vec<f32>,
    /// The stamp of the last mover that was counted here.
    counted: Vec<u32>,
    stamp: u32,
    touched: Vec<u32>,
}

impl Renderer {
    /// A renderer for each robot, in the world's order. They share what can be shared.
    pub fn team(world: &Arc<World>) -> Vec<Self> {
        let scene = Arc::new(Scene::new(world));
        let rays = Arc::new(Rays::trace(world.camera()));
        let mut team: Vec<Self> =
            (0..world.robots().len()).map(|robot| Self::new(world, &scene, &rays, robot)).collect();
        let clothes: Arc<[Clothes]> = camouflage::dress(world, &mut team).into();
        team.iter_mut().for_each(|r| r.clothes = clothes.clone());
        team
    }

    fn new(world: &Arc<World>, scene: &Arc<Scene>, rays: &Arc<Rays>, robot: usize) -> Self {
        let height = world.camera().height_m;
        let first = world.at(0.0);
        let standing = world
            .robots()
            .iter()
            .enumerate()
            .filter(|(n, r)| *n != robot && r.stands())
            .map(|(n, _)| still::robot_caster(n as u16 + 1, first.robots[n].x_m, first.robots[n].y_m, height))
            .collect();
        let pixels = rays.width * rays.height;
        let mut renderer = Self {
            world: world.clone(),
            scene: scene.clone(),
            rays: rays.clone(),
            clothes: Arc::default(),
            robot,
            standing,
            still: StillPicture::new(rays, Stand::new(f64::NAN, 0.0, 0.0)),
            sensor: Sensor::new(
                world.camera().blur_px,
                world.camera().noise_gray,
                sensor::mix(world.seed() ^ ((robot as u64) << 56)),
            ),
            gain: 1.0,
            canvas: Canvas {
                light: vec![0.0; pixels],
                key: vec![0; pixels],
                shown: vec![(0, 0); pixels],
                depth: vec![f32::INFINITY; pixels],
                counted: vec![0; pixels],
                stamp: 0,
                touched: Vec::new(),
            },
        };
        renderer.look_from(&first);
        renderer.expose();
        renderer
    }

    /// The picture at a true time.
    pub fn render(&mut self, time_s: f64) -> Picture {
        let state = self.world.at(time_s);
        self.look_from(&state);
        let movers = self.movers(&state);
        let strength = self.scene.lights().strength(time_s);
        for pixel in self.rays.lit.iter().map(|p| *p as usize) {
            self.canvas.light[pixel] = self.still.glow[pixel].total(&strength);
        }
        self.throw_shadows(&movers, &strength);
        let visible_fraction = self.draw(&movers);
        self.paint(&movers, &strength);
        self.clear();
        Picture {
            width: self.rays.width as u32,
            height: self.rays.height as u32,
            gray: self.sensor.develop(&self.canvas.light, self.rays.width, self.gain, time_s),
            visible_fraction,
        }
    }

    /// Only the share of each person that is seen at a true time.
    pub fn visible_fraction(&mut self, time_s: f64) -> Vec<f64> {
        let state = self.world.at(time_s);
        self.look_from(&state);
        let movers = self.movers(&state);
        let visible = self.draw(&movers);
        self.clear();
        visible
    }

    /// Makes the picture of what stands still fit to where the camera is.
    fn look_from(&mut self, state: &State) {
        let robot = &state.robots[self.robot];
        let stand = Stand::new(robot.x_m, robot.y_m, robot.heading_rad);
        if self.still.stand == stand && (self.still.is_fine || robot.moving) {
            return;
        }
        let still = Still::new(&self.scene, stand, &self.standing);
        self.still.fill(&still, &self.rays, !robot.moving);
    }

    /// Chooses the exposure from the empty room.
    fn expose(&mut self) {
        let strength = [1.0; crate::world::MAX_LAMPS];
        let mut light: Vec<f32> = self.rays.lit.iter().map(|p| self.still.glow[*p as usize].total(&strength)).collect();
        light.sort_by(f32::total_cmp);
        let place = (light.len() as f64 * (1.0 - BRIGHTEST_SHARE)) as usize;
        let bright = light.get(place.min(light.len().saturating_sub(1))).copied().unwrap_or(1.0);
        self.gain = FULL_GRAY / bright.max(1e-6);
    }

    fn movers(&self, state: &State) -> Vec<Mover> {
        let height = self.world.camera().height_m;
        let robots = self.world.robots().iter().enumerate().filter(|(n, r)| *n != self.robot && !r.stands());
        let mut movers: Vec<Mover> =
            robots.map(|(n, _)| Mover::robot(n, state.robots[n].x_m, state.robots[n].y_m, height)).collect();
        for (n, (person, clothes)) in state.people.iter().zip(self.clothes.iter()).enumerate() {
            let capsules = self.world.capsules(person);
            movers.push(Mover::person(n, &capsules, *clothes, person.heading_rad));
        }
        movers
    }

    /// Takes the light away that movers keep from what stands still, tile by tile.
    fn throw_shadows(&mut self, movers: &[Mover], strength: &light::PerLamp) {
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

    /// Finds which mover every pixel's centre shows; gives the visible share of each person.
    fn draw(&mut self, movers: &[Mover]) -> Vec<f64> {
        let people = self.world.people_count();
        let mut alone = vec![0u32; people];
        let canvas = &mut self.canvas;
        for (n, mover) in movers.iter().enumerate() {
            canvas.stamp += 1;
            for part in 0..mover.parts() {
                for pixel in self.rays.window(&self.still.stand, &mover.part_bound(part)) {
                    let ray = self.still.stand.room_from_body(self.rays.ray(pixel, 0.0, 0.0));
                    let Some(hit) = mover.hit_part(part, &ray, f32::INFINITY) else { continue };
                    if canvas.counted[pixel] != canvas.stamp {
                        canvas.counted[pixel] = canvas.stamp;
                        if let (Some(person), true) = (mover.person_index(), self.rays.is_nominal[pixel]) {
                            alone[person] += 1;
                        }
                    }
                    if hit.t < self.still.depth[pixel].min(canvas.depth[pixel]) {
                        if canvas.key[pixel] == 0 {
                            canvas.touched.push(pixel as u32);
                        }
                        canvas.depth[pixel] = hit.t;
                        canvas.shown[pixel] = (n as u16, part as u16);
                        canvas.key[pixel] = mover.key(&hit, &ray);
                    }
                }
            }
        }
        let mut seen = vec![0u32; people];
        for pixel in canvas.touched.iter().map(|p| *p as usize).filter(|p| self.rays.is_nominal[*p]) {
            if let Some(person) = movers[usize::from(canvas.shown[pixel].0)].person_index() {
                seen[person] += 1;
            }
        }
        seen.iter().zip(alone).map(|(s, a)| if a == 0 { 0.0 } else { f64::from(*s) / f64::from(a) }).collect()
    }

    /// Gives the movers' pixels their light: one sample inside, sixteen where a pixel shows an edge.
    fn paint(&mut self, movers: &[Mover], strength: &light::PerLamp) {
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
        strength: &light::PerLamp,
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
        let mut open: Vec<Option<light::PerLamp>> = vec![None; movers.len()];
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

    fn clear(&mut self) {
        let canvas = &mut self.canvas;
        for pixel in canvas.touched.drain(..).map(|p| p as usize) {
            canvas.key[pixel] = 0;
            canvas.depth[pixel] = f32::INFINITY;
        }
    }
}

#[cfg(test)]
mod tests;
