//! Gradient descent on the cross entropy.

use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha12Rng;
use robot_agent::tracking::bodily::{HIDDEN, INPUTS, WEIGHTS, active, log_odds, probability};

use super::Example;
use crate::adam::{Adam, cosine};

const SEED: u64 = 5;
const BATCH: usize = 256;
/// Length of the first steps.
const RATE: f32 = 3e-3;

/// The weights that explain the examples, for inputs as they are, after so many steps.
pub fn learn(examples: &[&Example], steps: usize) -> Vec<f32> {
    if examples.is_empty() {
        return vec![0.0; WEIGHTS];
    }
    let scaling = Scaling::of(examples);
    let mut rng = ChaCha12Rng::seed_from_u64(SEED);
    let most = (6.0 / INPUTS as f32).sqrt();
    let mut net: Vec<f32> = (0..WEIGHTS).map(|_| most * (2.0 * rng.random::<f32>() - 1.0)).collect();
    let mut adam = Adam::new(WEIGHTS);
    let mut order: Vec<usize> = (0..examples.len()).collect();
    let mut next = order.len();
    for step in 0..steps {
        let mut gradient = vec![0.0; WEIGHTS];
        let mut weight = 0.0;
        for _ in 0..BATCH {
            if next == order.len() {
                order.shuffle(&mut rng);
                next = 0;
            }
            let example = examples[order[next]];
            next += 1;
            weight += example.weight;
            let body = f32::from(u8::from(example.is_body));
            add_gradient(&net, &scaling.scaled(&example.inputs), body, example.weight, &mut gradient);
        }
        gradient.iter_mut().for_each(|g| *g /= weight);
        adam.descend(&mut net, &gradient, cosine(RATE, step, steps));
    }
    scaling.folded_into(net)
}

/// Adds `weight` times the gradient of the cross entropy of an example.
fn add_gradient(net: &[f32], inputs: &[f32; INPUTS], body: f32, weight: f32, gradient: &mut [f32]) {
    let by_odds = weight * (probability(log_odds(net, inputs)) - body);
    let (units, last) = net.split_at(HIDDEN * (INPUTS + 1));
    let (of_units, of_last) = gradient.split_at_mut(units.len());
    for (k, (unit, of_unit)) in units.chunks_exact(INPUTS + 1).zip(of_units.chunks_exact_mut(INPUTS + 1)).enumerate() {
        let active = active(unit, inputs);
        if active > 0.0 {
            of_last[k] += by_odds * active;
            let by_active = by_odds * last[k];
            of_unit.iter_mut().zip(inputs).for_each(|(g, x)| *g += by_active * x);
            of_unit[INPUTS] += by_active;
        }
    }
    of_last[HIDDEN] += by_odds;
}

/// Brings inputs to mean 0 and spread 1.
struct Scaling {
    means: [f32; INPUTS],
    spreads: [f32; INPUTS],
}

impl Scaling {
    fn of(examples: &[&Example]) -> Self {
        let n = examples.len() as f64;
        let mean = |f: &dyn Fn(&Example) -> f64| examples.iter().map(|e| f(e)).sum::<f64>() / n;
        let means: [f64; INPUTS] = std::array::from_fn(|k| mean(&|e| f64::from(e.inputs[k])));
        let spread = |k: usize| mean(&|e| (f64::from(e.inputs[k]) - means[k]).powi(2)).sqrt();
        Self { means: means.map(|m| m as f32), spreads: std::array::from_fn(|k| spread(k) as f32 + 1e-6) }
    }

    fn scaled(&self, inputs: &[f32; INPUTS]) -> [f32; INPUTS] {
        std::array::from_fn(|k| (inputs[k] - self.means[k]) / self.spreads[k])
    }

    /// Weights for inputs as they are, from those for scaled ones.
    fn folded_into(&self, mut net: Vec<f32>) -> Vec<f32> {
        for unit in net[..HIDDEN * (INPUTS + 1)].chunks_exact_mut(INPUTS + 1) {
            for k in 0..INPUTS {
                unit[k] /= self.spreads[k];
                unit[INPUTS] -= unit[k] * self.means[k];
            }
        }
        net
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn inputs(rng: &mut ChaCha12Rng) -> [f32; INPUTS] {
        std::array::from_fn(|k| k as f32 + 2.0 * rng.random::<f32>())
    }

    #[test]
    fn gradients_are_those_of_differences() {
        let mut rng = ChaCha12Rng::seed_from_u64(1);
        let net: Vec<f32> = (0..WEIGHTS).map(|_| 0.2 * (rng.random::<f32>() - 0.5)).collect();
        let inputs: [f32; INPUTS] = std::array::from_fn(|_| rng.random::<f32>() - 0.5);
        let mut gradient = vec![0.0; WEIGHTS];
        add_gradient(&net, &inputs, 0.3, 2.0, &mut gradient);
        let loss = |net: &[f32]| {
            let p = probability(log_odds(net, &inputs));
            -2.0 * (0.3 * p.ln() + 0.7 * (1.0 - p).ln())
        };
        for k in (0..WEIGHTS).step_by(7) {
            let mut more = net.clone();
            let mut less = net.clone();
            (more[k], less[k]) = (net[k] + 1e-2, net[k] - 1e-2);
            let difference = (loss(&more) - loss(&less)) / 2e-2;
            assert!((gradient[k] - difference).abs() < 1e-3, "{k}: {} {difference}", gradient[k]);
        }
    }

    #[test]
    fn what_hangs_on_two_inputs_together_is_learnt_whatever_their_scale() {
        let mut rng = ChaCha12Rng::seed_from_u64(2);
        let examples: Vec<Example> = (0..4000)
            .map(|_| {
                let inputs = inputs(&mut rng);
                Example { inputs, is_body: (inputs[3] > 4.0) != (inputs[5] > 6.0), weight: 1.0 }
            })
            .collect();
        let net = learn(&examples.iter().take(3000).collect::<Vec<_>>(), 3000);
        let right = examples.iter().skip(3000).filter(|e| (log_odds(&net, &e.inputs) > 0.0) == e.is_body);
        assert!(right.count() > 900);
    }
}
