use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;

#[test]
fn the_network_median_equals_the_sorted_median_for_every_count() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for n in 1..40usize {
        let frames: Vec<Vec<u8>> = (0..n).map(|_| bytes(&mut rng, 150, 256)).collect();
        let mut out = vec![0; 150];
        median(&frames.iter().map(Vec::as_slice).collect::<Vec<_>>(), &mut out);
        for i in 0..150 {
            let mut column: Vec<u16> = frames.iter().map(|f| u16::from(f[i])).collect();
            column.sort_unstable();
            let want = if n % 2 == 1 { column[n / 2] } else { (column[n / 2 - 1] + column[n / 2] + 1) >> 1 };
            assert_eq!(u16::from(out[i]), want, "{n} frames");
        }
    }
}

/// All results of the loops on seeded pictures of a width that no vector divides.
fn everything(seed: u64) -> Vec<Vec<u16>> {
    const N: usize = 1013;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (current, before) = (bytes(&mut rng, N, 256), bytes(&mut rng, N, 256));
    let (valid, how) = (bytes(&mut rng, N, 2), bytes(&mut rng, N, 3));
    let near = |rng: &mut ChaCha8Rng| -> Vec<u16> {
        current
            .iter()
            .map(|&c| (u16::from(c) << 8).saturating_add_signed((rng.next_u32() % 4000) as i16 - 2000))
            .collect()
    };
    let (mut level, mut second) = (near(&mut rng), near(&mut rng));
    let mut noise: Vec<u16> = (0..N).map(|_| (rng.next_u32() % u32::from(NOISE_MAX + 1)) as u16).collect();
    let (mut seen, mut seen_second, mut known) = (bytes(&mut rng, N, 9), bytes(&mut rng, N, 9), bytes(&mut rng, N, 2));
    let exposure = 30_000 + (rng.next_u32() % 6000) as u16;
    let (mut magnitude, mut faint, mut strong) = (vec![0; N], vec![0; N], vec![0; N]);
    mark_changes(&current, exposure, &level, &noise, 512, 1536, &mut magnitude, &mut faint, &mut strong);
    keep_valid(&valid, &mut faint, &mut strong);
    let marked = faint.clone();
    let layers = Layers { second: &second, second_is_known: &known };
    forgive_known(&current, exposure, &noise, layers, &mut faint, &mut strong);
    let mut looks = Looks {
        level: &mut level,
        second: &mut second,
        seen: &mut seen,
        seen_second: &mut seen_second,
        second_is_known: &mut known,
    };
    let exchanged = count_looks(&current, exposure, &how, &noise, seed.is_multiple_of(2), 8, 2, &mut looks);
    learn(&current, exposure, &how, 4, 5, 12, NOISE_MAX, &mut level, &mut noise);
    let mut trimmed = marked.clone();
    keep_at_least(&magnitude, &before, &mut trimmed);
    let mut most = before.clone();
    raise(&magnitude, &mut most);
    let mut sums = seen.clone();
    slide_column_sums(&faint, &valid, &mut sums);
    let mut majority = vec![0; N - 4];
    threshold_row_sums(&faint, 2, &how, &mut majority);
    let counts =
        vec![u16::from(exchanged), count_ones(&marked) as u16, count_differences(&current, &before, 40) as u16];
    let wider = |v: Vec<u8>| v.into_iter().map(u16::from).collect::<Vec<u16>>();
    let mut all = vec![counts, level, second, noise];
    all.extend([magnitude, faint, strong, marked, trimmed, most, sums, majority, seen, seen_second, known].map(wider));
    all
}

#[test]
fn vector_instructions_change_no_bit() {
    for seed in 0..20 {
        assert_eq!(everything(seed), portable(|| everything(seed)), "seed {seed}");
    }
}

fn bytes(rng: &mut ChaCha8Rng, n: usize, below: u32) -> Vec<u8> {
    (0..n).map(|_| (rng.next_u32() % below) as u8).collect()
}
