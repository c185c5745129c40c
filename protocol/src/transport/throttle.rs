//! A sender that floods is cut down to what its kind may have, before it waits in the common ring: one robot, mad or hostile,
//! must not push out what the others say. A token bucket a key; what is over is refused and counted.
//!
//! Zenoh's own downsampling would not do: it counts by connection, so that behind another leader all robots would share one
//! allowance, and it has no burst, so that a link that stalls for a moment would lose honest messages.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use crate::codec::Kind;

/// Senders with a bucket of their own; later ones share one.
const MAX_SENDERS: usize = 1024;

/// How much a sender of one kind may send.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pace {
    /// Messages a second, in the long run.
    pub per_second: f64,
    /// Messages at once, after silence or a stalled link.
    pub burst: f64,
}

/// What a robot may send of a kind: above what any honest agent does (120 frames a second, a history of alarms at once). `None` for
/// what only leaders publish or what is asked for.
pub fn pace(kind: Kind) -> Option<Pace> {
    let (per_second, burst) = match kind {
        Kind::Observation => (150.0, 300.0),
        Kind::Alarm => (50.0, 300.0),
        Kind::Health => (5.0, 20.0),
        Kind::Announcement | Kind::Edges => (2.0, 20.0),
        _ => return None,
    };
    Some(Pace { per_second, burst })
}

/// The buckets of one subscriber.
#[derive(Debug)]
pub(super) struct Throttle {
    pace: Pace,
    senders: Mutex<BTreeMap<String, Bucket>>,
}

#[derive(Debug, Clone, Copy)]
struct Bucket {
    tokens: f64,
    filled: Instant,
    told: bool,
}

/// What becomes of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Admission {
    /// It goes on.
    Admitted,
    /// It is over the pace. `first`: of this sender, for the first time.
    Refused { first: bool },
}

impl Throttle {
    pub(super) fn new(kind: Kind) -> Option<Self> {
        pace(kind).map(|pace| Self { pace, senders: Mutex::default() })
    }

    /// Whether a message on this key goes on.
    pub(super) fn admit(&self, key: &str, now: Instant) -> Admission {
        let mut senders = self.senders.lock().unwrap_or_else(PoisonError::into_inner);
        let known = senders.contains_key(key) || senders.len() < MAX_SENDERS;
        let key = if known { key } else { "" };
        if !senders.contains_key(key) {
            senders.insert(key.to_owned(), Bucket { tokens: self.pace.burst, filled: now, told: false });
        }
        let Some(bucket) = senders.get_mut(key) else { return Admission::Admitted };
        let gained = now.saturating_duration_since(bucket.filled).as_secs_f64() * self.pace.per_second;
        bucket.tokens = (bucket.tokens + gained).min(self.pace.burst);
        bucket.filled = now;
        if bucket.tokens >= 1.0 {
            bucket.tokens -= 1.0;
            return Admission::Admitted;
        }
        Admission::Refused { first: !std::mem::replace(&mut bucket.told, true) }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn a_flood_is_cut_to_its_pace_and_the_others_lose_nothing() {
        let throttle = Throttle::new(Kind::Observation).unwrap();
        let Pace { per_second, burst } = throttle.pace;
        let start = Instant::now();
        let (mut admitted, mut told) = (0, 0);
        // 10 000 a second for 10 s, beside an honest robot at 120 Hz.
        for n in 0..100_000u64 {
            let now = start + Duration::from_micros(100 * n);
            match throttle.admit("mad", now) {
                Admission::Admitted => admitted += 1,
                Admission::Refused { first } => told += u32::from(first),
            }
            if n % 83 == 0 {
                assert_eq!(throttle.admit("honest", now), Admission::Admitted);
            }
        }
        let allowed = burst + 10.0 * per_second;
        assert!((f64::from(admitted) - allowed).abs() < 3.0, "{admitted} of {allowed}");
        assert_eq!(told, 1);
    }

    #[test]
    fn a_stalled_link_that_comes_back_loses_nothing() {
        let throttle = Throttle::new(Kind::Observation).unwrap();
        let start = Instant::now();
        for frame in 0..240 {
            // Two seconds at 120 Hz, all at once.
            assert_eq!(throttle.admit("r1", start), Admission::Admitted, "{frame}");
        }
    }

    #[test]
    fn senders_beyond_the_limit_share_one_bucket() {
        let throttle = Throttle::new(Kind::Health).unwrap();
        let now = Instant::now();
        for n in 0..MAX_SENDERS + 5000 {
            throttle.admit(&n.to_string(), now);
        }
        assert!(throttle.senders.lock().unwrap().len() <= MAX_SENDERS + 1);
        assert_eq!(throttle.admit("yet another", now), Admission::Refused { first: false });
        assert_eq!(throttle.admit("1", now), Admission::Admitted);
    }
}
