//! Requests to an agent and their replies, by queryable.

use bincode::{Decode, Encode};

use crate::codec::{Invalid, Kind, Message, bounded_decode, check};
/// What an operator or a leader may ask of an agent.
#[derive(Debug, Clone, PartialEq, Encode, Decode)]
pub enum Command {
    /// Say who you are and how you are: answered by [`CommandReply::Status`].
    Status,
    /// Start the background anew.
    RestartBackground,
    /// Forget all tracks.
    ResetTracks,
    /// Work at most this many frames a second (1/64 to 120).
    SetFrameRate(f32),
    /// Stop publishing observations until resumed.
    Pause,
    /// Go on.
    Resume,
}

/// The answer.
#[derive(Debug, Clone, PartialEq, Encode, Decode)]
pub enum CommandReply {
    /// Done.
    Done,
    /// Not done, and why (≤ 256 bytes).
    Refused(String),
    /// To [`Command::Status`].
    Status {
        /// The session.
        epoch: u64,
        /// Frames worked on.
        frames: u64,
        /// Whether the background is ready.
        background_ready: bool,
        /// Whether publishing is paused.
        paused: bool,
        /// Tracks followed now.
        tracks: u32,
        /// Peers seen in the last frame.
        peers: u32,
    },
}

/// Slowest rate that may be asked for: a frame in 64 s. Exact in binary, so that it is written as it is.
pub const MIN_FRAME_RATE_HZ: f32 = 0.015_625;
/// Fastest rate that may be asked for.
pub const MAX_FRAME_RATE_HZ: f32 = 120.0;
/// Most bytes of a refusal's reason.
pub const MAX_REFUSAL_LEN: usize = 256;

impl Message for Command {
    const KIND: Kind = Kind::Command;

    fn validate(&self) -> Result<(), Invalid> {
        match self {
            Self::SetFrameRate(rate_hz) => {
                check::in_range("rate_hz", *rate_hz, MIN_FRAME_RATE_HZ.into(), MAX_FRAME_RATE_HZ.into())
            }
            _ => Ok(()),
        }
    }

    bounded_decode!(Kind::Command);
}

impl Message for CommandReply {
    const KIND: Kind = Kind::CommandReply;

    fn validate(&self) -> Result<(), Invalid> {
        match self {
            Self::Refused(why) => check::text("why", why, MAX_REFUSAL_LEN),
            _ => Ok(()),
        }
    }

    bounded_decode!(Kind::CommandReply);
}
