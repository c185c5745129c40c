//! A nearer body and what it hides of those behind it.
//!
//! A camera on top of a robot looks down on its fellows: what stands behind one shows above it. So a body hides a sector only
//! below its own upper end, and somebody right behind is measured by what shows over it.

use protocol::angle::difference;

use super::geometry;
use super::rays::PixelRay;

/// So far above its upper end a body's light may be mixed in, pixels.
const MARGIN_PX: f64 = 2.5;

/// A body that was found, as seen from the camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Occluder {
    /// Bearings of its right and left outline, radians.
    pub sector_rad: [f64; 2],
    /// To its axis along the floor, metres.
    pub range_m: f64,
    /// Tangent of the elevation of its upper end where it reaches highest in the picture.
    pub top: f64,
}

impl Occluder {
    /// An upright cylinder of this height and radius, seen by a camera at this height.
    pub fn new(bearing_rad: f64, range_m: f64, [radius_m, height_m]: [f64; 2], camera_height_m: f64) -> Self {
        let half = geometry::outline_rad(radius_m, range_m);
        let rise = height_m - camera_height_m;
        // Looked down on, the far side of the lid is its highest line.
        let distance_m = if rise < 0.0 { range_m + radius_m } else { (range_m - radius_m).max(0.1) };
        Self { sector_rad: [bearing_rad - half, bearing_rad + half], range_m, top: rise / distance_m }
    }

    /// An upright sheet of this height between these bearings, its robot at this range.
    pub fn sheet(sector_rad: [f64; 2], range_m: f64, height_m: f64, camera_height_m: f64) -> Self {
        Self { sector_rad, range_m, top: (height_m - camera_height_m) / range_m }
    }

    /// Whether it fills this bearing up to its upper end.
    pub fn is_at(&self, bearing_rad: f64) -> bool {
        geometry::is_within(self.sector_rad, bearing_rad)
    }

    /// The share of a body's width in its sector, where that shows at this bearing, half as wide.
    pub fn hidden_share(&self, bearing_rad: f64, half_rad: f64) -> f32 {
        let from = |end: f64| difference(self.sector_rad[usize::from(end > 0.0)], bearing_rad);
        let hidden = from(1.0).min(half_rad) - from(-1.0).max(-half_rad);
        (hidden / (2.0 * half_rad)).clamp(0.0, 1.0) as f32
    }

    /// Whether a pixel sees it, or may.
    pub fn hides(&self, ray: &PixelRay) -> bool {
        let slope = f64::from(ray.slope);
        let margin = MARGIN_PX * (1.0 + slope * slope) / f64::from(ray.px_per_elevation);
        slope < self.top + margin && self.is_at(f64::from(ray.bearing_rad))
    }

    /// Whether something whose lower end is `height_m` high and `distance_m` away shows above it wholly.
    pub fn is_below(&self, height_m: f64, distance_m: f64, camera_height_m: f64) -> bool {
        (height_m - camera_height_m) / distance_m > self.top
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_higher_than_a_nearer_body_shows_above_it() {
        // A camera at 0.6 m over a body of 0.4 m at 2 m: one sees over its far side down to 0.2 / 2.2 below the horizon.
        let body = Occluder::new(0.3, 2.0, [0.2, 0.4], 0.6);
        assert!((body.top + 0.2 / 2.2).abs() < 1e-12);
        // Three metres away that is 0.6 − 3·0.0909 = 0.327 m high.
        assert!(body.is_below(0.34, 3.0, 0.6) && !body.is_below(0.31, 3.0, 0.6));
        assert!(body.is_at(0.3) && body.is_at(0.39) && !body.is_at(0.41) && !body.is_at(0.19));
        // From below one sees its near side, and nothing over it that is not higher.
        let above = Occluder::new(0.3, 2.0, [0.2, 0.8], 0.6);
        assert!((above.top - 0.2 / 1.8).abs() < 1e-12);
    }
}
