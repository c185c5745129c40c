//! Shadows on walls and floor: they make a surface darker but leave its texture.
//!
//! In small blocks the marked pixels are fitted by C ≈ r · B. A shadow gives a ratio somewhat below one and leaves only the
//! camera's noise; clothes have a texture of their own, or are much darker, or brighter. A block is a shadow only among
//! others, so a smooth patch of a coat stays.

use std::ops::Range;

use super::kernel;
use super::raster::Raster;

const BLOCK: [usize; 2] = [4, 6];
/// Ratios that soft shadows indoors have.
const RATIO: [f32; 2] = [0.72, 0.985];
/// Variance of the rest against that of the noise.
const MOST_REST: f32 = 2.2;
/// Marked pixels that say enough.
const LEAST_PIXELS: u8 = 8;

/// Removes shadows, with its working memory.
#[derive(Debug)]
pub(crate) struct Shadow {
    raster: Raster,
    blocks: [usize; 2],
    kind: Vec<u8>,
    /// Marks of each column in a row of blocks.
    sums: Vec<u8>,
    /// Marks of each block in it.
    counts: Vec<u8>,
    products: Products,
    /// Blocks taken for shadows.
    found: Vec<(usize, usize)>,
}

const EMPTY: u8 = 0;
const BODY: u8 = 1;
const SHADOW: u8 = 2;

impl Shadow {
    pub(crate) fn new(raster: Raster) -> Self {
        let blocks = [raster.width.div_ceil(BLOCK[0]), raster.height.div_ceil(BLOCK[1])];
        let sums = vec![0; blocks[0] * BLOCK[0]];
        Self {
            raster,
            blocks,
            kind: vec![EMPTY; blocks[0] * blocks[1]],
            sums,
            counts: vec![0; blocks[0]],
            products: Products::default(),
            found: Vec::new(),
        }
    }

    /// Takes shadows out of `marks`; background and noise are 8.8 fixed point, the picture's common gain is `gain`.
    pub(crate) fn remove(&mut self, picture: &[u8], background: &[u16], noise: &[u16], gain: f64, marks: &mut [u8]) {
        let Raster { width, height, .. } = self.raster;
        let [columns, rows] = self.blocks;
        self.kind.fill(EMPTY);
        self.found.clear();
        for by in 0..rows {
            self.sums.fill(0);
            for y in by * BLOCK[1]..((by + 1) * BLOCK[1]).min(height) {
                kernel::add_row(&marks[y * width..(y + 1) * width], &mut self.sums);
            }
            kernel::sums_of_fours(&mut self.sums, &mut self.counts);
            // A few marks say nothing: they go with their neighbours. Blocks with more are judged in stretches.
            let mut bx = 0;
            while let Some(ahead) = self.counts[bx..].iter().position(|n| *n >= LEAST_PIXELS) {
                let start = bx + ahead;
                bx = start + self.counts[start..].iter().position(|n| *n < LEAST_PIXELS).unwrap_or(columns - start);
                let pixels = start * BLOCK[0]..(bx * BLOCK[0]).min(width);
                self.products.clear(pixels.len().next_multiple_of(BLOCK[0]));
                for y in by * BLOCK[1]..((by + 1) * BLOCK[1]).min(height) {
                    let pixels = y * width + pixels.start..y * width + pixels.end;
                    self.products.add(
                        &marks[pixels.clone()],
                        &picture[pixels.clone()],
                        &background[pixels.clone()],
                        &noise[pixels],
                    );
                }
                for block in start..bx {
                    let n = u32::from(self.counts[block]);
                    let kind = self.products.judge((block - start) * BLOCK[0], n, gain as f32);
                    self.kind[by * columns + block] = kind;
                    if kind == SHADOW {
                        self.found.push((block, by));
                    }
                }
            }
        }
        for &(bx, by) in &self.found {
            if self.is_among_shadows(bx, by) {
                self.for_rows(bx, by, |pixels| marks[pixels].fill(0));
            }
        }
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

    fn for_rows(&self, bx: usize, by: usize, mut f: impl FnMut(Range<usize>)) {
        let Raster { width, height, .. } = self.raster;
        let columns = bx * BLOCK[0]..((bx + 1) * BLOCK[0]).min(width);
        for y in by * BLOCK[1]..((by + 1) * BLOCK[1]).min(height) {
            f(y * width + columns.start..y * width + columns.end);
        }
    }
}

/// Sums of products down the columns of a stretch of blocks, of marked pixels only. Levels are in eighths of grey levels, so
/// that the sums of a block stay in 32 bits: 24 · 2040² < 2³².
#[derive(Debug, Default)]
struct Products {
    cc: Vec<u32>,
    cb: Vec<u32>,
    bb: Vec<u32>,
    nn: Vec<u32>,
}

impl Products {
    fn clear(&mut self, columns: usize) {
        for sums in [&mut self.cc, &mut self.cb, &mut self.bb, &mut self.nn] {
            sums.clear();
            sums.resize(columns, 0);
        }
    }

    fn add(&mut self, marks: &[u8], picture: &[u8], background: &[u16], noise: &[u16]) {
        kernel::add_products(
            marks,
            picture,
            background,
            noise,
            [&mut self.cc, &mut self.cb, &mut self.bb, &mut self.nn],
        );
    }

    /// What the block of `n` marks is that begins with a column of the stretch.
    fn judge(&self, column: usize, n: u32, gain: f32) -> u8 {
        const UNIT: f32 = 1.0 / 64.0;
        const SIGMA: f32 = 1.2533 / 256.0;
        let sum = |sums: &[u32]| sums[column..][..BLOCK[0]].iter().fold(0u32, |s, v| s.wrapping_add(*v)) as f32;
        let (cc, cb, bb, nn) = (sum(&self.cc), sum(&self.cb), sum(&self.bb), sum(&self.nn));
        if bb == 0.0 {
            return EMPTY;
        }
        let ratio = cb / bb;
        let rest = (cc - ratio * cb).max(0.0) * UNIT / n as f32;
        let noise = nn * SIGMA * SIGMA / n as f32;
        let darker = (RATIO[0]..RATIO[1]).contains(&(ratio / gain));
        if darker && rest < MOST_REST * noise + 0.3 { SHADOW } else { BODY }
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
        let count = |columns: Range<usize>| {
            (0..raster.len()).filter(|i| columns.contains(&(i % 120)) && marks[*i] != 0).count()
        };
        assert!(count(10..50) < 100, "{}", count(10..50));
        assert!(count(70..100) > 1400, "{}", count(70..100));
    }
}
