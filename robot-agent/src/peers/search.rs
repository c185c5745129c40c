//! Where in the panorama a cylinder of known rings may stand: the coarse search.
//!
//! Insight: with the camera's height known, the vertical profile of a painted cylinder at range B is known exactly, so there are
//! only two unknowns, bearing and range. Algorithm: at about a hundred ranges in geometric steps, every narrow strip of
//! columns is correlated with the profile (running sums make the cost independent of the strip's size); strips vote for a
//! body where its width says they belong; the best bodies are taken greedily. Narrow strips let a half hidden body be found.

use std::f64::consts::TAU;

use super::kernel::{self, Band};
use super::look::CylinderLook;
use super::near::Rim;
use super::occluder::Occluder;
use super::refusals::{How, Place};
use crate::panorama::{PanoramaGeometry, Projection};

/// Nearest and farthest range, metres, and the step between ranges.
const RANGE_M: [f64; 2] = [0.6, 7.0];
const RANGE_STEP: f64 = 1.03;
/// Most candidates of one picture. Of 165 half hidden robots in 700 rooms (seed 500000) six more were found
/// with 64 than with 24.
pub const MAX_CANDIDATES: usize = 48;
/// Strips below this correlation have no vote; above the second a whole one.
const VOTE: [f32; 2] = [0.55, 0.85];
/// Share of the body's strips that must vote.
const LEAST_SUPPORT: f32 = 0.22;
/// Least support beyond what goes on on both sides.
const LEAST_WORTH: f32 = 0.12;
/// Most places that bodies before them hide in part; least share of such a place's strips that are hidden, and that are not.
const MAX_BEHIND: usize = 8;
pub(super) const LEAST_HIDDEN: f32 = 0.1;
const LEAST_UNHIDDEN: f32 = 0.35;
/// Gray levels per unit of reflectance below which nothing is a ring.
const LEAST_GAIN: f32 = 9.0;
/// Sensor noise and rounding in the panorama, squared grey levels.
const NOISE2: f32 = 4.0;
/// Rows at a ring's edge that the blur mixes.
const TRIM_ROWS: f64 = 0.6;

/// The grid of a cylindrical panorama: column u at bearing seam − 2π(u + ½)/W, row v at tangent top − (v + ½)(top − bottom)/H.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    /// Columns over 360°.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Bearing of the left border, radians.
    pub seam_rad: f64,
    /// Tangents of the elevations of the upper and lower border.
    pub tangents: [f64; 2],
}

impl Grid {
    /// The grid of a panorama; `None` for a spherical one.
    pub fn of(geometry: &PanoramaGeometry) -> Option<Self> {
        (geometry.projection() == Projection::Cylinder).then(|| {
            let [low, high] = geometry.elevation_rad();
            Self {
                width: geometry.width() as usize,
                height: geometry.height() as usize,
                seam_rad: geometry.theta0_rad(),
                tangents: [high.tan(), low.tan()],
            }
        })
    }

    /// Bearing of the middle of a column, radians.
    pub(super) fn bearing_rad(&self, column: f64) -> f64 {
        protocol::angle::wrap(self.seam_rad - TAU * (column + 0.5) / self.width as f64)
    }

    /// Row in which the tangent of an elevation lies: the middle of the first one is at ½.
    pub(super) fn row(&self, tangent: f64) -> f64 {
        let [top, bottom] = self.tangents;
        (top - tangent) / (top - bottom) * self.height as f64
    }
}

/// A place where a body may be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate {
    /// Of the axis, radians.
    pub bearing_rad: f64,
    /// To the axis along the floor, metres.
    pub range_m: f64,
    /// Share of its strips that vote, or of the contrast of an upper end and its outlines in the most there may be, 0 … 1.
    pub support: f64,
    /// Bearings [right, left] between which strips vote, radians.
    pub seen_rad: [f64; 2],
    /// Measured in the last frame: the place is right to a fraction of a pixel if the robot still stands.
    pub known: bool,
    /// Found by the marker's upper end alone, which looks so.
    pub rim: Option<Rim>,
    /// Somebody before it hides a part of it.
    pub behind: Option<Hider>,
}

