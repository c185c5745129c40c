//! What tells a robot from what only looks like one: the weights of the detector's verdict, learnt from labelled fits.
//!
//! Logistic regression by Newton's method with a small ridge, on traits brought to unit spread. What the detector fitted is labelled by
//! the truth: a robot where the fit's place is within χ²₂'s 99.99 % of one's that looks like it (a cylinder or a plate), none where
//! there is none near. A plate that is not where it is said to be is as bad as no plate; such a cylinder teaches nothing.

use std::fmt::Write as _;
use std::io::{BufRead, Write as _};
use std::path::Path;

use nalgebra::{DMatrix, DVector, Vector2};
use robot_agent::peers::{Basis, Fit};
use serde::{Deserialize, Serialize};

use super::PeersError;
use super::trial::{Kind, View, turned};

/// Squared sigmas within which a fit's bearing and range are a robot's (χ²₂ at 99.99 %).
const RIGHT_CHI2: f64 = 18.4;
/// Weight of the ridge: that of so many examples at the edge of doubt.
const RIDGE: f64 = 0.5;
const MOST_STEPS: usize = 30;
/// Log-odds are worked out up to this.
const MOST_LOG_ODDS: f64 = 30.0;
/// Fewest examples of either label.
const LEAST_EXAMPLES: usize = 50;

/// A labelled fit, a line of JSON in a file of fits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Example {
    /// Of the layout.
    pub seed: u64,
    /// In the layout.
    pub picture: usize,
    /// What the fit stands on.
    pub basis: Basis,
    /// Whether it is a robot; `None` teaches nothing.
    pub is_robot: Option<bool>,
    /// Whether the detector took it for one.
    pub is_taken: bool,
    /// In the order of [`Basis::names`].
    pub traits: Vec<f64>,
}

/// Labels a picture's fits.
pub fn label(seed: u64, picture: usize, fits: Vec<Fit>, views: &[View]) -> impl Iterator<Item = Example> {
    fits.into_iter().map(move |Fit { peer, traits, is_taken }| {
        let is_plate = matches!(traits.basis, Basis::Stripes | Basis::PlateEnd);
        let alike = views.iter().filter(|v| (v.kind == Kind::Rectangle) == is_plate);
        let near = alike.filter(|v| v.may_be(&peer));
        let is_robot = match near.min_by(|a, b| a.apart_m(&peer).total_cmp(&b.apart_m(&peer))) {
            None => Some(false),
            Some(view) => {
                let error = Vector2::new(turned(peer.bearing_rad - view.bearing_rad), peer.range_m - view.range_m);
                let information = peer.covariance.try_inverse();
                let is_there = information.is_some_and(|i| (error.transpose() * i * error)[0] < RIGHT_CHI2);
                // Of a cylinder's fits the better one is kept, of a plate's the first.
                Some(is_there).filter(|is_there| *is_there || is_plate)
            }
        };
        Example { seed, picture, basis: traits.basis, is_robot, is_taken, traits: traits.values }
    })
}

/// Writes a file of fits.
pub fn write<'a>(path: &Path, examples: impl Iterator<Item = &'a Example>) -> Result<(), PeersError> {
    let failed = |why: &dyn std::fmt::Display| PeersError(format!("{}: {why}", path.display()));
    let mut file = std::io::BufWriter::new(std::fs::File::create(path).map_err(|e| failed(&e))?);
    for example in examples {
        serde_json::to_writer(&mut file, example).map_err(|e| failed(&e))?;
        file.write_all(b"\n").map_err(|e| failed(&e))?;
    }
    file.flush().map_err(|e| failed(&e))
}

/// Reads a file of fits.
pub fn read(path: &Path) -> Result<Vec<Example>, PeersError> {
    let failed = |why: &dyn std::fmt::Display| PeersError(format!("{}: {why}", path.display()));
    let file = std::fs::File::open(path).map_err(|e| failed(&e))?;
    let mut examples = Vec::new();
    for (n, line) in std::io::BufReader::new(file).lines().enumerate() {
        let line = line.map_err(|e| failed(&e))?;
        let example: Example = serde_json::from_str(&line).map_err(|e| {
            failed(&format_args!("line {}: {e}; lines as `sim-harness peers --fits` writes them", n + 1))
        })?;
        let traits = example.basis.names().count();
        if example.traits.len() != traits || example.traits.iter().any(|t| !t.is_finite()) {
            let why =
                format!("line {}: `traits` are {:?}; {traits} finite numbers would be right", n + 1, example.traits);
            return Err(failed(&why));
        }
        examples.push(example);
    }
    Ok(examples)
}

