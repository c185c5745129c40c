//! What the measurements so far make of one object, and how well it explains them.

use nalgebra::Matrix3;
use protocol::angle::difference;
use protocol::frames::Pose2;
use protocol::id::TrackId;
use protocol::time::Timestamp;

use super::identity::Looks;
use super::{OBSERVED_S, Sight, gate_distance2};
use crate::calibration::live::Calibrator;
use crate::leader::config::TargetConfig;
use crate::stereo::range_cue::CameraFacts;
use crate::stereo::tails::{log_student, stretch};
use crate::stereo::target::{BearingFrom, LASTING, Target, TopFrom};
use crate::stereo::triangulate::height_m;

/// A frame's top or feet never count for less than this part of those with an error of their own.
const MOST_REPEAT: f64 = 3.0;
/// Where the rays leave the place so unsure (larger axis, metres), ranges from feet, head and width help.
const UNSURE_M: f64 = 0.15;
/// How much less a range from feet, head and width says with every frame: the gait, the clothes, the shadow stay.
const RANGE_REPEAT: f64 = 10.0;
/// No frame is like another after so long, seconds.
const LONG_S: f64 = 1.0;
/// Within so long nobody moves enough to be followed, seconds: of a team of twenty a frame comes every five milliseconds.
const STEP_S: f64 = 0.015;
/// What a frame counts for, apart from others and in one region with them: errors of successive frames are alike.
const TEMPER: f64 = 0.5;
const TEMPER_MERGED: f64 = 0.3;
/// What a squared sigma of a single robot's range is worth in a frame, nats, where the target's is known to this part: ranges
/// of feet and heads err alike from frame to frame. The same for looks, which are told seldom.
const CUE_WORTH: f64 = 0.1;
const KNOWN_RANGE: f64 = 0.3;
const LOOKS_WORTH: f64 = 0.2;
/// What the height of a top counts for in a frame, beside the bearing.
const TOP_WORTH: f64 = 0.2;
/// What a frame costs in which a robot that should see it does not, nats.
const UNSEEN: f64 = 0.4;
/// How far away a robot may miss people, metres.
pub const SURE_RANGE_M: f64 = 6.0;

/// What all judgements need.
#[derive(Debug, Clone, Copy)]
pub struct Context<'a> {
    /// What targets are like.
    pub config: &'a TargetConfig,
    /// Where robots stand, how surely.
    pub calibrator: &'a Calibrator,
    /// The covariance of each standing robot's pose by itself, which is asked for again and again.
    pub covariances: &'a [(usize, Matrix3<f64>)],
}

impl Context<'_> {
    /// Covariance of a robot's pose.
    pub fn covariance(&self, robot: usize) -> Matrix3<f64> {
        let known = self.covariances.iter().find(|(r, _)| *r == robot);
        known.map_or_else(|| self.calibrator.covariance(robot, robot), |(_, covariance)| *covariance)
    }
}

/// A frame of the window: what one robot saw at one time.
#[derive(Debug, Clone)]
pub struct Seen {
    /// Whose.
    pub robot: usize,
    /// Capture, leader's clock.
    pub at: Timestamp,
    /// Its standard deviation, seconds.
    pub at_sigma_s: f64,
    /// Newest capture of any robot then.
    pub newest: Timestamp,
    /// Where the robot stands.
    pub pose: Pose2,
    /// Its camera.
    pub camera: CameraFacts,
    /// The tracks that it measured.
    pub sights: Vec<Sight>,
    /// Bearing and half width of all its tracks, also of those that it only predicted, rad.
    pub covered: Vec<(f64, f64)>,
}

impl Seen {
    /// A sight as a bearing of a target at `range_m`, the first of this robot for so long.
    fn bearing(&self, config: &TargetConfig, sight: &Sight, range_m: f64, interval_s: f64) -> BearingFrom {
        let range_m = range_m.max(0.3);
        let timing = 1.2 * self.at_sigma_s / range_m;
        let of_body = config.filter_var(sight.sigma_rad, range_m);
        BearingFrom {
            robot: self.robot,
            pose: self.pose,
            bearing_rad: sight.bearing_rad,
            var: of_body + timing * timing,
            lasting: LASTING * of_body,
            at: self.at,
            interval_s,
        }
    }
}

/// The last bearing of an object by a robot.
#[derive(Debug, Clone, Copy)]
pub struct ObservedBy {
    /// Whose.
    pub robot: usize,
    /// Of which of its tracks.
    pub track: TrackId,
    /// When.
    pub at: Timestamp,
}

/// An object as measured so far.
#[derive(Debug, Clone)]
pub struct State {
    /// Its filter.
    pub target: Target,
    /// Last bearing by each robot.
    pub observers: Vec<ObservedBy>,
    /// Last bearing at all.
    pub last: Timestamp,
    /// Bearings so far.
    pub updates: u32,
    /// Two robots have seen it at a time.
    pub two_robots: bool,
    /// How well it explains what it was given, against clutter, nats.
    pub score: f64,
}

impl State {
    /// Nothing was measured yet.
    pub fn new(target: Target, at: Timestamp) -> Self {
        Self { target, observers: Vec::new(), last: at, updates: 0, two_robots: false, score: 0.0 }
    }

    /// The robots that see it at `at`.
    pub fn observers_at(&self, at: Timestamp) -> impl Iterator<Item = &ObservedBy> {
        self.observers.iter().filter(move |o| at.seconds_since(o.at) < OBSERVED_S)
    }

