//! A team's network as Zenoh gives it, in virtual time: every leader is a router, leaders are all linked, a robot holds one link
//! to one leader and takes the next when it is lost; liveliness follows the links.
//!
//! The times are those measured of the real one (DESIGN §4): a killed process is noticed in 20 ms, a frozen one or a dead link
//! after its lease of 1 s; a robot is with its next leader 0.3 s after a kill and 0.6 s after a lease.

use std::collections::BTreeMap;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::network::VirtualNs;

/// A second.
pub const SECOND: VirtualNs = 1_000_000_000;
/// A broken link is noticed after so long: its process was killed; or is silent.
const KILL_NOTICED: VirtualNs = SECOND / 50;
const LEASE: VirtualNs = SECOND;
/// Then a robot needs so long to be with its next leader.
const REATTACH: VirtualNs = 3 * SECOND / 10;
const HANDSHAKE: VirtualNs = 6 * SECOND / 10;
/// Two leaders that reach each other again are linked after so long.
const RELINK: VirtualNs = 3 * SECOND / 10;
/// A leader whose loop does not come round loses its token after so long.
const STALL_NOTICED: VirtualNs = 7 * SECOND / 10;
/// The least time that a message takes, and the mean of what comes on top, seconds.
const DELAY_S: (f64, f64) = (1e-3, 1e-3);
/// A message that must arrive and was lost comes again after so long.
const RECOVERED: VirtualNs = SECOND;

/// How a process is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Life {
    /// At work.
    Works,
    /// Alive, and its links too, but it computes nothing, since then.
    Stalled(VirtualNs),
    /// Stopped, since then.
    Frozen(VirtualNs),
    /// Gone, since then.
    Dead(VirtualNs),
}

/// What the links do to messages.
#[derive(Debug, Clone, Copy, Default)]
pub struct Weather {
    /// Share that vanishes.
    pub loss: f64,
    /// On top of the usual, seconds: mean and spread.
    pub delay_s: (f64, f64),
    /// Share that comes twice.
    pub duplicates: f64,
    /// Messages may overtake each other.
    pub disorder: bool,
}

/// All nodes: robots first, then leaders.
#[derive(Debug)]
pub struct Fabric {
    robots: usize,
    /// How each process is.
    pub life: Vec<Life>,
    /// Nodes of different islands do not reach each other.
    pub island: Vec<u8>,
    /// The present weather.
    pub weather: Weather,
    /// The leader that each robot is linked to.
    home: Vec<Option<usize>>,
    /// Since when a robot's link is broken, and whether by a death.
    broken: Vec<Option<(VirtualNs, bool)>>,
    /// By (leader, node): whether its token is seen, and since when that is out of date.
    seen: BTreeMap<(usize, usize), (bool, Option<VirtualNs>)>,
    last: BTreeMap<(usize, usize), VirtualNs>,
    random: ChaCha8Rng,
    /// Messages that the links lost.
    pub lost: u64,
}

/// Somebody's token, as a leader sees it.
#[derive(Debug, Clone, Copy)]
pub struct Sign {
    /// Which leader.
    pub at: usize,
    /// Whose.
    pub of: usize,
    /// Whether it is there.
    pub alive: bool,
}

impl Fabric {
    /// Everything works.
    pub fn new(robots: usize, leaders: usize, seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(0x6661_6272);
        let nodes = robots + leaders;
        Self {
            robots,
            life: vec![Life::Works; nodes],
            island: vec![0; nodes],
            weather: Weather::default(),
            home: vec![Some(robots); robots],
            broken: vec![None; robots],
            seen: BTreeMap::new(),
            last: BTreeMap::new(),
            random,
            lost: 0,
        }
    }

    fn leaders(&self) -> std::ops::Range<usize> {
        self.robots..self.life.len()
    }

    /// Whether the process sends and receives.
    fn talks(&self, node: usize) -> bool {
        matches!(self.life[node], Life::Works | Life::Stalled(_))
    }

    fn linked(&self, a: usize, b: usize) -> bool {
        self.island[a] == self.island[b]
    }

    /// The leaders through which messages between two nodes go; `None` where no way is known.
    fn way(&self, a: usize, b: usize) -> Option<Vec<usize>> {
        let door = |node: usize| if node < self.robots { self.home[node] } else { Some(node) };
        let (first, last) = (door(a)?, door(b)?);
        let mut way = vec![a];
        for node in [first, last, b] {
            if way.last() != Some(&node) {
                way.push(node);
            }
        }
        Some(way)
    }

