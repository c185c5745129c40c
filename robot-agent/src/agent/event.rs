//! What happens to an agent, and what it does.

use protocol::message::{
    Alarm, Announcement, ClockProbe, ClockReply, Command, CommandReply, Edges, Health, Observation, Surroundings,
};
use protocol::time::Timestamp;

pub use protocol::message::PictureKind;

/// One gray picture with its capture time.
#[derive(Debug, Clone)]
pub struct Frame {
    /// Mid-exposure, on the robot's own clock.
    pub capture: Timestamp,
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width · height` gray values, row by row.
    pub gray: Vec<u8>,
}

/// Ties an answer to its question; chosen by the shell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Token(pub u64);

/// Everything that happens to an agent.
#[derive(Debug, Clone)]
pub enum Input {
    /// A picture.
    Frame(Frame),
    /// A picture that could not be read: which, and why.
    BadFrame(String),
    /// There will be no more frames, and that is all right (the end of a recording).
    CaptureEnded,
    /// A robot of the team says who it is and what it looks like. One's own comes back and is ignored.
    Announcement(Box<Announcement>),
    /// A leader says who is round the robot.
    Surroundings(Surroundings),
    /// A leader probes the clock; `now` of the call is the time of arrival.
    ClockProbe(Token, ClockProbe),
    /// Somebody asks something.
    Command(Token, Command),
    /// Somebody wants a picture.
    Picture(Token, PictureKind),
    /// `next_deadline` has come.
    Deadline,
}

/// Everything an agent does.
#[derive(Debug, Clone)]
pub enum Output {
    /// Publish.
    Announcement(Announcement),
    /// Publish.
    Observation(Observation),
    /// Publish.
    Alarm(Alarm),
    /// Publish.
    Edges(Edges),
    /// Publish. The shell adds what only it knows: messages dropped and refused, traffic, frames that it dropped itself.
    Health(Health),
    /// Reply. The shell sets `replied` at the last moment.
    ClockReply(Token, ClockReply),
    /// Reply.
    CommandReply(Token, CommandReply),
    /// Reply with an encoded picture (PNG or JPEG), or say why not.
    Picture(Token, Result<Vec<u8>, String>),
    /// Tell people; the agent limits how often it repeats itself.
    Notice(String),
}

/// Whether a frame needs more steps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Progress {
    /// Call again.
    More,
    /// The frame is done, or there is none.
    Done,
}
