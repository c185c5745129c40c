//! Several bodies in one region: where is each of them?
//!
//! Every body was seen alone before: its strip (which cells of columns × bands it fills, and how bright they are) is a
//! template. The region should be the union of the templates at their right places, and each of its cells should look like
//! one of those that cover it. Templates are shifted, one after the other, to where both fit best; the prediction is a
//! weak prior. A body whose columns are covered by others is not measured but only kept between them, and its sigma says so.

use std::ops::RangeInclusive;

use super::body::{BANDS, Strip};
use crate::motion::Raster;
use crate::motion::kernel::wide;

/// One body that is looked for.
#[derive(Debug, Clone)]
pub(super) struct Sought<'a> {
    /// Its strip when it was alone.
    pub(super) template: &'a Strip,
    /// Offset of its axis from the strip's first column.
    pub(super) axis_offset: f64,
    /// Where its axis should be, and how sure that is, columns.
    pub(super) predicted: f64,
    pub(super) sigma: f64,
}

/// Where a body was found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Placed {
    /// Column of the axis, wrapped.
    pub(super) axis: f64,
    /// Share of its columns that no other body covers.
    pub(super) alone: f64,
    /// How much worse the region would be explained without it, as a share of what it would fill: 0 = nothing speaks for it.
    pub(super) support: f64,
}

/// Most bodies fitted at once; a larger group is a crowd, whose members stay where they are predicted.
pub(super) const MAX_BODIES: usize = 6;
/// Grey levels of difference that weigh like a cell filled wrongly.
const GRAY_SCALE: f32 = 40.0;
/// Cells that one column of misplacement is worth: brings the misfit to the scale of the prior.
const CELLS_PER_UNIT: f32 = 4.0;

/// More than rounding makes of a sum, and columns after which it is asked whether it is enough.
const CLEARLY_MORE: f32 = 1.001;
const STEP: usize = 8;

