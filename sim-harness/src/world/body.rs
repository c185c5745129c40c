//! The robots' body: an upright cylinder painted in rings, a mast, the lens on it. All robots look alike.

use super::solid::Upright;

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
/// Of everything that is not a ring.
pub const BARE_REFLECTANCE: f64 = 0.30;

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

/// Cylinder, mast and lens of a robot standing at (x, y).
pub fn solids(x_m: f64, y_m: f64, camera_height_m: f64) -> [Upright; 3] {
    let upright = |radius: f64, low: f64, high: f64| Upright {
        x: x_m as f32,
        y: y_m as f32,
        radius: radius as f32,
        low: low as f32,
        high: high as f32,
    };
    let lens = camera_height_m - LENS_HALF_HEIGHT_M;
    [
        upright(RADIUS_M, LOW_M, HIGH_M),
        upright(MAST_RADIUS_M, HIGH_M, lens),
        upright(MAST_RADIUS_M, lens, camera_height_m + LENS_HALF_HEIGHT_M),
    ]
}

/// Reflectance of solid number `part` of [`solids`] at height `z` with this upward component of the normal.
pub fn reflectance(part: usize, z_m: f32, normal_z: f32) -> f32 {
    match part {
        0 if normal_z.abs() < 0.5 => RINGS
            .iter()
            .find(|r| f64::from(z_m) >= r.height_m[0] && f64::from(z_m) < r.height_m[1])
            .map_or(BARE_REFLECTANCE, |r| r.reflectance) as f32,
        0 => BARE_REFLECTANCE as f32,
        1 => 0.25,
        _ => 0.12,
    }
}
