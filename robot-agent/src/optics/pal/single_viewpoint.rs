//! The PAL that keeps a single viewpoint with refraction: its window is a Cartesian oval
//! (`model = "pal-single-viewpoint"`, design S).
//!
//! Problem: an ellipsoid as window bends rays from V so that they seem to come from everywhere along 3 mm of the axis.
//! Insight: the surface n|R| − |R − V′| = C makes all optical paths from V to the wave about V′ equal, so every ray from
//! V leaves as if from V′ = (0, t). Source: Descartes; the report's "new single-viewpoint PAL", `MATHS.md` §3.5.

use std::f64::consts::{FRAC_PI_2, PI};

use serde::{Deserialize, Serialize};

use super::{check_ellipsoid, check_glass, check_hyperboloid};
use crate::optics::ParameterError;
use crate::optics::axial::{Axial, AxialDesign, AxialOptics, AxialRay, ImagePlane};
use crate::optics::parameter::{check_length_mm, check_positive_px, design, one};
use crate::optics::root::root;

/// The parameters of `[pal-single-viewpoint]` in `camera.toml`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PalSingleViewpointDesign {
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
    /// n of the glass against air, > 1.
    pub refractive_index: f64,
    /// t: the viewpoint's height above V, mm.
    #[serde(alias = "t_mm")]
    pub oval_t_mm: f64,
    /// C: the oval's path difference n|R| − |R − V′|, mm; > t.
    #[serde(alias = "oval_C_mm", alias = "C_mm")]
    pub oval_c_mm: f64,
    /// (u₀, v₀): the image of the axis, px.
    pub centre_px: [f64; 2],
    /// Pixels along u for one along v.
    #[serde(default = "one")]
    pub aspect: f64,
    /// Elevations [lowest, highest] that the annulus shows, degrees.
    pub elevation_deg: [f64; 2],
}

design!(
    PalSingleViewpointDesign: ellipsoid_a_mm,
    ellipsoid_c_mm,
    hyperboloid_a_mm,
    hyperboloid_c_mm,
    focal_length_px,
    refractive_index,
    oval_t_mm,
    oval_c_mm,
    centre_px,
    aspect,
);

impl PalSingleViewpointDesign {
    /// Design S of `MATHS.md` §3.5: −15° … +20° on 768×576.
    pub const DESIGN_S: Self = Self {
        ellipsoid_a_mm: 21.978021978022,
        ellipsoid_c_mm: 6.59340659340659,
        hyperboloid_a_mm: 6.90659340659341,
        hyperboloid_c_mm: 13.5934065934066,
        focal_length_px: 744.912451010028,
        refractive_index: 1.5168,
        oval_t_mm: 5.35898384862245,
        oval_c_mm: 9.63047639179834,
        centre_px: [383.5, 287.5],
        aspect: 1.0,
        elevation_deg: [-15.0, 20.0],
    };
}

/// A single-viewpoint PAL camera, validated.
pub type PalSingleViewpoint = Axial<PalSingleViewpointDesign>;

/// The optics in a meridian half-plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OvalMeridian {
    focal_length_px: f64,
    /// K of the half-angle theorem.
    gain: f64,
    n: f64,
    t_mm: f64,
    c_mm: f64,
    /// Zenith angle inside the glass where that outside is least.
    least_zeta_in: f64,
}

impl AxialDesign for PalSingleViewpointDesign {
    const MODEL: &'static str = "pal-single-viewpoint";
    type Optics = OvalMeridian;

