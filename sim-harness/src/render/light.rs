//! Lamps, and what stands in their light. Lamps are discs under the ceiling; solids that move throw soft shadows by one
//! test a solid: how near the way to the lamp passes, against the solid's radius and the half shadow the disc makes there.

use crate::scenario::{LampSpec, share_at};
use crate::world::MAX_LAMPS;
use crate::world::body::Body;
use crate::world::solid::{Block, Capsule, Upright};
use crate::world::vector::{Ray, V3, v3};

/// Of a lamp's disc.
const LAMP_RADIUS_M: f32 = 0.16;
/// Of the lamps below the ceiling.
const LAMP_DROP_M: f64 = 0.06;
/// Shadows of what is nearer to a place than this share of the way to the lamp are as sharp as at this share.
const LEAST_SHARE: f32 = 0.02;
/// Mains flicker.
const FLICKER_HZ: f64 = 100.0;
/// Points of a lamp's disc that are tested for furniture in the way.
const DISC_POINTS: usize = 6;

/// Light of each lamp at a place, without its flicker.
pub type PerLamp = [f32; MAX_LAMPS];

/// All lamps.
#[derive(Debug, Clone)]
pub struct Lights {
    lamps: Vec<(V3, f32, f64)>,
    ambient: f32,
    /// Light over time: of each lamp, then that from everywhere.
    over_time: Vec<Vec<[f64; 2]>>,
}

impl Lights {
    /// Scaled so that together they give 1 in the middle of the floor.
    pub fn new(lamps: &[LampSpec], ambient: f64, ambient_light: &[[f64; 2]], ceiling_m: f64) -> Self {
        let z = (ceiling_m - LAMP_DROP_M) as f32;
        let mut lights = Self {
            lamps: lamps
                .iter()
                .map(|l| (v3(l.position_m[0] as f32, l.position_m[1] as f32, z), l.power as f32, l.flicker))
                .collect(),
            ambient: ambient as f32,
            over_time: lamps.iter().map(|l| l.light.clone()).chain([ambient_light.to_vec()]).collect(),
        };
        let sum: f32 = (0..lamps.len()).map(|k| lights.direct(k, v3(0.0, 0.0, 0.0), v3(0.0, 0.0, 1.0))).sum();
        if sum > 0.0 {
            lights.lamps.iter_mut().for_each(|l| l.1 /= sum);
        }
        lights
    }

    /// Number of lamps.
    pub fn count(&self) -> usize {
        self.lamps.len()
    }

    /// Where a lamp is.
    #[inline(always)]
    pub fn position(&self, lamp: usize) -> V3 {
        self.lamps[lamp].0
    }

    /// Strength of each lamp at a true time, its flicker included, in units of the light from everywhere.
    pub fn strength(&self, time_s: f64) -> PerLamp {
        let ambient = self.ambient_strength(time_s);
        let mut out = [0.0; MAX_LAMPS];
        for ((out, (_, _, flicker)), light) in out.iter_mut().zip(&self.lamps).zip(&self.over_time) {
            let flicker = 1.0 + flicker * (std::f64::consts::TAU * FLICKER_HZ * time_s).sin();
            *out = (share_at(light, time_s) * flicker) as f32 / ambient;
        }
        out
    }

    /// Strength of the light from everywhere at a true time, 1 as a rule.
    pub fn ambient_strength(&self, time_s: f64) -> f32 {
        self.over_time.last().map_or(1.0, |light| share_at(light, time_s) as f32)
    }

    /// Light of one lamp on a surface element, nothing in the way.
    #[inline(always)]
    pub fn direct(&self, lamp: usize, p: V3, normal: V3) -> f32 {
        let (position, power, _) = self.lamps[lamp];
        let to = position - p;
        let d2 = to.dot(to);
        let d = d2.sqrt();
        let facing = normal.dot(to) / d;
        if facing <= 0.0 {
            return 0.0;
        }
        // A frosted disc: most light goes down, some sideways.
        let falling = 0.35 + 0.65 * (to.z / d).max(0.0);
        power * facing * falling / d2
    }

    /// Light from everywhere on a surface element: a little more from above than from below.
    #[inline(always)]
    pub fn ambient(&self, normal: V3) -> f32 {
        self.ambient * (0.85 + 0.25 * normal.z)
    }

