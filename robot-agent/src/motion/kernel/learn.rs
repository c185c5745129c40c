//! The background follows: level, noise, and the second look of each pixel.

use super::{bits_of, expose, tolerance, wide};

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
    /// 1 where the second look was the background once.
    pub second_is_known: &'a mut [u8],
}

/// Pixels that are looked at together.
const BLOCK: usize = 64;

wide! {
/// Counts which of its two looks each pixel shows, replaces a second look that is not seen any more, and makes the second
/// the background where it has been seen `lead` frames longer. Counts stop at `most`. Nothing happens where `how` is
/// [`KEEP`], unless `also_kept`. Whether any second look has become the background.
#[allow(clippy::too_many_arguments)]
pub fn count_looks(
    current: &[u8],
    exposure_q15: u16,
    how: &[u8],
    noise: &[u16],
    also_kept: bool,
    most: u8,
    lead: u8,
    looks: &mut Looks<'_>,
) -> bool {
    let counted = if also_kept { u8::MAX } else { KEEP };
    let mut exchanged = false;
    for start in (0..current.len()).step_by(BLOCK) {
        let block = start..(start + BLOCK).min(current.len());
        let (current, how, noise) = (&current[block.clone()], &how[block.clone()], &noise[block.clone()]);
        let (level, second) = (&mut looks.level[block.clone()], &mut looks.second[block.clone()]);
        let (seen, seen_second) = (&mut looks.seen[block.clone()], &mut looks.seen_second[block.clone()]);
        let known = &mut looks.second_is_known[block];
        // Nearly everywhere the background is seen: counted without a branch, and the block is done.
        let mut other = [0u8; BLOCK];
        if count_background(current, exposure_q15, how, noise, level, counted, most, seen, &mut other) == 0 {
            continue;
        }
        let mut left = bits_of(&other);
        while left != 0 {
            let i = left.trailing_zeros() as usize;
            left &= left - 1;
            let now = expose(current[i], exposure_q15);
            let tolerance = tolerance(noise[i]);
            if now.abs_diff(second[i]) < tolerance && seen_second[i] > 0 {
                seen_second[i] = seen_second[i].saturating_add(1).min(most);
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
                exchanged = true;
            }
        }
    }
    exchanged
}
}

/// Counts where the background is seen; `other` is 1 where something else is, the result not 0 if it is anywhere.
#[inline(always)]
#[allow(clippy::too_many_arguments)]
fn count_background(
    current: &[u8],
    exposure_q15: u16,
    how: &[u8],
    noise: &[u16],
    level: &[u16],
    counted: u8,
    most: u8,
    seen: &mut [u8],
    other: &mut [u8; BLOCK],
) -> u8 {
    let n = current.len().min(BLOCK);
    let (current, how, noise, level) = (&current[..n], &how[..n], &noise[..n], &level[..n]);
    let (seen, other) = (&mut seen[..n], &mut other[..n]);
    let mut any = 0u8;
    for i in 0..n {
        let same = u8::from(expose(current[i], exposure_q15).abs_diff(level[i]) < tolerance(noise[i]));
        let wanted = u8::from(how[i] < counted);
        seen[i] = seen[i].saturating_add(same & wanted).min(most);
        other[i] = (same ^ 1) & wanted;
        any |= other[i];
    }
    any
}
