//! Cameras: where a point appears, and which ray a pixel sees.
//!
//! One camera model a file behind the object-safe [`Camera`]; [`CameraFile`] reads `camera.toml`; [`MountedCamera`]
//! puts a model on a robot and speaks the body frame, which is what the rest of the agent wants.
//!
//! ```text
//! body frame ──[Mounting]──▶ camera frame ──[mirrored]──▶ Camera::project ──▶ pixel
//! ```

pub mod axial;
mod camera_file;
pub mod conic;
pub mod ellipsoidal;
pub mod fisheye;
pub mod fixed_viewpoint;
pub mod hyperboloidal;
pub mod jacobian;
#[cfg(test)]
pub(crate) mod laws;
mod lens_distortion;
pub mod mirror;
pub mod misaligned;
pub mod mosaic;
mod mounted;
mod mounting;
pub mod pal;
pub mod paraboloidal;
pub mod parameter;
pub mod pinhole;
pub mod polynomial;
pub mod pyramid;
mod root;
pub mod spherical;
pub mod two_paraboloids;
pub mod unified_sphere;

use std::sync::Arc;

use nalgebra::{Matrix2x3, Vector2, Vector3};

pub use camera_file::{CameraFile, MODELS, camera_toml};
pub use conic::{Conic, ConicParameters};
pub use ellipsoidal::{Ellipsoidal, EllipsoidalParameters};
pub use fisheye::{Fisheye, FisheyeLaw, FisheyeParameters};
pub use hyperboloidal::{Hyperboloidal, HyperboloidalParameters};
pub use mirror::CameraSide;
pub use misaligned::{Misaligned, Misalignment};
pub use mosaic::{Mosaic, MosaicParameters};
pub use mounted::{Mask, MountedCamera, Resolution, Timing};
pub use mounting::{Mounting, MountingSigma};
pub use pal::conicoid::{PalConicoid, PalConicoidDesign};
pub use pal::orthographic::{PalOrthographic, PalOrthographicDesign};
pub use pal::single_viewpoint::{PalSingleViewpoint, PalSingleViewpointDesign};
pub use pal::{Pal, PalDesign};
pub use paraboloidal::{Paraboloidal, ParaboloidalParameters};
pub use parameter::{Parameter, ParameterError};
pub use pinhole::{Pinhole, PinholeParameters};
pub use polynomial::{Polynomial, PolynomialParameters};
pub use pyramid::{Pyramid, PyramidParameters};
pub use spherical::{Spherical, SphericalParameters};
pub use unified_sphere::{UnifiedSphere, UnifiedSphereParameters};

/// What a pixel sees: a half-line, in metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ray {
    /// Where the ray leaves the outermost surface (the viewpoint of a central camera).
    pub origin_m: Vector3<f64>,
    /// Unit vector away from the camera.
    pub direction: Vector3<f64>,
}

/// Where the optical axis meets the picture, and the pixels of a unit on the plane at unit distance from the pinhole.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NormalisedPlane {
    /// (u₀, v₀), px.
    pub centre_px: [f64; 2],
    /// (fx, fy), px.
    pub focal_length_px: [f64; 2],
}

/// A camera model without its mounting. Points are in the camera's frame: origin V of `MATHS.md` §3 for the PALs, the
/// viewpoint of a central camera, the mirror's apex or centre of the others; axes as the body's (x forward, y left,
/// z up). Cameras with an axis of symmetry have it along z and look up: u runs along x and v along y. Only the pinhole
/// looks along x. Pixels have their centres at integers.
///
/// The domain is the same in all directions: a pixel belongs to it iff it is in the picture (−½ … size−½) and its ray
/// is one the model describes; a point iff its pixel does. `image_of_…` and `ray_of_image` are the optics alone, which
/// a calibration needs beyond the picture's edge, too.
pub trait Camera: std::fmt::Debug + Send + Sync {
    /// Name as in `camera.toml`.
    fn model(&self) -> &'static str;

    /// Width and height of the picture.
    fn image_size_px(&self) -> [u32; 2];

    /// Where the optics image a point (metres), also beyond the picture's edge; `None` where they do not.
    fn image_of_point(&self, point_m: &Vector3<f64>) -> Option<Vector2<f64>>;

    /// The same for a point at infinity; `direction` need not be a unit vector.
    fn image_of_direction(&self, direction: &Vector3<f64>) -> Option<Vector2<f64>>;

    /// The ray of an image position, also beyond the picture's edge; `None` where there is none.
    fn ray_of_image(&self, pixel: &Vector2<f64>) -> Option<Ray>;

    /// Whether an image position, which may lie beyond the picture's edge, is one that the model is for.
    fn is_in_field_of_view(&self, _pixel: &Vector2<f64>) -> bool {
        true
    }

    /// Whether a position is in the picture and in the field of view, provided that it has a ray.
    fn is_in_domain(&self, pixel: &Vector2<f64>) -> bool {
        is_in_image(pixel, self.image_size_px()) && self.is_in_field_of_view(pixel)
    }

