//! The host's clock, for the shells: the cores are told the time.
//!
//! It is read once, and runs on steadily from there: whoever sets the host's clock (chrony's `makestep`, a person) while a
//! program runs moves none of its stamps. Two programs of one host may then differ by the step; leaders measure that.
//!
//! Robots of a simulated team live on one host but their clocks differ: each gets the host's clock and a fixed offset.

use std::sync::OnceLock;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use crate::time::Timestamp;

/// The host's wall clock as it was at the program's start, running on, plus a fixed offset.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Clock {
    offset_ns: i64,
}

impl Clock {
    /// The host's clock itself.
    pub fn system() -> Self {
        Self::default()
    }

    /// The host's clock plus `offset_ns` nanoseconds.
    pub fn with_offset_ns(offset_ns: i64) -> Self {
        Self { offset_ns }
    }

    /// The present instant on this clock. A host whose clock stands before 1970 reads as the epoch.
    pub fn now(&self) -> Timestamp {
        static START: OnceLock<(Instant, Duration)> = OnceLock::new();
        let (start, since_epoch) = START
            .get_or_init(|| (Instant::now(), SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or(Duration::ZERO)));
        let ns = u64::try_from((*since_epoch + start.elapsed()).as_nanos()).unwrap_or(u64::MAX);
        Timestamp(ns.saturating_add_signed(self.offset_ns))
    }

    /// How long to wait until `instant`; zero when it has passed.
    pub fn until(&self, instant: Timestamp) -> Duration {
        Duration::from_nanos(instant.0.saturating_sub(self.now().0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_offset_clock_differs_from_the_hosts_by_its_offset() {
        let before = Clock::system().now();
        let shifted = Clock::with_offset_ns(-20_000_000).now();
        let after = Clock::system().now();
        assert!(shifted.seconds_since(before) >= -0.020 && shifted.seconds_since(after) <= -0.020);
    }

    #[test]
    fn an_instant_that_has_passed_needs_no_waiting() {
        assert_eq!(Clock::system().until(Timestamp(1)), Duration::ZERO);
    }
}
