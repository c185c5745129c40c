//! The tilt of a camera from two centres: that of vertical lines moves with it, that of the rim circles does not.
//!
//! How far a degree moves the lines' centre depends on the camera; it is found by tilting vertical lines in front of the
//! camera and crossing their images (4.26 px a degree for the report's lens).
//!
//! Source: `MATHS.md` §4.1.

use nalgebra::{Matrix2, Rotation3, Vector2, Vector3};

use super::centre;
use crate::optics::{Camera, direction};

/// Vertical lines round the camera.
const LINES: u32 = 36;
/// Points of each, over the field of view.
const POINTS: u32 = 25;
/// The tilt that the derivative is taken over, radians.
const STEP_RAD: f64 = 2e-3;

/// What two centres say.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tilt {
    /// Angle between the camera's axis and the vertical, radians.
    pub angle_rad: f64,
    /// Its standard deviation.
    pub sigma_rad: f64,
    /// Bearing (camera's frame) towards which the upper end of the axis leans, radians.
    pub towards_rad: f64,
    /// How far a tilt moves the lines' centre, px per radian.
    pub px_per_rad: f64,
}

/// The tilt from the offset (px) of the lines' centre from the rims'. `None` for a camera whose lines do not cross.
pub fn from_centres(camera: &dyn Camera, offset_px: &Vector2<f64>, covariance_px2: &Matrix2<f64>) -> Option<Tilt> {
    // Columns: how the centre moves when the axis leans towards x and towards y.
    let moved = |towards: Vector3<f64>| -> Option<Vector2<f64>> {
        let axis = Vector3::z().cross(&towards);
        Some((lines_centre(camera, axis * STEP_RAD)? - lines_centre(camera, -axis * STEP_RAD)?) / (2.0 * STEP_RAD))
    };
    let slope = Matrix2::from_columns(&[moved(Vector3::x())?, moved(Vector3::y())?]);
    let inverse = slope.try_inverse()?;
    let lean = inverse * offset_px;
    let covariance = inverse * covariance_px2 * inverse.transpose();
    let angle_rad = lean.norm();
    let unit = if angle_rad > 0.0 { lean / angle_rad } else { Vector2::x() };
    Some(Tilt {
        angle_rad,
        sigma_rad: unit.dot(&(covariance * unit)).max(0.0).sqrt(),
        towards_rad: lean.y.atan2(lean.x),
        px_per_rad: slope.determinant().abs().sqrt(),
    })
}

/// Where the images of vertical lines cross when the camera is turned by a rotation vector (radians).
fn lines_centre(camera: &dyn Camera, turn: Vector3<f64>) -> Option<Vector2<f64>> {
    let camera_from_world = Rotation3::new(turn).inverse();
    // Without the outermost parts of the field of view, which a tilt moves out of it.
    let [low, high] = camera.elevation_rad();
    let margin = 0.05 * (high - low) + 2.0 * STEP_RAD;
    let lines: Vec<Vec<Vector2<f64>>> = (0..LINES)
        .map(|i| {
            let bearing = std::f64::consts::TAU * (f64::from(i) + 0.5) / f64::from(LINES);
            (0..POINTS)
                .filter_map(|k| {
                    let elevation = low + margin + (high - low - 2.0 * margin) * f64::from(k) / f64::from(POINTS - 1);
                    camera.image_of_direction(&(camera_from_world * direction(bearing, elevation)))
                })
                .collect()
        })
        .collect();
    centre::of_lines(&lines).ok().map(|c| c.centre_px)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::Pal;

    #[test]
    fn a_degree_moves_the_lines_centre_as_far_as_independent_code_says() {
        let camera = Pal::reference();
        let tilt = from_centres(&camera, &Vector2::new(4.26, 0.0), &(Matrix2::identity() * 0.01)).unwrap();
        assert!((tilt.px_per_rad.to_radians() - 4.26).abs() < 0.15, "{}", tilt.px_per_rad.to_radians());
        assert!((tilt.angle_rad.to_degrees() - 1.0).abs() < 0.04, "{tilt:?}");
        assert!((tilt.sigma_rad.to_degrees() - 0.1 / 4.26).abs() < 2e-3, "{tilt:?}");
    }
}
