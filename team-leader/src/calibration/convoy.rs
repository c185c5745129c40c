//! Robots that all drive, with odometry, and see each other now and then.
//!
//! Nobody stands, so there is nothing to average: one extended Kalman filter holds x, y, heading of every member jointly.
//! Odometry moves a robot and widens it; a sighting ties two, and through the joint covariance all others. The frame is that of
//! the first member at the moment it was first tied to somebody.
//!
//! Joining: a robot is a member once it and a member have seen each other within a few seconds. With what either drove in
//! between, the two sightings give the relative pose in closed form. D: driven from the first sighting to the second; m₁: where
//! the member sees the newcomer, m₂: where the newcomer then sees the member; X = (p, φ): the newcomer's pose at the second
//! sighting in the member's frame at the first, a: the origin of the newcomer's first frame in its second:
//!
//! ```text
//!   p + R(φ) a = m₁     p + R(φ) m₂ = d     ⇒   φ = ∠(m₁ − d) − ∠(a − m₂),   p = d − R(φ) m₂
//! ```

use std::collections::VecDeque;

use nalgebra::{DMatrix, DVector, Matrix3, RowVector3, SMatrix, Vector2, Vector3};
use protocol::angle::wrap;
use protocol::frames::Pose2;
use protocol::time::Timestamp;

use super::kernel;
use super::slot::Sighted;

/// Two sightings of a pair that are further apart do not make a newcomer a member, seconds.
const MUTUAL_S: f64 = 3.0;
/// Most sightings that wait for their answer.
const MAX_WAITING: usize = 64;
/// A pose is carried on by its speed for at most so long, seconds.
const LONGEST_STEP_S: f64 = 0.5;
/// Squared sigmas of two numbers beyond which a sighting weighs less: 99 %.
const DOUBTFUL: f64 = 9.2;
/// The same beyond which it is not used.
const GROSS: f64 = 60.0;
/// A member whose sightings were all gross so many times running is taken out: it stands elsewhere.
const LOST_AFTER: u32 = 12;
/// Covariance of the first member: given, not measured.
const GAUGE_VAR: f64 = 1e-10;

/// Robots on the move.
#[derive(Debug, Default)]
pub struct Convoy {
    members: Vec<Member>,
    cov: DMatrix<f64>,
    /// Dead reckoning of everybody, in a frame of its own, with the covariance since it began.
    reckoning: Vec<Option<Reckoning>>,
    waiting: VecDeque<Waiting>,
    /// Whose frame it is.
    gauge: Option<usize>,
}

#[derive(Debug, Clone, Copy)]
struct Member {
    robot: usize,
    pose: Pose2,
    at: Timestamp,
    /// m/s, m/s, rad/s.
    speed: [f64; 3],
    gross: u32,
}

#[derive(Debug, Clone, Copy)]
struct Reckoning {
    pose: Pose2,
    /// Trace of the positions' and variance of the heading's growth: how unsure what was driven since is.
    spread: [f64; 2],
}

/// A sighting that waits for one the other way.
#[derive(Debug, Clone, Copy)]
struct Waiting {
    observer: usize,
    peer: usize,
    at: Timestamp,
    bearing: (f64, f64),
    range: (f64, f64),
    reckoned: [Reckoning; 2],
}

/// Bearing and range with variances.
fn polar(sighted: &Sighted) -> Option<((f64, f64), (f64, f64))> {
    let (width, var) = sighted.width_rad?;
    let range = kernel::range(width);
    let slope = kernel::width(range).1;
    Some(((sighted.bearing_rad, sighted.bearing_var), (range, var / (slope * slope))))
}

fn at(bearing: f64, range: f64) -> Vector2<f64> {
    Vector2::new(range * bearing.cos(), range * bearing.sin())
}

impl Convoy {
    /// Whose frame it is, once there is one.
    pub fn gauge(&self) -> Option<usize> {
        self.gauge
    }

    /// Whether the robot is a member.
    pub fn contains(&self, robot: usize) -> bool {
        self.members.iter().any(|m| m.robot == robot)
    }

    /// Pose of a member, carried on by its speed to `when`.
    pub fn pose(&self, robot: usize, when: Timestamp) -> Option<Pose2> {
        let member = self.members.iter().find(|m| m.robot == robot)?;
        Some(member.ahead(when))
    }

