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
/// Least ratio of a shadow through which the texture behind shows.
const LEAST_DEEP_RATIO: f32 = 0.3;
/// Variance that is always there, (grey levels)², and that of the rest against the noise's, …
const LEAST_VARIANCE: f32 = 0.3;
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
    counts: Vec<Counts>,
    products: kernel::Fours,
    /// Blocks taken for shadows.
    found: Vec<(usize, usize)>,
    /// Frames for which each block may still become brighter.
    remembered: Vec<u16>,
}

const EMPTY: u8 = 0;
const BODY: u8 = 1;
const SHADOW: u8 = 2;
const LIT: u8 = 3;

/// Bits of sixteen bytes at once: those that say that a kind is a shadow or lit.
const SHADOW_OR_LIT: u128 = u128::MAX / 255 * 2;

impl Shadow {
    pub(crate) fn new(raster: Raster) -> Self {
        let blocks = [raster.width.div_ceil(BLOCK[0]), raster.height.div_ceil(BLOCK[1])];
        let counts = vec![Counts::default(); raster.width.div_ceil(WORD)];
        let all = blocks[0] * blocks[1];
        let remembered = vec![REMEMBERED_NEW; all];
        Self {
            raster,
            blocks,
            kind: vec![EMPTY; all],
            counts,
            products: Default::default(),
            found: Vec::new(),
            remembered,
        }
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
                let told = counts.told_columns();
                if told == 0 {
                    continue;
                }
                for (w, row) in words.iter_mut().zip(band.chunks_exact(stride)) {
                    *w = row[word] & told;
                }
                let words = &words[..lines.len()];
                let first = lines.start * width + word * WORD;
                let levels = (&background[first..], &noise[first..]);
                kernel::products_by_fours(words, &picture[first..], levels.0, levels.1, width, &mut self.products);
                let kinds = judge(&self.products, &counts.in_order(), gain as f32);
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
        let (mut shadows, mut bodies) = (0, 0);
        for row in self.kind[by.saturating_sub(1) * columns..(by + 2).min(rows) * columns].chunks_exact(columns) {
            let near = match row.get(bx.wrapping_sub(1)..bx + 2) {
                Some(&[before, here, after]) => [before, here, after],
                _ => {
                    let before = bx.checked_sub(1).or_else(|| over_seam(columns - 1));
                    let after = Some(bx + 1).filter(|x| *x < columns).or_else(|| over_seam(0));
                    [before, Some(bx), after].map(|x| x.map_or(EMPTY, |x| row[x]))
                }
            };
            for kind in near {
                shadows += u32::from(kind >= SHADOW);
                bodies += u32::from(kind == BODY);
            }
        }
        shadows > bodies && shadows >= 3
    }
}

/// Marks of each four columns of a word of marks, in at most six rows: a byte each.
#[derive(Debug, Clone, Copy, Default)]
struct Counts {
    /// Of the first, third, … four columns.
    even: u64,
    odd: u64,
}

impl Counts {
    /// The columns whose four have at least [`LEAST_PIXELS`] marks.
    fn told_columns(self) -> u64 {
        const { assert!(LEAST_PIXELS == 8 && BLOCK[0] * BLOCK[1] < 32) };
        if (self.even | self.odd) & (EACH * 0b11000) == 0 {
            return 0;
        }
        let eight_or_more = |counts: u64| (counts >> 3 | counts >> 4) & EACH;
        (eight_or_more(self.even) * 0x0f) | (eight_or_more(self.odd) * 0xf0)
    }

    /// From the first four columns to the last.
    fn in_order(self) -> [u8; BLOCKS] {
        let (even, odd) = (self.even.to_le_bytes(), self.odd.to_le_bytes());
        std::array::from_fn(|k| if k % 2 == 0 { even[k / 2] } else { odd[k / 2] })
    }
}

/// The lowest bit of each byte.
const EACH: u64 = u64::MAX / 255;
/// Every second four bits.
const EVEN: u64 = EACH * 0x0f;

