//! Where an error comes from: what each agent measured beside what it should have measured, so that an agent's errors and
//! the leader's are told apart.
//!
//! A track is compared with the person nearest in bearing, a sighting with the robot nearest in bearing; both only within
//! [`GATE_RAD`].

use std::collections::BTreeMap;

use protocol::angle::difference;
use protocol::frames::Pose2;
use protocol::message::{Motion, Observation, TrackState};
use serde::Serialize;

use super::Outcome;
use crate::score::statistics::{Rms, mean};
use crate::score::visibility::LEAST_FRACTION;

/// Farther apart in bearing, a measurement belongs to nobody.
pub const GATE_RAD: f64 = 0.15;

/// One observation beside the truth. Degrees, metres.
#[derive(Debug, Clone, Serialize)]
pub struct Diagnosis {
    /// True time of the capture.
    pub time_s: f64,
    /// Whose.
    pub robot: String,
    /// What the robot says of itself.
    pub motion: String,
    /// Whether it truly moved.
    pub moves: bool,
    /// Stages that ran.
    pub stages: u8,
    /// Fellow robots.
    pub sightings: Vec<SightingError>,
    /// Moving objects.
    pub tracks: Vec<TrackError>,
    /// People at least half visible whom no track is near.
    pub missed: Vec<Missed>,
}

/// A sighting.
#[derive(Debug, Clone, Serialize)]
pub struct SightingError {
    /// The robot that is truly there.
    pub peer: Option<String>,
    /// As measured.
    pub bearing_deg: f64,
    /// Measured minus true.
    pub bearing_error_deg: Option<f64>,
    /// As claimed.
    pub bearing_sigma_deg: f64,
    /// Truth.
    pub true_range_m: Option<f64>,
    /// Measured minus true.
    pub range_error_m: Option<f64>,
    /// As claimed.
    pub range_sigma_m: Option<f64>,
    /// That it is a robot.
    pub confidence: f64,
}

/// A track.
#[derive(Debug, Clone, Serialize)]
pub struct TrackError {
    /// Which.
    pub track: u32,
    /// visible, merged, hidden.
    pub state: String,
    /// Who is truly there.
    pub person: Option<String>,
    /// As measured.
    pub bearing_deg: f64,
    /// Measured minus true.
    pub bearing_error_deg: Option<f64>,
    /// As claimed.
    pub bearing_sigma_deg: f64,
    /// Truth.
    pub true_range_m: Option<f64>,
    /// Measured minus true.
    pub range_error_m: Option<f64>,
    /// As claimed.
    pub range_sigma_m: Option<f64>,
    /// Angular width.
    pub width_deg: f64,
    /// Lowest and highest point.
    pub elevation_deg: [f64; 2],
    /// seen, cut, hidden.
    pub ends: [String; 2],
    /// As claimed.
    pub confidence: f64,
    /// Of the person.
    pub visible_fraction: Option<f64>,
}

/// A person that should be in a track.
#[derive(Debug, Clone, Serialize)]
pub struct Missed {
    /// Who.
    pub person: String,
    /// Where.
    pub bearing_deg: f64,
    /// How far.
    pub range_m: f64,
    /// How much of it shows.
    pub visible_fraction: f64,
    /// Whether it walks.
    pub speed_mps: f64,
}

/// All observations of a run.
pub fn diagnose(outcome: &Outcome) -> Vec<Diagnosis> {
    outcome.observations.iter().filter_map(|(robot, observation)| one(outcome, *robot, observation)).collect()
}

fn one(outcome: &Outcome, robot: protocol::id::RobotId, observation: &Observation) -> Option<Diagnosis> {
    let index = outcome.names.iter().position(|name| *name == robot)?;
    let world = &outcome.world;
    let offset_s = world.robots()[index].clock_offset_s;
    let time_s = outcome.true_time_s(observation.capture.offset_by_secs(-offset_s));
    let state = world.at(time_s);
    let own = &state.robots[index];
    let pose = Pose2::new(own.x_m, own.y_m, own.heading_rad);
    let keeper = outcome.truth();
    let seen = keeper.fractions(time_s).get(index).copied().unwrap_or_default();
    let sight = |x: f64, y: f64| {
        let at = nalgebra::Vector2::new(x, y);
        (pose.bearing_to(at), (at - pose.position()).norm())
    };
    let robots: Vec<(String, (f64, f64))> = state
        .robots
        .iter()
        .enumerate()
        .filter(|(n, _)| *n != index)
        .map(|(n, r)| (outcome.names[n].to_string(), sight(r.x_m, r.y_m)))
        .collect();
    let people: Vec<(String, (f64, f64))> = state.people.iter().map(|p| (p.id.clone(), sight(p.x_m, p.y_m))).collect();

    let sightings = observation
        .sightings
        .iter()
        .map(|s| {
            let near = nearest(&robots, s.bearing.rad()).map(|n| &robots[n]);
            SightingError {
                peer: near.map(|(name, _)| name.clone()),
                bearing_deg: s.bearing.rad().to_degrees(),
                bearing_error_deg: near.map(|(_, (b, _))| difference(s.bearing.rad(), *b).to_degrees()),
                bearing_sigma_deg: s.bearing_sigma.value().to_degrees(),
                true_range_m: near.map(|(_, (_, r))| *r),
                range_error_m: near.zip(s.range).map(|((_, (_, r)), range)| range.range.m() - r),
                range_sigma_m: s.range.map(|range| range.sigma.value()),
                confidence: s.confidence.value(),
            }
        })
        .collect();
    let tracks: Vec<TrackError> = observation
        .tracks
        .iter()
        .map(|t| {
            let who = nearest(&people, t.bearing.rad());
            let near = who.map(|n| &people[n]);
            TrackError {
                track: t.track.0,
                state: word(t.state),
                person: near.map(|(name, _)| name.clone()),
                bearing_deg: t.bearing.rad().to_degrees(),
                bearing_error_deg: near.map(|(_, (b, _))| difference(t.bearing.rad(), *b).to_degrees()),
                bearing_sigma_deg: t.bearing_sigma.value().to_degrees(),
                true_range_m: near.map(|(_, (_, r))| *r),
                range_error_m: near.zip(t.range).map(|((_, (_, r)), range)| range.range.m() - r),
                range_sigma_m: t.range.map(|range| range.sigma.value()),
                width_deg: t.width.rad().to_degrees(),
                elevation_deg: t.elevation.map(|e| e.rad().to_degrees()),
                ends: t.ends.map(word),
                confidence: t.confidence.value(),
                visible_fraction: who.and_then(|n| seen.get(n).copied()),
            }
        })
        .collect();
    let missed = people
        .iter()
        .enumerate()
        .filter(|(n, _)| seen.get(*n).is_some_and(|f| *f >= LEAST_FRACTION))
        .filter(|(_, (_, (bearing, _)))| {
            !observation.tracks.iter().any(|t| {
                let reach = GATE_RAD.max(t.width.rad().abs() / 2.0);
                difference(t.bearing.rad(), *bearing).abs() < reach
            })
        })
        .map(|(n, (name, (bearing, range)))| Missed {
            person: name.clone(),
            bearing_deg: bearing.to_degrees(),
            range_m: *range,
            visible_fraction: seen[n],
            speed_mps: state.people[n].speed_mps,
        })
        .collect();
    Some(Diagnosis {
        time_s,
        robot: robot.to_string(),
        motion: word(observation.motion),
        moves: own.moving,
        stages: observation.stages.0,
        sightings,
        tracks,
        missed,
    })
}

