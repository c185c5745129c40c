//! Several bodies in one region: where is each of them?
//!
//! Every body was seen alone before: its strip (which cells of columns × bands it fills, and how bright they are) is a
//! template. The region should be the union of the templates at their right places, and each of its cells should look like
//! one of those that cover it. Templates are shifted, one after the other, to where both fit best; the prediction is a
//! weak prior. A body whose columns are covered by others is not measured but only kept between them, and its sigma says so.

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
const STEP: i32 = 8;

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
    if n <= MAX_BODIES {
        // Coordinate descent; few rounds, for each one is exact in its coordinate.
        for _ in 0..3 {
            let before = starts.clone();
            for k in 0..n {
                let reach = (3.0 * bodies[k].sigma).clamp(4.0, 24.0) as i32;
                let mut best = (f32::INFINITY, starts[k]);
                let centre = predicted[k].round() as i32;
                let mut trial = starts.clone();
                let pull_at = |candidate: i32| {
                    let pull = (f64::from(candidate) - predicted[k]) / bodies[k].sigma;
                    0.5 * (pull * pull) as f32
                };
                let candidates = centre - reach..=centre + reach;
                // Where it was is near the best: what is clearly worse need not be known.
                let mut limit = f32::INFINITY;
                if candidates.contains(&starts[k]) {
                    limit = misfit(region, bodies, &trial, f32::INFINITY) / CELLS_PER_UNIT + pull_at(starts[k]);
                }
                for candidate in candidates {
                    trial[k] = candidate;
                    let pull = pull_at(candidate);
                    let most = (limit.min(best.0) * CLEARLY_MORE - pull) * CELLS_PER_UNIT;
                    let total = misfit(region, bodies, &trial, most) / CELLS_PER_UNIT + pull;
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
            let axis = raster.wrap_column(region.start as f64 + f64::from(starts[k]) + bodies[k].axis_offset);
            Placed { axis, alone: share_alone(k, bodies, &starts), support: support(k, region, bodies, &starts) }
        })
        .collect()
}

fn middle(region: &Strip) -> f64 {
    region.filled.len() as f64 / 2.0
}

fn clamp_inside(start: i32, len: i32, width: i32) -> i32 {
    start.clamp(-len / 2, (width - len / 2).max(-len / 2))
}

wide! {
/// Cells that are filled in only one of region and union, and filled cells that look like none of those that cover them;
/// some of them where there are more than `most`.
fn misfit(region: &Strip, bodies: &[Sought<'_>], starts: &[i32], most: f32) -> f32 {
    let width = region.filled.len() as i32;
    let (mut first, mut last) = (0, width);
    for (s, b) in starts.iter().zip(bodies) {
        (first, last) = (first.min(*s), last.max(s + b.template.filled.len() as i32));
    }
    let mut sums = [0f32; BANDS];
    for x in first..last {
        if (x - first) % STEP == 0 && total(&sums) > most {
            break;
        }
        let (mut filling, mut unlike) = ([0f32; BANDS], [f32::INFINITY; BANDS]);
        let found = usize::try_from(x).ok().filter(|i| *i < region.filled.len());
        let (filled, gray) = match found {
            Some(i) => (&region.filled[i], &region.gray[i]),
            None => (&[0.0; BANDS], &[f32::INFINITY; BANDS]),
        };
        for (s, b) in starts.iter().zip(bodies) {
            let Ok(i) = usize::try_from(x - s) else { continue };
            let (Some(f), Some(g)) = (b.template.filled.get(i), b.template.gray.get(i)) else { continue };
            for band in 0..BANDS {
                filling[band] = filling[band].max(f[band]);
                let difference = if f[band] > 0.2 { (gray[band] - g[band]).abs() } else { f32::INFINITY };
                unlike[band] = unlike[band].min(difference);
            }
        }
        for band in 0..BANDS {
            let covered = (filled[band] > 0.2) & unlike[band].is_finite();
            let strange = filled[band] * (unlike[band] / GRAY_SCALE).min(1.0);
            sums[band] += (filled[band] - filling[band]).abs() + if covered { strange } else { 0.0 };
        }
    }
    total(&sums)
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

fn support(k: usize, region: &Strip, bodies: &[Sought<'_>], starts: &[i32]) -> f64 {
    let others: Vec<usize> = (0..bodies.len()).filter(|&j| j != k).collect();
    let without: Vec<Sought<'_>> = others.iter().map(|&j| bodies[j].clone()).collect();
    let their_starts: Vec<i32> = others.iter().map(|&j| starts[j]).collect();
    let whole = f32::INFINITY;
    let worse = misfit(region, &without, &their_starts, whole) - misfit(region, bodies, starts, whole);
    let fills: f32 = bodies[k].template.filled.iter().flatten().sum();
    f64::from(worse / fills.max(1.0))
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
        Strip::of(
            &region,
            &Scene {
                raster: &RASTER,
                picture: &gray,
                background: &[],
                mask: &mask,
                magnitude: &magnitude,
                valid: &mask,
                objects: &[],
            },
        )
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
