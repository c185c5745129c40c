//! Who sees whom, and whether what they see fits what was announced.
//!
//! A sighting without a name is given to the robot that the map has in that direction. At the map's distance the marker's edges show
//! its radius, its ends the height of the camera and the tilt: where these differ from what was announced, somebody measured wrong.

use std::collections::BTreeMap;

use protocol::angle::wrap;
use protocol::frames::Pose2;
use protocol::id::RobotId;
use protocol::message::PeerSighting;
use protocol::message::observation::FeaturePart;
use serde::Serialize;

use super::{Heard, Notes};

/// A sighting within this of where the map has a robot is of it, radians.
const SAME_DIRECTION_RAD: f64 = 0.09;
/// A radius that is off by this share is spoken of.
const RADIUS_SHARE: f64 = 0.1;
/// An elevation that is off by this is spoken of, degrees.
const ELEVATION_LIMIT_DEG: f64 = 0.5;
/// Sightings that a difference must rest on.
const MIN_SIGHTINGS: usize = 10;

/// One robot as another sees it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Sight {
    /// Who sees.
    pub observer: RobotId,
    /// Whom; null where neither marker nor map tells.
    pub peer: Option<RobotId>,
    /// In so many observations.
    pub sightings: usize,
    /// Radius of a cylinder from the width it shows at the map's distance, metres, median.
    pub radius_m: Option<f64>,
    /// Measured minus expected elevation of the marker's ends, degrees, median: an error of a camera's height or of the tilt towards it.
    pub elevation_error_deg: Option<f64>,
}

#[derive(Debug, Default)]
struct Looks {
    count: usize,
    radii_m: Vec<f64>,
    elevation_errors_deg: Vec<f64>,
}

/// All of them, by observer and peer.
pub fn sights(heard: &Heard) -> Vec<Sight> {
    let placed = heard.map.iter().flat_map(|map| &map.robots);
    let poses: BTreeMap<RobotId, (Pose2, u8)> =
        placed.filter_map(|robot| Some((robot.id, (robot.team_from_body?, robot.component)))).collect();
    let mut looks: BTreeMap<(RobotId, Option<RobotId>), Looks> = BTreeMap::new();
    for (observer, observations) in &heard.observations {
        for sighting in observations.iter().flat_map(|observation| &observation.sightings) {
            let peer = sighting.robot.or_else(|| in_direction(&poses, *observer, sighting.bearing.rad()));
            let look = looks.entry((*observer, peer)).or_default();
            look.count += 1;
            if let Some(peer) = peer {
                measure(heard, &poses, (*observer, peer), sighting, look);
            }
        }
    }
    let sight = |((observer, peer), look): ((RobotId, Option<RobotId>), Looks)| Sight {
        observer,
        peer,
        sightings: look.count,
        radius_m: median(look.radii_m),
        elevation_error_deg: median(look.elevation_errors_deg),
    };
    looks.into_iter().map(sight).collect()
}

fn in_direction(poses: &BTreeMap<RobotId, (Pose2, u8)>, observer: RobotId, bearing_rad: f64) -> Option<RobotId> {
    let (own, component) = poses.get(&observer)?;
    let off = |other: &Pose2| {
        let bearing = (other.y_m - own.y_m).atan2(other.x_m - own.x_m) - own.heading_rad;
        wrap(bearing - bearing_rad).abs()
    };
    let others = poses.iter().filter(|(id, (_, theirs))| **id != observer && theirs == component);
    let nearest = others.map(|(id, (pose, _))| (*id, off(pose))).min_by(|a, b| a.1.total_cmp(&b.1))?;
    (nearest.1 < SAME_DIRECTION_RAD).then_some(nearest.0)
}

fn measure(
    heard: &Heard,
    poses: &BTreeMap<RobotId, (Pose2, u8)>,
    (observer, peer): (RobotId, RobotId),
    sighting: &PeerSighting,
    look: &mut Looks,
) {
    let (Some((own, _)), Some((theirs, _))) = (poses.get(&observer), poses.get(&peer)) else { return };
    let distance_m = (theirs.x_m - own.x_m).hypot(theirs.y_m - own.y_m);
    let announced = |robot| heard.announcements.get(&robot).and_then(|all: &Vec<_>| all.last());
    let (Some(me), Some(them)) = (announced(observer), announced(peer)) else { return };
    let protocol::marker::Marker::Cylinder { radius_m, height_m, .. } = &them.marker else { return };
    let edge = |part| sighting.features.iter().find(|feature| feature.part == part);
    if let (Some(left), Some(right)) = (edge(FeaturePart::Left), edge(FeaturePart::Right)) {
        let half_rad = 0.5 * wrap(left.bearing.rad() - right.bearing.rad());
        look.radii_m.push(distance_m * half_rad.sin());
    }
    for (ends, _) in sighting.features.iter().filter_map(|feature| feature.elevation) {
        let near_m = (distance_m - radius_m).max(0.05);
        for (end, height_m) in ends.iter().zip(height_m) {
            let expected_rad = ((height_m - me.camera.height_m) / near_m).atan();
            look.elevation_errors_deg.push((end.rad() - expected_rad).to_degrees());
        }
    }
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    (values.len() >= MIN_SIGHTINGS).then(|| values[values.len() / 2])
}

/// Says who is blind, who is unseen, and what does not fit.
pub(super) fn judge(heard: &Heard, sees: &[Sight], notes: &mut Notes) {
    if heard.present.len() < 2 {
        return;
    }
    let unknown = sees.iter().any(|sight| sight.peer.is_none());
    for &robot in &heard.present {
        if !heard.observations.contains_key(&robot) {
            continue;
        }
        if !sees.iter().any(|sight| sight.observer == robot) {
            let cure =
                "is a fellow within 5 m and unhidden, does it wear the marker that it announces, is the mask right?";
            notes.warning(&robot, "sees no fellow robot", cure);
        } else if !unknown && !sees.iter().any(|sight| sight.peer == Some(robot)) {
            notes.warning(
                &robot,
                "no fellow robot sees it",
                "is it hidden, or does it wear another marker than it announces?",
            );
        }
    }
    for sight in sees {
        let Some(peer) = sight.peer else { continue };
        let announced = heard.announcements.get(&peer).and_then(|all| all.last()).map(|a| &a.marker);
        if let (Some(protocol::marker::Marker::Cylinder { radius_m, .. }), Some(seen_m)) = (announced, sight.radius_m)
            && (seen_m - radius_m).abs() > RADIUS_SHARE * radius_m
        {
            let what = format!(
                "its marker looks {seen_m:.3} m in radius to {}, and is announced as {radius_m:.3} m",
                sight.observer
            );
            notes.warning(&peer, what, "measure the marker; [robot] marker radius_m");
        }
        if let Some(off_deg) = sight.elevation_error_deg.filter(|off| off.abs() > ELEVATION_LIMIT_DEG) {
            let what = format!(
                "sees {peer} {:.1}° {} than it should",
                off_deg.abs(),
                if off_deg > 0.0 { "higher" } else { "lower" }
            );
            let cure = "its tilt or height in [mounting], or the marker's height_m, is not what the file says";
            notes.warning(&sight.observer, what, cure);
        }
    }
}
