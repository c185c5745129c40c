//! The report's panoramic annular lens: ellipsoid and hyperboloid mirrors in one block of glass, a perspective camera
//! below, refraction where the light enters (`model = "pal"`).
//!
//! The camera looks up; the centre of the picture is the zenith and the outer rim the lowest elevation. All optics are
//! in the [`Meridian`] plane. The viewpoint is not quite one point: a ray's origin is where it leaves the glass.
//!
//! Source: report section 3.4 and 3.5 with errata, `MATHS.md` §3.

pub mod conicoid;
mod meridian;
pub mod orthographic;
pub mod single_viewpoint;
mod window;

use std::f64::consts::FRAC_PI_2;

use serde::{Deserialize, Serialize};

pub use meridian::Meridian;
pub use window::{MeridianRay, Window};

use super::ParameterError;
use super::axial::{Axial, AxialDesign, AxialOptics, AxialRay, ImagePlane};
use super::parameter::{check_elevations, check_length_mm, check_positive_px, design, one};

/// The parameters of `[pal]` in `camera.toml`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
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
    #[serde(default = "one")]
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

design!(
    PalDesign: ellipsoid_a_mm,
    ellipsoid_c_mm,
    hyperboloid_a_mm,
    hyperboloid_c_mm,
    focal_length_px,
    refraction_a_mm,
    refraction_eccentricity,
    refractive_index,
    centre_px,
    aspect,
);

/// The PAL camera, validated.
pub type Pal = Axial<PalDesign>;

impl Pal {
    /// Design D.
    #[expect(clippy::missing_panics_doc, clippy::expect_used, reason = "a constant, tested")]
    pub fn reference() -> Self {
        Self::new(PalDesign::REFERENCE, PalDesign::REFERENCE_IMAGE_SIZE_PX).expect("design D is a camera")
    }
}

impl AxialDesign for PalDesign {
    const MODEL: &'static str = "pal";
    type Optics = Meridian;

    fn optics(&self, image_size_px: [u32; 2]) -> Result<Meridian, ParameterError> {
        check_values(self)?;
        check_elevations(self.elevation_deg)?;
        let meridian = Meridian::new(self);
        check_light_path(self, &meridian, image_size_px)?;
        Ok(meridian)
    }

    fn image_plane(&self) -> ImagePlane {
        ImagePlane { centre_px: self.centre_px, aspect: self.aspect, upside_down: false }
    }

    fn elevation_deg(&self) -> Option<[f64; 2]> {
        Some(self.elevation_deg)
    }
}

impl AxialOptics for Meridian {
    fn focal_length_px(&self) -> f64 {
        self.focal_length_px
    }

    fn ray_of_radius(&self, radius_px: f64) -> Option<AxialRay> {
        Self::ray_of_radius(self, radius_px).map(AxialRay::from)
    }

    fn radius_of_zenith(&self, zenith_rad: f64) -> Option<f64> {
        self.radius_of_ray(&self.window.ray_of_zenith(zenith_rad)?)
    }

    fn radius_of_point(&self, r_mm: f64, z_mm: f64) -> Option<f64> {
        self.radius_of_ray(&self.window.ray_of_point(r_mm, z_mm)?)
    }

    fn single_viewpoint_mm(&self) -> Option<f64> {
        None
    }
}

impl From<MeridianRay> for AxialRay {
    fn from(ray: MeridianRay) -> Self {
        Self { origin_mm: ray.exit_mm, zenith_rad: ray.zeta_out }
    }
}

fn check_values(d: &PalDesign) -> Result<(), ParameterError> {
    check_ellipsoid(d.ellipsoid_a_mm, d.ellipsoid_c_mm)?;
    check_hyperboloid(d.hyperboloid_a_mm, d.hyperboloid_c_mm)?;
    check_window(d.refraction_a_mm, d.refraction_eccentricity)?;
    check_glass(d.refractive_index)?;
    check_positive_px("focal_length_px", d.focal_length_px)
}

/// The first mirror.
fn check_ellipsoid(a_mm: f64, c_mm: f64) -> Result<(), ParameterError> {
    check_length_mm("ellipsoid_a_mm", a_mm)?;
    check_length_mm("ellipsoid_c_mm", c_mm)?;
    if c_mm < a_mm {
        return Ok(());
    }
    Err(ParameterError::new("ellipsoid_c_mm", c_mm, "less than ellipsoid_a_mm (an ellipsoid has c < a)"))
}

/// The second mirror.
fn check_hyperboloid(a_mm: f64, c_mm: f64) -> Result<(), ParameterError> {
    check_length_mm("hyperboloid_a_mm", a_mm)?;
    check_length_mm("hyperboloid_c_mm", c_mm)?;
    if c_mm > a_mm {
        return Ok(());
    }
    Err(ParameterError::new("hyperboloid_c_mm", c_mm, "more than hyperboloid_a_mm (a hyperboloid has c > a)"))
}

fn check_window(a_mm: f64, eccentricity: f64) -> Result<(), ParameterError> {
    check_length_mm("refraction_a_mm", a_mm)?;
    if (0.0..1.0).contains(&eccentricity) {
        return Ok(());
    }
    Err(ParameterError::new("refraction_eccentricity", eccentricity, "in [0, 1), 0 for a sphere about V"))
}

fn check_glass(refractive_index: f64) -> Result<(), ParameterError> {
    if (1.0..4.0).contains(&refractive_index) {
        return Ok(());
    }
    let expected = "in [1, 4), 1.5168 for BK7, 1 without refraction";
    Err(ParameterError::new("refractive_index", refractive_index, expected))
}

/// A direction from V is either mirror or window: the window's zenith angles ζ and the mirror's π − ζ must not meet.
fn check_horizon(window: &Window, elevation_deg: [f64; 2]) -> Result<(), ParameterError> {
    let horizon = window.ray_of_zenith_inside(FRAC_PI_2).map_or(f64::NAN, |ray| 90.0 - ray.zeta_out.to_degrees());
    if elevation_deg[0] >= horizon - 1e-6 {
        return Ok(());
    }
    let expected = format!("above {horizon:.2} degrees, where the mirror begins on the outside of the glass");
    Err(ParameterError::new("elevation_deg", elevation_deg, expected))
}

/// Both ends of the field of view must come through the glass and off both mirrors, on radii that fit the picture.
fn check_light_path(d: &PalDesign, m: &Meridian, image_size_px: [u32; 2]) -> Result<(), ParameterError> {
    let radius = |elevation_deg: f64| {
        let radius = AxialOptics::radius_of_zenith(m, FRAC_PI_2 - elevation_deg.to_radians());
        radius.filter(|r| m.point_on_hyperboloid_mm(*r).is_some()).ok_or_else(|| {
            ParameterError::new(
                "elevation_deg",
                d.elevation_deg,
                format!("within what the glass and the mirrors let through: no light from {elevation_deg} degrees"),
            )
        })
    };
    check_horizon(&m.window, d.elevation_deg)?;
    let (outer, inner) = (radius(d.elevation_deg[0])?, radius(d.elevation_deg[1])?);
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
