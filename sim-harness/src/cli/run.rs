//! `sim-harness run`: a scenario with agents and a leader, against truth.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use clap::{Args, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};
use protocol::folder::make_writable;
use protocol::id::RobotId;

use super::record::Format;
use super::told::{note_short, scenario_help, tell};
use super::{seeds, table};
use crate::parallel;
use crate::scenario::Scenario;
use crate::score::{Scores, Summary};
use crate::team::diagnosis::{diagnose, summary as diagnosis_summary};
use crate::team::outcome::Scored;
use crate::team::{Outcome, TeamError, TeamSettings, live, output, simulated};

/// Arguments of `run`.
#[derive(Debug, Clone, Args)]
pub struct RunArgs {
    /// A scenario file, or the name of a scenario inside the program
    #[arg(help = scenario_help())]
    pub scenario: PathBuf,
    /// How messages travel
    #[arg(long, value_enum, default_value_t = Transport::Zenoh)]
    pub transport: Transport,
    /// Another seed than the scenario's
    #[arg(long)]
    pub seed: Option<u64>,
    /// Several seeds, both ends included, e.g. 0..9, or a list, e.g. 1,3,7: mean and worst of each figure
    #[arg(long, value_name = "A..B", conflicts_with = "seed", value_parser = seeds::parse)]
    pub seeds: Option<seeds::Seeds>,
    /// Writes map.jsonl, edges.jsonl, truth.jsonl, scores.json, errors.jsonl, observations.jsonl, in virtual time leader.jsonl (for replay), and pictures there; with
    /// several seeds a folder each
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Only the first seconds of the scenario
    #[arg(long, value_name = "SECONDS")]
    pub duration: Option<f64>,
    /// A robot's agent gets this camera file instead of the scenario's, e.g. r1=r1/camera.toml; may be given for each robot
    #[arg(long, value_name = "ROBOT=FILE", value_parser = camera_of)]
    pub camera: Vec<(RobotId, PathBuf)>,
    /// Keeps rendered pictures in that folder (a byte a pixel, 0.8 GB a seed of the default scenario), and takes those of the same scenario and seed that
    /// are there: agents and leaders are tried again without rendering; in virtual time
    #[arg(long, value_name = "DIR")]
    pub pictures: Option<PathBuf>,
    /// Also says what each agent measured wrong, apart from the leader
    #[arg(long)]
    pub diagnose: bool,
    /// How to report
    #[arg(long, value_enum, default_value_t = Format::Text)]
    pub format: Format,
}

/// How messages travel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Transport {
    /// Zenoh sessions on loopback, in real time
    Zenoh,
    /// A simulated network in virtual time: same seed, same bytes
    Simulated,
}

/// Does it; gives the exit code.
#[allow(clippy::print_stderr)]
pub fn run(args: &RunArgs) -> u8 {
    match try_run(args) {
        Ok(text) => tell("run", &text, 0),
        Err(error) => {
            eprintln!("sim-harness run: {error}");
            exit_code(&error)
        }
    }
}

/// 2 for what the user gave, 1 for what failed.
pub(super) fn exit_code(error: &TeamError) -> u8 {
    match error {
        TeamError::Scenario(_)
        | TeamError::World(_)
        | TeamError::Camera(_)
        | TeamError::CameraSize { .. }
        | TeamError::Usage(_)
        | TeamError::Recording { .. } => 2,
        _ => 1,
    }
}

fn try_run(args: &RunArgs) -> Result<String, TeamError> {
    let scenario = Scenario::load(&args.scenario)?;
    let settings = TeamSettings {
        duration_s: checked_duration(args.duration)?,
        cameras: cameras(&args.camera, &scenario)?,
        pictures: pictures(args)?,
        ..TeamSettings::default()
    };
    note_short("run", args.duration, &scenario);
    if let Some(folder) = &args.out {
        writable(folder)?;
    }
    let Some(seeds) = &args.seeds else {
        let seed = args.seed.unwrap_or(scenario.seed);
        let bar = progress(settings.duration_s.unwrap_or(f64::INFINITY).min(scenario.duration_s));
        let outcome = one(&scenario, seed, args.transport, &settings, &|s| bar.set_position(s as u64))?;
        bar.finish_and_clear();
        let scored = outcome.score();
        if let Some(folder) = &args.out {
            output::write_all(&outcome, &scored, folder)?;
        }
        return report(args, &outcome, &scored);
    };
    let runs = many(&scenario, &seeds.0, args, &settings)?;
    let summary = Summary::new(runs).ok_or_else(|| TeamError::Usage("--seeds names no seed".to_owned()))?;
    if let Some(folder) = &args.out {
        output::write_json(&summary, &folder.join("scores.json"))?;
    }
    match args.format {
        Format::Json => json(&summary),
        Format::Text => Ok(table::summary(&summary)),
    }
}

/// `r1=FILE`.
fn camera_of(text: &str) -> Result<(RobotId, PathBuf), String> {
    let (robot, file) = text.split_once('=').ok_or("must be a robot and a file, as r1=camera.toml")?;
    Ok((RobotId::new(robot).map_err(|e| e.to_string())?, file.into()))
}

