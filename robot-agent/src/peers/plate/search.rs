//! Where in the panorama a striped plate may stand, and how it is turned: the coarse search.
//!
//! Problem: a turned plate is at another distance in every column, so its stripes run aslant, and no single range fits it.
//! Insight: one column of a plate depends on its distance alone. Algorithm: every narrow strip of columns is compared with the
//! stripes at a hundred distances once; a plate is a path through this table (distance over column) that its turn gives, along
//! which the strips show the stripes, or all of them the negative (the back).

use std::f64::consts::TAU;

use super::super::kernel::{self, Band};
use super::super::look::PlateLook;
use super::super::refusals::{How, Place};
use super::super::search::{Grid, Peak, bands, strongest};

/// Nearest and farthest distance along a column, metres, and the step between distances.
const DISTANCE_M: [f64; 2] = [0.35, 6.5];
const STEP: f64 = 1.03;
/// Turns of the plate from or towards the line of sight, radians.
const TURNS: [f64; 9] = [0.0, -0.3, 0.3, -0.6, 0.6, -0.85, 0.85, -1.05, 1.05];
/// Columns of a strip, and between two strips and two places.
const STRIP: usize = 3;
const HOP: usize = 2;
/// Places along a plate, as shares of its half width.
pub(super) const PLACES: [f64; 10] = [-0.9, -0.7, -0.5, -0.3, -0.1, 0.1, 0.3, 0.5, 0.7, 0.9];
/// Strips below this correlation have no vote; above the second a whole one.
const VOTE: [f32; 2] = [0.6, 0.9];
/// Least mean vote of the places.
const LEAST_SUPPORT: f32 = 0.4;
/// Least support beyond what goes on on both sides.
const LEAST_WORTH: f32 = 0.15;
/// Grey levels per unit of reflectance below which nothing is a stripe.
const LEAST_GAIN: f32 = 12.0;
/// Sensor noise and rounding in the panorama, squared grey levels.
const NOISE2: f32 = 2.0;
/// Most candidates of one picture where one edge between stripes is in view, which much looks like, and where more are.
const MAX_CANDIDATES: [usize; 2] = [16, 20];
/// Stripes of which one edge is in view.
const ONE_EDGE: usize = 2;

/// A place where a plate may be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlateCandidate {
    /// Of its middle, radians.
    pub bearing_rad: f64,
    /// Of its middle along the floor, metres.
    pub distance_m: f64,
    /// Of its normal less the bearing of its middle, radians.
    pub turn_rad: f64,
    /// What speaks for it, 0 … 1.
    pub support: f64,
}

impl PlateCandidate {
    /// For [`super::super::refusals`].
    pub fn place(&self, how: How) -> Place {
        let Self { bearing_rad, distance_m: range_m, turn_rad, support } = *self;
        Place { how, bearing_rad, range_m, turn_rad, support }
    }
}

#[derive(Debug)]
struct Level {
    distance_m: f64,
    bands: Vec<Band>,
    /// By turn: columns and levels from the middle to each place.
    places: Vec<[(i32, i32); PLACES.len()]>,
    half_columns: f64,
}

/// The search over one panorama, its tables reused from frame to frame.
#[derive(Debug)]
pub struct PlateSearch {
    grid: Grid,
    levels: Vec<Level>,
    pad: usize,
    sums: Vec<u32>,
    squares: Vec<u32>,
    votes: Vec<f32>,
    support: Vec<(f32, u8)>,
}

impl PlateSearch {
    /// Prepares the stripes. `lowest` is the tangent of the lowest elevation that the camera sees.
    pub fn new(grid: Grid, look: &PlateLook, camera_height_m: f64, lowest: f64) -> Self {
        let mut levels = Vec::new();
        let mut distance_m = DISTANCE_M[0];
        while distance_m < DISTANCE_M[1] {
            if let Some(bands) = bands(&grid, &look.edges_m, &look.reflectance, camera_height_m, lowest, distance_m) {
                let half_m = 0.5 * look.width_m;
                let places = TURNS.iter().map(|turn| path(&grid, distance_m, half_m, *turn)).collect();
                let half_columns = (half_m / distance_m).atan() / TAU * grid.width as f64;
                levels.push(Level { distance_m, bands, places, half_columns });
            } else if !levels.is_empty() {
                // Too far for this many rows: levels follow each other without a gap.
                break;
            }
            distance_m *= STEP;
        }
        let pad = STRIP;
        let table = (grid.height + 1) * (grid.width + 2 * pad + 1);
        let map = levels.len() * grid.width;
        Self {
            grid,
            levels,
            pad,
            sums: vec![0; table],
            squares: vec![0; table],
            votes: vec![0.0; map],
            support: vec![(0.0, 0); map],
        }
    }

