//! Root mean squares and percentiles.

/// Root of the mean of squares.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Rms {
    sum: f64,
    count: usize,
}

impl Rms {
    /// Takes the square of an error in.
    pub fn add_square(&mut self, square: f64) {
        self.sum += square;
        self.count += 1;
    }

    /// The root; `None` of nothing.
    pub fn value(&self) -> Option<f64> {
        (self.count > 0).then(|| (self.sum / self.count as f64).sqrt())
    }
}

impl std::ops::AddAssign for Rms {
    fn add_assign(&mut self, other: Self) {
        self.sum += other.sum;
        self.count += other.count;
    }
}

/// The mean; `None` of nothing.
pub fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// The smallest value that at least `share` (0 … 1) of all values do not exceed (nearest rank).
pub fn percentile(values: &[f64], share: f64) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let rank = (share * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.clamp(1, sorted.len().max(1)) - 1).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_rank_is_a_value_that_occurred() {
        let values: Vec<f64> = (1..=200).rev().map(f64::from).collect();
        assert_eq!(percentile(&values, 0.5), Some(100.0));
        assert_eq!(percentile(&values, 0.99), Some(198.0));
        assert_eq!(percentile(&[7.0], 0.99), Some(7.0));
        assert_eq!(percentile(&[], 0.5), None);
    }

    #[test]
    fn the_root_mean_square_of_three_and_four_is_that_of_twelve_and_a_half() {
        let mut rms = Rms::default();
        rms.add_square(9.0);
        rms.add_square(16.0);
        assert!((rms.value().unwrap() - 12.5_f64.sqrt()).abs() < 1e-12);
    }
}
