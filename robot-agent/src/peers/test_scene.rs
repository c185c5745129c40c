//! A small renderer for the tests of this module: a furnished room through design D, straight from `MATHS.md` §3, by
//! supersampled rays. It shares no code with the optics or the detector.

use std::f64::consts::{PI, TAU};

pub const WIDTH: usize = 768;
pub const HEIGHT: usize = 576;
pub const CAMERA_HEIGHT_M: f64 = 0.6;

/// splitmix64: a named stream, the same on every machine.
pub struct Dice(pub u64);

impl Dice {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }
    pub fn normal(&mut self) -> f64 {
        (-2.0 * self.uniform(1e-12, 1.0).ln()).sqrt() * self.uniform(0.0, TAU).cos()
    }
}

/// Value noise in [0, 1]: texture of walls and clothes.
fn noise(seed: u64, x: f64, y: f64) -> f64 {
    let lattice = |i: i64, j: i64| {
        let mut dice = Dice(
            seed ^ (i as u64).wrapping_mul(0x1234_5678_9abc_def1) ^ (j as u64).wrapping_mul(0xfedc_ba98_7654_3211),
        );
        (dice.next() >> 40) as f64 / f64::from(1 << 24)
    };
    let (i, j) = (x.floor() as i64, y.floor() as i64);
    let (fx, fy) = (x - x.floor(), y - y.floor());
    let (sx, sy) = (fx * fx * (3.0 - 2.0 * fx), fy * fy * (3.0 - 2.0 * fy));
    let top = lattice(i, j) * (1.0 - sx) + lattice(i + 1, j) * sx;
    let bottom = lattice(i, j + 1) * (1.0 - sx) + lattice(i + 1, j + 1) * sx;
    top * (1.0 - sy) + bottom * sy
}

