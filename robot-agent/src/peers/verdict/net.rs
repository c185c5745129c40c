//! A small convolutional network: what a fit looks like.
//!
//! Problem: traits are what somebody thought of; anybody who looks at the picture sees at a glance that this is a chair. Insight: a fit says
//! where the body would be, so all pictures can be brought to one size and place, whatever the camera and the distance, and few weights learn
//! what robots look like there. Three times convolution, maximum of four, half the size; then two dense layers, the second of which
//! knows the traits, too. A picture and its mirror image are asked, and the mean counts.
//!
//! ```text
//! 24 × 24 × 2 --3×3--> 12 --max--> 12 × 12 --3×3--> 24 --max--> 6 × 6 --3×3--> 32 --max--> 3 × 3 --> 32 --traits--> 24 --> nats
//! ```

/// Width and height of the picture of a fit, cells.
pub const SIDE: usize = 24;
/// Channels before and after each convolution.
pub const CHANNELS: [usize; 4] = [2, 12, 24, 32];
/// Of the dense layers.
pub const DENSE: [usize; 3] = [SIDE / 8 * (SIDE / 8) * CHANNELS[3], 32, 24];
/// A trait further from its mean than so many standard deviations says no more.
const MOST_SIGMAS: f32 = 4.0;
/// Grey levels beside the spread by which a picture's are divided.
const LEAST_SPREAD: f32 = 2.0;
/// What is said of a picture beside its cells: ln of its spread and of its mean.
pub const OF_PICTURE: usize = 2;

/// From the middle of a fit to either side of its picture, half widths of the body; its lower and upper end, metres above the floor.
const PICTURE_WIDTH: f64 = 1.5;
const PICTURE_M: [f64; 2] = [-0.05, 0.70];

/// A cell without a pixel.
pub const UNSEEN: i16 = -1;

/// What a fit looks like: means of grey levels, each with how far from the body's middle it is, half widths, and how high above the floor, metres.
pub fn picture(grays: impl Iterator<Item = ([f64; 2], f64)>) -> Vec<i16> {
    let side = SIDE as f64;
    let [low_m, high_m] = PICTURE_M;
    let mut sums = [[0.0f64; 2]; SIDE * SIDE];
    for ([aside, height_m], gray) in grays {
        let across = (aside + PICTURE_WIDTH) / (2.0 * PICTURE_WIDTH) * side;
        let up = (height_m - low_m) / (high_m - low_m) * side;
        if (0.0..side).contains(&across) && (0.0..side).contains(&up) {
            let sum = &mut sums[up as usize * SIDE + across as usize];
            *sum = [sum[0] + gray, sum[1] + 1.0];
        }
    }
    sums.iter().map(|[gray, n]| if *n > 0.0 { (gray / n).round() as i16 } else { UNSEEN }).collect()
}

/// How many weights of each kind there are for so many traits, in their order: means and reciprocal spreads of the traits, then kernels
/// (tap, before, after) and biases of the convolutions, then the dense layers (before, after) and theirs.
pub fn sizes(traits: usize) -> [usize; 14] {
    let [c0, c1, c2, c3] = CHANNELS;
    let [d0, d1, d2] = DENSE;
    let all = traits + OF_PICTURE;
    [all, all, 9 * c0 * c1, c1, 9 * c1 * c2, c2, 9 * c2 * c3, c3, d0 * d1, d1, (d1 + all) * d2, d2, d2, 1]
}

/// The weights, kind by kind.
pub fn split(weights: &[f32], traits: usize) -> Option<[&[f32]; 14]> {
    let sizes = sizes(traits);
    if weights.len() != sizes.iter().sum::<usize>() {
        return None;
    }
    let mut rest = weights;
    Some(sizes.map(|size| {
        let (first, last) = rest.split_at(size);
        rest = last;
        first
    }))
}

/// What the network is shown: cells (gray less the mean over the spread, and whether there is a pixel) and numbers (traits, then what is said
/// of the picture), the latter not yet brought to one scale.
pub fn shown(picture: &[i16], traits: &[f64]) -> (Vec<f32>, Vec<f32>) {
    let seen = || picture.iter().filter(|gray| **gray != UNSEEN).map(|gray| f32::from(*gray));
    let n = (seen().count() as f32).max(1.0);
    let mean = seen().sum::<f32>() / n;
    let spread = (seen().map(|gray| (gray - mean).powi(2)).sum::<f32>() / n).sqrt();
    let cell = |gray: &i16| match *gray {
        UNSEEN => [0.0, 0.0],
        gray => [(f32::from(gray) - mean) / (spread + LEAST_SPREAD), 1.0],
    };
    let cells = picture.iter().flat_map(cell).collect();
    let of_picture = [(spread + 1.0).ln(), (mean + 1.0).ln()];
    (cells, traits.iter().map(|value| *value as f32).chain(of_picture).collect())
}

