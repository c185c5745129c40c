//! Offline: poses and targets from bearings in a file, jointly or by the report's closed forms.

pub mod closed_form;
pub mod input;
pub mod joint;
pub mod output;
pub mod pairing;
pub mod sequence;
pub mod start;
pub mod terms;
mod words;

use nalgebra::{DMatrix, Matrix3, Vector2};
use protocol::estimate::{SolveStatus, chi2_quantile};
use protocol::frames::Pose2;
use protocol::marker::Marker;
use protocol::message::MapStatus;

use input::{Part, Problem};
use joint::{Joint, Layout, State};
use output::{Solution, SolvedRobot, SolvedTarget, UNKNOWN_VAR};
use terms::{Kind, Other, Term};

/// A fit worse than this has a cause.
const INCONSISTENT_P: f64 = 0.9999;
/// Places at which a robot without a start is tried.
const TRIES: usize = 96;
/// Two fits as good as each other (difference of χ²) at different places are both answers.
const EQUAL_CHI2: f64 = 6.0;

/// Why a file cannot be solved.
#[derive(Debug, thiserror::Error)]
pub enum SolveError {
    /// Not the format.
    #[error("{0}; see DESIGN §6 for the format")]
    Json(serde_json::Error),
    /// Something is not there.
    #[error("`{0}` is empty; at least one would be right")]
    Missing(&'static str),
    /// Named, but not among the robots.
    #[error("{place}: {id:?} is not among `robots`")]
    UnknownRobot {
        /// Which key.
        place: String,
        /// What it says.
        id: String,
    },
    /// One name for two things.
    #[error("the {what} {id:?} stands there twice")]
    Twice {
        /// What.
        what: &'static str,
        /// Which.
        id: String,
    },
    /// A value that cannot be.
    #[error("{place} is {value}; {right} would be right")]
    Value {
        /// Which key.
        place: String,
        /// What it says.
        value: String,
        /// What would be right.
        right: &'static str,
    },
    /// A line of a sequence.
    #[error("line {line}: {source}")]
    Line {
        /// Counted from 1.
        line: usize,
        /// What is wrong with it.
        source: Box<SolveError>,
    },
}

/// Solves jointly. Never fails: the status says what became of it.
pub fn solve(mut problem: Problem) -> Solution {
    let naming = start::name_sightings(&mut problem);
    let held = held_poses(&problem);
    let unsolved = |problem: &Problem| {
        let (status, why) = if naming == MapStatus::Ambiguous {
            (SolveStatus::Ambiguous, "several ways of naming the sightings fit equally")
        } else {
            (SolveStatus::Insufficient, "nothing ties the robots together")
        };
        nothing(status, why, problem, &held)
    };
    let Some(robots) = Stage::robots(&problem, &held) else { return unsolved(&problem) };
    let sigmas: Vec<(f64, f64)> = (0..problem.robots.len()).map(|r| robots.sigma(r)).collect();
    let poses = robots.joint.state.poses.clone();
    let left_open = problem.bearings.iter().any(|b| b.target.is_none()) && pairing::pair(&mut problem, &poses, &sigmas);
    let full = Stage::all(&problem, &held, &robots.placed, &poses);
    let Some(full) = full else { return unsolved(&problem) };
    full.conclude(&problem, naming == MapStatus::Ambiguous, left_open)
}

/// Poses that are given: by the file, or the anchor's where nothing else fixes the frame.
fn held_poses(problem: &Problem) -> Vec<Option<Pose2>> {
    let mut held: Vec<Option<Pose2>> = problem.robots.iter().map(|r| r.pose).collect();
    let seen = |t: usize| problem.bearings.iter().any(|b| b.target == Some(t));
    let landmarks = problem.landmarks.iter().filter(|l| seen(l.target)).count();
    if held.iter().all(Option::is_none) && landmarks < 2 {
        held[problem.anchor] = Some(Pose2::IDENTITY);
    }
    held
}

/// One joint solution and what it was of.
struct Stage {
    joint: Joint,
    layout: Layout,
    terms: Vec<Term>,
    /// Robots that take part.
    placed: Vec<bool>,
    /// Targets that take part.
    located: Vec<bool>,
    /// Another place fits as well.
    twofold: bool,
}

impl Stage {
    /// The robots alone, with everything that is named.
    fn robots(problem: &Problem, held: &[Option<Pose2>]) -> Option<Self> {
        let tree = start::tree(problem, held);
        let n = problem.robots.len();
        let reached: Vec<bool> = tree.iter().map(Option::is_some).collect();
        let touched = |r: usize| {
            problem.sightings.iter().any(|s| s.peer.is_some() && (s.observer == r || s.peer == Some(r)))
                || problem.bearings.iter().any(|b| b.observer == r && b.target.is_some())
        };
        let placed: Vec<bool> = (0..n).map(|r| reached[r] || touched(r)).collect();
        if placed.iter().filter(|p| **p).count() < 2 && problem.landmarks.is_empty() {
            return None;
        }
        let known: Vec<Vector2<f64>> = tree
            .iter()
            .flatten()
            .map(Pose2::position)
            .chain(problem.landmarks.iter().map(|l| Vector2::new(l.position_m[0], l.position_m[1])))
            .collect();
        let missing: Vec<usize> = (0..n).filter(|&r| placed[r] && !reached[r]).collect();
        let tries = if missing.is_empty() { 1 } else { TRIES };
        let mut fits: Vec<Self> = Vec::new();
        for k in 0..tries {
            let mut poses: Vec<[f64; 3]> = tree.iter().map(|p| array(&p.unwrap_or_default())).collect();
            for (salt, &r) in missing.iter().enumerate() {
                let places = start::lattice(&known, TRIES, salt);
                poses[r] = array(&places[k]);
            }
            fits.extend(Self::fit(problem, held, &placed, &poses));
        }
        fits.sort_by(|a, b| a.joint.chi2.total_cmp(&b.joint.chi2));
        let limit = fits.first()?.joint.chi2 + EQUAL_CHI2;
        let rival = fits.iter().skip(1).take_while(|f| f.joint.chi2 < limit).any(|f| f.differs(&fits[0]));
        let mut best = fits.swap_remove(0);
        best.twofold = rival && best.joint.nullity == 0;
        Some(best)
    }