kernel::wide! {
/// Counts marks of at most six rows of words, one below the other.
fn count_fours(rows: &[u64], counts: &mut [Counts]) {
    counts.fill(Counts::default());
    for row in rows.chunks_exact(counts.len()) {
        for (counts, word) in counts.iter_mut().zip(row) {
            let twos = word - (word >> 1 & 0x5555_5555_5555_5555);
            let fours = (twos & 0x3333_3333_3333_3333) + (twos >> 2 & 0x3333_3333_3333_3333);
            counts.even += fours & EVEN;
            counts.odd += fours >> 4 & EVEN;
        }
    }
}
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
        let kept = ratio / gain;
        let brighter = (gain / ratio >= RATIO[0]) & (gain / ratio < RATIO[1]);
        let only_noise = rest < MOST_REST * noise + LEAST_VARIANCE;
        let through = ratio * ratio * (bb - b1 * b1 / n).max(0.0) * UNIT / n;
        let shows_through =
            (through > LEAST_TEXTURE * (noise + LEAST_VARIANCE)) & (rest < MOST_REST_OF_TEXTURE * through);
        let is_shaded = only_noise & (kept >= RATIO[0]) | shows_through & (kept >= LEAST_DEEP_RATIO);
        let kind = if is_shaded & (kept < RATIO[1]) {
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

    const RING: Raster = Raster { width: 120, height: 60, wraps: true };

    /// Levels by column and row.
    type Levels<'a> = &'a dyn Fn(usize, usize) -> f64;

    /// A camera's noise, grey levels.
    fn noise(seed: u64) -> impl FnMut() -> f64 {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        move || (0..4).map(|_| f64::from(rng.next_u32() >> 24) / 256.0 - 0.5).sum::<f64>() * 2.6
    }

    /// What is left of the marks when shadows are removed.
    fn left(
        shadow: &mut Shadow,
        background: Levels<'_>,
        picture: Levels<'_>,
        marked: impl Fn(usize, usize) -> bool,
        noise: &mut impl FnMut() -> f64,
    ) -> Marks {
        let places = || (0..RING.len()).map(|i| (i % RING.width, i / RING.width));
        let level: Vec<u16> = places().map(|(x, y)| (background(x, y) * 256.0) as u16).collect();
        let seen: Vec<u8> = places().map(|(x, y)| (picture(x, y) + noise()).round() as u8).collect();
        let marks: Vec<u8> = places().map(|(x, y)| u8::from(marked(x, y))).collect();
        let deviation = vec![(1.2 * 256.0) as u16; RING.len()];
        let mut marks = Marks::of_bytes(&marks, RING);
        shadow.remove(&seen, &level, &deviation, 1.0, &mut marks);
        marks
    }

    fn count(marks: &Marks, columns: std::ops::Range<usize>) -> usize {
        (0..RING.height).map(|y| marks.count(y, columns.start, columns.len())).sum()
    }

    #[test]
    fn a_soft_shadow_goes_and_a_checked_shirt_of_the_same_brightness_stays() {
        let wall = |x: usize, y: usize| 130.0 + 10.0 * (x as f64 / 9.0).sin() * (y as f64 / 7.0).cos();
        let shaded = |x: usize, y: usize| (10..50).contains(&x) && y > 10;
        let shirt = |x: usize, y: usize| (70..100).contains(&x) && y > 10;
        let picture = |x: usize, y: usize| match (shaded(x, y), shirt(x, y)) {
            (true, _) => wall(x, y) * 0.9,
            (_, true) => 117.0 + if (x / 4 + y / 4).is_multiple_of(2) { 9.0 } else { -9.0 },
            _ => wall(x, y),
        };
        let marked = |x, y| shaded(x, y) || shirt(x, y);
        let marks = left(&mut Shadow::new(RING), &wall, &picture, marked, &mut noise(7));
        assert!(count(&marks, 10..50) < 100, "{}", count(&marks, 10..50));
        assert!(count(&marks, 70..100) > 1400, "{}", count(&marks, 70..100));
    }

    #[test]
    fn a_deep_shadow_on_shelves_goes_and_dark_clothes_before_them_stay() {
        let shelves = |x: usize, y: usize| 110.0 + 60.0 * (x as f64 / 1.9).sin() * (y as f64 / 2.4).cos();
        // Over the seam the shadow, with an edge that lets more and more light by; then plain and patterned clothes.
        let shaded = |x: usize| (x + 10) % 120 < 40;
        let (dark, patterned) = (50..75, 85..105);
        let picture = |x: usize, y: usize| match x {
            _ if shaded(x) => (0.45 + 0.01 * ((x + 10) % 120) as f64) * shelves(x, y),
            _ if dark.contains(&x) => 50.0,
            _ if patterned.contains(&x) => 55.0 + 20.0 * (x as f64 / 1.3).cos() * (y as f64 / 1.7).sin(),
            _ => shelves(x, y),
        };
        let marked = |x, _| shaded(x) || dark.contains(&x) || patterned.contains(&x);
        let marks = left(&mut Shadow::new(RING), &shelves, &picture, marked, &mut noise(9));
        // A tenth of the shadow may be left, and of the coats a twentieth be gone.
        let shadow = count(&marks, 110..120) + count(&marks, 0..30);
        assert!(shadow < 240, "{shadow} of 2400 pixels of the shadow are left");
        assert!(count(&marks, dark.clone()) > 1425, "{} of 1500 are left", count(&marks, dark));
        assert!(count(&marks, patterned.clone()) > 1140, "{} of 1200 are left", count(&marks, patterned));
    }

    #[test]
    fn a_shadow_that_was_learnt_leaves_nothing_when_it_goes_and_a_light_coat_stays_where_none_was() {
        let wall = |x: usize, y: usize| 130.0 + 10.0 * (x as f64 / 9.0).sin() * (y as f64 / 7.0).cos();
        let shaded = |x: usize, y: usize| (10..50).contains(&x) && y > 10;
        let coat = |x: usize, y: usize| (70..100).contains(&x) && y > 10;
        let (mut shadow, mut noise) = (Shadow::new(RING), noise(8));
        let mut counts = |background: Levels<'_>, picture: Levels<'_>| {
            let marked = |x, y| shaded(x, y) || coat(x, y);
            let marks = left(&mut shadow, background, picture, marked, &mut noise);
            [count(&marks, 10..50), count(&marks, 70..100)]
        };
        let dark = |x: usize, y: usize| if shaded(x, y) { 0.88 * wall(x, y) } else { wall(x, y) };
        // A shadow falls, somebody in a textured coat beside it; long after the start of the background.
        let textured =
            |x: usize, y: usize| if coat(x, y) { 117.0 + [9.0, -9.0][(x / 4 + y / 4) % 2] } else { dark(x, y) };
        let frames = usize::from(REMEMBERED_NEW) + 1;
        let last = (0..frames).map(|_| counts(&wall, &textured)).last();
        assert!(last.is_some_and(|[shaded, _]| shaded < 100), "{last:?}");
        // It has been learnt and goes; the coat is smooth now, and lighter than the wall.
        let light = |x: usize, y: usize| if coat(x, y) { 1.15 * wall(x, y) } else { wall(x, y) };
        let [shaded_left, coat_left] = counts(&dark, &light);
        assert!(shaded_left < 100, "{shaded_left}");
        assert!(coat_left > 1400, "{coat_left}");
    }
}
