//! Camera models that a calibration can fit, with what it turns of each and where it starts.

use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;

use super::free_camera::FreeCamera;
use crate::optics::fisheye::{FisheyeLaw, FisheyeParameters};
use crate::optics::{
    Camera, Fisheye, Misaligned, Misalignment, ParameterError, Pinhole, PinholeParameters, Polynomial,
    PolynomialParameters, UnifiedSphere, UnifiedSphereParameters,
};

/// The angle off the axis that the picture's nearer edge is first taken to see, radians.
const EDGE_RAD: f64 = 1.8;

/// A model and the numbers of it that a fit turns.
#[derive(Debug, Clone)]
pub struct Candidate {
    /// For reports: the model and its variant.
    pub name: String,
    /// Where the search starts.
    pub start: FreeCamera,
}

/// Which model to fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Mei's unified sphere, plain, with radial and with tangential terms.
    UnifiedSphere,
    /// Scaramuzza's polynomial.
    Polynomial,
    /// A polynomial of the angle off the axis, its even powers too.
    RadiusPolynomial,
    /// Kannala and Brandt's fisheye.
    KannalaBrandt,
    /// Pinhole with OpenCV's distortion.
    Pinhole,
}

/// Names of the numbers that make a camera of known model; `=` holds several equal.
const SPHERE: [&str; 4] = ["xi", "focal_length_px[0]=focal_length_px[1]", "centre_px[0]", "centre_px[1]"];
const FISHEYE: [&str; 7] =
    ["focal_length_px[0]=focal_length_px[1]", "centre_px[0]", "centre_px[1]", "k[0]", "k[1]", "k[2]", "k[3]"];
const POLYNOMIAL: [&str; 6] = ["forward[0]", "forward[2]", "forward[3]", "forward[4]", "centre_px[0]", "centre_px[1]"];
const PINHOLE: [&str; 5] =
    ["focal_length_px[0]=focal_length_px[1]", "centre_px[0]", "centre_px[1]", "distortion[0]", "distortion[1]"];

/// Sets a camera askew to its optics; the amount is turned by the fit.
const MISALIGNMENT: [&str; 2] = ["misalignment.tangential[0]", "misalignment.tangential[1]"];

fn misaligned(camera: &Arc<dyn Camera>) -> Result<Arc<dyn Camera>, ParameterError> {
    Ok(Arc::new(Misaligned::new(camera.clone(), Misalignment::Tangential([0.0; 2]))?))
}

impl Kind {
    /// All that a camera of unknown kind may be; a pinhole only where it is said to be one.
    pub const PANORAMIC: [Self; 4] =
        [Self::UnifiedSphere, Self::RadiusPolynomial, Self::Polynomial, Self::KannalaBrandt];

    /// The variants of this model, simplest first, for pictures of a size; the centre starts in their middle, or where
    /// it is given.
    ///
    /// # Errors
    /// The size or the centre makes no camera.
    pub fn candidates(
        self,
        image_size_px: [u32; 2],
        centre_px: Option<[f64; 2]>,
    ) -> Result<Vec<Candidate>, ParameterError> {
        let [w, h] = image_size_px.map(f64::from);
        let centre_px = centre_px.unwrap_or([0.5 * (w - 1.0), 0.5 * (h - 1.0)]);
        let reach = 0.5 * w.min(h);
        let variant = |name: &str, camera: &Arc<dyn Camera>, base: &[&str], more: &[&str]| {
            let free: Vec<&str> = base.iter().chain(more).copied().collect();
            Candidate { name: name.into(), start: FreeCamera::new(camera.clone(), &free) }
        };
        Ok(match self {
            Self::UnifiedSphere => {
                let focal = reach / (0.5 * EDGE_RAD).tan();
                let parameters = UnifiedSphereParameters {
                    xi: 1.0,
                    focal_length_px: [focal; 2],
                    centre_px,
                    skew: 0.0,
                    distortion: [0.0; 4],
                };
                let camera: Arc<dyn Camera> = Arc::new(UnifiedSphere::new(parameters, image_size_px)?);
                let radial = ["distortion[0]", "distortion[1]"];
                let tangential = ["distortion[0]", "distortion[1]", "distortion[2]", "distortion[3]"];
                let each_axis =
                    ["xi", "focal_length_px[0]", "focal_length_px[1]", "centre_px[0]", "centre_px[1]", "skew"];
                vec![
                    variant("unified sphere", &camera, &SPHERE, &[]),
                    variant("unified sphere, radial", &camera, &SPHERE, &radial),
                    variant("unified sphere, radial and tangential", &camera, &SPHERE, &tangential),
                    variant("unified sphere, all terms", &camera, &each_axis, &tangential),
                ]
            }
            Self::Polynomial => {
                let gamma = reach / (0.5 * EDGE_RAD).tan();
                let parameters = PolynomialParameters {
                    forward: vec![-0.5 * gamma, 0.0, 0.5 / gamma, 0.0, 0.0],
                    inverse: Vec::new(),
                    centre_px,
                    affine: [1.0, 0.0, 0.0],
                };
                let camera: Arc<dyn Camera> = Arc::new(Polynomial::new(parameters, image_size_px)?);
                // A turn of the picture in itself is a turn of every pose: of the three affine numbers two can be known.
                vec![
                    variant("polynomial", &camera, &POLYNOMIAL, &[]),
                    variant("polynomial, affine", &camera, &POLYNOMIAL, &["affine[0]", "affine[1]"]),
                ]
            }
            Self::RadiusPolynomial => {
                // ρ(θ) with θ from −90° at the axis: an equidistant lens to start with.
                let focal = reach / EDGE_RAD;
                let parameters = PolynomialParameters {
                    forward: Vec::new(),
                    inverse: vec![focal * FRAC_PI_2, focal, 0.0, 0.0, 0.0],
                    centre_px,
                    affine: [1.0, 0.0, 0.0],
                };
                let camera: Arc<dyn Camera> = Arc::new(Polynomial::new(parameters, image_size_px)?);
                let base = [
                    "inverse[0]",
                    "inverse[1]",
                    "inverse[2]",
                    "inverse[3]",
                    "inverse[4]",
                    "centre_px[0]",
                    "centre_px[1]",
                ];
                vec![
                    variant("polynomial of the angle", &camera, &base, &[]),
                    variant("polynomial of the angle, affine", &camera, &base, &["affine[0]", "affine[1]"]),
                    variant("polynomial of the angle, misaligned", &misaligned(&camera)?, &base, &MISALIGNMENT),
                ]
            }
            Self::KannalaBrandt => {
                let parameters = FisheyeParameters {
                    law: FisheyeLaw::KannalaBrandt,
                    focal_length_px: [reach / EDGE_RAD; 2],
                    centre_px,
                    k: [0.0; 4],
                };
                let camera: Arc<dyn Camera> = Arc::new(Fisheye::new(parameters, image_size_px)?);
                vec![
                    variant("fisheye, Kannala-Brandt", &camera, &FISHEYE, &[]),
                    variant("fisheye, Kannala-Brandt, misaligned", &misaligned(&camera)?, &FISHEYE, &MISALIGNMENT),
                ]
            }
            Self::Pinhole => {
                let parameters = PinholeParameters { focal_length_px: [w.max(h); 2], centre_px, distortion: [0.0; 5] };
                let camera: Arc<dyn Camera> = Arc::new(Pinhole::new(parameters, image_size_px)?);
                let more = ["distortion[2]", "distortion[3]", "distortion[4]"];
                vec![
                    variant("pinhole", &camera, &PINHOLE, &[]),
                    variant("pinhole, all terms", &camera, &PINHOLE, &more),
                ]
            }
        })
    }
}

