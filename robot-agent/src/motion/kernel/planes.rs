//! Counting marks 64 pixels at a time: plane p of a row holds bit p of the count of each of its pixels.

use super::wide;

/// Planes of a count of marks in the rows of a window, a column each: at most 11.
const COLUMN_PLANES: usize = 4;
/// Planes of a count of marks in a window: at most 121.
pub const PLANES: usize = 7;
/// Rows of a word that are worked together: as many as the widest registers hold.
pub const ROWS: usize = 8;

/// Of a picture's height: words from one column of words to the next, [`ROWS`] of them before the first row and as many after the last.
pub fn pitch(height: usize) -> usize {
    height.next_multiple_of(ROWS) + 2 * ROWS
}

/// What [`majority`] asks for.
#[derive(Debug, Clone, Copy)]
pub struct Needs<'a> {
    /// Least marks in the window of each pixel, above 0: [`PLANES`] planes, each a column of words of the picture's height and up to a
    /// multiple of [`ROWS`], for each column of words that is not as the one before.
    pub planes: &'a [u64],
    /// Where those of a column of words begin.
    pub of_column: &'a [usize],
    /// Of a column of words: whether marks in others are never enough for any of its pixels.
    pub alone: &'a [bool],
}

/// Working memory of [`majority`].
#[derive(Debug, Clone)]
pub struct Counts {
    /// Of each column of words, in planes: marks in the window's rows, a column of pixels each.
    planes: Vec<u64>,
    /// Of each column of words: whether [`ROWS`] rows have any.
    any: Vec<bool>,
    enough: Vec<u64>,
}

impl Counts {
    /// For so many columns of words, those over the seam not counted.
    pub fn new(columns: usize, height: usize) -> Self {
        let rows = height.next_multiple_of(ROWS);
        let any = vec![false; (columns + 2) * rows / ROWS];
        Self { planes: vec![0; (columns + 2) * COLUMN_PLANES * rows], any, enough: vec![0; rows] }
    }

    /// Bytes held.
    pub fn memory_bytes(&self) -> usize {
        size_of_val(&*self.planes) + size_of_val(&*self.any) + size_of_val(&*self.enough)
    }
}

wide! {
/// Marks in `out`, `height` rows of words, where the window of 2·`reach` + 1 columns and rows has enough marks; each reach from 1 to 5. Of
/// `marks` the words of a column lie one below the other, [`pitch`] apart the columns, zeros before and after; a column goes before the
/// first one and one after the last: what lies over the seam.
pub fn majority(marks: &[u64], height: usize, reach: [usize; 2], needs: Needs<'_>, counts: &mut Counts, out: &mut [u64]) {
    count_rows(marks, height, reach[1], counts);
    // The window that is usual has loops of its own.
    match reach {
        [2, ..=3] => majority_of::<2, 3>(height, needs, counts, out),
        [1, _] => majority_of::<1, 4>(height, needs, counts, out),
        [2, _] => majority_of::<2, 4>(height, needs, counts, out),
        [3, _] => majority_of::<3, 4>(height, needs, counts, out),
        [4, _] => majority_of::<4, 4>(height, needs, counts, out),
        _ => majority_of::<5, 4>(height, needs, counts, out),
    }
}
}

/// Neighbours that are alike: from the first of a range on at which something is, the end of those at which it is.
#[inline(always)]
fn next_run(from: usize, end: usize, is_there: impl Fn(usize) -> bool) -> Option<(usize, usize)> {
    let first = (from..end).find(|i| is_there(*i))?;
    Some((first, (first + 1..end).find(|i| !is_there(*i)).unwrap_or(end)))
}

