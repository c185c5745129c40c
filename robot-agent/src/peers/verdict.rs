//! Whether what was fitted is a robot.
//!
//! Problem: shelves, chairs, blinds, doors and striped boxes fit a painted cylinder or plate here and there. Insight: they do not in
//! everything at once: paint, bend, outlines, bars, width; and what a trait says hangs on the others. Algorithm: boosted decision
//! trees (`forest`) over the traits of a fit ([`super::cylinder::credible`], [`super::plate::credible`]), and a small network
//! ([`net`]) that looks at the picture of the fit; both learnt from labelled fits, and the mean of what they say counts. What
//! is taken for a robot is one by odds of [`LEAST_LOG_ODDS`]; of plates, the likeliest by less (`super::as_announced`).
//!
//! They are made with `sim-harness peers --per-layout 1 --fits FILE` for each of some sets of rooms, and `sim-harness verdict FILE…
//! --out robot-agent/src/peers/verdict`, which also says how well they tell apart what is in rooms that they were not learnt from. These are
//! of 95,933 fits (28,127 of the same rooms to plates for what judges these, since plates are fitted otherwise): 1,600 rooms with robots (400 from seed 500000 on, 300 from 510000, 500 from 502000, 400 from 504500) and 600 without
//! (600000 and 610000, `--without-robots`), 220 and 250 of teams in which nobody wears bars (520000, 620000; `--plain`), 150 and 150 through
//! a camera of half the resolution (530000, 630000; `--camera-of tiny`). What is unlike all of them (a marker, a camera, a room) is judged by
//! what it resembles most.

mod forest;
pub mod net;

use std::sync::OnceLock;

use serde::{Deserialize, Serialize};

use forest::Tree;
pub use forest::{Node, log_odds};

use super::{Peer, cylinder, plate};

/// Log-odds that a fit must have to be taken for a robot, whatever else is in the picture; by the upper end of a cylinder alone, of which trees
/// and network are the surer together the less each of them is: of 59,777 other things in rooms unseen one is beyond 0.5, of 3,168 robots 3,063.
pub(super) const LEAST_LOG_ODDS: f64 = 1.2;
const LEAST_END_LOG_ODDS: f64 = 0.5;
/// What is less likely than this will not be one in the next picture either, by other noise.
const HOPELESS_LOG_ODDS: f64 = -2.0;
/// Most fits that are kept for whoever asks for them.
const MOST_FITS: usize = 4096;

/// The trees of each basis.
static RINGS: &[Tree] = include!("verdict/rings.in");
static CYLINDER_END: &[Tree] = include!("verdict/cylinder-end.in");
static STRIPES: &[Tree] = include!("verdict/stripes.in");
static PLATE_END: &[Tree] = include!("verdict/plate-end.in");
/// The weights of the networks, four bytes each, the least first.
static RINGS_NET: &[u8] = include_bytes!("verdict/rings.net");
static CYLINDER_END_NET: &[u8] = include_bytes!("verdict/cylinder-end.net");
static STRIPES_NET: &[u8] = include_bytes!("verdict/stripes.net");
static PLATE_END_NET: &[u8] = include_bytes!("verdict/plate-end.net");

/// What the trees think less likely than this a network is not asked about.
pub const WORTH_A_LOOK: f64 = -6.0;

/// What a fit stands on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Basis {
    /// The rings of a cylinder.
    Rings,
    /// The upper end of a cylinder's marker alone.
    CylinderEnd,
    /// The stripes of a plate.
    Stripes,
    /// The upper end of a plate alone.
    PlateEnd,
}

impl Basis {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Rings, Self::CylinderEnd, Self::Stripes, Self::PlateEnd];

    /// What each value of its traits is of.
    pub fn names(self) -> &'static [&'static str] {
        match self {
            Self::Rings => &cylinder::credible::RINGS,
            Self::CylinderEnd => &cylinder::credible::END,
            Self::Stripes => &plate::credible::STRIPES,
            Self::PlateEnd => &plate::credible::END,
        }
    }

    /// The weights of the network that looks at such fits.
    fn net(self) -> &'static [f32] {
        static NETS: [OnceLock<Vec<f32>>; 4] = [const { OnceLock::new() }; 4];
        let (n, bytes) = match self {
            Self::Rings => (0, RINGS_NET),
            Self::CylinderEnd => (1, CYLINDER_END_NET),
            Self::Stripes => (2, STRIPES_NET),
            Self::PlateEnd => (3, PLATE_END_NET),
        };
        let weights = || bytes.as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
        NETS[n].get_or_init(weights)
    }

    fn trees(self) -> &'static [Tree] {
        match self {
            Self::Rings => RINGS,
            Self::CylinderEnd => CYLINDER_END,
            Self::Stripes => STRIPES,
            Self::PlateEnd => PLATE_END,
        }
    }
}

