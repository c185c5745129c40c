//! What the agent said against what was so.
//!
//! * Identities as in CLEAR-MOT by bearing: a pair stays while it is within [`GATE_RAD`], the rest is assigned optimally; a
//!   switch is a person matched to another track than the last one it was matched to.
//! * Coverage: of the person-frames in which at least half of somebody shows, the share with a track; only while there should be
//!   a background: from [`WARM_UP_S`], and again [`RECOVERY_FRAMES`] after the light jumped or the robot stopped.
//! * NEES of tracks in state `visible`, samples of one quantity at least [`SPACING_S`] apart. Only `seen` ends are
//!   measurements; of `cut` and `hidden` ones the share that is no bound (by more than three sigmas) is counted. A body's
//!   height is camera height + range · tan(elevation of the top), where a range is given and the top is seen.

use std::collections::BTreeMap;

use protocol::angle::difference;
use protocol::id::{TargetId, TrackId};
use protocol::message::{AlarmKind, ElevationEnd, Motion, TrackObservation, TrackState};
use serde::Serialize;

use super::trial::{Instant, SeenTruth, Trial};
use crate::score::identity::IdentityCount;
use crate::score::nees::{Nees, SPACING_S};
use crate::score::visibility::LEAST_FRACTION;

/// Farther apart in bearing, a track is not the person's.
pub const GATE_RAD: f64 = 0.15;
/// Nothing is asked of the first seconds.
pub const WARM_UP_S: f64 = 5.0;
/// Within so many frames the agent must be back at work.
pub const RECOVERY_FRAMES: usize = 30;
/// Slower than this, a column of the panorama a frame, nobody can see the robot turn, radians a second.
const STANDING_RATE: f64 = 0.06;
/// Sigmas by which the truth may lie on the wrong side of a bound.
const BOUND_SIGMAS: f64 = 3.0;

/// Errors against what was claimed.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Errors {
    /// e² / σ².
    pub nees: Nees,
    /// Σ e, Σ e² and their number, all samples.
    pub sums: [f64; 2],
    /// Samples.
    pub count: usize,
}

impl Errors {
    fn add(&mut self, error: f64, sigma: f64, is_apart: bool) {
        if is_apart {
            self.nees.add((error / sigma).powi(2), 1);
        }
        self.sums[0] += error;
        self.sums[1] += error * error;
        self.count += 1;
    }

    /// Mean error.
    pub fn bias(&self) -> Option<f64> {
        (self.count > 0).then(|| self.sums[0] / self.count as f64)
    }

    /// Root mean square.
    pub fn rms(&self) -> Option<f64> {
        (self.count > 0).then(|| (self.sums[1] / self.count as f64).sqrt())
    }

    fn pool(&mut self, other: &Self) {
        self.nees += other.nees;
        self.sums[0] += other.sums[0];
        self.sums[1] += other.sums[1];
        self.count += other.count;
    }
}

/// Of one pair of ends: what was measured there.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Regime {
    /// To the axis, radians.
    pub bearing: Errors,
    /// Lower and upper end where it is seen, radians.
    pub elevation: [Errors; 2],
    /// Metres.
    pub range: Errors,
    /// Metres.
    pub height: Errors,
    /// Cut or hidden ends, and those that are no bound.
    pub bounds: [usize; 2],
}

impl Regime {
    fn pool(&mut self, other: &Self) {
        self.bearing.pool(&other.bearing);
        self.range.pool(&other.range);
        self.height.pool(&other.height);
        for k in 0..2 {
            self.elevation[k].pool(&other.elevation[k]);
            self.bounds[k] += other.bounds[k];
        }
    }
}

/// The figures of one or more trials of a case.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Tally {
    /// Trials.
    pub trials: usize,
    /// Identity switches, and the seeds in which there were some.
    pub switches: usize,
    /// The seeds of these.
    pub switched_in: Vec<u64>,
    /// Person-frames that should have been covered, and that were.
    pub wanted: usize,
    /// Of these.
    pub covered: usize,
    /// Frames with a background, and visible or merged tracks in them that are nobody's.
    pub frames: usize,
    /// Of these.
    pub orphans: usize,
    /// Alarms that nothing explains.
    pub false_alarms: usize,
    /// Frames from a jump of the light to its alarm; `None`: there was none.
    pub alarm_after: Vec<Option<usize>>,
    /// Frames from a jump of the light or the end of a turn to tracking; `None`: never within the trial.
    pub recovery_after: Vec<Option<usize>>,
    /// Frames in which the robot turned, those in which it said so, and those in which it said nothing of motion.
    pub turning: [usize; 3],
    /// Frames in which the robot stood and said it moved, beyond the recovery.
    pub phantom_motion: usize,
    /// Shares of the frames of a stand of 20 s with a track of the same name as before it, the worst first.
    pub held: Vec<f64>,
    /// By what the ends are: "seen/cut" is seen feet and a cut top.
    pub regimes: BTreeMap<String, Regime>,
}

