//! The loop that unwarps: one bilinear sample a pixel, plain, the oracle of the vectorised `tiles`.

mod blocks;
mod tiles;

pub(super) use blocks::{Segment, copy, differences};
pub(super) use tiles::Tiles;

use super::LutEntry;

/// Columns worked through from top to bottom before moving on. A tile's source pixels are then a wedge of the ring that
/// fits the first-level cache; whole rows would run around the ring 162 times and miss on every line.
const TILE_COLUMNS: usize = 64;

/// Samples `source` (rows of `stride` bytes) at every entry into `out`, both row by row with `width` a row.
///
/// value = (Σ wᵢ pᵢ + 2¹⁵) >> 16 with weights (256 − fx | fx) × (256 − fy | fy), within 0.9 gray levels of exact
/// interpolation. The caller has checked that `out` and `entries` have one length and that every entry's four pixels
/// lie inside `source`; pixels that do not are left at 0 rather than read.
pub(super) fn unwarp(source: &[u8], stride: usize, entries: &[LutEntry], width: usize, out: &mut [u8]) {
    if width == 0 {
        return;
    }
    for start in (0..width).step_by(TILE_COLUMNS) {
        let end = (start + TILE_COLUMNS).min(width);
        for (row, out_row) in entries.chunks_exact(width).zip(out.chunks_exact_mut(width)) {
            for (entry, value) in row[start..end].iter().zip(&mut out_row[start..end]) {
                *value = sample(source, stride, *entry);
            }
        }
    }
}

#[inline(always)]
fn sample(source: &[u8], stride: usize, entry: LutEntry) -> u8 {
    let offset = entry.offset as usize;
    // Two loads of two neighbouring pixels.
    let (Some(&[a, b]), Some(&[c, d])) = (pair(source, offset), pair(source, offset + stride)) else {
        return 0;
    };
    let (fx, fy) = (u32::from(entry.fx), u32::from(entry.fy));
    let upper = u32::from(a) * (256 - fx) + u32::from(b) * fx;
    let lower = u32::from(c) * (256 - fx) + u32::from(d) * fx;
    ((upper * (256 - fy) + lower * fy + (1 << 15)) >> 16) as u8
}

#[inline(always)]
fn pair(source: &[u8], offset: usize) -> Option<&[u8; 2]> {
    source.get(offset..)?.first_chunk()
}
