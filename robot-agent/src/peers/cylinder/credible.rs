//! What speaks for and against a cylinder's being a robot ([`super::super::verdict`]).

use super::super::rings::RingFit;
use super::super::verdict::{Basis, Traits, given, lack};
use super::{BEND_GATE, CylinderFinder, Found, Part, height_sigma_m};
use crate::optics::MountedCamera;

/// Of bodies of which rings are seen.
pub(in super::super) const RINGS: [&str; 18] = [
    // Share of the columns that show the rings.
    "visible",
    // −ln of what their mean correlation with the rings lacks to 1.
    "correlation",
    // −ln of the RMS error of the reflectances.
    "paint",
    // Gray level of black over white's less black's: black paint is nearly black.
    "black",
    // The bend's squared distance from a cylinder's in sigmas, and ln of its sigma: a test that could not fail says nothing.
    "bend",
    "bend unknown",
    // How many outlines there are, and how far they are from where the rings put them, pixels squared.
    "outlines",
    "outlines' way",
    // What does not fit of the bars; no other pattern would do; it is a body without bars in a team with bars; bars that are measured by
    // themselves; nobody in the team wears bars.
    "bars' misfit",
    "bars are certain",
    "no bars",
    "bars",
    "plain team",
    // To the axis, metres, and ln of the body's width, pixels.
    "range",
    "width",
    // The upper part alone.
    "upper part",
    // Squared sigmas by which it stands too low or high.
    "height",
    // ln of contrast over noise.
    "contrast",
];
/// Of bodies so near that the marker's upper end alone is seen ([`super::super::near`]).
pub(in super::super) const END: [&str; 13] = [
    // Share of the columns in which the upper end is where the curve says, and of those in which its far side is where it should be.
    "visible",
    "lid",
    "outlines",
    "outlines' way",
    // Bars were read at all, what does not fit of them, and no other name would do.
    "bars are read",
    "bars' misfit",
    "named",
    "no bars",
    "bars",
    "plain team",
    "range",
    // Metres beyond where a ring edge comes into view.
    "ring edge",
    "contrast",
];
/// Beyond, a body of 0.2 m is 14 pixels wide and much looks like it, metres.
const FARTHEST_M: f64 = 6.2;
/// An outline further from where the rings put it says no more, pixels.
const MOST_WAY_PX: f64 = 2.0;

/// Rings beyond all doubt: see [`CylinderFinder::is_plain`].
const PLAIN_M: f64 = 3.2;
/// The same further away, where the bend is known like this.
const PLAIN_FAR_M: f64 = 4.2;
const PLAIN_FAR_BEND: f64 = 0.1;
const PLAIN_CORRELATION: f64 = 0.9975;
const PLAIN_PAINT: f64 = 0.03;
const PLAIN_BLACK: f64 = 0.1;
const PLAIN_BEND: f64 = 0.35;
const PLAIN_ROUND_CHI2: f64 = 6.0;
/// Sigmas of the height, as mounting and fit leave it open.
const PLAIN_HEIGHT: f64 = 2.0;
/// Share of the columns in which the upper end of a body without a reading of its bars must be where the curve says: of true bodies the
/// least was 0.97, plates and tables came to 0.94.
pub(super) const LEAST_LONE_RIM: f64 = 0.96;

impl CylinderFinder {
    /// Whether it is.
    pub(super) fn is_credible(&self, found: &Found, traits: &Traits) -> bool {
        found.rings.near_m + self.look.radius_m <= FARTHEST_M && traits.are_credible()
    }

    /// What speaks for and against it.
    pub(super) fn traits(&self, camera: &MountedCamera, found: &Found) -> Traits {
        let (look, rings) = (&self.look, &found.rings);
        let range_m = rings.near_m + look.radius_m;
        let reading = found.reading.as_ref();
        let way = |fit: &super::EdgeFit| (fit.outwards_rad * fit.px_per_rad).clamp(-MOST_WAY_PX, MOST_WAY_PX).powi(2);
        let outlines = [found.outlines() as f64, found.left.iter().chain(&found.right).map(way).sum::<f64>()];
        let misfit = reading.map_or(0.0, |r| r.misfit);
        let has_none = given(reading.is_some_and(|r| look.patterns[r.pattern].bars.is_empty()));
        let bars = reading.map_or(0.0, |r| r.bars.len() as f64);
        let is_plain_team = given(!look.is_barred());
        let contrast = (rings.gain.max(0.1) / rings.noise.max(0.3)).ln();
        let values = if rings.is_rim {
            let named = given(reading.is_some_and(|r| r.is_named));
            let read = [given(reading.is_some()), misfit, named, has_none, bars, is_plain_team];
            let beyond = range_m - self.reach.one_edge_m;
            [&[rings.visible, rings.lid][..], &outlines, &read, &[range_m, beyond, contrast]].concat()
        } else {
            let [bend, sigma] = rings.bend;
            let bent = (0.5 * BEND_GATE - bend.abs()).min(0.0).powi(2) / (sigma * sigma + 0.03 * 0.03);
            let low = (rings.lower_m / height_sigma_m(rings, camera).max(0.004)).powi(2);
            let seen =
                [rings.visible, lack(rings.correlation), -(rings.paint_error(look) + 0.01).ln(), rings.black(look)];
            let certain = given(reading.is_some_and(|r| r.is_certain));
            let read = [misfit, certain, has_none, bars, is_plain_team];
            let place = [range_m, (rings.columns.len() as f64).ln(), given(self.part == Part::Upper), low];
            [&seen[..], &[bent, sigma.max(0.02).ln()], &outlines, &read, &place, &[contrast]].concat()
        };
        Traits { basis: if rings.is_rim { Basis::CylinderEnd } else { Basis::Rings }, values }
    }

    /// Whether the rings are there beyond all doubt, whatever is before them and whatever bars they show. In 300 rooms without robots
    /// nothing nearer than 3.2 m correlated better than 0.9952 with them.
    pub(super) fn is_plain(&self, rings: &RingFit, camera: &MountedCamera) -> bool {
        let [bend, sigma] = rings.bend;
        !rings.is_rim
            && (rings.near_m < PLAIN_M || rings.near_m < PLAIN_FAR_M && sigma <= PLAIN_FAR_BEND)
            && rings.correlation >= PLAIN_CORRELATION
            && rings.paint_error(&self.look) <= PLAIN_PAINT
            && rings.black(&self.look) <= PLAIN_BLACK
            && sigma <= PLAIN_BEND
            && bend.abs() <= BEND_GATE + 2.0 * sigma
            && is_round(rings, PLAIN_ROUND_CHI2)
            && rings.lower_m.abs() <= PLAIN_HEIGHT * height_sigma_m(rings, camera)
    }
}

/// Whether the rings bend as a cylinder's much rather than as a flat board's, which a single outline would not tell.
fn is_round(rings: &RingFit, chi2: f64) -> bool {
    let variance = rings.bend[1].powi(2) + BEND_GATE.powi(2) / 4.0;
    (rings.bend[0] + 1.0).powi(2) - rings.bend[0].powi(2) > chi2 * variance || rings.edges_seen < 2
}
