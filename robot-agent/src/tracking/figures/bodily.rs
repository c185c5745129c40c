//! How much of what is marked is somebody's body, and not only lighter or darker than it was.
//!
//! Problem: a lamp near somebody makes shadows on walls that leave half of the light or less. Pixel by pixel, and in small blocks, they
//! look like a dark coat; a figure that takes them in stays with them when its owner walks on. Insight: over half a metre they do
//! not, nor do the scraps of them that `motion/shadow` leaves. A shadow is one ratio to what is behind, changes slowly, and has no more
//! texture than what is behind has; clothes, arms, faces and the gaps between them do. Algorithm: a network of one hidden layer looks at
//! statistics of what is marked in two windows round each cell. It is learnt by `sim-harness shadows` from rendered rooms, in which every pixel's owner is known.

use std::ops::Range;
use std::sync::OnceLock;

use super::CELL;
use crate::motion::Scene;

/// Half sizes of the windows, rows and columns of cells.
const WINDOWS: [[usize; 2]; 2] = [[2, 2], [4, 3]];
/// Cells that are repeated beyond both ends of a row.
const PAD: usize = 3;
/// What is measured of a window.
const TRAITS: usize = 11;
/// All that the network sees of a cell.
pub const INPUTS: usize = 1 + WINDOWS.len() * TRAITS;
/// Its hidden units.
pub const HIDDEN: usize = 16;
/// Its weights: of each unit those of the inputs and a bias, then those of the units and a bias.
pub const WEIGHTS: usize = HIDDEN * (INPUTS + 1) + HIDDEN + 1;

/// The weights as they were learnt, four bytes each, the least first.
static LEARNT: &[u8] = include_bytes!("bodily.net");

/// What speaks for a body before anything is seen of it, beyond how often marks are bodies in the rooms that were learnt from, nats.
const DOUBT: f32 = 1.0;

/// Darker than this counts as this, grey levels: ratios of what is nearly black say nothing.
const LEAST_LEVEL: f32 = 2.0;
/// Least variance of a background that tells whether it shows through, (grey levels)².
const NOISE: f32 = 9.0;

/// A cell in which something is marked.
#[derive(Debug, Clone, PartialEq)]
pub struct MarkedCell {
    /// Columns of the panorama.
    pub columns: Range<usize>,
    /// Its rows.
    pub rows: Range<usize>,
    /// Share of its pixels that are marked.
    pub marked: f32,
    /// What the network sees of it.
    pub inputs: [f32; INPUTS],
}

/// Of the marked pixels of a cell, times the share of it that is marked; summed over the cells of a window.
#[derive(Debug, Clone, Copy, Default)]
#[repr(C)]
struct Sums([f32; 16]);

// What is in [`Sums`]: the share itself, 1 for any cell that is tested, the logarithm of picture over background and its square, the rest
// beside that ratio, the spreads of both, their means and the products of these, and 1 where it is brighter.
const SHARE: usize = 0;
const TESTED: usize = 1;
const RATIO: usize = 2;

/// The cells of a frame.
#[derive(Debug)]
pub(super) struct Cells {
    columns: usize,
    rows: usize,
    sums: Vec<Sums>,
}

impl Cells {
    pub(super) fn new(columns: usize, rows: usize) -> Self {
        Self { columns, rows, sums: vec![Sums::default(); rows * (columns + 2 * PAD)] }
    }

    /// Takes a cell of a frame, with the numbers of its pixels that are marked and that are tested at all.
    pub(super) fn take(&mut self, scene: &Scene<'_>, [row, cell]: [usize; 2], [marked, tested]: [u32; 2]) {
        let has_background = scene.background.len() == scene.picture.len();
        let at = self.at(row, cell);
        let sums = &mut self.sums[at].0;
        *sums = [0.0; 16];
        sums[TESTED] = f32::from(u8::from(tested > 0));
        if marked > 0 && has_background {
            add_marked(sums, scene, [row, cell], [marked, tested]);
        }
    }

    /// All cells are taken.
    pub(super) fn close(&mut self) {
        let (columns, stride) = (self.columns, self.stride());
        for sums in self.sums.chunks_exact_mut(stride) {
            sums.copy_within(columns..columns + PAD, 0);
            sums.copy_within(PAD..2 * PAD, PAD + columns);
        }
    }

    fn stride(&self) -> usize {
        self.columns + 2 * PAD
    }

    fn at(&self, row: usize, cell: usize) -> usize {
        row * self.stride() + PAD + cell
    }

