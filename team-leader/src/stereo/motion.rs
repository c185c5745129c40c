//! How place and velocity of what moves go on along one axis: velocities forget (people turn, robots stop), driven by white acceleration.

/// A step in time.
#[derive(Debug, Clone, Copy)]
pub struct Step {
    dt_s: f64,
    /// How far one metre a second leads, metres.
    pub reach_s: f64,
    /// The part of the velocity that is left.
    pub keep_velocity: f64,
}

impl Step {
    /// So many seconds, of velocities that last so long.
    pub fn over(dt_s: f64, velocity_lasts_s: f64) -> Self {
        let keep_velocity = (-dt_s / velocity_lasts_s).exp();
        Self { dt_s, reach_s: velocity_lasts_s * (1.0 - keep_velocity), keep_velocity }
    }

    /// By what the variance of the place (m²), its covariance with the velocity (m²/s) and the velocity's variance (m²/s²) grow with
    /// acceleration of this power, m²/s³.
    pub fn grows(&self, acceleration_m2ps3: f64) -> [f64; 3] {
        let (q, dt_s) = (acceleration_m2ps3, self.dt_s);
        [q * dt_s.powi(3) / 3.0, q * dt_s * dt_s / 2.0, q * dt_s]
    }
}
