//! The team over Zenoh: typed publishers, subscribers, questions and presence. The only place that knows Zenoh.
//!
//! Zenoh gives what a team needs (brokering by a leader's own process, history for late joiners, liveliness), and traps
//! that this module keeps from the programs: a full channel stops a session, a blocking put closes a transport, closing may
//! take 10 s, a single-threaded runtime panics. Here nothing that comes in waits for anybody: subscribers read bounded
//! rings that drop the oldest and count it, and every call has a time limit.
//!
//! ```no_run
//! # use protocol::{id::*, key::*, message::*, transport::*};
//! # async fn run(team: TeamId, observation: Observation) -> Result<(), Box<dyn std::error::Error>> {
//! let leader = Transport::open(Options::router(["tcp/127.0.0.1:0"])).await?;
//! let mut seen = leader.subscribe::<Observation>(Pattern::EveryRobot(team, RobotTopic::Observation)).await?;
//!
//! let agent = Transport::open(Options::client(leader.locators().await)).await?;
//! let r1 = RobotId::new("r1")?;
//! let alive = agent.declare_alive(Key::robot(team, r1, RobotTopic::Alive)).await?;
//! let publisher = agent.publish::<Observation>(Key::robot(team, r1, RobotTopic::Observation)).await?;
//! publisher.put(&observation)?;
//!
//! while let Some(received) = seen.recv().await {
//!     println!("{} at {}", received.key, received.message.capture);
//! }
//! # Ok(()) }
//! ```

mod error;
mod maps;
mod options;
mod presence;
mod publisher;
mod qos;
mod question;
mod ring;
mod subscriber;
#[cfg(test)]
mod tests;
mod throttle;

use std::sync::Arc;
use std::time::Duration;

pub use error::{AskError, TransportError};
pub use maps::Maps;
pub use options::{HANDSHAKE_LIMIT, LEASE, MAX_MESSAGE_BYTES, MAX_SESSIONS, Options, RETRY, Role};
pub use presence::{AliveToken, Presences, Sign};
pub use publisher::{Publisher, TextPublisher};
pub use qos::{Qos, qos};
pub use question::{
    Answered, Asked, AskedMap, AskedMapJson, AskedPicture, AskedRecent, AskedReplayStart, EncodedPicture,
    MAX_WAITING_QUESTIONS, Question, Questions,
};
pub use subscriber::{Received, Subscriber};
pub use throttle::{Pace, pace};

use zenoh::Wait;

use crate::board::Board;
use crate::meter::Meter;
use crate::security::{Security, preflight};
use error::words;

/// Time that closing a session may take. Zenoh itself would allow 10 s on a bad link.
pub const CLOSE_LIMIT: Duration = Duration::from_secs(2);
/// Time in which a session that is closed can be followed by another: its endpoints may be in use for a moment.
pub const REOPEN_LIMIT: Duration = Duration::from_secs(5);
/// One attempt of a client that waits for ever. After the first it says so; whoever gives up waiting is rid of it after this time.
const ATTEMPT_LIMIT: Duration = Duration::from_secs(1);
/// Time that the session's own counters may take to answer.
const COUNTERS_LIMIT: Duration = Duration::from_secs(1);

/// One session of a program. Cheap to clone; [`Transport::close`] ends it for all clones.
#[derive(Debug, Clone)]
pub struct Transport {
    session: zenoh::Session,
    options: Arc<Options>,
    meter: Arc<Meter>,
}

/// What went over a session's links, by Zenoh's own count: everything but TCP/IP's headers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WireBytes {
    /// Out.
    pub sent: u64,
    /// In.
    pub received: u64,
}

impl Transport {
    /// Opens a session. A router returns at once and connects in the background; a client waits for its first connection,
    /// for ever where [`Options::connect_limit`] is `None` (dropping the future gives up).
    ///
    /// # Errors
    /// Wrong endpoints or configuration, a port that is taken, nobody there in time, a single-threaded runtime.
    pub async fn open(options: Options) -> Result<Self, TransportError> {
        Self::open_with(options, Arc::default()).await
    }

    /// Closes this session and opens another with the same settings at the same endpoints: for a program that the others have
    /// given up, or that does not find them any more. What was declared is gone, for all clones; what the meter has counted
    /// goes on. A client waits for ever.
    ///
    /// # Errors
    /// A router's cannot be opened within [`REOPEN_LIMIT`].
    pub async fn reopen(self) -> Result<Self, TransportError> {
        let mut options = (*self.options).clone();
        options.connect_limit = None;
        if options.listen.iter().any(|endpoint| endpoint.ends_with(":0")) {
            options.listen = self.locators().await;
        }
        let meter = self.meter.clone();
        if let Err(error) = self.close().await {
            tracing::warn!("{error}");
        }
        let until = tokio::time::Instant::now() + REOPEN_LIMIT;
        loop {
            match Self::open_with(options.clone(), meter.clone()).await {
                Err(error) if tokio::time::Instant::now() < until => tracing::debug!("{error}"),
                opened => return opened,
            }
            tokio::time::sleep(RETRY[0]).await;
        }
    }

