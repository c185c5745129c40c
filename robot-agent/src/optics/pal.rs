//! The report's panoramic annular lens: ellipsoid and hyperboloid mirrors in one block of glass, a perspective camera
//! below, refraction where the light enters (`model = "pal"`).
//!
//! The camera looks up; the centre of the picture is the zenith and the outer rim the lowest elevation. By the symmetry
//! about the axis a point's azimuth is its image's, so all optics are in the [`Meridian`] plane. The viewpoint is not
//! quite one point: a ray's origin is where it leaves the glass.
//!
//! Source: report section 3.4 and 3.5 with errata, `MATHS.md` §3.

mod meridian;
use std::f64::consts::FRAC_PI_2;

use nalgebra::{Vector2, Vector3};

pub use meridian::{Meridian, MeridianRay};

use super::{Camera, Ray, is_in_image};

/// Slack of the domain's ends, so that the ends themselves belong to it despite rounding.
const DOMAIN_SLACK_RAD: f64 = 1e-9;

const M_FROM_MM: f64 = 1e-3;

/// The parameters of `[pal]` in `camera.toml`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PalDesign {
    /// a_e of the first mirror, mm; > c_e.
    pub ellipsoid_a_mm: f64,
    /// c_e of the first mirror, mm; > 0.
    pub ellipsoid_c_mm: f64,
    /// a_h of the second mirror, mm; > 0.
    pub hyperboloid_a_mm: f64,
    /// c_h of the second mirror, mm; > a_h.
    pub hyperboloid_c_mm: f64,
    /// Focal length of the pinhole camera, px.
    pub focal_length_px: f64,
    /// a_R of the refracting ellipsoid, mm.
    pub refraction_a_mm: f64,
    /// e_R of the refracting ellipsoid, in [0, 1).
    pub refraction_eccentricity: f64,
    /// n of the glass against air, ≥ 1.
    pub refractive_index: f64,
    /// (u₀, v₀): the image of the axis, px.
    pub centre_px: [f64; 2],
    /// Pixels along u for one along v.
    pub aspect: f64,
    /// Elevations [lowest, highest] that the annulus shows, degrees.
    pub elevation_deg: [f64; 2],
}

impl PalDesign {
    /// Design D of `MATHS.md` §3.6: 40 mm of BK7, −15° … +20° on 768×576.
    pub const REFERENCE: Self = Self {
        ellipsoid_a_mm: 23.8095238095,
        ellipsoid_c_mm: 9.52380952381,
        hyperboloid_a_mm: 6.47619047619,
        hyperboloid_c_mm: 16.5238095238,
        focal_length_px: 751.84954507,
        refraction_a_mm: 31.25,
        refraction_eccentricity: 0.6,
        refractive_index: 1.5168,
        centre_px: [383.5, 287.5],
        aspect: 1.0,
        elevation_deg: [-15.0, 20.0],
    };

    /// The picture of design D.
    pub const REFERENCE_IMAGE_SIZE_PX: [u32; 2] = [768, 576];
}

/// A parameter that makes no camera: which one, its value, and what would be right.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{key} = {value}: {expected}")]
pub struct ParameterError {
    /// Key inside the model's table.
    pub key: &'static str,
    /// The value as given.
    pub value: String,
    /// What would be right.
    pub expected: String,
}

impl ParameterError {
    /// Names a wrong value.
    pub fn new(key: &'static str, value: impl std::fmt::Debug, expected: impl Into<String>) -> Self {
        Self { key, value: format!("{value:?}"), expected: expected.into() }
    }
}

/// The PAL camera, validated.
#[derive(Debug, Clone, PartialEq)]
pub struct Pal {
    design: PalDesign,
    image_size_px: [u32; 2],
    meridian: Meridian,
    elevation_rad: [f64; 2],
    viewpoint_z_mm: f64,
    viewpoint_miss_mm: f64,
}

impl Pal {
    /// Checks that the design can exist and shows its elevations on the picture.
    ///
    /// # Errors
    /// The first parameter that makes that impossible.
    pub fn new(design: PalDesign, image_size_px: [u32; 2]) -> Result<Self, ParameterError> {
        check_values(&design, image_size_px)?;
        let meridian = Meridian::new(&design);
        check_light_path(&design, &meridian, image_size_px)?;
        let elevation_rad = design.elevation_deg.map(f64::to_radians);
        let (viewpoint_z_mm, viewpoint_miss_mm) = best_viewpoint_mm(&meridian, elevation_rad);
        Ok(Self { design, image_size_px, meridian, elevation_rad, viewpoint_z_mm, viewpoint_miss_mm })
    }

    /// Design D.
    #[expect(clippy::missing_panics_doc, clippy::expect_used, reason = "a constant, tested")]
    pub fn reference() -> Self {
        Self::new(PalDesign::REFERENCE, PalDesign::REFERENCE_IMAGE_SIZE_PX).expect("design D is a camera")
    }

    /// The parameters.
    pub fn design(&self) -> &PalDesign {
        &self.design
    }

    /// The optics in the meridian plane.
    pub fn meridian(&self) -> &Meridian {
        &self.meridian
    }