#[derive(Clone, Copy)]
pub enum Paint {
    /// The four announced rings, black below.
    Rings,
    /// The same with bars (middle and half width, degrees) on a robot of this heading, radians.
    Barred(f64, &'static [[f64; 2]]),
    Plain(f64),
    /// Texture of a seed: mean, amplitude, scale (1/m).
    Texture(u64, f64, f64, f64),
    /// Horizontal stripes: two reflectances and the period, metres.
    Stripes(f64, f64, f64),
}

impl Paint {
    fn at(&self, a: f64, z: f64) -> f64 {
        match *self {
            Paint::Rings => {
                if z < 0.1 {
                    0.3
                } else {
                    [0.85, 0.10, 0.85, 0.10][(((z - 0.1) / 0.1) as usize).min(3)]
                }
            }
            Paint::Barred(heading, bars) => {
                let ring = Paint::Rings.at(a, z);
                let azimuth = (a / 0.2 - heading).to_degrees();
                let apart = |bar: &[f64; 2]| ((azimuth - bar[0] + 180.0).rem_euclid(360.0) - 180.0).abs() < bar[1];
                if z >= 0.1 && bars.iter().any(apart) { 0.95 - ring } else { ring }
            }
            Paint::Plain(r) => r,
            Paint::Texture(seed, mean, amplitude, scale) => {
                let fine = noise(seed, a * scale, z * scale) - 0.5;
                let coarse = noise(seed ^ 77, a * scale * 0.2, z * scale * 0.2) - 0.5;
                (mean + amplitude * (fine + coarse)).clamp(0.02, 0.95)
            }
            Paint::Stripes(p, q, period) => {
                if (z / period).rem_euclid(1.0) < 0.5 {
                    p
                } else {
                    q
                }
            }
        }
    }
}

/// A vertical cylinder in the observer's body frame.
#[derive(Clone, Copy)]
pub struct Pillar {
    pub x_m: f64,
    pub y_m: f64,
    pub radius_m: f64,
    pub height_m: [f64; 2],
    pub side: Paint,
    pub top: f64,
}

pub struct Scene {
    pub pillars: Vec<Pillar>,
    /// Walls at x = ±, y = ± these, metres, the observer somewhere inside.
    pub walls_m: [f64; 4],
    pub lamps: Vec<[f64; 4]>,
    pub ambient: f64,
    pub seed: u64,
    /// Level of background texture, 0 plain to 1 busy.
    pub clutter: f64,
}

pub fn robot(x_m: f64, y_m: f64) -> Vec<Pillar> {
    vec![
        Pillar { x_m, y_m, radius_m: 0.2, height_m: [0.02, 0.5], side: Paint::Rings, top: 0.3 },
        Pillar { x_m, y_m, radius_m: 0.02, height_m: [0.5, 0.62], side: Paint::Plain(0.2), top: 0.2 },
    ]
}

pub fn person(x_m: f64, y_m: f64, heading: f64, seed: u64) -> Vec<Pillar> {
    let mut dice = Dice(seed);
    let (dx, dy) = (0.1 * heading.cos(), 0.1 * heading.sin());
    let clothes = |dice: &mut Dice| {
        if dice.uniform(0.0, 1.0) < 0.3 {
            Paint::Stripes(dice.uniform(0.05, 0.4), dice.uniform(0.5, 0.9), dice.uniform(0.08, 0.25))
        } else {
            Paint::Texture(dice.next(), dice.uniform(0.1, 0.7), 0.4, dice.uniform(5.0, 30.0))
        }
    };
    let (trousers, shirt) = (clothes(&mut dice), clothes(&mut dice));
    vec![
        Pillar { x_m: x_m + dx, y_m: y_m + dy, radius_m: 0.07, height_m: [0.0, 0.85], side: trousers, top: 0.3 },
        Pillar { x_m: x_m - dx, y_m: y_m - dy, radius_m: 0.07, height_m: [0.0, 0.85], side: trousers, top: 0.3 },
        Pillar { x_m, y_m, radius_m: 0.18, height_m: [0.8, 1.5], side: shirt, top: 0.3 },
        Pillar { x_m, y_m, radius_m: 0.1, height_m: [1.5, 1.75], side: Paint::Plain(0.5), top: 0.2 },
    ]
}

impl Scene {
    /// A room with lamps; everything but robots and people by the seed.
    pub fn room(seed: u64, clutter: f64) -> Self {
        let mut dice = Dice(seed);
        let walls_m = [0, 1, 2, 3].map(|_| dice.uniform(1.2, 7.0));
        let walls_m = [walls_m[0].max(7.5 - walls_m[1]), walls_m[1], walls_m[2].max(5.5 - walls_m[3]), walls_m[3]];
        let mut lamps = Vec::new();
        for _ in 0..3 {
            lamps.push([
                dice.uniform(-walls_m[1], walls_m[0]),
                dice.uniform(-walls_m[3], walls_m[2]),
                2.4,
                dice.uniform(0.5, 2.5),
            ]);
        }
        let mut pillars = Vec::new();
        for _ in 0..(6.0 * clutter) as usize {
            let (b, d) = (dice.uniform(-PI, PI), dice.uniform(2.5, 7.0));
            let side = Paint::Texture(dice.next(), dice.uniform(0.1, 0.8), 0.5, dice.uniform(3.0, 20.0));
            pillars.push(Pillar {
                x_m: d * b.cos(),
                y_m: d * b.sin(),
                radius_m: dice.uniform(0.05, 0.4),
                height_m: [0.0, dice.uniform(0.3, 2.0)],
                side,
                top: 0.5,
            });
        }
        Scene { pillars, walls_m, lamps, ambient: 0.25, seed, clutter }
    }

    /// The same room with its walls about this far away, metres.
    pub fn with_walls(self, m: f64) -> Self {
        Scene { walls_m: [m, m + 0.3, m - 0.1, m + 0.1], ..self }
    }

