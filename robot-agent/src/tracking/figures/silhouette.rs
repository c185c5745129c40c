//! What an upright person covers in the panorama, by distance.
//!
//! A body's outline changes with gait and turn, so a silhouette is the *share of time* in which a cell is covered: certain in
//! the trunk, half in the legs, now and then where the arms and the stride reach. Heights of 1.5 to 1.9 m are averaged. The
//! shares are of a standing or walking adult as in anthropometric tables (shoulders 0.45 m, hips 0.35 m, head 0.16 m).

use std::sync::Arc;

use crate::motion::Raster;
use crate::tracking::View;

/// Columns and rows of a cell, pixels.
pub(super) const CELL: [usize; 2] = [3, 4];
/// Chance that a covered cell is marked: clothes may look like what is behind them.
const DETECTION: f32 = 0.85;
/// Chance that a free cell is marked: shadows, noise.
const CLUTTER: f32 = 0.04;
/// Nearest and furthest distance, metres, and how many steps are between them.
const RANGE_M: [f64; 2] = [0.45, 11.0];
/// Number of distances.
pub(super) const LEVELS: usize = 33;
/// Heights that are averaged, metres.
const HEIGHTS_M: [f64; 5] = [1.5, 1.6, 1.7, 1.8, 1.9];
/// Widest half of a silhouette, radians.
const WIDEST_RAD: f64 = 0.9;

/// Shares of cover: (height as a part of the body's, then half widths, as parts of the height, to which cover is certain, usual, sometimes).
const OUTLINE: [(f64, [f64; 3]); 9] = [
    (0.00, [0.03, 0.10, 0.21]),
    (0.25, [0.04, 0.09, 0.17]),
    (0.42, [0.07, 0.11, 0.19]),
    (0.50, [0.085, 0.125, 0.19]),
    (0.62, [0.08, 0.115, 0.16]),
    (0.78, [0.095, 0.13, 0.15]),
    (0.83, [0.05, 0.10, 0.14]),
    (0.88, [0.035, 0.05, 0.075]),
    (1.00, [0.02, 0.04, 0.055]),
];
/// Cover within the three half widths.
const COVER: [f64; 3] = [0.92, 0.6, 0.2];

/// One distance: cells `rows` × (2 · `half` + 1), centred on the axis.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Silhouette {
    /// Along the floor, metres.
    pub(super) range_m: f64,
    /// Columns of cells on each side of the axis.
    pub(super) half: usize,
    /// Share of time in which the cell is covered.
    pub(super) cover: Vec<f32>,
    /// Log-likelihood ratio (body there : not there) of a cell that is not marked …
    pub(super) unmarked: Vec<f32>,
    /// … and of one that is.
    pub(super) marked: Vec<f32>,
    /// Gain of a body that is marked as often as expected.
    pub(super) full: f32,
}

impl Silhouette {
    /// Columns of cells.
    pub(super) fn width(&self) -> usize {
        2 * self.half + 1
    }

    /// What a cell is expected to gain that is marked in a share `cover` of the time.
    pub(super) fn expected_gain(&self, cell: usize, cover: f32) -> f32 {
        self.unmarked[cell] + cover * (self.marked[cell] - self.unmarked[cell])
    }

    fn of_cover(range_m: f64, half: usize, cover: Vec<f32>) -> Self {
        let ratios = |c: &f32| {
            let marked = CLUTTER + (DETECTION - CLUTTER) * c;
            let unmarked = ((1.0 - marked) / (1.0 - CLUTTER)).ln();
            (unmarked, (marked / CLUTTER).ln())
        };
        let (unmarked, marked): (Vec<f32>, Vec<f32>) = cover.iter().map(ratios).unzip();
        let full = cover.iter().zip(unmarked.iter().zip(&marked)).map(|(c, (u, m))| u + c * (m - u)).sum();
        Self { range_m, half, cover, unmarked, marked, full }
    }
}

