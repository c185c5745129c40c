//! All standing robots, solved together.
//!
//! State x = (common width error, then x, y, heading of each member). The prior (mean x₀, covariance P₀) holds everything
//! that was learned before the present stations and the gauge; the links (slot means of the present stations) are added
//! anew at each solution:
//!
//! ```text
//!   minimise (x − x₀)ᵀ P₀⁻¹ (x − x₀) + Σ links ρ( (β − β(x))²/σ_β² ) + ρ( (α − α(x))²/σ_α² )
//! ```
//!
//! by Gauss–Newton with Huber's ρ. When a robot leaves its station, its links are absorbed into the prior, and its rows are
//! taken out (marginalisation): what it told about the others stays, and so does the gauge. Source: `MATHS.md` §5.5; the
//! rest is the information filter's book-keeping.

use nalgebra::{DMatrix, DVector, Matrix3};
use protocol::angle::wrap;
use protocol::frames::Pose2;

use super::kernel;

/// Standardised residuals beyond weigh less and less (Huber).
const HUBER_SIGMAS: f64 = 3.0;
/// Gauss–Newton steps at most.
const MAX_ITERATIONS: usize = 12;
/// A step below this (m, rad) ends the iteration.
const STEP_TOLERANCE: f64 = 1e-8;

/// Standing robot `observer` sees standing robot `peer`: means with their full variances (white part and floor).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Link {
    /// Whose picture.
    pub observer: usize,
    /// Who is in it.
    pub peer: usize,
    /// In the observer's body frame, rad.
    pub bearing_rad: f64,
    /// rad².
    pub bearing_var: f64,
    /// Width of the reference cylinder and its variance, where known.
    pub width_rad: Option<(f64, f64)>,
}

/// The standing robots.
#[derive(Debug, Clone)]
pub struct Block {
    members: Vec<usize>,
    prior_mean: DVector<f64>,
    prior_cov: DMatrix<f64>,
    mean: DVector<f64>,
    cov: DMatrix<f64>,
    chi2: f64,
    dof: usize,
    converged: bool,
}

/// A robot that leaves: its pose, its covariance given the others, and its dependence on them.
#[derive(Debug, Clone)]
pub struct Departed {
    /// At the moment of leaving.
    pub team_from_body: Pose2,
    /// Given exact poses of the remaining members.
    pub own_covariance: Matrix3<f64>,
    /// ∂(x, y, heading)/∂(pose of each remaining member).
    pub dependence: Vec<(usize, Matrix3<f64>)>,
}

impl Block {
    /// Nobody stands; `common_width_rad` is the standard deviation of the error that all widths share.
    pub fn new(common_width_rad: f64) -> Self {
        let zero = DVector::zeros(1);
        let cov = DMatrix::from_element(1, 1, common_width_rad.powi(2).max(1e-14));
        Self {
            members: Vec::new(),
            prior_mean: zero.clone(),
            prior_cov: cov.clone(),
            mean: zero,
            cov,
            chi2: 0.0,
            dof: 0,
            converged: true,
        }
    }

    /// Members in the order of the covariance.
    pub fn members(&self) -> &[usize] {
        &self.members
    }

    /// Whether the robot is a member.
    pub fn contains(&self, robot: usize) -> bool {
        self.members.contains(&robot)
    }

    /// χ² of the last solution (links and prior) and its degrees of freedom.
    pub fn chi2(&self) -> (f64, usize) {
        (self.chi2, self.dof)
    }

    /// Whether the last solution converged.
    pub fn converged(&self) -> bool {
        self.converged
    }

    /// Pose of a member.
    pub fn pose(&self, robot: usize) -> Option<Pose2> {
        let k = self.row(robot)?;
        Some(Pose2::new(self.mean[k], self.mean[k + 1], self.mean[k + 2]))
    }

    /// The error that all widths share, estimated.
    pub fn common_width_rad(&self) -> f64 {
        self.mean[0]
    }

    /// 3 × 3 block of the joint covariance between two members.
    pub fn covariance(&self, a: usize, b: usize) -> Option<Matrix3<f64>> {
        let (i, j) = (self.row(a)?, self.row(b)?);
        Some(self.cov.fixed_view::<3, 3>(i, j).into_owned())
    }