    /// Pixels of the grid.
    pub fn len(&self) -> usize {
        self.grid.width * self.grid.height
    }

    /// Candidates, those of which several edges are in view before the others, best first in either. `panorama` holds one byte a pixel of the grid.
    pub fn run(&mut self, panorama: &[u8]) -> Vec<PlateCandidate> {
        let Grid { width, height, .. } = self.grid;
        kernel::integrate(panorama, width, height, self.pad, &mut self.sums, &mut self.squares);
        let stride = width + 2 * self.pad + 1;
        for (level, votes) in self.levels.iter().zip(self.votes.chunks_exact_mut(width)) {
            for u in (0..width).step_by(HOP) {
                let from = u + self.pad - STRIP / 2;
                let (correlation, gain) =
                    kernel::correlate(&self.sums, &self.squares, stride, &level.bands, from, from + STRIP, NOISE2);
                let share = ((correlation.abs() - VOTE[0]) / (VOTE[1] - VOTE[0])).clamp(0.0, 1.0);
                let share = if gain.abs() < LEAST_GAIN { 0.0 } else { share };
                votes[u..(u + HOP).min(width)].fill(share.copysign(correlation));
            }
        }
        self.gather();
        self.pick()
    }

    /// The best turn at every place.
    fn gather(&mut self) {
        let (width, count) = (self.grid.width as i32, self.levels.len() as i32);
        for (l, level) in self.levels.iter().enumerate() {
            for u in (0..width).step_by(HOP) {
                let mut best = (0.0f32, 0u8);
                for (t, places) in level.places.iter().enumerate() {
                    let mut sum = 0.0;
                    for (k, (column, up)) in places.iter().enumerate() {
                        let row = l as i32 + up;
                        if (0..count).contains(&row) {
                            sum += self.votes[(row * width + (u + column).rem_euclid(width)) as usize];
                        }
                        // Most places show nothing at all.
                        if k == 4 && sum.abs() < 0.5 {
                            break;
                        }
                    }
                    let support = sum.abs() / PLACES.len() as f32;
                    if support > best.0 {
                        best = (support, t as u8);
                    }
                }
                self.support[l * width as usize + u as usize] = best;
            }
        }
    }

    fn pick(&self) -> Vec<PlateCandidate> {
        let width = self.grid.width;
        let mut peaks: Vec<Peak> = Vec::new();
        for l in 0..self.levels.len() {
            for u in (0..width).step_by(HOP) {
                let worth = self.worth(l, u);
                if worth >= LEAST_WORTH && self.support[l * width + u].0 >= LEAST_SUPPORT {
                    peaks.push((worth, l, u));
                }
            }
        }
        let near = |l: usize, other: usize, apart: f64| {
            let (level, other) = (&self.levels[l], &self.levels[other]);
            let ratio = other.distance_m / level.distance_m;
            apart < 0.6 * level.half_columns.max(other.half_columns) && (0.85..1.18).contains(&ratio)
        };
        let candidate = |(_, l, u): Peak| PlateCandidate {
            bearing_rad: self.grid.bearing_rad(u as f64),
            distance_m: self.levels[l].distance_m,
            turn_rad: TURNS[usize::from(self.support[l * width + u].1)],
            support: f64::from(self.support[l * width + u].0),
        };
        let (one, more): (Vec<Peak>, Vec<Peak>) =
            peaks.into_iter().partition(|(_, l, _)| self.levels[*l].bands.len() <= ONE_EDGE);
        let picked = strongest(more, width, MAX_CANDIDATES[1], near).into_iter().chain(strongest(
            one,
            width,
            MAX_CANDIDATES[0],
            near,
        ));
        picked.map(candidate).collect()
    }

    /// Support less what goes on on either side: the foot of a wall looks like two stripes all along, a plate ends.
    fn worth(&self, l: usize, u: usize) -> f32 {
        let width = self.grid.width;
        let beside = ((2.2 * self.levels[l].half_columns) as usize).clamp(HOP, width / 2 - 1) / HOP * HOP;
        let at = |u: usize| self.support[l * width + u % width].0;
        at(u) - at(u + beside).min(at(u + width - beside))
    }
}

