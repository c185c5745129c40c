//! Scores as the design defines them.

use std::collections::BTreeMap;
use std::fmt;

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};
use pathfinding::kuhn_munkres::kuhn_munkres_min;
use pathfinding::matrix::Matrix;
use protocol::id::TargetId;
use protocol::message::TeamMap;

use super::world::{World, clock};

const FROM_S: f64 = 5.0;
const GATE_M: f64 = 0.5;

#[derive(Debug, Default)]
pub struct Score {
    standing: Mean,
    standing_turn: Mean,
    driving: Mean,
    driving_turn: Mean,
    targets: Mean,
    pub expected: u64,
    pub matched: u64,
    pub id_switches: u32,
    pub false_tracks: u64,
    target_nees: Mean,
    robot_nees: Mean,
    pub maps: u64,
    pub first_map_s: Option<f64>,
    last_id: BTreeMap<usize, TargetId>,
    last_nees_s: f64,
    /// True pose of the gauge's robot when it fixed the frame.
    zero: Option<[f64; 3]>,
    /// Worst position error of any robot after `worst_from_s`, m.
    pub worst_m: f64,
    /// Robots without a place after `worst_from_s`.
    pub unplaced: u64,
    /// From when on those two count.
    pub worst_from_s: f64,
}

#[derive(Debug, Default, Clone, Copy)]
struct Mean {
    n: u64,
    sum: f64,
}

impl Mean {
    fn add(&mut self, x: f64) {
        self.n += 1;
        self.sum += x;
    }
    fn get(self) -> f64 {
        if self.n == 0 { 0.0 } else { self.sum / self.n as f64 }
    }
}

impl Score {
    pub fn take(&mut self, world: &World, map: &TeamMap) {
        self.maps += 1;
        let t = map.stamp.seconds_since(clock(0.0));
        let (poses, people) = world.truth_at(t);
        let placed = map.robots.iter().filter(|r| r.team_from_body.is_some()).count();
        if placed == world.robots.len() {
            self.first_map_s.get_or_insert(t);
        }
        if let Some(g) = map.gauge.filter(|_| self.zero.is_none()) {
            self.zero = world.robots.iter().position(|r| r.id == g).map(|k| poses[k]);
        }
        if t < FROM_S {
            return;
        }
        if t > self.worst_from_s && placed < world.robots.len() {
            self.unplaced += 1;
        }
        let Some(gauge) = map.gauge.and_then(|g| world.robots.iter().position(|r| r.id == g)) else { return };
        let zero = *self.zero.get_or_insert(poses[gauge]);
        let to_team = |p: [f64; 2]| {
            let (s, c) = zero[2].sin_cos();
            let (dx, dy) = (p[0] - zero[0], p[1] - zero[1]);
            Vector2::new(c * dx + s * dy, -s * dx + c * dy)
        };
        let nees_now = t - self.last_nees_s >= 2.0;
        if nees_now {
            self.last_nees_s = t;
        }
        let joint = map.joint_covariance_of(0).unwrap();
        let mut row = 0;
        for robot in map.placed(0) {
            let Some(pose) = robot.team_from_body else { continue };
            let k = world.robots.iter().position(|r| r.id == robot.id).unwrap();
            let truth = to_team([poses[k][0], poses[k][1]]);
            let turn = protocol::angle::wrap(pose.heading_rad - (poses[k][2] - zero[2]));
            let e = pose.position() - truth;
            let cov: Matrix3<f64> = joint.fixed_view::<3, 3>(row, row).into_owned();
            row += 3;
            if t > self.worst_from_s {
                self.worst_m = self.worst_m.max(e.norm());
            }
            if k == gauge && !world.drives(k) {
                continue;
            }
            let (place, heading) = if world.drives(k) && t > 19.5 && t < 31.0 {
                (&mut self.driving, &mut self.driving_turn)
            } else {
                (&mut self.standing, &mut self.standing_turn)
            };
            place.add(e.norm_squared());
            heading.add(turn * turn);
            if nees_now {
                let v = Vector3::new(e.x, e.y, turn);
                self.robot_nees.add(v.dot(&cov.cholesky().unwrap().solve(&v)) / 3.0);
            }
        }
        self.take_targets(map, people, poses, &to_team, nees_now, t);
    }

