//! The elevation interval of a body, with what each end is.
//!
//! An end at the border of what is tested is *cut*; an end below which something nearer stands (a neighbour in one region, a
//! fellow robot, furniture) is *hidden*. Both are bounds, never measurements. Furniture is not seen by the motion stage, but
//! a body whose feet are hidden by a table would, taken at its word, stand further away and be a giant: lower ends that
//! make no body are hidden too.

use protocol::message::ElevationEnd;

use super::range::{Range, from_ground_contact};
use super::view::View;
use crate::motion::Scene;

/// Lower and upper end of a body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Extent {
    /// Elevations, lowest first, radians.
    pub elevation_rad: [f64; 2],
    /// Of a seen end, radians.
    pub sigma_rad: f64,
    /// What the ends are.
    pub ends: [ElevationEnd; 2],
    /// Along the floor, where the feet are seen.
    pub range: Option<Range>,
}

/// Rows from the border of the tested picture at which an end is cut.
pub(super) const BORDER_ROWS: usize = 3;
/// Rows by which shadow, blur and shoes blur the lower end.
const FOOT_SIGMA_ROWS: f64 = 2.0;
const TOP_SIGMA_ROWS: f64 = 1.2;
/// Heights and breadths of an upright person, metres: what a range from the feet must give.
const PERSON_HEIGHT_M: [f64; 2] = [1.3, 2.15];
/// Largest difference of the logarithms of the range from the feet and the figure's.
const FIGURE_AGREES: f64 = 0.2;
const PERSON_BREADTH_M: [f64; 2] = [0.15, 0.95];

/// Measures the extent of what spans `rows` about `axis` and is `width_rad` wide. `shared`: other bodies are in the region.
/// `person`: taken for a person. `figure_m`: how far away the whole body seems to be, where a figure was fitted: feet that
/// would stand elsewhere are a shadow's end or hidden.
#[allow(clippy::too_many_arguments)]
pub(super) fn measure(
    scene: &Scene<'_>,
    view: &View,
    axis: f64,
    rows: [usize; 2],
    width_rad: f64,
    shared: bool,
    person: bool,
    figure_m: Option<f64>,
) -> Extent {
    let (top, bottom) = (rows[0] as f64 - 0.5, rows[1] as f64 + 0.5);
    let elevation = |row: f64| view.angles_rad(axis, row).map(|a| a.1);
    let middle = elevation(0.5 * (top + bottom)).unwrap_or(0.0);
    let elevation_rad = [
        elevation(bottom).or_else(|| elevation(bottom - 1.0)).unwrap_or(middle),
        elevation(top).or_else(|| elevation(top + 1.0)).unwrap_or(middle),
    ];
    let mut ends = if shared { [ElevationEnd::Hidden; 2] } else { [ElevationEnd::Seen; 2] };
    let borders = tested_rows(scene, axis);
    if rows[0] < borders[0] + BORDER_ROWS {
        ends[1] = ElevationEnd::Cut;
    }
    if rows[1] + BORDER_ROWS > borders[1] {
        ends[0] = ElevationEnd::Cut;
    }
    let step = view.steps_rad(axis, 0.5 * (top + bottom))[1];
    let sigma_rad = TOP_SIGMA_ROWS.hypot(0.01 * (bottom - top)) * step;
    let mut range = None;
    if ends[0] == ElevationEnd::Seen
        && let Some(height_m) = view.height_m
    {
        let foot_sigma_rad = FOOT_SIGMA_ROWS * step;
        match from_ground_contact(elevation_rad[0], foot_sigma_rad, height_m, view.tilt_sigma_rad) {
            Some(found)
                if !person
                    || (is_a_body(&found, height_m.0, &elevation_rad, ends[1], width_rad)
                        && figure_m.is_none_or(|m| (found.range_m / m).ln().abs() < FIGURE_AGREES)) =>
            {
                range = Some(found);
            }
            // Feet that cannot be feet. What is not a person may well be above the floor.
            _ if person => ends[0] = ElevationEnd::Hidden,
            _ => {}
        }
    }
    Extent { elevation_rad, sigma_rad, ends, range }
}

fn is_a_body(range: &Range, camera_m: f64, elevation_rad: &[f64; 2], top: ElevationEnd, width_rad: f64) -> bool {
    let top_m = camera_m + range.range_m * elevation_rad[1].tan();
    let slack = 1.0 + range.sigma_m / range.range_m;
    let height_fits =
        top_m < PERSON_HEIGHT_M[1] * slack && (top != ElevationEnd::Seen || top_m > PERSON_HEIGHT_M[0] / slack);
    let breadth_m = range.range_m * width_rad;
    height_fits && breadth_m > PERSON_BREADTH_M[0] && breadth_m < PERSON_BREADTH_M[1] * slack
}

/// First and last tested row of the column.
fn tested_rows(scene: &Scene<'_>, axis: f64) -> [usize; 2] {
    let w = scene.raster.width;
    let column = (scene.raster.wrap_column(axis).round().max(0.0) as usize).min(w - 1);
    let tested = |row: &usize| scene.valid[row * w + column] != 0;
    let first = (0..scene.raster.height).find(tested).unwrap_or(0);
    let last = (0..scene.raster.height).rev().find(tested).unwrap_or(scene.raster.height - 1);
    [first, last]
}
