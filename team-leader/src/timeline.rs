//! When things happened, on the leader's clock.
//!
//! Observations come from clocks that differ, with delays, in bursts, twice, out of order. Each is stamped on the leader's
//! clock by its robot's offset and then admitted or refused with a reason that is counted. Admitted ones need no waiting:
//! every filter of the leader takes a measurement somewhat older than its state, so a map can leave at once.

use protocol::time::Timestamp;

/// An observation older than the newest by more says nothing about now, seconds.
pub const LATEST_S: f64 = 1.0;
/// An observation may be stamped this much after the leader's own time (clock errors), seconds.
pub const EARLIEST_S: f64 = 0.25;

/// So many newer observations in a row with lower numbers: the number before was wrong, or they are counted anew.
const RENUMBERED: u32 = 10;

/// Why an observation is not used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Refusal {
    /// Its number was had before, or a newer one was.
    OutOfOrder,
    /// Older than [`LATEST_S`].
    Late,
    /// Stamped in the future.
    Future,
}

/// The observations of one robot in time.
#[derive(Debug, Clone, Default)]
pub struct Timeline {
    epoch: Option<u64>,
    last_sequence: u32,
    last_capture: Option<Timestamp>,
    /// Newer ones in a row whose number is below the last one's.
    below: u32,
    /// Observations that never came, by their numbers.
    pub lost: u64,
    /// Refused, by reason: out of order, late, future.
    pub refused: [u64; 3],
}

/// What is known of an admitted observation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Admission {
    /// Capture on the leader's clock.
    pub at: Timestamp,
    /// Since the robot's observation before, seconds.
    pub since_last_s: Option<f64>,
    /// The robot began a new session.
    pub new_session: bool,
}

impl Timeline {
    /// Admits the observation number `sequence` of session `epoch`, captured `at` (leader's clock), or says why not.
    /// `newest` is the newest capture of the whole team, `now` the leader's time.
    pub fn admit(
        &mut self,
        epoch: u64,
        sequence: u32,
        at: Timestamp,
        newest: Option<Timestamp>,
        now: Timestamp,
    ) -> Result<Admission, Refusal> {
        let new_session = self.epoch != Some(epoch);
        let older = self.last_capture.is_some_and(|last| at <= last);
        // One wrong number must not shut a robot out for ever.
        let renumbered = sequence <= self.last_sequence && !older && {
            self.below += 1;
            self.below > RENUMBERED
        };
        let refusal = if !new_session && !renumbered && (sequence <= self.last_sequence || older) {
            Some(Refusal::OutOfOrder)
        } else if newest.is_some_and(|n| n.seconds_since(at) > LATEST_S) {
            Some(Refusal::Late)
        } else if at.seconds_since(now) > EARLIEST_S {
            Some(Refusal::Future)
        } else {
            None
        };
        if let Some(refusal) = refusal {
            self.refused[refusal as usize] += 1;
            return Err(refusal);
        }
        if !new_session && !renumbered {
            self.lost += u64::from(sequence - self.last_sequence - 1);
        }
        self.below = 0;
        let since_last_s = self.last_capture.filter(|_| !new_session).map(|last| at.seconds_since(last));
        (self.epoch, self.last_sequence, self.last_capture) = (Some(epoch), sequence, Some(at));
        Ok(Admission { at, since_last_s, new_session })
    }

    /// Observations of the session that never came, or came too late, out of order or from the future.
    pub fn lost_or_refused(&self) -> u32 {
        u32::try_from(self.lost + self.refused.iter().sum::<u64>()).unwrap_or(u32::MAX)
    }

    /// Capture of the newest admitted observation, leader's clock.
    pub fn last_capture(&self) -> Option<Timestamp> {
        self.last_capture
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Nothing here is in the future.
    const LATER: Timestamp = Timestamp(u64::MAX);

    fn at(s: f64) -> Timestamp {
        Timestamp::from_secs_f64(1000.0 + s)
    }

    #[test]
    fn an_observation_is_admitted_once_and_gaps_are_counted() {
        let mut line = Timeline::default();
        assert!(line.admit(1, 0, at(0.0), None, LATER).unwrap().new_session);
        assert_eq!(line.admit(1, 0, at(0.0), None, LATER), Err(Refusal::OutOfOrder));
        let a = line.admit(1, 3, at(0.3), None, LATER).unwrap();
        assert!((a.since_last_s.unwrap() - 0.3).abs() < 1e-9);
        assert_eq!(line.lost, 2);
        assert_eq!(line.admit(1, 2, at(0.2), None, LATER), Err(Refusal::OutOfOrder));
        assert_eq!(line.refused, [2, 0, 0]);
    }

    #[test]
    fn late_and_future_stamps_are_refused() {
        let mut line = Timeline::default();
        assert_eq!(line.admit(1, 0, at(0.0), Some(at(1.5)), LATER), Err(Refusal::Late));
        assert_eq!(line.admit(1, 0, at(9.0), None, at(1.0)), Err(Refusal::Future));
        assert_eq!(line.refused, [0, 1, 1]);
    }

    #[test]
    fn one_wrong_number_does_not_shut_a_robot_out_for_ever() {
        let mut line = Timeline::default();
        line.admit(1, 0, at(0.0), None, LATER).unwrap();
        line.admit(1, u32::MAX, at(0.1), None, LATER).unwrap();
        let admitted = (1..20).filter(|n| line.admit(1, *n, at(0.1 + 0.1 * f64::from(*n)), None, LATER).is_ok());
        assert_eq!(admitted.collect::<Vec<_>>(), (11..20).collect::<Vec<_>>());
    }

    #[test]
    fn a_restarted_agent_begins_anew() {
        let mut line = Timeline::default();
        line.admit(1, 100, at(0.0), None, LATER).unwrap();
        let a = line.admit(2, 0, at(0.1), None, LATER).unwrap();
        assert!(a.new_session && a.since_last_s.is_none());
    }
}