    /// Takes a robot in with an independent prior.
    pub fn insert(&mut self, robot: usize, pose: Pose2, covariance: &Matrix3<f64>) {
        if self.contains(robot) {
            return;
        }
        self.members.push(robot);
        let tail = [pose.x_m, pose.y_m, pose.heading_rad];
        for mean in [&mut self.prior_mean, &mut self.mean] {
            *mean = DVector::from_iterator(mean.len() + 3, mean.iter().copied().chain(tail));
        }
        for cov in [&mut self.prior_cov, &mut self.cov] {
            let n = cov.nrows();
            let mut wider = DMatrix::zeros(n + 3, n + 3);
            wider.view_mut((0, 0), (n, n)).copy_from(cov);
            wider.fixed_view_mut::<3, 3>(n, n).copy_from(covariance);
            *cov = wider;
        }
    }

    /// Solves for the members with the present links. Links of strangers are ignored.
    pub fn solve(&mut self, links: &[Link]) {
        let Some(prior_information) = self.prior_cov.clone().cholesky().map(|c| c.inverse()) else {
            self.converged = false;
            return;
        };
        let mut x = self.mean.clone();
        self.converged = false;
        for _ in 0..MAX_ITERATIONS {
            let (information, gradient, _) = self.normal_equations(&x, &prior_information, links);
            let Some(factor) = information.cholesky() else { return };
            let step = -factor.solve(&gradient);
            x += &step;
            if !x.iter().all(|v| v.is_finite()) {
                return;
            }
            self.wrap_headings(&mut x);
            if step.amax() < STEP_TOLERANCE {
                self.converged = true;
                break;
            }
        }
        let (information, _, chi2) = self.normal_equations(&x, &prior_information, links);
        let Some(factor) = information.cholesky() else {
            self.converged = false;
            return;
        };
        self.cov = factor.inverse();
        self.mean = x;
        self.chi2 = chi2;
        let scalars: usize = links
            .iter()
            .filter(|l| self.contains(l.observer) && self.contains(l.peer))
            .map(|l| 1 + usize::from(l.width_rad.is_some()))
            .sum();
        // The prior of a member that only links determine is weak; it adds three unknowns, and the gauge takes three.
        self.dof = scalars.saturating_sub(3 * self.members.len().saturating_sub(1));
    }

    /// Moves what the links say into the prior; call before their observer or peer leaves.
    pub fn absorb(&mut self, links: &[Link]) {
        if links.is_empty() {
            return;
        }
        let Some(prior_information) = self.prior_cov.clone().cholesky().map(|c| c.inverse()) else { return };
        let x = self.mean.clone();
        let (information, gradient, _) = self.normal_equations(&x, &prior_information, links);
        let Some(factor) = information.cholesky() else { return };
        let mut mean = &x - factor.solve(&gradient);
        self.wrap_headings(&mut mean);
        self.prior_mean = mean;
        self.prior_cov = factor.inverse();
    }

    /// Takes a robot out. `None` if it is no member.
    pub fn remove(&mut self, robot: usize) -> Option<Departed> {
        let team_from_body = self.pose(robot)?;
        let k = self.row(robot)?;
        let rest: Vec<usize> = (0..self.mean.len()).filter(|&r| !(k..k + 3).contains(&r)).collect();
        let rest_cov = self.cov.select_rows(&rest).select_columns(&rest);
        let cross = self.cov.rows(k, 3).select_columns(&rest);
        let marginal = self.cov.fixed_view::<3, 3>(k, k).into_owned();
        // Regression on the others' poses; the common width error (row 0) is theirs to carry.
        let poses: Vec<usize> = (1..rest.len()).collect();
        let gain = rest_cov
            .select_rows(&poses)
            .select_columns(&poses)
            .cholesky()
            .map(|c| c.solve(&cross.select_columns(&poses).transpose()).transpose());
        let members: Vec<usize> = self.members.iter().copied().filter(|&m| m != robot).collect();
        let (own_covariance, dependence) = match gain {
            Some(gain) if !members.is_empty() => {
                let own = marginal - (&gain * cross.select_columns(&poses).transpose()).fixed_view::<3, 3>(0, 0);
                let blocks = members.iter().enumerate();
                (own, blocks.map(|(i, &m)| (m, gain.fixed_view::<3, 3>(0, 3 * i).into_owned())).collect())
            }
            _ => (marginal, Vec::new()),
        };
        for cov in [&mut self.prior_cov, &mut self.cov] {
            *cov = cov.select_rows(&rest).select_columns(&rest);
        }
        for mean in [&mut self.prior_mean, &mut self.mean] {
            *mean = mean.select_rows(&rest);
        }
        self.members = members;
        Some(Departed { team_from_body, own_covariance: symmetric(own_covariance), dependence })
    }

