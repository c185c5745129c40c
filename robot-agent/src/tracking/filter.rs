//! The axis of one track over time: a Kalman filter with constant velocity, on a ring of columns where the picture is one.
//!
//! State (column, rate). People accelerate by a metre or two a second², which in the picture depends on their distance;
//! their breadth stands for it (half a metre of shoulders), so the process noise is given in columns by the caller.

use crate::motion::Raster;

/// Column of the axis and its rate, with covariance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxisFilter {
    /// Columns; in [0, width) on a ring.
    pub column: f64,
    /// Columns a second.
    pub rate: f64,
    /// Covariance: (column, column), (column, rate), (rate, rate).
    pub p: [f64; 3],
}

impl AxisFilter {
    /// Seen once; `rate_sigma` (columns a second) is how fast things move.
    pub fn new(column: f64, sigma: f64, rate_sigma: f64) -> Self {
        Self { column, rate: 0.0, p: [sigma * sigma, 0.0, rate_sigma * rate_sigma] }
    }

    /// `dt_s` later; white acceleration of `acceleration` columns/s² (one standard deviation over one second).
    pub fn predict(&mut self, dt_s: f64, acceleration: f64, raster: &Raster) {
        let q = acceleration * acceleration;
        self.column = raster.wrap_column(self.column + self.rate * dt_s);
        let [cc, cr, rr] = self.p;
        self.p = [
            cc + 2.0 * dt_s * cr + dt_s * dt_s * rr + q * dt_s.powi(3) / 3.0,
            cr + dt_s * rr + q * dt_s * dt_s / 2.0,
            rr + q * dt_s,
        ];
    }

    /// A measurement with its standard deviation, columns.
    pub fn update(&mut self, column: f64, sigma: f64, raster: &Raster) {
        let innovation = raster.column_difference(column, self.column);
        let [cc, cr, rr] = self.p;
        let s = cc + sigma * sigma;
        let (kc, kr) = (cc / s, cr / s);
        self.column = raster.wrap_column(self.column + kc * innovation);
        self.rate += kr * innovation;
        self.p = [(1.0 - kc) * cc, (1.0 - kc) * cr, rr - kr * cr];
    }

    /// One standard deviation of the column.
    pub fn sigma(&self) -> f64 {
        self.p[0].max(0.0).sqrt()
    }

    /// One standard deviation of the rate.
    pub fn rate_sigma(&self) -> f64 {
        self.p[2].max(0.0).sqrt()
    }

    /// While nobody is seen rates die out, so that a prediction does not run away round the ring.
    pub fn damp(&mut self, factor: f64) {
        self.rate *= factor;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_track_follows_over_the_seam() {
        let raster = Raster { width: 1000, height: 10, wraps: true };
        let mut filter = AxisFilter::new(950.0, 1.0, 100.0);
        for i in 1..=20 {
            filter.predict(0.1, 5.0, &raster);
            filter.update(raster.wrap_column(950.0 + 5.0 * f64::from(i)), 1.0, &raster);
        }
        assert!(raster.column_difference(filter.column, 50.0).abs() < 0.5, "{filter:?}");
        assert!((filter.rate - 50.0).abs() < 3.0);
        assert!(filter.sigma() < 1.0);
    }
}
