//! Which tracks of which robots are one object.
//!
//! Problem: each robot follows objects by bearing under its own numbers; the same person has another number at every
//! robot, vanishes in merged regions, and two crossing rays meet where nobody stands (a ghost).
//!
//! Insight: every pairing of tracks is weighed against its tracks being clutter, by likelihoods: where the rays meet, how far
//! each robot alone thinks it is, whether others see it. From frame to frame a track is its target's by the filter's prediction;
//! over the frames of a second the pairings themselves are compared, all at once, and the best explanation of all tracks
//! replaces what stands when it is clearly better. Who is who after that is a question of its own (place and height).
//!
//! ```text
//!  track of a frame ── assignment ──▶ a target's: measures it (heavy tails weighed down)
//!        │
//!        └─ with the others' tracks ──▶ exchange: two targets' tracks of this robot the other way round?
//!                                  └──▶ birth: the set of pairings that explains most ──▶ new target, found again, placed anew
//!  target ── unseen too long, lost, a double ──▶ dropped; remembered for a while to get its number back (identity)
//! ```

mod assignment;
mod birth;
mod exchange;
mod explanation;
mod identity;
mod likelihood;
mod memory;
mod merged;
mod upkeep;

use nalgebra::{Matrix2, Matrix3, RowVector3, Vector2};
use protocol::appearance::Appearance;
use protocol::frames::Pose2;
use protocol::id::{TargetId, TrackId};
use protocol::message::{TrackObservation, TrackState};
use protocol::time::Timestamp;

use crate::calibration::live::{Calibrator, Changes};
use crate::leader::config::TargetConfig;
use crate::stereo::range_cue::{CameraFacts, RangeCue};
use crate::stereo::target::{BearingFrom, Innovation, Target};
use birth::Candidate;
use exchange::Exchange;
use identity::{Looks, Past};
use likelihood::{Fit, stretch};
use memory::Memory;

/// Most targets followed at once.
const MAX_TARGETS: usize = 256;
/// Most tracks remembered.
const MAX_MEMORIES: usize = 1024;
/// Part of a merged region's width that is the standard deviation of one object's bearing in it.
const MERGED_SPREAD: f64 = 0.3;
/// Updates after which a target is believed.
const CONFIRMED_UPDATES: u32 = 6;
/// Variance below which the height of a top does not fall, m².
const TOP_FLOOR_VAR: f64 = 0.0016;
/// A frame never counts for less than this part of a frame with an error of its own.
const MOST_REPEAT: f64 = 2.5;
/// Where the rays leave the place so unsure (larger axis, metres), ranges from feet, head and width help.
const UNSURE_M: f64 = 0.15;
/// How much less a range from feet, head and width says with every frame: the gait, the clothes, the shadow stay.
const RANGE_REPEAT: f64 = 10.0;
/// What a robot followed this long ago it still follows, seconds.
const PRESENT_S: f64 = 0.3;
/// By how many nats an assignment must be the best one for the track to move its target: of a track that is sure who it is, and
/// of one that was with others.
const CLEAR: [f64; 2] = [1.0, 2.0];
/// A target counts as seen by a robot for so long after its last bearing, seconds.
pub const OBSERVED_S: f64 = 0.35;

/// All moving objects.
#[derive(Debug)]
pub struct Follower {
    config: TargetConfig,
    targets: Vec<Followed>,
    memories: Vec<Memory>,
    candidates: Vec<Candidate>,
    exchanges: Vec<Exchange>,
    departed: Vec<Followed>,
    vacated: Vec<(Vector2<f64>, Timestamp)>,
    next_id: u32,
    newest: Timestamp,
}

/// One object.
#[derive(Debug, Clone)]
pub struct Followed {
    /// Its number in the team.
    pub id: TargetId,
    /// Its filter.
    pub target: Target,
    /// Last bearing by each robot, and whether it was of the object alone.
    pub observers: Vec<(usize, Timestamp)>,
    /// Last bearing at all.
    pub last: Timestamp,
    updates: u32,
    two_robots: bool,
    /// Half of its width, m.
    half_width_m: f64,
    past: Past,
    /// What it looks like.
    looks: Looks,
}

