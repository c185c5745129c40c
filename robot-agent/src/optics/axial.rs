//! What all cameras with an axis of symmetry share: the picture's rings and bearings, the limits of the field of view,
//! the viewpoint. A model only says how image radius and ray belong together in one meridian half-plane ([`AxialOptics`]).
//!
//! A point's azimuth is that of its image, by definition of the picture's axes: bearing = atan2(v − v₀, (u − u₀)/aspect),
//! whichever side of the pinhole the image plane is on.

use std::f64::consts::{FRAC_PI_2, PI};
use std::sync::{Arc, OnceLock};

use nalgebra::{Matrix2x3, RowVector3, Vector2, Vector3};

use super::parameter::{Design, check_aspect, check_centre, check_elevations};
use super::{Camera, NormalisedPlane, Parameter, ParameterError, Ray};

/// Slack of the domain's ends, so that the ends themselves belong to it despite rounding.
const DOMAIN_SLACK_PX: f64 = 1e-7;

const M_FROM_MM: f64 = 1e-3;

/// A ray in a meridian half-plane, on its way out into the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxialRay {
    /// Where it leaves the last surface: (r, z), mm. r counts along the ray's azimuth and may be negative.
    pub origin_mm: [f64; 2],
    /// Angle from the axis z, in [0, π].
    pub zenith_rad: f64,
}

/// How a ray changes with its image radius, per px.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxialSlope {
    /// Of the origin, mm/px.
    pub origin_mm: [f64; 2],
    /// Of the angle, rad/px.
    pub zenith_rad: f64,
}

/// The optics in a half-plane through the axis z. Lengths in mm, image radii in px along v, r ≥ 0.
pub trait AxialOptics: std::fmt::Debug + Clone + Send + Sync + 'static {
    /// The ray that an image radius ≥ 0 sees; `None` where there is none.
    fn ray_of_radius(&self, radius_px: f64) -> Option<AxialRay>;

    /// The image radius of what lies at infinity in a direction, its zenith angle in [0, π].
    fn radius_of_zenith(&self, zenith_rad: f64) -> Option<f64>;

    /// The image radius of a point (r, z).
    fn radius_of_point(&self, r_mm: f64, z_mm: f64) -> Option<f64> {
        self.radius_of_zenith(r_mm.atan2(z_mm))
    }

    /// How the ray changes along the image radius; by differences of the rays where a model has no closed form (relative
    /// truncation 10⁻⁸, rounding 10⁻¹¹).
    fn slope_of_radius(&self, radius_px: f64) -> Option<AxialSlope> {
        let step = 1e-4 * radius_px.max(1e-2 * self.focal_length_px());
        let at = |k: f64| self.ray_of_radius(radius_px + k * step);
        let combined = |parts: &[(f64, AxialRay)]| {
            let sum = |of: &dyn Fn(&AxialRay) -> f64| parts.iter().map(|(w, ray)| w * of(ray)).sum::<f64>() / step;
            let origin_mm = [sum(&|ray| ray.origin_mm[0]), sum(&|ray| ray.origin_mm[1])];
            AxialSlope { origin_mm, zenith_rad: sum(&|ray| ray.zenith_rad) }
        };
        // On one side only at an end of what is seen, and at the axis.
        let inner = if radius_px >= step { at(-1.0) } else { None };
        match (inner, at(1.0)) {
            (Some(inner), Some(outer)) => Some(combined(&[(-0.5, inner), (0.5, outer)])),
            (_, Some(outer)) => Some(combined(&[(-1.5, at(0.0)?), (2.0, outer), (-0.5, at(2.0)?)])),
            (Some(inner), None) => Some(combined(&[(1.5, at(0.0)?), (-2.0, inner), (0.5, at(-2.0)?)])),
            (None, None) => None,
        }
    }

    /// The point of the axis that all rays pass (z, mm); `None` where there is none.
    fn single_viewpoint_mm(&self) -> Option<f64> {
        Some(0.0)
    }

    /// Of the camera that looks at the optics, px along v.
    fn focal_length_px(&self) -> f64;
}

