//! What may be asked, and how questions and answers become bytes.

use std::fmt::Debug;

use zenoh::bytes::Encoding;

use super::command::{command_from_words, reply_as_json};
use crate::codec::{self, DecodeError, EncodeError, Kind, Message};
use crate::key::{Key, RobotTopic, Topic};
use crate::message::{ClockProbe, ClockReply, Command, CommandReply, PictureKind, Recent, ReplayStart, TeamMap};
use crate::time::Timestamp;

/// Something that may be asked on a key.
pub trait Question: Debug + Sized + Send + Sync + 'static {
    /// What it is answered with.
    type Answer: Answer;
    /// For the meter and the QoS.
    const KIND: Kind;
    /// For the meter.
    const ANSWER_KIND: Kind;

    /// What travels with the question; `None` where the key says all.
    #[doc(hidden)]
    fn to_payload(&self) -> Result<Option<Vec<u8>>, EncodeError>;

    /// Reads a question, and whether it came from people, who read JSON. `parameter` gives the key's parameters.
    #[doc(hidden)]
    fn read(
        key: Key,
        payload: Option<&[u8]>,
        parameter: &dyn Fn(&str) -> Option<String>,
    ) -> Result<(Self, bool), String>;
}

/// Something that answers.
pub trait Answer: Debug + Sized + Send + Sync + 'static {
    #[doc(hidden)]
    fn to_bytes(&self, for_people: bool) -> Result<(Vec<u8>, Encoding), EncodeError>;
    #[doc(hidden)]
    fn from_bytes(bytes: &[u8]) -> Result<Self, DecodeError>;
}

impl Question for Command {
    type Answer = CommandReply;
    const KIND: Kind = Kind::Command;
    const ANSWER_KIND: Kind = Kind::CommandReply;

    fn to_payload(&self) -> Result<Option<Vec<u8>>, EncodeError> {
        codec::encode(self).map(Some)
    }

    fn read(
        _: Key,
        payload: Option<&[u8]>,
        parameter: &dyn Fn(&str) -> Option<String>,
    ) -> Result<(Self, bool), String> {
        match payload {
            Some(envelope) => Ok((codec::decode(envelope).map_err(|error| error.to_string())?, false)),
            None => Ok((command_from_words(parameter)?, true)),
        }
    }
}

impl Answer for CommandReply {
    fn to_bytes(&self, for_people: bool) -> Result<(Vec<u8>, Encoding), EncodeError> {
        let envelope = codec::encode(self)?;
        Ok(if for_people {
            (reply_as_json(self).to_string().into_bytes(), Encoding::APPLICATION_JSON)
        } else {
            (envelope, Encoding::APPLICATION_OCTET_STREAM)
        })
    }

    fn from_bytes(bytes: &[u8]) -> Result<Self, DecodeError> {
        codec::decode(bytes)
    }
}

impl Question for ClockProbe {
    type Answer = ClockReply;
    const KIND: Kind = Kind::ClockProbe;
    const ANSWER_KIND: Kind = Kind::ClockReply;

    fn to_payload(&self) -> Result<Option<Vec<u8>>, EncodeError> {
        codec::encode(self).map(Some)
    }

    fn read(_: Key, payload: Option<&[u8]>, _: &dyn Fn(&str) -> Option<String>) -> Result<(Self, bool), String> {
        match payload {
            Some(envelope) => Ok((codec::decode(envelope).map_err(|error| error.to_string())?, false)),
            None => Ok((Self { sent: Timestamp(0) }, true)),
        }
    }
}

impl Answer for ClockReply {
    fn to_bytes(&self, for_people: bool) -> Result<(Vec<u8>, Encoding), EncodeError> {
        if !for_people {
            return Ok((codec::encode(self)?, Encoding::APPLICATION_OCTET_STREAM));
        }
        let json = serde_json::json!({
            "received_ns": self.received.0, "replied_ns": self.replied.0, "epoch": self.epoch,
        });
        Ok((json.to_string().into_bytes(), Encoding::APPLICATION_JSON))
    }

    fn from_bytes(bytes: &[u8]) -> Result<Self, DecodeError> {
        codec::decode(bytes)
    }
}

/// A robot asks the leader when recordings begin.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AskedReplayStart(pub ClockProbe);

impl Question for AskedReplayStart {
    type Answer = ReplayStart;
    const KIND: Kind = Kind::ClockProbe;
    const ANSWER_KIND: Kind = Kind::ReplayStart;

    fn to_payload(&self) -> Result<Option<Vec<u8>>, EncodeError> {
        self.0.to_payload()
    }

    fn read(
        key: Key,
        payload: Option<&[u8]>,
        parameter: &dyn Fn(&str) -> Option<String>,
    ) -> Result<(Self, bool), String> {
        ClockProbe::read(key, payload, parameter).map(|(probe, for_people)| (Self(probe), for_people))
    }
}

