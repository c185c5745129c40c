//! What was true at a map's stamp, for the score. Who could see whom comes from the last picture of each robot before it.

use std::collections::BTreeSet;

use protocol::frames::Pose2;
use protocol::id::RobotId;
use serde::{Deserialize, Serialize};

use crate::score::visibility::coverable;
use crate::score::{PersonTruth, RobotTruth, Truth};
use crate::world::World;

/// When a robot took a picture, and the share of each person unhidden in it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Glimpse {
    /// True time.
    pub time_s: f64,
    /// A person each.
    pub visible_fraction: Vec<f64>,
}

/// The truth of a run.
#[derive(Debug)]
pub struct TruthKeeper<'a> {
    world: &'a World,
    names: &'a [RobotId],
    /// Of each robot, in order of time.
    glimpses: &'a [Vec<Glimpse>],
    drivers: BTreeSet<usize>,
}

impl<'a> TruthKeeper<'a> {
    /// `names` and `glimpses` in the order of the world's robots; a robot is a driver if it moves before `end_s`.
    pub fn new(world: &'a World, names: &'a [RobotId], glimpses: &'a [Vec<Glimpse>], end_s: f64) -> Self {
        let drives = |robot: &crate::world::Robot| robot.drives.iter().any(|d| d.start_s < end_s && d.end_s > 0.0);
        let drivers = world.robots().iter().enumerate().filter(|(_, r)| drives(r)).map(|(n, _)| n).collect();
        Self { world, names, glimpses, drivers }
    }

    /// The share of each person that each robot sees around a time.
    pub fn fractions(&self, time_s: f64) -> Vec<&'a [f64]> {
        self.glimpses
            .iter()
            .map(|glimpses| {
                let after = glimpses.partition_point(|g| g.time_s <= time_s + 1e-6);
                glimpses.get(after.saturating_sub(1)).map_or(&[][..], |g| &g.visible_fraction)
            })
            .collect()
    }

    /// The truth at a time.
    pub fn at(&self, time_s: f64) -> Truth {
        let state = self.world.at(time_s);
        let fractions = self.fractions(time_s);
        let robots: Vec<RobotTruth> = state
            .robots
            .iter()
            .enumerate()
            .map(|(n, robot)| RobotTruth {
                id: self.names[n],
                room_from_body: Pose2::new(robot.x_m, robot.y_m, robot.heading_rad),
                moving: robot.moving,
                drives: self.drivers.contains(&n),
            })
            .collect();
        let people = state
            .people
            .iter()
            .enumerate()
            .map(|(n, person)| {
                let position_m = [person.x_m, person.y_m];
                let sights: Vec<([f64; 2], f64)> = robots
                    .iter()
                    .zip(&fractions)
                    .map(|(robot, seen)| {
                        (robot.room_from_body.position().into(), seen.get(n).copied().unwrap_or_default())
                    })
                    .collect();
                PersonTruth { id: person.id.clone(), position_m, coverable: coverable(position_m, &sights) }
            })
            .collect();
        Truth { time_s, robots, people }
    }
}