    /// Inner and outer radius of the annulus, px (along v).
    pub fn annulus_px(&self) -> [f64; 2] {
        let radius = |e: f64| radius_of_elevation(&self.meridian, e).unwrap_or(f64::NAN);
        [radius(self.elevation_rad[1]), radius(self.elevation_rad[0])]
    }

    fn pixel(&self, azimuth: (f64, f64), ray: &MeridianRay) -> Option<Vector2<f64>> {
        self.covers(ray).then_some(())?;
        let radius = self.meridian.radius_of_ray(ray)?;
        let [u0, v0] = self.design.centre_px;
        let pixel = Vector2::new(u0 + self.design.aspect * radius * azimuth.0, v0 + radius * azimuth.1);
        is_in_image(&pixel, self.image_size_px).then_some(pixel)
    }

    fn covers(&self, ray: &MeridianRay) -> bool {
        let elevation = FRAC_PI_2 - ray.zeta_out;
        elevation >= self.elevation_rad[0] - DOMAIN_SLACK_RAD && elevation <= self.elevation_rad[1] + DOMAIN_SLACK_RAD
    }
}

impl Camera for Pal {
    fn model(&self) -> &'static str {
        "pal"
    }

    fn image_size_px(&self) -> [u32; 2] {
        self.image_size_px
    }

    fn project(&self, point_m: &Vector3<f64>) -> Option<Vector2<f64>> {
        let radius_m = point_m.x.hypot(point_m.y);
        let azimuth = azimuth(point_m, radius_m)?;
        self.pixel(azimuth, &self.meridian.ray_of_point(radius_m / M_FROM_MM, point_m.z / M_FROM_MM)?)
    }

    fn project_direction(&self, direction: &Vector3<f64>) -> Option<Vector2<f64>> {
        let radius = direction.x.hypot(direction.y);
        let azimuth = azimuth(direction, radius)?;
        self.pixel(azimuth, &self.meridian.ray_of_zenith(radius.atan2(direction.z))?)
    }

    fn unproject(&self, pixel: &Vector2<f64>) -> Option<Ray> {
        is_in_image(pixel, self.image_size_px).then_some(())?;
        let [u0, v0] = self.design.centre_px;
        let offset = Vector2::new((pixel.x - u0) / self.design.aspect, pixel.y - v0);
        let radius = offset.norm();
        (radius > 0.0).then_some(())?;
        let (cos, sin) = (offset.x / radius, offset.y / radius);
        let ray = self.meridian.ray_of_radius(radius)?;
        self.covers(&ray).then_some(())?;
        let [r, z] = ray.exit_mm;
        let (sin_z, cos_z) = ray.zeta_out.sin_cos();
        Some(Ray {
            origin_m: Vector3::new(r * cos, r * sin, z) * M_FROM_MM,
            direction: Vector3::new(sin_z * cos, sin_z * sin, cos_z),
        })
    }

    fn elevation_rad(&self) -> [f64; 2] {
        self.elevation_rad
    }

    fn is_panoramic(&self) -> bool {
        true
    }

    fn viewpoint_m(&self) -> Vector3<f64> {
        Vector3::new(0.0, 0.0, self.viewpoint_z_mm * M_FROM_MM)
    }

    fn viewpoint_miss_m(&self) -> f64 {
        self.viewpoint_miss_mm * M_FROM_MM
    }
}

/// (cos θ, sin θ); `None` on the axis and for what is not finite.
fn azimuth(v: &Vector3<f64>, radius: f64) -> Option<(f64, f64)> {
    (radius > 0.0 && radius.is_finite() && v.z.is_finite()).then(|| (v.x / radius, v.y / radius))
}

fn radius_of_elevation(meridian: &Meridian, elevation_rad: f64) -> Option<f64> {
    meridian.radius_of_ray(&meridian.ray_of_zenith(FRAC_PI_2 - elevation_rad)?)
}

/// The point of the axis whose largest distance to a ray of the field of view is least: (z, that distance), mm.
fn best_viewpoint_mm(meridian: &Meridian, elevation_rad: [f64; 2]) -> (f64, f64) {
    const SAMPLES: usize = 400;
    let rays: Vec<(f64, f64)> = (0..=SAMPLES)
        .filter_map(|i| {
            let t = i as f64 / SAMPLES as f64;
            let zenith = FRAC_PI_2 - (elevation_rad[0] * (1.0 - t) + elevation_rad[1] * t);
            let ray = meridian.ray_of_zenith(zenith)?;
            Some((meridian.axis_crossing_mm(&ray), ray.zeta_out.sin()))
        })
        .collect();
    let worst = |z: f64| rays.iter().map(|(z_x, sin)| (z_x - z).abs() * sin).fold(0.0, f64::max);
    let mut low = rays.iter().map(|r| r.0).fold(f64::INFINITY, f64::min);
    let mut high = rays.iter().map(|r| r.0).fold(f64::NEG_INFINITY, f64::max);
    // The worst distance is convex in z: a ternary search; 100 steps leave (2/3)^100 of the interval.
    for _ in 0..100 {
        let (a, b) = (low + (high - low) / 3.0, high - (high - low) / 3.0);
        if worst(a) < worst(b) {
            high = b;
        } else {
            low = a;
        }
    }
    let z = 0.5 * (low + high);
    (z, worst(z))
}

