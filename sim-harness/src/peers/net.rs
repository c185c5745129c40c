//! Learns the weights of the network that the detector's verdict asks (`robot_agent::peers::net`): stochastic gradient descent on the
//! cross entropy, mirror images and left-out cells of the last map (dropout) for more examples than there are.

use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha12Rng;
use robot_agent::peers::net::{CHANNELS, DENSE, OF_PICTURE, Pass, SIDE, mirrored, scaled, shown, sizes, split, taps};

use crate::adam::{Adam, cosine};

/// A labelled picture: cells, numbers, and whether it is a robot.
pub struct Shown {
    cells: Vec<f32>,
    numbers: Vec<f32>,
    is_robot: bool,
}

const SEED: u64 = 11;
/// Each example is seen so often, and oftener where there are few: so many steps are taken at least, unless each was seen so often.
const EPOCHS: usize = 10;
const LEAST_STEPS: usize = 3000;
const MOST_EPOCHS: usize = 60;
const BATCH: usize = 128;
/// Length of the first steps; they grow shorter as a cosine does.
const RATE: f32 = 2e-3;
/// Share of the last map that is kept.
const KEPT: f32 = 0.7;
/// Weights are drawn towards 0 by this.
const RIDGE: f32 = 2e-4;
/// Kinds of weights (`sizes`): the first that is learnt; those that are drawn towards 0.
const FIRST_LEARNT: usize = 2;
const DRAWN: [usize; 6] = [2, 4, 6, 8, 10, 12];

impl Shown {
    /// From what a fit looks like and its traits.
    pub fn new(picture: &[i16], traits: &[f64], is_robot: bool) -> Self {
        let (cells, numbers) = shown(picture, traits);
        Self { cells, numbers, is_robot }
    }
}

/// The weights that explain the labels.
pub fn learn(examples: &[&Shown]) -> Vec<f32> {
    let Some(traits) = examples.first().map(|e| e.numbers.len() - OF_PICTURE) else { return Vec::new() };
    let mut rng = ChaCha12Rng::seed_from_u64(SEED);
    let mut weights = begun(examples, traits, &mut rng);
    let learnt_from: usize = sizes(traits)[..FIRST_LEARNT].iter().sum();
    let mut adam = Adam::new(weights.len() - learnt_from);
    let mut order: Vec<usize> = (0..examples.len()).collect();
    let batches = examples.len().div_ceil(BATCH);
    let epochs = LEAST_STEPS.div_ceil(batches).clamp(EPOCHS, MOST_EPOCHS);
    let steps = epochs * batches;
    let mut step = 0;
    for _ in 0..epochs {
        order.shuffle(&mut rng);
        for batch in order.chunks(BATCH) {
            let mut gradient = vec![0.0f32; weights.len()];
            for i in batch {
                let example = examples[*i];
                let is_mirrored = rng.random::<bool>();
                let cells = if is_mirrored { mirrored(&example.cells) } else { example.cells.clone() };
                let kept = std::array::from_fn(|_| if rng.random::<f32>() < KEPT { 1.0 / KEPT } else { 0.0 });
                add_gradient(&weights, traits, (&cells, &example.numbers), example.is_robot, &kept, &mut gradient);
            }
            let per_example = 1.0 / batch.len() as f32;
            gradient.iter_mut().for_each(|g| *g *= per_example);
            add_ridge(&weights, traits, &mut gradient);
            step += 1;
            let rate = cosine(RATE, step, steps);
            adam.descend(&mut weights[learnt_from..], &gradient[learnt_from..], rate);
        }
    }
    weights
}

/// Scales of the numbers, and weights drawn as He and others (2015) do.
fn begun(examples: &[&Shown], traits: usize, rng: &mut ChaCha12Rng) -> Vec<f32> {
    let sizes = sizes(traits);
    let n = examples.len() as f32;
    let mean = |k: usize| examples.iter().map(|e| e.numbers[k]).sum::<f32>() / n;
    let means: Vec<f32> = (0..sizes[0]).map(mean).collect();
    let spread = |k: usize| (examples.iter().map(|e| (e.numbers[k] - means[k]).powi(2)).sum::<f32>() / n).sqrt();
    let per_spread: Vec<f32> = (0..sizes[1]).map(|k| 1.0 / (spread(k) + 1e-6)).collect();
    let mut weights = [means, per_spread].concat();
    for (kind, size) in sizes.iter().enumerate().skip(FIRST_LEARNT) {
        let before = match kind {
            2 | 4 | 6 => 9 * CHANNELS[kind / 2 - 1],
            8 => DENSE[0],
            10 => DENSE[1] + sizes[0],
            12 => DENSE[2],
            _ => 0,
        };
        let most = if before == 0 { 0.0 } else { (6.0 / before as f32).sqrt() };
        // The last layer begins unsure.
        let most = if kind == 12 { 0.1 * most } else { most };
        weights.extend((0..*size).map(|_| most * (2.0 * rng.random::<f32>() - 1.0)));
    }
    weights
}

