//! The room and its furniture as patches: flat rectangles whose paint and light are worked out once, for all cameras.
//! A camera's picture of a patch is then two look-ups.

use super::light::{Lights, PerLamp};
use super::patch::{Map, PAINT_TEXEL_M, Patch};
use crate::world::solid::{Block, FACES};
use crate::world::texture::Paint;
use crate::world::vector::{Ray, V3, v3};
use crate::world::{MAX_LAMPS, World};

/// Edge of a texel of light.
const LIGHT_TEXEL_M: f32 = 0.06;

/// Light that leaves a surface towards the camera, by where it came from, per unit of lamp strength.
#[derive(Debug, Clone, Copy, Default)]
pub struct Glow {
    /// From everywhere.
    pub ambient: f32,
    /// From each lamp.
    pub lamps: PerLamp,
}

impl Glow {
    /// Adds a share of another.
    #[inline(always)]
    pub fn add(&mut self, other: &Self, share: f32) {
        self.ambient += share * other.ambient;
        for k in 0..MAX_LAMPS {
            self.lamps[k] += share * other.lamps[k];
        }
    }

    /// Sum under these lamp strengths.
    #[inline(always)]
    pub fn total(&self, strength: &PerLamp) -> f32 {
        self.lamps.iter().zip(strength).fold(self.ambient, |sum, (lamp, strength)| sum + lamp * strength)
    }
}

/// All that never moves, painted and lit.
#[derive(Debug)]
pub struct Scene {
    half: [f32; 2],
    height: f32,
    blocks: Vec<Block>,
    patches: Vec<Patch>,
    lights: Lights,
}

impl Scene {
    /// Paints and lights the room of a world.
    pub fn new(world: &World) -> Self {
        let [x, y, z] = world.room_size_m().map(|s| s as f32);
        let mut scene = Self {
            half: [x / 2.0, y / 2.0],
            height: z,
            blocks: world.blocks().iter().map(|b| b.block).collect(),
            patches: Vec::new(),
            lights: Lights::new(world.lamps(), world.ambient(), world.ambient_light(), f64::from(z)),
        };
        let seed = world.seed() as u32 ^ (world.seed() >> 32) as u32;
        for face in 0..FACES {
            let size = match face / 2 {
                0 => [y, z],
                1 => [x, z],
                _ => [x, y],
            };
            let seed = seed ^ (0x1000 + face as u32);
            let paint = |u: f32, v: f32| {
                let hanging = world.hangings().iter().rev().find(|h| {
                    h.wall == face
                        && u >= h.corner[0]
                        && v >= h.corner[1]
                        && u < h.corner[0] + h.size[0]
                        && v < h.corner[1] + h.size[1]
                });
                match (hanging, face) {
                    (Some(h), _) => h.paint.reflectance(seed, u - h.corner[0], v - h.corner[1], h.size),
                    (None, 4) => Paint::Panels(0.78).reflectance(seed, u, v, size),
                    (None, 5) => Paint::Carpet(0.30).reflectance(seed, u, v, size),
                    // Walls have a skirting board, and each its own tone.
                    (None, _) if v < 0.08 => 0.22,
                    (None, n) => Paint::Plaster([0.62, 0.56, 0.66, 0.52][n % 4]).reflectance(seed, u, v, size),
                }
            };
            scene.bake(face, size, &paint);
        }
        for (n, block) in world.blocks().iter().enumerate() {
            let h = block.block.half * 2.0;
            for face in 0..FACES {
                let size = match face / 2 {
                    0 => [h.y, h.z],
                    1 => [h.x, h.z],
                    _ => [h.x, h.y],
                };
                let seed = seed ^ (0x2000 + 31 * n as u32 + face as u32);
                let paint = block.paint[face];
                scene.bake(FACES * (n + 1) + face, size, &|u, v| paint.reflectance(seed, u, v, size));
            }
        }
        scene
    }

    /// The lamps.
    pub fn lights(&self) -> &Lights {
        &self.lights
    }

    /// Furniture.
    pub fn blocks(&self) -> &[Block] {
        &self.blocks
    }

    /// Nearest meeting of a ray from inside the room with walls and these blocks: distance and patch.
    #[inline]
    pub fn hit(&self, ray: &Ray, candidates: &[u16]) -> (f32, usize) {
        let (o, d) = (ray.origin, ray.direction);
        let along = |o: f32, d: f32, half: f32| if d > 0.0 { (half - o) / d } else { (-half - o) / d };
        let (tx, ty) = (along(o.x, d.x, self.half[0]), along(o.y, d.y, self.half[1]));
        let tz = if d.z > 0.0 { (self.height - o.z) / d.z } else { -o.z / d.z };
        let mut best = if tx < ty && tx < tz {
            (tx, usize::from(d.x < 0.0))
        } else if ty < tz {
            (ty, 2 + usize::from(d.y < 0.0))
        } else {
            (tz, 4 + usize::from(d.z < 0.0))
        };
        for b in candidates {
            if let Some((t, face)) = self.blocks[usize::from(*b)].hit(ray, best.0) {
                best = (t, FACES * (usize::from(*b) + 1) + face);
            }
        }
        best
    }

