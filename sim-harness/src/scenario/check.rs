//! Ranges of a scenario's values.

use protocol::id::RobotId;

use super::{EyeSpec, Scenario};
use crate::world::body::RADIUS_M;

/// A camera's lengths in glass, mm.
const GLASS_MM: [f64; 2] = [0.1, 1000.0];

/// A value that is not possible.
pub(super) struct Fault {
    pub key: String,
    pub value: String,
    pub right: String,
}

fn within(key: &str, value: f64, low: f64, high: f64, unit: &str) -> Result<(), Fault> {
    if value >= low && value <= high {
        return Ok(());
    }
    Err(Fault { key: key.into(), value: value.to_string(), right: format!("{low} to {high} {unit}").trim_end().into() })
}

fn count(key: &str, value: usize, low: usize, high: usize) -> Result<(), Fault> {
    within(key, value as f64, low as f64, high as f64, "")
}

pub(super) fn check(s: &Scenario) -> Result<(), Fault> {
    within("duration_s", s.duration_s, 0.1, 3600.0, "seconds")?;
    let [x, y, z] = s.room.size_m;
    within("room.size_m[0]", x, 2.0, 30.0, "metres")?;
    within("room.size_m[1]", y, 2.0, 30.0, "metres")?;
    within("room.size_m[2]", z, 2.0, 6.0, "metres")?;
    within("room.ambient", s.room.ambient, 0.0, 10.0, "")?;
    light("room.ambient_light", &s.room.ambient_light, 0.01)?;
    count("room.lamps (their number)", s.room.lamps.len(), 1, crate::world::MAX_LAMPS)?;
    for (n, lamp) in s.room.lamps.iter().enumerate() {
        within(&format!("room.lamps[{n}].position_m[0]"), lamp.position_m[0], -x / 2.0, x / 2.0, "metres")?;
        within(&format!("room.lamps[{n}].position_m[1]"), lamp.position_m[1], -y / 2.0, y / 2.0, "metres")?;
        within(&format!("room.lamps[{n}].power"), lamp.power, 0.0, 100.0, "")?;
        within(&format!("room.lamps[{n}].flicker"), lamp.flicker, 0.0, 0.5, "")?;
        light(&format!("room.lamps[{n}].light"), &lamp.light, 0.0)?;
    }
    count("room.furniture (its number)", s.room.furniture.len(), 0, 64)?;
    for (n, piece) in s.room.furniture.iter().enumerate() {
        let key = format!("room.furniture[{n}]");
        within(&format!("{key}.position_m[0]"), piece.position_m[0], -x / 2.0, x / 2.0, "metres")?;
        within(&format!("{key}.position_m[1]"), piece.position_m[1], -y / 2.0, y / 2.0, "metres")?;
        within(&format!("{key}.yaw_deg"), piece.yaw_deg, -360.0, 360.0, "degrees")?;
        for size in piece.size_m.unwrap_or([1.0; 3]) {
            within(&format!("{key}.size_m"), size, 0.0, 10.0, "metres")?;
        }
    }
    robots(s)?;
    count("people.count", s.people.count, 0, 16)?;
    within("people.height_m", s.people.height_m[0], 1.0, 2.2, "metres")?;
    within("people.height_m", s.people.height_m[1], s.people.height_m[0], 2.2, "metres")?;
    within("people.speed_mps", s.people.speed_mps, 0.1, 3.0, "metres a second")?;
    within("people.stop_s", s.people.stop_s, 0.0, 3600.0, "seconds")?;
    count("people.camouflaged", s.people.camouflaged, 0, s.people.count)?;
    count("people.standing (their number)", s.people.standing.len(), 0, s.people.count)?;
    for (n, place) in s.people.standing.iter().enumerate() {
        in_room(s, &format!("people.standing[{n}]"), *place)?;
    }
    ways(s)?;
    within("capture.rate_hz", s.capture.rate_hz, 0.1, 100.0, "Hz")?;
    within("capture.jitter_ms", s.capture.jitter_ms, 0.0, 400.0 / s.capture.rate_hz, "milliseconds")?;
    within("capture.clock_offset_ms", s.capture.clock_offset_ms, 0.0, 900.0, "milliseconds")?;
    camera(s)
}

/// A place on the floor.
fn in_room(s: &Scenario, key: &str, place_m: [f64; 2]) -> Result<(), Fault> {
    for (k, (place, size)) in place_m.into_iter().zip(s.room.size_m).enumerate() {
        within(&format!("{key}[{k}]"), place, -size / 2.0, size / 2.0, "metres (in the room)")?;
    }
    Ok(())
}

/// Later than the point before.
fn later(key: &str, time_s: f64, before_s: Option<f64>) -> Result<(), Fault> {
    within(key, time_s, -60.0, 3600.0, "seconds")?;
    if before_s.is_none_or(|before| time_s > before) {
        return Ok(());
    }
    Err(Fault { key: key.into(), value: time_s.to_string(), right: "a time later than the one before".into() })
}

