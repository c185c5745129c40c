//! What goes wrong in a run: one kind of fault, with a victim and a duration drawn from the seed.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

/// What goes wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// Nothing: what the figures are when all is well.
    Nothing,
    /// The leader that rules is killed, and started again at the end with what it had saved.
    KillLeader,
    /// It is frozen and thawed.
    FreezeLeader,
    /// It is alive and its links are up, but it computes nothing.
    StallLeader,
    /// Its host's link is down.
    CutLeader,
    /// Robots and leaders fall into two halves.
    Partition,
    /// All leaders are killed at once, and started again after a while with what they had saved.
    KillAllLeaders,
    /// A robot's agent is killed and started again as a new session.
    KillRobot,
    /// A robot's agent is frozen and thawed.
    FreezeRobot,
    /// A robot's link is down.
    CutRobot,
    /// A robot's clock is set, by up to ±0.5 s.
    StepClock,
    /// A robot's clock is set by hours.
    JumpClock,
    /// 5 % of the messages vanish.
    Loss,
    /// Messages take 200 ± 100 ms.
    Delay,
    /// Messages come twice.
    Duplication,
    /// Messages overtake each other.
    Reordering,
    /// A robot sends rubbish: mutated envelopes.
    Garbage,
    /// A robot sends each message a hundred times.
    Flood,
    /// A second robot uses the id of one.
    Double,
}

impl Kind {
    /// All of them, in the order in which seeds take them.
    pub const ALL: [Self; 19] = [
        Self::KillLeader,
        Self::FreezeLeader,
        Self::Partition,
        Self::KillRobot,
        Self::StepClock,
        Self::Delay,
        Self::StallLeader,
        Self::CutLeader,
        Self::FreezeRobot,
        Self::CutRobot,
        Self::Loss,
        Self::KillAllLeaders,
        Self::Garbage,
        Self::Flood,
        Self::Double,
        Self::JumpClock,
        Self::Duplication,
        Self::Reordering,
        Self::Nothing,
    ];

    /// Its word in tables.
    pub fn word(self) -> &'static str {
        match self {
            Self::Nothing => "nothing",
            Self::KillLeader => "kill leader",
            Self::FreezeLeader => "freeze leader",
            Self::StallLeader => "stall leader",
            Self::CutLeader => "cut leader off",
            Self::Partition => "partition",
            Self::KillAllLeaders => "kill all leaders",
            Self::KillRobot => "kill robot",
            Self::FreezeRobot => "freeze robot",
            Self::CutRobot => "cut robot off",
            Self::StepClock => "step clock",
            Self::JumpClock => "jump clock",
            Self::Loss => "loss 5 %",
            Self::Delay => "delay 200 ± 100 ms",
            Self::Duplication => "duplication",
            Self::Reordering => "reordering",
            Self::Garbage => "garbage",
            Self::Flood => "flood",
            Self::Double => "one id twice",
        }
    }
}

/// One run's fault.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fault {
    /// What.
    pub kind: Kind,
    /// Which robot, where it concerns one.
    pub robot: usize,
    /// When, seconds of true time.
    pub from_s: f64,
    /// Until when.
    pub to_s: f64,
    /// By how much a clock is set, seconds.
    pub step_s: f64,
}

impl Fault {
    /// The fault of a seed: kinds in turn, the rest at random.
    pub fn of_seed(seed: u64, robots: usize) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(0x6368_616f);
        let kind = Kind::ALL[(seed % Kind::ALL.len() as u64) as usize];
        let from_s = random.random_range(7.0..8.0);
        let lasts_s = match kind {
            Kind::StepClock | Kind::JumpClock => 0.0,
            _ => random.random_range(2.0..4.0),
        };
        let step_s = match kind {
            Kind::JumpClock => random.random_range(-7200.0..7200.0),
            _ => random.random_range(-0.5..0.5),
        };
        Self { kind, robot: random.random_range(0..robots), from_s, to_s: from_s + lasts_s, step_s }
    }

    /// Whether it lasts at this time.
    pub fn lasts(&self, time_s: f64) -> bool {
        (self.from_s..self.to_s).contains(&time_s)
    }
}
