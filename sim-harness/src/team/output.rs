//! A run as files: `map.jsonl`, `truth.jsonl`, `scores.json`, what explains them (`errors.jsonl`, `observations.jsonl`), and
//! pictures. `time_s` is seconds since the scenario's start in all of them.

use std::fs::{File, create_dir_all, write};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use image::{GrayImage, ImageFormat};
use nalgebra::Matrix2;
use protocol::frames::Pose2;
use protocol::message::TeamMap;
use serde::Serialize;
use team_leader::picture::{Overlay, Trails, draw};
use team_leader::team_map::json::{EdgeJson, MapJson};

use super::diagnosis::diagnose;
use super::outcome::Scored;
use super::{Outcome, TeamError};
use crate::replay;

/// Between two lines of `truth.jsonl`, seconds.
const TRUTH_STEP_S: f64 = 0.05;
/// Size of the picture of the map.
const MAP_PX: [u32; 2] = [1100, 900];

/// Writes everything below `folder`, which is made where it is missing.
pub fn write_all(outcome: &Outcome, scored: &Scored, folder: &Path) -> Result<(), TeamError> {
    let at = |path: PathBuf, result: io::Result<()>| result.map_err(|source| TeamError::Output { path, source });
    at(folder.to_owned(), create_dir_all(folder))?;
    let file = |name: &str| folder.join(name);
    let maps = outcome.maps.iter().map(|map| {
        let mut json = MapJson::from(map);
        json.time_s = outcome.true_time_s(map.stamp);
        json
    });
    at(file("map.jsonl"), lines(&file("map.jsonl"), maps))?;
    at(file("edges.jsonl"), lines(&file("edges.jsonl"), &outcome.edges))?;
    at(file("truth.jsonl"), lines(&file("truth.jsonl"), truth(outcome)))?;
    at(file("errors.jsonl"), lines(&file("errors.jsonl"), &scored.errors))?;
    at(file("observations.jsonl"), lines(&file("observations.jsonl"), diagnose(outcome)))?;
    if !outcome.heard.is_empty() {
        replay::write(outcome, &file(replay::FILE))?;
    }
    write_json(&scored.scores, &file("scores.json"))?;
    for (kind, robot, bytes) in &outcome.pictures {
        let ending = if bytes.starts_with(&[0xff, 0xd8]) { "jpg" } else { "png" };
        let path = file(&format!("{robot}-{kind}.{ending}"));
        at(path.clone(), write(&path, bytes))?;
    }
    for (robot, frame) in &outcome.frames {
        let path = file(&format!("{robot}-pal.png"));
        let picture = GrayImage::from_raw(frame.width, frame.height, frame.gray.clone());
        let saved = picture.ok_or_else(|| io::Error::other("a frame of the wrong size"));
        let saved = saved.and_then(|p| p.save_with_format(&path, ImageFormat::Png).map_err(io::Error::other));
        at(path, saved)?;
    }
    if let Some(picture) = map_picture(outcome, scored) {
        let path = file("map.png");
        at(path.clone(), picture.save_with_format(&path, ImageFormat::Png).map_err(io::Error::other))?;
    }
    Ok(())
}

/// Writes one value as JSON for people; the folder is made where it is missing.
pub fn write_json<T: Serialize>(value: &T, path: &Path) -> Result<(), TeamError> {
    let folder = path.parent().map_or(Ok(()), create_dir_all);
    let text = folder.and_then(|()| serde_json::to_string_pretty(value).map_err(io::Error::other));
    text.and_then(|text| write(path, text + "\n")).map_err(|source| TeamError::Output { path: path.to_owned(), source })
}

fn lines<T: Serialize>(path: &Path, values: impl IntoIterator<Item = T>) -> io::Result<()> {
    let mut file = BufWriter::new(File::create(path)?);
    for value in values {
        serde_json::to_writer(&mut file, &value)?;
        file.write_all(b"\n")?;
    }
    file.flush()
}

/// The last map with the truth laid over; `None` without maps.
pub fn map_picture(outcome: &Outcome, scored: &Scored) -> Option<image::RgbImage> {
    let last = outcome.maps.last()?;
    let mut trails = Trails::default();
    outcome.maps.iter().for_each(|map| trails.record(map));
    let overlay = scored.scorer.room_from_team().map(|room_from_team| overlay(outcome, last, room_from_team));
    Some(draw(last, &trails, overlay.as_ref(), MAP_PX[0], MAP_PX[1]))
}

fn overlay(outcome: &Outcome, map: &TeamMap, room_from_team: Pose2) -> Overlay {
    let team_from_room = room_from_team.inverse();
    let point = |[x, y]: [f64; 2]| team_from_room.transform(nalgebra::Vector2::new(x, y)).into();
    let truth = outcome.truth().at(outcome.true_time_s(map.stamp));
    Overlay {
        outlines: outcome.world.outlines().into_iter().map(|(corners, _)| corners.map(point).to_vec()).collect(),
        robots: truth.robots.iter().map(|r| (r.id.to_string(), team_from_room * r.room_from_body)).collect(),
        people: truth.people.iter().map(|p| (p.id.clone(), point(p.position_m))).collect(),
        edges: outcome.edges.iter().map(placed).collect(),
    }
}

fn placed(edge: &EdgeJson) -> ([f64; 2], Matrix2<f64>) {
    let [[xx, xy], [_, yy]] = edge.covariance;
    ([edge.x_m, edge.y_m], Matrix2::new(xx, xy, xy, yy))
}

/// Walls and furniture from above.
#[derive(Serialize)]
struct TruthLine {
    time_s: f64,
    robots: Vec<RobotLine>,
    people: Vec<PersonLine>,
}

#[derive(Serialize)]
struct RobotLine {
    id: String,
    x_m: f64,
    y_m: f64,
    heading_deg: f64,
    tilt_deg: [f64; 2],
}

#[derive(Serialize)]
struct PersonLine {
    id: String,
    x_m: f64,
    y_m: f64,
    z_m: f64,
    height_m: f64,
    visible_fraction: std::collections::BTreeMap<String, f64>,
}

fn truth(outcome: &Outcome) -> impl Iterator<Item = TruthLine> + '_ {
    let steps = (outcome.duration_s / TRUTH_STEP_S + 1e-9) as usize;
    let keeper = outcome.truth();
    (0..=steps).map(move |step| {
        let time_s = step as f64 * TRUTH_STEP_S;
        let state = outcome.world.at(time_s);
        let seen = keeper.fractions(time_s);
        TruthLine {
            time_s,
            robots: state
                .robots
                .iter()
                .zip(&outcome.names)
                .map(|(robot, name)| RobotLine {
                    id: name.to_string(),
                    x_m: robot.x_m,
                    y_m: robot.y_m,
                    heading_deg: protocol::angle::wrap(robot.heading_rad).to_degrees(),
                    tilt_deg: outcome.world.camera().tilt_deg(&robot.id),
                })
                .collect(),
            people: state
                .people
                .iter()
                .enumerate()
                .map(|(n, person)| PersonLine {
                    id: person.id.clone(),
                    x_m: person.x_m,
                    y_m: person.y_m,
                    z_m: person.z_m,
                    height_m: person.height_m,
                    visible_fraction: outcome
                        .names
                        .iter()
                        .zip(&seen)
                        .filter_map(|(name, seen)| seen.get(n).map(|f| (name.to_string(), *f)))
                        .collect(),
                })
                .collect(),
        }
    })
}