/// The tracks of one frame of a standing robot.
#[derive(Debug, Clone, Copy)]
pub struct Frame<'a> {
    /// Whose.
    pub robot: usize,
    /// Capture, leader's clock.
    pub at: Timestamp,
    /// Its standard deviation, seconds.
    pub at_sigma_s: f64,
    /// Where the robot stands.
    pub pose: Pose2,
    /// Its camera.
    pub camera: CameraFacts,
    /// What it follows.
    pub tracks: &'a [TrackObservation],
}

/// A measured track, ready for use.
#[derive(Debug, Clone, Copy)]
struct Sight {
    track: TrackId,
    bearing_rad: f64,
    sigma_rad: f64,
    half_width_rad: f64,
    merged: bool,
    /// Its bearing is that of a region that it shares with others (they have the same), not its own.
    region: bool,
    cue: RangeCue,
    /// Elevation of the top and its sigma, where it is seen.
    top: Option<(f64, f64)>,
    /// It was with others of late, and may be somebody else than before.
    doubtful: bool,
    /// What it looks like, in the frames in which that is told.
    appearance: Option<Appearance>,
    /// A fellow robot that moves explains it.
    peer: bool,
}

impl Follower {
    /// Nothing moves yet.
    pub fn new(config: TargetConfig) -> Self {
        Self {
            config,
            targets: Vec::new(),
            memories: Vec::new(),
            candidates: Vec::new(),
            exchanges: Vec::new(),
            departed: Vec::new(),
            vacated: Vec::new(),
            next_id: 1,
            newest: Timestamp::default(),
        }
    }

    /// All targets, believed or not.
    pub fn targets(&self) -> &[Followed] {
        &self.targets
    }

    /// Robots' poses were corrected, robots left their stations.
    pub fn follow_changes(&mut self, changes: &Changes, at: Timestamp) {
        for followed in &mut self.targets {
            for (robot, shift) in &changes.shifts {
                followed.target.shift(*robot, shift);
            }
            for (robot, _, covariance) in &changes.left {
                followed.target.forget(*robot, covariance);
            }
        }
        for (robot, pose, _) in &changes.left {
            self.memories.retain(|m| m.robot != *robot);
            self.candidates.retain(|c| !c.concerns(*robot));
            self.vacated.push((pose.position(), at));
        }
    }

    /// The robot's session ended: its track numbers mean nothing any more.
    pub fn forget_tracks(&mut self, robot: usize) {
        self.memories.retain(|m| m.robot != robot);
        self.candidates.retain(|c| !c.concerns(robot));
    }

    /// Works on one frame.
    pub fn observe(&mut self, frame: &Frame<'_>, calibrator: &Calibrator) {
        self.newest = self.newest.max(frame.at);
        for followed in &mut self.targets {
            followed.target.predict(self.newest);
        }
        let sights = self.sights(frame, calibrator);
        self.remember(frame, &sights);
        let assigned = self.assign(frame, &sights, calibrator);
        for (sight, target) in sights.iter().zip(&assigned) {
            match target {
                Some((t, fit)) if !sight.region => self.measure(frame, sight, *t, fit),
                Some(_) => {}
                None => self.memories.iter_mut().filter(|m| m.is(frame.robot, sight.track)).for_each(Memory::miss),
            }
        }
        let members: Vec<Option<usize>> = assigned.iter().map(|a| a.map(|(t, _)| t)).collect();
        self.measure_merged(frame, &sights, &members, calibrator);
        self.exchange(frame, calibrator);
        self.give_birth(frame, &sights, calibrator);
        self.keep_up(calibrator);
        self.keep_past();
    }