fn nearest(things: &[(String, (f64, f64))], bearing: f64) -> Option<usize> {
    let off = |n: usize| difference(bearing, things[n].1.0).abs();
    (0..things.len()).filter(|n| off(*n) < GATE_RAD).min_by(|a, b| off(*a).total_cmp(&off(*b)))
}

fn word(value: impl std::fmt::Debug) -> String {
    format!("{value:?}").to_lowercase()
}

/// The agents' errors in a few lines, for people.
pub fn summary(diagnoses: &[Diagnosis]) -> String {
    let mut by_robot: BTreeMap<&str, Tally> = BTreeMap::new();
    for diagnosis in diagnoses.iter().filter(|d| d.time_s >= crate::score::WARM_UP_S) {
        by_robot.entry(&diagnosis.robot).or_default().add(diagnosis);
    }
    let mut text = String::from(
        "robot  standing  peers/frame  peer bearing: bias rms (deg) NIS  peer range: bias rms (m) NIS | tracks/frame  \
         bearing: bias rms (deg) NIS  range: bias rms (m) NIS  missed  orphans\n",
    );
    for (robot, tally) in by_robot {
        text.push_str(&tally.line(robot));
    }
    text
}

#[derive(Default)]
struct Tally {
    frames: usize,
    standing: usize,
    sightings: usize,
    peer_bearing: Errors,
    peer_range: Errors,
    tracks: usize,
    orphans: usize,
    bearing: Errors,
    range: Errors,
    seen: usize,
    missed: usize,
}

#[derive(Default)]
struct Errors {
    values: Vec<f64>,
    rms: Rms,
    nis: Vec<f64>,
}

impl Errors {
    fn add(&mut self, error: Option<f64>, sigma: Option<f64>) {
        if let (Some(error), Some(sigma)) = (error, sigma) {
            self.values.push(error);
            self.rms.add_square(error * error);
            self.nis.push((error / sigma).powi(2));
        }
    }

    fn text(&self) -> String {
        let show = |value: Option<f64>| value.map_or("-".to_owned(), |v| format!("{v:.3}"));
        format!("{:>7} {:>6} {:>7}", show(mean(&self.values)), show(self.rms.value()), show(mean(&self.nis)))
    }
}

impl Tally {
    fn add(&mut self, d: &Diagnosis) {
        self.frames += 1;
        self.standing += usize::from(d.motion == word(Motion::Standing));
        self.sightings += d.sightings.len();
        for s in d.sightings.iter().filter(|s| s.peer.is_some()) {
            self.peer_bearing.add(s.bearing_error_deg, Some(s.bearing_sigma_deg));
            self.peer_range.add(s.range_error_m, s.range_sigma_m);
        }
        self.tracks += d.tracks.len();
        for t in &d.tracks {
            if t.person.is_none() {
                self.orphans += 1;
            } else if t.state == word(TrackState::Visible) {
                self.bearing.add(t.bearing_error_deg, Some(t.bearing_sigma_deg));
                self.range.add(t.range_error_m, t.range_sigma_m);
            }
        }
        let found = d.tracks.iter().filter(|t| t.visible_fraction.is_some_and(|f| f >= LEAST_FRACTION)).count();
        if !d.moves {
            self.missed += d.missed.len();
            self.seen += d.missed.len() + found;
        }
    }

    fn line(&self, robot: &str) -> String {
        let frames = self.frames.max(1) as f64;
        format!(
            "{robot:<6} {:>7.1}%  {:>10.2}   {}   {} | {:>6.2}  {}  {}  {:>5.1}%  {:>5}\n",
            100.0 * self.standing as f64 / frames,
            self.sightings as f64 / frames,
            self.peer_bearing.text(),
            self.peer_range.text(),
            self.tracks as f64 / frames,
            self.bearing.text(),
            self.range.text(),
            100.0 * self.missed as f64 / self.seen.max(1) as f64,
            self.orphans,
        )
    }
}
