//! Key expressions, built and parsed here and nowhere else.
//!
//! ```text
//! pal/{team}/robot/{robot}/alive | announcement | observation | alarm | health | edges | command | clock
//! pal/{team}/robot/{robot}/picture/{kind}
//! pal/{team}/leader/{leader}/alive | candidacy
//! pal/{team}/map
//! pal/{team}/map/json
//! pal/{team}/guidance/{robot}
//! pal/{team}/surroundings/{robot}
//! pal/{team}/replay_start
//! ```
//! A [`Key`] is one such key; a [`Pattern`] is a key or all of its like, with `*` for the robot or the leader.

use std::fmt;
use std::str::FromStr;

use crate::codec::{Kind, Subject};
use crate::id::{LeaderId, NameError, RobotId, TeamId};
use crate::message::PictureKind;
use crate::message::picture::UnknownPicture;

/// First chunk of every key.
pub const ROOT: &str = "pal";

/// One key.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Key {
    /// Whose.
    pub team: TeamId,
    /// What.
    pub topic: Topic,
}

/// What a key carries.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Topic {
    /// Something of one robot.
    Robot(RobotId, RobotTopic),
    /// Liveliness token of a leader.
    LeaderAlive(LeaderId),
    /// Where a leader stands: for the other leaders.
    Candidacy(LeaderId),
    /// The team map.
    Map,
    /// The same as JSON.
    MapJson,
    /// Where this robot should go.
    Guidance(RobotId),
    /// Who is round this robot.
    Surroundings(RobotId),
    /// Queryable: when recordings begin.
    ReplayStart,
}

/// What a robot has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum RobotTopic {
    /// Liveliness token.
    Alive,
    /// Who it is.
    Announcement,
    /// One message a frame.
    Observation,
    /// Alarms and events.
    Alarm,
    /// How it is doing.
    Health,
    /// What stands still round it.
    Edges,
    /// Queryable: a picture.
    Picture(PictureKind),
    /// Queryable: a request.
    Command,
    /// Queryable: a clock probe.
    Clock,
}

/// Why a text is not a key of ours.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum KeyError {
    /// Not below `pal/`, or no such topic.
    #[error("{0:?} is not a key of a PAL team")]
    Unknown(String),
    /// A chunk that should be a name is none.
    #[error("in the key {key:?}: {source}")]
    Name {
        /// The whole key.
        key: String,
        /// What is wrong.
        source: NameError,
    },
    /// A picture that does not exist.
    #[error("in the key {key:?}: {source}")]
    Picture {
        /// The whole key.
        key: String,
        /// What is wrong.
        source: UnknownPicture,
    },
}

impl Key {
    /// Something of a robot.
    pub fn robot(team: TeamId, robot: RobotId, topic: RobotTopic) -> Self {
        Self { team, topic: Topic::Robot(robot, topic) }
    }

    /// Liveliness token of a leader.
    pub fn leader_alive(team: TeamId, leader: LeaderId) -> Self {
        Self { team, topic: Topic::LeaderAlive(leader) }
    }

    /// Where a leader stands.
    pub fn candidacy(team: TeamId, leader: LeaderId) -> Self {
        Self { team, topic: Topic::Candidacy(leader) }
    }

    /// The team map.
    pub fn map(team: TeamId) -> Self {
        Self { team, topic: Topic::Map }
    }

    /// The team map as JSON.
    pub fn map_json(team: TeamId) -> Self {
        Self { team, topic: Topic::MapJson }
    }

    /// Where a robot should go.
    pub fn guidance(team: TeamId, robot: RobotId) -> Self {
        Self { team, topic: Topic::Guidance(robot) }
    }

    /// Who is round a robot.
    pub fn surroundings(team: TeamId, robot: RobotId) -> Self {
        Self { team, topic: Topic::Surroundings(robot) }
    }

    /// When recordings begin.
    pub fn replay_start(team: TeamId) -> Self {
        Self { team, topic: Topic::ReplayStart }
    }

    /// The robot whose key it is.
    pub fn robot_id(&self) -> Option<RobotId> {
        match self.topic {
            Topic::Robot(robot, _) | Topic::Guidance(robot) | Topic::Surroundings(robot) => Some(robot),
            _ => None,
        }
    }

