//! What surfaces look like: reflectance as a function of the place on the surface, in metres. Everything is smooth noise
//! and simple patterns from a seed; nothing here knows about cameras or light.

/// A surface's paint. Reflectances in 0 … 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Paint {
    /// Painted wall or ceiling: faint, wide mottling.
    Plaster(f32),
    /// Boards along u with grain.
    Wood(f32),
    /// Square carpet tiles of half a metre with fibre noise.
    Carpet(f32),
    /// Rows of book spines between boards.
    Books,
    /// A picture of large blots in a white margin; the number chooses which.
    Poster(u32),
    /// A door with frame and panels.
    Door,
    /// Upholstery.
    Fabric(f32),
    /// Ceiling panels.
    Panels(f32),
    /// Cabinet front with drawers and handles.
    Drawers(f32),
    /// A dark screen with a bright window.
    Screen,
    /// A bright board with lines of writing.
    Whiteboard,
    /// Dark and bright stripes of this height, the lowest dark.
    Stripes(f32),
}

impl Paint {
    /// Reflectance at (u, v) metres from the lower left corner of a surface of this size.
    pub fn reflectance(self, seed: u32, u: f32, v: f32, size: [f32; 2]) -> f32 {
        let s = seed;
        match self {
            Self::Plaster(base) => {
                base * (1.0 + 0.10 * cloud(s, u * 1.1, v * 1.1) + 0.06 * cloud(s ^ 7, u * 9.0, v * 9.0))
            }
            Self::Wood(base) => {
                let board = (v / 0.11).floor();
                let tone = 0.12 * cell(s, board as i32, 3);
                base * (1.0 + tone + 0.16 * cloud(s ^ 5, u * 2.2 + board * 17.0, v * 28.0))
            }
            Self::Carpet(base) => {
                let (i, j) = ((u / 0.5).floor(), (v / 0.5).floor());
                let seam = edge(u, 0.5, 0.012).max(edge(v, 0.5, 0.012));
                let tone = 0.14 * cell(s, i as i32, j as i32);
                base * (1.0 + tone + 0.22 * cloud(s ^ 11, u * 13.0, v * 13.0)) * (1.0 - 0.25 * seam)
            }
            Self::Books => {
                let shelf = (v / 0.33).floor();
                let height = v - shelf * 0.33;
                if height < 0.03 || u < 0.025 || u > size[0] - 0.025 {
                    return 0.55;
                }
                let x = u + 0.3 * cell(s, shelf as i32, 9);
                let book = (x / 0.045 + 0.5 * cloud(s, x * 4.0, shelf * 3.1)).floor();
                let top = 0.24 + 0.05 * cell(s ^ 3, book as i32, shelf as i32);
                if height > top {
                    return 0.06;
                }
                let band = if (height - 0.17).abs() < 0.015 { 0.25 } else { 0.0 };
                (0.38 + 0.34 * cell(s ^ 21, book as i32, shelf as i32) + band).clamp(0.05, 0.9)
            }
            Self::Poster(which) => {
                let margin = 0.04;
                if u < margin || v < margin || u > size[0] - margin || v > size[1] - margin {
                    return 0.88;
                }
                let s = s ^ which.wrapping_mul(0x9e37);
                let blot = cloud(s, u * 4.0, v * 4.0) + 0.5 * cloud(s ^ 2, u * 11.0, v * 11.0);
                let line = if v < 0.2 && edge(v, 0.05, 0.02) > 0.5 && u < size[0] * 0.8 { -0.35 } else { 0.0 };
                (0.46 + 0.75 * blot + line).clamp(0.06, 0.85)
            }
            Self::Door => {
                let frame = u < 0.07 || u > size[0] - 0.07 || v > size[1] - 0.07;
                let handle = (u - (size[0] - 0.17)).abs() < 0.06 && (v - 1.03).abs() < 0.018;
                let panel = edge((v - 0.3).max(0.0), 0.75, 0.02) > 0.0
                    || (u - 0.2).abs() < 0.01
                    || (u - size[0] + 0.2).abs() < 0.01;
                if handle {
                    0.75
                } else if frame {
                    0.30
                } else {
                    (if panel { 0.24 } else { 0.36 }) * (1.0 + 0.18 * cloud(s, u * 20.0, v * 1.6))
                }
            }
            Self::Fabric(base) => {
                base * (1.0 + 0.20 * cloud(s, u * 7.0, v * 7.0) + 0.15 * cloud(s ^ 1, u * 23.0, v * 23.0))
            }
            Self::Panels(base) => {
                let seam = edge(u, 0.6, 0.02).max(edge(v, 0.6, 0.02));
                base * (1.0 + 0.05 * cloud(s, u * 6.0, v * 6.0)) * (1.0 - 0.45 * seam)
            }
            Self::Drawers(base) => {
                let gap = edge(v, 0.38, 0.014).max(edge(u, 0.5, 0.014));
                let (du, dv) = (u.rem_euclid(0.5) - 0.25, v.rem_euclid(0.38) - 0.30);
                let handle = if du.abs() < 0.07 && dv.abs() < 0.012 { -0.55 } else { 0.0 };
                base * (1.0 + 0.07 * cloud(s, u * 3.0, v * 3.0) + handle) * (1.0 - 0.6 * gap)
            }
            Self::Screen => {
                let window = u > 0.1 * size[0] && u < 0.7 * size[0] && v > 0.2 * size[1] && v < 0.8 * size[1];
                let text = edge(v, 0.03, 0.015) * 0.4;
                if window { 0.8 - text } else { 0.12 }
            }
            Self::Stripes(height) => {
                let is_bright = (v / height) as i32 % 2 == 1;
                (if is_bright { 0.8 } else { 0.12 }) * (1.0 + 0.1 * cloud(s, u * 9.0, v * 9.0))
            }
            Self::Whiteboard => {
                let rim = u < 0.03 || v < 0.03 || u > size[0] - 0.03 || v > size[1] - 0.03;
                let row = edge(v, 0.16, 0.05) > 0.0 && cloud(s, u * 14.0, (v / 0.16).floor() * 5.0) > 0.05;
                let written = row && u > 0.15 && u < size[0] - 0.3;
                if rim || written { 0.35 } else { 0.86 }
            }
        }
        .clamp(0.02, 0.95)
    }
}