/// Where the axis meets the picture, and how the picture is held against the optics.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImagePlane {
    /// (u₀, v₀), px.
    pub centre_px: [f64; 2],
    /// Pixels along u for one along v.
    pub aspect: f64,
    /// Whether the camera's z runs against the optics' own (a mirror above its camera).
    pub upside_down: bool,
}

/// The table of a camera with an axis of symmetry.
pub trait AxialDesign: Design {
    /// Name as in `camera.toml`.
    const MODEL: &'static str;
    /// Its optics.
    type Optics: AxialOptics;

    /// The optics, after a check of every value that they are made from.
    ///
    /// # Errors
    /// The first parameter that makes no camera.
    fn optics(&self, image_size_px: [u32; 2]) -> Result<Self::Optics, ParameterError>;

    /// How the picture lies.
    fn image_plane(&self) -> ImagePlane;

    /// Elevations [lowest, highest] in degrees that the picture shows; all that it can show where not given.
    fn elevation_deg(&self) -> Option<[f64; 2]>;
}

/// A camera with an axis of symmetry, validated.
#[derive(Debug, Clone)]
pub struct Axial<D: AxialDesign> {
    design: D,
    image_size_px: [u32; 2],
    optics: D::Optics,
    plane: ImagePlane,
    /// Innermost and outermost image radius of the field of view.
    radius_px: [f64; 2],
    elevation_rad: [f64; 2],
    viewpoint_mm: OnceLock<(f64, f64)>,
}

impl<D: AxialDesign> Axial<D> {
    /// Checks that the design can exist and shows its elevations on the picture.
    ///
    /// # Errors
    /// The first parameter that makes that impossible.
    pub fn new(design: D, image_size_px: [u32; 2]) -> Result<Self, ParameterError> {
        let plane = design.image_plane();
        let optics = design.optics(image_size_px)?;
        check_centre(plane.centre_px, image_size_px)?;
        check_aspect(plane.aspect)?;
        let (radius_px, elevation_rad) = field_of_view(&design, &optics, &plane, image_size_px)?;
        Ok(Self { design, image_size_px, optics, plane, radius_px, elevation_rad, viewpoint_mm: OnceLock::new() })
    }

    /// The parameters.
    pub fn design(&self) -> &D {
        &self.design
    }

    /// The optics in the meridian plane.
    pub fn optics(&self) -> &D::Optics {
        &self.optics
    }

    /// Inner and outer radius of the field of view in the picture, px (along v).
    pub fn annulus_px(&self) -> [f64; 2] {
        self.radius_px
    }

    /// Offset from the centre, with square pixels.
    fn offset_px(&self, pixel: &Vector2<f64>) -> Vector2<f64> {
        let [u0, v0] = self.plane.centre_px;
        Vector2::new((pixel.x - u0) / self.plane.aspect, pixel.y - v0)
    }

    /// The pixel at the azimuth of a vector and an image radius.
    fn pixel(&self, v: &Vector3<f64>, radius_px: f64) -> Vector2<f64> {
        let (cos, sin) = azimuth(v.x, v.y);
        let [u0, v0] = self.plane.centre_px;
        Vector2::new(u0 + self.plane.aspect * radius_px * cos, v0 + radius_px * sin)
    }

    fn up(&self) -> f64 {
        if self.plane.upside_down { -1.0 } else { 1.0 }
    }

    fn viewpoint_mm(&self) -> (f64, f64) {
        *self.viewpoint_mm.get_or_init(|| {
            let single = self.optics.single_viewpoint_mm().map(|z| (z, 0.0));
            single.unwrap_or_else(|| best_viewpoint_mm(&self.optics, self.radius_px))
        })
    }
}