    /// The kind of what is published or asked here; `None` for liveliness tokens.
    pub fn kind(&self) -> Option<Kind> {
        match self.topic {
            Topic::Robot(_, topic) => topic.kind(),
            Topic::LeaderAlive(_) => None,
            Topic::Candidacy(_) => Some(Kind::Candidacy),
            Topic::Map => Some(Kind::TeamMap),
            Topic::MapJson => Some(Kind::MapJson),
            Topic::Guidance(_) => Some(Kind::Guidance),
            Topic::Surroundings(_) => Some(Kind::Surroundings),
            Topic::ReplayStart => Some(Kind::ClockProbe),
        }
    }

    /// Whether a message that names this subject may come on this key. A robot speaks of itself only on its own keys.
    pub fn fits(&self, subject: Subject) -> bool {
        match (subject, self.robot_id()) {
            (Subject::Robot(named), Some(robot)) => named == robot,
            (Subject::Robot(_), None) => false,
            (Subject::Leader(named), None) => match self.topic {
                Topic::LeaderAlive(leader) | Topic::Candidacy(leader) => named == leader,
                _ => true,
            },
            (Subject::Leader(_), Some(_)) => false,
            (Subject::Nobody, _) => true,
        }
    }
}

impl RobotTopic {
    /// The kind of what is published or asked here; `None` for the liveliness token.
    pub fn kind(self) -> Option<Kind> {
        match self {
            Self::Alive => None,
            Self::Announcement => Some(Kind::Announcement),
            Self::Observation => Some(Kind::Observation),
            Self::Alarm => Some(Kind::Alarm),
            Self::Health => Some(Kind::Health),
            Self::Edges => Some(Kind::Edges),
            Self::Picture(_) => Some(Kind::Picture),
            Self::Command => Some(Kind::Command),
            Self::Clock => Some(Kind::ClockProbe),
        }
    }
}

impl fmt::Display for RobotTopic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Alive => f.write_str("alive"),
            Self::Announcement => f.write_str("announcement"),
            Self::Observation => f.write_str("observation"),
            Self::Alarm => f.write_str("alarm"),
            Self::Health => f.write_str("health"),
            Self::Edges => f.write_str("edges"),
            Self::Picture(kind) => write!(f, "picture/{kind}"),
            Self::Command => f.write_str("command"),
            Self::Clock => f.write_str("clock"),
        }
    }
}

impl fmt::Display for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let team = self.team;
        match &self.topic {
            Topic::Robot(robot, topic) => write!(f, "{ROOT}/{team}/robot/{robot}/{topic}"),
            Topic::LeaderAlive(leader) => write!(f, "{ROOT}/{team}/leader/{leader}/alive"),
            Topic::Candidacy(leader) => write!(f, "{ROOT}/{team}/leader/{leader}/candidacy"),
            Topic::Map => write!(f, "{ROOT}/{team}/map"),
            Topic::MapJson => write!(f, "{ROOT}/{team}/map/json"),
            Topic::Guidance(robot) => write!(f, "{ROOT}/{team}/guidance/{robot}"),
            Topic::Surroundings(robot) => write!(f, "{ROOT}/{team}/surroundings/{robot}"),
            Topic::ReplayStart => write!(f, "{ROOT}/{team}/replay_start"),
        }
    }
}

impl FromStr for Key {
    type Err = KeyError;

