//! How people walk: each has a list of things to do (cross behind a robot, stop, meet somebody, stroll), follows the way
//! there, keeps out of the way of others, and walks smoothly. Worked out once in small steps, kept as samples.

use nalgebra::Vector2;
use rand::{Rng, RngExt};
use rand_chacha::ChaCha12Rng;

use super::floor::{Field, Grid};
use super::person::Gait;
use super::robot::Robot;
use crate::scenario::PeopleSpec;

/// Time step of the samples.
const STEP_S: f64 = 0.02;
/// Walking begins before the pictures.
const WARM_UP_S: f64 = 4.0;
const ACCELERATION_MPS2: f64 = 1.6;
const TURN_RATE_RADPS: f64 = 3.0;
/// Two steps of somebody of 1.75 m.
const STRIDE_M: f64 = 1.40;
/// Legs swing this far at 1 m/s.
const SWING_RAD: f64 = 0.40;
/// Bodies keep at least this far apart.
const APART_M: f64 = 0.55;
/// Of a talk between two who meet.
const TALK_S: f64 = 3.0;
/// Longest wait for somebody to meet.
const PATIENCE_S: f64 = 12.0;

/// Something to do.
#[derive(Debug, Clone, Copy)]
enum Task {
    Go(Vector2<f64>),
    Stand(f64),
    /// Go there, wait for the partner, talk.
    Meet {
        at: Vector2<f64>,
        partner: usize,
    },
}

struct Walker {
    position: Vector2<f64>,
    velocity: Vector2<f64>,
    heading: f64,
    phase: f64,
    speed: f64,
    task: Task,
    since_s: f64,
    arrived_s: Option<f64>,
    field: Field,
    /// Times from which one stop and meetings are due.
    stop_due_s: f64,
    meetings: Vec<(f64, usize, Vector2<f64>)>,
    crossings: Vec<[Vector2<f64>; 2]>,
    next_goal: Vec<Vector2<f64>>,
}

/// All walks of a run.
#[derive(Debug, Clone)]
pub struct Walks {
    samples: Vec<Vec<Gait>>,
}

impl Walks {
    /// How person `n` stands or walks at a true time; the ends are held.
    pub fn at(&self, n: usize, time_s: f64) -> Gait {
        let track = &self.samples[n];
        let place = ((time_s + WARM_UP_S) / STEP_S).clamp(0.0, (track.len() - 1) as f64);
        let (i, f) = (place as usize, place.fract());
        let (a, b) = (track[i], track[(i + 1).min(track.len() - 1)]);
        let mix = |a: f64, b: f64| a + (b - a) * f;
        Gait {
            x_m: mix(a.x_m, b.x_m),
            y_m: mix(a.y_m, b.y_m),
            heading_rad: mix(a.heading_rad, b.heading_rad),
            phase_rad: mix(a.phase_rad, b.phase_rad),
            swing_rad: mix(a.swing_rad, b.swing_rad),
        }
    }

    /// Metres a second at a true time.
    pub fn speed(&self, n: usize, time_s: f64) -> f64 {
        let (a, b) = (self.at(n, time_s - STEP_S), self.at(n, time_s + STEP_S));
        (b.x_m - a.x_m).hypot(b.y_m - a.y_m) / (2.0 * STEP_S)
    }
}

impl Walks {
    /// Whether person `n` stands still for `span_s` on end within the first `duration_s`.
    pub(super) fn stops_for(&self, n: usize, span_s: f64, duration_s: f64) -> bool {
        const LOOK_S: f64 = 0.25;
        let mut still_s = 0.0;
        (0..(duration_s / LOOK_S) as usize).any(|i| {
            still_s = if self.speed(n, i as f64 * LOOK_S) < 0.1 { still_s + LOOK_S } else { 0.0 };
            still_s >= span_s
        })
    }
}

/// Works out everybody's walk.
pub(super) fn walk(
    spec: &PeopleSpec,
    heights_m: &[f64],
    robots: &[Robot],
    grid: &Grid,
    duration_s: f64,
    rng: &mut ChaCha12Rng,
) -> Option<Walks> {
    let mut crowd = Crowd::new(spec, heights_m, robots, grid, duration_s, rng)?;
    let steps = ((WARM_UP_S + duration_s + 1.0) / STEP_S) as usize;
    let mut samples = vec![Vec::with_capacity(steps); heights_m.len()];
    for step in 0..steps {
        crowd.step(step as f64 * STEP_S - WARM_UP_S, rng);
        for (track, (w, height)) in samples.iter_mut().zip(crowd.walkers.iter().zip(heights_m)) {
            let swing = SWING_RAD * (w.velocity.norm() / (height / 1.75)).min(1.3);
            track.push(Gait {
                x_m: w.position.x,
                y_m: w.position.y,
                heading_rad: w.heading,
                phase_rad: w.phase,
                swing_rad: swing,
            });
        }
    }
    Some(Walks { samples })
}

struct Crowd<'a> {
    grid: &'a Grid,
    robots: &'a [Robot],
    heights_m: &'a [f64],
    stop_s: f64,
    standing: usize,
    walkers: Vec<Walker>,
}

