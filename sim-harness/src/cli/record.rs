//! `sim-harness record`: images and truth of a scenario as files, ready for one `robot-agent run` a robot.
//!
//! ```text
//! OUT/truth.jsonl               a line every 50 ms of true time from 0
//! OUT/markers.json              what the robots wear
//! OUT/leader.toml
//! OUT/{robot}/frames/NNNNNN.png
//! OUT/{robot}/frames/frames.csv file,capture_ns on the robot's own clock, counted from the team's common zero
//! OUT/{robot}/camera.toml
//! OUT/{robot}/agent.toml
//! ```

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use image::ImageEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use indicatif::ProgressBar;
use protocol::folder::make_writable;

use super::told::{note_short, scenario_help, tell};
use crate::parallel;
use crate::render::{Picture, Renderer};
use crate::scenario::{Scenario, ScenarioError};
use crate::world::robot::START_STAMP_S;
use crate::world::{World, WorldError};

mod config;
mod truth;

/// Time between two lines of truth.
const TRUTH_STEP_S: f64 = 0.05;

/// Arguments of `record`.
#[derive(Debug, Clone, clap::Args)]
pub struct RecordArgs {
    #[arg(help = scenario_help())]
    scenario: PathBuf,
    /// Folder to write to; made if it is not there
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Another seed than the scenario's
    #[arg(long)]
    seed: Option<u64>,
    /// Only the first seconds of the scenario
    #[arg(long, value_name = "SECONDS")]
    duration: Option<f64>,
    /// How to report: text or json
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

/// How a command reports.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Format {
    /// For people.
    Text,
    /// One JSON object.
    Json,
}

/// Why nothing was recorded.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The scenario.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// Its world.
    #[error("{scenario}: {source}")]
    World {
        /// Name of the scenario.
        scenario: String,
        /// Why.
        source: WorldError,
    },
    /// An option.
    #[error("--duration {0}: more than 0 seconds")]
    Duration(f64),
    /// No robot takes a picture in that time.
    #[error("{scenario}: no robot takes a picture in {duration_s} s; {right} would be right")]
    NoPicture {
        /// Name of the scenario.
        scenario: String,
        /// As given, or as the scenario has it.
        duration_s: f64,
        /// What would give one.
        right: String,
    },
    /// A file.
    #[error("cannot write {}: {source}", file.display())]
    Unwritable {
        /// Which.
        file: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A picture.
    #[error("cannot write {}: {source}", file.display())]
    Image {
        /// Which.
        file: PathBuf,
        /// Why.
        source: image::ImageError,
    },
}

/// Does it; gives the exit code.
#[allow(clippy::print_stderr)]
pub fn run(args: &RecordArgs) -> u8 {
    match record(args) {
        Ok(summary) => tell("record", &summary, 0),
        Err(error) => {
            eprintln!("sim-harness record: {error}");
            match error {
                RecordError::Unwritable { .. } | RecordError::Image { .. } => 1,
                _ => 2,
            }
        }
    }
}

