//! Which session of a robot is the one to hear, and whether two robots use one id.
//!
//! A restarted agent has a new epoch and its old one falls silent. Two robots with one id *alternate*: an epoch comes back
//! after another one took over. The session that appeared last is heard; the other is dropped and told of, so that the
//! map does not jump between two robots.

use std::collections::BTreeMap;

use protocol::id::RobotId;
use protocol::message::Announcement;
use protocol::message::map::MAX_ROBOTS;

/// Most sessions remembered a robot.
const MAX_SESSIONS: usize = 16;

/// The sessions of all robots.
#[derive(Debug, Default)]
pub struct Sessions {
    robots: BTreeMap<RobotId, Robot>,
}

#[derive(Debug, Default)]
struct Robot {
    /// Epochs in the order in which they appeared; the last one is heard.
    epochs: Vec<u64>,
    hosts: BTreeMap<u64, String>,
    told: bool,
}

/// What to do with a message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Verdict {
    /// Hear it.
    Current,
    /// Drop it: another session of this id appeared later.
    Superseded {
        /// To be told, once a robot.
        notice: Option<String>,
    },
}

impl Sessions {
    /// Remembers who announced a session. A robot beyond [`MAX_ROBOTS`] is not remembered, and always heard.
    pub fn announced(&mut self, announcement: &Announcement) -> Verdict {
        if self.robots.len() < MAX_ROBOTS || self.robots.contains_key(&announcement.robot) {
            let robot = self.robots.entry(announcement.robot).or_default();
            if robot.hosts.len() >= MAX_SESSIONS {
                robot.hosts.pop_first();
            }
            robot.hosts.insert(announcement.epoch, announcement.host.clone());
        }
        self.heard(announcement.robot, announcement.epoch)
    }

    /// Judges a message of a session.
    pub fn heard(&mut self, id: RobotId, epoch: u64) -> Verdict {
        let known = self.robots.len();
        let robot = match self.robots.get_mut(&id) {
            Some(robot) => robot,
            None if known < MAX_ROBOTS => self.robots.entry(id).or_default(),
            None => return Verdict::Current,
        };
        if robot.epochs.last() == Some(&epoch) {
            return Verdict::Current;
        }
        if !robot.epochs.contains(&epoch) {
            if robot.epochs.len() >= MAX_SESSIONS {
                robot.epochs.remove(0);
            }
            robot.epochs.push(epoch);
            return Verdict::Current;
        }
        let first_time = !std::mem::replace(&mut robot.told, true);
        Verdict::Superseded { notice: first_time.then(|| robot.notice(id, epoch)) }
    }
}

impl Robot {
    fn notice(&self, id: RobotId, old: u64) -> String {
        let host = |epoch| self.hosts.get(&epoch).map_or("an unknown host", String::as_str);
        let new = self.epochs.last().copied().unwrap_or_default();
        format!(
            "two robots use the id {id}: session {new:016x} on {} is heard, session {old:016x} on {} is dropped; \
             give one of them another [robot] id",
            host(new),
            host(old)
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_restarted_agent_is_heard_without_a_word() {
        let mut sessions = Sessions::default();
        for epoch in [1, 1, 2, 2, 3] {
            assert_eq!(sessions.heard(r1(), epoch), Verdict::Current);
        }
    }

    #[test]
    fn two_robots_of_one_id_are_told_once_with_both_sessions_and_the_later_one_is_heard() {
        let mut sessions = Sessions::default();
        sessions.announced(&announcement(1, "alpha"));
        sessions.announced(&announcement(2, "beta"));
        let Verdict::Superseded { notice: Some(notice) } = sessions.heard(r1(), 1) else { panic!("not noticed") };
        for part in ["r1", "alpha", "beta", "0000000000000001", "0000000000000002"] {
            assert!(notice.contains(part), "{part} is missing in {notice}");
        }
        assert_eq!(sessions.heard(r1(), 2), Verdict::Current);
        assert_eq!(sessions.heard(r1(), 1), Verdict::Superseded { notice: None });
    }

    fn r1() -> RobotId {
        RobotId::new("r1").unwrap()
    }

    fn announcement(epoch: u64, host: &str) -> Announcement {
        use protocol::marker::Marker;
        use protocol::message::CameraSummary;
        let camera = CameraSummary {
            model: "pal".to_owned(),
            height_m: 0.6,
            height_sigma_m: 0.0,
            tilt_sigma_rad: 0.0,
            elevation_rad: [-0.2, 0.3],
            frame_rate_hz: 10.0,
        };
        let marker = Marker::Cylinder { radius_m: 0.2, height_m: [0.1, 0.5], look: None };
        Announcement { robot: r1(), epoch, host: host.to_owned(), version: String::new(), marker, camera }
    }
}
