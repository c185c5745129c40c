//! What is wrong with a running team, and what would fix it: from what anybody may hear, judged without a clock or network.
//!
//! A team is silent for few reasons: nobody leads, a name differs, a robot is not there, its camera gives nothing, its clock is off,
//! it sees nobody, nobody sees it, its programs are of another version. Each has its check; each finding says what to do.

mod sights;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};

use protocol::id::{LeaderId, RobotId, TeamId};
use protocol::message::map::Trust;
use protocol::message::{Announcement, Health, MapStatus, Observation, Presence, TeamMap};
use serde::Serialize;

pub use sights::Sight;

/// Offsets of clocks above this make people wonder: chrony is not at work.
const CLOCK_OFFSET_LIMIT_S: f64 = 0.1;
/// A person at 1.5 m/s is then 1.5 cm elsewhere.
const CLOCK_SIGMA_LIMIT_S: f64 = 0.01;
/// Below this share of its nominal rate a robot is slow.
const RATE_SHARE: f64 = 0.7;
/// Above this share of lost frames or messages something is too slow.
const LOST_SHARE: f64 = 0.05;
/// A picture is dark or bright where its mean is outside, gray values.
const EXPOSURE_GRAY: [f64; 2] = [40.0, 215.0];
/// Above this share of black or white pixels the exposure is wrong.
const CLIPPED_SHARE: f64 = 0.1;
/// Below this share of the team's median sharpness a lens is out of focus or dirty.
const SHARPNESS_SHARE: f64 = 0.5;

/// What was heard of a team for a few seconds.
#[derive(Debug, Clone)]
pub struct Heard {
    /// Which team.
    pub team: TeamId,
    /// This program's version.
    pub version: String,
    /// How long it was listened, seconds.
    pub listened_s: f64,
    /// Leaders whose token is there.
    pub leaders: BTreeSet<LeaderId>,
    /// Robots whose token is there.
    pub present: BTreeSet<RobotId>,
    /// Who the robots say they are; several where several sessions use one name.
    pub announcements: BTreeMap<RobotId, Vec<Announcement>>,
    /// The robots' last reports.
    pub healths: BTreeMap<RobotId, Health>,
    /// What they saw.
    pub observations: BTreeMap<RobotId, Vec<Observation>>,
    /// Robots that say they are paused.
    pub paused: BTreeSet<RobotId>,
    /// The last map.
    pub map: Option<TeamMap>,
    /// What their pictures are like; empty where none were asked for.
    pub pictures: BTreeMap<RobotId, PictureFigures>,
}

/// What a picture is like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PictureFigures {
    /// Mean gray value.
    pub mean: f64,
    /// Share of pixels that are black or white (below 2, above 253).
    pub clipped: f64,
    /// Mean absolute second difference along the rows, gray values, over the mean absolute first difference: how much of the contrast
    /// is fine.
    pub sharpness: f64,
}

/// How bad it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// As it should be.
    Fine,
    /// It works, but not as well as it could.
    Warning,
    /// It does not work.
    Problem,
}

/// One thing that was found.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// How bad it is.
    pub severity: Severity,
    /// Of whom: the team, a robot, a leader.
    pub about: String,
    /// What.
    pub what: String,
    /// What would fix it; empty where nothing is wrong.
    pub cure: String,
}

/// The diagnosis: findings, the worst first, and who sees whom.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Diagnosis {
    /// Findings.
    pub findings: Vec<Finding>,
    /// Who sees whom.
    pub sees: Vec<Sight>,
}

impl Diagnosis {
    /// Whether nothing is a [`Severity::Problem`].
    pub fn is_fine(&self) -> bool {
        self.findings.iter().all(|finding| finding.severity < Severity::Problem)
    }
}

