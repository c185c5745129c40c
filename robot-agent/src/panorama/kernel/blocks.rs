//! How much blocks of a picture differ from what they were: sums of absolute differences.

use crate::motion::kernel::{self, wide};

/// Neighbouring pixels of a row.
pub(in super::super) type Segment = [u8; 16];

/// Segments of a block.
const SEGMENTS: usize = 8;
/// Lines ahead of those needed that are fetched into the cache: so many that memory is always busy, and so few that they stay there
/// until they are.
const AHEAD: usize = 256;

wide! {
/// The sum of absolute differences to its `reference` of each of some `blocks`; `places` are where a block's segments begin in the
/// picture. A place that is none differs as much as can be. The sums of other blocks stay. `lines` are where the lines of the cache
/// begin that these blocks need, in the order of blocks.
pub(in super::super) fn differences(
    picture: &[u8],
    places: &[[u32; SEGMENTS]],
    reference: &[[Segment; SEGMENTS]],
    blocks: &[u32],
    lines: &[u32],
    sums: &mut [u16],
) {
    let (first, mut later) = lines.split_at(AHEAD.min(lines.len()));
    kernel::fetch_far_lines(picture, first);
    // All blocks need about as many.
    let each = lines.len().div_ceil(blocks.len().max(1));
    for block in blocks {
        let (now, rest) = later.split_at(each.min(later.len()));
        kernel::fetch_far_lines(picture, now);
        later = rest;
        let block = *block as usize;
        if let (Some(places), Some(reference), Some(sum)) = (places.get(block), reference.get(block), sums.get_mut(block)) {
            *sum = difference(picture, places, reference);
        }
    }
}
}

/// Takes the picture's blocks as reference.
pub(in super::super) fn copy(picture: &[u8], places: &[[u32; SEGMENTS]], reference: &mut [[Segment; SEGMENTS]]) {
    for (places, reference) in places.iter().zip(reference) {
        for (place, then) in places.iter().zip(reference) {
            if let Some(now) = picture.get(*place as usize..).and_then(|pixels| pixels.first_chunk()) {
                *then = *now;
            }
        }
    }
}

#[inline(always)]
fn difference(picture: &[u8], places: &[u32; SEGMENTS], reference: &[Segment; SEGMENTS]) -> u16 {
    let segment = |place: u32| -> Option<&Segment> { picture.get(place as usize..)?.first_chunk() };
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::*;
        // SAFETY: every x86-64 processor has these instructions.
        let mut all = unsafe { _mm_setzero_si128() };
        for (place, then) in places.iter().zip(reference) {
            let now = segment(*place);
            // SAFETY: every x86-64 processor has these instructions; 16 bytes are read of 16.
            all = unsafe {
                let sums = match now {
                    Some(now) => {
                        _mm_sad_epu8(_mm_loadu_si128(now.as_ptr().cast()), _mm_loadu_si128(then.as_ptr().cast()))
                    }
                    None => _mm_set_epi64x(8 * 255, 8 * 255),
                };
                _mm_add_epi64(all, sums)
            };
        }
        // SAFETY: every x86-64 processor has these instructions.
        unsafe { (_mm_cvtsi128_si32(all) + _mm_extract_epi16::<4>(all)) as u16 }
    }
    #[cfg(not(target_arch = "x86_64"))]
    places
        .iter()
        .zip(reference)
        .map(|(place, then)| {
            let now = segment(*place);
            now.map_or(16 * 255, |now| now.iter().zip(then).map(|(a, b)| u16::from(a.abs_diff(*b))).sum())
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};

    use super::*;

    #[test]
    fn sums_are_those_of_pixels_one_by_one() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let mut random = || (0..4000).map(|_| (rng.next_u32() >> 24) as u8).collect::<Vec<u8>>();
        let (before, now) = (random(), random());
        let mut places = vec![[0u32; SEGMENTS]; 20];
        places.iter_mut().flatten().for_each(|place| *place = rng.next_u32() % 3984);
        let mut reference = vec![[[0; 16]; SEGMENTS]; 20];
        copy(&before, &places, &mut reference);
        let mut sums = vec![0; 20];
        let blocks: Vec<u32> = (0..20).filter(|block| block % 7 != 3).collect();
        differences(&now, &places, &reference, &blocks, &[0, 64, 128], &mut sums);
        for (block, (sum, places)) in sums.iter().zip(&places).enumerate() {
            if block % 7 == 3 {
                assert_eq!(*sum, 0);
                continue;
            }
            let pixels = places.iter().flat_map(|p| *p as usize..*p as usize + 16);
            let want: u32 = pixels.map(|i| u32::from(now[i].abs_diff(before[i]))).sum();
            assert_eq!(u32::from(*sum), want);
        }
    }
}
