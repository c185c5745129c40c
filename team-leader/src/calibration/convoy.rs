//! Robots that all drive, with odometry, and see each other now and then.
//!
//! Nobody stands, so there is nothing to average: one extended Kalman filter holds all members jointly. Odometry moves a robot and
//! widens it; a sighting ties two, and through the joint covariance all others. The frame is that of the first member at the moment
//! it was first tied to somebody.
//!
//! What the errors of a robot share is part of its state, since no number of readings takes it away: camera (bearings against the
//! heading, ranges too long by a part) and wheels (way and turn too long by a part, a turn with every metre, a direction of driving
//! that is not the heading's: Borenstein and Feng, "UMBmark", 1995). Camera and wheels tell the difference of theirs, the priors
//! share it out, and what remains unknown stays in the covariance. Errors that last as long as a view are two rows for each pair that
//! sees each other (`convoy/viewpoint.rs`).
//!
//! ```text
//!  state: member 0: x y heading bias range wheels turn drift direction | member 1: … | view 0: bearing range | view 1: …
//!  p ← p + (1 + wheels) R(heading + direction) step    heading ← heading + (1 + turn) Δ + drift · way
//!  bearing = ∠(peer − p) − heading + bias + e₀ + v     range = (1 + range) |peer − p| + e₁ + v
//! ```
//!
//! Joining: a robot is a member once it and a member have seen each other within a few seconds (`convoy/mutual.rs`).

mod mutual;
mod viewpoint;

use std::collections::VecDeque;

use nalgebra::{DMatrix, DVector, Matrix3, SMatrix};
use protocol::angle::wrap;
use protocol::frames::Pose2;
use protocol::time::Timestamp;

use super::kernel;
use super::slot::Sighted;
use mutual::{Reckoning, Waiting, mutual};
use viewpoint::{LASTING_SHARE, View};

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
/// A priori, standard deviations of what a robot's errors share: bias of bearings, rad, ranges too long by a part; wheels too
/// long by a part, turns too large by a part, rad turned a metre, direction of driving, rad. A calibrated camera, and wheels as they
/// come.
const PRIOR: [f64; SHARED] = [0.006, 0.02, 0.1, 0.1, 0.05, 0.04];
const SHARED: usize = 6;
/// Rows of a member, and where the shared errors of its camera begin.
const ROWS: usize = 3 + SHARED;
const BIAS: usize = 3;
const RANGE: usize = 4;
/// Most views whose errors are remembered; the one unused for longest makes room.
const MAX_VIEWS: usize = 48;
/// Both readings that make a newcomer a member are used again, or leave errors that those after share: its pose is taken to be known
/// this much worse (variance).
const USED_AGAIN: f64 = 4.0;
/// Over how many sightings the innovations of an observer are averaged that tell whether its errors are larger than it states.
const INNOVATIONS: f64 = 60.0;

/// Robots on the move.
#[derive(Debug, Clone, Default)]
pub struct Convoy {
    members: Vec<Member>,
    views: Vec<View>,
    cov: DMatrix<f64>,
    /// Dead reckoning of everybody, in a frame of its own, with the covariance since it began.
    reckoning: Vec<Option<Reckoning>>,
    waiting: VecDeque<Waiting>,
    /// Whose frame it is.
    gauge: Option<usize>,
    /// Sightings used.
    updates: u64,
}

#[derive(Debug, Clone, Copy)]
struct Member {
    robot: usize,
    pose: Pose2,
    at: Timestamp,
    /// m/s, m/s, rad/s.
    speed: [f64; 3],
    gross: u32,
    /// Estimates of what its errors share, as `PRIOR`.
    shared: [f64; SHARED],
    /// Mean squared innovation of what it sees, in units of what it should be.
    excess: f64,
}

