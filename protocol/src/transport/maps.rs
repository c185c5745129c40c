//! The map of whoever leads: behind a fence, so that a leader that has been replaced is not heard again.

use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use zenoh::query::{ConsolidationMode, QueryTarget, Reply};

use super::Transport;
use super::error::{AskError, TransportError, words};
use super::question::{Answered, Question};
use super::subscriber::{Received, Subscriber};
use crate::fence::Fence;
use crate::id::TeamId;
use crate::key::Key;
use crate::message::TeamMap;

/// Answers of so many leaders are compared; there is more than one only while a replaced one has not noticed yet.
const MAX_ANSWERS: usize = 16;
/// After the first answer the others have this long.
const OTHERS_LIMIT: Duration = Duration::from_millis(150);

/// Receives the maps of the leader that is believed.
#[derive(Debug)]
pub struct Maps {
    raw: Subscriber<TeamMap>,
    fence: Fence,
}

impl Transport {
    /// A subscriber to the team's map that drops the maps of leaders that were replaced.
    ///
    /// # Errors
    /// The session is closed, or refuses.
    pub async fn subscribe_map(&self, team: TeamId) -> Result<Maps, TransportError> {
        Ok(Maps { raw: self.subscribe(Key::map(team)).await?, fence: Fence::default() })
    }

    /// Asks everybody who answers, and gives the answer of the highest rank: that of the leader of the highest term.
    ///
    /// # Errors
    /// Nobody there (at once), no answer in time, only refusals (the last one), answers that cannot be read.
    pub async fn ask_ruler<Q: Question>(
        &self,
        key: Key,
        question: &Q,
        limit: Duration,
        rank: impl Fn(&Q::Answer) -> u64,
    ) -> Result<Answered<Q::Answer>, AskError> {
        let not_sent = |error: zenoh::Error| TransportError::Send { key: key.to_string(), reason: words(&error) };
        let clock = self.options().clock;
        let (sender, mut replies) = tokio::sync::mpsc::channel(MAX_ANSWERS);
        let sender = Mutex::new(sender);
        let callback = move |reply: Reply| {
            let sender = sender.lock().unwrap_or_else(PoisonError::into_inner);
            // Nobody waits any more, or there are more than anybody needs: fine.
            let _ = sender.try_send((reply, clock.now()));
        };
        let mut get = self
            .session
            .get(key.to_string())
            .target(QueryTarget::All)
            .consolidation(ConsolidationMode::None)
            .timeout(limit)
            .callback(callback);
        if let Some(payload) = question.to_payload().map_err(TransportError::Encode)? {
            get = get.payload(payload);
        }
        get.await.map_err(not_sent)?;
        let mut best: Option<(u64, Answered<Q::Answer>)> = None;
        let mut failed = None;
        let mut until = tokio::time::Instant::now() + limit;
        loop {
            let (reply, arrived) = match tokio::time::timeout_at(until, replies.recv()).await {
                Ok(Some(reply)) => reply,
                Ok(None) => break,
                Err(_) => {
                    failed = failed.or_else(|| Some(AskError::TimedOut { key: key.to_string(), limit }));
                    break;
                }
            };
            match self.read_reply::<Q>(key, reply, limit) {
                Ok(answer) => {
                    let height = rank(&answer);
                    if best.as_ref().is_none_or(|(highest, _)| height > *highest) {
                        best = Some((height, Answered { answer, arrived }));
                    }
                    until = until.min(tokio::time::Instant::now() + OTHERS_LIMIT);
                }
                Err(why) => failed = Some(why),
            }
        }
        match (best, failed) {
            (Some((_, answered)), _) => Ok(answered),
            (None, Some(why)) => Err(why),
            (None, None) => Err(AskError::NobodyThere(key.to_string())),
        }
    }
}

impl Maps {
    /// The next map of the leader that is believed; `None` once the session is closed.
    pub async fn recv(&mut self) -> Option<Received<TeamMap>> {
        loop {
            let received = self.raw.recv().await?;
            if self.fence.admits(received.arrived, received.message.leader, received.message.term) {
                return Some(received);
            }
        }
    }

    /// Maps of replaced leaders that were dropped.
    pub fn fenced(&self) -> u64 {
        self.fence.refused()
    }
}
