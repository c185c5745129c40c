//! An ordinary camera with the five-coefficient lens distortion of OpenCV (`model = "pinhole"`), so that ordinary video
//! can be tracked.
//!
//! Problem: the distortion polynomial turns back far from the axis, and a point there would appear inside the picture
//! where it is not. Insight: up to the first turning point of r(1 + k₁r² + k₂r⁴ + k₃r⁶) the map is one to one, so that
//! radius bounds the domain, and within it the inverse is a Newton iteration from the distorted point itself.
//! The optical axis is the camera's x: u = cx − fx·y/x, v = cy − fy·z/x.
//! Source: OpenCV's `calib3d` camera model.

use nalgebra::{Matrix2, Vector2, Vector3};

use super::{Camera, Ray, elevation_rad, is_in_image, pal::ParameterError};

/// The parameters of `[pinhole]` in `camera.toml`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PinholeParameters {
    /// (fx, fy), px.
    pub focal_length_px: [f64; 2],
    /// (cx, cy), px.
    pub centre_px: [f64; 2],
    /// k₁, k₂, p₁, p₂, k₃ as OpenCV orders them.
    pub distortion: [f64; 5],
}

/// A pinhole camera, validated.
#[derive(Debug, Clone, PartialEq)]
pub struct Pinhole {
    parameters: PinholeParameters,
    image_size_px: [u32; 2],
    /// Square of the undistorted radius (tangent of the angle off the axis) where the distortion turns back.
    turning_radius_squared: f64,
    elevation_rad: [f64; 2],
}

impl Pinhole {
    /// Checks that the picture shows something the distortion describes.
    ///
    /// # Errors
    /// The first parameter that makes that impossible.
    pub fn new(parameters: PinholeParameters, image_size_px: [u32; 2]) -> Result<Self, ParameterError> {
        let p = &parameters;
        if !p.focal_length_px.iter().all(|f| *f > 0.0 && f.is_finite()) {
            return Err(ParameterError::new(
                "focal_length_px",
                p.focal_length_px,
                "[fx, fy], both positive, in pixels",
            ));
        }
        let [w, h] = image_size_px;
        if p.focal_length_px[0] < 0.05 * f64::from(w) || p.focal_length_px[1] < 0.05 * f64::from(h) {
            let expected = "[fx, fy] in pixels (these would see 170 degrees and more: are they in millimetres?)";
            return Err(ParameterError::new("focal_length_px", p.focal_length_px, expected));
        }
        if !is_in_image(&Vector2::from(p.centre_px), image_size_px) {
            return Err(ParameterError::new("centre_px", p.centre_px, format!("inside the picture of {w}x{h} pixels")));
        }
        if !p.distortion.iter().all(|k| k.is_finite()) {
            return Err(ParameterError::new("distortion", p.distortion, "[k1, k2, p1, p2, k3], finite numbers"));
        }
        let turning_radius_squared = turning_radius_squared(p.distortion);
        let mut camera = Self { parameters, image_size_px, turning_radius_squared, elevation_rad: [0.0; 2] };
        camera.elevation_rad = camera.border_elevations();
        Ok(camera)
    }

    /// The parameters.
    pub fn parameters(&self) -> &PinholeParameters {
        &self.parameters
    }

    /// The extreme elevations lie on the picture's border (or on the domain's rim, which the border pixels then miss
    /// and the rows and columns further in catch).
    fn border_elevations(&self) -> [f64; 2] {
        let [w, h] = self.image_size_px.map(f64::from);
        let steps = 64;
        let mut range = [f64::INFINITY, f64::NEG_INFINITY];
        for i in 0..=steps {
            for j in 0..=steps {
                let (a, b) = (f64::from(i) / f64::from(steps), f64::from(j) / f64::from(steps));
                let pixel = Vector2::new(a * w - 0.5, b * h - 0.5);
                if let Some(ray) = self.unproject(&pixel) {
                    let elevation = elevation_rad(&ray.direction);
                    range = [range[0].min(elevation), range[1].max(elevation)];
                }
            }
        }
        range
    }