    fn optics(&self, _image_size_px: [u32; 2]) -> Result<OvalMeridian, ParameterError> {
        check_ellipsoid(self.ellipsoid_a_mm, self.ellipsoid_c_mm)?;
        check_hyperboloid(self.hyperboloid_a_mm, self.hyperboloid_c_mm)?;
        check_glass(self.refractive_index)?;
        check_positive_px("focal_length_px", self.focal_length_px)?;
        if self.refractive_index < 1.0 + 1e-6 {
            let expected = "more than 1: without refraction the model is \"pal\"";
            return Err(ParameterError::new("refractive_index", self.refractive_index, expected));
        }
        check_length_mm("oval_c_mm", self.oval_c_mm)?;
        if !(-self.oval_c_mm..self.oval_c_mm).contains(&self.oval_t_mm) {
            let expected = "less than oval_c_mm, else no surface surrounds both points";
            return Err(ParameterError::new("oval_t_mm", self.oval_t_mm, expected));
        }
        let e_e = self.ellipsoid_c_mm / self.ellipsoid_a_mm;
        let e_h = self.hyperboloid_c_mm / self.hyperboloid_a_mm;
        let mut optics = OvalMeridian {
            focal_length_px: self.focal_length_px,
            gain: (1.0 + e_e) / (1.0 - e_e) * (e_h + 1.0) / (e_h - 1.0),
            n: self.refractive_index,
            t_mm: self.oval_t_mm,
            c_mm: self.oval_c_mm,
            least_zeta_in: 0.0,
        };
        optics.least_zeta_in = optics.find_least();
        Ok(optics)
    }

    fn image_plane(&self) -> ImagePlane {
        ImagePlane { centre_px: self.centre_px, aspect: self.aspect, upside_down: false }
    }

    fn elevation_deg(&self) -> Option<[f64; 2]> {
        Some(self.elevation_deg)
    }
}

impl OvalMeridian {
    /// K.
    pub fn half_angle_gain(&self) -> f64 {
        self.gain
    }

    /// |VR| along a ray inside the glass.
    pub fn distance_mm(&self, zeta_in: f64) -> f64 {
        let (n, t, c) = (self.n, self.t_mm, self.c_mm);
        let half = n * c - t * zeta_in.cos();
        (half + (half * half - (n * n - 1.0) * (c * c - t * t)).sqrt()) / (n * n - 1.0)
    }

    /// The oval's point on a ray inside the glass and the zenith angle with which it leaves from V′.
    pub fn ray_of_zenith_inside(&self, zeta_in: f64) -> Option<AxialRay> {
        let (sin, cos) = zeta_in.sin_cos();
        let d = self.distance_mm(zeta_in);
        let zenith_rad = (d * sin).atan2(d * cos - self.t_mm);
        d.is_finite().then_some(AxialRay { origin_mm: [d * sin, d * cos], zenith_rad })
    }

    /// Zenith angle inside the glass for one outside: the branch beyond the minimum, which is the one that is used.
    pub fn zenith_inside(&self, zenith_rad: f64) -> Option<f64> {
        let miss = |zeta_in: f64| {
            // Undefined where no surface is: below the root, for the bracket.
            let zenith = self.ray_of_zenith_inside(zeta_in).map_or(0.0, |ray| ray.zenith_rad);
            zenith - zenith_rad
        };
        (miss(self.least_zeta_in) <= 0.0 && miss(PI) >= 0.0).then_some(())?;
        root(self.least_zeta_in, PI, zenith_rad - 0.2, |zeta_in| {
            // Secant slope: the root is then polished by the bracket's own steps to the last bit.
            let step = 1e-6;
            (miss(zeta_in), (miss(zeta_in + step) - miss(zeta_in - step)) / (2.0 * step))
        })
    }

    /// Where the zenith angle outside begins to rise.
    fn find_least(&self) -> f64 {
        const STEPS: u32 = 1000;
        let zenith = |i: u32| {
            let zeta_in = FRAC_PI_2 * f64::from(i) / f64::from(STEPS);
            (zeta_in, self.ray_of_zenith_inside(zeta_in).map_or(f64::INFINITY, |ray| ray.zenith_rad))
        };
        let least = (0..=STEPS).map(zenith).min_by(|a, b| a.1.total_cmp(&b.1));
        least.map_or(0.0, |(zeta_in, _)| zeta_in)
    }
}

