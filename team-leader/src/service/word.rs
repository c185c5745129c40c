//! What the leader tells single robots: where to go, and who is round them. Publishers are declared when there is something to tell.

use std::collections::BTreeMap;

use protocol::codec::Message;
use protocol::id::{RobotId, TeamId};
use protocol::key::Key;
use protocol::message::map::MAX_ROBOTS;
use protocol::message::{Guidance, Surroundings};
use protocol::transport::{Publisher, Transport};

use super::desk::log_unsent;

/// The publishers.
#[derive(Debug, Default)]
pub struct Word {
    guidance: ByRobot<Guidance>,
    surroundings: ByRobot<Surroundings>,
}

impl Word {
    /// Tells a robot where to go.
    pub fn guide(&mut self, guidance: Guidance) {
        self.guidance.put(guidance.robot, guidance);
    }

    /// Tells a robot who is round it.
    pub fn show(&mut self, surroundings: Surroundings) {
        self.surroundings.put(surroundings.robot, surroundings);
    }

    /// The session is another: nothing is declared in it.
    pub fn clear(&mut self) {
        *self = Self::default();
    }

    /// Declares publishers for robots that are told something for the first time, and tells them.
    pub async fn declare(&mut self, transport: &Transport, team: TeamId) {
        self.guidance.declare(transport, |robot| Key::guidance(team, robot)).await;
        self.surroundings.declare(transport, |robot| Key::surroundings(team, robot)).await;
    }
}

#[derive(Debug)]
struct ByRobot<M> {
    publishers: BTreeMap<RobotId, Publisher<M>>,
    /// For robots that have no publisher yet; the last of each robot.
    undelivered: BTreeMap<RobotId, M>,
}

impl<M> Default for ByRobot<M> {
    fn default() -> Self {
        Self { publishers: BTreeMap::new(), undelivered: BTreeMap::new() }
    }
}

impl<M: Message> ByRobot<M> {
    fn put(&mut self, robot: RobotId, message: M) {
        match self.publishers.get(&robot) {
            Some(publisher) => log_unsent(publisher.put(&message)),
            None if self.undelivered.len() < MAX_ROBOTS => {
                self.undelivered.insert(robot, message);
            }
            None => {}
        }
    }

    async fn declare(&mut self, transport: &Transport, key: impl Fn(RobotId) -> Key) {
        while let Some((robot, message)) = self.undelivered.pop_first() {
            match transport.publish(key(robot)).await {
                Ok(publisher) => {
                    log_unsent(publisher.put(&message));
                    self.publishers.insert(robot, publisher);
                }
                Err(error) => tracing::error!("{error}"),
            }
        }
    }
}
