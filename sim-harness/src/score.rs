//! How good a run was, against truth. The definitions are fixed (`DESIGN.md` §6):
//!
//! - A person's truth is the vertical axis through its volume's centroid at the map's stamp; every map from [`WARM_UP_S`]
//!   after the start on is scored.
//! - Truth and map are brought together by the true pose of the gauge robot at the first map that has one: nothing is fitted.
//! - Targets and people are matched by optimal assignment inside [`GATE_M`].
//! - *coverage*: matched person-instants among those that two robots could see ([`visibility`]); merged blobs count.
//! - GOSPA with p = 2, c = 1 m, α = 2 over all people and all targets, mean over the maps.
//! - Identity switches as in CLEAR-MOT ([`identity`]). A false track is a target that is matched in fewer than half of the
//!   maps it stands in.
//! - Robots: RMS over all robots but the gauge robot. A robot that drives in the run is reported apart.
//! - NEES ([`nees`]) of robots: the joint error of all robots whose covariance is not zero by definition (the gauge), one
//!   sample each 2 s; of targets: (x, y) with the whole covariance own + J · joint · Jᵀ, all matched targets each 2 s.

pub mod assignment;
pub mod cdnet;
pub mod identity;
pub mod mot;
pub mod nees;
pub mod scores;
pub mod statistics;
pub mod structure;
pub mod summary;
pub mod visibility;

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector, Vector2};
use protocol::angle::difference;
use protocol::frames::Pose2;
use protocol::id::{RobotId, TargetId};
use protocol::message::{MapTarget, TeamMap};
use serde::Serialize;

use self::assignment::assign;
use self::identity::IdentityCount;
use self::nees::{Nees, SPACING_S, mahalanobis2};
pub use self::scores::{Run, Scores};
use self::statistics::Rms;
pub use self::summary::Summary;

/// Nothing is scored before, seconds after the start.
pub const WARM_UP_S: f64 = 5.0;
/// Largest distance between a person and the target that follows it, metres.
pub const GATE_M: f64 = 0.5;
/// c of GOSPA, metres.
pub const GOSPA_CUT_M: f64 = 1.0;
/// Targets within this of their two nearest robots are reported apart, metres.
pub const NEAR_M: f64 = 5.0;
/// A variance below is zero by definition: the gauge robot's.
const NO_VARIANCE: f64 = 1e-13;

/// The truth at one map's stamp, in the room's frame.
#[derive(Debug, Clone, Default)]
pub struct Truth {
    /// Since the start of the scenario.
    pub time_s: f64,
    /// All robots.
    pub robots: Vec<RobotTruth>,
    /// All people, in one order over the run.
    pub people: Vec<PersonTruth>,
}

/// A robot as it was.
#[derive(Debug, Clone)]
pub struct RobotTruth {
    /// Who.
    pub id: RobotId,
    /// Where.
    pub room_from_body: Pose2,
    /// Whether it moves now.
    pub moving: bool,
    /// Whether it moves at any time of the run.
    pub drives: bool,
}

/// A person as it was.
#[derive(Debug, Clone)]
pub struct PersonTruth {
    /// Who.
    pub id: String,
    /// The vertical axis through the volume's centroid.
    pub position_m: [f64; 2],
    /// Whether two robots could place it ([`visibility::coverable`]).
    pub coverable: bool,
}

/// What one map had wrong, for whoever looks for the reason. Metres, degrees.
#[derive(Debug, Clone, Serialize)]
pub struct MapErrors {
    /// Of the map's stamp.
    pub time_s: f64,
    /// Robots with a pose, in the map's order.
    pub robots: Vec<RobotError>,
    /// Matched pairs.
    pub targets: Vec<TargetError>,
    /// Coverable people without a target.
    pub missed: Vec<String>,
    /// Targets without a person: id and position in the room.
    pub unmatched: Vec<(TargetId, [f64; 2])>,
    /// People who switched to another target.
    pub switched: Vec<String>,
}

/// A robot's error in the team frame.
#[derive(Debug, Clone, Serialize)]
pub struct RobotError {
    /// Who.
    pub id: RobotId,
    /// Estimate minus truth.
    pub error_m: [f64; 2],
    /// Estimate minus truth.
    pub heading_error_deg: f64,
    /// Of x, y and heading.
    pub sigma: [f64; 3],
    /// Of x, y, heading, divided by 3.
    pub nees: Option<f64>,
}

/// A matched target's error in the team frame.
#[derive(Debug, Clone, Serialize)]
pub struct TargetError {
    /// Of whom.
    pub person: String,
    /// By which target.
    pub target: TargetId,
    /// Estimate minus truth.
    pub error_m: [f64; 2],
    /// Of x and y, whole covariance.
    pub sigma_m: [f64; 2],
    /// Divided by 2.
    pub nees: Option<f64>,
    /// How many robots see it.
    pub observers: usize,
    /// Seconds since it was measured.
    pub age_s: f32,
}