impl AxialOptics for OvalMeridian {
    fn ray_of_radius(&self, radius_px: f64) -> Option<AxialRay> {
        let t = radius_px / self.focal_length_px;
        let zeta_in = 2.0 * (self.gain * t / (1.0 + (1.0 + t * t).sqrt())).atan();
        (zeta_in >= self.least_zeta_in).then(|| self.ray_of_zenith_inside(zeta_in)).flatten()
    }

    fn radius_of_zenith(&self, zenith_rad: f64) -> Option<f64> {
        let tau = (0.5 * self.zenith_inside(zenith_rad)?).tan() / self.gain;
        (tau < 1.0).then(|| 2.0 * self.focal_length_px * tau / (1.0 - tau * tau))
    }

    fn radius_of_point(&self, r_mm: f64, z_mm: f64) -> Option<f64> {
        // Every ray comes from V′; the point must be outside the oval.
        let outside = self.n * r_mm.hypot(z_mm) - r_mm.hypot(z_mm - self.t_mm) >= self.c_mm * (1.0 - 1e-12);
        outside.then(|| self.radius_of_zenith(r_mm.atan2(z_mm - self.t_mm))).flatten()
    }

    fn single_viewpoint_mm(&self) -> Option<f64> {
        Some(self.t_mm)
    }

    fn focal_length_px(&self) -> f64 {
        self.focal_length_px
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::optics::Camera;
    use crate::optics::laws::{assert_rel, camera_laws, golden};

    fn camera() -> PalSingleViewpoint {
        PalSingleViewpoint::new(PalSingleViewpointDesign::DESIGN_S, [768, 576]).unwrap()
    }

    camera_laws!(design_s, camera());

    #[test]
    fn the_oval_is_golden() {
        let (inputs, golden, tol) = golden("pal.oval");
        let optics = *camera().optics();
        for (i, zeta_deg) in inputs["zeta_deg"].as_array().unwrap().iter().enumerate() {
            let zeta = zeta_deg.as_f64().unwrap().to_radians();
            assert_rel(optics.distance_mm(zeta), &golden["d"][i], tol);
            assert_rel(optics.ray_of_zenith_inside(zeta).unwrap().zenith_rad, &golden["zeta_out"][i], tol);
        }
        assert_rel(optics.zenith_inside(70_f64.to_radians()).unwrap(), &golden["zeta_in_for_70deg"], tol);
    }

    #[test]
    fn far_points_appear_at_the_golden_radii() {
        let (_, golden, tol) = golden("pal.designS");
        assert_rel(camera().optics().half_angle_gain(), &golden["K"], tol);
        for row in golden["table"].as_array().unwrap() {
            let (sin, cos) = row["elev_deg"].as_f64().unwrap().to_radians().sin_cos();
            let pixel = camera().project_direction(&Vector3::new(cos, 0.0, sin)).unwrap();
            assert_rel(pixel.x - 383.5, &row["r_I"], tol);
        }
    }

    #[test]
    fn every_ray_passes_the_viewpoint() {
        let camera = camera();
        assert_eq!(camera.viewpoint_miss_m(), 0.0);
        for radius in [116.0, 150.0, 200.0, 269.0] {
            let ray = camera.unproject(&nalgebra::Vector2::new(383.5, 287.5 + radius)).unwrap();
            assert!((ray.origin_m - camera.viewpoint_m()).cross(&ray.direction).norm() < 1e-16);
        }
    }

    #[test]
    fn an_oval_that_contains_only_one_point_is_an_error() {
        let wrong = PalSingleViewpointDesign { oval_t_mm: 12.0, ..PalSingleViewpointDesign::DESIGN_S };
        assert_eq!(PalSingleViewpoint::new(wrong, [768, 576]).unwrap_err().key, "oval_t_mm");
    }
}
