//! Who is there: liveliness tokens and their watchers.

use std::sync::Arc;

use zenoh::Wait;
use zenoh::sample::{Sample, SampleKind};

use super::Transport;
use super::error::{TransportError, words};
use super::ring::Ring;
use crate::key::{Key, Pattern};

/// Signs that may wait for a slow reader. Of each key only the last waits, so this many robots and leaders.
const MAX_WAITING_SIGNS: usize = 4096;

impl Transport {
    /// Says that the key's owner is there, until the token is dropped or the session is lost.
    ///
    /// # Errors
    /// The session is closed, or refuses.
    pub async fn declare_alive(&self, key: Key) -> Result<AliveToken, TransportError> {
        let token = self.session.liveliness().declare_token(key.to_string()).await;
        let refused = |error: zenoh::Error| TransportError::Declare { key: key.to_string(), reason: words(&error) };
        Ok(AliveToken { _token: token.map_err(refused)? })
    }

    /// The same for a caller without a runtime: a watchdog's thread.
    ///
    /// # Errors
    /// The session is closed, or refuses.
    pub fn declare_alive_blocking(&self, key: Key) -> Result<AliveToken, TransportError> {
        let token = self.session.liveliness().declare_token(key.to_string()).wait();
        let refused = |error: zenoh::Error| TransportError::Declare { key: key.to_string(), reason: words(&error) };
        Ok(AliveToken { _token: token.map_err(refused)? })
    }

    /// Watches who comes and goes; those already there come first.
    ///
    /// # Errors
    /// The session is closed, or refuses.
    pub async fn watch(&self, pattern: impl Into<Pattern>) -> Result<Presences, TransportError> {
        let pattern = pattern.into();
        let (writer, ring) = Ring::new(MAX_WAITING_SIGNS);
        let meter = self.meter.clone();
        let callback = move |sample: Sample| {
            let Ok(key) = sample.key_expr().as_str().parse::<Key>() else {
                meter.count_refused();
                return;
            };
            let sign = Sign { key, alive: sample.kind() == SampleKind::Put };
            if !writer.push_last(sign, |waiting, new| waiting.key == new.key) {
                meter.count_dropped();
            }
        };
        let refused = |error: zenoh::Error| TransportError::Declare { key: pattern.to_string(), reason: words(&error) };
        let liveliness = self.session.liveliness();
        let raw = liveliness.declare_subscriber(pattern.to_string()).history(true).callback(callback).await;
        Ok(Presences { _raw: raw.map_err(refused)?, ring })
    }
}

/// Keeps a key alive; dropping it tells everybody that its owner is gone.
#[derive(Debug)]
pub struct AliveToken {
    _token: zenoh::liveliness::LivelinessToken,
}

/// Somebody came or went.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sign {
    /// Whose token.
    pub key: Key,
    /// Whether it is there now.
    pub alive: bool,
}

/// Who comes and goes. A robot that goes and comes back while nobody reads shows as there.
#[derive(Debug)]
pub struct Presences {
    _raw: zenoh::pubsub::Subscriber<()>,
    ring: Arc<Ring<Sign>>,
}

impl Presences {
    /// The next change; `None` once the session is closed.
    pub async fn recv(&mut self) -> Option<Sign> {
        self.ring.recv().await
    }
}
