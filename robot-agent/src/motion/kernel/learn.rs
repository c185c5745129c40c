//! The background follows: level, noise, and the second look of each pixel.

use super::{Level, available, bits_of, expose, padded, tolerance, wide};

/// Learnt fully: nothing is there.
pub const LEARN: u8 = 0;
/// Something moves there that nobody follows: level and noise move by small steps. So leaves that never stand still
/// become noise, a drifting light is followed, and somebody who walks past leaves next to nothing.
pub const LEARN_SLOWLY: u8 = 1;
/// Somebody is there: nothing is learnt.
pub const KEEP: u8 = 2;

wide! {
/// Running average outside objects (`MATHS.md` §7.3) with a noise estimate beside it: where `how` is [`LEARN`],
/// b += ((c<<8) − b + (1<<(k−1))) >> k and noise += (|c − b| − noise) >> `k_noise`.
/// Where `how` is [`LEARN_SLOWLY`], both move by at most `small_step`. The noise stays below `most_noise` (at most [`super::NOISE_MAX`]).
#[allow(clippy::too_many_arguments)]
pub fn learn(
    current: &[u8],
    exposure_q15: u16,
    how: &[u8],
    k: u32,
    k_noise: u32,
    small_step: u8,
    most_noise: u16,
    background: &mut [u16],
    noise: &mut [u16],
) {
    let n = current.len();
    let (how, background, noise) = (&how[..n], &mut background[..n], &mut noise[..n]);
    #[cfg(target_arch = "x86_64")]
    if available() == Level::Avx2 && n >= WIDTH {
        let rate = Rate { k, k_noise, small_step, most_noise };
        let whole = n - n % WIDTH;
        let (level, deviation) = (background[..whole].as_chunks_mut().0, noise[..whole].as_chunks_mut().0);
        // SAFETY: the processor has these instructions.
        unsafe { learn_avx2(current.as_chunks().0, exposure_q15, how.as_chunks().0, &rate, level, deviation) };
        if whole < n {
            let (level, noise) = (&mut background[whole..], &mut noise[whole..]);
            learn_plain(&current[whole..], exposure_q15, &how[whole..], &rate, level, noise);
        }
        return;
    }
    learn_plain(current, exposure_q15, how, &Rate { k, k_noise, small_step, most_noise }, background, noise);
}
}

/// How fast [`learn`] learns.
struct Rate {
    k: u32,
    k_noise: u32,
    small_step: u8,
    most_noise: u16,
}

/// Pixels that AVX2 works on together.
const WIDTH: usize = 32;

#[inline(always)]
fn learn_plain(current: &[u8], exposure_q15: u16, how: &[u8], rate: &Rate, background: &mut [u16], noise: &mut [u16]) {
    let Rate { k, k_noise, small_step, most_noise } = *rate;
    let n = current.len();
    let (how, background, noise) = (&how[..n], &mut background[..n], &mut noise[..n]);
    let half = 1u16 << (k - 1);
    let half_noise = 1i16 << (k_noise - 1);
    for i in 0..n {
        // Up and down apart, so that 16 bits hold everything; one of the two is 0.
        let (now, level) = (expose(current[i], exposure_q15), background[i]);
        let (up, down) = (now.saturating_sub(level), level.saturating_sub(now));
        let slowly = u16::from(how[i] == LEARN).wrapping_sub(1); // all ones where slowly or not at all
        let limit = !slowly | u16::from(small_step);
        let at_all = u16::from(how[i] == KEEP).wrapping_sub(1); // all ones where at all
        let rise = (up.saturating_add(half) >> k).min(limit) & at_all;
        // ⌊(half − down) / 2ᵏ⌋ is −⌊(down + half − 1) / 2ᵏ⌋.
        let fall = (down.saturating_add(half - 1) >> k).min(limit) & at_all;
        background[i] = level.wrapping_add(rise).wrapping_sub(fall);
        let deviation = (up | down).min(4 * most_noise) as i16;
        let step = (deviation - noise[i] as i16 + half_noise) >> k_noise;
        let step = step.min(limit.min(i16::MAX as u16) as i16) & at_all as i16;
        noise[i] = ((noise[i] as i16 + step) as u16).min(most_noise);
    }
}