impl<D: AxialDesign> Camera for Axial<D> {
    fn model(&self) -> &'static str {
        D::MODEL
    }

    fn image_size_px(&self) -> [u32; 2] {
        self.image_size_px
    }

    fn image_of_point(&self, point_m: &Vector3<f64>) -> Option<Vector2<f64>> {
        is_somewhere(point_m).then_some(())?;
        let (r, z) = (point_m.x.hypot(point_m.y) / M_FROM_MM, self.up() * point_m.z / M_FROM_MM);
        Some(self.pixel(point_m, self.optics.radius_of_point(r, z)?))
    }

    fn image_of_direction(&self, direction: &Vector3<f64>) -> Option<Vector2<f64>> {
        is_somewhere(direction).then_some(())?;
        let zenith = direction.x.hypot(direction.y).atan2(self.up() * direction.z);
        Some(self.pixel(direction, self.optics.radius_of_zenith(zenith)?))
    }

    fn ray_of_image(&self, pixel: &Vector2<f64>) -> Option<Ray> {
        let offset = self.offset_px(pixel);
        let radius = offset.norm();
        radius.is_finite().then_some(())?;
        // What belongs to the domain only by rounding is its end.
        let [inner, outer] = self.radius_px;
        let is_at = |end: f64| (radius - end).abs() <= DOMAIN_SLACK_PX;
        let radius = if is_at(inner) || is_at(outer) { radius.clamp(inner, outer) } else { radius };
        let (cos, sin) = azimuth(offset.x, offset.y);
        let AxialRay { origin_mm: [r, z], zenith_rad } = self.optics.ray_of_radius(radius)?;
        let (sin_z, cos_z) = zenith_rad.sin_cos();
        Some(Ray {
            origin_m: Vector3::new(r * cos, r * sin, self.up() * z) * M_FROM_MM,
            direction: Vector3::new(sin_z * cos, sin_z * sin, self.up() * cos_z),
        })
    }

    /// A point (r, z) appears at the radius whose ray passes it, F = (r − r₀) cos ζ − (z − z₀) sin ζ = 0 with origin (r₀, z₀)
    /// and angle ζ functions of the radius; so ∂radius/∂(r, z) = −(cos ζ, −sin ζ)/F′.
    fn point_jacobian(&self, point_m: &Vector3<f64>) -> Option<Matrix2x3<f64>> {
        is_somewhere(point_m).then_some(())?;
        let (r, z) = (point_m.x.hypot(point_m.y) / M_FROM_MM, self.up() * point_m.z / M_FROM_MM);
        let radius = self.optics.radius_of_point(r, z)?;
        let AxialRay { origin_mm: [r0, z0], zenith_rad } = self.optics.ray_of_radius(radius)?;
        let slope = self.optics.slope_of_radius(radius)?;
        let (sin_z, cos_z) = zenith_rad.sin_cos();
        let along = (r - r0) * sin_z + (z - z0) * cos_z;
        let by_radius = -slope.origin_mm[0] * cos_z + slope.origin_mm[1] * sin_z - along * slope.zenith_rad;
        let (by_r, by_z) = (-cos_z / by_radius, sin_z / by_radius);
        (by_r.is_finite() && by_z.is_finite()).then_some(())?;
        let (cos, sin) = azimuth(point_m.x, point_m.y);
        // Across the meridian the radius stays: the picture turns with the point. On the axis all azimuths are alike.
        let across = if r > 1e-9 * z.abs() { radius / r } else { by_r };
        let outwards = Vector2::new(self.plane.aspect * cos, sin);
        let sideways = Vector2::new(-self.plane.aspect * sin, cos);
        let jacobian = outwards * RowVector3::new(by_r * cos, by_r * sin, by_z * self.up())
            + sideways * RowVector3::new(-across * sin, across * cos, 0.0);
        Some(jacobian / M_FROM_MM)
    }

    fn is_in_field_of_view(&self, pixel: &Vector2<f64>) -> bool {
        let radius = self.offset_px(pixel).norm();
        radius >= self.radius_px[0] - DOMAIN_SLACK_PX && radius <= self.radius_px[1] + DOMAIN_SLACK_PX
    }

    fn normalised_plane(&self) -> Option<NormalisedPlane> {
        let focal = self.optics.focal_length_px();
        Some(NormalisedPlane { centre_px: self.plane.centre_px, focal_length_px: [self.plane.aspect * focal, focal] })
    }

    fn elevation_rad(&self) -> [f64; 2] {
        self.elevation_rad
    }

    /// A ring of the field of view is wholly on the picture.
    fn is_panoramic(&self) -> bool {
        let [w, h] = self.image_size_px.map(f64::from);
        let [u0, v0] = self.plane.centre_px;
        let aspect = self.plane.aspect;
        let room = ((u0 + 0.5) / aspect).min((w - 0.5 - u0) / aspect).min(v0 + 0.5).min(h - 0.5 - v0);
        room > self.radius_px[0] + 1.0
    }

    fn parameters(&self) -> Vec<Parameter> {
        self.design.parameters()
    }

    fn with_values(&self, values: &[f64]) -> Result<Arc<dyn Camera>, ParameterError> {
        Ok(Arc::new(Self::new(self.design.with_values(values), self.image_size_px)?))
    }

    fn table(&self) -> toml::Table {
        self.design.table()
    }

    fn viewpoint_m(&self) -> Vector3<f64> {
        Vector3::new(0.0, 0.0, self.up() * self.viewpoint_mm().0 * M_FROM_MM)
    }

    fn viewpoint_miss_m(&self) -> f64 {
        self.viewpoint_mm().1 * M_FROM_MM
    }
}

