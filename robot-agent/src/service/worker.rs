//! The agent's thread: takes what waits in the mailbox, looks at the clock between the stages of a frame, hands out what
//! the agent says.

use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use protocol::host_clock::Clock;
use tokio::sync::mpsc::Sender;

use super::mailbox::{Item, Mailbox};
use super::source::{Captured, LiveSource};
use crate::agent::{Agent, Input, Output, Progress};

/// Longest sleep of an idle agent: its deadlines follow the wall clock, which may be set.
const LONGEST_IDLE: Duration = Duration::from_millis(500);

/// Starts the agent's thread. It ends when the mailbox is closed.
pub fn start_agent(
    mut agent: Agent,
    clock: Clock,
    mailbox: Arc<Mailbox>,
    outbox: Outbox,
) -> std::io::Result<JoinHandle<()>> {
    std::thread::Builder::new().name(format!("agent {}", agent.robot())).spawn(move || {
        let mut out = Vec::new();
        loop {
            let patience = clock.until(agent.next_deadline()).min(LONGEST_IDLE);
            match mailbox.take(patience) {
                Item::Closed => break,
                Item::Timeout => agent.handle(clock.now(), Input::Deadline, &mut out),
                Item::Event(arrival, input) => agent.handle(arrival, input, &mut out),
                Item::Frame(frame) => {
                    let mut goes_on = agent.begin_frame(clock.now(), frame, &mut out);
                    while goes_on {
                        outbox.send(&mut out);
                        while let Some((arrival, input)) = mailbox.take_event() {
                            agent.handle(arrival, input, &mut out);
                        }
                        goes_on = agent.step(clock.now(), &mut out) == Progress::More;
                    }
                }
            }
            outbox.send(&mut out);
        }
    })
}

/// Starts the source's thread. It ends with the mailbox or with the source; `ended` is called in the second case.
pub fn start_capture(
    mut source: Box<dyn LiveSource>,
    clock: Clock,
    mailbox: Arc<Mailbox>,
    ended: impl FnOnce() + Send + 'static,
) -> std::io::Result<JoinHandle<()>> {
    std::thread::Builder::new().name("capture".to_owned()).spawn(move || {
        while !mailbox.is_closed() {
            match source.next(&clock) {
                Captured::Frame(frame) => mailbox.put_frame(frame),
                Captured::Bad(what) => {
                    mailbox.put_event(clock.now(), Input::BadFrame(what));
                }
                Captured::Waiting => {}
                Captured::End => {
                    mailbox.put_event(clock.now(), Input::CaptureEnded);
                    ended();
                    break;
                }
            }
        }
    })
}

/// Where the agent's outputs go: a bounded queue to the network side. A network that does not keep up costs messages, never
/// frames.
#[derive(Debug, Clone)]
pub struct Outbox {
    queue: Sender<Output>,
    dropped: Arc<std::sync::atomic::AtomicU64>,
}

impl Outbox {
    /// An outbox in front of `queue`; messages that do not fit are counted in `dropped`.
    pub fn new(queue: Sender<Output>, dropped: Arc<std::sync::atomic::AtomicU64>) -> Self {
        Self { queue, dropped }
    }

    fn send(&self, out: &mut Vec<Output>) {
        for output in out.drain(..) {
            if self.queue.try_send(output).is_err() {
                self.dropped.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            }
        }
    }
}
