//! Requests to an agent and their replies, by queryable.

use bincode::{Decode, Encode};

/// What an operator or a leader may ask of an agent.
#[derive(Debug, Clone, PartialEq, Encode, Decode)]
pub enum Command {
    /// Say who you are and how you are: answered by [`CommandReply::Status`].
    Status,
    /// Start the background anew.
    RestartBackground,
    /// Forget all tracks.
    ResetTracks,
    /// Work at most this many frames a second (0 < rate ≤ 120).
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
