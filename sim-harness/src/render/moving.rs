//! What moves: people and driving robots, drawn over the picture of what stands still, with their shadows.

use super::light::{Caster, PerLamp, Shade};
use super::scene::{Glow, Scene};
use super::still::{robot_caster, robot_glow, robot_key};
use crate::world::MAX_LAMPS;
use crate::world::body::Body;
use crate::world::person::{COVERS, PARTS};
use crate::world::solid::{Capsule, Upright};
use crate::world::vector::{Ray, V3, v3};
use crate::world::wardrobe::Clothes;

/// Body numbers of people begin here; robots are numbered from 1.
pub const FIRST_PERSON: u16 = 0x100;

/// Somebody or something that moves.
#[derive(Debug, Clone)]
pub struct Mover {
    /// Shape.
    pub caster: Caster,
    clothes: Option<Clothes>,
    turn: [f32; 2],
    /// A lamp that is lit.
    is_lit: bool,
}

/// Where a ray meets a mover.
#[derive(Debug, Clone, Copy)]
pub struct MoverHit {
    /// Along the ray.
    pub t: f32,
    part: usize,
    normal: Option<V3>,
}

impl Mover {
    /// A driving robot.
    pub fn robot(index: usize, body: Body) -> Self {
        Self { caster: robot_caster(index as u16 + 1, body), clothes: None, turn: [1.0, 0.0], is_lit: false }
    }

    /// The lamp above a robot. It throws no shadow.
    pub fn lamp(index: usize, body: Body, is_lit: bool) -> Self {
        let caster = Caster { uprights: Vec::new(), ..robot_caster(index as u16 + 1, body) };
        Self { caster, clothes: None, turn: [1.0, 0.0], is_lit }
    }

    /// A person.
    pub fn person(index: usize, capsules: &[Capsule; PARTS], clothes: Clothes, heading_rad: f64) -> Self {
        let bound = round(capsules);
        let caster = Caster {
            body: FIRST_PERSON + index as u16,
            bound,
            capsules: capsules.to_vec(),
            uprights: Vec::new(),
            robot: None,
        };
        Self {
            caster,
            clothes: Some(clothes),
            turn: [heading_rad.cos() as f32, heading_rad.sin() as f32],
            is_lit: false,
        }
    }

    /// Which person it is.
    pub fn person_index(&self) -> Option<usize> {
        self.caster.body.checked_sub(FIRST_PERSON).map(usize::from)
    }

    /// Number of parts.
    pub fn parts(&self) -> usize {
        self.caster.robot.as_ref().map_or(self.caster.capsules.len(), Body::parts)
    }

    /// The upright cylinder round a part.
    pub fn part_bound(&self, part: usize) -> Upright {
        match self.caster.capsules.get(part) {
            Some(c) => Upright {
                x: 0.5 * (c.a.x + c.b.x),
                y: 0.5 * (c.a.y + c.b.y),
                radius: 0.5 * (c.a.x - c.b.x).hypot(c.a.y - c.b.y) + c.radius,
                low: c.a.z.min(c.b.z) - c.radius,
                high: c.a.z.max(c.b.z) + c.radius,
            },
            None => self.caster.robot.as_ref().map_or(self.caster.bound, |body| body.bound(part)),
        }
    }

    /// Meeting of one part with a ray of the room, nearer than `limit`.
    #[inline]
    pub fn hit_part(&self, part: usize, ray: &Ray, limit: f32) -> Option<MoverHit> {
        match self.caster.capsules.get(part) {
            Some(capsule) => capsule.hit(ray, limit).map(|t| MoverHit { t, part, normal: None }),
            None => {
                let body = self.caster.robot.as_ref()?;
                body.hit(part, ray, limit).map(|(t, normal)| MoverHit { t, part, normal: Some(normal) })
            }
        }
    }

    /// Calls `each` with the parts that come within an angle of `spread_rad` of a ray.
    pub fn near_parts(&self, ray: &Ray, spread_rad: f32, mut each: impl FnMut(usize)) {
        let bound = &self.caster.bound;
        let distance = (bound.x - ray.origin.x).hypot(bound.y - ray.origin.y);
        let grown = (distance + bound.radius) * spread_rad;
        let round =
            Upright { radius: bound.radius + grown, low: bound.low - grown, high: bound.high + grown, ..*bound };
        if distance > round.radius && round.hit(ray, f32::INFINITY).is_none() {
            return;
        }
        for part in 0..self.parts() {
            let meets = match self.caster.capsules.get(part) {
                Some(c) => Capsule { radius: c.radius + grown, ..*c }.hit(ray, f32::INFINITY).is_some(),
                None => {
                    let u = self.part_bound(part);
                    Upright { radius: u.radius + grown, low: u.low - grown, high: u.high + grown, ..u }
                        .hit(ray, f32::INFINITY)
                        .is_some()
                }
            };
            if meets {
                each(part);
            }
        }
    }

    /// Distinguishes surfaces between which a pixel shows an edge; never 0.
    #[inline]
    pub fn key(&self, hit: &MoverHit, ray: &Ray) -> u32 {
        match (hit.normal, &self.caster.robot) {
            (Some(normal), Some(body)) => {
                robot_key(usize::from(self.caster.body), hit.part, body.zone(hit.part, ray.at(hit.t), normal))
            }
            _ => (u32::from(self.caster.body) << 8) + COVERS[hit.part] as u32 + 1,
        }
    }