    /// Whether messages pass from `a` to `b` at present (a frozen end takes them into its buffers).
    fn passes(&self, a: usize, b: usize) -> bool {
        self.way(a, b).is_some_and(|way| {
            way.windows(2).all(|hop| self.linked(hop[0], hop[1]))
                && way.iter().all(|node| *node == b || self.talks(*node))
                && !matches!(self.life[b], Life::Dead(_))
        })
    }

    /// When a message sent now arrives: not at all, once, or twice. What `must_arrive` comes late instead of never.
    pub fn send(&mut self, now: VirtualNs, from: usize, to: usize, must_arrive: bool) -> Vec<VirtualNs> {
        if !self.passes(from, to) {
            self.lost += u64::from(from != to);
            return Vec::new();
        }
        let weather = self.weather;
        let [lost, jitter, spread, twice]: [f64; 4] = std::array::from_fn(|_| self.random.random());
        let mut takes_s = DELAY_S.0 - DELAY_S.1 * (1.0 - jitter).ln();
        takes_s += weather.delay_s.0 + weather.delay_s.1 * (2.0 * spread - 1.0);
        let mut at = now + (takes_s * 1e9) as VirtualNs;
        if lost < weather.loss {
            if !must_arrive {
                self.lost += 1;
                return Vec::new();
            }
            at += RECOVERED;
        }
        if !weather.disorder {
            let last = self.last.entry((from, to)).or_default();
            at = at.max(*last + 1);
            *last = at;
        }
        let mut arrivals = vec![at];
        if twice < weather.duplicates {
            arrivals.push(at + (0.05e9 * jitter) as VirtualNs);
        }
        arrivals
    }

    /// Links and tokens follow what has happened; what each leader sees of it.
    pub fn settle(&mut self, now: VirtualNs) -> Vec<Sign> {
        for robot in 0..self.robots {
            self.attach(now, robot);
        }
        let mut signs = Vec::new();
        for at in self.leaders() {
            if self.life[at] != Life::Works {
                continue;
            }
            for of in (0..self.life.len()).filter(|of| *of != at) {
                let there = self.is_there(now, at, of);
                let patience = self.patience(at, of, there);
                let (shown, since) = self.seen.entry((at, of)).or_insert((false, None));
                if *shown == there {
                    *since = None;
                    continue;
                }
                let since_when = *since.get_or_insert(now);
                if now - since_when >= patience {
                    (*shown, *since) = (there, None);
                    signs.push(Sign { at, of, alive: there });
                }
            }
        }
        signs
    }

    /// A leader has been started again: it sees nobody yet.
    pub fn forget(&mut self, leader: usize) {
        self.seen.retain(|(at, _), _| *at != leader);
    }

    fn attach(&mut self, now: VirtualNs, robot: usize) {
        if !self.talks(robot) {
            return;
        }
        let good = |fabric: &Self, home: usize| fabric.talks(home) && fabric.linked(robot, home);
        if self.home[robot].is_some_and(|home| good(self, home)) {
            self.broken[robot] = None;
            return;
        }
        let by_death = self.home[robot].is_some_and(|home| matches!(self.life[home], Life::Dead(_)));
        let (since, by_death) = *self.broken[robot].get_or_insert((now, by_death));
        let patience = if by_death { REATTACH } else { LEASE + HANDSHAKE };
        if now - since >= patience
            && let Some(next) = self.leaders().find(|leader| good(self, *leader))
        {
            (self.home[robot], self.broken[robot]) = (Some(next), None);
        }
    }

    fn is_there(&self, now: VirtualNs, at: usize, of: usize) -> bool {
        let works = match self.life[of] {
            Life::Works => true,
            Life::Stalled(since) => of < self.robots || now - since < STALL_NOTICED,
            _ => false,
        };
        works && self.passes(of, at)
    }

    fn patience(&self, at: usize, of: usize, there: bool) -> VirtualNs {
        if there {
            return if of < self.robots { KILL_NOTICED } else { RELINK };
        }
        let way = self.way(of, at).unwrap_or_default();
        let noticed_at_once = way.iter().any(|node| matches!(self.life[*node], Life::Dead(_) | Life::Stalled(_)));
        if noticed_at_once || way.is_empty() { KILL_NOTICED } else { LEASE }
    }
}
