//! What stands still, as one camera sees it: room, furniture and standing robots, with the light of each lamp kept apart.
//! Worked out once while the camera stands, and for every picture while it drives.

use super::light::Caster;
use super::rays::{Rays, Stand};
use super::scene::{Glow, Scene};
use crate::world::MAX_LAMPS;
use crate::world::body::Body;
use crate::world::vector::{Ray, V3};

/// Sectors of bearing by which solids are sorted.
const SECTORS: usize = 256;
/// Where the samples of an edge pixel lie: all columns and all rows of a 16 × 16 grid once, so that an edge of any direction
/// is placed to a sixteenth of a pixel.
pub const EDGE_SAMPLES: [[f32; 2]; 16] = rooks();

const fn rooks() -> [[f32; 2]; 16] {
    let mut out = [[0.0; 2]; 16];
    let mut i = 0;
    while i < 16 {
        let reversed = ((i & 1) << 3) | ((i & 2) << 1) | ((i & 4) >> 1) | ((i & 8) >> 3);
        out[i] = [(i as f32 + 0.5) / 16.0 - 0.5, (reversed as f32 + 0.5) / 16.0 - 0.5];
        i += 1;
    }
    out
}

/// Four samples for an edge, each in its own column and row.
pub const FEW_SAMPLES: [[f32; 2]; 4] = [[-0.375, -0.125], [-0.125, 0.375], [0.125, -0.375], [0.375, 0.125]];

/// Samples of a pixel that shows one surface.
const INNER_SAMPLES: [[f32; 2]; 4] = [[-0.25, -0.25], [0.25, -0.25], [-0.25, 0.25], [0.25, 0.25]];

/// What a ray meets first of all that stands still.
#[derive(Debug, Clone, Copy)]
pub struct StillHit {
    /// Along the ray.
    pub t: f32,
    /// Patch, or robot part and ring: different where a pixel would show an edge.
    pub key: u32,
    robot: Option<(usize, usize, V3)>,
    patch: usize,
}

/// Everything that stands still around one camera.
pub struct Still<'a> {
    scene: &'a Scene,
    stand: Stand,
    casters: &'a [Caster],
    blocks_in: Vec<Vec<u16>>,
    robots_in: Vec<Vec<u16>>,
}

impl<'a> Still<'a> {
    /// `casters`: the standing robots, without the observer.
    pub fn new(scene: &'a Scene, stand: Stand, casters: &'a [Caster]) -> Self {
        let mut still =
            Self { scene, stand, casters, blocks_in: vec![Vec::new(); SECTORS], robots_in: vec![Vec::new(); SECTORS] };
        for (n, block) in scene.blocks().iter().enumerate() {
            let (dx, dy) = (block.centre.x - stand.x, block.centre.y - stand.y);
            fill(&mut still.blocks_in, dx, dy, block.circle(), n as u16);
        }
        for (n, caster) in casters.iter().enumerate() {
            let b = &caster.bound;
            fill(&mut still.robots_in, b.x - stand.x, b.y - stand.y, b.radius, n as u16);
        }
        still
    }

    /// What a ray of the room meets; `bearing` is that of its pixel in the body frame.
    #[inline]
    pub fn hit(&self, ray: &Ray, bearing: f32) -> StillHit {
        let sector = sector(bearing + self.stand.heading);
        let (t, patch) = self.scene.hit(ray, &self.blocks_in[sector]);
        let mut hit = StillHit { t, key: patch as u32, robot: None, patch };
        for n in &self.robots_in[sector] {
            let Some(body) = &self.casters[usize::from(*n)].robot else { continue };
            for part in 0..body.parts() {
                if let Some((t, normal)) = body.hit(part, ray, hit.t) {
                    hit.t = t;
                    hit.robot = Some((usize::from(*n), part, normal));
                    hit.key = robot_key(usize::from(*n), part, body.zone(part, ray.at(t), normal));
                }
            }
        }
        hit
    }

