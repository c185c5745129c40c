//! The one instant at which all robots of a team begin to replay.

use protocol::message::{ClockProbe, ReplayStart};
use protocol::time::Timestamp;

use crate::config::Replay;

/// Known from the start, or once enough robots have joined.
#[derive(Debug)]
pub struct CommonStart {
    rule: Option<Replay>,
    start: Option<Timestamp>,
}

impl CommonStart {
    /// By a rule; without one robots ask in vain and are told so by silence in the answer.
    pub fn new(rule: Option<Replay>) -> Self {
        let start = match rule {
            Some(Replay::At(start)) => Some(start),
            _ => None,
        };
        Self { rule, start }
    }

    /// So many robots are there now.
    pub fn joined(&mut self, present: usize, now: Timestamp) {
        let Some(Replay::WhenJoined { robots, delay_s }) = self.rule else { return };
        if self.start.is_none() && present >= robots {
            self.start = Some(now.offset_by_secs(delay_s));
            tracing::info!("{present} robots have joined: recordings begin in {delay_s} s");
        }
    }

    /// Another leader gave this start.
    pub fn adopt(&mut self, start: Timestamp) {
        if self.rule.is_some() {
            self.start = self.start.or(Some(start));
        }
    }

    /// The start, once it is known.
    pub fn start(&self) -> Option<Timestamp> {
        self.start
    }

    /// The answer to a robot that asks.
    pub fn answer(&self, probe: ClockProbe, received: Timestamp, now: Timestamp) -> ReplayStart {
        ReplayStart { probe_sent: probe.sent, received, replied: now, start: self.start }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recordings_begin_once_when_enough_robots_have_joined() {
        let mut start = CommonStart::new(Some(Replay::WhenJoined { robots: 2, delay_s: 1.5 }));
        let answer = |start: &CommonStart| start.answer(ClockProbe { sent: Timestamp(1) }, Timestamp(2), Timestamp(3));
        start.joined(1, Timestamp(10_000_000_000));
        assert_eq!(answer(&start).start, None);
        start.joined(2, Timestamp(20_000_000_000));
        start.joined(3, Timestamp(30_000_000_000));
        assert_eq!(answer(&start).start, Some(Timestamp(21_500_000_000)));
    }

    #[test]
    fn a_given_instant_is_given_to_everybody_at_once() {
        let start = CommonStart::new(Some(Replay::At(Timestamp(7))));
        let answer = start.answer(ClockProbe { sent: Timestamp(1) }, Timestamp(2), Timestamp(3));
        assert_eq!(
            answer,
            ReplayStart {
                probe_sent: Timestamp(1),
                received: Timestamp(2),
                replied: Timestamp(3),
                start: Some(Timestamp(7))
            }
        );
    }
}
