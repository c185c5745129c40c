//! What `solve` writes.

use protocol::estimate::SolveStatus;
use serde::{Deserialize, Serialize};

/// The result.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Solution {
    /// What became of it.
    pub status: SolveStatus,
    /// Why, for people.
    pub explanation: String,
    /// Robots with a place.
    pub robots: Vec<SolvedRobot>,
    /// Targets with a place.
    pub targets: Vec<SolvedTarget>,
    /// Sum of squared standardised residuals.
    pub chi2: f64,
    /// Degrees of freedom.
    pub dof: usize,
    /// What is known least, in words.
    pub weakest_direction: String,
}

/// A robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SolvedRobot {
    /// Name.
    pub id: String,
    /// Metres.
    pub x_m: f64,
    /// Metres.
    pub y_m: f64,
    /// Degrees, counter-clockwise, in (−180, 180].
    pub heading_deg: f64,
    /// x, y, heading; m and rad. Null where the direction is not determined.
    pub covariance: Option<[[f64; 3]; 3]>,
}

/// A target.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SolvedTarget {
    /// Name.
    pub id: String,
    /// Metres.
    pub x_m: f64,
    /// Metres.
    pub y_m: f64,
    /// Metres; null without elevations.
    pub z_m: Option<f64>,
    /// x, y, z; m². Without elevations the variance of z is [`UNKNOWN_VAR`]. Null where a direction is not determined.
    pub covariance: Option<[[f64; 3]; 3]>,
    /// Who sees it.
    pub observers: Vec<String>,
}

/// Variance of what nothing tells, m².
pub const UNKNOWN_VAR: f64 = 1e6;