    async fn open_with(options: Options, meter: Arc<Meter>) -> Result<Self, TransportError> {
        // Zenoh panics in a single-threaded runtime.
        let runtime = tokio::runtime::Handle::try_current().map_err(|_| TransportError::Runtime)?;
        if runtime.runtime_flavor() == tokio::runtime::RuntimeFlavor::CurrentThread {
            return Err(TransportError::Runtime);
        }
        let waits_for_ever = options.role == Role::Client && options.connect_limit.is_none();
        let attempt = match waits_for_ever {
            true => Options { connect_limit: Some(ATTEMPT_LIMIT), ..options.clone() },
            false => options.clone(),
        };
        let mut waiting_was_said = false;
        let session = loop {
            let config = attempt.to_zenoh()?;
            // Zenoh's `open` blocks its thread until it is connected, awaited or not.
            let opened = tokio::task::spawn_blocking(move || zenoh::open(config).wait()).await;
            let reason = match opened {
                Ok(Ok(session)) => break session,
                Ok(Err(error)) => words(&error),
                Err(panic) => panic.to_string(),
            };
            // Zenoh hides why a handshake failed.
            let reason = match waiting_was_said {
                true => reason,
                false => why_no_handshake(&options).await.unwrap_or(reason),
            };
            if !waits_for_ever {
                let (listen, connect) = (options.listen, options.connect);
                return Err(TransportError::Open { listen, connect, reason });
            }
            if !waiting_was_said {
                waiting_was_said = true;
                let endpoints = options.connect.join(", ");
                tracing::warn!("nobody there yet: waiting for a leader or router at {endpoints} ({reason})");
            }
            tokio::time::sleep(RETRY[0]).await;
        };
        let transport = Self { session, options: Arc::new(options), meter };
        transport.board().connected(&transport);
        Ok(transport)
    }

    /// Where this session is reached, with the real port where 0 was asked for.
    pub async fn locators(&self) -> Vec<String> {
        self.session.info().locators().await.iter().map(ToString::to_string).collect()
    }

    /// Whether at least one link to a leader or router (a client) or to anybody (a router) is up.
    pub async fn is_connected(&self) -> bool {
        self.session.info().transports().await.next().is_some()
    }

    /// Where the service shows its figures.
    pub fn board(&self) -> &Board {
        &self.options.board
    }

    /// How it was opened.
    pub fn options(&self) -> &Options {
        &self.options
    }

    /// What passed, by robot and kind, and what was dropped or refused.
    pub fn meter(&self) -> &Arc<Meter> {
        &self.meter
    }

    /// Zenoh's own count of the bytes on this session's links; `None` unless [`Options::measure`] was set.
    pub async fn wire_bytes(&self) -> Option<WireBytes> {
        if !self.options.measure {
            return None;
        }
        let own = format!("@/{}/*?_stats=true", self.session.zid());
        let replies = self.session.get(own).timeout(COUNTERS_LIMIT).await.ok()?;
        while let Ok(reply) = replies.recv_async().await {
            let Ok(sample) = reply.result() else { continue };
            let Ok(json) = serde_json::from_slice::<serde_json::Value>(&sample.payload().to_bytes()) else { continue };
            let counter = |name: &str| json["stats"][name].as_u64();
            if let (Some(sent), Some(received)) = (counter("tx_bytes"), counter("rx_bytes")) {
                return Some(WireBytes { sent, received });
            }
        }
        None
    }

    /// Closes the session within [`CLOSE_LIMIT`]: undeclares everything, so that the others see it go at once.
    ///
    /// # Errors
    /// The limit passed; the session is abandoned.
    pub async fn close(self) -> Result<(), TransportError> {
        let closing = async { self.session.close().await };
        match tokio::time::timeout(CLOSE_LIMIT, closing).await {
            Ok(Ok(())) => Ok(()),
            Ok(Err(error)) => Err(TransportError::Close { limit: CLOSE_LIMIT, reason: format!(": {}", words(&error)) }),
            Err(_) => Err(TransportError::Close { limit: CLOSE_LIMIT, reason: String::new() }),
        }
    }
}

/// What each endpoint objects to, where certificates are used.
async fn why_no_handshake(options: &Options) -> Option<String> {
    let Security::Tls(credentials) = options.security.clone() else { return None };
    let endpoints = options.connect.clone();
    let tried = tokio::task::spawn_blocking(move || {
        let problem = |endpoint: &String| preflight::probe(endpoint, &credentials).err();
        endpoints.iter().filter_map(problem).collect::<Vec<_>>()
    });
    let problems = tried.await.ok()?;
    (!problems.is_empty()).then(|| problems.join("; "))
}
