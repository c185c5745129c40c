//! The rays of every pixel, traced once a camera: at the corners of the pixels, so that a ray anywhere inside a pixel is a
//! bilinear mix of four traced ones (exact to 10⁻⁵ px: the glass is smooth).

use std::f32::consts::TAU;

use nalgebra::{Rotation3, Vector3};

use super::pal::Pal;
use crate::scenario::CameraSpec;
use crate::world::solid::Upright;
use crate::world::vector::{Ray, V3, v3};

/// The picture is lit this far beyond the design's annulus, as real rims are: interpolation and blur at the nominal
/// edge see light, not the rim.
const RIM_PX: f64 = 3.0;
/// Sectors of bearing by which pixels are sorted.
const SECTORS: usize = 720;
/// Edge of a tile.
pub const TILE_PX: usize = 8;
/// Windows are drawn this much wider than the solid: rays start up to 2 cm off the axis.
const MARGIN_M: f32 = 0.025;

fn sector(bearing: f32) -> usize {
    let turn = bearing / TAU;
    (((turn - turn.floor()) * SECTORS as f32) as usize).min(SECTORS - 1)
}

/// Rays of a camera in the robot's body frame (origin on the floor under the axis), metres.
#[derive(Debug)]
pub struct Rays {
    /// Pixels a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Lit pixels, row by row.
    pub lit: Vec<u32>,
    /// Whether light falls on the pixel.
    pub is_lit: Vec<bool>,
    /// Whether the pixel is inside the design's elevations.
    pub is_nominal: Vec<bool>,
    /// Bearing of the pixel's centre, radians in the body frame.
    pub bearing: Vec<f32>,
    /// Slope (tangent of the elevation) of the pixel's centre.
    pub slope: Vec<f32>,
    /// Of V above the floor.
    pub camera_height_m: f32,
    /// Mean angle that a pixel shows.
    pub pixel_rad: f32,
    /// Lit pixels in squares of [`TILE_PX`].
    pub tiles: Vec<Vec<u32>>,
    /// Lit pixels by sector of bearing, with their slopes, by slope.
    sectors: Vec<Vec<(f32, u32)>>,
    corners: Vec<[f32; 6]>,
}

impl Rays {
    /// Traces a camera that stands upright.
    pub fn trace(spec: &CameraSpec) -> Self {
        Self::trace_tilted(spec, [0.0; 2])
    }

    /// Traces a camera turned on its robot about V: roll, then pitch, degrees. All rays turn as one piece of glass does.
    pub fn trace_tilted(spec: &CameraSpec, [roll_deg, pitch_deg]: [f64; 2]) -> Self {
        let pal = Pal::new(spec);
        let pitched = Rotation3::from_axis_angle(&Vector3::y_axis(), pitch_deg.to_radians());
        let turn = pitched * Rotation3::from_axis_angle(&Vector3::x_axis(), roll_deg.to_radians());
        let (inner, outer) = rim_radii(&pal, spec);
        let radius = |u: f64, v: f64| (u - spec.centre_px[0]).hypot(v - spec.centre_px[1]);
        let within = |r: f64, margin: f64| r >= inner - margin && r <= outer + margin;
        let ray = |u: f64, v: f64| {
            let traced = pal.trace(u, v).filter(|_| within(radius(u, v), RIM_PX + 1.5))?;
            Some((turn * traced.origin_mm * 1e-3, turn * traced.direction))
        };
        let pixel =
            |u: f64, v: f64| PixelUse { is_lit: within(radius(u, v), RIM_PX), is_nominal: within(radius(u, v), 0.0) };
        let mut rays = Self::new(spec.image_size_px, spec.height_m, ray, pixel);
        rays.pixel_rad = (2.0 / (inner + outer)) as f32;
        rays
    }

    /// Any camera by its rays: origin (m, from the camera's origin) and unit direction at a point of the picture.
    pub fn of_camera(
        size_px: [u32; 2],
        height_m: f64,
        ray: impl Fn(f64, f64) -> Option<(Vector3<f64>, Vector3<f64>)>,
    ) -> Self {
        Self::of_camera_with_margin(size_px, [0; 2], height_m, ray)
    }

