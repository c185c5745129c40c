//! A target's filter that knows how it errs by what its observers' bearings have in common.

use nalgebra::{DVector, Matrix2, Matrix4, Matrix4x2, RowVector2, RowVector4, Vector2, Vector4};
use protocol::angle::wrap;
use protocol::frames::Pose2;
use protocol::id::TargetId;
use protocol::time::Timestamp;

use crate::calibration::kernel;
use crate::leader::config::TargetConfig;
use crate::stereo::motion::Step;
use crate::stereo::tails::stretch;
use crate::stereo::target::VELOCITY_MEMORY_S;

/// A new target's velocity, m/s, and place, m (standard deviations).
const NEW_VELOCITY_MPS: f64 = 0.7;
const NEW_POSITION_M: f64 = 0.5;
/// It begins where two rays no older than this, of robots that look under at least this sine, meet.
const TOGETHER_S: f64 = 0.15;
const LEAST_SINE: f64 = 0.2;
/// Without bearings for so long it is over, seconds; longest prediction in one go.
const OVER_S: f64 = 1.5;
/// Frames of one robot that follow each other have like errors; so many count as one at most.
const MOST_REPEAT: f64 = 5.0;
/// Squared innovations count up to so many of their variances.
const LARGEST: f64 = 16.0;
/// Innovations before the filter has settled tell nothing.
const WARM_UP: u32 = 6;

/// A target under watch.
#[derive(Debug, Clone)]
pub struct Watched {
    /// Which.
    pub id: TargetId,
    mean: Vector4<f64>,
    cov: Matrix4<f64>,
    at: Timestamp,
    begun: bool,
    updates: u32,
    /// Last bearing of each robot and its ray.
    last: Vec<(usize, Timestamp, Pose2, f64)>,
    /// ∂mean/∂(lag, bias) of each robot: how what is wrong with the estimates of those shows in the mean.
    by: Vec<(usize, Matrix4x2<f64>)>,
}

/// A bearing as the robot stamped it.
#[derive(Debug, Clone, Copy)]
pub struct Bearing {
    pub robot: usize,
    pub at: Timestamp,
    pub at_sigma_s: f64,
    pub pose: Pose2,
    pub bearing_rad: f64,
    pub sigma_rad: f64,
    /// By how much its errors are larger than stated.
    pub widened: f64,
}

/// How a bearing's error fits what the robot states.
#[derive(Debug, Clone, Copy)]
pub struct Fitting {
    /// The innovation squared, less what the target's own uncertainty explains, over the variance that the robot states: 1 in the
    /// mean where errors fit.
    pub excess: f64,
    /// How much that tells: one over its variance, 1 where the target's own uncertainty is none.
    pub weight: f64,
}

/// What a bearing says of the shared errors.
#[derive(Debug, Clone)]
pub struct Innovation {
    /// Measured − predicted, less the shared errors as estimated.
    pub residual_rad: f64,
    /// One over its variance, less for those far off; 0 while the filter settles.
    pub weight: f64,
    /// How the robot's errors fit its sigmas; `None` while the filter settles.
    pub fitting: Option<Fitting>,
    /// ∂residual/∂(lag, bias) of each robot.
    pub to_shared: Vec<(usize, [f64; 2])>,
}

impl Watched {
    pub fn new(id: TargetId, at: Timestamp) -> Self {
        Self {
            id,
            mean: Vector4::zeros(),
            cov: Matrix4::zeros(),
            at,
            begun: false,
            updates: 0,
            last: Vec::new(),
            by: Vec::new(),
        }
    }

    pub fn is_over(&self, now: Timestamp) -> bool {
        self.last.iter().all(|(_, at, ..)| now.seconds_since(*at) > OVER_S)
    }

    pub fn concerns(&self, robot: usize) -> bool {
        self.last.iter().any(|(r, ..)| *r == robot) || self.by.iter().any(|(r, _)| *r == robot)
    }

