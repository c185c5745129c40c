//! From light to grey levels: the lens blurs, the sensor adds noise and rounds.

use rand::SeedableRng;
use rand_chacha::ChaCha12Rng;
use rand_distr::{Distribution, StandardNormal};

/// Pre-drawn normal numbers; each row of each picture begins somewhere else in them.
const NOISE: usize = 1 << 16;

/// A lens and sensor.
#[derive(Debug)]
pub struct Sensor {
    kernel: Vec<f32>,
    noise: Vec<f32>,
    seed: u64,
    scratch: Vec<f32>,
}

impl Sensor {
    /// Blur and noise as standard deviations; `seed` is the camera's own.
    pub fn new(blur_px: f64, noise_gray: f64, seed: u64) -> Self {
        let reach = (3.5 * blur_px).ceil() as i64;
        let weight = |i: i64| if blur_px > 0.0 { (-0.5 * (i as f64 / blur_px).powi(2)).exp() } else { 1.0 };
        let sum: f64 = (-reach..=reach).map(weight).sum();
        let mut rng = ChaCha12Rng::seed_from_u64(0x6e6f_6973_6521);
        let noise = (0..NOISE)
            .map(|_| {
                let n: f64 = StandardNormal.sample(&mut rng);
                (n * noise_gray) as f32
            })
            .collect();
        Self { kernel: (-reach..=reach).map(|i| (weight(i) / sum) as f32).collect(), noise, seed, scratch: Vec::new() }
    }

    /// Grey levels of a picture of light. `gain` is grey levels per unit of light, `time_s` chooses the noise.
    pub fn develop(&mut self, light: &[f32], width: usize, gain: f32, time_s: f64) -> Vec<u8> {
        let height = light.len() / width;
        let reach = self.kernel.len() / 2;
        self.scratch.clear();
        self.scratch.resize(light.len(), 0.0);
        for (row, out) in light.chunks_exact(width).zip(self.scratch.chunks_exact_mut(width)) {
            blur_row(row, out, &self.kernel);
        }
        let mut gray = vec![0u8; light.len()];
        let mut sum = vec![0.0f32; width];
        for y in 0..height {
            sum.fill(0.0);
            for (k, w) in self.kernel.iter().enumerate() {
                let from = y + k;
                if from >= reach && from - reach < height {
                    let row = &self.scratch[(from - reach) * width..(from - reach + 1) * width];
                    sum.iter_mut().zip(row).for_each(|(s, l)| *s += w * gain * l);
                }
            }
            let start = mix(self.seed ^ time_s.to_bits() ^ ((y as u64) << 40)) as usize % (NOISE - width);
            let noise = &self.noise[start..start + width];
            for ((g, s), n) in gray[y * width..(y + 1) * width].iter_mut().zip(&sum).zip(noise) {
                // A picture has no light outside the annulus, and its black stays black.
                *g = if *s > 0.0 { (s + n + 0.5).clamp(0.0, 255.0) as u8 } else { 0 };
            }
        }
        gray
    }
}

fn blur_row(row: &[f32], out: &mut [f32], kernel: &[f32]) {
    let reach = kernel.len() / 2;
    let width = row.len();
    for (k, w) in kernel.iter().enumerate() {
        let shift = k as i64 - reach as i64;
        let (from, to) = ((-shift).max(0) as usize, (width as i64 - shift.max(0)) as usize);
        let source = &row[(from as i64 + shift) as usize..(to as i64 + shift) as usize];
        out[from..to].iter_mut().zip(source).for_each(|(o, s)| *o += w * s);
    }
}

/// A well mixed number from any (splitmix64).
pub fn mix(x: u64) -> u64 {
    let mut z = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_has_the_stated_deviation_and_differs_between_instants() {
        let mut sensor = Sensor::new(0.0, 2.0, 5);
        let light = vec![1.0; 256 * 256];
        let (a, b) = (sensor.develop(&light, 256, 120.0, 1.0), sensor.develop(&light, 256, 120.0, 1.1));
        let deviation = |levels: &[f64]| {
            let mean = levels.iter().sum::<f64>() / levels.len() as f64;
            (levels.iter().map(|g| (g - mean).powi(2)).sum::<f64>() / levels.len() as f64).sqrt()
        };
        let single = deviation(&a.iter().map(|g| f64::from(*g)).collect::<Vec<_>>());
        // Rounding to whole levels adds a twelfth of a level squared.
        assert!((single - (4.0f64 + 1.0 / 12.0).sqrt()).abs() < 0.03, "{single}");
        let between = deviation(&a.iter().zip(&b).map(|(a, b)| f64::from(*a) - f64::from(*b)).collect::<Vec<_>>());
        assert!((between - single * 2f64.sqrt()).abs() < 0.06, "{between}");
    }

    #[test]
    fn a_point_of_light_is_blurred_to_the_stated_width_and_keeps_its_light() {
        let mut light = vec![0.0; 64 * 64];
        light[32 * 64 + 32] = 1.0;
        let gray = Sensor::new(0.8, 0.0, 0).develop(&light, 64, 1000.0, 0.0);
        let (mut sum, mut second) = (0.0, 0.0);
        for (i, g) in gray.iter().enumerate() {
            let x = i as f64 % 64.0 - 32.0;
            sum += f64::from(*g);
            second += f64::from(*g) * x * x;
        }
        assert!((sum - 1000.0).abs() < 20.0, "{sum}");
        assert!(((second / sum).sqrt() - 0.8).abs() < 0.03, "{}", (second / sum).sqrt());
    }
}
