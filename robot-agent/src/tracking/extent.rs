//! The elevation interval of a body, with what each end is.
//!
//! An end at the border of what is tested is *cut*; an end below which something nearer stands (a neighbour in one region, a
//! fellow robot, furniture) is *hidden*. Both are bounds, never measurements. Furniture is not seen by the motion stage, but
//! a body whose feet are hidden by a table would, taken at its word, stand further away and be a giant: lower ends that
//! make no body are hidden too, and so are tops that make nobody who stands: a head that is lost in what is behind it.

use protocol::message::ElevationEnd;

use super::range::{Range, from_ground_contact};
use super::view::View;
use crate::motion::{Patch, Scene};

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
const FOOT_SIGMA_ROWS: f64 = 1.5;
const TOP_SIGMA_ROWS: f64 = 1.0;
/// The same of a top as a share of the rows of the body.
const TOP_SIGMA_SHARE: f64 = 0.0085;
/// Heights and breadths of an upright person, metres: what a range from the feet must give.
const PERSON_HEIGHT_M: [f64; 2] = [1.3, 2.15];
/// The lower edge of what is seen of somebody is the near end of a foot: nearer than the body's axis by half a foot and half a
/// step, and by its shadow, less the rows that shoes lose in the floor (mean and standard deviation, metres): 0.04 m in the default
/// scenario (12,000 frames), 0.2 m in `stroll` and 0.26 m in `approach` (1,000 and 1,400), whose floors are plain.
const FOOT_AHEAD_M: (f64, f64) = (0.14, 0.08);
/// Hair and face may be lost in what is behind them: error of a top, metres.
const HEAD_M: f64 = 0.05;
/// A lower top is no head of somebody who stands …
const LEAST_TOP_M: f64 = 1.4;
/// … and one below this may have lost its head: it may be as much higher.
const LOW_TOP_M: f64 = 1.6;
/// Feet are where the body is but for a step: relative error of a range from them.
const LEAST_SPREAD: f64 = 0.06;
/// Largest difference of the logarithms of the range from the feet and the figure's.
const FIGURE_AGREES: f64 = 0.2;
const PERSON_BREADTH_M: [f64; 2] = [0.15, 0.95];

/// What is known of a body beside its rows.
#[derive(Debug, Clone, Copy)]
pub(super) struct Known {
    /// Angular width, radians.
    pub(super) width_rad: f64,
    /// Other bodies are in its region.
    pub(super) shared: bool,
    /// Taken for a person.
    pub(super) person: bool,
    /// How far away the whole body seems to be, where a figure was fitted: feet that would stand elsewhere are the end of a
    /// shadow, or hidden.
    pub(super) figure_m: Option<f64>,
    /// Its lowest marks may be feet.
    pub(super) feet: bool,
    /// Its highest ones may be a head.
    pub(super) head: bool,
}

