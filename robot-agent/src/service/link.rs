//! Everything that an agent declares on its session.

use protocol::id::{RobotId, TeamId};
use protocol::key::{Key, Pattern, RobotTopic};
use protocol::message::{
    Alarm, Announcement, ClockProbe, Command, Edges, Health, Observation, PictureKind, Surroundings,
};
use protocol::transport::{
    AliveToken, AskedPicture, AskedRecent, Presences, Publisher, Questions, Subscriber, Transport, TransportError,
};
use tokio::sync::mpsc;
use tokio::task::JoinSet;

use super::waiting::Question;

/// Questions on their way from their keys to the network task.
const MAX_QUESTIONS_ON_THE_WAY: usize = 32;

/// Publishers, subscribers, questions and the token of one agent.
#[derive(Debug)]
pub struct Link {
    pub announcement: Publisher<Announcement>,
    pub observation: Publisher<Observation>,
    pub alarm: Publisher<Alarm>,
    pub health: Publisher<Health>,
    pub edges: Publisher<Edges>,
    pub announcements: Subscriber<Announcement>,
    pub surroundings: Subscriber<Surroundings>,
    pub leaders: Presences,
    pub questions: mpsc::Receiver<Question>,
    pub recent_asked: Questions<AskedRecent>,
    _forwarders: JoinSet<()>,
    _alive: AliveToken,
}

impl Link {
    /// Declares all of it; the token last: who sees it finds the rest.
    pub async fn declare(transport: &Transport, team: TeamId, robot: RobotId) -> Result<Self, TransportError> {
        let key = |topic| Key::robot(team, robot, topic);
        let (sender, questions) = mpsc::channel(MAX_QUESTIONS_ON_THE_WAY);
        let mut forwarders = JoinSet::new();
        let clocks: Questions<ClockProbe> = transport.answer(key(RobotTopic::Clock)).await?;
        forward(&mut forwarders, clocks, Question::Clock, &sender);
        let commands: Questions<Command> = transport.answer(key(RobotTopic::Command)).await?;
        forward(&mut forwarders, commands, Question::Command, &sender);
        for kind in PictureKind::ALL {
            let pictures: Questions<AskedPicture> = transport.answer(key(RobotTopic::Picture(kind))).await?;
            forward(&mut forwarders, pictures, Question::Picture, &sender);
        }
        Ok(Self {
            announcement: transport.publish(key(RobotTopic::Announcement)).await?,
            observation: transport.publish(key(RobotTopic::Observation)).await?,
            alarm: transport.publish(key(RobotTopic::Alarm)).await?,
            health: transport.publish(key(RobotTopic::Health)).await?,
            edges: transport.publish(key(RobotTopic::Edges)).await?,
            announcements: transport.subscribe(Pattern::EveryRobot(team, RobotTopic::Announcement)).await?,
            surroundings: transport.subscribe(Key::surroundings(team, robot)).await?,
            leaders: transport.watch(Pattern::EveryLeader(team)).await?,
            questions,
            recent_asked: transport.answer(key(RobotTopic::Observation)).await?,
            _forwarders: forwarders,
            _alive: transport.declare_alive(key(RobotTopic::Alive)).await?,
        })
    }
}

/// Brings the questions of one key to the common queue. Waiting here is harmless: the key's own ring is bounded.
fn forward<Q: protocol::transport::Question>(
    forwarders: &mut JoinSet<()>,
    mut questions: Questions<Q>,
    wrap: fn(protocol::transport::Asked<Q>) -> Question,
    sender: &mpsc::Sender<Question>,
) {
    let sender = sender.clone();
    forwarders.spawn(async move {
        while let Some(asked) = questions.recv().await {
            if sender.send(wrap(asked)).await.is_err() {
                break;
            }
        }
    });
}