fn add_ridge(weights: &[f32], traits: usize, gradient: &mut [f32]) {
    let mut from = 0;
    for (kind, size) in sizes(traits).into_iter().enumerate() {
        if DRAWN.contains(&kind) {
            let pairs = gradient[from..from + size].iter_mut().zip(&weights[from..from + size]);
            pairs.for_each(|(g, w)| *g += 2.0 * RIDGE * w);
        }
        from += size;
    }
}

/// Adds the gradient of the cross entropy of one example; gives that.
fn add_gradient(
    weights: &[f32],
    traits: usize,
    (cells, numbers): (&[f32], &[f32]),
    is_robot: bool,
    kept: &[f32; DENSE[0]],
    gradient: &mut [f32],
) -> f32 {
    let Some(kinds) = split(weights, traits) else { return 0.0 };
    let numbers = scaled(numbers, kinds[0], kinds[1]);
    let Pass { maps, outs, before: [last, first, second], says: said } = Pass::new(&kinds, cells, &numbers, kept);
    let truth = f32::from(u8::from(is_robot));
    let by_said = 1.0 / (1.0 + (-said).exp()) - truth;

    let mut rest = gradient;
    let mut parts = sizes(traits).map(|size| {
        let (part, last) = std::mem::take(&mut rest).split_at_mut(size);
        rest = last;
        part
    });
    let [.., k0, b0, k1, b1, k2, b2, d0, e0, d1, e1, d2, e2] = &mut parts;
    let by_second = dense_back(&second, kinds[12], &[by_said], d2, e2);
    let by_second = through(&by_second, &second);
    let by_first = dense_back(&first, kinds[10], &by_second, d1, e1);
    let by_first = through(&by_first[..DENSE[1]], &first);
    let by_last = dense_back(&last, kinds[8], &by_first, d0, e0);
    let mut by_map: Vec<f32> = by_last.iter().zip(kept).map(|(g, kept)| g * kept).collect();
    for (k, kernel, bias) in [(2, k2, b2), (1, k1, b1), (0, k0, b0)] {
        let side = SIDE >> k;
        let by_out = pool_back(&outs[k], &maps[k + 1], side, CHANNELS[k + 1], &by_map);
        by_map = convolve_back(&maps[k], side, [CHANNELS[k], CHANNELS[k + 1]], kinds[2 + 2 * k], &by_out, kernel, bias);
    }
    // ln(1 + e^−said) for a robot, without overflow.
    let against = if is_robot { -said } else { said };
    against.max(0.0) + (-against.abs()).exp().ln_1p()
}

/// The gradient before a cut at 0.
fn through(by_after: &[f32], after: &[f32]) -> Vec<f32> {
    by_after.iter().zip(after).map(|(g, x)| if *x > 0.0 { *g } else { 0.0 }).collect()
}

fn dense_back(
    before: &[f32],
    weights: &[f32],
    by_after: &[f32],
    by_weights: &mut [f32],
    by_bias: &mut [f32],
) -> Vec<f32> {
    let n = by_after.len();
    by_bias.iter_mut().zip(by_after).for_each(|(g, by)| *g += by);
    let rows = before.iter().zip(weights.chunks_exact(n)).zip(by_weights.chunks_exact_mut(n));
    rows.map(|((value, weights), by_weights)| {
        by_weights.iter_mut().zip(by_after).for_each(|(g, by)| *g += value * by);
        weights.iter().zip(by_after).map(|(w, by)| w * by).sum()
    })
    .collect()
}

/// The gradient before pooling, and before the cut at 0.
fn pool_back(out: &[f32], largest: &[f32], side: usize, channels: usize, by_largest: &[f32]) -> Vec<f32> {
    let half = side / 2;
    let mut by_out = vec![0.0; out.len()];
    for (y, x) in (0..half).flat_map(|y| (0..half).map(move |x| (y, x))) {
        for c in 0..channels {
            let at = (y * half + x) * channels + c;
            if largest[at] <= 0.0 {
                continue;
            }
            let cells = [(0, 0), (0, 1), (1, 0), (1, 1)].map(|(v, u)| ((2 * y + v) * side + 2 * x + u) * channels + c);
            if let Some(cell) = cells.into_iter().find(|cell| out[*cell] >= largest[at]) {
                by_out[cell] = by_largest[at];
            }
        }
    }
    by_out
}