/// What one person covers, learnt while nobody was in front or beside: in metres about the axis, so that it holds at any
/// distance. It knows the person's height and breadth, and which clothes cannot be told from what is behind.
#[derive(Debug, Clone)]
pub(in crate::tracking) struct Shape {
    share: Vec<f32>,
    frames: f32,
}

/// Size of a shape's bins (across, up) and their number, metres.
const BIN_M: [f64; 2] = [0.06, 0.1];
const BINS: [usize; 2] = [25, 21];
/// Frames for which the average outline counts beside what is learnt.
const PRIOR_FRAMES: f32 = 12.0;
/// Frames over which a shape is averaged.
const MOST_FRAMES: f32 = 12.0;

impl Default for Shape {
    fn default() -> Self {
        Self { share: vec![0.0; BINS[0] * BINS[1]], frames: 0.0 }
    }
}

impl Shape {
    fn bin(x_m: f64, z_m: f64) -> Option<usize> {
        let across = (x_m / BIN_M[0]).round() + (BINS[0] / 2) as f64;
        let up = (z_m / BIN_M[1]).floor();
        let inside = (0.0..BINS[0] as f64).contains(&across) && (0.0..BINS[1] as f64).contains(&up);
        inside.then(|| up as usize * BINS[0] + across as usize)
    }
}

/// Silhouettes at all distances, of the average person and of known ones.
#[derive(Debug)]
pub(super) struct Silhouettes {
    average: Vec<Arc<Silhouette>>,
    /// Distance across and height of each cell of each silhouette, metres.
    places: Vec<Vec<(f32, f32)>>,
}

impl Silhouettes {
    /// For a view.
    pub(super) fn new(view: &View, raster: &Raster, camera_m: f64) -> Self {
        let rows = raster.height.div_ceil(CELL[1]);
        let column_rad = CELL[0] as f64 * view.steps_rad(0.0, raster.height as f64 / 2.0)[0];
        let tangents: Vec<f64> = (0..rows)
            .map(|row| {
                let middle = row as f64 * CELL[1] as f64 + 0.5 * (CELL[1] as f64 - 1.0);
                view.angles_rad(0.0, middle.min(raster.height as f64 - 1.0)).map_or(0.0, |(_, e)| e.tan())
            })
            .collect();
        let (average, places) =
            (0..LEVELS).map(|l| average(range_of_level(l as f64), camera_m, column_rad, &tangents)).unzip();
        Self { average, places }
    }

    /// The average person at a level.
    pub(super) fn average(&self, level: usize) -> &Arc<Silhouette> {
        &self.average[level]
    }

    /// Height over the floor of a row of cells of somebody at a level, metres.
    pub(super) fn height_m(&self, level: usize, row: usize) -> f64 {
        let width = self.average[level].width();
        self.places[level].get(row * width + width / 2).map_or(f64::NAN, |(_, z)| f64::from(*z))
    }

    /// A known person at a level.
    pub(super) fn of(&self, shape: &Shape, level: usize) -> Arc<Silhouette> {
        let average = &self.average[level];
        if shape.frames == 0.0 {
            return Arc::clone(average);
        }
        let known = shape.frames / (shape.frames + PRIOR_FRAMES);
        let blend = |(c, (x, z)): (&f32, &(f32, f32))| {
            let learnt = Shape::bin(f64::from(*x), f64::from(*z)).map_or(0.0, |bin| shape.share[bin]);
            c + known * (learnt - c)
        };
        let cover = average.cover.iter().zip(&self.places[level]).map(blend).collect();
        Arc::new(Silhouette::of_cover(average.range_m, average.half, cover))
    }

