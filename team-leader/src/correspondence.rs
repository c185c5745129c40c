//! Which tracks of which robots are one object.
//!
//! Problem: each robot follows objects by bearing under its own numbers; the same person has another number at every
//! robot, vanishes in merged regions, and two crossing rays meet where nobody stands (a ghost).
//!
//! Insight: each track has an owner, and keeps it until the frames of the last seconds are explained better otherwise. They are
//! kept for that (`window`): a change of owners is tried from where it may have happened on, the targets concerned are
//! filtered again over the frames since, and the change is made where their scores gain more than it must (`moves`). So a
//! robot that takes one person for another drags nobody away for longer than until the rays of the next frames tell.
//!
//! ```text
//!  track of a frame ──▶ its owner's: measures it (heavy tails weighed down), scores it against clutter        state
//!        ├─ another owner, two exchanged, none: from some frame on, filtered anew, made where it gains          moves
//!        └─ with others' tracks: the set of pairings that explains most ──▶ new target where it gains           birth
//!  target ── unseen too long, lost, a double ──▶ dropped; remembered to get its number back         upkeep, identity
//! ```

mod birth;
mod explanation;
mod identity;
mod likelihood;
mod memory;
mod moves;
mod state;
mod upkeep;
mod window;

use std::collections::{BTreeMap, VecDeque};

use nalgebra::{Matrix2, Matrix3, RowVector3, Vector2};
use protocol::appearance::Appearance;
use protocol::frames::Pose2;
use protocol::id::{TargetId, TrackId};
use protocol::message::{TrackObservation, TrackState};
use protocol::time::Timestamp;

use crate::calibration::live::{Calibrator, Changes};
use crate::calibration::systematic::SettledFrame;
use crate::leader::config::TargetConfig;
use crate::stereo::range_cue::{CameraFacts, RangeCue};
use crate::stereo::target::{BearingFrom, Innovation, Target};
use birth::Candidate;
use identity::{Looks, Past};
use memory::Memory;
use state::{Context, Seen, State};
use window::Kept;

pub use state::ObservedBy;

/// Most targets followed at once.
const MAX_TARGETS: usize = 256;
/// Most tracks remembered.
const MAX_MEMORIES: usize = 1024;
/// Part of a merged region's width that is the standard deviation of one object's bearing in it.
const MERGED_SPREAD: f64 = 0.3;
/// People are looked for so many times as often as owners are reconsidered, where both are done seldom.
const BIRTHS_OFTENER: u32 = 5;
/// Updates after which a target is believed.
const CONFIRMED_UPDATES: u32 = 6;
/// Nats by which a target must explain its tracks better than clutter before it is shown: few wrong pairs of tracks get there.
const SHOWN_SCORE: f64 = 15.0;
/// What a robot followed this long ago it still follows, seconds.
const PRESENT_S: f64 = 0.3;
/// A target counts as seen by a robot for so long after its last bearing, seconds.
const OBSERVED_S: f64 = 0.35;

/// All moving objects.
#[derive(Debug)]
pub struct Follower {
    config: TargetConfig,
    targets: Vec<Followed>,
    memories: Vec<Memory>,
    candidates: Vec<Candidate>,
    window: VecDeque<Kept>,
    departed: Vec<Followed>,
    vacated: Vec<(Vector2<f64>, Timestamp)>,
    next_id: u32,
    newest: Timestamp,
    /// Frames that left the window and were not taken yet.
    settled: Vec<SettledFrame>,
    /// See [`Follower::be_thrifty`], and the frames of each robot.
    thrift: u32,
    turns: BTreeMap<usize, u32>,
}

