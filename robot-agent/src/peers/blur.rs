//! A step, a ramp and a square root, each seen through a Gaussian blur.
//!
//! Problem: the edge of a lit cylinder is not a step. Towards its outline a body that is lit from the observer's side darkens
//! like √t (t = distance inside the outline), which a plain step model takes for a narrower body: a bias of range.
//! Insight: across the body the light is a smooth function times 1, t and √t, and the convolution of each with a Gaussian of
//! unit width is one universal function of t/b. The last has no closed form, so it is tabulated once.

use std::sync::LazyLock;

const STEP: f64 = 0.01;
const LOW: f64 = -5.0;
const HIGH: f64 = 12.0;

struct Tables {
    step: Vec<f64>,
    bell: Vec<f64>,
    root: Vec<f64>,
}

static TABLES: LazyLock<Tables> = LazyLock::new(|| {
    let n = ((HIGH - LOW) / STEP).round() as usize + 2;
    let at = |i: usize| LOW + STEP * i as f64;
    let step = (0..n).map(|i| 0.5 * statrs::function::erf::erfc(-at(i) / std::f64::consts::SQRT_2)).collect();
    let bell = (0..n).map(|i| density(at(i))).collect();
    let root = (0..n).map(|i| root_by_quadrature(at(i))).collect();
    Tables { step, bell, root }
});

/// ∫₀^∞ √t N(y − t) dt, with t = q² so that the integrand is smooth.
fn root_by_quadrature(y: f64) -> f64 {
    let from = (y - 7.0).max(0.0).sqrt();
    let to = (y.max(0.0) + 7.0).sqrt();
    let n = 400;
    let h = (to - from) / f64::from(n);
    let f = |q: f64| 2.0 * q * q * density(y - q * q);
    let inner: f64 = (1..n).map(|i| f(from + h * f64::from(i)) * if i % 2 == 1 { 4.0 } else { 2.0 }).sum();
    (f(from) + inner + f(to)) * h / 3.0
}

fn lookup(table: &[f64], y: f64) -> f64 {
    let x = (y - LOW) / STEP;
    let i = x as usize;
    let f = x - i as f64;
    table[i] + f * (table[i + 1] - table[i])
}

/// Normal density.
fn density(y: f64) -> f64 {
    0.398_942_280_401_432_7 * (-0.5 * y * y).exp()
}

/// The unit step at 0 after a blur of standard deviation 1, to 2·10⁻⁶.
pub fn step(y: f64) -> f64 {
    if y <= LOW {
        0.0
    } else if y >= 5.0 {
        1.0
    } else {
        lookup(&TABLES.step, y)
    }
}

/// [`density`] to 5·10⁻⁶, without the call.
pub fn bell(y: f64) -> f64 {
    if y.abs() >= 5.0 { 0.0 } else { lookup(&TABLES.bell, y) }
}

/// √max(t, 0) after a blur of standard deviation 1, to 10⁻⁵.
pub fn root(y: f64) -> f64 {
    if y <= LOW {
        0.0
    } else if y >= HIGH {
        y.sqrt() * (1.0 - 0.125 / (y * y))
    } else {
        lookup(&TABLES.root, y)
    }
}

/// The derivative of [`root`], to 10⁻³.
pub fn root_slope(y: f64) -> f64 {
    (root(y + 2.0 * STEP) - root(y - 2.0 * STEP)) / (4.0 * STEP)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tables_agree_with_direct_summation() {
        for y in [-4.2, -1.0, -0.003, 0.0, 0.7, 3.3, 11.9, 30.0_f64] {
            let (mut s, mut r, mut q) = (0.0, 0.0, 0.0);
            let h = 1e-3;
            for i in 0..60_000 {
                let t = (f64::from(i) + 0.5) * h;
                let w = density(y - t) * h;
                s += w;
                r += t * w;
                q += t.sqrt() * w;
            }
            assert!((step(y) - s).abs() < 5e-5, "step at {y}");
            assert!((bell(y) - density(y)).abs() < 1e-5, "bell at {y}");
            assert!((y * step(y) + bell(y) - r).abs() < 5e-5, "ramp at {y}");
            assert!((root(y) - q).abs() < 5e-5, "root at {y}: {} {q}", root(y));
        }
    }
}
