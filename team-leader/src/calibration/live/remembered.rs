//! Places that are known from before: from another leader's map, or from a file.

use nalgebra::{Matrix3, Vector3};
use protocol::angle::wrap;
use protocol::frames::Pose2;
use protocol::time::Timestamp;

use super::Calibrator;
use crate::calibration::naming::Naming;
use crate::calibration::rover::Rover;

/// A remembered pose that is further from the new one (squared sigmas of three numbers) is forgotten.
const MEMORY_GATE: f64 = 16.0;

/// Least variance of a remembered place in any direction: (3 µm)², (3 µrad)².
const LEAST_VARIANCE: f64 = 1e-11;

/// What a place may be off and still be the same: found anew by few sightings, or pushed by a hand's breadth (3 cm, 1°).
pub(super) fn nudged() -> Matrix3<f64> {
    Matrix3::from_diagonal(&Vector3::new(1e-3, 1e-3, 3e-4))
}

/// What was written by others and rounded may be no covariance by a hair, or by more: without directions of no or negative variance.
fn nearest_covariance(matrix: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    if !matrix.iter().all(|v| v.is_finite()) {
        return None;
    }
    let mut eigen = (0.5 * (matrix + matrix.transpose())).symmetric_eigen();
    eigen.eigenvalues.apply(|v| *v = v.max(LEAST_VARIANCE));
    Some(eigen.recompose())
}

impl Calibrator {
    /// The robot stood there, as far as somebody knows: a hint until sightings place it. `unsure` places (from a file, who knows
    /// how old) are not shown of robots that are there and may have been moved.
    pub fn remember(
        &mut self,
        robot: usize,
        pose: Pose2,
        covariance: &Matrix3<f64>,
        at: Timestamp,
        is_gauge: bool,
        unsure: bool,
    ) {
        if self.block.contains(robot) || self.robots.get(robot).is_none() {
            return;
        }
        let Some(covariance) = nearest_covariance(covariance) else { return };
        if is_gauge || self.gauge.is_none() {
            self.gauge = Some(robot);
        }
        let speeds = [self.config.speed_mps, self.config.turn_radps];
        self.robots[robot].rover = Some(Rover::standing_at(pose, &covariance, at, speeds));
        self.robots[robot].unsure = unsure;
    }

    /// The robot is there: a place that is old is doubted.
    pub fn is_back(&mut self, robot: usize) {
        if let Some(robot) = self.robots.get_mut(robot) {
            robot.back = true;
        }
    }

    /// Robots that were placed elsewhere than remembered since the last call.
    pub fn take_moved(&mut self) -> Vec<usize> {
        std::mem::take(&mut self.moved)
    }

    /// How many of the robots that a naming places stand where they are remembered.
    pub(super) fn agreeing(&self, naming: &Naming, root: usize, at: Timestamp) -> usize {
        let placed = naming.placed.iter().filter(|(robot, _)| *robot != root);
        placed.filter(|(robot, pose)| self.stands_as_remembered(*robot, pose, at)).count()
    }

    /// Whether a place that was found for a robot is the remembered one.
    pub(super) fn stands_as_remembered(&self, robot: usize, pose: &Pose2, at: Timestamp) -> bool {
        let Some(rover) = &self.robots[robot].rover else { return false };
        let before = rover.pose_at(at);
        let turned_rad = wrap(pose.heading_rad - before.heading_rad);
        let e = Vector3::new(pose.x_m - before.x_m, pose.y_m - before.y_m, turned_rad);
        (rover.covariance(&self.block) + nudged()).cholesky().is_some_and(|c| e.dot(&c.solve(&e)) < MEMORY_GATE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_remembered_matrix_that_is_no_covariance_becomes_one_and_a_right_one_stays() {
        let right = Matrix3::new(4e-4, 1e-4, 0.0, 1e-4, 2e-4, 0.0, 0.0, 0.0, 1e-5);
        assert!((nearest_covariance(&right).unwrap() - right).amax() < 1e-15);
        let mut wrong = right;
        wrong[(0, 1)] = 1e-3;
        wrong[(1, 0)] = 1e-3;
        wrong[(2, 2)] = -1e-6;
        assert!(wrong.cholesky().is_none());
        assert!(nearest_covariance(&wrong).unwrap().cholesky().is_some());
        wrong[(0, 0)] = f64::NAN;
        assert_eq!(nearest_covariance(&wrong), None);
    }
}
