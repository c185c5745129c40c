//! Shadows on walls and floor: they make a surface darker but leave its texture.
//!
//! In small blocks the marked pixels are fitted by C ≈ r · B. A shadow gives a ratio somewhat below one and leaves only the
//! camera's noise; clothes have a texture of their own, or are much darker, or brighter. A block is a shadow only among
//! others, so a smooth patch of a coat stays.
//!
//! Where what is behind has a texture (shelves, posters), it shows through a shadow and not through a body: there a shadow may be
//! as deep as it likes, and the rest is measured against what shows through, for within a block the light changes. Deep shadows
//! on smooth walls cannot be told from dark clothes like this; the tracker judges them whole (`tracking/shade`).
//!
//! A shadow that stays becomes background, and leaves a place that is brighter than it when it goes: the same test with a
//! ratio above one. Bright clothes on a smooth wall would pass it too, so it holds only where there was a shadow before (or,
//! for a while, where the background is new and may have been learnt with one).

use super::kernel;
use super::marks::{Marks, WORD};
use super::raster::Raster;

const BLOCK: [usize; 2] = [4, 6];
/// Blocks of a word of marks.
const BLOCKS: usize = WORD / BLOCK[0];
/// Ratios that soft shadows indoors have.
const RATIO: [f32; 2] = [0.72, 0.985];
/// For how many frames a place may become brighter since a shadow lay on it, and since the background was begun.
const REMEMBERED: u16 = 6000;
const REMEMBERED_NEW: u16 = 300;
/// Ratios of shadows, however deep, through which the texture behind shows.
const DEEP_RATIO: [f32; 2] = [0.3, 0.985];
/// Variance of the rest against that of the noise, …
const MOST_REST: f32 = 2.2;
/// … and against that of what shows through, if that is at least so much against the noise.
const MOST_REST_OF_TEXTURE: f32 = 0.2;
const LEAST_TEXTURE: f32 = 4.0;
/// Marked pixels that say enough.
const LEAST_PIXELS: u8 = 8;

/// Removes shadows, with its working memory.
#[derive(Debug)]
pub(crate) struct Shadow {
    raster: Raster,
    blocks: [usize; 2],
    kind: Vec<u8>,
    /// Marks of each block of a row of them, by words.
    counts: Vec<[u8; BLOCKS]>,
    /// Blocks taken for shadows.
    found: Vec<(usize, usize)>,
    /// Frames for which each block may still become brighter.
    remembered: Vec<u16>,
}

const EMPTY: u8 = 0;
const BODY: u8 = 1;
const SHADOW: u8 = 2;
const LIT: u8 = 3;

/// Bits of sixteen bytes at once: those that say that a count is at least [`LEAST_PIXELS`], and that a kind is a shadow or lit.
const AT_LEAST_EIGHT: u128 = u128::MAX / 255 * (u8::MAX - LEAST_PIXELS + 1) as u128;
const SHADOW_OR_LIT: u128 = u128::MAX / 255 * 2;

impl Shadow {
    pub(crate) fn new(raster: Raster) -> Self {
        let blocks = [raster.width.div_ceil(BLOCK[0]), raster.height.div_ceil(BLOCK[1])];
        let counts = vec![[0; BLOCKS]; raster.width.div_ceil(WORD)];
        let all = blocks[0] * blocks[1];
        let remembered = vec![REMEMBERED_NEW; all];
        Self { raster, blocks, kind: vec![EMPTY; all], counts, found: Vec::new(), remembered }
    }

    /// The background is begun anew.
    pub(super) fn restart(&mut self) {
        self.remembered.fill(REMEMBERED_NEW);
    }