impl Tally {
    /// The figures of one trial.
    pub fn of(trial: &Trial) -> Self {
        let mut tally = Self { trials: 1, ..Self::default() };
        let jumps = jumps(trial);
        let asked = asked_frames(trial, &jumps);
        tally.follow(trial, &asked);
        tally.measure(trial, &asked);
        for &jump in &jumps {
            let late = trial.instants[jump..].iter().position(|i| i.alarms.iter().any(is_jump));
            tally.alarm_after.push(late.filter(|n| *n <= RECOVERY_FRAMES));
            // The frame of the jump itself has no tracks.
            let later = &trial.instants[jump + 1..];
            tally.recovery_after.push(later.iter().position(|i| i.ready).map(|n| n + 1));
        }
        let explained = |n: usize| jumps.iter().any(|j| (*j..*j + 2).contains(&n));
        for (n, instant) in trial.instants.iter().enumerate() {
            let turns = instant.turn_rate.abs() > STANDING_RATE;
            tally.turning[0] += usize::from(turns);
            tally.turning[1] += usize::from(turns && instant.motion == Motion::Turning);
            tally.turning[2] += usize::from(turns && instant.motion == Motion::Standing);
            tally.phantom_motion += usize::from(asked[n] && instant.motion != Motion::Standing);
            let unexplained = |a: &&AlarmKind| is_jump(a) || **a == AlarmKind::SelfMotion && asked[n] && !turns;
            tally.false_alarms += if explained(n) { 0 } else { instant.alarms.iter().filter(unexplained).count() };
        }
        if let Some(stop) = last_turning(trial) {
            let later = &trial.instants[stop + 1..];
            tally.recovery_after.push(later.iter().position(|i| i.ready).map(|n| n + 1));
        }
        tally
    }

    /// Adds the figures of other trials of the case.
    pub fn pool(&mut self, other: &Self) {
        self.trials += other.trials;
        self.switches += other.switches;
        self.switched_in.extend(&other.switched_in);
        self.wanted += other.wanted;
        self.covered += other.covered;
        self.frames += other.frames;
        self.orphans += other.orphans;
        self.false_alarms += other.false_alarms;
        self.alarm_after.extend(&other.alarm_after);
        self.recovery_after.extend(&other.recovery_after);
        self.phantom_motion += other.phantom_motion;
        self.held.extend(&other.held);
        self.held.sort_by(f64::total_cmp);
        for k in 0..3 {
            self.turning[k] += other.turning[k];
        }
        for (ends, regime) in &other.regimes {
            self.regimes.entry(ends.clone()).or_default().pool(regime);
        }
    }

    /// Share of what should be covered.
    pub fn coverage(&self) -> Option<f64> {
        (self.wanted > 0).then(|| self.covered as f64 / self.wanted as f64)
    }

    /// All regimes together.
    pub fn all_ends(&self) -> Regime {
        self.regimes.values().fold(Regime::default(), |mut all, r| {
            all.pool(r);
            all
        })
    }

    fn follow(&mut self, trial: &Trial, asked: &[bool]) {
        let mut identities = IdentityCount::default();
        let mut first_name: Option<TrackId> = None;
        let (mut stood, mut held) = (0, 0);
        for (n, instant) in trial.instants.iter().enumerate() {
            let off: Vec<Vec<f64>> =
                instant.people.iter().map(|p| instant.tracks.iter().map(|t| off_rad(p, t)).collect()).collect();
            let names: Vec<TargetId> = instant.tracks.iter().map(|t| TargetId(t.track.0)).collect();
            if !asked[n] {
                continue;
            }
            self.switches += identities.add(&off, &names, GATE_RAD).len();
            self.frames += 1;
            let real = |t: &&TrackObservation| t.state != TrackState::Hidden;
            let nobodys = |t: &&TrackObservation| instant.people.iter().all(|p| off_rad(p, t) > GATE_RAD);
            self.orphans += instant.tracks.iter().filter(real).filter(nobodys).count();
            for person in instant.people.iter().filter(|p| p.visible_fraction >= LEAST_FRACTION) {
                self.wanted += 1;
                self.covered += usize::from(instant.tracks.iter().any(|t| off_rad(person, t) < GATE_RAD));
            }
            if let (super::Case::Stand, Some([came_s, went_s])) = (trial.case, standing_s(trial)) {
                let name = instant
                    .people
                    .first()
                    .and_then(|p| instant.tracks.iter().find(|t| off_rad(p, t) < GATE_RAD).map(|t| t.track));
                if instant.time_s < came_s {
                    first_name = name.or(first_name);
                } else if instant.time_s < went_s {
                    stood += 1;
                    held += usize::from(name.is_some() && name == first_name);
                }
            }
        }
        if self.switches > 0 {
            self.switched_in.push(trial.seed);
        }
        if stood > 0 {
            self.held.push(held as f64 / stood as f64);
        }
    }