/// Where a ray, prolonged backwards, crosses the axis: z in mm, its sagittal viewpoint.
pub fn axis_crossing_mm(ray: &AxialRay) -> f64 {
    let (sin, cos) = ray.zenith_rad.sin_cos();
    ray.origin_mm[1] - ray.origin_mm[0] * cos / sin
}

/// The point (r, z) in mm where the ray of an image radius touches its neighbours, its tangential viewpoint, by central
/// differences; `None` where a ray is missing and for rays that are parallel.
pub fn caustic_mm(optics: &impl AxialOptics, radius_px: f64) -> Option<[f64; 2]> {
    // Relative truncation 10⁻⁸ and rounding 10⁻¹¹ of the slopes.
    let step = 1e-4 * radius_px;
    let ray = optics.ray_of_radius(radius_px)?;
    let (plus, minus) = (optics.ray_of_radius(radius_px + step)?, optics.ray_of_radius(radius_px - step)?);
    let turn = plus.zenith_rad - minus.zenith_rad;
    (turn != 0.0).then_some(())?;
    // o + s u with (o + s u)′ ⊥ n, where u = (sin ζ, cos ζ) and n = (cos ζ, −sin ζ) = u′/ζ′.
    let (sin, cos) = ray.zenith_rad.sin_cos();
    let across = |i: usize| plus.origin_mm[i] - minus.origin_mm[i];
    let s = -(across(0) * cos - across(1) * sin) / turn;
    Some([ray.origin_mm[0] + s * sin, ray.origin_mm[1] + s * cos])
}

/// (cos θ, sin θ); θ = 0 on the axis, where every azimuth is the same.
fn azimuth(x: f64, y: f64) -> (f64, f64) {
    let radius = x.hypot(y);
    if radius > 0.0 { (x / radius, y / radius) } else { (1.0, 0.0) }
}

pub(crate) fn is_somewhere(v: &Vector3<f64>) -> bool {
    v.iter().all(|x| x.is_finite()) && *v != Vector3::zeros()
}

/// The radii and elevations of the field of view: those of the table, or all that the optics show on the picture.
fn field_of_view<D: AxialDesign>(
    design: &D,
    optics: &D::Optics,
    plane: &ImagePlane,
    image_size_px: [u32; 2],
) -> Result<([f64; 2], [f64; 2]), ParameterError> {
    let farthest = farthest_radius_px(plane, image_size_px);
    let Some(elevation_deg) = design.elevation_deg() else {
        return all_that_is_seen(optics, plane, farthest).ok_or_else(|| {
            let [w, h] = image_size_px;
            ParameterError::new(
                "centre_px",
                plane.centre_px,
                format!("where the picture of {w}x{h} pixels shows a ray"),
            )
        });
    };
    check_elevations(elevation_deg)?;
    let zenith = |elevation_deg: f64| {
        let zenith = FRAC_PI_2 - elevation_deg.to_radians();
        if plane.upside_down { PI - zenith } else { zenith }
    };
    let radius = |elevation: f64| {
        optics.radius_of_zenith(zenith(elevation)).ok_or_else(|| {
            let expected = format!("within what the optics let through: no light from {elevation} degrees");
            ParameterError::new("elevation_deg", elevation_deg, expected)
        })
    };
    let (a, b) = (radius(elevation_deg[0])?, radius(elevation_deg[1])?);
    let radius_px = [a.min(b), a.max(b)];
    if radius_px[1] - radius_px[0] < 4.0 || radius_px[0] > farthest {
        let [w, h] = image_size_px;
        let expected = format!(
            "elevations that are seen on the picture: these are between {:.1} and {:.1} px from the centre of {w}x{h} \
             (is a focal length in millimetres?)",
            radius_px[0], radius_px[1]
        );
        return Err(ParameterError::new("elevation_deg", elevation_deg, expected));
    }
    Ok((radius_px, elevation_deg.map(f64::to_radians)))
}