/// What hides a part of a body.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Hider {
    /// Bodies of cylinders.
    Body,
    /// Plates, too, which are looked for later.
    Plate,
}

impl Candidate {
    /// For [`super::refusals`].
    pub(super) fn place(&self) -> Place {
        let Self { bearing_rad, range_m, support, .. } = *self;
        let how = self.behind.map_or(How::Cylinder(self.rim), |hider| How::Behind(hider, self.rim));
        Place { how, bearing_rad, range_m, turn_rad: 0.0, support }
    }
}

#[derive(Debug)]
struct Level {
    range_m: f64,
    bands: Vec<Band>,
    half_columns: f64,
}

/// The search over one panorama, its tables reused from frame to frame.
#[derive(Debug)]
pub struct Search {
    grid: Grid,
    levels: Vec<Level>,
    /// Bars show the negative of the rings.
    is_barred: bool,
    pad: usize,
    sums: Vec<u32>,
    squares: Vec<u32>,
    votes: Vec<f32>,
    support: Vec<f32>,
}

impl Search {
    /// Prepares the profiles. `lowest` is the tangent of the lowest elevation that the camera sees.
    pub fn new(grid: Grid, look: &CylinderLook, camera_height_m: f64, lowest: f64) -> Self {
        let mut levels = Vec::new();
        let mut range_m = RANGE_M[0].max(look.radius_m * 1.5);
        while range_m < RANGE_M[1] {
            // Strips lie anywhere on the front: on average a little behind the nearest line.
            let distance_m = range_m - 0.92 * look.radius_m;
            if let Some(bands) = bands(&grid, &look.edges_m, &look.reflectance, camera_height_m, lowest, distance_m) {
                let half_columns = (look.radius_m / range_m).asin() / TAU * grid.width as f64;
                levels.push(Level { range_m, bands, half_columns });
            }
            range_m *= RANGE_STEP;
        }
        let pad = grid.width / 4;
        let table = (grid.height + 1) * (grid.width + 2 * pad + 1);
        let map = levels.len() * grid.width;
        Self {
            grid,
            levels,
            is_barred: look.is_barred(),
            pad,
            sums: vec![0; table],
            squares: vec![0; table],
            votes: vec![0.0; map],
            support: vec![0.0; map],
        }
    }

    /// Pixels of the grid.
    pub fn len(&self) -> usize {
        self.grid.width * self.grid.height
    }

    /// Candidates, best first (≤ [`MAX_CANDIDATES`]). `panorama` holds one byte a pixel of the grid.
    pub fn run(&mut self, panorama: &[u8]) -> Vec<Candidate> {
        let Grid { width, height, .. } = self.grid;
        kernel::integrate(panorama, width, height, self.pad, &mut self.sums, &mut self.squares);
        for (level, (votes, support)) in
            self.levels.iter().zip(self.votes.chunks_exact_mut(width).zip(self.support.chunks_exact_mut(width)))
        {
            vote(&self.sums, &self.squares, (width, self.pad), level, self.is_barred, votes);
            gather(votes, level.half_columns * 0.85, support);
        }
        self.pick(MAX_CANDIDATES)
    }

