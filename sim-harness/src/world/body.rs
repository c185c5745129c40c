//! The robots' bodies: solids painted with what their robot wears. All have a mast with the lens on it.
//!
//! ```text
//!      ▪ lens                 ▪                     ▪
//!      │ mast                 │                     │
//!   ┌──┴──┐ 0.50           ┌──┴──┐               ┌──│──┐      upper end of the marker
//!   │█████│                │█ █▒█│               │█████│
//!   │     │  rings         │ █  ▒│  rings, dark  │     │      a plate before the mast,
//!   │█████│                │█ █▒█│  and bright   │█████│      its back in the negative
//!   │     │                │ █  ▒│  exchanged    └──│──┘
//!   └─────┘                └─────┘  in bars        ─┴─
//! ```

use std::sync::Arc;

use super::solid::{Block, Upright};
use super::vector::{Ray, V3, v3};
use crate::scenario::WearSpec;

/// Of the cylinder.
pub const RADIUS_M: f64 = 0.20;
/// Lower end of the cylinder above the floor.
pub const LOW_M: f64 = 0.02;
/// Upper end of the cylinder.
pub const HIGH_M: f64 = 0.50;
/// Extent of the painted rings.
pub const PAINTED_M: [f64; 2] = [0.10, 0.50];
/// Mast and lens block.
pub const MAST_RADIUS_M: f64 = 0.02;
/// The lens block reaches this far above and below the camera's focus.
pub const LENS_HALF_HEIGHT_M: f64 = 0.02;
/// Of a lamp round the mast: from where to where, and its radius.
pub const LAMP_M: [f64; 2] = [0.52, 0.56];
const LAMP_RADIUS_M: f64 = 0.03;
/// Its diffuser.
const LAMP_REFLECTANCE: f32 = 0.5;
/// What it sends when it is lit: a white wall under the room's lamps sends about 0.8.
const LAMP_GLOW: f32 = 2.5;
/// Of everything that is not a ring.
pub const BARE_REFLECTANCE: f64 = 0.30;
/// Of a plate's sheet.
const SHEET_M: f64 = 0.003;
/// Foot under a plate: radius and height.
const FOOT_M: [f64; 2] = [0.13, 0.06];
/// Posts that throw a plate's shadow stand this far apart.
const POST_STEP_M: f64 = 0.04;

/// One painted ring.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PaintedRing {
    /// Lower and upper edge above the floor.
    pub height_m: [f64; 2],
    /// Diffuse.
    pub reflectance: f64,
}

/// From the bottom up.
pub const RINGS: [PaintedRing; 4] = [
    PaintedRing { height_m: [0.10, 0.20], reflectance: 0.85 },
    PaintedRing { height_m: [0.20, 0.30], reflectance: 0.10 },
    PaintedRing { height_m: [0.30, 0.40], reflectance: 0.85 },
    PaintedRing { height_m: [0.40, 0.50], reflectance: 0.10 },
];
/// A ring's reflectance and that of its negative add to this.
const WITH_NEGATIVE: f64 = 0.95;

/// A body that stands somewhere.
#[derive(Debug, Clone)]
pub struct Body {
    wear: Arc<WearSpec>,
    heading_rad: f32,
    parts: Vec<Part>,
}

#[derive(Debug, Clone, Copy)]
struct Part {
    solid: Solid,
    paint: Cover,
}

#[derive(Debug, Clone, Copy)]
enum Solid {
    Upright(Upright),
    Block(Block),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Cover {
    Marker,
    Bare,
    Mast,
    Lens,
    Lamp,
}

impl Body {
    /// A lamp round the mast of a robot at (x, y).
    pub fn lamp(x_m: f64, y_m: f64) -> Self {
        let [low, high] = LAMP_M.map(|z| z as f32);
        let solid = Solid::Upright(Upright { x: x_m as f32, y: y_m as f32, radius: LAMP_RADIUS_M as f32, low, high });
        Self { wear: Arc::default(), heading_rad: 0.0, parts: vec![Part { solid, paint: Cover::Lamp }] }
    }

    /// What a part sends by itself where it is lit.
    pub fn own_glow(&self, part: usize) -> Option<f32> {
        (self.parts[part].paint == Cover::Lamp).then_some(LAMP_GLOW)
    }