    fn light(&self, p: [f64; 3], n: [f64; 3]) -> f64 {
        let mut e = self.ambient;
        for lamp in &self.lamps {
            let d = [lamp[0] - p[0], lamp[1] - p[1], lamp[2] - p[2]];
            let r2 = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
            let c = (d[0] * n[0] + d[1] * n[1] + d[2] * n[2]).max(0.0) / r2.sqrt();
            e += lamp[3] * c / r2;
        }
        e
    }

    /// Radiance along a ray, grey levels.
    fn radiance(&self, o: [f64; 3], d: [f64; 3]) -> f64 {
        let at = |t: f64| [o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2]];
        // Walls and floor.
        let mut t = f64::INFINITY;
        let mut value = 0.0;
        let texture = |k: u64, a: f64, z: f64| {
            let fine = noise(self.seed ^ k, a * 9.0, z * 9.0) - 0.5;
            let coarse = noise(self.seed ^ k ^ 5, a * 1.3, z * 0.7) - 0.5;
            // Posters and doors: rectangles with sharp edges.
            let board = noise(self.seed ^ k ^ 9, (a * 0.8).floor() + 0.5, (z * 0.6).floor() + 0.5) - 0.5;
            (0.5 + self.clutter * (0.3 * fine + 0.4 * coarse + 0.7 * board)).clamp(0.03, 0.95)
        };
        for (k, wall) in self.walls_m.iter().enumerate() {
            let (axis, sign) = (k / 2, if k % 2 == 0 { 1.0 } else { -1.0 });
            let s = (sign * wall - o[axis]) / d[axis];
            if s > 0.0 && s < t {
                t = s;
                let p = at(s);
                let mut n = [0.0; 3];
                n[axis] = -sign;
                value = texture(k as u64 + 1, p[1 - axis], p[2]) * self.light(p, n);
            }
        }
        if d[2] < 0.0 {
            let s = -o[2] / d[2];
            if s < t {
                t = s;
                let p = at(s);
                value = texture(31, p[0], p[1]) * self.light(p, [0.0, 0.0, 1.0]);
            }
        }
        for pillar in &self.pillars {
            let (mx, my) = (o[0] - pillar.x_m, o[1] - pillar.y_m);
            let a = d[0] * d[0] + d[1] * d[1];
            let b = mx * d[0] + my * d[1];
            let c = mx * mx + my * my - pillar.radius_m * pillar.radius_m;
            let disc = b * b - a * c;
            if disc <= 0.0 {
                continue;
            }
            let s = (-b - disc.sqrt()) / a;
            let z = o[2] + s * d[2];
            if s > 0.0 && s < t && z >= pillar.height_m[0] && z <= pillar.height_m[1] {
                t = s;
                let p = at(s);
                let n = [(p[0] - pillar.x_m) / pillar.radius_m, (p[1] - pillar.y_m) / pillar.radius_m, 0.0];
                value = pillar.side.at(n[1].atan2(n[0]) * pillar.radius_m, z) * self.light(p, n);
            }
            if d[2] < 0.0 {
                let s = (pillar.height_m[1] - o[2]) / d[2];
                let p = at(s);
                if s > 0.0 && s < t && (p[0] - pillar.x_m).hypot(p[1] - pillar.y_m) <= pillar.radius_m {
                    t = s;
                    value = pillar.top * self.light(p, [0.0, 0.0, 1.0]);
                }
            }
        }
        190.0 * value
    }