/// A picture's mirror image.
pub fn mirrored(cells: &[f32]) -> Vec<f32> {
    cells.chunks_exact(SIDE * CHANNELS[0]).flat_map(|row| row.rchunks_exact(CHANNELS[0]).flatten()).copied().collect()
}

/// Numbers brought to one scale.
pub fn scaled(numbers: &[f32], means: &[f32], per_spread: &[f32]) -> Vec<f32> {
    let scale = |((value, mean), per_spread): ((&f32, &f32), &f32)| {
        ((value - mean) * per_spread).clamp(-MOST_SIGMAS, MOST_SIGMAS)
    };
    numbers.iter().zip(means).zip(per_spread).map(scale).collect()
}

/// What a network says of a picture and its traits, nats; `None` where the weights are not for so many, or there is no picture.
pub fn log_odds(weights: &[f32], picture: &[i16], traits: &[f64]) -> Option<f64> {
    let kinds = split(weights, traits.len()).filter(|_| picture.len() == SIDE * SIDE)?;
    let (cells, numbers) = shown(picture, traits);
    let numbers = scaled(&numbers, kinds[0], kinds[1]);
    let of = |cells: &[f32]| f64::from(Pass::new(&kinds, cells, &numbers, &[1.0; DENSE[0]]).says);
    Some(0.5 * (of(&cells) + of(&mirrored(&cells))))
}

/// What a network makes of a picture on the way to what it says.
pub struct Pass {
    /// What comes before each convolution, and after the last one: the largest of every four of what came out of the one before.
    pub maps: [Vec<f32>; 4],
    /// What comes out of each.
    pub outs: [Vec<f32>; 3],
    /// What comes before each dense layer.
    pub before: [Vec<f32>; 3],
    /// Nats.
    pub says: f32,
}

impl Pass {
    /// Of cells and scaled numbers, the last map times `kept`.
    pub fn new(kinds: &[&[f32]; 14], cells: &[f32], numbers: &[f32], kept: &[f32; DENSE[0]]) -> Self {
        let mut maps = [cells.to_vec(), Vec::new(), Vec::new(), Vec::new()];
        let mut outs = [const { Vec::new() }; 3];
        for layer in 0..3 {
            let (out, side) = convolved(layer, &maps[layer], kinds[2 + 2 * layer], kinds[3 + 2 * layer]);
            maps[layer + 1] = pooled(&out, side, CHANNELS[layer + 1]);
            outs[layer] = out;
        }
        let last: Vec<f32> = maps[3].iter().zip(kept).map(|(x, kept)| x * kept).collect();
        let cut_off = |x: Vec<f32>| x.into_iter().map(|x| x.max(0.0)).collect::<Vec<_>>();
        let mut first = cut_off(dense(&last, kinds[8], kinds[9]));
        first.extend(numbers);
        let second = cut_off(dense(&first, kinds[10], kinds[11]));
        let says = dense(&second, kinds[12], kinds[13])[0];
        Self { maps, outs, before: [last, first, second], says }
    }
}

/// What comes out of a convolution (0, 1 or 2) of maps as the one before left them, and the width of the maps.
fn convolved(layer: usize, maps: &[f32], kernel: &[f32], bias: &[f32]) -> (Vec<f32>, usize) {
    let side = SIDE >> layer;
    let out = match layer {
        0 => convolved_to::<{ CHANNELS[1] }>(maps, side, kernel, bias),
        1 => convolved_to::<{ CHANNELS[2] }>(maps, side, kernel, bias),
        _ => convolved_to::<{ CHANNELS[3] }>(maps, side, kernel, bias),
    };
    (out, side)
}

