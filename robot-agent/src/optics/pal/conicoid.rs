//! PALs whose surfaces share no foci (`model = "pal-conicoid"`): Greguss' with spheres, Powell's with conicoids, and any
//! PAL whose glass ends in a plane towards its camera (the second refraction).
//!
//! Without common foci nothing has a closed form: a ray is traced from the pinhole through the surfaces in the meridian
//! plane, and a point's image is the root of how far its ray misses it, which falls along the image radius.
//!
//! ```text
//! pinhole ─▶ (face) ─▶ second mirror ─▶ first mirror ─▶ window ─▶ world        s = z − vertex
//! every surface: r² = 2Rs − (1 + k)s², R > 0 where it opens upwards
//! ```
//!
//! Source: report 3.1 and 3.4, `MATHS.md` §0 (second refraction) and §3.6.

use serde::{Deserialize, Serialize};

use super::{Pal, PalDesign, check_glass};
use crate::optics::ParameterError;
use crate::optics::axial::{Axial, AxialDesign, AxialOptics, AxialRay, ImagePlane};
use crate::optics::parameter::{Design, Numbers, check_finite, check_positive_px, one};
use crate::optics::root::root;

/// The parameters of `[pal-conicoid]` in `camera.toml`. A surface is [vertex_z_mm, radius_mm, conic_constant]: height of
/// its vertex above the origin, radius of curvature there (positive where it opens upwards), and k (0 a sphere, −e²
/// along the axis).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PalConicoidDesign {
    /// The ring mirror: opens upwards.
    pub first_mirror: [f64; 3],
    /// The mirror over it: opens upwards, too.
    pub second_mirror: [f64; 3],
    /// Where light enters: opens downwards.
    pub window: [f64; 3],
    /// Height of the pinhole, mm.
    pub pinhole_z_mm: f64,
    /// Focal length of the pinhole camera, px.
    pub focal_length_px: f64,
    /// n of the glass against air, ≥ 1.
    pub refractive_index: f64,
    /// Height of the plane in which the glass ends towards the pinhole, mm; without one the pinhole is in the glass.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub face_z_mm: Option<f64>,
    /// (u₀, v₀): the image of the axis, px.
    pub centre_px: [f64; 2],
    /// Pixels along u for one along v.
    #[serde(default = "one")]
    pub aspect: f64,
    /// Elevations [lowest, highest] that the annulus shows, degrees.
    pub elevation_deg: [f64; 2],
}

impl Design for PalConicoidDesign {
    fn visit(&mut self, visitor: &mut dyn FnMut(&str, &mut f64)) {
        self.first_mirror.visit("first_mirror", visitor);
        self.second_mirror.visit("second_mirror", visitor);
        self.window.visit("window", visitor);
        self.pinhole_z_mm.visit("pinhole_z_mm", visitor);
        self.focal_length_px.visit("focal_length_px", visitor);
        self.refractive_index.visit("refractive_index", visitor);
        if let Some(face) = &mut self.face_z_mm {
            face.visit("face_z_mm", visitor);
        }
        self.centre_px.visit("centre_px", visitor);
        self.aspect.visit("aspect", visitor);
    }
}

impl From<&PalDesign> for PalConicoidDesign {
    /// The same lens by its surfaces' vertices: what a polisher would change, one surface at a time.
    fn from(d: &PalDesign) -> Self {
        let conic = |a: f64, e: f64| ((a * (1.0 - e * e)).abs(), -e * e);
        let (e_e, e_h) = (d.ellipsoid_c_mm / d.ellipsoid_a_mm, d.hyperboloid_c_mm / d.hyperboloid_a_mm);
        let (p_e, k_e) = conic(d.ellipsoid_a_mm, e_e);
        let (p_h, k_h) = conic(d.hyperboloid_a_mm, e_h);
        let (p_r, k_r) = conic(d.refraction_a_mm, d.refraction_eccentricity);
        let focus_b = 2.0 * d.ellipsoid_c_mm;
        Self {
            first_mirror: [d.ellipsoid_c_mm - d.ellipsoid_a_mm, p_e, k_e],
            second_mirror: [focus_b - d.hyperboloid_c_mm + d.hyperboloid_a_mm, p_h, k_h],
            window: [d.refraction_a_mm * (1.0 - d.refraction_eccentricity), -p_r, k_r],
            pinhole_z_mm: focus_b - 2.0 * d.hyperboloid_c_mm,
            focal_length_px: d.focal_length_px,
            refractive_index: d.refractive_index,
            face_z_mm: None,
            centre_px: d.centre_px,
            aspect: d.aspect,
            elevation_deg: d.elevation_deg,
        }
    }
}

