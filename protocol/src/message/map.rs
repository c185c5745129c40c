//! The team map: what the leader publishes.
//!
//! Robots that nothing ties together are in different components: each component has a frame of its own, and no position of
//! one means anything in another. Robots of a component carry one joint covariance (their errors are correlated: they were
//! calibrated against each other); each target carries its own covariance given the poses, and the Jacobian of its position to
//! the poses, from which anybody can compute the full covariance of any pair of entries:
//! `cov(target) = own + J · joint · Jᵀ` ([`TeamMap::covariance_of`]).

use bincode::{Decode, Encode};
use nalgebra::{DMatrix, Matrix3};

use crate::codec::{Invalid, Kind, Message, Subject, bounded_decode, check};
use crate::frames::Pose2;
use crate::id::{LeaderId, RobotId, TargetId};
use crate::message::Alarm;
use crate::time::Timestamp;

/// Most robots in a map.
pub const MAX_ROBOTS: usize = 256;
/// Most targets in a map.
pub const MAX_TARGETS: usize = 1024;
/// Most alarms in a map.
pub const MAX_ALARMS: usize = 8;

/// The team at one instant.
#[derive(Debug, Clone, PartialEq, Encode, Decode)]
pub struct TeamMap {
    /// Who leads.
    pub leader: LeaderId,
    /// Its term: receivers drop maps of a lower one (≤ [`MAX_TERM`](crate::fence::MAX_TERM)).
    pub term: u64,
    /// Counts the maps of the term.
    pub sequence: u64,
    /// The instant all entries are predicted to, leader's clock.
    pub stamp: Timestamp,
    /// Age of the oldest contribution, seconds.
    pub oldest_contribution_s: f32,
    /// How the calibration stands.
    pub status: MapStatus,
    /// Why, in one sentence for people (≤ 256 bytes).
    pub explanation: String,
    /// The robot whose pose fixed the frame of component 0, where one has.
    pub gauge: Option<RobotId>,
    /// All robots that were ever announced in this team (≤ [`MAX_ROBOTS`]).
    pub robots: Vec<MapRobot>,
    /// Joint covariance of the robots with a pose (x, y, heading each; m and rad), component by component from 0 up, robots of a
    /// component in the order of `robots`: of each the upper triangle row by row, n(n+1)/2 values for n = 3 · robots with a pose.
    pub joint_covariance: Vec<f32>,
    /// Moving objects (≤ [`MAX_TARGETS`]).
    pub targets: Vec<MapTarget>,
    /// The first number that no target of this team has had: whoever leads next counts from there.
    pub next_target: TargetId,
    /// What robots raised of late (≤ [`MAX_ALARMS`]), oldest first. The same alarm is in many maps: its robot, epoch and
    /// number tell.
    pub alarms: Vec<Alarm>,
}

/// How the mutual calibration stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Encode, Decode)]
pub enum MapStatus {
    /// No two robots have seen each other yet.
    Waiting,
    /// Solved.
    Converged,
    /// Several namings fit equally: nothing is placed that is not certain.
    Ambiguous,
    /// Measurements contradict each other.
    Inconsistent,
    /// Some robots or directions are not determined.
    Insufficient,
}

/// A robot in the map.
#[derive(Debug, Clone, PartialEq, Encode, Decode)]
pub struct MapRobot {
    /// Who.
    pub id: RobotId,
    /// Its pose, where known. Robots in different components are never in one frame.
    pub team_from_body: Option<Pose2>,
    /// Which component it belongs to; the gauge is in component 0. One that has no pose is a component by itself.
    pub component: u8,
    /// Whether it is there.
    pub presence: Presence,
    /// Whether it moves.
    pub moving: bool,
    /// Estimated offset of its clock to the leader's (robot − leader), seconds, and its standard deviation.
    pub clock_offset_s: Option<(f32, f32)>,
    /// By how much its pictures are older than their stamps say (latency that no clock probe sees; robots on the whole: 0),
    /// seconds, and its standard deviation, where moving targets have shown it.
    pub lag_s: Option<(f32, f32)>,
    /// Error that all its bearings of targets share, beside its heading's, rad, and its standard deviation, where shown.
    pub bias_rad: Option<(f32, f32)>,
    /// Whether its errors fit the sigmas that it states.
    pub trust: Trust,
    /// Whether at least three other robots that see each other would show it if what this one sees were false. Where not,
    /// it has to be believed, and may move the others.
    pub verifiable: bool,
    /// Why its observations are not used, where they are not.
    pub trouble: Option<Trouble>,
    /// Observations of its session that never came, or came too late or out of order.
    pub observations_lost: u32,
}