    /// Everything, from known robots.
    fn all(problem: &Problem, held: &[Option<Pose2>], placed: &[bool], poses: &[[f64; 3]]) -> Option<Self> {
        Self::fit(problem, held, placed, poses)
    }

    fn fit(problem: &Problem, held: &[Option<Pose2>], placed: &[bool], poses: &[[f64; 3]]) -> Option<Self> {
        let (terms, located) = terms_of(problem, placed);
        let m = problem.targets.len();
        let landmark = |t: usize| problem.landmarks.iter().find(|l| l.target == t);
        let free: Vec<bool> = (0..m).map(|t| located[t] && landmark(t).is_none()).collect();
        let heights: Vec<bool> = (0..m)
            .map(|t| {
                free[t] && terms.iter().any(|x| x.other == Other::Target(t) && matches!(x.kind, Kind::Elevation { .. }))
            })
            .collect();
        let layout = Layout::new(
            &(0..placed.len()).map(|r| held[r].is_some() || !placed[r]).collect::<Vec<_>>(),
            &free.iter().map(|f| !f).collect::<Vec<_>>(),
            &heights,
        );
        let mut state = State { poses: poses.to_vec(), points: vec![[0.0; 3]; m] };
        for l in &problem.landmarks {
            state.points[l.target] = [l.position_m[0], l.position_m[1], l.z_m.unwrap_or(0.0)];
        }
        start::place_targets(&mut state, &terms, &free);
        let joint = joint::solve(&terms, &layout, state);
        joint.chi2.is_finite().then(|| Self { joint, layout, terms, placed: placed.to_vec(), located, twofold: false })
    }

    fn differs(&self, other: &Self) -> bool {
        let (a, b) = (&self.joint.state.poses, &other.joint.state.poses);
        a.iter()
            .zip(b)
            .any(|(p, q)| (p[0] - q[0]).hypot(p[1] - q[1]) > 0.05 || protocol::angle::wrap(p[2] - q[2]).abs() > 0.02)
    }

    /// Standard deviations of position and heading.
    fn sigma(&self, robot: usize) -> (f64, f64) {
        let cov = self.robot_covariance(robot);
        ((cov[(0, 0)] + cov[(1, 1)]).sqrt(), cov[(2, 2)].sqrt())
    }

    fn robot_covariance(&self, robot: usize) -> Matrix3<f64> {
        let column = self.layout.robots[robot];
        column.map_or_else(Matrix3::zeros, |c| self.joint.covariance.fixed_view::<3, 3>(c, c).into_owned())
    }

