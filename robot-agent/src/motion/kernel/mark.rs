//! What differs from the background, and from the frame before. Marks are bits, see `marks`.

use super::{Level, available, bits_of, expose, fetch, padded, tolerance, wide};

/// The noise estimate saturates here (8.8 fixed point: 11.7 grey levels of mean deviation, leaves in the wind), so that thresholds stay in 16 bits.
pub const NOISE_MAX: u16 = 3000;
/// The same indoors: 6.6 grey levels.
pub const INDOOR_NOISE_MAX: u16 = 1700;

const BLOCK: usize = 64;

/// A piece of the picture and what it is compared with: some rows of some columns. Each slice begins at the piece's first pixel and goes on
/// at least to its last, rows lie `width` pixels apart.
#[derive(Debug, Clone, Copy)]
pub struct Compared<'a> {
    /// Grey levels.
    pub picture: &'a [u8],
    /// Factor that brings the picture to the background's exposure; 32768 is 1.
    pub exposure_q15: u16,
    /// 8.8 fixed point.
    pub background: &'a [u16],
    /// Mean absolute deviation, 8.8 fixed point.
    pub noise: &'a [u16],
    /// Least changes that mark faintly and strongly, 8.8 fixed point.
    pub floors: [u16; 2],
    /// Columns and rows of the piece.
    pub size: [usize; 2],
    /// Columns of the picture.
    pub width: usize,
}

/// Where [`mark_changes`] marks: each slice begins at the piece's first pixel or word, too; rows of words lie `stride` words apart.
#[derive(Debug)]
pub struct Marked<'a> {
    /// |C − B| in whole grey levels.
    pub magnitude: &'a mut [u8],
    /// A value a column: becomes the largest of itself and the magnitudes below it.
    pub most: &'a mut [u8],
    /// Marked faintly.
    pub faint: &'a mut [u64],
    /// Marked strongly.
    pub strong: &'a mut [u64],
    /// Words of a row of the picture.
    pub stride: usize,
}

/// Rows ahead of which pixels are fetched into the cache: where a picture is worked here and there, it is not read in one piece.
const FETCH_ROWS: usize = 2;

wide! {
/// Marks the pixels of a piece of the picture that differ from the background: `faint` where |C − B| ≥ max(floor, 1.6 σ), `strong`
/// where |C − B| ≥ max(floor, 4 σ) (`MATHS.md` §7.4), σ = 1.25 noise, C at the background's exposure.
pub fn mark_changes(piece: Compared<'_>, marked: &mut Marked<'_>) {
    let level = available();
    let [columns, rows] = piece.size;
    let words = columns.div_ceil(BLOCK);
    for y in 0..rows {
        let ahead = (y + FETCH_ROWS) * piece.width..(y + FETCH_ROWS) * piece.width + columns;
        fetch(piece.picture.get(ahead.clone()).unwrap_or_default());
        fetch(piece.background.get(ahead.clone()).unwrap_or_default());
        fetch(piece.noise.get(ahead.clone()).unwrap_or_default());
        fetch(marked.magnitude.get(ahead).unwrap_or_default());
        let pixels = y * piece.width..y * piece.width + columns;
        let (picture, background, noise) =
            (&piece.picture[pixels.clone()], &piece.background[pixels.clone()], &piece.noise[pixels.clone()]);
        let (magnitude, most) = (&mut marked.magnitude[pixels], &mut marked.most[..columns]);
        let faint = &mut marked.faint[y * marked.stride..][..words];
        let strong = &mut marked.strong[y * marked.stride..][..words];
        let row = Row { picture, exposure_q15: piece.exposure_q15, background, noise, floors: piece.floors };
        mark_row(level, row, magnitude, most, faint, strong);
    }
}
}

/// A row of [`Compared`].
#[derive(Clone, Copy)]
struct Row<'a> {
    picture: &'a [u8],
    exposure_q15: u16,
    background: &'a [u16],
    noise: &'a [u16],
    floors: [u16; 2],
}

