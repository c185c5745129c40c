//! One region, several people: cut where the outline of heads and shoulders dips.
//!
//! People who stand beside each other touch at the shoulders or through a shadow, and were perhaps never seen apart. Counting
//! the region's pixels above the horizon column by column gives a profile with a peak for each head; arms are no half as
//! high. The profile is cut at its deepest dip between two peaks, again and again. Only bodies whose heads or feet are seen
//! are cut: of somebody so near that only the legs are in view, both legs are peaks.

use super::body::solid_rows;
use super::extent::BORDER_ROWS;
use crate::motion::{Region, Scene};

/// A dip must be this much below the lower of its two peaks …
const DIP: f64 = 0.2;
/// … and that peak at least this share of the region's highest.
const LEAST_PEAK: f64 = 0.5;
/// Least distance of two peaks, columns a row of the lower one: a third of a metre between heads.
const LEAST_DISTANCE: f64 = 0.14;
/// Narrowest piece, columns.
const LEAST_COLUMNS: usize = 4;
/// Lowest peak that is looked at, rows.
const LEAST_ROWS: f64 = 12.0;

/// The bodies of a region, left to right; the region itself where it is one. `row`: the first row below the horizon.
pub(super) fn split(region: &Region, scene: &Scene<'_>, row: usize) -> Vec<Region> {
    let solid = solid_rows(region, scene, 0..region.arc.width);
    let bottom_cut = solid[1] + BORDER_ROWS >= scene.raster.height;
    let top_cut = solid[0] < BORDER_ROWS;
    if bottom_cut && top_cut {
        return vec![region.clone()];
    }
    let profile = smooth(&profile(region, scene, row));
    let highest = profile.iter().copied().fold(0.0, f64::max);
    let mut cuts = Vec::new();
    cut(&profile, 0, highest, &mut cuts);
    cuts.sort_unstable();
    let mut pieces = Vec::new();
    let mut from = 0;
    for to in cuts.into_iter().chain([region.arc.width]) {
        pieces.extend(region.columns(from..to, scene.raster));
        from = to;
    }
    pieces
}

fn profile(region: &Region, scene: &Scene<'_>, row: usize) -> Vec<f64> {
    let width = scene.raster.width;
    let mut counts = vec![0.0; region.arc.width];
    for (_, start, len) in region.spans().take_while(|(r, _, _)| *r < row) {
        let offset = (start + width - region.arc.start) % width;
        for c in &mut counts[offset..(offset + len).min(region.arc.width)] {
            *c += 1.0;
        }
    }
    counts
}

fn smooth(profile: &[f64]) -> Vec<f64> {
    (0..profile.len())
        .map(|i| {
            let window = &profile[i.saturating_sub(1)..(i + 2).min(profile.len())];
            window.iter().sum::<f64>() / window.len() as f64
        })
        .collect()
}

/// Adds the cuts (columns from the region's first) of the profile, which starts at column `first`.
fn cut(profile: &[f64], first: usize, highest: f64, cuts: &mut Vec<usize>) {
    let n = profile.len();
    if n < 2 * LEAST_COLUMNS {
        return;
    }
    let peak = |range: std::ops::Range<usize>| {
        range.map(|i| (i, profile[i])).max_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, 0.0))
    };
    let mut best: Option<(f64, usize)> = None;
    for x in LEAST_COLUMNS..=n - LEAST_COLUMNS {
        let (left, right) = (peak(0..x), peak(x..n));
        let lower = left.1.min(right.1);
        let apart = (right.0 - left.0) as f64 >= LEAST_DISTANCE * lower;
        if lower < LEAST_PEAK * highest || lower < LEAST_ROWS || !apart {
            continue;
        }
        let dip = (lower - profile[x.min(n - 1)]) / lower;
        if dip >= DIP && best.is_none_or(|(d, _)| dip > d) {
            best = Some((dip, x));
        }
    }
    if let Some((_, x)) = best {
        cuts.push(first + x);
        cut(&profile[..x], first, highest, cuts);
        cut(&profile[x..], first + x, highest, cuts);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::{Raster, group};

    const RASTER: Raster = Raster { width: 300, height: 160, wraps: true };

    /// Heads, shoulders and legs at (axis column, top row), ten columns broad at the shoulders.
    fn people(at: &[(usize, usize)]) -> Vec<u8> {
        let mut mask = vec![0u8; RASTER.len()];
        let mut paint = |x: usize, half: usize, y0: usize, y1: usize| {
            for y in y0..y1 {
                for c in x + 300 - half..=x + 300 + half {
                    mask[y * 300 + c % 300] = 1;
                }
            }
        };
        for &(x, top) in at {
            paint(x, 3, top, top + 14);
            paint(x, 7, top + 14, top + 50);
            paint(x, 5, top + 50, 140);
        }
        mask
    }

    fn count(mask: &[u8]) -> Vec<usize> {
        let magnitude = vec![50; mask.len()];
        let scene = Scene { raster: &RASTER, picture: mask, mask, magnitude: &magnitude, valid: mask, objects: &[] };
        let region = group(mask, &RASTER, [1, 1], 1).remove(0);
        split(&region, &scene, 95).iter().map(|r| r.arc.centre().round() as usize % 300).collect()
    }

    #[test]
    fn two_people_shoulder_to_shoulder_are_two_also_over_the_seam() {
        let found = count(&people(&[(296, 20), (11, 26)]));
        assert_eq!(found.len(), 2, "{found:?}");
        assert!(found[0].abs_diff(296) <= 2 && found[1].abs_diff(11) <= 2, "{found:?}");
    }

    #[test]
    fn one_person_with_an_arm_out_is_one() {
        let mut mask = people(&[(100, 20)]);
        for y in 40..62 {
            mask[y * 300 + 107..y * 300 + 116].fill(1);
        }
        assert_eq!(count(&mask).len(), 1);
    }
}
