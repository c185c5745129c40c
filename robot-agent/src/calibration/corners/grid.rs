//! From saddles to the labelled corners of a board.
//!
//! ```text
//!          slot 1                 A saddle has four slots, its edges' directions in the order of their angles. Along slots
//!            │                    0 and 2 it is bright towards larger angles, along 1 and 3 dark. A neighbour sees the
//!  slot 2 ───┼─── slot 0          common edge from its other end, so there the sides are exchanged: even slots meet odd
//!            │                    ones, which hardly anything but a board does.
//!          slot 3
//! ```

use std::collections::{BTreeMap, VecDeque};
use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::Vector2;
use protocol::angle::wrap;

use super::BoardNotFound;
use super::saddle::{Saddle, Surface};
use crate::calibration::BoardSize;

/// Candidates beyond this number, weakest first, are left out.
const MAX_SADDLES: usize = 4000;
/// The chord to a neighbour may leave an edge's direction by this much, radians: lines are curved.
const MAX_BEND_RAD: f64 = 0.5;
/// A neighbour is at most this many times stronger or weaker (−det is of fourth order in the scale).
const MAX_STRENGTH_RATIO: f32 = 60.0;
/// Share of the board's corners that must be linked before the others are sought where these say.
const MIN_LINKED: f64 = 0.6;
/// Fewer linked corners are not worth mentioning.
const MIN_GRID: usize = 9;
/// The largest change from one step along a line to the next, as a share of the step.
const MAX_STEP_CHANGE: f64 = 0.6;

type Cell = (i32, i32);
const STEPS: [Cell; 4] = [(1, 0), (0, 1), (-1, 0), (0, -1)];

/// A corner in its place.
#[derive(Debug, Clone, Copy)]
struct Corner {
    saddle: Saddle,
    /// The slot that points to the next column.
    forward: usize,
}

type Grid = BTreeMap<Cell, Corner>;

/// The complete board of this size among the saddles, row by row.
pub(super) fn find(surface: &Surface, saddles: &[Saddle], size: BoardSize) -> Result<Vec<Vector2<f64>>, BoardNotFound> {
    let saddles = &saddles[..saddles.len().min(MAX_SADDLES)];
    let neighbours = mutual_neighbours(surface, saddles);
    let mut largest: Option<Grid> = None;
    for grid in components(saddles, &neighbours) {
        let mut windows = windows(&grid, size);
        windows.retain(|w| w.present as f64 >= MIN_LINKED * size.corners() as f64);
        windows.sort_by_key(|w| std::cmp::Reverse(w.present));
        if windows.iter().filter(|w| w.present == size.corners()).count() > 1 {
            return Err(BoardNotFound::Larger { wanted: size, found: extent(&grid) });
        }
        if let Some(corners) = windows.iter().find_map(|w| complete(surface, &grid, w, size)) {
            return Ok(corners);
        }
        if grid.len() >= MIN_GRID && largest.as_ref().is_none_or(|l| grid.len() > l.len()) {
            largest = Some(grid);
        }
    }
    Err(match largest {
        Some(grid) => BoardNotFound::Incomplete { wanted: size, found: extent(&grid), corners: grid.len() },
        None => BoardNotFound::NoGrid { wanted: size, saddles: saddles.len() },
    })
}

/// The direction of a slot, radians from u towards v.
fn slot_angle(saddle: &Saddle, slot: usize) -> f64 {
    saddle.edges[slot % 2] + if slot % 4 >= 2 { PI } else { 0.0 }
}

/// The slot of one kind (even or odd) that points most nearly along an angle, and how far it is off.
fn nearest_slot(saddle: &Saddle, kind: usize, angle: f64) -> (usize, f64) {
    let off = wrap(slot_angle(saddle, kind) - angle);
    if off.abs() <= FRAC_PI_2 { (kind, off.abs()) } else { (kind + 2, PI - off.abs()) }
}

/// For each saddle and slot the neighbour there and its slot that points back, where both choose each other.
fn mutual_neighbours(surface: &Surface, saddles: &[Saddle]) -> Vec<[Option<(usize, usize)>; 4]> {
    let chosen: Vec<[Option<(usize, usize)>; 4]> =
        saddles.iter().map(|s| choose_neighbours(surface, saddles, s)).collect();
    let is_mutual = |a: usize, slot: usize| {
        chosen[a][slot].filter(|(b, back)| chosen[*b][*back].is_some_and(|(other, s)| (other, s) == (a, slot)))
    };
    (0..saddles.len()).map(|a| [0, 1, 2, 3].map(|slot| is_mutual(a, slot))).collect()
}

