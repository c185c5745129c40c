//! Who sends how much of what.
//!
//! A [`Meter`] counts messages and payload bytes by robot and kind as they pass the transport (or the simulated network).
//! Bytes on the wire are more: [`crate::transport::Transport::wire_bytes`] reads Zenoh's own counters of a session, and
//! where there are none [`modelled_wire_bytes`] adds the framing that was measured, and must be shown as modelled.

use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::codec::Kind;
use crate::id::RobotId;
use crate::message::KindTraffic;

/// Zenoh's bytes round a small message that travels alone over TCP on a declared key, with our QoS: 15.6 measured
/// (1.10.2, an observation; 9-11 with Zenoh's default priority).
pub const ZENOH_FRAME_BYTES: u64 = 15;
/// What a cached publisher adds: source id and sequence number (measured).
pub const ZENOH_CACHED_BYTES: u64 = 22;
/// Ethernet-less TCP/IPv4 with timestamps: 52 bytes a segment, counted for the message only, not for its acknowledgement.
pub const TCP_IP_BYTES: u64 = 52;
/// Payload of one TCP segment on Ethernet.
pub const SEGMENT_BYTES: u64 = 1448;

/// Most (robot, kind, direction) entries; what would be more is counted as of no robot.
pub const MAX_ENTRIES: usize = 16_384;

/// Which way a message went.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Direction {
    /// Published, asked or answered.
    Sent,
    /// Came in.
    Received,
}

/// What was counted of one robot and kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Count {
    /// Messages.
    pub messages: u64,
    /// Bytes of the envelopes (or plain payloads).
    pub payload_bytes: u64,
}

/// One line of the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Row {
    /// Whose key it was; `None` for the leader's.
    pub robot: Option<RobotId>,
    /// What.
    pub kind: Kind,
    /// Which way.
    pub direction: Direction,
    /// How much.
    pub count: Count,
}

/// Counters of one session. Shared by all its publishers and subscribers; counting takes a short lock.
#[derive(Debug, Default)]
pub struct Meter {
    counters: Mutex<Counters>,
}

#[derive(Debug, Default)]
struct Counters {
    traffic: BTreeMap<(Option<RobotId>, Kind, Direction), Count>,
    dropped: u64,
    refused: u64,
    flooded: u64,
}

impl Meter {
    /// Counts one message.
    pub fn count(&self, robot: Option<RobotId>, kind: Kind, direction: Direction, payload_bytes: usize) {
        let mut counters = self.lock();
        let full = counters.traffic.len() >= MAX_ENTRIES;
        let robot = robot.filter(|_| !full || counters.traffic.contains_key(&(robot, kind, direction)));
        let count = counters.traffic.entry((robot, kind, direction)).or_default();
        count.messages += 1;
        count.payload_bytes += payload_bytes as u64;
    }

    /// Counts a message that a full queue dropped.
    pub fn count_dropped(&self) {
        self.lock().dropped += 1;
    }

    /// Counts a message that could not be read.
    pub fn count_refused(&self) {
        self.lock().refused += 1;
    }

    /// Counts a message that its sender had too many of.
    pub fn count_flooded(&self) {
        self.lock().flooded += 1;
    }

    /// Messages over their senders' pace, since the start.
    pub fn flooded(&self) -> u64 {
        self.lock().flooded
    }

    /// Messages that a full queue dropped, since the start.
    pub fn dropped(&self) -> u64 {
        self.lock().dropped
    }

    /// Messages that could not be read, since the start.
    pub fn refused(&self) -> u64 {
        self.lock().refused
    }

    /// The table, by robot, kind and direction.
    pub fn rows(&self) -> Vec<Row> {
        let row = |(&(robot, kind, direction), &count): (&_, &_)| Row { robot, kind, direction, count };
        self.lock().traffic.iter().map(row).collect()
    }