    /// Distorted normalised point and its Jacobian.
    fn distort(&self, p: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        let [k1, k2, p1, p2, k3] = self.parameters.distortion;
        let (x, y) = (p.x, p.y);
        let s = x * x + y * y;
        let radial = 1.0 + s * (k1 + s * (k2 + s * k3));
        let slope = k1 + s * (2.0 * k2 + s * 3.0 * k3);
        let distorted = Vector2::new(
            x * radial + 2.0 * p1 * x * y + p2 * (s + 2.0 * x * x),
            y * radial + p1 * (s + 2.0 * y * y) + 2.0 * p2 * x * y,
        );
        let mixed = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y;
        let jacobian = Matrix2::new(
            radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x,
            mixed,
            mixed,
            radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x,
        );
        (distorted, jacobian)
    }

    /// Whether the distortion is one to one there.
    fn is_regular(&self, undistorted: &Vector2<f64>, jacobian: &Matrix2<f64>) -> bool {
        undistorted.norm_squared() < self.turning_radius_squared && jacobian.determinant() > 0.0
    }

    fn undistort(&self, distorted: &Vector2<f64>) -> Option<Vector2<f64>> {
        const STEPS: usize = 50;
        let limit = self.turning_radius_squared.sqrt();
        let mut point = *distorted;
        if point.norm() >= limit {
            point *= 0.99 * limit / point.norm();
        }
        for _ in 0..STEPS {
            let (value, jacobian) = self.distort(&point);
            let error = value - distorted;
            if error.norm() < 1e-14 * (1.0 + distorted.norm()) {
                break;
            }
            let mut step = jacobian.try_inverse()? * error;
            // Near the turning point a full step may leave the one-to-one disc: halve it.
            let mut halvings = 0;
            while (point - step).norm() >= limit && halvings < 40 {
                step *= 0.5;
                halvings += 1;
            }
            point -= step;
        }
        let (value, jacobian) = self.distort(&point);
        ((value - distorted).norm() < 1e-11 && self.is_regular(&point, &jacobian)).then_some(point)
    }
}

impl Camera for Pinhole {
    fn model(&self) -> &'static str {
        "pinhole"
    }

    fn image_size_px(&self) -> [u32; 2] {
        self.image_size_px
    }

    fn project(&self, point_m: &Vector3<f64>) -> Option<Vector2<f64>> {
        (point_m.x > 0.0).then_some(())?;
        let undistorted = Vector2::new(-point_m.y / point_m.x, -point_m.z / point_m.x);
        let (distorted, jacobian) = self.distort(&undistorted);
        self.is_regular(&undistorted, &jacobian).then_some(())?;
        let p = &self.parameters;
        let pixel = Vector2::new(
            p.centre_px[0] + p.focal_length_px[0] * distorted.x,
            p.centre_px[1] + p.focal_length_px[1] * distorted.y,
        );
        is_in_image(&pixel, self.image_size_px).then_some(pixel)
    }

    fn project_direction(&self, direction: &Vector3<f64>) -> Option<Vector2<f64>> {
        self.project(direction)
    }

    fn unproject(&self, pixel: &Vector2<f64>) -> Option<Ray> {
        is_in_image(pixel, self.image_size_px).then_some(())?;
        let p = &self.parameters;
        let distorted = Vector2::new(
            (pixel.x - p.centre_px[0]) / p.focal_length_px[0],
            (pixel.y - p.centre_px[1]) / p.focal_length_px[1],
        );
        let undistorted = self.undistort(&distorted)?;
        let direction = Vector3::new(1.0, -undistorted.x, -undistorted.y).normalize();
        Some(Ray { origin_m: Vector3::zeros(), direction })
    }

    fn elevation_rad(&self) -> [f64; 2] {
        self.elevation_rad
    }

    fn is_panoramic(&self) -> bool {
        false
    }
}