    /// Errors of those who are alone.
    fn measure(&mut self, trial: &Trial, asked: &[bool]) {
        let mut last: BTreeMap<(String, usize, u8), f64> = BTreeMap::new();
        let camera_m = trial.scenario.camera.height_m;
        for (_, instant) in trial.instants.iter().enumerate().filter(|(n, _)| asked[*n]) {
            let [person] = &instant.people[..] else { continue };
            let near = |t: &&TrackObservation| off_rad(person, t) < GATE_RAD && t.state == TrackState::Visible;
            let mut tracks = instant.tracks.iter().filter(near);
            let (Some(track), None) = (tracks.next(), tracks.next()) else { continue };
            let ends = track.ends.map(word).join("/");
            let mut apart = |what: u8| {
                let slot = last.entry((ends.clone(), 0, what)).or_insert(f64::NEG_INFINITY);
                let is_apart = instant.time_s - *slot >= SPACING_S;
                if is_apart {
                    *slot = instant.time_s;
                }
                is_apart
            };
            let regime = self.regimes.entry(ends.clone()).or_default();
            let bearing_error = difference(track.bearing.rad(), person.bearing_rad);
            regime.bearing.add(bearing_error, track.bearing_sigma.value(), apart(0));
            let sigma = track.elevation_sigma.value();
            for end in 0..2 {
                let error = track.elevation[end].rad() - person.elevation_rad[end];
                if track.ends[end] == ElevationEnd::Seen {
                    regime.elevation[end].add(error, sigma, apart(1 + end as u8));
                } else {
                    // The body reaches at least as far as it was seen.
                    let beyond = if end == 0 { -error } else { error };
                    regime.bounds[0] += 1;
                    regime.bounds[1] += usize::from(beyond > BOUND_SIGMAS * sigma);
                }
            }
            if let Some(range) = &track.range {
                let (range_m, range_sigma_m) = (range.range.m(), range.sigma.value());
                regime.range.add(range_m - person.range_m, range_sigma_m, apart(3));
                if track.ends[1] == ElevationEnd::Seen {
                    let top = track.elevation[1].rad();
                    let height_m = camera_m + range_m * top.tan();
                    let height_sigma_m = (top.tan() * range_sigma_m).hypot(range_m / top.cos().powi(2) * sigma);
                    regime.height.add(height_m - person.height_m, height_sigma_m, apart(4));
                }
            }
        }
    }
}

fn off_rad(person: &SeenTruth, track: &TrackObservation) -> f64 {
    difference(track.bearing.rad(), person.bearing_rad).abs()
}

fn word(end: ElevationEnd) -> &'static str {
    match end {
        ElevationEnd::Seen => "seen",
        ElevationEnd::Cut => "cut",
        ElevationEnd::Hidden => "hidden",
    }
}

fn is_jump(alarm: &AlarmKind) -> bool {
    matches!(alarm, AlarmKind::LightSwitched | AlarmKind::SceneChanged)
}

/// First frames after the light was switched.
fn jumps(trial: &Trial) -> Vec<usize> {
    let light = &trial.scenario.room.lamps[0].light;
    let switched = light.windows(2).filter(|w| w[1][0] - w[0][0] < 0.1 && w[0][1] != w[1][1]).map(|w| w[0][0]);
    switched.filter_map(|t| trial.instants.iter().position(|i| i.time_s > t)).collect()
}

fn last_turning(trial: &Trial) -> Option<usize> {
    trial.instants.iter().rposition(|i| i.turn_rate.abs() > STANDING_RATE)
}

/// In which frames the agent should be at work.
fn asked_frames(trial: &Trial, jumps: &[usize]) -> Vec<bool> {
    let stopped = last_turning(trial);
    let turning: Vec<bool> = trial.instants.iter().map(|i: &Instant| i.turn_rate != 0.0).collect();
    let recovers =
        |n: usize| jumps.iter().copied().chain(stopped).any(|from| (from..=from + RECOVERY_FRAMES).contains(&n));
    trial.instants.iter().enumerate().map(|(n, i)| i.time_s >= WARM_UP_S && !turning[n] && !recovers(n)).collect()
}

/// From when to when the first person stands.
fn standing_s(trial: &Trial) -> Option<[f64; 2]> {
    let way = trial.scenario.people.ways.first()?;
    let still = way.windows(2).find(|w| w[0][1..] == w[1][1..])?;
    Some([still[0][0], still[1][0]])
}
