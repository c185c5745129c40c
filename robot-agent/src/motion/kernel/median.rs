//! Exact medians of stacks of pictures.

use super::wide;

/// Pixels sorted together: several registers, so that one works while another waits.
const BLOCK: usize = 128;

/// Exact medians of columns of a stack (`MATHS.md` §7.2): `frames[f][i]` over f; even counts give (lower + upper + 1) >> 1.
/// Batcher's sorting network without the comparators on which the middle does not depend, on blocks of pixels: minima and
/// maxima of whole vectors, no branch on data.
pub fn median(frames: &[&[u8]], out: &mut [u8]) {
    let n = frames.len();
    if n == 0 {
        return;
    }
    let network = selection_network(n);
    let mut block = vec![[0u8; BLOCK]; n];
    run(frames, &network, &mut block, out);
}

wide! {
fn run(frames: &[&[u8]], network: &[(u16, u16)], block: &mut [[u8; BLOCK]], out: &mut [u8]) {
    let n = frames.len();
    for (b, out) in out.chunks_mut(BLOCK).enumerate() {
        for (row, frame) in block.iter_mut().zip(frames) {
            let pixels = &frame[b * BLOCK..b * BLOCK + out.len()];
            match pixels.first_chunk::<BLOCK>() {
                Some(whole) => *row = *whole,
                None => row[..out.len()].copy_from_slice(pixels),
            }
        }
        for &(low, high) in network {
            let (low, high) = (usize::from(low), usize::from(high));
            let (a, b) = (block[low], block[high]);
            for k in 0..BLOCK {
                block[low][k] = a[k].min(b[k]);
            }
            for k in 0..BLOCK {
                block[high][k] = a[k].max(b[k]);
            }
        }
        let (lower, upper) = (&block[(n - 1) / 2], &block[n / 2]);
        for (i, o) in out.iter_mut().enumerate() {
            *o = ((u16::from(lower[i]) + u16::from(upper[i]) + 1) >> 1) as u8;
        }
    }
}
}

/// The comparators (of which the first index gets the smaller value) that bring the middle of n values to its place.
fn selection_network(n: usize) -> Vec<(u16, u16)> {
    let mut needed = vec![false; n];
    needed[(n - 1) / 2] = true;
    needed[n / 2] = true;
    let mut network: Vec<(u16, u16)> = Vec::new();
    for &(low, high) in sorting_network(n).iter().rev() {
        if needed[usize::from(low)] || needed[usize::from(high)] {
            needed[usize::from(low)] = true;
            needed[usize::from(high)] = true;
            network.push((low, high));
        }
    }
    network.reverse();
    network
}

/// Batcher's odd–even merge sort for any number of values (Knuth, TAOCP 3, algorithm 5.2.2M).
fn sorting_network(n: usize) -> Vec<(u16, u16)> {
    let mut network = Vec::new();
    if n < 2 {
        return network;
    }
    let top = n.next_power_of_two() / 2;
    let mut p = top;
    while p > 0 {
        let (mut q, mut r, mut d) = (top, 0, p);
        loop {
            network.extend((0..n - d).filter(|i| i & p == r).map(|i| (i as u16, (i + d) as u16)));
            if q == p {
                break;
            }
            d = q - p;
            q /= 2;
            r = p;
        }
        p /= 2;
    }
    network
}
