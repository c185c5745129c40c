//! The agent as a state machine: frames, questions and time in; messages out. It knows no clock, no network, no runtime.
//!
//! ```text
//! frame ─▶ begin_frame ─▶ step: unwarp ─▶ step: change ─▶ step: regions ─▶ step: tracks ─▶ step: peers ─▶ step: publish
//!                          └────────── the caller may look at its clock, answer questions, or step on ──────────┘
//! ```
//! `handle(Input::Frame)` does all steps at once and, since its `now` stands still, leaves nothing out.

mod answers;
mod budget;
mod duties;
mod event;
mod pipeline;
mod readout;
mod settings;
mod surroundings;
mod team;
mod witness;

use protocol::message::{Alarm, AlarmKind, Announcement, CameraSummary, Edges, Observation, Stages};
use protocol::time::Timestamp;

pub use event::{Frame, Input, Output, PictureKind, Progress, Token};
pub use settings::AgentSettings;

use crate::optics::MountedCamera;
use crate::panorama::UnwarpError;
use crate::tracking::bodily::MarkedCell;
use budget::Budget;
use duties::Duties;
use pipeline::Pipeline;
use surroundings::Around;
use team::Team;

/// A frame whose capture time is further behind the last one than this means that the clock was set, not that it came late.
const CLOCK_SET_S: f64 = 1.0;
/// Most notices about frames that cannot be used; later ones are only counted.
const MAX_BAD_FRAME_NOTICES: u32 = 10;

