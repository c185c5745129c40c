//! The loops over pixels: plain functions over slices whose lengths the caller has made equal. Written so that the
//! compiler vectorises them: no branches on data, no allocation, one element of each slice a step.

/// The noise estimate saturates here (8.8 fixed point: 6.6 grey levels of mean deviation), so that thresholds stay in 16 bits.
pub const NOISE_MAX: u16 = 1700;

/// Marks pixels that differ from the background: `faint` where |C − B| ≥ max(`floor_faint`, 1.6 σ), `strong` where
/// |C − B| ≥ max(`floor_strong`, 4 σ) (`MATHS.md` §7.4), C brought to the background's exposure by `exposure_q15` / 32768. Background, noise (mean absolute deviation, σ = 1.25 noise) and
/// floors are 8.8 fixed point; `magnitude` is |C − B| in whole grey levels; 1 marks, 0 does not; pixels with `valid` 0 are never marked (`valid` is 0 or 1).
#[allow(clippy::too_many_arguments)]
pub fn mark_changes(
    current: &[u8],
    exposure_q15: u16,
    background: &[u16],
    noise: &[u16],
    valid: &[u8],
    floor_faint: u16,
    floor_strong: u16,
    magnitude: &mut [u8],
    faint: &mut [u8],
    strong: &mut [u8],
) {
    let n = current.len();
    let (background, noise, valid) = (&background[..n], &noise[..n], &valid[..n]);
    let (magnitude, faint, strong) = (&mut magnitude[..n], &mut faint[..n], &mut strong[..n]);
    for i in 0..n {
        let difference = expose(current[i], exposure_q15).abs_diff(background[i]);
        let deviation = noise[i];
        magnitude[i] = (difference >> 8) as u8;
        faint[i] = u8::from(difference >= (deviation * 2).max(floor_faint)) & valid[i];
        strong[i] = u8::from(difference >= (deviation * 5).max(floor_strong)) & valid[i];
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

/// How near a level must be to be the same look: 3.2 σ, at least four grey levels.
#[inline(always)]
fn tolerance(noise: u16) -> u16 {
    (noise * 4).max(1024)
}

/// Takes away marks where the picture shows what was the background before.
pub fn forgive_known(
    current: &[u8],
    exposure_q15: u16,
    noise: &[u16],
    layers: Layers<'_>,
    faint: &mut [u8],
    strong: &mut [u8],
) {
    let n = current.len();
    let (noise, second, known) = (&noise[..n], &layers.second[..n], &layers.second_is_known[..n]);
    let (faint, strong) = (&mut faint[..n], &mut strong[..n]);
    for i in 0..n {
        let same = expose(current[i], exposure_q15).abs_diff(second[i]) < tolerance(noise[i]);
        let keep = !(u8::from(same) & known[i]) & 1;
        faint[i] &= keep;
        strong[i] &= keep;
    }
}

/// Counts which of its two looks each pixel shows, replaces a second look that is not seen any more, and makes the second
/// the background where it has been seen `lead` frames longer. Counts stop at `most`. Nothing happens where `how` is
/// [`KEEP`], unless `also_kept`.
#[allow(clippy::too_many_arguments)]
pub fn count_looks(
    current: &[u8],
    exposure_q15: u16,
    how: &[u8],
    noise: &[u16],
    also_kept: bool,
    most: u8,
    lead: u8,
    level: &mut [u16],
    second: &mut [u16],
    seen: &mut [u8],
    seen_second: &mut [u8],
    second_is_known: &mut [u8],
) {
    let n = current.len();
    let (how, noise, level, second) = (&how[..n], &noise[..n], &mut level[..n], &mut second[..n]);
    let (seen, seen_second, known) = (&mut seen[..n], &mut seen_second[..n], &mut second_is_known[..n]);
    for i in 0..n {
        if how[i] == KEEP && !also_kept {
            continue;
        }
        let now = expose(current[i], exposure_q15);
        let tolerance = tolerance(noise[i]);
        if now.abs_diff(level[i]) < tolerance {
            seen[i] = (seen[i] + 1).min(most);
            continue;
        }
        if now.abs_diff(second[i]) < tolerance && seen_second[i] > 0 {
            seen_second[i] = (seen_second[i] + 1).min(most);
            let step = (i32::from(now) - i32::from(second[i])) >> 3;
            second[i] = (i32::from(second[i]) + step) as u16;
        } else {
            seen_second[i] = seen_second[i].saturating_sub(1);
            if seen_second[i] == 0 {
                (second[i], seen_second[i], known[i]) = (now, 1, 0);
            }
        }
        if seen_second[i] > seen[i].saturating_add(lead) || seen_second[i] == most {
            std::mem::swap(&mut level[i], &mut second[i]);
            std::mem::swap(&mut seen[i], &mut seen_second[i]);
            seen_second[i] = seen_second[i].min(most / 2);
            known[i] = 1;
        }
    }
}

/// |a − b| ≥ `threshold` as 0 or 1 (6-1).
pub fn mark_difference(a: &[u8], b: &[u8], threshold: u8, out: &mut [u8]) {
    let n = a.len();
    let (b, out) = (&b[..n], &mut out[..n]);
    for i in 0..n {
        out[i] = u8::from(a[i].abs_diff(b[i]) >= threshold);
    }
}

/// A grey level in 8.8 fixed point times a factor (32768 is 1), saturating. Exact for a factor of 1.
#[inline(always)]
fn expose(level: u8, exposure_q15: u16) -> u16 {
    let half = ((u32::from(level) << 8) * u32::from(exposure_q15)) >> 16;
    (half.min(32767) as u16) << 1
}

/// Learnt fully: nothing is there.
pub const LEARN: u8 = 0;
/// Something moves there that nobody follows: level and noise move by small steps. So leaves that never stand still
/// become noise, a drifting light is followed, and somebody who walks past leaves next to nothing.
pub const LEARN_SLOWLY: u8 = 1;
/// Somebody is there: nothing is learnt.
pub const KEEP: u8 = 2;

/// Running average outside objects (`MATHS.md` §7.3) with a noise estimate beside it: where `how` is [`LEARN`],
/// b += ((c<<8) − b + (1<<(k−1))) >> k and noise += (|c − b| − noise) >> `k_noise`.
/// Where `how` is [`LEARN_SLOWLY`], both move by at most `small_step`.
#[allow(clippy::too_many_arguments)]
pub fn learn(
    current: &[u8],
    exposure_q15: u16,
    how: &[u8],
    k: u32,
    k_noise: u32,
    small_step: u8,
    background: &mut [u16],
    noise: &mut [u16],
) {
    let small_step = i32::from(small_step);
    let n = current.len();
    let (how, background, noise) = (&how[..n], &mut background[..n], &mut noise[..n]);
    let half = 1i32 << (k - 1);
    let half_noise = 1i32 << (k_noise - 1);
    for i in 0..n {
        let difference = i32::from(expose(current[i], exposure_q15)) - i32::from(background[i]);
        let fully = i32::from(how[i] != LEARN) - 1; // all ones where true
        let at_all = i32::from(how[i] == KEEP) - 1;
        let limit = small_step | (fully & 0xffff);
        let step = ((difference + half) >> k).clamp(-limit, limit) & at_all;
        background[i] = (i32::from(background[i]) + step) as u16;
        let deviation = difference.abs().min(4 * i32::from(NOISE_MAX));
        let step = (deviation - i32::from(noise[i]) + half_noise) >> k_noise;
        let step = step.min(limit) & at_all;
        noise[i] = (i32::from(noise[i]) + step).min(i32::from(NOISE_MAX)) as u16;
    }
}

/// `most[i]` = the larger of both.
pub fn raise(values: &[u8], most: &mut [u8]) {
    for (m, &v) in most.iter_mut().zip(values) {
        *m = (*m).max(v);
    }
}

/// Takes away marks where `values` is below `least`.
pub fn keep_at_least(values: &[u8], least: &[u8], marks: &mut [u8]) {
    for ((m, &v), &l) in marks.iter_mut().zip(values).zip(least) {
        *m &= u8::from(v >= l);
    }
}

/// One row of sums down the columns: `sums += enter − leave`.
pub fn slide_column_sums(enter: &[u8], leave: &[u8], sums: &mut [u8]) {
    let n = sums.len();
    let (enter, leave) = (&enter[..n], &leave[..n]);
    for i in 0..n {
        sums[i] = sums[i].wrapping_add(enter[i]).wrapping_sub(leave[i]);
    }
}

/// `out[i]` = 1 where the sum of `padded[i ..= i + 2·reach]` is at least `need[i]`; `padded` has `2·reach` more elements.
pub fn threshold_row_sums(padded: &[u8], reach: usize, need: &[u8], out: &mut [u8]) {
    let n = out.len();
    let need = &need[..n];
    match reach {
        2 => {
            let p = &padded[..n + 4];
            for i in 0..n {
                let sum = p[i] + p[i + 1] + p[i + 2] + p[i + 3] + p[i + 4];
                out[i] = u8::from(sum >= need[i]);
            }
        }
        _ => {
            for i in 0..n {
                let sum: u8 = padded[i..=i + 2 * reach].iter().sum();
                out[i] = u8::from(sum >= need[i]);
            }
        }
    }
}

/// Number of ones.
pub fn count_ones(marks: &[u8]) -> usize {
    marks.chunks(255).map(|c| usize::from(c.iter().sum::<u8>())).sum()
}

/// Exact medians of columns of a stack (`MATHS.md` §7.2): `frames[f][i]` over f; even counts give (lower + upper + 1) >> 1.
/// Batcher's sorting network on blocks of 64 pixels: minima and maxima of whole vectors, no branch on data.
pub fn median(frames: &[&[u8]], out: &mut [u8]) {
    const BLOCK: usize = 64;
    let n = frames.len();
    if n == 0 {
        return;
    }
    let mut block = vec![[0u8; BLOCK]; n];
    for (b, out) in out.chunks_mut(BLOCK).enumerate() {
        for (row, frame) in block.iter_mut().zip(frames) {
            row[..out.len()].copy_from_slice(&frame[b * BLOCK..b * BLOCK + out.len()]);
        }
        sort_rows(&mut block);
        if n % 2 == 1 {
            out.copy_from_slice(&block[n / 2][..out.len()]);
        } else {
            let (lower, upper) = (&block[n / 2 - 1], &block[n / 2]);
            for (i, o) in out.iter_mut().enumerate() {
                *o = ((u16::from(lower[i]) + u16::from(upper[i]) + 1) >> 1) as u8;
            }
        }
    }
}

/// Batcher's odd–even merge sort for any number of rows (Knuth, TAOCP 3, algorithm 5.2.2M).
fn sort_rows<const B: usize>(rows: &mut [[u8; B]]) {
    let n = rows.len();
    if n < 2 {
        return;
    }
    let top = n.next_power_of_two() / 2;
    let mut p = top;
    while p > 0 {
        let (mut q, mut r, mut d) = (top, 0, p);
        loop {
            for i in 0..n - d {
                if i & p == r {
                    let (head, tail) = rows.split_at_mut(i + d);
                    let (low, high) = (&mut head[i], &mut tail[0]);
                    for k in 0..B {
                        let (a, b) = (low[k], high[k]);
                        low[k] = a.min(b);
                        high[k] = a.max(b);
                    }
                }
            }
            if q == p {
                break;
            }
            d = q - p;
            q /= 2;
            r = p;
        }
        p /= 2;
    }
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};

    use super::*;

    #[test]
    fn the_network_median_equals_the_sorted_median_for_every_count() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        for n in 1..40usize {
            let frames: Vec<Vec<u8>> =
                (0..n).map(|_| (0..150).map(|_| (rng.next_u32() >> 24) as u8).collect()).collect();
            let mut out = vec![0; 150];
            median(&frames.iter().map(Vec::as_slice).collect::<Vec<_>>(), &mut out);
            for i in 0..150 {
                let mut column: Vec<u16> = frames.iter().map(|f| u16::from(f[i])).collect();
                column.sort_unstable();
                let want = if n % 2 == 1 { column[n / 2] } else { (column[n / 2 - 1] + column[n / 2] + 1) >> 1 };
                assert_eq!(u16::from(out[i]), want, "{n} frames");
            }
        }
    }
}