    /// Covariance of two members (x, y, heading each).
    pub fn covariance(&self, a: usize, b: usize) -> Option<Matrix3<f64>> {
        let (i, j) = (self.row(a)?, self.row(b)?);
        Some(self.cov.fixed_view::<3, 3>(i, j).into_owned())
    }

    /// A robot drove `step` (its body frame) in `since_s`.
    pub fn drive(&mut self, robot: usize, now: Timestamp, step: Pose2, covariance: &Matrix3<f64>, since_s: f64) {
        if self.reckoning.len() <= robot {
            self.reckoning.resize(robot + 1, None);
        }
        let start = Reckoning { pose: Pose2::IDENTITY, spread: [0.0; 2] };
        let reckoning = self.reckoning[robot].get_or_insert(start);
        reckoning.pose = reckoning.pose * step;
        reckoning.spread[0] += covariance[(0, 0)] + covariance[(1, 1)];
        reckoning.spread[1] += covariance[(2, 2)];
        let Some(i) = self.row(robot) else { return };
        let member = &mut self.members[i / 3];
        let before = member.pose;
        member.pose = before * step;
        let rate = 1.0 / since_s.max(1e-3);
        let (dx, dy) = (member.pose.x_m - before.x_m, member.pose.y_m - before.y_m);
        (member.speed, member.at) = ([rate * dx, rate * dy, rate * step.heading_rad], now);
        let f = Matrix3::new(1.0, 0.0, -dy, 0.0, 1.0, dx, 0.0, 0.0, 1.0);
        let rows = f * self.cov.rows(i, 3);
        self.cov.rows_mut(i, 3).copy_from(&rows);
        let columns = self.cov.columns(i, 3) * f.transpose();
        self.cov.columns_mut(i, 3).copy_from(&columns);
        let (s, c) = before.heading_rad.sin_cos();
        let rotation = Matrix3::new(c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0);
        let mut own = self.cov.fixed_view_mut::<3, 3>(i, i);
        own += rotation * covariance * rotation.transpose();
    }

    /// `observer` saw `peer`; both have odometry.
    pub fn sight(&mut self, observer: usize, peer: usize, now: Timestamp, sighted: &Sighted) {
        if let (Some(i), Some(j)) = (self.row(observer), self.row(peer)) {
            return self.update(i, j, now, sighted);
        }
        let Some((bearing, range)) = polar(sighted) else { return };
        let reckoned = |r: usize| self.reckoning.get(r).copied().flatten();
        let (Some(mine), Some(theirs)) = (reckoned(observer), reckoned(peer)) else { return };
        let seen = Waiting { observer, peer, at: now, bearing, range, reckoned: [mine, theirs] };
        while self.waiting.front().is_some_and(|w| now.seconds_since(w.at) > MUTUAL_S)
            || self.waiting.len() >= MAX_WAITING
        {
            let _ = self.waiting.pop_front();
        }
        let answered = self.waiting.iter().rev().find(|w| (w.observer, w.peer) == (peer, observer)).copied();
        if let Some(first) = answered {
            self.join(&first, &seen);
        }
        self.waiting.push_back(seen);
    }

    fn row(&self, robot: usize) -> Option<usize> {
        self.members.iter().position(|m| m.robot == robot).map(|k| 3 * k)
    }

    /// Two sightings of each other: one of the pair is a member, or they found the frame.
    fn join(&mut self, first: &Waiting, second: &Waiting) {
        // The relative pose is of `second.observer` (who answers) seen from `first.observer`.
        let (a, b) = (first.observer, second.observer);
        let Some((b_in_a, own)) = mutual(first, second) else { return };
        match (self.row(a), self.row(b)) {
            (None, None) if self.members.is_empty() => {
                self.gauge = Some(a);
                self.insert(a, second.at, Pose2::IDENTITY, &(Matrix3::identity() * GAUGE_VAR), None);
                self.insert(b, second.at, b_in_a, &own, Some(a));
            }
            (Some(k), None) => {
                let pose = self.members[k / 3].pose * b_in_a;
                self.insert(b, second.at, pose, &own, Some(a));
            }
            (None, Some(k)) => {
                let a_in_b = b_in_a.inverse();
                // Covariance of the inverse: the heading's error swings the position round.
                let (s, c) = b_in_a.heading_rad.sin_cos();
                let swing = Matrix3::new(-c, -s, a_in_b.y_m, s, -c, -a_in_b.x_m, 0.0, 0.0, -1.0);
                let pose = self.members[k / 3].pose * a_in_b;
                self.insert(a, second.at, pose, &(swing * own * swing.transpose()), Some(b));
            }
            _ => {}
        }
    }