    /// The same with a margin of so many columns and rows on each side of the picture: lit, but not what the camera is for.
    pub fn of_camera_with_margin(
        size_px: [u32; 2],
        margin_px: [usize; 2],
        height_m: f64,
        ray: impl Fn(f64, f64) -> Option<(Vector3<f64>, Vector3<f64>)>,
    ) -> Self {
        let [left, above] = margin_px.map(|m| m as f64);
        let [width, height] = size_px.map(f64::from);
        let ray = |x: f64, y: f64| ray(x - left, y - above);
        // A pixel is lit only with all its corners: its rays are mixed from theirs.
        let pixel = |x: f64, y: f64| {
            let corners = [(-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)];
            let is_lit = corners.iter().all(|(dx, dy)| ray(x + dx, y + dy).is_some());
            let is_inside = (0.0..width).contains(&(x - left)) && (0.0..height).contains(&(y - above));
            PixelUse { is_lit, is_nominal: is_lit && is_inside }
        };
        let [wide, high] = [0, 1].map(|i| size_px[i] + 2 * margin_px[i] as u32);
        let mut rays = Self::new([wide, high], height_m, ray, pixel);
        let angle = |i: u32| {
            let (u, v) = (i as usize % rays.width, i as usize / rays.width);
            let (a, b) = (ray(u as f64 - 0.5, v as f64)?.1, ray(u as f64 + 0.5, v as f64)?.1);
            Some(a.angle(&b))
        };
        let angles: Vec<f64> = rays.lit.iter().step_by(101).filter_map(|i| angle(*i)).collect();
        rays.pixel_rad = (angles.iter().sum::<f64>() / angles.len().max(1) as f64) as f32;
        rays
    }

    fn new(
        size_px: [u32; 2],
        height_m: f64,
        ray: impl Fn(f64, f64) -> Option<(Vector3<f64>, Vector3<f64>)>,
        pixel: impl Fn(f64, f64) -> PixelUse,
    ) -> Self {
        let [width, height] = size_px.map(|s| s as usize);
        let pixels = width * height;
        let mut rays = Self {
            width,
            height,
            lit: Vec::new(),
            is_lit: vec![false; pixels],
            is_nominal: vec![false; pixels],
            bearing: vec![0.0; pixels],
            slope: vec![0.0; pixels],
            camera_height_m: height_m as f32,
            pixel_rad: 0.0,
            tiles: Vec::new(),
            sectors: vec![Vec::new(); SECTORS],
            corners: vec![[0.0; 6]; (width + 1) * (height + 1)],
        };
        for y in 0..=height {
            for x in 0..=width {
                if let Some((o, d)) = ray(x as f64 - 0.5, y as f64 - 0.5) {
                    rays.corners[y * (width + 1) + x] = [o.x, o.y, o.z + height_m, d.x, d.y, d.z].map(|c| c as f32);
                }
            }
        }
        for y in 0..height {
            for x in 0..width {
                let (u, v) = (x as f64, y as f64);
                let PixelUse { is_lit, is_nominal } = pixel(u, v);
                let Some((_, d)) = ray(u, v).filter(|_| is_lit) else { continue };
                let i = y * width + x;
                rays.is_lit[i] = true;
                rays.lit.push(i as u32);
                rays.is_nominal[i] = is_nominal;
                rays.bearing[i] = d.y.atan2(d.x) as f32;
                rays.slope[i] = (d.z / d.x.hypot(d.y)) as f32;
            }
        }
        let columns = width.div_ceil(TILE_PX);
        rays.tiles = vec![Vec::new(); columns * height.div_ceil(TILE_PX)];
        for pixel in &rays.lit {
            let p = *pixel as usize;
            rays.sectors[sector(rays.bearing[p])].push((rays.slope[p], *pixel));
            rays.tiles[(p / width) / TILE_PX * columns + (p % width) / TILE_PX].push(*pixel);
        }
        rays.tiles.retain(|tile| !tile.is_empty());
        for sector in &mut rays.sectors {
            sector.sort_by(|a, b| a.0.total_cmp(&b.0));
        }
        rays
    }

    /// Lit pixels that show something of an upright solid standing in the room, and perhaps a few more.
    pub fn window<'a>(&'a self, stand: &Stand, bound: &Upright) -> impl Iterator<Item = usize> + 'a {
        let (dx, dy) = (bound.x - stand.x, bound.y - stand.y);
        let distance = dx.hypot(dy);
        let radius = bound.radius + MARGIN_M;
        let (half, near) = if distance > radius + 0.05 {
            ((radius / distance).asin(), distance - radius)
        } else {
            (std::f32::consts::PI, 0.03)
        };
        let slope = |z: f32, up: bool| {
            let rise = z - self.camera_height_m;
            rise / if (rise > 0.0) == up { near } else { distance + radius }
        };
        let (low, high) = (slope(bound.low - MARGIN_M, false), slope(bound.high + MARGIN_M, true));
        let middle = dy.atan2(dx) - stand.heading;
        let span = ((half / TAU * SECTORS as f32).ceil() as i64 + 1).min(SECTORS as i64 / 2);
        let first = sector(middle) as i64 - span;
        let count = (2 * span + 1).min(SECTORS as i64);
        (0..count)
            .flat_map(move |i| {
                let sector = &self.sectors[(first + i).rem_euclid(SECTORS as i64) as usize];
                let from = sector.partition_point(|(slope, _)| *slope < low);
                let to = sector.partition_point(|(slope, _)| *slope <= high);
                &sector[from..to.max(from)]
            })
            .map(|(_, pixel)| *pixel as usize)
    }

    /// The pixels around a pixel; lit ones never touch the picture's rim.
    #[inline(always)]
    pub fn neighbours(&self, pixel: usize) -> [usize; 8] {
        let w = self.width;
        let (x, y) = (pixel % w, pixel / w);
        if x == 0 || y == 0 || x + 1 == w || y + 1 == self.height {
            return [pixel; 8];
        }
        [pixel - w - 1, pixel - w, pixel - w + 1, pixel - 1, pixel + 1, pixel + w - 1, pixel + w, pixel + w + 1]
    }

    /// The ray at an offset of −½ … ½ pixel from a pixel's centre, in the body frame; the direction is of unit length.
    #[inline(always)]
    pub fn ray(&self, pixel: usize, du: f32, dv: f32) -> Ray {
        let (x, y) = (pixel % self.width, pixel / self.width);
        let at = y * (self.width + 1) + x;
        let [a, b] = [&self.corners[at], &self.corners[at + 1]];
        let [c, d] = [&self.corners[at + self.width + 1], &self.corners[at + self.width + 2]];
        let (fu, fv) = (du + 0.5, dv + 0.5);
        let (wa, wb, wc, wd) = ((1.0 - fu) * (1.0 - fv), fu * (1.0 - fv), (1.0 - fu) * fv, fu * fv);
        let mix = |i: usize| a[i] * wa + b[i] * wb + c[i] * wc + d[i] * wd;
        Ray { origin: v3(mix(0), mix(1), mix(2)), direction: v3(mix(3), mix(4), mix(5)).unit() }
    }
}