/// ln of the odds by what trees and network, if one was asked, say.
pub fn together(by_trees: f64, by_net: Option<f64>) -> f64 {
    by_net.map_or(by_trees, |by_net| 0.5 * (by_trees + by_net))
}

/// 1 for what is, 0 for what is not.
pub(super) fn given(is: bool) -> f64 {
    f64::from(u8::from(is))
}

/// −ln of what a correlation lacks to 1.
pub(super) fn lack(correlation: f64) -> f64 {
    -(1.005 - correlation).ln()
}

/// What speaks for and against a fit's being a robot.
#[derive(Debug, Clone, PartialEq)]
pub struct Traits {
    /// Of what they are.
    pub basis: Basis,
    /// In the order of [`Basis::names`].
    pub values: Vec<f64>,
    /// What the fit looks like: grey levels where the body would be and about it, [`net::SIDE`] cells wide and high, the lowest row first,
    /// [`net::UNSEEN`] where there is no pixel. Empty where nobody asks.
    pub picture: Vec<i16>,
    by_trees: f64,
    by_net: Option<f64>,
}

impl Traits {
    /// Of as many values as the basis has names; a network looks at the picture, if there is one, where the trees see a chance.
    pub fn new(basis: Basis, values: Vec<f64>, picture: impl FnOnce() -> Vec<i16>) -> Self {
        let by_trees = log_odds(basis.trees(), &values);
        let picture = if by_trees > WORTH_A_LOOK { picture() } else { Vec::new() };
        // Without a network that knows these traits the trees judge alone.
        let by_net = net::log_odds(basis.net(), &picture, &values);
        Self { basis, values, picture, by_trees, by_net }
    }

    /// ln of the odds that it is a robot: the mean of what trees and network say.
    pub fn log_odds(&self) -> f64 {
        together(self.by_trees, self.by_net)
    }

    /// What the network says, nats, if one was asked.
    pub fn by_net(&self) -> Option<f64> {
        self.by_net
    }

    /// What each trait says for a robot by the trees, nats; together with what is known before any, their log-odds.
    pub fn terms(&self) -> Vec<(&'static str, f64)> {
        let said = forest::terms(self.basis.trees(), &self.values);
        self.basis.names().iter().copied().zip(said).collect()
    }

    pub(super) fn are_hopeless(&self) -> bool {
        self.log_odds() < HOPELESS_LOG_ODDS
    }

    pub(super) fn are_credible(&self) -> bool {
        self.log_odds() >= if self.basis == Basis::CylinderEnd { LEAST_END_LOG_ODDS } else { LEAST_LOG_ODDS }
    }
}

/// Something that a cylinder or a plate was fitted to.
#[derive(Debug, Clone)]
pub struct Fit {
    /// The robot that it would be.
    pub peer: Peer,
    /// What speaks for that.
    pub traits: Traits,
    /// Whether its log-odds suffice, whatever else is in the picture.
    pub is_taken: bool,
}

/// Fits on their way to whoever asks for them.
#[derive(Debug, Default)]
pub(super) struct Fits(Option<Vec<Fit>>);

impl Fits {
    /// Those since the last call; kept from the first call on.
    pub(super) fn take(&mut self) -> Vec<Fit> {
        self.0.replace(Vec::new()).unwrap_or_default()
    }

    pub(super) fn are_kept(&self) -> bool {
        self.0.is_some()
    }

    pub(super) fn keep(&mut self, fit: &Fit) {
        if let Some(fits) = self.0.as_mut().filter(|fits| fits.len() < MOST_FITS) {
            fits.push(fit.clone());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn trees_ask_for_traits_that_there_are_and_lead_to_a_leaf() {
        for basis in Basis::ALL {
            assert!(basis.trees().len() > 50, "{basis:?}");
            for tree in basis.trees() {
                for (n, (of, least, nats, branches)) in tree.iter().enumerate() {
                    assert!(
                        usize::from(*of) < basis.names().len() && least.is_finite() && nats.is_finite(),
                        "{basis:?}"
                    );
                    let next = branches.map(usize::from);
                    assert!(next == [0, 0] || next.iter().all(|next| (n + 1..tree.len()).contains(next)), "{basis:?}");
                }
            }
        }
    }

    #[test]
    fn networks_know_as_many_traits_as_there_are_and_have_finite_weights() {
        for basis in Basis::ALL {
            let weights = basis.net();
            assert!(net::split(weights, basis.names().len()).is_some() && weights.iter().all(|w| w.is_finite()));
        }
    }

    #[test]
    fn what_speaks_for_a_fit_adds_up_to_its_log_odds() {
        for basis in Basis::ALL {
            let says = |values: Vec<f64>| {
                let traits = Traits::new(basis, values, Vec::new);
                log_odds(basis.trees(), &traits.values) - traits.terms().iter().map(|(_, nats)| nats).sum::<f64>()
            };
            let many = basis.names().len();
            let before = says(vec![0.0; many]);
            assert!((says(vec![2.0; many]) - before).abs() < 1e-3, "{basis:?}");
        }
    }
}
