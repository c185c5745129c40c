//! The window of a PAL: an ellipsoid of revolution with its upper focus in V, through which light enters the glass.
//!
//! Insight: it bends a ray through V so that both directions have closed forms in the zenith angle η of the surface's
//! normal. So only points at a finite distance need an iteration, and its root is unique.
//! Source: report (3-6) … (3-8) with the errata of `MATHS.md` §0 (upper focus of R at V, κ = n·e_R), §3.3 and §3.4.

use std::f64::consts::PI;

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

/// The refracting ellipsoid in a meridian half-plane, lengths in mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Window {
    /// e_R.
    pub eccentricity: f64,
    /// Semi-latus rectum p_R = a_R (1 − e_R²).
    pub p_mm: f64,
    /// κ = n·e_R.
    pub kappa: f64,
}

impl Window {
    /// From a_R, e_R in [0, 1) and n ≥ 1.
    pub(super) fn new(a_mm: f64, eccentricity: f64, refractive_index: f64) -> Self {
        Self { eccentricity, p_mm: a_mm * (1.0 - eccentricity.powi(2)), kappa: refractive_index * eccentricity }
    }

    /// The ray that leaves with zenith angle `zeta_out` in air: the closed far-field inverse. `None` outside (0, π).
    pub fn ray_of_zenith(&self, zeta_out: f64) -> Option<MeridianRay> {
        if !(zeta_out > 0.0 && zeta_out < PI) {
            return None;
        }
        let normal = zeta_out.sin().atan2(self.kappa + zeta_out.cos());
        let zeta_in = normal + (self.eccentricity * normal.sin()).asin();
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

    /// Where the outer ray, prolonged backwards, crosses the axis: z in mm, the sagittal viewpoint.
    pub fn axis_crossing_mm(&self, ray: &MeridianRay) -> f64 {
        self.distance_mm(ray.zeta_in) * (ray.zeta_out - ray.zeta_in).sin() / ray.zeta_out.sin()
    }

    /// The point of the tangential caustic on the ray: (r, z) in mm.
    pub fn caustic_mm(&self, ray: &MeridianRay) -> [f64; 2] {
        let (cos_in, cos_out) = (ray.incidence().cos(), ray.emergence().cos());
        let s_e = cos_in + self.eccentricity * ray.normal.cos();
        let s_k = cos_out + self.kappa * ray.normal.cos();
        let s = -self.distance_mm(ray.zeta_in) * cos_out.powi(2) * s_e / (cos_in.powi(2) * s_k);
        let (sin, cos) = ray.zeta_out.sin_cos();
        [ray.exit_mm[0] + s * sin, ray.exit_mm[1] + s * cos]
    }

    /// The ray that runs with zenith angle `zeta_in` inside the glass; `None` where it is totally reflected.
    pub fn ray_of_zenith_inside(&self, zeta_in: f64) -> Option<MeridianRay> {
        let (sin, cos) = zeta_in.sin_cos();
        let normal = sin.atan2(self.eccentricity + cos);
        let bend = self.kappa * normal.sin();
        if bend > 1.0 {
            return None;
        }
        let d = self.distance_mm(zeta_in);
        Some(MeridianRay { zeta_in, zeta_out: normal + bend.asin(), normal, exit_mm: [d * sin, d * cos] })
    }

    /// |VR| along a ray inside the glass.
    fn distance_mm(&self, zeta_in: f64) -> f64 {
        self.p_mm / (1.0 + self.eccentricity * zeta_in.cos())
    }

    /// dζ_out/dζ_in > 0.
    fn bending_slope(&self, ray: &MeridianRay) -> f64 {
        let (cos_in, cos_out) = (ray.incidence().cos(), ray.emergence().cos());
        let s_k = cos_out + self.kappa * ray.normal.cos();
        let s_e = cos_in + self.eccentricity * ray.normal.cos();
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
