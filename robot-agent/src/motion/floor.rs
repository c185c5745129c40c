//! What stands and what lies: shadows on the floor are not part of bodies.
//!
//! A camera below people's hips sees everybody who stands on the floor reach above its horizon, at any distance; the floor
//! never does. So the columns of the mask that reach above the horizon are bodies; marks in other columns, however they
//! touch, are shadows or low things, and low things that are only darker than the floor are shadows. People
//! throw shadows on walls, too, shaped like people; those show the wall's own texture.

use super::kernel;
use super::marks::{Marks, WORD};
use super::raster::Raster;
use super::regions::Region;

/// Columns beside a body's that still belong to it: feet.
const MARGIN: usize = 2;

/// Splits a mask into upright bodies and low things. Three pixels above the horizon make a column a body's; `row` is the first row below the horizon.
pub(super) fn split(mask: &Marks, row: usize, raster: &Raster, upright: &mut Marks, low: &mut Marks) {
    let Raster { width, height, wraps } = *raster;
    let row = row.min(height);
    let stride = mask.stride();
    // Marks of each column above the horizon, up to three, in two planes.
    let (mut ones, mut twos) = (vec![0u64; stride], vec![0u64; stride]);
    for y in 0..row {
        for ((one, two), &m) in ones.iter_mut().zip(&mut twos).zip(mask.row(y)) {
            let carry = *one & m;
            (*one, *two) = ((*one ^ m) | (*two & carry), *two | carry);
        }
    }
    let is_body = |x: usize| ones[x / WORD] & twos[x / WORD] & 1 << (x % WORD) != 0;
    let mut body = vec![0u64; stride];
    for x in (0..width).filter(|x| is_body(*x)) {
        for offset in 0..=2 * MARGIN {
            let column = x + offset;
            let column = if wraps { (column + width - MARGIN) % width } else { column.wrapping_sub(MARGIN) };
            if column < width {
                body[column / WORD] |= 1 << (column % WORD);
            }
        }
    }
    upright.words_mut().copy_from_slice(mask.words());
    low.words_mut().fill(0);
    let below = row * stride..height * stride;
    let words = upright.words_mut()[below.clone()].iter_mut().zip(&mut low.words_mut()[below]);
    for ((u, l), body) in words.zip(body.iter().cycle()) {
        (*u, *l) = (*u & body, *u & !body);
    }
}

/// Whether a region is only darker, by less than half, nearly everywhere.
pub(super) fn is_darker(region: &Region, picture: &[u8], background: &[u16], raster: &Raster) -> bool {
    // All but a fifth.
    let enough = region.area.div_ceil(5);
    kernel::count_not_darker(&region.runs, raster.width, picture, background, enough) < enough
}

/// Whether a region shows the background's own texture, only darker: a soft shadow on a wall. Steps over some columns are
/// compared in picture and background; a shadow leaves no more difference than noise does, clothes and limbs leave more.
pub(super) fn is_soft_shadow(
    region: &Region,
    picture: &[u8],
    background: &[u16],
    noise: &[u16],
    raster: &Raster,
) -> bool {
    if !is_darker(region, picture, background, raster) {
        return false;
    }
    let (mut difference, mut expected) = (0u64, 0u64);
    for (row, start, len) in region.spans().filter(|(_, _, len)| *len > kernel::STEP) {
        let pixels = row * raster.width + start..row * raster.width + start + len;
        let (steps, deviations) =
            kernel::compare_steps(&picture[pixels.clone()], &background[pixels.clone()], &noise[pixels]);
        difference += u64::from(steps);
        expected += u64::from(deviations);
    }
    // Two pixels' noise: √2 of one, with a quarter to spare.
    expected > 0 && 10 * difference < 18 * expected
}
