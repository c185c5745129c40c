//! The agent over Zenoh: translates what comes in, stamps and sends what the [`Agent`] says, drains.
//!
//! ```text
//!  source ──▶ capture thread ──▶ ┌─────────┐ ──▶ agent thread ──▶ bounded queue ──▶ network task ──▶ Zenoh
//!                  newest wins   │ mailbox │                                        │
//!  questions ───────────────────▶└─────────┘◀───────────────────────────────────────┘
//! ```
//! Nothing here waits for the network: the agent works from the first moment, whether or not a leader is there. While nobody
//! is connected its observations go nowhere; the last announcement and the alarms are kept, and over a restart in a journal.

mod journal;
mod link;
mod mailbox;
mod network;
mod queue;
mod replay;
mod source;
mod waiting;
mod worker;

use std::future::Future;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::thread::JoinHandle;
use std::time::Duration;

use protocol::host_clock::Clock;
use protocol::id::TeamId;
use protocol::meter::Row;
use protocol::transport::{Options, TransportError, WireBytes};
use tokio::sync::Notify;

pub use journal::{Journal, JournalError};
pub use replay::{Replay, Start};
pub use source::{Captured, FrameSender, LONGEST_WAIT, LiveSource, frame_channel};

use crate::agent::Agent;
use mailbox::Mailbox;
use network::Network;

/// Time that the threads have to finish what they are doing.
const THREADS_LIMIT: Duration = Duration::from_secs(2);
/// After a recording's last frame, time to work on it before the agent stops.
const LAST_FRAME_LIMIT: Duration = Duration::from_secs(1);

/// What a service needs.
pub struct Setup {
    /// The pure agent.
    pub agent: Agent,
    /// Where frames come from.
    pub source: Box<dyn LiveSource>,
    /// The robot's clock.
    pub clock: Clock,
    /// Its team.
    pub team: TeamId,
    /// How to open the session; `clock` of the options is set from this one's.
    pub session: Options,
    /// Alarms that outlive the agent.
    pub journal: Option<Journal>,
    /// To be filled with the leader's common start, for a [`Replay`] that waits for it.
    pub start: Option<Start>,
    /// Whether the end of the source ends the service.
    pub stop_at_end: bool,
}

/// Why a service cannot work.
#[derive(Debug, thiserror::Error)]
pub enum ServiceError {
    /// The network.
    #[error(transparent)]
    Transport(#[from] TransportError),
    /// The system gives no thread.
    #[error("no thread can be started: {0}")]
    Thread(#[from] std::io::Error),
    /// A fault of this program; what it was stands in the log before.
    #[error("the {0} thread has failed")]
    Failed(String),
}

/// What a service did.
#[derive(Debug, Clone, Default)]
pub struct Summary {
    /// Frames dropped because a newer one was there.
    pub frames_dropped: u64,
    /// Messages that a full queue dropped.
    pub messages_dropped: u64,
    /// Messages that could not be read.
    pub messages_refused: u64,
    /// Traffic by robot and kind; empty if nobody was ever connected.
    pub traffic: Vec<Row>,
    /// Bytes on the links, where [`Options::measure`] was set.
    pub wire: Option<WireBytes>,
    /// What people were told.
    pub notices: Vec<String>,
}

/// Works until `shutdown` ends (or the source, where asked for), then closes the session. Needs tokio's multi-threaded runtime.
///
/// # Errors
/// A wrong endpoint, no threads. A leader that is away is no error: the agent waits and says so once.
pub async fn run(setup: Setup, shutdown: impl Future<Output = ()>) -> Result<Summary, ServiceError> {
    let Setup { agent, source, clock, team, mut session, journal, start, stop_at_end } = setup;
    session.clock = clock;
    let mailbox = Arc::new(Mailbox::default());
    let dropped = Arc::new(AtomicU64::new(0));
    let ended = Arc::new(Notify::new());
    let (outbox, outputs) = queue::queue(dropped.clone());
    let mut network = Network::new(&agent, team, clock, session, start, mailbox.clone(), dropped);
    if let Some(journal) = journal {
        network.keep_alarms(journal);
    }

    let tell = ended.clone();
    let failed = Arc::new(Notify::new());
    let threads = vec![
        worker::start_agent(agent, clock, mailbox.clone(), outbox, OnPanic(failed.clone()))?,
        worker::start_capture(source, clock, mailbox.clone(), OnPanic(failed.clone()), move || tell.notify_one())?,
    ];
    let ended = async {
        ended.notified().await;
        tracing::info!("the recording has ended");
        if !stop_at_end {
            std::future::pending::<()>().await;
        }
        tokio::time::sleep(LAST_FRAME_LIMIT).await;
    };
    let worked = tokio::select! {
        worked = network.work(outputs) => worked.map_err(ServiceError::from),
        () = shutdown => Ok(()),
        () = ended => Ok(()),
        () = failed.notified() => Ok(()),
    };
    mailbox.close();
    let joined = join(threads).await;
    let summary = network.close().await;
    worked.and(joined)?;
    Ok(summary)
}

/// Tells where a thread ends in a panic.
struct OnPanic(Arc<Notify>);

impl Drop for OnPanic {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.notify_one();
        }
    }
}

/// Waits for the threads, within limits: a camera driver that hangs must not keep the process.
///
/// # Errors
/// One of them has panicked (reported where it happened): whoever keeps the service must start it again.
async fn join(threads: Vec<JoinHandle<()>>) -> Result<(), ServiceError> {
    let joined = tokio::task::spawn_blocking(move || {
        let ends = threads.into_iter().map(|thread| {
            let name = thread.thread().name().unwrap_or_default().to_owned();
            thread.join().map_err(|_| ServiceError::Failed(name))
        });
        // All are waited for, whatever becomes of the first.
        ends.fold(Ok(()), Result::and)
    });
    match tokio::time::timeout(THREADS_LIMIT, joined).await {
        Ok(Ok(joined)) => joined,
        Ok(Err(_)) => Ok(()),
        Err(_) => {
            tracing::warn!("a thread did not end within {THREADS_LIMIT:?} and is abandoned");
            Ok(())
        }
    }
}

#[cfg(test)]
mod tests;
