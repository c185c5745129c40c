//! Subscribers: a ring of undecoded samples, decoded by the reader. What cannot be read is counted and logged, never given.

use std::collections::BTreeSet;
use std::marker::PhantomData;
use std::sync::Arc;
use std::time::{Duration, Instant};

use zenoh::sample::{Locality, Sample};
use zenoh_ext::{AdvancedSubscriber, AdvancedSubscriberBuilderExt, HistoryConfig, RecoveryConfig};

use super::Transport;
use super::error::{TransportError, words};
use super::qos::qos;
use super::ring::{Ring, Writer};
use super::throttle::{Admission, Throttle};
use crate::codec::{self, Kind, Message};
use crate::host_clock::Clock;
use crate::key::{Key, Pattern};
use crate::meter::{Direction, Meter};
use crate::time::Timestamp;

/// Time that a publisher has to answer for what it kept. Until all have, what new publishers say waits.
const HISTORY_LIMIT: Duration = Duration::from_secs(2);
/// The same for kinds of which a newer message is worth more than an old one.
const LIVE_HISTORY_LIMIT: Duration = Duration::from_millis(300);
/// Senders whose refused messages are logged once each; those of further senders are only counted.
const MAX_REFUSED_NAMED: usize = 64;

impl Transport {
    /// A subscriber to the messages `M` of a key or of all its like. Of kinds that are kept for late joiners it gets what
    /// was published before, also from publishers that appear later.
    ///
    /// # Errors
    /// The session is closed, or refuses.
    pub async fn subscribe<M: Message>(&self, pattern: impl Into<Pattern>) -> Result<Subscriber<M>, TransportError> {
        self.subscribe_from(pattern.into(), Locality::Any).await
    }

    /// The same, without what this very session publishes.
    ///
    /// # Errors
    /// The session is closed, or refuses.
    pub async fn subscribe_others<M: Message>(
        &self,
        pattern: impl Into<Pattern>,
    ) -> Result<Subscriber<M>, TransportError> {
        self.subscribe_from(pattern.into(), Locality::Remote).await
    }

    async fn subscribe_from<M: Message>(
        &self,
        pattern: Pattern,
        origin: Locality,
    ) -> Result<Subscriber<M>, TransportError> {
        let (writer, ring) = Ring::new(qos(M::KIND).ring);
        let raw = self.declare_subscriber(pattern, origin, M::KIND, writer).await?;
        Ok(Subscriber {
            _raw: raw,
            ring,
            meter: self.meter.clone(),
            refused: 0,
            named: BTreeSet::new(),
            message: PhantomData,
        })
    }

    async fn declare_subscriber(
        &self,
        pattern: Pattern,
        origin: Locality,
        kind: Kind,
        writer: Writer<Arrived>,
    ) -> Result<Raw, TransportError> {
        let refused = |error: zenoh::Error| TransportError::Declare { key: pattern.to_string(), reason: words(&error) };
        let (meter, clock) = (self.meter.clone(), self.options.clock);
        // Runs on Zenoh's threads: stamps, bounds, queues, and returns.
        let throttle = Throttle::new(kind);
        let callback = move |sample: Sample| {
            if throttle.as_ref().is_none_or(|throttle| admit(throttle, &sample, &meter)) {
                arrive(&sample, kind, clock, &meter, &writer);
            }
        };
        let builder = self.session.declare_subscriber(pattern.to_string()).allowed_origin(origin);
        let qos = qos(kind);
        if qos.kept == 0 {
            return Ok(Raw::Plain { _subscriber: builder.callback(callback).await.map_err(refused)? });
        }
        let builder = builder
            .history(HistoryConfig::default().max_samples(qos.kept).detect_late_publishers())
            .query_timeout(if qos.recovered { HISTORY_LIMIT } else { LIVE_HISTORY_LIMIT });
        let builder = if qos.recovered { builder.recovery(RecoveryConfig::default().heartbeat()) } else { builder };
        Ok(Raw::WithHistory { _subscriber: builder.callback(callback).await.map_err(refused)? })
    }
}

