//! Bytes: what each robot sends by message kind, as payload (our envelopes) and on the wire, beside what its pictures would
//! cost as raw and as JPEG video.
//!
//! In a simulated run nothing is on a wire; its bytes are computed by [`modelled_wire_bytes`]: Zenoh's frame as measured, and
//! the TCP/IP headers of the segments.

pub mod interface;

use std::collections::BTreeMap;

use protocol::codec::Kind;
use protocol::meter::modelled_wire_bytes;
use serde::Serialize;

/// Quality of the JPEG pictures that video is compared with.
pub const JPEG_QUALITY: u8 = 75;

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

impl VideoRate {
    /// Of all robots: pictures in a run and their size; `jpeg`: bytes and number of those that were encoded.
    pub fn of(robots: impl Iterator<Item = (usize, [u32; 2])>, jpeg: (u64, u64), duration_s: f64) -> Self {
        let (frames, pixels) = robots.fold((0.0, 0.0), |(frames, pixels), (n, [width, height])| {
            (frames + n as f64, pixels + n as f64 * f64::from(width) * f64::from(height))
        });
        let per_s = |bytes: f64| bytes / duration_s.max(1e-9);
        Self { raw_bytes_per_s: per_s(pixels), jpeg_bytes_per_s: per_s(frames * jpeg.0 as f64 / jpeg.1.max(1) as f64) }
    }
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
    pub fn add(&mut self, sender: &str, kind: Kind, payload_bytes: usize) {
        self.add_many(sender, kind.name(), 1, payload_bytes as u64, modelled_wire_bytes(kind, payload_bytes));
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
    fn rates_are_bytes_over_the_length_of_the_run() {
        let mut traffic = Traffic::default();
        traffic.add("r1", Kind::Observation, 100);
        traffic.add("r1", Kind::Observation, 300);
        let rates = traffic.rates(2.0);
        assert_eq!((rates.len(), rates[0].messages), (1, 2));
        assert!((rates[0].payload_bytes_per_s - 200.0).abs() < 1e-9);
    }
}
