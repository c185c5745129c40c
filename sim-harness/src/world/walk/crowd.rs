//! What people do next: cross behind a robot, stop, meet somebody, stroll.

use nalgebra::Vector2;
use rand::{Rng, RngExt};
use rand_chacha::ChaCha12Rng;

use super::WARM_UP_S;
use crate::scenario::PeopleSpec;
use crate::world::floor::{Field, Grid};
use crate::world::robot::Robot;

/// Of a talk between two who meet.
const TALK_S: f64 = 3.0;
/// Longest wait for somebody to meet.
const PATIENCE_S: f64 = 8.0;
/// Who wants to walk and comes no further than this (m) in so long (s) is stuck, and does something else.
const STUCK: (f64, f64) = (0.3, 2.0);

/// Something to do.
#[derive(Debug, Clone, Copy)]
pub(super) enum Task {
    Go(Vector2<f64>),
    Stand(f64),
    /// Go there, wait for the partner, talk.
    Meet {
        at: Vector2<f64>,
        partner: usize,
    },
}

/// Somebody on the way.
pub(super) struct Walker {
    pub(super) position: Vector2<f64>,
    pub(super) velocity: Vector2<f64>,
    pub(super) heading: f64,
    pub(super) phase: f64,
    pub(super) speed: f64,
    pub(super) task: Task,
    pub(super) since_s: f64,
    pub(super) arrived_s: Option<f64>,
    /// Where it last came further, and when.
    progress: (Vector2<f64>, f64),
    pub(super) field: Field,
    /// Times from which one stop and meetings are due.
    stop_due_s: f64,
    meetings: Vec<(f64, usize, Vector2<f64>)>,
    crossings: Vec<[Vector2<f64>; 2]>,
    next_goal: Vec<Vector2<f64>>,
}

/// Everybody, and where they may walk.
pub(super) struct Crowd<'a> {
    pub(super) grid: &'a Grid,
    robots: &'a [Robot],
    pub(super) heights_m: &'a [f64],
    stop_s: f64,
    pub(super) standing: usize,
    pub(super) walkers: Vec<Walker>,
}

impl<'a> Crowd<'a> {
    /// Everybody at a free place with things to do.
    pub(super) fn new(
        spec: &PeopleSpec,
        heights_m: &'a [f64],
        robots: &'a [Robot],
        grid: &'a Grid,
        duration_s: f64,
        rng: &mut ChaCha12Rng,
    ) -> Option<Self> {
        let mut crowd =
            Self { grid, robots, heights_m, stop_s: spec.stop_s, standing: spec.standing.len(), walkers: Vec::new() };
        let count = heights_m.len();
        let behind: Vec<[Vector2<f64>; 2]> = crowd.behind(rng);
        for n in 0..count {
            let position = match spec.standing.get(n) {
                Some([x, y]) => Vector2::new(*x, *y),
                None => crowd.free_place(rng, 0.8)?,
            };
            let mut crossings: Vec<_> = (0..behind.len()).map(|i| behind[(i + n) % behind.len()]).collect();
            if rng.random_bool(0.5) {
                crossings.iter_mut().for_each(|c| c.swap(0, 1));
            }
            let share = (n as f64 + rng.random_range(0.2..0.8)) / count as f64;
            crowd.walkers.push(Walker {
                position,
                velocity: Vector2::zeros(),
                heading: rng.random_range(-3.0..3.0),
                phase: rng.random_range(0.0..6.0),
                speed: spec.speed_mps * rng.random_range(0.88..1.12),
                task: if n < crowd.standing { Task::Stand(f64::INFINITY) } else { Task::Stand(0.0) },
                since_s: -WARM_UP_S,
                arrived_s: None,
                progress: (position, -WARM_UP_S),
                field: grid.field(position),
                stop_due_s: 3.0 + share * (duration_s - spec.stop_s - 14.0).max(2.0),
                meetings: Vec::new(),
                crossings,
                next_goal: Vec::new(),
            });
        }
        for a in crowd.standing..count {
            let b = if a + 1 < count { a + 1 } else { crowd.standing };
            if a == b || (count - crowd.standing == 2 && a > b) {
                continue;
            }
            let place = crowd.free_place(rng, 0.5)?;
            let share = (a as f64 + rng.random_range(0.3..0.7)) / count as f64;
            let due = 6.0 + share * (duration_s - 12.0).max(0.0);
            let side = Vector2::new(0.38, 0.0);
            crowd.walkers[a].meetings.push((due, b, place - side));
            crowd.walkers[b].meetings.push((due, a, place + side));
        }
        Some(crowd)
    }

    /// Pairs of places on either side of each robot's bearing 180°, for each place where it stands.
    fn behind(&self, rng: &mut impl Rng) -> Vec<[Vector2<f64>; 2]> {
        let mut pairs = Vec::new();
        for robot in self.robots {
            let times = [-1e6, robot.drives.last().map_or(f64::NAN, |d| d.end_s)];
            for pose in times.iter().filter(|t| t.is_finite()).map(|t| robot.at(*t)) {
                let (sin, cos) = pose.heading_rad.sin_cos();
                let place = |x: f64, y: f64| Vector2::new(pose.x_m + cos * x - sin * y, pose.y_m + sin * x + cos * y);
                for _ in 0..40 {
                    let (d, w) = (rng.random_range(0.9..3.2), rng.random_range(0.5..1.0));
                    let pair = [place(-d, w), place(-d, -w)];
                    let middle = place(-d, 0.0);
                    if pair.iter().chain([&middle]).all(|p| self.grid.is_free(*p)) {
                        pairs.push(pair);
                        break;
                    }
                }
            }
        }
        pairs
    }

