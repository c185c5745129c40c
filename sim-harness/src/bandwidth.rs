//! Bytes: what each robot sends by message kind, as payload (our envelopes) and on the wire, beside what its pictures would
//! cost as raw and as JPEG video.
//!
//! In a simulated run nothing is on a wire; its bytes are computed by [`wire_bytes`] from what was measured of Zenoh over TCP.

use std::collections::BTreeMap;

use serde::Serialize;

/// Zenoh's header of a message that goes alone in its own frame with a declared key, bytes (measured: 9 to 11).
pub const ZENOH_HEADER_BYTES: usize = 11;
/// Ethernet, IPv4 and TCP with timestamps of a segment and of its share of acknowledgements, bytes (measured on loopback: 80).
pub const TCP_BYTES: usize = 80;
/// Most bytes of one TCP segment.
pub const SEGMENT_BYTES: usize = 1448;
/// Quality of the JPEG pictures that video is compared with.
pub const JPEG_QUALITY: u8 = 75;

/// Modelled bytes on the wire of one message.
pub fn wire_bytes(payload_bytes: usize) -> usize {
    let zenoh = payload_bytes + ZENOH_HEADER_BYTES;
    zenoh + zenoh.div_ceil(SEGMENT_BYTES) * TCP_BYTES
}

/// One robot's (or the leader's) traffic of one kind.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct KindRate {
    /// Sender: a robot, or the leader.
    pub robot: String,
    /// Message kind.
    pub kind: String,
    /// In the whole run.
    pub messages: u64,
    /// Our envelopes.
    pub payload_bytes_per_s: f64,
    /// With all headers below.
    pub wire_bytes_per_s: f64,
}

/// What pictures would cost, all robots together.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct VideoRate {
    /// A byte a pixel.
    pub raw_bytes_per_s: f64,
    /// A JPEG picture a frame.
    pub jpeg_bytes_per_s: f64,
}

/// Counts messages by sender and kind.
#[derive(Debug, Clone, Default)]
pub struct Traffic {
    counts: BTreeMap<(String, String), Count>,
}

#[derive(Debug, Clone, Copy, Default)]
struct Count {
    messages: u64,
    payload: u64,
    wire: u64,
}

impl Traffic {
    /// A message was sent.
    pub fn add(&mut self, sender: &str, kind: &str, payload_bytes: usize) {
        self.add_many(sender, kind, 1, payload_bytes as u64, wire_bytes(payload_bytes) as u64);
    }

    /// Messages counted elsewhere.
    pub fn add_many(&mut self, sender: &str, kind: &str, messages: u64, payload_bytes: u64, wire_bytes: u64) {
        let count = self.counts.entry((sender.to_owned(), kind.to_owned())).or_default();
        count.messages += messages;
        count.payload += payload_bytes;
        count.wire += wire_bytes;
    }

    /// Rates over a run of this length, by sender, then kind.
    pub fn rates(&self, duration_s: f64) -> Vec<KindRate> {
        let rate = |bytes: u64| bytes as f64 / duration_s.max(1e-9);
        self.counts
            .iter()
            .map(|((robot, kind), count)| KindRate {
                robot: robot.clone(),
                kind: kind.clone(),
                messages: count.messages,
                payload_bytes_per_s: rate(count.payload),
                wire_bytes_per_s: rate(count.wire),
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_alone_pays_zenohs_header_and_one_segment() {
        assert_eq!(wire_bytes(32), 32 + 11 + 80);
        assert_eq!(wire_bytes(1448 - 11), 1448 + 80);
        assert_eq!(wire_bytes(1448 - 10), 1449 + 160);
    }

    #[test]
    fn rates_are_bytes_over_the_length_of_the_run() {
        let mut traffic = Traffic::default();
        traffic.add("r1", "observation", 100);
        traffic.add("r1", "observation", 300);
        let rates = traffic.rates(2.0);
        assert_eq!((rates.len(), rates[0].messages), (1, 2));
        assert!((rates[0].payload_bytes_per_s - 200.0).abs() < 1e-9);
    }
}
