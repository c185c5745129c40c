//! What stands and what lies: shadows on the floor are not part of bodies.
//!
//! A camera below people's hips sees everybody who stands on the floor reach above its horizon, at any distance; the floor
//! never does. So the columns of the mask that reach above the horizon are bodies; marks in other columns, however they
//! touch, are shadows or low things, and low things that are only darker than the floor are shadows. People
//! throw shadows on walls, too, shaped like people; those show the wall's own texture.

use super::kernel;
use super::raster::Raster;
use super::regions::Region;

/// Pixels above the horizon that make a column a body's.
const LEAST_ABOVE: u32 = 3;
/// Columns beside a body's that still belong to it: feet.
const MARGIN: usize = 2;

/// Splits a mask into upright bodies and low things; `row` is the first row below the horizon.
pub(super) fn split(mask: &[u8], row: usize, raster: &Raster, upright: &mut [u8], low: &mut [u8]) {
    let Raster { width, height, wraps } = *raster;
    let row = row.min(height);
    let mut above = vec![0u32; width];
    for line in mask[..row * width].chunks_exact(width) {
        for (a, &m) in above.iter_mut().zip(line) {
            *a += u32::from(m);
        }
    }
    let mut body = vec![0u8; width];
    for (x, _) in above.iter().enumerate().filter(|(_, a)| **a >= LEAST_ABOVE) {
        for offset in 0..=2 * MARGIN {
            let column = x + offset;
            if wraps {
                body[(column + width - MARGIN) % width] = 1;
            } else if column >= MARGIN && column - MARGIN < width {
                body[column - MARGIN] = 1;
            }
        }
    }
    upright.copy_from_slice(mask);
    low.fill(0);
    for y in row..height {
        let line = y * width..(y + 1) * width;
        let columns = mask[line.clone()].iter().zip(&body);
        for ((u, l), (&m, &b)) in upright[line.clone()].iter_mut().zip(&mut low[line]).zip(columns) {
            *u = m & b;
            *l = m & !b & 1;
        }
    }
}

/// Whether a region is only darker, by less than half, nearly everywhere.
pub(super) fn is_darker(region: &Region, picture: &[u8], background: &[u16], raster: &Raster) -> bool {
    let darker: usize = region
        .spans()
        .map(|(row, start, len)| {
            let range = row * raster.width + start..row * raster.width + start + len;
            kernel::count_darker(&picture[range.clone()], &background[range])
        })
        .sum();
    10 * darker > 8 * region.area
}

/// Whether a region shows the background's own texture, only darker: a soft shadow on a wall. Steps over two columns are
/// compared in picture and background; a shadow leaves no more difference than noise does, clothes and limbs leave more.
pub(super) fn is_soft_shadow(
    region: &Region,
    picture: &[u8],
    background: &[u16],
    noise: &[u16],
    raster: &Raster,
) -> bool {
    const STEP: usize = 3;
    if !is_darker(region, picture, background, raster) {
        return false;
    }
    let (mut difference, mut expected) = (0u64, 0u64);
    for (row, start, len) in region.spans().filter(|(_, _, len)| *len > STEP) {
        let first = row * raster.width + start;
        for i in first..first + len - STEP {
            let now = (i32::from(picture[i + STEP]) - i32::from(picture[i])) << 8;
            let before = i32::from(background[i + STEP]) - i32::from(background[i]);
            difference += u64::from(now.abs_diff(before));
            expected += u64::from(noise[i]);
        }
    }
    // Two pixels' noise: √2 of one, with a quarter to spare.
    expected > 0 && 10 * difference < 18 * expected
}