/// The texts of camera files that stand on the command line.
fn cameras(given: &[(RobotId, PathBuf)], scenario: &Scenario) -> Result<BTreeMap<RobotId, String>, TeamError> {
    let robots = scenario.robot_ids();
    let mut texts = BTreeMap::new();
    for (robot, path) in given {
        if !robots.contains(robot) {
            let names: Vec<String> = robots.iter().map(ToString::to_string).collect();
            return Err(TeamError::Usage(format!("--camera {robot}=…: the robots are {}", names.join(", "))));
        }
        let text = std::fs::read_to_string(path)
            .map_err(|e| TeamError::Usage(format!("--camera {robot}={}: cannot be read: {e}", path.display())))?;
        if texts.insert(*robot, text).is_some() {
            return Err(TeamError::Usage(format!("--camera {robot}=…: given twice")));
        }
    }
    Ok(texts)
}

/// The folder for pictures, made where it is not there.
fn pictures(args: &RunArgs) -> Result<Option<PathBuf>, TeamError> {
    let Some(folder) = &args.pictures else { return Ok(None) };
    if args.transport != Transport::Simulated {
        return Err(TeamError::Usage("--pictures: in virtual time only, with --transport simulated".to_owned()));
    }
    writable(folder)?;
    Ok(Some(folder.clone()))
}

/// A folder that results can be written to, before there are any.
pub(super) fn writable(folder: &Path) -> Result<(), TeamError> {
    make_writable(folder).map_err(|source| TeamError::Output { path: folder.to_owned(), source })
}

pub(super) fn checked_duration(duration_s: Option<f64>) -> Result<Option<f64>, TeamError> {
    match duration_s {
        Some(wanted) if wanted.is_nan() || wanted <= 0.0 => {
            Err(TeamError::Usage(format!("--duration {wanted}: more than 0 seconds")))
        }
        wanted => Ok(wanted),
    }
}

pub(super) fn one(
    scenario: &Scenario,
    seed: u64,
    transport: Transport,
    settings: &TeamSettings,
    progress: &(dyn Fn(f64) + Sync),
) -> Result<Outcome, TeamError> {
    match transport {
        Transport::Simulated => simulated::run(scenario, seed, settings, progress),
        Transport::Zenoh => live::run(scenario, seed, settings, progress),
    }
}

/// Several seeds: in virtual time as many at once as there are processors, in real time one after the other.
fn many(scenario: &Scenario, seeds: &[u64], args: &RunArgs, settings: &TeamSettings) -> Result<Vec<Scores>, TeamError> {
    let at_once = match args.transport {
        Transport::Zenoh => 1,
        Transport::Simulated => parallel::processors().min(seeds.len()),
    };
    let length_s = settings.duration_s.unwrap_or(f64::INFINITY).min(scenario.duration_s);
    let bar = progress(length_s * seeds.len() as f64);
    let results = parallel::map(at_once, seeds, |&seed| {
        let told = Mutex::new(0.0);
        let tell = |now_s: f64| {
            if let Ok(mut told) = told.lock() {
                bar.inc((now_s - *told) as u64);
                *told += (now_s - *told).floor();
            }
        };
        let outcome = one(scenario, seed, args.transport, settings, &tell)?;
        let scored = outcome.score();
        if let Some(folder) = &args.out {
            output::write_all(&outcome, &scored, &folder.join(format!("seed-{seed}")))?;
        }
        Ok(scored.scores)
    });
    bar.finish_and_clear();
    results.into_iter().collect()
}

pub(super) fn report(args: &RunArgs, outcome: &Outcome, scored: &Scored) -> Result<String, TeamError> {
    if args.format == Format::Json {
        return json(&scored.scores);
    }
    let mut text = text(outcome, scored, args.out.as_deref());
    if args.diagnose {
        text.push('\n');
        text.push_str(&diagnosis_summary(&diagnose(outcome)));
    }
    Ok(text)
}

/// The whole report of one run.
pub(super) fn text(outcome: &Outcome, scored: &Scored, out: Option<&Path>) -> String {
    let scores = &scored.scores;
    let mut text = table::scores(scores);
    text.push('\n');
    text.push_str(&table::bandwidth(&scores.bandwidth, &scores.video, outcome.names.len(), scores.modelled));
    text.push('\n');
    text.push_str(&table::remarks(outcome));
    if let Some(folder) = out {
        text.push_str(&format!("files: {}\n", folder.display()));
    }
    text
}

pub(super) fn json<T: serde::Serialize>(value: &T) -> Result<String, TeamError> {
    serde_json::to_string(value).map_err(|e| TeamError::Service(format!("the scores cannot be written: {e}")))
}

/// A bar over seconds of the scenario; invisible where standard error is no terminal.
pub(super) fn progress(length_s: f64) -> ProgressBar {
    let style = ProgressStyle::with_template("{bar:40} {pos}/{len} s of the scenario, {elapsed} elapsed");
    let bar = ProgressBar::new(length_s.ceil() as u64);
    if let Ok(style) = style { bar.with_style(style) } else { bar }
}