impl PalConicoidDesign {
    /// Greguss' variant of a PAL: both mirrors replaced by the spheres that fit best the zones that its field of view
    /// uses, in the sense of least squares.
    pub fn best_fit_spheres(pal: &Pal) -> Self {
        const SAMPLES: u32 = 100;
        let [inner, outer] = pal.annulus_px();
        let meridian = pal.optics();
        let radii = (0..=SAMPLES).map(|i| inner + (outer - inner) * f64::from(i) / f64::from(SAMPLES));
        let (mut first, mut second) = (Vec::new(), Vec::new());
        for radius in radii {
            first.extend(meridian.ray_of_radius(radius).map(|ray| meridian.point_on_ellipsoid_mm(&ray)));
            second.extend(meridian.point_on_hyperboloid_mm(radius));
        }
        Self { first_mirror: best_sphere(&first), second_mirror: best_sphere(&second), ..Self::from(pal.design()) }
    }
}

/// The sphere about a point of the axis through points (r, z): r² + z² = 2 z₀ z + (R² − z₀²) is linear in z₀ and q.
fn best_sphere(points: &[[f64; 2]]) -> [f64; 3] {
    let n = points.len() as f64;
    let square = |p: &[f64; 2]| p[0] * p[0] + p[1] * p[1];
    let mean_z = points.iter().map(|p| p[1]).sum::<f64>() / n;
    let mean_s = points.iter().map(square).sum::<f64>() / n;
    let covariance: f64 = points.iter().map(|p| (p[1] - mean_z) * (square(p) - mean_s)).sum();
    let variance: f64 = points.iter().map(|p| (p[1] - mean_z).powi(2)).sum();
    let centre = 0.5 * covariance / variance;
    let radius = (mean_s - 2.0 * centre * mean_z + centre * centre).sqrt();
    [centre - radius, radius, 0.0]
}

/// A PAL camera of conicoids, validated.
pub type PalConicoid = Axial<PalConicoidDesign>;

/// The surfaces in the meridian plane, and the image radii between which they show the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TracedMeridian {
    design: PalConicoidDesign,
    radius_px: [f64; 2],
}

/// A point and a unit direction (r, z); r counts along the azimuth of the image and is negative on the mirrors.
#[derive(Debug, Clone, Copy)]
struct Light {
    at: [f64; 2],
    towards: [f64; 2],
}

impl AxialDesign for PalConicoidDesign {
    const MODEL: &'static str = "pal-conicoid";
    type Optics = TracedMeridian;

