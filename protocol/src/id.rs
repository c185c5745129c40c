//! Names of teams, robots and leaders, and numbers of tracks and targets.
//!
//! A name is one chunk of a key expression and one word of a log line, so it is short and plain:
//! `[a-z0-9_-]{1,16}`. It is stored inline, so ids are `Copy` and cost nothing to pass around.

use std::fmt;
use std::str::FromStr;

use bincode::{BorrowDecode, Decode, Encode};
use serde::{Deserialize, Serialize};

/// Longest name in bytes.
pub const MAX_NAME_LEN: usize = 16;

/// Why a text is not a name.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NameError {
    /// Nothing, or more than [`MAX_NAME_LEN`] bytes.
    #[error("the name {0:?} has {1} characters; 1 to {MAX_NAME_LEN} are allowed")]
    Length(String, usize),
    /// A character outside `[a-z0-9_-]`.
    #[error("the name {0:?} holds {1:?}; only a-z, 0-9, '_' and '-' are allowed")]
    Character(String, char),
}

#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
struct Name {
    bytes: [u8; MAX_NAME_LEN],
    len: u8,
}

impl Name {
    fn parse(text: &str) -> Result<Self, NameError> {
        if let Some(bad) = text.chars().find(|c| !matches!(c, 'a'..='z' | '0'..='9' | '_' | '-')) {
            return Err(NameError::Character(text.chars().take(64).collect(), bad));
        }
        if text.is_empty() || text.len() > MAX_NAME_LEN {
            return Err(NameError::Length(text.chars().take(64).collect(), text.len()));
        }
        let mut bytes = [0; MAX_NAME_LEN];
        bytes[..text.len()].copy_from_slice(text.as_bytes());
        Ok(Self { bytes, len: text.len() as u8 })
    }

    fn as_str(&self) -> &str {
        // Only ASCII passes `parse`, so this cannot fail; the empty text would show a defect here.
        std::str::from_utf8(&self.bytes[..usize::from(self.len)]).unwrap_or_default()
    }
}

macro_rules! name_type {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        #[serde(try_from = "String", into = "String")]
        pub struct $name(Name);

        impl $name {
            /// The name checked: `[a-z0-9_-]{1,16}`.
            pub fn new(text: &str) -> Result<Self, NameError> {
                Name::parse(text).map(Self)
            }

            /// The name as text.
            pub fn as_str(&self) -> &str {
                self.0.as_str()
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.pad(self.as_str())
            }
        }

        impl fmt::Debug for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "{}({})", stringify!($name), self.as_str())
            }
        }

        impl FromStr for $name {
            type Err = NameError;
            fn from_str(text: &str) -> Result<Self, NameError> {
                Self::new(text)
            }
        }

        impl TryFrom<String> for $name {
            type Error = NameError;
            fn try_from(text: String) -> Result<Self, NameError> {
                Self::new(&text)
            }
        }

        impl From<$name> for String {
            fn from(name: $name) -> String {
                name.as_str().to_owned()
            }
        }

        impl Encode for $name {
            fn encode<E: bincode::enc::Encoder>(&self, encoder: &mut E) -> Result<(), bincode::error::EncodeError> {
                self.as_str().encode(encoder)
            }
        }

        impl<C> Decode<C> for $name {
            fn decode<D: bincode::de::Decoder<Context = C>>(decoder: &mut D) -> Result<Self, bincode::error::DecodeError> {
                Self::new(&String::decode(decoder)?)
                    .map_err(|e| bincode::error::DecodeError::OtherString(e.to_string()))
            }
        }

        impl<'de, C> BorrowDecode<'de, C> for $name {
            fn borrow_decode<D: bincode::de::BorrowDecoder<'de, Context = C>>(
                decoder: &mut D,
            ) -> Result<Self, bincode::error::DecodeError> {
                Self::decode(decoder)
            }
        }
    };
}

name_type!(
    /// A team: the first chunk of every key after `pal/`.
    TeamId
);
name_type!(
    /// A robot, unique in its team.
    RobotId
);
name_type!(
    /// A leader, unique in its team.
    LeaderId
);
name_type!(
    /// Whoever holds a certificate of a team: a robot, a leader, an operator, a router. Unique among its like.
    MemberId
);

impl From<RobotId> for MemberId {
    fn from(id: RobotId) -> Self {
        Self(id.0)
    }
}

impl From<LeaderId> for MemberId {
    fn from(id: LeaderId) -> Self {
        Self(id.0)
    }
}

/// A moving object as one robot follows it; never used twice in one session (epoch) of the robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, Encode, Decode)]
#[serde(transparent)]
pub struct TrackId(pub u32);

/// A moving object as the team knows it; never used twice by one team.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, Encode, Decode)]
#[serde(transparent)]
pub struct TargetId(pub u32);

impl fmt::Display for TrackId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.0)
    }
}

impl fmt::Display for TargetId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "t{}", self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn short_plain_names_are_names() {
        for name in ["r", "r1", "sixteen-letters-", "0_0-z"] {
            let id = RobotId::new(name).unwrap();
            assert_eq!((id.as_str(), id.to_string().parse()), (name, Ok(id)));
        }
    }

    #[test]
    fn other_names_are_refused_with_the_reason() {
        for (name, part) in [
            ("", "0 characters"),
            ("seventeen-letters", "17 characters"),
            ("R1", "'R'"),
            ("r/1", "'/'"),
            ("*", "'*'"),
            ("r 1", "' '"),
            ("é", "'é'"),
        ] {
            let error = TeamId::new(name).unwrap_err().to_string();
            assert!(error.contains(part), "{error}");
        }
        // What is shown of a hostile name is short.
        assert!(RobotId::new(&"a".repeat(100_000)).unwrap_err().to_string().len() < 200);
        assert!(serde_json::from_str::<RobotId>("\"R\"").is_err());
    }

    #[test]
    fn names_sort_like_their_text() {
        let mut names = ["r2", "r10", "a", "r1"].map(|name| RobotId::new(name).unwrap());
        names.sort();
        assert_eq!(names.map(|name| name.to_string()), ["a", "r1", "r10", "r2"]);
    }
}