    /// Lets a shape follow what is marked: `marked(row, column)` gives the share marked of the silhouette's cells, `None`
    /// where it cannot be told.
    pub(super) fn learn(&self, shape: &mut Shape, level: usize, marked: impl Fn(usize, usize) -> Option<f32>) {
        let width = self.average[level].width();
        let mut sums = vec![(0f32, 0f32); shape.share.len()];
        for (i, (x, z)) in self.places[level].iter().enumerate() {
            if let Some(bin) = Shape::bin(f64::from(*x), f64::from(*z))
                && let Some(share) = marked(i / width, i % width)
            {
                sums[bin].0 += share;
                sums[bin].1 += 1.0;
            }
        }
        shape.frames = (shape.frames + 1.0).min(MOST_FRAMES);
        for (share, (sum, n)) in shape.share.iter_mut().zip(sums) {
            if n > 0.0 {
                *share += (sum / n - *share) / shape.frames;
            }
        }
    }
}

/// Distance of a level, metres.
pub(super) fn range_of_level(level: f64) -> f64 {
    RANGE_M[0] * (RANGE_M[1] / RANGE_M[0]).powf(level / (LEVELS - 1) as f64)
}

/// Level of a distance; may lie outside of the levels that are.
pub(super) fn level_of_range(range_m: f64) -> f64 {
    (range_m.max(1e-3) / RANGE_M[0]).ln() / (RANGE_M[1] / RANGE_M[0]).ln() * (LEVELS - 1) as f64
}

fn average(range_m: f64, camera_m: f64, column_rad: f64, tangents: &[f64]) -> (Arc<Silhouette>, Vec<(f32, f32)>) {
    let reach_m = OUTLINE.iter().map(|(_, half)| half[2]).fold(0.0, f64::max) * HEIGHTS_M[HEIGHTS_M.len() - 1];
    let half = ((reach_m / range_m).atan().min(WIDEST_RAD) / column_rad).ceil() as usize;
    let (mut cover, mut places) = (Vec::new(), Vec::new());
    for tangent in tangents {
        let z_m = camera_m + range_m * tangent;
        for column in 0..=2 * half {
            let aside = (column as f64 - half as f64) * column_rad;
            // The mean over the cell, for a body may be as narrow as one.
            let share = [-0.33, 0.0, 0.33]
                .iter()
                .map(|part| range_m * (aside + part * column_rad).tan().abs())
                .flat_map(|x_m| HEIGHTS_M.iter().map(move |h| cover_at(z_m / h, x_m / h)))
                .sum::<f64>()
                / (3 * HEIGHTS_M.len()) as f64;
            cover.push(share as f32);
            places.push(((range_m * aside.tan()) as f32, z_m as f32));
        }
    }
    (Arc::new(Silhouette::of_cover(range_m, half, cover)), places)
}

/// Share of time in which a body covers a place at a height and a distance from its axis, both as parts of its height.
fn cover_at(z: f64, x: f64) -> f64 {
    if !(0.0..=1.0).contains(&z) {
        return 0.0;
    }
    let above = OUTLINE.iter().position(|(h, _)| *h >= z).unwrap_or(OUTLINE.len() - 1).max(1);
    let (low, high) = (&OUTLINE[above - 1], &OUTLINE[above]);
    let part = (z - low.0) / (high.0 - low.0);
    (0..3).find(|&k| x <= low.1[k] + part * (high.1[k] - low.1[k])).map_or(0.0, |k| COVER[k])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cover_falls_from_the_axis_to_the_sides_and_ends_at_head_and_feet() {
        for z in [0.05, 0.3, 0.5, 0.7, 0.8, 0.95] {
            let row: Vec<f64> = (0..30).map(|i| cover_at(z, f64::from(i) * 0.01)).collect();
            assert!(row.windows(2).all(|w| w[0] >= w[1]), "{z}: {row:?}");
            assert!(row[0] > 0.9 && row[29] == 0.0);
        }
        assert_eq!(cover_at(1.01, 0.0), 0.0);
        assert_eq!(cover_at(-0.01, 0.0), 0.0);
    }

    #[test]
    fn levels_and_ranges_are_inverse() {
        for level in [0.0, 7.5, 32.0] {
            assert!((level_of_range(range_of_level(level)) - level).abs() < 1e-9);
        }
        assert!((range_of_level(0.0) - RANGE_M[0]).abs() < 1e-12);
    }
}