fn record(args: &RecordArgs) -> Result<String, RecordError> {
    let scenario = Scenario::load(&args.scenario)?;
    let duration_s = match args.duration {
        Some(wanted) if wanted.is_nan() || wanted <= 0.0 => return Err(RecordError::Duration(wanted)),
        wanted => wanted.unwrap_or(f64::INFINITY).min(scenario.duration_s),
    };
    let seed = args.seed.unwrap_or(scenario.seed);
    let world =
        World::new(&scenario, seed).map_err(|source| RecordError::World { scenario: scenario.name.clone(), source })?;
    let world = Arc::new(world);
    let total: usize = world.robots().iter().map(|r| captures(r, duration_s).count()).sum();
    if total == 0 {
        let first = world.robots().iter().filter_map(|r| r.captures.first()).map(|c| c.true_time_s);
        let right = first.min_by(f64::total_cmp).map_or_else(
            || "a longer `duration_s` or a higher `capture.rate_hz`".to_owned(),
            |first_s| format!("--duration {:.3} or more", (1e3 * first_s).ceil() * 1e-3),
        );
        return Err(RecordError::NoPicture { scenario: scenario.name, duration_s, right });
    }
    note_short("record", args.duration, &scenario);
    let out = &args.out;
    make_writable(out).map_err(|source| RecordError::Unwritable { file: out.clone(), source })?;
    for robot in world.robots() {
        remove_frames(&out.join(robot.id.as_str()).join("frames"), captures(robot, duration_s).count())?;
    }
    write(&out.join("markers.json"), &json_lines([config::markers(&scenario)]))?;
    write(&out.join("leader.toml"), &config::leader_toml(world.robots().len()))?;
    let renderers = world.robots().iter().zip(Renderer::team(&world));
    let progress = ProgressBar::new(total as u64);
    let visible = parallel::map(parallel::processors(), renderers, |(robot, mut renderer)| {
        let folder = out.join(robot.id.as_str());
        make_folder(&folder.join("frames"))?;
        write(&folder.join("camera.toml"), scenario.camera_toml_of(&robot.id).as_bytes())?;
        write(&folder.join("agent.toml"), config::agent_toml(robot.id, robot.clock_offset_s, &scenario).as_bytes())?;
        let mut table = String::from("file,capture_ns\n");
        for (n, capture) in captures(robot, duration_s).enumerate() {
            let name = frame_name(n);
            let picture = renderer.render(capture.true_time_s);
            write_png(&folder.join("frames").join(&name), &picture)?;
            table.push_str(&format!("{name},{}\n", capture.stamp.0));
            progress.inc(1);
        }
        write(&folder.join("frames").join("frames.csv"), table.as_bytes())?;
        let ticks = (duration_s / TRUTH_STEP_S + 1e-9) as usize;
        Ok((0..=ticks).map(|i| renderer.visible_fraction(i as f64 * TRUTH_STEP_S)).collect())
    });
    progress.finish_and_clear();
    let visible: Vec<Vec<Vec<f64>>> = visible.into_iter().collect::<Result<_, RecordError>>()?;
    let lines = (0..visible.first().map_or(0, Vec::len)).map(|i| {
        let state = world.at(i as f64 * TRUTH_STEP_S);
        truth::line(&state, world.camera(), |robot, person| visible[robot][i][person])
    });
    write(&out.join("truth.jsonl"), &json_lines(lines))?;
    Ok(match args.format {
        Format::Text => format!(
            "{} with seed {seed}: {total} pictures of {} robots in {duration_s} s, truth every {TRUTH_STEP_S} s, in {}",
            scenario.name,
            world.robots().len(),
            out.display()
        ),
        Format::Json => serde_json::json!({
            "scenario": scenario.name, "seed": seed, "duration_s": duration_s, "pictures": total,
            "robots": world.robots().iter().map(|r| r.id.to_string()).collect::<Vec<_>>(),
            "out": out.display().to_string(), "start_stamp_s": START_STAMP_S,
        })
        .to_string(),
    })
}

fn captures(robot: &crate::world::Robot, duration_s: f64) -> impl Iterator<Item = &crate::world::Capture> {
    robot.captures.iter().take_while(move |c| c.true_time_s <= duration_s)
}

fn make_folder(folder: &Path) -> Result<(), RecordError> {
    fs::create_dir_all(folder).map_err(|source| RecordError::Unwritable { file: folder.to_owned(), source })
}

/// Removes the frames of an earlier, longer recording from number `from` on, and no other file: an agent would replay them, too.
fn remove_frames(frames: &Path, from: usize) -> Result<(), RecordError> {
    let Ok(entries) = fs::read_dir(frames) else { return Ok(()) };
    for file in entries.filter_map(|entry| Some(entry.ok()?.path())) {
        if file.file_name().and_then(|name| frame_number(name.to_str()?)).is_some_and(|number| number >= from) {
            fs::remove_file(&file).map_err(|source| RecordError::Unwritable { file, source })?;
        }
    }
    Ok(())
}

