//! Who is wrong where few measurements cannot tell: an average over all answers instead of a guess.
//!
//! Two robots that measure two tangents each and a target have one number more than they need. Where the sum does not come out, one
//! of six is wrong, and each of them would explain it. The likeliest answer sets one aside and believes the others: its place is as
//! often wrong as the choice, and its covariance says nothing of that. The estimate of least square error is the mean over the
//! choices by their probability (Pitman's), and its covariance has their spread. Of each set S of measurements that may be from the
//! broad part of the density of [`super::super::robust`], `s` times as uncertain (or from the part of gross errors, with an ε and an s
//! of its own):
//!
//! ```text
//!   p(S) ∝ (ε/(1−ε))^|S| · s^−|S| · exp(−χ²_S/2) · |Λ_S|^−½          x̄ = Σ p x_S      P = Σ p (Λ_S⁻¹ + (x_S − x̄)(x_S − x̄)ᵀ)
//! ```
//!
//! χ²_S, x_S and the information Λ_S are those of the fit without S's surplus of weight, linear about x̄, which is found by
//! iterating: a fit of its own would go as far as it likes along what only S determined. A set of one more follows from the set by
//! an update of rank one.

use std::collections::BTreeSet;

use nalgebra::{DMatrix, DVector};

use super::super::layout::{Layout, State};
use super::super::robust::{BROAD, GROSS, WIDTH};
use super::super::terms::Term;
use super::Block;

/// With more measurements than this it is clear who is wrong.
const MOST_TERMS: usize = 40;
/// Most measurements that are wrong at once.
const MOST_WRONG: usize = 4;
/// Sets that are less likely than the likeliest by this (logarithm) are left out.
const LEAST_LOG: f64 = 8.0;
/// Most sets from which larger ones are made.
const MOST_SETS: usize = 24;
/// Steps of the mean at most, and the standardised one at which it has ended.
const MAX_ITERATIONS: usize = 20;
const STEP_TOLERANCE: f64 = 1e-3;
/// What is wrong is of the broad part of the density, or grossly so: share and width, in sigmas, of the Gaussians that stand for them.
const PARTS: [(f64, f64); 2] = [(BROAD, WIDTH), (GROSS * ROOT_TAU * GROSS_WIDTH, GROSS_WIDTH)];
const GROSS_WIDTH: f64 = 50.0;
const ROOT_TAU: f64 = 2.506_628_274_631;

/// An estimate and how far it is to be believed.
pub(super) struct Average {
    pub(super) state: State,
    /// Of the unknowns of robots.
    pub(super) robot_covariance: DMatrix<f64>,
    /// Of each target's numbers.
    pub(super) target_covariances: Vec<Block>,
    /// Of each measurement.
    pub(super) weights: Vec<f64>,
}

/// A measurement, and of which of [`PARTS`] it is.
type Wrong = (usize, usize);

/// A set of measurements that may be wrong, and what follows if they are.
struct Answer {
    /// In ascending order.
    wrong: Vec<Wrong>,
    /// From where it was linear to its minimum.
    step: DVector<f64>,
    covariance: DMatrix<f64>,
    /// ln p(S) but for a constant.
    log: f64,
}

impl Answer {
    fn weight(&self, measurement: usize) -> f64 {
        self.wrong.iter().find(|w| w.0 == measurement).map_or(1.0, |w| PARTS[w.1].1.powi(-2))
    }
}

impl Average {
    /// Over who may be wrong, beginning at the likeliest answer; `None` where there are too many measurements, something is not
    /// determined, or the mean is not found.
    pub(super) fn about(terms: &[Term], layout: &Layout, likeliest: &State) -> Option<Self> {
        if terms.len() > MOST_TERMS {
            return None;
        }
        let mut state = likeliest.clone();
        for _ in 0..MAX_ITERATIONS {
            let answers = Linear::about(terms, layout, &state).answers()?;
            let mean = answers.iter().fold(DVector::zeros(layout.unknowns), |sum, (p, a)| sum + *p * &a.step);
            let mut covariance = DMatrix::zeros(layout.unknowns, layout.unknowns);
            for (p, answer) in &answers {
                let off = &answer.step - &mean;
                covariance += *p * (&answer.covariance + &off * off.transpose());
            }
            state = layout.step(&state, mean.as_slice());
            if mean.dot(&covariance.clone().cholesky()?.solve(&mean)) > STEP_TOLERANCE * STEP_TOLERANCE {
                continue;
            }
            let weight = |k: usize| answers.iter().map(|(p, a)| p * a.weight(k)).sum();
            let block = |columns: &[Option<usize>; 5]| {
                Block::from_fn(|r, c| columns[r].zip(columns[c]).map_or(0.0, |at| covariance[at]))
            };
            let robots = layout.robot_unknowns;
            return Some(Self {
                state,
                robot_covariance: covariance.view((0, 0), (robots, robots)).into_owned(),
                target_covariances: layout.targets.iter().map(block).collect(),
                weights: (0..terms.len()).map(weight).collect(),
            });
        }
        None
    }
}