    /// A free place, at least `off` from the lines of sight between robots.
    fn free_place(&self, rng: &mut impl Rng, off: f64) -> Option<Vector2<f64>> {
        let half = self.grid.half();
        (0..2000).find_map(|attempt| {
            let p = Vector2::new(rng.random_range(-half.x..half.x), rng.random_range(-half.y..half.y));
            let off = if attempt < 1000 { off } else { 0.3 };
            let hides = self.robots.iter().enumerate().any(|(i, a)| {
                self.robots[..i].iter().any(|b| {
                    a.stations().iter().any(|a| b.stations().iter().any(|b| distance_to_segment(p, *a, *b) < off))
                })
            });
            let taken = self.walkers.iter().any(|w| (w.position - p).norm() < 1.0);
            (self.grid.is_free(p) && !hides && !taken).then_some(p)
        })
    }

    /// One time step for everybody.
    pub(super) fn step(&mut self, now_s: f64, rng: &mut ChaCha12Rng) {
        for n in 0..self.walkers.len() {
            if self.is_done(n, now_s) {
                self.choose(n, now_s, rng);
            }
        }
        let wishes: Vec<_> = (0..self.walkers.len()).map(|n| self.wish(n)).collect();
        for (n, wish) in wishes.into_iter().enumerate() {
            self.advance(n, wish);
        }
        self.keep_apart();
    }

    fn is_done(&mut self, n: usize, now_s: f64) -> bool {
        let w = &mut self.walkers[n];
        if (w.position - w.progress.0).norm() > STUCK.0 {
            w.progress = (w.position, now_s);
        }
        let w = &self.walkers[n];
        let there = |at: Vector2<f64>| (w.position - at).norm() < 0.18;
        let stuck = now_s - w.progress.1 > STUCK.1 && now_s - w.since_s > STUCK.1;
        match w.task {
            Task::Go(at) => there(at) || stuck || now_s - w.since_s > 25.0,
            Task::Stand(span) => now_s - w.since_s >= span,
            Task::Meet { at, partner } => {
                let arrived = w.arrived_s.or_else(|| there(at).then_some(now_s));
                let together = matches!(self.walkers[partner].task, Task::Meet { partner, .. } if partner == n)
                    && self.walkers[partner].arrived_s.is_some();
                self.walkers[n].arrived_s = arrived;
                if arrived.is_none() && stuck {
                    return true;
                }
                if together && arrived.is_some() {
                    let both = arrived.unwrap_or(now_s).max(self.walkers[partner].arrived_s.unwrap_or(now_s));
                    return now_s - both > TALK_S;
                }
                now_s - self.walkers[n].since_s > PATIENCE_S + TALK_S
            }
        }
    }

    fn choose(&mut self, n: usize, now_s: f64, rng: &mut ChaCha12Rng) {
        let w = &mut self.walkers[n];
        let stroll = matches!(w.task, Task::Go(_));
        let task = if let Some(i) = w.meetings.iter().position(|m| m.0 <= now_s) {
            let (_, partner, at) = w.meetings.remove(i);
            Task::Meet { at, partner }
        } else if let Some(goal) = w.next_goal.pop() {
            Task::Go(goal)
        } else if stroll && now_s >= w.stop_due_s {
            w.stop_due_s = f64::INFINITY;
            Task::Stand(self.stop_s)
        } else if !w.crossings.is_empty() && rng.random_bool(0.7) {
            let [from, to] = w.crossings.remove(0);
            w.next_goal.push(to);
            Task::Go(from)
        } else {
            let off = if now_s + 12.0 > w.stop_due_s { 0.5 } else { 0.0 };
            let here = w.position;
            let place = (0..20).filter_map(|_| self.free_place(rng, off)).find(|p| (p - here).norm() > 1.8);
            Task::Go(place.unwrap_or(here))
        };
        let w = &mut self.walkers[n];
        let goal = match task {
            Task::Go(at) | Task::Meet { at, .. } => at,
            Task::Stand(_) => w.position,
        };
        w.field = self.grid.field(goal);
        if self.grid.is_free(w.position) && !w.field.reaches(self.grid, w.position) {
            w.field = self.grid.field(w.position);
        }
        w.task = task;
        w.since_s = now_s;
        w.arrived_s = None;
        w.progress = (w.position, now_s);
    }
}

fn distance_to_segment(p: Vector2<f64>, a: Vector2<f64>, b: Vector2<f64>) -> f64 {
    let along = b - a;
    let s = ((p - a).dot(&along) / along.norm_squared().max(1e-12)).clamp(0.0, 1.0);
    (p - (a + along * s)).norm()
}
