//! How a camera sits on its robot.

use nalgebra::{Rotation3, Vector3};

/// Height of the camera above the floor where nothing is said, metres.
pub const DEFAULT_HEIGHT_M: f64 = 0.6;

/// The pose of the camera frame in the body frame, and how well it is known.
///
/// `body_from_camera` = translation `position_m`, rotation Rz(yaw)·Ry(pitch)·Rx(roll): a positive pitch lowers the
/// nose (x towards −z), a positive roll lowers the right side (y towards z).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mounting {
    /// The model's origin in the body frame, metres.
    pub position_m: Vector3<f64>,
    /// Roll, pitch, yaw, radians. Yaw is the azimuth offset.
    pub rotation_rpy_rad: [f64; 3],
    /// Whether the picture is mirror-reversed: the image's azimuth is then negated.
    pub mirrored: bool,
    /// Whether the height was given. Where it was not, `position_m` has a default that no range may be built on.
    pub height_is_given: bool,
    /// Standard deviations.
    pub sigma: MountingSigma,
}

/// Standard deviations of a mounting: errors that all pictures of a camera share.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MountingSigma {
    /// Of the position's components, metres.
    pub position_m: Vector3<f64>,
    /// Of roll, pitch and yaw, radians.
    pub rotation_rpy_rad: [f64; 3],
}

impl Default for MountingSigma {
    /// What a careful hand reaches with a ruler and a spirit level: 5 mm, 0.1° of tilt. Yaw is exact: it defines what
    /// "ahead" means.
    fn default() -> Self {
        let tilt = 0.1_f64.to_radians();
        Self { position_m: Vector3::new(0.005, 0.005, 0.005), rotation_rpy_rad: [tilt, tilt, 0.0] }
    }
}

impl Default for Mounting {
    fn default() -> Self {
        Self {
            position_m: Vector3::new(0.0, 0.0, DEFAULT_HEIGHT_M),
            rotation_rpy_rad: [0.0; 3],
            mirrored: false,
            height_is_given: false,
            sigma: MountingSigma::default(),
        }
    }
}

impl Mounting {
    /// On the axis at a known height, level, looking ahead.
    pub fn at_height(height_m: f64) -> Self {
        Self { position_m: Vector3::new(0.0, 0.0, height_m), height_is_given: true, ..Self::default() }
    }

    /// The rotation part of `body_from_camera`.
    pub fn body_from_camera_rotation(&self) -> Rotation3<f64> {
        let [roll, pitch, yaw] = self.rotation_rpy_rad;
        Rotation3::from_euler_angles(roll, pitch, yaw)
    }

    /// Height of the model's origin above the floor, where it was given.
    pub fn height_m(&self) -> Option<f64> {
        self.height_is_given.then_some(self.position_m.z)
    }
}