    fn take_targets(
        &mut self,
        map: &TeamMap,
        people: &[super::world::PersonTruth],
        poses: &[[f64; 3]],
        to_team: &dyn Fn([f64; 2]) -> Vector2<f64>,
        nees_now: bool,
        t: f64,
    ) {
        let n = people.len();
        let mut costs = Matrix::new(n, n + map.targets.len(), 1_000_000i64);
        for (p, person) in people.iter().enumerate() {
            let truth = to_team(person.position);
            for (k, target) in map.targets.iter().enumerate() {
                let d = (Vector2::new(target.position_m[0], target.position_m[1]) - truth).norm();
                if d < GATE_M {
                    costs[(p, k)] = (d * 1000.0) as i64;
                }
            }
            costs[(p, map.targets.len() + p)] = 10_000;
        }
        let (_, chosen) = kuhn_munkres_min(&costs);
        let mut used = 0;
        for (p, k) in chosen.into_iter().enumerate() {
            let person = &people[p];
            let counted = person.seen_by.len() >= 2 && widest_parallax(poses, person) >= 0.1;
            self.expected += u64::from(counted);
            if k >= map.targets.len() || costs[(p, k)] >= 10_000 {
                if counted && std::env::var("MISSES").is_ok() && nees_now {
                    println!(
                        "t {t:.2} person {p} missed, seen by {:?} at {:?}",
                        person.seen_by,
                        to_team(person.position).as_slice()
                    );
                }
                continue;
            }
            used += 1;
            let target = &map.targets[k];
            let e = Vector2::new(target.position_m[0], target.position_m[1]) - to_team(person.position);
            if std::env::var("ERRORS").is_ok() && nees_now {
                let cov = map.covariance_of(target).unwrap();
                println!(
                    "t {t:.1} p{p} {} at {:.2} {:.2} v {:.2} e {:.3} {:.3} sigma {:.3} {:.3} seen {:?} by {:?} est v {:?}",
                    target.id,
                    person.position[0],
                    person.position[1],
                    person.speed(),
                    e.x,
                    e.y,
                    cov[(0, 0)].sqrt(),
                    cov[(1, 1)].sqrt(),
                    person.seen_by,
                    target.observers,
                    target.velocity_mps
                );
            }
            if counted {
                self.matched += 1;
                if second_nearest(poses, person) <= 5.0 {
                    self.targets.add(e.norm_squared());
                }
                if nees_now {
                    let cov = map.covariance_of(target).unwrap();
                    let cov: Matrix2<f64> = cov.fixed_view::<2, 2>(0, 0).into_owned();
                    self.target_nees.add(e.dot(&cov.cholesky().unwrap().solve(&e)) / 2.0);
                }
            }
        }
        self.false_tracks += (map.targets.len() - used) as u64;
        self.follow_ids(map, people, to_team, t);
    }

