//! Where robots should stand for a better view of the targets there are, said while the team runs.
//!
//! The present targets are where targets have been in the last seconds. In turn, for each standing robot, a grid of places
//! round it is tried, a few places a message, so that no step takes long: what would the map's error be if this robot stood
//! there, the others as they are ([`crate::planning::outlook`])? After a round the robot that gains most is told, if that is
//! worth the way; the others wait, since their best places depend on it. A goal once given is kept while it is nearly the
//! best, and nobody is told twice within the configured interval.

use std::collections::VecDeque;

use nalgebra::{DMatrix, Vector2};
use protocol::frames::Pose2;
use protocol::message::{Guidance, TrackObservation, TrackState};
use protocol::time::Timestamp;

use super::{Leader, Output};
use crate::calibration::block::Block;
use crate::correspondence::ObservedBy;
use crate::planning::outlook::{Outlook, Post, joint};

/// Places along each side of the grid, and of the finer one round its best.
const GRID: i32 = 15;
const FINE: i32 = 5;
/// Work on one message: places times targets' places times robots.
const WORK: usize = 250;
/// Targets' places are kept so long, seconds, so far apart in time, and so many.
const KEPT_S: f64 = 20.0;
const SAMPLE_S: f64 = 1.0;
const MAX_SAMPLES: usize = 60;
/// Used in a plan at most.
const MAX_PLACES: usize = 16;
/// From other robots and from where targets were, metres.
const APART_M: f64 = 0.7;
const FROM_TARGETS_M: f64 = 0.5;
/// From upright edges of furniture and walls that begin below a robot's top, metres.
const FROM_EDGES_M: f64 = 0.35;
const ROBOT_TOP_M: f64 = 0.8;
/// A goal given before is kept while no other is better by this factor.
const BETTER: f64 = 0.93;
/// A robot that stands within this of where it stood has not gone anywhere, metres.
const SAME_M: f64 = 0.2;
/// A robot's rate follows within so many frames.
const RATE_MEMORY: f64 = 100.0;

/// The planner's state, of a component.
#[derive(Debug, Default)]
pub struct Guide {
    samples: VecDeque<(Timestamp, Vector2<f64>)>,
    last_sample: Option<Timestamp>,
    round: Option<Round>,
    /// Goals given: robot, where it stood, where to.
    goal: Option<(usize, Pose2, Pose2)>,
    last_told: Option<Timestamp>,
}

/// One look at all robots.
#[derive(Debug)]
struct Round {
    robots: Vec<usize>,
    posts: Vec<Post>,
    places: Vec<Vector2<f64>>,
    outlook: Outlook,
    here_m2: f64,
    /// Number in `robots` of whom it is about, the others' calibration without it, places to try, the best of them.
    turn: usize,
    rest: Option<Block>,
    trials: Vec<Vector2<f64>>,
    fine: bool,
    best: Option<(f64, Vector2<f64>)>,
    /// Best of each robot so far.
    found: Vec<(f64, usize, Vector2<f64>)>,
}

impl Leader {
    /// Goes on with planning by one message of work.
    pub(super) fn guide(&mut self, home: usize, now: Timestamp, outputs: &mut Vec<Output>) {
        if !self.config.guidance.enabled {
            return;
        }
        self.sample(home, now);
        if self.components[home].guide.round.is_none() {
            let config = &self.config.guidance;
            let wait = self.components[home].guide.last_told.is_some_and(|t| now.seconds_since(t) < config.interval_s);
            if wait || self.somebody_moves(home) || !self.begin_round(home) {
                return;
            }
        }
        if self.somebody_moves(home) {
            self.components[home].guide.round = None;
            return;
        }
        self.go_on(home, now, outputs);
    }

    /// What a robot's frame says of its bearings of targets.
    pub(super) fn note_bearings(&mut self, robot: usize, tracks: &[TrackObservation], since_s: Option<f64>) {
        let home = self.home(robot);
        let Some(eye) = home.calibrator.station(robot).map(|pose| pose.position()) else { return };
        let seen = |track: &TrackObservation| {
            let is_it = |o: &ObservedBy| o.robot == robot && o.track == track.track;
            let followed = home.follower.targets().iter().find(|f| f.state.observers.iter().any(is_it))?;
            Some(((followed.state.target.position() - eye).norm(), track.bearing_sigma.value()))
        };
        let seen: Vec<_> = tracks.iter().filter(|t| t.state == TrackState::Visible).filter_map(seen).collect();
        let (line, rate_hz) = &mut self.members[robot].bearings;
        seen.into_iter().for_each(|(range_m, sigma_rad)| line.note(range_m, sigma_rad));
        if let Some(since_s) = since_s.filter(|s| *s > 1e-3) {
            *rate_hz += if *rate_hz == 0.0 { 1.0 / since_s } else { (1.0 / since_s - *rate_hz) / RATE_MEMORY };
        }
    }

