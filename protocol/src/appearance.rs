//! What somebody looks like: grey level and its spread in bands of height over the floor. Sixteen bytes on the wire.
//!
//! Trousers, shirt, face and hair lie at the same height whatever the distance and whoever looks, so the descriptors of two
//! robots can be compared. Light falls differently on each side of a body and in each corner of a room, so levels are
//! compared as ratios, with heavy tails, and neighbouring bands (one piece of cloth) count in part only.

/// Bands.
pub const BANDS: usize = 8;
/// Height of a band, metres; the first begins at the floor.
pub const BAND_M: f64 = 0.25;

/// Standard deviations of the difference of two sights of one body, and of two bodies: logarithm of the level, and spread.
const SAME: [f64; 2] = [0.25, 0.15];
const ANYBODY: [f64; 2] = [0.7, 0.3];
/// What a band counts beside its neighbours.
const BAND_WORTH: f64 = 0.5;
/// Degrees of freedom of Student's t.
const NU: f64 = 4.0;
/// Steps of the spread's byte to one.
const SPREAD_STEPS: f64 = 100.0;

/// One band.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Band {
    /// Natural logarithm of the mean grey level (1 … 255).
    pub log_level: f64,
    /// Standard deviation of the level over its mean, 0 … 2.55.
    pub spread: f64,
}

impl Band {
    /// Of the mean and the standard deviation of grey levels, 0 … 255.
    pub fn of(mean: f64, sigma: f64) -> Self {
        let mean = mean.clamp(1.0, 255.0);
        Self { log_level: mean.ln(), spread: (sigma / mean).clamp(0.0, 2.55) }
    }
}

/// The bands from the floor up; `None` where nothing was seen.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Appearance(pub [Option<Band>; BANDS]);

impl Appearance {
    /// For the wire: levels (0: not seen), then spreads.
    pub fn to_bytes(&self) -> [u8; 2 * BANDS] {
        std::array::from_fn(|i| match (self.0[i % BANDS], i < BANDS) {
            (Some(band), true) => band.log_level.exp().round().clamp(1.0, 255.0) as u8,
            (Some(band), false) => (band.spread * SPREAD_STEPS).round().clamp(0.0, 255.0) as u8,
            (None, _) => 0,
        })
    }

    /// From the wire; all bytes mean something.
    pub fn from_bytes(bytes: &[u8; 2 * BANDS]) -> Self {
        Self(std::array::from_fn(|i| {
            let (level, spread) = (bytes[i], bytes[i + BANDS]);
            (level > 0).then(|| Band { log_level: f64::from(level).ln(), spread: f64::from(spread) / SPREAD_STEPS })
        }))
    }

    /// How much speaks for the same body, nats against another's; 0 where no band is seen in both.
    pub fn log_ratio(&self, other: &Self) -> f64 {
        let bands = self.0.iter().zip(&other.0).filter_map(|(a, b)| Some((a.as_ref()?, b.as_ref()?)));
        let nats = bands.map(|(a, b)| {
            log_ratio(a.log_level - b.log_level, SAME[0], ANYBODY[0])
                + log_ratio(a.spread - b.spread, SAME[1], ANYBODY[1])
        });
        BAND_WORTH * nats.sum::<f64>()
    }

    /// Moves `part` of the way (0 … 1) towards a newer sight; what was not seen before is taken over.
    pub fn follow(&mut self, newer: &Self, part: f64) {
        for (old, new) in self.0.iter_mut().zip(&newer.0) {
            match (old.as_mut(), new) {
                (Some(old), Some(new)) => {
                    old.log_level += part * (new.log_level - old.log_level);
                    old.spread += part * (new.spread - old.spread);
                }
                (None, Some(new)) => *old = Some(*new),
                (_, None) => {}
            }
        }
    }

    /// Bands that are seen.
    pub fn seen(&self) -> usize {
        self.0.iter().flatten().count()
    }
}

/// ln of Student's t with scale `same` over that with scale `any`.
fn log_ratio(x: f64, same: f64, any: f64) -> f64 {
    let log_t = |s: f64| -s.ln() - 0.5 * (NU + 1.0) * (1.0 + (x / s).powi(2) / NU).ln();
    log_t(same) - log_t(any)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(levels: [f64; BANDS]) -> Appearance {
        Appearance(levels.map(|l| (l > 0.0).then(|| Band::of(l, 0.3 * l))))
    }

    #[test]
    fn the_same_clothes_in_other_light_are_more_alike_than_other_clothes() {
        let one = of([30.0, 30.0, 32.0, 90.0, 120.0, 118.0, 70.0, 0.0]);
        let brighter = of([36.0, 37.0, 39.0, 110.0, 144.0, 140.0, 85.0, 60.0]);
        let other = of([75.0, 75.0, 77.0, 60.0, 52.0, 50.0, 70.0, 60.0]);
        let (alike, unlike) = (one.log_ratio(&brighter), one.log_ratio(&other));
        assert!(alike > 2.0 && unlike < -1.0, "{alike} {unlike}");
        assert_eq!(one.log_ratio(&other), other.log_ratio(&one));
        assert_eq!(one.log_ratio(&Appearance::default()), 0.0);
    }

    #[test]
    fn the_wire_keeps_it_to_half_a_step_and_any_bytes_are_something() {
        let one = of([30.4, 0.0, 32.0, 90.0, 254.7, 118.0, 70.0, 1.0]);
        let back = Appearance::from_bytes(&one.to_bytes());
        for (a, b) in one.0.iter().zip(&back.0) {
            assert_eq!(a.is_some(), b.is_some());
            if let (Some(a), Some(b)) = (a, b) {
                assert!((a.log_level.exp() - b.log_level.exp()).abs() <= 0.5 && (a.spread - b.spread).abs() <= 0.005);
            }
        }
        for byte in [0, 1, 127, 255] {
            assert!(Appearance::from_bytes(&[byte; 16]).log_ratio(&one).is_finite());
        }
    }
}
