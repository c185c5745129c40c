//! Joint maximum likelihood over robots and targets: Levenberg–Marquardt with analytic Jacobians, targets eliminated
//! (`MATHS.md` §5.5).
//!
//! No measurement joins two targets, so they are eliminated one by one and what is left to factor has the size of the
//! robots alone: the time grows linearly with measurements and targets. With W = Hᵣₜ, H = Hₜₜ:
//!
//! ```text
//!   (A − Σ W H⁻¹ Wᵀ) δᵣ = −(gᵣ − Σ W H⁻¹ gₜ)      δₜ = −H⁻¹ (gₜ + Wᵀ δᵣ)
//!   Cov(r) = S⁻¹                                   Cov(t) = H⁻¹ + (H⁻¹Wᵀ) S⁻¹ (H⁻¹Wᵀ)ᵀ
//! ```
//!
//! Gaussian first; where the residuals say that they are not (their sum or the largest of them is beyond what chance does
//! once in a hundred), again with the loss of real bearings ([`super::robust`]) and, where the measurements are too few to tell
//! which of them are wrong, as the mean over who may be (`doubt`).

mod doubt;

use nalgebra::{DMatrix, DVector, SMatrix, SVector};
use statrs::distribution::{ContinuousCDF, Normal as Gaussian};

use super::layout::{Layout, State, TARGET};
use super::observability::{self, Weakest};
use super::robust::Loss;
use super::terms::{Other, Term};
use doubt::Average;

/// Steps at most.
const MAX_ITERATIONS: usize = 200;
/// Relative change of the cost below which it ends.
const COST_TOLERANCE: f64 = 1e-15;
/// Standardised step below which it ends.
const STEP_TOLERANCE: f64 = 1e-10;
/// Chance of a Gaussian fit to be taken for one with tails.
const TAIL_P: f64 = 0.01;
/// Part of the measurements that may be set aside; one always may.
const MOST_ASIDE: f64 = 0.2;
/// Below this weight a measurement is set aside.
pub const SET_ASIDE: f64 = 0.5;

type Block = SMatrix<f64, TARGET, TARGET>;

/// A solution.
#[derive(Debug, Clone)]
pub struct Joint {
    /// With the unknowns solved.
    pub state: State,
    /// Of the unknowns of robots; only meaningful with nullity 0.
    pub robot_covariance: DMatrix<f64>,
    /// Of each target's numbers; zero where they are known.
    pub target_covariances: Vec<Block>,
    /// Sum of squared standardised residuals, each by its weight.
    pub chi2: f64,
    /// Measurements that count (and priors) minus unknowns.
    pub dof: usize,
    /// Weight of each measurement.
    pub weights: Vec<f64>,
    /// Whether Gaussian errors did not explain it.
    pub tailed: bool,
    /// What is determined worst, or not at all.
    pub weakest: Weakest,
    /// Whether the iteration ended at a minimum.
    pub converged: bool,
}

/// The normal equations: information and gradient, as an arrow.
#[derive(Debug, Clone)]
pub struct Normal {
    /// Of the robots.
    pub robots: DMatrix<f64>,
    /// Gradient of the robots.
    pub gradient: DVector<f64>,
    /// Of each target that is looked at.
    pub targets: Vec<Target>,
    /// Sum of the losses.
    pub cost: f64,
}

/// A target's part. Numbers that are known have a one in `own` and zeros elsewhere.
#[derive(Debug, Clone)]
pub struct Target {
    /// Columns of the unknowns of the robots that look at it.
    pub columns: Vec<usize>,
    /// Information of its own.
    pub own: Block,
    /// Shared with the robots: a row a number, a column for each of `columns`.
    pub cross: DMatrix<f64>,
    /// Gradient.
    pub gradient: SVector<f64, TARGET>,
}

