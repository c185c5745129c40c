//! From the fit to what is said of it.

use nalgebra::{DMatrix, Matrix3};
use protocol::angle::wrap;
use protocol::estimate::{SolveStatus, chi2_quantile};

use super::Stage;
use super::input::Problem;
use super::layout::ROBOT;
use super::output::{JointCovariance, Solution, SolvedNuisance, SolvedRobot, SolvedTarget, UNKNOWN_VAR};
use super::terms::Other;
use super::{joint, observability, pairs, words};

/// A fit worse than this has a cause.
const INCONSISTENT_P: f64 = 0.9999;
/// Part of real measurements that the loss sets aside; many more have a cause.
const TAIL: f64 = 0.026;
/// Sigmas beyond which a measurement is a gross error, not one of the tails of real ones.
const GROSS: f64 = 20.0;
/// With more unknowns nobody is told what would cure what is open.
const MAX_CURED: usize = 300;
/// Part (m, rad, s of a direction of unit length) below which an unknown has none in it.
const NO_PART: f64 = 1e-6;
/// Most warnings of one kind.
const MAX_WARNINGS: usize = 10;

impl Stage {
    /// Standard deviations of position and heading.
    pub(super) fn sigma(&self, robot: usize) -> (f64, f64) {
        let cov = self.robot_covariance(robot);
        ((cov[(0, 0)] + cov[(1, 1)]).sqrt(), cov[(2, 2)].sqrt())
    }

    fn between(&self, a: usize, b: usize) -> [[f64; ROBOT]; ROBOT] {
        let (rows, columns) = (&self.layout.robots[a], &self.layout.robots[b]);
        rows.map(|r| columns.map(|c| r.zip(c).map_or(0.0, |(r, c)| self.joint.robot_covariance[(r, c)])))
    }

    fn robot_covariance(&self, robot: usize) -> Matrix3<f64> {
        let all = self.between(robot, robot);
        Matrix3::from_fn(|r, c| all[r][c])
    }

    /// Of its position.
    pub(super) fn target_covariance(&self, target: usize) -> Matrix3<f64> {
        let mut cov: Matrix3<f64> = self.joint.target_covariances[target].fixed_view::<3, 3>(0, 0).into_owned();
        if self.layout.targets[target][2].is_none() {
            cov[(2, 2)] = UNKNOWN_VAR;
        }
        cov
    }

    pub(super) fn conclude(self, problem: &Problem, namesakes: bool, left_open: bool) -> Solution {
        let joint = &self.joint;
        let determined = joint.weakest.undetermined.is_empty();
        let (status, explanation) = self.verdict(problem, namesakes, left_open);
        let mut warnings = pairs::disagreements(problem, &self.placed);
        warnings.extend(self.set_aside(problem));
        let cures = if determined || self.layout.unknowns > MAX_CURED {
            Vec::new()
        } else {
            observability::cures(&joint.weakest, &self.layout, &joint.state, problem, &self.placed)
        };
        let robots_determined = !self.layout.robots.iter().any(|columns| self.is_open(columns));
        let robots = problem.robots.iter().enumerate().filter(|(r, _)| self.placed[*r]);
        let robots = robots.map(|(r, robot)| self.robot(r, &robot.id, robots_determined)).collect();
        let mut landmark = vec![false; problem.targets.len()];
        for l in &problem.landmarks {
            landmark[l.target] = true;
        }
        let observers = self.observers(problem);
        let targets = (0..problem.targets.len()).filter(|t| self.located[*t] && !landmark[*t]).map(|t| {
            let [x_m, y_m, z_m, vx_mps, vy_mps] = joint.state.points[t];
            SolvedTarget {
                id: problem.targets[t].clone(),
                x_m,
                y_m,
                z_m: self.layout.targets[t][2].map(|_| z_m),
                covariance: (robots_determined && !self.is_open(&self.layout.targets[t]))
                    .then(|| rows(&self.target_covariance(t))),
                observers: observers[t].iter().map(|r| problem.robots[*r].id.clone()).collect(),
                time_s: problem.times[t],
                paired: problem.paired_with(t),
                velocity_mps: self.layout.targets[t][3].map(|_| [vx_mps, vy_mps]),
            }
        });
        Solution {
            robots,
            targets: targets.collect(),
            chi2: joint.chi2,
            dof: joint.dof,
            weakest_direction: words::weakest(joint, &self.layout, problem),
            undetermined: words::undetermined(joint, &self.layout, problem),
            cures,
            warnings,
            joint_covariance: robots_determined.then(|| self.joint_covariance(problem)),
            ..Solution::empty(status, &explanation)
        }
    }

    /// Whether a direction that nothing determines has a part in one of these unknowns.
    fn is_open(&self, columns: &[Option<usize>]) -> bool {
        let directions = &self.joint.weakest.undetermined;
        columns.iter().flatten().any(|column| directions.iter().any(|d| d[*column].abs() > NO_PART))
    }