/// Why an agent cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum AgentError {
    /// The camera does not say where it is.
    #[error("the camera's height above the floor is unknown; give [mounting] height_m in the camera file")]
    NoHeight,
    /// The camera is not one that a team can use: its announcement would be refused.
    #[error("no team can use this camera: {0}; [mounting] in the camera file says where it is")]
    Camera(#[from] protocol::codec::Invalid),
    /// The panorama cannot be made from this camera.
    #[error(transparent)]
    Panorama(#[from] crate::panorama::GeometryError),
    /// The motion stage cannot be made.
    #[error(transparent)]
    Motion(#[from] crate::motion::MotionError),
}

/// One robot's agent.
#[derive(Debug)]
pub struct Agent {
    settings: AgentSettings,
    epoch: u64,
    camera: CameraSummary,
    image_size_px: [u32; 2],
    pipeline: Pipeline,
    /// To be told at the start.
    problems: Vec<String>,
    team: Team,
    around: Around,
    duties: Duties,
    budget: Budget,
    work: Option<Work>,
    last_capture: Option<Timestamp>,
    max_frame_rate_hz: f64,
    paused: bool,
    observations: u32,
    alarms: u32,
    bad_frame_notices: u32,
}

/// The frame that is being worked on.
#[derive(Debug)]
struct Work {
    begun: Timestamp,
    capture: Timestamp,
}

impl Agent {
    /// An agent that has seen nothing. `epoch` tells this session from every other of the robot: draw it at random or from
    /// the clock at each start.
    pub fn new(settings: AgentSettings, camera: MountedCamera, epoch: u64) -> Result<Self, AgentError> {
        let summary = summary(&settings, &camera)?;
        let image_size_px = camera.image_size_px();
        let (pipeline, problems) = Pipeline::new(camera, &settings)?;
        Ok(Self {
            epoch,
            camera: summary,
            image_size_px,
            pipeline,
            problems,
            team: Team::new(settings.robot),
            around: Around::default(),
            duties: Duties::new(settings.frame_rate_hz),
            budget: Budget::new(settings.max_bytes_per_s),
            work: None,
            last_capture: None,
            max_frame_rate_hz: settings.max_frame_rate_hz,
            paused: false,
            observations: 0,
            alarms: 0,
            bad_frame_notices: 0,
            settings,
        })
    }

    /// Whose agent it is.
    pub fn robot(&self) -> protocol::id::RobotId {
        self.settings.robot
    }

    /// The session.
    pub fn epoch(&self) -> u64 {
        self.epoch
    }

    /// Works on one event, a frame as a whole. Outputs are appended in the order in which they should leave.
    /// `now` is the robot's clock.
    pub fn handle(&mut self, now: Timestamp, input: Input, out: &mut Vec<Output>) {
        let mut before = out.len();
        match input {
            Input::Frame(frame) => {
                if self.begin_frame(now, frame, out) {
                    while self.step(now, out) == Progress::More {}
                }
                // The last step has charged what it gave.
                before = out.len();
            }
            Input::BadFrame(what) => self.refuse_frame(format!("{what}; the frame is skipped"), out),
            Input::CaptureEnded => self.duties.capture_ended(),
            Input::Announcement(announcement) => self.meet(&announcement, out),
            Input::Surroundings(said) => self.around.take(now, self.epoch, said),
            Input::ClockProbe(token, probe) => out.push(self.answer_probe(now, token, probe)),
            Input::Command(token, command) => {
                let reply = self.obey(&command);
                out.push(Output::CommandReply(token, reply));
            }
            Input::Picture(token, kind) => out.push(Output::Picture(token, self.pipeline.picture(kind))),
            Input::Deadline => {}
        }
        self.do_duties(now, out);
        self.charge(now, &out[before..]);
    }

    fn charge(&mut self, now: Timestamp, outputs: &[Output]) {
        outputs.iter().for_each(|output| self.budget.charge(now, output));
    }

    /// When [`Input::Deadline`] is wanted at the latest. Earlier or repeated calls do no harm.
    pub fn next_deadline(&self) -> Timestamp {
        self.duties.next()
    }

    /// What of the last frame was marked, for learning to tell bodies from shadows (`sim-harness shadows`).
    pub fn marked_cells(&self) -> Vec<MarkedCell> {
        self.pipeline.marked_cells()
    }

    /// Columns of its panorama.
    pub fn panorama_width(&self) -> usize {
        self.pipeline.panorama_width()
    }

    /// Another picture of the camera's size as its panorama.
    ///
    /// # Errors
    /// A picture of another size.
    pub fn unwarped(&self, gray: &[u8]) -> Result<Vec<u8>, UnwarpError> {
        self.pipeline.unwarped(gray)
    }

    /// Takes a frame to work on in steps; `false` if it cannot be used (counted, and said in a notice) or is not wanted.
    /// A frame that is still being worked on is given up.
    pub fn begin_frame(&mut self, now: Timestamp, frame: Frame, out: &mut Vec<Output>) -> bool {
        self.work = None;
        self.duties.health.frames += 1;
        let [width, height] = self.image_size_px;
        let given = (frame.width, frame.height, frame.gray.len());
        if given != (width, height, width as usize * height as usize) {
            let [w, h] = [frame.width, frame.height];
            self.refuse_frame(
                format!("an image of {w}×{h} came, the camera file says image_size_px = [{width}, {height}]; the frame is skipped"),
                out,
            );
            return false;
        }
        if !self.is_in_order(frame.capture, out) {
            return false;
        }
        self.duties.frame_came(now);
        if !self.is_wanted(frame.capture) {
            self.duties.health.frames_dropped += 1;
            return false;
        }
        self.last_capture = Some(frame.capture);
        self.work = Some(Work { begun: now, capture: frame.capture });
        self.pipeline.expect(self.around.at(frame.capture));
        self.pipeline.begin(frame);
        true
    }

    /// Does the next stage of the frame, or leaves it out when the time budget is used up. The last step publishes.
    pub fn step(&mut self, now: Timestamp, out: &mut Vec<Output>) -> Progress {
        let Some(work) = &self.work else { return Progress::Done };
        let hurry = self.settings.budget_s.is_some_and(|budget| now.seconds_since(work.begun) > budget);
        if self.pipeline.step(hurry) == Progress::More {
            return Progress::More;
        }
        let capture = work.capture;
        let before = out.len();
        self.work = None;
        self.publish(now, capture, out);
        self.do_duties(now, out);
        self.charge(now, &out[before..]);
        Progress::Done
    }

    fn publish(&mut self, now: Timestamp, capture: Timestamp, out: &mut Vec<Output>) {
        let seen = self.pipeline.take_result();
        for kind in seen.events {
            let alarm = self.alarm(now, kind);
            out.push(Output::Alarm(alarm));
        }
        let skipped = Stages(seen.wanted.0 & !seen.stages.0).0.count_ones();
        self.duties.health.stages_skipped += u64::from(skipped);
        self.duties.frame_done(now.seconds_since(capture));
        if self.paused {
            return;
        }
        if let Some(edges) = seen.edges {
            out.push(Output::Edges(Edges { epoch: self.epoch, at: capture, edges }));
        }
        let observation = Observation {
            epoch: self.epoch,
            sequence: self.observations,
            capture,
            motion: seen.motion,
            odometry: None,
            stages: seen.stages,
            sightings: seen.sightings,
            tracks: seen.tracks,
        };
        // Only what is sent has a number: what the cap leaves out is no loss.
        if let Some(observation) = self.budget.shape(now, observation, out) {
            out.push(Output::Observation(observation));
            self.observations = self.observations.wrapping_add(1);
        }
    }

    fn is_in_order(&mut self, capture: Timestamp, out: &mut Vec<Output>) -> bool {
        let Some(last) = self.last_capture else { return true };
        let step_s = capture.seconds_since(last);
        if step_s < -CLOCK_SET_S {
            out.push(Output::Notice(format!(
                "capture times went back by {:.1} s (the clock was set?): tracks and background begin anew",
                -step_s
            )));
            self.pipeline.restart();
            return true;
        }
        if step_s <= 0.0 {
            self.refuse_frame(format!("a frame came {:.1} ms before the last one; it is skipped", -step_s * 1e3), out);
            return false;
        }
        true
    }

    /// Whether the greatest rate allows a frame; always where the clock was set back.
    fn is_wanted(&self, capture: Timestamp) -> bool {
        let Some(last) = self.last_capture else { return true };
        let step_s = capture.seconds_since(last);
        // A tenth of slack, so that a jittering camera of exactly the greatest rate loses nothing.
        step_s < 0.0 || step_s >= 0.9 / self.max_frame_rate_hz
    }

    fn refuse_frame(&mut self, what: String, out: &mut Vec<Output>) {
        self.duties.health.frames_bad += 1;
        self.bad_frame_notices += 1;
        match self.bad_frame_notices {
            ..MAX_BAD_FRAME_NOTICES => out.push(Output::Notice(what)),
            MAX_BAD_FRAME_NOTICES => out.push(Output::Notice(format!("{what}; further bad frames are only counted"))),
            _ => {}
        }
    }

    fn alarm(&mut self, at: Timestamp, kind: AlarmKind) -> Alarm {
        let number = self.alarms;
        self.alarms = self.alarms.wrapping_add(1);
        Alarm { robot: self.settings.robot, epoch: self.epoch, number, at, kind }
    }

    fn announcement(&self) -> Announcement {
        Announcement {
            robot: self.settings.robot,
            epoch: self.epoch,
            host: self.settings.host.clone(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            marker: self.settings.marker.clone(),
            camera: self.camera.clone(),
        }
    }

    fn meet(&mut self, announcement: &Announcement, out: &mut Vec<Output>) {
        if let Some(notice) = self.team.meet(self.epoch, &self.settings.host, announcement) {
            out.push(Output::Notice(notice));
        }
        out.extend(self.pipeline.look_for(self.team.looks()).into_iter().map(Output::Notice));
    }
}

fn summary(settings: &AgentSettings, camera: &MountedCamera) -> Result<CameraSummary, AgentError> {
    let mounting = camera.mounting();
    let [roll, pitch, _] = mounting.sigma.rotation_rpy_rad;
    mounting.height_m().ok_or(AgentError::NoHeight)?;
    let summary = CameraSummary {
        model: camera.camera().model().to_owned(),
        // Where the bearings come from: some millimetres above the lens's focus that the mounting measures.
        height_m: camera.viewpoint_body_m().z,
        height_sigma_m: mounting.sigma.position_m.z,
        tilt_sigma_rad: roll.max(pitch),
        elevation_rad: camera.camera().elevation_rad(),
        frame_rate_hz: settings.frame_rate_hz,
    };
    summary.validate()?;
    Ok(summary)
}

#[cfg(test)]
mod tests;