    /// Candidates of the last [`Search::run`] that `occluders` hide in part, judged by what they do not: best first, at most
    /// [`MAX_BEHIND`]. In another call for the same panorama there must be all of these and more.
    pub fn behind(&mut self, occluders: &[Occluder], hider: Hider) -> Vec<Candidate> {
        if occluders.is_empty() {
            return Vec::new();
        }
        let width = self.grid.width;
        let is_hidden = |o: &Occluder| (0..width).map(|u| o.is_at(self.grid.bearing_rad(u as f64))).collect();
        let sectors: Vec<(f64, Vec<bool>)> = occluders.iter().map(|o| (o.range_m, is_hidden(o))).collect();
        let (mut unhidden, mut shares) = (vec![1.0; width], vec![1.0; width]);
        let maps = self.votes.chunks_exact_mut(width).zip(self.support.chunks_exact_mut(width));
        for (level, (votes, support)) in self.levels.iter().zip(maps) {
            unhidden.fill(1.0);
            for (_, is_hidden) in sectors.iter().filter(|(range_m, _)| *range_m < level.range_m) {
                unhidden.iter_mut().zip(is_hidden).filter(|(_, is)| **is).for_each(|(share, _)| *share = 0.0);
            }
            votes.iter_mut().zip(&unhidden).for_each(|(vote, is)| *vote *= is);
            let half = level.half_columns * 0.85;
            gather(&unhidden, half, &mut shares);
            gather(votes, half, support);
            for (support, share) in support.iter_mut().zip(&shares) {
                *support = if (LEAST_UNHIDDEN..1.0 - LEAST_HIDDEN).contains(share) { *support / share } else { 0.0 };
            }
        }
        self.pick(MAX_BEHIND).into_iter().map(|candidate| Candidate { behind: Some(hider), ..candidate }).collect()
    }

    fn pick(&self, most: usize) -> Vec<Candidate> {
        let width = self.grid.width;
        let mut peaks: Vec<Peak> = Vec::new();
        for l in 0..self.levels.len() {
            for u in 0..width {
                let s = self.worth(l, u);
                if s < LEAST_WORTH || self.support[l * width + u] < LEAST_SUPPORT {
                    continue;
                }
                let at = |l: usize, u: usize| self.worth(l, u % width);
                let beside = at(l, u + 1) > s || at(l, u + width - 1) >= s;
                let nearer = l > 0 && at(l - 1, u) > s;
                let farther = l + 1 < self.levels.len() && at(l + 1, u) >= s;
                if !(beside || nearer || farther) {
                    peaks.push((s, l, u));
                }
            }
        }
        let near = |l: usize, other: usize, apart: f64| {
            let (level, other) = (&self.levels[l], &self.levels[other]);
            let ratio = other.range_m / level.range_m;
            apart < 0.6 * level.half_columns.min(other.half_columns) && (0.8..1.25).contains(&ratio)
        };
        let candidate = |(_, l, u): Peak| self.candidate(l, u, self.support[l * width + u]);
        strongest(peaks, width, most, near).into_iter().map(candidate).collect()
    }

    /// Support less what goes on on either side: the foot of a wall looks like two rings all along, a body ends.
    fn worth(&self, l: usize, u: usize) -> f32 {
        let width = self.grid.width;
        let beside = ((1.8 * self.levels[l].half_columns) as usize).clamp(1, width / 2 - 1);
        let at = |u: usize| self.support[l * width + u % width];
        at(u) - at(u + beside).min(at(u + width - beside))
    }

    fn candidate(&self, l: usize, u: usize, support: f32) -> Candidate {
        let width = self.grid.width;
        let level = &self.levels[l];
        let reach = (level.half_columns * 1.1).ceil() as i64;
        let bearing = |column: f64| self.grid.bearing_rad(column);
        let seen: Vec<i64> = (-reach..=reach)
            .filter(|d| self.votes[l * width + (u as i64 + d).rem_euclid(width as i64) as usize] > 0.3)
            .collect();
        let (first, last) = (seen.first().copied().unwrap_or(0), seen.last().copied().unwrap_or(0));
        Candidate {
            bearing_rad: bearing(u as f64),
            range_m: level.range_m,
            support: f64::from(support),
            seen_rad: [bearing((u as i64 + last) as f64), bearing((u as i64 + first) as f64)],
            known: false,
            rim: None,
            behind: None,
        }
    }
}

/// A place of the panorama that may show something: its support, level of distance and column.
pub(super) type Peak = (f32, usize, usize);

