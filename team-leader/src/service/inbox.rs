//! Everything that the leader hears.

use protocol::id::TeamId;
use protocol::key::{Key, Pattern, RobotTopic};
use protocol::message::{Alarm, Announcement, Candidacy, Edges, Health, Observation, TeamMap};
use protocol::transport::{
    Asked, AskedMap, AskedMapJson, AskedReplayStart, Presences, Question, Questions, Subscriber, Transport,
    TransportError,
};

/// Subscribers and questions, each with its own bounded ring.
#[derive(Debug)]
pub struct Inbox {
    pub announcements: Subscriber<Announcement>,
    pub observations: Subscriber<Observation>,
    pub alarms: Subscriber<Alarm>,
    pub healths: Subscriber<Health>,
    pub edges: Subscriber<Edges>,
    pub robots: Presences,
    pub leaders: Presences,
    pub candidacies: Subscriber<Candidacy>,
    pub maps: Subscriber<TeamMap>,
    pub map_asked: Option<Questions<AskedMap>>,
    pub json_asked: Option<Questions<AskedMapJson>>,
    pub start_asked: Option<Questions<AskedReplayStart>>,
    team: TeamId,
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
            edges: transport.subscribe(every(RobotTopic::Edges)).await?,
            robots: transport.watch(every(RobotTopic::Alive)).await?,
            leaders: transport.watch(Pattern::EveryLeader(team)).await?,
            candidacies: transport.subscribe_others(Pattern::EveryCandidacy(team)).await?,
            maps: transport.subscribe_others(Key::map(team)).await?,
            map_asked: None,
            json_asked: None,
            start_asked: None,
            team,
        })
    }

    /// Whether questions to the team are answered here.
    pub fn answers(&self) -> bool {
        self.map_asked.is_some()
    }

    /// Takes questions to the team from now on, or no more.
    pub async fn answer(&mut self, transport: &Transport, reigns: bool) {
        (self.map_asked, self.json_asked, self.start_asked) = (None, None, None);
        if reigns && let Err(error) = self.declare_questions(transport).await {
            tracing::error!("questions to the team cannot be taken: {error}");
        }
    }

    async fn declare_questions(&mut self, transport: &Transport) -> Result<(), TransportError> {
        self.json_asked = Some(transport.answer(Key::map_json(self.team)).await?);
        self.start_asked = Some(transport.answer(Key::replay_start(self.team)).await?);
        self.map_asked = Some(transport.answer(Key::map(self.team)).await?);
        Ok(())
    }
}

/// The next question, where questions are taken.
pub async fn next<Q: Question>(questions: &mut Option<Questions<Q>>) -> Option<Asked<Q>> {
    match questions {
        Some(questions) => questions.recv().await,
        None => std::future::pending().await,
    }
}