    /// Which others can shade it at all.
    pub fn shaders<'a>(&self, scene: &Scene, others: &[&'a Caster]) -> Shaders<'a> {
        let bound = &self.caster.bound;
        let step = 0.45;
        let spread = bound.radius.hypot(0.5 * step);
        let levels = (bound.high / step).ceil() as usize;
        let reaches = |other: &Caster, lamp: V3| {
            (0..levels).any(|i| {
                let middle = v3(bound.x, bound.y, (i as f32 + 0.5) * step);
                other.parts_shading(middle, spread, lamp).is_some()
            })
        };
        let mut shaders = Shaders { of_lamp: Default::default() };
        for (k, list) in shaders.of_lamp.iter_mut().enumerate().take(scene.lights().count()) {
            let lamp = scene.lights().position(k);
            let able = others.iter().filter(|c| c.body != self.caster.body && reaches(c, lamp));
            list.extend(able.copied());
        }
        shaders
    }

    /// Whether it is a driving robot.
    pub fn is_robot(&self) -> bool {
        self.clothes.is_none()
    }

    /// What the met point sends to the camera; `open` is the share of each lamp's light that comes there.
    pub fn glow(&self, hit: &MoverHit, ray: &Ray, scene: &Scene, open: &PerLamp) -> Glow {
        let p = ray.at(hit.t);
        let own = self.caster.robot.as_ref().filter(|_| self.is_lit).and_then(|body| body.own_glow(hit.part));
        if let Some(ambient) = own {
            return Glow { ambient, ..Glow::default() };
        }
        let mut glow = match (hit.normal, &self.caster.robot, &self.clothes) {
            (Some(normal), Some(body), _) => robot_glow(scene, body.reflectance(hit.part, p, normal), p, normal),
            (_, _, Some(clothes)) => self.person_glow(hit.part, clothes, p, scene),
            _ => Glow::default(),
        };
        glow.lamps.iter_mut().zip(open).for_each(|(lamp, open)| *lamp *= open);
        glow
    }

    fn person_glow(&self, part: usize, clothes: &Clothes, p: V3, scene: &Scene) -> Glow {
        let capsule = &self.caster.capsules[part];
        let (share, normal) = capsule.surface(p);
        let own = normal.turned(self.turn[0], -self.turn[1]);
        let along = share * (capsule.b - capsule.a).length() + own.z * capsule.radius;
        let reflectance = clothes.reflectance(part, COVERS[part], along, own);
        // Arms and trunk keep some of the lamps' light from what is below them.
        let top = self.caster.bound.high;
        let open = 0.62 + 0.38 * (p.z / top).clamp(0.0, 1.0);
        let mut glow = Glow { ambient: reflectance * scene.lights().ambient(normal) * open, lamps: [0.0; MAX_LAMPS] };
        for k in 0..scene.lights().count() {
            glow.lamps[k] = reflectance * open * scene.lights().direct(k, p, normal);
        }
        glow
    }
}

/// Who can shade a mover, by lamp.
pub struct Shaders<'a> {
    of_lamp: [Vec<&'a Caster>; MAX_LAMPS],
}

impl Shaders<'_> {
    /// As [`Shaders::open`], at points near each other.
    pub fn open_all(&self, points: impl Iterator<Item = V3>, scene: &Scene) -> Vec<PerLamp> {
        let points: Vec<V3> = points.collect();
        let Some(middle) = points.get(points.len() / 2).copied() else { return Vec::new() };
        let spread = points.iter().map(|p| (*p - middle).length()).fold(0.0, f32::max);
        let mut shade = Shade::default();
        points.iter().for_each(|p| shade.push(*p));
        let mut open = vec![[1.0; MAX_LAMPS]; points.len()];
        for (k, casters) in self.of_lamp.iter().enumerate().filter(|(_, casters)| !casters.is_empty()) {
            let lamp = scene.lights().position(k);
            shade.reopen();
            for caster in casters {
                if let Some(parts) = caster.parts_shading(middle, spread, lamp) {
                    shade.close(caster, parts, lamp, None);
                }
            }
            open.iter_mut().zip(shade.open()).for_each(|(open, of_lamp)| open[k] = *of_lamp);
        }
        open
    }

    /// Share of each lamp's light that is left at a point.
    #[inline]
    pub fn open(&self, p: V3, scene: &Scene) -> PerLamp {
        let mut open = [1.0; MAX_LAMPS];
        for (k, (open, list)) in open.iter_mut().zip(&self.of_lamp).enumerate() {
            for caster in list {
                *open *= 1.0 - caster.shade(p, scene.lights().position(k));
            }
        }
        open
    }
}

/// The upright cylinder round a body.
fn round(capsules: &[Capsule; PARTS]) -> Upright {
    let ends = || capsules.iter().flat_map(|c| [(c.a, c.radius), (c.b, c.radius)]);
    let (mut low, mut high) = (f32::INFINITY, 0.0f32);
    let (mut x, mut y) = (0.0, 0.0);
    for (p, r) in ends() {
        low = low.min(p.z - r);
        high = high.max(p.z + r);
        x += p.x / (2 * PARTS) as f32;
        y += p.y / (2 * PARTS) as f32;
    }
    let radius = ends().map(|(p, r)| (p.x - x).hypot(p.y - y) + r).fold(0.0, f32::max);
    Upright { x, y, radius, low: low.max(0.0), high }
}
