//! Why no PAL has two paraboloids as mirrors: an analysis, not a camera.
//!
//! The ring mirror, a concave paraboloid about V, sends the light that comes through V at a zenith angle ζ up along the
//! axis at the distance r = p₁ tan(ζ/2) from it. So light between the mirrors is collimated, the second paraboloid must
//! be as wide as the ring itself, and it hides the sky from V down to its rim. It is not the single viewpoint that is
//! lost: a concave second mirror has a real focus B and keeps it (the report's argument, that light diverges from B,
//! holds for a convex one). Source: report 3.3 with its erratum, `MATHS.md` §0.

use std::f64::consts::FRAC_PI_2;

/// A ring paraboloid about V and a second paraboloid over it, about the same axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TwoParaboloids {
    /// p₁: semi-latus rectum of the ring mirror, mm.
    pub first_p_mm: f64,
    /// Height of the second mirror's rim above V, mm.
    pub second_rim_z_mm: f64,
}

impl TwoParaboloids {
    /// How far from the axis light of a zenith angle runs between the mirrors, mm.
    pub fn collimated_radius_mm(&self, zenith_rad: f64) -> f64 {
        self.first_p_mm * (0.5 * zenith_rad).tan()
    }

    /// The radius that the second mirror needs for a field of view down to an elevation, mm.
    pub fn second_radius_mm(&self, lowest_elevation_rad: f64) -> f64 {
        self.collimated_radius_mm(FRAC_PI_2 - lowest_elevation_rad)
    }

    /// The elevation of the second mirror's rim from V: all above is hidden by it.
    pub fn hidden_above_rad(&self, lowest_elevation_rad: f64) -> f64 {
        self.second_rim_z_mm.atan2(self.second_radius_mm(lowest_elevation_rad))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAIR: TwoParaboloids = TwoParaboloids { first_p_mm: 20.0, second_rim_z_mm: 9.0 };

    /// Reflection at z = (r² − p²)/2p in the meridian plane, for light that came through V.
    fn reflected(zenith: f64) -> (f64, [f64; 2]) {
        let p = PAIR.first_p_mm;
        let towards = [-zenith.sin(), -zenith.cos()];
        // t with z = (r² − p²)/2p: t² sin² + 2pt cos − p² = 0.
        let (sin, cos) = zenith.sin_cos();
        let t = p * (-cos + (cos * cos + sin * sin).sqrt()) / (sin * sin);
        let (r, slope) = (t * towards[0], t * towards[0] / p);
        let normal = [-slope / slope.hypot(1.0), 1.0 / slope.hypot(1.0)];
        let twice = 2.0 * (towards[0] * normal[0] + towards[1] * normal[1]);
        (r, [towards[0] - twice * normal[0], towards[1] - twice * normal[1]])
    }

    #[test]
    fn light_between_the_mirrors_is_collimated_at_the_stated_radius() {
        for zenith_deg in [40.0, 70.0, 90.0, 105.0] {
            let (r, towards) = reflected(f64::to_radians(zenith_deg));
            assert!(towards[0].abs() < 1e-14 && towards[1] > 0.0, "{towards:?}");
            assert!((r.abs() - PAIR.collimated_radius_mm(f64::to_radians(zenith_deg))).abs() < 1e-12);
        }
    }

    #[test]
    fn the_second_mirror_of_design_d_s_field_of_view_is_wider_than_its_ring_and_hides_the_upper_half_of_it() {
        let lowest = f64::to_radians(-15.0);
        assert!(PAIR.second_radius_mm(lowest) > 26.0, "wider than D's whole block, 20 mm");
        assert!(PAIR.hidden_above_rad(lowest).to_degrees() < 20.0, "D sees up to 20 degrees");
    }
}