/// Judges what was heard.
pub fn diagnose(heard: &Heard) -> Diagnosis {
    let mut notes = Notes::default();
    leadership(heard, &mut notes);
    versions(heard, &mut notes);
    for robot in &heard.present {
        of_robot(heard, *robot, &mut notes);
    }
    map(heard, &mut notes);
    pictures(heard, &mut notes);
    let sees = sights::sights(heard);
    sights::judge(heard, &sees, &mut notes);
    let mut findings = notes.0;
    findings.sort_by_key(|finding| std::cmp::Reverse(finding.severity));
    Diagnosis { findings, sees }
}

/// Findings so far.
#[derive(Debug, Default)]
struct Notes(Vec<Finding>);

impl Notes {
    fn fine(&mut self, about: &dyn std::fmt::Display, what: impl Into<String>) {
        self.note(Severity::Fine, about, what, "");
    }

    fn warning(&mut self, about: &dyn std::fmt::Display, what: impl Into<String>, cure: impl Into<String>) {
        self.note(Severity::Warning, about, what, cure);
    }

    fn problem(&mut self, about: &dyn std::fmt::Display, what: impl Into<String>, cure: impl Into<String>) {
        self.note(Severity::Problem, about, what, cure);
    }

    fn note(
        &mut self,
        severity: Severity,
        about: &dyn std::fmt::Display,
        what: impl Into<String>,
        cure: impl Into<String>,
    ) {
        self.0.push(Finding { severity, about: about.to_string(), what: what.into(), cure: cure.into() });
    }
}

fn leadership(heard: &Heard, notes: &mut Notes) {
    let team = format!("team {}", heard.team);
    let leaders: Vec<String> = heard.leaders.iter().map(ToString::to_string).collect();
    match (&heard.map, leaders.is_empty()) {
        (_, true) => notes.problem(
            &team,
            "no leader is there",
            format!("start one: team-leader run, with [leader] team = \"{}\"", heard.team),
        ),
        (Some(map), _) => {
            notes.fine(&team, format!("{} leads in term {}; leaders: {}", map.leader, map.term, leaders.join(", ")));
        }
        (None, _) => notes.warning(
            &team,
            format!("leaders: {}, but no map", leaders.join(", ")),
            "a map comes with the first observation; see the robots below",
        ),
    }
    if heard.present.is_empty() {
        let cure = format!(
            "is robot-agent running, is its [robot] team \"{}\", does its [network] connect name this leader's address, and do \
             certificates fit? robot-agent check says",
            heard.team
        );
        notes.problem(&team, "no robot is there", cure);
    }
}

fn versions(heard: &Heard, notes: &mut Notes) {
    for (&robot, announced) in &heard.announcements {
        if let [first, .., last] = &announced[..] {
            let hosts = format!("on {} and {}", first.host, last.host);
            notes.problem(&robot, format!("two sessions use this id, {hosts}"), "give one of them another [robot] id");
        }
        for announcement in announced {
            if announcement.version != heard.version {
                let what = format!("robot-agent {} beside team-leader {}", announcement.version, heard.version);
                notes.warning(&robot, what, "install the same version everywhere; the older side first");
                break;
            }
        }
    }
}

fn of_robot(heard: &Heard, robot: RobotId, notes: &mut Notes) {
    let announced = heard.announcements.get(&robot).and_then(|all| all.last());
    if announced.is_none() {
        let cure = "does it speak another version of the wire? Its log and the leader's name refused messages";
        notes.problem(&robot, "is there but has not said who it is", cure);
    }
    let seen = heard.observations.get(&robot).map_or(0, Vec::len);
    let rate_hz = seen as f64 / heard.listened_s.max(1e-3);
    let nominal_hz = announced.map(|announcement| announcement.camera.frame_rate_hz);
    if heard.paused.contains(&robot) {
        notes.problem(&robot, "is paused", format!("team-leader query command {robot} resume"));
    } else if seen == 0 {
        notes.problem(
            &robot,
            "sends no observations",
            "does its camera or recording give frames? See its log and health",
        );
    } else if nominal_hz.is_some_and(|nominal| rate_hz < RATE_SHARE * nominal) {
        let what = format!("{rate_hz:.1} observations a second, nominally {:.1}", nominal_hz.unwrap_or_default());
        notes.warning(
            &robot,
            what,
            "a busy processor ([work] budget_ms), a capped link ([network] max_bytes_per_s) or a bad one",
        );
    } else {
        let tracks = heard.observations[&robot].last().map_or(0, |last| last.tracks.len());
        notes.fine(&robot, format!("{rate_hz:.1} observations a second, {tracks} tracks"));
    }
    match heard.healths.get(&robot) {
        Some(health) => of_health(health, notes),
        None => notes.warning(&robot, "no health report came", "it comes every two seconds; is the link full?"),
    }
}

