//! A panorama in which a step is as easily seen in the dark as in the light.
//!
//! Problem: where to look closely is decided by contrast in grey levels, of which a dark corner has few and a lit wall many. Insight: what a
//! lamp lights by a tenth shows a tenth of the contrast, while the sensor's noise falls much less. Between the share of the light and the
//! grey levels lies the root of the light: what a dark robot shows counts more, and noise does not drown it. Algorithm: a table, and the mean
//! of three columns, which costs upright edges little where they are looked at two columns aside.

/// Grey levels that noise and rounding are worth, and the scale: near grey level 60 a step is as large as it was.
const FLOOR: f64 = 4.0;
const SCALE: f64 = 16.0;

/// A panorama of so many columns, one byte a pixel, row after row, evened.
pub(super) fn evened(panorama: &[u8], width: usize) -> Vec<u8> {
    let table: [u16; 256] =
        std::array::from_fn(|gray| (SCALE * ((gray as f64 + FLOOR).sqrt() - FLOOR.sqrt())).round() as u16);
    let mut out = Vec::with_capacity(panorama.len());
    for row in panorama.chunks_exact(width) {
        let shade = |gray: &u8| table[usize::from(*gray)];
        let [mut before, mut here] = [row.last(), row.first()].map(|gray| gray.map_or(0, shade));
        for next in row.iter().skip(1).chain(row.first()) {
            let next = shade(next);
            out.push(((before + here + next + 1) / 3) as u8);
            (before, here) = (here, next);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tenth_of_the_light_is_more_than_a_tenth_of_the_contrast_and_order_is_kept() {
        let step = |from: u8, to: u8| {
            let panorama: Vec<u8> = (0..24).map(|n| if n % 12 < 6 { from } else { to }).collect();
            let evened = evened(&panorama, 12);
            assert_eq!(evened[..12], evened[12..]);
            f64::from(evened[8]) - f64::from(evened[3])
        };
        assert!(step(8, 12) > 0.25 * step(80, 120));
        assert!((step(55, 65) - 10.0).abs() <= 1.0);
        assert!((0..255).all(|gray| step(gray, gray + 1) >= 0.0) && step(0, 255) > 200.0);
    }
}
