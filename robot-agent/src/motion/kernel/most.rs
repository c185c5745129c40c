//! What pixels show most of the time.

use super::wide;

/// Most frames that are compared: one register of bytes.
pub const MOST_FRAMES: usize = 32;
/// Pixels looked at together.
const BLOCK: usize = 64;
/// Grey levels that are one look: a pixel's noise (mean deviation, 8.8 fixed point) shifted by so many bits: four of it.
const NOISE_SHIFT: u32 = 6;
/// At least and at most so many.
pub const ALIKE: [u8; 2] = [6, 12];

wide! {
/// Pixels that show another look in more of the frames than the one in `level` (8.8 fixed point): each with the mean of that look,
/// in the same units, and in how many frames it is shown. Levels are one look within about four mean deviations
/// (`noise`), but at least 6 and at most 12 grey levels. At most [`MOST_FRAMES`] frames, all as long as `level`.
pub fn more_often_seen(frames: &[&[u8]], level: &[u16], noise: &[u16], found: &mut Vec<(usize, u16, u8)>) {
    let n = frames.len().min(MOST_FRAMES);
    let frames = &frames[..n];
    let mut there = [0u8; MOST_FRAMES];
    there[..n].fill(1);
    for first in (0..level.len()).step_by(BLOCK) {
        let len = BLOCK.min(level.len() - first);
        let (mut levels, mut alike, mut own) = ([0u8; BLOCK], [0u8; BLOCK], [0u8; BLOCK]);
        for k in 0..len {
            levels[k] = (level[first + k] >> 8) as u8;
            alike[k] = ((noise[first + k] >> NOISE_SHIFT).min(u16::from(u8::MAX)) as u8).clamp(ALIKE[0], ALIKE[1]);
        }
        for frame in frames {
            let mut shown = [0u8; BLOCK];
            shown[..len].copy_from_slice(&frame[first..first + len]);
            for k in 0..BLOCK {
                own[k] += u8::from(shown[k].abs_diff(levels[k]) <= alike[k]);
            }
        }
        for k in 0..len {
            // No other look can be in more frames than are left.
            if 2 * usize::from(own[k]) >= n {
                continue;
            }
            let mut shown = [0u8; MOST_FRAMES];
            for (s, frame) in shown.iter_mut().zip(frames) {
                *s = frame[first + k];
            }
            let (mut most, mut look) = (own[k], None);
            for v in &shown[..n] {
                let mut like = 0u8;
                for (s, there) in shown.iter().zip(&there) {
                    like += *there & u8::from(s.abs_diff(*v) <= alike[k]);
                }
                if like > most {
                    (most, look) = (like, Some(*v));
                }
            }
            if let Some(look) = look {
                let ours = shown[..n].iter().filter(|s| s.abs_diff(look) <= alike[k]);
                let sum: u32 = ours.map(|s| u32::from(*s)).sum();
                found.push((first + k, ((sum << 8) / u32::from(most)) as u16, most));
            }
        }
    }
}
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::kernel::{Level, at_most};

    #[test]
    fn what_a_pixel_shows_most_of_the_time_is_found_on_all_processors() {
        // Pixel i shows somebody (dark, another level in each frame) in its first i % 8 of eleven frames, then the wall.
        let (n, pixels) = (11, 150);
        let wall = |i: usize| 100 + (i % 50) as u8;
        let shown = |f: usize, i: usize| if f < i % 8 { (13 * f) as u8 } else { wall(i) + (f % 3) as u8 };
        let frames: Vec<Vec<u8>> = (0..n).map(|f| (0..pixels).map(|i| shown(f, i)).collect()).collect();
        let frames: Vec<&[u8]> = frames.iter().map(Vec::as_slice).collect();
        // The background has somebody's first level everywhere.
        let (level, noise) = (vec![0u16; pixels], vec![300u16; pixels]);
        let find = || {
            let mut found = Vec::new();
            more_often_seen(&frames, &level, &noise, &mut found);
            found
        };
        let found = find();
        assert_eq!(found.iter().map(|(i, ..)| *i).collect::<Vec<_>>(), (0..pixels).collect::<Vec<_>>());
        for (i, look, frames) in &found {
            assert_eq!(usize::from(*frames), n - i % 8);
            assert!((f64::from(*look) / 256.0 - f64::from(wall(*i) + 1)).abs() < 1.0, "{i}: {look}");
        }
        // The wall is where it should be: nothing is seen more often.
        let right: Vec<u16> = (0..pixels).map(|i| u16::from(wall(i) + 1) << 8).collect();
        let mut none = Vec::new();
        more_often_seen(&frames, &right, &noise, &mut none);
        assert!(none.is_empty(), "{none:?}");
        for most in [Level::Portable, Level::Avx2] {
            assert_eq!(at_most(most, find), found, "{most:?}");
        }
    }
}
