//! What an object looks like: a histogram of grey levels, compared by the Bhattacharyya distance (`MATHS.md` §7.10, golden
//! group `bhattacharyya`). Frozen before a merge, it tells after the split who is who; velocities do not, for people turn back.

use crate::motion::{Region, Scene};

/// Bins of a histogram.
pub const BINS: usize = 16;

/// √(1 − Σ√(pᵢqᵢ)) of two histograms (any scale, equal lengths): 0 alike … 1 disjoint. 1 where one is empty.
pub fn bhattacharyya(a: &[f64], b: &[f64]) -> f64 {
    let (sa, sb) = (a.iter().sum::<f64>(), b.iter().sum::<f64>());
    if !(sa > 0.0 && sb > 0.0) {
        return 1.0;
    }
    let overlap: f64 = a.iter().zip(b).map(|(p, q)| (p / sa * q / sb).sqrt()).sum();
    (1.0 - overlap).max(0.0).sqrt()
}

/// Rows of a region that are counted, about.
const ROWS: usize = 28;

/// Grey levels of a region, upper and lower half apart: trousers and jackets are told apart by where they are.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Histogram {
    bins: [f64; 2 * BINS],
}

impl Histogram {
    /// Of a region's pixels.
    pub fn of(region: &Region, scene: &Scene<'_>) -> Self {
        // Counted by grey level first; two counters in turn, for neighbours are often equal.
        let mut counts = [[[0u32; 256]; 2]; 2];
        let middle = usize::midpoint(region.rows[0], region.rows[1]);
        // A few rows of what is tall say as much.
        let step = (region.height() / ROWS).max(1);
        for (row, start, len) in region.spans().filter(|(row, _, _)| row.is_multiple_of(step)) {
            let [even, odd] = &mut counts[usize::from(row > middle)];
            let (pairs, rest) = scene.picture[row * scene.raster.width + start..][..len].as_chunks::<2>();
            for [a, b] in pairs {
                even[usize::from(*a)] += 1;
                odd[usize::from(*b)] += 1;
            }
            for a in rest {
                even[usize::from(*a)] += 1;
            }
        }
        let mut bins = [0.0; 2 * BINS];
        for (bins, [even, odd]) in bins.chunks_exact_mut(BINS).zip(&counts) {
            let mut levels = [0u32; 256];
            for (n, (a, b)) in levels.iter_mut().zip(even.iter().zip(odd)) {
                *n = a + b;
            }
            share_out(&levels, bins);
        }
        Self { bins }
    }

    /// 0 alike … 1 unlike.
    pub fn distance(&self, other: &Self) -> f64 {
        bhattacharyya(&self.bins, &other.bins)
    }

    /// Moves a part of the way towards a newer look.
    pub fn blend(&mut self, newer: &Self, part: f64) {
        let scale = |b: &[f64]| 1.0 / b.iter().sum::<f64>().max(1e-9);
        let (old, new) = (scale(&self.bins), scale(&newer.bins));
        for (b, n) in self.bins.iter_mut().zip(&newer.bins) {
            *b = (1.0 - part) * *b * old + part * n * new;
        }
    }
}

/// Levels a bin.
const WIDTH: usize = 256 / BINS;

/// Counts of grey levels into bins, each level shared between the two whose middles it lies between, so that a slightly brighter
/// light moves little.
fn share_out(levels: &[u32; 256], bins: &mut [f64]) {
    let sum = |levels: &[u32]| f64::from(levels.iter().sum::<u32>());
    let half = WIDTH / 2;
    bins[0] += sum(&levels[..half]);
    bins[BINS - 1] += sum(&levels[256 - half..]);
    for (bin, levels) in levels[half..256 - half].as_chunks::<WIDTH>().0.iter().enumerate() {
        let later: u32 = levels.iter().zip(0..).map(|(n, k)| n * k).sum();
        let later = f64::from(later) / WIDTH as f64;
        bins[bin] += sum(levels) - later;
        bins[bin + 1] += later;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::golden;

    #[test]
    fn the_distance_of_two_histograms_is_the_golden_one() {
        let golden = golden("bhattacharyya");
        let h = |k: &str| -> Vec<f64> {
            golden["inputs"][k].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
        };
        let d = bhattacharyya(&h("h1"), &h("h2"));
        assert!((d - golden["outputs"].as_f64().unwrap()).abs() < 1e-12, "{d}");
        assert_eq!(bhattacharyya(&[1.0, 0.0], &[0.0, 3.0]), 1.0);
    }
}
