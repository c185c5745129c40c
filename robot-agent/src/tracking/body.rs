//! Measuring one body: where its vertical axis is, and what of it is seen.
//!
//! The middle of the box is where the swinging hand is, not where the body is, and a shadow on the wall is part of the box
//! too. The axis is taken from the columns of the upper part (trunk and head): each column weighs with how much it
//! differs from the background, thin and faint columns (arms, shadows) are left out, and the rest is averaged.

use super::extent::BORDER_ROWS;
use crate::motion::{Arc, Raster, Region, Scene, kernel};

/// Rows from the top that make the trunk and the head, as a share of what is seen.
const UPPER_SHARE: f64 = 0.55;
/// Columns that weigh less than this share of the heaviest are arms, edges and shadows …
const THIN: f64 = 0.35;
/// … and those below this share are not even counted to the body's columns.
const FAINT: f64 = 0.12;
/// Changes count up to this, grey levels: a white shirt is not more of a body than a gray one.
const FULL_CHANGE: u8 = 40;
/// Vertical bands of a [`Strip`].
pub(super) const BANDS: usize = 8;

/// What is measured on a region that shows one body.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Body {
    /// Columns and rows.
    pub(super) arc: Arc,
    pub(super) rows: [usize; 2],
    /// Of the axis: column, on a ring in [0, width).
    pub(super) axis: f64,
    /// Columns of the trunk.
    pub(super) trunk_width: f64,
    /// Whether it runs out of the picture above and below.
    pub(super) both_cut: bool,
    /// Columns and bands, for telling bodies apart inside one region.
    pub(super) strip: Strip,
}

impl Body {
    pub(super) fn measure(region: &Region, scene: &Scene<'_>) -> Self {
        let raster = scene.raster;
        let arc = region.arc;
        let limit = region.rows[0] + (UPPER_SHARE * region.height() as f64).ceil() as usize;
        let upper = region.runs.partition_point(|run| (run.row as usize) < limit);
        let mut weight = vec![0u32; arc.width + kernel::RUN_BLOCK];
        let runs = &region.runs[..upper];
        kernel::add_to_columns(runs, raster.width, arc.start, scene.magnitude, 1, FULL_CHANGE, &mut weight);
        weight.truncate(arc.width);
        let heaviest = f64::from(weight.iter().copied().max().unwrap_or(0));
        let least = heaviest * THIN;
        let counted = |w: &&u32| f64::from(**w) >= heaviest * FAINT;
        let first = weight.iter().position(|w| counted(&w)).unwrap_or(0);
        let last = weight.iter().rposition(|w| counted(&w)).unwrap_or(arc.width - 1);
        let (mut sum, mut weighted, mut trunk) = (0.0, 0.0, 0.0);
        for (i, &f) in weight.iter().enumerate() {
            let f = f64::from(f);
            if f >= least {
                sum += f;
                weighted += f * i as f64;
                trunk += 1.0;
            }
        }
        let offset = if sum > 0.0 { weighted / sum } else { (arc.width as f64 - 1.0) / 2.0 };
        let rows = solid_rows(region, scene, first..last + 1, SOLID);
        Self {
            both_cut: rows[0] < BORDER_ROWS && rows[1] + BORDER_ROWS >= raster.height,
            arc: Arc { start: raster.column(arc.start, first), width: last - first + 1 },
            rows,
            axis: raster.wrap_column(arc.start as f64 + offset),
            trunk_width: trunk,
            strip: Strip::of(region, scene),
        }
    }

    /// Of a box that somebody else found: its middle is the axis.
    pub(super) fn of_box(region: &Region, scene: &Scene<'_>) -> Self {
        Self {
            arc: region.arc,
            rows: region.rows,
            axis: scene.raster.wrap_column(region.arc.centre()),
            trunk_width: region.arc.width as f64,
            both_cut: false,
            strip: Strip { start: region.arc.start, filled: Vec::new(), gray: Vec::new() },
        }
    }

    /// The axis' offset from the strip's first column.
    pub(super) fn axis_offset(&self, raster: &Raster) -> f64 {
        raster.wrap_column(self.axis - self.strip.start as f64)
    }
}

/// Rows that change this much less than the typical one are not solid.
const SOLID: f64 = 0.5;