    /// What stands at (x, y) with a heading.
    pub fn new(wear: &Arc<WearSpec>, x_m: f64, y_m: f64, heading_rad: f64, camera_height_m: f64) -> Self {
        let upright = |radius: f64, low: f64, high: f64| {
            Solid::Upright(Upright {
                x: x_m as f32,
                y: y_m as f32,
                radius: radius as f32,
                low: low as f32,
                high: high as f32,
            })
        };
        let part = |solid, paint| Part { solid, paint };
        let lens = camera_height_m - LENS_HALF_HEIGHT_M;
        let mut parts = match wear.as_ref() {
            WearSpec::Rings | WearSpec::Bars { .. } => vec![
                part(upright(RADIUS_M, LOW_M, HIGH_M), Cover::Marker),
                part(upright(MAST_RADIUS_M, HIGH_M, lens), Cover::Mast),
            ],
            WearSpec::Plate { width_m, left_edge_m, behind_m } => {
                let (sin, cos) = heading_rad.sin_cos();
                let own = [behind_m - 0.5 * SHEET_M, 0.5 * width_m - left_edge_m];
                let sheet = Block::new(
                    (x_m + cos * own[0] - sin * own[1]) as f32,
                    (y_m + sin * own[0] + cos * own[1]) as f32,
                    PAINTED_M[0] as f32,
                    heading_rad as f32,
                    SHEET_M as f32,
                    *width_m as f32,
                    (PAINTED_M[1] - PAINTED_M[0]) as f32,
                );
                vec![
                    part(Solid::Block(sheet), Cover::Marker),
                    part(upright(MAST_RADIUS_M, 0.0, lens), Cover::Mast),
                    part(upright(FOOT_M[0].min(behind_m + 0.08), 0.0, FOOT_M[1]), Cover::Bare),
                ]
            }
        };
        parts.push(part(upright(MAST_RADIUS_M, lens, camera_height_m + LENS_HALF_HEIGHT_M), Cover::Lens));
        Self { wear: wear.clone(), heading_rad: heading_rad as f32, parts }
    }

    /// Number of parts.
    pub fn parts(&self) -> usize {
        self.parts.len()
    }

    /// Whether a part carries the marker.
    pub fn is_marker(&self, part: usize) -> bool {
        self.parts[part].paint == Cover::Marker
    }

    /// Where a ray meets a part, and the outer normal there; nearer than `limit`.
    #[inline]
    pub fn hit(&self, part: usize, ray: &Ray, limit: f32) -> Option<(f32, V3)> {
        match &self.parts[part].solid {
            Solid::Upright(upright) => upright.hit(ray, limit),
            Solid::Block(block) => block.hit(ray, limit).map(|(t, face)| (t, block.normal(face))),
        }
    }

    /// The upright cylinder round a part.
    pub fn bound(&self, part: usize) -> Upright {
        match &self.parts[part].solid {
            Solid::Upright(upright) => *upright,
            Solid::Block(block) => round(block),
        }
    }

    /// The upright cylinder on the floor round everything.
    pub fn outer_bound(&self) -> Upright {
        let first = self.bound(0);
        let reach = |b: Upright| (b.x - first.x).hypot(b.y - first.y) + b.radius;
        let bounds = || (0..self.parts.len()).map(|n| self.bound(n));
        let high = bounds().map(|b| b.high).fold(0.0, f32::max);
        Upright { high, low: 0.0, radius: bounds().map(reach).fold(0.0, f32::max), ..first }
    }

    /// Upright cylinders that throw its shadow.
    pub fn shades(&self) -> Vec<Upright> {
        let mut shades = Vec::new();
        for part in &self.parts {
            match &part.solid {
                Solid::Upright(upright) => shades.push(*upright),
                Solid::Block(block) => {
                    let posts = (2.0 * block.half.y / POST_STEP_M as f32).ceil().max(1.0);
                    let step = 2.0 * block.half.y / posts;
                    let round = round(block);
                    shades.extend((0..posts as usize).map(|n| {
                        let own = v3(0.0, (n as f32 + 0.5) * step - block.half.y, 0.0);
                        let p = block.centre + own.turned(block.turn[0], block.turn[1]);
                        Upright { x: p.x, y: p.y, radius: 0.5 * step, ..round }
                    }));
                }
            }
        }
        shades
    }

    /// Reflectance of a point on a part.
    pub fn reflectance(&self, part: usize, p: V3, normal: V3) -> f32 {
        let ring = |negative: bool| {
            let ring = ring_at(p.z).map(|n| RINGS[n].reflectance);
            ring.map_or(BARE_REFLECTANCE, |r| if negative { WITH_NEGATIVE - r } else { r }) as f32
        };
        match (self.parts[part].paint, &self.parts[part].solid) {
            (Cover::Mast, _) => 0.25,
            (Cover::Lens, _) => 0.12,
            (Cover::Lamp, _) => LAMP_REFLECTANCE,
            (Cover::Bare, _) => BARE_REFLECTANCE as f32,
            (Cover::Marker, _) if normal.z.abs() >= 0.5 => BARE_REFLECTANCE as f32,
            (Cover::Marker, Solid::Upright(_)) => ring(self.is_in_bar(normal)),
            (Cover::Marker, Solid::Block(block)) => match facing(block, normal) {
                Side::Front => ring(false),
                Side::Back => ring(true),
                Side::Rim => BARE_REFLECTANCE as f32,
            },
        }
    }

