//! Questions that the agent is thinking about.

use std::collections::BTreeMap;

use protocol::message::{ClockProbe, ClockReply, Command, CommandReply};
use protocol::time::Timestamp;
use protocol::transport::{Asked, AskedPicture, EncodedPicture, TransportError};

use crate::agent::{Input, Token};

/// A question of any kind.
#[derive(Debug)]
pub enum Question {
    Clock(Asked<ClockProbe>),
    Command(Asked<Command>),
    Picture(Asked<AskedPicture>),
}

impl Question {
    /// As the agent gets it, with its time of arrival.
    pub fn input(&self, token: Token) -> (Timestamp, Input) {
        match self {
            Self::Clock(asked) => (asked.arrived, Input::ClockProbe(token, asked.question)),
            Self::Command(asked) => (asked.arrived, Input::Command(token, asked.question.clone())),
            Self::Picture(asked) => (asked.arrived, Input::Picture(token, asked.question.0)),
        }
    }

    /// Says no.
    pub fn refuse(self, why: &str) -> Result<(), TransportError> {
        match self {
            Self::Clock(asked) => asked.refuse(why),
            Self::Command(asked) => asked.refuse(why),
            Self::Picture(asked) => asked.refuse(why),
        }
    }
}

/// Questions by the token that the agent answers with. As many as the mailbox takes, since the agent answers each.
#[derive(Debug, Default)]
pub struct Waiting {
    next: u64,
    questions: BTreeMap<Token, Question>,
}

impl Waiting {
    /// A token for a new question.
    pub fn token(&mut self) -> Token {
        self.next += 1;
        Token(self.next)
    }

    /// Keeps a question until it is answered.
    pub fn keep(&mut self, token: Token, question: Question) {
        self.questions.insert(token, question);
    }

    /// Answers a clock probe. The time of replying is set here, at the last moment.
    pub fn answer_clock(&mut self, token: Token, reply: ClockReply, now: Timestamp) -> Result<(), TransportError> {
        match self.questions.remove(&token) {
            Some(Question::Clock(asked)) => asked.reply(&ClockReply { replied: now, ..reply }),
            _ => Ok(()),
        }
    }

    /// Answers a command.
    pub fn answer_command(&mut self, token: Token, reply: &CommandReply) -> Result<(), TransportError> {
        match self.questions.remove(&token) {
            Some(Question::Command(asked)) => asked.reply(reply),
            _ => Ok(()),
        }
    }

    /// The one who wants a picture, to be answered elsewhere: a picture may wait for a slow link.
    pub fn take_picture(&mut self, token: Token) -> Option<Asked<AskedPicture>> {
        match self.questions.remove(&token) {
            Some(Question::Picture(asked)) => Some(asked),
            _ => None,
        }
    }
}

/// Answers a request for a picture; blocks while the link is busy.
pub fn answer_picture(asked: Asked<AskedPicture>, picture: Result<Vec<u8>, String>) -> Result<(), TransportError> {
    match picture {
        Ok(bytes) => asked.reply(&EncodedPicture(bytes)),
        Err(why) => asked.refuse(&why),
    }
}
