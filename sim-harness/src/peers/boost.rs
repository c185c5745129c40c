//! Boosted decision trees: what the detector's verdict is learnt with (Friedman 2001; leaves by Newton's step and quantile bins as in
//! LightGBM).
//!
//! Each tree is grown best leaf first on the gradients that the trees before it leave, and counts a little. Each looks at a part of the
//! traits, so that what only one of them seems to say does not decide alone.

use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha12Rng;
use robot_agent::peers::Node;

/// A tree, its nodes as the detector walks them.
pub type Tree = Vec<Node>;

const SEED: u64 = 7;
/// Trees, their most leaves, and what part of Newton's step each of them goes.
const TREES: usize = 150;
const MOST_LEAVES: usize = 8;
const RATE: f64 = 0.08;
/// Fewest examples of a leaf, and the ridge on its step.
const LEAST_EXAMPLES: usize = 12;
const RIDGE: f64 = 1.0;
/// Part of the traits that a tree looks at.
const TRAITS_SHARE: f64 = 0.5;
/// Most bins of a trait.
const BINS: usize = 64;

/// Examples: their traits, each in a bin, and what they are.
struct Table {
    /// Of each trait the least values of its bins but the first.
    edges: Vec<Vec<f32>>,
    /// Trait after trait, the bins of all examples.
    bins: Vec<Vec<u8>>,
    labels: Vec<f64>,
}

/// A leaf that may be split.
struct Leaf {
    node: usize,
    examples: Vec<u32>,
    split: Option<Split>,
}

#[derive(Clone, Copy)]
struct Split {
    gain: f64,
    of: usize,
    /// From this bin on examples go the second way.
    from: usize,
}

/// Sums of gradients and curvatures.
#[derive(Clone, Copy, Default)]
struct Sums {
    n: usize,
    gradient: f64,
    curvature: f64,
}

impl Sums {
    fn add(&mut self, [gradient, curvature]: [f64; 2]) {
        self.n += 1;
        self.gradient += gradient;
        self.curvature += curvature;
    }

    fn join(&mut self, other: Self) {
        self.n += other.n;
        self.gradient += other.gradient;
        self.curvature += other.curvature;
    }

    fn less(self, other: Self) -> Self {
        Self {
            n: self.n - other.n,
            gradient: self.gradient - other.gradient,
            curvature: self.curvature - other.curvature,
        }
    }

    fn step(self) -> f64 {
        self.gradient / (self.curvature + RIDGE)
    }

    fn worth(self) -> f64 {
        self.gradient * self.step()
    }
}

/// Trees whose sum is the log-odds of an example's being true. The first is what is known before any trait.
pub fn grow(rows: &[(&[f64], bool)]) -> Vec<Tree> {
    let table = Table::of(rows);
    let mut rng = ChaCha12Rng::seed_from_u64(SEED);
    let true_ones = table.labels.iter().sum::<f64>();
    let before = ((true_ones + 0.5) / (rows.len() as f64 - true_ones + 0.5)).ln();
    let mut odds = vec![before; rows.len()];
    let mut trees = vec![vec![(0, 0.0, before as f32, [0, 0])]];
    let mut traits: Vec<usize> = (0..table.bins.len()).collect();
    for _ in 0..TREES {
        traits.shuffle(&mut rng);
        let looked_at = &traits[..(TRAITS_SHARE * traits.len() as f64).ceil() as usize];
        trees.push(table.tree(looked_at, &mut odds));
    }
    trees
}

impl Table {
    fn of(rows: &[(&[f64], bool)]) -> Self {
        let traits = rows.first().map_or(0, |(traits, _)| traits.len());
        let value = |row: &(&[f64], bool), k: usize| row.0[k] as f32;
        let edges: Vec<Vec<f32>> = (0..traits)
            .map(|k| {
                let mut values: Vec<f32> = rows.iter().map(|row| value(row, k)).collect();
                values.sort_by(f32::total_cmp);
                let mut edges: Vec<f32> = (1..BINS)
                    .filter_map(|bin| {
                        let at = bin * values.len() / BINS;
                        let (below, here) = (values.get(at.checked_sub(1)?)?, values.get(at)?);
                        // A value that many have stays in one bin.
                        let below = if below < here { below } else { values.iter().rev().find(|v| *v < here)? };
                        Some(0.5 * (below + here))
                    })
                    .collect();
                edges.dedup();
                edges
            })
            .collect();
        let bin = |edges: &[f32], value: f32| edges.partition_point(|edge| *edge <= value) as u8;
        let bins = edges
            .iter()
            .enumerate()
            .map(|(k, edges)| rows.iter().map(|row| bin(edges, value(row, k))).collect())
            .collect();
        Self { edges, bins, labels: rows.iter().map(|(_, is)| f64::from(u8::from(*is))).collect() }
    }