fn check_values(d: &PalDesign, image_size_px: [u32; 2]) -> Result<(), ParameterError> {
    let error = |key, value: f64, expected: &str| Err(ParameterError::new(key, value, expected));
    // A lens block is between a pea and a bucket: outside, the unit is wrong.
    for (key, value) in [
        ("ellipsoid_a_mm", d.ellipsoid_a_mm),
        ("ellipsoid_c_mm", d.ellipsoid_c_mm),
        ("hyperboloid_a_mm", d.hyperboloid_a_mm),
        ("hyperboloid_c_mm", d.hyperboloid_c_mm),
        ("refraction_a_mm", d.refraction_a_mm),
    ] {
        if !(value > 0.1 && value < 10_000.0) {
            return error(key, value, "a length in millimetres between 0.1 and 10000 (is it in metres?)");
        }
    }
    if d.ellipsoid_c_mm >= d.ellipsoid_a_mm {
        return error("ellipsoid_c_mm", d.ellipsoid_c_mm, "less than ellipsoid_a_mm (an ellipsoid has c < a)");
    }
    if d.hyperboloid_c_mm <= d.hyperboloid_a_mm {
        return error("hyperboloid_c_mm", d.hyperboloid_c_mm, "more than hyperboloid_a_mm (a hyperboloid has c > a)");
    }
    if !(d.refraction_eccentricity >= 0.0 && d.refraction_eccentricity < 1.0) {
        return error("refraction_eccentricity", d.refraction_eccentricity, "in [0, 1), 0 for a sphere about V");
    }
    if !(d.refractive_index >= 1.0 && d.refractive_index < 4.0) {
        return error("refractive_index", d.refractive_index, "in [1, 4), 1.5168 for BK7, 1 without refraction");
    }
    if !(d.focal_length_px > 0.0 && d.focal_length_px.is_finite()) {
        return error("focal_length_px", d.focal_length_px, "a positive number of pixels");
    }
    check_picture(d.centre_px, d.aspect, image_size_px)?;
    check_elevations(d.elevation_deg)
}

/// The centre is in the picture and pixels are nearly square.
fn check_picture(centre_px: [f64; 2], aspect: f64, image_size_px: [u32; 2]) -> Result<(), ParameterError> {
    if !is_in_image(&Vector2::from(centre_px), image_size_px) {
        let [w, h] = image_size_px;
        return Err(ParameterError::new("centre_px", centre_px, format!("inside the picture of {w}x{h} pixels")));
    }
    if !(aspect > 0.2 && aspect < 5.0) {
        return Err(ParameterError::new("aspect", aspect, "between 0.2 and 5, 1 for square pixels"));
    }
    Ok(())
}

fn check_elevations([low, high]: [f64; 2]) -> Result<(), ParameterError> {
    let error = |expected: &str| Err(ParameterError::new("elevation_deg", [low, high], expected));
    if !(low > -90.0 && low < 90.0 && high > -90.0 && high < 90.0) {
        return error("[lowest, highest] in degrees, each between -90 and 90");
    }
    if low >= high {
        return error("[lowest, highest]: they are swapped or equal");
    }
    if high - low < 1.0 {
        return error("[lowest, highest] at least 1 degree apart (are they in radians?)");
    }
    Ok(())
}

/// Both ends of the field of view must come through the glass and off both mirrors, on radii that fit the picture.
fn check_light_path(d: &PalDesign, m: &Meridian, image_size_px: [u32; 2]) -> Result<(), ParameterError> {
    let radius = |elevation_deg: f64| {
        let radius = radius_of_elevation(m, elevation_deg.to_radians());
        radius.filter(|r| m.point_on_hyperboloid_mm(*r).is_some()).ok_or_else(|| {
            ParameterError::new(
                "elevation_deg",
                d.elevation_deg,
                format!("within what the glass and the mirrors let through: no light from {elevation_deg} degrees"),
            )
        })
    };
    let [low, high] = d.elevation_deg;
    // A direction from V is either mirror or window: the window's zenith angles ζ and the mirror's π − ζ must not meet.
    let horizon = m.ray_of_zenith_inside(FRAC_PI_2).map_or(f64::NAN, |ray| 90.0 - ray.zeta_out.to_degrees());
    if low < horizon - 1e-6 {
        let expected = format!("above {horizon:.2} degrees, where the mirror begins on the outside of the glass");
        return Err(ParameterError::new("elevation_deg", d.elevation_deg, expected));
    }
    let (outer, inner) = (radius(low)?, radius(high)?);
    let diagonal = f64::from(image_size_px[0]).hypot(f64::from(image_size_px[1]));
    if outer - inner < 4.0 || inner > diagonal {
        return Err(ParameterError::new(
            "focal_length_px",
            d.focal_length_px,
            format!(
                "a focal length in pixels that puts the annulus on the picture (this one reaches from {inner:.1} to \
                 {outer:.1} px; is it in millimetres?)"
            ),
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests;
