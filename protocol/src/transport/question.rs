//! Questions and answers: commands, clock probes, pictures, the map.
//!
//! Our programs ask with an envelope and are answered with one. Whoever asks by key alone (a shell script, a person) is
//! answered too: commands and clock as JSON, with the command in the parameters (`…/command?do=set_frame_rate;rate_hz=5`,
//! without `do` the status); pictures as PNG or JPEG, the map as an envelope, `map/json` as JSON.

mod answer;
mod command;

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::sync::oneshot;
use zenoh::Wait;
use zenoh::query::{Query, Reply};

pub use answer::{
    Answer, AskedMap, AskedMapJson, AskedPicture, AskedRecent, AskedReplayStart, EncodedPicture, Question,
};

use super::Transport;
use super::error::{AskError, TransportError, words};
use super::qos::qos;
use super::ring::Ring;
use crate::codec::DecodeError;
use crate::key::Key;
use crate::meter::{Direction, Meter};
use crate::time::Timestamp;

/// Questions that may wait for a busy program; the oldest goes unanswered.
pub const MAX_WAITING_QUESTIONS: usize = 32;
/// Most bytes of a refusal's words that are shown.
const MAX_WHY_LEN: usize = 512;

impl Transport {
    /// Takes questions on a key.
    ///
    /// # Errors
    /// The session is closed, or refuses.
    pub async fn answer<Q: Question>(&self, key: Key) -> Result<Questions<Q>, TransportError> {
        let (writer, ring) = Ring::new(MAX_WAITING_QUESTIONS);
        let (meter, clock) = (self.meter.clone(), self.options.clock);
        let callback = move |query: Query| {
            if !writer.push((query, clock.now())) {
                meter.count_dropped();
            }
        };
        let raw = self.session.declare_queryable(key.to_string()).complete(true).callback(callback).await;
        let refused = |error: zenoh::Error| TransportError::Declare { key: key.to_string(), reason: words(&error) };
        Ok(Questions {
            _raw: raw.map_err(refused)?,
            ring,
            meter: self.meter.clone(),
            key,
            question: Default::default(),
        })
    }

    /// Asks, and waits at most `limit` for the first answer.
    ///
    /// # Errors
    /// Nobody there (at once), no answer in time, a refusal with its words, an answer that cannot be read.
    pub async fn ask<Q: Question>(
        &self,
        key: Key,
        question: &Q,
        limit: Duration,
    ) -> Result<Answered<Q::Answer>, AskError> {
        let not_sent = |error: zenoh::Error| TransportError::Send { key: key.to_string(), reason: words(&error) };
        let payload = question.to_payload().map_err(TransportError::Encode)?;
        let asked_bytes = payload.as_ref().map_or(0, Vec::len);
        let clock = self.options.clock;
        let (sender, receiver) = oneshot::channel();
        let sender = Mutex::new(Some(sender));
        // The first answer counts; stamped on Zenoh's thread.
        let callback = move |reply: Reply| {
            let at = clock.now();
            if let Some(sender) = sender.lock().unwrap_or_else(PoisonError::into_inner).take() {
                // Nobody waits any more: fine.
                let _ = sender.send((reply, at));
            }
        };
        let qos = qos(Q::KIND);
        let mut get = self
            .session
            .get(key.to_string())
            .timeout(limit)
            .priority(qos.priority)
            .congestion_control(qos.congestion)
            .express(qos.express)
            .callback(callback);
        if let Some(payload) = payload {
            get = get.payload(payload);
        }
        get.await.map_err(not_sent)?;
        self.meter.count(key.robot_id(), Q::KIND, Direction::Sent, asked_bytes);

        let timed_out = || AskError::TimedOut { key: key.to_string(), limit };
        // Zenoh ends the query itself at the limit; a little later we do not wait for that either.
        let (reply, arrived) = match tokio::time::timeout(limit + limit / 4, receiver).await {
            Ok(Ok(reply)) => reply,
            Ok(Err(_)) => return Err(AskError::NobodyThere(key.to_string())),
            Err(_) => return Err(timed_out()),
        };
        Ok(Answered { answer: self.read_reply::<Q>(key, reply, limit)?, arrived })
    }

