//! Upright edges of what stands still: corners, door frames, posts, sides of furniture. Their bearings are what several robots
//! make a map of the room from.
//!
//! Problem: people, shadows and noise have upright edges too, and most edges of a room are no upright ones.
//!
//! Insight: the background has no people in it and next to no noise, and in the panorama of a level camera whatever is upright
//! stands in one column, at any distance. Algorithm: steps between the columns, summed over a few rows; where they are largest
//! along a row is an edge point (to a part of a pixel by a parabola); points one below the other are a chain; a long chain that
//! stays in its column is an upright edge. Fellow robots are left out: they stand only for a while.

use protocol::angle::difference;
use protocol::message::UprightEdge;
use protocol::message::edges::MAX_EDGES;
use protocol::quantity::{Angle16, LogSigma};
use protocol::time::Timestamp;

use crate::motion::Raster;
use crate::tracking::{PeerBearing, View};

/// Rows over which steps are summed, to either side.
const BESIDE_ROWS: usize = 2;
/// Mean step between the columns beside an edge, grey levels.
const LEAST_STEP: i32 = 6;
/// Rows of an edge, as an angle, and rows without a point that it goes on over.
const LEAST_RAD: f64 = 0.06;
const GAP_ROWS: usize = 3;
/// Upper and lower half of an upright edge are in the same column to this, and its points scatter by less; columns.
const MOST_SLANT: f64 = 0.35;
const MOST_SCATTER: f64 = 0.5;
/// Error of an edge's column that does not average out over its rows: parabola, table, blur.
const FLOOR_COLUMNS: f64 = 0.08;
/// Rows along an edge whose errors are alike.
const ALIKE_ROWS: f64 = 5.0;
/// Columns beside an edge that its levels are of.
const LEVELS_AT: std::ops::RangeInclusive<isize> = 2..=4;
/// An end so near to where the picture ends is cut, rows.
const CUT_ROWS: usize = 3;
/// Beside a fellow robot edges are its own, radians.
const BESIDE_PEER_RAD: f64 = 0.03;
/// When a background is good enough, and how long what was told holds, seconds.
const SETTLED_S: f64 = 3.0;
const TOLD_EVERY_S: f64 = 10.0;

/// When edges are due.
#[derive(Debug, Clone, Copy, Default)]
pub struct Due {
    at: Option<Timestamp>,
}

impl Due {
    /// Whether they are at a frame; `ready`: there is a background.
    pub fn is_due(&mut self, capture: Timestamp, ready: bool) -> bool {
        if !ready {
            self.at = None;
            return false;
        }
        let at = *self.at.get_or_insert_with(|| capture.offset_by_secs(SETTLED_S));
        // A clock that was set back must not silence it for years.
        let due = capture >= at || at.seconds_since(capture) > TOLD_EVERY_S;
        if due {
            self.at = Some(capture.offset_by_secs(TOLD_EVERY_S));
        }
        due
    }
}

/// Edge points below each other.
#[derive(Debug, Clone)]
struct Chain {
    positive: bool,
    /// Column of the first point; the others are counted from it, over the seam.
    first: f64,
    last: f64,
    last_row: usize,
    /// Row, column from the first on, step.
    points: Vec<(usize, f64, i32)>,
}

/// The upright edges of a background (grey levels; `valid`: what the camera sees), the plainest first.
pub fn upright_edges(
    background: &[u8],
    valid: &[u8],
    raster: &Raster,
    view: &View,
    peers: &[PeerBearing],
) -> Vec<UprightEdge> {
    let (w, h) = (raster.width, raster.height);
    if background.len() != w * h || valid.len() != w * h || h <= 2 * BESIDE_ROWS || w < 16 {
        return Vec::new();
    }
    let row_rad = view.steps_rad(0.0, h as f64 / 2.0)[1];
    let least_rows = ((LEAST_RAD / row_rad).round() as usize).max(2 * BESIDE_ROWS + 1);
    let picture = Picture { background, valid, raster, view };
    let mut edges: Vec<(f64, UprightEdge)> = picture
        .chains(least_rows)
        .iter()
        .filter_map(|chain| picture.edge(chain))
        .filter(|(_, edge)| {
            let near = |p: &PeerBearing| {
                difference(p.bearing_rad, edge.bearing.rad()).abs() < p.half_width_rad + BESIDE_PEER_RAD
            };
            !peers.iter().any(near)
        })
        .collect();
    edges.sort_by(|a, b| b.0.total_cmp(&a.0));
    edges.truncate(MAX_EDGES);
    edges.into_iter().map(|(_, edge)| edge).collect()
}

struct Picture<'a> {
    background: &'a [u8],
    valid: &'a [u8],
    raster: &'a Raster,
    view: &'a View,
}

