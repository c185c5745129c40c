//! UTIAS multi-robot set (MRCLAM): driving robots that see each other by barcodes (range and bearing, narrow cameras) and
//! measure their wheels; poses of all by a motion-capture system.
//!
//! Every robot becomes an agent that sends what it saw of its fellows and what its wheels say, ten times a second and whenever
//! it saw somebody. Landmarks are not given; barcodes of nobody in the team are counted and left out. Scored are relative
//! poses, which is what robots can know of each other: at mutual sightings, and of every pair over the whole run beside what
//! dead reckoning would say that began with the same first relative pose.

use std::collections::BTreeMap;
use std::path::Path;

use nalgebra::{Matrix3, Vector3};
use protocol::angle::wrap;
use protocol::frames::Pose2;
use protocol::id::RobotId;
use protocol::marker::Marker;
use protocol::message::{Motion, Observation, Odometry, PeerSighting, SightedRange, Stages, TeamMap};
use protocol::quantity::{Angle16, Fraction8, LogSigma, Millimetres};
use protocol::time::Timestamp;
use serde::Serialize;

use super::feed::{Feed, Recorded};
use super::{RecordedError, files, median};

/// How old a picture is when it is stamped, seconds: exposure, transfer, and finding the barcode in it.
const CAMERA_LATENCY_S: f64 = 0.05;
/// Sigmas of a reading: bearing in radians, of its stamp in seconds (a robot that turns by 0.4 rad/s is half a degree further after
/// 20 ms), range in metres and as a part of it.
const BEARING_SIGMA_RAD: f64 = 0.0064;
const STAMP_SIGMA_S: f64 = 0.02;
const RANGE_SIGMA_M: f64 = 0.055;
const RANGE_SIGMA: f64 = 0.033;
/// Lags of the wheels that are tried, seconds.
const LAGS_S: [f64; 9] = [0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4];
/// Growth of odometry's errors: forward m²/s while driving, sideways m²/s, heading rad²/s, and heading rad² per rad turned: wheels
/// that reach late what they are told, and slip. What wheels do wrong all the time the leader finds itself.
const FORWARD_M2PS: f64 = 5e-4;
const SIDEWAYS_M2PS: f64 = 1e-5;
const HEADING_RAD2PS: f64 = 2e-4;
const HEADING_PER_RAD: f64 = 8e-3;
/// Between observations without a sighting, seconds.
const TICK_S: f64 = 0.1;
/// Wheels that are not heard for longer stand, seconds.
const WHEELS_SILENT_S: f64 = 1.0;
/// Two sightings of each other within this are mutual, seconds.
pub const MUTUAL_S: f64 = 0.5;
/// Truth is taken between poses no further apart than this, seconds.
const TRUTH_GAP_S: f64 = 0.5;
/// Times are after the Unix epoch and before the year 2100, seconds; a recording of a robot is not longer than a day.
const LAST_TIME_S: f64 = 4.1e9;
const LONGEST_S: f64 = 86_400.0;
/// Between the instants at which pairs are scored, seconds.
const SCORE_S: f64 = 1.0;

/// A pair over the whole run.
#[derive(Debug, Clone, Serialize)]
pub struct Pair {
    /// Which two.
    pub robots: [usize; 2],
    /// Instants scored.
    pub instants: usize,
    /// Median error of the relative position, metres, of the map.
    pub median_m: f64,
    /// The same of dead reckoning.
    pub reckoned_m: f64,
}

/// Scores of a replay.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// How late the wheels do what they are told, as the innovations say, seconds.
    pub wheel_lag_s: f64,
    /// Robots.
    pub robots: usize,
    /// Readings of fellow robots that were sent.
    pub sightings: usize,
    /// Readings of landmarks: left out.
    pub landmarks: usize,
    /// Readings of barcodes that nobody wears: left out.
    pub unknown_barcodes: usize,
    /// Mutual sightings scored.
    pub mutual: usize,
    /// Median error of the relative position at mutual sightings, metres.
    pub mutual_m: f64,
    /// The same of the relative heading, degrees.
    pub mutual_deg: f64,
    /// Mean squared normalised error over three at mutual sightings.
    pub nees: f64,
    /// Median of it over the median of χ² with three degrees of freedom.
    pub nees_median: f64,
    /// Every pair.
    pub pairs: Vec<Pair>,
    /// What the leader told.
    pub notices: Vec<String>,
}

#[derive(Debug, Clone, Copy)]
struct Reading {
    time_s: f64,
    peer: usize,
    range_m: f64,
    bearing_rad: f64,
}

