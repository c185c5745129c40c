//! How each message kind travels: one table.
//!
//! Nothing periodic ever blocks: a newer message is worth more than a late one, and a stuck reader must not stop the
//! sender (Zenoh closes a transport whose blocking message waits 5 s). What must arrive is small and kept by its publisher,
//! so that a subscriber fetches what it missed. Answers may block: who asked is waiting, and a frozen one is dropped after
//! the lease of 1 s.

use zenoh::qos::{CongestionControl, Priority, Reliability};

use crate::codec::Kind;

/// How a kind travels.
#[derive(Debug, Clone, Copy)]
pub struct Qos {
    /// Which goes first when a link is full.
    pub priority: Priority,
    /// What happens when it is full.
    pub congestion: CongestionControl,
    /// Marks what links with losses may lose.
    pub reliability: Reliability,
    /// Sent at once instead of waiting to share a frame.
    pub express: bool,
    /// How many the publisher keeps for late joiners; 0 for none.
    pub kept: usize,
    /// Whether subscribers fetch what was lost.
    pub recovered: bool,
    /// Messages a subscriber's ring holds for a slow reader before it drops the oldest.
    pub ring: usize,
}

/// The table.
pub fn qos(kind: Kind) -> Qos {
    use CongestionControl::{Block, Drop};
    use Priority as P;
    use Reliability::{BestEffort, Reliable};
    let row = |priority, congestion, reliability, express, kept, recovered, ring| Qos {
        priority,
        congestion,
        reliability,
        express,
        kept,
        recovered,
        ring,
    };
    #[rustfmt::skip]
    let qos = match kind {
        //                                priority            congestion  reliability  express kept recovered ring
        Kind::Announcement         => row(P::Data,            Drop,       Reliable,    false,  1,  true,     256),
        Kind::Observation          => row(P::InteractiveHigh, Drop,       BestEffort,  true,   0,  false,    512),
        Kind::Recent               => row(P::Data,            Drop,       Reliable,    false,  0,  false,     32),
        Kind::Alarm                => row(P::DataHigh,        Drop,       Reliable,    true,  64,  true,     512),
        Kind::Health               => row(P::DataLow,         Drop,       BestEffort,  false,  0,  false,    256),
        Kind::Command              => row(P::DataHigh,        Block,      Reliable,    true,   0,  false,     32),
        Kind::CommandReply         => row(P::DataHigh,        Block,      Reliable,    true,   0,  false,     32),
        Kind::ClockProbe           => row(P::RealTime,        Drop,       Reliable,    true,   0,  false,     32),
        Kind::ClockReply           => row(P::RealTime,        Drop,       Reliable,    true,   0,  false,     32),
        Kind::ReplayStart          => row(P::DataHigh,        Block,      Reliable,    true,   0,  false,     32),
        Kind::TeamMap              => row(P::DataHigh,        Drop,       BestEffort,  true,   1,  false,     16),
        Kind::Candidacy            => row(P::InteractiveHigh, Drop,       BestEffort,  true,   0,  false,     64),
        Kind::Guidance             => row(P::Data,            Drop,       BestEffort,  false,  0,  false,     64),
        Kind::Surroundings         => row(P::InteractiveHigh, Drop,       BestEffort,  true,   0,  false,     16),
        Kind::Edges                => row(P::DataLow,         Drop,       Reliable,    false,  0,  false,     64),
        Kind::Picture              => row(P::Background,      Block,      Reliable,    false,  0,  false,      8),
        Kind::MapJson              => row(P::DataLow,         Drop,       BestEffort,  false,  0,  false,      8),
    };
    qos
}