    fn optics(&self, image_size_px: [u32; 2]) -> Result<TracedMeridian, ParameterError> {
        check_positive_px("focal_length_px", self.focal_length_px)?;
        check_glass(self.refractive_index)?;
        for (key, surface, up) in [
            ("first_mirror", self.first_mirror, 1.0),
            ("second_mirror", self.second_mirror, 1.0),
            ("window", self.window, -1.0),
        ] {
            check_finite(key, &surface, "[vertex_z_mm, radius_mm, conic_constant]")?;
            if up * surface[1] <= 0.1 {
                let side = if up > 0.0 { "positive (it opens upwards)" } else { "negative (it opens downwards)" };
                let expected = format!("[vertex_z_mm, radius_mm, conic_constant] with the radius {side}");
                return Err(ParameterError::new(key, surface, expected));
            }
        }
        let below = self.face_z_mm.unwrap_or(f64::INFINITY).min(self.second_mirror[0]);
        check_finite("pinhole_z_mm", &[self.pinhole_z_mm], "a height in millimetres")?;
        if self.pinhole_z_mm >= below {
            let expected = "below the face and the second mirror (the camera would be inside its lens)";
            return Err(ParameterError::new("pinhole_z_mm", self.pinhole_z_mm, expected));
        }
        let [w, h] = image_size_px.map(f64::from);
        let radius_px = lit_radii(self, w.hypot(h)).ok_or_else(|| {
            let expected = "surfaces through which light passes from the window to the pinhole";
            ParameterError::new("first_mirror", self.first_mirror, expected)
        })?;
        Ok(TracedMeridian { design: *self, radius_px })
    }

    fn image_plane(&self) -> ImagePlane {
        ImagePlane { centre_px: self.centre_px, aspect: self.aspect, upside_down: false }
    }

    fn elevation_deg(&self) -> Option<[f64; 2]> {
        Some(self.elevation_deg)
    }
}

/// The longest run of image radii whose rays come out and turn outwards with the radius.
fn lit_radii(design: &PalConicoidDesign, reach_px: f64) -> Option<[f64; 2]> {
    const STEPS: u32 = 2000;
    let mut best: Option<[f64; 2]> = None;
    let mut run: Option<([f64; 2], f64)> = None;
    for i in 1..=STEPS {
        let radius = reach_px * f64::from(i) / f64::from(STEPS);
        run = match (trace(design, radius), run) {
            (Some(ray), Some(([start, _], last))) if ray.zenith_rad > last => Some(([start, radius], ray.zenith_rad)),
            (Some(ray), _) => Some(([radius; 2], ray.zenith_rad)),
            (None, _) => None,
        };
        if let Some((ends, _)) = run
            && best.is_none_or(|b| ends[1] - ends[0] > b[1] - b[0])
        {
            best = Some(ends);
        }
    }
    best.filter(|[inner, outer]| outer - inner >= 4.0)
}

/// The ray that an image radius sees, from the pinhole outwards.
fn trace(d: &PalConicoidDesign, radius_px: f64) -> Option<AxialRay> {
    let (sin, cos) = (radius_px / d.focal_length_px).atan().sin_cos();
    // Behind the pinhole the image is at r > 0, so the light is at r < 0 before it.
    let mut light = Light { at: [0.0, d.pinhole_z_mm], towards: [-sin, cos] };
    if let Some(face) = d.face_z_mm {
        let run = (face - d.pinhole_z_mm) / cos;
        let sin = sin / d.refractive_index;
        light = Light { at: [light.at[0] + run * light.towards[0], face], towards: [-sin, (1.0 - sin * sin).sqrt()] };
    }
    let light = reflect(&light, &d.second_mirror)?;
    let light = reflect(&light, &d.first_mirror)?;
    let light = refract(&light, &d.window, d.refractive_index)?;
    let zenith_rad = light.towards[0].atan2(light.towards[1]);
    (zenith_rad > 0.0).then_some(AxialRay { origin_mm: light.at, zenith_rad })
}

