//! The agent's thread: takes what waits in the mailbox, looks at the clock between the stages of a frame, hands out what
//! the agent says.

use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use protocol::host_clock::Clock;

use super::mailbox::{Item, Mailbox};
use super::queue::Outbox;
use super::source::{Captured, LiveSource};
use crate::agent::{Agent, Input, Progress};

/// Longest sleep of an idle agent: its deadlines follow the wall clock, which may be set.
const LONGEST_IDLE: Duration = Duration::from_millis(500);

/// Starts the agent's thread. It ends when the mailbox is closed; `on_panic` is dropped then.
pub fn start_agent(
    mut agent: Agent,
    clock: Clock,
    mailbox: Arc<Mailbox>,
    outbox: Outbox,
    on_panic: impl Send + 'static,
) -> std::io::Result<JoinHandle<()>> {
    std::thread::Builder::new().name(format!("agent {}", agent.robot())).spawn(move || {
        let _on_panic = on_panic;
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
/// `on_panic` is dropped at its end.
pub fn start_capture(
    mut source: Box<dyn LiveSource>,
    clock: Clock,
    mailbox: Arc<Mailbox>,
    on_panic: impl Send + 'static,
    ended: impl FnOnce() + Send + 'static,
) -> std::io::Result<JoinHandle<()>> {
    std::thread::Builder::new().name("capture".to_owned()).spawn(move || {
        let _on_panic = on_panic;
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