    fn sights(&self, frame: &Frame<'_>, calibrator: &Calibrator) -> Vec<Sight> {
        let peers = self.moving_peers(frame, calibrator);
        let measured = frame.tracks.iter().filter(|t| t.state != TrackState::Hidden);
        measured
            .map(|t| {
                let merged = t.state == TrackState::Merged;
                let width = t.width.rad().abs();
                let sigma = t.bearing_sigma.value().max(1e-4);
                let bearing_rad = t.bearing.rad();
                let region = merged
                    && frame.tracks.iter().any(|o| {
                        o.track != t.track && o.state == t.state && (o.bearing, o.width) == (t.bearing, t.width)
                    });
                let seen_top = t.ends[1] == protocol::message::ElevationEnd::Seen && !merged;
                Sight {
                    track: t.track,
                    bearing_rad,
                    sigma_rad: if region { sigma.max(MERGED_SPREAD * width) } else { sigma },
                    half_width_rad: 0.5 * width,
                    merged,
                    region,
                    cue: RangeCue::of(t, frame.camera, self.config.person_height_m),
                    top: seen_top
                        .then(|| (t.elevation[1].rad(), t.elevation_sigma.value().hypot(frame.camera.tilt_sigma_rad))),
                    doubtful: t.doubtful,
                    appearance: t.appearance.as_ref().map(Appearance::from_bytes),
                    peer: t.class == protocol::message::ObjectClass::Robot
                        || peers.iter().any(|(b, half)| protocol::angle::difference(*b, bearing_rad).abs() < *half),
                }
            })
            .collect()
    }

    /// Bearings and half widths of fellow robots that move (or stopped and are not yet placed): they are no people.
    fn moving_peers(&self, frame: &Frame<'_>, calibrator: &Calibrator) -> Vec<(f64, f64)> {
        calibrator
            .rovers(frame.at)
            .filter(|(robot, ..)| *robot != frame.robot)
            .map(|(_, pose, covariance)| {
                let d = (pose.position() - frame.pose.position()).norm().max(0.3);
                let sigma = (covariance[(0, 0)] + covariance[(1, 1)]).sqrt().min(0.5);
                (frame.pose.bearing_to(pose.position()), ((0.25 + 2.0 * sigma) / d).min(0.6))
            })
            .collect()
    }

    /// A sight as a bearing of a target at `range_m`. `repeat` weighs down frames whose errors are alike.
    fn bearing(&self, frame: &Frame<'_>, sight: &Sight, range_m: f64, repeat: f64) -> BearingFrom {
        let range_m = range_m.max(0.3);
        let sway = self.config.axis_sway_m / range_m;
        let timing = 1.2 * frame.at_sigma_s / range_m;
        let var = (sight.sigma_rad.powi(2) + sway * sway) * repeat + timing * timing;
        BearingFrom { robot: frame.robot, pose: frame.pose, bearing_rad: sight.bearing_rad, var, at: frame.at }
    }

    fn measure(&mut self, frame: &Frame<'_>, sight: &Sight, t: usize, fit: &Fit) {
        let id = self.targets[t].id;
        let Some(memory) = self.memories.iter_mut().find(|m| m.is(frame.robot, sight.track)) else { return };
        if !memory.hit(id, fit.d2) {
            return;
        }
        if let (false, Some(looks)) = (sight.doubtful, memory.appearance_of_bound()) {
            self.targets[t].looks.see(frame.robot, &looks);
        }
        if fit.margin < CLEAR[usize::from(sight.doubtful)] {
            // It may as well be another's: it moves nobody.
            return;
        }
        let followed_alone = self.is_seen_by_one(t, frame);
        let repeat = self.repeat(t, frame);
        let range_m = fit.range_m;
        let mut m = self.bearing(frame, sight, range_m, repeat);
        m.var *= stretch(fit.d2);
        self.use_bearing(t, &m);
        if sight.merged {
            return;
        }
        let followed = &mut self.targets[t];
        if followed.target.sigma_m() < 0.2 && sight.half_width_rad > 0.0 {
            followed.half_width_m +=
                0.05 * ((sight.half_width_rad.tan() * range_m).clamp(0.1, 0.6) - followed.half_width_m);
        }
        let unsure = followed_alone || followed.target.sigma_m() > UNSURE_M;
        if let (true, Some((log_range, spread))) = (unsure, sight.cue.log_range) {
            let cue_m = log_range.exp();
            followed.target.update_range(&frame.pose, cue_m, (spread * cue_m).powi(2) * RANGE_REPEAT);
        }
        if let Some((elevation, sigma)) = sight.top {
            let range_var = followed.target.sigma_m().powi(2);
            let (top, var) =
                crate::stereo::triangulate::height_m(frame.camera.height_m, range_m, elevation, sigma, range_var);
            followed.target.update_top(top, var * repeat + TOP_FLOOR_VAR, TOP_FLOOR_VAR);
        }
    }
}

