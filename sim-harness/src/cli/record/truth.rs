//! A line of `truth.jsonl`.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::scenario::CameraSpec;
use crate::world::State;

/// The world at an instant, as written.
#[derive(Debug, Serialize)]
pub struct Line {
    time_s: f64,
    robots: Vec<RobotLine>,
    people: Vec<PersonLine>,
}

#[derive(Debug, Serialize)]
struct RobotLine {
    id: String,
    x_m: f64,
    y_m: f64,
    heading_deg: f64,
    tilt_deg: [f64; 2],
}

#[derive(Debug, Serialize)]
struct PersonLine {
    id: String,
    x_m: f64,
    y_m: f64,
    z_m: f64,
    height_m: f64,
    visible_fraction: BTreeMap<String, f64>,
}

/// `visible` gives the visible share of a person (second) to a robot (first).
pub fn line(state: &State, camera: &CameraSpec, visible: impl Fn(usize, usize) -> f64) -> Line {
    let round = |x: f64| (x * 1e6).round() / 1e6;
    let turn = |rad: f64| rad.to_degrees() - 360.0 * (rad.to_degrees() / 360.0).round();
    Line {
        time_s: round(state.time_s),
        robots: state
            .robots
            .iter()
            .map(|r| RobotLine {
                id: r.id.to_string(),
                x_m: round(r.x_m),
                y_m: round(r.y_m),
                heading_deg: round(turn(r.heading_rad)),
                tilt_deg: camera.tilt_deg(&r.id),
            })
            .collect(),
        people: state
            .people
            .iter()
            .enumerate()
            .map(|(n, p)| PersonLine {
                id: p.id.clone(),
                x_m: round(p.x_m),
                y_m: round(p.y_m),
                z_m: round(p.z_m),
                height_m: round(p.height_m),
                visible_fraction: state
                    .robots
                    .iter()
                    .enumerate()
                    .map(|(r, robot)| (robot.id.to_string(), round(visible(r, n))))
                    .collect(),
            })
            .collect(),
    }
}
