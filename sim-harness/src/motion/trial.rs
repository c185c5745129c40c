//! One run of a case: frames are rendered and worked by the agent, truth is kept beside what it said.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use protocol::frames::Pose2;
use protocol::message::{AlarmKind, Motion, Stages, TrackObservation};
use robot_agent::agent::{Agent, AgentError, AgentSettings, Frame, Input, Output};
use robot_agent::optics::CameraFile;
use robot_agent::tracking::TrackerSettings;

use super::Case;
use crate::render::Renderer;
use crate::scenario::Scenario;
use crate::world::{PersonState, Robot, RobotState, World, WorldError};

/// Why there is no trial.
#[derive(Debug, thiserror::Error)]
pub enum TrialError {
    /// Its world.
    #[error("{case} with seed {seed}: {source}")]
    World {
        /// Which.
        case: &'static str,
        /// Which.
        seed: u64,
        /// Why.
        source: WorldError,
    },
    /// The agent does not take the camera.
    #[error("the scenario's camera: {0}")]
    Camera(String),
    /// The agent.
    #[error(transparent)]
    Agent(#[from] AgentError),
    /// The folder of pictures.
    #[error("{}: {source}", folder.display())]
    Pictures {
        /// Which.
        folder: PathBuf,
        /// Why.
        source: std::io::Error,
    },
}

/// A person as the robot should see it.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct SeenTruth {
    /// To the axis through the body's centroid, body frame.
    pub bearing_rad: f64,
    /// To that axis along the floor.
    pub range_m: f64,
    /// Standing.
    pub height_m: f64,
    /// Of the body's outline, lowest first, from the camera's place.
    pub elevation_rad: [f64; 2],
    /// Unhidden share of it within the field of view.
    pub visible_fraction: f64,
}

/// One frame: truth and what the agent said.
#[derive(Debug, Clone)]
pub struct Instant {
    /// True time.
    pub time_s: f64,
    /// Whether the robot truly moves, and how fast it turns, radians a second.
    pub turn_rate: f64,
    /// Its people.
    pub people: Vec<SeenTruth>,
    /// What the agent says of itself.
    pub motion: Motion,
    /// Whether there was a background to compare with.
    pub ready: bool,
    /// Its tracks.
    pub tracks: Vec<TrackObservation>,
    /// Its alarms.
    pub alarms: Vec<AlarmKind>,
}

/// A run.
#[derive(Debug)]
pub struct Trial {
    /// What happened.
    pub case: Case,
    /// How.
    pub seed: u64,
    /// Written out.
    pub scenario: Scenario,
    /// A frame each.
    pub instants: Vec<Instant>,
}

/// Renders and works the frames of a case; `pictures` is a folder in which rendered ones are kept.
///
/// # Errors
/// A world that cannot be, an agent that does not take its camera, or a folder that cannot be used.
pub fn run(case: Case, seed: u64, pictures: Option<&Path>) -> Result<Trial, TrialError> {
    run_scenario(case, seed, case.scenario(seed), pictures)
}

/// The same of a scenario of the case that was changed.
///
/// # Errors
/// See [`run`].
pub fn run_scenario(case: Case, seed: u64, scenario: Scenario, pictures: Option<&Path>) -> Result<Trial, TrialError> {
    let world = World::new(&scenario, seed).map_err(|source| TrialError::World { case: case.name(), seed, source })?;
    let world = Arc::new(world);
    let robot = &world.robots()[0];
    let mut agent = agent_of(&scenario, robot, TrackerSettings::default())?;
    let mut renderer = Renderer::team(&world).remove(0);
    if let Some(folder) = pictures {
        let kept = renderer.keep_in(folder, &scenario);
        kept.map_err(|source| TrialError::Pictures { folder: folder.to_owned(), source })?;
    }
    let mut instants = Vec::new();
    let mut out = Vec::new();
    for capture in &robot.captures {
        let picture = renderer.render(capture.true_time_s);
        let state = world.at(capture.true_time_s);
        let frame = Frame { capture: capture.stamp, width: picture.width, height: picture.height, gray: picture.gray };
        agent.handle(capture.stamp, Input::Frame(frame), &mut out);
        let mut instant = Instant {
            time_s: capture.true_time_s,
            turn_rate: turn_rate(&world, capture.true_time_s),
            people: state
                .people
                .iter()
                .zip(&picture.visible_fraction)
                .map(|(person, seen)| truth(&world, &state.robots[0], person, *seen))
                .collect(),
            motion: Motion::Unknown,
            ready: false,
            tracks: Vec::new(),
            alarms: Vec::new(),
        };
        for output in out.drain(..) {
            match output {
                Output::Observation(o) => {
                    instant.motion = o.motion;
                    instant.ready = o.stages.ran(Stages::TRACKING);
                    instant.tracks = o.tracks;
                }
                Output::Alarm(alarm) => instant.alarms.push(alarm.kind),
                _ => {}
            }
        }
        instants.push(instant);
    }
    Ok(Trial { case, seed, scenario, instants })
}