#[derive(Debug, Clone)]
struct Robot {
    id: RobotId,
    /// Time, forward m/s, turning rad/s.
    wheels: Vec<[f64; 3]>,
    readings: Vec<Reading>,
    /// Time, x, y, heading.
    truth: Vec<[f64; 4]>,
}

/// Replays a folder.
pub fn replay(folder: &Path) -> Result<Report, RecordedError> {
    let known = |row: &[f64]| match row[0] >= 1.0 {
        true => Ok(()),
        false => Err((row[0], "a subject from 1 on")),
    };
    let barcodes: BTreeMap<u64, usize> =
        files::checked_table(&folder.join("Barcodes.dat"), 2, "subject, barcode", known)?
            .iter()
            .map(|row| (row[1] as u64, row[0] as usize))
            .collect();
    let mut robots = Vec::new();
    let (mut landmarks, mut unknown) = (0, 0);
    while folder.join(format!("Robot{}_Measurement.dat", robots.len() + 1)).exists() {
        let number = robots.len() + 1;
        let file = |what: &str| folder.join(format!("Robot{number}_{what}.dat"));
        let id = RobotId::new(&format!("r{number}")).map_err(|e| RecordedError::Message(e.to_string()))?;
        let mut readings = Vec::new();
        for row in files::checked_table(&file("Measurement"), 4, "time, barcode, range, bearing", in_time())? {
            match barcodes.get(&(row[1] as u64)) {
                Some(&subject) => {
                    let (time_s, peer) = (row[0] - CAMERA_LATENCY_S, subject - 1);
                    readings.push(Reading { time_s, peer, range_m: row[2], bearing_rad: row[3] });
                }
                None => unknown += 1,
            }
        }
        let want = "time, forward velocity, turning velocity";
        let wheels = files::checked_table(&file("Odometry"), 3, want, in_time())?;
        let truth = files::checked_table(&file("Groundtruth"), 4, "time, x, y, orientation", in_time())?;
        robots.push(Robot {
            id,
            wheels: wheels.iter().map(|r| [r[0], r[1], r[2]]).collect(),
            readings,
            truth: truth.iter().map(|r| [r[0], r[1], r[2], r[3]]).collect(),
        });
    }
    if robots.len() < 2 {
        let (file, value) = (folder.display().to_string(), format!("{} robots", robots.len()));
        let want = "Robot1_Measurement.dat, Robot2_Measurement.dat and so on";
        return Err(RecordedError::Format { file, line: None, value, want });
    }
    let team = robots.len();
    for robot in &mut robots {
        let before = robot.readings.len();
        robot.readings.retain(|r| r.peer < team);
        landmarks += before - robot.readings.len();
    }
    // What nobody told: how late the wheels do what they were told. With the right lag the innovations are least.
    let mut best: Option<(f64, Report)> = None;
    for wheel_lag_s in LAGS_S {
        let shifted: Vec<Robot> = robots.iter().map(|r| r.later(wheel_lag_s)).collect();
        let (innovation, report) = Run::new(&shifted)?.play(landmarks, unknown, wheel_lag_s)?;
        if best.as_ref().is_none_or(|(least, _)| innovation < *least) {
            best = Some((innovation, report));
        }
    }
    best.map(|(_, report)| report).ok_or_else(|| RecordedError::Message("nothing was replayed".to_owned()))
}

/// Checks the times of a file, row by row: none far beyond the others, for everything between is gone through.
fn in_time() -> impl FnMut(&[f64]) -> Result<(), (f64, &'static str)> {
    let mut first_s = None;
    move |row| {
        let time_s = row[0];
        if !(0.0..=LAST_TIME_S).contains(&time_s) {
            return Err((time_s, "a time from 0 to 4.1e9 seconds (Unix time)"));
        }
        if !(-LONGEST_S..=LONGEST_S).contains(&(time_s - *first_s.get_or_insert(time_s))) {
            return Err((time_s, "a time within 86400 seconds (a day) of the file's first"));
        }
        Ok(())
    }
}

/// What a robot does at an instant.
#[derive(Debug, Clone)]
struct Event {
    time_s: f64,
    robot: usize,
    readings: Vec<Reading>,
}