/// Takes maps in and keeps the sums.
#[derive(Debug, Clone, Default)]
pub struct Scorer {
    room_from_team: Option<Pose2>,
    sums: Sums,
    identity: IdentityCount,
    /// A target each: maps it was matched in, maps it stood in.
    lives: BTreeMap<TargetId, (usize, usize)>,
    last_sample_s: Option<f64>,
}

#[derive(Debug, Clone, Default)]
struct Sums {
    standing: [Rms; 2],
    driving: [Rms; 2],
    driving_now: [Rms; 2],
    placed: [usize; 2],
    targets: Rms,
    near_targets: Rms,
    covered: [usize; 2],
    gospa_m: Vec<f64>,
    robot_nees: Nees,
    target_nees: Nees,
}

impl Scorer {
    /// Takes a map in. Maps come in the order of their stamps. Gives the errors of a scored map.
    pub fn add(&mut self, truth: &Truth, map: &TeamMap) -> Option<MapErrors> {
        self.align(truth, map);
        if truth.time_s < WARM_UP_S {
            return None;
        }
        let sampled = self.last_sample_s.is_none_or(|last| truth.time_s >= last + SPACING_S - 1e-9);
        if sampled {
            self.last_sample_s = Some(truth.time_s);
        }
        let Some(room_from_team) = self.room_from_team else {
            // Nothing is placed: whoever could be covered is missed.
            self.sums.covered[1] += truth.people.iter().filter(|p| p.coverable).count();
            self.sums.placed[1] += truth.robots.len();
            self.sums.gospa_m.push((truth.people.len() as f64 * GOSPA_CUT_M * GOSPA_CUT_M / 2.0).sqrt());
            return None;
        };
        let team_from_room = room_from_team.inverse();
        // Of the team's component, whose frame is compared with the truth.
        let joint = map.joint_covariance_of(0).unwrap_or_else(|| DMatrix::zeros(0, 0));
        let mut errors = MapErrors {
            time_s: truth.time_s,
            robots: self.robots(truth, map, team_from_room, &joint, sampled),
            targets: Vec::new(),
            missed: Vec::new(),
            unmatched: Vec::new(),
            switched: Vec::new(),
        };
        self.targets(truth, map, room_from_team, &joint, sampled, &mut errors);
        Some(errors)
    }

    /// `room_from_team` once it is known: for drawing truth beside the map.
    pub fn room_from_team(&self) -> Option<Pose2> {
        self.room_from_team
    }

    fn align(&mut self, truth: &Truth, map: &TeamMap) {
        if self.room_from_team.is_some() {
            return;
        }
        let Some(gauge) = map.gauge else { return };
        let estimate = map.robots.iter().find(|r| r.id == gauge).and_then(|r| r.team_from_body);
        let actual = truth.robots.iter().find(|r| r.id == gauge).map(|r| r.room_from_body);
        if let (Some(team_from_body), Some(room_from_body)) = (estimate, actual) {
            self.room_from_team = Some(room_from_body * team_from_body.inverse());
        }
    }

    fn robots(
        &mut self,
        truth: &Truth,
        map: &TeamMap,
        team_from_room: Pose2,
        joint: &DMatrix<f64>,
        sampled: bool,
    ) -> Vec<RobotError> {
        let mut errors = Vec::new();
        let mut joint_error = Vec::new();
        let mut entries = Vec::new();
        let with_pose = map.placed(0).filter_map(|r| r.team_from_body.map(|pose| (r, pose)));
        for (index, (robot, pose)) in with_pose.enumerate() {
            let Some(actual) = truth.robots.iter().find(|t| t.id == robot.id) else { continue };
            let expected = team_from_room * actual.room_from_body;
            let apart = pose.position() - expected.position();
            let turned = difference(pose.heading_rad, expected.heading_rad);
            self.sums.placed[0] += 1;
            let at = 3 * index;
            let variance = |k: usize| joint.get((at + k, at + k)).copied().unwrap_or(0.0);
            let free = (0..3).any(|k| variance(k) > NO_VARIANCE);
            if map.gauge != Some(robot.id) || actual.drives {
                let (squares, heading2) = (apart.norm_squared(), turned.to_degrees().powi(2));
                let add = |sums: &mut [Rms; 2]| {
                    sums[0].add_square(squares);
                    sums[1].add_square(heading2);
                };
                if actual.drives {
                    add(&mut self.sums.driving);
                    if actual.moving {
                        add(&mut self.sums.driving_now);
                    }
                } else {
                    add(&mut self.sums.standing);
                }
            }
            let error = [apart.x, apart.y, turned];
            if free {
                joint_error.extend(error);
                entries.extend([at, at + 1, at + 2]);
            }
            let own = DMatrix::from_fn(3, 3, |r, c| joint.get((at + r, at + c)).copied().unwrap_or(0.0));
            errors.push(RobotError {
                id: robot.id,
                error_m: [apart.x, apart.y],
                heading_error_deg: turned.to_degrees(),
                sigma: [0, 1, 2].map(|k| variance(k).max(0.0).sqrt()),
                nees: if free { mahalanobis2(&DVector::from_row_slice(&error), &own).map(|d| d / 3.0) } else { None },
            });
        }
        self.sums.placed[1] += truth.robots.len();
        if sampled && !entries.is_empty() && entries.iter().all(|&e| e < joint.nrows()) {
            let covariance = DMatrix::from_fn(entries.len(), entries.len(), |r, c| joint[(entries[r], entries[c])]);
            if let Some(sample) = mahalanobis2(&DVector::from_vec(joint_error), &covariance) {
                self.sums.robot_nees.add(sample, entries.len());
            }
        }
        errors
    }

