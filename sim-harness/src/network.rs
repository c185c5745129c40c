//! A network that exists only in virtual time: encoded envelopes that arrive later, in the same order for the same seed.
//!
//! Each pair of sender and receiver is a link as Zenoh over TCP gives one: what is sent first arrives first. A message takes
//! `delay_s` plus an exponentially distributed jitter; with `loss` > 0 some vanish (TCP would not lose them: it is there for
//! experiments). Draws happen in the order of sending, so a run is a function of the seed.

pub mod events;

use std::collections::BTreeMap;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

pub use events::EventQueue;

/// Virtual time since the start of a scenario, nanoseconds.
pub type VirtualNs = u64;

/// How the links behave.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NetworkSettings {
    /// The least time a message takes, seconds.
    pub delay_s: f64,
    /// Mean of what comes on top, seconds.
    pub jitter_s: f64,
    /// Share of messages that vanish, 0 … 1.
    pub loss: f64,
}

impl Default for NetworkSettings {
    /// A quiet wireless network.
    fn default() -> Self {
        Self { delay_s: 1e-3, jitter_s: 1e-3, loss: 0.0 }
    }
}

/// The links of a team. A node is a number its user chooses.
#[derive(Debug)]
pub struct Network {
    settings: NetworkSettings,
    random: ChaCha8Rng,
    /// When the last message of a link arrives.
    last: BTreeMap<(usize, usize), VirtualNs>,
    lost: u64,
}

impl Network {
    /// Links without traffic.
    pub fn new(settings: NetworkSettings, seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        // A stream of its own: the world draws from the same seed.
        random.set_stream(0x6e65_7477);
        Self { settings, random, last: BTreeMap::new(), lost: 0 }
    }

    /// When a message sent now arrives; `None` if it is lost.
    pub fn send(&mut self, now: VirtualNs, from: usize, to: usize) -> Option<VirtualNs> {
        let (lost, jitter): (f64, f64) = (self.random.random(), self.random.random());
        if lost < self.settings.loss {
            self.lost += 1;
            return None;
        }
        let takes_s = self.settings.delay_s - self.settings.jitter_s * (1.0 - jitter).ln();
        let last = self.last.entry((from, to)).or_default();
        *last = (now + (takes_s * 1e9) as u64).max(*last + 1);
        Some(*last)
    }

    /// Messages lost so far.
    pub fn lost(&self) -> u64 {
        self.lost
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_link_keeps_the_order_of_sending() {
        let mut network = Network::new(NetworkSettings { jitter_s: 0.05, ..Default::default() }, 1);
        let arrivals: Vec<_> = (0..200).map(|n| network.send(n * 1_000_000, 0, 1).unwrap()).collect();
        assert!(arrivals.is_sorted());
        assert!(arrivals.iter().enumerate().all(|(n, at)| *at >= n as u64 * 1_000_000 + 1_000_000));
    }

    #[test]
    fn the_same_seed_gives_the_same_delays_and_another_seed_others() {
        let run = |seed| {
            let mut network = Network::new(NetworkSettings::default(), seed);
            (0..20).map(|n| network.send(n, 0, 1)).collect::<Vec<_>>()
        };
        assert_eq!(run(7), run(7));
        assert_ne!(run(7), run(8));
    }

    #[test]
    fn about_the_wanted_share_is_lost() {
        let mut network = Network::new(NetworkSettings { loss: 0.2, ..Default::default() }, 3);
        let arrived = (0..1000).filter(|n| network.send(*n, 0, 1).is_some()).count();
        assert!((760..=840).contains(&arrived), "{arrived}");
        assert_eq!(network.lost(), 1000 - arrived as u64);
    }
}
