//! Cameras other than the PAL: robots that look one way, and robots whose camera turns.

use protocol::id::RobotId;
use serde::{Deserialize, Serialize};

use super::CameraSpec;

/// A robot that has another camera than the rest.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OtherCamera {
    /// Whose, e.g. "r2".
    pub robot: RobotId,
    /// Which.
    pub camera: EyeSpec,
}

/// A camera at the height of the others: `kind` selects.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum EyeSpec {
    /// Looks straight ahead.
    Pinhole {
        /// Width, height.
        image_size_px: [u32; 2],
        /// Seen from left to right, degrees.
        field_deg: f64,
    },
    /// A slit camera that turns clockwise about the robot's axis, seen from above, and begins behind it. A picture is one turn;
    /// its columns are seen one after the other, and its capture time is that of its middle, straight ahead.
    Rotating {
        /// Columns of a turn, rows.
        image_size_px: [u32; 2],
        /// A turn, and so the time from picture to picture, seconds.
        turn_s: f64,
        /// Lowest and highest direction, at the picture's lower and upper border.
        elevation_deg: [f64; 2],
    },
}

impl CameraSpec {
    /// The camera of a robot that has no PAL.
    pub fn other(&self, robot: &RobotId) -> Option<EyeSpec> {
        self.others.iter().find(|o| o.robot == *robot).map(|o| o.camera)
    }

    /// The size of a robot's pictures.
    pub fn image_size_of(&self, robot: &RobotId) -> [u32; 2] {
        match self.other(robot) {
            Some(EyeSpec::Pinhole { image_size_px, .. } | EyeSpec::Rotating { image_size_px, .. }) => image_size_px,
            None => self.image_size_px,
        }
    }
}

impl EyeSpec {
    /// Half of what a camera sees that looks one way, radians; `None` for one that looks all round.
    pub fn half_field_rad(&self) -> Option<f64> {
        match self {
            Self::Pinhole { field_deg, .. } => Some(0.5 * field_deg.to_radians()),
            Self::Rotating { .. } => None,
        }
    }

    /// Time of a turn, seconds.
    pub fn turn_s(&self) -> Option<f64> {
        match self {
            Self::Rotating { turn_s, .. } => Some(*turn_s),
            Self::Pinhole { .. } => None,
        }
    }

    /// Pixels of a slope of 1 (and, in the middle of a pinhole's picture, of a radian).
    pub fn focal_length_px(&self) -> f64 {
        match self {
            Self::Pinhole { image_size_px: [width, _], field_deg } => {
                0.5 * f64::from(*width) / (0.5 * field_deg.to_radians()).tan()
            }
            Self::Rotating { image_size_px: [_, height], elevation_deg: [low, high], .. } => {
                f64::from(*height) / (high.to_radians().tan() - low.to_radians().tan())
            }
        }
    }

    /// Row of the horizon.
    pub fn horizon_px(&self) -> f64 {
        match self {
            Self::Pinhole { image_size_px: [_, height], .. } => 0.5 * (f64::from(*height) - 1.0),
            Self::Rotating { elevation_deg: [_, high], .. } => self.focal_length_px() * high.to_radians().tan() - 0.5,
        }
    }

    /// As a robot's `camera.toml`.
    pub fn toml(&self, height_m: f64) -> String {
        let (f, horizon) = (self.focal_length_px(), self.horizon_px());
        match self {
            Self::Pinhole { image_size_px: [w, h], .. } => format!(
                "model = \"pinhole\"\nimage_size_px = [{w}, {h}]\n[pinhole]\nfocal_length_px = [{f:?}, {f:?}]\n\
                 centre_px = [{:?}, {horizon:?}]\n[mounting]\nheight_m = {height_m:?}\n",
                0.5 * (f64::from(*w) - 1.0),
            ),
            Self::Rotating { image_size_px: [w, h], turn_s, .. } => format!(
                "model = \"mosaic\"\nimage_size_px = [{w}, {h}]\n[mosaic]\nfocal_length_px = {f:?}\nhorizon_px = {horizon:?}\n\
                 turn_s = {turn_s:?}\n[mounting]\nheight_m = {height_m:?}\n",
            ),
        }
    }
}