/// The weights that explain the labels best, as tables for `credible.rs`, with what they and the detector's verdict tell apart.
pub fn learn(examples: &[Example]) -> Result<String, PeersError> {
    let mut text = String::new();
    for basis in Basis::ALL {
        let of: Vec<(&Example, bool)> =
            examples.iter().filter(|e| e.basis == basis).filter_map(|e| Some((e, e.is_robot?))).collect();
        let robots = of.iter().filter(|(_, is_robot)| *is_robot).count();
        let others = of.len() - robots;
        if robots.min(others) < LEAST_EXAMPLES {
            return Err(PeersError(format!(
                "of {basis:?} there are {robots} fits of robots and {others} others; at least {LEAST_EXAMPLES} of each would be right"
            )));
        }
        let rows: Vec<(&[f64], bool)> = of.iter().map(|(e, is_robot)| (&e.traits[..], *is_robot)).collect();
        let weights =
            regress(&rows).ok_or_else(|| PeersError(format!("the weights of {basis:?} are not determined")))?;
        let _ = writeln!(text, "{basis:?}: {robots} fits of robots, {others} others");
        for (name, weight) in basis.names().zip(weights.iter()) {
            let _ = writeln!(text, "    (\"{name}\", {weight:.3}),");
        }
        let count = |taken: &dyn Fn(&Example) -> bool| {
            let with = |robot: bool| of.iter().filter(|(e, is_robot)| *is_robot == robot && taken(e)).count();
            (with(true), with(false))
        };
        let (now_robots, now_others) = count(&|e| e.is_taken);
        let _ = writeln!(text, "  taken by the detector: {now_robots} robots, {now_others} others");
        for least in [0.0, 0.5, 1.0, 1.5, 2.0, 3.0] {
            let odds = |e: &Example| e.traits.iter().zip(weights.iter()).map(|(t, w)| t * w).sum::<f64>();
            let (robots, others) = count(&|e| odds(e) >= least);
            let _ = writeln!(text, "  log-odds of {least:.1} and more: {robots} robots, {others} others");
        }
    }
    Ok(text)
}

/// Weights of traits, the first of which is always 1.
fn regress(rows: &[(&[f64], bool)]) -> Option<DVector<f64>> {
    let n = rows.first()?.0.len();
    let mean = |k: usize| rows.iter().map(|(t, _)| t[k]).sum::<f64>() / rows.len() as f64;
    let middle: Vec<f64> = (0..n).map(|k| if k == 0 { 0.0 } else { mean(k) }).collect();
    let spread: Vec<f64> = (0..n)
        .map(|k| {
            let square = rows.iter().map(|(t, _)| (t[k] - middle[k]).powi(2)).sum::<f64>();
            (square / rows.len() as f64).sqrt().max(1e-6)
        })
        .collect();
    let spread: Vec<f64> = spread.into_iter().enumerate().map(|(k, s)| if k == 0 { 1.0 } else { s }).collect();
    let mut weights = DVector::<f64>::zeros(n);
    for _ in 0..MOST_STEPS {
        let mut information = DMatrix::<f64>::identity(n, n) * RIDGE;
        let mut gradient = -RIDGE * &weights;
        (information[(0, 0)], gradient[0]) = (1e-9, 0.0);
        for (traits, is_robot) in rows {
            let row = DVector::from_fn(n, |k, _| (traits[k] - middle[k]) / spread[k]);
            let odds = weights.dot(&row).clamp(-MOST_LOG_ODDS, MOST_LOG_ODDS);
            let likely = 1.0 / (1.0 + (-odds).exp());
            gradient.axpy(f64::from(u8::from(*is_robot)) - likely, &row, 1.0);
            information.ger((likely * (1.0 - likely)).max(1e-9), &row, &row, 1.0);
        }
        let step = information.cholesky()?.solve(&gradient);
        weights += &step;
        if step.amax() < 1e-6 {
            break;
        }
    }
    let mut weights = DVector::from_fn(n, |k, _| weights[k] / spread[k]);
    weights[0] -= (1..n).map(|k| weights[k] * middle[k]).sum::<f64>();
    Some(weights)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_those_that_the_labels_were_drawn_with() {
        use rand::{RngExt, SeedableRng};
        let mut rng = rand_chacha::ChaCha12Rng::seed_from_u64(5);
        let truth = [-1.0, 2.0, -0.5];
        let drawn: Vec<([f64; 3], bool)> = (0..20_000)
            .map(|_| {
                let traits = [1.0, rng.random_range(-1.0..2.0), rng.random_range(0.0..9.0)];
                let odds: f64 = traits.iter().zip(truth).map(|(t, w)| t * w).sum();
                (traits, rng.random_bool(1.0 / (1.0 + (-odds).exp())))
            })
            .collect();
        let rows: Vec<(&[f64], bool)> = drawn.iter().map(|(t, is)| (&t[..], *is)).collect();
        let weights = regress(&rows).unwrap();
        for (found, true_weight) in weights.iter().zip(truth) {
            assert!((found - true_weight).abs() < 0.12, "{weights}");
        }
    }

    #[test]
    fn too_few_fits_and_lines_that_are_none_are_told() {
        let error = learn(&[]).unwrap_err().to_string();
        assert!(error.contains("0 fits of robots"), "{error}");
        let path = std::env::temp_dir().join(format!("fits-{}.jsonl", std::process::id()));
        std::fs::write(&path, "{\"seed\":1}\n").unwrap();
        let error = read(&path).unwrap_err().to_string();
        std::fs::remove_file(&path).unwrap();
        assert!(error.contains("line 1") && error.contains("picture"), "{error}");
    }
}
