//! Which mirrors have a single viewpoint, and what a mirror without one costs.
//!
//! Baker and Nayar's condition r(c−2z)z′² − 2(r²+cz−z²)z′ + r(2z−c) = 0 for a viewpoint at 0 and a pinhole at (0, c) has
//! the conics as its only solutions, with one free k. Source: Baker and Nayar 1999; `MATHS.md` §1.0.

use std::f64::consts::FRAC_PI_2;

use nalgebra::Vector3;

use super::{Camera, bearing_rad, direction, elevation_rad};

/// (a, b) of the hyperboloid for a pinhole at a distance c from the viewpoint, k > 2; lengths in the unit of c.
pub fn hyperboloid(c: f64, k: f64) -> [f64; 2] {
    [0.5 * c * ((k - 2.0) / k).sqrt(), 0.5 * c * (2.0 / k).sqrt()]
}

/// (a, b) of the ellipsoid for a pinhole at a distance c from the viewpoint, k > 0 in the square of the unit of c.
pub fn ellipsoid(c: f64, k: f64) -> [f64; 2] {
    [0.5 * (2.0 * k + c * c).sqrt(), (0.5 * k).sqrt()]
}

/// The largest errors, over a camera's picture, of taking its rays to come from [`Camera::viewpoint_m`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ViewpointCost {
    /// Distance of the objects from the viewpoint, m.
    pub distance_m: f64,
    /// Of a bearing, radians.
    pub bearing_rad: f64,
    /// Of an elevation, radians.
    pub elevation_rad: f64,
}

/// What a fixed viewpoint costs at a distance: objects that far from the viewpoint, along the rays of a grid of pixels.
///
/// A camera that is used with a fixed viewpoint takes the ray's direction for the object's; the error is the angle
/// between it and the direction from the viewpoint to the object.
pub fn cost(camera: &dyn Camera, distance_m: f64) -> ViewpointCost {
    const STEPS: u32 = 96;
    let [w, h] = camera.image_size_px().map(f64::from);
    let viewpoint = camera.viewpoint_m();
    let mut worst = ViewpointCost { distance_m, bearing_rad: 0.0, elevation_rad: 0.0 };
    for n in 0..STEPS * STEPS {
        let at = |i: u32, side: f64| (f64::from(i) + 0.5) / f64::from(STEPS) * side - 0.5;
        let pixel = nalgebra::Vector2::new(at(n % STEPS, w), at(n / STEPS, h));
        let Some(ray) = camera.unproject(&pixel) else { continue };
        // The point of the ray at that distance from the viewpoint.
        let from = ray.origin_m - viewpoint;
        let along = from.dot(&ray.direction);
        let rest = along * along - from.norm_squared() + distance_m * distance_m;
        if rest < 0.0 {
            continue;
        }
        let seen: Vector3<f64> = from + ray.direction * (rest.sqrt() - along);
        // At the poles a bearing means nothing.
        let elevation = elevation_rad(&ray.direction);
        if elevation.abs() < FRAC_PI_2 - 0.05 {
            let bearing = protocol::angle::wrap(bearing_rad(&seen) - bearing_rad(&ray.direction));
            worst.bearing_rad = worst.bearing_rad.max(bearing.abs());
        }
        worst.elevation_rad = worst.elevation_rad.max((elevation_rad(&seen) - elevation).abs());
    }
    worst
}

/// A camera's viewpoint locus on one meridian: for each elevation the point of the axis that its ray passes, and the
/// point of the caustic that it touches; m, in the camera's frame with r along the meridian.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LocusPoint {
    /// Elevation of the ray, radians.
    pub elevation_rad: f64,
    /// Where it crosses the axis: z, m.
    pub axis_z_m: f64,
    /// Where it touches its neighbours: (r, z), m.
    pub caustic_m: [f64; 2],
}

/// The viewpoint locus at a number of elevations over the field of view, for a camera with an axis of symmetry along z;
/// empty for central cameras.
pub fn locus(camera: &dyn Camera, points: u32) -> Vec<LocusPoint> {
    // Differences of rays: as for `axial::caustic_mm`.
    const STEP_RAD: f64 = 1e-5;
    if camera.viewpoint_miss_m() == 0.0 {
        return Vec::new();
    }
    let [low, high] = camera.elevation_rad();
    let ray = |elevation: f64| {
        let ray = camera.ray_of_image(&camera.image_of_direction(&direction(0.0, elevation))?)?;
        Some(([ray.origin_m.x, ray.origin_m.z], elevation))
    };
    (0..points)
        .filter_map(|i| {
            let t = (f64::from(i) + 0.5) / f64::from(points);
            let elevation = low + (high - low) * t;
            let ([r, z], _) = ray(elevation)?;
            let ((plus, above), (minus, below)) = (ray(elevation + STEP_RAD)?, ray(elevation - STEP_RAD)?);
            let (sin, cos) = elevation.sin_cos();
            // u = (cos e, sin e), its turn n = (−sin e, cos e).
            let s = ((plus[0] - minus[0]) * sin - (plus[1] - minus[1]) * cos) / (above - below);
            Some(LocusPoint {
                elevation_rad: elevation,
                axis_z_m: z - r * sin / cos,
                caustic_m: [r + s * cos, z + s * sin],
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::Pal;
    use crate::optics::laws::{assert_rel, golden};

    #[test]
    fn the_conics_of_baker_and_nayar_are_golden() {
        for (group, conic) in [("bn.hyperboloid", hyperboloid as fn(f64, f64) -> [f64; 2]), ("bn.ellipsoid", ellipsoid)]
        {
            let (inputs, golden, tol) = golden(group);
            let [a, b] = conic(inputs["c"].as_f64().unwrap(), inputs["k"].as_f64().unwrap());
            assert_rel(a, &golden["a"], tol);
            assert_rel(b, &golden["b"], tol);
        }
    }

    #[test]
    fn design_d_s_fixed_viewpoint_costs_what_maths_says() {
        // MATHS §3.4: 0.344° at 0.25 m … 0.0086° at 10 m, bearings exact.
        let camera = Pal::reference();
        for (distance_m, elevation_deg) in [(0.25, 0.344), (0.5, 0.172), (1.0, 0.086), (3.0, 0.029), (10.0, 0.0086)] {
            let cost = cost(&camera, distance_m);
            let ours = cost.elevation_rad.to_degrees();
            assert!((ours - elevation_deg).abs() < 0.015 * elevation_deg + 5e-5, "{ours} at {distance_m}");
            assert!(cost.bearing_rad < 1e-12);
        }
    }

    #[test]
    fn design_d_s_locus_is_that_of_its_closed_form() {
        let camera = Pal::reference();
        let window = camera.optics().window;
        for point in locus(&camera, 9) {
            let ray = window.ray_of_zenith(FRAC_PI_2 - point.elevation_rad).unwrap();
            assert!((point.axis_z_m * 1e3 - window.axis_crossing_mm(&ray)).abs() < 1e-9);
            let caustic = window.caustic_mm(&ray);
            for i in 0..2 {
                assert!((point.caustic_m[i] * 1e3 - caustic[i]).abs() < 1e-6, "{point:?} {caustic:?}");
            }
        }
    }
}