/// All instants at which somebody speaks, in order.
fn events(robots: &[Robot]) -> Vec<Event> {
    let mut all = Vec::new();
    for (k, robot) in robots.iter().enumerate() {
        let (Some(first), Some(last)) = (robot.wheels.first(), robot.wheels.last()) else { continue };
        let mut times: Vec<f64> = robot.readings.iter().map(|r| r.time_s).collect();
        let ticks = ((last[0] - first[0]) / TICK_S) as usize;
        times.extend((0..ticks).map(|n| first[0] + TICK_S * n as f64));
        times.retain(|t| (first[0]..=last[0]).contains(t));
        times.sort_by(f64::total_cmp);
        times.dedup_by(|a, b| *a - *b < 1e-3);
        for time_s in times {
            let at = |r: &&Reading| (r.time_s - time_s).abs() < 1e-3;
            let from = robot.readings.partition_point(|r| r.time_s < time_s - 1.0);
            let near = robot.readings[from..].iter().take_while(|r| r.time_s < time_s + 1.0);
            all.push(Event { time_s, robot: k, readings: near.filter(at).copied().collect() });
        }
    }
    all.sort_by(|a, b| a.time_s.total_cmp(&b.time_s).then(a.robot.cmp(&b.robot)));
    all
}

struct Run<'a> {
    robots: &'a [Robot],
    feed: Feed,
    /// Of each robot: last observation, its number, pose by its wheels alone.
    last: Vec<Option<f64>>,
    sequence: Vec<u32>,
    reckoned: Vec<Pose2>,
    /// Last sighting of each peer by each robot.
    seen: BTreeMap<(usize, usize), f64>,
    /// Relative pose by the map, and by the wheels, when a pair was first in the map.
    begun: BTreeMap<(usize, usize), [Pose2; 3]>,
    /// The newest map, and how far readings were from it.
    before: Option<TeamMap>,
    innovations: Vec<f64>,
    mutual: Vec<[f64; 3]>,
    pairs: BTreeMap<(usize, usize), Vec<[f64; 2]>>,
}

impl<'a> Run<'a> {
    fn new(robots: &'a [Robot]) -> Result<Self, RecordedError> {
        let recorded: Vec<Recorded> = robots
            .iter()
            .map(|r| Recorded {
                id: r.id,
                fixed: None,
                height_m: 0.2,
                tilt_sigma_rad: 0.0,
                marker: Marker::Cylinder { radius_m: 0.17, height_m: [0.1, 0.3], look: None },
                rate_hz: 1.0 / TICK_S,
            })
            .collect();
        Ok(Self {
            robots,
            feed: Feed::new(&recorded, |_| {})?,
            last: vec![None; robots.len()],
            sequence: vec![0; robots.len()],
            reckoned: vec![Pose2::IDENTITY; robots.len()],
            seen: BTreeMap::new(),
            begun: BTreeMap::new(),
            before: None,
            innovations: Vec::new(),
            mutual: Vec::new(),
            pairs: BTreeMap::new(),
        })
    }

    /// Mean size of the bearings' innovations, and the scores.
    fn play(
        mut self,
        landmarks: usize,
        unknown_barcodes: usize,
        wheel_lag_s: f64,
    ) -> Result<(f64, Report), RecordedError> {
        let mut sightings = 0;
        let mut next_score = f64::NEG_INFINITY;
        for event in events(self.robots) {
            sightings += event.readings.len();
            let off: Vec<f64> = event.readings.iter().filter_map(|r| self.innovation(event.robot, r)).collect();
            self.innovations.extend(off);
            let Some(map) = self.send(&event)? else { continue };
            self.before = Some(map.clone());
            for reading in &event.readings {
                self.seen.insert((event.robot, reading.peer), event.time_s);
                let answer = self.seen.get(&(reading.peer, event.robot)).copied();
                if answer.is_some_and(|t| event.time_s - t < MUTUAL_S) {
                    let scored = self.relative_error(&map, event.robot, reading.peer, event.time_s);
                    self.mutual.extend(scored);
                }
            }
            if event.time_s >= next_score {
                next_score = event.time_s + SCORE_S;
                self.score_pairs(&map, event.time_s);
            }
        }
        let of = |k: usize| self.mutual.iter().map(|e| e[k]).collect::<Vec<_>>();
        let pair = |(robots, errors): (&(usize, usize), &Vec<[f64; 2]>)| Pair {
            robots: [robots.0 + 1, robots.1 + 1],
            instants: errors.len(),
            median_m: median(errors.iter().map(|e| e[0]).collect()),
            reckoned_m: median(errors.iter().map(|e| e[1]).collect()),
        };
        let innovation = self.innovations.iter().sum::<f64>() / self.innovations.len().max(1) as f64;
        let report = Report {
            wheel_lag_s,
            robots: self.robots.len(),
            sightings,
            landmarks,
            unknown_barcodes,
            mutual: self.mutual.len(),
            mutual_m: median(of(0)),
            mutual_deg: median(of(1)),
            nees: of(2).iter().sum::<f64>() / (3 * self.mutual.len()).max(1) as f64,
            nees_median: median(of(2)) / 2.366,
            pairs: self.pairs.iter().map(pair).collect(),
            notices: self.feed.notices,
        };
        Ok((innovation, report))
    }

