//! Clock probes under way: each is a question of its own, so that a robot that does not answer delays nobody.

use std::time::Duration;

use protocol::host_clock::Clock;
use protocol::id::{RobotId, TeamId};
use protocol::key::{Key, RobotTopic};
use protocol::message::{ClockProbe, ClockReply};
use protocol::transport::{Answered, Transport};
use tokio::sync::mpsc;
use tokio::task::JoinSet;

/// An answer later than this says little about the clock.
const ANSWER_LIMIT: Duration = Duration::from_secs(1);
/// Most probes under way; the leader repeats what is left out.
const MAX_UNDER_WAY: usize = 256;

/// Asks robots for their time.
#[derive(Debug)]
pub struct Probes {
    transport: Transport,
    team: TeamId,
    clock: Clock,
    under_way: JoinSet<()>,
    sender: mpsc::Sender<(RobotId, Answered<ClockReply>)>,
    receiver: mpsc::Receiver<(RobotId, Answered<ClockReply>)>,
}

impl Probes {
    /// Nobody is asked yet.
    pub fn new(transport: Transport, team: TeamId, clock: Clock) -> Self {
        let (sender, receiver) = mpsc::channel(MAX_UNDER_WAY);
        Self { transport, team, clock, under_way: JoinSet::new(), sender, receiver }
    }

    /// Sends a probe. Its time of sending is set here, at the last moment.
    pub fn ask(&mut self, robot: RobotId, _probe: ClockProbe) {
        while self.under_way.try_join_next().is_some() {}
        if self.under_way.len() >= MAX_UNDER_WAY {
            return;
        }
        let (transport, clock, sender) = (self.transport.clone(), self.clock, self.sender.clone());
        let key = Key::robot(self.team, robot, RobotTopic::Clock);
        self.under_way.spawn(async move {
            let probe = ClockProbe { sent: clock.now() };
            match transport.ask(key, &probe, ANSWER_LIMIT).await {
                // The queue is as long as there are probes.
                Ok(answered) => drop(sender.try_send((robot, answered))),
                Err(error) => tracing::debug!("clock probe: {error}"),
            }
        });
    }

    /// The next answer.
    pub async fn recv(&mut self) -> Option<(RobotId, Answered<ClockReply>)> {
        self.receiver.recv().await
    }
}
