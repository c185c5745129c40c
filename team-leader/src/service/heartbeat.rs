//! The liveliness token follows the work: whoever computes nothing must not look alive.
//!
//! A thread of its own watches the loop that does the work. When that stops beating, the token goes; when it beats again, the
//! token comes back. (A frozen or killed process loses the token by its session.)

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use protocol::key::Key;
use protocol::transport::{Transport, TransportError};

/// A loop that has not come round for so long does not work.
pub const SILENT_AFTER: Duration = Duration::from_millis(700);
/// Between two looks.
const LOOK_PERIOD: Duration = Duration::from_millis(100);

/// Keeps the token while somebody beats; dropping it gives the token back.
#[derive(Debug)]
pub struct Heartbeat {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug)]
struct Shared {
    start: Instant,
    /// Milliseconds since the start.
    last: AtomicU64,
    ended: AtomicBool,
}

impl Heartbeat {
    /// Declares the token and watches from now on.
    ///
    /// # Errors
    /// The session refuses the token, or the system gives no thread.
    pub fn start(transport: Transport, key: Key) -> Result<Self, TransportError> {
        let shared = Arc::new(Shared { start: Instant::now(), last: AtomicU64::new(0), ended: AtomicBool::new(false) });
        let mut token = Some(transport.declare_alive_blocking(key)?);
        let seen = shared.clone();
        let watch = move || {
            while !seen.ended.load(Ordering::Relaxed) {
                std::thread::park_timeout(LOOK_PERIOD);
                let works = seen.silent_for() < SILENT_AFTER;
                if !works && token.take().is_some() {
                    tracing::error!("the leader computes nothing: it is not shown as alive until it does");
                }
                if works && token.is_none() {
                    match transport.declare_alive_blocking(key) {
                        Ok(declared) => token = Some(declared),
                        Err(error) => tracing::debug!("{error}"),
                    }
                }
            }
        };
        let started = std::thread::Builder::new().name("heartbeat".to_owned()).spawn(watch);
        let refused =
            |error: std::io::Error| TransportError::Declare { key: key.to_string(), reason: error.to_string() };
        Ok(Self { shared, thread: Some(started.map_err(refused)?) })
    }

    /// The loop has come round.
    pub fn beat(&self) {
        self.shared.last.store(self.shared.start.elapsed().as_millis() as u64, Ordering::Relaxed);
    }
}

impl Shared {
    fn silent_for(&self) -> Duration {
        self.start.elapsed().saturating_sub(Duration::from_millis(self.last.load(Ordering::Relaxed)))
    }
}

impl Drop for Heartbeat {
    fn drop(&mut self) {
        self.shared.ended.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            // A panic has been reported where it happened.
            let _ = thread.join();
        }
    }
}