/// Bearing and range with variances.
fn polar(sighted: &Sighted) -> Option<((f64, f64), (f64, f64))> {
    let (width, var) = sighted.width_rad?;
    let range = kernel::range(width);
    let slope = kernel::width(range).1;
    Some(((sighted.bearing_rad, sighted.bearing_var), (range, var / (slope * slope))))
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

    /// A robot drove `step` (its body frame, as its wheels say) in `since_s`.
    pub fn drive(&mut self, robot: usize, now: Timestamp, step: Pose2, covariance: &Matrix3<f64>, since_s: f64) {
        if self.reckoning.len() <= robot {
            self.reckoning.resize(robot + 1, None);
        }
        self.reckoning[robot].get_or_insert(Reckoning::START).drive(step, covariance);
        let Some(i) = self.row(robot) else { return };
        let member = &mut self.members[i / ROWS];
        let before = member.pose;
        let [_, _, wheels, turn, drift, direction] = member.shared;
        let (s, c) = (before.heading_rad + direction).sin_cos();
        // The step as the wheels say it, in the team's frame; then as it was.
        let (ux, uy) = (c * step.x_m - s * step.y_m, s * step.x_m + c * step.y_m);
        let (dx, dy) = ((1.0 + wheels) * ux, (1.0 + wheels) * uy);
        let dh = (1.0 + turn) * step.heading_rad + drift * step.x_m;
        member.pose = Pose2::new(before.x_m + dx, before.y_m + dy, wrap(before.heading_rad + dh));
        let rate = 1.0 / since_s.max(1e-3);
        (member.speed, member.at) = ([rate * dx, rate * dy, rate * dh], now);
        let mut f = SMatrix::<f64, 3, ROWS>::zeros();
        f.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::new(1.0, 0.0, -dy, 0.0, 1.0, dx, 0.0, 0.0, 1.0));
        (f[(0, 5)], f[(1, 5)]) = (ux, uy);
        (f[(2, 6)], f[(2, 7)]) = (step.heading_rad, step.x_m);
        (f[(0, 8)], f[(1, 8)]) = (-dy, dx);
        let rows = f * self.cov.rows(i, ROWS);
        self.cov.rows_mut(i, 3).copy_from(&rows);
        let columns = self.cov.columns(i, ROWS) * f.transpose();
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
            if let (Some(i), Some(j)) = (self.row(observer), self.row(peer)) {
                self.update(i, j, now, sighted);
            }
        }
        self.waiting.push_back(seen);
    }

    fn row(&self, robot: usize) -> Option<usize> {
        self.members.iter().position(|m| m.robot == robot).map(|k| ROWS * k)
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
                let pose = self.members[k / ROWS].pose * b_in_a;
                self.insert(b, second.at, pose, &own, Some(a));
            }
            (None, Some(k)) => {
                let a_in_b = b_in_a.inverse();
                // Covariance of the inverse: the heading's error swings the position round.
                let (s, c) = b_in_a.heading_rad.sin_cos();
                let swing = Matrix3::new(-c, -s, a_in_b.y_m, s, -c, -a_in_b.x_m, 0.0, 0.0, -1.0);
                let pose = self.members[k / ROWS].pose * a_in_b;
                self.insert(a, second.at, pose, &(swing * own * swing.transpose()), Some(b));
            }
            _ => {}
        }
    }

    /// A new member at `pose`, which is `from`'s with a relative pose of covariance `own` (in the frame of `from`).
    fn insert(&mut self, robot: usize, now: Timestamp, pose: Pose2, own: &Matrix3<f64>, from: Option<usize>) {
        let n = ROWS * self.members.len();
        self.widen(n, ROWS);
        let mut block = *own;
        if let Some(k) = from.and_then(|f| self.row(f)) {
            let from = self.members[k / ROWS].pose;
            let (dx, dy) = (pose.x_m - from.x_m, pose.y_m - from.y_m);
            let f = Matrix3::new(1.0, 0.0, -dy, 0.0, 1.0, dx, 0.0, 0.0, 1.0);
            let (s, c) = from.heading_rad.sin_cos();
            let rotation = Matrix3::new(c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0);
            let shared = f * self.cov.rows(k, 3);
            block = f * self.cov.fixed_view::<3, 3>(k, k) * f.transpose()
                + USED_AGAIN * rotation * own * rotation.transpose();
            self.cov.rows_mut(n, 3).copy_from(&shared);
            self.cov.columns_mut(n, 3).copy_from(&shared.transpose());
        }
        self.cov.fixed_view_mut::<3, 3>(n, n).copy_from(&block);
        for (k, sigma) in PRIOR.iter().enumerate() {
            self.cov[(n + 3 + k, n + 3 + k)] = sigma * sigma;
        }
        let (speed, shared) = ([0.0; 3], [0.0; SHARED]);
        self.members.push(Member { robot, pose, at: now, speed, gross: 0, shared, excess: 1.0 });
    }

    fn remove(&mut self, row: usize) {
        let robot = self.members[row / ROWS].robot;
        while let Some(v) = self.views.iter().position(|v| v.observer == robot || v.peer == robot) {
            self.forget(v);
        }
        self.members.remove(row / ROWS);
        self.narrow(row, ROWS);
    }

    /// Zero rows and columns from `at` on.
    fn widen(&mut self, at: usize, count: usize) {
        let cov = std::mem::take(&mut self.cov);
        self.cov = cov.insert_rows(at, count, 0.0).insert_columns(at, count, 0.0);
    }

    fn narrow(&mut self, at: usize, count: usize) {
        let cov = std::mem::take(&mut self.cov);
        self.cov = cov.remove_rows(at, count).remove_columns(at, count);
    }

    fn view_row(&self, view: usize) -> usize {
        ROWS * self.members.len() + 2 * view
    }

    fn forget(&mut self, view: usize) {
        self.narrow(self.view_row(view), 2);
        self.views.remove(view);
    }

    /// The view of `peer` by `observer`, made ready for a reading whose lasting errors have these variances.
    fn view(&mut self, observer: usize, peer: usize, reading: (f64, Option<f64>), variances: [f64; 2]) -> usize {
        self.updates += 1;
        let known = self.views.iter().position(|v| (v.observer, v.peer) == (observer, peer));
        let (view, rho) = match known {
            Some(view) => (view, self.views[view].turn_to(reading.0, reading.1, self.updates)),
            None => {
                let oldest = (0..self.views.len()).min_by_key(|&v| self.views[v].used);
                if let Some(oldest) = oldest.filter(|_| self.views.len() >= MAX_VIEWS) {
                    self.forget(oldest);
                }
                self.views.push(View::new(observer, peer, reading.0, reading.1, self.updates));
                let view = self.views.len() - 1;
                self.widen(self.view_row(view), 2);
                (view, 0.0)
            }
        };
        let u = self.view_row(view);
        self.cov.rows_mut(u, 2).scale_mut(rho);
        self.cov.columns_mut(u, 2).scale_mut(rho);
        for (k, variance) in variances.iter().enumerate() {
            self.cov[(u + k, u + k)] += (1.0 - rho * rho) * variance;
        }
        view
    }

    /// The member at row `i` saw that at row `j`.
    fn update(&mut self, i: usize, j: usize, now: Timestamp, sighted: &Sighted) {
        let (observer, target) = (self.members[i / ROWS], self.members[j / ROWS]);
        let (me, peer) = (observer.ahead(now), target.ahead(now));
        let (from, to) = ([me.x_m, me.y_m, me.heading_rad], [peer.x_m, peer.y_m]);
        let (bearing, b_from, b_to) = kernel::bearing(from, to);
        let (range, d_from, d_to) = kernel::distance(from, to);
        let measured = polar(sighted).map(|(_, range)| range);
        let widened = observer.excess.max(1.0);
        let variances = [sighted.bearing_var, measured.map_or(0.0, |m| m.1)].map(|v| widened * v);
        let reading = (sighted.bearing_rad, measured.map(|m| m.0));
        let view = self.view(observer.robot, target.robot, reading, variances.map(|v| LASTING_SHARE * v));
        let (u, lasting) = (self.view_row(view), self.views[view].error);
        let n = self.cov.nrows();
        let count = 1 + usize::from(measured.is_some());
        let mut h = DMatrix::zeros(count, n);
        let mut residual = DVector::zeros(count);
        let mut wide = |row: usize, scale: f64, from: [f64; 3], to: [f64; 2], off: f64| {
            from.iter().enumerate().for_each(|(k, d)| h[(row, i + k)] = scale * d);
            to.iter().enumerate().for_each(|(k, d)| h[(row, j + k)] = scale * d);
            h[(row, u + row)] = 1.0;
            residual[row] = off;
        };
        let [bias, longer, ..] = observer.shared;
        wide(0, 1.0, b_from, b_to, wrap(sighted.bearing_rad - bearing - bias - lasting[0]));
        if let Some((measured, _)) = measured {
            wide(1, 1.0 + longer, d_from, d_to, measured - (1.0 + longer) * range - lasting[1]);
            h[(1, i + RANGE)] = range;
        }
        h[(0, i + BIAS)] = 1.0;
        let noise =
            DMatrix::from_fn(count, count, |a, b| if a == b { (1.0 - LASTING_SHARE) * variances[a] } else { 0.0 });
        let wide = &h * &self.cov;
        let spread = &wide * h.transpose();
        let Some(inverse) = (&spread + &noise).try_inverse() else { return };
        let nis = residual.dot(&(&inverse * &residual));
        if nis > GROSS || !nis.is_finite() {
            return self.note_gross(i, j);
        }
        (self.members[i / ROWS].gross, self.members[j / ROWS].gross) = (0, 0);
        // The innovation had these variances widened already: against what is stated.
        let excess = &mut self.members[i / ROWS].excess;
        *excess += (widened * nis.min(DOUBTFUL) / count as f64 - *excess) / INNOVATIONS;
        let total = spread + noise * (nis / DOUBTFUL).max(1.0);
        let Some(inverse) = total.clone().try_inverse() else { return };
        let gain = wide.transpose() * inverse;
        self.cov -= &gain * (total * gain.transpose());
        for a in 0..n {
            for b in 0..a {
                let mean = 0.5 * (self.cov[(a, b)] + self.cov[(b, a)]);
                (self.cov[(a, b)], self.cov[(b, a)]) = (mean, mean);
            }
        }
        self.correct(&(gain * residual));
    }

    fn correct(&mut self, step: &DVector<f64>) {
        for (k, member) in self.members.iter_mut().enumerate() {
            let (row, pose) = (ROWS * k, member.pose);
            let heading = wrap(pose.heading_rad + step[row + 2]);
            member.pose = Pose2::new(pose.x_m + step[row], pose.y_m + step[row + 1], heading);
            member.shared.iter_mut().enumerate().for_each(|(e, x)| *x += step[row + 3 + e]);
        }
        let base = ROWS * self.members.len();
        for (v, view) in self.views.iter_mut().enumerate() {
            view.error.iter_mut().enumerate().for_each(|(e, x)| *x += step[base + 2 * v + e]);
        }
    }

    fn note_gross(&mut self, i: usize, j: usize) {
        for k in [i, j] {
            self.members[k / ROWS].gross += 1;
        }
        // Of the two, whoever contradicts more is elsewhere; the first member carries the frame and stays.
        let worse = if self.members[i / ROWS].gross > self.members[j / ROWS].gross { i } else { j };
        let gauge = self.gauge;
        if self.members[worse / ROWS].gross >= LOST_AFTER && Some(self.members[worse / ROWS].robot) != gauge {
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

#[cfg(test)]
mod tests;
