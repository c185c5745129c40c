//! The calibration as it runs: one call an observation.

mod adrift;
mod elsewhere;
mod exchange;
mod remembered;
mod robots;
mod roster;
mod stations;
mod watch;

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Matrix3, Vector3};
use protocol::frames::Pose2;
use protocol::message::{MapStatus, Motion};
use protocol::time::Timestamp;

use super::block::Block;
use super::convoy::Convoy;
use super::rover::Rover;
use super::slot::{NOTICE_S, Sighted};
use crate::leader::config::CalibrationConfig;
pub use robots::Robot;
use roster::Roster;
pub use watch::Finding;

/// Covariance of a pose that is given, not measured.
const GAUGE_VAR: f64 = 1e-10;
/// A slot unseen for longer is not fresh, seconds: it keeps its name but proves nothing.
const FRESH_S: f64 = 1.5;
/// Sightings a slot needs before it is named.
const LEAST_COUNT: u32 = 3;
/// How long a robot must stand before it is named, seconds: one that has gone on would have said so by then.
const SETTLED_S: f64 = NOTICE_S;
/// Between attempts to name, seconds.
const NAMING_INTERVAL_S: f64 = 0.2;
/// Between checks of names that were given, seconds.
const CHECK_INTERVAL_S: f64 = 1.0;
/// Checks in a row that must contradict a place before it is given up.
const CONTRADICTIONS: u32 = 3;
/// Most slots of one robot.
const MAX_SLOTS: usize = 48;

/// Where the robots of a component are. Robots are numbered as the leader met them; nothing else depends on their order.
#[derive(Debug, Clone)]
pub struct Calibrator {
    config: CalibrationConfig,
    anchor: Option<(usize, Pose2)>,
    robots: Roster,
    block: Block,
    /// Used while nobody has ever stood: what drives, with odometry.
    convoy: Convoy,
    gauge: Option<usize>,
    ambiguous: Vec<usize>,
    last_naming: Option<Timestamp>,
    next_root: usize,
    last_check: Option<Timestamp>,
    last_solve: Option<Timestamp>,
    changes: Changes,
    /// Robots placed elsewhere than remembered.
    moved: Vec<usize>,
    fit: Fit,
    /// What is wrong, and what of it nobody has been told yet.
    findings: Vec<Finding>,
    new_findings: Vec<Finding>,
    /// Robots that read their own name on others: how often in a row, and when last.
    own_names: BTreeMap<usize, (u32, Timestamp)>,
    /// Placed robots whose sightings others can verify.
    verifiable: BTreeSet<usize>,
    last_watch: Option<Timestamp>,
    thrifty: bool,
}

/// How well the standing robots' solution fits. Quantiles are dear and change only with the degrees of freedom.
#[derive(Debug, Clone, Copy)]
struct Fit {
    dof: usize,
    usual: f64,
    utmost: f64,
}

/// One observation, as the calibration needs it.
#[derive(Debug, Clone)]
pub struct Look<'a> {
    /// Whose.
    pub robot: usize,
    /// Capture, leader's clock.
    pub at: Timestamp,
    /// Since this robot's observation before, seconds.
    pub since_last_s: Option<f64>,
    /// What the robot was doing.
    pub motion: Motion,
    /// Motion since the observation before, with covariance.
    pub odometry: Option<(Pose2, Matrix3<f64>)>,
    /// Fellow robots.
    pub sightings: &'a [Sighted],
}

/// What an observation changed for those who depend on the poses.
#[derive(Debug, Clone, Default)]
pub struct Changes {
    /// Standing robots whose pose was corrected, and by how much (x, y, heading).
    pub shifts: Vec<(usize, Vector3<f64>)>,
    /// Robots that left their station: pose there and its covariance.
    pub left: Vec<(usize, Pose2, Matrix3<f64>)>,
}