/// The measurements and priors, linear about a state.
struct Linear {
    /// Of each measurement.
    rows: Vec<DVector<f64>>,
    residuals: Vec<f64>,
    information: DMatrix<f64>,
    gradient: DVector<f64>,
    chi2: f64,
}

impl Linear {
    fn about(terms: &[Term], layout: &Layout, state: &State) -> Self {
        let n = layout.unknowns;
        let (mut rows, mut residuals) = (Vec::with_capacity(terms.len()), Vec::with_capacity(terms.len()));
        let (mut information, mut gradient, mut chi2) = (DMatrix::zeros(n, n), DVector::zeros(n), 0.0);
        for term in terms {
            let at = term.row(state);
            let row = at.unknowns(term, layout);
            information.ger(1.0, &row, &row, 1.0);
            gradient.axpy(at.residual, &row, 1.0);
            chi2 += at.residual * at.residual;
            rows.push(row);
            residuals.push(at.residual);
        }
        for &(column, robot, k, sigma) in &layout.priors {
            let residual = state.poses[robot][k] / sigma;
            information[(column, column)] += sigma.powi(-2);
            gradient[column] += residual / sigma;
            chi2 += residual * residual;
        }
        Self { rows, residuals, information, gradient, chi2 }
    }

    /// The likely answers with their probabilities.
    fn answers(&self) -> Option<Vec<(f64, Answer)>> {
        let nobody = self.nobody_is_wrong()?;
        let mut most = nobody.log;
        let (mut all, mut last) = (vec![nobody], 0);
        let mut seen = BTreeSet::new();
        for _ in 0..MOST_WRONG {
            let mut found: Vec<Answer> = Vec::new();
            for answer in all[last..].iter().take(MOST_SETS) {
                let others = (0..self.rows.len()).filter(|k| answer.wrong.iter().all(|w| w.0 != *k));
                for another in others.flat_map(|k| (0..PARTS.len()).map(move |part| (k, part))) {
                    let mut wrong = answer.wrong.clone();
                    wrong.push(another);
                    wrong.sort_unstable();
                    if !seen.insert(wrong.clone()) {
                        continue;
                    }
                    if let Some(more) = self.with(answer, another, wrong, most - LEAST_LOG) {
                        most = most.max(more.log);
                        found.push(more);
                    }
                }
            }
            found.sort_by(|a, b| b.log.total_cmp(&a.log));
            last = all.len();
            all.append(&mut found);
        }
        all.retain(|a| a.log > most - LEAST_LOG);
        let sum: f64 = all.iter().map(|a| (a.log - most).exp()).sum();
        Some(all.into_iter().map(|a| ((a.log - most).exp() / sum, a)).collect())
    }

    fn nobody_is_wrong(&self) -> Option<Answer> {
        let factor = self.information.clone().cholesky()?;
        let step = -factor.solve(&self.gradient);
        let log_det: f64 = factor.l_dirty().diagonal().iter().map(|d| 2.0 * d.ln()).sum();
        let log = -0.5 * (self.chi2 + self.gradient.dot(&step) + log_det);
        log.is_finite().then(|| Answer { wrong: Vec::new(), step, covariance: factor.inverse(), log })
    }

    /// What follows if another one is wrong, too, `wrong` in all; `None` where that is less likely than `least`.
    fn with(&self, answer: &Answer, another: Wrong, wrong: Vec<Wrong>, least: f64) -> Option<Answer> {
        let (another, (share, width)) = (another.0, PARTS[another.1]);
        let row = &self.rows[another];
        let moves = &answer.covariance * row;
        let less = 1.0 - width.powi(-2);
        let residual = self.residuals[another] + row.dot(&answer.step);
        // What is left of its weight's share in the information.
        let left = 1.0 - less * row.dot(&moves);
        let odds = (share / (1.0 - BROAD) / width).ln();
        let log = answer.log + odds + 0.5 * (less * residual * residual / left - left.ln());
        if left.is_nan() || left <= 0.0 || log.is_nan() || log <= least {
            return None;
        }
        let mut covariance = answer.covariance.clone();
        covariance.ger(less / left, &moves, &moves, 1.0);
        Some(Answer { wrong, step: &answer.step + less * residual / left * moves, covariance, log })
    }
}
