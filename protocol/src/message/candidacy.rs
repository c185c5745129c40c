//! How leaders agree on who leads: each says several times a second, and at once after a change, where it stands.

use bincode::{Decode, Encode};

use crate::codec::{Invalid, Kind, Message, Subject, bounded_decode, check};
use crate::id::LeaderId;
use crate::message::map::MAX_ROBOTS;
use crate::time::Timestamp;

/// A leader, ruling or standing by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Encode, Decode)]
pub struct Candidacy {
    /// Who.
    pub leader: LeaderId,
    /// Its session: two programs that use one leader's id differ in it.
    pub epoch: u64,
    /// The highest term it knows of; its own while it rules (≤ [`MAX_TERM`](crate::fence::MAX_TERM)).
    pub term: u64,
    /// Whether it rules: publishes the map and answers for the team.
    pub rules: bool,
    /// How many robots it sees alive (≤ [`MAX_ROBOTS`]).
    pub robots: u16,
    /// The instant that it gave robots as the common start of recordings, leader's clock.
    pub replay_start: Option<Timestamp>,
}

impl Message for Candidacy {
    const KIND: Kind = Kind::Candidacy;

    fn validate(&self) -> Result<(), Invalid> {
        check::term("term", self.term)?;
        check::count("robots", usize::from(self.robots), MAX_ROBOTS)
    }

    fn subject(&self) -> Subject {
        Subject::Leader(self.leader)
    }

    bounded_decode!(Kind::Candidacy);
}
