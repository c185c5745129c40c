//! Whether the map is right, from what a robot of the team hears of it, against the truth.

use std::collections::BTreeMap;

use nalgebra::{Matrix2, Rotation2, Vector2};
use protocol::id::TargetId;
use protocol::message::TeamMap;
use serde::Serialize;

use crate::world::State;

/// A target is right within so many sigmas, and metres.
const RIGHT: (f64, f64) = (3.0, 0.3);
/// The map must be right for so long, seconds.
pub const RIGHT_FOR_S: f64 = 1.0;
/// No map for so long is not right, seconds.
const SILENT_S: f64 = 0.3;
/// Beyond so many sigmas for longer than so long, a target is a lie.
const LIE: (f64, f64) = (5.0, 1.0);
/// Two numbers on one person for longer than this are one too many, seconds.
const DOUBLE_S: f64 = 2.0;
/// How near to a person a target is his, metres.
const HIS_M: f64 = 0.4;

/// What was found.
#[derive(Debug, Default, Clone, Serialize)]
pub struct Findings {
    /// From the fault to the first map of whoever led next, seconds, where somebody did.
    pub taken_over_s: Option<f64>,
    /// From the end of the fault to when the map was right again (and stayed so for a second), seconds.
    pub right_again_s: Option<f64>,
    /// People with another number after the fault than before it.
    pub renamed: usize,
    /// Longest time without any map, seconds.
    pub longest_silence_s: f64,
    /// What must never be, in words.
    pub violations: Vec<String>,
}

impl Findings {
    /// Whether nothing was that must never be, and the map was right again within `limit_s` after the fault.
    pub fn are_fine(&self, limit_s: f64) -> bool {
        self.violations.is_empty() && self.right_again_s.is_some_and(|after_s| after_s <= limit_s)
    }
}

/// Looks at each map that the robot believes.
#[derive(Debug)]
pub struct Judge {
    fault_s: (f64, f64),
    right_since: Option<f64>,
    last_map: Option<(f64, protocol::id::LeaderId, u64)>,
    before: BTreeMap<usize, TargetId>,
    after: BTreeMap<usize, TargetId>,
    lying_since: BTreeMap<TargetId, f64>,
    doubled_since: BTreeMap<usize, f64>,
    findings: Findings,
}

impl Judge {
    /// For a fault from … to, seconds.
    pub fn new(fault_s: (f64, f64)) -> Self {
        Self {
            fault_s,
            right_since: None,
            last_map: None,
            before: BTreeMap::new(),
            after: BTreeMap::new(),
            lying_since: BTreeMap::new(),
            doubled_since: BTreeMap::new(),
            findings: Findings::default(),
        }
    }

    /// A believed map that came at `now_s`; `truth` is that of its stamp. `live` are people that at least two robots have seen
    /// for a while; nothing is asked of the others.
    pub fn look(&mut self, now_s: f64, map: &TeamMap, truth: &State, live: &[bool]) {
        if let Some((last_s, leader, _)) = self.last_map {
            let silence_s = now_s - last_s;
            if now_s > self.fault_s.0 {
                self.findings.longest_silence_s = self.findings.longest_silence_s.max(silence_s);
            }
            if silence_s > SILENT_S {
                self.right_since = None;
            }
            if leader != map.leader && now_s > self.fault_s.0 && self.findings.taken_over_s.is_none() {
                self.findings.taken_over_s = Some(now_s - self.fault_s.0);
            }
        }
        self.last_map = Some((now_s, map.leader, map.term));
        let placed = Placed::of(map, truth);
        let mut right = placed.is_some();
        if let Some(placed) = placed {
            right = self.compare(now_s, &placed, truth, live);
        }
        self.right_since = if right { Some(self.right_since.unwrap_or(now_s)) } else { None };
        if let Some(since_s) = self.right_since
            && self.findings.right_again_s.is_none()
            && now_s - since_s.max(self.fault_s.1) >= RIGHT_FOR_S
        {
            self.findings.right_again_s = Some((since_s - self.fault_s.1).max(0.0));
        }
    }

