//! Robots that nothing ties together: each component has a frame, targets and shared errors of its own.
//!
//! Component 0 is the team's: its frame is the anchor's, everybody who joins belongs to it, and until it has a frame there is no
//! other. A standing robot that it cannot place may be tied to others that it cannot place either (another room): these become
//! a component. Where robots of two components come to see each other, the younger one dissolves into the older; a robot that
//! arrives among those of another component changes to it. All of that is tried on copies first and done only where the places
//! are certain.

use nalgebra::Vector2;
use protocol::frames::Pose2;
use protocol::id::TargetId;
use protocol::time::Timestamp;

use super::Leader;
use super::config::LeaderCoreConfig;
use super::guidance::Guide;
use super::names::Own;
use crate::calibration::live::{Calibrator, Changes, Robot};
use crate::calibration::systematic::Systematic;
use crate::correspondence::{Followed, Follower};
use crate::structure::Structure;

/// Between attempts to tie robots together, seconds; most trials in one.
const INTERVAL_S: f64 = 0.2;
const MAX_TRIALS: usize = 6;

/// Robots in one frame, and what they see.
#[derive(Debug)]
pub struct Component {
    /// Its number in the map; 0 is the team's.
    pub number: u8,
    /// No two components that ever were have the same.
    pub serial: u32,
    /// Where its robots are.
    pub calibrator: Calibrator,
    /// Its targets.
    pub follower: Follower,
    /// What its robots' bearings share.
    pub systematic: Systematic,
    /// What stands still round its robots.
    pub structure: Structure,
    pub(super) guide: Guide,
}

/// When robots were last tried, and whose turn it is.
#[derive(Debug, Default)]
pub struct Exchange {
    last: Option<Timestamp>,
    turn: usize,
    serials: u32,
}

impl Component {
    fn new(number: u8, serial: u32, calibrator: Calibrator, config: &LeaderCoreConfig) -> Self {
        Self {
            number,
            serial,
            calibrator,
            follower: Follower::new(config.targets),
            systematic: Systematic::new(config.targets),
            structure: Structure::default(),
            guide: Guide::default(),
        }
    }

    /// The team's, in which nobody is yet.
    pub fn first(config: &LeaderCoreConfig) -> Self {
        Self::new(0, 0, Calibrator::new(config.calibration), config)
    }

    /// Begins anew without robots; only number and serial stay.
    pub fn clear(&mut self, config: &LeaderCoreConfig) {
        *self = Self::new(self.number, self.serial, Calibrator::new(config.calibration), config);
    }

    /// Poses were corrected, robots left.
    pub fn follow_changes(&mut self, changes: &Changes, at: Timestamp) {
        for (robot, ..) in &changes.left {
            self.systematic.left_station(*robot);
        }
        self.follower.follow_changes(changes, at);
        self.structure.follow_changes(changes);
    }

    /// What was tried is done.
    fn go_on_with(&mut self, mut calibrator: Calibrator, at: Timestamp) {
        let changes = calibrator.take_changes();
        self.calibrator = calibrator;
        self.follow_changes(&changes, at);
    }

    /// Targets that are believed.
    pub fn confirmed(&self) -> impl Iterator<Item = &Followed> {
        self.follower.targets().iter().filter(|followed| followed.is_confirmed())
    }

    /// Those of them that the team map shows. Agents are told of the others as well: they know earlier who is near.
    pub fn shown(&self) -> impl Iterator<Item = &Followed> {
        self.follower.targets().iter().filter(|followed| followed.may_be_shown())
    }
}

impl Leader {
    /// The component that the robot belongs to.
    pub(super) fn home(&mut self, robot: usize) -> &mut Component {
        &mut self.components[self.members[robot].component]
    }