    /// Light of each lamp past blocks of furniture.
    pub fn past_blocks(&self, p: V3, normal: V3, blocks: &[Block]) -> PerLamp {
        let mut out = [0.0; MAX_LAMPS];
        for (k, out) in out.iter_mut().enumerate().take(self.count()) {
            let whole = self.direct(k, p, normal);
            if whole <= 0.0 {
                continue;
            }
            let from = p + normal * 1e-3;
            let seen =
                (0..DISC_POINTS).filter(|i| !is_blocked(from, self.position(k) + disc_point(*i), blocks)).count();
            *out = whole * seen as f32 / DISC_POINTS as f32;
        }
        out
    }
}

fn disc_point(i: usize) -> V3 {
    let r = LAMP_RADIUS_M * ((i as f32 + 0.5) / DISC_POINTS as f32).sqrt();
    let (sin, cos) = (2.4 * i as f32).sin_cos();
    v3(r * cos, r * sin, 0.0)
}

fn is_blocked(from: V3, to: V3, blocks: &[Block]) -> bool {
    let way = to - from;
    let length = way.length();
    let ray = Ray { origin: from, direction: way * (1.0 / length) };
    blocks.iter().any(|b| b.hit(&ray, length).is_some())
}

/// A solid that throws shadows, with a bounding upright round it.
#[derive(Debug, Clone)]
pub struct Caster {
    /// Which body (own shadow is left out where it is lit itself).
    pub body: u16,
    /// Round everything.
    pub bound: Upright,
    /// Parts of a person; empty for a robot.
    pub capsules: Vec<Capsule>,
    /// What throws a robot's shadow; empty for a person.
    pub uprights: Vec<Upright>,
    /// A robot's body; none for a person.
    pub robot: Option<Body>,
}

/// Parts of a caster that can shade some place.
#[derive(Debug, Clone, Copy, Default)]
pub struct Parts(u32);

/// Places whose light from one lamp is asked for together, coordinate by coordinate so that several are tested at a time.
#[derive(Debug, Default)]
pub struct Shade {
    x: Vec<f32>,
    y: Vec<f32>,
    z: Vec<f32>,
    most: Vec<f32>,
    open: Vec<f32>,
}

impl Shade {
    /// Forgets all places.
    pub fn clear(&mut self) {
        self.x.clear();
        self.y.clear();
        self.z.clear();
    }

    /// Adds one.
    pub fn push(&mut self, p: V3) {
        self.x.push(p.x);
        self.y.push(p.y);
        self.z.push(p.z);
    }

    /// Nothing is in the way of any.
    pub fn reopen(&mut self) {
        self.open.clear();
        self.open.resize(self.x.len(), 1.0);
    }

    /// Takes away what parts of a caster keep from the places, but for those that are `spared`.
    pub fn close(&mut self, caster: &Caster, parts: Parts, lamp: V3, spared: Option<&[bool]>) {
        self.most.clear();
        self.most.resize(self.x.len(), 0.0);
        for (n, capsule) in caster.capsules.iter().enumerate().take(u32::BITS as usize) {
            if parts.0 & (1 << n) != 0 {
                self.darken(|p| behind_capsule(capsule, p, lamp - p));
            }
        }
        for upright in &caster.uprights {
            self.darken(|p| behind_upright(upright, p, lamp - p));
        }
        for (i, (open, most)) in self.open.iter_mut().zip(&self.most).enumerate() {
            let is_spared = spared.is_some_and(|spared| spared[i]);
            *open *= if is_spared { 1.0 } else { 1.0 - most };
        }
    }

    /// Share of the lamp's light that is left at each place.
    pub fn open(&self) -> &[f32] {
        &self.open
    }

    #[inline(always)]
    fn darken(&mut self, shade: impl Fn(V3) -> f32) {
        for (((most, x), y), z) in self.most.iter_mut().zip(&self.x).zip(&self.y).zip(&self.z) {
            *most = most.max(shade(v3(*x, *y, *z)));
        }
    }
}

impl Caster {
    /// Share of a lamp's light that is kept from `p`, 0 … 1.
    #[inline]
    pub fn shade(&self, p: V3, lamp: V3) -> f32 {
        let way = lamp - p;
        if !self.may_shade(p, way, 0.0) {
            return 0.0;
        }
        let capsules = self.capsules.iter().map(|c| behind_capsule(c, p, way));
        let uprights = self.uprights.iter().map(|u| behind_upright(u, p, way));
        capsules.chain(uprights).fold(0.0, f32::max)
    }

