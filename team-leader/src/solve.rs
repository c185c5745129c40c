//! Offline: poses and targets from bearings in a file, jointly or by the report's closed forms.

pub mod bars;
pub mod closed_form;
mod conclusion;
pub mod explain;
mod fitting;
pub mod input;
pub mod joint;
pub mod layout;
pub mod matching;
mod measurements;
pub mod observability;
pub mod output;
pub mod pairing;
mod pairs;
pub mod resection;
pub mod robust;
pub mod sequence;
pub mod start;
pub mod terms;
mod words;

use std::borrow::Cow;

use nalgebra::Vector2;
use protocol::estimate::SolveStatus;
use protocol::frames::Pose2;
use protocol::message::MapStatus;

use input::Problem;
use joint::Joint;
use layout::{Layout, State, TARGET};
use measurements::terms_of;
use output::{Solution, SolvedRobot};
use robust::Loss;
use terms::{Kind, Other, Term};

/// Places at which a robot without a start is tried.
const TRIES: usize = 96;
/// Instants nearer than this to each other tell no velocity, seconds.
const LEAST_SPAN_S: f64 = 0.05;
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
        right: Cow<'static, str>,
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
pub fn solve(problem: Problem) -> Solution {
    solve_and(problem, |_, _| Vec::new())
}

/// Solves jointly, and explains where each target's error comes from.
pub fn solve_and_explain(problem: Problem) -> Solution {
    solve_and(problem, Stage::explain)
}

fn solve_and(mut problem: Problem, explain: impl Fn(&Stage, &Problem) -> Vec<explain::Explained>) -> Solution {
    let naming = start::name_sightings(&mut problem);
    let said = fitting::prepare(&mut problem);
    let mut solution = solve_named(problem, naming, explain);
    solution.warnings.splice(0..0, said);
    solution
}

fn solve_named(
    mut problem: Problem,
    naming: MapStatus,
    explain: impl Fn(&Stage, &Problem) -> Vec<explain::Explained>,
) -> Solution {
    problem.split_by_time();
    let held = held_poses(&problem);
    let unsolved = |problem: &Problem| {
        let (status, why) = if naming == MapStatus::Ambiguous {
            (SolveStatus::Ambiguous, "several ways of naming the sightings fit equally")
        } else {
            (SolveStatus::Insufficient, "nothing ties the robots together")
        };
        nothing(status, why, problem, &held)
    };
    let unnamed = problem.bearings.iter().any(|b| b.target.is_none());
    let Some(robots) = Stage::robots(&problem, &held) else { return unsolved(&problem) };
    if !unnamed {
        let explained = explain(&robots, &problem);
        return Solution { explained, ..robots.conclude(&problem, naming == MapStatus::Ambiguous, false) };
    }
    let sigmas: Vec<(f64, f64)> = (0..problem.robots.len()).map(|r| robots.sigma(r)).collect();
    let poses: Vec<[f64; 3]> = robots.joint.state.poses.iter().map(|p| [p[0], p[1], p[2]]).collect();
    let left_open = pairing::pair(&mut problem, &poses, &sigmas);
    let Some(full) = Stage::fit(&problem, &held, &robots.placed, &poses) else { return unsolved(&problem) };
    let explained = explain(&full, &problem);
    Solution { explained, ..full.conclude(&problem, naming == MapStatus::Ambiguous, left_open) }
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
    /// Sum of the losses of real bearings, to compare fits by.
    loss: f64,
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
                || problem.robots[r].moved.is_some()
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
        fits.sort_by(|a, b| a.loss.total_cmp(&b.loss));
        let limit = fits.first()?.loss + EQUAL_CHI2;
        let rival = fits.iter().skip(1).take_while(|f| f.loss < limit).any(|f| f.differs(&fits[0]));
        let mut best = fits.swap_remove(0);
        best.twofold = rival && best.joint.weakest.undetermined.is_empty();
        Some(best)
    }

    /// Everything, from poses to start with.
    fn fit(problem: &Problem, held: &[Option<Pose2>], placed: &[bool], poses: &[[f64; 3]]) -> Option<Self> {
        let (terms, located) = terms_of(problem, placed);
        let m = problem.targets.len();
        let mut free: Vec<[bool; TARGET]> = located.iter().map(|l| [*l, *l, false, false, false]).collect();
        let mut times: Vec<(f64, f64, usize)> = vec![(f64::INFINITY, f64::NEG_INFINITY, 0); m];
        for term in &terms {
            let Other::Target(t) = term.other else { continue };
            free[t][2] |= matches!(term.kind, Kind::Elevation { .. });
            if term.kind == Kind::Bearing {
                let (first, last, count) = &mut times[t];
                (*first, *last, *count) = (first.min(term.since_s), last.max(term.since_s), *count + 1);
            }
        }
        for (free, (first, last, count)) in free.iter_mut().zip(times) {
            // Four bearings at two instants give position and velocity.
            let moves = last - first > LEAST_SPAN_S && count >= 4;
            (free[3], free[4]) = (moves, moves);
        }
        let mut state = State {
            poses: poses.iter().map(|[x, y, h]| [*x, *y, *h, 0.0, 0.0]).collect(),
            points: vec![[0.0; TARGET]; m],
        };
        for l in &problem.landmarks {
            free[l.target] = [false; TARGET];
            state.points[l.target] = [l.position_m[0], l.position_m[1], l.z_m.unwrap_or(0.0), 0.0, 0.0];
        }
        let still: Vec<bool> = (0..placed.len()).map(|r| held[r].is_some() || !placed[r]).collect();
        let nuisances: Vec<_> =
            problem.robots.iter().zip(placed).map(|(r, p)| if *p { r.nuisance } else { Default::default() }).collect();
        let earlier: Vec<Option<usize>> = problem.robots.iter().map(|r| Some(r.moved.as_ref()?.from)).collect();
        let layout = Layout::with_places(&still, &nuisances, &earlier, &free);
        start::place_targets(&mut state, &terms, &free);
        let joint = joint::solve(&terms, &layout, state);
        let loss = joint::residuals(&terms, &joint.state).iter().map(|r| Loss::Tailed.of(*r).0).sum();
        let placed = placed.to_vec();
        joint.chi2.is_finite().then_some(Self { joint, layout, terms, placed, located, loss, twofold: false })
    }

    fn differs(&self, other: &Self) -> bool {
        let (a, b) = (&self.joint.state.poses, &other.joint.state.poses);
        a.iter()
            .zip(b)
            .any(|(p, q)| (p[0] - q[0]).hypot(p[1] - q[1]) > 0.05 || protocol::angle::wrap(p[2] - q[2]).abs() > 0.02)
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
            nuisance: Default::default(),
        })
    });
    Solution {
        robots: robots.collect(),
        weakest_direction: "everything: too few measurements".to_owned(),
        ..Solution::empty(status, why)
    }
}

fn array(pose: &Pose2) -> [f64; 3] {
    [pose.x_m, pose.y_m, pose.heading_rad]
}

#[cfg(test)]
mod tests;
