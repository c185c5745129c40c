//! The agent as a state machine: frames, questions and time in; messages out. It knows no clock, no network, no runtime.

use protocol::message::{Alarm, Announcement, ClockProbe, ClockReply, Command, CommandReply, Health, Observation};
use protocol::time::Timestamp;

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
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Token(pub u64);

/// Everything that happens to an agent.
#[derive(Debug, Clone)]
pub enum Input {
    /// A picture.
    Frame(Frame),
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
    Health(Health),
    /// Reply. The shell sets `replied` at the last moment.
    ClockReply(Token, ClockReply),
    /// Reply.
    CommandReply(Token, CommandReply),
    /// Reply with an encoded picture (PNG or JPEG), or say why not.
    Picture(Token, Result<Vec<u8>, String>),
}

/// Pictures for people.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum PictureKind {
    /// Panorama with boxes, identities, bearings.
    Panorama,
    /// The object image: moving pixels only.
    Objects,
    /// Virtual gaze windows on each object.
    Gaze,
    /// One picture of the recent past.
    Synopsis,
    /// Track image.
    Tracks,
    /// The background.
    Background,
}
