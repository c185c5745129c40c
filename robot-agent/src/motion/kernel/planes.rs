//! Counting marks 64 pixels at a time: plane p of a row holds bit p of the count of each of its pixels.

use super::wide;

/// Planes of a count of marks in the rows of a window, a column each: at most 11.
pub const COLUMN_PLANES: usize = 4;
/// Planes of a count of marks in a window: at most 121.
pub const PLANES: usize = 7;
wide! {
/// Counts down the columns: `counts += enter − leave`. `counts` has [`COLUMN_PLANES`] planes, each with a word more than `enter` has
/// before and after.
pub fn slide_counts(enter: &[u64], leave: &[u64], counts: &mut [u64]) {
    let n = enter.len();
    let leave = &leave[..n];
    let (a, rest) = counts.split_at_mut(n + 2);
    let (b, rest) = rest.split_at_mut(n + 2);
    let (c, d) = rest.split_at_mut(n + 2);
    let (a, b, c, d) = (&mut a[1..=n], &mut b[1..=n], &mut c[1..=n], &mut d[1..=n]);
    for i in 0..n {
        let (mut carry, mut borrow) = (enter[i] & !leave[i], leave[i] & !enter[i]);
        for plane in [&mut a[i], &mut b[i], &mut c[i], &mut d[i]] {
            let bits = *plane;
            *plane = bits ^ carry ^ borrow;
            (carry, borrow) = (bits & carry, !bits & borrow);
        }
    }
}
}

wide! {
/// Marks where the counts of 2·`reach` + 1 neighbouring columns together are at least `need`, for a reach of 1 to 5. `columns` as for
/// [`slide_counts`], where no column counts more than `most`; `need` has [`PLANES`] planes as long as `out`.
pub fn majority_of_counts(columns: &[u64], most: usize, reach: usize, need: &[u64], out: &mut [u64]) {
    // The window that is usual has loops of its own.
    match (reach, most) {
        (2, ..=7) => majority::<2, 3>(columns, need, out),
        (1, _) => majority::<1, 4>(columns, need, out),
        (2, _) => majority::<2, 4>(columns, need, out),
        (3, _) => majority::<3, 4>(columns, need, out),
        (4, _) => majority::<4, 4>(columns, need, out),
        _ => majority::<5, 4>(columns, need, out),
    }
}
}

/// Words that are worked together: as many as the widest registers hold. The last ones of a row begin sooner.
const WORDS: usize = 8;

#[inline(always)]
fn majority<const REACH: usize, const COUNTED: usize>(columns: &[u64], need: &[u64], out: &mut [u64]) {
    let n = out.len();
    if n < WORDS {
        return majority_of_words::<REACH, COUNTED>(columns, n + 2, need, n, out);
    }
    let mut first = 0;
    while first < n {
        let from = first.min(n - WORDS);
        let Some(out) = out[from..].first_chunk_mut::<WORDS>() else { return };
        majority_of_words::<REACH, COUNTED>(&columns[from..], n + 2, &need[from..], n, out);
        first += WORDS;
    }
}

/// Some words of a row. Planes of columns begin `stride` words apart, those of needs `need_stride`.
// Loops with fixed ends and no closures: all but the one over the words are unrolled, and that one is vectorised.
#[inline(always)]
fn majority_of_words<const REACH: usize, const COUNTED: usize>(
    columns: &[u64],
    stride: usize,
    need: &[u64],
    need_stride: usize,
    out: &mut [u64],
) {
    let n = out.len();
    let (a, b) = (&columns[..n + 2], &columns[stride..][..n + 2]);
    let (c, d) = (&columns[2 * stride..][..n + 2], &columns[3 * stride..][..n + 2]);
    let (need0, need1, need2) = (&need[..n], &need[need_stride..][..n], &need[2 * need_stride..][..n]);
    let (need3, need4) = (&need[3 * need_stride..][..n], &need[4 * need_stride..][..n]);
    let (need5, need6) = (&need[5 * need_stride..][..n], &need[6 * need_stride..][..n]);
    for w in 0..n {
        // The word before, the word itself and the one after, of each plane that counts anything.
        let mut words = [
            [a[w], a[w + 1], a[w + 2]],
            [b[w], b[w + 1], b[w + 2]],
            [c[w], c[w + 1], c[w + 2]],
            [d[w], d[w + 1], d[w + 2]],
        ];
        words[COUNTED..].fill([0; 3]);
        let sum = if REACH == 2 && COUNTED == 3 { sum_of_five(words) } else { sum_of::<REACH>(words) };
        let need = [need0[w], need1[w], need2[w], need3[w], need4[w], need5[w], need6[w]];
        let mut enough = u64::MAX;
        for p in 0..PLANES {
            enough = (sum[p] & !need[p]) | (!(sum[p] ^ need[p]) & enough);
        }
        out[w] = enough;
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