    /// The answer in a reply, or why there is none.
    pub(super) fn read_reply<Q: Question>(
        &self,
        key: Key,
        reply: Reply,
        limit: Duration,
    ) -> Result<Q::Answer, AskError> {
        match reply.into_result() {
            Ok(sample) => {
                let payload = sample.payload().to_bytes();
                let unreadable = |source: DecodeError| AskError::Unreadable { key: key.to_string(), source };
                let answer = Q::Answer::from_bytes(&payload).map_err(unreadable)?;
                self.meter.count(key.robot_id(), Q::ANSWER_KIND, Direction::Received, payload.len());
                Ok(answer)
            }
            Err(refusal) => {
                let why = refusal.payload().to_bytes();
                let why: String = String::from_utf8_lossy(&why[..why.len().min(MAX_WHY_LEN)]).into_owned();
                // Zenoh's own word at the limit.
                Err(if why == "Timeout" {
                    AskError::TimedOut { key: key.to_string(), limit }
                } else {
                    AskError::Refused { key: key.to_string(), why }
                })
            }
        }
    }
}

/// An answer with its time of arrival.
#[derive(Debug, Clone, PartialEq)]
pub struct Answered<A> {
    /// What was said.
    pub answer: A,
    /// When it came in, on the session's clock.
    pub arrived: Timestamp,
}

/// Questions on one key.
#[derive(Debug)]
pub struct Questions<Q> {
    _raw: zenoh::query::Queryable<()>,
    ring: Arc<Ring<(Query, Timestamp)>>,
    meter: Arc<Meter>,
    key: Key,
    question: std::marker::PhantomData<fn() -> Q>,
}

impl<Q: Question> Questions<Q> {
    /// The next question that can be read (others are refused in words and counted); `None` once the session is closed.
    pub async fn recv(&mut self) -> Option<Asked<Q>> {
        loop {
            let (query, arrived) = self.ring.recv().await?;
            let payload = query.payload().map(|payload| payload.to_bytes());
            let parameters = query.parameters().clone();
            let read = Q::read(self.key, payload.as_deref(), &|name| parameters.get(name).map(ToOwned::to_owned));
            match read {
                Ok((question, for_people)) => {
                    let bytes = payload.map_or(0, |payload| payload.len());
                    self.meter.count(self.key.robot_id(), Q::KIND, Direction::Received, bytes);
                    let meter = self.meter.clone();
                    return Some(Asked { question, arrived, query, for_people, meter, key: self.key });
                }
                Err(why) => {
                    self.meter.count_refused();
                    tracing::warn!(key = %self.key, "question refused: {why}");
                    // Who asked nonsense may be gone already; that is no news.
                    let _ = query.reply_err(why).wait();
                }
            }
        }
    }
}

/// A question that wants an answer. Dropping it leaves it unanswered.
#[derive(Debug)]
pub struct Asked<Q> {
    /// What.
    pub question: Q,
    /// When it came in, on the session's clock.
    pub arrived: Timestamp,
    query: Query,
    for_people: bool,
    meter: Arc<Meter>,
    key: Key,
}

impl<Q: Question> Asked<Q> {
    /// Answers.
    ///
    /// # Errors
    /// The answer is illegal (then the asker is told so), or the session is closed.
    pub fn reply(self, answer: &Q::Answer) -> Result<(), TransportError> {
        let (bytes, encoding) = match answer.to_bytes(self.for_people) {
            Ok(encoded) => encoded,
            Err(error) => {
                self.refuse(&error.to_string())?;
                return Err(error.into());
            }
        };
        let len = bytes.len();
        let sent = self.query.reply(self.key.to_string(), bytes).encoding(encoding).wait();
        sent.map_err(|error| TransportError::Send { key: self.key.to_string(), reason: words(&error) })?;
        self.meter.count(self.key.robot_id(), Q::ANSWER_KIND, Direction::Sent, len);
        Ok(())
    }

    /// Says no, and why.
    ///
    /// # Errors
    /// The session is closed.
    pub fn refuse(&self, why: &str) -> Result<(), TransportError> {
        let sent = self.query.reply_err(why).wait();
        sent.map_err(|error| TransportError::Send { key: self.key.to_string(), reason: words(&error) })
    }
}
