//! Whose map to believe when two leaders speak: the one of the higher term.
//!
//! Problem: a leader that was frozen, or cut off, goes on with its map when it comes back; by then another one leads.
//!
//! Insight: whoever takes over takes a term above every one it knows of. A receiver that has seen a map of a term drops every
//! lower one, so the old leader is not heard again, whatever it believes. Two sides of a partition may have taken the same
//! term: the lower name is heard until the leaders have settled it (the one that stays takes a new term).
//!
//! A fence that never fell would keep a team for ever from a leader that lost its memory together with all others. So it
//! falls when nothing has come over it for [`FENCE`]: a thawed leader that is heard then is the only one there is.

use std::time::Duration;

use crate::id::LeaderId;
use crate::time::Timestamp;

/// How long after its last map a term still keeps lower ones out.
pub const FENCE: Duration = Duration::from_secs(2);

/// Highest legal term: who takes one a second does not get there in a hundred million years, and every number up to it is
/// exact as a JSON number. A message of a higher one is refused, or nobody could take over from whoever says it.
pub const MAX_TERM: u64 = 1 << 52;

/// What a receiver of maps remembers.
#[derive(Debug, Clone, Copy, Default)]
pub struct Fence {
    accepted: Option<(u64, LeaderId, Timestamp)>,
    refused: u64,
}

impl Fence {
    /// Whether to believe a map of `leader` in `term` that came at `now` (the receiver's clock).
    pub fn admits(&mut self, now: Timestamp, leader: LeaderId, term: u64) -> bool {
        let admitted = match self.accepted {
            Some((highest, ruler, last)) => {
                term > highest
                    || (term == highest && leader <= ruler)
                    // Also after the clock was set back by more.
                    || now.seconds_since(last).abs() > FENCE.as_secs_f64()
            }
            None => true,
        };
        if admitted {
            self.accepted = Some((term, leader, now));
        } else {
            self.refused += 1;
        }
        admitted
    }

    /// The term that is believed.
    pub fn term(&self) -> Option<u64> {
        self.accepted.map(|(term, ..)| term)
    }

    /// Maps refused so far.
    pub fn refused(&self) -> u64 {
        self.refused
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lower_term_is_dropped_while_the_higher_one_speaks() {
        let mut fence = Fence::default();
        assert!(fence.admits(at(0.0), leader("l1"), 1));
        assert!(fence.admits(at(1.0), leader("l2"), 2));
        assert!(!fence.admits(at(1.1), leader("l1"), 1));
        assert!(fence.admits(at(1.2), leader("l2"), 2));
        assert_eq!((fence.refused(), fence.term()), (1, Some(2)));
    }

    #[test]
    fn of_one_term_the_lower_name_is_believed() {
        let mut fence = Fence::default();
        assert!(fence.admits(at(0.0), leader("l3"), 2));
        assert!(fence.admits(at(0.1), leader("l2"), 2));
        assert!(!fence.admits(at(0.2), leader("l3"), 2));
    }

    #[test]
    fn a_leader_without_memory_is_heard_when_nobody_else_has_spoken_for_long() {
        let mut fence = Fence::default();
        assert!(fence.admits(at(0.0), leader("l1"), 9));
        assert!(!fence.admits(at(1.9), leader("l1"), 1));
        assert!(fence.admits(at(2.1), leader("l1"), 1));
    }

    fn at(s: f64) -> Timestamp {
        Timestamp::from_secs_f64(1000.0 + s)
    }

    fn leader(name: &str) -> LeaderId {
        LeaderId::new(name).unwrap()
    }
}