    /// How far a bearing is from what the map before and the wheels since predict, radians.
    fn innovation(&self, robot: usize, reading: &Reading) -> Option<f64> {
        let map = self.before.as_ref()?;
        let since_s = map.stamp.0 as f64 * 1e-9;
        let pose = |k: usize| {
            let there = map.robots.iter().find(|r| r.id == self.robots[k].id)?.team_from_body?;
            Some(there * driven(&self.robots[k].wheels, since_s, reading.time_s).0)
        };
        let (me, peer) = (pose(robot)?, pose(reading.peer)?);
        Some(wrap(reading.bearing_rad - me.bearing_to(peer.position())).abs())
    }

    /// What the robot says at the instant; the map after it.
    fn send(&mut self, event: &Event) -> Result<Option<TeamMap>, RecordedError> {
        let robot = &self.robots[event.robot];
        let odometry = self.last[event.robot].map(|before| {
            let (step, covariance) = driven(&robot.wheels, before, event.time_s);
            self.reckoned[event.robot] = self.reckoned[event.robot] * step;
            Odometry {
                dx_m: step.x_m as f32,
                dy_m: step.y_m as f32,
                dheading_rad: step.heading_rad as f32,
                covariance: [
                    covariance[(0, 0)],
                    covariance[(0, 1)],
                    covariance[(0, 2)],
                    covariance[(1, 1)],
                    covariance[(1, 2)],
                    covariance[(2, 2)],
                ]
                .map(|v| v as f32),
            }
        });
        self.last[event.robot] = Some(event.time_s);
        self.sequence[event.robot] += 1;
        let turning = robot.turning_at(event.time_s);
        let sighting = |r: &Reading| PeerSighting {
            marker: Marker::CYLINDER,
            robot: Some(self.robots[r.peer].id),
            bearing: Angle16::from_rad(r.bearing_rad),
            bearing_sigma: LogSigma::from_value(BEARING_SIGMA_RAD.hypot(STAMP_SIGMA_S * turning)),
            range: Some(SightedRange {
                range: Millimetres::from_m(r.range_m),
                sigma: LogSigma::from_value(RANGE_SIGMA_M.hypot(RANGE_SIGMA * r.range_m)),
            }),
            heading: None,
            confidence: Fraction8::from_value(1.0),
            features: Vec::new(),
        };
        let observation = Observation {
            epoch: 1,
            sequence: self.sequence[event.robot],
            capture: Timestamp::from_secs_f64(event.time_s),
            // Nothing but its wheels says whether it moves.
            motion: Motion::Unknown,
            odometry,
            stages: Stages::ALL,
            sightings: event.readings.iter().map(sighting).collect(),
            tracks: Vec::new(),
        };
        self.feed.observe(robot.id, &observation)
    }

    fn score_pairs(&mut self, map: &TeamMap, time_s: f64) {
        for a in 0..self.robots.len() {
            for b in a + 1..self.robots.len() {
                let Some((found, truth)) = self.relative(map, a, b, time_s) else { continue };
                let [began, wheels_a, wheels_b] =
                    *self.begun.entry((a, b)).or_insert([found, self.reckoned[a], self.reckoned[b]]);
                let (drove_a, drove_b) = (wheels_a.inverse() * self.reckoned[a], wheels_b.inverse() * self.reckoned[b]);
                let reckoned = drove_a.inverse() * began * drove_b;
                let off = |p: &Pose2| (p.position() - truth.position()).norm();
                self.pairs.entry((a, b)).or_default().push([off(&found), off(&reckoned)]);
            }
        }
    }

    /// Pose of `b` seen from `a`: by the map, and in truth.
    fn relative(&self, map: &TeamMap, a: usize, b: usize, time_s: f64) -> Option<(Pose2, Pose2)> {
        let robot = |k: usize| map.robots.iter().find(|r| r.id == self.robots[k].id);
        if robot(a)?.component != robot(b)?.component {
            return None;
        }
        let pose = |k: usize| robot(k)?.team_from_body;
        let truth = |k: usize| self.robots[k].truth_at(time_s);
        Some((pose(a)?.inverse() * pose(b)?, truth(a)?.inverse() * truth(b)?))
    }

