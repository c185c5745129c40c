//! What speaks for and against a cylinder's being a robot ([`super::super::verdict`]).

use super::super::rings::RingFit;
use super::super::verdict::{Basis, Traits, given, lack, net};
use super::{BEND_GATE, CylinderFinder, Found, Part, height_sigma_m};
use crate::optics::MountedCamera;

/// Of bodies of which rings are seen.
pub(in super::super) const RINGS: [&str; 21] = [
    // Share of the columns that show the rings, and of the width that nobody hides who was found.
    "visible",
    "unhidden",
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
    // Sides up to which rings are shown where no outline is, and the share of the columns beside in which rings go on.
    "open sides",
    "goes on",
    // What does not fit of the bars ([`UNREAD`] where none can be read in a team with bars); no other pattern would do; it is a body without
    // bars in a team with bars; bars that are measured by themselves; nobody in the team wears bars.
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
pub(in super::super) const END: [&str; 16] = [
    // Share of the columns in which the upper end is where the curve says, by how many pixels (RMS) it is not, and share of those in which
    // its far side is where it should be.
    "visible",
    "stray",
    "lid",
    "outlines",
    "outlines' way",
    // Share of the columns beside in which the upper end goes on.
    "goes on",
    // Bars were read at all, what does not fit of them, and no other name would do.
    "bars are read",
    "bars' misfit",
    "named",
    "no bars",
    "bars",
    "plain team",
    // How far what is in view of the rings correlates with them.
    "ringed",
    "range",
    // Metres beyond where a ring edge comes into view.
    "ring edge",
    "contrast",
];
/// Beyond, a body of 0.2 m is 14 pixels wide and much looks like it, metres.
const FARTHEST_M: f64 = 6.2;
/// Misfit of bars that cannot be read: more than that of any reading.
const UNREAD: f64 = 6.0;
/// An outline further from where the rings put it says no more, pixels.
const MOST_WAY_PX: f64 = 2.0;

/// Share of the columns in which the upper end of a body without a reading of its bars must be where the curve says for it to be worth a
/// closer look: of true bodies in lit rooms the least was 0.97, plates and tables came to 0.94.
pub(super) const LEAST_LONE_RIM: f64 = 0.9;

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
        let misfit = reading.map_or(if look.is_barred() { UNREAD } else { 0.0 }, |r| r.misfit);
        let has_none = given(reading.is_some_and(|r| look.patterns[r.pattern].bars.is_empty()));
        let bars = reading.map_or(0.0, |r| r.bars.len() as f64);
        let is_plain_team = given(!look.is_barred());
        let contrast = (rings.gain.max(0.1) / rings.noise.max(0.3)).ln();
        let values = if let Some(end) = rings.end {
            let named = given(reading.is_some_and(|r| r.is_named));
            let read = [given(reading.is_some()), misfit, named, has_none, bars, is_plain_team];
            let beyond = range_m - self.reach.one_edge_m;
            let ringed = reading.map_or(0.0, |r| r.ringed);
            let seen = [rings.visible, end.stray_px, end.lid];
            [&seen[..], &outlines, &[found.goes_on], &read, &[ringed, range_m, beyond, contrast]].concat()
        } else {
            let [bend, sigma] = rings.bend;
            let bent = (0.5 * BEND_GATE - bend.abs()).min(0.0).powi(2) / (sigma * sigma + 0.03 * 0.03);
            let low = (rings.lower_m / height_sigma_m(rings, camera).max(0.004)).powi(2);
            let shown = [rings.visible, found.unhidden];
            let paint = [lack(rings.correlation), -(rings.paint_error(look) + 0.01).ln(), rings.black(look)];
            let sides = [found.open_sides as f64, found.goes_on];
            let certain = given(reading.is_some_and(|r| r.is_certain));
            let read = [misfit, certain, has_none, bars, is_plain_team];
            let place = [range_m, (rings.columns.len() as f64).ln(), given(self.part == Part::Upper), low];
            let bent = [bent, sigma.max(0.02).ln()];
            [&shown[..], &paint, &bent, &outlines, &sides, &read, &place, &[contrast]].concat()
        };
        let basis = if rings.end.is_some() { Basis::CylinderEnd } else { Basis::Rings };
        Traits::new(basis, values, || self.picture(rings))
    }

    /// What the body and what is about it look like in the picture at hand ([`Traits::picture`]).
    fn picture(&self, rings: &RingFit) -> Vec<i16> {
        let cylinder = rings.cylinder(self.look.radius_m);
        let half = cylinder.outline_rad;
        net::picture(self.samples.iter().map(|sample| {
            let met = cylinder.meet(&sample.ray);
            ([met.aside_rad / half, met.height_m + rings.lower_m], sample.gray)
        }))
    }
}
