use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;

#[test]
fn the_network_median_equals_the_sorted_median_for_every_count() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for n in 1..40usize {
        let frames: Vec<Vec<u8>> = (0..n).map(|_| bytes(&mut rng, 150, 256)).collect();
        let frames: Vec<&[u8]> = frames.iter().map(Vec::as_slice).collect();
        for level in [Level::Portable, Level::Avx2, Level::Avx512] {
            for len in [150, 64, 40, 20] {
                let mut out = vec![0; len];
                at_most(level, || median(&frames, &mut out));
                for i in 0..len {
                    let mut column: Vec<u16> = frames.iter().map(|f| u16::from(f[i])).collect();
                    column.sort_unstable();
                    let want = if n % 2 == 1 { column[n / 2] } else { (column[n / 2 - 1] + column[n / 2] + 1) >> 1 };
                    assert_eq!(u16::from(out[i]), want, "{n} frames, {level:?}, pixel {i} of {len}");
                }
            }
        }
    }
}

#[test]
fn what_differs_is_marked_as_the_formula_says_at_any_width() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for n in [16, 63, 64, 65, 130, 200] {
        let (picture, mut most) = (bytes(&mut rng, n, 256), bytes(&mut rng, n, 256));
        let background: Vec<u16> = picture.iter().map(|p| near(&mut rng, *p)).collect();
        let noise: Vec<u16> = (0..n).map(|_| (rng.next_u32() % 500) as u16).collect();
        let (mut magnitude, before) = (vec![0; n], most.clone());
        let words = n.div_ceil(64);
        let (mut faint, mut strong) = (vec![u64::MAX; words], vec![u64::MAX; words]);
        let piece = Compared {
            picture: &picture,
            exposure_q15: 32768,
            background: &background,
            noise: &noise,
            floors: [512, 1536],
            size: [n, 1],
            width: n,
        };
        let (faint_words, strong_words) = (&mut faint, &mut strong);
        let out = &mut Marked {
            magnitude: &mut magnitude,
            most: &mut most,
            faint: faint_words,
            strong: strong_words,
            stride: words,
        };
        mark_changes(piece, out);
        for x in 0..64 * words {
            let bits = [faint[x / 64] >> (x % 64) & 1, strong[x / 64] >> (x % 64) & 1].map(|b| b != 0);
            if x >= n {
                assert_eq!(bits, [false; 2], "{x} of {n}");
                continue;
            }
            let change = (f64::from(picture[x]) - f64::from(background[x]) / 256.0).abs();
            let sigma = 1.25 * f64::from(noise[x]) / 256.0;
            assert_eq!(
                bits,
                [change >= f64::max(2.0, 1.6 * sigma), change >= f64::max(6.0, 4.0 * sigma)],
                "{x} of {n}"
            );
            assert_eq!(f64::from(magnitude[x]), change.floor());
            assert_eq!(most[x], before[x].max(magnitude[x]));
        }
    }
}