    fn from_str(text: &str) -> Result<Self, KeyError> {
        let shown = || text.chars().take(128).collect::<String>();
        let unknown = || KeyError::Unknown(shown());
        let name = |source| KeyError::Name { key: shown(), source };
        let mut chunks = text.split('/');
        if chunks.next() != Some(ROOT) {
            return Err(unknown());
        }
        let team = TeamId::new(chunks.next().ok_or_else(unknown)?).map_err(name)?;
        // At most four chunks follow; a fifth makes the key unknown.
        let rest: Vec<&str> = chunks.take(5).collect();
        let topic = match rest[..] {
            ["robot", robot, ref topic @ ..] => {
                Topic::Robot(RobotId::new(robot).map_err(name)?, robot_topic(topic, &shown)?)
            }
            ["leader", leader, "alive"] => Topic::LeaderAlive(LeaderId::new(leader).map_err(name)?),
            ["leader", leader, "candidacy"] => Topic::Candidacy(LeaderId::new(leader).map_err(name)?),
            ["map"] => Topic::Map,
            ["map", "json"] => Topic::MapJson,
            ["guidance", robot] => Topic::Guidance(RobotId::new(robot).map_err(name)?),
            ["surroundings", robot] => Topic::Surroundings(RobotId::new(robot).map_err(name)?),
            ["replay_start"] => Topic::ReplayStart,
            _ => return Err(unknown()),
        };
        Ok(Self { team, topic })
    }
}

fn robot_topic(chunks: &[&str], shown: &dyn Fn() -> String) -> Result<RobotTopic, KeyError> {
    Ok(match chunks {
        ["alive"] => RobotTopic::Alive,
        ["announcement"] => RobotTopic::Announcement,
        ["observation"] => RobotTopic::Observation,
        ["alarm"] => RobotTopic::Alarm,
        ["health"] => RobotTopic::Health,
        ["edges"] => RobotTopic::Edges,
        ["picture", kind] => {
            RobotTopic::Picture(kind.parse().map_err(|source| KeyError::Picture { key: shown(), source })?)
        }
        ["command"] => RobotTopic::Command,
        ["clock"] => RobotTopic::Clock,
        _ => return Err(KeyError::Unknown(shown())),
    })
}

/// One key, or the same topic of every robot or leader of a team.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Pattern {
    /// Just this key.
    One(Key),
    /// This topic of every robot.
    EveryRobot(TeamId, RobotTopic),
    /// Every picture of every robot.
    EveryPicture(TeamId),
    /// Liveliness of every leader.
    EveryLeader(TeamId),
    /// Where every leader stands.
    EveryCandidacy(TeamId),
    /// Guidance for every robot.
    EveryGuidance(TeamId),
}

impl From<Key> for Pattern {
    fn from(key: Key) -> Self {
        Self::One(key)
    }
}

impl Pattern {
    /// Whether the key is among them.
    pub fn matches(&self, key: &Key) -> bool {
        match *self {
            Self::One(one) => one == *key,
            Self::EveryRobot(team, topic) => {
                team == key.team && matches!(key.topic, Topic::Robot(_, found) if found == topic)
            }
            Self::EveryPicture(team) => {
                team == key.team && matches!(key.topic, Topic::Robot(_, RobotTopic::Picture(_)))
            }
            Self::EveryLeader(team) => team == key.team && matches!(key.topic, Topic::LeaderAlive(_)),
            Self::EveryCandidacy(team) => team == key.team && matches!(key.topic, Topic::Candidacy(_)),
            Self::EveryGuidance(team) => team == key.team && matches!(key.topic, Topic::Guidance(_)),
        }
    }
}