fn of_health(health: &Health, notes: &mut Notes) {
    let robot = health.robot;
    let share = |part: u64, of: u64| part as f64 / of.max(1) as f64;
    if share(health.frames_dropped, health.frames) > LOST_SHARE {
        let what =
            format!("{} of {} frames dropped because a newer one was there", health.frames_dropped, health.frames);
        notes.warning(
            &robot,
            what,
            "the processor is too slow: a lower frame rate, fewer [work] panorama_columns, or a budget_ms",
        );
    }
    if health.frames_bad > 0 {
        let what = format!("{} frames could not be used", health.frames_bad);
        notes.warning(
            &robot,
            what,
            "the camera file is of another picture size, or the source is damaged; see its log",
        );
    }
    let sent: u64 = health.traffic.iter().map(|traffic| traffic.messages).sum();
    if share(health.messages_dropped, sent) > LOST_SHARE {
        let what = format!("{} messages dropped of {sent} sent", health.messages_dropped);
        notes.warning(
            &robot,
            what,
            "its link is full: a cap ([network] max_bytes_per_s), a lower frame rate, or fewer picture requests",
        );
    }
    if health.messages_refused > 0 {
        let what = format!("{} messages could not be read", health.messages_refused);
        notes.warning(&robot, what, "programs of different versions, or strangers; its log names the senders");
    }
    let [median_ms, p99_ms] = health.latency_ms;
    if health.frame_rate_hz > 0.0 && f64::from(p99_ms) > 2e3 / f64::from(health.frame_rate_hz) {
        let what = format!("{median_ms:.0} ms from capture to publication, {p99_ms:.0} ms at worst in a hundred");
        notes.warning(&robot, what, "stages wait for the processor: see [work] budget_ms");
    }
}

fn map(heard: &Heard, notes: &mut Notes) {
    let Some(map) = &heard.map else { return };
    let about = format!("team {}", heard.team);
    let explained = |word: &str| format!("calibration {word}: {}", map.explanation);
    match map.status {
        MapStatus::Converged => notes.fine(&about, format!("calibrated; {} people in the map", map.targets.len())),
        MapStatus::Waiting => notes.warning(&about, explained("waits"), "let two robots see each other; see who sees whom below"),
        MapStatus::Ambiguous => {
            notes.warning(&about, explained("is ambiguous"), "let a robot drive a little, or give markers a code");
        }
        MapStatus::Insufficient => {
            notes.warning(&about, explained("is incomplete"), "let the robots named see more of each other");
        }
        _ => notes.problem(
            &about,
            explained("contradicts itself"),
            "a marker's radius or height, a camera's height or tilt is not what its file says; see the differences below",
        ),
    }
    let believed = map.robots.iter().filter(|robot| robot.team_from_body.is_some() && !robot.verifiable);
    unverifiable(&believed.map(|robot| robot.id.as_str()).collect::<Vec<_>>(), notes);
    for robot in &map.robots {
        match robot.presence {
            Presence::Offline => notes.warning(&robot.id, "is offline", "it was here before; start its agent again"),
            Presence::Silent => notes.warning(&robot.id, "is silent: alive, but without observations", "see its log"),
            Presence::Online if robot.team_from_body.is_none() => {
                notes.warning(&robot.id, "has no place in the map", "nobody sees it, or it sees nobody; see below");
            }
            Presence::Online => {}
        }
        if robot.trust == Trust::SetAside {
            let cure = "its [mounting], its marker, or somebody who speaks for it: see the map's explanation";
            notes.warning(&robot.id, "what it sees contradicts the others; it is hardly used", cure);
        }
        match robot.clock_offset_s {
            Some((offset, sigma)) => {
                let (offset_s, sigma_s) = (f64::from(offset), f64::from(sigma));
                if offset_s.abs() > CLOCK_OFFSET_LIMIT_S {
                    let what = format!("its clock is {:.0} ms off (corrected)", 1e3 * offset_s);
                    notes.warning(&robot.id, what, "run chrony on it, with the leader's host as server");
                }
                if sigma_s > CLOCK_SIGMA_LIMIT_S {
                    let what = format!("its clock is known to {:.0} ms only", 1e3 * sigma_s);
                    notes.warning(&robot.id, what, "the link is slow in one direction or jitters; a better link");
                }
            }
            None if robot.presence == Presence::Online => {
                notes.warning(
                    &robot.id,
                    "its clock has not been measured",
                    "it answers no clock probes; is it very busy?",
                );
            }
            None => {}
        }
    }
}