/// One object.
#[derive(Debug, Clone)]
pub struct Followed {
    /// Its number in the team.
    pub id: TargetId,
    /// What is measured of it.
    pub state: State,
    /// Its states before the frames of the window.
    trail: VecDeque<State>,
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
pub struct Sight {
    track: TrackId,
    bearing_rad: f64,
    sigma_rad: f64,
    half_width_rad: f64,
    merged: bool,
    cue: RangeCue,
    /// Elevation of the top and its sigma, where it is seen.
    top: Option<(f64, f64)>,
    /// It was with others of late, and may be somebody else than before.
    doubtful: bool,
    /// Density of tracks of nobody at its bearing, 1/rad.
    clutter: f64,
    /// What it looks like, as last told.
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
            window: VecDeque::new(),
            departed: Vec::new(),
            vacated: Vec::new(),
            next_id: 1,
            newest: Timestamp::default(),
            settled: Vec::new(),
            thrift: 1,
            turns: BTreeMap::new(),
        }
    }

    /// One of many components: every `thrift`-th frame of a robot is explained anew, and people are looked for in more, but not
    /// in all of them. Wrong owners and new people are found later, at that part of the cost. Measured are all frames.
    pub fn be_thrifty(&mut self, thrift: u32) {
        self.thrift = thrift.max(1);
    }

    /// Frames whose owners have become final since the last call.
    pub fn take_settled(&mut self) -> Vec<SettledFrame> {
        std::mem::take(&mut self.settled)
    }

    /// All targets, believed or not.
    pub fn targets(&self) -> &[Followed] {
        &self.targets
    }

    /// Robots' poses were corrected, robots left their stations.
    pub fn follow_changes(&mut self, changes: &Changes, at: Timestamp) {
        if !changes.left.is_empty() {
            self.settle();
        }
        for followed in &mut self.targets {
            for state in followed.trail.iter_mut().chain([&mut followed.state]) {
                for (robot, shift) in &changes.shifts {
                    state.target.shift(*robot, shift);
                }
                for (robot, _, covariance) in &changes.left {
                    state.target.forget(*robot, covariance);
                }
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
        let mut sights = self.sights(frame, calibrator);
        self.remember(frame, &sights);
        for sight in &mut sights {
            let memory = self.memories.iter().find(|m| m.is(frame.robot, sight.track));
            sight.appearance = memory.and_then(|m| m.appearance);
        }
        let config = self.config;
        let covariances: Vec<_> = calibrator.stations().map(|(r, _)| (r, calibrator.covariance(r, r))).collect();
        let context = Context { config: &config, calibrator, covariances: &covariances };
        let owners = sights.iter().map(|s| self.memories.iter().find(|m| m.is(frame.robot, s.track))?.bound).collect();
        let seen = Seen {
            robot: frame.robot,
            at: frame.at,
            at_sigma_s: frame.at_sigma_s,
            newest: self.newest,
            pose: frame.pose,
            camera: frame.camera,
            covered: frame.tracks.iter().map(|t| (t.bearing.rad(), 0.5 * t.width.rad().abs())).collect(),
            sights: sights.clone(),
        };
        self.keep(Kept { seen, owners }, &context);
        // Robots begin at different frames, so that their turns do not come together.
        let turn = self.turns.entry(frame.robot).or_insert(frame.robot as u32);
        *turn = turn.wrapping_add(1);
        let turn = *turn;
        if turn.is_multiple_of(self.thrift) {
            self.reconsider(&context);
        }
        if turn.is_multiple_of(self.thrift.div_ceil(BIRTHS_OFTENER)) {
            self.give_birth(frame, &sights, &context);
        }
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
                    cue: RangeCue::of(t, frame.camera, self.config.person_height_m),
                    top: seen_top
                        .then(|| (t.elevation[1].rad(), t.elevation_sigma.value().hypot(frame.camera.tilt_sigma_rad))),
                    doubtful: t.doubtful,
                    clutter: likelihood::clutter_of_tracks(frame, t),
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
}

impl Followed {
    /// Whether it is believed: measured often enough, and seen by two robots at a time.
    pub fn is_confirmed(&self) -> bool {
        self.state.updates >= CONFIRMED_UPDATES && self.state.two_robots
    }

    /// Whether it may be shown: believed, and far better an explanation than clutter. Whether its place is sure enough
    /// [`Self::published_covariance`] says.
    pub fn may_be_shown(&self) -> bool {
        self.is_confirmed() && self.state.score >= SHOWN_SCORE
    }

    /// [`Self::covariance`] where it is small enough for the place to be published.
    pub fn published_covariance(&self, calibrator: &Calibrator, config: &TargetConfig) -> Option<Matrix2<f64>> {
        let covariance = self.covariance(calibrator);
        (covariance.symmetric_eigenvalues().max().sqrt() <= config.publish_below_m).then_some(covariance)
    }

    /// Position covariance with the poses' part, m².
    pub fn covariance(&self, calibrator: &Calibrator) -> Matrix2<f64> {
        let mut sum = self.state.target.own_covariance();
        for (a, da) in self.state.target.dependence() {
            for (b, db) in self.state.target.dependence() {
                sum += da * calibrator.covariance(a, b) * db.transpose();
            }
        }
        0.5 * (sum + sum.transpose())
    }
}

/// Squared residual over its variance, and the variance, with the poses' errors (of each robot by itself).
fn gate_distance2(innovation: &Innovation, target: &Target, m: &BearingFrom, context: &Context<'_>) -> (f64, f64) {
    let mut var = innovation.var;
    let mut own_pose_counted = false;
    for (robot, d) in target.dependence() {
        let mut row: RowVector3<f64> = innovation.to_position() * d;
        if robot == m.robot {
            row += innovation.to_pose();
            own_pose_counted = true;
        }
        var += quadratic(&row, &context.covariance(robot));
    }
    if !own_pose_counted {
        var += quadratic(&innovation.to_pose(), &context.covariance(m.robot));
    }
    (innovation.residual_rad.powi(2) / var, var)
}

fn quadratic(row: &RowVector3<f64>, cov: &Matrix3<f64>) -> f64 {
    (row * cov * row.transpose())[0]
}