#[inline(always)]
fn mark_row(level: Level, row: Row<'_>, magnitude: &mut [u8], most: &mut [u8], faint: &mut [u64], strong: &mut [u64]) {
    let n = row.picture.len();
    let (background, noise) = (&row.background[..n], &row.noise[..n]);
    let (magnitude, most) = (&mut magnitude[..n], &mut most[..n]);
    let blocks = row.picture.as_chunks().0.iter().zip(background.as_chunks().0).zip(noise.as_chunks().0);
    let out = magnitude.as_chunks_mut().0.iter_mut().zip(most.as_chunks_mut().0);
    for (((p, b), s), ((magnitude, most), marks)) in blocks.zip(out.zip(faint.iter_mut().zip(strong.iter_mut()))) {
        (*marks.0, *marks.1) = mark_block(level, p, row.exposure_q15, b, s, row.floors, magnitude, most);
    }
    let (w, rest) = (n / BLOCK, n % BLOCK);
    if rest == 0 {
        return;
    }
    // The last block of a row begins sooner: what is marked twice is marked alike.
    let first = n.saturating_sub(BLOCK);
    let block = (row.picture[first..].first_chunk(), background[first..].first_chunk(), noise[first..].first_chunk());
    let out = (magnitude[first..].first_chunk_mut(), most[first..].first_chunk_mut());
    (faint[w], strong[w]) = match (block, out) {
        ((Some(p), Some(b), Some(s)), (Some(magnitude), Some(most))) => {
            let (faint, strong) = mark_block(level, p, row.exposure_q15, b, s, row.floors, magnitude, most);
            (faint >> (BLOCK - rest), strong >> (BLOCK - rest))
        }
        _ => {
            let (mut changes, mut larger) = ([0; BLOCK], padded(most));
            let (p, b, s) = (padded(row.picture), padded(background), padded(noise));
            let (faint, strong) =
                mark_block(level, &p, row.exposure_q15, &b, &s, row.floors, &mut changes, &mut larger);
            magnitude.copy_from_slice(&changes[..n]);
            most.copy_from_slice(&larger[..n]);
            (faint & ((1 << n) - 1), strong & ((1 << n) - 1))
        }
    };
}

