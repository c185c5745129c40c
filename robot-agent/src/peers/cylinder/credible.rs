//! Whether what was fitted is a robot.
//!
//! Problem: shelves, chairs, blinds and striped boxes fit a painted cylinder here and there. Insight: they do not in everything at
//! once: paint, bend, outlines, bars. Algorithm: the fewer outlines confirm a body, the better everything else must be; rings beyond
//! all doubt, or bars that are one robot's and nobody else's, need no outline at all.

use super::super::edges::EdgeFit;
use super::super::rings::RingFit;
use super::{BEND_GATE, CylinderFinder, Found, LEAST_CORRELATION, Part, RANGE_SLACK, height_sigma_m};
use crate::optics::MountedCamera;

/// What the rings must reach, by the number of outlines that confirm them: fewer outlines, less doubt. A fitted robot has a
/// correlation of 0.99 and a paint error of 0.02; shelves and chair legs stay below 0.97 and above 0.05.
const DOUBT: [Doubt; 3] = [
    Doubt { correlation: 0.98, paint: 0.06, bend: 0.25 },
    Doubt { correlation: 0.97, paint: 0.07, bend: 0.35 },
    Doubt { correlation: 0.95, paint: 0.09, bend: 0.45 },
];
/// Black paint is nearly black: gray level of black over white's less black's.
const MOST_BLACK: f64 = 0.3;
/// Beyond, a body of 0.2 m is 14 pixels wide and much looks like it, metres.
const FARTHEST_M: f64 = 6.2;
/// Beyond, the corner of a striped box bends as a cylinder does: both outlines must be there, metres.
const FARTHEST_ONE_SIDED_M: f64 = 4.0;
/// A flat board bends by −1: nothing is a cylinder that is nearer to it than this.
const FLATTEST: f64 = -0.6;
/// A flat board must fit worse than a cylinder by this much χ², by the number of outlines.
const ROUND_CHI2: [f64; 3] = [9.0, 9.0, 4.0];

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
/// Bodies without bars, in a team with bars, that are wholly seen this far away correlate like this: of 150 true ones none was
/// below, of 14 false ones two.
const PLAIN_RANGE_M: std::ops::Range<f64> = 1.5..3.2;
const WHOLLY_SEEN: f64 = 0.9;
const LEAST_WITHOUT_BARS: f64 = 0.985;
/// Bars that are one robot's and nobody else's and fit like this need no outline: in 300 rooms without robots the two that were
/// certain fitted with 1.7 and 2.4. In 900 with robots three more were none, further away than rings are beyond doubt or by one edge
/// between two rings.
const WORST_SPELT: f64 = 1.2;
const LEAST_SPELT_EDGES: usize = 2;
/// Share of the columns in which the upper end must be where the curve says: of 30 true bodies the least was 0.93, what else was
/// fitted reached 0.8.
const LEAST_RIM: f64 = 0.85;
/// The same where bars are read: so many, each column no worse than this.
const LEAST_READ_RIM: f64 = 0.7;
const LEAST_READ_BARS: usize = 3;
const WORST_READ: f64 = 1.5;
/// The same with one outline and neither enough bars nor a name: of true bodies the least was 0.97, plates and tables came to 0.94.
pub(super) const LEAST_LONE_RIM: f64 = 0.96;
/// How far the only outline may be from where rings put it, pixels, and how many sigmas beyond [`BEND_GATE`] their bend may be.
const LONE_WAY_PX: f64 = 0.8;
const LONE_BEND: f64 = 2.5;
/// With less than two outlines and this share of the columns it must be clear which bars they show.
const LEAST_UNCLEAR: f64 = 0.7;

/// Limits of a verdict.
struct Doubt {
    correlation: f64,
    paint: f64,
    /// Largest standard deviation of the bend: the test must have had a chance to fail.
    bend: f64,
}

