//! Median, 99th percentile and worst of the latencies of one period.

/// Most samples of one period; later ones replace the oldest.
const MAX_SAMPLES: usize = 4096;

/// Collects latencies between two reports.
#[derive(Debug, Clone, Default)]
pub struct Latencies {
    samples_ms: Vec<f32>,
    next: usize,
}

impl Latencies {
    /// Adds one, in seconds.
    pub fn push(&mut self, seconds: f64) {
        let ms = (seconds * 1e3) as f32;
        if self.samples_ms.len() < MAX_SAMPLES {
            self.samples_ms.push(ms);
        } else {
            self.samples_ms[self.next] = ms;
            self.next = (self.next + 1) % MAX_SAMPLES;
        }
    }

    /// Median, 99th percentile and worst in milliseconds (nearest rank; 0 without samples); forgets the samples.
    pub fn report(&mut self) -> [f32; 3] {
        self.samples_ms.sort_by(f32::total_cmp);
        let n = self.samples_ms.len();
        let rank = |p: f64| self.samples_ms.get(((p * n as f64).ceil() as usize).max(1) - 1).copied().unwrap_or(0.0);
        let report = [rank(0.5), rank(0.99), rank(1.0)];
        self.samples_ms.clear();
        self.next = 0;
        report
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_report_is_the_nearest_rank_and_begins_anew() {
        let mut latencies = Latencies::default();
        for ms in (1..=100).rev() {
            latencies.push(f64::from(ms) * 1e-3);
        }
        assert_eq!(latencies.report(), [50.0, 99.0, 100.0]);
        assert_eq!(latencies.report(), [0.0; 3]);
    }
}