/// All results of the loops on seeded pictures of a width that no vector divides.
fn everything(seed: u64) -> Vec<Vec<u64>> {
    const N: usize = 1013;
    const WORDS: usize = N.div_ceil(64);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (current, before) = (bytes(&mut rng, N, 256), bytes(&mut rng, N, 256));
    let how = bytes(&mut rng, N, 3);
    let mut level: Vec<u16> = current.iter().map(|c| near(&mut rng, *c)).collect();
    for (i, l) in level[..N / 2].iter_mut().enumerate().filter(|(i, _)| i % 17 != 0) {
        *l = u16::from(current[i]) << 8;
    }
    let mut second: Vec<u16> = current.iter().map(|c| near(&mut rng, *c)).collect();
    let mut noise: Vec<u16> = (0..N).map(|_| (rng.next_u32() % u32::from(NOISE_MAX + 1)) as u16).collect();
    let (mut seen, mut seen_second) = (bytes(&mut rng, N, 9), bytes(&mut rng, N, 9));
    let mut known: Vec<u64> = (0..WORDS).map(|_| rng.next_u64()).collect();
    let exposure_q15 = 30_000 + (rng.next_u32() % 6000) as u16;
    let (mut magnitude, mut most) = (vec![0; N], before.clone());
    let (mut faint, mut strong) = (vec![0; WORDS], vec![0; WORDS]);
    let piece = Compared {
        picture: &current,
        exposure_q15,
        background: &level,
        noise: &noise,
        floors: [512, 1536],
        size: [N, 1],
        width: N,
    };
    let out = &mut Marked {
        magnitude: &mut magnitude,
        most: &mut most,
        faint: &mut faint,
        strong: &mut strong,
        stride: WORDS,
    };
    mark_changes(piece, out);
    let layers = Layers { second: &second[64..128], known: known[1] };
    let forgiven = known_look(&current[64..128], exposure_q15, &noise[64..128], layers);
    let mut products = Fours::default();
    products_by_fours(&faint[..3], &current, &level, &noise, 64, &mut products);
    let mut looks = Looks {
        level: &mut level,
        second: &mut second,
        seen: &mut seen,
        seen_second: &mut seen_second,
        known: &mut known,
    };
    let counting = Counting { also_kept: seed.is_multiple_of(2), most: 8, lead: 2, weight: 1 + (seed % 3) as u8 };
    let exchanged = count_looks(&current, exposure_q15, &how, &noise, counting, &mut looks);
    learn(&current, exposure_q15, &how, 4, 5, 12, NOISE_MAX, &mut level, &mut noise);
    let mut all_trimmed = Vec::new();
    for columns in [50, 64] {
        let mut trimmed = [u64::MAX, 0, u64::MAX];
        keep_at_least(&magnitude, 70, 3, &before[..columns], &mut trimmed, 1);
        for (y, word) in trimmed.iter().enumerate() {
            let kept = |x: usize| y != 1 && (x >= columns || magnitude[70 * y + x] >= before[x]);
            assert!((0..64).all(|x| (word >> x & 1 != 0) == kept(x)), "row {y}");
        }
        all_trimmed.extend(trimmed);
    }
    let (height, words) = (9 + (seed % 9) as usize, 3);
    let a_column = PLANES * height.next_multiple_of(ROWS);
    let planes: Vec<u64> = (0..2 * a_column).map(|_| rng.next_u64()).collect();
    let mut columns = vec![0; (words + 2) * pitch(height)];
    let (mut counts, mut enough) = (Counts::new(words, height), vec![7; words * height]);
    let reach = [1 + seed as usize % 5, [3, 2, 5][seed as usize % 3]];
    let needs = Needs { planes: &planes, of_column: &[0, a_column, a_column], alone: &[true, false, true] };
    // What was counted once and is no longer there leaves nothing.
    for some in [3, 2] {
        for column in columns.chunks_exact_mut(pitch(height)) {
            let any = rng.next_u32() % 4 < some;
            column[ROWS..ROWS + height].iter_mut().for_each(|word| *word = if any { rng.next_u64() } else { 0 });
        }
        majority(&columns, height, reach, needs, &mut counts, &mut enough);
    }
    let mut all = vec![known, faint, strong, enough];
    all.push(vec![u64::from(exchanged), forgiven]);
    all.push(all_trimmed);
    let (steps, deviations) = compare_steps(&current, &level, &noise);
    let plain = (0..N - STEP).map(|i| {
        let step = (i64::from(current[i + STEP]) - i64::from(current[i])) * 256;
        (step - (i64::from(level[i + STEP]) - i64::from(level[i]))).unsigned_abs()
    });
    assert_eq!(u64::from(steps), plain.sum::<u64>());
    all.push(vec![u64::from(steps), u64::from(deviations)]);
    all.push(products.into_iter().flatten().map(u64::from).collect());
    all.extend([level, second, noise].map(|v| v.into_iter().map(u64::from).collect()));
    all.extend([magnitude, most, seen, seen_second].map(|v| v.into_iter().map(u64::from).collect()));
    all
}