impl fmt::Display for Pattern {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::One(key) => write!(f, "{key}"),
            Self::EveryRobot(team, topic) => write!(f, "{ROOT}/{team}/robot/*/{topic}"),
            Self::EveryPicture(team) => write!(f, "{ROOT}/{team}/robot/*/picture/*"),
            Self::EveryLeader(team) => write!(f, "{ROOT}/{team}/leader/*/alive"),
            Self::EveryCandidacy(team) => write!(f, "{ROOT}/{team}/leader/*/candidacy"),
            Self::EveryGuidance(team) => write!(f, "{ROOT}/{team}/guidance/*"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_key_is_written_as_designed_and_read_back() {
        let expected = [
            "pal/blue/robot/r1/alive",
            "pal/blue/robot/r1/announcement",
            "pal/blue/robot/r1/observation",
            "pal/blue/robot/r1/alarm",
            "pal/blue/robot/r1/health",
            "pal/blue/robot/r1/edges",
            "pal/blue/robot/r1/command",
            "pal/blue/robot/r1/clock",
            "pal/blue/robot/r1/picture/panorama",
            "pal/blue/robot/r1/picture/objects",
            "pal/blue/robot/r1/picture/gaze",
            "pal/blue/robot/r1/picture/synopsis",
            "pal/blue/robot/r1/picture/tracks",
            "pal/blue/robot/r1/picture/background",
            "pal/blue/leader/l-1/alive",
            "pal/blue/leader/l-1/candidacy",
            "pal/blue/map",
            "pal/blue/map/json",
            "pal/blue/guidance/r1",
            "pal/blue/surroundings/r1",
            "pal/blue/replay_start",
        ];
        let written: Vec<String> = every_key().iter().map(ToString::to_string).collect();
        assert_eq!(written, expected);
        for key in every_key() {
            assert_eq!(key.to_string().parse(), Ok(key));
        }
    }

    #[test]
    fn a_key_that_is_not_ours_is_refused_in_words() {
        for text in ["", "pal", "pal/blue", "pal/blue/robot/r1", "pal/blue/robot/r1/eyes", "pal/blue/map/json/x", "x/y"]
        {
            assert!(matches!(text.parse::<Key>(), Err(KeyError::Unknown(_))), "{text:?}");
        }
        for text in ["pal/Blue/map", "pal/blue/robot/*/alive", "pal/blue/leader/a b/alive", "pal//map"] {
            assert!(matches!(text.parse::<Key>(), Err(KeyError::Name { .. })), "{text:?}");
        }
        let error = "pal/blue/robot/r1/picture/raw".parse::<Key>().unwrap_err().to_string();
        assert!(error.contains("raw") && error.contains("panorama"), "{error}");
    }

    #[test]
    fn a_pattern_matches_exactly_the_keys_that_its_text_matches() {
        let team = TeamId::new("blue").unwrap();
        let mut patterns: Vec<Pattern> = every_key().into_iter().map(Pattern::One).collect();
        for key in every_key() {
            if let Topic::Robot(_, topic) = key.topic {
                patterns.push(Pattern::EveryRobot(team, topic));
            }
        }
        patterns.extend([
            Pattern::EveryPicture(team),
            Pattern::EveryLeader(team),
            Pattern::EveryCandidacy(team),
            Pattern::EveryGuidance(team),
        ]);
        for pattern in patterns {
            for key in every_key() {
                assert_eq!(
                    pattern.matches(&key),
                    text_matches(&pattern.to_string(), &key.to_string()),
                    "{pattern} {key}"
                );
            }
        }
    }

    #[test]
    fn nobody_speaks_of_another_robot_on_its_own_key() {
        let [r1, r2] = ["r1", "r2"].map(|name| RobotId::new(name).unwrap());
        let key = Key::robot(TeamId::new("blue").unwrap(), r1, RobotTopic::Alarm);
        assert!(key.fits(Subject::Robot(r1)));
        assert!(!key.fits(Subject::Robot(r2)));
        assert!(!key.fits(Subject::Leader(LeaderId::new("l").unwrap())));
    }

    fn text_matches(pattern: &str, key: &str) -> bool {
        let (pattern, key): (Vec<_>, Vec<_>) = (pattern.split('/').collect(), key.split('/').collect());
        pattern.len() == key.len() && pattern.iter().zip(&key).all(|(p, k)| *p == "*" || p == k)
    }

    fn every_key() -> Vec<Key> {
        let team = TeamId::new("blue").unwrap();
        let robot = RobotId::new("r1").unwrap();
        let mut topics = vec![
            RobotTopic::Alive,
            RobotTopic::Announcement,
            RobotTopic::Observation,
            RobotTopic::Alarm,
            RobotTopic::Health,
            RobotTopic::Edges,
            RobotTopic::Command,
            RobotTopic::Clock,
        ];
        topics.extend(PictureKind::ALL.map(RobotTopic::Picture));
        let mut keys: Vec<Key> = topics.into_iter().map(|topic| Key::robot(team, robot, topic)).collect();
        keys.extend([
            Key::leader_alive(team, LeaderId::new("l-1").unwrap()),
            Key::candidacy(team, LeaderId::new("l-1").unwrap()),
            Key::map(team),
            Key::map_json(team),
            Key::guidance(team, robot),
            Key::surroundings(team, robot),
            Key::replay_start(team),
        ]);
        keys
    }
}