    /// Takes shadows out of `marks`; background and noise are 8.8 fixed point, the picture's common gain is `gain`.
    pub(super) fn remove(&mut self, picture: &[u8], background: &[u16], noise: &[u16], gain: f64, marks: &mut Marks) {
        let Raster { width, height, .. } = self.raster;
        let [columns, rows] = self.blocks;
        self.kind.fill(EMPTY);
        self.found.clear();
        self.remembered.iter_mut().for_each(|n| *n = n.saturating_sub(1));
        let mut words = [0u64; BLOCK[1]];
        for by in 0..rows {
            let lines = by * BLOCK[1]..((by + 1) * BLOCK[1]).min(height);
            let stride = marks.stride();
            let band = &marks.words()[lines.start * stride..lines.end * stride];
            if band.iter().fold(0, |any, word| any | word) == 0 {
                continue;
            }
            count_fours(band, &mut self.counts);
            for word in 0..stride {
                let counts = self.counts[word];
                // A few marks say nothing: they go with their neighbours.
                if u128::from_le_bytes(counts) & AT_LEAST_EIGHT == 0 {
                    continue;
                }
                for (k, w) in words[..lines.len()].iter_mut().enumerate() {
                    *w = band[k * stride + word];
                }
                let words = &words[..lines.len()];
                let first = lines.start * width + word * WORD;
                let levels = (&background[first..], &noise[first..]);
                let products = kernel::products_by_fours(words, &picture[first..], levels.0, levels.1, width);
                let kinds = judge(&products, &counts, gain as f32);
                let first = word * BLOCKS;
                let blocks = by * columns + first..by * columns + columns.min(first + BLOCKS);
                if u128::from_le_bytes(kinds) & SHADOW_OR_LIT == 0 {
                    self.kind[blocks.clone()].copy_from_slice(&kinds[..blocks.len()]);
                    continue;
                }
                for (k, (at, kind)) in blocks.zip(kinds).enumerate() {
                    self.kind[at] = if kind == LIT && self.remembered[at] == 0 { BODY } else { kind };
                    if self.kind[at] >= SHADOW {
                        self.found.push((first + k, by));
                    }
                }
            }
        }
        let stride = marks.stride();
        for &(bx, by) in &self.found {
            if self.is_among_shadows(bx, by) {
                let at = by * columns + bx;
                if self.kind[at] == SHADOW {
                    self.remembered[at] = REMEMBERED;
                }
                let (word, bit) = (bx * BLOCK[0] / WORD, bx * BLOCK[0] % WORD);
                for y in by * BLOCK[1]..((by + 1) * BLOCK[1]).min(height) {
                    marks.words_mut()[y * stride + word] &= !(0b1111 << bit);
                }
            }
        }
    }

    fn is_among_shadows(&self, bx: usize, by: usize) -> bool {
        let [columns, rows] = self.blocks;
        let over_seam = |column: usize| self.raster.wraps.then_some(column);
        let before = bx.checked_sub(1).or_else(|| over_seam(columns - 1));
        let after = Some(bx + 1).filter(|x| *x < columns).or_else(|| over_seam(0));
        let (mut shadows, mut bodies) = (0, 0);
        for row in self.kind[by.saturating_sub(1) * columns..(by + 2).min(rows) * columns].chunks_exact(columns) {
            for x in [before, Some(bx), after].into_iter().flatten() {
                let kind = row[x];
                shadows += u32::from(kind >= SHADOW);
                bodies += u32::from(kind == BODY);
            }
        }
        shadows > bodies && shadows >= 3
    }
}

kernel::wide! {
/// Marks of each four columns of at most six rows of words, one below the other.
fn count_fours(rows: &[u64], counts: &mut [[u8; BLOCKS]]) {
    let stride = counts.len();
    let (upper, lower) = rows.split_at((3 * stride).min(rows.len()));
    for (word, counts) in counts.iter_mut().enumerate() {
        if rows.iter().skip(word).step_by(stride).fold(0, |any, word| any | word) == 0 {
            *counts = [0; BLOCKS];
            continue;
        }
        // The counts of three rows fit four bits.
        let (upper, lower) = (nibbles(upper, word, stride), nibbles(lower, word, stride));
        let even = (upper & EVEN) + (lower & EVEN);
        let odd = (upper >> 4 & EVEN) + (lower >> 4 & EVEN);
        for ((counts, even), odd) in counts.as_chunks_mut::<2>().0.iter_mut().zip(even.to_le_bytes()).zip(odd.to_le_bytes()) {
            *counts = [even, odd];
        }
    }
}
}