impl<'a> Crowd<'a> {
    fn new(
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

    fn step(&mut self, now_s: f64, rng: &mut ChaCha12Rng) {
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
        let w = &self.walkers[n];
        let there = |at: Vector2<f64>| (w.position - at).norm() < 0.18;
        match w.task {
            Task::Go(at) => there(at) || now_s - w.since_s > 25.0,
            Task::Stand(span) => now_s - w.since_s >= span,
            Task::Meet { at, partner } => {
                let arrived = w.arrived_s.or_else(|| there(at).then_some(now_s));
                let together = matches!(self.walkers[partner].task, Task::Meet { partner, .. } if partner == n)
                    && self.walkers[partner].arrived_s.is_some();
                self.walkers[n].arrived_s = arrived;
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
        if !w.field.reaches(self.grid, w.position) {
            w.field = self.grid.field(w.position);
        }
        w.task = task;
        w.since_s = now_s;
        w.arrived_s = None;
    }

    /// The velocity somebody would like to have, and where they would like to look.
    fn wish(&self, n: usize) -> (Vector2<f64>, Option<f64>) {
        let w = &self.walkers[n];
        let goal = match w.task {
            Task::Go(at) => at,
            Task::Meet { at, partner } => {
                if w.arrived_s.is_some() {
                    let to = self.walkers[partner].position - w.position;
                    return (Vector2::zeros(), Some(to.y.atan2(to.x)));
                }
                at
            }
            Task::Stand(_) => return (Vector2::zeros(), None),
        };
        let to = self.grid.ahead(&w.field, w.position, 0.7) - w.position;
        let left = (goal - w.position).norm();
        let slow = if matches!(w.task, Task::Meet { .. }) { (left / 0.5).clamp(0.25, 1.0) } else { 1.0 };
        let mut velocity = if to.norm() > 1e-6 { to.normalize() * w.speed * slow } else { Vector2::zeros() };
        for (m, other) in self.walkers.iter().enumerate().filter(|(m, _)| *m != n) {
            let apart = w.position - other.position;
            let d = apart.norm().max(1e-3);
            let meeting = matches!(w.task, Task::Meet { partner, .. } if partner == m);
            if d < 1.3 && !meeting {
                // Push away and pass on the right.
                let away = apart / d;
                let right = Vector2::new(velocity.y, -velocity.x) * 0.9;
                let ahead = if velocity.dot(&-away) > 0.0 { 1.0 } else { 0.0 };
                let strength = (1.3 - d) / 0.7;
                velocity += away * (0.6 * strength) + right * (ahead * strength.min(1.0));
            }
        }
        let clearance = self.grid.clearance(w.position);
        let tight = ((0.38 - clearance) / 0.15).clamp(0.0, 1.0);
        velocity += self.grid.outwards(w.position) * (0.8 * tight);
        let fastest = 1.25 * w.speed;
        (if velocity.norm() > fastest { velocity.normalize() * fastest } else { velocity }, None)
    }

    fn advance(&mut self, n: usize, (wish, look): (Vector2<f64>, Option<f64>)) {
        let w = &mut self.walkers[n];
        let change = wish - w.velocity;
        let most = ACCELERATION_MPS2 * STEP_S;
        w.velocity += if change.norm() > most { change.normalize() * most } else { change };
        let speed = w.velocity.norm();
        let next = w.position + w.velocity * STEP_S;
        if n >= self.standing && self.grid.clearance(next) > 0.18 {
            w.position = next;
        } else {
            w.velocity *= 0.8;
            if n >= self.standing {
                w.position += self.grid.outwards(w.position) * (0.3 * STEP_S);
            }
        }
        let target = look.or((speed > 0.15).then(|| w.velocity.y.atan2(w.velocity.x)));
        if let Some(target) = target {
            let turn = wrap(target - w.heading);
            w.heading += turn.clamp(-TURN_RATE_RADPS * STEP_S, TURN_RATE_RADPS * STEP_S) * (turn.abs() * 4.0).min(1.0);
        }
        w.phase += std::f64::consts::TAU * speed * STEP_S / (STRIDE_M * self.heights_m[n] / 1.75);
    }

    /// Nobody walks into anybody: what is left of an approach below arm's length is taken from the velocities, and who is
    /// too near is eased away.
    fn keep_apart(&mut self) {
        for a in 0..self.walkers.len() {
            for b in a + 1..self.walkers.len() {
                let apart = self.walkers[a].position - self.walkers[b].position;
                let d = apart.norm().max(1e-3);
                if d >= APART_M + 0.15 {
                    continue;
                }
                let away = apart / d;
                let most = 0.5 * (d - APART_M).max(0.0) / 0.15;
                let push = (0.5 * (APART_M - d)).clamp(0.0, 0.7 * STEP_S);
                for (n, away) in [(a, away), (b, -away)] {
                    let approach = -self.walkers[n].velocity.dot(&away);
                    if approach > most {
                        self.walkers[n].velocity += away * (approach - most);
                    }
                    let next = self.walkers[n].position + away * push;
                    if n >= self.standing && self.grid.clearance(next) > 0.18 {
                        self.walkers[n].position = next;
                    }
                }
            }
        }
    }
}

fn wrap(angle: f64) -> f64 {
    angle - std::f64::consts::TAU * (angle / std::f64::consts::TAU).round()
}

fn distance_to_segment(p: Vector2<f64>, a: Vector2<f64>, b: Vector2<f64>) -> f64 {
    let along = b - a;
    let s = ((p - a).dot(&along) / along.norm_squared().max(1e-12)).clamp(0.0, 1.0);
    (p - (a + along * s)).norm()
}
