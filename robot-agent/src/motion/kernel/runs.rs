//! Loops over the pixels of a region: one call for all of its runs. These are short, so each is worked in blocks of 64 pixels; those
//! beyond its end are read where there are any, and do not count.

use std::ops::Range;

use super::{Level, available, bits_of, padded, wide};
#[cfg(target_arch = "x86_64")]
use super::{narrow, narrow_avx2};
use crate::motion::regions::Run;

/// Pixels that are worked together.
pub const BLOCK: usize = 64;

/// Pixels of a picture from place `at` on; zeros beyond its end, in `space`.
#[inline(always)]
fn block<'a, T: Copy + Default>(values: &'a [T], at: usize, space: &'a mut [T; BLOCK]) -> &'a [T; BLOCK] {
    let values = values.get(at..).unwrap_or(&[]);
    values.first_chunk().unwrap_or_else(|| pad(values, space))
}

#[cold]
#[inline(never)]
fn pad_before<'a>(values: &[u8], missing: usize, space: &'a mut [u8; BLOCK]) -> &'a [u8; BLOCK] {
    let there = values.len().min(BLOCK.saturating_sub(missing));
    space[BLOCK.min(missing)..][..there].copy_from_slice(&values[..there]);
    space
}

#[cold]
#[inline(never)]
fn pad<'a, T: Copy + Default>(values: &[T], space: &'a mut [T; BLOCK]) -> &'a [T; BLOCK] {
    *space = padded(values);
    space
}

/// The lowest `n` bits.
#[inline(always)]
pub(super) fn lowest(n: usize) -> u64 {
    if n >= BLOCK { u64::MAX } else { (1 << n) - 1 }
}

/// Calls `f` with each block of a run: the place of its first pixel, counted in the run too, and how many of it belong to the run.
#[inline(always)]
fn for_blocks(run: &Run, width: usize, mut f: impl FnMut(usize, usize, usize)) {
    let (first, len) = (run.row as usize * width + run.start as usize, run.len as usize);
    let mut done = 0;
    while done < len {
        f(first + done, done, (len - done).min(BLOCK));
        done += BLOCK;
    }
}

/// Calls `f` with the pixels of each block of columns that a run has a part in, counted from column `start` of a ring of `width`: the
/// block's first column, its pixels, and 255 where they belong to the run. Blocks of all runs lie one below the other, so that sums
/// over them are kept at places of their own.
#[inline(always)]
fn for_columns(
    run: &Run,
    width: usize,
    start: usize,
    values: &[u8],
    mut f: impl FnMut(usize, &[u8; BLOCK], &[u8; BLOCK]),
) {
    let (first, len) = (run.offset(start, width), run.len as usize);
    let mut column = first / BLOCK * BLOCK;
    while column < first + len {
        let from = first.saturating_sub(column);
        let n = (first + len - column).min(BLOCK) - from;
        let mut inside = [0u8; BLOCK];
        for (i, inside) in inside.iter_mut().enumerate() {
            *inside = if (i as u8).wrapping_sub(from as u8) < n as u8 { u8::MAX } else { 0 };
        }
        let at = (run.row as usize * width + run.start as usize + column).checked_sub(first);
        let mut space = [0; BLOCK];
        let pixels = match at {
            Some(at) => block(values, at, &mut space),
            // Before the picture's first pixel there are none.
            None => pad_before(values, (first - column).saturating_sub(run.start as usize), &mut space),
        };
        f(column, pixels, &inside);
        column += BLOCK;
    }
}

wide! {
/// How many pixels of a region differ by `threshold` or more in two pictures of rows of `width` pixels (6-1). Counts on until there
/// are `enough`.
pub fn count_differences(runs: &[Run], width: usize, a: &[u8], b: &[u8], threshold: u8, enough: usize) -> usize {
    let mut count = 0;
    for run in runs {
        for_blocks(run, width, |at, _, n| {
            let (mut a_end, mut b_end) = ([0; BLOCK], [0; BLOCK]);
            let (a, b) = (block(a, at, &mut a_end), block(b, at, &mut b_end));
            let mut differ = [0u8; BLOCK];
            for i in 0..BLOCK {
                differ[i] = if a[i].abs_diff(b[i]) >= threshold { u8::MAX } else { 0 };
            }
            count += (bits_of(&differ) & lowest(n)).count_ones() as usize;
        });
        if count >= enough {
            break;
        }
    }
    count
}
}