    fn target_covariance(&self, target: usize) -> Matrix3<f64> {
        let mut cov = Matrix3::zeros();
        let Some(c) = self.layout.targets[target] else { return cov };
        let columns: Vec<usize> = [Some(c), Some(c + 1), self.layout.heights[target]].into_iter().flatten().collect();
        let part: DMatrix<f64> = self.joint.covariance.select_rows(&columns).select_columns(&columns);
        cov.view_mut((0, 0), part.shape()).copy_from(&part);
        if columns.len() == 2 {
            cov[(2, 2)] = UNKNOWN_VAR;
        }
        cov
    }

    fn conclude(self, problem: &Problem, namesakes: bool, left_open: bool) -> Solution {
        let joint = &self.joint;
        let determined = joint.nullity == 0;
        let missing: Vec<&str> =
            problem.robots.iter().zip(&self.placed).filter(|(_, p)| !**p).map(|(r, _)| r.id.as_str()).collect();
        let (status, explanation) = if namesakes {
            (SolveStatus::Ambiguous, "several ways of naming the sightings fit equally".to_owned())
        } else if !missing.is_empty() || self.terms.len() < self.layout.unknowns {
            let who = if missing.is_empty() { "some directions".to_owned() } else { missing.join(", ") };
            (SolveStatus::Insufficient, format!("too few measurements for {who}"))
        } else if !determined {
            (SolveStatus::Degenerate, format!("{} directions are not determined", joint.nullity))
        } else if !joint.converged {
            (SolveStatus::NotConverged, "the iteration did not end".to_owned())
        } else if self.twofold {
            (SolveStatus::Ambiguous, "another layout fits equally well".to_owned())
        } else if joint.dof > 0 && joint.chi2 > chi2_quantile(INCONSISTENT_P, joint.dof) {
            (SolveStatus::Inconsistent, words::worst(&self.terms, &joint.state, problem))
        } else if left_open {
            (SolveStatus::Ambiguous, "some bearings could be of several targets: they are left out".to_owned())
        } else {
            (SolveStatus::Converged, "a minimum that fits".to_owned())
        };
        let robots = problem.robots.iter().enumerate().filter(|(r, _)| self.placed[*r]).map(|(r, robot)| {
            let [x_m, y_m, heading] = joint.state.poses[r];
            SolvedRobot {
                id: robot.id.clone(),
                x_m,
                y_m,
                heading_deg: protocol::angle::wrap(heading).to_degrees(),
                covariance: determined.then(|| rows(&self.robot_covariance(r))),
            }
        });
        let landmark = |t: usize| problem.landmarks.iter().find(|l| l.target == t);
        let targets = problem.targets.iter().enumerate().filter(|(t, _)| self.located[*t] && landmark(*t).is_none());
        let targets = targets.map(|(t, id)| {
            let [x_m, y_m, z_m] = joint.state.points[t];
            SolvedTarget {
                id: id.clone(),
                x_m,
                y_m,
                z_m: self.layout.heights[t].map(|_| z_m),
                covariance: determined.then(|| rows(&self.target_covariance(t))),
                observers: observers(problem, t),
            }
        });
        let weakest_direction = words::weakest(joint, &self.layout, problem);
        Solution {
            status,
            explanation,
            robots: robots.collect(),
            targets: targets.collect(),
            chi2: joint.chi2,
            dof: joint.dof,
            weakest_direction,
        }
    }
}

/// Who has a bearing of the target.
fn observers(problem: &Problem, target: usize) -> Vec<String> {
    let mut ids: Vec<String> = Vec::new();
    for b in problem.bearings.iter().filter(|b| b.target == Some(target)) {
        let id = &problem.robots[b.observer].id;
        if !ids.contains(id) {
            ids.push(id.clone());
        }
    }
    ids
}

/// All measurements between things that take part, and which targets do.
fn terms_of(problem: &Problem, placed: &[bool]) -> (Vec<Term>, Vec<bool>) {
    let mut terms = Vec::new();
    for s in &problem.sightings {
        let Some(peer) = s.peer.filter(|p| placed[*p] && placed[s.observer]) else { continue };
        sighting_terms(problem, s, peer, &mut terms);
    }
    let mut located = vec![false; problem.targets.len()];
    for (t, target) in located.iter_mut().enumerate() {
        let mine = problem.bearings.iter().filter(|b| b.target == Some(t) && placed[b.observer]);
        let mut observers: Vec<usize> = mine.map(|b| b.observer).collect();
        observers.sort_unstable();
        observers.dedup();
        // A single ray places nothing, unless it is a landmark's.
        *target = observers.len() >= 2 || (!observers.is_empty() && problem.landmarks.iter().any(|l| l.target == t));
    }
    for b in &problem.bearings {
        let Some(t) = b.target.filter(|t| located[*t] && placed[b.observer]) else { continue };
        let term =
            |kind, (measured, sigma)| Term { observer: b.observer, other: Other::Target(t), kind, measured, sigma };
        terms.push(term(Kind::Bearing, b.bearing));
        let flat = problem.landmarks.iter().any(|l| l.target == t && l.z_m.is_none());
        if let Some(elevation) = b.elevation.filter(|_| !flat) {
            terms.push(term(Kind::Elevation { camera_m: problem.robots[b.observer].camera_height_m }, elevation));
        }
    }
    (terms, located)
}

/// The features are the measurement where there are any; else bearing, range, heading.
fn sighting_terms(problem: &Problem, s: &input::Sighting, peer: usize, terms: &mut Vec<Term>) {
    let camera_m = problem.robots[s.observer].camera_height_m;
    let mut push = |kind, measured, sigma| {
        terms.push(Term { observer: s.observer, other: Other::Robot(peer), kind, measured, sigma });
    };
    if s.features.is_empty() {
        for (kind, value) in [(Kind::Bearing, s.bearing), (Kind::Range, s.range)] {
            if let Some((measured, sigma)) = value {
                push(kind, measured, sigma);
            }
        }
    }
    if let Some((measured, sigma)) = s.heading {
        push(Kind::Heading, measured, sigma);
    }
    for f in &s.features {
        let ends = |make: &dyn Fn(f64) -> Kind, heights: [f64; 2], push: &mut dyn FnMut(Kind, f64, f64)| {
            for (z_m, measured) in heights.into_iter().zip(f.elevation_rad.into_iter().flatten()) {
                push(make(z_m), measured, f.sigma_rad);
            }
        };
        match (&problem.robots[peer].marker, f.part) {
            (
                Marker::Cylinder { radius_m, height_m, .. } | Marker::Bars { radius_m, height_m, .. },
                Part::Left | Part::Right,
            ) => {
                let radius_m = *radius_m;
                let side = if f.part == Part::Left { 1.0 } else { -1.0 };
                push(Kind::Tangent { radius_m, side }, f.bearing_rad, f.sigma_rad);
                ends(&|z_m| Kind::RingElevation { radius_m, z_m, camera_m }, *height_m, &mut push);
            }
            (Marker::Bars { radius_m, azimuths_deg, height_m, .. }, Part::Bar(n)) => {
                let Some(azimuth) = azimuths_deg.get(n) else { continue };
                let (sin, cos) = azimuth.to_radians().sin_cos();
                let at_m = [radius_m * cos, radius_m * sin];
                push(Kind::BodyPoint { at_m }, f.bearing_rad, f.sigma_rad);
                ends(&|z_m| Kind::BodyPointElevation { at_m, z_m, camera_m }, *height_m, &mut push);
            }
            (marker @ Marker::Rectangle { height_m, bottom_m, .. }, Part::Edge(n)) => {
                let Some(edge) = marker.edge_points().and_then(|edges| edges.get(n).copied()) else { continue };
                let at_m = [edge.x, edge.y];
                push(Kind::BodyPoint { at_m }, f.bearing_rad, f.sigma_rad);
                let heights = [*bottom_m, bottom_m + height_m];
                ends(&|z_m| Kind::BodyPointElevation { at_m, z_m, camera_m }, heights, &mut push);
            }
            _ => {}
        }
    }
}

fn nothing(status: SolveStatus, why: &str, problem: &Problem, held: &[Option<Pose2>]) -> Solution {
    let robots = problem.robots.iter().zip(held).filter_map(|(robot, pose)| {
        let pose = (*pose)?;
        Some(SolvedRobot {
            id: robot.id.clone(),
            x_m: pose.x_m,
            y_m: pose.y_m,
            heading_deg: pose.heading_rad.to_degrees(),
            covariance: Some([[0.0; 3]; 3]),
        })
    });
    Solution {
        status,
        explanation: why.to_owned(),
        robots: robots.collect(),
        targets: Vec::new(),
        chi2: 0.0,
        dof: 0,
        weakest_direction: "everything: too few measurements".to_owned(),
    }
}

fn array(pose: &Pose2) -> [f64; 3] {
    [pose.x_m, pose.y_m, pose.heading_rad]
}

fn rows(m: &Matrix3<f64>) -> [[f64; 3]; 3] {
    [0, 1, 2].map(|r| [m[(r, 0)], m[(r, 1)], m[(r, 2)]])
}

#[cfg(test)]
mod tests;