/// Solves from `start`.
pub fn solve(terms: &[Term], layout: &Layout, start: State) -> Joint {
    let (state, converged) = minimise(terms, layout, start.clone(), Loss::Square);
    if !tails(&residuals(terms, &state), layout) {
        return conclude(terms, layout, state, Loss::Square, converged);
    }
    // A gross error draws the Gaussian minimum far away, so the way there is looked for from the start, too.
    let mut best: Option<(f64, Joint)> = None;
    let (near, near_ended) = minimise(terms, layout, start, Loss::Huber);
    let (far, _) = minimise(terms, layout, state, Loss::Huber);
    for from in [&near, &far] {
        let (there, ended) = minimise(terms, layout, from.clone(), Loss::Tailed);
        let joint = conclude(terms, layout, there, Loss::Tailed, ended);
        let loss: f64 = residuals(terms, &joint.state).iter().map(|r| Loss::Tailed.of(*r).0).sum();
        let aside = joint.weights.iter().filter(|w| **w < SET_ASIDE).count();
        let sound = joint.weakest.undetermined.is_empty() && aside as f64 <= (MOST_ASIDE * terms.len() as f64).max(1.0);
        if sound && best.as_ref().is_none_or(|(least, _)| loss < *least) {
            best = Some((loss, joint));
        }
    }
    // Where too much would have to be set aside, nobody can say which part is wrong.
    let best = best.map_or_else(|| conclude(terms, layout, near, Loss::Huber, near_ended), |(_, joint)| joint);
    if !best.weakest.undetermined.is_empty() {
        return best;
    }
    match Average::about(terms, layout, &best.state) {
        Some(average) => describe(terms, layout, average, best.weakest),
        None => best,
    }
}

/// Standardised residuals.
pub fn residuals(terms: &[Term], state: &State) -> Vec<f64> {
    terms.iter().map(|t| t.row(state).residual).collect()
}

/// Whether Gaussian measurements would do this only once in a hundred problems.
fn tails(residuals: &[f64], layout: &Layout) -> bool {
    let n = residuals.len() + layout.priors.len();
    let Some(dof) = n.checked_sub(layout.unknowns).filter(|d| *d > 0) else { return false };
    let chi2: f64 = residuals.iter().map(|r| r * r).sum();
    let largest = residuals.iter().fold(0.0, |m: f64, r| m.max(r.abs()));
    let Ok(gaussian) = Gaussian::new(0.0, 1.0) else { return false };
    let once = gaussian.inverse_cdf(1.0 - 0.25 * TAIL_P / residuals.len() as f64);
    // Wilson and Hilferty's quantile of χ²: exact to a few per mille, which a threshold may be.
    let (d, z) = (2.0 / (9.0 * dof as f64), gaussian.inverse_cdf(1.0 - 0.5 * TAIL_P));
    largest > once || chi2 > dof as f64 * (1.0 - d + z * d.sqrt()).powi(3)
}

fn minimise(terms: &[Term], layout: &Layout, start: State, loss: Loss) -> (State, bool) {
    let mut state = start;
    if layout.unknowns == 0 || terms.is_empty() {
        return (state, true);
    }
    let plan = Plan::new(terms, layout);
    let mut normal = plan.normal(&state, loss).0;
    let (mut damping, mut factor) = (1e-6, 2.0);
    for _ in 0..MAX_ITERATIONS {
        if !normal.cost.is_finite() {
            return (state, false);
        }
        let Some((step, gain, length)) = normal.step(layout, damping) else {
            damping *= factor;
            factor *= 2.0;
            if damping > 1e12 {
                return (state, false);
            }
            continue;
        };
        let moved = layout.step(&state, &step);
        let cost = plan.cost(&moved, loss);
        let fell = normal.cost - cost;
        if cost.is_finite() && fell >= 0.0 {
            state = moved;
            let ratio = if gain > 0.0 { fell / gain } else { 1.0 };
            damping = (damping * f64::max(1.0 / 3.0, 1.0 - (2.0 * ratio - 1.0).powi(3))).max(1e-12);
            factor = 2.0;
            if fell <= COST_TOLERANCE * normal.cost.max(1e-12) || length < STEP_TOLERANCE {
                return (state, true);
            }
            normal = plan.normal(&state, loss).0;
        } else {
            // At the floor of the arithmetic no step makes it better.
            if length < 1e-6 || gain <= 1e-12 * normal.cost.max(1e-12) {
                return (state, true);
            }
            damping *= factor;
            factor *= 2.0;
            if damping > 1e12 {
                return (state, false);
            }
        }
    }
    (state, false)
}