/// A sample with its time of arrival. Its payload is not larger than its kind may be, so a ring's memory is bounded.
#[derive(Debug)]
struct Arrived {
    key: String,
    payload: zenoh::bytes::ZBytes,
    at: Timestamp,
}

/// Whether its sender has not sent too much of late.
fn admit(throttle: &Throttle, sample: &Sample, meter: &Meter) -> bool {
    let key = sample.key_expr().as_str();
    match throttle.admit(key, Instant::now()) {
        Admission::Admitted => true,
        Admission::Refused { first } => {
            meter.count_flooded();
            if first {
                tracing::warn!(
                    key,
                    "flood: more messages than any honest agent sends; what is over is refused and counted"
                );
            }
            false
        }
    }
}

fn arrive(sample: &Sample, kind: Kind, clock: Clock, meter: &Meter, writer: &Writer<Arrived>) {
    let at = clock.now();
    let payload = sample.payload();
    // An oversized payload goes on empty: the reader refuses it like every other that cannot be read.
    let payload = if payload.len() <= kind.max_bytes() { payload.clone() } else { zenoh::bytes::ZBytes::new() };
    if !writer.push(Arrived { key: sample.key_expr().as_str().to_owned(), payload, at }) {
        meter.count_dropped();
    }
}

#[derive(Debug)]
enum Raw {
    Plain { _subscriber: zenoh::pubsub::Subscriber<()> },
    WithHistory { _subscriber: AdvancedSubscriber<()> },
}

/// A message that came in.
#[derive(Debug, Clone, PartialEq)]
pub struct Received<M> {
    /// On which key.
    pub key: Key,
    /// When, on the session's clock ([`super::Options::clock`]), stamped before it waited in the ring.
    pub arrived: Timestamp,
    /// What.
    pub message: M,
}

/// Receives messages of one type.
#[derive(Debug)]
pub struct Subscriber<M> {
    _raw: Raw,
    ring: Arc<Ring<Arrived>>,
    meter: Arc<Meter>,
    refused: u64,
    named: BTreeSet<String>,
    message: PhantomData<fn() -> M>,
}

impl<M: Message> Subscriber<M> {
    /// The next message that can be read; `None` once the session is closed.
    pub async fn recv(&mut self) -> Option<Received<M>> {
        loop {
            let arrived = self.ring.recv().await?;
            if let Some(received) = self.read(&arrived) {
                return Some(received);
            }
        }
    }

    /// The next message, if there is one now.
    pub fn try_recv(&mut self) -> Option<Received<M>> {
        loop {
            let arrived = self.ring.try_recv()?;
            if let Some(received) = self.read(&arrived) {
                return Some(received);
            }
        }
    }

    /// Messages dropped because the reader was too slow.
    pub fn dropped(&self) -> u64 {
        self.ring.dropped()
    }

    /// Messages that could not be read, or named another robot than their key.
    pub fn refused(&self) -> u64 {
        self.refused
    }

    fn read(&mut self, arrived: &Arrived) -> Option<Received<M>> {
        match read::<M>(arrived) {
            Ok(received) => {
                let robot = received.key.robot_id();
                self.meter.count(robot, M::KIND, Direction::Received, arrived.payload.len());
                Some(received)
            }
            Err(why) => {
                self.refused += 1;
                self.meter.count_refused();
                if self.named.len() < MAX_REFUSED_NAMED && self.named.insert(arrived.key.clone()) {
                    tracing::warn!(
                        key = arrived.key,
                        "message refused (further ones from there are only counted): {why}"
                    );
                }
                None
            }
        }
    }
}

fn read<M: Message>(arrived: &Arrived) -> Result<Received<M>, String> {
    let key: Key = arrived.key.parse().map_err(|error| format!("{error}"))?;
    let message: M = codec::decode(&arrived.payload.to_bytes()).map_err(|error| error.to_string())?;
    if !key.fits(message.subject()) {
        return Err(format!("it names {:?}", message.subject()));
    }
    Ok(Received { key, arrived: arrived.at, message })
}