fn convolve_back(
    maps: &[f32],
    side: usize,
    [before, after]: [usize; 2],
    kernel: &[f32],
    by_out: &[f32],
    by_kernel: &mut [f32],
    by_bias: &mut [f32],
) -> Vec<f32> {
    let mut by_maps = vec![0.0; maps.len()];
    for (n, by_out) in by_out.chunks_exact(after).enumerate() {
        if by_out.iter().all(|by| *by == 0.0) {
            continue;
        }
        by_bias.iter_mut().zip(by_out).for_each(|(g, by)| *g += by);
        for (tap, at) in taps(n % side, n / side, side) {
            let from = tap * before * after;
            for c in 0..before {
                let weights = from + c * after..from + (c + 1) * after;
                let value = maps[at * before + c];
                by_kernel[weights.clone()].iter_mut().zip(by_out).for_each(|(g, by)| *g += value * by);
                by_maps[at * before + c] += kernel[weights].iter().zip(by_out).map(|(w, by)| w * by).sum::<f32>();
            }
        }
    }
    by_maps
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pictures(n: usize) -> Vec<Shown> {
        let mut rng = ChaCha12Rng::seed_from_u64(3);
        let picture = |k: usize| {
            // A bright bar across for robots, upright for others, somewhere, in noise.
            let (is_robot, at) = (k.is_multiple_of(2), rng.random_range(4..SIDE - 4));
            let gray =
                |v: usize, u: usize, noise: i16| 60 + noise + if (if is_robot { v } else { u }) == at { 25 } else { 0 };
            let cells =
                (0..SIDE * SIDE).map(|n| gray(n / SIDE, n % SIDE, rng.random_range(-8..8))).collect::<Vec<i16>>();
            Shown::new(&cells, &[rng.random::<f64>(), 1.0], is_robot)
        };
        (0..n).map(picture).collect()
    }

    #[test]
    fn gradients_are_those_of_differences() {
        let all = pictures(4);
        let examples: Vec<&Shown> = all.iter().collect();
        let mut rng = ChaCha12Rng::seed_from_u64(5);
        let mut weights = begun(&examples, 2, &mut rng);
        let kept = [1.0; DENSE[0]];
        let cost = |weights: &[f32], gradient: &mut [f32]| {
            let of = |e: &&Shown| add_gradient(weights, 2, (&e.cells, &e.numbers), e.is_robot, &kept, &mut *gradient);
            examples.iter().map(of).map(f64::from).sum::<f64>()
        };
        let mut gradient = vec![0.0; weights.len()];
        cost(&weights, &mut gradient);
        let mut from = 0;
        for (kind, size) in sizes(2).into_iter().enumerate() {
            // Of each kind the steepest.
            let n = (from..from + size).max_by(|a, b| gradient[*a].abs().total_cmp(&gradient[*b].abs())).unwrap();
            from += size;
            if kind < FIRST_LEARNT {
                continue;
            }
            let (was, step) = (weights[n], 2e-3);
            let mut at = |by: f32| {
                weights[n] = was + by;
                cost(&weights, &mut vec![0.0; gradient.len()])
            };
            let by_difference = (at(step) - at(-step)) / (2.0 * f64::from(step));
            weights[n] = was;
            let by_rule = f64::from(gradient[n]);
            assert!((by_difference - by_rule).abs() < 0.05 * by_rule.abs() + 1e-3, "{kind}: {by_difference} {by_rule}");
        }
    }

    #[test]
    fn what_lies_across_is_told_from_what_stands_upright() {
        let all = pictures(600);
        let (seen, unseen): (Vec<_>, Vec<_>) = all.iter().enumerate().partition(|(n, _)| *n < 500);
        let weights = learn(&seen.into_iter().map(|(_, e)| e).collect::<Vec<_>>());
        let kept = [1.0; DENSE[0]];
        let costs = unseen.iter().map(|(_, e)| {
            add_gradient(&weights, 2, (&e.cells, &e.numbers), e.is_robot, &kept, &mut vec![0.0; weights.len()])
        });
        let mean = costs.sum::<f32>() / unseen.len() as f32;
        assert!(mean < 0.3, "{mean}");
    }
}
