//! The ray of every pixel, worked out when first asked for.
//!
//! The refinement compares the raw picture with the body pixel by pixel. With the ray (not only the direction) of each pixel
//! it is exact for cameras whose viewpoint is not a point, and needs nothing of the model but `unproject`.

use nalgebra::{Vector2, Vector3};

use crate::optics::MountedCamera;

/// The noise is measured in every so many rows, in pieces of so many pixels of this grey: nearer to black or white it is cut off.
const NOISE_ROWS: usize = 8;
const NOISE_PIECE: usize = 64;
const NOISE_GRAY: std::ops::RangeInclusive<u8> = 8..=247;
/// This share of the pieces is taken to be smooth; so few say nothing.
const SMOOTH: f64 = 0.3;
const LEAST_PIECES: usize = 8;
/// No sensor is taken to be worse, squared grey levels.
const MOST_NOISE2: f64 = 16.0;

/// The ray of one pixel in the body frame, and the local scale of the picture.
#[derive(Debug, Clone, Copy, Default)]
pub struct PixelRay {
    /// Where it leaves the camera, metres.
    pub origin_m: [f32; 3],
    /// Of its direction, radians.
    pub bearing_rad: f32,
    /// Of the bearing.
    pub sine: f32,
    /// Of the bearing.
    pub cosine: f32,
    /// Tangent of its elevation.
    pub slope: f32,
    /// Pixels per radian of bearing; 0: not worked out yet, negative: this pixel sees nothing.
    pub px_per_bearing: f32,
    /// Pixels per radian of elevation.
    pub px_per_elevation: f32,
}

impl PixelRay {
    /// Height of one pixel on an upright surface `distance_m` away along the floor, metres.
    pub fn m_per_px(&self, distance_m: f64) -> f64 {
        let slope = f64::from(self.slope);
        distance_m * (1.0 + slope * slope) / f64::from(self.px_per_elevation)
    }

    /// Its elevation at its own scale, pixels: which row of a small patch it is in.
    pub fn elevation_px(&self) -> f64 {
        f64::from(self.slope).atan() * f64::from(self.px_per_elevation)
    }
}

/// One pixel of a patch: its gray value beside its ray.
#[derive(Debug, Clone, Copy)]
pub struct Sample {
    /// 0 … 255.
    pub gray: f64,
    /// What it sees.
    pub ray: PixelRay,
}

/// Rays of a whole picture, filled as they are needed.
#[derive(Debug)]
pub struct PixelRays {
    width: usize,
    height: usize,
    table: Vec<PixelRay>,
    /// Of the sensor's noise in the picture at hand, squared grey levels: see [`PixelRays::measure_noise`].
    noise2: f64,
    /// The same of its pieces.
    pieces: Vec<f64>,
}

impl PixelRays {
    /// An empty table for a picture of this size.
    pub fn new([width, height]: [u32; 2]) -> Self {
        let (width, height) = (width as usize, height as usize);
        Self { width, height, table: vec![PixelRay::default(); width * height], noise2: 0.0, pieces: Vec::new() }
    }

    /// Takes the noise of a picture from second differences along some of its rows, where it is smooth and neither black nor white.
    pub fn measure_noise(&mut self, raw: &[u8]) {
        self.pieces.clear();
        for piece in raw.chunks_exact(self.width).step_by(NOISE_ROWS).flat_map(|row| row.chunks_exact(NOISE_PIECE)) {
            if !piece.iter().all(|gray| NOISE_GRAY.contains(gray)) {
                continue;
            }
            let bend = |three: &[u8]| i32::from(three[0]) - 2 * i32::from(three[1]) + i32::from(three[2]);
            let squares: i32 = piece.windows(3).map(|three| bend(three).pow(2)).sum();
            self.pieces.push(f64::from(squares) / (6.0 * (NOISE_PIECE - 2) as f64));
        }
        let rank = (SMOOTH * self.pieces.len() as f64) as usize;
        self.noise2 = match self.pieces.len() {
            0..LEAST_PIECES => 0.0,
            _ => self.pieces.select_nth_unstable_by(rank, f64::total_cmp).1.min(MOST_NOISE2),
        };
    }

    /// What [`PixelRays::measure_noise`] found.
    pub fn noise2(&self) -> f64 {
        self.noise2
    }