/// Every second four bits.
const EVEN: u64 = 0x0f0f_0f0f_0f0f_0f0f;

/// Marks of each four columns of a word in at most three rows, four bits each.
#[inline(always)]
fn nibbles(rows: &[u64], word: usize, stride: usize) -> u64 {
    let mut sum = 0;
    for row in rows.chunks_exact(stride) {
        let w = row[word];
        let twos = w - (w >> 1 & 0x5555_5555_5555_5555);
        sum += (twos & 0x3333_3333_3333_3333) + (twos >> 2 & 0x3333_3333_3333_3333);
    }
    sum
}

kernel::wide! {
/// What each block of a word is, `counts` marks in it; empty where that is too few. Sums of products of its marked pixels in eighths of grey levels, so that
/// they stay in 32 bits: 24 · 2040² < 2³².
fn judge(products: &[[u32; BLOCKS]; 5], counts: &[u8; BLOCKS], gain: f32) -> [u8; BLOCKS] {
    const UNIT: f32 = 1.0 / 64.0;
    const SIGMA: f32 = 1.2533 / 256.0;
    let mut kinds = [EMPTY; BLOCKS];
    for k in 0..BLOCKS {
        let [cc, cb, bb, nn, b1] = [products[0][k], products[1][k], products[2][k], products[3][k], products[4][k]];
        let [cc, cb, bb, nn, b1] = [cc as f32, cb as f32, bb as f32, nn as f32, b1 as f32];
        let n = f32::from(counts[k].max(1));
        let ratio = cb / bb.max(1.0);
        let rest = (cc - ratio * cb).max(0.0) * UNIT / n;
        let noise = nn * SIGMA * SIGMA / n;
        let darker = (ratio / gain >= RATIO[0]) & (ratio / gain < RATIO[1]);
        let brighter = (gain / ratio >= RATIO[0]) & (gain / ratio < RATIO[1]);
        let only_noise = rest < MOST_REST * noise + 0.3;
        let through = ratio * ratio * (bb - b1 * b1 / n).max(0.0) * UNIT / n;
        let shows_through = (through > LEAST_TEXTURE * (noise + 0.3)) & (rest < MOST_REST_OF_TEXTURE * through);
        let deep = (ratio / gain >= DEEP_RATIO[0]) & (ratio / gain < DEEP_RATIO[1]);
        let kind = if only_noise & darker | shows_through & deep {
            SHADOW
        } else if only_noise & brighter {
            LIT
        } else {
            BODY
        };
        kinds[k] = if (bb == 0.0) | (counts[k] < LEAST_PIXELS) { EMPTY } else { kind };
    }
    kinds
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
        let mut marks = Marks::of_bytes(&marks, raster);
        Shadow::new(raster).remove(&picture, &background, &deviation, 1.0, &mut marks);
        let count = |columns: std::ops::Range<usize>| -> usize {
            (0..raster.height).map(|y| marks.count(y, columns.start, columns.len())).sum()
        };
        assert!(count(10..50) < 100, "{}", count(10..50));
        assert!(count(70..100) > 1400, "{}", count(70..100));
    }

    #[test]
    fn a_deep_shadow_on_shelves_goes_and_dark_clothes_before_them_stay() {
        let raster = Raster { width: 120, height: 60, wraps: true };
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(9);
        let mut noise = || (0..4).map(|_| f64::from(rng.next_u32() >> 24) / 256.0 - 0.5).sum::<f64>() * 2.6;
        let shelves = |x: usize, y: usize| 110.0 + 60.0 * (x as f64 / 1.9).sin() * (y as f64 / 2.4).cos();
        let background: Vec<u16> = (0..raster.len()).map(|i| (shelves(i % 120, i / 120) * 256.0) as u16).collect();
        // Over the seam the shadow, with an edge that lets more and more light by; then plain and patterned clothes.
        let shaded = |x: usize| (x + 10) % 120 < 40;
        let dark = |x: usize| (50..75).contains(&x);
        let patterned = |x: usize| (85..105).contains(&x);
        let picture: Vec<u8> = (0..raster.len())
            .map(|i| {
                let (x, y) = (i % 120, i / 120);
                let level = match x {
                    _ if shaded(x) => (0.45 + 0.01 * (x + 10).rem_euclid(120) as f64) * shelves(x, y),
                    _ if dark(x) => 50.0,
                    _ if patterned(x) => 55.0 + 20.0 * (x as f64 / 1.3).cos() * (y as f64 / 1.7).sin(),
                    _ => shelves(x, y),
                };
                (level + noise()).round() as u8
            })
            .collect();
        let marks: Vec<u8> = (0..raster.len())
            .map(|i| u8::from([shaded(i % 120), dark(i % 120), patterned(i % 120)].contains(&true)))
            .collect();
        let deviation = vec![(1.2 * 256.0) as u16; raster.len()];
        let mut marks = Marks::of_bytes(&marks, raster);
        Shadow::new(raster).remove(&picture, &background, &deviation, 1.0, &mut marks);
        let share = |of: &dyn Fn(usize) -> bool| {
            let columns: Vec<usize> = (0..120).filter(|x| of(*x)).collect();
            let left: usize = columns.iter().map(|x| (0..60).map(|y| marks.count(y, *x, 1)).sum::<usize>()).sum();
            left as f64 / (60 * columns.len()) as f64
        };
        assert!(share(&shaded) < 0.1, "{:.2} of the shadow are left", share(&shaded));
        assert!(share(&dark) > 0.95, "{:.2} of a plain coat are left", share(&dark));
        assert!(share(&patterned) > 0.95, "{:.2} of a patterned coat are left", share(&patterned));
    }

    #[test]
    fn a_shadow_that_was_learnt_leaves_nothing_when_it_goes_and_a_light_coat_stays_where_none_was() {
        let raster = Raster { width: 120, height: 60, wraps: true };
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(8);
        let mut noise = || (0..4).map(|_| f64::from(rng.next_u32() >> 24) / 256.0 - 0.5).sum::<f64>() * 2.6;
        let wall = |i: usize| 130.0 + 10.0 * ((i % 120) as f64 / 9.0).sin() * ((i / 120) as f64 / 7.0).cos();
        let shaded = |i: usize| (10..50).contains(&(i % 120)) && i / 120 > 10;
        let coat = |i: usize| (70..100).contains(&(i % 120)) && i / 120 > 10;
        let deviation = vec![(1.2 * 256.0) as u16; raster.len()];
        let mut shadow = Shadow::new(raster);
        let mut left = |background: &dyn Fn(usize) -> f64, picture: &dyn Fn(usize) -> f64, frames: usize| {
            let background: Vec<u16> = (0..raster.len()).map(|i| (background(i) * 256.0) as u16).collect();
            let mut counts = [0, 0];
            for _ in 0..frames {
                let picture: Vec<u8> = (0..raster.len()).map(|i| (picture(i) + noise()).round() as u8).collect();
                let marks: Vec<u8> = (0..raster.len()).map(|i| u8::from(shaded(i) || coat(i))).collect();
                let mut marks = Marks::of_bytes(&marks, raster);
                shadow.remove(&picture, &background, &deviation, 1.0, &mut marks);
                let count = |columns: std::ops::Range<usize>| -> usize {
                    (0..raster.height).map(|y| marks.count(y, columns.start, columns.len())).sum()
                };
                counts = [count(10..50), count(70..100)];
            }
            counts
        };
        let dark = |i: usize| if shaded(i) { 0.88 * wall(i) } else { wall(i) };
        // A shadow falls, somebody in a textured coat beside it; long after the start of the background.
        let textured = |i: usize| if coat(i) { 117.0 + [9.0, -9.0][(i / 4 + i / 480) % 2] } else { dark(i) };
        assert!(left(&wall, &textured, usize::from(REMEMBERED_NEW) + 1)[0] < 100);
        // It has been learnt and goes; the coat is smooth now, and lighter than the wall.
        let light = |i: usize| if coat(i) { 1.15 * wall(i) } else { wall(i) };
        let [shaded_left, coat_left] = left(&dark, &light, 1);
        assert!(shaded_left < 100, "{shaded_left}");
        assert!(coat_left > 1400, "{coat_left}");
    }
}