fn choose_neighbours(surface: &Surface, saddles: &[Saddle], a: &Saddle) -> [Option<(usize, usize)>; 4] {
    let reach = 0.25 * surface.width.max(surface.height) as f64;
    let mut candidates: [Vec<(f64, usize, usize)>; 4] = Default::default();
    for (index, b) in saddles.iter().enumerate() {
        let chord = b.at - a.at;
        let distance = chord.norm();
        let ratio = b.strength / a.strength;
        if distance > reach || distance < 2.0 || !(1.0 / MAX_STRENGTH_RATIO..=MAX_STRENGTH_RATIO).contains(&ratio) {
            continue;
        }
        let angle = chord.y.atan2(chord.x);
        for kind in 0..2 {
            let (slot, bend_a) = nearest_slot(a, kind, angle);
            let (back, bend_b) = nearest_slot(b, 1 - kind, angle + PI);
            if bend_a < MAX_BEND_RAD && bend_b < MAX_BEND_RAD {
                let bend = (bend_a * bend_a + bend_b * bend_b) / (MAX_BEND_RAD * MAX_BEND_RAD);
                candidates[slot].push((distance * (1.0 + bend), index, back));
            }
        }
    }
    let mut slot = 0;
    candidates.map(|mut list| {
        let kind = slot % 2;
        slot += 1;
        list.sort_by(|x, y| x.0.total_cmp(&y.0));
        // Whatever is nearer than the neighbour is a few stray points: the rest of the list only costs time.
        let first = list.iter().take(12).find(|(_, b, _)| is_edge(surface, &a.at, &saddles[*b].at, kind == 0));
        first.map(|(_, b, back)| (*b, *back))
    })
}

/// Whether the gray values beside a segment differ all along, and the brighter side is the one of larger angles.
fn is_edge(surface: &Surface, from: &Vector2<f64>, to: &Vector2<f64>, bright_at_larger_angles: bool) -> bool {
    let chord = to - from;
    let side = Vector2::new(-chord.y, chord.x).normalize() * (0.22 * chord.norm()).clamp(1.0, 6.0);
    [0.3, 0.5, 0.7].iter().all(|t| {
        let at = from + chord * *t;
        match (surface.gray_at(&(at + side)), surface.gray_at(&(at - side))) {
            (Some(a), Some(b)) => (a - b) * if bright_at_larger_angles { 1.0 } else { -1.0 } > 1.0,
            _ => false,
        }
    })
}

/// Walks the links; each connected part becomes a grid.
fn components(saddles: &[Saddle], neighbours: &[[Option<(usize, usize)>; 4]]) -> Vec<Grid> {
    let mut seen = vec![false; saddles.len()];
    let mut grids = Vec::new();
    for start in 0..saddles.len() {
        if seen[start] {
            continue;
        }
        seen[start] = true;
        let mut grid = Grid::from([((0, 0), Corner { saddle: saddles[start], forward: 0 })]);
        let mut queue = VecDeque::from([(start, (0, 0), 0)]);
        while let Some((a, (i, j), forward)) = queue.pop_front() {
            for (k, (di, dj)) in STEPS.iter().enumerate() {
                let Some((b, back)) = neighbours[a][(forward + k) % 4] else { continue };
                let cell = (i + di, j + dj);
                if seen[b] || grid.contains_key(&cell) {
                    continue;
                }
                seen[b] = true;
                // Its slot `back` points against step k.
                let forward = (back + 4 - (k + 2) % 4) % 4;
                grid.insert(cell, Corner { saddle: saddles[b], forward });
                queue.push_back((b, cell, forward));
            }
        }
        grids.push(grid);
    }
    grids.sort_by_key(|g| std::cmp::Reverse(g.len()));
    grids
}

/// The window's corners in order, with those added, where their neighbours say they are, that were too weak for the list
/// or whose links failed. `None` where one stays missing or the lines are not smooth.
fn complete(surface: &Surface, grid: &Grid, window: &Window, size: BoardSize) -> Option<Vec<Vector2<f64>>> {
    let mut grid: Grid = window.cells.iter().filter_map(|cell| Some((*cell, *grid.get(cell)?))).collect();
    while grid.len() < window.cells.len() {
        let missing = window.cells.iter().filter(|cell| !grid.contains_key(cell));
        let added: Vec<(Cell, Corner)> =
            missing.filter_map(|cell| Some((*cell, corner_at(surface, &grid, *cell)?))).collect();
        if added.is_empty() {
            return None;
        }
        grid.extend(added);
    }
    let corners: Vec<Vector2<f64>> = window.cells.iter().map(|cell| grid[cell].saddle.at).collect();
    is_smooth(&corners, size).then_some(corners)
}

