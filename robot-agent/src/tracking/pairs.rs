//! Two people side by side in one region: two heads over one mass.
//!
//! People who come together are one region from their first frame on, so no track remembers them apart. What tells two
//! upright bodies from a broad one is the upper outline: two tops about equally high, a head's breadth or more apart, with a
//! dip between. The region is cut in the dip; what moves there is then assigned to tracks like any other region.

use crate::motion::{Raster, Region};

/// Smallest height, pixels, at which an outline says anything.
const LEAST_HEIGHT: usize = 20;
/// Width over height from which somebody may be two.
const LEAST_ASPECT: f64 = 0.42;
/// Of the height: how much lower than the higher top the other may be, and the dip must be.
const TOPS_DIFFER: f64 = 0.3;
const LEAST_DIP: f64 = 0.1;
/// Of the height: the least breadth of each of the two.
const LEAST_BREADTH: f64 = 0.17;
/// Most bodies that one region is cut into.
const MOST: usize = 4;

/// The bodies in a region, from left to right: one in nearly every case.
pub(super) fn bodies(region: &Region, raster: &Raster) -> Vec<Region> {
    let mut whole = vec![region.clone()];
    let mut single = Vec::new();
    while let Some(region) = whole.pop() {
        if whole.len() + single.len() + 1 < MOST
            && let Some([left, right]) = cut(&region, raster)
        {
            whole.extend([right, left]);
        } else {
            single.push(region);
        }
    }
    single
}

/// The two parts of a region with two tops.
fn cut(region: &Region, raster: &Raster) -> Option<[Region; 2]> {
    let (width, height) = (region.arc.width, region.height());
    let tall = height as f64;
    if height < LEAST_HEIGHT || (width as f64) < LEAST_ASPECT * tall {
        return None;
    }
    let outline = upper_outline(region, raster);
    let breadth = (LEAST_BREADTH * tall).ceil().max(3.0) as usize;
    if 2 * breadth >= width {
        return None;
    }
    // The dip whose lower neighbour top stands most above it.
    let highest = |columns: &[f64]| columns.iter().copied().fold(f64::INFINITY, f64::min);
    let (dip, depth) = (breadth..width - breadth)
        .map(|x| {
            let (left, right) = (highest(&outline[..x]), highest(&outline[x + 1..]));
            let depth = if (left - right).abs() > TOPS_DIFFER * tall { 0.0 } else { outline[x] - left.max(right) };
            (x, depth)
        })
        .max_by(|a, b| a.1.total_cmp(&b.1))?;
    if depth < (LEAST_DIP * tall).max(3.0) {
        return None;
    }
    // The dip's middle, where it is flat.
    let flat = outline[dip..width - breadth].iter().take_while(|o| **o == outline[dip]).count();
    let middle = dip + flat / 2;
    Some([region.columns(0..middle, raster)?, region.columns(middle..width, raster)?])
}

/// First row of the region in each column of its arc, smoothed over three columns; hair and noise make no heads.
fn upper_outline(region: &Region, raster: &Raster) -> Vec<f64> {
    let width = region.arc.width;
    let mut first = vec![region.rows[1] as f64; width];
    for (row, start, len) in region.spans() {
        let offset = (start + raster.width - region.arc.start) % raster.width;
        for column in &mut first[offset.min(width)..(offset + len).min(width)] {
            *column = column.min(row as f64);
        }
    }
    (0..width)
        .map(|x| {
            let near = &first[x.saturating_sub(1)..(x + 2).min(width)];
            near.iter().sum::<f64>() / near.len() as f64
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::group;

    /// Bodies with heads, standing at row 60: (column of the axis, breadth, height).
    fn region(people: &[(usize, usize, usize)]) -> (Region, Raster) {
        let raster = Raster { width: 100, height: 64, wraps: true };
        let mut mask = vec![0u8; raster.len()];
        for &(axis, breadth, height) in people {
            for y in 60 - height..60 {
                let half = if y < 60 - height * 5 / 6 { breadth / 4 } else { breadth / 2 };
                for x in axis + 100 - half..=axis + 100 + half {
                    mask[y * 100 + x % 100] = 1;
                }
            }
        }
        (group(&mask, &raster, [1, 1], 1).remove(0), raster)
    }

    #[test]
    fn two_side_by_side_are_two_also_on_the_seam() {
        for axis in [40, 95] {
            let (pair, raster) = region(&[(axis, 14, 44), (axis + 14, 14, 40)]);
            let bodies = bodies(&pair, &raster);
            assert_eq!(bodies.len(), 2, "at {axis}");
            let middle = raster.column_difference(bodies[1].arc.start as f64, axis as f64);
            assert!((middle - 7.0).abs() <= 2.0, "cut {middle} columns beside the first's axis");
            assert_eq!(bodies.iter().map(|b| b.area).sum::<usize>(), pair.area);
        }
    }

    #[test]
    fn one_with_an_arm_stretched_out_is_one_and_three_are_three() {
        let (one, raster) = region(&[(50, 16, 44), (62, 12, 24)]);
        assert_eq!(bodies(&one, &raster).len(), 1);
        let (three, raster) = region(&[(30, 14, 44), (44, 14, 42), (58, 14, 45)]);
        assert_eq!(bodies(&three, &raster).len(), 3);
    }
}
