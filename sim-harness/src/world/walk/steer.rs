//! How people walk: towards the next point of their way, past each other on the right, with limited acceleration.

use nalgebra::Vector2;

use super::STEP_S;
use super::crowd::{Crowd, Task};

const ACCELERATION_MPS2: f64 = 1.6;
pub(super) const TURN_RATE_RADPS: f64 = 3.0;
/// Two steps of somebody of 1.75 m.
pub(super) const STRIDE_M: f64 = 1.40;
/// Bodies keep at least this far apart.
const APART_M: f64 = 0.55;

impl Crowd<'_> {
    /// The velocity somebody would like to have, and where they would like to look.
    pub(super) fn wish(&self, n: usize) -> (Vector2<f64>, Option<f64>) {
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
        let to = if self.grid.is_free(w.position) {
            self.grid.ahead(&w.field, w.position, 0.7) - w.position
        } else {
            // Pushed between things by others: out of there first.
            self.grid.outwards(w.position)
        };
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

    pub(super) fn advance(&mut self, n: usize, (wish, look): (Vector2<f64>, Option<f64>)) {
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
    pub(super) fn keep_apart(&mut self) {
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

/// To (−π, π].
pub(super) fn wrap(angle: f64) -> f64 {
    angle - std::f64::consts::TAU * (angle / std::f64::consts::TAU).round()
}