    /// The ray of pixel (u, v), which must lie in the picture; `None` where the camera sees nothing.
    pub fn get(&mut self, camera: &MountedCamera, u: usize, v: usize) -> Option<PixelRay> {
        let slot = &mut self.table[v * self.width + u];
        if slot.px_per_bearing == 0.0 {
            *slot = work_out(camera, u as f64, v as f64)
                .filter(|_| camera.is_unmasked(&Vector2::new(u as f64, v as f64)))
                .unwrap_or(PixelRay { px_per_bearing: -1.0, ..PixelRay::default() });
        }
        (slot.px_per_bearing > 0.0).then_some(*slot)
    }

    /// All pixels that may see the sector `bearing_rad` ± `half_width_rad` between the elevations `elevation_rad` (a
    /// superset: the box round the sector in the picture).
    pub fn patch(
        &mut self,
        camera: &MountedCamera,
        raw: &[u8],
        bearing_rad: f64,
        half_width_rad: f64,
        elevation_rad: [f64; 2],
        into: &mut Vec<Sample>,
    ) {
        into.clear();
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for i in 0..=12 {
            let b = bearing_rad + half_width_rad * (f64::from(i) / 6.0 - 1.0);
            for e in elevation_rad {
                let direction = Vector3::new(b.cos(), b.sin(), e.tan());
                if let Some(pixel) = camera.project_body_direction(&direction) {
                    for k in 0..2 {
                        low[k] = low[k].min(pixel[k]);
                        high[k] = high[k].max(pixel[k]);
                    }
                }
            }
        }
        // The sides of the sector bulge between the sampled bearings, and points near at hand are displaced by under 2 px.
        let clip = |x: f64, n: usize| x.clamp(0.0, n as f64 - 1.0) as usize;
        if low[0] > high[0] {
            return;
        }
        for v in clip(low[1] - 3.0, self.height)..=clip(high[1] + 4.0, self.height) {
            for u in clip(low[0] - 3.0, self.width)..=clip(high[0] + 4.0, self.width) {
                if let Some(ray) = self.get(camera, u, v) {
                    into.push(Sample { gray: f64::from(raw[v * self.width + u]), ray });
                }
            }
        }
    }
}

fn work_out(camera: &MountedCamera, u: f64, v: f64) -> Option<PixelRay> {
    let angles = |u: f64, v: f64| {
        let ray = camera.unproject_body(&Vector2::new(u, v))?;
        let d = ray.direction;
        Some((ray, d.y.atan2(d.x), d.z.atan2(d.x.hypot(d.y))))
    };
    let (ray, bearing, elevation) = angles(u, v)?;
    // One-sided at the border of the field of view.
    let slope = |du: f64, dv: f64| {
        let ahead = angles(u + du, v + dv).map(|to| difference(to, bearing, elevation, 1.0));
        ahead.or_else(|| angles(u - du, v - dv).map(|to| difference(to, bearing, elevation, -1.0)))
    };
    let (bu, eu) = slope(0.5, 0.0)?;
    let (bv, ev) = slope(0.0, 0.5)?;
    let (per_bearing, per_elevation) = (0.5 / bu.hypot(bv), 0.5 / eu.hypot(ev));
    (per_bearing.is_finite() && per_elevation.is_finite()).then_some(PixelRay {
        origin_m: [ray.origin_m.x as f32, ray.origin_m.y as f32, ray.origin_m.z as f32],
        bearing_rad: bearing as f32,
        sine: bearing.sin() as f32,
        cosine: bearing.cos() as f32,
        slope: elevation.tan() as f32,
        px_per_bearing: per_bearing as f32,
        px_per_elevation: per_elevation as f32,
    })
}

fn difference(to: (crate::optics::Ray, f64, f64), bearing: f64, elevation: f64, sign: f64) -> (f64, f64) {
    (sign * protocol::angle::difference(to.1, bearing), sign * (to.2 - elevation))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::peers::test_scene::Dice;

    #[test]
    fn noise_is_measured_where_it_is_not_cut_off_at_black_or_white() {
        let [width, height] = [640, 320];
        let mut dice = Dice(7);
        // Black and white stripes with a grey part between them that is a third of the picture.
        let light = |v: usize| [2.0, 120.0, 253.0][3 * v / height];
        let raw: Vec<u8> = (0..width * height)
            .map(|i| (light(i / width) + 2.0 * dice.normal()).round().clamp(0.0, 255.0) as u8)
            .collect();
        let mut rays = PixelRays::new([width as u32, height as u32]);
        rays.measure_noise(&raw);
        assert!((3.2..4.4).contains(&rays.noise2()), "{}", rays.noise2());
    }
}