    /// Squared standardised residuals (bearing, width) of a link at the present solution.
    pub fn residual2(&self, link: &Link) -> Option<(f64, Option<f64>)> {
        let terms = self.terms(&self.mean, link)?;
        Some((terms[0].residual * terms[0].residual, terms[1].used.then_some(terms[1].residual * terms[1].residual)))
    }

    fn row(&self, robot: usize) -> Option<usize> {
        self.members.iter().position(|&m| m == robot).map(|k| 1 + 3 * k)
    }

    fn wrap_headings(&self, x: &mut DVector<f64>) {
        for k in 0..self.members.len() {
            x[3 + 3 * k] = wrap(x[3 + 3 * k]);
        }
    }

    /// Information, gradient (half of the derivative of the sum) and χ² at `x`.
    fn normal_equations(
        &self,
        x: &DVector<f64>,
        prior_information: &DMatrix<f64>,
        links: &[Link],
    ) -> (DMatrix<f64>, DVector<f64>, f64) {
        let mut away = x - &self.prior_mean;
        self.wrap_headings(&mut away);
        let mut information = prior_information.clone();
        let mut gradient = prior_information * &away;
        let mut chi2 = away.dot(&gradient);
        for link in links {
            let (Some(terms), Some(i), Some(j)) = (self.terms(x, link), self.row(link.observer), self.row(link.peer))
            else {
                continue;
            };
            for term in terms.iter().filter(|t| t.used) {
                let size = term.residual.abs();
                let weight = if size > HUBER_SIGMAS { HUBER_SIGMAS / size } else { 1.0 };
                chi2 += weight * term.residual * term.residual;
                let columns = [0, i, i + 1, i + 2, j, j + 1];
                for (a, &ca) in columns.iter().enumerate() {
                    gradient[ca] += weight * term.row[a] * term.residual;
                    for (b, &cb) in columns.iter().enumerate() {
                        information[(ca, cb)] += weight * term.row[a] * term.row[b];
                    }
                }
            }
        }
        (information, gradient, chi2)
    }

    /// Standardised residuals (predicted − measured) with derivatives to (common, observer x y h, peer x y).
    fn terms(&self, x: &DVector<f64>, link: &Link) -> Option<[Term; 2]> {
        let (i, j) = (self.row(link.observer)?, self.row(link.peer)?);
        let (pose, point) = ([x[i], x[i + 1], x[i + 2]], [x[j], x[j + 1]]);
        let (bearing, b_pose, b_point) = kernel::bearing(pose, point);
        let s = link.bearing_var.sqrt().recip();
        let first = Term {
            used: true,
            residual: s * wrap(bearing - link.bearing_rad),
            row: [0.0, s * b_pose[0], s * b_pose[1], s * b_pose[2], s * b_point[0], s * b_point[1]],
        };
        let Some((width_rad, width_var)) = link.width_rad else { return Some([first, Term::default()]) };
        let (range, d_pose, d_point) = kernel::distance(pose, point);
        let (width, slope) = kernel::width(range);
        let s = width_var.sqrt().recip();
        let t = s * slope;
        let second = Term {
            used: true,
            residual: s * (width + x[0] - width_rad),
            row: [s, t * d_pose[0], t * d_pose[1], 0.0, t * d_point[0], t * d_point[1]],
        };
        Some([first, second])
    }
}

#[derive(Debug, Clone, Copy, Default)]
struct Term {
    used: bool,
    residual: f64,
    row: [f64; 6],
}

fn symmetric(m: Matrix3<f64>) -> Matrix3<f64> {
    0.5 * (m + m.transpose())
}

#[cfg(test)]
mod tests;