    fn compare(&mut self, now_s: f64, placed: &Placed, truth: &State, live: &[bool]) -> bool {
        let mut right = true;
        for (n, person) in truth.people.iter().enumerate() {
            let at = Vector2::new(person.x_m, person.y_m);
            let nearest = placed.targets.iter().min_by(|a, b| (a.at - at).norm().total_cmp(&(b.at - at).norm()));
            let found = nearest.filter(|t| (t.at - at).norm() <= RIGHT.1 && t.sigmas(at) <= RIGHT.0);
            right &= found.is_some() || !live[n];
            if let Some(target) = nearest.filter(|t| (t.at - at).norm() <= HIS_M) {
                let names = if now_s < self.fault_s.0 { &mut self.before } else { &mut self.after };
                names.insert(n, target.id);
            }
            let alone = truth
                .people
                .iter()
                .enumerate()
                .all(|(m, other)| m == n || (Vector2::new(other.x_m, other.y_m) - at).norm() > 1.0);
            let his = placed.targets.iter().filter(|t| (t.at - at).norm() <= HIS_M).count();
            self.note_double(now_s, n, alone && his >= 2);
        }
        for target in &placed.targets {
            let place = |p: &crate::world::PersonState| Vector2::new(p.x_m, p.y_m);
            let nearest =
                truth.people.iter().map(place).min_by(|a, b| (a - target.at).norm().total_cmp(&(b - target.at).norm()));
            let lies = nearest.is_some_and(|at| target.sigmas(at) > LIE.0);
            self.note_lie(now_s, target.id, lies);
        }
        let shown: Vec<TargetId> = placed.targets.iter().map(|t| t.id).collect();
        self.lying_since.retain(|id, _| shown.contains(id));
        right
    }

    fn note_lie(&mut self, now_s: f64, id: TargetId, lies: bool) {
        if !lies {
            self.lying_since.remove(&id);
            return;
        }
        let since_s = *self.lying_since.entry(id).or_insert(now_s);
        if now_s - since_s > LIE.1 {
            self.violation(format!("target {id} is more than {} sigma from everybody since {since_s:.1} s", LIE.0));
            self.lying_since.insert(id, f64::INFINITY);
        }
    }

    fn note_double(&mut self, now_s: f64, person: usize, doubled: bool) {
        if !doubled {
            self.doubled_since.remove(&person);
            return;
        }
        let since_s = *self.doubled_since.entry(person).or_insert(now_s);
        if now_s - since_s > DOUBLE_S {
            self.violation(format!("person {} has two numbers since {since_s:.1} s", person + 1));
            self.doubled_since.insert(person, f64::INFINITY);
        }
    }

    /// Something that must never be.
    pub fn violation(&mut self, what: String) {
        if self.findings.violations.len() < 20 {
            self.findings.violations.push(what);
        }
    }

    /// What was found, at the end.
    pub fn conclude(mut self) -> Findings {
        let renamed = self.before.iter().filter(|(n, id)| self.after.get(n).is_some_and(|after| after != *id));
        self.findings.renamed = renamed.count();
        self.findings
    }
}

/// A map's targets in the room.
struct Placed {
    targets: Vec<Target>,
}

struct Target {
    id: TargetId,
    at: Vector2<f64>,
    information: Matrix2<f64>,
}

impl Target {
    fn sigmas(&self, at: Vector2<f64>) -> f64 {
        let e = at - self.at;
        (e.dot(&(self.information * e))).max(0.0).sqrt()
    }
}

impl Placed {
    /// By the robots of the map in the team's frame; `None` with fewer than two.
    fn of(map: &TeamMap, truth: &State) -> Option<Self> {
        let pairs: Vec<_> = map
            .placed(0)
            .filter_map(|robot| Some((robot.team_from_body?, truth.robots.iter().find(|t| t.id == robot.id)?)))
            .collect();
        if pairs.len() < 2 {
            return None;
        }
        let count = pairs.len() as f64;
        let (sin, cos) = pairs.iter().fold((0.0, 0.0), |(s, c), (pose, truth)| {
            let turn = truth.heading_rad - pose.heading_rad;
            (s + turn.sin(), c + turn.cos())
        });
        let room_from_team = Rotation2::new(sin.atan2(cos));
        let mean = |sum: Vector2<f64>| sum / count;
        let team_m = mean(pairs.iter().map(|(pose, _)| pose.position()).sum());
        let room_m = mean(pairs.iter().map(|(_, truth)| Vector2::new(truth.x_m, truth.y_m)).sum());
        let targets = map
            .targets
            .iter()
            .filter(|target| target.component == 0)
            .filter_map(|target| {
                let team = Vector2::new(target.position_m[0], target.position_m[1]);
                let covariance = map.covariance_of(target)?.fixed_view::<2, 2>(0, 0).into_owned();
                let turned = room_from_team.matrix() * covariance * room_from_team.matrix().transpose();
                let at = room_m + room_from_team * (team - team_m);
                Some(Target { id: target.id, at, information: turned.try_inverse()? })
            })
            .collect();
        Some(Self { targets })
    }
}
