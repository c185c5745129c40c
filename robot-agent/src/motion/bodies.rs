//! Fragments of one body joined: what stands above each other with little between is one upright body.
//!
//! A belt of the wall's grey, a table's edge or a stripe of the shirt cuts a person into pieces above each other; people
//! beside each other are never above each other. So pieces are joined when they share most of the narrower one's columns
//! and the gap between their rows is small beside their joint height.

use super::raster::Raster;
use super::regions::Region;

/// Joins fragments until nothing changes; regions keep the order of their first pixel.
pub(crate) fn join_fragments(mut regions: Vec<Region>, raster: &Raster, max_gap_share: f64) -> Vec<Region> {
    keep_largest(&mut regions, MOST_FRAGMENTS);
    let belong = |a: &Region, b: &Region| belong_together(a, b, raster, max_gap_share);
    let mut a = 0;
    while a < regions.len() {
        let Some(b) = (a + 1..regions.len()).find(|b| belong(&regions[a], &regions[*b])) else {
            a += 1;
            continue;
        };
        let mut joined = (a, b);
        loop {
            let second = regions.remove(joined.1);
            let joint = Region::joined(&[&regions[joined.0], &second], raster);
            regions[joined.0] = joint;
            // Of those before, which fitted nobody, one may fit the larger one.
            let Some(before) = (0..joined.0).find(|before| belong(&regions[*before], &regions[joined.0])) else {
                break;
            };
            joined = (before, joined.0);
        }
        a = joined.0;
    }
    regions
}

/// Leaves out the smallest of too many, the others in their order.
fn keep_largest(regions: &mut Vec<Region>, most: usize) {
    if regions.len() <= most {
        return;
    }
    let mut areas: Vec<usize> = regions.iter().map(|region| region.area).collect();
    let (_, least, _) = areas.select_nth_unstable_by(most - 1, |a, b| b.cmp(a));
    let least = *least;
    regions.retain(|region| region.area >= least);
    regions.truncate(most);
}

/// Most fragments that are joined: leaves in the wind make thousands.
const MOST_FRAGMENTS: usize = 512;

fn belong_together(a: &Region, b: &Region, raster: &Raster, max_gap_share: f64) -> bool {
    let shared = a.arc.overlap(&b.arc, raster);
    if 2 * shared < a.arc.width.min(b.arc.width) {
        return false;
    }
    let gap = if a.rows[1] < b.rows[0] {
        b.rows[0] - a.rows[1] - 1
    } else if b.rows[1] < a.rows[0] {
        a.rows[0] - b.rows[1] - 1
    } else {
        0
    };
    let joint = a.rows[1].max(b.rows[1]) - a.rows[0].min(b.rows[0]) + 1;
    // Small pieces that lie within the other's box are its arms and stripes.
    gap as f64 <= (max_gap_share * joint as f64).max(2.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::regions::group;

    #[test]
    fn head_and_trunk_are_joined_and_neighbours_are_not() {
        let raster = Raster { width: 60, height: 60, wraps: true };
        let mut mask = vec![0u8; raster.len()];
        let mut paint = |x0: usize, y0: usize, w: usize, h: usize| {
            for y in y0..y0 + h {
                for x in x0..x0 + w {
                    mask[y * 60 + x % 60] = 1;
                }
            }
        };
        paint(57, 5, 6, 8); // head over the seam
        paint(55, 16, 10, 30); // trunk
        paint(30, 16, 10, 30); // neighbour
        let regions = join_fragments(group(&mask, &raster, [0, 0], 1), &raster, 0.12);
        assert_eq!(regions.len(), 2);
        assert_eq!(regions[0].rows, [5, 45]);
        assert_eq!(regions[0].arc.start, 55);
    }
}
