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
/// [`slide_counts`], `need` has [`PLANES`] planes as long as `out`.
pub fn majority_of_counts(columns: &[u64], reach: usize, need: &[u64], out: &mut [u64]) {
    match reach {
        1 => majority::<1>(columns, need, out),
        2 => majority::<2>(columns, need, out),
        3 => majority::<3>(columns, need, out),
        4 => majority::<4>(columns, need, out),
        _ => majority::<5>(columns, need, out),
    }
}
}

// Loops with fixed ends and no closures: all but the one over the words are unrolled, and that one is vectorised.
#[inline(always)]
fn majority<const REACH: usize>(columns: &[u64], need: &[u64], out: &mut [u64]) {
    let n = out.len();
    let (a, rest) = columns.split_at(n + 2);
    let (b, rest) = rest.split_at(n + 2);
    let (c, d) = rest.split_at(n + 2);
    let d = &d[..n + 2];
    let (need, rest) = need.split_at(n);
    let (need1, rest) = rest.split_at(n);
    let (need2, rest) = rest.split_at(n);
    let (need3, rest) = rest.split_at(n);
    let (need4, rest) = rest.split_at(n);
    let (need5, need6) = rest.split_at(n);
    let need6 = &need6[..n];
    for w in 0..n {
        // The word before, the word itself and the one after, of each plane.
        let words = [
            [a[w], a[w + 1], a[w + 2]],
            [b[w], b[w + 1], b[w + 2]],
            [c[w], c[w + 1], c[w + 2]],
            [d[w], d[w + 1], d[w + 2]],
        ];
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
        let need = [need[w], need1[w], need2[w], need3[w], need4[w], need5[w], need6[w]];
        let mut enough = u64::MAX;
        for p in 0..PLANES {
            enough = (sum[p] & !need[p]) | (!(sum[p] ^ need[p]) & enough);
        }
        out[w] = enough;
    }
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
