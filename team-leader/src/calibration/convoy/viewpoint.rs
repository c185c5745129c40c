//! Errors of sightings that stay for as long as two robots see each other from the same side, and change as the view changes.
//!
//! Problem: a detector measures the same again when it sees the same again. Of the readings of five driving robots (MRCLAM) four
//! fifths of a range's variance and half of a bearing's come back a second later, and are gone only when range or bearing is
//! another. A filter that takes them for white counts one reading many times and becomes certain of something wrong.
//!
//! ```text
//!  z = h(x) + e + v    var v = (1 − s) σ²    var e = s σ²    e ← ρ e + √(1 − ρ²) √s σ w    ρ = ρ₀ exp(−½ (Δβ/L_β)² − ½ (Δln r/L_r)²)
//! ```

use protocol::angle::wrap;

/// Share s of a sighting's variance that stays with the view.
pub const LASTING_SHARE: f64 = 0.8;
/// How far a bearing, rad, and (the logarithm of) a range may change until the view is another: L_β, L_r.
const BEARING_RAD: f64 = 0.1;
const LOG_RANGE: f64 = 0.2;
/// Of the same view, ρ₀: light and attitude are never quite the same.
const SAME: f64 = 0.98;

/// How one robot sees another at present; its error is two rows of the joint state.
#[derive(Debug, Clone, Copy)]
pub struct View {
    /// Who sees.
    pub observer: usize,
    /// Whom.
    pub peer: usize,
    /// Estimate of e: rad, m.
    pub error: [f64; 2],
    /// Readings when it was used last: rad, m.
    bearing_rad: f64,
    range_m: Option<f64>,
    /// Its turn, of all updates.
    pub used: u64,
}

impl View {
    /// A view that was not there.
    pub fn new(observer: usize, peer: usize, bearing_rad: f64, range_m: Option<f64>, used: u64) -> Self {
        Self { observer, peer, error: [0.0; 2], bearing_rad, range_m, used }
    }

    /// Takes the next reading; the correlation ρ of its error with that of the one before.
    pub fn turn_to(&mut self, bearing_rad: f64, range_m: Option<f64>, used: u64) -> f64 {
        let turned = wrap(bearing_rad - self.bearing_rad) / BEARING_RAD;
        let nearer = match (self.range_m, range_m) {
            (Some(before), Some(now)) if before > 0.0 && now > 0.0 => (now / before).ln() / LOG_RANGE,
            _ => 0.0,
        };
        let rho = SAME * (-0.5 * (turned * turned + nearer * nearer)).exp();
        (self.bearing_rad, self.range_m, self.used) = (bearing_rad, range_m.or(self.range_m), used);
        self.error = self.error.map(|e| rho * e);
        rho
    }
}
