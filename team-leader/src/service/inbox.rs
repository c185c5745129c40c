//! Everything that the leader hears.

use protocol::id::TeamId;
use protocol::key::{Key, Pattern, RobotTopic};
use protocol::message::{Alarm, Announcement, Health, Observation};
use protocol::transport::{
    AskedMap, AskedMapJson, AskedReplayStart, Presences, Questions, Subscriber, Transport, TransportError,
};

/// Subscribers and questions, each with its own bounded ring.
#[derive(Debug)]
pub struct Inbox {
    pub announcements: Subscriber<Announcement>,
    pub observations: Subscriber<Observation>,
    pub alarms: Subscriber<Alarm>,
    pub healths: Subscriber<Health>,
    pub robots: Presences,
    pub leaders: Presences,
    pub map_asked: Questions<AskedMap>,
    pub json_asked: Questions<AskedMapJson>,
    pub start_asked: Questions<AskedReplayStart>,
}

impl Inbox {
    /// Declares all of it.
    pub async fn declare(transport: &Transport, team: TeamId) -> Result<Self, TransportError> {
        let every = |topic| Pattern::EveryRobot(team, topic);
        Ok(Self {
            announcements: transport.subscribe(every(RobotTopic::Announcement)).await?,
            observations: transport.subscribe(every(RobotTopic::Observation)).await?,
            alarms: transport.subscribe(every(RobotTopic::Alarm)).await?,
            healths: transport.subscribe(every(RobotTopic::Health)).await?,
            robots: transport.watch(every(RobotTopic::Alive)).await?,
            leaders: transport.watch(Pattern::EveryLeader(team)).await?,
            map_asked: transport.answer(Key::map(team)).await?,
            json_asked: transport.answer(Key::map_json(team)).await?,
            start_asked: transport.answer(Key::replay_start(team)).await?,
        })
    }
}
