//! What the agent says, on its way to the network: a bounded queue that never makes the agent wait.
//!
//! A network that does not keep up costs messages. Of what comes again anyway (observations, health) the oldest goes first,
//! since the present is worth more; alarms, announcements and answers stay as long as there is anything periodic to drop.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::Notify;

use crate::agent::Output;

/// Outputs that wait for the network task.
pub const MAX_OUTPUTS: usize = 256;

/// The reader's end.
#[derive(Debug)]
pub struct Outputs(Arc<Queue>);

/// The writer's end; dropping it ends the queue.
#[derive(Debug)]
pub struct Outbox(Arc<Queue>);

#[derive(Debug)]
struct Queue {
    state: Mutex<State>,
    changed: Notify,
    dropped: Arc<AtomicU64>,
}

#[derive(Debug, Default)]
struct State {
    items: VecDeque<Output>,
    closed: bool,
}

/// A queue; what it drops is counted in `dropped`.
pub fn queue(dropped: Arc<AtomicU64>) -> (Outbox, Outputs) {
    let queue = Arc::new(Queue { state: Mutex::default(), changed: Notify::new(), dropped });
    (Outbox(queue.clone()), Outputs(queue))
}

impl Outbox {
    /// Queues all of it.
    pub fn send(&self, out: &mut Vec<Output>) {
        if out.is_empty() {
            return;
        }
        let mut state = self.0.lock();
        for output in out.drain(..) {
            if state.items.len() >= MAX_OUTPUTS {
                let periodic = state.items.iter().position(is_periodic).unwrap_or(0);
                state.items.remove(periodic);
                self.0.dropped.fetch_add(1, Ordering::Relaxed);
            }
            state.items.push_back(output);
        }
        drop(state);
        self.0.changed.notify_one();
    }
}

impl Outputs {
    /// The next output; `None` once the agent has ended and all is read.
    pub async fn recv(&mut self) -> Option<Output> {
        loop {
            {
                let mut state = self.0.lock();
                if let Some(output) = state.items.pop_front() {
                    return Some(output);
                }
                if state.closed {
                    return None;
                }
            }
            // One permit is kept, so a push between the lock and here is not missed.
            self.0.changed.notified().await;
        }
    }
}

impl Queue {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Outbox {
    fn drop(&mut self) {
        self.0.lock().closed = true;
        self.0.changed.notify_one();
    }
}

fn is_periodic(output: &Output) -> bool {
    matches!(output, Output::Observation(_) | Output::Health(_))
}

#[cfg(test)]
mod tests {
    use protocol::id::RobotId;
    use protocol::message::{Alarm, AlarmKind, Motion, Observation, Stages};
    use protocol::time::Timestamp;

    use super::*;

    #[tokio::test]
    async fn the_oldest_observations_go_first_and_alarms_stay() {
        let dropped = Arc::new(AtomicU64::new(0));
        let (outbox, mut outputs) = queue(dropped.clone());
        for number in 0..10 {
            outbox.send(&mut vec![alarm(number)]);
        }
        for sequence in 0..1000 {
            outbox.send(&mut vec![observation(sequence)]);
        }
        drop(outbox);
        let (mut alarms, mut sequences) = (Vec::new(), Vec::new());
        while let Some(output) = outputs.recv().await {
            match output {
                Output::Alarm(alarm) => alarms.push(alarm.number),
                Output::Observation(observation) => sequences.push(observation.sequence),
                _ => {}
            }
        }
        assert_eq!(alarms, (0..10).collect::<Vec<_>>());
        assert_eq!(sequences, (754..1000).collect::<Vec<_>>());
        assert_eq!(dropped.load(Ordering::Relaxed), 754);
    }

    fn alarm(number: u32) -> Output {
        let robot = RobotId::new("r1").unwrap();
        Output::Alarm(Alarm { robot, epoch: 1, number, at: Timestamp(1), kind: AlarmKind::SelfMotion })
    }

    fn observation(sequence: u32) -> Output {
        Output::Observation(Observation {
            epoch: 1,
            sequence,
            capture: Timestamp(1),
            motion: Motion::Standing,
            odometry: None,
            stages: Stages::ALL,
            sightings: Vec::new(),
            tracks: Vec::new(),
        })
    }
}