    /// What was sent, by kind, as it stands in [`crate::message::Health`].
    pub fn sent_by_kind(&self) -> Vec<KindTraffic> {
        let mut by_kind: BTreeMap<Kind, Count> = BTreeMap::new();
        for row in self.rows().iter().filter(|row| row.direction == Direction::Sent) {
            let count = by_kind.entry(row.kind).or_default();
            count.messages += row.count.messages;
            count.payload_bytes += row.count.payload_bytes;
        }
        let traffic = |(kind, count): (Kind, Count)| KindTraffic {
            kind: kind as u8,
            messages: count.messages,
            payload_bytes: count.payload_bytes,
        };
        by_kind.into_iter().map(traffic).collect()
    }

    fn lock(&self) -> MutexGuard<'_, Counters> {
        // Counters stay meaningful whatever happened to the thread that held them.
        self.counters.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Bytes on the wire of one message of this kind, modelled: Zenoh's frame, and TCP/IP headers of its segments.
pub fn modelled_wire_bytes(kind: Kind, payload_bytes: usize) -> u64 {
    let cached = if is_cached(kind) { ZENOH_CACHED_BYTES } else { 0 };
    let bytes = payload_bytes as u64 + ZENOH_FRAME_BYTES + cached;
    bytes + bytes.div_ceil(SEGMENT_BYTES) * TCP_IP_BYTES
}

/// Bytes on the wire of what was sent, by row. Zenoh counts by session only: what it sent beside our payload (headers, presence,
/// keep-alives) is shared out by the modelled overhead of each kind, and TCP/IP's headers are added. Without Zenoh's count all of it
/// is modelled.
pub fn share_of_wire(sent: impl IntoIterator<Item = Row>, zenoh_sent: Option<u64>) -> Vec<(Row, u64)> {
    let rows: Vec<Row> = sent.into_iter().filter(|row| row.count.messages > 0).collect();
    let overhead = |row: &Row| {
        let mean = row.count.payload_bytes / row.count.messages;
        (modelled_wire_bytes(row.kind, mean as usize) - mean) * row.count.messages
    };
    let zenoh = |row: &Row| overhead(row).saturating_sub(row.count.messages * TCP_IP_BYTES);
    let modelled: u64 = rows.iter().map(zenoh).sum();
    let payload: u64 = rows.iter().map(|row| row.count.payload_bytes).sum();
    let share = zenoh_sent.map_or(1.0, |bytes| bytes.saturating_sub(payload) as f64 / modelled.max(1) as f64);
    let wire = |row: &Row| {
        let headers = zenoh(row) as f64 * share + (overhead(row) - zenoh(row)) as f64;
        row.count.payload_bytes + headers as u64
    };
    rows.iter().map(|row| (*row, wire(row))).collect()
}

/// Whether the publisher keeps the last ones for late joiners.
pub(crate) fn is_cached(kind: Kind) -> bool {
    matches!(kind, Kind::Announcement | Kind::Alarm | Kind::TeamMap)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn traffic_is_summed_by_robot_and_kind_and_direction() {
        let meter = Meter::default();
        let robots = ["r1", "r2"].map(|name| RobotId::new(name).ok());
        for robot in robots {
            meter.count(robot, Kind::Observation, Direction::Sent, 100);
            meter.count(robot, Kind::Observation, Direction::Sent, 60);
        }
        meter.count(None, Kind::TeamMap, Direction::Received, 500);
        let rows = meter.rows();
        assert_eq!(rows.len(), 3);
        assert_eq!((rows[0].robot, rows[0].count.payload_bytes), (None, 500));
        assert_eq!(rows[2].count, Count { messages: 2, payload_bytes: 160 });
        assert_eq!(meter.sent_by_kind(), [KindTraffic { kind: 2, messages: 4, payload_bytes: 320 }]);
    }

    #[test]
    fn the_model_gives_what_was_measured_for_a_small_message() {
        // 32 bytes paced, counted at the interface: 123 bytes with the acknowledgement's 40, at Zenoh's default priority.
        let modelled = modelled_wire_bytes(Kind::Observation, 32) as f64;
        assert!((modelled + 40.0 - 123.0).abs() < 20.0, "{modelled}");
    }
}