/// Measures the extent of what spans `rows` about `axis`.
pub(super) fn measure(scene: &Scene<'_>, view: &View, axis: f64, rows: [usize; 2], known: &Known) -> Extent {
    let (top, bottom) = (rows[0] as f64 - 0.5, rows[1] as f64 + 0.5);
    let elevation = |row: f64| view.angles_rad(axis, row).map(|a| a.1);
    let middle = elevation(0.5 * (top + bottom)).unwrap_or(0.0);
    let elevation_rad = [
        elevation(bottom).or_else(|| elevation(bottom - 1.0)).unwrap_or(middle),
        elevation(top).or_else(|| elevation(top + 1.0)).unwrap_or(middle),
    ];
    let mut ends = if known.shared { [ElevationEnd::Hidden; 2] } else { [ElevationEnd::Seen; 2] };
    let borders = tested_rows(scene, axis);
    if rows[0] < borders[0] + BORDER_ROWS {
        ends[1] = ElevationEnd::Cut;
    }
    if rows[1] + BORDER_ROWS > borders[1] {
        ends[0] = ElevationEnd::Cut;
    } else if !known.feet {
        ends[0] = ElevationEnd::Hidden;
    }
    let step = view.steps_rad(axis, 0.5 * (top + bottom))[1];
    let mut range = None;
    if ends[0] == ElevationEnd::Seen
        && let Some(height_m) = view.height_m
    {
        let foot_sigma_rad = FOOT_SIGMA_ROWS * step;
        let contact = from_ground_contact(elevation_rad[0], foot_sigma_rad, height_m, view.tilt_sigma_rad);
        let (ahead_m, step_m) = if known.person { FOOT_AHEAD_M } else { (0.0, 0.0) };
        let axis = |r: Range| Range { range_m: r.range_m + ahead_m, sigma_m: r.sigma_m.hypot(step_m) };
        match contact.map(axis) {
            Some(found) if !known.person || is_a_body(&found, height_m.0, &elevation_rad, ends[1], known) => {
                range = Some(found);
            }
            // Feet that cannot be feet. What is not a person may well be above the floor.
            _ if known.person => ends[0] = ElevationEnd::Hidden,
            _ => {}
        }
    }
    if let Some(range) = &mut range {
        // Gait and shoes.
        range.sigma_m = range.sigma_m.hypot(LEAST_SPREAD * range.range_m);
    }
    let mut away_m = range.map(|r| r.range_m).or(known.figure_m);
    if ends[0] == ElevationEnd::Cut
        && let Some((camera_m, _)) = view.height_m
        && elevation_rad[0] < 0.0
    {
        // Feet below the picture are nearer than the floor at its border, whatever the figure seems to say.
        let most_m = camera_m / (-elevation_rad[0]).tan();
        away_m = Some(away_m.map_or(most_m, |m| m.min(most_m)));
    }
    let mut sigma_rad = TOP_SIGMA_ROWS.hypot(TOP_SIGMA_SHARE * (bottom - top)) * step;
    if let (Some(m), Some((camera_m, _))) = (away_m.filter(|_| known.person), view.height_m) {
        let top_m = camera_m + m * elevation_rad[1].tan();
        if ends[1] == ElevationEnd::Seen && (!known.head || top_m < LEAST_TOP_M) {
            ends[1] = ElevationEnd::Hidden;
        }
        if ends == [ElevationEnd::Seen, ElevationEnd::Hidden] {
            // Without its head this is a part of somebody, and what it ends in need not be feet.
            (ends[0], range) = (ElevationEnd::Hidden, None);
        }
        let lost_m = if ends[1] == ElevationEnd::Seen { (LOW_TOP_M - top_m).max(0.0) } else { 0.0 };
        sigma_rad = sigma_rad.hypot(HEAD_M.hypot(lost_m) * elevation_rad[1].cos().powi(2) / m.max(0.3));
    }
    Extent { elevation_rad, sigma_rad, ends, range }
}

fn is_a_body(range: &Range, camera_m: f64, elevation_rad: &[f64; 2], top: ElevationEnd, known: &Known) -> bool {
    let top_m = camera_m + range.range_m * elevation_rad[1].tan();
    let slack = 1.0 + range.sigma_m / range.range_m;
    let height_fits =
        top_m < PERSON_HEIGHT_M[1] * slack && (top != ElevationEnd::Seen || top_m > PERSON_HEIGHT_M[0] / slack);
    let breadth_m = range.range_m * known.width_rad;
    let agrees = known.figure_m.is_none_or(|m| (range.range_m / m).ln().abs() < FIGURE_AGREES);
    height_fits && agrees && breadth_m > PERSON_BREADTH_M[0] && breadth_m < PERSON_BREADTH_M[1] * slack
}

