//! The background follows: level, noise, and the second look of each pixel.

use super::{bits_of, expose, padded, tolerance, wide};

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
    for (b, known) in looks.known.iter_mut().enumerate() {
        let pixels = (b * BLOCK).min(current.len())..((b + 1) * BLOCK).min(current.len());
        let (current, how, noise) = (&current[pixels.clone()], &how[pixels.clone()], &noise[pixels.clone()]);
        let (level, seen) = (&mut looks.level[pixels.clone()], &mut looks.seen[pixels.clone()]);
        // Nearly everywhere the background is seen: counted, and the block is done.
        let mut other = [0u8; BLOCK];
        if !count_background(current, exposure_q15, how, noise, level, counting, seen, &mut other) {
            continue;
        }
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
        let (renewed, replaced) = count_others(&now, &padded(noise), &other, counting, &mut block);
        *known = (*known & !renewed) | replaced;
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

/// Counts where the background is seen; `other` is all ones where something else is. Whether it is anywhere.
#[inline(always)]
#[allow(clippy::too_many_arguments)]
fn count_background(
    current: &[u8],
    exposure_q15: u16,
    how: &[u8],
    noise: &[u16],
    level: &[u16],
    counting: Counting,
    seen: &mut [u8],
    other: &mut [u8; BLOCK],
) -> bool {
    let counted = if counting.also_kept { u8::MAX } else { KEEP };
    let n = current.len().min(BLOCK);
    let (current, how, noise, level) = (&current[..n], &how[..n], &noise[..n], &level[..n]);
    let (seen, other) = (&mut seen[..n], &mut other[..n]);
    let mut any = 0u8;
    for i in 0..n {
        let same = u8::from(expose(current[i], exposure_q15).abs_diff(level[i]) < tolerance(noise[i]));
        let wanted = u8::from(how[i] < counted);
        seen[i] = seen[i].saturating_add(same & wanted).min(counting.most);
        other[i] = 0u8.wrapping_sub((same ^ 1) & wanted);
        any |= other[i];
    }
    any != 0
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
        let down = count.saturating_sub(1);
        renewed[i] = if down == 0 { other[i] & !near[i] } else { 0 };
        let missed = if down == 0 { 1 } else { down };
        let count_now = if near[i] != 0 { count.saturating_add(1).min(counting.most) } else { missed };
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
