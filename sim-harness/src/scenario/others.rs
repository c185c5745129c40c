//! Cameras other than the PAL: robots that look one way, robots whose camera turns, and every camera of the zoo.

use protocol::id::RobotId;
use serde::{Deserialize, Serialize};

use super::CameraSpec;
use crate::zoo::Animal;

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
    /// One of the zoo, upright and all round.
    Zoo {
        /// Which, by its name on the zoo's sheet.
        specimen: Animal,
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
            Some(eye) => eye.image_size_px(),
            None => self.image_size_px,
        }
    }
}

impl EyeSpec {
    /// Width and height of its pictures.
    pub fn image_size_px(&self) -> [u32; 2] {
        match self {
            Self::Pinhole { image_size_px, .. } | Self::Rotating { image_size_px, .. } => *image_size_px,
            Self::Zoo { specimen } => specimen.specimen().size_px,
        }
    }

    /// Half of what a camera sees that looks one way, radians; `None` for one that looks all round.
    pub fn half_field_rad(&self) -> Option<f64> {
        match self {
            Self::Pinhole { field_deg, .. } => Some(0.5 * field_deg.to_radians()),
            Self::Rotating { .. } | Self::Zoo { .. } => None,
        }
    }

    /// Time of a turn, seconds.
    pub fn turn_s(&self) -> Option<f64> {
        match self {
            Self::Rotating { turn_s, .. } => Some(*turn_s),
            Self::Pinhole { .. } | Self::Zoo { .. } => None,
        }
    }

    /// Pixels of a slope of 1 (and, in the middle of a pinhole's picture, of a radian), and the row of the horizon; `None` for a
    /// camera whose rows are no slopes.
    pub fn slopes(&self) -> Option<Slopes> {
        let (focal_length_px, horizon_px) = match self {
            Self::Pinhole { image_size_px: [width, height], field_deg } => {
                (0.5 * f64::from(*width) / (0.5 * field_deg.to_radians()).tan(), 0.5 * (f64::from(*height) - 1.0))
            }
            Self::Rotating { image_size_px: [_, height], elevation_deg, .. } => {
                let [low, high] = elevation_deg.map(|e| e.to_radians().tan());
                let f = f64::from(*height) / (high - low);
                (f, f * high - 0.5)
            }
            Self::Zoo { .. } => return None,
        };
        Some(Slopes { focal_length_px, horizon_px })
    }

    /// As a robot's `camera.toml`.
    pub fn toml(&self, height_m: f64) -> String {
        let [w, h] = self.image_size_px();
        let Slopes { focal_length_px: f, horizon_px: horizon } = self.slopes().unwrap_or_default();
        match self {
            Self::Pinhole { .. } => format!(
                "model = \"pinhole\"\nimage_size_px = [{w}, {h}]\n[pinhole]\nfocal_length_px = [{f:?}, {f:?}]\n\
                 centre_px = [{:?}, {horizon:?}]\n[mounting]\nheight_m = {height_m:?}\n",
                0.5 * (f64::from(w) - 1.0),
            ),
            Self::Rotating { turn_s, .. } => format!(
                "model = \"mosaic\"\nimage_size_px = [{w}, {h}]\n[mosaic]\nfocal_length_px = {f:?}\nhorizon_px = {horizon:?}\n\
                 turn_s = {turn_s:?}\n[mounting]\nheight_m = {height_m:?}\n",
            ),
            Self::Zoo { specimen } => specimen.specimen().camera_toml(height_m),
        }
    }
}

/// A picture whose rows are slopes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Slopes {
    /// Pixels of a slope of 1.
    pub focal_length_px: f64,
    /// Row of the horizon.
    pub horizon_px: f64,
}