    fn sample(&mut self, home: usize, now: Timestamp) {
        if self.components[home].guide.last_sample.is_some_and(|t| now.seconds_since(t) < SAMPLE_S) {
            return;
        }
        self.components[home].guide.last_sample = Some(now);
        let component = &mut self.components[home];
        let people: Vec<_> = component.confirmed().map(|followed| followed.state.target.position()).collect();
        let samples = &mut component.guide.samples;
        for position in people {
            if samples.len() >= MAX_SAMPLES {
                samples.pop_front();
            }
            samples.push_back((now, position));
        }
        samples.retain(|(at, _)| now.seconds_since(*at) < KEPT_S);
    }

    fn somebody_moves(&self, home: usize) -> bool {
        self.robots_of(home).any(|r| self.members[r].alive && self.components[home].calibrator.moves(r))
    }

    fn begin_round(&mut self, home: usize) -> bool {
        let stations: Vec<(usize, Pose2)> = self.components[home].calibrator.stations().collect();
        let guide = &self.components[home].guide;
        if stations.len() < 2 || guide.samples.is_empty() {
            return false;
        }
        let robots: Vec<usize> = stations.iter().map(|(r, _)| *r).collect();
        let post = |&(robot, pose): &(usize, Pose2)| {
            let (line, rate_hz) = Some(self.members[robot].bearings).filter(|(_, rate_hz)| *rate_hz > 0.0)?;
            let radius_m = self.members[robot].radius_m().unwrap_or(0.25);
            Some(Post { pose, radius_m, blur: line.blur()?, rate_hz })
        };
        let Some(posts) = stations.iter().map(post).collect::<Option<Vec<_>>>() else { return false };
        // Evenly over the time that is kept.
        let stride = guide.samples.len().div_ceil(MAX_PLACES);
        let places: Vec<_> = guide.samples.iter().step_by(stride).map(|(_, p)| *p).collect();
        let poses = joint(&robots, |a, b| self.components[home].calibrator.covariance(a, b));
        let rate_hz = posts.iter().map(|post| post.rate_hz).fold(0.0, f64::max);
        let outlook = Outlook::new(&self.config.targets, rate_hz);
        let Some(here_m2) = outlook.mean_square_m2(&posts, &poses, &places) else { return false };
        self.components[home].guide.round = Some(Round {
            robots,
            posts,
            places,
            outlook,
            here_m2,
            turn: 0,
            rest: None,
            trials: Vec::new(),
            fine: false,
            best: None,
            found: Vec::new(),
        });
        true
    }

    fn go_on(&mut self, home: usize, now: Timestamp, outputs: &mut Vec<Output>) {
        let Some(mut round) = self.components[home].guide.round.take() else { return };
        let mut work = WORK / self.thrift();
        while round.turn < round.robots.len() {
            if round.rest.is_none() {
                self.begin_turn(home, &mut round);
            }
            while let Some(trial) = round.trials.pop() {
                let Some(rest) = &round.rest else { break };
                if let Some(value) = self.expected(home, &round, round.turn, rest, trial)
                    && round.best.is_none_or(|(least, _)| value < least)
                {
                    round.best = Some((value, trial));
                }
                work = work.saturating_sub(round.places.len() * round.posts.len());
                if work == 0 {
                    self.components[home].guide.round = Some(round);
                    return;
                }
            }
            match (round.best, round.fine) {
                (Some((_, place)), false) => {
                    round.fine = true;
                    let step = 2.0 * self.config.guidance.reach_m / f64::from(GRID - 1) / f64::from(FINE);
                    round.trials = grid(place, FINE, step);
                }
                (best, _) => {
                    round.found.extend(best.map(|(value, place)| (value, round.turn, place)));
                    (round.turn, round.rest, round.fine, round.best) = (round.turn + 1, None, false, None);
                }
            }
        }
        self.conclude(home, now, &round, outputs);
    }

    /// The robots without the one whose turn it is, and places for it.
    fn begin_turn(&self, home: usize, round: &mut Round) {
        let robot = round.robots[round.turn];
        round.rest = Some(self.components[home].calibrator.without(robot));
        if !self.may_be_sent(robot) {
            round.trials.clear();
            round.fine = true;
            return;
        }
        let reach_m = self.config.guidance.reach_m;
        let mut trials = grid(round.posts[round.turn].pose.position(), GRID, 2.0 * reach_m / f64::from(GRID - 1));
        if let Some((_, _, goal)) =
            self.components[home].guide.goal.filter(|(r, stood, _)| *r == robot && same(stood, round, robot))
        {
            trials.push(goal.position());
        }
        round.trials = trials;
    }

