//! Whether what was fitted is a robot.
//!
//! Problem: shelves, chairs, blinds, doors and striped boxes fit a painted cylinder or plate here and there. Insight: they do not in
//! everything at once: paint, bend, outlines, bars, width. Algorithm: logistic regression. Each trait of a fit says something for or
//! against a robot, in nats; the weights ([`super::cylinder::credible`], [`super::plate::credible`]) are learnt from labelled fits, and what
//! is taken for a robot is one by odds of [`LEAST_LOG_ODDS`]; of plates, the likeliest by less (`super::as_announced`).
//!
//! Cylinders' weights are of 12,825 fits: 700 rooms with robots (seeds 500000 and 510000) and 800 without (600000, 610000), 220 and 250 of
//! teams in which nobody wears bars (520000, 620000; `--plain`), 150 and 150 through a camera of half the resolution (530000, 630000;
//! `--camera-of tiny`); those of a cylinder's end (7,037 fits) and of plates (9,195) were made anew from the same without 510000 and 610000 when more
//! candidates were looked at. They are made anew with `sim-harness peers --per-layout 1 --fits FILE` for each of these, and
//! `sim-harness verdict FILE…`.

use serde::{Deserialize, Serialize};

use super::{Peer, cylinder, plate};

/// Log-odds that a fit must have to be taken for a robot, whatever else is in the picture.
pub(super) const LEAST_LOG_ODDS: f64 = 1.2;
/// What is less likely than this will not be one in the next picture either, by other noise.
const HOPELESS_LOG_ODDS: f64 = -2.0;
/// Most fits that are kept for whoever asks for them.
const MOST_FITS: usize = 4096;

/// A trait and what one unit of it says for a robot, nats.
pub(super) type Weight = (&'static str, f64);

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

    fn weights(self) -> &'static [Weight] {
        match self {
            Self::Rings => &cylinder::credible::RINGS,
            Self::CylinderEnd => &cylinder::credible::END,
            Self::Stripes => &plate::credible::STRIPES,
            Self::PlateEnd => &plate::credible::END,
        }
    }

    /// What each value of its traits is of.
    pub fn names(self) -> impl Iterator<Item = &'static str> {
        self.weights().iter().map(|(name, _)| *name)
    }
}

/// What speaks for and against a fit's being a robot.
#[derive(Debug, Clone, PartialEq)]
pub struct Traits {
    /// Of what they are.
    pub basis: Basis,
    /// In the order of [`Basis::names`].
    pub values: Vec<f64>,
}

impl Traits {
    /// ln of the odds that it is a robot.
    pub fn log_odds(&self) -> f64 {
        self.terms().map(|(_, nats)| nats).sum()
    }

    /// What each trait says for a robot, nats.
    pub fn terms(&self) -> impl Iterator<Item = (&'static str, f64)> {
        self.basis.weights().iter().zip(&self.values).map(|((name, weight), value)| (*name, weight * value))
    }

    pub(super) fn are_hopeless(&self) -> bool {
        self.log_odds() < HOPELESS_LOG_ODDS
    }

    pub(super) fn are_credible(&self) -> bool {
        self.log_odds() >= LEAST_LOG_ODDS
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