/// First and last row of what is solid in some columns (counted from the arc's first): rows that change at least so much of
/// what the typical one does, the first at least `at_top`, the last [`SOLID`]. Shadows on the floor run on below the feet, but fainter.
pub(super) fn solid_rows(
    region: &Region,
    scene: &Scene<'_>,
    columns: std::ops::Range<usize>,
    at_top: f64,
) -> [usize; 2] {
    let (width, start) = (scene.raster.width, region.arc.start);
    let mut rows = vec![(0u32, 0u32); region.height()];
    let (runs, first, changes) = (&region.runs, region.rows[0], scene.magnitude);
    kernel::add_to_rows(runs, width, start, &columns, first, changes, FULL_CHANGE, &mut rows);
    let mean = |(sum, n): &(u32, u32)| if *n == 0 { 0.0 } else { f64::from(*sum) / f64::from(*n) };
    let mut means = Vec::with_capacity(rows.len());
    means.extend(rows.iter().filter(|r| r.1 > 0).map(mean));
    if means.is_empty() {
        return region.rows;
    }
    let middle = means.len() / 2;
    let (_, typical, _) = means.select_nth_unstable_by(middle, f64::total_cmp);
    let typical = *typical;
    let first = rows.iter().position(|r| mean(r) >= at_top * typical).unwrap_or(0);
    let last = rows.iter().rposition(|r| mean(r) >= SOLID * typical).unwrap_or(rows.len() - 1);
    [region.rows[0] + first, region.rows[0] + last]
}

/// A region in columns and eight bands of the picture's rows: how full each cell is and how bright.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Strip {
    /// First column, as in the region's arc.
    pub(super) start: usize,
    /// A column each: share of the band's rows that are filled, 0 … 1.
    pub(super) filled: Vec<[f32; BANDS]>,
    /// Mean grey level of the filled pixels.
    pub(super) gray: Vec<[f32; BANDS]>,
}

impl Strip {
    pub(super) fn of(region: &Region, scene: &Scene<'_>) -> Self {
        let raster = scene.raster;
        let width = region.arc.width;
        // By bands first: rows of pixels are added to rows of sums.
        let mut counts = vec![0u16; BANDS * width + kernel::RUN_BLOCK];
        let mut sums = vec![0u32; BANDS * width + kernel::RUN_BLOCK];
        let size = [raster.width, raster.height];
        let start = region.arc.start;
        kernel::add_to_cells(&region.runs, size, start, width, BANDS, scene.picture, &mut counts, &mut sums);
        let rows_of_band = raster.height as f32 / BANDS as f32;
        let (mut filled, mut gray) = (vec![[0f32; BANDS]; width], vec![[0f32; BANDS]; width]);
        look_of_cells(&counts, &sums, rows_of_band, &mut filled, &mut gray);
        Self { start: region.arc.start, filled, gray }
    }
}

kernel::wide! {
/// How full cells of `rows` rows are and how bright, column by column, from the counts and sums of their pixels, band by band.
fn look_of_cells(counts: &[u16], sums: &[u32], rows: f32, filled: &mut [[f32; BANDS]], gray: &mut [[f32; BANDS]]) {
    let width = filled.len();
    for (column, (filled, gray)) in filled.iter_mut().zip(gray).enumerate() {
        let (mut n, mut sum) = ([0f32; BANDS], [0f32; BANDS]);
        for band in 0..BANDS {
            n[band] = f32::from(counts[band * width + column]);
            sum[band] = sums[band * width + column] as f32;
        }
        for band in 0..BANDS {
            filled[band] = (n[band] / rows).min(1.0);
            // Nothing where there is nothing: its sum is 0.
            gray[band] = sum[band] / n[band].max(1.0);
        }
    }
}
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::group;

    #[test]
    fn an_outstretched_arm_does_not_move_the_axis() {
        let raster = Raster { width: 200, height: 100, wraps: true };
        let mut mask = vec![0u8; raster.len()];
        let mut paint = |x0: usize, y0: usize, w: usize, h: usize| {
            for y in y0..y0 + h {
                for x in x0..x0 + w {
                    mask[y * 200 + x % 200] = 1;
                }
            }
        };
        paint(190, 10, 21, 80); // body over the seam, axis at column 200 = 0
        paint(211, 30, 14, 5); // arm
        let region = group(&mask, &raster, [0, 0], 1).remove(0);
        let magnitude = vec![50; mask.len()];
        let scene = Scene { magnitude: &magnitude, ..Scene::of_marks(&raster, &mask, &mask) };
        let body = Body::measure(&region, &scene);
        assert!(raster.column_difference(body.axis, 200.0).abs() < 0.6, "{}", body.axis);
        assert_eq!((body.arc.start, body.arc.width), (190, 21));
    }
}