fn conclude(terms: &[Term], layout: &Layout, state: State, loss: Loss, converged: bool) -> Joint {
    let (normal, weights) = Plan::new(terms, layout).normal(&state, loss);
    let (robot_covariance, target_covariances) = normal.covariances(layout);
    let weakest = observability::weakest(&normal, layout, &target_covariances);
    let found = Average { state, robot_covariance, target_covariances, weights };
    let joint = describe(terms, layout, found, weakest);
    Joint { tailed: loss != Loss::Square, converged: converged && joint.converged, ..joint }
}

/// What is to be said of an estimate where not everything is believed.
fn describe(terms: &[Term], layout: &Layout, found: Average, weakest: Weakest) -> Joint {
    let Average { state, robot_covariance, target_covariances, weights } = found;
    let of_terms = terms.iter().zip(&weights).map(|(term, weight)| weight * term.row(&state).residual.powi(2));
    let chi2 = of_terms.sum::<f64>() + prior_cost(layout, &state);
    let counted = weights.iter().filter(|w| **w >= SET_ASIDE).count() + layout.priors.len();
    let dof = counted.saturating_sub(layout.unknowns);
    let converged = chi2.is_finite();
    Joint { state, robot_covariance, target_covariances, chi2, dof, weights, tailed: true, weakest, converged }
}

fn prior_cost(layout: &Layout, state: &State) -> f64 {
    layout.priors.iter().map(|&(_, robot, k, sigma)| (state.poses[robot][k] / sigma).powi(2)).sum()
}

/// Who looks at a target, and all their columns.
type Watch = (Vec<usize>, Vec<usize>);

/// What does not change between iterations: who looks at what.
struct Plan<'a> {
    terms: &'a [Term],
    layout: &'a Layout,
    targets: Vec<Watch>,
    /// Of each term of a target: where the observer's columns begin in the target's cross matrix.
    places: Vec<usize>,
}

impl<'a> Plan<'a> {
    fn new(terms: &'a [Term], layout: &'a Layout) -> Self {
        let mut targets: Vec<Watch> = vec![Default::default(); layout.targets.len()];
        let mut starts: Vec<Vec<usize>> = vec![Vec::new(); layout.targets.len()];
        let mut places = vec![0; terms.len()];
        for (term, place) in terms.iter().zip(&mut places) {
            let Other::Target(t) = term.other else { continue };
            let (observers, columns) = &mut targets[t];
            *place = match observers.iter().position(|o| *o == term.observer) {
                Some(k) => starts[t][k],
                None => {
                    observers.push(term.observer);
                    starts[t].push(columns.len());
                    columns.extend(layout.robots[term.observer].iter().flatten());
                    starts[t][observers.len() - 1]
                }
            };
        }
        Self { terms, layout, targets, places }
    }

    fn cost(&self, state: &State, loss: Loss) -> f64 {
        let of = |t: &Term| loss.of(t.row(state).residual).0;
        self.terms.iter().map(of).sum::<f64>() + prior_cost(self.layout, state)
    }