/// Counts marks in the rows up to `reach` above and below each.
#[inline(always)]
fn count_rows(marks: &[u64], height: usize, reach: usize, counts: &mut Counts) {
    let groups = height.div_ceil(ROWS);
    let rows = groups * ROWS;
    let planes = counts.planes.chunks_exact_mut(COLUMN_PLANES * rows).zip(counts.any.chunks_exact_mut(groups));
    for (column, (planes, any)) in marks.chunks_exact(pitch(height)).zip(planes) {
        for (group, any) in any.iter_mut().enumerate() {
            // Most of a picture has none in its window.
            let near = &column[(group + 1) * ROWS - reach..][..ROWS + 2 * reach];
            let mut all = [0; ROWS];
            for from in [0, reach, 2 * reach] {
                all.iter_mut().zip(&near[from..][..ROWS]).for_each(|(all, word)| *all |= word);
            }
            let before = std::mem::replace(any, all.iter().fold(0, |any, word| any | word) != 0);
            if before && !*any {
                planes.chunks_exact_mut(rows).for_each(|plane| plane[group * ROWS..][..ROWS].fill(0));
            }
        }
        let (ones, others) = planes.split_at_mut(rows);
        let (twos, others) = others.split_at_mut(rows);
        let (fours, eights) = others.split_at_mut(rows);
        let mut end = 0;
        while let Some((first, last)) = next_run(end, groups, |group| any[group]) {
            end = last;
            let rows = first * ROWS..last * ROWS;
            let (ones, twos) = (&mut ones[rows.clone()], &mut twos[rows.clone()]);
            let (fours, eights) = (&mut fours[rows.clone()], &mut eights[rows.clone()]);
            let n = rows.len();
            let words = &column[ROWS + rows.start - reach..][..n + 2 * reach];
            if reach == 3 {
                let (twos, fours, words) = (&mut twos[..n], &mut fours[..n], &words[..n + 6]);
                for k in 0..n {
                    let (s, c0) = three(words[k], words[k + 1], words[k + 2]);
                    let (t, c1) = three(words[k + 3], words[k + 4], words[k + 5]);
                    let (one, c2) = three(s, t, words[k + 6]);
                    ones[k] = one;
                    (twos[k], fours[k]) = three(c0, c1, c2);
                }
                continue;
            }
            for plane in [&mut *ones, &mut *twos, &mut *fours, &mut *eights] {
                plane.fill(0);
            }
            for by in 0..=2 * reach {
                let planes = ones.iter_mut().zip(&mut *twos).zip(fours.iter_mut().zip(&mut *eights));
                for (word, ((one, two), (four, eight))) in words[by..].iter().zip(planes) {
                    let mut carry = *word;
                    for plane in [one, two, four, eight] {
                        let bits = *plane;
                        (*plane, carry) = (bits ^ carry, bits & carry);
                    }
                }
            }
        }
    }
}

#[inline(always)]
fn majority_of<const REACH: usize, const COUNTED: usize>(
    height: usize,
    needs: Needs<'_>,
    counts: &mut Counts,
    out: &mut [u64],
) {
    out.fill(0);
    let (stride, groups) = (needs.of_column.len(), height.div_ceil(ROWS));
    let rows = groups * ROWS;
    let Counts { planes, any, enough } = counts;
    for (w, (need, alone)) in needs.of_column.iter().zip(needs.alone).enumerate() {
        let any = &any[w * groups..][..3 * groups];
        let planes = &planes[w * COLUMN_PLANES * rows..][..3 * COLUMN_PLANES * rows];
        let mut end = 0;
        let is_near = |group: usize| any[groups + group] | !alone & (any[group] | any[2 * groups + group]);
        while let Some((first, last)) = next_run(end, groups, is_near) {
            end = last;
            let (first, n) = (first * ROWS, (last - first) * ROWS);
            let enough = &mut enough[..n];
            majority_of_rows::<REACH, COUNTED>(&planes[first..], &needs.planes[need + first..], rows, enough);
            for (out, enough) in out[first * stride..].chunks_exact_mut(stride).zip(enough) {
                out[w] = *enough;
            }
        }
    }
}