    /// A new member at `pose`, which is `from`'s with a relative pose of covariance `own` (in the frame of `from`).
    fn insert(&mut self, robot: usize, now: Timestamp, pose: Pose2, own: &Matrix3<f64>, from: Option<usize>) {
        let n = self.cov.nrows();
        let mut cov = DMatrix::zeros(n + 3, n + 3);
        cov.view_mut((0, 0), (n, n)).copy_from(&self.cov);
        let base = from.and_then(|f| self.row(f));
        let mut block = *own;
        if let Some(k) = base {
            let from = self.members[k / 3].pose;
            let (dx, dy) = (pose.x_m - from.x_m, pose.y_m - from.y_m);
            let f = Matrix3::new(1.0, 0.0, -dy, 0.0, 1.0, dx, 0.0, 0.0, 1.0);
            let (s, c) = from.heading_rad.sin_cos();
            let rotation = Matrix3::new(c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0);
            let shared = f * self.cov.rows(k, 3);
            block = f * self.cov.fixed_view::<3, 3>(k, k) * f.transpose() + rotation * own * rotation.transpose();
            cov.view_mut((n, 0), (3, n)).copy_from(&shared);
            cov.view_mut((0, n), (n, 3)).copy_from(&shared.transpose());
        }
        cov.fixed_view_mut::<3, 3>(n, n).copy_from(&block);
        self.cov = cov;
        self.members.push(Member { robot, pose, at: now, speed: [0.0; 3], gross: 0 });
    }

    fn remove(&mut self, row: usize) {
        let rest: Vec<usize> = (0..self.cov.nrows()).filter(|k| !(row..row + 3).contains(k)).collect();
        self.cov = self.cov.select_rows(&rest).select_columns(&rest);
        self.members.remove(row / 3);
    }

    /// The member at row `i` saw that at row `j`.
    fn update(&mut self, i: usize, j: usize, now: Timestamp, sighted: &Sighted) {
        let (me, peer) = (self.members[i / 3].ahead(now), self.members[j / 3].ahead(now));
        let (from, to) = ([me.x_m, me.y_m, me.heading_rad], [peer.x_m, peer.y_m]);
        let (bearing, b_from, b_to) = kernel::bearing(from, to);
        let (range, d_from, d_to) = kernel::distance(from, to);
        let n = self.cov.nrows();
        let wide = |from: [f64; 3], to: [f64; 2]| {
            let mut row = SMatrix::<f64, 1, 3>::zeros().resize_horizontally(n, 0.0);
            row.fixed_columns_mut::<3>(i).copy_from(&RowVector3::from(from));
            row[j] += to[0];
            row[j + 1] += to[1];
            row
        };
        let mut rows = vec![wide(b_from, b_to)];
        let mut residuals = vec![wrap(sighted.bearing_rad - bearing)];
        let mut noises = vec![sighted.bearing_var];
        if let Some((_, (measured, var))) = polar(sighted) {
            rows.push(wide(d_from, d_to));
            residuals.push(measured - range);
            noises.push(var);
        }
        let h = DMatrix::from_fn(rows.len(), n, |r, c| rows[r][c]);
        let residual = DVector::from_vec(residuals);
        let spread = &h * &self.cov * h.transpose();
        let noise = DMatrix::from_diagonal(&DVector::from_vec(noises));
        let Some(inverse) = (&spread + &noise).try_inverse() else { return };
        let nis = residual.dot(&(&inverse * &residual));
        if nis > GROSS || !nis.is_finite() {
            return self.note_gross(i, j);
        }
        (self.members[i / 3].gross, self.members[j / 3].gross) = (0, 0);
        let noise = noise * (nis / DOUBTFUL).max(1.0);
        let Some(inverse) = (spread + &noise).try_inverse() else { return };
        let gain = &self.cov * h.transpose() * inverse;
        let keep = DMatrix::identity(n, n) - &gain * h;
        self.cov = &keep * &self.cov * keep.transpose() + &gain * noise * gain.transpose();
        let step = gain * residual;
        for (k, member) in self.members.iter_mut().enumerate() {
            let pose = &member.pose;
            member.pose = Pose2::new(
                pose.x_m + step[3 * k],
                pose.y_m + step[3 * k + 1],
                wrap(pose.heading_rad + step[3 * k + 2]),
            );
        }
    }