/// The same, in half as many instructions as the compiler finds.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn learn_avx2(
    current: &[[u8; WIDTH]],
    exposure_q15: u16,
    how: &[[u8; WIDTH]],
    rate: &Rate,
    background: &mut [[u16; WIDTH]],
    noise: &mut [[u16; WIDTH]],
) {
    use std::arch::x86_64::*;

    use super::avx2::{exposed, in_order, load_bytes, load_levels, store_levels};
    let exposure = _mm256_set1_epi16(exposure_q15 as i16);
    let whole = |v: u16| _mm256_set1_epi16(v as i16);
    let [shift, shift_noise] = [rate.k, rate.k_noise].map(|k| _mm_cvtsi32_si128(k as i32));
    let (half, half_noise) = (1u16 << (rate.k - 1), whole(1 << (rate.k_noise - 1)));
    let (half_up, half_down) = (whole(half), whole(half - 1));
    let (small, most, most_deviation) =
        (whole(rate.small_step.into()), whole(rate.most_noise), whole(4 * rate.most_noise));
    let one = |now, learnt, kept, level: &mut [u16; 16], noise: &mut [u16; 16]| {
        let (before, before_noise) = (load_levels(level), load_levels(noise));
        let (up, down) = (_mm256_subs_epu16(now, before), _mm256_subs_epu16(before, now));
        let limit = _mm256_or_si256(learnt, small);
        let rise = _mm256_min_epu16(_mm256_srl_epi16(_mm256_adds_epu16(up, half_up), shift), limit);
        let fall = _mm256_min_epu16(_mm256_srl_epi16(_mm256_adds_epu16(down, half_down), shift), limit);
        let step = _mm256_andnot_si256(kept, _mm256_sub_epi16(rise, fall));
        store_levels(level, _mm256_add_epi16(before, step));
        let deviation = _mm256_min_epu16(_mm256_or_si256(up, down), most_deviation);
        let step = _mm256_add_epi16(_mm256_sub_epi16(deviation, before_noise), half_noise);
        let limit = _mm256_min_epu16(limit, whole(i16::MAX as u16));
        let step = _mm256_min_epi16(_mm256_sra_epi16(step, shift_noise), limit);
        let after = _mm256_add_epi16(before_noise, _mm256_andnot_si256(kept, step));
        store_levels(noise, _mm256_min_epu16(after, most));
    };
    let (zero, kept) = (_mm256_setzero_si256(), _mm256_set1_epi8(KEEP as i8));
    let pixels = current.iter().zip(how).zip(background.iter_mut().zip(noise));
    for ((current, how), (level, noise)) in pixels {
        let [first, second] = exposed(load_bytes(current), exposure);
        let how = in_order(load_bytes(how));
        // Bytes doubled: all ones in 16 bits where learnt fully, where kept.
        let (learnt, kept) = (_mm256_cmpeq_epi8(how, zero), _mm256_cmpeq_epi8(how, kept));
        let ([level, level_later], [noise, noise_later]) = (level.as_chunks_mut().0, noise.as_chunks_mut().0) else {
            return;
        };
        one(first, _mm256_unpacklo_epi8(learnt, learnt), _mm256_unpacklo_epi8(kept, kept), level, noise);
        one(second, _mm256_unpackhi_epi8(learnt, learnt), _mm256_unpackhi_epi8(kept, kept), level_later, noise_later);
    }
}

/// The two looks of each pixel, and how often each was seen.
#[derive(Debug)]
pub struct Looks<'a> {
    /// The background, 8.8 fixed point.
    pub level: &'a mut [u16],
    /// What else is seen there, 8.8 fixed point.
    pub second: &'a mut [u16],
    /// How often the background was seen.
    pub seen: &'a mut [u8],
    /// How often the second look was.
    pub seen_second: &'a mut [u8],
    /// Marked where the second look was the background once, 64 pixels a word.
    pub known: &'a mut [u64],
}

/// Pixels that are looked at together.
const BLOCK: usize = 64;

/// How looks are counted.
#[derive(Debug, Clone, Copy)]
pub struct Counting {
    /// Also where `how` is [`KEEP`].
    pub also_kept: bool,
    /// Where counts stop.
    pub most: u8,
    /// So much longer must the second look have been seen to become the background.
    pub lead: u8,
    /// What being seen now counts for.
    pub weight: u8,
}

