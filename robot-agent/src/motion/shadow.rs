//! Shadows on walls and floor: they make a surface darker but leave its texture.
//!
//! In small blocks the marked pixels are fitted by C ≈ r · B. A shadow gives a ratio somewhat below one and leaves only the
//! camera's noise; clothes have a texture of their own, or are much darker, or brighter. A block is a shadow only among
//! others, so a smooth patch of a coat stays.

use super::raster::Raster;

const BLOCK: [usize; 2] = [4, 6];
/// Ratios that soft shadows indoors have.
const RATIO: [f32; 2] = [0.72, 0.985];
/// Variance of the rest against that of the noise.
const MOST_REST: f32 = 2.2;
/// Marked pixels that say enough.
const LEAST_PIXELS: u32 = 8;

/// Removes shadows, with its working memory.
#[derive(Debug)]
pub(crate) struct Shadow {
    raster: Raster,
    blocks: [usize; 2],
    kind: Vec<u8>,
}

const EMPTY: u8 = 0;
const BODY: u8 = 1;
const SHADOW: u8 = 2;

impl Shadow {
    pub(crate) fn new(raster: Raster) -> Self {
        let blocks = [raster.width.div_ceil(BLOCK[0]), raster.height.div_ceil(BLOCK[1])];
        Self { raster, blocks, kind: vec![EMPTY; blocks[0] * blocks[1]] }
    }

    /// Takes shadows out of `marks`; background and noise are 8.8 fixed point, the picture's common gain is `gain`.
    pub(crate) fn remove(&mut self, picture: &[u8], background: &[u16], noise: &[u16], gain: f64, marks: &mut [u8]) {
        let [columns, rows] = self.blocks;
        for by in 0..rows {
            for bx in 0..columns {
                self.kind[by * columns + bx] = self.judge(bx, by, picture, background, noise, gain as f32, marks);
            }
        }
        for by in 0..rows {
            for bx in 0..columns {
                if self.kind[by * columns + bx] == SHADOW && self.is_among_shadows(bx, by) {
                    self.for_pixels(bx, by, |i| marks[i] = 0);
                }
            }
        }
    }

    #[allow(clippy::too_many_arguments)]
    fn judge(
        &self,
        bx: usize,
        by: usize,
        picture: &[u8],
        background: &[u16],
        noise: &[u16],
        gain: f32,
        marks: &[u8],
    ) -> u8 {
        let (mut n, mut cc, mut cb, mut bb, mut nn) = (0u32, 0f32, 0f32, 0f32, 0f32);
        self.for_pixels(bx, by, |i| {
            if marks[i] != 0 {
                let (c, b) = (f32::from(picture[i]), f32::from(background[i]) / 256.0);
                let sigma = f32::from(noise[i]) * (1.2533 / 256.0);
                n += 1;
                cc += c * c;
                cb += c * b;
                bb += b * b;
                nn += sigma * sigma;
            }
        });
        if n == 0 {
            return EMPTY;
        }
        if n < LEAST_PIXELS || bb <= 0.0 {
            // A few marks at a border: they go with their neighbours.
            return EMPTY;
        }
        let ratio = cb / bb;
        let rest = (cc - ratio * cb).max(0.0) / n as f32;
        let darker = (RATIO[0]..RATIO[1]).contains(&(ratio / gain));
        if darker && rest < MOST_REST * nn / n as f32 + 0.3 { SHADOW } else { BODY }
    }

    fn is_among_shadows(&self, bx: usize, by: usize) -> bool {
        let [columns, rows] = self.blocks;
        let (mut shadows, mut bodies) = (0, 0);
        for y in by.saturating_sub(1)..(by + 2).min(rows) {
            for dx in 0..3 {
                let x = if self.raster.wraps { (bx + columns + dx - 1) % columns } else { bx + dx };
                let x = if self.raster.wraps {
                    x
                } else if x == 0 || x > columns {
                    continue;
                } else {
                    x - 1
                };
                match self.kind[y * columns + x] {
                    SHADOW => shadows += 1,
                    BODY => bodies += 1,
                    _ => {}
                }
            }
        }
        shadows > bodies && shadows >= 3
    }

    fn for_pixels(&self, bx: usize, by: usize, mut f: impl FnMut(usize)) {
        let Raster { width, height, .. } = self.raster;
        for y in by * BLOCK[1]..((by + 1) * BLOCK[1]).min(height) {
            for x in bx * BLOCK[0]..((bx + 1) * BLOCK[0]).min(width) {
                f(y * width + x);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};

    use super::*;

    #[test]
    fn a_soft_shadow_goes_and_a_checked_shirt_of_the_same_brightness_stays() {
        let raster = Raster { width: 120, height: 60, wraps: true };
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(7);
        let mut noise = || (0..4).map(|_| f64::from(rng.next_u32() >> 24) / 256.0 - 0.5).sum::<f64>() * 2.6;
        let wall = |x: usize, y: usize| 130.0 + 10.0 * (x as f64 / 9.0).sin() * (y as f64 / 7.0).cos();
        let background: Vec<u16> = (0..raster.len()).map(|i| (wall(i % 120, i / 120) * 256.0) as u16).collect();
        let mut marks = vec![0u8; raster.len()];
        let picture: Vec<u8> = (0..raster.len())
            .map(|i| {
                let (x, y) = (i % 120, i / 120);
                let level = if (10..50).contains(&x) && y > 10 {
                    marks[i] = 1;
                    wall(x, y) * 0.9
                } else if (70..100).contains(&x) && y > 10 {
                    marks[i] = 1;
                    117.0 + if (x / 4 + y / 4) % 2 == 0 { 9.0 } else { -9.0 }
                } else {
                    wall(x, y)
                };
                (level + noise()).round() as u8
            })
            .collect();
        let deviation = vec![(1.2 * 256.0) as u16; raster.len()];
        Shadow::new(raster).remove(&picture, &background, &deviation, 1.0, &mut marks);
        let count = |columns: std::ops::Range<usize>| {
            (0..raster.len()).filter(|i| columns.contains(&(i % 120)) && marks[*i] != 0).count()
        };
        assert!(count(10..50) < 100, "{}", count(10..50));
        assert!(count(70..100) > 1400, "{}", count(70..100));
    }
}
