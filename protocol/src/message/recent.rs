//! What a robot has seen of late, for a leader that comes late.

use bincode::{Decode, Encode};

use crate::codec::{self, EncodeError, Invalid, Kind, Message, bounded_decode, check};
use crate::message::Observation;

/// Most observations that are told: more than a leader uses.
pub const MAX_RECENT: usize = 32;

/// A robot's last observations.
#[derive(Debug, Clone, PartialEq, Default, Encode, Decode)]
pub struct Recent {
    /// Oldest first (≤ [`MAX_RECENT`]).
    pub observations: Vec<Observation>,
}

impl Recent {
    /// The newest of `observations` (oldest first), as many as a message holds.
    ///
    /// # Errors
    /// One of them may not be sent: it has not been, either.
    pub fn newest(observations: impl DoubleEndedIterator<Item = Observation>) -> Result<Self, EncodeError> {
        let mut newest = Vec::new();
        let mut bytes = 0;
        for observation in observations.rev().take(MAX_RECENT) {
            bytes += codec::encode(&observation)?.len();
            if bytes > Kind::Recent.max_bytes() - codec::HEADER_LEN {
                break;
            }
            newest.push(observation);
        }
        newest.reverse();
        Ok(Self { observations: newest })
    }
}

impl Message for Recent {
    const KIND: Kind = Kind::Recent;

    fn validate(&self) -> Result<(), Invalid> {
        check::count("observations", self.observations.len(), MAX_RECENT)?;
        self.observations.iter().try_for_each(Message::validate)
    }

    bounded_decode!(Kind::Recent);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::samples;

    #[test]
    fn as_many_of_the_newest_are_told_as_a_message_holds() {
        let numbered = |sequence| Observation { sequence, ..samples::observation() };
        let few = Recent::newest((0..3).map(numbered)).unwrap();
        assert_eq!(few.observations.iter().map(|o| o.sequence).collect::<Vec<_>>(), [0, 1, 2]);
        let most = Recent::newest((0..100).map(numbered)).unwrap();
        assert_eq!(most.observations.last().unwrap().sequence, 99);
        assert!(codec::encode(&most).is_ok() && most.observations.len() <= MAX_RECENT);
        // Many tracks in each: fewer fit.
        let crowd = |sequence| {
            let mut crowd = numbered(sequence);
            crowd.tracks = vec![crowd.tracks[0].clone(); 64];
            crowd
        };
        let crowded = Recent::newest((0..100).map(crowd)).unwrap();
        assert!(codec::encode(&crowded).is_ok() && crowded.observations.len() < most.observations.len());
    }
}
