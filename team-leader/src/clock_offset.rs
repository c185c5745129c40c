//! How far a robot's clock is from the leader's.
//!
//! Problem: bearings of two robots meet only at one instant, but their clocks differ, and a message's delay is unknown.
//!
//! Insight: a four-timestamp probe (sent t₁ and returned t₄ on the leader's clock, received t₂ and replied t₃ on the
//! robot's) bounds the offset θ = robot − leader without any assumption about delays: a message never arrives before it
//! was sent, so t₃ − t₄ ≤ θ ≤ t₂ − t₁.
//!
//! Algorithm: intersect the intervals of all probes, each widened by the drift that two clocks may have since. What is
//! left is the certain interval; its middle is the estimate, and as nothing inside is preferred its standard deviation is
//! that of a uniform distribution, width/√12. An empty intersection means that a clock was stepped: the newest probe starts anew.
//! (The idea of Marzullo, and of NTP's round-trip bound.)

use protocol::message::ClockReply;
use protocol::time::Timestamp;

/// Least standard deviation: stamps are taken by a scheduler, seconds.
const LEAST_SIGMA_S: f64 = 2e-5;
/// Probes whose round trip is longer say nothing worth keeping, seconds.
const LONGEST_ROUND_TRIP_S: f64 = 10.0;

/// What all probes of one robot say.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClockOffset {
    /// Bounds of robot − leader, seconds, at `at`.
    low_s: f64,
    high_s: f64,
    at: Timestamp,
    max_drift: f64,
}

impl ClockOffset {
    /// From the first probe; `None` where its stamps contradict causality (the reply left before the probe came, or the
    /// round trip was negative or absurd).
    pub fn from_reply(reply: &ClockReply, arrived: Timestamp, max_drift: f64) -> Option<Self> {
        let (low_s, high_s) = interval(reply, arrived)?;
        Some(Self { low_s, high_s, at: arrived, max_drift })
    }

    /// Narrows the interval by another probe; false where the reply is unusable and was ignored.
    pub fn narrow(&mut self, reply: &ClockReply, arrived: Timestamp) -> bool {
        let Some((low_s, high_s)) = interval(reply, arrived) else { return false };
        let widening_s = self.widening_s(arrived);
        let (kept_low_s, kept_high_s) = (self.low_s - widening_s, self.high_s + widening_s);
        let (both_low_s, both_high_s) = (kept_low_s.max(low_s), kept_high_s.min(high_s));
        (self.low_s, self.high_s) = if both_low_s <= both_high_s { (both_low_s, both_high_s) } else { (low_s, high_s) };
        self.at = arrived;
        true
    }

    /// robot − leader, seconds.
    pub fn offset_s(&self) -> f64 {
        0.5 * (self.low_s + self.high_s)
    }

    /// Standard deviation at leader time `now`, seconds.
    pub fn sigma_s(&self, now: Timestamp) -> f64 {
        let width_s = self.high_s - self.low_s + 2.0 * self.widening_s(now);
        (width_s / 12f64.sqrt()).max(LEAST_SIGMA_S)
    }

    /// Half the width of the interval in which the offset is for certain, at leader time `now`, seconds.
    pub fn half_width_s(&self, now: Timestamp) -> f64 {
        0.5 * (self.high_s - self.low_s) + self.widening_s(now)
    }

    /// A stamp of the robot on the leader's clock.
    pub fn leader_time(&self, robot_time: Timestamp) -> Timestamp {
        robot_time.offset_by_secs(-self.offset_s())
    }

    /// The robot's stamp of a time of the leader's clock.
    pub fn robot_time(&self, leader_time: Timestamp) -> Timestamp {
        leader_time.offset_by_secs(self.offset_s())
    }

    fn widening_s(&self, now: Timestamp) -> f64 {
        now.seconds_since(self.at).abs() * self.max_drift
    }
}

/// The interval of one probe; the bounds are differences of large numbers, taken in integers by `seconds_since`.
fn interval(reply: &ClockReply, arrived: Timestamp) -> Option<(f64, f64)> {
    let low_s = reply.replied.seconds_since(arrived);
    let high_s = reply.received.seconds_since(reply.probe_sent);
    let held_s = reply.replied.seconds_since(reply.received);
    let round_trip_s = arrived.seconds_since(reply.probe_sent);
    (held_s >= 0.0 && low_s <= high_s && (0.0..LONGEST_ROUND_TRIP_S).contains(&round_trip_s)).then_some((low_s, high_s))
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};

    use super::*;

    fn reply(sent_s: f64, out_s: f64, held_s: f64, back_s: f64, offset_s: f64) -> (ClockReply, Timestamp) {
        let t = |s: f64| Timestamp::from_secs_f64(1e6 + s);
        let reply = ClockReply {
            probe_sent: t(sent_s),
            received: t(sent_s + out_s + offset_s),
            replied: t(sent_s + out_s + held_s + offset_s),
            epoch: 1,
        };
        (reply, t(sent_s + out_s + held_s + back_s))
    }

    #[test]
    fn the_true_offset_is_always_inside_whatever_the_delays() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        for _ in 0..200 {
            let offset_s = rng.random_range(-0.02..0.02);
            let mut clock: Option<ClockOffset> = None;
            let mut at_s = 0.0;
            for _ in 0..20 {
                let (r, arrived) = reply(
                    at_s,
                    rng.random_range(1e-4..0.02),
                    rng.random_range(0.0..0.01),
                    rng.random_range(1e-4..0.02),
                    offset_s,
                );
                match &mut clock {
                    Some(c) => assert!(c.narrow(&r, arrived)),
                    None => clock = ClockOffset::from_reply(&r, arrived, 0.0),
                }
                at_s += 0.1;
                let c = clock.unwrap();
                assert!(c.low_s - 1e-6 <= offset_s && offset_s <= c.high_s + 1e-6);
            }
            let c = clock.unwrap();
            let half_width_s = c.sigma_s(c.at) * 3f64.sqrt();
            assert!((c.offset_s() - offset_s).abs() <= half_width_s + 1e-6);
            assert!(c.sigma_s(c.at) < 3e-3, "twenty probes narrow it");
        }
    }

    #[test]
    fn a_stepped_clock_starts_a_new_interval() {
        let (r, a) = reply(0.0, 0.001, 0.0, 0.001, 0.01);
        let mut clock = ClockOffset::from_reply(&r, a, 50e-6).unwrap();
        let (r, a) = reply(1.0, 0.001, 0.0, 0.001, 5.0);
        assert!(clock.narrow(&r, a));
        assert!((clock.offset_s() - 5.0).abs() < 1e-5);
    }

    #[test]
    fn drift_widens_what_is_known_with_age() {
        let (r, a) = reply(0.0, 1e-4, 0.0, 1e-4, 0.0);
        let clock = ClockOffset::from_reply(&r, a, 50e-6).unwrap();
        assert!(clock.sigma_s(a.offset_by_secs(100.0)) > 2e-3);
    }

    #[test]
    fn a_reply_that_breaks_causality_is_ignored() {
        let (mut r, a) = reply(0.0, 0.001, 0.0, 0.001, 0.0);
        r.replied = r.received.offset_by_secs(-1.0);
        assert_eq!(ClockOffset::from_reply(&r, a, 50e-6), None);
        let (r, a) = reply(0.0, 0.001, 0.0, -0.5, 0.0);
        assert_eq!(ClockOffset::from_reply(&r, a, 50e-6), None);
    }
}