    /// Robots of a component.
    pub(super) fn robots_of(&self, component: usize) -> impl Iterator<Item = usize> + '_ {
        self.members.iter().enumerate().filter(move |(_, m)| m.component == component).map(|(k, _)| k)
    }

    /// Ties robots together that belong together, now and then. `at`: the newest capture.
    pub(super) fn exchange_robots(&mut self, at: Timestamp) {
        let waits = self.exchange.last.is_some_and(|last| at.seconds_since(last) < INTERVAL_S);
        if waits || !self.components[0].calibrator.is_founded() {
            return;
        }
        self.exchange.last = Some(at);
        self.exchange.turn = self.exchange.turn.wrapping_add(1);
        self.dissolve_remains(at);
        let mut trials = MAX_TRIALS;
        self.receive_arrivals(at, &mut trials);
        self.join_components(at, &mut trials);
        self.found_components(at, &mut trials);
    }

    /// Standing robots without a place in their component, in the order of their turn.
    fn strangers(&self, at: Timestamp) -> Vec<usize> {
        let mut strangers: Vec<usize> = self.components.iter().flat_map(|c| c.calibrator.strangers(at)).collect();
        strangers.sort_unstable();
        let turn = self.exchange.turn % strangers.len().max(1);
        strangers.rotate_left(turn);
        strangers
    }

    /// Robots that have come to stand among those of another component.
    fn receive_arrivals(&mut self, at: Timestamp, trials: &mut usize) {
        if self.components.len() < 2 {
            return;
        }
        for robot in self.strangers(at) {
            let home = self.members[robot].component;
            let ours = self.components[home].calibrator.unexplained(Some(robot), at);
            for there in (0..self.components.len()).filter(|there| *there != home) {
                if *trials == 0 {
                    return;
                }
                let theirs = || self.components[there].calibrator.unexplained(None, at);
                if !self.may_meet(&ours, there, None) || !self.may_meet(&theirs(), home, Some(robot)) {
                    continue;
                }
                *trials -= 1;
                let copy = self.components[home].calibrator.copies([robot]);
                let trial = self.components[there].calibrator.with(copy, at);
                if trial.station(robot).is_some() {
                    self.move_to(robot, there, at);
                    self.components[there].go_on_with(trial, at);
                    break;
                }
            }
        }
    }

    /// Whether slots with these names may show a robot of a component, or that one of it.
    fn may_meet(&self, told: &[Option<usize>], component: usize, robot: Option<usize>) -> bool {
        told.iter().any(|told| {
            told.is_none_or(|told| {
                robot.is_none_or(|robot| robot == told)
                    && self.members.get(told).is_some_and(|member| member.component == component)
            })
        })
    }

    /// Two components whose robots see each other become one, in the frame of the older.
    fn join_components(&mut self, at: Timestamp, trials: &mut usize) {
        let seen: Vec<_> = self.components.iter().map(|c| c.calibrator.unexplained(None, at)).collect();
        let count = self.components.len();
        let mut pairs: Vec<(usize, usize)> = (0..count)
            .flat_map(|a| (a + 1..count).map(move |b| (a, b)))
            .filter(|&(a, b)| self.may_meet(&seen[a], b, None) && self.may_meet(&seen[b], a, None))
            .collect();
        let turn = self.exchange.turn % pairs.len().max(1);
        pairs.rotate_left(turn);
        for (older, younger) in pairs {
            if *trials == 0 {
                return;
            }
            *trials -= 1;
            let robots: Vec<usize> = self.robots_of(younger).collect();
            let copies = self.components[younger].calibrator.copies(robots.iter().copied());
            let trial = self.components[older].calibrator.with(copies, at);
            if let Some(common) = robots.iter().copied().find(|r| trial.station(*r).is_some()) {
                if let (Some(here), Some(there)) =
                    (trial.station(common), self.components[younger].calibrator.station(common))
                {
                    self.hand_over_numbers(younger, older, here * there.inverse(), at);
                }
                self.components[older].go_on_with(trial, at);
                robots.iter().for_each(|r| self.members[*r].component = older);
                self.remove_component(younger);
                // The others' numbers have changed.
                return;
            }
        }
    }

    /// Whoever is found again in the frame that a component dissolves into keeps the number.
    fn hand_over_numbers(&mut self, from: usize, to: usize, to_from_from: Pose2, at: Timestamp) {
        let (old, new) = (self.components[from].serial, self.components[to].serial);
        let targets: Vec<(TargetId, Vector2<f64>, Vector2<f64>)> = self.components[from]
            .confirmed()
            .map(|followed| (followed.id, followed.state.target.position(), followed.state.target.velocity()))
            .collect();
        for (id, position, velocity) in targets {
            let velocity = to_from_from.rotation() * velocity;
            self.names.hand_over((old, id), new, to_from_from.transform(position), velocity, at);
        }
    }

    /// Strangers that see each other become a component.
    fn found_components(&mut self, at: Timestamp, trials: &mut usize) {
        let mut strangers = self.strangers(at);
        while let (Some(root), true) = (strangers.first().copied(), *trials > 0 && strangers.len() > 1) {
            *trials -= 1;
            let all: Vec<(usize, Robot)> = strangers
                .iter()
                .flat_map(|r| self.components[self.members[*r].component].calibrator.copies([*r]))
                .collect();
            let Some(found) = Calibrator::found(self.config.calibration, root, all, at) else {
                strangers.remove(0);
                continue;
            };
            let robots: Vec<usize> = found.stations().map(|(r, _)| r).collect();
            strangers.retain(|r| !robots.contains(r));
            let component = self.new_component(found);
            for robot in robots {
                self.leave(robot, at);
                self.members[robot].component = component;
            }
        }
    }

    /// A robot changes to another component, in which it has no place yet.
    pub(super) fn move_to(&mut self, robot: usize, component: usize, at: Timestamp) {
        if self.members[robot].component != component {
            let copies = self.home(robot).calibrator.copies([robot]);
            self.leave(robot, at);
            self.members[robot].component = component;
            for (robot, state) in copies {
                self.home(robot).calibrator.adopt(robot, state);
            }
        }
    }

    /// A robot is taken out of its component, and has none until it gets one.
    fn leave(&mut self, robot: usize, at: Timestamp) {
        let home = self.home(robot);
        let changes = home.calibrator.release(robot, at);
        home.follow_changes(&changes, at);
        home.follower.forget_tracks(robot);
        home.systematic.new_session(robot);
    }

    /// One more component.
    pub(super) fn new_component(&mut self, calibrator: Calibrator) -> usize {
        self.exchange.serials += 1;
        let free = |number: &u8| self.components.iter().all(|c| c.number != *number);
        let number = (1..=u8::MAX).find(free).unwrap_or(u8::MAX);
        self.components.push(Component::new(number, self.exchange.serials, calibrator, &self.config));
        self.components.len() - 1
    }

    /// Components in which fewer than two robots have, or had, a place: who remains is the team's again.
    fn dissolve_remains(&mut self, at: Timestamp) {
        for component in (1..self.components.len()).rev() {
            let robots: Vec<usize> = self.robots_of(component).collect();
            let calibrator = &self.components[component].calibrator;
            if robots.iter().filter(|r| calibrator.knows(**r)).count() >= 2 {
                continue;
            }
            robots.into_iter().for_each(|robot| self.move_to(robot, 0, at));
            self.remove_component(component);
        }
    }

    fn remove_component(&mut self, component: usize) {
        let gone = self.components.remove(component);
        self.names.forget(gone.serial);
        for member in self.members.iter_mut().filter(|member| member.component > component) {
            member.component -= 1;
        }
    }

    /// All targets of ours at `at`, for their numbers.
    pub(super) fn own_targets(&self, at: Timestamp) -> Vec<Own> {
        let of = |component: &Component| {
            let serial = component.serial;
            let own = component.confirmed().map(move |followed| {
                let (target, ahead_s) = (&followed.state.target, at.seconds_since(followed.state.last));
                let position = target.position() + target.velocity() * ahead_s.clamp(-0.5, 0.5);
                Own { id: (serial, followed.id), position, velocity: target.velocity() }
            });
            own.collect::<Vec<_>>()
        };
        self.components.iter().flat_map(of).collect()
    }
}
