//! What a track is: person, fellow robot or something else, from size, aspect ratio and the peer detector.

use protocol::message::{ElevationEnd, ObjectClass, PeerSighting};

use super::extent::Extent;
use super::view::View;

/// Where the peer detector sees a fellow robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PeerBearing {
    /// To its axis, radians.
    pub bearing_rad: f64,
    /// Half of its angular width, radians.
    pub half_width_rad: f64,
}

impl PeerBearing {
    /// Where the tracker should expect a robot, not a person.
    pub fn of(sighting: &PeerSighting) -> Self {
        /// Half width where no edges were measured: a robot of 0.2 m radius at 2 m.
        const DEFAULT_HALF_WIDTH_RAD: f64 = 0.1;
        let bearing_rad = sighting.bearing.rad();
        let half_width = sighting
            .features
            .iter()
            .map(|feature| protocol::angle::difference(feature.bearing.rad(), bearing_rad).abs())
            .fold(0.0, f64::max);
        let half_width_rad = if half_width > 0.0 { half_width } else { DEFAULT_HALF_WIDTH_RAD };
        Self { bearing_rad, half_width_rad }
    }
}

/// Votes of the frames so far.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Votes {
    person: f64,
    robot: f64,
    other: f64,
}

/// Older votes fade: a class is decided by about the last second.
const FADE: f64 = 0.9;
/// Robots are low: their bodies end at most this much above the horizon (their masts are too thin to matter).
const ROBOT_TOP_RAD: f64 = 0.05;
/// What is lower is nobody, metres.
const LEAST_TOP_M: f64 = 1.1;

impl Votes {
    pub(super) fn add(&mut self, class: ObjectClass) {
        self.person *= FADE;
        self.robot *= FADE;
        self.other *= FADE;
        match class {
            ObjectClass::Person => self.person += 1.0,
            ObjectClass::Robot => self.robot += 1.0,
            ObjectClass::Other | ObjectClass::Swaying => self.other += 1.0,
            ObjectClass::Unknown => {}
        }
    }

    pub(super) fn winner(&self) -> ObjectClass {
        let most = self.person.max(self.robot).max(self.other);
        if most < 1.5 {
            ObjectClass::Unknown
        } else if self.robot == most {
            ObjectClass::Robot
        } else if self.person == most {
            ObjectClass::Person
        } else {
            ObjectClass::Other
        }
    }
}

/// The class of one sight of a body that is `width_rad` wide.
pub(super) fn of_one_sight(
    bearing_rad: f64,
    width_rad: f64,
    extent: &Extent,
    view: &View,
    peers: &[PeerBearing],
) -> ObjectClass {
    let [low, high] = extent.elevation_rad;
    let aspect = (high - low) / width_rad.max(1e-6);
    if !view.is_panoramic() {
        return if aspect > 1.2 { ObjectClass::Person } else { ObjectClass::Other };
    }
    let at_peer = peers.iter().any(|p| {
        protocol::angle::difference(bearing_rad, p.bearing_rad).abs() < p.half_width_rad + 0.5 * width_rad.min(0.2)
    });
    let least_top_rad = least_top_of_people_rad(view.height_m.map(|(camera_m, _)| camera_m), low);
    if at_peer && high < least_top_rad {
        return ObjectClass::Robot;
    }
    // Whoever stands upright on the floor before a camera below the chin reaches above the horizon. What stays below is a
    // shadow, a chair, a robot that the peer detector did not find.
    let upright = aspect > 1.0 || high > 0.25;
    // Who goes on where the camera sees nothing may be as high as anybody.
    let cut = extent.ends[1] == ElevationEnd::Cut;
    match (upright, high > least_top_rad || cut) {
        (true, true) => ObjectClass::Person,
        (false, _) if cut => ObjectClass::Unknown,
        _ => ObjectClass::Other,
    }
}

/// Elevation that people reach who stand on the floor, whatever else is lower; `low_rad`: of somebody's lower end. Before a camera
/// below their hips that is the horizon and a little more, before a higher one it depends on how far away they are.
fn least_top_of_people_rad(camera_m: Option<f64>, low_rad: f64) -> f64 {
    /// Where the floor is not seen under somebody, he is taken to be as far away as this, metres.
    const USUAL_RANGE_M: f64 = 3.0;
    let Some(camera_m) = camera_m else { return ROBOT_TOP_RAD };
    let down = -low_rad.tan();
    let range_m = if down > 0.05 { camera_m / down } else { USUAL_RANGE_M };
    ((LEAST_TOP_M - camera_m) / range_m).atan().min(ROBOT_TOP_RAD)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_child_before_a_camera_at_eye_level_is_somebody_and_a_chair_is_not() {
        for camera_m in [0.3, 0.6, 1.0, 1.5] {
            for range_m in [1.0, 2.0, 4.0, 6.0] {
                let elevation = |z_m: f64| ((z_m - camera_m) / range_m).atan();
                let least = least_top_of_people_rad(Some(camera_m), elevation(0.0));
                assert!(elevation(1.4) > least, "camera {camera_m} m, {range_m} m");
                assert!(elevation(0.6_f64.min(camera_m)) < least, "camera {camera_m} m, {range_m} m");
            }
        }
    }
}