    /// The picture: rays through the glass, lens blur of 0.8 px, sensor noise.
    pub fn picture(&self, noise_sigma: f64, seed: u64) -> Vec<u8> {
        const SUB: usize = 3;
        let mut sharp = vec![0.0f64; WIDTH * HEIGHT];
        for v in 0..HEIGHT {
            for u in 0..WIDTH {
                let r = (u as f64 - 383.5).hypot(v as f64 - 287.5);
                if !(155.0..274.0).contains(&r) {
                    continue;
                }
                let mut sum = 0.0;
                for i in 0..SUB * SUB {
                    let du = ((i % SUB) as f64 + 0.5) / SUB as f64 - 0.5;
                    let dv = ((i / SUB) as f64 + 0.5) / SUB as f64 - 0.5;
                    let (o, d) = ray(u as f64 + du - 383.5, v as f64 + dv - 287.5);
                    sum += self.radiance(o, d);
                }
                sharp[v * WIDTH + u] = sum / (SUB * SUB) as f64;
            }
        }
        let kernel: Vec<f64> = (-4..=4).map(|i| (-0.5 * f64::from(i * i) / 0.64).exp()).collect();
        let total: f64 = kernel.iter().sum();
        let blur = |from: &[f64], step: usize| {
            let mut to = vec![0.0; from.len()];
            for i in 4 * step..from.len() - 4 * step {
                to[i] = (0..9).map(|k| kernel[k] * from[i + k * step - 4 * step]).sum::<f64>() / total;
            }
            to
        };
        let soft = blur(&blur(&sharp, 1), WIDTH);
        let mut dice = Dice(seed ^ 0xabcdef);
        soft.iter()
            .enumerate()
            .map(|(i, g)| {
                let r = ((i % WIDTH) as f64 - 383.5).hypot((i / WIDTH) as f64 - 287.5);
                if (158.0..270.0).contains(&r) {
                    (g + noise_sigma * dice.normal()).round().clamp(0.0, 255.0) as u8
                } else {
                    0
                }
            })
            .collect()
    }
}

/// Design D, forward: image radius to the ray that leaves the glass (MATHS §3.1–3.3), lengths in metres, V at the camera's height.
fn ray(du: f64, dv: f64) -> ([f64; 3], [f64; 3]) {
    let (f, k, er, kappa, pr): (f64, f64, f64, f64, f64) = (751.849_545_07, 5.341_232_227_49, 0.6, 0.910_08, 20.0);
    let r = du.hypot(dv);
    let t = r / f;
    let zeta_in = 2.0 * (k * t / (1.0 + (1.0 + t * t).sqrt())).atan();
    let eta = zeta_in.sin().atan2(er + zeta_in.cos());
    let zeta = eta + (kappa * eta.sin()).asin();
    let dr = pr / (1.0 + er * zeta_in.cos());
    let (ro, zo) = (dr * zeta_in.sin() * 1e-3, dr * zeta_in.cos() * 1e-3);
    let (c, s) = (du / r, dv / r);
    ([ro * c, ro * s, zo + CAMERA_HEIGHT_M], [zeta.sin() * c, zeta.sin() * s, zeta.cos()])
}

/// The panorama of a picture by bilinear look-up of directions at infinity, 1080 × 162 over −15…+20°.
pub fn panorama(raw: &[u8]) -> Vec<u8> {
    let (top, bottom) = (20f64.to_radians().tan(), -(15f64.to_radians().tan()));
    let radius: Vec<f64> = (0..162)
        .map(|v| {
            let elevation = (top - (v as f64 + 0.5) * (top - bottom) / 162.0).atan();
            let (mut low, mut high) = (150.0, 280.0);
            for _ in 0..50 {
                let mid = 0.5 * (low + high);
                let (_, d) = ray(mid, 0.0);
                if d[2].atan2(d[0]) > elevation { low = mid } else { high = mid }
            }
            low
        })
        .collect();
    let mut out = Vec::with_capacity(1080 * 162);
    for r in &radius {
        for u in 0..1080 {
            let b = PI - TAU * (f64::from(u) + 0.5) / 1080.0;
            let (x, y) = (383.5 + r * b.cos(), 287.5 + r * b.sin());
            let (i, j) = (x as usize, y as usize);
            let (fx, fy) = (x - i as f64, y - j as f64);
            let g = |i: usize, j: usize| f64::from(raw[j * WIDTH + i]);
            let value = (g(i, j) * (1.0 - fx) + g(i + 1, j) * fx) * (1.0 - fy)
                + (g(i, j + 1) * (1.0 - fx) + g(i + 1, j + 1) * fx) * fy;
            out.push(value.round() as u8);
        }
    }
    out
}