wide! {
/// How many pixels of a region are anything but the background (8.8 fixed point) darkened by less than half. Counts on until there
/// are `enough`.
pub fn count_not_darker(runs: &[Run], width: usize, picture: &[u8], background: &[u16], enough: usize) -> usize {
    let mut count = 0;
    for run in runs {
        for_blocks(run, width, |at, _, n| {
            let (mut picture_end, mut background_end) = ([0; BLOCK], [0; BLOCK]);
            let (picture, background) =
                (block(picture, at, &mut picture_end), block(background, at, &mut background_end));
            let mut darker = [0u8; BLOCK];
            for i in 0..BLOCK {
                let half = u16::from(picture[i]) << 7;
                darker[i] = if (half < background[i] >> 1) & (half > background[i] >> 2) { u8::MAX } else { 0 };
            }
            count += (!bits_of(&darker) & lowest(n)).count_ones() as usize;
        });
        if count >= enough {
            break;
        }
    }
    count
}
}

wide! {
/// Adds a region's `values`, at least `least` and at most `most` each, to the sums of its columns, of which column `start` of a
/// ring of `width` is the first. `sums` has at least [`BLOCK`] more than the region has columns.
pub fn add_to_columns(runs: &[Run], width: usize, start: usize, values: &[u8], least: u8, most: u8, sums: &mut [u32]) {
    #[cfg(target_arch = "x86_64")]
    if sums.len() <= 2 * BLOCK && let Some(sums) = sums.first_chunk_mut() {
        let limits = [least, most];
        match available() {
            // SAFETY: the processor has these instructions.
            Level::Avx512 => return unsafe { narrow::add_to_columns(runs, width, start, values, limits, sums) },
            // SAFETY: as above.
            Level::Avx2 => return unsafe { narrow_avx2::add_to_columns(runs, width, start, values, limits, sums) },
            Level::Portable => {}
        }
    }
    for run in runs {
        for_columns(run, width, start, values, |column, values, inside| {
            let Some(sums) = sums.get_mut(column..).and_then(|sums| sums.first_chunk_mut::<BLOCK>()) else { return };
            for i in 0..BLOCK {
                sums[i] = sums[i].wrapping_add(u32::from(values[i].max(least).min(most) & inside[i]));
            }
        });
    }
}
}

wide! {
/// Adds a region's `values`, at most `most` each, to the sums of its rows, of which `first_row` is the first, and counts them. Only
/// those in some `columns` of a ring of `width`, counted from column `start`.
#[allow(clippy::too_many_arguments)]
pub fn add_to_rows(
    runs: &[Run],
    width: usize,
    start: usize,
    columns: &Range<usize>,
    first_row: usize,
    values: &[u8],
    most: u8,
    rows: &mut [(u32, u32)],
) {
    let level = available();
    for run in runs {
        let first = run.offset(start, width);
        let (from, end) = (first.max(columns.start), (first + run.len as usize).min(columns.end));
        let mut sum = 0u32;
        let inner = Run { row: run.row, start: run.start + (from - first) as u32, len: end.saturating_sub(from) as u32 };
        let place = inner.row as usize * width + inner.start as usize;
        let (mut done, mut space) = (0, [0; BLOCK]);
        while done < inner.len as usize {
            let values = block(values, place + done, &mut space);
            let n = (inner.len as usize - done).min(BLOCK);
            sum = sum.wrapping_add(sum_of_first(level, values, n, most));
            done += BLOCK;
        }
        if let Some((all, n)) = rows.get_mut((run.row as usize).wrapping_sub(first_row)) {
            *all = all.wrapping_add(sum);
            *n = n.wrapping_add(inner.len);
        }
    }
}
}