    /// Information, gradient (half the derivative of the cost) and the weight of each measurement.
    fn normal(&self, state: &State, loss: Loss) -> (Normal, Vec<f64>) {
        let n = self.layout.robot_unknowns;
        let empty = |(columns, (_, robots)): (&[Option<usize>; TARGET], &Watch)| Target {
            columns: robots.clone(),
            own: Block::from_fn(|r, c| if r == c && columns[r].is_none() { 1.0 } else { 0.0 }),
            cross: DMatrix::zeros(TARGET, robots.len()),
            gradient: SVector::zeros(),
        };
        let mut normal = Normal {
            robots: DMatrix::zeros(n, n),
            gradient: DVector::zeros(n),
            targets: self.layout.targets.iter().zip(&self.targets).map(empty).collect(),
            cost: prior_cost(self.layout, state),
        };
        for &(column, robot, k, sigma) in &self.layout.priors {
            normal.robots[(column, column)] += sigma.powi(-2);
            normal.gradient[column] += state.poses[robot][k] * sigma.powi(-2);
        }
        let mut weights = Vec::with_capacity(self.terms.len());
        for (term, &place) in self.terms.iter().zip(&self.places) {
            let row = term.row(state);
            let (cost, weight) = loss.of(row.residual);
            normal.cost += cost;
            weights.push(weight);
            let mine = &self.layout.robots[term.observer];
            add_robot(&mut normal, (mine, &row.observer), (mine, &row.observer), weight);
            add_gradient(&mut normal.gradient, mine, &row.observer, weight * row.residual);
            match term.other {
                Other::Robot(r) => {
                    let other = &self.layout.robots[r];
                    add_robot(&mut normal, (other, &row.other), (other, &row.other), weight);
                    add_robot(&mut normal, (mine, &row.observer), (other, &row.other), weight);
                    add_robot(&mut normal, (other, &row.other), (mine, &row.observer), weight);
                    add_gradient(&mut normal.gradient, other, &row.other, weight * row.residual);
                }
                Other::Target(t) => {
                    let target = &mut normal.targets[t];
                    let mut other = SVector::from(row.other);
                    for (k, column) in self.layout.targets[t].iter().enumerate() {
                        if column.is_none() {
                            other[k] = 0.0;
                        }
                    }
                    target.own += weight * other * other.transpose();
                    target.gradient += weight * row.residual * other;
                    for (k, d) in mine.iter().zip(row.observer).filter(|(c, _)| c.is_some()).map(|(_, d)| d).enumerate()
                    {
                        for (row, o) in other.iter().enumerate() {
                            target.cross[(row, place + k)] += weight * d * o;
                        }
                    }
                }
            }
        }
        (normal, weights)
    }
}

type Part<'a> = (&'a [Option<usize>; 5], &'a [f64; 5]);

fn add_robot(normal: &mut Normal, (rows, a): Part<'_>, (columns, b): Part<'_>, weight: f64) {
    for (row, a) in rows.iter().zip(a) {
        let Some(row) = *row else { continue };
        for (column, b) in columns.iter().zip(b) {
            if let Some(column) = *column {
                normal.robots[(row, column)] += weight * a * b;
            }
        }
    }
}

fn add_gradient(gradient: &mut DVector<f64>, columns: &[Option<usize>; 5], d: &[f64; 5], scale: f64) {
    for (column, d) in columns.iter().zip(d) {
        if let Some(column) = *column {
            gradient[column] += scale * d;
        }
    }
}

/// The normal equations of `terms` at `state`.
pub fn normal(terms: &[Term], layout: &Layout, state: &State) -> Normal {
    Plan::new(terms, layout).normal(state, Loss::Square).0
}