    /// Uses a bearing. `None` until the target has begun; `estimate`: lag and bias of each robot.
    pub fn take(&mut self, b: &Bearing, config: &TargetConfig, estimate: &DVector<f64>) -> Option<Innovation> {
        let (lag_s, bias_rad) = (estimate[2 * b.robot], estimate[2 * b.robot + 1]);
        let b = &Bearing { at: b.at.offset_by_secs(-lag_s), bearing_rad: b.bearing_rad - bias_rad, ..*b };
        let before = self.last.iter().position(|(r, ..)| *r == b.robot);
        let since_s = before.map_or(1.0, |k| b.at.seconds_since(self.last[k].1)).max(1e-3);
        let ray = (b.robot, b.at, b.pose, b.bearing_rad);
        match before {
            Some(k) => self.last[k] = ray,
            None => self.last.push(ray),
        }
        if !self.begun && !self.begin(b) {
            return None;
        }
        self.predict(b.at, config.usual_acceleration_m2ps3);
        let dt = b.at.seconds_since(self.at);
        let then = [self.mean[0] + dt * self.mean[2], self.mean[1] + dt * self.mean[3]];
        let from = [b.pose.x_m, b.pose.y_m, b.pose.heading_rad];
        let (bearing, _, to_point) = kernel::bearing(from, then);
        let range_m = kernel::distance(from, then).0.max(0.3);
        let h = RowVector4::new(to_point[0], to_point[1], dt * to_point[0], dt * to_point[1]);
        let residual_rad = wrap(b.bearing_rad - bearing);

        let direct = RowVector2::new(-(to_point[0] * self.mean[2] + to_point[1] * self.mean[3]), 1.0);
        if !self.by.iter().any(|(r, _)| *r == b.robot) {
            self.by.push((b.robot, Matrix4x2::zeros()));
        }
        let to_shared: Vec<(usize, RowVector2<f64>)> =
            self.by.iter().map(|(r, d)| (*r, if *r == b.robot { direct - h * d } else { -(h * d) })).collect();

        let speed = self.mean[2].hypot(self.mean[3]);
        let timing = (speed * b.at_sigma_s / range_m).powi(2);
        let stated = config.bearing_var(b.sigma_rad, range_m) + timing;
        let repeat = config.repeat(since_s, MOST_REPEAT);
        let noise = stated * b.widened.powi(2) * repeat;
        let spread = (h * self.cov * h.transpose())[0];
        let var = spread + noise * stretch(residual_rad.powi(2) / (spread + noise));
        let gain = self.cov * h.transpose() / var;
        self.mean += gain * residual_rad;
        self.cov = (Matrix4::identity() - gain * h) * self.cov;
        self.cov = 0.5 * (self.cov + self.cov.transpose());
        for ((_, d), (_, g)) in self.by.iter_mut().zip(&to_shared) {
            *d += gain * g;
        }
        self.updates = self.updates.saturating_add(1);
        if !self.mean.iter().all(|v| v.is_finite()) {
            self.begun = false;
            return None;
        }
        let settled = self.updates > WARM_UP && self.last.len() > 1;
        Some(Innovation {
            residual_rad,
            weight: if settled { 1.0 / var } else { 0.0 },
            fitting: settled.then(|| {
                let believed = stated * b.widened.powi(2);
                Fitting {
                    excess: (residual_rad.powi(2).min(LARGEST * (spread + believed)) - spread) / stated,
                    weight: (1.0 + spread / believed).powi(-2),
                }
            }),
            to_shared: to_shared.into_iter().map(|(r, g)| (r, [g[0], g[1]])).collect(),
        })
    }

    /// The estimate of the shared errors has changed by this: the filter goes on as if it had had the new one from the start.
    pub fn rebase(&mut self, change: &DVector<f64>) {
        for (r, d) in &self.by {
            self.mean -= d * Vector2::new(change[2 * r], change[2 * r + 1]);
        }
    }

    /// Begins where the ray meets that of another robot.
    fn begin(&mut self, b: &Bearing) -> bool {
        let line = |pose: &Pose2, bearing: f64| {
            let (s, c) = (pose.heading_rad + bearing).sin_cos();
            (pose.position(), Vector2::new(c, s))
        };
        let (p, u) = line(&b.pose, b.bearing_rad);
        let met = self.last.iter().filter(|(r, at, ..)| *r != b.robot && b.at.seconds_since(*at).abs() < TOGETHER_S);
        let place = met.filter_map(|(_, _, pose, bearing)| {
            let (q, w) = line(pose, *bearing);
            let sine = u.x * w.y - u.y * w.x;
            let [s, t] = Matrix2::new(u.x, -w.x, u.y, -w.y).try_inverse().map(|m| m * (q - p)).map(|x| [x.x, x.y])?;
            (sine.abs() > LEAST_SINE && s > 0.3 && t > 0.3).then_some((sine.abs(), p + s * u))
        });
        let Some((_, place)) = place.max_by(|a, b| a.0.total_cmp(&b.0)) else { return false };
        self.mean = Vector4::new(place.x, place.y, 0.0, 0.0);
        let (x, v) = (NEW_POSITION_M.powi(2), NEW_VELOCITY_MPS.powi(2));
        self.cov = Matrix4::from_diagonal(&Vector4::new(x, x, v, v));
        (self.at, self.begun, self.updates) = (b.at, true, 0);
        self.by.clear();
        true
    }

    fn predict(&mut self, at: Timestamp, acceleration_m2ps3: f64) {
        let dt = at.seconds_since(self.at);
        if dt <= 0.0 {
            return;
        }
        if dt > OVER_S {
            self.begun = false;
        }
        self.at = at;
        let step = Step::over(dt, VELOCITY_MEMORY_S);
        let [place, both, velocity] = step.grows(acceleration_m2ps3);
        let mut f = Matrix4::identity();
        for k in 0..2 {
            f[(k, k + 2)] = step.reach_s;
            f[(k + 2, k + 2)] = step.keep_velocity;
        }
        self.mean = f * self.mean;
        self.cov = f * self.cov * f.transpose();
        for (_, d) in &mut self.by {
            *d = f * *d;
        }
        for k in 0..2 {
            self.cov[(k, k)] += place;
            self.cov[(k, k + 2)] += both;
            self.cov[(k + 2, k)] += both;
            self.cov[(k + 2, k + 2)] += velocity;
        }
    }
}