/// The sum of the first `n` values, at most `most` each.
#[inline(always)]
fn sum_of_first(level: Level, values: &[u8; BLOCK], n: usize, most: u8) -> u32 {
    #[cfg(target_arch = "x86_64")]
    match level {
        // SAFETY: the processor has these instructions.
        Level::Avx512 => return unsafe { narrow::sum_of_first(values, n, most) },
        // SAFETY: as above.
        Level::Avx2 => return unsafe { narrow_avx2::sum_of_first(values, n, most) },
        Level::Portable => {}
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = level;
    let mut sum = 0u32;
    for (i, value) in values.iter().enumerate() {
        sum = sum.wrapping_add(u32::from(if i < n { (*value).min(most) } else { 0 }));
    }
    sum
}

wide! {
/// Adds a region's pixels to the sums of the cells that its `columns` columns from `start` on make with `bands` equal bands of the
/// `height` rows of the picture, and counts them. `counts` and `sums` are by bands, and have at least [`BLOCK`] more than there are
/// cells.
#[allow(clippy::too_many_arguments)]
pub fn add_to_cells(
    runs: &[Run],
    size: [usize; 2],
    start: usize,
    columns: usize,
    bands: usize,
    pixels: &[u8],
    counts: &mut [u16],
    sums: &mut [u32],
) {
    #[cfg(target_arch = "x86_64")]
    if columns <= BLOCK {
        let cells = [columns, bands];
        match available() {
            // SAFETY: the processor has these instructions.
            Level::Avx512 => return unsafe { narrow::add_to_cells(runs, size, start, cells, pixels, counts, sums) },
            // SAFETY: as above.
            Level::Avx2 => return unsafe { narrow_avx2::add_to_cells(runs, size, start, cells, pixels, counts, sums) },
            Level::Portable => {}
        }
    }
    let [width, height] = size;
    for run in runs {
        let first = run.row as usize * bands / height * columns;
        for_columns(run, width, start, pixels, |column, pixels, inside| {
            let cells = first + column..;
            let counts = counts.get_mut(cells.clone()).and_then(|counts| counts.first_chunk_mut::<BLOCK>());
            let sums = sums.get_mut(cells).and_then(|sums| sums.first_chunk_mut::<BLOCK>());
            let (Some(counts), Some(sums)) = (counts, sums) else { return };
            for i in 0..BLOCK {
                counts[i] = counts[i].wrapping_add(u16::from(inside[i] & 1));
                sums[i] = sums[i].wrapping_add(u32::from(pixels[i] & inside[i]));
            }
        });
    }
}
}

wide! {
/// Sets the pixels of runs.
pub fn fill_runs(runs: &[Run], width: usize, value: u8, pixels: &mut [u8]) {
    for run in runs {
        let first = run.row as usize * width + run.start as usize;
        if let Some(pixels) = pixels.get_mut(first..first + run.len as usize) {
            fill(pixels, value);
        }
    }
}
}

/// Sets all pixels: in pieces of 32, then of 8, for runs are short; the last piece of each overlaps the one before.
#[inline(always)]
fn fill(pixels: &mut [u8], value: u8) {
    fn pieces<const N: usize>(pixels: &mut [u8], value: u8) -> bool {
        if pixels.len() < N {
            return false;
        }
        let (whole, _) = pixels.as_chunks_mut::<N>();
        whole.fill([value; N]);
        if let Some(last) = pixels.last_chunk_mut::<N>() {
            *last = [value; N];
        }
        true
    }
    if !pieces::<32>(pixels, value) && !pieces::<8>(pixels, value) {
        pixels.iter_mut().for_each(|p| *p = value);
    }
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};

    use super::super::at_most;
    use super::*;

    const WIDTH: usize = 150;
    const HEIGHT: usize = 20;

    /// Runs of a region with so many columns before the seam and after it, some of them long, and at the picture's ends.
    fn runs(rng: &mut rand_chacha::ChaCha8Rng, [before, after]: [usize; 2]) -> Vec<Run> {
        let mut random = |below: usize| rng.next_u32() as usize % below;
        let mut runs = vec![Run { row: 19, start: 140, len: 10 }];
        for row in 0..HEIGHT as u32 - 1 {
            let len = 1 + random(after);
            runs.push(Run { row, start: random(after + 1 - len) as u32, len: len as u32 });
            let len = 1 + random(before);
            runs.push(Run { row, start: (WIDTH - before + random(before + 1 - len)) as u32, len: len as u32 });
        }
        runs.sort_by_key(|r| (r.row, r.start));
        runs
    }

    fn pixels(runs: &[Run]) -> impl Iterator<Item = (usize, usize)> {
        runs.iter().flat_map(|r| (r.start..r.start + r.len).map(|x| (x as usize, r.row as usize)))
    }

    #[test]
    fn sums_and_counts_are_those_of_pixels_one_by_one() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(12);
        for n in 0..40 {
            // Wide regions and narrow ones.
            let (sides, inner) = [([50, 60], 20..101), ([30, 34], 10..51)][n % 2].clone();
            let (start, all_columns) = (WIDTH - sides[0], sides[0] + sides[1]);
            let runs = runs(&mut rng, sides);
            let mut bytes = || (0..WIDTH * HEIGHT).map(|_| (rng.next_u32() >> 24) as u8).collect::<Vec<u8>>();
            let (a, b) = (bytes(), bytes());
            let level: Vec<u16> = a.iter().zip(&b).map(|(a, b)| u16::from(*a) << 8 | u16::from(*b)).collect();
            let (mut differ, mut not_darker) = (0, 0);
            let (mut columns, mut rows) = (vec![0u32; all_columns + BLOCK], vec![(0, 0); HEIGHT]);
            let mut counts = vec![0u16; 4 * all_columns + BLOCK];
            let (mut sums, mut filled) = (vec![0u32; 4 * all_columns + BLOCK], vec![3; WIDTH * HEIGHT]);
            for (x, y) in pixels(&runs) {
                let i = y * WIDTH + x;
                differ += usize::from(a[i].abs_diff(b[i]) >= 90);
                let half = u16::from(b[i]) << 7;
                not_darker += usize::from(half >= level[i] >> 1 || half <= level[i] >> 2);
                let column = (x + WIDTH - start) % WIDTH;
                columns[column] += u32::from(a[i].clamp(9, 99));
                if inner.contains(&column) {
                    rows[y] = (rows[y].0 + u32::from(a[i].min(99)), rows[y].1 + 1);
                }
                counts[y * 4 / HEIGHT * all_columns + column] += 1;
                sums[y * 4 / HEIGHT * all_columns + column] += u32::from(a[i]);
                filled[i] = 7;
            }
            for kind in [Level::Portable, Level::Avx2, Level::Avx512] {
                at_most(kind, || {
                    assert_eq!(count_differences(&runs, WIDTH, &a, &b, 90, usize::MAX), differ);
                    assert!((5..differ).contains(&count_differences(&runs, WIDTH, &a, &b, 90, 5)));
                    assert_eq!(count_not_darker(&runs, WIDTH, &b, &level, usize::MAX), not_darker);
                    let mut got = vec![0; all_columns + BLOCK];
                    add_to_columns(&runs, WIDTH, start, &a, 9, 99, &mut got);
                    assert_eq!(got, columns, "{kind:?}");
                    let mut got = vec![(0, 0); HEIGHT];
                    add_to_rows(&runs, WIDTH, start, &inner, 0, &a, 99, &mut got);
                    assert_eq!(got, rows, "{kind:?}");
                    let mut got = (vec![0; counts.len()], vec![0; sums.len()]);
                    add_to_cells(&runs, [WIDTH, HEIGHT], start, all_columns, 4, &a, &mut got.0, &mut got.1);
                    assert_eq!(got, (counts.clone(), sums.clone()), "{kind:?}");
                    let mut got = vec![3; WIDTH * HEIGHT];
                    fill_runs(&runs, WIDTH, 7, &mut got);
                    assert_eq!(got, filled, "{kind:?}");
                });
            }
        }
    }

    #[test]
    fn sums_of_more_rows_than_sixteen_bits_hold_are_whole() {
        const ROWS: usize = 600;
        let runs: Vec<Run> = (0..ROWS as u32).map(|row| Run { row, start: 20, len: 40 }).collect();
        let white = vec![u8::MAX; WIDTH * ROWS];
        for kind in [Level::Portable, Level::Avx2, Level::Avx512] {
            at_most(kind, || {
                let mut columns = vec![0; 40 + BLOCK];
                add_to_columns(&runs, WIDTH, 20, &white, 0, u8::MAX, &mut columns);
                assert!(columns[..40].iter().all(|sum| *sum == 255 * ROWS as u32), "{kind:?}");
                let (mut counts, mut sums) = (vec![0; 40 + BLOCK], vec![0; 40 + BLOCK]);
                add_to_cells(&runs, [WIDTH, ROWS], 20, 40, 1, &white, &mut counts, &mut sums);
                assert!(counts[..40].iter().all(|count| usize::from(*count) == ROWS), "{kind:?}");
                assert!(sums[..40].iter().all(|sum| *sum == 255 * ROWS as u32), "{kind:?}");
            });
        }
    }
}