    /// What it sends to the camera; `pixel_rad` is the size of the sample.
    #[inline]
    pub fn glow(&self, hit: &StillHit, ray: &Ray, pixel_rad: f32) -> Glow {
        let p = ray.at(hit.t);
        let (mut glow, own) = self.bare_glow(hit, ray, pixel_rad);
        for k in 0..self.scene.lights().count() {
            let lamp = self.scene.lights().position(k);
            for (n, caster) in self.casters.iter().enumerate() {
                if n != own {
                    glow.lamps[k] *= 1.0 - caster.shade(p, lamp);
                }
            }
        }
        glow
    }

    /// As [`Self::glow`] without the shadows of robots, and which robot it is.
    #[inline]
    fn bare_glow(&self, hit: &StillHit, ray: &Ray, pixel_rad: f32) -> (Glow, usize) {
        let p = ray.at(hit.t);
        match hit.robot {
            Some((n, part, normal)) => {
                let reflectance = self.casters[n].robot.as_ref().map_or(0.0, |body| body.reflectance(part, p, normal));
                (robot_glow(self.scene, reflectance, p, normal), n)
            }
            None => {
                let facing = ray.direction.dot(self.scene.normal(hit.patch)).abs().max(0.02);
                (self.scene.glow(hit.patch, p, hit.t * pixel_rad / facing.sqrt()), usize::MAX)
            }
        }
    }
}

/// Keys of robots begin here.
pub const ROBOT_KEYS: u32 = 0x100_0000;

/// A ball round the points of some pixels.
fn ball(pixels: &[u32], points: &[V3]) -> (V3, f32) {
    let share = 1.0 / pixels.len().max(1) as f32;
    let middle = pixels.iter().fold(V3::default(), |sum, p| sum + points[*p as usize] * share);
    (middle, pixels.iter().map(|p| (points[*p as usize] - middle).length()).fold(0.0, f32::max))
}

/// Distinguishes the painted parts of robots.
pub fn robot_key(robot: usize, part: usize, zone: u32) -> u32 {
    ROBOT_KEYS + ((robot as u32) << 12) + ((part as u32) << 8) + zone
}

/// Robot and part of a key.
pub fn robot_of(key: u32) -> Option<(usize, usize)> {
    let key = key.checked_sub(ROBOT_KEYS).filter(|_| key != u32::MAX)?;
    Some(((key >> 12) as usize, (key >> 8 & 15) as usize))
}

/// What a point on a robot sends to the camera, nobody's shadow on it.
#[inline]
pub fn robot_glow(scene: &Scene, reflectance: f32, p: V3, normal: V3) -> Glow {
    let mut glow = Glow { ambient: reflectance * scene.lights().ambient(normal), lamps: [0.0; MAX_LAMPS] };
    for k in 0..scene.lights().count() {
        glow.lamps[k] = reflectance * scene.lights().direct(k, p, normal);
    }
    glow
}

/// A robot's solids as something that throws shadows.
pub fn robot_caster(number: u16, robot: Body) -> Caster {
    Caster {
        body: number,
        bound: robot.outer_bound(),
        capsules: Vec::new(),
        uprights: robot.shades(),
        robot: Some(robot),
    }
}

fn sector(bearing: f32) -> usize {
    let turn = bearing / std::f32::consts::TAU;
    (((turn - turn.floor()) * SECTORS as f32) as usize).min(SECTORS - 1)
}

/// Puts `n` into every sector that a circle at (dx, dy) touches.
fn fill(sectors: &mut [Vec<u16>], dx: f32, dy: f32, radius: f32, n: u16) {
    let distance = dx.hypot(dy);
    let half = if distance > radius * 1.02 { (radius * 1.01 / distance).asin() } else { std::f32::consts::PI };
    let step = std::f32::consts::TAU / SECTORS as f32;
    let span = ((half / step).ceil() as i64 + 1).min(SECTORS as i64 / 2);
    let middle = sector(dy.atan2(dx)) as i64;
    for i in -span..=span {
        let sector = &mut sectors[(middle + i).rem_euclid(SECTORS as i64) as usize];
        if sector.last() != Some(&n) {
            sector.push(n);
        }
    }
}

