//! Squares round marks, 64 pixels a word, rows of words one after the other.

use super::wide;

wide! {
/// Marks the left and right neighbours of marks, too, in rows of `stride` words for `width` columns; the first and the last column are
/// neighbours where it `wraps`.
pub fn spread_by_one(marks: &[u64], stride: usize, width: usize, wraps: bool, out: &mut [u64]) {
    let n = marks.len();
    let out = &mut out[..n];
    // As if the rows were one; then the ends of each.
    if n > 2 {
        let neighbours = marks[..n - 2].iter().zip(&marks[2..]);
        for ((out, word), (before, after)) in out[1..n - 1].iter_mut().zip(&marks[1..n - 1]).zip(neighbours) {
            *out = spread(*before, *word, *after);
        }
    }
    let last = (width - 1) % 64;
    for (row, out) in marks.chunks_exact(stride).zip(out.chunks_exact_mut(stride)) {
        let ring = [row[0] & 1, row[stride - 1] >> last & 1].map(|end| if wraps { end } else { 0 });
        if stride == 1 {
            out[0] = (spread(0, row[0], 0) | ring[1] | ring[0] << last) & (u64::MAX >> (63 - last));
            continue;
        }
        out[0] = spread(0, row[0], row[1]) | ring[1];
        out[stride - 1] =
            (spread(row[stride - 2], row[stride - 1], 0) | ring[0] << last) & (u64::MAX >> (63 - last));
    }
}
}

#[inline(always)]
fn spread(before: u64, word: u64, after: u64) -> u64 {
    word | word << 1 | word >> 1 | before >> 63 | after << 63
}

wide! {
/// Marks what is marked in any of the rows up to `reach` above and below.
pub fn spread_over_rows(marks: &[u64], stride: usize, reach: usize, out: &mut [u64]) {
    out.copy_from_slice(marks);
    for by in 1..=reach {
        let shift = (by * stride).min(marks.len());
        for (out, mark) in out.iter_mut().zip(&marks[shift..]) {
            *out |= *mark;
        }
        for (out, mark) in out[shift..].iter_mut().zip(marks) {
            *out |= *mark;
        }
    }
}
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};

    use super::super::{Level, at_most};
    use super::*;

    #[test]
    fn squares_are_those_of_marks_one_by_one() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(13);
        for (width, wraps) in
            [(17, true), (64, true), (64, false), (130, true), (130, false), (1080, true), (128, true)]
        {
            let (height, stride, reach) = (9usize, usize::div_ceil(width, 64), 2usize);
            let marked: Vec<bool> = (0..width * height).map(|_| rng.next_u32().is_multiple_of(40)).collect();
            let mut marks = vec![0u64; stride * height];
            for i in (0..marked.len()).filter(|i| marked[*i]) {
                marks[i / width * stride + i % width / 64] |= 1 << (i % width % 64);
            }
            for level in [Level::Portable, Level::Avx2, Level::Avx512] {
                let (mut wide, mut squares) = (vec![7; marks.len()], vec![7; marks.len()]);
                at_most(level, || {
                    spread_by_one(&marks, stride, width, wraps, &mut wide);
                    spread_over_rows(&wide, stride, reach, &mut squares);
                });
                for (y, row) in squares.chunks_exact(stride).enumerate() {
                    for x in 0..stride * 64 {
                        let near = |near: usize, at: usize| {
                            let apart = near.abs_diff(at);
                            apart <= 1 || wraps && apart == width - 1
                        };
                        let rows = y.saturating_sub(reach)..(y + reach + 1).min(height);
                        let want =
                            x < width && rows.clone().any(|v| (0..width).any(|u| near(u, x) && marked[v * width + u]));
                        assert_eq!(row[x / 64] >> (x % 64) & 1 != 0, want, "{x} {y} of {width}, {wraps}, {level:?}");
                    }
                }
            }
        }
    }
}