/// 1 near a multiple of `period` (within half of `width`), 0 elsewhere.
fn edge(x: f32, period: f32, width: f32) -> f32 {
    let m = x.rem_euclid(period);
    if m.min(period - m) < 0.5 * width { 1.0 } else { 0.0 }
}

/// A number in −1 … 1 for a cell of a grid.
pub fn cell(seed: u32, i: i32, j: i32) -> f32 {
    let mut h =
        seed.wrapping_mul(0x9e37_79b9) ^ (i as u32).wrapping_mul(0x85eb_ca6b) ^ (j as u32).wrapping_mul(0xc2b2_ae35);
    h ^= h >> 15;
    h = h.wrapping_mul(0x2c1b_3c6d);
    h ^= h >> 12;
    h = h.wrapping_mul(0x297a_2d39);
    h ^= h >> 15;
    h as f32 * (2.0 / 4_294_967_295.0) - 1.0
}

/// Smooth noise in about −1 … 1, one blot a unit, with an octave of detail.
pub fn cloud(seed: u32, u: f32, v: f32) -> f32 {
    0.7 * smooth(seed, u, v) + 0.3 * smooth(seed ^ 0x51, 2.0 * u, 2.0 * v)
}

fn smooth(seed: u32, u: f32, v: f32) -> f32 {
    let (i, j) = (u.floor(), v.floor());
    let (fu, fv) = (u - i, v - j);
    let (i, j) = (i as i32, j as i32);
    let (su, sv) = (fu * fu * (3.0 - 2.0 * fu), fv * fv * (3.0 - 2.0 * fv));
    let low = cell(seed, i, j) * (1.0 - su) + cell(seed, i + 1, j) * su;
    let high = cell(seed, i, j + 1) * (1.0 - su) + cell(seed, i + 1, j + 1) * su;
    low * (1.0 - sv) + high * sv
}
