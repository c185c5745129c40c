//! Instants on the wire: nanoseconds since the Unix epoch, of the clock of whoever stamps.

use std::fmt;
use std::ops::{Add, Sub};
use std::time::Duration;

use bincode::{Decode, Encode};
use serde::{Deserialize, Serialize};

/// Nanoseconds since the Unix epoch. A stamp means something only together with whose clock it is:
/// an observation carries its robot's clock, the map the leader's.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize, Encode, Decode)]
#[serde(transparent)]
pub struct Timestamp(pub u64);

impl Timestamp {
    /// From seconds since the epoch; negative and non-finite values give the epoch.
    pub fn from_secs_f64(seconds: f64) -> Self {
        Self((seconds * 1e9).max(0.0) as u64)
    }

    /// Seconds since the epoch; exact to about 0.2 µs today.
    pub fn as_secs_f64(self) -> f64 {
        self.0 as f64 * 1e-9
    }

    /// `self − earlier` in seconds, signed, exact to the nanosecond for spans below a hundred days.
    pub fn seconds_since(self, earlier: Self) -> f64 {
        match self.0.checked_signed_diff(earlier.0) {
            Some(ns) => ns as f64 * 1e-9,
            None => (i128::from(self.0) - i128::from(earlier.0)) as f64 * 1e-9,
        }
    }

    /// The instant `seconds` later (earlier where negative), clamped to the epoch.
    pub fn offset_by_secs(self, seconds: f64) -> Self {
        let ns = i128::from(self.0).saturating_add((seconds * 1e9).round() as i128);
        Self(ns.clamp(0, i128::from(u64::MAX)) as u64)
    }
}

impl Add<Duration> for Timestamp {
    type Output = Self;
    fn add(self, span: Duration) -> Self {
        Self(self.0.saturating_add(u64::try_from(span.as_nanos()).unwrap_or(u64::MAX)))
    }
}

impl Sub<Duration> for Timestamp {
    type Output = Self;
    fn sub(self, span: Duration) -> Self {
        Self(self.0.saturating_sub(u64::try_from(span.as_nanos()).unwrap_or(u64::MAX)))
    }
}

impl fmt::Display for Timestamp {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{:09}s", self.0 / 1_000_000_000, self.0 % 1_000_000_000)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_are_signed_and_exact_to_the_nanosecond() {
        let (a, b) = (Timestamp(1_790_000_000_123_456_789), Timestamp(1_790_000_000_123_456_788));
        assert_eq!((a.seconds_since(b), b.seconds_since(a)), (1e-9, -1e-9));
        assert_eq!(a.offset_by_secs(-1e-9), b);
        assert_eq!(a.to_string(), "1790000000.123456789s");
    }

    #[test]
    fn nothing_runs_over_the_ends_of_time() {
        assert_eq!(Timestamp(5) - Duration::from_secs(1), Timestamp(0));
        assert_eq!(Timestamp(u64::MAX) + Duration::MAX, Timestamp(u64::MAX));
        assert_eq!(Timestamp(5).offset_by_secs(f64::NEG_INFINITY), Timestamp(0));
        assert_eq!([-1.0, f64::NAN].map(Timestamp::from_secs_f64), [Timestamp(0); 2]);
        assert!((Timestamp(u64::MAX).seconds_since(Timestamp(0)) - 18_446_744_073.709_55).abs() < 1e-5);
    }

    #[test]
    fn an_instant_moved_by_more_than_time_there_is_stays_at_an_end() {
        let noon = Timestamp(1_700_000_000_000_000_000);
        assert_eq!(noon.offset_by_secs(3.4e38), Timestamp(u64::MAX));
        assert_eq!(noon.offset_by_secs(-3.4e38), Timestamp(0));
        assert_eq!(noon.offset_by_secs(f64::NAN), noon);
    }
}