    /// Share of a cell that is marked, if the background is known.
    pub(super) fn marked_share(&self, row: usize, cell: usize) -> f32 {
        self.sums[self.at(row, cell)].0[SHARE]
    }

    /// What the network sees of a cell; `None` where nothing is marked.
    pub(super) fn inputs(&self, row: usize, cell: usize) -> Option<[f32; INPUTS]> {
        let here = &self.sums[self.at(row, cell)].0;
        if here[SHARE] == 0.0 {
            return None;
        }
        let [level, behind] = [here[7], here[8]].map(|sum| (sum / here[SHARE]).max(LEAST_LEVEL));
        let mut inputs = [behind.ln(); INPUTS];
        for ([up, aside], inputs) in WINDOWS.iter().zip(inputs[1..].chunks_exact_mut(TRAITS)) {
            let mut window = Sums::default();
            for y in row.saturating_sub(*up)..(row + up + 1).min(self.rows) {
                let first = self.at(y, cell) - aside;
                for sums in &self.sums[first..=first + 2 * aside] {
                    window.0.iter_mut().zip(sums.0).for_each(|(sum, value)| *sum += value);
                }
            }
            inputs.copy_from_slice(&traits(&window.0, level, behind));
        }
        Some(inputs)
    }

    /// Cells in which something is marked.
    pub(super) fn marked(&self) -> impl Iterator<Item = MarkedCell> {
        let cells = (0..self.rows).flat_map(|row| (0..self.columns).map(move |cell| (row, cell)));
        cells.filter_map(|(row, cell)| {
            let inputs = self.inputs(row, cell)?;
            let marked = self.marked_share(row, cell);
            let [x, y] = [cell * CELL[0], row * CELL[1]];
            Some(MarkedCell { columns: x..x + CELL[0], rows: y..y + CELL[1], marked, inputs })
        })
    }

    /// Probability that what is marked in a cell is a body; 1 where nothing is.
    pub(super) fn body(&self, row: usize, cell: usize) -> f32 {
        static NET: OnceLock<Vec<f32>> = OnceLock::new();
        let net = NET.get_or_init(|| LEARNT.as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect());
        self.inputs(row, cell).map_or(1.0, |inputs| probability(log_odds(net, &inputs) + DOUBT))
    }
}

/// What is in a cell in which something is marked.
fn add_marked(sums: &mut [f32; 16], scene: &Scene<'_>, [row, cell]: [usize; 2], [marked, tested]: [u32; 2]) {
    let (w, h) = (scene.raster.width, scene.raster.height);
    // Of the picture and of the background in 8.8 fixed point.
    let (mut p, mut b, mut pp, mut pb, mut bb) = (0u32, 0u32, 0u32, 0u32, 0u64);
    for y in row * CELL[1]..((row + 1) * CELL[1]).min(h) {
        for i in y * w + cell * CELL[0]..y * w + ((cell + 1) * CELL[0]).min(w) {
            if scene.mask[i] != 0 {
                let (now, behind) = (u32::from(scene.picture[i]), u32::from(scene.background[i]));
                p += now;
                b += behind;
                pp += now * now;
                pb += now * behind;
                bb += u64::from(behind * behind);
            }
        }
    }
    let mean = |sum: f64| (sum / f64::from(marked)) as f32;
    let (pp, pb, bb) = (mean(f64::from(pp)), mean(f64::from(pb) / 256.0), mean(bb as f64 / 65536.0));
    let (p, b) = (mean(f64::from(p)), mean(f64::from(b) / 256.0));
    let rest = (pp - pb / bb.max(1e-3) * pb).max(0.0).sqrt();
    let [spread, spread_behind] = [pp - p * p, bb - b * b].map(|var| var.max(0.0).sqrt());
    let ratio = (p.max(LEAST_LEVEL) / b.max(LEAST_LEVEL)).ln();
    let brighter = f32::from(u8::from(ratio > 0.0));
    let share = marked as f32 / tested.max(1) as f32;
    let values = [ratio, ratio * ratio, rest, spread, spread_behind, p, b, p * p, p * b, b * b, brighter];
    sums[SHARE] = share;
    sums[RATIO..].iter_mut().zip(values).for_each(|(sum, value)| *sum = share * value);
}

