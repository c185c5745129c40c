//! Which session of a robot is the one to hear, and whether two robots use one id.
//!
//! A restarted agent has a new epoch and its old one is silent: the new one is heard. Two robots of one id *both* speak: then
//! neither is used, because either may be the wrong one, until one has gone. So a new session waits until the one before has
//! been silent for a moment; if that speaks on, both are named (host, epoch).

use std::collections::BTreeMap;

use protocol::id::RobotId;
use protocol::message::Announcement;
use protocol::message::map::MAX_ROBOTS;
use protocol::time::Timestamp;

/// Most sessions remembered a robot.
const MAX_SESSIONS: usize = 16;
/// A session that has been silent for so long gives way to a new one, seconds.
const QUIET_S: f64 = 0.5;
/// What is on its way when a new session speaks may still come, seconds.
const TAIL_S: f64 = 0.3;
/// A session that has been silent for so long has gone (health comes every two seconds), seconds.
const GONE_S: f64 = 3.0;

/// The sessions of all robots.
#[derive(Debug, Default)]
pub struct Sessions {
    robots: BTreeMap<RobotId, Robot>,
}

#[derive(Debug, Default)]
struct Robot {
    sessions: Vec<Session>,
    current: Option<u64>,
    /// When a session that waits spoke first.
    challenged: Option<Timestamp>,
    conflict: bool,
}

#[derive(Debug)]
struct Session {
    epoch: u64,
    host: Option<String>,
    last: Timestamp,
    /// Its liveliness token went after its last word.
    gone: bool,
}

/// What to do with a message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Verdict {
    /// Use it.
    Use,
    /// Drop it: another session of this id speaks, or did a moment ago.
    Drop {
        /// To be told, once a conflict.
        notice: Option<String>,
    },
}

impl Sessions {
    /// Remembers who announced a session. A robot beyond [`MAX_ROBOTS`] is not remembered, and always heard.
    pub fn announced(&mut self, now: Timestamp, announcement: &Announcement) -> Verdict {
        let verdict = self.heard(now, announcement.robot, announcement.epoch);
        let session = self.robots.get_mut(&announcement.robot).and_then(|robot| robot.session(announcement.epoch));
        if let Some(session) = session {
            session.host = Some(announcement.host.clone());
        }
        verdict
    }

    /// Judges a message of a session that came at `now`.
    pub fn heard(&mut self, now: Timestamp, id: RobotId, epoch: u64) -> Verdict {
        if self.robots.len() >= MAX_ROBOTS && !self.robots.contains_key(&id) {
            return Verdict::Use;
        }
        let robot = self.robots.entry(id).or_default();
        robot.spoke(now, epoch);
        if robot.conflict {
            robot.conflict = robot.sessions.iter().any(|s| s.epoch != epoch && s.is_live(now, GONE_S));
            if robot.conflict {
                return Verdict::Drop { notice: None };
            }
            robot.settle(epoch);
            return Verdict::Use;
        }
        let Some(current) = robot.current.filter(|current| *current != epoch) else {
            return robot.current_spoke(now, id, epoch);
        };
        if robot.session(current).is_some_and(|s| s.is_live(now, QUIET_S)) {
            robot.challenged.get_or_insert(now);
            return Verdict::Drop { notice: None };
        }
        robot.settle(epoch);
        Verdict::Use
    }

    /// The robot's liveliness token has gone: a next session need not wait.
    pub fn gone(&mut self, id: RobotId) {
        if let Some(robot) = self.robots.get_mut(&id).filter(|robot| !robot.conflict)
            && let Some(current) = robot.current
            && let Some(session) = robot.session(current)
        {
            session.gone = true;
        }
    }

    /// Whether messages of this session are used.
    pub fn is_heard(&self, id: RobotId, epoch: u64) -> bool {
        self.robots.get(&id).is_none_or(|robot| !robot.conflict && robot.current == Some(epoch))
    }

    /// Whether two sessions of this id speak.
    pub fn in_conflict(&self, id: RobotId) -> bool {
        self.robots.get(&id).is_some_and(|robot| robot.conflict)
    }
}

impl Robot {
    fn session(&mut self, epoch: u64) -> Option<&mut Session> {
        self.sessions.iter_mut().find(|session| session.epoch == epoch)
    }

    fn spoke(&mut self, now: Timestamp, epoch: u64) {
        if let Some(session) = self.session(epoch) {
            session.last = session.last.max(now);
            session.gone = false;
            return;
        }
        if self.sessions.len() >= MAX_SESSIONS {
            let oldest = (0..self.sessions.len()).min_by_key(|k| self.sessions[*k].last);
            oldest.map(|k| self.sessions.remove(k));
        }
        self.sessions.push(Session { epoch, host: None, last: now, gone: false });
    }