/// What the leader makes of the sigmas that a robot states.
#[derive(Debug, Clone, Copy, PartialEq, Encode, Decode)]
pub enum Trust {
    /// Its errors fit them.
    Full,
    /// Its errors are larger by this factor (> 1), by which its sigmas are widened.
    Widened(f32),
    /// What it sees contradicts the others; it is used only as far as it cannot do harm.
    SetAside,
}

/// Why a robot's observations are not used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Encode, Decode)]
pub enum Trouble {
    /// It has not said who it is.
    NotAnnounced,
    /// It has not answered a clock probe yet.
    ClockUnknown,
    /// Its clock is known too badly: bearings would be of another instant.
    ClockUncertain,
    /// Two sessions use its name: neither is used until one goes.
    TwoSessions,
}

/// Whether a robot is there.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Encode, Decode)]
pub enum Presence {
    /// Alive and sending.
    Online,
    /// Alive, but silent for longer than it should be.
    Silent,
    /// Gone; its pose is the last known.
    Offline,
}

/// A moving object in the map.
#[derive(Debug, Clone, PartialEq, Encode, Decode)]
pub struct MapTarget {
    /// Which.
    pub id: TargetId,
    /// In whose frame it is: that of this component's robots.
    pub component: u8,
    /// Position on the floor of its vertical axis and height of its centre where known (z), metres.
    pub position_m: [f64; 3],
    /// Velocity along the floor, m/s.
    pub velocity_mps: [f32; 2],
    /// Height of its top above the floor with its sigma, where seen.
    pub height_m: Option<(f32, f32)>,
    /// Covariance of (x, y, z) given exact robot poses: upper triangle xx xy xz yy yz zz, m².
    pub own_covariance: [f32; 6],
    /// Jacobian of (x, y) to the poses (x, y, heading) of each robot with a pose of its component, in the order of `robots`:
    /// 2 × 3n row by row.
    pub pose_jacobian: Vec<f32>,
    /// Robots that see it now.
    pub observers: Vec<RobotId>,
    /// The two of them whose bearings serve it best from where they stand, where two see it.
    pub pair: Option<(RobotId, RobotId)>,
    /// Seconds since it was last measured.
    pub age_s: f32,
}

/// Most bytes of the explanation.
pub const MAX_EXPLANATION_LEN: usize = 256;

impl Message for TeamMap {
    const KIND: Kind = Kind::TeamMap;

    fn validate(&self) -> Result<(), Invalid> {
        check::term("term", self.term)?;
        check::in_range("oldest_contribution_s", self.oldest_contribution_s, 0.0, f64::from(f32::MAX))?;
        check::text("explanation", &self.explanation, MAX_EXPLANATION_LEN)?;
        check::count("robots", self.robots.len(), MAX_ROBOTS)?;
        check::count("targets", self.targets.len(), MAX_TARGETS)?;
        self.robots.iter().try_for_each(MapRobot::validate)?;
        let sizes = self.sizes();
        let triangles = triangles(&self.joint_covariance, &sizes);
        check::consistent(triangles.is_some(), "joint_covariance", "has not one upper triangle a component")?;
        for (part, n) in triangles.into_iter().flatten().zip(&sizes) {
            check::covariance("joint_covariance", part, *n)?;
        }
        self.targets
            .iter()
            .try_for_each(|target| target.validate(sizes.get(usize::from(target.component)).copied().unwrap_or(0)))?;
        check::count("alarms", self.alarms.len(), MAX_ALARMS)?;
        self.alarms.iter().try_for_each(Message::validate)
    }

    fn subject(&self) -> Subject {
        Subject::Leader(self.leader)
    }

    bounded_decode!(Kind::TeamMap);
}

impl TeamMap {
    /// Robots of a component that have a pose, in the order of its joint covariance.
    pub fn placed(&self, component: u8) -> impl Iterator<Item = &MapRobot> {
        self.robots.iter().filter(move |robot| robot.component == component && robot.team_from_body.is_some())
    }

    /// Components with a placed robot, in their order.
    pub fn components(&self) -> Vec<u8> {
        let sizes = self.sizes().into_iter().zip(0..);
        sizes.filter(|(size, _)| *size > 0).map(|(_, component)| component).collect()
    }

