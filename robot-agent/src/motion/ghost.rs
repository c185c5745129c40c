//! Ghosts: the trace in the background of somebody who stood in the first frames and has left.
//!
//! A ghost differs from the background like a person does, and stands still like a person who has stopped. What tells
//! them apart are edges: the outline of a real object is an edge in the picture, the outline of a ghost is an edge in the
//! *background*. So the steps across the outline are compared place by place; no history is needed.

use super::raster::Raster;
use super::regions::Region;

/// Places of a region's left and right outline where the step is clearly larger in the picture or in the background.
/// Votes, not sums: one poster behind has stronger edges than a whole person.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct OutlineSteps {
    pub(crate) picture: u32,
    pub(crate) background: u32,
}

/// Grey levels by which a step must be larger.
const CLEARLY: u16 = 5;
/// Fewest places that say anything.
const LEAST_PLACES: u32 = 8;

/// Columns from the outline to either side.
const REACH: usize = 2;

pub(crate) fn outline_steps(region: &Region, picture: &[u8], background: &[u16], raster: &Raster) -> OutlineSteps {
    let w = raster.width;
    let mut votes = OutlineSteps::default();
    let mut compare = |o: usize, i: usize| {
        let in_picture = u16::from(picture[o].abs_diff(picture[i]));
        let in_background = background[o].abs_diff(background[i]) >> 8;
        votes.picture += u32::from(in_picture > in_background + CLEARLY);
        votes.background += u32::from(in_background > in_picture + CLEARLY);
    };
    let reach = REACH as isize;
    for (row, start, len) in region.spans() {
        if len < 2 * REACH {
            continue;
        }
        // Two columns wide: the outline of a blurred picture is a ramp.
        let (left, right) = (row * w + start, row * w + start + len - 1);
        if start >= REACH && start + len + REACH <= w {
            compare(left - REACH, left + REACH - 1);
            compare(right + REACH, right + 1 - REACH);
            continue;
        }
        // At the picture's ends.
        let (first, last) = (start as isize, (start + len - 1) as isize);
        for (outside, inside) in [(first - reach, first + reach - 1), (last + reach, last - reach + 1)] {
            if let (Some(o), Some(i)) = (raster.column_at(outside), raster.column_at(inside)) {
                compare(row * w + o, row * w + i);
            }
        }
    }
    votes
}

/// What an outline is an edge of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Outline {
    /// The picture: somebody is there.
    Picture,
    /// The background: somebody has left.
    Background,
    /// Hard to tell.
    #[default]
    Unclear,
}

impl OutlineSteps {
    pub(crate) fn belong_to(&self) -> Outline {
        if self.background >= LEAST_PLACES && 2 * self.background > 3 * self.picture {
            Outline::Background
        } else if self.picture >= LEAST_PLACES && self.picture > 2 * self.background {
            Outline::Picture
        } else {
            Outline::Unclear
        }
    }
}

#[cfg(test)]
mod tests {
    use protocol::time::Timestamp;

    use crate::motion::{Arc, Holds, MotionSettings, MotionStage, Patch, Raster};

    /// Frames after it stopped in which somebody is still an object who stands before a striped wall, in clothes like the
    /// brighter stripes beside which his outline lies: it is an edge of the background.
    fn frames_in_view(recognised: bool) -> usize {
        let raster = Raster { width: 240, height: 120, wraps: false };
        let settings = MotionSettings { own_motion: false, ..MotionSettings::default() };
        let mut stage = MotionStage::new(raster, None, settings).unwrap();
        let wall = |column: usize| if column % 12 < 6 { 150 } else { 70 };
        let body = 102..138;
        let patch = Patch { arc: Arc { start: body.start - 4, width: body.len() + 8 }, rows: [14, 119] };
        let recognised = if recognised { vec![patch] } else { Vec::new() };
        let holds = Holds { keep: vec![patch], recognised, ..Holds::default() };
        let mut seen = 0;
        for frame in 0..80 {
            let shown = |i: usize| {
                let (column, row) = (i % raster.width, i / raster.width);
                let inside = frame >= 30 && body.contains(&column) && row >= 20;
                if inside { 150 } else { wall(column) }
            };
            let picture: Vec<u8> = (0..raster.len()).map(shown).collect();
            stage.change(&picture, Timestamp::from_secs_f64(100.0 + 0.1 * f64::from(frame))).unwrap();
            stage.extract();
            seen += usize::from(frame >= 30 && !stage.scene().objects.is_empty());
            stage.learn(&holds);
        }
        seen
    }

    #[test]
    fn a_trace_in_the_background_goes_and_somebody_who_looks_like_himself_stays() {
        let (nobody, somebody) = (frames_in_view(false), frames_in_view(true));
        assert!(nobody < 15 && somebody == 50, "{nobody} {somebody}");
    }
}
