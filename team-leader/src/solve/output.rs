//! What `solve` writes.

use protocol::estimate::SolveStatus;
use serde::{Deserialize, Serialize};

use super::explain::Explained;

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
    /// Sum of squared standardised residuals, each by its weight.
    pub chi2: f64,
    /// Degrees of freedom.
    pub dof: usize,
    /// What is known least, in words.
    pub weakest_direction: String,
    /// Directions that nothing determines, in words.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub undetermined: Vec<String>,
    /// Measurements that would determine them, in words.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub cures: Vec<String>,
    /// Pairs whose two directions disagree, and measurements that were not believed.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<String>,
    /// Of all robots that are not held, jointly.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub joint_covariance: Option<JointCovariance>,
    /// Where each target's error comes from, where that was asked for.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub explained: Vec<Explained>,
}

impl Solution {
    /// A solution with nothing in it.
    pub fn empty(status: SolveStatus, explanation: &str) -> Self {
        Self {
            status,
            explanation: explanation.to_owned(),
            robots: Vec::new(),
            targets: Vec::new(),
            chi2: 0.0,
            dof: 0,
            weakest_direction: String::new(),
            undetermined: Vec::new(),
            cures: Vec::new(),
            warnings: Vec::new(),
            joint_covariance: None,
            explained: Vec::new(),
        }
    }
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
    /// Bias and time offset, where they are unknowns.
    #[serde(flatten)]
    pub nuisance: SolvedNuisance,
}

/// Errors of a robot's measurements that were solved for.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct SolvedNuisance {
    /// Added to all its bearings, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bearing_bias_deg: Option<f64>,
    /// Its standard deviation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bearing_bias_sigma_deg: Option<f64>,
    /// By how much its stamps are late, seconds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time_offset_s: Option<f64>,
    /// Its standard deviation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time_offset_sigma_s: Option<f64>,
}

/// Covariance of several robots' poses.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JointCovariance {
    /// Whose, in order.
    pub robots: Vec<String>,
    /// x, y, heading of each; m and rad.
    pub matrix: Vec<Vec<f64>>,
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
    /// When it is there, where its bearings have times.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time_s: Option<f64>,
    /// Which of the file's bearings (counted from 0) without a name were taken for its own.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub paired: Vec<usize>,
    /// Velocity x, y, where bearings of several instants tell it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub velocity_mps: Option<[f64; 2]>,
}

/// Variance of what nothing tells, m².
pub const UNKNOWN_VAR: f64 = 1e6;