    /// Error of the relative pose: metres, degrees, squared normalised.
    fn relative_error(&self, map: &TeamMap, a: usize, b: usize, time_s: f64) -> Option<[f64; 3]> {
        let (found, truth) = self.relative(map, a, b, time_s)?;
        let turn = wrap(found.heading_rad - truth.heading_rad);
        let e = Vector3::new(found.x_m - truth.x_m, found.y_m - truth.y_m, turn);
        let component = map.robots.iter().find(|r| r.id == self.robots[a].id)?.component;
        let placed: Vec<_> = map.placed(component).collect();
        let row = |k: usize| Some(3 * placed.iter().position(|r| r.id == self.robots[k].id)?);
        let joint = map.joint_covariance_of(component)?;
        let (i, j) = (row(a)?, row(b)?);
        let (pa, pb) = (placed[i / 3].team_from_body?, placed[j / 3].team_from_body?);
        let (s, c) = pa.heading_rad.sin_cos();
        let back = Matrix3::new(c, s, 0.0, -s, c, 0.0, 0.0, 0.0, 1.0);
        let (dx, dy) = (pb.x_m - pa.x_m, pb.y_m - pa.y_m);
        let by_a = back * Matrix3::new(-1.0, 0.0, dy, 0.0, -1.0, -dx, 0.0, 0.0, -1.0);
        let cov = |i: usize, j: usize| joint.fixed_view::<3, 3>(i, j).into_owned();
        let cross = by_a * cov(i, j) * back.transpose();
        let all = by_a * cov(i, i) * by_a.transpose() + back * cov(j, j) * back.transpose() + cross + cross.transpose();
        Some([e.x.hypot(e.y), turn.abs().to_degrees(), e.dot(&(all.try_inverse()? * e))])
    }
}

impl Robot {
    /// With wheels that do what they are told `by_s` after.
    fn later(&self, by_s: f64) -> Self {
        Self { wheels: self.wheels.iter().map(|w| [w[0] + by_s, w[1], w[2]]).collect(), ..self.clone() }
    }

    /// rad/s, as its wheels were told last.
    fn turning_at(&self, time_s: f64) -> f64 {
        let after = self.wheels.partition_point(|w| w[0] <= time_s);
        after.checked_sub(1).map_or(0.0, |k| self.wheels[k][2])
    }

    fn truth_at(&self, time_s: f64) -> Option<Pose2> {
        let after = self.truth.partition_point(|t| t[0] < time_s);
        let (a, b) = (self.truth.get(after.checked_sub(1)?)?, self.truth.get(after)?);
        if b[0] - a[0] > TRUTH_GAP_S {
            return None;
        }
        let f = (time_s - a[0]) / (b[0] - a[0]).max(1e-9);
        let between = |k: usize| a[k] + f * (b[k] - a[k]);
        Some(Pose2::new(between(1), between(2), a[3] + f * wrap(b[3] - a[3])))
    }
}

/// What the wheels say of the way from `from_s` to `to_s`, with covariance: their speeds hold until the next are told.
fn driven(wheels: &[[f64; 3]], from_s: f64, to_s: f64) -> (Pose2, Matrix3<f64>) {
    let mut pose = Pose2::IDENTITY;
    let (mut moving_s, mut turned) = (0.0, 0.0);
    let mut k = wheels.partition_point(|w| w[0] <= from_s).saturating_sub(1);
    let mut now = from_s;
    while now < to_s && k < wheels.len() {
        let [told_s, forward, turn] = wheels[k];
        let until = wheels.get(k + 1).map_or(to_s, |w| w[0]).min(to_s);
        let valid = until.min(told_s + WHEELS_SILENT_S) - now;
        if valid > 0.0 {
            let half = 0.5 * turn * valid;
            let way = forward * valid;
            pose = pose * Pose2::new(way * half.cos(), way * half.sin(), turn * valid);
            moving_s += if forward.abs() > 1e-6 || turn.abs() > 1e-6 { valid } else { 0.0 };
            turned += (turn * valid).abs();
        }
        now = until.max(now);
        k += 1;
    }
    let variances = Vector3::new(
        FORWARD_M2PS * moving_s + 1e-9,
        SIDEWAYS_M2PS * moving_s + 1e-9,
        HEADING_RAD2PS * moving_s + HEADING_PER_RAD * turned + 1e-9,
    );
    (pose, Matrix3::from_diagonal(&variances))
}
