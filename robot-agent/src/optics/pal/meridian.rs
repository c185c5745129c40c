//! The PAL in its meridian plane: image radius ↔ ray, in millimetres and pixels.
//!
//! Problem: light goes world → refraction ellipsoid R → first mirror E → second mirror H → pinhole O. V (the origin) is
//! a focus of R and of E, B of E and of H, O of H.
//! Insight: both mirrors only rescale the half-angle tangent, tan(ζ/2) = K tan(ψ/2); the rest is the [`Window`].
//! Source: report (3-1)…(3-8) with the errata of `MATHS.md` §0 (centre of H at 2c_e − c_h, signed radii, upper focus of R
//! at V, κ = n·e_R), §3.1–3.4.
//!
//! ```text
//!        z ▲          B  z_B = 2c_e        ζ zenith angle: ζ_in inside the glass, ζ_out in air
//!          │   H ‿                          r ≥ 0; mirror points lie at azimuth θ + π, R and the world at θ
//!          │        \
//!          V ──────── R ───▶ world
//!       E ⁀│
//!          O  z_O = 2(c_e − c_h)
//! ```

use super::PalDesign;
use super::window::{MeridianRay, Window};

/// The design's derived constants. Lengths in mm, radii in the image in px.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Meridian {
    /// Focal length of the pinhole camera at O, px.
    pub focal_length_px: f64,
    /// Eccentricity e_e of the first mirror.
    pub ellipsoid_eccentricity: f64,
    /// Semi-minor axis b_e of the first mirror.
    pub ellipsoid_b_mm: f64,
    /// Eccentricity e_h of the second mirror.
    pub hyperboloid_eccentricity: f64,
    /// b_h of the second mirror.
    pub hyperboloid_b_mm: f64,
    /// K of the half-angle theorem.
    pub half_angle_gain: f64,
    /// Height of the pinhole over V; negative where it is below.
    pub pinhole_z_mm: f64,
    /// Height of the common focus B of the two mirrors.
    pub focus_z_mm: f64,
    /// The refracting ellipsoid.
    pub window: Window,
    /// a_h, c_h, kept for the points on H.
    hyperboloid_ac_mm: [f64; 2],
    /// a_e (1 − e_e²) = b_e²/a_e, kept for the points on E.
    ellipsoid_p_mm: f64,
}

impl Meridian {
    /// Derives the constants; the design must have been validated.
    pub(super) fn new(design: &PalDesign) -> Self {
        let d = design;
        let e_e = d.ellipsoid_c_mm / d.ellipsoid_a_mm;
        let e_h = d.hyperboloid_c_mm / d.hyperboloid_a_mm;
        let ellipsoid_p_mm = d.ellipsoid_a_mm * (1.0 - e_e * e_e);
        Self {
            focal_length_px: d.focal_length_px,
            ellipsoid_eccentricity: e_e,
            ellipsoid_b_mm: (d.ellipsoid_a_mm.powi(2) - d.ellipsoid_c_mm.powi(2)).sqrt(),
            hyperboloid_eccentricity: e_h,
            hyperboloid_b_mm: (d.hyperboloid_c_mm.powi(2) - d.hyperboloid_a_mm.powi(2)).sqrt(),
            half_angle_gain: (1.0 + e_e) / (1.0 - e_e) * (e_h + 1.0) / (e_h - 1.0),
            pinhole_z_mm: 2.0 * (d.ellipsoid_c_mm - d.hyperboloid_c_mm),
            focus_z_mm: 2.0 * d.ellipsoid_c_mm,
            window: Window::new(d.refraction_a_mm, d.refraction_eccentricity, d.refractive_index),
            hyperboloid_ac_mm: [d.hyperboloid_a_mm, d.hyperboloid_c_mm],
            ellipsoid_p_mm,
        }
    }

    /// The ray that an image radius (px, ≥ 0) sees; `None` past total reflection.
    pub fn ray_of_radius(&self, radius_px: f64) -> Option<MeridianRay> {
        let t = radius_px / self.focal_length_px;
        let tau = t / (1.0 + (1.0 + t * t).sqrt());
        self.window.ray_of_zenith_inside(2.0 * (self.half_angle_gain * tau).atan())
    }

    /// The image radius of a ray by its zenith angle inside the glass; `None` at 90° from the image axis and beyond.
    pub fn radius_of_ray(&self, ray: &MeridianRay) -> Option<f64> {
        let tau = (0.5 * ray.zeta_in).tan() / self.half_angle_gain;
        (tau < 1.0).then(|| 2.0 * self.focal_length_px * tau / (1.0 - tau * tau))
    }

    /// Where the image ray of a radius meets the second mirror: (r, z) in mm. `None` where it misses the sheet around B.
    pub fn point_on_hyperboloid_mm(&self, radius_px: f64) -> Option<[f64; 2]> {
        let [a, c] = self.hyperboloid_ac_mm;
        let (sin, cos) = (radius_px / self.focal_length_px).atan().sin_cos();
        let d = self.hyperboloid_b_mm.powi(2) / (c * cos - a);
        (c * cos > a).then_some([d * sin, self.pinhole_z_mm + d * cos])
    }

    /// Where a ray meets the first mirror, opposite to R: (r, z) in mm.
    pub fn point_on_ellipsoid_mm(&self, ray: &MeridianRay) -> [f64; 2] {
        let (sin, cos) = ray.zeta_in.sin_cos();
        let d = self.ellipsoid_p_mm / (1.0 + self.ellipsoid_eccentricity * cos);
        [d * sin, -d * cos]
    }
}
