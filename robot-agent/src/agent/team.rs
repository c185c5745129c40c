//! What an agent knows of its fellows: what they look like, and whether somebody else uses its name.

use std::collections::BTreeMap;

use protocol::id::RobotId;
use protocol::marker::Marker;
use protocol::message::Announcement;
use protocol::message::map::MAX_ROBOTS;

/// Most different looks that are searched for: each costs one search a frame.
pub const MAX_LOOKS: usize = 4;
/// Most sessions under the own name that are told of.
const MAX_DOUBLES: usize = 16;

/// The fellows.
#[derive(Debug)]
pub struct Team {
    own: RobotId,
    markers: BTreeMap<RobotId, Marker>,
    doubles: Vec<u64>,
}

impl Team {
    /// Nobody is known yet.
    pub fn new(own: RobotId) -> Self {
        Self { own, markers: BTreeMap::new(), doubles: Vec::new() }
    }

    /// Takes an announcement; a notice if it is of another session under the own name (once a session).
    pub fn meet(&mut self, epoch: u64, host: &str, other: &Announcement) -> Option<String> {
        if other.robot != self.own {
            if self.markers.len() < MAX_ROBOTS || self.markers.contains_key(&other.robot) {
                self.markers.insert(other.robot, other.marker.clone());
            }
            return None;
        }
        if other.epoch == epoch || self.doubles.contains(&other.epoch) || self.doubles.len() >= MAX_DOUBLES {
            return None;
        }
        self.doubles.push(other.epoch);
        Some(format!(
            "two sessions use the robot id {}: this one (epoch {epoch:016x}, host {host}) and one of epoch {:016x} on host {}; \
             if that one still runs, give one of them another id",
            self.own, other.epoch, other.host
        ))
    }

    /// The different looks of the fellows, in the order of their names; at most [`MAX_LOOKS`]. The own look stands for
    /// all fellows until one is known.
    /// Bars and lamps come with the name of who wears them.
    pub fn looks(&self) -> Vec<(Option<RobotId>, Marker)> {
        let mut looks: Vec<(Option<RobotId>, Marker)> = Vec::new();
        let mut nameless = 0;
        for (robot, marker) in &self.markers {
            let tells_name = matches!(marker, Marker::Bars { .. }) || marker.beacon().is_some();
            let look = (tells_name.then_some(*robot), marker.clone());
            if !looks.contains(&look) && (tells_name || nameless < MAX_LOOKS) {
                nameless += usize::from(!tells_name);
                looks.push(look);
            }
        }
        looks
    }
}

#[cfg(test)]
mod tests {
    use protocol::message::CameraSummary;

    use super::*;

    #[test]
    fn another_session_under_the_own_name_is_told_once_with_both_hosts() {
        let mut team = Team::new(RobotId::new("r1").unwrap());
        let notice = team.meet(1, "here", &announcement("r1", 2, 0.2)).unwrap();
        for part in ["r1", "host here", "host there", "0000000000000001", "0000000000000002"] {
            assert!(notice.contains(part), "{part} is missing in {notice}");
        }
        assert_eq!(team.meet(1, "here", &announcement("r1", 2, 0.2)), None);
        assert_eq!(team.meet(1, "here", &announcement("r1", 1, 0.2)), None, "one's own announcement comes back");
    }

    #[test]
    fn robots_of_one_look_are_searched_for_once() {
        let mut team = Team::new(RobotId::new("r1").unwrap());
        for (id, radius) in [("r2", 0.2), ("r3", 0.2), ("r4", 0.3)] {
            assert_eq!(team.meet(1, "here", &announcement(id, 7, radius)), None);
        }
        assert_eq!(team.looks().len(), 2);
    }

    fn announcement(id: &str, epoch: u64, radius_m: f64) -> Announcement {
        let camera = CameraSummary {
            model: "pal".to_owned(),
            height_m: 0.6,
            height_sigma_m: 0.0,
            tilt_sigma_rad: 0.0,
            elevation_rad: [-0.2, 0.3],
            frame_rate_hz: 10.0,
        };
        Announcement {
            robot: RobotId::new(id).unwrap(),
            epoch,
            host: "there".to_owned(),
            version: "0.1.0".to_owned(),
            marker: Marker::Cylinder { radius_m, height_m: [0.1, 0.5], look: None },
            camera,
        }
    }
}