#[test]
fn vector_instructions_change_no_bit() {
    for seed in 0..20 {
        let plain = at_most(Level::Portable, || everything(seed));
        for level in [Level::Avx2, Level::Avx512] {
            assert_eq!(at_most(level, || everything(seed)), plain, "seed {seed}, {level:?}");
        }
    }
}

/// The second looks of single pixels, counted one by one.
#[test]
fn looks_are_counted_as_the_rule_says() {
    const N: usize = 200;
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    for round in 0..50 {
        let current = bytes(&mut rng, N, 256);
        let how = bytes(&mut rng, N, 3);
        let noise: Vec<u16> = (0..N).map(|_| (rng.next_u32() % 600) as u16).collect();
        let mut old: [Vec<u16>; 2] = std::array::from_fn(|_| current.iter().map(|c| near(&mut rng, *c)).collect());
        // In every third round nearly everywhere the background is seen.
        if round % 3 == 0 {
            for i in (0..N).filter(|i| i % 17 != 0) {
                old[0][i] = u16::from(current[i]) << 8;
            }
        }
        let counts: [Vec<u8>; 2] = std::array::from_fn(|_| bytes(&mut rng, N, 9));
        let known: Vec<u64> = (0..4).map(|_| rng.next_u64()).collect();
        let ([mut level, mut second], [mut seen, mut seen_second]) = (old.clone(), counts.clone());
        let mut marks = known.clone();
        let mut looks = Looks {
            level: &mut level,
            second: &mut second,
            seen: &mut seen,
            seen_second: &mut seen_second,
            known: &mut marks,
        };
        let counting = Counting { also_kept: round % 2 == 0, most: 8, lead: 2, weight: 1 };
        count_looks(&current, 32768, &how, &noise, counting, &mut looks);
        for i in 0..N {
            let (now, near) = (i32::from(current[i]) << 8, i32::from(noise[i] * 4).max(1024));
            let [mut b, mut s] = [&old[0], &old[1]].map(|v| i32::from(v[i]));
            let [mut nb, mut ns] = [&counts[0], &counts[1]].map(|v| i32::from(v[i]));
            let mut is_known = known[i / 64] >> (i % 64) & 1 != 0;
            let wanted = counting.also_kept || how[i] != KEEP;
            if wanted && (now - b).abs() < near {
                nb = (nb + 1).min(8);
            } else if wanted {
                if (now - s).abs() < near && ns > 0 {
                    (s, ns) = (s + ((now - s) >> 3), (ns + 1).min(8));
                } else {
                    ns = (ns - 1).max(0);
                    if ns == 0 {
                        (s, ns, is_known) = (now, 1, false);
                    }
                }
                if ns > nb + 2 || ns == 8 {
                    (b, s, nb, ns, is_known) = (s, b, ns, nb.min(4), true);
                }
            } else {
                nb = nb.min(8);
            }
            let found = (i32::from(level[i]), i32::from(second[i]), i32::from(seen[i]), i32::from(seen_second[i]));
            assert_eq!(found, (b, s, nb, ns), "pixel {i}");
            assert_eq!(marks[i / 64] >> (i % 64) & 1 != 0, is_known, "pixel {i}");
        }
    }
}

/// A level within eight grey levels of one, 8.8 fixed point.
fn near(rng: &mut ChaCha8Rng, gray: u8) -> u16 {
    (u16::from(gray) << 8).saturating_add_signed((rng.next_u32() % 4000) as i16 - 2000)
}

fn bytes(rng: &mut ChaCha8Rng, n: usize, below: u32) -> Vec<u8> {
    (0..n).map(|_| (rng.next_u32() % below) as u8).collect()
}