wide! {
/// Counts which of its two looks each pixel shows, replaces a second look that is not seen any more, and makes the second
/// the background where it has been seen `lead` frames longer. Nothing happens where `how` is [`KEEP`], unless `also_kept`.
/// Whether any second look has become the background.
pub fn count_looks(
    current: &[u8],
    exposure_q15: u16,
    how: &[u8],
    noise: &[u16],
    counting: Counting,
    looks: &mut Looks<'_>,
) -> bool {
    let mut exchanged = false;
    for b in 0..looks.known.len() {
        let pixels = (b * BLOCK).min(current.len())..((b + 1) * BLOCK).min(current.len());
        let (current, how, noise) = (&current[pixels.clone()], &how[pixels.clone()], &noise[pixels.clone()]);
        let (level, seen) = (&mut looks.level[pixels.clone()], &mut looks.seen[pixels.clone()]);
        // Nearly everywhere the background is seen: counted, and the block is done.
        let whole = (current.first_chunk(), how.first_chunk(), noise.first_chunk(), level.first_chunk());
        let others = match (whole, seen.first_chunk_mut()) {
            ((Some(current), Some(how), Some(noise), Some(level)), Some(seen)) => {
                count_background(current, exposure_q15, how, noise, level, counting, seen)
            }
            _ => {
                let (how, noise, level, mut counts) = (padded(how), padded(noise), padded(level), padded(seen));
                let current = padded(current);
                let others = count_background(&current, exposure_q15, &how, &noise, &level, counting, &mut counts);
                seen.copy_from_slice(&counts[..seen.len()]);
                others & ((1 << seen.len()) - 1)
            }
        };
        if others.count_ones() <= FEW {
            exchanged |= count_few(current, exposure_q15, noise, others, counting, looks, b);
            continue;
        }
        let (level, seen) = (&mut looks.level[pixels.clone()], &mut looks.seen[pixels.clone()]);
        let (second, seen_second) = (&mut looks.second[pixels.clone()], &mut looks.seen_second[pixels]);
        let mut now = [0; BLOCK];
        for (now, c) in now.iter_mut().zip(padded(current)) {
            *now = expose(c, exposure_q15);
        }
        let mut block = Block {
            level: padded(level),
            second: padded(second),
            seen: padded(seen),
            seen_second: padded(seen_second),
        };
        let other = std::array::from_fn(|i| if others >> i & 1 != 0 { u8::MAX } else { 0 });
        let (renewed, replaced) = count_others(&now, &padded(noise), &other, counting, &mut block);
        looks.known[b] = (looks.known[b] & !renewed) | replaced;
        exchanged |= replaced != 0;
        let n = level.len();
        level.copy_from_slice(&block.level[..n]);
        second.copy_from_slice(&block.second[..n]);
        seen.copy_from_slice(&block.seen[..n]);
        seen_second.copy_from_slice(&block.seen_second[..n]);
    }
    exchanged
}
}

/// So few pixels of a block that show something else are counted one by one.
const FEW: u32 = 6;

/// Counts the pixels of block `b` whose bits are set in `others`. Whether any second look has become the background.
fn count_few(
    current: &[u8],
    exposure_q15: u16,
    noise: &[u16],
    mut others: u64,
    counting: Counting,
    looks: &mut Looks<'_>,
    b: usize,
) -> bool {
    let mut exchanged = false;
    while others != 0 {
        let bit = others.trailing_zeros() as usize;
        others &= others - 1;
        let (i, now) = (b * BLOCK + bit, expose(current[bit], exposure_q15));
        let (level, second, count, seen) = (looks.level[i], looks.second[i], looks.seen_second[i], looks.seen[i]);
        let near = count > 0 && now.abs_diff(second) < tolerance(noise[bit]);
        let renewed = count <= counting.weight && !near;
        let count_now = if near {
            count.saturating_add(counting.weight).min(counting.most)
        } else {
            count.saturating_sub(counting.weight).max(1)
        };
        let replaced = count_now > seen.saturating_add(counting.lead) || count_now == counting.most;
        let moved = second.wrapping_add(((now.wrapping_sub(second) as i16) >> 3) as u16);
        let second_now = if renewed {
            now
        } else if near {
            moved
        } else {
            second
        };
        looks.known[b] = (looks.known[b] & !(u64::from(renewed) << bit)) | u64::from(replaced) << bit;
        if replaced {
            (looks.level[i], looks.second[i]) = (second_now, level);
            (looks.seen[i], looks.seen_second[i]) = (count_now, seen.min(counting.most / 2));
        } else {
            (looks.second[i], looks.seen_second[i]) = (second_now, count_now);
        }
        exchanged |= replaced;
    }
    exchanged
}