    /// CLEAR-MOT: a correspondence lives as long as it is within the gate; only then others are assigned.
    fn follow_ids(
        &mut self,
        map: &TeamMap,
        people: &[super::world::PersonTruth],
        to_team: &dyn Fn([f64; 2]) -> Vector2<f64>,
        t: f64,
    ) {
        let distance = |p: usize, k: usize| {
            let at = map.targets[k].position_m;
            (Vector2::new(at[0], at[1]) - to_team(people[p].position)).norm()
        };
        let mut free_people: Vec<usize> = (0..people.len()).collect();
        let mut free_targets: Vec<usize> = (0..map.targets.len()).collect();
        for p in 0..people.len() {
            let kept = self
                .last_id
                .get(&p)
                .and_then(|id| free_targets.iter().position(|&k| map.targets[k].id == *id && distance(p, k) < GATE_M));
            if let Some(at) = kept {
                free_targets.remove(at);
                free_people.retain(|q| *q != p);
            }
        }
        let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
        for &p in &free_people {
            for &k in &free_targets {
                pairs.push((distance(p, k), p, k));
            }
        }
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (d, p, k) in pairs {
            if d >= GATE_M || !free_people.contains(&p) || !free_targets.contains(&k) {
                continue;
            }
            free_people.retain(|q| *q != p);
            free_targets.retain(|q| *q != k);
            let id = map.targets[k].id;
            if let Some(old) = self.last_id.insert(p, id)
                && old != id
            {
                self.id_switches += 1;
                if std::env::var("MISSES").is_ok() {
                    println!("t {t:.2} person {p} switches {old} -> {id}");
                }
            }
        }
    }

    pub fn merge(&mut self, o: &Self) {
        for (a, b) in [
            (&mut self.standing, o.standing),
            (&mut self.standing_turn, o.standing_turn),
            (&mut self.driving, o.driving),
            (&mut self.driving_turn, o.driving_turn),
            (&mut self.targets, o.targets),
            (&mut self.target_nees, o.target_nees),
            (&mut self.robot_nees, o.robot_nees),
        ] {
            a.n += b.n;
            a.sum += b.sum;
        }
        self.expected += o.expected;
        self.matched += o.matched;
        self.id_switches += o.id_switches;
        self.false_tracks += o.false_tracks;
        self.maps += o.maps;
    }

    pub fn standing_m(&self) -> f64 {
        self.standing.get().sqrt()
    }
    pub fn standing_deg(&self) -> f64 {
        self.standing_turn.get().sqrt().to_degrees()
    }
    pub fn driving_m(&self) -> f64 {
        self.driving.get().sqrt()
    }
    pub fn driving_deg(&self) -> f64 {
        self.driving_turn.get().sqrt().to_degrees()
    }
    pub fn targets_m(&self) -> f64 {
        self.targets.get().sqrt()
    }
    pub fn coverage(&self) -> f64 {
        self.matched as f64 / self.expected.max(1) as f64
    }
    pub fn false_per_map(&self) -> f64 {
        self.false_tracks as f64 / self.maps.max(1) as f64
    }
    pub fn target_nees(&self) -> f64 {
        self.target_nees.get()
    }
    pub fn robot_nees(&self) -> f64 {
        self.robot_nees.get()
    }
}

/// Largest sine of the angle under which two robots that see the person look at it.
fn widest_parallax(poses: &[[f64; 3]], person: &super::world::PersonTruth) -> f64 {
    let line = |r: usize| (person.position[1] - poses[r][1]).atan2(person.position[0] - poses[r][0]);
    let pairs = person.seen_by.iter().flat_map(|&a| person.seen_by.iter().map(move |&b| (a, b)));
    pairs.map(|(a, b)| (line(a) - line(b)).sin().abs()).fold(0.0, f64::max)
}

/// Distance of the second nearest robot.
fn second_nearest(poses: &[[f64; 3]], person: &super::world::PersonTruth) -> f64 {
    let mut d: Vec<f64> = poses.iter().map(|p| (person.position[0] - p[0]).hypot(person.position[1] - p[1])).collect();
    d.sort_by(f64::total_cmp);
    d[1]
}

impl fmt::Display for Score {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "standing {:.3} m {:.2}°, driving {:.3} m {:.2}°, targets {:.3} m, coverage {:.3}, switches {}, false {:.3}/map, NEES robots {:.2} targets {:.2}, maps {}, first {:?}",
            self.standing_m(),
            self.standing_deg(),
            self.driving_m(),
            self.driving_deg(),
            self.targets_m(),
            self.coverage(),
            self.id_switches,
            self.false_tracks as f64 / self.maps.max(1) as f64,
            self.robot_nees(),
            self.target_nees(),
            self.maps,
            self.first_map_s,
        )
    }
}
