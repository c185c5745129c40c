//! Pictures of the world as the robots' PAL cameras take them: solid geometry, light and glass.
//!
//! The mirrors are traced once a camera ([`rays`]); the room is painted and lit once ([`scene`]); what stands still is drawn
//! once while a camera stands ([`still`]); every picture adds what moves, its shadows, flicker, blur and noise. All of it is
//! a function of (world, robot, time): the same instant gives the same bytes.
//!
//! Nothing here uses the team's frames, markers or camera models: this is the physics that they are tested against.

pub mod bench;
mod camouflage;
pub mod eyes;
mod kept;
pub mod light;
pub mod moving;
mod paint;
pub mod pal;
mod patch;
pub mod presence;
pub mod rays;
pub mod scene;
pub mod sensor;
pub mod still;
pub mod surface;

use std::io;
use std::path::Path;
use std::sync::Arc;

use crate::scenario::Scenario;
use crate::world::body::Body;
use crate::world::wardrobe::Clothes;
use crate::world::{PersonState, RobotState, State, World};
use eyes::Turn;
use kept::Kept;
use light::Caster;
use moving::Mover;
use rays::{Rays, Stand};
use scene::Scene;
use sensor::Sensor;
use still::{Still, StillPicture};

/// Grey level of the light that all but [`BRIGHTEST_SHARE`] of the pixels stay below.
const FULL_GRAY: f32 = 215.0;
const BRIGHTEST_SHARE: f64 = 0.01;
/// The exposure is for directions up to this slope above and below the horizon (31°).
const EXPOSED_SLOPE: f32 = 0.6;

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
    /// Columns and rows that are drawn beyond each border of the picture.
    pad: usize,
    /// Of a camera that looks one way: half of how far, radians.
    half_field_rad: Option<f64>,
    /// Of a camera that turns.
    turn: Option<Turn>,
    /// A file of pictures that were rendered before.
    kept: Option<Kept>,
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
    /// A renderer for each robot, in the world's order, each with its camera's tilt. They share what can be shared.
    pub fn team(world: &Arc<World>) -> Vec<Self> {
        let scene = Arc::new(Scene::new(world));
        let mut traced: Vec<([f64; 2], Arc<Rays>)> = Vec::new();
        let mut team: Vec<Self> = Vec::new();
        for (n, robot) in world.robots().iter().enumerate() {
            if let Some(eye) = world.camera().other(&robot.id) {
                let mut renderer = Self::new(world, &scene, &Arc::new(eyes::rays(&eye, world.camera().height_m)), n);
                renderer.pad = eyes::PAD_PX;
                renderer.half_field_rad = eye.half_field_rad();
                renderer.turn = Turn::new(world, &scene, &eye, n);
                team.push(renderer);
                continue;
            }
            let tilt_deg = world.camera().tilt_deg(&robot.id);
            let known = traced.iter().find(|(tilt, _)| *tilt == tilt_deg).map(|(_, rays)| rays.clone());
            let rays = known.unwrap_or_else(|| Arc::new(Rays::trace_tilted(world.camera(), tilt_deg)));
            team.push(Self::new(world, &scene, &rays, n));
            traced.push((tilt_deg, rays));
        }
        let clothes: Arc<[Clothes]> = camouflage::dress(world, &mut team).into();
        team.iter_mut().for_each(|r| r.dress(&clothes));
        team
    }

    /// The first robot's place with another camera, whose rays are given.
    pub fn with_rays(world: &Arc<World>, rays: Rays) -> Self {
        let scene = Arc::new(Scene::new(world));
        let mut team = vec![Self::new(world, &scene, &Arc::new(rays), 0)];
        let clothes: Arc<[Clothes]> = camouflage::dress(world, &mut team).into();
        let mut renderer = team.remove(0);
        renderer.clothes = clothes;
        renderer
    }

    /// The first robot's camera, whose rays were traced before. Nobody is camouflaged.
    pub fn of_first(world: &Arc<World>, rays: &Arc<Rays>) -> Self {
        let mut renderer = Self::new(world, &Arc::new(Scene::new(world)), rays, 0);
        renderer.clothes = (0..world.people_count()).map(|n| *world.clothes(n)).collect();
        renderer
    }

    fn dress(&mut self, clothes: &Arc<[Clothes]>) {
        self.clothes = clothes.clone();
        self.turn.iter_mut().flat_map(Turn::renderers).for_each(|strip| strip.clothes = clothes.clone());
    }

    fn new(world: &Arc<World>, scene: &Arc<Scene>, rays: &Arc<Rays>, robot: usize) -> Self {
        let first = world.at(0.0);
        let standing = world
            .robots()
            .iter()
            .enumerate()
            .filter(|(n, r)| *n != robot && r.stands())
            .map(|(n, _)| still::robot_caster(n as u16 + 1, body_at(world, &first, n)))
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
            pad: 0,
            half_field_rad: None,
            turn: None,
            kept: None,
        };
        renderer.look_from(&first);
        renderer.expose();
        renderer
    }

    /// Keeps its pictures in a file in a folder, which must be there, and takes those that are in it: a world of this scenario is rendered
    /// once. A picture takes a byte a pixel there.
    pub fn keep_in(&mut self, folder: &Path, scenario: &Scenario) -> io::Result<()> {
        self.kept = Some(Kept::open(&kept::path(folder, scenario, self.world.seed(), self.robot)?)?);
        Ok(())
    }

    /// The picture at a true time.
    pub fn render(&mut self, time_s: f64) -> Picture {
        match self.kept.take() {
            Some(mut kept) => {
                let (size, people) = (self.size().map(|n| n as u32), self.world.people_count());
                let picture = kept.get(time_s, size, people, || self.picture(time_s));
                self.kept = Some(kept);
                picture
            }
            None => self.picture(time_s),
        }
    }

    /// Pixels a row, and rows.
    fn size(&self) -> [usize; 2] {
        [self.rays.width, self.rays.height].map(|n| n - 2 * self.pad)
    }

    fn picture(&mut self, time_s: f64) -> Picture {
        let counted = match &mut self.turn {
            Some(turn) => turn.expose(time_s, &mut self.canvas.light, self.world.people_count()),
            None => self.gather(time_s),
        };
        let visible_fraction = self.shares(&self.world.at(time_s), &counted);
        let [width, height] = self.size();
        let wide = self.sensor.develop(&self.canvas.light, self.rays.width, self.gain, time_s);
        let gray = if self.pad == 0 { wide } else { self.inner(&wide) };
        Picture { width: width as u32, height: height as u32, gray, visible_fraction }
    }

    /// A picture without what is drawn beyond its borders.
    fn inner(&self, wide: &[u8]) -> Vec<u8> {
        let [width, height] = self.size();
        let rows = wide.chunks_exact(self.rays.width).skip(self.pad).take(height);
        rows.flat_map(|row| &row[self.pad..self.pad + width]).copied().collect()
    }

    /// Lets the light of an instant fall on every pixel; of each person the pixels seen and those it would cover alone.
    fn gather(&mut self, time_s: f64) -> Vec<[u32; 2]> {
        let state = self.world.at(time_s);
        self.look_from(&state);
        let movers = self.movers(&state);
        // All light in units of that from everywhere.
        let strength = self.scene.lights().strength(time_s);
        let everywhere = self.scene.lights().ambient_strength(time_s);
        for pixel in self.rays.lit.iter().map(|p| *p as usize) {
            self.canvas.light[pixel] = self.still.glow[pixel].total(&strength);
        }
        self.throw_shadows(&movers, &strength);
        let counted = self.draw(&movers);
        self.paint(&movers, &strength);
        self.clear();
        if everywhere != 1.0 {
            self.canvas.light.iter_mut().for_each(|light| *light *= everywhere);
        }
        counted
    }

    /// Only the share of each person that is seen at a true time.
    pub fn visible_fraction(&mut self, time_s: f64) -> Vec<f64> {
        let state = self.world.at(time_s);
        self.look_from(&state);
        let movers = self.movers(&state);
        let counted = self.draw(&movers);
        self.clear();
        self.shares(&state, &counted)
    }

    /// Visible share of each person, from the pixels seen and those it would cover alone. A camera that looks one way does not
    /// see what is beyond its picture's sides.
    fn shares(&self, state: &State, counted: &[[u32; 2]]) -> Vec<f64> {
        let inside = |person: &PersonState| match self.half_field_rad {
            Some(half) => share_within(&state.robots[self.robot], person, half),
            None => 1.0,
        };
        let shares = counted.iter().zip(&state.people);
        shares
            .map(
                |([seen, alone], person)| {
                    if *alone == 0 { 0.0 } else { f64::from(*seen) / f64::from(*alone) * inside(person) }
                },
            )
            .collect()
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
        // For what stands about: a camera that sees the ceiling must not be blinded by its lamps.
        let about = |p: &&u32| self.rays.slope[**p as usize].abs() < EXPOSED_SLOPE;
        let mut pixels: Vec<u32> = self.rays.lit.iter().filter(about).copied().collect();
        if pixels.is_empty() {
            pixels.clone_from(&self.rays.lit);
        }
        let mut light: Vec<f32> = pixels.iter().map(|p| self.still.glow[*p as usize].total(&strength)).collect();
        light.sort_by(f32::total_cmp);
        let place = (light.len() as f64 * (1.0 - BRIGHTEST_SHARE)) as usize;
        let bright = light.get(place.min(light.len().saturating_sub(1))).copied().unwrap_or(1.0);
        self.gain = FULL_GRAY / bright.max(1e-6);
    }

    fn movers(&self, state: &State) -> Vec<Mover> {
        let robots = self.world.robots().iter().enumerate().filter(|(n, r)| *n != self.robot && !r.stands());
        let mut movers: Vec<Mover> = robots.map(|(n, _)| Mover::robot(n, body_at(&self.world, state, n))).collect();
        for (n, robot) in self.world.robots().iter().enumerate().filter(|(n, _)| *n != self.robot) {
            let at = &state.robots[n];
            let lamp = robot.blink.as_ref().map(|b| Mover::lamp(n, Body::lamp(at.x_m, at.y_m), b.is_lit(state.time_s)));
            movers.extend(lamp);
        }
        for (n, (person, clothes)) in state.people.iter().zip(self.clothes.iter()).enumerate() {
            let capsules = self.world.capsules(person);
            movers.push(Mover::person(n, &capsules, *clothes, person.heading_rad));
        }
        movers
    }

    /// Finds which mover every pixel's centre shows; of each person the pixels seen and those it would cover alone.
    fn draw(&mut self, movers: &[Mover]) -> Vec<[u32; 2]> {
        let mut counted = vec![[0u32; 2]; self.world.people_count()];
        let canvas = &mut self.canvas;
        for (n, mover) in movers.iter().enumerate() {
            canvas.stamp += 1;
            for part in 0..mover.parts() {
                for pixel in self.rays.window(&self.still.stand, &mover.part_bound(part)) {
                    let ray = self.still.ray[pixel];
                    let Some(hit) = mover.hit_part(part, &ray, f32::INFINITY) else { continue };
                    if canvas.counted[pixel] != canvas.stamp {
                        canvas.counted[pixel] = canvas.stamp;
                        if let (Some(person), true) = (mover.person_index(), self.rays.is_nominal[pixel]) {
                            counted[person][1] += 1;
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
        for pixel in canvas.touched.iter().map(|p| *p as usize).filter(|p| self.rays.is_nominal[*p]) {
            if let Some(person) = movers[usize::from(canvas.shown[pixel].0)].person_index() {
                counted[person][0] += 1;
            }
        }
        counted
    }

    /// Forgets what moved.
    fn clear(&mut self) {
        let canvas = &mut self.canvas;
        for pixel in canvas.touched.drain(..).map(|p| p as usize) {
            canvas.key[pixel] = 0;
            canvas.depth[pixel] = f32::INFINITY;
        }
    }
}

/// Share of a person's breadth that is within so much of straight ahead, radians.
fn share_within(robot: &RobotState, person: &PersonState, half_rad: f64) -> f64 {
    /// Half of the breadth of shoulders.
    const HALF_M: f64 = 0.22;
    let (dx, dy) = (person.x_m - robot.x_m, person.y_m - robot.y_m);
    let (sin, cos) = robot.heading_rad.sin_cos();
    let bearing = (cos * dy - sin * dx).atan2(cos * dx + sin * dy);
    let half_person = (HALF_M / dx.hypot(dy).max(HALF_M)).asin();
    ((half_rad - (bearing.abs() - half_person)) / (2.0 * half_person)).clamp(0.0, 1.0)
}

/// A robot's body where it stands.
fn body_at(world: &World, state: &State, n: usize) -> Body {
    let at = &state.robots[n];
    Body::new(&world.robots()[n].wear, at.x_m, at.y_m, at.heading_rad, world.camera().height_m)
}

#[cfg(test)]
mod tests;