    fn may_be_sent(&self, robot: usize) -> bool {
        let (id, config) = (self.members[robot].id, &self.config);
        let named = config.guidance.robots.is_empty() || config.guidance.robots.contains(&id);
        named && config.fixed.iter().all(|f| f.robot != id)
    }

    /// Expected mean square error if the robot of a turn stood at `place`, beside the `rest`; `None` where it may not.
    fn expected(&self, home: usize, round: &Round, turn: usize, rest: &Block, place: Vector2<f64>) -> Option<f64> {
        let robot = round.robots[turn];
        let apart = |p: Vector2<f64>, least: f64| (p - place).norm() >= least;
        let others = || round.posts.iter().enumerate().filter(|(k, _)| *k != turn).map(|(_, p)| p);
        let free = others().all(|p| apart(p.pose.position(), APART_M))
            && round.places.iter().all(|p| apart(*p, FROM_TARGETS_M))
            && self.components[home]
                .structure
                .landmarks()
                .iter()
                .all(|edge| edge.extent_m[0] > ROBOT_TOP_M || apart(edge.position, FROM_EDGES_M))
            && self.is_known_ground(round, place);
        if !free {
            return None;
        }
        let mut posts = round.posts.clone();
        posts[turn].pose = Pose2::new(place.x, place.y, posts[turn].pose.heading_rad);
        let block = self.components[home].calibrator.with_elsewhere(rest, robot, posts[turn].pose)?;
        let poses: DMatrix<f64> = joint(&round.robots, |a, b| block.covariance(a, b).unwrap_or_default());
        round.outlook.mean_square_m2(&posts, &poses, &round.places)
    }

    /// Where the ground is known: in the given area, else among the robots and where targets have been.
    fn is_known_ground(&self, round: &Round, place: Vector2<f64>) -> bool {
        let bounds = self.config.guidance.area_m.unwrap_or_else(|| {
            let points = || round.posts.iter().map(|p| p.pose.position()).chain(round.places.iter().copied());
            [0, 1].map(|k| {
                let range = points().map(|p| p[k]);
                [range.clone().fold(f64::MAX, f64::min), range.fold(f64::MIN, f64::max)]
            })
        });
        (0..2).all(|k| (bounds[k][0]..=bounds[k][1]).contains(&place[k]))
    }

    /// The robot that gains most is told.
    fn conclude(&mut self, home: usize, now: Timestamp, round: &Round, outputs: &mut Vec<Output>) {
        self.components[home].guide.last_told = Some(now);
        let Some(&(value, turn, place)) = round.found.iter().min_by(|a, b| a.0.total_cmp(&b.0)) else { return };
        let stood = round.posts[turn].pose;
        let mut best = (value, round.robots[turn], stood, Pose2::new(place.x, place.y, stood.heading_rad));
        // Who has been told goes on being told the same while that is nearly the best.
        let told = self.components[home].guide.goal.take().filter(|(robot, stood, _)| same(stood, round, *robot));
        if let Some((robot, stood, goal)) = told
            && let Some(turn) = round.robots.iter().position(|r| *r == robot)
            && let Some(value) =
                self.expected(home, round, turn, &self.components[home].calibrator.without(robot), goal.position())
            && BETTER * value < best.0
        {
            best = (value, robot, stood, goal);
        }
        let (value, robot, stood, goal) = best;
        let (here_m, there_m) = (round.here_m2.sqrt(), value.sqrt());
        if there_m <= self.config.guidance.worth * here_m {
            self.components[home].guide.goal = Some((robot, stood, goal));
            outputs.push(Output::Guidance(Guidance {
                robot: self.members[robot].id,
                at: now,
                team_from_goal: goal,
                error_here_m: here_m,
                error_there_m: there_m,
                term: self.succession.reign().unwrap_or_else(|| self.succession.highest()),
            }));
        }
    }
}

/// Whether the robot still stands where it stood.
fn same(stood: &Pose2, round: &Round, robot: usize) -> bool {
    let post = round.robots.iter().position(|r| *r == robot).map(|k| round.posts[k].pose);
    post.is_some_and(|p| (p.position() - stood.position()).norm() < SAME_M)
}

fn grid(around: Vector2<f64>, side: i32, step_m: f64) -> Vec<Vector2<f64>> {
    let half = side / 2;
    let line = || (-half..=half).map(f64::from);
    line().flat_map(|i| line().map(move |j| around + step_m * Vector2::new(i, j))).collect()
}
