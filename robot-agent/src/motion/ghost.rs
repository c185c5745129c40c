//! Ghosts: the trace in the background of somebody who stood in the first frames and has left.
//!
//! A ghost differs from the background like a person does, and stands still like a person who has stopped. What tells
//! them apart are edges: the outline of a real object is an edge in the picture, the outline of a ghost is an edge in the
//! *background*. So the steps across the outline are summed in both; no history is needed.

use super::raster::Raster;
use super::regions::Region;

/// Mean absolute grey step across the left and right outline of a region, in the picture and in the background.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct OutlineSteps {
    pub(crate) picture: f32,
    pub(crate) background: f32,
}

/// Columns from the outline to either side.
const REACH: usize = 2;

pub(crate) fn outline_steps(region: &Region, picture: &[u8], background: &[u16], raster: &Raster) -> OutlineSteps {
    let w = raster.width;
    let (mut in_picture, mut in_background, mut n) = (0u32, 0u32, 0u32);
    let mut add = |row: usize, outside: isize, inside: isize| {
        let column = |c: isize| {
            if raster.wraps {
                Some(c.rem_euclid(w as isize) as usize)
            } else {
                usize::try_from(c).ok().filter(|&c| c < w)
            }
        };
        if let (Some(o), Some(i)) = (column(outside), column(inside)) {
            let (o, i) = (row * w + o, row * w + i);
            in_picture += u32::from(picture[o].abs_diff(picture[i]));
            in_background += u32::from(background[o].abs_diff(background[i]) >> 8);
            n += 1;
        }
    };
    let reach = REACH as isize;
    for (row, start, len) in region.spans() {
        if len < 2 * REACH {
            continue;
        }
        let (first, last) = (start as isize, (start + len - 1) as isize);
        // Two columns wide: the outline of a blurred picture is a ramp.
        add(row, first - reach, first + reach - 1);
        add(row, last + reach, last - reach + 1);
    }
    if n == 0 {
        return OutlineSteps::default();
    }
    OutlineSteps { picture: in_picture as f32 / n as f32, background: in_background as f32 / n as f32 }
}

impl OutlineSteps {
    /// Whether the outline belongs to the background. Wants a clear step there: noise and texture have none.
    pub(crate) fn is_ghost(&self) -> bool {
        self.background > 1.5 * self.picture + 2.0
    }
}