/// How far the axis of a body whom the side of what is tested cuts through lies beyond what is taken for it, columns, to the right
/// positive; `half` is half its breadth. What is taken for the axis is the middle of what is seen: if that is d columns from the side, 2d
/// columns are seen, and the axis is half the breadth less d beyond their middle.
pub(super) fn beyond_side(scene: &Scene<'_>, axis: f64, half: f64, patch: &Patch) -> f64 {
    /// Columns: what ends so near the side is cut.
    const BORDER: f64 = 2.0;
    /// Of the rows, where the trunk is.
    const TRUNK: usize = 3;
    let raster = scene.raster;
    let row = patch.rows[0] + patch.rows[1].saturating_sub(patch.rows[0]) / TRUNK;
    let is_tested = |column: f64| {
        raster.column_at(column.round() as isize).is_some_and(|column| scene.valid[row * raster.width + column] != 0)
    };
    // How far the side is from the axis, where that is less than the body reaches and what is seen of it ends there.
    let side = |to: f64| {
        let steps = (0..half.ceil() as usize).find(|k| !is_tested(axis + to * *k as f64))?;
        let away = steps as f64 - 0.5;
        let end = to * raster.column_difference(patch.arc.centre(), axis) + 0.5 * patch.arc.width as f64;
        (end + BORDER > away).then_some((half - away).clamp(0.0, half))
    };
    side(1.0).unwrap_or(0.0) - side(-1.0).unwrap_or(0.0)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::{Arc, Raster};
    use crate::optics::MountedCamera;
    use crate::panorama::PanoramaGeometry;

    /// The ends of a person of 1.75 m at 4 m, the lower one that of a foot 0.17 m before the axis; the top lowered by some metres.
    fn person(lost_m: f64, head: bool) -> Extent {
        seen([(1.75 - lost_m, 4.0), (0.0, 4.0 - 0.17)], head)
    }

    /// The ends of a person whose figure fits 4.1 m away, his upper and lower one at these heights and distances, metres.
    fn seen(ends_m: [(f64, f64); 2], head: bool) -> Extent {
        let camera = MountedCamera::reference(0.6);
        let geometry = PanoramaGeometry::for_camera(&camera).unwrap();
        let raster = Raster { width: geometry.width() as usize, height: geometry.height() as usize, wraps: true };
        let view = View::panorama(geometry, &camera);
        let rows = ends_m.map(|(height_m, range_m)| {
            let row = view.row_of_elevation(((height_m - 0.6) / range_m).atan()).unwrap();
            (row.round() as usize).min(raster.height - 1)
        });
        let (marks, valid) = (vec![0; raster.len()], vec![1; raster.len()]);
        let scene = Scene::of_marks(&raster, &marks, &valid);
        let known = Known { width_rad: 0.1, shared: false, person: true, figure_m: Some(4.1), feet: true, head };
        measure(&scene, &view, 100.0, rows, &known)
    }

    #[test]
    fn a_range_from_feet_is_to_the_body_s_axis() {
        let extent = person(0.0, true);
        assert_eq!(extent.ends, [ElevationEnd::Seen; 2]);
        let range = extent.range.unwrap();
        assert!((range.range_m - 4.0).abs() < range.sigma_m / 2.0, "{range:?}");
    }

    #[test]
    fn over_feet_below_the_picture_a_low_top_is_a_bound_whatever_the_figure_says() {
        // The floor leaves the picture at 2.24 m. What ends at 1.15 m there would be 1.6 m high at the figure's distance.
        let low = seen([(1.15, 2.24), (0.0, 1.9)], true);
        assert_eq!(low.ends, [ElevationEnd::Cut, ElevationEnd::Hidden]);
    }

    #[test]
    fn a_top_without_a_head_is_a_bound() {
        for (lost_m, head) in [(0.0, false), (0.2, false), (0.45, true)] {
            assert_eq!(person(lost_m, head).ends[1], ElevationEnd::Hidden, "{lost_m} m lost");
        }
    }

    #[test]
    fn who_is_cut_by_the_side_of_what_is_tested_has_his_axis_beyond_what_is_seen() {
        // Columns 20 to 69 are tested, of a ring and of a picture; he is 20 columns broad.
        let tested = 20..70;
        for wraps in [true, false] {
            let raster = Raster { width: 100, height: 40, wraps };
            let valid: Vec<u8> = (0..raster.len()).map(|i| u8::from(tested.contains(&(i % 100)))).collect();
            let marks = vec![0; raster.len()];
            let scene = Scene::of_marks(&raster, &marks, &valid);
            for truth in 15..75 {
                let (first, last) = ((truth - 10).max(tested.start), (truth + 9).min(tested.end - 1));
                let arc = Arc { start: first, width: last + 1 - first };
                let seen = beyond_side(&scene, arc.centre(), 10.0, &Patch { arc, rows: [5, 35] });
                let axis = arc.centre() + seen;
                assert!((axis - (truth as f64 - 0.5)).abs() < 1.01, "wraps: {wraps}, {truth}: {axis}, {seen} beyond");
                assert!(!(32..58).contains(&truth) || seen == 0.0, "{truth}: {seen}");
            }
        }
    }
}