/// The least s = r² > 0 with 1 + 3k₁s + 5k₂s² + 7k₃s³ = 0, infinite where there is none: bracketed on a geometric grid
/// from 10⁻⁶ to 10⁶ (0.06° to 89.94° off the axis), then bisected.
fn turning_radius_squared([k1, k2, _, _, k3]: [f64; 5]) -> f64 {
    let slope = |s: f64| 1.0 + s * (3.0 * k1 + s * (5.0 * k2 + s * 7.0 * k3));
    let ratio: f64 = 1.01;
    let mut low = 1e-6;
    while low < 1e6 {
        let high = low * ratio;
        if slope(high) <= 0.0 {
            let (mut a, mut b) = (low, high);
            for _ in 0..60 {
                let middle = 0.5 * (a + b);
                if slope(middle) > 0.0 { a = middle } else { b = middle }
            }
            return a;
        }
        low = high;
    }
    f64::INFINITY
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::laws::camera_laws;

    fn parameters(distortion: [f64; 5]) -> PinholeParameters {
        PinholeParameters { focal_length_px: [700.0, 710.0], centre_px: [322.0, 238.5], distortion }
    }

    fn camera(distortion: [f64; 5]) -> Pinhole {
        Pinhole::new(parameters(distortion), [640, 480]).unwrap()
    }

    camera_laws!(without_distortion, camera([0.0; 5]));
    camera_laws!(with_barrel_distortion, camera([-0.28, 0.09, 1e-3, -5e-4, -0.012]));
    camera_laws!(with_pincushion_distortion, camera([0.2, -0.03, 0.0, 2e-4, 0.0]));

    #[test]
    fn a_point_to_the_left_appears_left_and_a_point_above_appears_above() {
        let pixel = camera([0.0; 5]).project(&Vector3::new(2.0, 0.2, 0.1)).unwrap();
        assert_eq!((pixel.x, pixel.y), (322.0 - 70.0, 238.5 - 35.5));
    }

    #[test]
    fn distortion_agrees_with_opencv_by_hand() {
        // (x, y) = (0.3, -0.2): r² = 0.13, radial = 1 + 0.13·(-0.28) + 0.0169·0.09 + 0.002197·(-0.012)
        let radial = 1.0 - 0.0364 + 0.001521 - 0.000026364;
        let x = 0.3 * radial + 2.0 * 1e-3 * 0.3 * -0.2 + -5e-4 * (0.13 + 0.18);
        let y = -0.2 * radial + 1e-3 * (0.13 + 0.08) + 2.0 * -5e-4 * 0.3 * -0.2;
        let pixel = camera([-0.28, 0.09, 1e-3, -5e-4, -0.012]).project(&Vector3::new(1.0, -0.3, 0.2)).unwrap();
        assert!((pixel.x - (322.0 + 700.0 * x)).abs() < 1e-9 && (pixel.y - (238.5 + 710.0 * y)).abs() < 1e-9);
    }

    #[test]
    fn a_point_beyond_the_turning_radius_has_no_image() {
        // k1 = -1: r(1 - r²) turns at r = 1/√3 = 0.577 and would come back to the centre at r = 1.
        let camera = camera([-1.0, 0.0, 0.0, 0.0, 0.0]);
        assert!((camera.turning_radius_squared - 1.0 / 3.0).abs() < 1e-9);
        assert!(camera.project(&Vector3::new(1.0, 0.9, 0.0)).is_none());
        assert!(camera.project(&Vector3::new(1.0, 0.4, 0.0)).is_some());
    }

    #[test]
    fn what_is_behind_has_no_image() {
        assert!(camera([0.0; 5]).project(&Vector3::new(-1.0, 0.0, 0.0)).is_none());
    }

    #[test]
    fn a_focal_length_in_millimetres_is_named() {
        let wrong = PinholeParameters { focal_length_px: [4.2, 4.2], ..parameters([0.0; 5]) };
        let error = Pinhole::new(wrong, [640, 480]).unwrap_err().to_string();
        assert!(error.contains("focal_length_px") && error.contains("millimetres"), "{error}");
    }
}