impl Normal {
    /// The step with Marquardt's damping, the fall of the cost that it promises, and its standardised length.
    fn step(&self, layout: &Layout, damping: f64) -> Option<(Vec<f64>, f64, f64)> {
        let mut reduced = self.robots.clone();
        for k in 0..reduced.nrows() {
            reduced[(k, k)] += damping * self.robots[(k, k)].max(1e-12);
        }
        let mut rhs = -&self.gradient;
        let mut inverses = Vec::with_capacity(self.targets.len());
        for target in &self.targets {
            let mut own = target.own;
            for k in 0..TARGET {
                own[(k, k)] += damping * target.own[(k, k)].max(1e-12);
            }
            let inverse = own.cholesky()?.inverse();
            target.eliminate(&inverse, &mut reduced);
            let by_gradient = inverse * target.gradient;
            for (k, &column) in target.columns.iter().enumerate() {
                rhs[column] += target.cross.column(k).dot(&by_gradient);
            }
            inverses.push(inverse);
        }
        let robots = if reduced.nrows() == 0 { rhs } else { reduced.cholesky()?.solve(&rhs) };
        let mut step = vec![0.0; layout.unknowns];
        step[..layout.robot_unknowns].copy_from_slice(robots.as_slice());
        let mut gain = -robots.dot(&self.gradient);
        let mut length2: f64 = (0..robots.len()).map(|k| robots[k].powi(2) * self.robots[(k, k)]).sum();
        for ((target, inverse), columns) in self.targets.iter().zip(&inverses).zip(&layout.targets) {
            let mut g = target.gradient;
            for (k, &column) in target.columns.iter().enumerate() {
                g += target.cross.column(k) * robots[column];
            }
            let own = -(inverse * g);
            gain -= own.dot(&target.gradient);
            for (k, column) in columns.iter().enumerate() {
                if let Some(column) = *column {
                    step[column] = own[k];
                    length2 += own[k].powi(2) * target.own[(k, k)];
                }
            }
        }
        step.iter().all(|s| s.is_finite()).then(|| (step, gain, length2.sqrt()))
    }

    /// Covariance of the robots, and of each target; meaningless where something is not determined.
    pub fn covariances(&self, layout: &Layout) -> (DMatrix<f64>, Vec<Block>) {
        let mut reduced = self.robots.clone();
        let mut inverses = Vec::with_capacity(self.targets.len());
        for target in &self.targets {
            let inverse = target.inverse();
            target.eliminate(&inverse, &mut reduced);
            inverses.push(inverse);
        }
        let n = reduced.nrows();
        let robots =
            if n == 0 { reduced } else { reduced.cholesky().map_or_else(|| DMatrix::zeros(n, n), |c| c.inverse()) };
        let mut blocks = Vec::with_capacity(self.targets.len());
        for ((target, inverse), columns) in self.targets.iter().zip(&inverses).zip(&layout.targets) {
            let response = inverse * &target.cross;
            let poses = robots.select_rows(&target.columns).select_columns(&target.columns);
            let mut block = inverse + &response * poses * response.transpose();
            for (k, column) in columns.iter().enumerate() {
                if column.is_none() {
                    block.row_mut(k).fill(0.0);
                    block.column_mut(k).fill(0.0);
                }
            }
            blocks.push(block);
        }
        (robots, blocks)
    }

    /// Information of the robots with the targets eliminated.
    pub fn reduced(&self) -> DMatrix<f64> {
        let mut reduced = self.robots.clone();
        for target in &self.targets {
            target.eliminate(&target.inverse(), &mut reduced);
        }
        reduced
    }
}

impl Target {
    /// Inverse of its own information; along directions that nothing determines it is large, and nothing hangs on it.
    pub fn inverse(&self) -> Block {
        if let Some(factor) = self.own.cholesky()
            && (0..TARGET).all(|k| factor.l()[(k, k)].powi(2) > 1e-12 * self.own[(k, k)])
        {
            return factor.inverse();
        }
        let mut own = self.own;
        for k in 0..TARGET {
            own[(k, k)] = own[(k, k)] * (1.0 + 1e-13) + 1e-30;
        }
        own.cholesky().map_or_else(Block::zeros, |c| c.inverse())
    }

    fn eliminate(&self, inverse: &Block, reduced: &mut DMatrix<f64>) {
        let y = inverse * &self.cross;
        for (b, &column) in self.columns.iter().enumerate() {
            for (a, &row) in self.columns.iter().enumerate() {
                reduced[(row, column)] -= self.cross.column(a).dot(&y.column(b));
            }
        }
    }
}

#[cfg(test)]
mod tests;
