//! What stands and what lies: shadows on the floor are not part of bodies.
//!
//! A camera below people's hips sees everybody who stands on the floor reach above its horizon, at any distance; the floor
//! never does. So the columns of the mask that reach above the horizon are bodies; marks in other columns, however they
//! touch, are shadows or low things, and low things that are only darker than the floor are shadows. People
//! throw shadows on walls, too, shaped like people; those show the wall's own texture.

use super::kernel;
use super::marks::Marks;
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
    let mut body: Vec<u64> = ones.iter().zip(&twos).map(|(one, two)| one & two).collect();
    for _ in 0..MARGIN {
        kernel::spread_by_one(&body, stride, width, wraps, &mut ones);
        std::mem::swap(&mut body, &mut ones);
    }
    upright.words_mut().copy_from_slice(mask.words());
    low.words_mut().fill(0);
    let below = row * stride..height * stride;
    let rows = upright.words_mut()[below.clone()].chunks_exact_mut(stride);
    for (upright, low) in rows.zip(low.words_mut()[below].chunks_exact_mut(stride)) {
        for ((u, l), body) in upright.iter_mut().zip(low).zip(&body) {
            (*u, *l) = (*u & body, *u & !body);
        }
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
