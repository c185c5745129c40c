//! The versioned envelope round every message, and the only place that knows bincode.
//!
//! ```text
//!  0      1      2         3      4
//! +------+------+---------+------+----------------------- … -+
//! | 0x50 | 0xA1 | version | kind | body: bincode 2, standard |
//! +------+------+---------+------+----------------------- … -+
//! ```
//!
//! Problem: bytes come from a network. They may be cut, stretched, mutated, from another version, or hostile.
//!
//! Insight: bincode alone trusts the lengths it reads (twelve bytes can ask for terabytes and abort the process), accepts
//! trailing bytes and any float. So each kind has a byte limit that is checked before decoding, decoding claims every
//! allocation beforehand against [`ALLOCATION_FACTOR`] times that limit, all bytes must be used, and the values are
//! validated: finite, in range, counted. Encoding validates too, so no program of ours sends what another one refuses.
//!
//! A program reads its own wire version and the one before. Adding a field makes a new version: raise [`WIRE_VERSION`],
//! and give the changed message a `decode_previous`.

mod error;

pub use error::{DecodeError, EncodeError, Invalid};
pub(crate) mod check;
#[cfg(test)]
mod tests;

use bincode::{Decode, Encode};

use crate::id::{LeaderId, RobotId};

/// First two bytes of every envelope: `P` and no text in any encoding of today.
pub const MAGIC: [u8; 2] = [0x50, 0xA1];
/// The version that this program writes.
pub const WIRE_VERSION: u8 = 1;
/// The oldest version that this program reads: the one before its own, where there is one.
pub const OLDEST_VERSION: u8 = if WIRE_VERSION > 1 { WIRE_VERSION - 1 } else { WIRE_VERSION };
/// Bytes of the envelope before the body.
pub const HEADER_LEN: usize = 4;
/// Decoding a message never allocates more than this many times its kind's [`Kind::max_bytes`]: a value in memory is
/// larger than on the wire, at most so much in any message that is accepted.
pub const ALLOCATION_FACTOR: usize = 4;

/// What an envelope holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Kind {
    /// [`crate::message::Announcement`].
    Announcement = 1,
    /// [`crate::message::Observation`].
    Observation = 2,
    /// [`crate::message::Alarm`].
    Alarm = 3,
    /// [`crate::message::Health`].
    Health = 4,
    /// [`crate::message::Command`].
    Command = 5,
    /// [`crate::message::CommandReply`].
    CommandReply = 6,
    /// [`crate::message::ClockProbe`].
    ClockProbe = 7,
    /// [`crate::message::ClockReply`].
    ClockReply = 8,
    /// [`crate::message::TeamMap`].
    TeamMap = 9,
    /// [`crate::message::Guidance`].
    Guidance = 10,
    /// A picture for people: travels as plain PNG or JPEG, without an envelope, so that any tool can show it.
    Picture = 11,
    /// The map as JSON: travels as plain text, without an envelope.
    MapJson = 12,
    /// [`crate::message::ReplayStart`].
    ReplayStart = 13,
    /// [`crate::message::Candidacy`].
    Candidacy = 14,
    /// [`crate::message::Recent`].
    Recent = 15,
    /// [`crate::message::Surroundings`].
    Surroundings = 16,
    /// [`crate::message::Edges`].
    Edges = 17,
}

impl Kind {
    /// All kinds, in the order of their numbers.
    pub const ALL: [Self; 17] = [
        Self::Announcement,
        Self::Observation,
        Self::Alarm,
        Self::Health,
        Self::Command,
        Self::CommandReply,
        Self::ClockProbe,
        Self::ClockReply,
        Self::TeamMap,
        Self::Guidance,
        Self::Picture,
        Self::MapJson,
        Self::ReplayStart,
        Self::Candidacy,
        Self::Recent,
        Self::Surroundings,
        Self::Edges,
    ];

    /// The kind of that number.
    pub fn from_u8(number: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| *kind as u8 == number)
    }

    /// A word for logs and tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Announcement => "announcement",
            Self::Observation => "observation",
            Self::Alarm => "alarm",
            Self::Health => "health",
            Self::Command => "command",
            Self::CommandReply => "command reply",
            Self::ClockProbe => "clock probe",
            Self::ClockReply => "clock reply",
            Self::TeamMap => "map",
            Self::Guidance => "guidance",
            Self::Picture => "picture",
            Self::MapJson => "map as JSON",
            Self::ReplayStart => "replay start",
            Self::Candidacy => "candidacy",
            Self::Recent => "recent observations",
            Self::Surroundings => "surroundings",
            Self::Edges => "edges",
        }
    }

    /// Most bytes of an envelope (or plain payload) of this kind: what the message's own limits on counts and texts need,
    /// rounded up. A map of more than some 250 robots or 1000 targets with all their Jacobians does not fit.
    pub const fn max_bytes(self) -> usize {
        match self {
            Self::Announcement | Self::Health => 4 << 10,
            Self::Observation | Self::Recent => 16 << 10,
            Self::Alarm => 512,
            Self::Command | Self::Guidance => 256,
            Self::CommandReply | Self::Surroundings | Self::Edges => 1 << 10,
            Self::ClockProbe | Self::ClockReply | Self::ReplayStart | Self::Candidacy => 64,
            Self::TeamMap | Self::Picture => 4 << 20,
            Self::MapJson => 16 << 20,
        }
    }
}