#[inline(always)]
#[allow(clippy::too_many_arguments)]
fn mark_block(
    level: Level,
    picture: &[u8; BLOCK],
    exposure_q15: u16,
    background: &[u16; BLOCK],
    noise: &[u16; BLOCK],
    [floor_faint, floor_strong]: [u16; 2],
    magnitude: &mut [u8; BLOCK],
    most: &mut [u8; BLOCK],
) -> (u64, u64) {
    #[cfg(target_arch = "x86_64")]
    {
        let floors = [floor_faint, floor_strong];
        // SAFETY: the processor has these instructions.
        match level {
            Level::Avx512 => {
                return unsafe { mark_block_avx512(picture, exposure_q15, background, noise, floors, magnitude, most) };
            }
            Level::Avx2 => {
                return unsafe { mark_block_avx2(picture, exposure_q15, background, noise, floors, magnitude, most) };
            }
            Level::Portable => {}
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = level;
    let (mut faint, mut strong) = ([0u8; BLOCK], [0u8; BLOCK]);
    for i in 0..BLOCK {
        let difference = expose(picture[i], exposure_q15).abs_diff(background[i]);
        let deviation = noise[i];
        let change = (difference >> 8) as u8;
        (magnitude[i], most[i]) = (change, most[i].max(change));
        faint[i] = if difference >= (deviation * 2).max(floor_faint) { u8::MAX } else { 0 };
        strong[i] = if difference >= (deviation * 5).max(floor_strong) { u8::MAX } else { 0 };
    }
    (bits_of(&faint), bits_of(&strong))
}

/// The same; a comparison's bits are its result here.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx2")]
#[inline]
fn mark_block_avx512(
    picture: &[u8; BLOCK],
    exposure_q15: u16,
    background: &[u16; BLOCK],
    noise: &[u16; BLOCK],
    floors: [u16; 2],
    magnitude: &mut [u8; BLOCK],
    most: &mut [u8; BLOCK],
) -> (u64, u64) {
    use std::arch::x86_64::*;

    use super::avx2::{load_bytes, store_bytes};
    use super::avx512::{difference, exposed, load_levels};
    let exposure = _mm512_set1_epi16(exposure_q15 as i16);
    let [floor_faint, floor_strong] = floors.map(|floor| _mm512_set1_epi16(floor as i16));
    let (background, noise) = (background.as_chunks::<32>().0, noise.as_chunks::<32>().0);
    let out = magnitude.as_chunks_mut::<32>().0.iter_mut().zip(most.as_chunks_mut::<32>().0);
    let (mut faint, mut strong) = (0, 0);
    for (k, (picture, (magnitude, most))) in picture.as_chunks::<32>().0.iter().zip(out).enumerate() {
        let now = exposed(load_bytes(picture), exposure);
        let (background, noise) = (load_levels(&background[k]), load_levels(&noise[k]));
        let difference = difference(now, background);
        let least = _mm512_max_epu16(_mm512_slli_epi16::<1>(noise), floor_faint);
        faint |= u64::from(_mm512_cmpge_epu16_mask(difference, least)) << (32 * k);
        let least = _mm512_max_epu16(_mm512_add_epi16(_mm512_slli_epi16::<2>(noise), noise), floor_strong);
        strong |= u64::from(_mm512_cmpge_epu16_mask(difference, least)) << (32 * k);
        let change = _mm512_cvtepi16_epi8(_mm512_srli_epi16::<8>(difference));
        store_bytes(magnitude, change);
        store_bytes(most, _mm256_max_epu8(load_bytes(most), change));
    }
    (faint, strong)
}

/// The same, in half as many instructions as the compiler finds.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn mark_block_avx2(
    picture: &[u8; BLOCK],
    exposure_q15: u16,
    background: &[u16; BLOCK],
    noise: &[u16; BLOCK],
    floors: [u16; 2],
    magnitude: &mut [u8; BLOCK],
    most: &mut [u8; BLOCK],
) -> (u64, u64) {
    use std::arch::x86_64::*;

    use super::avx2::{difference, exposed, in_order, load_bytes, load_levels, store_bytes};
    let exposure = _mm256_set1_epi16(exposure_q15 as i16);
    let [floor_faint, floor_strong] = floors.map(|floor| _mm256_set1_epi16(floor as i16));
    let zero = _mm256_setzero_si256();
    let reaches = |difference, least| _mm256_cmpeq_epi16(_mm256_subs_epu16(least, difference), zero);
    let one = |now, background: &[u16; 16], noise: &[u16; 16]| {
        let (background, noise) = (load_levels(background), load_levels(noise));
        let difference = difference(now, background);
        let faint = _mm256_max_epu16(_mm256_slli_epi16::<1>(noise), floor_faint);
        let strong = _mm256_max_epu16(_mm256_add_epi16(_mm256_slli_epi16::<2>(noise), noise), floor_strong);
        (_mm256_srli_epi16::<8>(difference), reaches(difference, faint), reaches(difference, strong))
    };
    let bits = |a, b| u64::from(_mm256_movemask_epi8(in_order(_mm256_packs_epi16(a, b))) as u32);
    let (background, noise) = (background.as_chunks::<16>().0, noise.as_chunks::<16>().0);
    let out = magnitude.as_chunks_mut::<32>().0.iter_mut().zip(most.as_chunks_mut::<32>().0);
    let (mut faint, mut strong) = (0, 0);
    for (k, (picture, (magnitude, most))) in picture.as_chunks::<32>().0.iter().zip(out).enumerate() {
        let [first, second] = exposed(load_bytes(picture), exposure);
        let (a, b) =
            (one(first, &background[2 * k], &noise[2 * k]), one(second, &background[2 * k + 1], &noise[2 * k + 1]));
        let change = in_order(_mm256_packus_epi16(a.0, b.0));
        store_bytes(magnitude, change);
        store_bytes(most, _mm256_max_epu8(load_bytes(most), change));
        faint |= bits(a.1, b.1) << (32 * k);
        strong |= bits(a.2, b.2) << (32 * k);
    }
    (faint, strong)
}

/// The second look of some pixels, see `background`.
#[derive(Debug, Clone, Copy)]
pub struct Layers<'a> {
    /// Level of the second look, 8.8 fixed point.
    pub second: &'a [u16],
    /// Marked where the second look was the background once.
    pub known: u64,
}

wide! {
/// The pixels of a block of at most 64 that show what was the background before.
pub fn known_look(picture: &[u8], exposure_q15: u16, noise: &[u16], layers: Layers<'_>) -> u64 {
    let (picture, noise, second) = (padded(picture), padded(noise), padded(layers.second));
    let mut same = [0u8; BLOCK];
    for i in 0..BLOCK {
        let near = expose(picture[i], exposure_q15).abs_diff(second[i]) < tolerance(noise[i]);
        same[i] = if near { u8::MAX } else { 0 };
    }
    bits_of(&same) & layers.known
}
}