/// The nearest point ahead on the sheet of a surface that holds its vertex, with the unit normal there.
fn meet(light: &Light, [vertex, radius, k]: &[f64; 3]) -> Option<([f64; 2], [f64; 2])> {
    let ([r, z], [dr, dz]) = (light.at, light.towards);
    let s = z - vertex;
    let a = dr * dr + (1.0 + k) * dz * dz;
    let b = r * dr + (1.0 + k) * s * dz - radius * dz;
    let c = r * r + (1.0 + k) * s * s - 2.0 * radius * s;
    let root = (b * b - a * c).sqrt();
    root.is_finite().then_some(())?;
    let large = -(b + root.copysign(b));
    let hits = [large / a, c / large].into_iter().filter(|t| *t > 1e-9).filter(|t| {
        // The half with the vertex: the normal's z does not change sign along it.
        let s = s + t * dz;
        (radius - (1.0 + k) * s) * radius > 0.0 && s * radius >= -1e-12
    });
    let t = hits.fold(f64::INFINITY, f64::min);
    t.is_finite().then_some(())?;
    let at = [r + t * dr, z + t * dz];
    let normal = [at[0], (1.0 + k) * (at[1] - vertex) - radius];
    let length = normal[0].hypot(normal[1]);
    Some((at, [normal[0] / length, normal[1] / length]))
}

fn reflect(light: &Light, surface: &[f64; 3]) -> Option<Light> {
    let (at, n) = meet(light, surface)?;
    let twice = 2.0 * (light.towards[0] * n[0] + light.towards[1] * n[1]);
    Some(Light { at, towards: [light.towards[0] - twice * n[0], light.towards[1] - twice * n[1]] })
}

/// Out of the glass; `None` at total reflection.
fn refract(light: &Light, surface: &[f64; 3], n_glass: f64) -> Option<Light> {
    let (at, n) = meet(light, surface)?;
    let cos = light.towards[0] * n[0] + light.towards[1] * n[1];
    let across = [n_glass * (light.towards[0] - cos * n[0]), n_glass * (light.towards[1] - cos * n[1])];
    let rest = 1.0 - across[0].powi(2) - across[1].powi(2);
    (rest > 0.0).then_some(())?;
    let along = rest.sqrt().copysign(cos);
    Some(Light { at, towards: [across[0] + along * n[0], across[1] + along * n[1]] })
}

impl TracedMeridian {
    /// The image radius where a function of the ray that rises with the radius is 0.
    fn radius_where(&self, rises: impl Fn(&AxialRay) -> f64) -> Option<f64> {
        let [inner, outer] = self.radius_px;
        let value = |radius: f64| trace(&self.design, radius.clamp(inner, outer)).map(|ray| rises(&ray));
        (value(inner)? <= 0.0 && value(outer)? >= 0.0).then_some(())?;
        root(inner, outer, 0.5 * (inner + outer), |radius| {
            // A slope to six digits is enough for Newton's steps; the value decides where they end.
            let step = 1e-4;
            let slope =
                value(radius + step).zip(value(radius - step)).map(|(plus, minus)| (plus - minus) / (2.0 * step));
            (value(radius).unwrap_or(f64::NAN), slope.unwrap_or(f64::NAN))
        })
    }
}

impl AxialOptics for TracedMeridian {
    fn ray_of_radius(&self, radius_px: f64) -> Option<AxialRay> {
        let [inner, outer] = self.radius_px;
        (radius_px >= inner && radius_px <= outer).then(|| trace(&self.design, radius_px)).flatten()
    }

    fn radius_of_zenith(&self, zenith_rad: f64) -> Option<f64> {
        self.radius_where(|ray| ray.zenith_rad - zenith_rad)
    }

    fn radius_of_point(&self, r_mm: f64, z_mm: f64) -> Option<f64> {
        let offset = |ray: &AxialRay| {
            let (sin, cos) = ray.zenith_rad.sin_cos();
            let [dr, dz] = [r_mm - ray.origin_mm[0], z_mm - ray.origin_mm[1]];
            (dz * sin - dr * cos, dr * sin + dz * cos)
        };
        let radius = self.radius_where(|ray| offset(ray).0)?;
        (offset(&trace(&self.design, radius)?).1 > 0.0).then_some(radius)
    }

    fn single_viewpoint_mm(&self) -> Option<f64> {
        None
    }

