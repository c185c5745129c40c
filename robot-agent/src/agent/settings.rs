//! What an agent is told at its start.

use protocol::id::RobotId;
use protocol::marker::Marker;

use crate::motion::MotionSettings;
use crate::optics::MountedCamera;
use crate::panorama::{GeometryError, PanoramaGeometry};
use crate::tracking::TrackerSettings;

/// Settings of the pure agent. [`AgentSettings::new`] gives the defaults of everything but the name and the marker.
#[derive(Debug, Clone)]
pub struct AgentSettings {
    /// Who the robot is.
    pub robot: RobotId,
    /// What the others see of it, as announced.
    pub marker: Marker,
    /// Name of the host, for people, at most 64 bytes.
    pub host: String,
    /// Columns of the panorama over 360°; `None`: as many as suit the camera (1080 for the reference camera).
    pub panorama_columns: Option<u32>,
    /// Nominal frames a second, as announced.
    pub frame_rate_hz: f64,
    /// Frames a second that are worked on at most, in (0, 120]; others are dropped and counted.
    pub max_frame_rate_hz: f64,
    /// Time for one frame, seconds, by which [`Agent::step`](super::Agent::step) leaves out stages; `None`: all run.
    pub budget_s: Option<f64>,
    /// Bytes a second on the wire that the agent keeps to, by leaving out observations, then tracks; `None`: no cap.
    pub max_bytes_per_s: Option<f64>,
    /// Change, background, regions.
    pub motion: MotionSettings,
    /// Tracks.
    pub tracking: TrackerSettings,
}

impl AgentSettings {
    /// Defaults: the panorama that suits the camera, 10 Hz, no budget.
    pub fn new(robot: RobotId, marker: Marker) -> Self {
        Self {
            robot,
            marker,
            host: "unknown".to_owned(),
            panorama_columns: None,
            frame_rate_hz: 10.0,
            max_frame_rate_hz: 120.0,
            budget_s: None,
            max_bytes_per_s: None,
            motion: MotionSettings::default(),
            tracking: TrackerSettings::default(),
        }
    }

    /// The panorama that `camera` is unwarped to.
    pub(super) fn panorama(&self, camera: &MountedCamera) -> Result<PanoramaGeometry, GeometryError> {
        let suited = PanoramaGeometry::for_work(camera)?;
        let Some(columns) = self.panorama_columns else { return Ok(suited) };
        let rows = u64::from(suited.height()) * u64::from(columns) / u64::from(suited.width());
        PanoramaGeometry::new(columns, (rows as u32).max(2), suited.projection(), suited.elevation_rad())
    }
}
