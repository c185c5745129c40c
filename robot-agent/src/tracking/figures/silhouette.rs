//! What an upright person covers in the panorama, by distance.
//!
//! A body's outline changes with gait and turn, so a silhouette is the *share of time* in which a cell is covered: certain in
//! the trunk, half in the legs, now and then where the arms and the stride reach. Heights of 1.5 to 1.9 m are averaged. The
//! shares are of a standing or walking adult as in anthropometric tables (shoulders 0.45 m, hips 0.35 m, head 0.16 m).

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
#[derive(Debug, Clone)]
pub(super) struct Silhouette {
    /// Along the floor, metres.
    pub(super) range_m: f64,
    /// Columns of cells on each side of the axis.
    pub(super) half: usize,
    /// Share of time in which the cell is covered.
    pub(super) cover: Vec<f32>,
    /// Log-likelihood ratio (body there : not there) of a cell that is not marked …
    pub(super) unmarked: Vec<f32>,
    /// … and how much more it is when the cell is marked.
    pub(super) marked_more: Vec<f32>,
}

impl Silhouette {
    /// Columns of cells.
    pub(super) fn width(&self) -> usize {
        2 * self.half + 1
    }
}

/// All distances, nearest first.
pub(super) fn all(view: &View, raster: &Raster, camera_m: f64) -> Vec<Silhouette> {
    let rows = raster.height.div_ceil(CELL[1]);
    let column_rad = CELL[0] as f64 * view.steps_rad(0.0, raster.height as f64 / 2.0)[0];
    let tangents: Vec<f64> = (0..rows)
        .map(|row| {
            let middle = row as f64 * CELL[1] as f64 + 0.5 * (CELL[1] as f64 - 1.0);
            view.angles_rad(0.0, middle.min(raster.height as f64 - 1.0)).map_or(0.0, |(_, elevation)| elevation.tan())
        })
        .collect();
    (0..LEVELS).map(|level| one(range_of_level(level as f64), camera_m, column_rad, &tangents)).collect()
}

/// Distance of a level, metres.
pub(super) fn range_of_level(level: f64) -> f64 {
    RANGE_M[0] * (RANGE_M[1] / RANGE_M[0]).powf(level / (LEVELS - 1) as f64)
}

/// Level of a distance; may lie outside of the levels that are.
pub(super) fn level_of_range(range_m: f64) -> f64 {
    (range_m.max(1e-3) / RANGE_M[0]).ln() / (RANGE_M[1] / RANGE_M[0]).ln() * (LEVELS - 1) as f64
}

fn one(range_m: f64, camera_m: f64, column_rad: f64, tangents: &[f64]) -> Silhouette {
    let reach_m = OUTLINE.iter().map(|(_, half)| half[2]).fold(0.0, f64::max) * HEIGHTS_M[HEIGHTS_M.len() - 1];
    let half = ((reach_m / range_m).atan().min(WIDEST_RAD) / column_rad).ceil() as usize;
    let mut silhouette = Silhouette {
        range_m,
        half,
        cover: Vec::with_capacity(tangents.len() * (2 * half + 1)),
        unmarked: Vec::new(),
        marked_more: Vec::new(),
    };
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
            let marked = CLUTTER + (DETECTION - CLUTTER) * share as f32;
            silhouette.cover.push(share as f32);
            silhouette.unmarked.push(((1.0 - marked) / (1.0 - CLUTTER)).ln());
            silhouette.marked_more.push((marked / CLUTTER).ln() - ((1.0 - marked) / (1.0 - CLUTTER)).ln());
        }
    }
    silhouette
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