/// The strongest peaks, at most `most`, none near a stronger one: `near` of a peak's level, that of the stronger one, and how many
/// columns they are apart round a panorama of `width` columns.
pub(super) fn strongest(
    mut peaks: Vec<Peak>,
    width: usize,
    most: usize,
    near: impl Fn(usize, usize, f64) -> bool,
) -> Vec<Peak> {
    peaks.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)).then(a.2.cmp(&b.2)));
    unlike(peaks, most, |(_, l, u), (_, level, column)| {
        let apart = (u + width - column) % width;
        near(*l, *level, apart.min(width - apart) as f64)
    })
}

/// At most `most` of what comes best first, leaving out what is `like` something better.
pub(super) fn unlike<T>(best_first: impl IntoIterator<Item = T>, most: usize, like: impl Fn(&T, &T) -> bool) -> Vec<T> {
    let mut picked: Vec<T> = Vec::new();
    for item in best_first {
        if picked.len() == most {
            break;
        }
        if !picked.iter().any(|better| like(&item, better)) {
            picked.push(item);
        }
    }
    picked
}

/// The rows in which rings or stripes appear at a distance along the floor, metres, from their edges' heights (one more than
/// there are of them, from the bottom up) and reflectances; `None` where too few are in view. `lowest` is the tangent of the lowest
/// elevation that the camera sees.
pub(super) fn bands(
    grid: &Grid,
    edges_m: &[f64],
    reflectance: &[f64],
    camera_height_m: f64,
    lowest: f64,
    distance_m: f64,
) -> Option<Vec<Band>> {
    let mut bands = Vec::new();
    for (edges, reflectance) in edges_m.windows(2).zip(reflectance) {
        let upper = grid.row((edges[1] - camera_height_m) / distance_m) + TRIM_ROWS;
        let lower = grid.row(((edges[0] - camera_height_m) / distance_m).max(lowest)) - TRIM_ROWS;
        let from = upper.ceil().max(0.0) as usize;
        let to = (lower.floor().max(0.0) as usize).min(grid.height);
        if from < to {
            bands.push(Band { rows: [from, to], reflectance: *reflectance as f32 });
        }
    }
    let rows: usize = bands.iter().map(|b| b.rows[1] - b.rows[0]).sum();
    let (low, high) = bands.iter().fold((f32::MAX, f32::MIN), |(l, h), b| (l.min(b.reflectance), h.max(b.reflectance)));
    (rows >= 4 && high - low > 0.05).then_some(bands)
}

fn vote(
    sums: &[u32],
    squares: &[u32],
    (width, pad): (usize, usize),
    level: &Level,
    is_barred: bool,
    votes: &mut [f32],
) {
    let stride = width + 2 * pad + 1;
    // Bars are narrow: a strip across the border of one shows neither.
    let half_strip = match is_barred {
        true => ((0.06 * level.half_columns) as usize).min(pad - 1),
        false => ((0.12 * level.half_columns) as usize).clamp(1, pad - 1),
    };
    let hop = half_strip.max(1);
    let mut u = 0;
    while u < width {
        let middle = u + pad;
        let (correlation, gain) = kernel::correlate(
            sums,
            squares,
            stride,
            &level.bands,
            middle - half_strip,
            middle + half_strip + 1,
            NOISE2,
        );
        let (correlation, gain) = if is_barred { (correlation.abs(), gain.abs()) } else { (correlation, gain) };
        let vote =
            if gain < LEAST_GAIN { 0.0 } else { ((correlation - VOTE[0]) / (VOTE[1] - VOTE[0])).clamp(0.0, 1.0) };
        let end = (u + hop).min(width);
        votes[u..end].fill(vote);
        u = end;
    }
}

/// Mean of the votes within `half` columns on either side, round the ring.
fn gather(votes: &[f32], half: f64, support: &mut [f32]) {
    let n = votes.len();
    let h = (half as usize).clamp(1, n / 4);
    let mut sum: f32 = (0..=2 * h).map(|i| votes[(n + i - h) % n]).sum();
    let scale = 1.0 / (2 * h + 1) as f32;
    for u in 0..n {
        support[u] = sum * scale;
        sum += votes[(u + h + 1) % n] - votes[(u + n - h) % n];
    }
}