impl CylinderFinder {
    /// Whether it is.
    pub(super) fn is_credible(&self, camera: &MountedCamera, found: &Found) -> bool {
        let (look, rings) = (&self.look, &found.rings);
        let range_m = rings.near_m + look.radius_m;
        // Bars from side to side are as good as outlines.
        let (seen, has_bars) = (found.outlines(), found.has_bars());
        let doubt = &DOUBT[seen];
        let reading = found.reading.as_ref();
        let is_unclear = look.is_barred() && reading.is_none_or(|r| !r.is_named);
        let is_read = reading.is_some_and(|r| r.bars.len() >= LEAST_READ_BARS && r.misfit < WORST_READ);
        let is_spelt = reading.is_some_and(|r| r.is_certain && r.misfit < WORST_SPELT)
            && rings.near_m < PLAIN_M
            && rings.edges_seen >= LEAST_SPELT_EDGES
            && !rings.is_rim;
        let is_certain = is_spelt || seen > 0 && reading.is_some_and(|r| r.is_certain);
        let is_plain = self.is_plain(rings, camera);
        let is_told = reading.is_some() || !look.is_barred();

        // A body without bars correlates better than one with them.
        let is_without_bars = reading.is_some_and(|r| look.patterns[r.pattern].bars.is_empty());
        let is_whole = rings.visible > WHOLLY_SEEN && PLAIN_RANGE_M.contains(&range_m) && !rings.is_rim;
        let correlation = match is_certain {
            true => LEAST_CORRELATION,
            false if is_without_bars && is_whole => doubt.correlation.max(LEAST_WITHOUT_BARS),
            false => doubt.correlation,
        };
        let is_painted = rings.correlation >= correlation
            && rings.paint_error(look) <= doubt.paint
            && rings.black(look) <= MOST_BLACK;
        let is_bent =
            is_certain || rings.bend[1] <= doubt.bend && is_round(rings, ROUND_CHI2[seen]) && rings.bend[0] >= FLATTEST;
        let is_clear = seen == 2 || rings.visible >= LEAST_UNCLEAR || !is_unclear || is_plain;
        let is_there = match seen {
            // A striped box of which a corner is hidden bends, too.
            0 => is_plain || is_spelt || rings.visible >= 0.5 && (is_read || rings.edges_seen >= 2 && has_bars),
            1 => has_bars || is_trusty(rings, found.left.or(found.right)),
            _ => true,
        };
        // Soon a ring edge is in view, too: a curve with one outline, or with unknown bars, is something else.
        let is_soon = range_m > self.reach.one_edge_m / RANGE_SLACK;
        let is_rim = !rings.is_rim
            || !(is_soon && (is_unclear || seen < 2 && !is_read))
                && (seen == 2 || is_read || is_certain || seen == 1 && is_told && rings.visible >= LEAST_LONE_RIM)
                && rings.visible >= if is_read { LEAST_READ_RIM } else { LEAST_RIM };
        is_painted
            && is_bent
            && is_clear
            && is_there
            && is_rim
            && (self.part == Part::Whole || is_plain || is_spelt)
            && range_m <= FARTHEST_M
            && (seen == 2 || range_m <= FARTHEST_ONE_SIDED_M || is_certain)
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

/// Whether the only outline is where the rings put it, and they bend as they should: a box's corner nearly does.
fn is_trusty(rings: &RingFit, outline: Option<EdgeFit>) -> bool {
    outline.is_some_and(|fit| (fit.outwards_rad * fit.px_per_rad).abs() < LONE_WAY_PX)
        && rings.bend[0].abs() <= BEND_GATE + LONE_BEND * rings.bend[1]
}

/// Whether the rings bend as a cylinder's much rather than as a flat board's, which a single outline would not tell.
fn is_round(rings: &RingFit, chi2: f64) -> bool {
    let variance = rings.bend[1].powi(2) + BEND_GATE.powi(2) / 4.0;
    (rings.bend[0] + 1.0).powi(2) - rings.bend[0].powi(2) > chi2 * variance || rings.edges_seen < 2
}
