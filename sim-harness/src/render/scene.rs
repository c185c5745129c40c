//! The room and its furniture as patches: flat rectangles whose paint and light are worked out once, for all cameras.
//! A camera's picture of a patch is then two look-ups.

use super::light::{Lights, PerLamp};
use crate::world::solid::{Block, FACES};
use crate::world::texture::Paint;
use crate::world::vector::{Ray, V3, v3};
use crate::world::{MAX_LAMPS, World};

/// Edge of a texel of paint.
const PAINT_TEXEL_M: f32 = 0.01;
/// Edge of a texel of light.
const LIGHT_TEXEL_M: f32 = 0.06;
/// Coarser copies of the paint, each of twice the texel.
const LEVELS: usize = 5;

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

#[derive(Debug)]
struct Patch {
    levels: Vec<Map<f32>>,
    light: Map<Glow>,
}

/// Values on a grid over a patch.
#[derive(Debug)]
struct Map<T> {
    columns: usize,
    rows: usize,
    /// Grid steps a metre along u and v, and the place of the first value on the grid.
    scale: [f32; 2],
    first: f32,
    values: Vec<T>,
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
            lights: Lights::new(world.lamps(), world.ambient(), f64::from(z)),
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
        let scale = |columns: usize, rows: usize| [columns as f32 / size[0], rows as f32 / size[1]];
        let mut levels = vec![Map { columns, rows, scale: scale(columns, rows), first: 0.5, values: finest }];
        while levels.len() < LEVELS {
            let coarser = levels[levels.len() - 1].halved(size);
            levels.push(coarser);
        }
        let light = Map {
            columns: light_columns,
            rows: light_rows,
            scale: scale(light_columns - 1, light_rows - 1),
            first: 0.0,
            values: light,
        };
        self.patches.push(Patch { levels, light });
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

impl Map<f32> {
    fn halved(&self, size: [f32; 2]) -> Self {
        let (columns, rows) = (self.columns.div_ceil(2), self.rows.div_ceil(2));
        let at = |i: usize, j: usize| self.values[j.min(self.rows - 1) * self.columns + i.min(self.columns - 1)];
        let values = (0..columns * rows)
            .map(|n| {
                let (i, j) = (2 * (n % columns), 2 * (n / columns));
                0.25 * (at(i, j) + at(i + 1, j) + at(i, j + 1) + at(i + 1, j + 1))
            })
            .collect();
        Self { columns, rows, scale: [columns as f32 / size[0], rows as f32 / size[1]], first: 0.5, values }
    }
}

impl<T> Map<T> {
    /// The four values round a place and their weights.
    #[inline(always)]
    fn around(&self, u: f32, v: f32) -> [(&T, f32); 4] {
        let x = (u * self.scale[0] - self.first).clamp(0.0, (self.columns - 1) as f32);
        let y = (v * self.scale[1] - self.first).clamp(0.0, (self.rows - 1) as f32);
        let (i, j) = (x as usize, y as usize);
        let (fx, fy) = (x - i as f32, y - j as f32);
        let right = usize::from(i + 1 < self.columns);
        let at = j * self.columns + i;
        let up = if j + 1 < self.rows { at + self.columns } else { at };
        [
            (&self.values[at], (1.0 - fx) * (1.0 - fy)),
            (&self.values[at + right], fx * (1.0 - fy)),
            (&self.values[up], (1.0 - fx) * fy),
            (&self.values[up + right], fx * fy),
        ]
    }
}

impl Patch {
    #[inline(always)]
    fn paint(&self, u: f32, v: f32, blur_m: f32) -> f32 {
        let mut level = 0;
        let mut texel = 1.5 * PAINT_TEXEL_M;
        while blur_m > texel && level + 1 < LEVELS {
            level += 1;
            texel *= 2.0;
        }
        self.levels[level].around(u, v).into_iter().map(|(value, weight)| value * weight).sum()
    }

    #[inline(always)]
    fn light_at(&self, u: f32, v: f32) -> Glow {
        let mut glow = Glow::default();
        for (light, weight) in self.light.around(u, v) {
            glow.add(light, weight);
        }
        glow
    }
}
