//! A PAL camera's glass, traced: sensor → pinhole → hyperboloid mirror → ellipsoid mirror → refracting ellipsoid → world.
//!
//! ```text
//!        z ▲      B · common focus of both mirrors
//!          │     ⌣   second mirror: hyperboloid round B, its other focus is the pinhole O
//!      ____│____     outer surface R: ellipsoid, upper focus V, glass inside
//!     /    V    \    ring mirror: ellipsoid, foci V and B, mirrored from inside
//!     \____|____/
//!          O         pinhole
//!        ──┼──       sensor, looking up
//! ```
//!
//! Every ray is carried in three dimensions from surface to surface: a quadratic for the intersection, the gradient for the
//! normal, vector reflection and vector refraction. Nothing uses that the surfaces share foci; that rays then meet in V is
//! what the tests observe. Lengths in millimetres, origin V, x forward, y left, z up.

use nalgebra::Vector3;

use super::surface::{Quadric, reflect, refract};
use crate::scenario::CameraSpec;

type V = Vector3<f64>;

/// A point and a direction on the way of light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Traced {
    /// On the second mirror.
    pub hyperboloid_mm: V,
    /// On the ring mirror.
    pub ellipsoid_mm: V,
    /// Direction inside the glass after the ring mirror.
    pub inner_direction: V,
    /// Where it leaves the glass.
    pub origin_mm: V,
    /// Unit vector out into the world.
    pub direction: V,
}

/// The glass of one camera.
#[derive(Debug, Clone, Copy)]
pub struct Pal {
    centre_px: [f64; 2],
    focal_length_px: f64,
    pinhole: V,
    second: Quadric,
    second_centre: f64,
    ring: Quadric,
    outer: Quadric,
    refractive_index: f64,
}

impl Pal {
    /// From the lengths of a scenario's camera.
    pub fn new(spec: &CameraSpec) -> Self {
        let (ae, ce) = (spec.ellipsoid_a_mm, spec.ellipsoid_c_mm);
        let (ah, ch) = (spec.hyperboloid_a_mm, spec.hyperboloid_c_mm);
        let (ar, cr) = (spec.refraction_a_mm, spec.refraction_a_mm * spec.refraction_eccentricity);
        let focus_b = 2.0 * ce;
        Self {
            centre_px: spec.centre_px,
            focal_length_px: spec.focal_length_px,
            pinhole: V::new(0.0, 0.0, focus_b - 2.0 * ch),
            second: Quadric::conic(focus_b - ch, ah * ah, ch * ch - ah * ah, -1.0),
            second_centre: focus_b - ch,
            ring: Quadric::conic(ce, ae * ae, ae * ae - ce * ce, 1.0),
            outer: Quadric::conic(-cr, ar * ar, ar * ar - cr * cr, 1.0),
            refractive_index: spec.refractive_index,
        }
    }

    /// The way of the light that falls on a point of the picture; `None` where there is none.
    ///
    /// The sensor lies below the pinhole and looks up. Its columns run along the body's x and its rows along y, so that
    /// with light crossing the axis twice (in the pinhole, and at the ring mirror's focus) the point straight ahead is at
    /// u > u₀, v = v₀.
    pub fn trace(&self, u_px: f64, v_px: f64) -> Option<Traced> {
        let sensor = V::new(u_px - self.centre_px[0], v_px - self.centre_px[1], -self.focal_length_px);
        let up = -sensor.normalize();
        let [first, other] = self.second.hits(&self.pinhole, &up)?;
        // The mirror is the upper sheet.
        let hyperboloid = [first, other]
            .into_iter()
            .filter(|t| *t > 1e-9)
            .map(|t| self.pinhole + up * t)
            .find(|p| p.z > self.second_centre)?;
        let down = reflect(&up, &self.second.normal(&hyperboloid));
        let ellipsoid = hyperboloid + down * self.ring.hits(&hyperboloid, &down)?[1];
        let inner = reflect(&down, &self.ring.normal(&ellipsoid));
        let origin = ellipsoid + inner * self.outer.hits(&ellipsoid, &inner)?[1];
        let direction = refract(&inner, &self.outer.normal(&origin), self.refractive_index)?;
        Some(Traced {
            hyperboloid_mm: hyperboloid,
            ellipsoid_mm: ellipsoid,
            inner_direction: inner,
            origin_mm: origin,
            direction,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(serde::Deserialize)]
    struct Golden {
        #[serde(rename = "pal.backproject")]
        backproject: Group,
    }
    #[derive(serde::Deserialize)]
    struct Group {
        outputs: Vec<Row>,
    }
    #[derive(serde::Deserialize)]
    struct Row {
        #[serde(rename = "r_I")]
        r_i: f64,
        #[serde(rename = "H")]
        h: [f64; 2],
        #[serde(rename = "E")]
        e: [f64; 2],
        #[serde(rename = "R")]
        r: [f64; 2],
        elev_out_deg: f64,
    }

    fn distance_to_focus(t: &Traced) -> f64 {
        t.ellipsoid_mm.cross(&t.inner_direction).norm()
    }

    #[test]
    fn traced_rays_pass_the_focus_of_the_ring_mirror() {
        let pal = Pal::new(&CameraSpec::default());
        for n in 0..360 {
            let (sin, cos) = (f64::from(n) * 0.7).sin_cos();
            let r = 157.0 + 113.0 * f64::from(n) / 360.0;
            let traced = pal.trace(383.5 + r * cos, 287.5 + r * sin).unwrap();
            assert!(distance_to_focus(&traced) < 1e-9, "{r}: {}", distance_to_focus(&traced));
        }
    }

    #[test]
    fn traced_points_and_elevations_are_the_golden_ones() {
        let text = include_str!("../../../tests/golden/golden.json");
        let golden: Golden = serde_json::from_str(text).unwrap();
        let pal = Pal::new(&CameraSpec::default());
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-8 * b.abs().max(1.0), "{a} against {b}");
        for row in golden.backproject.outputs {
            for turn in [0.0f64, 1.0, -2.5] {
                let (u, v) = (383.5 + row.r_i * turn.cos(), 287.5 + row.r_i * turn.sin());
                let t = pal.trace(u, v).unwrap();
                for (p, [r, z]) in [(t.hyperboloid_mm, row.h), (t.ellipsoid_mm, row.e), (t.origin_mm, row.r)] {
                    close(p.x.hypot(p.y), r);
                    close(p.z, z);
                }
                close(t.direction.z.asin().to_degrees(), row.elev_out_deg);
            }
        }
    }

    #[test]
    fn straight_ahead_is_right_of_the_centre_and_left_is_below() {
        let pal = Pal::new(&CameraSpec::default());
        let ahead = pal.trace(383.5 + 210.0, 287.5).unwrap().direction;
        assert!(ahead.x > 0.9 && ahead.y.abs() < 1e-12);
        let left = pal.trace(383.5, 287.5 + 210.0).unwrap().direction;
        assert!(left.y > 0.9 && left.x.abs() < 1e-12);
    }
}
