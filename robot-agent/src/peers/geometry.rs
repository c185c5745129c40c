//! Where a ray meets a vertical cylinder.
//!
//! Bearings of outlines need care at one place only: the two tangents are at β ± asin(R/B) (not atan: report eq. 5-2 as
//! printed, `MATHS.md` errata), and the near surface is at B − R, the outline at √(B² − R²).

use protocol::angle::difference;

use super::rays::PixelRay;

/// Towards the outline the distance changes ever faster; it is taken to do so no faster than where the cosine of the angle of
/// incidence is the root of this.
const LEAST_DEEP: f64 = 0.01;

/// A vertical cylinder on the floor as the observer's body frame has it.
#[derive(Debug, Clone, Copy)]
pub struct Cylinder {
    /// Of the axis along the floor, metres.
    pub range_m: f64,
    /// Metres.
    pub radius_m: f64,
    /// Of the outlines on either side of the axis, radians: asin(R/B).
    pub outline_rad: f64,
    axis: [f64; 2],
}

/// Where a ray passes a cylinder.
#[derive(Debug, Clone, Copy)]
pub struct Meeting {
    /// Sine of the angle of incidence, positive left of the axis; beyond ±1 the ray passes by.
    pub sine: f64,
    /// Bearing of the ray less that of the axis, radians, positive to the left.
    pub aside_rad: f64,
    /// Along the floor to the surface (to the outline's plane where the ray passes by), metres.
    pub distance_m: f64,
    /// Height above the floor there, metres.
    pub height_m: f64,
}

impl Cylinder {
    /// A cylinder; the observer must be outside (`range_m > radius_m`).
    pub fn new(bearing_rad: f64, range_m: f64, radius_m: f64) -> Self {
        let (s, c) = bearing_rad.sin_cos();
        Self { range_m, radius_m, outline_rad: outline_rad(radius_m, range_m), axis: [range_m * c, range_m * s] }
    }

    /// How the distance along a ray to the surface grows as the axis turns to the left, metres per radian, and as it moves away.
    pub fn distance_slopes(&self, ray: &PixelRay, met: &Meeting) -> [f64; 2] {
        let (s, c) = (f64::from(ray.sine), f64::from(ray.cosine));
        // Of the axis along and across the ray, as seen from the body frame's origin.
        let (along, across) = (self.axis[0] * c + self.axis[1] * s, self.axis[1] * c - self.axis[0] * s);
        let deep = (1.0 - met.sine * met.sine).max(LEAST_DEEP).sqrt();
        let by_across = -met.sine / deep;
        [by_across * along - across, (along + by_across * across) / self.range_m]
    }

    /// Sine of the angle of incidence alone, as in [`Cylinder::meet`].
    pub fn sine(&self, ray: &PixelRay) -> f64 {
        let m = [self.axis[0] - f64::from(ray.origin_m[0]), self.axis[1] - f64::from(ray.origin_m[1])];
        (m[0] * f64::from(ray.sine) - m[1] * f64::from(ray.cosine)) / self.radius_m
    }

    /// Where the ray passes.
    pub fn meet(&self, ray: &PixelRay) -> Meeting {
        let (s, c) = (f64::from(ray.sine), f64::from(ray.cosine));
        let m = [self.axis[0] - f64::from(ray.origin_m[0]), self.axis[1] - f64::from(ray.origin_m[1])];
        let along = m[0] * c + m[1] * s;
        let across = m[1] * c - m[0] * s;
        let sine = -across / self.radius_m;
        let deep = (1.0 - sine * sine).max(0.0).sqrt();
        let distance_m = along - self.radius_m * deep;
        Meeting {
            sine,
            // Rays of a camera on the axis start on their own bearing: `across` is B·sin(β − b).
            aside_rad: small_arcsine(-across / self.range_m),
            distance_m,
            height_m: f64::from(ray.origin_m[2]) + f64::from(ray.slope) * distance_m,
        }
    }
}

/// Of either outline from the axis of a cylinder, radians: asin(R/B).
pub fn outline_rad(radius_m: f64, range_m: f64) -> f64 {
    (radius_m / range_m).clamp(0.0, 1.0).asin()
}

/// Whether a bearing lies in a sector [right, left], radians.
pub fn is_within([right, left]: [f64; 2], bearing_rad: f64) -> bool {
    difference(bearing_rad, right) > 0.0 && difference(left, bearing_rad) > 0.0
}

/// asin to 10⁻⁶ without the call, for the angles that a body fills beyond four radii.
fn small_arcsine(x: f64) -> f64 {
    let q = x * x;
    if q > 0.12 {
        return x.clamp(-1.0, 1.0).asin();
    }
    x * (1.0 + q * (1.0 / 6.0 + q * (3.0 / 40.0 + q * (15.0 / 336.0 + q * (105.0 / 3456.0 + q * 0.0224)))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_short_arcsine_is_the_arcsine() {
        for i in -100..=100 {
            let x = f64::from(i) * 0.01;
            assert!((small_arcsine(x) - x.asin()).abs() < 1e-6, "{x}");
        }
    }

    #[test]
    fn the_slopes_of_the_distance_are_those_of_differences() {
        let at = |bearing, range| Cylinder::new(bearing, range, 0.2);
        let (bearing, range, step) = (0.4, 1.7, 1e-5);
        for aside in [-0.09, -0.03, 0.0, 0.05, 0.1f64] {
            let (sine, cosine) = (bearing + aside).sin_cos();
            let ray = PixelRay {
                origin_m: [0.02, -0.01, 0.6],
                bearing_rad: (bearing + aside) as f32,
                sine: sine as f32,
                cosine: cosine as f32,
                slope: -0.2,
                px_per_bearing: 150.0,
                px_per_elevation: 150.0,
            };
            let distance = |b: f64, r: f64| at(b, r).meet(&ray).distance_m;
            let [by_bearing, by_range] = at(bearing, range).distance_slopes(&ray, &at(bearing, range).meet(&ray));
            let turned = (distance(bearing + step, range) - distance(bearing - step, range)) / (2.0 * step);
            let moved = (distance(bearing, range + step) - distance(bearing, range - step)) / (2.0 * step);
            assert!((by_bearing - turned).abs() < 1e-4 * (1.0 + turned.abs()), "{aside}: {by_bearing} {turned}");
            assert!((by_range - moved).abs() < 1e-4, "{aside}: {by_range} {moved}");
        }
    }
}