fn light(key: &str, points: &[[f64; 2]], least: f64) -> Result<(), Fault> {
    for (n, [time_s, share]) in points.iter().enumerate() {
        let key = format!("{key}[{n}]");
        later(&key, *time_s, n.checked_sub(1).map(|n| points[n][0]))?;
        within(&key, *share, least, 10.0, "")?;
    }
    Ok(())
}

fn ways(s: &Scenario) -> Result<(), Fault> {
    let (ways, people) = (&s.people.ways, s.people.count);
    if !ways.is_empty() && (ways.len() != people || !s.people.standing.is_empty()) {
        let right = format!("one for each of the {people} people, and none of them in people.standing");
        return Err(Fault { key: "people.ways (their number)".into(), value: ways.len().to_string(), right });
    }
    for (n, way) in ways.iter().enumerate() {
        count(&format!("people.ways[{n}] (its points)"), way.len(), 1, 10_000)?;
        for (i, [time_s, x, y]) in way.iter().enumerate() {
            let key = format!("people.ways[{n}][{i}]");
            later(&key, *time_s, i.checked_sub(1).map(|i| way[i][0]))?;
            for (place, size) in [(x, s.room.size_m[0]), (y, s.room.size_m[1])] {
                within(&key, *place, -size / 2.0, size / 2.0, "metres")?;
            }
        }
    }
    Ok(())
}

fn robots(s: &Scenario) -> Result<(), Fault> {
    count("robots.count", s.robots.count, 1, 16)?;
    count("robots.poses (their number)", s.robots.poses.len(), 0, s.robots.count)?;
    poses(s)?;
    within("robots.apart_m", s.robots.apart_m, 0.5, 10.0, "metres")?;
    within("robots.within_m", s.robots.within_m, s.robots.apart_m, 50.0, "metres")?;
    for (n, drive) in s.robots.drives.iter().enumerate() {
        let key = format!("robots.drives[{n}]");
        known_robot(s, &key, &drive.robot)?;
        within(&format!("{key}.start_s"), drive.start_s, -60.0, s.duration_s, "seconds")?;
        within(&format!("{key}.end_s"), drive.end_s, drive.start_s + 0.5, 3600.0, "seconds")?;
        within(&format!("{key}.distance_m"), drive.distance_m, 0.0, 6.0, "metres")?;
        within(&format!("{key}.turn_deg"), drive.turn_deg, -360.0, 360.0, "degrees")?;
    }
    for (n, wear) in s.robots.wear.iter().enumerate() {
        let key = format!("robots.wear[{n}]");
        known_robot(s, &key, &wear.robot)?;
        if let super::WearSpec::Plate { width_m, left_edge_m, behind_m } = &wear.marker {
            within(&format!("{key}.marker.width_m"), *width_m, 0.05, 1.0, "metres")?;
            within(&format!("{key}.marker.left_edge_m"), *left_edge_m, 0.0, *width_m, "metres")?;
            within(&format!("{key}.marker.behind_m"), *behind_m, 0.03, 0.3, "metres (before the mast)")?;
        }
        if let Err(fault) = wear.marker().validate() {
            let right = "a marker that can be announced".to_owned();
            return Err(Fault { key: format!("{key}.marker"), value: fault.to_string(), right });
        }
    }
    Ok(())
}

/// In the room, and no two bodies in one place.
fn poses(s: &Scenario) -> Result<(), Fault> {
    for (n, [x, y, heading_deg]) in s.robots.poses.iter().enumerate() {
        let key = format!("robots.poses[{n}]");
        in_room(s, &key, [*x, *y])?;
        within(&format!("{key}[2]"), *heading_deg, -360.0, 360.0, "degrees")?;
        let near = s.robots.poses[..n].iter().position(|[a, b, _]| (a - x).hypot(b - y) < 2.0 * RADIUS_M);
        if let Some(other) = near {
            let right = format!("a place at least {} m from robots.poses[{other}]: bodies are so wide", 2.0 * RADIUS_M);
            return Err(Fault { key, value: format!("[{x}, {y}, {heading_deg}]"), right });
        }
    }
    Ok(())
}