    /// What a patch sends to the camera from a point on it; `blur_m` is the size of a pixel there.
    #[inline]
    pub fn glow(&self, patch: usize, p: V3, blur_m: f32) -> Glow {
        let (u, v) = self.surface(patch, p);
        let patch = &self.patches[patch];
        let paint = patch.paint(u, v, blur_m);
        let light = patch.light_at(u, v);
        let mut glow = Glow::default();
        glow.add(&light, paint);
        glow
    }

    /// Outer normal of a patch (into the room for walls).
    pub fn normal(&self, patch: usize) -> V3 {
        match patch {
            0 => v3(-1.0, 0.0, 0.0),
            1 => v3(1.0, 0.0, 0.0),
            2 => v3(0.0, -1.0, 0.0),
            3 => v3(0.0, 1.0, 0.0),
            4 => v3(0.0, 0.0, -1.0),
            5 => v3(0.0, 0.0, 1.0),
            n => self.blocks[n / FACES - 1].normal(n % FACES),
        }
    }

    #[inline(always)]
    fn surface(&self, patch: usize, p: V3) -> (f32, f32) {
        let (q, half, low) = if patch < FACES {
            (p, v3(self.half[0], self.half[1], 0.0), 0.0)
        } else {
            let block = &self.blocks[patch / FACES - 1];
            (block.local(p), block.half, block.half.z)
        };
        match patch % FACES / 2 {
            0 => (q.y + half.y, q.z + low),
            1 => (q.x + half.x, q.z + low),
            _ => (q.x + half.x, q.y + half.y),
        }
    }

    fn point(&self, patch: usize, u: f32, v: f32) -> V3 {
        if patch < FACES {
            let [x, y] = self.half;
            return match patch {
                0 => v3(x, u - y, v),
                1 => v3(-x, u - y, v),
                2 => v3(u - x, y, v),
                3 => v3(u - x, -y, v),
                4 => v3(u - x, v - y, self.height),
                _ => v3(u - x, v - y, 0.0),
            };
        }
        let block = &self.blocks[patch / FACES - 1];
        let (h, face) = (block.half, patch % FACES);
        let side = if face.is_multiple_of(2) { 1.0 } else { -1.0 };
        let own = match face / 2 {
            0 => v3(side * h.x, u - h.y, v - h.z),
            1 => v3(u - h.x, side * h.y, v - h.z),
            _ => v3(u - h.x, v - h.y, side * h.z),
        };
        block.centre + own.turned(block.turn[0], block.turn[1])
    }

    fn bake(&mut self, patch: usize, size: [f32; 2], paint: &dyn Fn(f32, f32) -> f32) {
        let count = |length: f32, texel: f32| ((length / texel).ceil() as usize).max(1);
        let (columns, rows) = (count(size[0], PAINT_TEXEL_M), count(size[1], PAINT_TEXEL_M));
        let place = |i: usize, n: usize, length: f32| (i as f32 + 0.5) / n as f32 * length;
        let mut finest = Vec::with_capacity(columns * rows);
        for j in 0..rows {
            finest.extend((0..columns).map(|i| paint(place(i, columns, size[0]), place(j, rows, size[1]))));
        }
        let (light_columns, light_rows) = (count(size[0], LIGHT_TEXEL_M) + 1, count(size[1], LIGHT_TEXEL_M) + 1);
        let normal = self.normal(patch);
        let mut light = Vec::with_capacity(light_columns * light_rows);
        for j in 0..light_rows {
            for i in 0..light_columns {
                // Light is kept at the corners of its texels, so that patches end where they end; a hair inside.
                let inside = |i: usize, n: usize| (i as f32 / (n - 1) as f32).clamp(0.002, 0.998);
                let (u, v) = (inside(i, light_columns) * size[0], inside(j, light_rows) * size[1]);
                let p = self.point(patch, u, v);
                light.push(Glow {
                    ambient: self.lights.ambient(normal) * corner_dusk(patch, u, v, size),
                    lamps: self.lights.past_blocks(p, normal, &self.blocks),
                });
            }
        }
        let light = Map::corners(light_columns, light_rows, size, light);
        self.patches.push(Patch::new(Map::middles(columns, rows, size, finest), light, size));
    }
}

/// Less light from everywhere near the corners of the room.
fn corner_dusk(patch: usize, u: f32, v: f32, size: [f32; 2]) -> f32 {
    if patch >= FACES {
        return 1.0;
    }
    let near = u.min(v).min(size[0] - u).min(size[1] - v);
    1.0 - 0.35 * (-near / 0.3).exp()
}
