//! Where in the panorama a near plate may stand, by one level line of it that ends in upright sides: the coarse search.
//!
//! Problem: of a plate near at hand too few stripes are in view to find it by. Insight: its upper end, or the edge between its two
//! upper stripes, is a straight level line of announced height and length: where it lies in the picture says how far away and how
//! turned the plate is. Algorithm: at every distance and turn the contrast across the line is taken at ten places and across both
//! sides; the best are moved to where line and sides show best. Furniture has stronger lines and sides, but what is between them is
//! seldom of one paint: candidates are the best by contrast over how uneven it is.

use std::f64::consts::TAU;

use protocol::angle::difference;

use super::super::look::PlateLook;
use super::super::near::{Curve, OUTLINE_BELOW, OUTLINE_EVERY, Rim};
use super::super::rings::median;
use super::super::search::{Grid, Peak, strongest, unlike};
use super::super::shades;
use super::search::{PLACES, PlateCandidate, across};

/// Nearest and farthest distance of a plate's middle, metres, and the step between distances.
const DISTANCE_M: [f64; 2] = [0.4, 1.15];
const STEP: f64 = 1.04;
/// Turns of the plate from or towards the line of sight, radians.
const TURNS: [f64; 9] = [0.0, -0.25, 0.25, -0.5, 0.5, -0.75, 0.75, -1.0, 1.0];
/// So many of the places along the line must be in view.
const LEAST_PLACES: usize = 8;
/// Least contrast of the line, as [`shades`] has it: all of the search is in its levels.
const LEAST_STEP: i32 = 4;
/// Rows in which a side is looked at, least and most.
const OUTLINE_ROWS: [usize; 2] = [3, 8];
/// Columns between two places of the search.
const STRIDE: usize = 2;
/// So many of the coarse search are placed finely, and so many of those are candidates.
const MAX_COARSE: usize = 100;
const MAX_CANDIDATES: usize = 20;
/// First steps of (column, ln of the distance, turn), how often they are halved, and most moves of one length.
const FINE_STEPS: [f64; 3] = [3.0, 0.03, 0.12];
const HALVINGS: usize = 3;
const MOST_MOVES: usize = 8;
/// Contrast of one place beyond this says no more.
const MOST_PLACE: f64 = 25.0;
/// The most that a plate shows: twice the line, and two sides.
const MOST_SHOWN: f64 = 4.0 * MOST_PLACE;
/// A side that is out of view is worth this share of the other one.
const UNSEEN_SIDE: f64 = 0.6;
/// The upper stripe's grey levels are taken at these shares of its height; paint varies by about so much. In 141
/// pictures (of seeds from 9000 on) 77 instead of 71 of 80 near plates that the coarse search had were among the candidates of either line.
const STRIPE_SHARES: [f64; 3] = [0.3, 0.5, 0.7];
const EVEN: f64 = 6.0;
/// Candidates nearer to each other than this are the same: shares of half the width and of the distance, radians.
const SAME: [f64; 3] = [0.3, 0.05, 0.3];

#[derive(Debug)]
struct Level {
    distance_m: f64,
    turn_rad: f64,
    half_columns: f64,
    line: Curve,
}

/// Column, ln of the distance in metres, and turn of a plate's middle.
type Place = [f64; 3];

/// The coarse search for near plates by one line.
#[derive(Debug)]
pub(super) struct LineSearch {
    grid: Grid,
    half_m: f64,
    /// Of the line and of the plate's upper end above the camera, metres.
    rise_m: f64,
    top_m: f64,
    /// Height of the upper stripe, metres.
    stripe_m: f64,
    levels: Vec<Level>,
}

