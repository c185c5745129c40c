//! Robots that change from one component to another.
//!
//! A robot that changes keeps what it sees and loses what only means something in the frame that it leaves: its place, the names
//! of its slots. The calibration that takes it places it as it would any other that stands.

use nalgebra::Matrix3;
use protocol::frames::Pose2;
use protocol::time::Timestamp;

use super::{CalibrationConfig, Calibrator, Changes, GAUGE_VAR, LEAST_COUNT, Robot};
use crate::calibration::naming::{self, Known, View};

/// How long a robot must stand without a place before it is looked for elsewhere, seconds.
const PATIENCE_S: f64 = 0.6;

impl Calibrator {
    /// Whether the frame is fixed.
    pub fn is_founded(&self) -> bool {
        self.gauge.is_some()
    }

    /// Whether the robot has a place here, or had one that is remembered.
    pub fn knows(&self, robot: usize) -> bool {
        self.block.contains(robot) || self.robots.get(robot).is_some_and(|r| r.rover.is_some())
    }

    /// Robots that have stood for a while, see somebody, and have no place among the standing ones.
    pub fn strangers(&self, at: Timestamp) -> impl Iterator<Item = usize> + '_ {
        let waits = move |robot: &Robot| robot.standing_since.is_some_and(|t| at.seconds_since(t) >= PATIENCE_S);
        let strange = self.robots.iter().filter(move |(r, robot)| waits(robot) && !self.block.contains(*r));
        strange.map(|(r, _)| r).filter(move |r| !self.fresh_slots(*r, at).is_empty())
    }

    /// Of a robot, or of all that have a place: what it sees now and nobody here explains, by the names that the markers tell.
    pub fn unexplained(&self, robot: Option<usize>, at: Timestamp) -> Vec<Option<usize>> {
        let whose = self.robots.numbers().filter(|r| robot.map_or(self.block.contains(*r), |robot| robot == *r));
        let slots = whose.flat_map(|r| self.fresh_slots(r, at).into_iter().map(move |s| &self.robots[r].slots[s]));
        slots.filter(|slot| slot.name.is_none() && slot.count() >= LEAST_COUNT).map(|slot| slot.told).collect()
    }

    /// Robots, as they would come into another component.
    pub fn copies(&self, robots: impl IntoIterator<Item = usize>) -> Vec<(usize, Robot)> {
        robots.into_iter().filter_map(|r| Some((r, self.robots.get(r)?.as_stranger()))).collect()
    }

    /// These robots with that calibration's own ones, placed where that is possible and certain.
    pub fn with(&self, strangers: Vec<(usize, Robot)>, at: Timestamp) -> Self {
        let mut whole = self.clone();
        whole.changes = Changes::default();
        strangers.into_iter().for_each(|(number, robot)| whole.robots.insert(number, robot));
        whole.last_naming = None;
        whole.name_strangers(at);
        whole.solve(at);
        whole
    }

    /// What [`Self::with`] changed for those who depend on the poses.
    pub fn take_changes(&mut self) -> Changes {
        std::mem::take(&mut self.changes)
    }

    /// A component of its own round the robot `root`, of those of `strangers` that are certainly tied to it; `None` where none
    /// is, or where they see as much that they do not explain.
    pub fn found(
        config: CalibrationConfig,
        root: usize,
        strangers: Vec<(usize, Robot)>,
        at: Timestamp,
    ) -> Option<Self> {
        let mut new = Self::new(config);
        strangers.into_iter().for_each(|(number, robot)| new.robots.insert(number, robot));
        let pose = Pose2::IDENTITY;
        let views = new.views(at, |r| if r == root { Known::Fixed(pose) } else { Known::Nothing });
        let views: Vec<View> = naming::around(views, root);
        let naming = naming::name(&views, config.common_width_rad, config.naming_margin);
        if naming.placed.len() < 2 {
            return None;
        }
        new.block.insert(root, pose, &(Matrix3::identity() * GAUGE_VAR));
        new.gauge = Some(root);
        new.take_names(&naming, &views, at);
        let named = new.links().len();
        if new.unexplained(None, at).len() >= named {
            return None;
        }
        let others: Vec<usize> = new.robots.numbers().filter(|r| !new.block.contains(*r)).collect();
        others.into_iter().for_each(|r| drop(new.robots.remove(r)));
        new.solve(at);
        Some(new)
    }

    /// Takes a robot out, with all that depends on it here.
    pub fn release(&mut self, robot: usize, at: Timestamp) -> Changes {
        self.changes = Changes::default();
        self.depart(robot, at);
        self.robots.remove(robot);
        self.ambiguous.retain(|r| *r != robot);
        self.verifiable.remove(&robot);
        self.findings.retain(|finding| !finding.robots().contains(&robot));
        std::mem::take(&mut self.changes)
    }

    /// Takes a robot in, that has no place here yet.
    pub fn adopt(&mut self, robot: usize, state: Robot) {
        self.robots.insert(robot, state);
    }
}

impl Robot {
    fn as_stranger(&self) -> Self {
        let mut slots = self.slots.clone();
        slots.iter_mut().for_each(|slot| slot.name = None);
        Self { slots, seen: self.seen, back: self.back, standing_since: self.standing_since, ..Self::default() }
    }
}
