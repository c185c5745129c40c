//! How far away: from where the feet touch the floor (`MATHS.md` §7.11, golden group `distance.ground`).
//!
//! tan(−elevation of the feet) = h_c / D. Half a degree of unknown tilt or a table before the feet turn this into nonsense with
//! a small sigma, so a range is only given where the feet are *seen* and the body that follows from it is a body.

/// A distance along the floor with one standard deviation, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Range {
    /// Along the floor.
    pub range_m: f64,
    /// One standard deviation.
    pub sigma_m: f64,
}

/// From the elevation of the ground contact (negative), its sigma (radians, pixel noise and shadow), and the camera's height
/// above the floor and unknown tilt, each with sigma. `None` at or above the horizon.
pub fn from_ground_contact(
    elevation_rad: f64,
    sigma_rad: f64,
    (height_m, height_sigma_m): (f64, f64),
    tilt_sigma_rad: f64,
) -> Option<Range> {
    let slope = (-elevation_rad).tan();
    if !(slope > 1e-3 && height_m > 0.0) {
        return None;
    }
    let range_m = height_m / slope;
    // dD/de = (D² + h²)/h for pixels as for tilt.
    let per_rad = (range_m * range_m + height_m * height_m) / height_m;
    let sigma_m = (per_rad * sigma_rad).hypot(per_rad * tilt_sigma_rad).hypot(range_m * height_sigma_m / height_m);
    Some(Range { range_m, sigma_m })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::golden;

    #[test]
    fn ranges_from_the_ground_and_their_sigmas_are_the_golden_ones() {
        let golden = golden("distance.ground");
        let hc = golden["inputs"]["hc"].as_f64().unwrap();
        let fc = golden["inputs"]["fc"].as_f64().unwrap();
        for case in golden["outputs"].as_array().unwrap() {
            let v = |k: &str| case[k].as_f64().unwrap();
            let elevation = -(v("rows") / fc).atan();
            let pixel_rad = (elevation.cos()).powi(2) / fc;
            let by_pixel = from_ground_contact(elevation, pixel_rad, (hc, 0.0), 0.0).unwrap();
            assert!((by_pixel.range_m - v("D_back")).abs() < 1e-9);
            assert!((by_pixel.sigma_m - v("sigma_1px")).abs() < 1e-9, "{by_pixel:?}");
            let by_tilt = from_ground_contact(elevation, 0.0, (hc, 0.0), 1f64.to_radians()).unwrap();
            assert!((by_tilt.sigma_m / v("sigma_1deg_tilt") - 1.0).abs() < 1e-9, "{by_tilt:?}");
        }
        assert_eq!(from_ground_contact(0.01, 0.01, (0.6, 0.0), 0.0), None);
    }
}