    /// One more tree; `odds` go on by what it says.
    fn tree(&self, traits: &[usize], odds: &mut [f64]) -> Tree {
        let slopes: Vec<[f64; 2]> = odds
            .iter()
            .zip(&self.labels)
            .map(|(odds, label)| {
                let likely = 1.0 / (1.0 + (-odds).exp());
                [label - likely, likely * (1.0 - likely)]
            })
            .collect();
        let all: Vec<u32> = (0..odds.len() as u32).collect();
        let sums = |examples: &[u32]| {
            let mut sums = Sums::default();
            examples.iter().for_each(|e| sums.add(slopes[*e as usize]));
            sums
        };
        let nats = |examples: &[u32]| (RATE * sums(examples).step()) as f32;
        let mut tree: Tree = vec![(0, 0.0, nats(&all), [0, 0])];
        let split = self.best_split(traits, &all, &slopes);
        let mut leaves = vec![Leaf { node: 0, examples: all, split }];
        while leaves.len() < MOST_LEAVES {
            let gain = |leaf: &Leaf| leaf.split.map_or(0.0, |split| split.gain);
            let best = (0..leaves.len()).max_by(|a, b| gain(&leaves[*a]).total_cmp(&gain(&leaves[*b])));
            let Some((best, split)) = best.and_then(|best| Some((best, leaves[best].split?))) else { break };
            let leaf = leaves.swap_remove(best);
            let is_second = |e: &u32| usize::from(self.bins[split.of][*e as usize]) >= split.from;
            let (second, first): (Vec<u32>, Vec<u32>) = leaf.examples.into_iter().partition(is_second);
            let next = tree.len();
            let (of, least) = (split.of as u8, self.edges[split.of][split.from - 1]);
            tree[leaf.node] = (of, least, tree[leaf.node].2, [next as u16, next as u16 + 1]);
            for (node, examples) in [(next, first), (next + 1, second)] {
                tree.push((0, 0.0, nats(&examples), [0, 0]));
                let split = self.best_split(traits, &examples, &slopes);
                leaves.push(Leaf { node, examples, split });
            }
        }
        for leaf in &leaves {
            let said = f64::from(tree[leaf.node].2);
            leaf.examples.iter().for_each(|e| odds[*e as usize] += said);
        }
        tree
    }

    fn best_split(&self, traits: &[usize], examples: &[u32], slopes: &[[f64; 2]]) -> Option<Split> {
        let mut best: Option<Split> = None;
        if examples.len() < 2 * LEAST_EXAMPLES {
            return None;
        }
        for of in traits {
            let mut bins = [Sums::default(); BINS];
            examples.iter().for_each(|e| bins[usize::from(self.bins[*of][*e as usize])].add(slopes[*e as usize]));
            let mut all = Sums::default();
            bins.iter().for_each(|bin| all.join(*bin));
            let mut first = Sums::default();
            for from in 1..=self.edges[*of].len() {
                first.join(bins[from - 1]);
                let second = all.less(first);
                if first.n.min(second.n) < LEAST_EXAMPLES {
                    continue;
                }
                let gain = first.worth() + second.worth() - all.worth();
                if gain > best.map_or(1e-9, |best| best.gain) {
                    best = Some(Split { gain, of: *of, from });
                }
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::RngExt;
    use robot_agent::peers::log_odds;

    /// True where both traits are on the same side of a half, nine times in ten; a third trait says nothing.
    fn drawn(n: usize, seed: u64) -> Vec<([f64; 3], bool)> {
        let mut rng = ChaCha12Rng::seed_from_u64(seed);
        let mut draw = || {
            let traits: [f64; 3] = std::array::from_fn(|_| rng.random_range(0.0..1.0));
            let is_alike = (traits[0] > 0.5) == (traits[1] > 0.5);
            (traits, is_alike == rng.random_bool(0.9))
        };
        (0..n).map(|_| draw()).collect()
    }

    #[test]
    fn trees_find_what_no_weights_could_and_are_as_sure_as_they_are_right() {
        let examples = drawn(4000, 1);
        let rows: Vec<(&[f64], bool)> = examples.iter().map(|(t, is)| (&t[..], *is)).collect();
        let trees = grow(&rows);
        let (mut right, mut surprise, others) = (0, 0.0, drawn(4000, 2));
        for (traits, is) in &others {
            let odds = log_odds(&trees, traits);
            right += usize::from((odds > 0.0) == *is);
            surprise += (1.0 + (if *is { -odds } else { odds }).exp()).ln();
        }
        let (right, surprise) = (right as f64 / 4000.0, surprise / 4000.0);
        // What was drawn leaves ln-loss 0.325.
        assert!(right > 0.87 && surprise < 0.37, "{right} {surprise}");
    }

    #[test]
    fn a_trait_that_all_share_and_too_few_examples_split_nothing() {
        let rows: Vec<(&[f64], bool)> = vec![(&[1.0], true), (&[1.0], false), (&[1.0], true)];
        let trees = grow(&rows);
        assert!(trees.iter().all(|tree| tree.len() == 1));
        assert!((log_odds(&trees, &[1.0]) - (2.5f64 / 1.5).ln()).abs() < 0.2);
    }
}
