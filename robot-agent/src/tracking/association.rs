//! Which object is which track: optimal assignment (`MATHS.md` §7.10, golden group `association`).
//!
//! cost = (Δx/σ_x)² + (Δy/σ_y)² + (ln area ratio/0.35)² + (ln aspect ratio/0.25)², gated at χ²₄(99 %). The Hungarian method
//! finds the set of pairs with the least total, where every track may also stay alone at the price of the gate: greedy
//! choices swap people who cross.

use pathfinding::matrix::Matrix;
use pathfinding::prelude::kuhn_munkres;

use crate::motion::Raster;

/// χ² with 4 degrees of freedom, 99 %.
pub const GATE: f64 = 13.2767041359876;
/// Most tracks and objects that are assigned at once.
pub const MAX_SIDE: usize = 128;

/// A box in the picture: centre column and row, width and height, pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shape {
    /// Centre column; may run over the seam.
    pub x: f64,
    /// Centre row.
    pub y: f64,
    /// Columns.
    pub w: f64,
    /// Rows.
    pub h: f64,
}

/// One standard deviation of each difference.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShapeSigmas {
    /// Columns.
    pub x: f64,
    /// Rows.
    pub y: f64,
    /// Logarithm of the area.
    pub log_area: f64,
    /// Logarithm of the aspect ratio.
    pub log_aspect: f64,
}

impl Default for ShapeSigmas {
    /// The report's proposals for a panorama of 1080 columns.
    fn default() -> Self {
        Self { x: 12.0, y: 6.0, log_area: 0.35, log_aspect: 0.25 }
    }
}

/// How badly an object fits a prediction; 0 is perfect.
pub fn cost(predicted: &Shape, found: &Shape, sigmas: &ShapeSigmas, raster: &Raster) -> f64 {
    let dx = raster.column_difference(found.x, predicted.x) / sigmas.x;
    let dy = (found.y - predicted.y) / sigmas.y;
    let area = (found.w * found.h / (predicted.w * predicted.h)).ln() / sigmas.log_area;
    let aspect = ((found.w / found.h) / (predicted.w / predicted.h)).ln() / sigmas.log_aspect;
    dx * dx + dy * dy + area * area + aspect * aspect
}

/// For each row of `costs` (tracks) the column (object) assigned to it; no pair costs `gate` or more. Non-finite costs never
/// pair. Only the first `MAX_SIDE` rows and columns take part.
pub fn assign(costs: &[Vec<f64>], gate: f64) -> Vec<Option<usize>> {
    let rows = costs.len().min(MAX_SIDE);
    let columns = costs.first().map_or(0, Vec::len).min(MAX_SIDE);
    let mut result = vec![None; costs.len()];
    if rows == 0 || columns == 0 {
        return result;
    }
    // Fixed point: the method wants an exact order. Each row has its own column for staying alone, worth nothing.
    const SCALE: f64 = 1e6;
    let weights = Matrix::from_fn(rows, columns + rows, |(r, c)| {
        let gain = if c < columns { gate - costs[r][c] } else { 0.0 };
        if gain > 0.0 || c >= columns { (gain * SCALE) as i64 } else { -1 }
    });
    let (_, chosen) = kuhn_munkres(&weights);
    for (r, c) in chosen.into_iter().enumerate() {
        if c < columns && weights[(r, c)] > 0 {
            result[r] = Some(c);
        }
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::golden;

    #[test]
    fn costs_and_assignment_are_the_golden_ones() {
        let golden = golden("association");
        let shapes = |k: &str| -> Vec<Shape> {
            let rows = golden["inputs"][k].as_array().unwrap();
            rows.iter()
                .map(|r| {
                    let v = |i: usize| r[i].as_f64().unwrap();
                    Shape { x: v(0), y: v(1), w: v(2), h: v(3) }
                })
                .collect()
        };
        let raster = Raster { width: 1080, height: 162, wraps: true };
        let (tracks, found) = (shapes("tracks"), shapes("obs"));
        let costs: Vec<Vec<f64>> = tracks
            .iter()
            .map(|t| found.iter().map(|o| cost(t, o, &ShapeSigmas::default(), &raster)).collect())
            .collect();
        for (row, want) in costs.iter().zip(golden["outputs"]["cost"].as_array().unwrap()) {
            for (a, b) in row.iter().zip(want.as_array().unwrap()) {
                let b = b.as_f64().unwrap();
                assert!((a - b).abs() <= 1e-11 * b, "{a} {b}");
            }
        }
        assert_eq!(assign(&costs, GATE), [Some(1), Some(0)]);
        assert!((GATE - golden["outputs"]["gate"].as_f64().unwrap()).abs() < 1e-10);
    }

    #[test]
    fn the_total_is_least_and_gated_pairs_stay_alone() {
        // Greedy would take (0, 0) for 1 and leave track 1 with 12.
        assert_eq!(assign(&[vec![1.0, 2.0], vec![2.0, 12.0]], GATE), [Some(1), Some(0)]);
        assert_eq!(assign(&[vec![20.0], vec![f64::NAN]], GATE), [None, None]);
        assert_eq!(assign(&[vec![3.0], vec![1.0], vec![2.0]], GATE), [None, Some(0), None]);
    }
}
