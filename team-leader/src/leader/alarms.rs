//! Alarms, each once: by (robot, epoch, number), however often and from whomever they come.
//!
//! Agents keep their alarms for late joiners, and a journal of them over restarts; a leader that joins, reconnects or takes over
//! gets them again. What was had before is told from what is new by the numbers alone.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use protocol::id::RobotId;
use protocol::message::Alarm;
use protocol::message::map::{MAX_ALARMS, MAX_ROBOTS};
use protocol::time::Timestamp;

/// How long an alarm is shown in the map, seconds.
pub const SHOWN_S: f64 = 10.0;
/// Sessions of a robot whose numbers are remembered.
const MAX_SESSIONS: usize = 16;
/// Numbers of a session that are remembered; older ones count as had.
const MAX_NUMBERS: usize = 512;

/// What was heard.
#[derive(Debug, Default)]
pub struct AlarmLog {
    had: BTreeMap<RobotId, BTreeMap<u64, Numbers>>,
    count: u64,
    recent: VecDeque<(Timestamp, Alarm)>,
}

#[derive(Debug, Default)]
struct Numbers {
    /// All below count as had.
    floor: u32,
    had: BTreeSet<u32>,
    /// Count of alarms at which one was had last.
    last: u64,
}

impl AlarmLog {
    /// Takes an alarm that came at `now`; false where it was had before.
    pub fn take(&mut self, now: Timestamp, alarm: &Alarm) -> bool {
        if !self.mark(alarm.robot, alarm.epoch, alarm.number) {
            return false;
        }
        if self.recent.len() >= MAX_ALARMS {
            self.recent.pop_front();
        }
        self.recent.push_back((now, alarm.clone()));
        true
    }

    /// Marks an alarm as had (it stands in the record of the session before); false where it was already.
    pub fn mark(&mut self, robot: RobotId, epoch: u64, number: u32) -> bool {
        if self.had.len() >= MAX_ROBOTS && !self.had.contains_key(&robot) {
            return false;
        }
        let sessions = self.had.entry(robot).or_default();
        if sessions.len() >= MAX_SESSIONS && !sessions.contains_key(&epoch) {
            // Not the lowest epoch: a robot without a clock of its own begins with an old one.
            let oldest = sessions.iter().min_by_key(|(_, numbers)| numbers.last).map(|(epoch, _)| *epoch);
            oldest.and_then(|oldest| sessions.remove(&oldest));
        }
        let numbers = sessions.entry(epoch).or_default();
        self.count += 1;
        numbers.last = self.count;
        if number < numbers.floor || !numbers.had.insert(number) {
            return false;
        }
        if numbers.had.len() > MAX_NUMBERS
            && let Some(lowest) = numbers.had.pop_first()
        {
            numbers.floor = lowest + 1;
        }
        true
    }

    /// What came of late, oldest first.
    pub fn recent(&self, now: Timestamp) -> Vec<Alarm> {
        let shown = self.recent.iter().filter(|(at, _)| (0.0..=SHOWN_S).contains(&now.seconds_since(*at)));
        shown.map(|(_, alarm)| alarm.clone()).collect()
    }
}

#[cfg(test)]
mod tests {
    use protocol::message::AlarmKind;

    use super::*;

    #[test]
    fn an_alarm_counts_once_whatever_the_order_and_how_often_it_comes() {
        let mut log = AlarmLog::default();
        let mut taken = Vec::new();
        for number in [3, 0, 1, 3, 2, 0, 1, 2, 4, 4] {
            if log.take(at(0.0), &alarm(7, number)) {
                taken.push(number);
            }
        }
        assert_eq!(taken, [3, 0, 1, 2, 4]);
        assert!(log.take(at(0.0), &alarm(8, 0)), "another session counts anew");
    }

    #[test]
    fn alarms_are_shown_for_a_while_and_memory_is_bounded() {
        let mut log = AlarmLog::default();
        for number in 0..2000 {
            assert!(log.take(at(f64::from(number) * 0.1), &alarm(1, number)));
        }
        assert_eq!(log.recent(at(200.0)).len(), MAX_ALARMS);
        assert!(log.recent(at(220.0)).is_empty());
        assert!(!log.take(at(200.0), &alarm(1, 5)), "an old one is not new again");
        for epoch in 0..100 {
            log.take(at(200.0), &alarm(epoch, 0));
        }
        assert!(log.had.values().all(|sessions| sessions.len() <= MAX_SESSIONS));
    }

    fn at(s: f64) -> Timestamp {
        Timestamp::from_secs_f64(1000.0 + s)
    }

    fn alarm(epoch: u64, number: u32) -> Alarm {
        Alarm { robot: RobotId::new("r1").unwrap(), epoch, number, at: at(0.0), kind: AlarmKind::SceneChanged }
    }
}