/// Columns and levels from a plate's middle to its places.
fn path(grid: &Grid, distance_m: f64, half_m: f64, turn: f64) -> [(i32, i32); PLACES.len()] {
    let across = across(distance_m, half_m, turn);
    PLACES.map(|share| {
        let (aside_rad, distance) = across(share);
        let column = -aside_rad / TAU * grid.width as f64;
        let level = (distance / distance_m).ln() / STEP.ln();
        (column.round() as i32, level.round() as i32)
    })
}

/// Of a plate whose middle is at a distance: how far beside the middle a share of its half width is seen, radians, and at what distance
/// along the floor, metres.
pub(super) fn across(distance_m: f64, half_m: f64, turn_rad: f64) -> impl Fn(f64) -> (f64, f64) {
    let (sin, cos) = turn_rad.sin_cos();
    move |share: f64| {
        let y = share * half_m;
        let (ahead, aside) = ((distance_m - y * sin).max(0.1), y * cos);
        (aside.atan2(ahead), ahead.hypot(aside))
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Of four stripes.
    pub(in super::super) fn look() -> PlateLook {
        PlateLook {
            width_m: 0.4,
            height_m: 0.4,
            left_edge_m: 0.2,
            behind_m: 0.06,
            bottom_m: 0.1,
            edges_m: vec![0.1, 0.2, 0.3, 0.4, 0.5],
            reflectance: vec![0.85, 0.1, 0.85, 0.1],
        }
    }

    /// Of a camera at 0.6 m.
    pub(in super::super) const GRID: Grid =
        Grid { width: 1086, height: 120, seam_rad: std::f64::consts::PI, tangents: [0.36, -0.27] };

    #[test]
    fn a_plate_is_found_at_its_place_with_its_turn_from_either_side() {
        let (look, grid) = (look(), GRID);
        let mut search = PlateSearch::new(grid, &look, 0.6, -0.27);
        for (bearing, distance, turn, is_back) in
            [(0.3, 0.9, 0.5, false), (3.1, 1.0, -0.9, true), (-2.0, 2.0, 0.9, false), (1.0, 4.5, 0.2, true)]
        {
            let panorama = drawn(&grid, &look, bearing, distance, turn, is_back);
            let found = search.run(&panorama);
            // Nearer than this one edge between stripes is in view.
            let best = found
                .iter()
                .find(|c| (c.distance_m < 1.1) == (distance < 1.1))
                .unwrap_or_else(|| panic!("nothing at {bearing} {distance} {turn}"));
            let apart = protocol::angle::difference(best.bearing_rad, bearing).abs() * distance;
            assert!(apart < 0.08, "{bearing} {distance}: {best:?}");
            assert!((best.distance_m / distance - 1.0).abs() < 0.08, "{bearing} {distance}: {best:?}");
            // Far away a turn is a fraction of a row.
            assert!(distance > 3.0 || (best.turn_rad - turn).abs() < 0.5, "{bearing} {distance} {turn}: {best:?}");
        }
    }

    /// A plate before a grey wall, by its definition: each pixel's ray meets its plane.
    pub(in super::super) fn drawn(
        grid: &Grid,
        look: &PlateLook,
        bearing: f64,
        distance: f64,
        turn: f64,
        is_back: bool,
    ) -> Vec<u8> {
        let mut out = vec![90u8; grid.width * grid.height];
        let c = distance * turn.cos();
        for u in 0..grid.width {
            let at = grid.seam_rad - TAU * (u as f64 + 0.5) / grid.width as f64;
            let aside = protocol::angle::difference(at, bearing);
            let along = (aside - turn).cos();
            if along < 0.05 {
                continue;
            }
            let d = c / along;
            if (d * aside.sin() / turn.cos()).abs() > 0.2 {
                continue;
            }
            for v in 0..grid.height {
                let [top, bottom] = grid.tangents;
                let z = 0.6 + d * (top - (v as f64 + 0.5) / grid.height as f64 * (top - bottom));
                if let Some(k) = (0..4).find(|k| z >= look.edges_m[*k] && z < look.edges_m[k + 1]) {
                    let r = if is_back { 0.95 - look.reflectance[k] } else { look.reflectance[k] };
                    out[v * grid.width + u] = (200.0 * r) as u8;
                }
            }
        }
        out
    }
}