impl Follower {
    /// Whether no other robot has seen the target of late.
    fn is_seen_by_one(&self, t: usize, frame: &Frame<'_>) -> bool {
        let observers = &self.targets[t].observers;
        observers.iter().all(|(r, at)| *r == frame.robot || frame.at.seconds_since(*at) > OBSERVED_S)
    }

    /// How much less a frame says because its error is like that of the frame before.
    fn repeat(&self, t: usize, frame: &Frame<'_>) -> f64 {
        let before = self.targets[t].observers.iter().find(|(r, _)| *r == frame.robot).map(|(_, at)| *at);
        let since_s = before.map_or(1.0, |b| frame.at.seconds_since(b)).max(1e-3);
        (2.0 * self.config.correlation_s / since_s).clamp(1.0, MOST_REPEAT)
    }

    /// Updates a target and its book-keeping by a bearing that has passed all gates.
    fn use_bearing(&mut self, t: usize, m: &BearingFrom) {
        let alone =
            self.targets[t].observers.iter().all(|(r, at)| *r == m.robot || m.at.seconds_since(*at) > OBSERVED_S);
        let followed = &mut self.targets[t];
        followed.target.update(m);
        followed.two_robots |= !alone;
        followed.last = followed.last.max(m.at);
        followed.updates += 1;
        match followed.observers.iter_mut().find(|(r, _)| *r == m.robot) {
            Some((_, at)) => *at = m.at,
            None => followed.observers.push((m.robot, m.at)),
        }
    }
}

impl Followed {
    /// Whether it may be shown: believed, seen by two robots, sure enough.
    pub fn is_confirmed(&self) -> bool {
        self.updates >= CONFIRMED_UPDATES && self.two_robots
    }

    /// Whether a robot has seen it within so many seconds of `at`.
    fn is_seen_by(&self, robot: usize, at: Timestamp, within_s: f64) -> bool {
        self.observers.iter().any(|(r, seen)| *r == robot && at.seconds_since(*seen).abs() < within_s)
    }

    /// Position covariance with the poses' part, m².
    pub fn covariance(&self, calibrator: &Calibrator) -> Matrix2<f64> {
        let mut sum = self.target.own_covariance();
        for (a, da) in self.target.dependence() {
            for (b, db) in self.target.dependence() {
                sum += da * calibrator.covariance(a, b) * db.transpose();
            }
        }
        0.5 * (sum + sum.transpose())
    }
}

/// Squared residual over its variance, and the variance, with the poses' errors (of each robot by itself).
fn gate_distance2(innovation: &Innovation, target: &Target, m: &BearingFrom, calibrator: &Calibrator) -> (f64, f64) {
    let mut var = innovation.var;
    let mut own_pose_counted = false;
    for (robot, d) in target.dependence() {
        let mut row: RowVector3<f64> = innovation.to_position() * d;
        if robot == m.robot {
            row += innovation.to_pose();
            own_pose_counted = true;
        }
        var += quadratic(&row, &calibrator.covariance(robot, robot));
    }
    if !own_pose_counted {
        var += quadratic(&innovation.to_pose(), &calibrator.covariance(m.robot, m.robot));
    }
    (innovation.residual_rad.powi(2) / var, var)
}

fn quadratic(row: &RowVector3<f64>, cov: &Matrix3<f64>) -> f64 {
    (row * cov * row.transpose())[0]
}