/// Distance from the centre to the picture's farthest corner, px along v.
fn farthest_radius_px(plane: &ImagePlane, image_size_px: [u32; 2]) -> f64 {
    let reach = |c: f64, side: u32| (c + 0.5).max(f64::from(side) - 0.5 - c);
    let [u0, v0] = plane.centre_px;
    (reach(u0, image_size_px[0]) / plane.aspect).hypot(reach(v0, image_size_px[1]))
}

/// The radii up to the picture's farthest corner that see something, and the elevations they see. Radii that see
/// nothing may only lie outside of those that do.
fn all_that_is_seen(optics: &impl AxialOptics, plane: &ImagePlane, farthest_px: f64) -> Option<([f64; 2], [f64; 2])> {
    const STEPS: u32 = 512;
    let radius = |i: u32| farthest_px * f64::from(i) / f64::from(STEPS);
    let sees = |r: f64| optics.ray_of_radius(r).is_some();
    let first = (0..=STEPS).find(|i| sees(radius(*i)))?;
    let last = (first..=STEPS).take_while(|i| sees(radius(*i))).last()?;
    // The ends to the last bit that sees.
    let end = |mut inside: f64, mut outside: f64| {
        for _ in 0..60 {
            let middle = 0.5 * (inside + outside);
            if sees(middle) { inside = middle } else { outside = middle }
        }
        inside
    };
    let inner = if first == 0 { 0.0 } else { end(radius(first), radius(first - 1)) };
    let outer = if last == STEPS { farthest_px } else { end(radius(last), radius(last + 1)) };
    (outer - inner > 4.0).then_some(())?;
    let elevations = (0..=STEPS).filter_map(|i| {
        let ray = optics.ray_of_radius(inner + (outer - inner) * f64::from(i) / f64::from(STEPS))?;
        Some(if plane.upside_down { ray.zenith_rad - FRAC_PI_2 } else { FRAC_PI_2 - ray.zenith_rad })
    });
    let range = elevations.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], e| [low.min(e), high.max(e)]);
    Some(([inner, outer], range))
}

/// The point of the axis whose largest distance to a ray of the field of view is least: (z, that distance), mm.
fn best_viewpoint_mm(optics: &impl AxialOptics, [inner, outer]: [f64; 2]) -> (f64, f64) {
    const SAMPLES: u32 = 400;
    let rays: Vec<AxialRay> = (0..=SAMPLES)
        .filter_map(|i| optics.ray_of_radius(inner + (outer - inner) * f64::from(i) / f64::from(SAMPLES)))
        .collect();
    let miss = |ray: &AxialRay, z: f64| {
        let (sin, cos) = ray.zenith_rad.sin_cos();
        (ray.origin_mm[0] * cos - (ray.origin_mm[1] - z) * sin).abs()
    };
    let worst = |z: f64| rays.iter().map(|ray| miss(ray, z)).fold(0.0, f64::max);
    // Where the steepest ray's distance grows beyond that of the origin nothing better can be.
    let steepest = rays.iter().map(|ray| ray.zenith_rad.sin()).fold(0.0, f64::max).max(1e-3);
    let reach = 2.0 * worst(0.0) / steepest;
    let (mut low, mut high) = (-reach, reach);
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