fn camera(s: &Scenario) -> Result<(), Fault> {
    let c = &s.camera;
    for side in c.image_size_px {
        within("camera.image_size_px", f64::from(side), 64.0, 2048.0, "pixels")?;
    }
    let [thin, thick] = GLASS_MM;
    within("camera.ellipsoid_a_mm", c.ellipsoid_a_mm, thin, thick, "mm")?;
    within("camera.ellipsoid_c_mm", c.ellipsoid_c_mm, 0.01, c.ellipsoid_a_mm * 0.999, "mm (below ellipsoid_a_mm)")?;
    within("camera.hyperboloid_c_mm", c.hyperboloid_c_mm, thin, thick, "mm")?;
    within(
        "camera.hyperboloid_a_mm",
        c.hyperboloid_a_mm,
        0.01,
        c.hyperboloid_c_mm * 0.999,
        "mm (below hyperboloid_c_mm)",
    )?;
    within("camera.focal_length_px", c.focal_length_px, 1.0, 1e5, "pixels")?;
    within("camera.refraction_a_mm", c.refraction_a_mm, thin, thick, "mm")?;
    within("camera.refraction_eccentricity", c.refraction_eccentricity, 0.0, 0.99, "")?;
    within("camera.refractive_index", c.refractive_index, 1.0, 3.0, "")?;
    for (k, (centre, side)) in c.centre_px.into_iter().zip(c.image_size_px).enumerate() {
        within(&format!("camera.centre_px[{k}]"), centre, 0.0, f64::from(side) - 1.0, "pixels (in the picture)")?;
    }
    within("camera.elevation_deg[1]", c.elevation_deg[1], -59.0, 80.0, "degrees")?;
    within("camera.elevation_deg[0]", c.elevation_deg[0], -60.0, c.elevation_deg[1] - 1.0, "degrees")?;
    within("camera.height_m", c.height_m, 0.52, 2.0, "metres (above the body)")?;
    within("camera.noise_gray", c.noise_gray, 0.0, 50.0, "grey levels")?;
    within("camera.blur_px", c.blur_px, 0.0, 2.0, "pixels")?;
    for (n, tilt) in c.tilts.iter().enumerate() {
        let key = format!("camera.tilts[{n}]");
        known_robot(s, &key, &tilt.robot)?;
        if c.tilts[..n].iter().any(|other| other.robot == tilt.robot) {
            let right = "each robot at most once".into();
            return Err(Fault { key: format!("{key}.robot"), value: tilt.robot.to_string(), right });
        }
        for angle in tilt.tilt_deg {
            within(&format!("{key}.tilt_deg"), angle, -10.0, 10.0, "degrees")?;
        }
    }
    others(s)
}

fn others(s: &Scenario) -> Result<(), Fault> {
    let others = &s.camera.others;
    for (n, other) in others.iter().enumerate() {
        let key = format!("camera.others[{n}]");
        known_robot(s, &key, &other.robot)?;
        let robot_fault = |right: &str| {
            Err(Fault { key: format!("{key}.robot"), value: other.robot.to_string(), right: right.to_owned() })
        };
        if others[..n].iter().any(|o| o.robot == other.robot) {
            return robot_fault("each robot at most once");
        }
        if s.camera.tilts.iter().any(|t| t.robot == other.robot) {
            return robot_fault("a robot without camera.tilts: only a PAL can be tilted");
        }
        let key = format!("{key}.camera");
        match other.camera {
            EyeSpec::Pinhole { image_size_px, field_deg } => {
                if s.robots.drives.iter().any(|d| d.robot == other.robot) {
                    return robot_fault("a robot that stands: one that looks one way loses the others when it drives");
                }
                size(&key, image_size_px)?;
                within(&format!("{key}.field_deg"), field_deg, 20.0, 120.0, "degrees")?;
            }
            EyeSpec::Rotating { image_size_px, turn_s, elevation_deg: [low, high] } => {
                size(&key, image_size_px)?;
                within(&format!("{key}.turn_s"), turn_s, 0.02, 10.0, "seconds")?;
                within(&format!("{key}.elevation_deg[1]"), high, -59.0, 60.0, "degrees")?;
                within(&format!("{key}.elevation_deg[0]"), low, -60.0, high - 1.0, "degrees")?;
            }
            EyeSpec::Zoo { specimen } => {
                let kind = match specimen.specimen().model {
                    "pinhole" => "pinhole",
                    "mosaic" => "rotating",
                    _ => continue,
                };
                let right = format!("a camera that sees all round at once; for this one there is kind = \"{kind}\"");
                return Err(Fault { key: format!("{key}.specimen"), value: String::from(specimen), right });
            }
        }
    }
    Ok(())
}

fn size(key: &str, image_size_px: [u32; 2]) -> Result<(), Fault> {
    image_size_px
        .into_iter()
        .try_for_each(|side| within(&format!("{key}.image_size_px"), f64::from(side), 64.0, 4096.0, "pixels"))
}

fn known_robot(s: &Scenario, key: &str, robot: &RobotId) -> Result<(), Fault> {
    if s.robot_ids().contains(robot) {
        return Ok(());
    }
    let names = s.robot_ids().iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
    Err(Fault { key: format!("{key}.robot"), value: robot.to_string(), right: names })
}
