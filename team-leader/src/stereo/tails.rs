//! Bearings of bodies have heavy tails (an arm, a shadow, half a body), so residuals follow Student's t, not a Gaussian: one far off
//! is not much less likely than one less far off, and never moves a target far ([`stretch`]).

/// Degrees of freedom of Student's t.
const NU: f64 = 4.0;
/// ln Γ((ν + 1) / 2) − ln Γ(ν / 2) − ln √(νπ) at ν = 4.
const LOG_STUDENT: f64 = -0.980_829_253_011_726;

/// Log-density of a residual of squared distance `d2` and variance `var`.
pub fn log_student(d2: f64, var: f64) -> f64 {
    LOG_STUDENT - 0.5 * var.ln() - 0.5 * (NU + 1.0) * (1.0 + d2 / NU).ln()
}

/// By how much the variance of a measurement at squared distance `d2` grows, so that far ones move little.
pub fn stretch(d2: f64) -> f64 {
    ((NU + d2) / (NU + 1.0)).max(1.0)
}