/// Counts where the background is seen; marks where something else is.
#[inline(always)]
fn count_background(
    current: &[u8; BLOCK],
    exposure_q15: u16,
    how: &[u8; BLOCK],
    noise: &[u16; BLOCK],
    level: &[u16; BLOCK],
    counting: Counting,
    seen: &mut [u8; BLOCK],
) -> u64 {
    #[cfg(target_arch = "x86_64")]
    // SAFETY: the processor has these instructions.
    match available() {
        Level::Avx512 => {
            return unsafe { count_background_avx512(current, exposure_q15, how, noise, level, counting, seen) };
        }
        Level::Avx2 => {
            return unsafe { count_background_avx2(current, exposure_q15, how, noise, level, counting, seen) };
        }
        Level::Portable => {}
    }
    let counted = if counting.also_kept { u8::MAX } else { KEEP };
    let mut near = [0u8; BLOCK];
    for i in 0..BLOCK {
        let same = expose(current[i], exposure_q15).abs_diff(level[i]) < tolerance(noise[i]);
        near[i] = if same { u8::MAX } else { 0 };
    }
    let mut other = [0u8; BLOCK];
    for i in 0..BLOCK {
        let wanted = if how[i] < counted { u8::MAX } else { 0 };
        seen[i] = seen[i].saturating_add(near[i] & wanted & counting.weight).min(counting.most);
        other[i] = !near[i] & wanted;
    }
    bits_of(&other)
}

/// The same; a comparison's bits are its result here.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx2")]
#[inline]
fn count_background_avx512(
    current: &[u8; BLOCK],
    exposure_q15: u16,
    how: &[u8; BLOCK],
    noise: &[u16; BLOCK],
    level: &[u16; BLOCK],
    counting: Counting,
    seen: &mut [u8; BLOCK],
) -> u64 {
    use std::arch::x86_64::*;

    use super::avx2::load_bytes;
    use super::avx512::{difference, exposed, load_block, load_levels};
    let exposure = _mm512_set1_epi16(exposure_q15 as i16);
    let (noise, level) = (noise.as_chunks::<WIDTH>().0, level.as_chunks::<WIDTH>().0);
    let mut far = 0;
    for (k, current) in current.as_chunks::<WIDTH>().0.iter().enumerate() {
        let (now, level) = (exposed(load_bytes(current), exposure), load_levels(&level[k]));
        let tolerance = _mm512_max_epu16(_mm512_slli_epi16::<2>(load_levels(&noise[k])), _mm512_set1_epi16(1024));
        far |= u64::from(_mm512_cmpge_epu16_mask(difference(now, level), tolerance)) << (WIDTH * k);
    }
    let counted = _mm512_set1_epi8(if counting.also_kept { u8::MAX } else { KEEP } as i8);
    let wanted = _mm512_cmplt_epu8_mask(load_block(how), counted);
    let (weight, most) = (_mm512_set1_epi8(counting.weight as i8), _mm512_set1_epi8(counting.most as i8));
    let before = load_block(seen);
    let now = _mm512_mask_adds_epu8(before, wanted & !far, before, weight);
    // SAFETY: 64 bytes are written of 64; the pointer need not be aligned.
    unsafe { _mm512_storeu_si512(seen.as_mut_ptr().cast(), _mm512_min_epu8(now, most)) };
    wanted & far
}