    fn note_gross(&mut self, i: usize, j: usize) {
        for k in [i, j] {
            self.members[k / 3].gross += 1;
        }
        // Of the two, whoever contradicts more is elsewhere; the first member carries the frame and stays.
        let worse = if self.members[i / 3].gross > self.members[j / 3].gross { i } else { j };
        let gauge = self.gauge;
        if self.members[worse / 3].gross >= LOST_AFTER && Some(self.members[worse / 3].robot) != gauge {
            self.remove(worse);
        }
    }
}

impl Member {
    fn ahead(&self, when: Timestamp) -> Pose2 {
        let dt = when.seconds_since(self.at).clamp(0.0, LONGEST_STEP_S);
        let [vx, vy, turn] = self.speed;
        Pose2::new(self.pose.x_m + dt * vx, self.pose.y_m + dt * vy, wrap(self.pose.heading_rad + dt * turn))
    }
}

/// Pose of the second's observer in the first's at the time of the second, with covariance.
fn mutual(first: &Waiting, second: &Waiting) -> Option<(Pose2, Matrix3<f64>)> {
    // What either drove in between.
    let driven_a = first.reckoned[0].pose.inverse() * second.reckoned[1].pose;
    let driven_b = first.reckoned[1].pose.inverse() * second.reckoned[0].pose;
    let unsure = |k: usize, l: usize, part: usize| second.reckoned[l].spread[part] - first.reckoned[k].spread[part];
    let relative = |b1: f64, r1: f64, b2: f64, r2: f64| {
        let (m1, m2) = (at(b1, r1), at(b2, r2));
        let (d, a) = (driven_a.position(), driven_b.inverse().position());
        let (v, w) = (m1 - d, a - m2);
        let phi = wrap(v.y.atan2(v.x) - w.y.atan2(w.x));
        let (s, c) = phi.sin_cos();
        let turned = |q: Vector2<f64>| Vector2::new(c * q.x - s * q.y, s * q.x + c * q.y);
        // Either sighting places it; both count alike.
        let p = 0.5 * (d - turned(m2) + m1 - turned(a));
        driven_a.inverse() * Pose2::new(p.x, p.y, phi)
    };
    let inputs = [first.bearing, first.range, second.bearing, second.range];
    let value = |shift: usize, by: f64| {
        let mut x = inputs.map(|i| i.0);
        if shift < 4 {
            x[shift] += by;
        }
        relative(x[0], x[1], x[2], x[3])
    };
    let pose = value(4, 0.0);
    let mut cov = Matrix3::zeros();
    for (k, (_, var)) in inputs.iter().enumerate() {
        let step = 1e-5;
        let (after, before) = (value(k, step), value(k, -step));
        let j =
            Vector3::new(after.x_m - before.x_m, after.y_m - before.y_m, wrap(after.heading_rad - before.heading_rad))
                / (2.0 * step);
        cov += *var * j * j.transpose();
    }
    let distance = pose.position().norm().max(0.1);
    let driven = unsure(0, 1, 0).max(0.0) + unsure(1, 0, 0).max(0.0);
    let turned = unsure(0, 1, 1).max(0.0) + unsure(1, 0, 1).max(0.0);
    cov += Matrix3::from_diagonal(&Vector3::new(
        driven + turned * distance * distance,
        driven + turned * distance * distance,
        turned + driven / (distance * distance),
    ));
    cov.iter().all(|v| v.is_finite()).then_some((pose, cov))
}

#[cfg(test)]
mod tests;