impl LineSearch {
    /// Prepares the lines at a height on the plate for a camera at this height.
    pub(super) fn new(grid: Grid, look: &PlateLook, line_m: f64, camera_height_m: f64) -> Self {
        let top_m = look.bottom_m + look.height_m - camera_height_m;
        let (half_m, rise_m) = (0.5 * look.width_m, line_m - camera_height_m);
        let stripe_m = look.edges_m[look.edges_m.len() - 1] - look.edges_m[look.edges_m.len() - 2];
        let mut search = Self { grid, half_m, rise_m, top_m, stripe_m, levels: Vec::new() };
        let mut distance_m = DISTANCE_M[0];
        while distance_m < DISTANCE_M[1] {
            let at_turns: Vec<_> = TURNS.iter().filter_map(|turn_rad| search.level(distance_m, *turn_rad)).collect();
            search.levels.extend(at_turns);
            distance_m *= STEP;
        }
        search
    }

    fn level(&self, distance_m: f64, turn_rad: f64) -> Option<Level> {
        let along = self.along([0.0, distance_m.ln(), turn_rad]);
        let at = |share: f64| {
            let (column, distance) = along(share);
            (column.round() as i64, self.grid.row(self.rise_m / distance), self.grid.row(self.top_m / distance))
        };
        let places: Vec<_> = PLACES
            .into_iter()
            .map(at)
            .filter(|(_, row, _)| *row >= 4.0 && row + 3.0 < self.grid.height as f64)
            .map(|(column, row, _)| (column, row.round() as usize))
            .collect();
        let sides = [-1.0, 1.0].map(|share| {
            let (column, _, top) = at(share);
            let first = top.round().max(0.0) as usize + OUTLINE_BELOW;
            (column, (first..self.grid.height).step_by(OUTLINE_EVERY).take(OUTLINE_ROWS[1]).collect::<Vec<_>>())
        });
        let is_seen = places.len() >= LEAST_PLACES && sides.iter().any(|(_, rows)| rows.len() >= OUTLINE_ROWS[0]);
        let half_columns = 0.5 * (sides[0].0 - sides[1].0).abs() as f64;
        is_seen.then_some(Level { distance_m, turn_rad, half_columns, line: Curve { places, sides } })
    }

    /// Candidates, best first. `panorama` holds one byte a pixel of the grid.
    pub(super) fn run(&self, panorama: &[u8]) -> Vec<PlateCandidate> {
        let panorama = &shades::evened(panorama, self.grid.width);
        let mut placed: Vec<(f64, PlateCandidate)> = self
            .coarse(panorama)
            .into_iter()
            .map(|(_, l, u)| {
                let level = &self.levels[l];
                let (shows, at) = self.placed(panorama, [u as f64, level.distance_m.ln(), level.turn_rad]);
                (shows / (EVEN + self.unevenness(panorama, at)), self.candidate(at, shows / MOST_SHOWN))
            })
            .collect();
        placed.sort_by(|a, b| b.0.total_cmp(&a.0));
        let candidates = placed.into_iter().map(|(_, candidate)| candidate);
        unlike(candidates, MAX_CANDIDATES, |candidate, other| {
            let apart_rad = difference(other.bearing_rad, candidate.bearing_rad).abs();
            apart_rad * candidate.distance_m < SAME[0] * self.half_m
                && (other.distance_m / candidate.distance_m - 1.0).abs() < SAME[1]
                && (other.turn_rad - candidate.turn_rad).abs() < SAME[2]
        })
    }

    fn coarse(&self, panorama: &[u8]) -> Vec<Peak> {
        let width = self.grid.width;
        let mut peaks: Vec<Peak> = Vec::new();
        for (l, level) in self.levels.iter().enumerate() {
            for u in (0..width).step_by(STRIDE) {
                let shows = level.line.shows(panorama, width, u, LEAST_STEP, Rim::Plain);
                peaks.extend(shows.map(|shows| (shows, l, u)));
            }
        }
        let is_near = |l: usize, other: usize, apart: f64| {
            let (own, other) = (&self.levels[l], &self.levels[other]);
            apart < 0.4 * own.half_columns
                && (0.9..1.11).contains(&(own.distance_m / other.distance_m))
                && (own.turn_rad - other.turn_rad).abs() < 0.6
        };
        strongest(peaks, width, MAX_COARSE, is_near)
    }

