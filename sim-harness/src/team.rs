//! Agents and a leader in one process, before a simulated world.
//!
//! ```text
//!  World ─▶ Renderer ─▶ picture ─▶ Agent ─▶ envelope ═ network ═▶ envelope ─▶ Leader ─▶ map
//!    │                                                                                   │
//!    └────────────────────────── truth ─────────────────────────────────▶ Scorer ◀───────┘
//! ```
//! Nothing of the world reaches an agent but its pictures with their capture times, its `camera.toml` and the marker it
//! wears; nothing reaches the leader but what agents publish. Two shells run the same agents and leader: [`simulated`] in
//! virtual time, where a seed fixes every byte, and [`live`] over Zenoh sessions on loopback in real time.

pub mod diagnosis;
pub mod frames;
pub mod live;
pub mod outcome;
pub mod output;
pub mod simulated;
pub mod truth;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use protocol::id::{LeaderId, NameError, RobotId, TeamId};
use robot_agent::agent::{AgentError, PictureKind};
use robot_agent::optics::{CameraFile, MountedCamera};

use crate::network::NetworkSettings;
use crate::scenario::{Scenario, ScenarioError};
use crate::world::{World, WorldError};

pub use outcome::Outcome;

/// Whatever it was, as a fault of the service.
pub(crate) fn failed(error: impl std::fmt::Display) -> TeamError {
    TeamError::Service(error.to_string())
}

/// A runtime that Zenoh's sessions work in.
pub(crate) fn runtime() -> Result<tokio::runtime::Runtime, TeamError> {
    let built = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build();
    built.map_err(|error| TeamError::Service(format!("no runtime: {error}")))
}

/// Why a team cannot run.
#[derive(Debug, thiserror::Error)]
pub enum TeamError {
    /// The scenario's file.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// Nothing fits the room.
    #[error(transparent)]
    World(#[from] WorldError),
    /// The scenario's camera.
    #[error("the scenario's camera cannot be used: {0}")]
    Camera(String),
    /// A camera file that is not of the robot's pictures.
    #[error(
        "--camera {robot}=…: a camera of {gw} × {gh} pixels, but {robot}'s pictures are {w} × {h} pixels; \
         a file with `image_size_px = [{w}, {h}]` would be right",
        gw = given_px[0], gh = given_px[1], w = picture_px[0], h = picture_px[1]
    )]
    CameraSize {
        /// Whose.
        robot: RobotId,
        /// Width and height in the file.
        given_px: [u32; 2],
        /// Width and height of the pictures.
        picture_px: [u32; 2],
    },
    /// A name.
    #[error(transparent)]
    Name(#[from] NameError),
    /// An agent refuses its settings.
    #[error(transparent)]
    Agent(#[from] AgentError),
    /// An option of the command line.
    #[error("{0}")]
    Usage(String),
    /// A message of our own could not be encoded.
    #[error("a message of {sender} cannot be encoded: {reason}")]
    Encode {
        /// Whose.
        sender: String,
        /// Why.
        reason: String,
    },
    /// A service over Zenoh failed.
    #[error("{0}")]
    Service(String),
    /// A recording cannot be read.
    #[error("{file}: {reason}", file = file.display())]
    Recording {
        /// Which, with the line where there is one.
        file: PathBuf,
        /// Why, and what would be right.
        reason: String,
    },
    /// Results cannot be written.
    #[error("{path}: {source}", path = path.display())]
    Output {
        /// Where.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
}

/// How a team runs, beside its scenario and seed.
#[derive(Debug, Clone, Default)]
pub struct TeamSettings {
    /// Ends before the scenario does, seconds.
    pub duration_s: Option<f64>,
    /// Other names for the robots, in the order of the world.
    pub names: Option<Vec<RobotId>>,
    /// Links of a simulated network.
    pub network: NetworkSettings,
    /// Text of the camera files that some robots (as the world names them) get instead of the scenario's.
    pub cameras: BTreeMap<RobotId, String>,
    /// Nobody listens to a team over Zenoh and nobody asks for pictures: only robots and leader speak, and the outcome has bytes alone.
    pub unwatched: bool,
    /// A folder in which rendered pictures are kept from run to run; in virtual time.
    pub pictures: Option<PathBuf>,
}

impl TeamSettings {
    fn duration_s(&self, world: &World) -> f64 {
        self.duration_s.unwrap_or(f64::INFINITY).min(world.duration_s())
    }

    fn names(&self, world: &World) -> Vec<RobotId> {
        let own = world.robots().iter().map(|r| r.id);
        match &self.names {
            Some(names) => names.iter().copied().chain(own.skip(names.len())).take(world.robots().len()).collect(),
            None => own.collect(),
        }
    }
}

/// What is asked of every agent at the end.
const PICTURES: [PictureKind; 3] = [PictureKind::Panorama, PictureKind::Objects, PictureKind::Tracks];

/// Name of the team in the process.
fn team_id() -> Result<TeamId, NameError> {
    TeamId::new("sim")
}

/// Name of its leader.
pub(crate) fn leader_id() -> Result<LeaderId, NameError> {
    LeaderId::new("leader")
}

/// A robot's camera as its agent reads it, from the text of `camera.toml`. `robot` as the world names it.
fn camera(scenario: &Scenario, settings: &TeamSettings, robot: &RobotId) -> Result<MountedCamera, TeamError> {
    let text = settings.cameras.get(robot).cloned().unwrap_or_else(|| scenario.camera_toml_of(robot));
    let camera = CameraFile::parse(&text, Path::new(&format!("camera.toml of {robot}")))
        .and_then(|file| file.mount())
        .map_err(|e| TeamError::Camera(e.to_string()))?;
    let (given_px, picture_px) = (camera.image_size_px(), scenario.camera.image_size_of(robot));
    if given_px != picture_px {
        return Err(TeamError::CameraSize { robot: *robot, given_px, picture_px });
    }
    Ok(camera)
}

/// Whether every robot's camera can be used, before anything is rendered for it.
fn check_cameras(scenario: &Scenario, settings: &TeamSettings) -> Result<(), TeamError> {
    scenario.robot_ids().iter().try_for_each(|robot| camera(scenario, settings, robot).map(drop))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_file_of_another_size_is_refused_with_both_sizes() {
        let scenario = Scenario::builtin("tiny").unwrap().unwrap();
        let large = crate::scenario::CameraSpec::default().toml();
        let cameras = [(scenario.robot_ids()[0], large)].into();
        let settings = TeamSettings { cameras, ..TeamSettings::default() };
        let error = simulated::run(&scenario, 0, &settings, &|_| panic!("time began")).unwrap_err().to_string();
        assert!(error.contains("r1") && error.contains("768 × 576") && error.contains("384 × 288"), "{error}");
        assert!(check_cameras(&scenario, &TeamSettings::default()).is_ok());
    }
}
