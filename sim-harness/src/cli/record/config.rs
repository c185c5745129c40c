//! Configurations with which the recorded folders are replayed at once.

use protocol::marker::Marker;

use crate::scenario::Scenario;
use crate::world::robot::START_STAMP_S;

/// For the robot `id` beside its `camera.toml` and `frames`.
pub fn agent_toml(id: &str, clock_offset_s: f64, scenario: &Scenario) -> String {
    // The recording's zero on the clock that the robot had then: the replaying host has but one clock.
    let recording_start_ns = ((START_STAMP_S + clock_offset_s) * 1e9).round().max(0.0) as u64;
    let marker = match scenario.marker() {
        Marker::Cylinder { radius_m, height_m: [low, high], look } => {
            let rings: Vec<String> = look
                .iter()
                .flat_map(|l| &l.rings)
                .map(|r| {
                    format!(
                        "{{ height_m = [{:?}, {:?}], reflectance = {:?} }}",
                        r.height_m[0], r.height_m[1], r.reflectance
                    )
                })
                .collect();
            format!(
                "{{ kind = \"cylinder\", radius_m = {radius_m:?}, height_m = [{low:?}, {high:?}], look = {{ rings = [{}] }} }}",
                rings.join(", ")
            )
        }
        other => format!("{other:?}"),
    };
    format!(
        "[robot]\nid = \"{id}\"\nteam = \"demo\"\ncamera = \"camera.toml\"\nmarker = {marker}\n\n[capture]\nsource = \"frames\"\nreplay_start = \"leader\"\nrecording_start = {recording_start_ns}\n"
    )
}

/// For a leader that starts the replay when all robots have joined.
pub fn leader_toml(robots: usize) -> Vec<u8> {
    format!("[leader]\nid = \"l1\"\nteam = \"demo\"\n\n[replay]\nrobots = {robots}\n").into_bytes()
}