impl std::fmt::Display for Kind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(self.name())
    }
}

/// Who a message says it is from or for. Receivers compare it with the key it came on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Subject {
    /// The message names nobody.
    Nobody,
    /// A robot.
    Robot(RobotId),
    /// A leader.
    Leader(LeaderId),
}

/// A message that travels in an envelope. Implemented by `crate::message::*` only.
pub trait Message: Encode + Decode<()> + Clone + std::fmt::Debug + Send + Sync + 'static {
    /// Its number in the envelope.
    const KIND: Kind;

    /// Whether all values are legal: finite, in range, counted. The first that is not is named.
    fn validate(&self) -> Result<(), Invalid>;

    /// Whom it names.
    fn subject(&self) -> Subject {
        Subject::Nobody
    }

    /// Decodes a body of the current version under the kind's allocation limit; also gives the bytes used.
    #[doc(hidden)]
    fn decode_body(body: &[u8]) -> Result<(Self, usize), bincode::error::DecodeError>;

    /// Decodes a body of the version before; the same as today's unless the message changed.
    #[doc(hidden)]
    fn decode_previous(body: &[u8]) -> Result<(Self, usize), bincode::error::DecodeError> {
        Self::decode_body(body)
    }
}

/// `decode_body` with the limit as a constant, which bincode wants in the type.
macro_rules! bounded_decode {
    ($kind:expr) => {
        fn decode_body(body: &[u8]) -> Result<(Self, usize), bincode::error::DecodeError> {
            const CLAIM: usize = $crate::codec::ALLOCATION_FACTOR * $kind.max_bytes();
            bincode::decode_from_slice(body, bincode::config::standard().with_limit::<CLAIM>())
        }
    };
}
pub(crate) use bounded_decode;

/// The envelope of a legal message.
///
/// # Errors
/// An illegal value ([`EncodeError::Invalid`]), or more bytes than the kind may have.
pub fn encode<M: Message>(message: &M) -> Result<Vec<u8>, EncodeError> {
    let kind = M::KIND;
    message.validate().map_err(|source| EncodeError::Invalid { kind, source })?;
    let body = bincode::encode_to_vec(message, bincode::config::standard())
        .map_err(|source| EncodeError::Body { kind, source })?;
    let len = HEADER_LEN + body.len();
    if len > kind.max_bytes() {
        return Err(EncodeError::TooLong { kind, len, limit: kind.max_bytes() });
    }
    let mut envelope = Vec::with_capacity(len);
    envelope.extend_from_slice(&MAGIC);
    envelope.extend_from_slice(&[WIRE_VERSION, kind as u8]);
    envelope.extend_from_slice(&body);
    Ok(envelope)
}

/// The message of an envelope that should hold an `M`.
///
/// # Errors
/// Everything else than one whole legal `M` in a version that this program reads. No input panics, and none makes it
/// allocate more than [`ALLOCATION_FACTOR`] times the kind's limit.
pub fn decode<M: Message>(envelope: &[u8]) -> Result<M, DecodeError> {
    let kind = M::KIND;
    // The length first: nothing of an oversized message is looked at.
    if envelope.len() > kind.max_bytes() {
        return Err(DecodeError::TooLong { kind, len: envelope.len(), limit: kind.max_bytes() });
    }
    let (header, body) =
        envelope.split_first_chunk::<HEADER_LEN>().ok_or(DecodeError::NoEnvelope { len: envelope.len() })?;
    let [magic_0, magic_1, version, number] = *header;
    if [magic_0, magic_1] != MAGIC {
        return Err(DecodeError::Magic { found: [magic_0, magic_1] });
    }
    let previous = readable(version)?;
    if number != kind as u8 {
        return Err(DecodeError::Kind { expected: kind, found: number });
    }
    let (message, used) = if previous { M::decode_previous(body) } else { M::decode_body(body) }
        .map_err(|source| DecodeError::Body { kind, source })?;
    if used != body.len() {
        return Err(DecodeError::Trailing { kind, extra: body.len() - used });
    }
    message.validate().map_err(|source| DecodeError::Invalid { kind, source })?;
    Ok(message)
}

/// The kind that an envelope claims to hold, for counting; `None` where there is no envelope.
pub fn claimed_kind(envelope: &[u8]) -> Option<Kind> {
    let header = envelope.first_chunk::<HEADER_LEN>()?;
    (header[..2] == MAGIC).then(|| Kind::from_u8(header[3])).flatten()
}

/// Whether a version that can be read is the previous one.
fn readable(version: u8) -> Result<bool, DecodeError> {
    match version {
        WIRE_VERSION => Ok(false),
        OLDEST_VERSION.. if version < WIRE_VERSION => Ok(true),
        _ if version < OLDEST_VERSION => Err(DecodeError::SenderTooOld { found: version, oldest: OLDEST_VERSION }),
        _ => Err(DecodeError::ReceiverTooOld { found: version, newest: WIRE_VERSION }),
    }
}
