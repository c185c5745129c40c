//! Who a robot is: published at start and after every change; the last one is kept for late joiners.

use bincode::{Decode, Encode};

use crate::id::RobotId;
use crate::marker::Marker;

/// Who I am, what I wear, my camera in one line, my version.
#[derive(Debug, Clone, PartialEq, Encode, Decode)]
pub struct Announcement {
    /// Whose.
    pub robot: RobotId,
    /// The session: a random or clock-derived number drawn at the agent's start. Observations carry it too, so that a
    /// restarted agent confuses nobody.
    pub epoch: u64,
    /// Host name, for people (≤ 64 bytes).
    pub host: String,
    /// Version of the program (≤ 32 bytes).
    pub version: String,
    /// What the others see of this robot.
    pub marker: Marker,
    /// The camera in one line.
    pub camera: CameraSummary,
}

/// What the leader needs to know of a camera: never its model, only what its bearings mean.
#[derive(Debug, Clone, PartialEq, Encode, Decode)]
pub struct CameraSummary {
    /// The model's name as in `camera.toml` (≤ 32 bytes).
    pub model: String,
    /// Viewpoint above the floor, metres, in (0, 10].
    pub height_m: f64,
    /// Its standard deviation, metres.
    pub height_sigma_m: f64,
    /// Standard deviation of the tilt that remains unknown, radians: it is common to all elevations of the robot.
    pub tilt_sigma_rad: f64,
    /// Field of view in elevation [lowest, highest], radians.
    pub elevation_rad: [f64; 2],
    /// Nominal frames a second.
    pub frame_rate_hz: f64,
}
