//! What differs from the background, and from the frame before.

use super::{expose, tolerance, wide};

/// The noise estimate saturates here (8.8 fixed point: 11.7 grey levels of mean deviation, leaves in the wind), so that thresholds stay in 16 bits.
pub const NOISE_MAX: u16 = 3000;
/// The same indoors: 6.6 grey levels.
pub const INDOOR_NOISE_MAX: u16 = 1700;

wide! {
/// Marks pixels that differ from the background: `faint` where |C − B| ≥ max(`floor_faint`, 1.6 σ), `strong` where
/// |C − B| ≥ max(`floor_strong`, 4 σ) (`MATHS.md` §7.4), C brought to the background's exposure by `exposure_q15` / 32768.
/// Background, noise (mean absolute deviation, σ = 1.25 noise) and floors are 8.8 fixed point; `magnitude` is |C − B| in whole
/// grey levels; 1 marks, 0 does not.
#[allow(clippy::too_many_arguments)]
pub fn mark_changes(
    current: &[u8],
    exposure_q15: u16,
    background: &[u16],
    noise: &[u16],
    floor_faint: u16,
    floor_strong: u16,
    magnitude: &mut [u8],
    faint: &mut [u8],
    strong: &mut [u8],
) {
    let n = current.len();
    let (background, noise) = (&background[..n], &noise[..n]);
    let (magnitude, faint, strong) = (&mut magnitude[..n], &mut faint[..n], &mut strong[..n]);
    for i in 0..n {
        let difference = expose(current[i], exposure_q15).abs_diff(background[i]);
        let deviation = noise[i];
        magnitude[i] = (difference >> 8) as u8;
        faint[i] = u8::from(difference >= (deviation * 2).max(floor_faint));
        strong[i] = u8::from(difference >= (deviation * 5).max(floor_strong));
    }
}
}

wide! {
/// Takes away all marks where `valid` is 0 (else 1).
pub fn keep_valid(valid: &[u8], faint: &mut [u8], strong: &mut [u8]) {
    for ((f, s), v) in faint.iter_mut().zip(strong).zip(valid) {
        *f &= v;
        *s &= v;
    }
}
}

/// The second look of a pixel, see `background`: what is seen there besides the background, how many frames each
/// of the two was seen, and whether the second was the background before.
#[derive(Debug, Clone, Copy)]
pub struct Layers<'a> {
    /// Level of the second look, 8.8 fixed point.
    pub second: &'a [u16],
    /// 1 where the second look was the background once.
    pub second_is_known: &'a [u8],
}

wide! {
/// Takes away marks where the picture shows what was the background before.
pub fn forgive_known(
    current: &[u8],
    exposure_q15: u16,
    noise: &[u16],
    layers: Layers<'_>,
    faint: &mut [u8],
    strong: &mut [u8],
) {
    const BLOCK: usize = 64;
    const FEW: u8 = 6;
    for start in (0..current.len()).step_by(BLOCK) {
        let block = start..(start + BLOCK).min(current.len());
        let known = &layers.second_is_known[block.clone()];
        // A few marks among known pixels are noise.
        let marked = known.iter().zip(&faint[block.clone()]).fold(0u8, |n, (k, f)| n.wrapping_add(k & f));
        if marked < FEW {
            continue;
        }
        let (current, noise) = (&current[block.clone()], &noise[block.clone()]);
        let second = &layers.second[block.clone()];
        let (faint, strong) = (&mut faint[block.clone()], &mut strong[block]);
        for i in 0..current.len() {
            let same = expose(current[i], exposure_q15).abs_diff(second[i]) < tolerance(noise[i]);
            let keep = !(u8::from(same) & known[i]) & 1;
            faint[i] &= keep;
            strong[i] &= keep;
        }
    }
}
}

wide! {
/// How many pixels of two pictures differ by `threshold` or more (6-1).
pub fn count_differences(a: &[u8], b: &[u8], threshold: u8) -> usize {
    a.chunks(255)
        .zip(b.chunks(255))
        .map(|(a, b)| {
            let count = a.iter().zip(b).fold(0u8, |s, (&a, &b)| s.wrapping_add(u8::from(a.abs_diff(b) >= threshold)));
            usize::from(count)
        })
        .sum()
}
}
