//! Whether numbers are distributed as they should be.

use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Two-sided bounds of the mean of `samples` values of χ² with `dof` degrees of freedom, divided by `dof`, at level `alpha`.
pub fn mean_bounds(dof: usize, samples: usize, alpha: f64) -> [f64; 2] {
    let n = (dof * samples) as f64;
    ChiSquared::new(n).map_or([0.0, f64::INFINITY], |d| [0.5 * alpha, 1.0 - 0.5 * alpha].map(|p| d.inverse_cdf(p) / n))
}

/// The p-value of Kolmogorov's test that `values` are of χ² with `dof` degrees of freedom.
pub fn kolmogorov_chi2(values: &[f64], dof: usize) -> f64 {
    let Ok(distribution) = ChiSquared::new(dof as f64) else { return 1.0 };
    let mut p: Vec<f64> = values.iter().map(|v| distribution.cdf(*v)).collect();
    p.sort_by(f64::total_cmp);
    let n = p.len() as f64;
    let above = |(k, p): (usize, &f64)| ((k as f64 + 1.0) / n - p).max(p - k as f64 / n);
    let d = p.iter().enumerate().map(above).fold(0.0, f64::max);
    // Stephens' correction, and Kolmogorov's series.
    let t = d * (n.sqrt() + 0.12 + 0.11 / n.sqrt());
    let series = (1..=100).map(|k| {
        let sign = if k % 2 == 1 { 2.0 } else { -2.0 };
        sign * (-2.0 * f64::from(k * k) * t * t).exp()
    });
    if t < 0.2 { 1.0 } else { series.sum::<f64>().clamp(0.0, 1.0) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kolmogorovs_p_is_that_of_the_tables() {
        // Evenly spread quantiles shifted by D: at n = 100 the 1 % point of D is 0.1608 (Smirnov's table).
        let even = |shift: f64| -> Vec<f64> {
            let distribution = ChiSquared::new(2.0).unwrap();
            let p = (0..100).map(|k| ((f64::from(k) + 0.5) / 100.0 + shift).clamp(0.0, 1.0 - 1e-12));
            p.map(|p| distribution.inverse_cdf(p)).collect()
        };
        assert!(kolmogorov_chi2(&even(0.0), 2) > 0.999);
        let p = kolmogorov_chi2(&even(0.1608 - 0.005), 2);
        assert!((0.008..0.012).contains(&p), "{p}");
    }

    #[test]
    fn bounds_of_a_mean_shrink_with_the_samples() {
        let [low, high] = mean_bounds(3, 5000, 0.01);
        // Mean 1, sigma √(2/15000) = 0.01155, ± 2.576 sigmas.
        assert!((low - 0.9705).abs() < 1e-3 && (high - 1.0299).abs() < 1e-3, "{low} {high}");
    }
}
