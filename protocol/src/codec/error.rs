//! Why bytes are not a message, and why a message cannot become bytes.

use super::Kind;

/// A value that no message may carry.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Invalid {
    /// NaN or infinity.
    #[error("{field} is not a finite number")]
    NotFinite {
        /// Which.
        field: &'static str,
    },
    /// Outside the legal range.
    #[error("{field} is {value}; legal is {min} to {max}")]
    OutOfRange {
        /// Which.
        field: &'static str,
        /// The value.
        value: f64,
        /// Least legal value.
        min: f64,
        /// Largest legal value.
        max: f64,
    },
    /// Not above zero, or too large.
    #[error("{field} is {value}; legal is more than 0, at most {max}")]
    NotPositive {
        /// Which.
        field: &'static str,
        /// The value.
        value: f64,
        /// Largest legal value.
        max: f64,
    },
    /// More entries than the limit.
    #[error("{field} has {count} entries; at most {limit} are legal")]
    TooMany {
        /// Which.
        field: &'static str,
        /// How many.
        count: usize,
        /// Most.
        limit: usize,
    },
    /// A text that is too long.
    #[error("{field} has {len} bytes; at most {limit} are legal")]
    TooLongText {
        /// Which.
        field: &'static str,
        /// Its length.
        len: usize,
        /// Most.
        limit: usize,
    },
    /// Two fields that must fit each other do not.
    #[error("{field} {problem}")]
    Inconsistent {
        /// Which.
        field: &'static str,
        /// In what way.
        problem: &'static str,
    },
}

/// Why a message was not encoded. Nothing was sent.
#[derive(Debug, thiserror::Error)]
pub enum EncodeError {
    /// It holds an illegal value.
    #[error("cannot send this {kind}: {source}")]
    Invalid {
        /// Of the message.
        kind: Kind,
        /// What.
        source: Invalid,
    },
    /// It is too long.
    #[error("cannot send this {kind}: it has {len} bytes, {limit} are allowed")]
    TooLong {
        /// Of the message.
        kind: Kind,
        /// Bytes of the envelope.
        len: usize,
        /// Most.
        limit: usize,
    },
    /// The encoder refused.
    #[error("cannot send this {kind}: {source}")]
    Body {
        /// Of the message.
        kind: Kind,
        /// What the encoder said.
        source: bincode::error::EncodeError,
    },
}

/// Why bytes are not the message that was expected.
#[derive(Debug, thiserror::Error)]
pub enum DecodeError {
    /// Too short for an envelope.
    #[error("{len} bytes are no message of this team's programs: an envelope has at least 4")]
    NoEnvelope {
        /// Bytes that came.
        len: usize,
    },
    /// Another program's bytes.
    #[error("not a message of this team's programs: it begins with {found:02x?}, not [50, a1]")]
    Magic {
        /// First two bytes.
        found: [u8; 2],
    },
    /// From an older program.
    #[error("the sender speaks wire version {found}, this program reads {oldest} and newer: upgrade the sender")]
    SenderTooOld {
        /// Of the message.
        found: u8,
        /// Oldest that can be read.
        oldest: u8,
    },
    /// From a newer program.
    #[error("the sender speaks wire version {found}, this program reads up to {newest}: upgrade this program")]
    ReceiverTooOld {
        /// Of the message.
        found: u8,
        /// Newest that can be read.
        newest: u8,
    },
    /// Another message than this key carries.
    #[error("expected a {expected}, got message kind {found}")]
    Kind {
        /// What the key carries.
        expected: Kind,
        /// What came.
        found: u8,
    },
    /// More bytes than the kind may have.
    #[error("a {kind} of {len} bytes: {limit} are allowed")]
    TooLong {
        /// What the key carries.
        kind: Kind,
        /// Bytes that came.
        len: usize,
        /// Most.
        limit: usize,
    },
    /// Bytes after the end.
    #[error("{extra} bytes after the end of a {kind}")]
    Trailing {
        /// Of the message.
        kind: Kind,
        /// How many.
        extra: usize,
    },
    /// Cut off, or not the encoding of any value.
    #[error("damaged {kind}: {source}")]
    Body {
        /// Of the message.
        kind: Kind,
        /// What the decoder said.
        source: bincode::error::DecodeError,
    },
    /// Well formed, but with an illegal value.
    #[error("illegal {kind}: {source}")]
    Invalid {
        /// Of the message.
        kind: Kind,
        /// What.
        source: Invalid,
    },
}