/// Whoever has to be believed: no fault, but good to know where not everybody is trusted.
fn unverifiable(robots: &[&str], notes: &mut Notes) {
    if !robots.is_empty() {
        let what =
            "unverifiable: fewer than three other robots see each other, so false sightings could move the others";
        notes.fine(&robots.join(", "), what);
    }
}

fn pictures(heard: &Heard, notes: &mut Notes) {
    let mut sharp: Vec<f64> = heard.pictures.values().map(|figures| figures.sharpness).collect();
    sharp.sort_by(f64::total_cmp);
    let median = sharp.get(sharp.len() / 2).copied().unwrap_or_default();
    for (&robot, figures) in &heard.pictures {
        let PictureFigures { mean, clipped, sharpness } = *figures;
        if !(EXPOSURE_GRAY[0]..=EXPOSURE_GRAY[1]).contains(&mean) {
            let (word, cure) = if mean < EXPOSURE_GRAY[0] { ("dark", "longer") } else { ("bright", "shorter") };
            notes.warning(
                &robot,
                format!("its picture is too {word}: mean gray value {mean:.0}"),
                format!("expose {cure}"),
            );
        } else if clipped > CLIPPED_SHARE {
            let what = format!("{:.0} % of its picture is black or white", 1e2 * clipped);
            notes.warning(&robot, what, "the exposure, or a lamp or the robot itself in the picture: draw a [mask]");
        } else if sharp.len() > 1 && sharpness < SHARPNESS_SHARE * median {
            let what = format!("its picture is blurred: {sharpness:.2} beside {median:.2} in the team");
            notes.warning(&robot, what, "focus the lens, clean it");
        } else {
            notes.fine(
                &robot,
                format!("picture: mean gray {mean:.0}, {:.1} % clipped, sharpness {sharpness:.2}", 1e2 * clipped),
            );
        }
    }
}

/// Figures of a gray picture, row by row; `None` for one without pixels.
pub fn picture_figures(gray: &[u8], width: usize) -> Option<PictureFigures> {
    if width < 3 || gray.len() < width {
        return None;
    }
    let (mut first, mut second) = (0u64, 0u64);
    for row in gray.chunks_exact(width) {
        for three in row.windows(3) {
            let [a, b, c] = [three[0], three[1], three[2]].map(i32::from);
            first += u64::from((c - a).unsigned_abs());
            second += u64::from((a - 2 * b + c).unsigned_abs());
        }
    }
    let clipped = gray.iter().filter(|value| !(2..=253).contains(*value)).count();
    Some(PictureFigures {
        mean: gray.iter().map(|value| f64::from(*value)).sum::<f64>() / gray.len() as f64,
        clipped: clipped as f64 / gray.len() as f64,
        sharpness: second as f64 / (first as f64).max(1.0),
    })
}