impl Calibrator {
    /// Nobody is known.
    pub fn new(config: CalibrationConfig) -> Self {
        Self {
            config,
            anchor: None,
            robots: Roster::default(),
            block: Block::new(config.common_width_rad),
            convoy: Convoy::default(),
            gauge: None,
            ambiguous: Vec::new(),
            last_naming: None,
            next_root: 0,
            last_check: None,
            last_solve: None,
            changes: Changes::default(),
            moved: Vec::new(),
            fit: Fit { dof: 0, usual: 0.0, utmost: 0.0 },
            findings: Vec::new(),
            new_findings: Vec::new(),
            own_names: BTreeMap::new(),
            verifiable: BTreeSet::new(),
            last_watch: None,
            thrifty: false,
        }
    }

    /// One more robot, by its number; the anchor with its pose.
    pub fn add_robot(&mut self, robot: usize, anchor: Option<Pose2>) {
        self.robots.insert(robot, Robot::default());
        if let Some(pose) = anchor {
            self.anchor = Some((robot, pose));
        }
    }

    /// The robot stands where it is said to, for good: a member from the start, its pose never solved for.
    pub fn fix(&mut self, robot: usize, pose: Pose2) {
        self.block.insert(robot, pose, &(Matrix3::identity() * GAUGE_VAR));
        self.gauge = self.gauge.or(Some(robot));
    }

    /// One of many components: its standing robots are solved for as seldom as a large component's.
    pub fn be_thrifty(&mut self, thrifty: bool) {
        self.thrifty = thrifty;
    }

    /// Works on one observation.
    pub fn observe(&mut self, look: &Look<'_>) -> Changes {
        self.changes = Changes::default();
        let named = |s: &Sighted| Sighted { robot: self.believed_name(look.robot, s.robot, look.at), ..*s };
        let sightings: Vec<Sighted> = look.sightings.iter().map(named).collect();
        let motion = self.motion(look);
        let look = &Look { motion, sightings: &sightings, ..look.clone() };
        self.follow_motion(look);
        self.find_adrift(look);
        let rest = self.match_sightings(look);
        if self.robots[look.robot].standing_since.is_some() && look.motion == Motion::Standing {
            self.fill_slots(look.robot, look.at, &rest);
        }
        self.follow_convoy(look);
        self.name_slots_of_members(look.robot, look.at);
        self.name_strangers(look.at);
        self.check_names(look.at);
        self.solve(look.at);
        self.watch(look.at);
        std::mem::take(&mut self.changes)
    }

    /// The robot whose pose fixed the frame.
    pub fn gauge(&self) -> Option<usize> {
        self.gauge.or_else(|| self.convoy.gauge())
    }

    /// Pose of a robot at `at`, where known.
    pub fn pose(&self, robot: usize, at: Timestamp) -> Option<Pose2> {
        let placed = self.block.pose(robot).or_else(|| Some(self.rover(robot)?.pose_at(at)));
        placed.or_else(|| self.convoy.pose(robot, at).filter(|_| self.is_convoy()))
    }

    /// Whether the frame is that of a team on the move: nobody has stood and been tied to others yet.
    fn is_convoy(&self) -> bool {
        self.gauge.is_none()
    }

    /// Odometry and sightings of a team on the move.
    fn follow_convoy(&mut self, look: &Look<'_>) {
        if !self.is_convoy() {
            return;
        }
        if let (Some((step, covariance)), Some(since_s)) = (look.odometry, look.since_last_s) {
            self.convoy.drive(look.robot, look.at, step, &covariance, since_s);
        }
        for sighted in look.sightings {
            if let Some(peer) = sighted.robot.filter(|peer| *peer != look.robot) {
                self.convoy.sight(look.robot, peer, look.at, sighted);
            }
        }
    }

    /// Pose of a robot that stands and is a member of the block: only its bearings measure targets.
    pub fn station(&self, robot: usize) -> Option<Pose2> {
        self.block.pose(robot)
    }