/// What of a camera of known design a calibration turns: for the report's lens the minimal parametrisation of focal length,
/// refraction and, for points nearer than about a metre, the size (`MATHS.md` §3.8); for the others everything that
/// is no choice of units.
///
/// # Errors
/// Never for a camera that was made from its own numbers.
pub fn of_design(camera: &dyn Camera) -> Result<Vec<Candidate>, ParameterError> {
    let values: Vec<f64> = camera.parameters().iter().map(|p| p.value).collect();
    let camera = camera.with_values(&values)?;
    let candidate = |name: &str, free: &[&str]| Candidate {
        name: format!("{}{name}", camera.model()),
        start: FreeCamera::new(camera.clone(), free),
    };
    let mut candidates = match camera.model() {
        "pal" => {
            let base = ["focal_length_px", "refraction_eccentricity", "centre_px[0]", "centre_px[1]"];
            let [f, e, u, v] = base;
            vec![
                candidate(", P2", &base),
                candidate(", P2 with aspect", &[f, e, u, v, "aspect"]),
                candidate(", P3 with aspect", &[f, e, u, v, "aspect", "refraction_a_mm"]),
            ]
        }
        _ => {
            // The rest of the numbers are lengths whose scale is a choice of units: the camera's own focal length and
            // the picture's place are what always can be turned.
            let names: Vec<String> = camera.parameters().into_iter().map(|p| p.name).collect();
            let of = |wanted: &[&str]| -> Vec<String> {
                names.iter().filter(|n| wanted.iter().any(|w| n.starts_with(w))).cloned().collect()
            };
            let picture = of(&["focal_length", "scale", "centre_px", "xi", "forward", "k["]);
            let all = of(&[
                "focal_length",
                "scale",
                "centre_px",
                "xi",
                "forward",
                "k[",
                "aspect",
                "distortion",
                "affine",
                "skew",
            ]);
            let plain: Vec<&str> = picture.iter().map(String::as_str).collect();
            let full: Vec<&str> = all.iter().map(String::as_str).collect();
            let mut variants = vec![candidate("", &plain)];
            if plain != full {
                variants.push(candidate(", all terms", &full));
            }
            // Where a pinhole stands before a mirror is a matter of assembly; without a single viewpoint it shows.
            if matches!(camera.model(), "spherical" | "conic") {
                let assembled: Vec<&str> = full.iter().copied().chain(["h_mm"]).collect();
                variants.push(candidate(", all terms and the pinhole's distance", &assembled));
            }
            variants
        }
    };
    // The richest variant askew, where the camera has one pinhole.
    if let (Ok(askew), Some(richest)) = (misaligned(&camera), candidates.last()) {
        let mut free: Vec<String> = richest.start.unknowns().iter().map(|u| u.name.clone()).collect();
        free.extend(MISALIGNMENT.map(String::from));
        let free: Vec<&str> = free.iter().map(String::as_str).collect();
        let name = format!("{}, misaligned", richest.name);
        candidates.push(Candidate { name, start: FreeCamera::new(askew, &free) });
    }
    Ok(candidates)
}