    fn candidate(&self, [u, ln_distance, turn_rad]: Place, support: f64) -> PlateCandidate {
        PlateCandidate { bearing_rad: self.grid.bearing_rad(u), distance_m: ln_distance.exp(), turn_rad, support }
    }

    /// Column and distance of what is at a share of the half width.
    fn along(&self, [u, ln_distance, turn_rad]: Place) -> impl Fn(f64) -> (f64, f64) {
        let across = across(ln_distance.exp(), self.half_m, turn_rad);
        let per_rad = self.grid.width as f64 / TAU;
        move |share: f64| {
            let (aside_rad, distance) = across(share);
            (u - aside_rad * per_rad, distance)
        }
    }

    /// Moves a plate to where line and sides show best. How well they do, and where that is.
    fn placed(&self, panorama: &[u8], start: Place) -> (f64, Place) {
        let mut best = (self.shows(panorama, start), start);
        let mut steps = FINE_STEPS;
        for _ in 0..=HALVINGS {
            for _ in 0..MOST_MOVES {
                let middle = best.1;
                for (k, by) in (0..3).flat_map(|k| [(k, steps[k]), (k, -steps[k])]) {
                    let mut at = middle;
                    at[k] += by;
                    let shows = self.shows(panorama, at);
                    if shows > best.0 {
                        best = (shows, at);
                    }
                }
                if best.1 == middle {
                    break;
                }
            }
            steps = steps.map(|step| 0.5 * step);
        }
        best
    }

    /// Contrast across the line and the sides of a plate.
    fn shows(&self, panorama: &[u8], at: Place) -> f64 {
        let along = self.along(at);
        let height = self.grid.height as f64;
        let (mut line, mut seen) = (0.0, 0);
        for share in PLACES {
            let (column, distance) = along(share);
            let row = self.grid.row(self.rise_m / distance);
            if row >= 3.0 && row + 3.0 < height {
                let step = self.gray(panorama, column, row - 1.0) - self.gray(panorama, column, row + 1.0);
                line += step.clamp(-MOST_PLACE, MOST_PLACE);
                seen += 1;
            }
        }
        if seen < LEAST_PLACES {
            return 0.0;
        }
        let side = |share: f64| {
            let (column, distance) = along(share);
            let mut row = self.grid.row(self.top_m / distance).max(0.0) + OUTLINE_BELOW as f64;
            let (mut sum, mut rows) = (0.0, 0);
            while row < height && rows < OUTLINE_ROWS[1] {
                let step = self.gray(panorama, column - 1.5, row) - self.gray(panorama, column + 1.5, row);
                sum += step.abs().min(MOST_PLACE);
                rows += 1;
                row += OUTLINE_EVERY as f64;
            }
            (rows >= OUTLINE_ROWS[0]).then(|| sum / rows as f64)
        };
        let sides = match [side(-1.0), side(1.0)] {
            [Some(right), Some(left)] => right + left,
            [Some(one), None] | [None, Some(one)] => (1.0 + UNSEEN_SIDE) * one,
            [None, None] => 0.0,
        };
        2.0 * f64::abs(line / seen as f64) + sides
    }

    /// Median distance of the upper stripe's grey levels from their median; a mast before it is a stray.
    fn unevenness(&self, panorama: &[u8], at: Place) -> f64 {
        let along = self.along(at);
        let inside = 1.0..self.grid.height as f64 - 1.0;
        let mut grays = Vec::with_capacity(PLACES.len() * STRIPE_SHARES.len());
        for (column, distance) in PLACES.map(along) {
            let rows = STRIPE_SHARES.map(|share| self.grid.row((self.top_m - share * self.stripe_m) / distance));
            let in_view = rows.into_iter().filter(|row| inside.contains(row));
            grays.extend(in_view.map(|row| self.gray(panorama, column, row)));
        }
        let middle = median(&mut grays);
        median(&mut grays.into_iter().map(|gray| (gray - middle).abs()).collect::<Vec<_>>())
    }

