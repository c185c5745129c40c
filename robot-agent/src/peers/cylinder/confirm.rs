//! Names and headings where a side of the body may be hidden.
//!
//! Problem: what stands before a body and hides one side of it may make the bars there look like those of another robot, all of
//! whose other bars fit. Insight: the bars next to the side that is not seen are the doubtful ones. Algorithm: without them
//! the reading must be the same.

use super::super::bars::{self, Reading};
use super::super::edges::Side;
use super::super::rays::Sample;
use super::super::rings::{Column, RingFit};
use super::CylinderFinder;

/// Next to a missing outline bars are doubtful from this share of the half width on; headings with and without them differ by less.
const DOUBTFUL_SHARE: f64 = 0.2;
const SAME_HEADING_RAD: f64 = 0.1;
/// A side is hidden where so many of its columns show no rings.
const LEAST_HIDDEN: usize = 3;
/// A side is whole where more than this share of its third of the columns shows rings.
const WHOLE_SIDE: f64 = 0.85;

impl CylinderFinder {
    /// Whether rings are shown up to where an outline should be.
    pub(super) fn shows_up_to(rings: &RingFit, side: Side) -> bool {
        let measured: Vec<bool> =
            rings.columns.iter().filter(|c| c.correlation != 0.0).map(|c| c.visible || c.is_mixed).collect();
        let few = (measured.len() / 3).max(1);
        let shown = match side {
            Side::Left => measured.iter().rev().take(few).filter(|v| **v).count(),
            Side::Right => measured.iter().take(few).filter(|v| **v).count(),
        };
        shown as f64 > WHOLE_SIDE * few as f64
    }

    /// Sectors [right, left] in which something else than rings shows: somebody stands there.
    pub(super) fn hidden_sectors(rings: &RingFit) -> Vec<[f64; 2]> {
        let shows = |c: &Column| c.visible || c.is_mixed;
        let measured: Vec<usize> = (0..rings.columns.len()).filter(|c| rings.columns[*c].correlation != 0.0).collect();
        let (half, n) = (rings.half_rad, rings.columns.len() as f64);
        let at = |border: usize| rings.bearing_rad - half + 2.0 * half * border as f64 / n;
        let is_hidden = |c: usize| !shows(&rings.columns[c]);
        let mut sectors = Vec::new();
        let mut begin = 0;
        for run in measured.chunk_by(|a, b| is_hidden(*a) == is_hidden(*b)) {
            let end = begin + run.len();
            if is_hidden(run[0]) && run.len() >= LEAST_HIDDEN {
                // Up to the next columns that were looked at; at the outlines nobody knows.
                let right = begin.checked_sub(1).map_or(at(0) - half, |shown| at(measured[shown] + 1));
                let left = measured.get(end).map_or(at(rings.columns.len()) + half, |shown| at(*shown));
                sectors.push([right, left]);
            }
            begin = end;
        }
        sectors
    }

    /// Where an outline is missing somebody may stand before the bars next to it: name and heading must be the same without them.
    pub(super) fn confirmed(
        &self,
        samples: &[Sample],
        rings: &RingFit,
        mut reading: Reading,
        [left, right]: [bool; 2],
    ) -> Reading {
        let [left, right] =
            [(left, Side::Left), (right, Side::Right)].map(|(seen, side)| seen || Self::shows_up_to(rings, side));
        if left && right || !reading.is_named {
            return reading;
        }
        let half = rings.cylinder(self.look.radius_m).outline_rad;
        let [inner, outer] =
            [DOUBTFUL_SHARE * half, 1.2 * half].map(|aside| [-1.0, 1.0].map(|s| rings.bearing_rad + s * aside));
        let mut hidden = Vec::new();
        if !left {
            hidden.push([inner[1], outer[1]]);
        }
        if !right {
            hidden.push([outer[0], inner[0]]);
        }
        let again = bars::read(samples, &self.look, rings, self.noise2, &hidden).filter(|again| {
            let period_rad = self.look.patterns[reading.pattern].period_rad;
            let turned = again.heading_rad[0] - reading.heading_rad[0];
            let turned = turned - period_rad * (turned / period_rad).round();
            again.pattern == reading.pattern && turned.abs() < SAME_HEADING_RAD
        });
        reading.is_named &= again.as_ref().is_some_and(|again| again.is_named);
        reading.is_clear &= again.as_ref().is_some_and(|again| again.is_clear);
        reading.has_heading &= again.is_some_and(|again| again.has_heading);
        reading
    }
}