/// Where the counts of 2·`REACH` + 1 neighbouring columns are at least what is needed, in some rows of a column of words. Its planes come
/// after those of the one before, `pitch` apart; `COUNTED` of them count anything.
// Loops with fixed ends and no closures: all but the one over the rows are unrolled, and that one is vectorised.
#[inline(always)]
fn majority_of_rows<const REACH: usize, const COUNTED: usize>(
    planes: &[u64],
    need: &[u64],
    pitch: usize,
    out: &mut [u64],
) {
    let n = out.len();
    let plane = |column: usize, p: usize| &planes[(column * COLUMN_PLANES + p) * pitch..][..n];
    let [a0, a1, a2] = [plane(0, 0), plane(1, 0), plane(2, 0)];
    let [b0, b1, b2] = [plane(0, 1), plane(1, 1), plane(2, 1)];
    let [c0, c1, c2] = [plane(0, 2), plane(1, 2), plane(2, 2)];
    let [d0, d1, d2] = [plane(0, 3), plane(1, 3), plane(2, 3)];
    let (need0, need1, need2) = (&need[..n], &need[pitch..][..n], &need[2 * pitch..][..n]);
    let (need3, need4) = (&need[3 * pitch..][..n], &need[4 * pitch..][..n]);
    let (need5, need6) = (&need[5 * pitch..][..n], &need[6 * pitch..][..n]);
    for k in 0..n {
        // The word before, the word itself and the one after, of each plane that counts anything.
        let mut words = [[a0[k], a1[k], a2[k]], [b0[k], b1[k], b2[k]], [c0[k], c1[k], c2[k]], [d0[k], d1[k], d2[k]]];
        words[COUNTED..].fill([0; 3]);
        let sum = if REACH == 2 && COUNTED == 3 { sum_of_five(words) } else { sum_of::<REACH>(words) };
        let need = [need0[k], need1[k], need2[k], need3[k], need4[k], need5[k], need6[k]];
        let mut enough = u64::MAX;
        for p in 0..PLANES {
            enough = (sum[p] & !need[p]) | (!(sum[p] ^ need[p]) & enough);
        }
        out[k] = enough;
    }
}

/// The sum of 2·`REACH` + 1 columns; `words` as in [`sum_of_five`].
#[inline(always)]
fn sum_of<const REACH: usize>(words: [[u64; 3]; COLUMN_PLANES]) -> [u64; PLANES] {
    let mut sum = [0u64; PLANES];
    add(&mut sum, [words[0][1], words[1][1], words[2][1], words[3][1]]);
    for by in 1..=REACH {
        let (mut left, mut right) = ([0; COLUMN_PLANES], [0; COLUMN_PLANES]);
        for p in 0..COLUMN_PLANES {
            left[p] = words[p][1] << by | words[p][0] >> (64 - by);
            right[p] = words[p][1] >> by | words[p][2] << (64 - by);
        }
        add(&mut sum, left);
        add(&mut sum, right);
    }
    sum
}

/// `sum += number`, bit by bit.
#[inline(always)]
fn add(sum: &mut [u64; PLANES], number: [u64; COLUMN_PLANES]) {
    let mut carry = 0;
    for p in 0..PLANES {
        let other = if p < COLUMN_PLANES { number[p] } else { 0 };
        let half = sum[p] ^ other;
        (sum[p], carry) = (half ^ carry, (sum[p] & other) | (carry & half));
    }
}

/// The sum of five columns that count at most seven each, in a third of the instructions of [`add`]: bits of one weight are added up
/// three at a time. `words`: of each plane the word before, the word itself and the one after.
#[inline(always)]
fn sum_of_five(words: [[u64; 3]; COLUMN_PLANES]) -> [u64; PLANES] {
    let ([a, b, c, d, e], [f, g, h, i, j], [k, l, m, o, p]) = (five(words[0]), five(words[1]), five(words[2]));
    // Ones.
    let (s, c0) = three(a, b, c);
    let (ones, c1) = three(s, d, e);
    // Twos: five and two carried.
    let ((s, c2), (t, c3)) = (three(f, g, h), three(i, j, c0));
    let (twos, c4) = three(s, t, c1);
    // Fours: five and three.
    let ((s, c5), (t, c6)) = (three(k, l, m), three(o, p, c2));
    let (u, c7) = three(s, t, c3);
    let (fours, c8) = (u ^ c4, u & c4);
    // Eights: four carried. Sixteens: two. At most 35 in all.
    let (s, c9) = three(c5, c6, c7);
    let (eights, c10) = (s ^ c8, s & c8);
    [ones, twos, fours, eights, c9 ^ c10, c9 & c10, 0]
}

/// A plane's bits of the five columns round each of a word's.
#[inline(always)]
fn five([before, here, after]: [u64; 3]) -> [u64; 5] {
    [here, here << 1 | before >> 63, here >> 1 | after << 63, here << 2 | before >> 62, here >> 2 | after << 62]
}

/// Sum and carry of three bits.
#[inline(always)]
fn three(a: u64, b: u64, c: u64) -> (u64, u64) {
    let half = a ^ b;
    (half ^ c, (a & b) | (c & half))
}
