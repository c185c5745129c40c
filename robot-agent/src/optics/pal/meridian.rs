//! The PAL in its meridian plane: image radius ↔ ray, in millimetres and pixels.
//!
//! Problem: light goes world → refraction ellipsoid R → first mirror E → second mirror H → pinhole O. V (the origin) is
//! a focus of R and of E, B of E and of H, O of H.
//! Insight: both mirrors only rescale the half-angle tangent, tan(ζ/2) = K tan(ψ/2), and the ellipsoid about V bends a
//! ray through V so that both directions have closed forms in the zenith angle η of the surface's normal. So only points
//! at a finite distance need an iteration, and its root is unique.
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

use std::f64::consts::PI;

use super::PalDesign;

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
    /// Eccentricity e_R of the refracting ellipsoid.
    pub refraction_eccentricity: f64,
    /// Semi-latus rectum p_R = a_R (1 − e_R²).
    pub refraction_p_mm: f64,
    /// κ = n·e_R.
    pub kappa: f64,
    /// a_h, c_h, kept for the points on H.
    hyperboloid_ac_mm: [f64; 2],
    /// a_e (1 − e_e²) = b_e²/a_e, kept for the points on E.
    ellipsoid_p_mm: f64,
}

/// A ray in the meridian plane as it leaves the glass.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeridianRay {
    /// Zenith angle inside the glass.
    pub zeta_in: f64,
    /// Zenith angle in air.
    pub zeta_out: f64,
    /// Zenith angle η of the surface's normal.
    pub normal: f64,
    /// Point R on the surface: (r, z), mm.
    pub exit_mm: [f64; 2],
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
            refraction_eccentricity: d.refraction_eccentricity,
            refraction_p_mm: d.refraction_a_mm * (1.0 - d.refraction_eccentricity.powi(2)),
            kappa: d.refractive_index * d.refraction_eccentricity,
            hyperboloid_ac_mm: [d.hyperboloid_a_mm, d.hyperboloid_c_mm],
            ellipsoid_p_mm,
        }
    }

    /// The ray that an image radius (px, ≥ 0) sees; `None` past total reflection.
    pub fn ray_of_radius(&self, radius_px: f64) -> Option<MeridianRay> {
        let t = radius_px / self.focal_length_px;
        let tau = t / (1.0 + (1.0 + t * t).sqrt());
        self.ray_of_zenith_inside(2.0 * (self.half_angle_gain * tau).atan())
    }

    /// The ray that leaves with zenith angle `zeta_out` in air: the closed far-field inverse. `None` outside (0, π).
    pub fn ray_of_zenith(&self, zeta_out: f64) -> Option<MeridianRay> {
        if !(zeta_out > 0.0 && zeta_out < PI) {
            return None;
        }
        let normal = zeta_out.sin().atan2(self.kappa + zeta_out.cos());
        let zeta_in = normal + (self.refraction_eccentricity * normal.sin()).asin();
        let ray = self.ray_of_zenith_inside(zeta_in)?;
        // Past total reflection asin folds back: the ray found is then another one.
        ((ray.zeta_out - zeta_out).abs() < 1e-9).then_some(ray)
    }

    /// The ray through a point (r ≥ 0, z) in mm at a finite distance; `None` where no ray leaves towards it.
    pub fn ray_of_point(&self, r_mm: f64, z_mm: f64) -> Option<MeridianRay> {
        // F(ζ) = (r − R_r) cos ζ_out − (z − R_z) sin ζ_out falls along ζ where the ray runs forwards, so a bracket kept
        // around Newton's steps makes them safe without changing where they end (MATHS §3.3: at most 6 steps from the
        // far field).
        const STEPS: usize = 60;
        let mut low = 0.0;
        let mut high = PI;
        let mut zeta = self.ray_of_zenith(r_mm.atan2(z_mm)).map_or(0.5 * PI, |ray| ray.zeta_in);
        for _ in 0..STEPS {
            let Some(ray) = self.ray_of_zenith_inside(zeta) else {
                high = zeta;
                zeta = 0.5 * (low + high);
                continue;
            };
            let (value, along) = ray.offset_mm(r_mm, z_mm);
            if value > 0.0 {
                low = zeta;
            } else {
                high = zeta;
            }
            let slope = -self.distance_mm(zeta) * ray.emergence().cos() / ray.incidence().cos()
                - along * self.bending_slope(&ray);
            let newton = zeta - value / slope;
            let next = if newton >= low && newton <= high { newton } else { 0.5 * (low + high) };
            let step = (next - zeta).abs();
            zeta = next;
            if step < 1e-15 {
                break;
            }
        }
        let ray = self.ray_of_zenith_inside(zeta)?;
        let (value, along) = ray.offset_mm(r_mm, z_mm);
        (along > 0.0 && value.abs() < 1e-9 * (1.0 + along)).then_some(ray)
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

    /// Where the outer ray, prolonged backwards, crosses the axis: z in mm, the sagittal viewpoint.
    pub fn axis_crossing_mm(&self, ray: &MeridianRay) -> f64 {
        self.distance_mm(ray.zeta_in) * (ray.zeta_out - ray.zeta_in).sin() / ray.zeta_out.sin()
    }

    /// The point of the tangential caustic on the ray: (r, z) in mm.
    pub fn caustic_mm(&self, ray: &MeridianRay) -> [f64; 2] {
        let (cos_in, cos_out) = (ray.incidence().cos(), ray.emergence().cos());
        let s_e = cos_in + self.refraction_eccentricity * ray.normal.cos();
        let s_k = cos_out + self.kappa * ray.normal.cos();
        let s = -self.distance_mm(ray.zeta_in) * cos_out.powi(2) * s_e / (cos_in.powi(2) * s_k);
        let (sin, cos) = ray.zeta_out.sin_cos();
        [ray.exit_mm[0] + s * sin, ray.exit_mm[1] + s * cos]
    }

    /// The ray that runs with zenith angle `zeta_in` inside the glass; `None` where it is totally reflected.
    pub fn ray_of_zenith_inside(&self, zeta_in: f64) -> Option<MeridianRay> {
        let (sin, cos) = zeta_in.sin_cos();
        let normal = sin.atan2(self.refraction_eccentricity + cos);
        let bend = self.kappa * normal.sin();
        if bend > 1.0 {
            return None;
        }
        let d = self.distance_mm(zeta_in);
        Some(MeridianRay { zeta_in, zeta_out: normal + bend.asin(), normal, exit_mm: [d * sin, d * cos] })
    }

    /// |VR| along a ray inside the glass.
    fn distance_mm(&self, zeta_in: f64) -> f64 {
        self.refraction_p_mm / (1.0 + self.refraction_eccentricity * zeta_in.cos())
    }

    /// dζ_out/dζ_in > 0.
    fn bending_slope(&self, ray: &MeridianRay) -> f64 {
        let (cos_in, cos_out) = (ray.incidence().cos(), ray.emergence().cos());
        let s_k = cos_out + self.kappa * ray.normal.cos();
        let s_e = cos_in + self.refraction_eccentricity * ray.normal.cos();
        (s_k * cos_in) / (s_e * cos_out)
    }
}

impl MeridianRay {
    /// Angle δ to the normal inside the glass.
    fn incidence(&self) -> f64 {
        self.zeta_in - self.normal
    }

    /// Angle δ′ to the normal in air.
    fn emergence(&self) -> f64 {
        self.zeta_out - self.normal
    }

    /// A point's offset across the ray (F) and along it, mm.
    fn offset_mm(&self, r_mm: f64, z_mm: f64) -> (f64, f64) {
        let (sin, cos) = self.zeta_out.sin_cos();
        let (dr, dz) = (r_mm - self.exit_mm[0], z_mm - self.exit_mm[1]);
        (dr * cos - dz * sin, dr * sin + dz * cos)
    }
}