    fn targets(
        &mut self,
        truth: &Truth,
        map: &TeamMap,
        room_from_team: Pose2,
        joint: &DMatrix<f64>,
        sampled: bool,
        errors: &mut MapErrors,
    ) {
        let in_frame: Vec<&MapTarget> = map.targets.iter().filter(|t| t.component == 0).collect();
        let places: Vec<Vector2<f64>> =
            in_frame.iter().map(|t| room_from_team.transform(Vector2::new(t.position_m[0], t.position_m[1]))).collect();
        let ids: Vec<TargetId> = in_frame.iter().map(|t| t.id).collect();
        let distance = |person: &PersonTruth, place: &Vector2<f64>| (place - Vector2::from(person.position_m)).norm();
        let distances: Vec<Vec<f64>> =
            truth.people.iter().map(|person| places.iter().map(|place| distance(person, place)).collect()).collect();

        let matched = assign(&distances, GATE_M);
        self.sums.gospa_m.push(gospa_m(&distances, places.len()));
        for person in self.identity.add(&distances, &ids, GATE_M) {
            errors.switched.push(truth.people[person].id.clone());
        }
        for (index, id) in ids.iter().enumerate() {
            let life = self.lives.entry(*id).or_default();
            life.1 += 1;
            if matched.contains(&Some(index)) {
                life.0 += 1;
            } else {
                errors.unmatched.push((*id, places[index].into()));
            }
        }
        for ((person, row), column) in truth.people.iter().zip(&distances).zip(&matched) {
            if person.coverable {
                self.sums.covered[1] += 1;
                self.sums.covered[0] += usize::from(column.is_some());
            }
            let Some(column) = *column else {
                if person.coverable {
                    errors.missed.push(person.id.clone());
                }
                continue;
            };
            let square = row[column] * row[column];
            self.sums.targets.add_square(square);
            if second_nearest_m(person, &truth.robots) <= NEAR_M {
                self.sums.near_targets.add_square(square);
            }
            let target = in_frame[column];
            let covariance = target.covariance(joint).unwrap_or_default().fixed_view::<2, 2>(0, 0).into_owned();
            let apart = room_from_team.rotation().transpose() * (places[column] - Vector2::from(person.position_m));
            let sample = mahalanobis2(
                &DVector::from_row_slice(apart.as_slice()),
                &DMatrix::from_column_slice(2, 2, covariance.as_slice()),
            );
            if let (true, Some(sample)) = (sampled, sample) {
                self.sums.target_nees.add(sample, 2);
            }
            errors.targets.push(TargetError {
                person: person.id.clone(),
                target: target.id,
                error_m: apart.into(),
                sigma_m: [covariance[(0, 0)].max(0.0).sqrt(), covariance[(1, 1)].max(0.0).sqrt()],
                nees: sample.map(|d| d / 2.0),
                observers: target.observers.len(),
                age_s: target.age_s,
            });
        }
    }
}

/// GOSPA with p = 2, c = [`GOSPA_CUT_M`], α = 2 of one instant, not averaged over its members: pairs count with their squared
/// distance, everybody left alone with c²/2.
fn gospa_m(distances_m: &[Vec<f64>], targets: usize) -> f64 {
    let pairs = assign(distances_m, GOSPA_CUT_M);
    let near: f64 = pairs.iter().zip(distances_m).filter_map(|(c, row)| c.map(|c| row[c] * row[c])).sum();
    let alone = distances_m.len() + targets - 2 * pairs.iter().flatten().count();
    (near + alone as f64 * GOSPA_CUT_M * GOSPA_CUT_M / 2.0).sqrt()
}

fn second_nearest_m(person: &PersonTruth, robots: &[RobotTruth]) -> f64 {
    let at = Vector2::from(person.position_m);
    let mut distances: Vec<f64> = robots.iter().map(|r| (r.room_from_body.position() - at).norm()).collect();
    distances.sort_by(f64::total_cmp);
    distances.get(1).copied().unwrap_or(f64::INFINITY)
}

#[cfg(test)]
mod tests;
