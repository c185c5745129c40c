//! Stochastic gradient descent as Adam (Kingma and Ba, 2015) does it.

/// Forgetting of the first and second moments, and the floor.
const BETAS: [f32; 2] = [0.9, 0.999];
const FLOOR: f32 = 1e-8;

/// The moments of some weights' gradients.
pub struct Adam {
    first: Vec<f32>,
    second: Vec<f32>,
    step: i32,
}

impl Adam {
    /// For so many weights.
    pub fn new(weights: usize) -> Self {
        Self { first: vec![0.0; weights], second: vec![0.0; weights], step: 0 }
    }

    /// One step of length `rate` down a gradient.
    pub fn descend(&mut self, weights: &mut [f32], gradient: &[f32], rate: f32) {
        self.step += 1;
        let unbiased = BETAS.map(|beta| 1.0 - beta.powi(self.step));
        let moments = self.first.iter_mut().zip(&mut self.second);
        for ((weight, g), (first, second)) in weights.iter_mut().zip(gradient).zip(moments) {
            *first = BETAS[0] * *first + (1.0 - BETAS[0]) * g;
            *second = BETAS[1] * *second + (1.0 - BETAS[1]) * g * g;
            *weight -= rate * (*first / unbiased[0]) / ((*second / unbiased[1]).sqrt() + FLOOR);
        }
    }
}

/// The length of a step of many: they grow shorter as a cosine does.
pub fn cosine(rate: f32, step: usize, steps: usize) -> f32 {
    0.5 * rate * (1.0 + (std::f32::consts::PI * step as f32 / steps as f32).cos())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_the_bottom_of_a_crooked_valley() {
        let mut weights = [3.0f32, -2.0];
        let mut adam = Adam::new(2);
        for step in 0..2000 {
            let [x, y] = weights;
            // Of (x − 1)² + 5 (y − x)².
            let gradient = [2.0 * (x - 1.0) - 10.0 * (y - x), 10.0 * (y - x)];
            adam.descend(&mut weights, &gradient, cosine(0.05, step, 2000));
        }
        assert!(weights.iter().all(|w| (w - 1.0).abs() < 0.01), "{weights:?}");
    }
}
