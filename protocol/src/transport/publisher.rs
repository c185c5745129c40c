//! Publishers: one key, one message type, the QoS of its kind.

use std::marker::PhantomData;
use std::sync::Arc;
use std::time::Duration;

use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh_ext::{AdvancedPublisher, AdvancedPublisherBuilderExt, CacheConfig, MissDetectionConfig};

use super::Transport;
use super::error::{TransportError, words};
use super::qos::qos;
use crate::codec::{self, Kind, Message};
use crate::key::Key;
use crate::meter::{Direction, Meter};

/// How long after a message its number is told again, so that subscribers notice a lost last one.
const HEARTBEAT: Duration = Duration::from_secs(1);

impl Transport {
    /// A publisher of `M` on its key.
    ///
    /// # Errors
    /// The session is closed, or refuses.
    pub async fn publish<M: Message>(&self, key: Key) -> Result<Publisher<M>, TransportError> {
        let raw = self.declare_publisher(key, M::KIND).await?;
        Ok(Publisher { raw, meter: self.meter.clone(), key, message: PhantomData })
    }

    /// A publisher of text (the map as JSON) on its key.
    ///
    /// # Errors
    /// The session is closed, or refuses.
    pub async fn publish_text(&self, key: Key) -> Result<TextPublisher, TransportError> {
        let raw = self.declare_publisher(key, Kind::MapJson).await?;
        Ok(TextPublisher { raw, meter: self.meter.clone(), key })
    }

    async fn declare_publisher(&self, key: Key, kind: Kind) -> Result<Raw, TransportError> {
        let refused = |error: zenoh::Error| TransportError::Declare { key: key.to_string(), reason: words(&error) };
        let qos = qos(kind);
        let encoding =
            if kind == Kind::MapJson { Encoding::APPLICATION_JSON } else { Encoding::APPLICATION_OCTET_STREAM };
        let plain = self
            .session
            .declare_publisher(key.to_string())
            .encoding(encoding)
            .priority(qos.priority)
            .congestion_control(qos.congestion)
            .reliability(qos.reliability)
            .express(qos.express);
        if qos.kept == 0 {
            return Ok(Raw::Plain(plain.await.map_err(refused)?));
        }
        // Numbered samples: without them the cache would want timestamps on the session.
        let numbering = MissDetectionConfig::default();
        let numbering = if qos.recovered { numbering.sporadic_heartbeat(HEARTBEAT) } else { numbering };
        let cached = plain
            .cache(CacheConfig::default().max_samples(qos.kept))
            .sample_miss_detection(numbering)
            .publisher_detection()
            .await
            .map_err(refused)?;
        Ok(Raw::Cached(cached))
    }
}

#[derive(Debug)]
enum Raw {
    Plain(zenoh::pubsub::Publisher<'static>),
    Cached(AdvancedPublisher<'static>),
}

impl Raw {
    fn put(&self, payload: Vec<u8>) -> zenoh::Result<()> {
        match self {
            Self::Plain(publisher) => publisher.put(payload).wait(),
            Self::Cached(publisher) => publisher.put(payload).wait(),
        }
    }

    async fn has_listeners(&self) -> bool {
        let status = match self {
            Self::Plain(publisher) => publisher.matching_status().await,
            Self::Cached(publisher) => publisher.matching_status().await,
        };
        status.is_ok_and(|status| status.matching())
    }
}

/// Publishes messages of one type on one key. Dropping it undeclares it; what it kept for late joiners goes with it.
#[derive(Debug)]
pub struct Publisher<M> {
    raw: Raw,
    meter: Arc<Meter>,
    key: Key,
    message: PhantomData<fn(M)>,
}

impl<M: Message> Publisher<M> {
    /// Sends a message and gives the bytes of its envelope. Never waits for a reader: no published kind blocks. While
    /// nobody is connected the message goes nowhere, or into what is kept for late joiners.
    ///
    /// # Errors
    /// The message is illegal or the session is closed.
    pub fn put(&self, message: &M) -> Result<usize, TransportError> {
        let envelope = codec::encode(message)?;
        let len = envelope.len();
        put(&self.raw, &self.meter, self.key, M::KIND, envelope)?;
        Ok(len)
    }

    /// The key.
    pub fn key(&self) -> Key {
        self.key
    }

    /// Whether at least one subscriber matches.
    pub async fn has_listeners(&self) -> bool {
        self.raw.has_listeners().await
    }
}

/// Publishes text on one key.
#[derive(Debug)]
pub struct TextPublisher {
    raw: Raw,
    meter: Arc<Meter>,
    key: Key,
}

impl TextPublisher {
    /// Sends a text.
    ///
    /// # Errors
    /// The session is closed.
    pub fn put(&self, text: String) -> Result<(), TransportError> {
        put(&self.raw, &self.meter, self.key, Kind::MapJson, text.into_bytes())
    }

    /// Whether at least one subscriber matches: without one, the text need not even be written.
    pub async fn has_listeners(&self) -> bool {
        self.raw.has_listeners().await
    }
}

fn put(raw: &Raw, meter: &Meter, key: Key, kind: Kind, payload: Vec<u8>) -> Result<(), TransportError> {
    let len = payload.len();
    raw.put(payload).map_err(|error| TransportError::Send { key: key.to_string(), reason: words(&error) })?;
    meter.count(key.robot_id(), kind, Direction::Sent, len);
    Ok(())
}