    /// A number below 256 that differs between surfaces of a part where a pixel would show an edge.
    pub fn zone(&self, part: usize, p: V3, normal: V3) -> u32 {
        if normal.z.abs() > 0.5 {
            return 15;
        }
        let ring = ring_at(p.z).map_or(14, |n| n as u32);
        match (self.parts[part].paint, &self.parts[part].solid) {
            (Cover::Marker, Solid::Upright(_)) => ring + if self.is_in_bar(normal) { 16 } else { 0 },
            (Cover::Marker, Solid::Block(block)) => {
                ring + match facing(block, normal) {
                    Side::Front => 0,
                    Side::Back => 32,
                    Side::Rim => 64,
                }
            }
            (_, _) if self.parts[part].paint == Cover::Lamp => 128,
            _ => 0,
        }
    }

    fn is_in_bar(&self, normal: V3) -> bool {
        let WearSpec::Bars { azimuths_deg, bar_width_deg, code } = self.wear.as_ref() else { return false };
        let azimuth_deg = f64::from(normal.y.atan2(normal.x) - self.heading_rad).to_degrees();
        azimuths_deg.iter().enumerate().any(|(n, bar)| {
            let modules = code.as_ref().and_then(|code| code.get(n)).map_or(1.0, |c| f64::from(*c));
            let apart = (azimuth_deg - bar + 180.0).rem_euclid(360.0) - 180.0;
            apart.abs() < 0.5 * modules * bar_width_deg
        })
    }
}

enum Side {
    Front,
    Back,
    Rim,
}

fn facing(block: &Block, normal: V3) -> Side {
    let own = normal.turned(block.turn[0], -block.turn[1]).x;
    if own > 0.5 {
        Side::Front
    } else if own < -0.5 {
        Side::Back
    } else {
        Side::Rim
    }
}

fn ring_at(z_m: f32) -> Option<usize> {
    let z_m = f64::from(z_m);
    RINGS.iter().position(|r| z_m >= r.height_m[0] && z_m < r.height_m[1])
}

fn round(block: &Block) -> Upright {
    Upright {
        x: block.centre.x,
        y: block.centre.y,
        radius: block.circle(),
        low: block.centre.z - block.half.z,
        high: block.centre.z + block.half.z,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn body(wear: WearSpec, heading_deg: f64) -> Body {
        Body::new(&Arc::new(wear), 0.0, 0.0, f64::to_radians(heading_deg), 0.6)
    }

    fn towards_axis(bearing_deg: f32, z: f32) -> Ray {
        let out = v3(1.0, 0.0, 0.0).turned(bearing_deg.to_radians().cos(), bearing_deg.to_radians().sin());
        Ray { origin: out * 2.0 + v3(0.0, 0.0, z), direction: -out }
    }

    fn shown(body: &Body, ray: &Ray) -> f32 {
        let (t, normal) = body.hit(0, ray, 10.0).unwrap();
        body.reflectance(0, ray.at(t), normal)
    }

    #[test]
    fn a_bar_turns_with_the_robot_and_is_the_rings_negative() {
        let wear = WearSpec::Bars { azimuths_deg: vec![0.0, 90.0], bar_width_deg: 20.0, code: Some(vec![1, 2]) };
        let body = body(wear, 30.0);
        for (bearing, in_bar) in [(30.0, true), (41.0, false), (120.0 + 19.0, true), (120.0 + 21.0, false)] {
            let expected = if in_bar { 0.10 } else { 0.85 };
            assert!((shown(&body, &towards_axis(bearing, 0.15)) - expected).abs() < 1e-6, "{bearing}");
        }
    }

    #[test]
    fn a_plate_shows_its_rings_in_front_and_their_negative_behind() {
        let body = body(WearSpec::Plate { width_m: 0.4, left_edge_m: 0.15, behind_m: 0.1 }, 90.0);
        assert!((shown(&body, &towards_axis(90.0, 0.15)) - 0.85).abs() < 1e-6);
        assert!((shown(&body, &towards_axis(-90.0, 0.15)) - 0.10).abs() < 1e-6);
        // Edges at own y = W − L₁ = 0.25 and −0.15, own x = 0.1: in the room x = −0.25 … 0.15, y = 0.1.
        let down = |x: f32| Ray { origin: v3(x, 2.0, 0.3), direction: v3(0.0, -1.0, 0.0) };
        for (x, hits) in [(-0.249, true), (-0.251, false), (0.149, true), (0.151, false)] {
            assert_eq!(body.hit(0, &down(x), 10.0).is_some(), hits, "{x}");
        }
        assert!((body.hit(0, &down(0.0), 10.0).unwrap().0 - 1.9).abs() < 1e-6);
    }
}