/// Name of a picture.
fn frame_name(number: usize) -> String {
    format!("{number:06}.png")
}

/// The number in a name of [`frame_name`]'s; `None` of every other.
fn frame_number(name: &str) -> Option<usize> {
    name.strip_suffix(".png")?.parse().ok().filter(|number| frame_name(*number) == name)
}

fn write(file: &Path, bytes: &[u8]) -> Result<(), RecordError> {
    fs::write(file, bytes).map_err(|source| RecordError::Unwritable { file: file.to_owned(), source })
}

fn write_png(file: &Path, picture: &Picture) -> Result<(), RecordError> {
    let unwritable = |source| RecordError::Unwritable { file: file.to_owned(), source };
    let mut out = std::io::BufWriter::new(fs::File::create(file).map_err(unwritable)?);
    PngEncoder::new_with_quality(&mut out, CompressionType::Fast, FilterType::Up)
        .write_image(&picture.gray, picture.width, picture.height, image::ExtendedColorType::L8)
        .map_err(|source| RecordError::Image { file: file.to_owned(), source })?;
    out.flush().map_err(unwritable)
}

fn json_lines<T: serde::Serialize>(values: impl IntoIterator<Item = T>) -> Vec<u8> {
    let mut out = Vec::new();
    for value in values {
        out.extend(serde_json::to_vec(&value).unwrap_or_default());
        out.push(b'\n');
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn args(out: &Path, seed: u64) -> RecordArgs {
        RecordArgs {
            scenario: "tiny".into(),
            out: out.to_owned(),
            seed: Some(seed),
            duration: Some(0.3),
            format: Format::Json,
        }
    }

    fn bytes(out: &Path) -> Vec<u8> {
        let mut all = fs::read(out.join("truth.jsonl")).unwrap();
        for file in ["r1/frames/frames.csv", "r1/frames/000001.png", "r2/frames/000000.png"] {
            all.extend(fs::read(out.join(file)).unwrap());
        }
        all
    }

    #[test]
    fn the_same_seed_gives_the_same_bytes_and_another_seed_others() {
        let folders = [(); 3].map(|()| tempfile::tempdir().unwrap());
        for (folder, seed) in folders.iter().zip([7, 7, 8]) {
            record(&args(folder.path(), seed)).unwrap();
        }
        let [a, b, c] = folders.map(|f| bytes(f.path()));
        assert!(a == b);
        assert!(a != c);
    }

    #[test]
    fn an_impossible_duration_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let args = RecordArgs { duration: Some(-1.0), ..args(folder.path(), 1) };
        assert!(record(&args).unwrap_err().to_string().contains("--duration -1"));
    }

    #[test]
    fn a_duration_without_a_picture_is_refused_before_anything_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let args = RecordArgs { duration: Some(1e-6), ..args(folder.path(), 1) };
        let error = record(&args).unwrap_err().to_string();
        assert!(error.contains("0.000001 s") && error.contains("--duration 0.0"), "{error}");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn a_shorter_recording_leaves_no_frame_of_a_longer_one_and_every_other_file() {
        let folder = tempfile::tempdir().unwrap();
        let frames = folder.path().join("r1/frames");
        fs::create_dir_all(&frames).unwrap();
        for name in ["000900.png", "900.png", "000900.png.bak", "notes.txt"] {
            fs::write(frames.join(name), b"").unwrap();
        }
        record(&args(folder.path(), 1)).unwrap();
        let table = fs::read_to_string(frames.join("frames.csv")).unwrap();
        let mut wanted: Vec<String> = table.lines().skip(1).map(|l| l.split(',').next().unwrap().to_owned()).collect();
        wanted.extend(["900.png", "000900.png.bak", "notes.txt", "frames.csv"].map(String::from));
        let mut found: Vec<String> =
            fs::read_dir(&frames).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        wanted.sort();
        found.sort();
        assert_eq!(found, wanted);
    }
}