    fn focal_length_px(&self) -> f64 {
        self.design.focal_length_px
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::optics::Camera;
    use crate::optics::laws::camera_laws;

    fn camera(change: impl FnOnce(&mut PalConicoidDesign)) -> PalConicoid {
        let mut design = PalConicoidDesign::from(&PalDesign::REFERENCE);
        change(&mut design);
        PalConicoid::new(design, [768, 576]).unwrap()
    }

    fn greguss() -> PalConicoidDesign {
        PalConicoidDesign { elevation_deg: [-13.0, 18.0], ..PalConicoidDesign::best_fit_spheres(&Pal::reference()) }
    }

    /// A flat face 5 mm before the pinhole's image at z = −14, as MATHS §0: the pinhole moves to −12.11.
    fn with_face() -> PalConicoidDesign {
        PalConicoidDesign {
            face_z_mm: Some(-9.0),
            pinhole_z_mm: -12.11,
            focal_length_px: 751.84954507 / 1.5168,
            elevation_deg: [-14.0, 18.0],
            ..PalConicoidDesign::from(&PalDesign::REFERENCE)
        }
    }

    camera_laws!(laws_of_design_d_traced, camera(|_| {}));
    camera_laws!(laws_of_best_fit_spheres, PalConicoid::new(greguss(), [768, 576]).unwrap());
    camera_laws!(laws_with_a_flat_face, PalConicoid::new(with_face(), [768, 576]).unwrap());

    #[test]
    fn design_d_by_its_surfaces_is_design_d() {
        let (traced, closed) = (camera(|_| {}), Pal::reference());
        for elevation_deg in [-15.0, -3.0, 8.0, 19.9] {
            let (sin, cos) = f64::to_radians(elevation_deg).sin_cos();
            for distance in [0.1, 1.0, 20.0] {
                let point = Vector3::new(cos * 0.8, cos * 0.6, sin) * distance;
                let (Some(ours), Some(theirs)) = (traced.project(&point), closed.project(&point)) else { continue };
                assert!((ours - theirs).norm() < 1e-7, "{point:?}: {ours:?} {theirs:?}");
            }
        }
        assert!((traced.viewpoint_miss_m() - closed.viewpoint_miss_m()).abs() < 1e-9);
    }

    #[test]
    fn a_flat_face_costs_the_elevations_that_maths_says() {
        // MATHS §0: −0.25 … +0.40° between the ideal and the traced ray. Its pinhole is given to 0.01 mm: 0.03°.
        let (ideal, traced) = (Pal::reference(), with_face());
        let error_deg = |radius_in_glass: f64| {
            // The same ray in air before the face: sin ψ_air = n sin ψ_glass.
            let sin = 1.5168 * (radius_in_glass / ideal.design().focal_length_px).atan().sin();
            let ours = trace(&traced, traced.focal_length_px * sin / (1.0 - sin * sin).sqrt()).unwrap();
            (ours.zenith_rad - AxialOptics::ray_of_radius(ideal.optics(), radius_in_glass).unwrap().zenith_rad)
                .to_degrees()
        };
        let [inner, outer] = ideal.annulus_px();
        let errors: Vec<f64> = (0..=50).map(|i| error_deg(inner + (outer - inner) * f64::from(i) / 50.0)).collect();
        let (least, most) = errors.iter().fold((f64::MAX, f64::MIN), |(low, high), e| (low.min(*e), high.max(*e)));
        assert!((least + 0.25).abs() < 0.03 && (most - 0.40).abs() < 0.03, "{least} … {most}");
    }

    #[test]
    fn impossible_surfaces_are_named() {
        let error = |change: fn(&mut PalConicoidDesign)| {
            let mut design = PalConicoidDesign::from(&PalDesign::REFERENCE);
            change(&mut design);
            PalConicoid::new(design, [768, 576]).unwrap_err().to_string()
        };
        assert!(error(|d| d.window[1] = 20.0).contains("opens downwards"));
        assert!(error(|d| d.pinhole_z_mm = 10.0).contains("inside its lens"));
        assert!(error(|d| d.first_mirror[2] = f64::NAN).contains("finite"));
    }
}