/// Places the bodies in the region's strip.
pub(super) fn place(region: &Strip, bodies: &[Sought<'_>], raster: &Raster) -> Vec<Placed> {
    let n = bodies.len();
    // Offsets of the templates' first columns in the region's columns.
    let predicted: Vec<f64> = bodies
        .iter()
        .map(|b| {
            raster.column_difference(b.predicted, region.start as f64 + middle(region)) + middle(region) - b.axis_offset
        })
        .collect();
    let width = region.filled.len() as i32;
    let mut starts: Vec<i32> = predicted
        .iter()
        .zip(bodies)
        .map(|(p, b)| clamp_inside(p.round() as i32, b.template.filled.len() as i32, width))
        .collect();
    let mut rest = Rest::default();
    if n <= MAX_BODIES {
        // Coordinate descent; few rounds, for each one is exact in its coordinate.
        for _ in 0..3 {
            let before = starts.clone();
            for k in 0..n {
                let reach = (3.0 * bodies[k].sigma).clamp(4.0, 24.0) as i32;
                let centre = predicted[k].round() as i32;
                let candidates = centre - reach..=centre + reach;
                rest.take(region, bodies, &starts, k, &candidates);
                let pull_at = |candidate: i32| {
                    let pull = (f64::from(candidate) - predicted[k]) / bodies[k].sigma;
                    0.5 * (pull * pull) as f32
                };
                let mut best = (f32::INFINITY, starts[k]);
                // Where it was is near the best: what is clearly worse need not be known.
                let mut limit = f32::INFINITY;
                if candidates.contains(&starts[k]) {
                    let misfit = rest.misfit(bodies[k].template, starts[k], f32::INFINITY);
                    limit = misfit / CELLS_PER_UNIT + pull_at(starts[k]);
                }
                for candidate in candidates {
                    let pull = pull_at(candidate);
                    let most = (limit.min(best.0) * CLEARLY_MORE - pull) * CELLS_PER_UNIT;
                    let total = rest.misfit(bodies[k].template, candidate, most) / CELLS_PER_UNIT + pull;
                    if total < best.0 {
                        best = (total, candidate);
                    }
                }
                starts[k] = best.1;
            }
            if starts == before {
                break;
            }
        }
    }
    (0..n)
        .map(|k| {
            rest.take(region, bodies, &starts, k, &(starts[k]..=starts[k]));
            let axis = raster.wrap_column(region.start as f64 + f64::from(starts[k]) + bodies[k].axis_offset);
            let support = rest.support(bodies[k].template, starts[k]);
            Placed { axis, alone: share_alone(k, bodies, &starts), support }
        })
        .collect()
}

fn middle(region: &Strip) -> f64 {
    region.filled.len() as f64 / 2.0
}

fn clamp_inside(start: i32, len: i32, width: i32) -> i32 {
    start.clamp(-len / 2, (width - len / 2).max(-len / 2))
}

/// A region beside what all bodies but one say of it.
#[derive(Debug, Default)]
struct Rest {
    /// The region's column of the first of `columns`; these hold the region, all bodies, and that one wherever it may be.
    first: i32,
    columns: Vec<Column>,
    /// What is wrong without that body in the columns before each one, and in all.
    before: Vec<f32>,
}

/// A column of cells.
#[derive(Debug, Clone, Copy)]
struct Column {
    /// Of the region: how full each cell is and how bright.
    filled: [f32; BANDS],
    gray: [f32; BANDS],
    /// How full the bodies would make it, and how unlike them it is: infinite where none is.
    filling: [f32; BANDS],
    unlike: [f32; BANDS],
}

const NOTHING: Column = Column {
    filled: [0.0; BANDS],
    gray: [f32::INFINITY; BANDS],
    filling: [0.0; BANDS],
    unlike: [f32::INFINITY; BANDS],
};

impl Rest {
    /// All `bodies` but `without` are at their `starts`; that one may be at one of the `candidates`.
    fn take(
        &mut self,
        region: &Strip,
        bodies: &[Sought<'_>],
        starts: &[i32],
        without: usize,
        candidates: &RangeInclusive<i32>,
    ) {
        let (mut first, mut last) = (0, region.filled.len() as i32);
        for (k, (body, start)) in bodies.iter().zip(starts).enumerate() {
            let length = body.template.filled.len() as i32;
            let places = if k == without { candidates.clone() } else { *start..=*start };
            (first, last) = (first.min(*places.start()), last.max(places.end() + length));
        }
        self.first = first;
        self.columns.clear();
        self.columns.resize((last - first) as usize, NOTHING);
        let inside = self.columns.iter_mut().skip(-first as usize);
        for ((column, filled), gray) in inside.zip(&region.filled).zip(&region.gray) {
            (column.filled, column.gray) = (*filled, *gray);
        }
        let others = bodies.iter().zip(starts).enumerate().filter(|(k, _)| *k != without);
        for (_, (body, start)) in others {
            cover(&mut self.columns[(start - first) as usize..], body.template);
        }
        self.before.clear();
        add_up(&self.columns, &mut self.before);
    }

    /// What is wrong with the body at a place; some of it where it is more than `most`.
    fn misfit(&self, template: &Strip, start: i32, most: f32) -> f32 {
        let from = (start - self.first) as usize;
        let to = from + template.filled.len();
        let elsewhere = self.wrong_without() - (self.before[to] - self.before[from]);
        elsewhere + misfit_under(&self.columns[from..to], template, most - elsewhere)
    }

    /// What is wrong without the body.
    fn wrong_without(&self) -> f32 {
        self.before.last().copied().unwrap_or(0.0)
    }

    /// How much worse it is without the body, as a share of what it would fill.
    fn support(&self, template: &Strip, start: i32) -> f64 {
        let worse = self.wrong_without() - self.misfit(template, start, f32::INFINITY);
        let fills: f32 = template.filled.iter().flatten().sum();
        f64::from(worse / fills.max(1.0))
    }
}

wide! {
/// Puts a body into the first columns.
fn cover(columns: &mut [Column], template: &Strip) {
    for (column, (filled, gray)) in columns.iter_mut().zip(template.filled.iter().zip(&template.gray)) {
        *column = column.covered(filled, gray);
    }
}
}

wide! {
/// What is wrong in the columns before each one, and in all.
fn add_up(columns: &[Column], before: &mut Vec<f32>) {
    let mut sum = 0.0;
    before.push(sum);
    for column in columns {
        sum += total(&column.wrong());
        before.push(sum);
    }
}
}

wide! {
/// What is wrong in columns with one more body in all of them; some of it where it is more than `most`.
fn misfit_under(columns: &[Column], template: &Strip, most: f32) -> f32 {
    let mut sums = [0f32; BANDS];
    let bodies = template.filled.chunks(STEP).zip(template.gray.chunks(STEP));
    for (columns, (filled, gray)) in columns.chunks(STEP).zip(bodies) {
        if total(&sums) > most {
            break;
        }
        for (column, (filled, gray)) in columns.iter().zip(filled.iter().zip(gray)) {
            let wrong = column.covered(filled, gray).wrong();
            for band in 0..BANDS {
                sums[band] += wrong[band];
            }
        }
    }
    total(&sums)
}
}

impl Column {
    /// With one more body in it.
    #[inline(always)]
    fn covered(&self, filled: &[f32; BANDS], gray: &[f32; BANDS]) -> Self {
        let mut column = *self;
        for band in 0..BANDS {
            column.filling[band] = column.filling[band].max(filled[band]);
            let difference = if filled[band] > 0.2 { (self.gray[band] - gray[band]).abs() } else { f32::INFINITY };
            column.unlike[band] = column.unlike[band].min(difference);
        }
        column
    }

    /// How much of each cell is filled in only one of region and union, or looks like none of those that cover it.
    #[inline(always)]
    fn wrong(&self) -> [f32; BANDS] {
        std::array::from_fn(|band| {
            let (filled, unlike) = (self.filled[band], self.unlike[band]);
            let covered = (filled > 0.2) & unlike.is_finite();
            let strange = filled * (unlike / GRAY_SCALE).min(1.0);
            (filled - self.filling[band]).abs() + if covered { strange } else { 0.0 }
        })
    }
}

#[inline(always)]
fn total(sums: &[f32; BANDS]) -> f32 {
    let mut total = 0.0;
    for sum in sums {
        total += sum;
    }
    total
}

fn share_alone(k: usize, bodies: &[Sought<'_>], starts: &[i32]) -> f64 {
    let len = bodies[k].template.filled.len() as i32;
    let alone = (starts[k]..starts[k] + len)
        .filter(|x| {
            !starts
                .iter()
                .zip(bodies)
                .enumerate()
                .any(|(j, (s, b))| j != k && (*s..s + b.template.filled.len() as i32).contains(x))
        })
        .count();
    alone as f64 / f64::from(len.max(1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::{Region, Scene, group};

    const RASTER: Raster = Raster { width: 300, height: 80, wraps: true };

    /// Bodies (first column, columns, top row, grey level), later ones nearer.
    fn picture(bodies: &[(usize, usize, usize, u8)]) -> (Vec<u8>, Vec<u8>) {
        let (mut gray, mut mask) = (vec![100u8; RASTER.len()], vec![0u8; RASTER.len()]);
        for &(x0, w, top, level) in bodies {
            for y in top..75 {
                for x in x0..x0 + w {
                    gray[y * 300 + x % 300] = level;
                    mask[y * 300 + x % 300] = 1;
                }
            }
        }
        (gray, mask)
    }

    fn strip(bodies: &[(usize, usize, usize, u8)]) -> Strip {
        let (gray, mask) = picture(bodies);
        let magnitude = vec![50; mask.len()];
        let region: Region = group(&mask, &RASTER, [0, 0], 1).remove(0);
        let scene = Scene { picture: &gray, magnitude: &magnitude, ..Scene::of_marks(&RASTER, &mask, &mask) };
        Strip::of(&region, &scene)
    }

    #[test]
    fn two_overlapping_bodies_are_found_where_they_are_over_the_seam() {
        let (a, b) = (strip(&[(40, 20, 20, 30)]), strip(&[(80, 24, 10, 180)]));
        // a at 285 (axis 294.5), b at 298 (axis 309.5 = 9.5), a in front.
        let region = strip(&[(298, 24, 10, 180), (285, 20, 20, 30)]);
        let sought = |template, axis_offset, predicted| Sought { template, axis_offset, predicted, sigma: 5.0 };
        let placed = place(&region, &[sought(&a, 9.5, 299.0), sought(&b, 11.5, 5.0)], &RASTER);
        assert!(RASTER.column_difference(placed[0].axis, 294.5).abs() <= 1.0, "{placed:?}");
        assert!(RASTER.column_difference(placed[1].axis, 9.5).abs() <= 1.0, "{placed:?}");
        assert!(placed[0].alone > 0.5 && placed[0].alone < 0.8);
    }

    #[test]
    fn a_hidden_body_is_said_to_be_hidden() {
        let (a, b) = (strip(&[(40, 10, 20, 30)]), strip(&[(80, 24, 10, 180)]));
        let region = strip(&[(100, 24, 10, 180)]);
        let sought = |template, axis_offset, predicted| Sought { template, axis_offset, predicted, sigma: 4.0 };
        let placed = place(&region, &[sought(&a, 4.5, 112.0), sought(&b, 11.5, 110.0)], &RASTER);
        assert!(placed[0].alone < 0.05, "{placed:?}");
        assert!(RASTER.column_difference(placed[1].axis, 111.5).abs() <= 1.0, "{placed:?}");
    }
}