/// Of a window, for a cell of some grey level before one of another.
fn traits(sums: &[f32; 16], level: f32, behind: f32) -> [f32; TRAITS] {
    let share = sums[SHARE].max(1e-6);
    let mut means = [0.0; TRAITS];
    means.iter_mut().zip(&sums[RATIO..]).for_each(|(mean, sum)| *mean = sum / share);
    let [ratio, ratios, rest, spread, spread_behind, p, b, pp, pb, bb, brighter] = means;
    let [var, var_behind] = [pp - p * p, bb - b * b].map(|var| var.max(0.0));
    let together = pb - p * b;
    let unexplained = (var - together * together / (var_behind + 1e-3)).max(0.0).sqrt();
    let part = |spread: f32, of: f32| ((spread + 1.0) / of).ln();
    [
        ratio,
        ((ratios - ratio * ratio).max(0.0).sqrt() + 0.01).ln(),
        part(rest, level),
        part(spread, level),
        part(spread_behind, behind),
        share / sums[TESTED].max(1.0),
        (together / (var_behind + NOISE)).clamp(-3.0, 3.0),
        part(var_behind.sqrt(), behind),
        part(var.sqrt(), level),
        part(unexplained, level),
        brighter,
    ]
}

/// What a network of [`WEIGHTS`] makes of a cell: log-odds of its being a body.
pub fn log_odds(net: &[f32], inputs: &[f32; INPUTS]) -> f32 {
    let (units, last) = net.split_at(HIDDEN * (INPUTS + 1));
    let mut sum = last[HIDDEN];
    for (unit, weight) in units.chunks_exact(INPUTS + 1).zip(last) {
        sum += weight * active(unit, inputs).max(0.0);
    }
    sum
}

/// What goes into a hidden unit.
pub fn active(unit: &[f32], inputs: &[f32; INPUTS]) -> f32 {
    unit[INPUTS] + unit.iter().zip(inputs).map(|(w, x)| w * x).sum::<f32>()
}