impl Answer for ReplayStart {
    fn to_bytes(&self, for_people: bool) -> Result<(Vec<u8>, Encoding), EncodeError> {
        if !for_people {
            return Ok((codec::encode(self)?, Encoding::APPLICATION_OCTET_STREAM));
        }
        let json = serde_json::json!({
            "received_ns": self.received.0, "replied_ns": self.replied.0, "start_ns": self.start.map(|start| start.0),
        });
        Ok((json.to_string().into_bytes(), Encoding::APPLICATION_JSON))
    }

    fn from_bytes(bytes: &[u8]) -> Result<Self, DecodeError> {
        codec::decode(bytes)
    }
}

/// A question that its key says whole, answered with a message in its envelope.
macro_rules! asked_by_key {
    ($question:ident, $answer:ident) => {
        impl Question for $question {
            type Answer = $answer;
            const KIND: Kind = <$answer as Message>::KIND;
            const ANSWER_KIND: Kind = <$answer as Message>::KIND;

            fn to_payload(&self) -> Result<Option<Vec<u8>>, EncodeError> {
                Ok(None)
            }

            fn read(_: Key, _: Option<&[u8]>, _: &dyn Fn(&str) -> Option<String>) -> Result<(Self, bool), String> {
                Ok((Self, false))
            }
        }

        impl Answer for $answer {
            fn to_bytes(&self, _: bool) -> Result<(Vec<u8>, Encoding), EncodeError> {
                Ok((codec::encode(self)?, Encoding::APPLICATION_OCTET_STREAM))
            }

            fn from_bytes(bytes: &[u8]) -> Result<Self, DecodeError> {
                codec::decode(bytes)
            }
        }
    };
}

/// A leader that has come late wants what a robot has seen of late, on the key of its observations.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AskedRecent;

asked_by_key!(AskedRecent, Recent);

/// Somebody wants the map.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AskedMap;

asked_by_key!(AskedMap, TeamMap);

/// Somebody wants the map as JSON.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AskedMapJson;

impl Question for AskedMapJson {
    type Answer = String;
    const KIND: Kind = Kind::MapJson;
    const ANSWER_KIND: Kind = Kind::MapJson;

    fn to_payload(&self) -> Result<Option<Vec<u8>>, EncodeError> {
        Ok(None)
    }

    fn read(_: Key, _: Option<&[u8]>, _: &dyn Fn(&str) -> Option<String>) -> Result<(Self, bool), String> {
        Ok((Self, true))
    }
}

impl Answer for String {
    fn to_bytes(&self, _: bool) -> Result<(Vec<u8>, Encoding), EncodeError> {
        Ok((plain(Kind::MapJson, self.as_bytes())?, Encoding::APPLICATION_JSON))
    }

    fn from_bytes(bytes: &[u8]) -> Result<Self, DecodeError> {
        bounded(Kind::MapJson, bytes)?;
        Ok(String::from_utf8_lossy(bytes).into_owned())
    }
}

/// Somebody wants a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AskedPicture(pub PictureKind);

/// A picture as PNG or JPEG.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EncodedPicture(pub Vec<u8>);

impl Question for AskedPicture {
    type Answer = EncodedPicture;
    const KIND: Kind = Kind::Picture;
    const ANSWER_KIND: Kind = Kind::Picture;

    fn to_payload(&self) -> Result<Option<Vec<u8>>, EncodeError> {
        Ok(None)
    }

    fn read(key: Key, _: Option<&[u8]>, _: &dyn Fn(&str) -> Option<String>) -> Result<(Self, bool), String> {
        match key.topic {
            Topic::Robot(_, RobotTopic::Picture(kind)) => Ok((Self(kind), true)),
            _ => Err(format!("{key} is not the key of a picture")),
        }
    }
}

impl Answer for EncodedPicture {
    fn to_bytes(&self, _: bool) -> Result<(Vec<u8>, Encoding), EncodeError> {
        let encoding = if self.0.starts_with(&[0xFF, 0xD8]) { Encoding::IMAGE_JPEG } else { Encoding::IMAGE_PNG };
        Ok((plain(Kind::Picture, &self.0)?, encoding))
    }

    fn from_bytes(bytes: &[u8]) -> Result<Self, DecodeError> {
        bounded(Kind::Picture, bytes)?;
        Ok(Self(bytes.to_vec()))
    }
}

fn plain(kind: Kind, bytes: &[u8]) -> Result<Vec<u8>, EncodeError> {
    let (len, limit) = (bytes.len(), kind.max_bytes());
    if len > limit { Err(EncodeError::TooLong { kind, len, limit }) } else { Ok(bytes.to_vec()) }
}

fn bounded(kind: Kind, bytes: &[u8]) -> Result<(), DecodeError> {
    let (len, limit) = (bytes.len(), kind.max_bytes());
    if len > limit { Err(DecodeError::TooLong { kind, len, limit }) } else { Ok(()) }
}
