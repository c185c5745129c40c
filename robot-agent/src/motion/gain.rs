//! The light's common factor: automatic exposure, a cloud, a lamp that flickers change the whole picture by one ratio.
//!
//! The median of C/B over a sparse sample is that ratio as long as objects cover less than half of the picture; dividing
//! it out keeps a camera that re-exposes for a passing truck from seeing objects everywhere.

/// Largest correction, as a factor up or down; what is beyond is an event, not exposure.
const LIMIT: f64 = 1.3;
/// Sampled pixels: every so many, coprime to usual widths.
const STRIDE: usize = 61;
/// Darker pixels carry no ratio.
const MIN_LEVEL: u16 = 24 << 8;

/// Median of picture / background; 1 where nothing can be said. Levels are 8.8 fixed point; `valid` is 0 or 1.
pub(super) fn common_gain(picture: &[u8], background: &[u16], valid: &[u8], ratios: &mut Vec<f32>) -> f64 {
    ratios.clear();
    let samples = picture.iter().zip(background).zip(valid).step_by(STRIDE);
    ratios.extend(
        samples
            .filter(|((c, b), v)| **v != 0 && **b >= MIN_LEVEL && **c < 250)
            .map(|((c, b), _)| f32::from(*c) * 256.0 / f32::from(*b)),
    );
    if ratios.len() < 50 {
        return 1.0;
    }
    let middle = ratios.len() / 2;
    let (_, median, _) = ratios.select_nth_unstable_by(middle, f32::total_cmp);
    let gain = f64::from(*median);
    if (1.0 / LIMIT..=LIMIT).contains(&gain) { gain } else { 1.0 }
}

/// Factor that brings a picture back to the background's exposure, as [`super::kernel::expose`] takes it (Q15).
pub(super) fn inverse_q15(gain: f64) -> u16 {
    (32768.0 / gain).round().clamp(1.0, 65535.0) as u16
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gain_is_found_beside_objects_that_cover_a_third() {
        let background: Vec<u16> = (0..30_000u32).map(|i| ((60 + i % 120) << 8) as u16).collect();
        let picture: Vec<u8> = background
            .iter()
            .enumerate()
            .map(|(i, b)| if i < 10_000 { 200 } else { (f64::from(b >> 8) * 1.1).round() as u8 })
            .collect();
        let gain = common_gain(&picture, &background, &vec![1; 30_000], &mut Vec::new());
        assert!((gain - 1.1).abs() < 0.02, "{gain}");
    }
}
