//! Who is who between truths and estimates at one instant.
//!
//! Optimal assignment with a gate: a pair at distance d < gate gains gate² − d², leaving both alone gains nothing; the
//! assignment of the largest gain is the one of GOSPA with p = 2, α = 2 and c = gate (Rahmathullah et al., FUSION 2017), and
//! never takes a pair outside the gate. Hungarian method, O(n³).

use pathfinding::kuhn_munkres::kuhn_munkres;
use pathfinding::matrix::Matrix;

/// Gains are compared as whole square micrometres: the Hungarian method wants numbers with a total order.
const PER_SQUARE_METRE: f64 = 1e12;

/// The column matched to each row. `distances_m[row][column]`, all rows of one length; not finite means impossible.
pub fn assign(distances_m: &[Vec<f64>], gate_m: f64) -> Vec<Option<usize>> {
    let columns = distances_m.first().map_or(0, Vec::len);
    if columns == 0 {
        return vec![None; distances_m.len()];
    }
    // One column of gain 0 for each row lets it stay alone.
    let width = columns + distances_m.len();
    let gain = |row: usize, column: usize| {
        let distance = distances_m[row].get(column).copied().unwrap_or(gate_m);
        let gain = gate_m * gate_m - distance * distance;
        if gain > 0.0 { (gain * PER_SQUARE_METRE) as i64 } else { 0 }
    };
    let gains = Matrix::from_fn(distances_m.len(), width, |(row, column)| gain(row, column));
    let (_, matched) = kuhn_munkres(&gains);
    matched.iter().enumerate().map(|(row, &column)| (gain(row, column) > 0).then_some(column)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sum_decides_not_the_nearest_pair() {
        // Nearest first would take (0, 0) at 0.1 and leave (1, 1) out at 0.9.
        let matched = assign(&[vec![0.1, 0.2], vec![0.2, 0.9]], 0.5);
        assert_eq!(matched, [Some(1), Some(0)]);
    }

    #[test]
    fn a_pair_outside_the_gate_is_never_matched() {
        assert_eq!(assign(&[vec![0.51], vec![0.3]], 0.5), [None, Some(0)]);
        assert_eq!(assign(&[vec![f64::NAN, f64::INFINITY]], 0.5), [None]);
    }

    #[test]
    fn more_rows_than_columns_and_none_at_all_are_fine() {
        assert_eq!(assign(&[vec![0.4], vec![0.3], vec![0.2]], 0.5), [None, None, Some(0)]);
        assert_eq!(assign(&[vec![], vec![]], 0.5), [None, None]);
        assert_eq!(assign(&[], 0.5), []);
    }
}
