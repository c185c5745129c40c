//! Exact medians of stacks of pictures.

use super::wide;
#[cfg(target_arch = "x86_64")]
use super::{Level, available, middle};

/// Pixels sorted together: several registers, so that one works while another waits.
const BLOCK: usize = 128;

/// Exact medians of columns of a stack (`MATHS.md` §7.2): `frames[f][i]` over f; even counts give (lower + upper + 1) >> 1.
/// Batcher's sorting network without the comparators on which the middle does not depend, on blocks of pixels: minima and
/// maxima of whole vectors, no branch on data. Up to 32 frames stay in registers where AVX2 or AVX-512 is there.
pub fn median(frames: &[&[u8]], out: &mut [u8]) {
    let n = frames.len();
    if n == 0 {
        return;
    }
    #[cfg(target_arch = "x86_64")]
    if n <= middle::VALUES {
        // SAFETY: the processor has these instructions.
        let done = match available() {
            Level::Avx512 => unsafe { middle::of_stack_avx512(frames, out) },
            Level::Avx2 => unsafe { middle::of_stack_avx2(frames, out) },
            Level::Portable => false,
        };
        if done {
            return;
        }
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
    let mut sorting = Batcher::new(n);
    let mut network: Vec<(u16, u16)> = std::iter::from_fn(|| sorting.next()).collect();
    let first = keep_needed(&mut network, &mut vec![false; n]);
    network.drain(..first);
    network
}

/// Moves the comparators on which the middle depends to the end of a sorting network, and says where they begin. `needed`: `false` for
/// each value.
pub(super) const fn keep_needed(network: &mut [(u16, u16)], needed: &mut [bool]) -> usize {
    needed[(needed.len() - 1) / 2] = true;
    needed[needed.len() / 2] = true;
    let (mut first, mut k) = (network.len(), network.len());
    while k > 0 {
        k -= 1;
        let (low, high) = (network[k].0 as usize, network[k].1 as usize);
        if needed[low] || needed[high] {
            (needed[low], needed[high]) = (true, true);
            first -= 1;
            network[first] = network[k];
        }
    }
    first
}

/// The comparators of Batcher's odd–even merge sort for any number of values (Knuth, TAOCP 3, algorithm 5.2.2M), one after the other;
/// the names are Knuth's.
pub(super) struct Batcher {
    n: usize,
    p: usize,
    q: usize,
    r: usize,
    d: usize,
    i: usize,
}

impl Batcher {
    pub(super) const fn new(n: usize) -> Self {
        let p = if n < 2 { 0 } else { n.next_power_of_two() / 2 };
        Self { n, p, q: p, r: 0, d: p, i: 0 }
    }

    /// The next comparator, of which the first index gets the smaller value.
    pub(super) const fn next(&mut self) -> Option<(u16, u16)> {
        while self.p > 0 {
            while self.i < self.n - self.d {
                let i = self.i;
                self.i += 1;
                if i & self.p == self.r {
                    return Some((i as u16, (i + self.d) as u16));
                }
            }
            self.i = 0;
            if self.q == self.p {
                self.p /= 2;
                (self.q, self.r, self.d) = (self.n.next_power_of_two() / 2, 0, self.p);
            } else {
                self.d = self.q - self.p;
                self.q /= 2;
                self.r = self.p;
            }
        }
        None
    }
}