    /// The image plane at unit distance from the camera's pinhole; `None` for cameras that have more than one or none.
    fn normalised_plane(&self) -> Option<NormalisedPlane> {
        None
    }

    /// How the camera stands askew to its optics, where it does.
    fn misalignment(&self) -> Option<Misalignment> {
        None
    }

    /// Elevations [lowest, highest] in radians that the camera sees somewhere.
    fn elevation_rad(&self) -> [f64; 2];

    /// Whether it sees all bearings.
    fn is_panoramic(&self) -> bool;

    /// The numbers that make the model, in a fixed order.
    fn parameters(&self) -> Vec<Parameter>;

    /// The same camera with other numbers, in the order of [`Camera::parameters`].
    ///
    /// # Errors
    /// The first parameter that makes no camera.
    fn with_values(&self, values: &[f64]) -> Result<Arc<dyn Camera>, ParameterError>;

    /// The model's table of `camera.toml`.
    fn table(&self) -> toml::Table;

    /// The point from which the camera looks, to the best approximation by one point. The origin for central cameras;
    /// for the others the point of the axis that the rays miss least.
    fn viewpoint_m(&self) -> Vector3<f64> {
        Vector3::zeros()
    }

    /// How much later than the picture's capture time a place on it is seen, seconds: other than 0 for cameras whose columns
    /// are taken one after the other.
    fn seen_after_s(&self, _pixel: &Vector2<f64>) -> f64 {
        0.0
    }

    /// The largest distance (metres) by which a ray misses [`Camera::viewpoint_m`]; 0 for central cameras.
    fn viewpoint_miss_m(&self) -> f64 {
        0.0
    }

    /// Where a point (metres) appears; `None` outside the domain.
    fn project(&self, point_m: &Vector3<f64>) -> Option<Vector2<f64>> {
        self.image_of_point(point_m).filter(|pixel| self.is_in_domain(pixel))
    }

    /// Where a point at infinity appears; `direction` need not be a unit vector. `None` outside the domain.
    fn project_direction(&self, direction: &Vector3<f64>) -> Option<Vector2<f64>> {
        self.image_of_direction(direction).filter(|pixel| self.is_in_domain(pixel))
    }

    /// The ray of a pixel; `None` outside the domain.
    fn unproject(&self, pixel: &Vector2<f64>) -> Option<Ray> {
        self.is_in_domain(pixel).then(|| self.ray_of_image(pixel)).flatten()
    }

    /// ∂pixel/∂point (2×3, px/m) where [`Camera::image_of_point`] gives one. By central differences where the model has
    /// no closed form.
    fn point_jacobian(&self, point_m: &Vector3<f64>) -> Option<Matrix2x3<f64>> {
        jacobian::of_point(|p| self.image_of_point(p), point_m)
    }
}

/// The elevations of what a camera sees on its picture, on a grid that includes the border.
pub(crate) fn elevations_on_the_picture(camera: &dyn Camera) -> [f64; 2] {
    const STEPS: u32 = 64;
    let [w, h] = camera.image_size_px().map(f64::from);
    let mut range = [f64::INFINITY, f64::NEG_INFINITY];
    for i in 0..=STEPS {
        for j in 0..=STEPS {
            let (a, b) = (f64::from(i) / f64::from(STEPS), f64::from(j) / f64::from(STEPS));
            if let Some(ray) = camera.unproject(&Vector2::new(a * w - 0.5, b * h - 0.5)) {
                let elevation = elevation_rad(&ray.direction);
                range = [range[0].min(elevation), range[1].max(elevation)];
            }
        }
    }
    range
}

/// Whether a pixel position lies on the picture, whose pixels reach half a pixel beyond their centres.
pub(crate) fn is_in_image(pixel: &Vector2<f64>, image_size_px: [u32; 2]) -> bool {
    let inside = |x: f64, n: u32| x >= -0.5 && x <= f64::from(n) - 0.5;
    inside(pixel.x, image_size_px[0]) && inside(pixel.y, image_size_px[1])
}

/// The elevation (radians) of a direction.
pub fn elevation_rad(direction: &Vector3<f64>) -> f64 {
    direction.z.atan2(direction.x.hypot(direction.y))
}

/// The bearing (radians, counter-clockwise from x) of a direction.
pub fn bearing_rad(direction: &Vector3<f64>) -> f64 {
    direction.y.atan2(direction.x)
}

/// The unit vector with a bearing and an elevation (radians).
pub fn direction(bearing_rad: f64, elevation_rad: f64) -> Vector3<f64> {
    let (sin_b, cos_b) = bearing_rad.sin_cos();
    let (sin_e, cos_e) = elevation_rad.sin_cos();
    Vector3::new(cos_e * cos_b, cos_e * sin_b, sin_e)
}