/// Whether light falls on a pixel, and whether the design is for it.
#[derive(Debug, Clone, Copy)]
struct PixelUse {
    is_lit: bool,
    is_nominal: bool,
}

/// Where the camera stands: turns body rays into the room.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stand {
    /// Of the axis.
    pub x: f32,
    /// Of the axis.
    pub y: f32,
    /// Radians.
    pub heading: f32,
    cos: f32,
    sin: f32,
}

impl Stand {
    /// At a pose in the room.
    pub fn new(x_m: f64, y_m: f64, heading_rad: f64) -> Self {
        let (sin, cos) = heading_rad.sin_cos();
        let heading = (heading_rad - std::f64::consts::TAU * (heading_rad / std::f64::consts::TAU).round()) as f32;
        Self { x: x_m as f32, y: y_m as f32, heading, cos: cos as f32, sin: sin as f32 }
    }

    /// A ray of the body in the room.
    #[inline(always)]
    pub fn room_from_body(&self, ray: Ray) -> Ray {
        let o = ray.origin.turned(self.cos, self.sin);
        Ray { origin: v3(o.x + self.x, o.y + self.y, o.z), direction: ray.direction.turned(self.cos, self.sin) }
    }

    /// Point on the axis at a height.
    pub fn axis(&self, z: f32) -> V3 {
        v3(self.x, self.y, z)
    }
}

/// Radii of the picture at which the highest and the lowest direction of the design are seen, by bisection on traced rays.
fn rim_radii(pal: &Pal, spec: &CameraSpec) -> (f64, f64) {
    let elevation =
        |r: f64| pal.trace(spec.centre_px[0] + r, spec.centre_px[1]).map(|t| t.direction.z.asin().to_degrees());
    let find = |wanted: f64| {
        let (mut low, mut high) = (1.0, f64::from(spec.image_size_px[0].max(spec.image_size_px[1])));
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            // Elevation falls with the radius; beyond the glass there is no ray.
            if elevation(middle).is_some_and(|e| e > wanted) { low = middle } else { high = middle }
        }
        0.5 * (low + high)
    };
    (find(spec.elevation_deg[1]), find(spec.elevation_deg[0]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mixed_ray_is_the_traced_ray_to_a_thousandth_of_a_pixel() {
        let spec = CameraSpec::default();
        let (rays, pal) = (Rays::trace(&spec), Pal::new(&spec));
        let pixel_rad = 0.005;
        for pixel in rays.lit.iter().step_by(997) {
            let (u, v) = (*pixel as usize % 768, *pixel as usize / 768);
            for (du, dv) in [(0.0, 0.0), (0.375, -0.125), (-0.2, 0.4)] {
                let mixed = rays.ray(*pixel as usize, du, dv).direction;
                let exact = pal.trace(u as f64 + f64::from(du), v as f64 + f64::from(dv)).unwrap().direction;
                let off = (f64::from(mixed.x) - exact.x)
                    .hypot(f64::from(mixed.y) - exact.y)
                    .hypot(f64::from(mixed.z) - exact.z);
                assert!(off < 1e-3 * pixel_rad, "{off}");
            }
        }
    }

    #[test]
    fn the_annulus_has_the_radii_of_the_design() {
        let spec = CameraSpec::default();
        let (inner, outer) = rim_radii(&Pal::new(&spec), &spec);
        assert!((inner - 157.743).abs() < 1e-3 && (outer - 270.0).abs() < 1e-3, "{inner} {outer}");
    }
}
