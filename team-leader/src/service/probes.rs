//! Questions to robots under way, each by itself, so that a robot that does not answer delays nobody.

use std::time::Duration;

use protocol::host_clock::Clock;
use protocol::id::{RobotId, TeamId};
use protocol::key::{Key, RobotTopic};
use protocol::message::{ClockProbe, ClockReply, Recent};
use protocol::transport::{Answered, AskError, AskedRecent, Transport};
use tokio::sync::mpsc;
use tokio::task::JoinSet;

/// An answer later than this says little about the clock.
const ANSWER_LIMIT: Duration = Duration::from_secs(1);
/// What a robot saw before is of no use later than this.
const RECENT_LIMIT: Duration = Duration::from_millis(500);
/// Most questions under way; the leader repeats the probes that are left out.
const MAX_UNDER_WAY: usize = 256;

/// What a robot answers.
#[derive(Debug)]
pub enum Told {
    /// What its clock says.
    Clock(Answered<ClockReply>),
    /// What it has seen of late.
    Recent(Answered<Recent>),
}

/// Asks robots for their time, and for what they have seen of late.
#[derive(Debug)]
pub struct Probes {
    transport: Transport,
    team: TeamId,
    clock: Clock,
    under_way: JoinSet<()>,
    sender: mpsc::Sender<(RobotId, Told)>,
    receiver: mpsc::Receiver<(RobotId, Told)>,
}

impl Probes {
    /// Nobody is asked yet.
    pub fn new(transport: Transport, team: TeamId, clock: Clock) -> Self {
        let (sender, receiver) = mpsc::channel(MAX_UNDER_WAY);
        Self { transport, team, clock, under_way: JoinSet::new(), sender, receiver }
    }

    /// Sends a probe. Its time of sending is set here, at the last moment.
    pub fn ask(&mut self, robot: RobotId, _probe: ClockProbe) {
        let (transport, clock) = (self.transport.clone(), self.clock);
        let key = Key::robot(self.team, robot, RobotTopic::Clock);
        self.start(robot, async move {
            let probe = ClockProbe { sent: clock.now() };
            transport.ask(key, &probe, ANSWER_LIMIT).await.map(Told::Clock)
        });
    }

    /// Asks for what the robot has seen of late.
    pub fn recall(&mut self, robot: RobotId) {
        let transport = self.transport.clone();
        let key = Key::robot(self.team, robot, RobotTopic::Observation);
        self.start(robot, async move { transport.ask(key, &AskedRecent, RECENT_LIMIT).await.map(Told::Recent) });
    }

    fn start(&mut self, robot: RobotId, question: impl Future<Output = Result<Told, AskError>> + Send + 'static) {
        while self.under_way.try_join_next().is_some() {}
        if self.under_way.len() >= MAX_UNDER_WAY {
            return;
        }
        let sender = self.sender.clone();
        self.under_way.spawn(async move {
            match question.await {
                // The queue is as long as there are questions.
                Ok(told) => drop(sender.try_send((robot, told))),
                Err(error) => tracing::debug!("robot {robot}: {error}"),
            }
        });
    }

    /// The next answer.
    pub async fn recv(&mut self) -> Option<(RobotId, Told)> {
        self.receiver.recv().await
    }
}