impl Picture<'_> {
    fn chains(&self, least_rows: usize) -> Vec<Chain> {
        let (w, h) = (self.raster.width, self.raster.height);
        let rows = 2 * BESIDE_ROWS + 1;
        let least = LEAST_STEP * rows as i32;
        let (mut sums, mut done, mut open) = (vec![0i32; w], Vec::new(), Vec::<Chain>::new());
        for y in BESIDE_ROWS..h - BESIDE_ROWS {
            sums.fill(0);
            for row in y - BESIDE_ROWS..=y + BESIDE_ROWS {
                self.add_steps(row, &mut sums);
            }
            for x in 0..w {
                let beside = [-1, 1].map(|d| self.raster.column_at(x as isize + d).map_or(0, |c| sums[c]));
                let here = sums[x];
                let (before, after) = (beside[0].abs(), beside[1].abs());
                if here.abs() < least || here.abs() < before || here.abs() <= after {
                    continue;
                }
                let curve = f64::from(2 * here.abs() - before - after).max(1.0);
                let part = (0.5 * f64::from(after - before) / curve).clamp(-0.5, 0.5);
                self.link(&mut open, y, x as f64 + part, here);
            }
            let over = |chain: &Chain| y - chain.last_row > GAP_ROWS;
            done.extend(open.iter().filter(|c| over(c) && c.points.len() >= least_rows).cloned());
            open.retain(|c| !over(c));
        }
        done.extend(open.into_iter().filter(|c| c.points.len() >= least_rows));
        done
    }

    /// Adds the steps across the columns of one row; none where something is not seen.
    fn add_steps(&self, row: usize, sums: &mut [i32]) {
        let w = self.raster.width;
        let (levels, valid) = (&self.background[row * w..][..w], &self.valid[row * w..][..w]);
        for (x, sum) in sums.iter_mut().enumerate() {
            let (Some(l), Some(r)) = (self.raster.column_at(x as isize - 1), self.raster.column_at(x as isize + 1))
            else {
                continue;
            };
            if valid[l] != 0 && valid[x] != 0 && valid[r] != 0 {
                *sum += i32::from(levels[r]) - i32::from(levels[l]);
            }
        }
    }

    fn link(&self, open: &mut Vec<Chain>, y: usize, x: f64, step: i32) {
        let away = |c: &Chain| self.raster.column_difference(x, c.last).abs();
        let found = open
            .iter_mut()
            .filter(|c| c.positive == (step > 0) && c.last_row < y && away(c) <= 1.0)
            .min_by(|a, b| away(a).total_cmp(&away(b)));
        match found {
            Some(chain) => {
                chain.points.push((y, self.raster.column_difference(x, chain.first), step.abs()));
                (chain.last, chain.last_row) = (x, y);
            }
            None => open.push(Chain {
                positive: step > 0,
                first: x,
                last: x,
                last_row: y,
                points: vec![(y, 0.0, step.abs())],
            }),
        }
    }

    /// The edge that a chain is, and how plain it is; `None` where it leaves its column.
    fn edge(&self, chain: &Chain) -> Option<(f64, UprightEdge)> {
        let points = &chain.points;
        let mean = |points: &[(usize, f64, i32)]| {
            let (mut sum, mut weight) = (0.0, 0.0);
            for (_, x, step) in points {
                sum += f64::from(*step) * x;
                weight += f64::from(*step);
            }
            sum / weight.max(1.0)
        };
        let (upper, lower) = points.split_at(points.len() / 2);
        if (mean(upper) - mean(lower)).abs() > MOST_SLANT {
            return None;
        }
        let middle = mean(points);
        let scatter = (points.iter().map(|(_, x, _)| (x - middle).powi(2)).sum::<f64>() / points.len() as f64).sqrt();
        if scatter > MOST_SCATTER {
            return None;
        }
        let column = self.raster.wrap_column(chain.first + middle);
        // Beyond its ends a part of the rows that are summed still shows it: it ends where half of them do.
        let typical = points.iter().map(|(.., step)| step).sum::<i32>() / points.len() as i32;
        let shows = |point: &&(usize, f64, i32)| 2 * point.2 >= typical;
        let [top, bottom] = [points.iter().find(shows)?.0, points.iter().rfind(shows)?.0];
        let (bearing, _) = self.view.angles_rad(column, (top + bottom) as f64 / 2.0)?;
        let elevation = |row: usize| Some(self.view.angles_rad(column, row as f64)?.1);
        let step_rad = self.view.steps_rad(column, (top + bottom) as f64 / 2.0)[0];
        let sigma = FLOOR_COLUMNS.hypot(scatter / (points.len() as f64 / ALIKE_ROWS).sqrt());
        let plainness: f64 = points.iter().map(|(.., step)| f64::from(*step).sqrt()).sum();
        let edge = UprightEdge {
            bearing: Angle16::from_rad(bearing),
            sigma: LogSigma::from_value(sigma * step_rad),
            levels: self.levels_beside(column, top, bottom)?,
            elevation: [Angle16::from_rad(elevation(bottom)?), Angle16::from_rad(elevation(top)?)],
            ends: [!self.is_cut(column, bottom, 1), !self.is_cut(column, top, -1)],
        };
        Some((plainness, edge))
    }

    /// Mean grey levels left and right of an edge.
    fn levels_beside(&self, column: f64, top: usize, bottom: usize) -> Option<[u8; 2]> {
        let (w, x) = (self.raster.width, column.round() as isize);
        let side = |sign: isize| {
            let columns: Vec<usize> = LEVELS_AT.filter_map(|d| self.raster.column_at(x + sign * d)).collect();
            let (mut sum, mut count) = (0u32, 0u32);
            for row in top..=bottom {
                for c in columns.iter().filter(|c| self.valid[row * w + **c] != 0) {
                    (sum, count) = (sum + u32::from(self.background[row * w + c]), count + 1);
                }
            }
            (count > 0).then(|| (sum / count.max(1)) as u8)
        };
        Some([side(-1)?, side(1)?])
    }

    /// Whether the picture ends just beyond a row.
    fn is_cut(&self, column: f64, row: usize, direction: isize) -> bool {
        let (w, h) = (self.raster.width, self.raster.height);
        let Some(x) = self.raster.column_at(column.round() as isize) else { return true };
        (1..=(CUT_ROWS + BESIDE_ROWS) as isize).any(|d| {
            let beyond = usize::try_from(row as isize + direction * d).ok().filter(|row| *row < h);
            beyond.is_none_or(|row| self.valid[row * w + x] == 0)
        })
    }
}

#[cfg(test)]
mod tests;