    /// Whether a robot has seen it within so many seconds of `at`.
    pub fn is_seen_by(&self, robot: usize, at: Timestamp, within_s: f64) -> bool {
        self.observers.iter().any(|o| o.robot == robot && at.seconds_since(o.at).abs() < within_s)
    }

    /// Goes on by a frame, in which `sight` is this object's.
    pub fn take(&mut self, seen: &Seen, sight: Option<&Sight>, looks: &Looks, context: &Context<'_>) {
        if self.target.since_s(seen.newest) > STEP_S {
            self.target.predict(seen.newest);
        }
        match sight {
            Some(sight) => self.measure(seen, sight, looks, context),
            None if self.should_be_seen(seen) => self.score -= UNSEEN,
            None => {}
        }
    }

    /// Whether the robot should have seen it in this frame.
    fn should_be_seen(&self, seen: &Seen) -> bool {
        if seen.covered.is_empty() {
            return false;
        }
        let away = self.target.position() - seen.pose.position();
        let range_m = away.norm().max(0.3);
        let bearing = seen.pose.bearing_to(self.target.position());
        range_m < SURE_RANGE_M
            && !seen.covered.iter().any(|(b, half)| difference(*b, bearing).abs() < half + 0.2 / range_m)
    }

    /// How far away the object is (m), and how a sight fits it: squared residual over its variance, and the variance, rad².
    fn fit(&self, seen: &Seen, sight: &Sight, context: &Context<'_>) -> (f64, f64, f64) {
        let range_m = self.target.range_m(&seen.pose, seen.at);
        let m = seen.bearing(context.config, sight, range_m, LONG_S);
        let (d2, var) = gate_distance2(&self.target.innovation(&m), &self.target, &m, context);
        (range_m, d2, var)
    }

    /// The height over the floor, metres, of the top that a sight shows, with its variance.
    pub fn top_of(&self, seen: &Seen, sight: &Sight) -> Option<(f64, f64)> {
        let (elevation, sigma) = sight.top?;
        let range_m = self.target.range_m(&seen.pose, seen.at);
        Some(height_m(seen.camera.height_m, range_m, elevation, sigma, self.target.sigma_m().powi(2)))
    }

    /// How well a sight fits, nats against clutter.
    pub fn worth(&self, seen: &Seen, sight: &Sight, context: &Context<'_>) -> f64 {
        let (_, d2, var) = self.fit(seen, sight, context);
        against_clutter(sight, d2, var)
    }

    fn measure(&mut self, seen: &Seen, sight: &Sight, looks: &Looks, context: &Context<'_>) {
        let config = context.config;
        let (range_m, d2, var) = self.fit(seen, sight, context);
        let sigma_m = self.target.sigma_m();
        self.score += against_clutter(sight, d2, var);
        if sigma_m < KNOWN_RANGE * range_m {
            self.score -= CUE_WORTH * sight.cue.cost(range_m);
        }
        if let Some((top, var)) = self.top_of(seen, sight) {
            self.score += TOP_WORTH * looks.as_tall(top, var);
        }
        if let Some(appearance) = &sight.appearance {
            self.score += LOOKS_WORTH * looks.resemblance(appearance);
        }

        let alone = self.observers.iter().all(|o| o.robot == seen.robot || seen.at.seconds_since(o.at) > OBSERVED_S);
        let before = self.observers.iter().find(|o| o.robot == seen.robot).map(|o| o.at);
        let since_s = before.map_or(LONG_S, |b| seen.at.seconds_since(b)).max(1e-3);
        let repeat = config.repeat(since_s, MOST_REPEAT);
        let mut m = seen.bearing(config, sight, range_m, since_s);
        m.var += (m.var - m.lasting) * (config.faster(since_s) - 1.0);
        self.target.update_stretched(&m, stretch(d2));
        self.two_robots |= !alone;
        self.last = self.last.max(seen.at);
        self.updates += 1;
        let now = ObservedBy { robot: seen.robot, track: sight.track, at: seen.at };
        match self.observers.iter_mut().find(|o| o.robot == seen.robot) {
            Some(before) => *before = now,
            None => self.observers.push(now),
        }
        if sight.merged {
            return;
        }
        if let Some((foot_m, sigma_m)) = sight.cue.foot_m {
            self.target.update_measured_range(seen.robot, &seen.pose, foot_m, sigma_m * sigma_m * repeat);
        }
        let unsure = alone || self.target.sigma_m() > UNSURE_M;
        let cue = if sight.top.is_some() { sight.cue.beside_top } else { sight.cue.log_range };
        if let (true, Some((log_range, spread))) = (unsure, cue) {
            let cue_m = log_range.exp();
            self.target.update_range(&seen.pose, cue_m, (spread * cue_m).powi(2) * RANGE_REPEAT);
        }
        if let Some(elevation_rad) = sight.top {
            let (robot, pose, camera_height_m, at) = (seen.robot, seen.pose, seen.camera.height_m, seen.at);
            self.target.update_top(&TopFrom { robot, pose, camera_height_m, elevation_rad, at, repeat });
        }
    }
}

/// What a sight of squared distance `d2` and variance `var` says, nats against clutter: errors of successive frames are alike,
/// more so while people are in one place.
fn against_clutter(sight: &Sight, d2: f64, var: f64) -> f64 {
    let temper = if sight.merged { TEMPER_MERGED } else { TEMPER };
    temper * (log_student(d2, var) - sight.clutter.ln())
}