/// The same.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn count_background_avx2(
    current: &[u8; BLOCK],
    exposure_q15: u16,
    how: &[u8; BLOCK],
    noise: &[u16; BLOCK],
    level: &[u16; BLOCK],
    counting: Counting,
    seen: &mut [u8; BLOCK],
) -> u64 {
    use std::arch::x86_64::*;

    use super::avx2::{difference, exposed, in_order, load_bytes, load_levels, store_bytes};
    let (exposure, zero) = (_mm256_set1_epi16(exposure_q15 as i16), _mm256_setzero_si256());
    // All ones where it is another look.
    let far = |now, noise: &[u16; 16], level: &[u16; 16]| {
        let (tolerance, level) = (_mm256_slli_epi16::<2>(load_levels(noise)), load_levels(level));
        let tolerance = _mm256_max_epu16(tolerance, _mm256_set1_epi16(1024));
        _mm256_cmpeq_epi16(_mm256_subs_epu16(tolerance, difference(now, level)), zero)
    };
    let kept = _mm256_set1_epi8(if counting.also_kept { -1 } else { KEEP as i8 });
    let (weight, most) = (_mm256_set1_epi8(counting.weight as i8), _mm256_set1_epi8(counting.most as i8));
    let (noise, level) = (noise.as_chunks::<16>().0, level.as_chunks::<16>().0);
    let mut others = 0;
    let pixels = current.as_chunks::<WIDTH>().0.iter().zip(how.as_chunks::<WIDTH>().0);
    for (k, ((current, how), seen)) in pixels.zip(seen.as_chunks_mut::<WIDTH>().0).enumerate() {
        let [first, second] = exposed(load_bytes(current), exposure);
        let first = far(first, &noise[2 * k], &level[2 * k]);
        let second = far(second, &noise[2 * k + 1], &level[2 * k + 1]);
        let far = in_order(_mm256_packs_epi16(first, second));
        // Where it is not counted the look counts as neither.
        let not_counted = _mm256_cmpeq_epi8(load_bytes(how), kept);
        let same = _mm256_andnot_si256(_mm256_or_si256(far, not_counted), weight);
        store_bytes(seen, _mm256_min_epu8(_mm256_adds_epu8(load_bytes(seen), same), most));
        let other = _mm256_movemask_epi8(_mm256_andnot_si256(not_counted, far));
        others |= u64::from(other as u32) << (WIDTH * k);
    }
    others
}

/// A block of pixels in registers.
struct Block {
    level: [u16; BLOCK],
    second: [u16; BLOCK],
    seen: [u8; BLOCK],
    seen_second: [u8; BLOCK],
}

/// Counts where `other` is all ones and 0 elsewhere. Marks where the second look is a new one, and where it has changed places
/// with the background.
#[inline(always)]
fn count_others(
    now: &[u16; BLOCK],
    noise: &[u16; BLOCK],
    other: &[u8; BLOCK],
    counting: Counting,
    block: &mut Block,
) -> (u64, u64) {
    let (mut near, mut renewed, mut replaced) = ([0u8; BLOCK], [0u8; BLOCK], [0u8; BLOCK]);
    for i in 0..BLOCK {
        near[i] = if now[i].abs_diff(block.second[i]) < tolerance(noise[i]) { other[i] } else { 0 };
    }
    for i in 0..BLOCK {
        let count = block.seen_second[i];
        near[i] = if count > 0 { near[i] } else { 0 };
        let down = count.saturating_sub(counting.weight);
        renewed[i] = if down == 0 { other[i] & !near[i] } else { 0 };
        let missed = if down == 0 { 1 } else { down };
        let count_now = if near[i] != 0 { count.saturating_add(counting.weight).min(counting.most) } else { missed };
        let seen = block.seen[i];
        let longer = (count_now > seen.saturating_add(counting.lead)) | (count_now == counting.most);
        replaced[i] = if longer { other[i] } else { 0 };
        block.seen[i] = if replaced[i] != 0 { count_now } else { seen };
        let kept = if replaced[i] != 0 { seen.min(counting.most / 2) } else { count_now };
        block.seen_second[i] = if other[i] != 0 { kept } else { count };
    }
    for i in 0..BLOCK {
        let (level, second) = (block.level[i], block.second[i]);
        // Near looks differ by less than 2¹⁵.
        let step = (now[i].wrapping_sub(second) as i16) >> 3;
        let moved = if near[i] != 0 { second.wrapping_add(step as u16) } else { second };
        let second_now = if renewed[i] != 0 { now[i] } else { moved };
        block.level[i] = if replaced[i] != 0 { second_now } else { level };
        block.second[i] = if replaced[i] != 0 { level } else { second_now };
    }
    (bits_of(&renewed), bits_of(&replaced))
}