/// A convolution by 3 × 3 with zeros beyond the border, cut off at 0: rows, columns, channels. As many sums as come out of it stay in registers.
fn convolved_to<const AFTER: usize>(maps: &[f32], side: usize, kernel: &[f32], bias: &[f32]) -> Vec<f32> {
    let before = maps.len() / (side * side);
    let (kernel, _) = kernel.as_chunks::<AFTER>();
    let start: [f32; AFTER] = std::array::from_fn(|c| bias.get(c).copied().unwrap_or(0.0));
    let mut out = Vec::with_capacity(side * side * AFTER);
    for (y, x) in (0..side).flat_map(|y| (0..side).map(move |x| (y, x))) {
        let mut sums = start;
        for (tap, at) in taps(x, y, side) {
            for (value, weights) in maps[at * before..][..before].iter().zip(&kernel[tap * before..]) {
                sums.iter_mut().zip(weights).for_each(|(sum, weight)| *sum += value * weight);
            }
        }
        out.extend(sums.map(|sum| sum.max(0.0)));
    }
    out
}

/// The taps of a kernel about a cell that are in the picture: which, and the cell.
pub fn taps(x: usize, y: usize, side: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..9).filter_map(move |tap| {
        let (u, v) = (x + tap % 3, y + tap / 3);
        ((1..=side).contains(&u) && (1..=side).contains(&v)).then(|| (tap, (v - 1) * side + u - 1))
    })
}

/// The largest of every four cells.
fn pooled(maps: &[f32], side: usize, channels: usize) -> Vec<f32> {
    let half = side / 2;
    let mut out = Vec::with_capacity(half * half * channels);
    for (y, x) in (0..half).flat_map(|y| (0..half).map(move |x| (y, x))) {
        let of = |v: usize, u: usize, c: usize| maps[((2 * y + v) * side + 2 * x + u) * channels + c];
        out.extend((0..channels).map(|c| of(0, 0, c).max(of(0, 1, c)).max(of(1, 0, c)).max(of(1, 1, c))));
    }
    out
}

/// Sums of all that comes before, each with its own weights: (before, after).
fn dense(before: &[f32], weights: &[f32], bias: &[f32]) -> Vec<f32> {
    let mut after = bias.to_vec();
    for (value, weights) in before.iter().zip(weights.chunks_exact(bias.len())) {
        after.iter_mut().zip(weights).for_each(|(sum, weight)| *sum += value * weight);
    }
    after
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_convolution_sums_what_is_about_a_cell_and_pooling_keeps_the_largest() {
        // One channel, a kernel that looks at the cell to the right and the one below.
        let maps: Vec<f32> = (0..16).map(|n| n as f32).collect();
        let mut kernel = [0.0; 9];
        (kernel[5], kernel[7]) = (1.0, 10.0);
        let out = convolved_to::<1>(&maps, 4, &kernel, &[0.5]);
        assert_eq!(out[5], 6.0 + 90.0 + 0.5);
        // Beyond the border is nothing.
        assert_eq!((out[3], out[12], out[15]), (70.5, 13.5, 0.5));
        assert_eq!(pooled(&maps, 4, 1), [5.0, 7.0, 13.0, 15.0]);
        assert_eq!(dense(&[1.0, 2.0], &[3.0, 4.0, 5.0, 6.0], &[0.0, 1.0]), [13.0, 17.0]);
    }

    #[test]
    fn a_picture_and_its_mirror_image_say_the_same_and_weights_for_others_say_nothing() {
        let weights: Vec<f32> =
            (0..sizes(3).iter().sum::<usize>()).map(|n| ((n * 37 % 101) as f32 - 50.0) * 2e-3).collect();
        let picture: Vec<i16> = (0..SIDE * SIDE).map(|n| (n * n % 97) as i16 - 1).collect();
        let mirror: Vec<i16> = picture.chunks_exact(SIDE).flat_map(|row| row.iter().rev()).copied().collect();
        let traits = [0.2, -3.0, 1.0];
        let says = |picture: &[i16], traits: &[f64]| log_odds(&weights, picture, traits).unwrap();
        let said = says(&picture, &traits);
        assert!(said.is_finite() && said != 0.0 && (said - says(&mirror, &traits)).abs() < 1e-5);
        assert!((said - says(&picture, &[0.2, -3.0, 1.3])).abs() > 1e-6);
        assert_eq!(log_odds(&weights, &picture, &traits[..2]), None);
        assert_eq!(log_odds(&weights, &picture[1..], &traits), None);
        // Nothing to be seen.
        assert!(says(&[UNSEEN; SIDE * SIDE], &traits).is_finite());
    }
}