/// Of log-odds.
pub fn probability(log_odds: f32) -> f32 {
    1.0 / (1.0 + (-log_odds).exp())
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};

    use protocol::time::Timestamp;

    use super::*;
    use crate::motion::{Holds, MotionSettings, MotionStage, Raster};

    const RING: Raster = Raster { width: 360, height: 160, wraps: true };
    /// Middle of the figure and half of its breadth, columns; its first row.
    const FIGURE: [usize; 3] = [180, 24, 40];

    /// Mean of what is said of the marked cells of an upright figure before a wall; `now` gives a level from the wall's, column and row.
    fn bodily(now: impl Fn(f64, usize, usize) -> f64) -> f32 {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let mut noise = || (0..4).map(|_| f64::from(rng.next_u32() >> 24) / 256.0 - 0.5).sum::<f64>() * 3.4;
        let wall = |x: usize, y: usize| 120.0 + 0.1 * x as f64 + 0.15 * y as f64;
        let at = |i: usize| (i % RING.width, i / RING.width);
        let inside = |x: usize, y: usize| x.abs_diff(FIGURE[0]) <= FIGURE[1] && y >= FIGURE[2];
        let mut picture = vec![0; RING.len()];
        for (i, pixel) in picture.iter_mut().enumerate() {
            let (x, y) = at(i);
            let level = if inside(x, y) { now(wall(x, y), x, y) } else { wall(x, y) };
            *pixel = (level + noise()).round().clamp(0.0, 255.0) as u8;
        }
        let background: Vec<u16> = (0..RING.len()).map(|i| (256.0 * wall(at(i).0, at(i).1)) as u16).collect();
        let mask: Vec<u8> = (0..RING.len()).map(|i| u8::from(inside(at(i).0, at(i).1))).collect();
        let valid = vec![1; RING.len()];
        let scene = Scene { picture: &picture, background: &background, ..Scene::of_marks(&RING, &mask, &valid) };
        let cells = cells_of(&scene);
        let said: Vec<f32> =
            cells.marked().map(|c| cells.body(c.rows.start / CELL[1], c.columns.start / CELL[0])).collect();
        mean(&said)
    }

    fn mean(values: &[f32]) -> f32 {
        values.iter().sum::<f32>() / values.len() as f32
    }

    fn cells_of(scene: &Scene<'_>) -> Cells {
        let (width, height) = (scene.raster.width, scene.raster.height);
        let (columns, rows) = (width / CELL[0], height / CELL[1]);
        let mut cells = Cells::new(columns, rows);
        for (row, cell) in (0..rows).flat_map(|row| (0..columns).map(move |cell| (row, cell))) {
            let lines = || row * CELL[1]..(row + 1) * CELL[1];
            let at = |y: usize| y * width + cell * CELL[0]..y * width + (cell + 1) * CELL[0];
            let count = |of: &[u8]| lines().map(|y| of[at(y)].iter().map(|m| u32::from(*m)).sum::<u32>()).sum();
            cells.take(scene, [row, cell], [count(scene.mask), count(scene.valid)]);
        }
        cells.close();
        cells
    }

    #[test]
    fn clothes_are_a_body_also_where_they_are_as_dark_as_a_shadow() {
        let folds = |x: usize, y: usize| (x as f64 / 4.0 + y as f64 / 9.0).sin() + (y as f64 / 5.0).cos();
        // Hair, a shirt, trousers, with an arm's edge between.
        let clothes = |shirt: f64, trousers: f64, fold: f64| {
            move |_: f64, x: usize, y: usize| {
                let level = match y {
                    ..=59 => 45.0,
                    60..=109 => shirt,
                    _ => trousers,
                };
                let arm = if x.abs_diff(FIGURE[0]) > 15 && y > 65 { 0.85 } else { 1.0 };
                level * arm * (1.0 + fold * folds(x, y))
            }
        };
        for (shirt, trousers) in [(90.0, 60.0), (170.0, 80.0), (70.0, 70.0)] {
            let said = bodily(clothes(shirt, trousers, 0.12));
            assert!(said > 0.8, "{said:.2} of {shirt} over {trousers}");
        }
    }

    /// Real people and what else is marked, in a place that nothing was learnt from: frames of PETS 2009, S2.L1, view 1.
    #[test]
    #[ignore = "needs PALTEAM_DATA"]
    fn real_pedestrians_are_bodies_and_most_of_what_else_is_marked_is_not() {
        const WIDTH: usize = 384;
        let data = std::env::var("PALTEAM_DATA").expect("PALTEAM_DATA names the folder of recordings");
        let dir = std::path::Path::new(&data).join("pets_s2l1");
        // Frame from 1, identity, then x, y, width and height in a picture of twice the size.
        let truth = std::fs::read_to_string(dir.join("gt_mot_format.txt")).unwrap();
        let boxes: Vec<Vec<f64>> =
            truth.lines().map(|l| l.split(',').map(|v| v.trim().parse().unwrap()).collect()).collect();
        let within = |cell: &MarkedCell, b: &[f64], beyond: f64, high: f64| {
            let [x, y] = [&cell.columns, &cell.rows].map(|r| (r.start + r.end) as f64);
            (b[2] - beyond..b[2] + b[4] + beyond).contains(&x)
                && (b[3] - beyond..b[3] + high * b[5] + beyond).contains(&y)
        };
        let raster = Raster { width: WIDTH, height: 288, wraps: false };
        let mut stage =
            MotionStage::new(raster, None, MotionSettings { own_motion: false, ..Default::default() }).unwrap();
        let (mut people, mut rest) = (Vec::new(), Vec::new());
        for frame in 0..400 {
            let picture = image::open(dir.join(format!("frames_384x288_gray/{frame:04}.jpg"))).unwrap().into_luma8();
            stage.change(&picture, Timestamp::from_secs_f64(f64::from(frame) / 7.0)).unwrap();
            stage.extract();
            stage.learn(&Holds::default());
            if frame < 100 || frame % 5 != 0 {
                continue;
            }
            let cells = cells_of(&stage.scene());
            let here: Vec<&[f64]> = boxes.iter().filter(|b| b[0] == f64::from(frame + 1)).map(Vec::as_slice).collect();
            let mut said = vec![Vec::new(); here.len()];
            for cell in cells.marked() {
                let body = cells.body(cell.rows.start / CELL[1], cell.columns.start / CELL[0]);
                // Feet are among shadows.
                if let Some(who) = here.iter().position(|b| within(&cell, b, 0.0, 0.85)) {
                    said[who].push(body);
                } else if !here.iter().any(|b| within(&cell, b, 20.0, 1.0)) {
                    rest.push(body);
                }
            }
            people.extend(said.iter().filter(|s| s.len() > 8).map(|s| mean(s)));
        }
        people.sort_by(f32::total_cmp);
        let (least, tenth, others) = (people[0], people[people.len() / 10], mean(&rest));
        eprintln!(
            "{} people: least {least:.2}, a tenth below {tenth:.2}; {} other cells: {others:.2}",
            people.len(),
            rest.len()
        );
        assert!(people.len() > 300 && least > 0.5 && tenth > 0.8, "{} people, {least:.2}, {tenth:.2}", people.len());
        assert!(others < 0.4, "{others:.2} of {} other cells", rest.len());
    }
}