    /// Gray level in the column nearest to `u`, between two rows; the middle of the first row is at ½.
    fn gray(&self, panorama: &[u8], u: f64, v: f64) -> f64 {
        let Grid { width, height, .. } = self.grid;
        let row = (v - 0.5).clamp(0.0, (height - 1) as f64 - 1e-6);
        let column = (u + (2 * width) as f64 + 0.5) as usize % width;
        let (above, share) = (row as usize, row.fract());
        let [a, b] = [above, above + 1].map(|row| f64::from(panorama[row * width + column]));
        a + share * (b - a)
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::test_scene::Dice;
    use super::super::search::tests::{GRID, drawn, look};
    use super::*;

    #[test]
    fn a_near_plate_is_found_where_it_is_as_it_is_turned_by_either_line() {
        let look = look();
        let (end_m, edge_m) = (look.edges_m[4], look.edges_m[3]);
        for (line_m, bearing, distance, turn, is_back) in [
            (end_m, 0.3, 0.6, 0.0, false),
            (end_m, 3.1, 0.7, 0.6, true),
            (end_m, -2.0, 0.8, -0.9, false),
            (edge_m, 1.0, 0.95, 0.8, false),
            (edge_m, -3.1, 1.0, -0.4, true),
        ] {
            let panorama = drawn(&GRID, &look, bearing, distance, turn, is_back);
            let found = LineSearch::new(GRID, &look, line_m, 0.6).run(&panorama);
            let best = found.first().unwrap_or_else(|| panic!("nothing at {bearing} {distance} {turn}"));
            let apart_m = difference(best.bearing_rad, bearing).abs() * distance;
            assert!(apart_m < 0.02, "{bearing} {distance} {turn}: {best:?}");
            assert!((best.distance_m / distance - 1.0).abs() < 0.03, "{bearing} {distance} {turn}: {best:?}");
            assert!((best.turn_rad - turn).abs() < 0.1, "{bearing} {distance} {turn}: {best:?}");
        }
    }

    #[test]
    fn a_faint_plate_of_even_paint_is_among_the_candidates_of_a_room_of_stronger_lines_about_uneven_faces() {
        let (look, (bearing, distance, turn)) = (look(), (0.3, 0.65, 0.3));
        let mut dice = Dice(5);
        let mut panorama = drawn(&GRID, &look, bearing, distance, turn, false);
        for gray in &mut panorama {
            // A fifth of the contrast.
            *gray = (90.0 + 0.2 * (f64::from(*gray) - 90.0) + dice.normal()) as u8;
        }
        // As wide and as near as plates, of boards each of which is of another paint.
        for n in 0..20 {
            let at = bearing + 0.9 + 0.24 * f64::from(n);
            let face = drawn(&GRID, &look, at, distance, 0.0, false);
            let mut board = 0.0;
            for (u, v) in (0..GRID.width).flat_map(|u| (0..GRID.height).map(move |v| (u, v))) {
                let i = v * GRID.width + u;
                if u % 5 == 0 && v == 0 {
                    board = (28.0 + 17.0 * dice.normal()).clamp(2.0, 60.0);
                }
                if face[i] != 90 {
                    panorama[i] = board as u8;
                }
            }
        }
        let found = LineSearch::new(GRID, &look, look.edges_m[4], 0.6).run(&panorama);
        let is_there = |c: &PlateCandidate| {
            difference(c.bearing_rad, bearing).abs() * distance < 0.04 && (c.distance_m / distance - 1.0).abs() < 0.08
        };
        assert!(found.iter().any(is_there), "{found:?}");
    }
}