    fn verdict(&self, problem: &Problem, namesakes: bool, left_open: bool) -> (SolveStatus, String) {
        let joint = &self.joint;
        let missing: Vec<&str> =
            problem.robots.iter().zip(&self.placed).filter(|(_, p)| !**p).map(|(r, _)| r.id.as_str()).collect();
        let nullity = joint.weakest.undetermined.len();
        if namesakes {
            (SolveStatus::Ambiguous, "several ways of naming the sightings fit equally".to_owned())
        } else if !missing.is_empty() || self.terms.len() + self.layout.priors.len() < self.layout.unknowns {
            let who = if missing.is_empty() { "some directions".to_owned() } else { missing.join(", ") };
            (SolveStatus::Insufficient, format!("too few measurements for {who}"))
        } else if nullity > 0 {
            let text = words::undetermined(joint, &self.layout, problem).join("; ");
            (SolveStatus::Degenerate, format!("{nullity} directions are not determined: {text}"))
        } else if joint.tailed && self.contradicts() {
            // Contradictions may also be why the iteration did not end.
            (SolveStatus::Inconsistent, words::worst(&self.terms, &joint.state, problem))
        } else if !joint.converged {
            (SolveStatus::NotConverged, "the iteration did not end".to_owned())
        } else if self.twofold {
            (SolveStatus::Ambiguous, "another layout fits equally well".to_owned())
        } else if left_open {
            (SolveStatus::Ambiguous, "some bearings could be of several targets: they are left out".to_owned())
        } else {
            (SolveStatus::Converged, "a minimum that fits".to_owned())
        }
    }

    /// Whether the measurements contradict each other more than real ones do.
    fn contradicts(&self) -> bool {
        let joint = &self.joint;
        if joint.dof > 0 && joint.chi2 > chi2_quantile(INCONSISTENT_P, joint.dof) {
            return true;
        }
        let n = joint.weights.len() as f64;
        let aside = joint.weights.iter().filter(|w| **w < joint::SET_ASIDE).count() as f64;
        let usual = TAIL * n + 4.0 * (TAIL * n).sqrt();
        let gross = joint::residuals(&self.terms, &joint.state).iter().any(|r| r.abs() > GROSS);
        aside > usual || gross || joint.dof == 0
    }

    /// Measurements that were not believed, in words.
    fn set_aside(&self, problem: &Problem) -> Vec<String> {
        let aside = || self.joint.weights.iter().enumerate().filter(|(_, w)| **w < joint::SET_ASIDE);
        let count = aside().count();
        let residuals = joint::residuals(&self.terms, &self.joint.state);
        let mut worst: Vec<usize> = aside().map(|(k, _)| k).collect();
        worst.sort_by(|a, b| residuals[*b].abs().total_cmp(&residuals[*a].abs()));
        let mut told: Vec<String> = worst
            .iter()
            .take(MAX_WARNINGS)
            .map(|&k| format!("set aside: {}", words::measurement(&self.terms[k], residuals[k], problem)))
            .collect();
        if count > MAX_WARNINGS {
            told.push(format!("set aside: {} further measurements", count - MAX_WARNINGS));
        }
        told
    }

    fn robot(&self, r: usize, id: &str, determined: bool) -> SolvedRobot {
        let [x_m, y_m, heading, bias, offset] = self.joint.state.poses[r];
        let sigma = |k: usize| self.between(r, r)[k][k].max(0.0).sqrt();
        let known = |k: usize| self.layout.robots[r][k].filter(|_| determined);
        SolvedRobot {
            id: id.to_owned(),
            x_m,
            y_m,
            heading_deg: wrap(heading).to_degrees(),
            covariance: determined.then(|| rows(&self.robot_covariance(r))),
            nuisance: SolvedNuisance {
                bearing_bias_deg: known(3).map(|_| bias.to_degrees()),
                bearing_bias_sigma_deg: known(3).map(|_| sigma(3).to_degrees()),
                time_offset_s: known(4).map(|_| offset),
                time_offset_sigma_s: known(4).map(|_| sigma(4)),
            },
        }
    }

    fn joint_covariance(&self, problem: &Problem) -> JointCovariance {
        let free: Vec<usize> = (0..problem.robots.len()).filter(|r| self.layout.robots[*r][0].is_some()).collect();
        let mut matrix = DMatrix::zeros(3 * free.len(), 3 * free.len());
        for (i, &a) in free.iter().enumerate() {
            for (j, &b) in free.iter().enumerate() {
                let block = self.between(a, b);
                matrix.fixed_view_mut::<3, 3>(3 * i, 3 * j).copy_from(&Matrix3::from_fn(|r, c| block[r][c]));
            }
        }
        JointCovariance {
            robots: free.iter().map(|r| problem.robots[*r].id.clone()).collect(),
            matrix: matrix.row_iter().map(|row| row.iter().copied().collect()).collect(),
        }
    }

    /// Who has a bearing of each target.
    fn observers(&self, problem: &Problem) -> Vec<Vec<usize>> {
        let mut seen: Vec<Vec<usize>> = vec![Vec::new(); problem.targets.len()];
        for term in &self.terms {
            if let Other::Target(t) = term.other
                && !seen[t].contains(&term.observer)
            {
                seen[t].push(term.observer);
            }
        }
        seen
    }
}

fn rows(m: &Matrix3<f64>) -> [[f64; 3]; 3] {
    [0, 1, 2].map(|r| [m[(r, 0)], m[(r, 1)], m[(r, 2)]])
}