/// Whether steps along rows and columns change little from one to the next.
fn is_smooth(corners: &[Vector2<f64>], size: BoardSize) -> bool {
    let smooth = |a: usize, b: usize, c: usize| {
        let (first, second) = (corners[b] - corners[a], corners[c] - corners[b]);
        (second - first).norm() < MAX_STEP_CHANGE * first.norm().min(second.norm())
    };
    let BoardSize { cols, rows } = size;
    let along_rows = (0..rows).all(|j| (2..cols).all(|i| smooth(j * cols + i - 2, j * cols + i - 1, j * cols + i)));
    along_rows && (0..cols).all(|i| (2..rows).all(|j| smooth((j - 2) * cols + i, (j - 1) * cols + i, j * cols + i)))
}

fn corner_at(surface: &Surface, grid: &Grid, cell: Cell) -> Option<Corner> {
    let neighbour = |(di, dj): Cell, n: i32| grid.get(&(cell.0 + n * di, cell.1 + n * dj)).map(|c| c.saddle.at);
    let mut predictions = Vec::new();
    let mut spacing = f64::INFINITY;
    for step in STEPS {
        if let (Some(a), Some(b)) = (neighbour(step, 1), neighbour(step, 2)) {
            // Straight on, and with the curvature of the line where a third point shows it.
            let predicted = neighbour(step, 3).map_or(2.0 * a - b, |c| 3.0 * a - 3.0 * b + c);
            predictions.push(predicted);
            spacing = spacing.min((a - predicted).norm());
        }
    }
    if predictions.is_empty() {
        return None;
    }
    let predicted = predictions.iter().sum::<Vector2<f64>>() / predictions.len() as f64;
    let saddle = surface.saddle_near(predicted, 0.4 * spacing)?;
    let mut corner = None;
    for (k, (di, dj)) in STEPS.iter().enumerate() {
        let Some(other) = grid.get(&(cell.0 + di, cell.1 + dj)) else { continue };
        let chord = other.saddle.at - saddle.at;
        let other_slot = (other.forward + k + 2) % 4;
        let kind = 1 - other_slot % 2;
        let (slot, bend) = nearest_slot(&saddle, kind, chord.y.atan2(chord.x));
        let forward = (slot + 4 - k) % 4;
        if bend > MAX_BEND_RAD
            || saddle.strength * MAX_STRENGTH_RATIO < other.saddle.strength
            || !is_edge(surface, &saddle.at, &other.saddle.at, kind == 0)
            || corner.is_some_and(|c: Corner| c.forward != forward)
        {
            return None;
        }
        corner = Some(Corner { saddle, forward });
    }
    corner
}

/// A place and orientation of the board on the grid.
struct Window {
    /// Row by row.
    cells: Vec<Cell>,
    /// How many of them the grid has.
    present: usize,
}

fn windows(grid: &Grid, size: BoardSize) -> Vec<Window> {
    let (cols, rows) = (size.cols as i32, size.rows as i32);
    let ends = |f: fn(&Cell) -> i32| grid.keys().map(f).fold((0, 0), |(l, h), x| (l.min(x), h.max(x)));
    let ((i_low, i_high), (j_low, j_high)) = (ends(|c| c.0), ends(|c| c.1));
    let mut list = Vec::new();
    for i0 in i_low - cols..=i_high {
        for j0 in j_low - cols..=j_high {
            let mut add = |cell: &dyn Fn(i32, i32) -> Cell| {
                let cells: Vec<Cell> =
                    (0..rows).flat_map(|j| (0..cols).map(move |i| (i, j))).map(|(i, j)| cell(i, j)).collect();
                let present = cells.iter().filter(|c| grid.contains_key(c)).count();
                list.push(Window { cells, present });
            };
            add(&|i, j| (i0 + i, j0 + j));
            if cols != rows {
                // A quarter turn: columns run along j, rows against i.
                add(&|i, j| (i0 + (rows - 1) - j, j0 + i));
            }
        }
    }
    list
}

fn extent(grid: &Grid) -> BoardSize {
    let span = |f: fn(&Cell) -> i32| {
        let (low, high) = grid.keys().map(f).fold((i32::MAX, i32::MIN), |(l, h), x| (l.min(x), h.max(x)));
        (high - low + 1).max(0) as usize
    };
    BoardSize { cols: span(|c| c.0), rows: span(|c| c.1) }
}