/// The agent of a robot of a scenario, which follows people in some way.
///
/// # Errors
/// A camera that it does not take.
pub fn agent_of(scenario: &Scenario, robot: &Robot, tracking: TrackerSettings) -> Result<Agent, TrialError> {
    let text = scenario.camera_toml_of(&robot.id);
    let camera = CameraFile::parse(&text, Path::new("the scenario's camera"))
        .and_then(|file| file.mount())
        .map_err(|e| TrialError::Camera(e.to_string()))?;
    let mut settings = AgentSettings::new(robot.id, scenario.marker_of(&robot.id));
    settings.frame_rate_hz = scenario.capture.rate_hz;
    settings.tracking = tracking;
    Ok(Agent::new(settings, camera, 1)?)
}

fn turn_rate(world: &World, time_s: f64) -> f64 {
    const STEP_S: f64 = 0.01;
    let heading = |t: f64| world.at(t).robots[0].heading_rad;
    (heading(time_s + STEP_S) - heading(time_s - STEP_S)) / (2.0 * STEP_S)
}

fn truth(world: &World, robot: &RobotState, person: &PersonState, visible_fraction: f64) -> SeenTruth {
    let pose = Pose2::new(robot.x_m, robot.y_m, robot.heading_rad);
    let at = nalgebra::Vector2::new(person.x_m, person.y_m);
    let camera_m = world.camera().height_m;
    // A ball's outline is its middle's elevation and half its apparent size.
    let mut elevation_rad = [f64::INFINITY, f64::NEG_INFINITY];
    for capsule in world.capsules(person) {
        for end in [capsule.a, capsule.b] {
            let [x, y, z] = [end.x, end.y, end.z].map(f64::from);
            let flat = (x - robot.x_m).hypot(y - robot.y_m);
            let (middle, distance) = ((z - camera_m).atan2(flat), flat.hypot(z - camera_m));
            let half = (f64::from(capsule.radius) / distance).min(1.0).asin();
            elevation_rad = [elevation_rad[0].min(middle - half), elevation_rad[1].max(middle + half)];
        }
    }
    SeenTruth {
        bearing_rad: pose.bearing_to(at),
        range_m: (at - pose.position()).norm(),
        height_m: person.height_m,
        elevation_rad,
        visible_fraction,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::{Tally, verdict};

    /// With a quarter of the pixels, for speed.
    fn small(case: Case, seed: u64) -> Tally {
        let mut scenario = case.scenario(seed);
        scenario.camera = scenario.camera.halved();
        Tally::of(&run_scenario(case, seed, scenario, None).unwrap())
    }

    #[test]
    #[ignore = "renders 240 frames: half a minute of work"]
    fn a_switched_light_is_an_alarm_in_the_frame_and_tracking_is_back_soon() {
        let tally = small(Case::Light, 1);
        assert_eq!(tally.alarm_after.len(), 2);
        for claim in verdict::claims(Case::Light, &tally) {
            assert!(claim.kept, "{claim:?}");
        }
        assert!(tally.coverage() > Some(0.95), "{:?}", tally.coverage());
    }

    #[test]
    #[ignore = "renders 240 frames: half a minute of work"]
    fn somebody_who_walks_about_keeps_his_name() {
        let tally = small(Case::Stroll, 1);
        assert_eq!((tally.switches, tally.false_alarms), (0, 0));
        assert!(tally.coverage() > Some(0.95), "{:?}", tally.coverage());
    }
}
