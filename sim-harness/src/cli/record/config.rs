//! Configurations with which the recorded folders are replayed at once.

use protocol::id::RobotId;
use serde_json::Value;

use crate::scenario::Scenario;
use crate::world::robot::START_STAMP_S;

/// For the robot `id` beside its `camera.toml` and `frames`.
pub fn agent_toml(id: RobotId, clock_offset_s: f64, scenario: &Scenario) -> String {
    // The recording's zero on the clock that the robot had then: the replaying host has but one clock.
    let recording_start_ns = ((START_STAMP_S + clock_offset_s) * 1e9).round().max(0.0) as u64;
    let rate_hz = scenario.capture_of(&id).rate_hz;
    let marker = toml::Value::try_from(scenario.marker_of(&id)).map(|marker| marker.to_string()).unwrap_or_default();
    format!(
        "[robot]\nid = \"{id}\"\nteam = \"demo\"\ncamera = \"camera.toml\"\nmarker = {marker}\n\n[capture]\nsource = \"frames\"\nframe_rate_hz = {rate_hz:?}\nreplay_start = \"leader\"\nrecording_start = {recording_start_ns}\n"
    )
}

/// What the robots wear, for `robot-agent peers --markers`: one marker where all look alike, else one a robot with its name.
pub fn markers(scenario: &Scenario) -> Value {
    let of = |id: &RobotId| serde_json::to_value(scenario.marker_of(id)).unwrap_or_default();
    let ids = scenario.robot_ids();
    match ids.first() {
        Some(first) if scenario.robots.wear.is_empty() => of(first),
        _ => Value::Array(ids.iter().map(|id| with_name(of(id), id)).collect()),
    }
}

fn with_name(mut marker: Value, id: &RobotId) -> Value {
    if let Some(marker) = marker.as_object_mut() {
        marker.insert("robot".to_owned(), Value::String(id.to_string()));
    }
    marker
}

/// For a leader that starts the replay when all robots have joined.
pub fn leader_toml(robots: usize) -> Vec<u8> {
    format!("[leader]\nid = \"l1\"\nteam = \"demo\"\n\n[replay]\nrobots = {robots}\n").into_bytes()
}
