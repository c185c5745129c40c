//! Where a ray meets a vertical cylinder.
//!
//! Bearings of outlines need care at one place only: the two tangents are at β ± asin(R/B) (not atan: report eq. 5-2 as
//! printed, `MATHS.md` errata), and the near surface is at B − R, the outline at √(B² − R²).

use super::rays::PixelRay;

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
        let outline_rad = (radius_m / range_m).clamp(0.0, 1.0).asin();
        Self { range_m, radius_m, outline_rad, axis: [range_m * c, range_m * s] }
    }

    /// Height above the floor where the ray meets the surface, as in [`Cylinder::meet`]: the part of it that the fits repeat.
    pub fn height_m(&self, ray: &PixelRay) -> f64 {
        let (s, c) = (f64::from(ray.sine), f64::from(ray.cosine));
        let m = [self.axis[0] - f64::from(ray.origin_m[0]), self.axis[1] - f64::from(ray.origin_m[1])];
        let across = m[1] * c - m[0] * s;
        let deep = (self.radius_m * self.radius_m - across * across).max(0.0).sqrt();
        f64::from(ray.origin_m[2]) + f64::from(ray.slope) * (m[0] * c + m[1] * s - deep)
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
}
