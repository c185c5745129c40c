//! Who is known to have a body, and where marks are doubted therefore.
//!
//! Shadows fall beside those who cast them. So what the network of [`super::bodily`] says of marks counts near tracks that look like
//! bodies to it, and nowhere else: somebody who is alone is followed also if he looks like a shadow all over. Who looks like one when he
//! comes near others, and was alone before, is left alone, too.

use super::figures::Span;
use crate::motion::Raster;

/// Mean share of marks that are a body's from which on a track has one. Bodies have 0.95 and more, nearly always.
const LEAST_SHARE: f64 = 0.8;
/// Sights that the mean goes back, about.
const REMEMBERED: f64 = 30.0;
/// Sights with nobody near who could cast a shadow, after which a track is none.
const ALONE_SIGHTS: u32 = 5;

/// What was seen of a track while it was apart from others.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Proof {
    share: f64,
    sights: f64,
    alone: u32,
}

impl Proof {
    /// So much of what is marked is a body's; `alone`: nobody is near who could cast a shadow there.
    pub(super) fn see(&mut self, share: f64, alone: bool) {
        self.sights = (self.sights + 1.0).min(REMEMBERED);
        self.share += (share - self.share) / self.sights;
        self.alone = self.alone.saturating_add(u32::from(alone));
    }

    pub(super) fn has_body(&self) -> bool {
        self.share > LEAST_SHARE
    }

    /// It looks like a shadow, and is none.
    pub(super) fn only_looks_like_a_shadow(&self) -> bool {
        !self.has_body() && self.alone >= ALONE_SIGHTS
    }
}

/// Where marks count only as far as they are somebody's body.
#[derive(Debug, Clone, Default)]
pub(super) struct Doubts {
    /// Where shadows fall, …
    pub(super) shadows: Vec<Span>,
    /// … and who only looks like one.
    pub(super) but: Vec<Span>,
}

impl Doubts {
    pub(super) fn hold_at(&self, column: f64, raster: &Raster) -> bool {
        let within = |spans: &[Span]| spans.iter().any(|span| span.contains(column, raster));
        within(&self.shadows) && !within(&self.but)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_looked_like_a_shadow_while_he_was_alone_is_not_doubted_and_who_has_a_body_proves_it_soon() {
        let [mut smooth, mut shadow, mut usual] = [Proof::default(); 3];
        for _ in 0..5 {
            smooth.see(0.1, true);
            shadow.see(0.1, false);
            usual.see(0.97, true);
        }
        assert!(smooth.only_looks_like_a_shadow() && !smooth.has_body());
        assert!(!shadow.only_looks_like_a_shadow() && !shadow.has_body());
        assert!(usual.has_body());

        let raster = Raster { width: 360, height: 10, wraps: true };
        let doubts =
            Doubts { shadows: vec![Span { middle: 2.0, half: 60.0 }], but: vec![Span { middle: 340.0, half: 9.0 }] };
        let doubted = |column: f64| doubts.hold_at(column, &raster);
        assert!(doubted(50.0) && doubted(325.0), "over the seam");
        assert!(!doubted(345.0) && !doubted(70.0));
    }
}
