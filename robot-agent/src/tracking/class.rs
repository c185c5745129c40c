//! What a track is: person, fellow robot or something else, from size, aspect ratio and the peer detector.

use protocol::message::{ObjectClass, PeerSighting};

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
    if at_peer && high < ROBOT_TOP_RAD {
        return ObjectClass::Robot;
    }
    // Whoever stands upright on the floor before a camera below the chin reaches above the horizon. What stays below is a
    // shadow, a chair, a robot that the peer detector did not find.
    let above_horizon = high > ROBOT_TOP_RAD;
    let upright = aspect > 1.0 || high > 0.25;
    if above_horizon && upright { ObjectClass::Person } else { ObjectClass::Other }
}