/// The picture of everything that stands still.
pub struct StillPicture {
    /// From where.
    pub stand: Stand,
    /// Through the pixels' centres, in the room.
    pub ray: Vec<Ray>,
    /// To the first surface along them.
    pub depth: Vec<f32>,
    /// Of that surface.
    pub point: Vec<V3>,
    /// Its key.
    pub key: Vec<u32>,
    /// Mean over the pixel.
    pub glow: Vec<Glow>,
    /// Whether more than one surface shows in the pixel.
    pub mixed: Vec<bool>,
    /// Middle and radius of the ball round all points of each tile of pixels.
    pub balls: Vec<(V3, f32)>,
    /// Whether the standing robots' shadows are in `glow`.
    pub is_fine: bool,
}

impl StillPicture {
    /// Room for a camera's pixels.
    pub fn new(rays: &Rays, stand: Stand) -> Self {
        let n = rays.width * rays.height;
        Self {
            stand,
            ray: vec![Ray { origin: V3::default(), direction: V3::default() }; n],
            depth: vec![f32::INFINITY; n],
            point: vec![V3::default(); n],
            key: vec![u32::MAX; n],
            glow: vec![Glow::default(); n],
            mixed: vec![false; n],
            balls: Vec::new(),
            is_fine: false,
        }
    }

    /// Works the picture out; `fine` takes several samples also where a pixel shows one surface, and adds the shadows of
    /// the standing robots.
    pub fn fill(&mut self, still: &Still<'_>, rays: &Rays, fine: bool) {
        self.stand = still.stand;
        self.is_fine = fine;
        let pixel_rad = rays.pixel_rad;
        for pixel in rays.lit.iter().map(|p| *p as usize) {
            let ray = still.stand.room_from_body(rays.ray(pixel, 0.0, 0.0));
            let hit = still.hit(&ray, rays.bearing[pixel]);
            self.ray[pixel] = ray;
            self.depth[pixel] = hit.t;
            self.point[pixel] = ray.at(hit.t);
            self.key[pixel] = hit.key;
            if !fine {
                self.glow[pixel] = still.bare_glow(&hit, &ray, pixel_rad).0;
            }
        }
        self.balls.clear();
        self.balls.extend(rays.tiles.iter().map(|tile| ball(tile, &self.point)));
        for pixel in rays.lit.iter().map(|p| *p as usize) {
            self.mixed[pixel] =
                rays.neighbours(pixel).into_iter().any(|n| rays.is_lit[n] && self.key[n] != self.key[pixel]);
            let samples: &[[f32; 2]] = match (self.mixed[pixel], fine) {
                (true, _) => &EDGE_SAMPLES,
                (false, true) => &INNER_SAMPLES,
                (false, false) => continue,
            };
            let mut sum = Glow::default();
            let share = 1.0 / samples.len() as f32;
            for [du, dv] in samples {
                let ray = still.stand.room_from_body(rays.ray(pixel, *du, *dv));
                let hit = still.hit(&ray, rays.bearing[pixel]);
                let glow = if fine {
                    still.glow(&hit, &ray, 0.5 * pixel_rad)
                } else {
                    still.bare_glow(&hit, &ray, 0.5 * pixel_rad).0
                };
                sum.add(&glow, share);
            }
            self.glow[pixel] = sum;
        }
    }

    /// Whether a standing robot is in the pixel or beside it.
    pub fn shows_robot(&self, rays: &Rays, pixel: usize) -> bool {
        let is_robot = |p: usize| rays.is_lit[p] && self.key[p] >= ROBOT_KEYS && self.key[p] != u32::MAX;
        is_robot(pixel) || rays.neighbours(pixel).into_iter().any(is_robot)
    }
}