    /// The session that is heard, or the first, spoke.
    fn current_spoke(&mut self, now: Timestamp, id: RobotId, epoch: u64) -> Verdict {
        let rival = self.sessions.iter().find(|s| s.epoch != epoch && s.is_live(now, GONE_S)).map(|s| s.epoch);
        match (self.current, self.challenged, rival) {
            (Some(_), Some(since), Some(rival)) if now.seconds_since(since) > TAIL_S => {
                self.conflict = true;
                Verdict::Drop { notice: Some(self.notice(id, epoch, rival)) }
            }
            (Some(_), Some(_), Some(_)) => Verdict::Use,
            _ => {
                self.settle(epoch);
                Verdict::Use
            }
        }
    }

    fn settle(&mut self, epoch: u64) {
        self.current = Some(epoch);
        self.challenged = None;
    }

    fn notice(&self, id: RobotId, one: u64, other: u64) -> String {
        let host = |epoch| {
            let session = self.sessions.iter().find(|session| session.epoch == epoch);
            session.and_then(|session| session.host.as_deref()).unwrap_or("an unknown host")
        };
        format!(
            "two robots use the id {id}: session {one:016x} on {} and session {other:016x} on {}; neither is used until one \
             goes; give one of them another [robot] id",
            host(one),
            host(other)
        )
    }
}

impl Session {
    fn is_live(&self, now: Timestamp, within_s: f64) -> bool {
        !self.gone && now.seconds_since(self.last) <= within_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_restarted_agent_is_heard_without_a_word() {
        let mut sessions = Sessions::default();
        for (at_s, epoch) in [(0.0, 1), (0.1, 1), (1.0, 2), (1.1, 2), (3.0, 3)] {
            assert_eq!(sessions.heard(at(at_s), r1(), epoch), Verdict::Use, "{at_s}");
        }
    }

    #[test]
    fn an_agent_that_restarts_at_once_is_heard_when_its_old_session_is_silent_or_its_token_has_gone() {
        let mut sessions = Sessions::default();
        assert_eq!(sessions.heard(at(0.0), r1(), 1), Verdict::Use);
        assert_eq!(sessions.heard(at(0.1), r1(), 2), Verdict::Drop { notice: None });
        // What was on its way.
        assert_eq!(sessions.heard(at(0.15), r1(), 1), Verdict::Use);
        assert_eq!(sessions.heard(at(0.2), r1(), 2), Verdict::Drop { notice: None });
        assert_eq!(sessions.heard(at(0.7), r1(), 2), Verdict::Use);
        sessions.gone(r1());
        assert_eq!(sessions.heard(at(0.75), r1(), 3), Verdict::Use);
    }

    #[test]
    fn of_two_robots_of_one_id_neither_is_used_until_one_goes_and_both_are_named_once() {
        let mut sessions = Sessions::default();
        let mut notices = Vec::new();
        let mut used = Vec::new();
        for tick in 0..70 {
            let now_s = 0.1 * f64::from(tick);
            // Beta comes at 1 s; alpha goes at 3 s.
            for (epoch, host, here) in [(1, "alpha", now_s < 3.0), (2, "beta", now_s > 1.0)] {
                if here {
                    match sessions.announced(at(now_s), &announcement(epoch, host)) {
                        Verdict::Use => used.push((tick, epoch)),
                        Verdict::Drop { notice } => notices.extend(notice),
                    }
                }
            }
            if !(1.3..1.6).contains(&now_s) && !(5.7..6.2).contains(&now_s) {
                assert_eq!(sessions.in_conflict(r1()), (1.5..6.0).contains(&now_s), "{now_s}");
                assert_eq!(sessions.is_heard(r1(), 1), now_s < 1.5, "{now_s}");
            }
        }
        assert_eq!(notices.len(), 1, "{notices:?}");
        for part in ["r1", "alpha", "beta", "0000000000000001", "0000000000000002", "neither"] {
            assert!(notices[0].contains(part), "{part} is missing in {}", notices[0]);
        }
        assert!(used.iter().filter(|(tick, _)| (16..47).contains(tick)).count() == 0, "{used:?}");
        assert!(used.iter().all(|(tick, epoch)| (*epoch == 1) == (*tick < 16)), "{used:?}");
        assert!(used.contains(&(65, 2)));
    }

    fn at(s: f64) -> Timestamp {
        Timestamp::from_secs_f64(1000.0 + s)
    }

    fn r1() -> RobotId {
        RobotId::new("r1").unwrap()
    }

    fn announcement(epoch: u64, host: &str) -> Announcement {
        Announcement { epoch, host: host.to_owned(), ..crate::leader::tests::world::announcement(r1()) }
    }
}
