//! Who a robot is: published at start and after every change; the last one is kept for late joiners.

use std::f64::consts::{FRAC_PI_2, PI};

use bincode::{Decode, Encode};

use crate::codec::{Invalid, Kind, Message, Subject, bounded_decode, check};
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

/// Most bytes of a host name.
pub const MAX_HOST_LEN: usize = 64;
/// Most bytes of a version or a model's name.
pub const MAX_WORD_LEN: usize = 32;

impl Message for Announcement {
    const KIND: Kind = Kind::Announcement;

    fn validate(&self) -> Result<(), Invalid> {
        check::text("host", &self.host, MAX_HOST_LEN)?;
        check::text("version", &self.version, MAX_WORD_LEN)?;
        self.marker.validate()?;
        self.camera.validate()
    }

    fn subject(&self) -> Subject {
        Subject::Robot(self.robot)
    }

    bounded_decode!(Kind::Announcement);
}

impl CameraSummary {
    /// Whether everything is legal, as whoever receives it will ask.
    ///
    /// # Errors
    /// The first field that is not, its value and what would be right.
    pub fn validate(&self) -> Result<(), Invalid> {
        check::text("camera.model", &self.model, MAX_WORD_LEN)?;
        check::positive("camera.height_m", self.height_m, 10.0)?;
        check::in_range("camera.height_sigma_m", self.height_sigma_m, 0.0, 10.0)?;
        check::in_range("camera.tilt_sigma_rad", self.tilt_sigma_rad, 0.0, PI)?;
        let [lowest, highest] = self.elevation_rad;
        check::in_range("camera.elevation_rad", lowest, -FRAC_PI_2, FRAC_PI_2)?;
        check::in_range("camera.elevation_rad", highest, -FRAC_PI_2, FRAC_PI_2)?;
        check::consistent(lowest < highest, "camera.elevation_rad", "is empty")?;
        check::in_range("camera.frame_rate_hz", self.frame_rate_hz, 0.0, 1000.0)
    }
}