    /// Joint covariance of a component's placed robots: 3n × 3n, x, y, heading of each in the order of [`Self::placed`]. `None`
    /// where the map's numbers do not fit its robots, which a decoded map's always do.
    pub fn joint_covariance_of(&self, component: u8) -> Option<DMatrix<f64>> {
        let sizes = self.sizes();
        let n = sizes.get(usize::from(component)).copied().unwrap_or(0);
        let triangle = triangles(&self.joint_covariance, &sizes)?.get(usize::from(component)).copied().unwrap_or(&[]);
        let mut full = DMatrix::zeros(n, n);
        let mut values = triangle.iter();
        for r in 0..n {
            for c in r..n {
                let v = f64::from(*values.next()?);
                full[(r, c)] = v;
                full[(c, r)] = v;
            }
        }
        Some(full)
    }

    /// 3 × 3 covariance of a target's (x, y, z) with the poses' part, m²: own + J · joint · Jᵀ. `None` as
    /// [`Self::joint_covariance_of`].
    pub fn covariance_of(&self, target: &MapTarget) -> Option<Matrix3<f64>> {
        target.covariance(&self.joint_covariance_of(target.component)?)
    }

    /// Rows of the joint covariance of each component, from 0 up.
    fn sizes(&self) -> Vec<usize> {
        let mut sizes = Vec::new();
        for robot in self.robots.iter().filter(|robot| robot.team_from_body.is_some()) {
            let component = usize::from(robot.component);
            sizes.resize(sizes.len().max(component + 1), 0);
            sizes[component] += 3;
        }
        sizes
    }
}

/// The upper triangles of the components, one after the other; `None` where the count of values is another.
fn triangles<'a>(values: &'a [f32], sizes: &[usize]) -> Option<Vec<&'a [f32]>> {
    let mut rest = values;
    let mut parts = Vec::with_capacity(sizes.len());
    for n in sizes {
        let (part, after) = rest.split_at_checked(n * (n + 1) / 2)?;
        parts.push(part);
        rest = after;
    }
    rest.is_empty().then_some(parts)
}

impl MapRobot {
    fn validate(&self) -> Result<(), Invalid> {
        if let Some(pose) = &self.team_from_body {
            pose.validate("robots.team_from_body")?;
        }
        if let Some((offset, sigma)) = self.clock_offset_s {
            check::finite("robots.clock_offset_s", offset)?;
            check::in_range("robots.clock_offset_s", sigma, 0.0, f64::from(f32::MAX))?;
        }
        for (name, value) in [("robots.lag_s", self.lag_s), ("robots.bias_rad", self.bias_rad)] {
            let Some((value, sigma)) = value else { continue };
            check::finite(name, value)?;
            check::in_range(name, sigma, 0.0, f64::from(f32::MAX))?;
        }
        match self.trust {
            Trust::Widened(factor) => check::in_range("robots.trust", factor, 1.0, f64::from(f32::MAX)),
            Trust::Full | Trust::SetAside => Ok(()),
        }
    }
}

impl MapTarget {
    /// 3 × 3 covariance of (x, y, z) under the joint covariance of its component ([`TeamMap::joint_covariance_of`]), m²; `None`
    /// where that is not of its component's size.
    pub fn covariance(&self, joint: &DMatrix<f64>) -> Option<Matrix3<f64>> {
        let n = joint.nrows();
        if self.pose_jacobian.len() != 2 * n {
            return None;
        }
        let j = DMatrix::from_row_iterator(2, n, self.pose_jacobian.iter().map(|v| f64::from(*v)));
        let [xx, xy, xz, yy, yz, zz] = self.own_covariance.map(f64::from);
        let mut cov = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
        let by_poses = &j * joint * j.transpose();
        for r in 0..2 {
            for c in 0..2 {
                cov[(r, c)] += by_poses[(r, c)];
            }
        }
        Some(cov)
    }

    fn validate(&self, pose_entries: usize) -> Result<(), Invalid> {
        check::all_finite("targets.position_m", &self.position_m)?;
        check::all_finite("targets.velocity_mps", &self.velocity_mps)?;
        if let Some((height, sigma)) = self.height_m {
            check::finite("targets.height_m", height)?;
            check::in_range("targets.height_m", sigma, 0.0, f64::from(f32::MAX))?;
        }
        check::covariance("targets.own_covariance", &self.own_covariance, 3)?;
        check::consistent(
            self.pose_jacobian.len() == 2 * pose_entries,
            "targets.pose_jacobian",
            "has not two rows of three entries a robot with a pose",
        )?;
        check::all_finite("targets.pose_jacobian", &self.pose_jacobian)?;
        check::count("targets.observers", self.observers.len(), MAX_ROBOTS)?;
        check::in_range("targets.age_s", self.age_s, 0.0, f64::from(f32::MAX))
    }
}