    /// Robots that stand and are members, with their poses.
    pub fn stations(&self) -> impl Iterator<Item = (usize, Pose2)> + '_ {
        self.block.members().iter().filter_map(|&m| Some((m, self.block.pose(m)?)))
    }

    /// All robots with a pose, at `at`.
    pub fn poses(&self, at: Timestamp) -> impl Iterator<Item = (usize, Pose2)> + '_ {
        self.robots.numbers().filter_map(move |r| Some((r, self.pose(r, at)?)))
    }

    /// Robots that are followed as moving, with pose at `at` and covariance.
    pub fn rovers(&self, at: Timestamp) -> impl Iterator<Item = (usize, Pose2, Matrix3<f64>)> + '_ {
        self.robots.iter().filter_map(move |(r, robot)| {
            let rover = robot.rover.as_ref().filter(|_| !robot.is_doubted())?;
            Some((r, rover.pose_at(at), rover.covariance(&self.block)))
        })
    }

    /// Covariance between two robots with a pose (x, y, heading each).
    pub fn covariance(&self, a: usize, b: usize) -> Matrix3<f64> {
        if let Some(cov) = self.convoy.covariance(a, b).filter(|_| self.is_convoy()) {
            return cov;
        }
        let scale = self.scale();
        if let Some(cov) = self.block.covariance(a, b) {
            return scale * cov;
        }
        let mut sum = Matrix3::zeros();
        for (m, dm) in self.dependence(a) {
            for (n, dn) in self.dependence(b) {
                sum += dm * self.block.covariance(m, n).unwrap_or_default() * dn.transpose();
            }
        }
        let own = self.rover(a).filter(|_| a == b);
        scale * sum + own.map_or_else(Matrix3::zeros, |r| r.own_covariance())
    }

    /// Whether the robot says that it moves (or has not yet said that it stands).
    pub fn moves(&self, robot: usize) -> bool {
        self.robots.get(robot).is_some_and(|r| r.standing_since.is_none())
    }

    /// How the calibration stands, with the robots that are the reason.
    pub fn status(&self) -> (MapStatus, Vec<usize>) {
        let unplaced: Vec<usize> =
            self.robots.iter().filter(|(r, robot)| robot.seen && !self.is_placed(*r)).map(|(r, _)| r).collect();
        let (chi2, dof) = self.block.chi2();
        if self.gauge().is_none() && self.findings.is_empty() {
            let status = if self.ambiguous.is_empty() { MapStatus::Waiting } else { MapStatus::Ambiguous };
            return (status, if self.ambiguous.is_empty() { unplaced } else { self.ambiguous.clone() });
        }
        let wrong: Vec<usize> = self.findings.iter().flat_map(Finding::robots).collect();
        if !wrong.is_empty() || (dof > 0 && dof == self.fit.dof && chi2 > self.fit.utmost) {
            return (MapStatus::Inconsistent, wrong);
        }
        if !self.ambiguous.is_empty() {
            return (MapStatus::Ambiguous, self.ambiguous.clone());
        }
        let status = if unplaced.is_empty() { MapStatus::Converged } else { MapStatus::Insufficient };
        (status, unplaced)
    }

    /// χ² of the standing robots' solution and its degrees of freedom.
    pub fn chi2(&self) -> (f64, usize) {
        self.block.chi2()
    }

    fn is_placed(&self, robot: usize) -> bool {
        let convoy = self.is_convoy() && self.convoy.contains(robot);
        self.block.contains(robot) || self.rover(robot).is_some() || convoy
    }

    /// A robot that is followed by itself, and whose place may be shown.
    fn rover(&self, robot: usize) -> Option<&Rover> {
        self.robots.get(robot).filter(|r| !r.is_doubted())?.rover.as_ref()
    }

    /// Measurements that contradict each other more than chance allows make everything less certain.
    fn scale(&self) -> f64 {
        let (chi2, dof) = self.block.chi2();
        if dof < 2 || dof != self.fit.dof { 1.0 } else { (chi2 / self.fit.usual).max(1.0) }
    }

    fn dependence(&self, robot: usize) -> Vec<(usize, Matrix3<f64>)> {
        if self.block.contains(robot) {
            return vec![(robot, Matrix3::identity())];
        }
        self.rover(robot).map(|r| r.dependence().collect()).unwrap_or_default()
    }
}