    /// The parts that can shade anything within `spread` of `p`; `None` where there are none.
    pub fn parts_shading(&self, p: V3, spread: f32, lamp: V3) -> Option<Parts> {
        let way = lamp - p;
        if !self.may_shade(p, way, spread) {
            return None;
        }
        let mut parts = 0;
        for (n, capsule) in self.capsules.iter().enumerate() {
            let (distance2, share) = nearest(p, way, capsule.a, capsule.b - capsule.a);
            // The half shadow widens towards the lamp; a little is added for the share at the tile's rim.
            if distance2.sqrt() < capsule.radius + spread + LAMP_RADIUS_M * (share + 0.1) {
                parts |= 1 << n;
            }
        }
        (parts != 0 || !self.uprights.is_empty()).then_some(Parts(parts))
    }

    /// Whether anything within `spread` of `p` can be in its shadow.
    #[inline]
    fn may_shade(&self, p: V3, way: V3, spread: f32) -> bool {
        let (ox, oy) = (p.x - self.bound.x, p.y - self.bound.y);
        let flat2 = (way.x * way.x + way.y * way.y).max(1e-9);
        let share = (-(ox * way.x + oy * way.y) / flat2).clamp(0.0, 1.0);
        let (dx, dy) = (ox + share * way.x, oy + share * way.y);
        let reach = self.bound.radius + LAMP_RADIUS_M + spread;
        if dx * dx + dy * dy > reach * reach {
            return false;
        }
        // The way enters the bounding circle before its nearest point: the lowest point inside decides.
        let enter = (share - reach / flat2.sqrt()).max(0.0);
        p.z - spread + enter * way.z < self.bound.high + LAMP_RADIUS_M
    }
}

/// 0 (lit) … 1 (dark) where the way passes a solid's surface at `gap` (negative inside), `share` of the way to the lamp.
#[inline(always)]
fn half_shadow(gap: f32, share: f32) -> f32 {
    let half = LAMP_RADIUS_M * share.max(LEAST_SHARE);
    let x = (0.5 - 0.5 * gap / half).clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}

#[inline(always)]
fn behind_capsule(capsule: &Capsule, p: V3, way: V3) -> f32 {
    let (distance2, share) = nearest(p, way, capsule.a, capsule.b - capsule.a);
    half_shadow(distance2.sqrt() - capsule.radius, share)
}

#[inline(always)]
fn behind_upright(u: &Upright, p: V3, way: V3) -> f32 {
    let (ox, oy) = (p.x - u.x, p.y - u.y);
    let flat2 = (way.x * way.x + way.y * way.y).max(1e-9);
    let share = (-(ox * way.x + oy * way.y) / flat2).clamp(0.0, 1.0);
    let (dx, dy) = (ox + share * way.x, oy + share * way.y);
    let side = (dx * dx + dy * dy).sqrt() - u.radius;
    // Height of the way over the cylinder's span: at the nearest point and where it enters.
    let enter = (share - u.radius / flat2.sqrt()).max(0.0);
    let (low, high) = (p.z + enter * way.z, p.z + share * way.z);
    let over = (low - u.high).max(u.low - high);
    half_shadow(side.max(over), share.max(0.05))
}

/// Square of the smallest distance between the ways p + s·d and a + t·e (s, t in 0 … 1), and its s.
#[inline(always)]
fn nearest(p: V3, d: V3, a: V3, e: V3) -> (f32, f32) {
    let r = p - a;
    let (dd, ee, de, dr, er) = (d.dot(d), e.dot(e).max(1e-9), d.dot(e), d.dot(r), e.dot(r));
    let denominator = dd * ee - de * de;
    let s = if denominator > 1e-9 { ((de * er - dr * ee) / denominator).clamp(0.0, 1.0) } else { 0.0 };
    let t = ((de * s + er) / ee).clamp(0.0, 1.0);
    let s = ((t * de - dr) / dd).clamp(0.0, 1.0);
    let apart = r + d * s - e * t;
    (apart.dot(apart), s)
}
