//! Fellow robots as witnesses that this one stands.
//!
//! The motion stage tells own motion by the sectors of the picture that stay. A camera that looks one way has few, and somebody
//! near covers them all: then nothing in the picture stays and the robot seems to drive. But a fellow robot is measured to
//! millimetres: who sees one where it has been for a second has not moved, whatever else is in the picture.
//! (That another one drives so that it stays in place while both move is not believed.)

use protocol::angle::difference;
use protocol::message::PeerSighting;
use protocol::time::Timestamp;

/// A fellow must have been in one place for so long, seconds: who drives at 2 cm/s is beyond the sigmas of one 3 m away by then.
const LEAST_S: f64 = 1.0;
/// Who has not been seen for so long is no witness any more, seconds.
const MEMORY_S: f64 = 5.0;
/// Sigmas within which a place is the same.
const SIGMAS: f64 = 4.0;
/// Places that are remembered.
const MOST: usize = 16;

/// Where fellows were.
#[derive(Debug, Clone, Default)]
pub struct Witnesses {
    places: Vec<Place>,
}

#[derive(Debug, Clone, Copy)]
struct Place {
    bearing: [f64; 2],
    range: [f64; 2],
    since: Timestamp,
    seen: Timestamp,
}

impl Witnesses {
    /// Takes the sightings of a frame; whether one of them shows that the robot stands.
    pub fn show_standing(&mut self, sightings: &[PeerSighting], capture: Timestamp) -> bool {
        self.places.retain(|p| (0.0..MEMORY_S).contains(&capture.seconds_since(p.seen)));
        let mut stands = false;
        for sighting in sightings {
            let Some(range) = sighting.range else { continue };
            let bearing = [sighting.bearing.rad(), sighting.bearing_sigma.value()];
            let range = [range.range.m(), range.sigma.value()];
            let has_room = self.places.len() < MOST;
            match self.places.iter_mut().find(|p| p.is_at(bearing, range)) {
                // The place stays what it was at first, so that a slow drive leaves it.
                Some(place) => {
                    place.seen = capture;
                    stands |= capture.seconds_since(place.since) >= LEAST_S;
                }
                None if has_room => {
                    self.places.push(Place { bearing, range, since: capture, seen: capture });
                }
                None => {}
            }
        }
        stands
    }
}

impl Place {
    fn is_at(&self, bearing: [f64; 2], range: [f64; 2]) -> bool {
        difference(bearing[0], self.bearing[0]).abs() < SIGMAS * bearing[1].hypot(self.bearing[1])
            && (range[0] - self.range[0]).abs() < SIGMAS * range[1].hypot(self.range[1])
    }
}

#[cfg(test)]
mod tests {
    use protocol::marker::Marker;
    use protocol::message::SightedRange;
    use protocol::quantity::{Angle16, Fraction8, LogSigma, Millimetres};

    use super::*;

    fn sighting(bearing_rad: f64, range_m: f64) -> PeerSighting {
        PeerSighting {
            marker: Marker::CYLINDER,
            robot: None,
            bearing: Angle16::from_rad(bearing_rad),
            bearing_sigma: LogSigma::from_value(2e-4),
            range: Some(SightedRange { range: Millimetres::from_m(range_m), sigma: LogSigma::from_value(0.003) }),
            heading: None,
            confidence: Fraction8::from_value(1.0),
            features: Vec::new(),
        }
    }

    /// Whether each frame, 0.1 s after the one before, shows that the robot stands.
    fn told(frames: impl IntoIterator<Item = Vec<PeerSighting>>) -> Vec<bool> {
        let mut witnesses = Witnesses::default();
        let at = |n: usize| Timestamp::from_secs_f64(1.0 + 0.1 * n as f64);
        frames.into_iter().enumerate().map(|(n, seen)| witnesses.show_standing(&seen, at(n))).collect()
    }

    #[test]
    fn a_fellow_that_stays_shows_it_after_a_second_and_when_it_is_seen_again() {
        let frames = (0..16).map(|n| if n == 13 { Vec::new() } else { vec![sighting(0.3, 2.0)] });
        assert_eq!(told(frames)[8..], [false, false, true, true, true, false, true, true]);
    }

    #[test]
    fn one_fellow_that_drives_does_not_hide_that_another_one_stays() {
        let frames = (0..16).map(|n| vec![sighting(0.3, 2.0), sighting(-0.2 + 0.02 * f64::from(n), 1.5)]);
        assert!(told(frames)[11..].iter().all(|t| *t));
    }

    #[test]
    fn a_robot_that_drives_or_turns_however_slowly_is_not_shown_to_stand() {
        // 0.05 m/s towards the fellow, 1° a second, 0.3 m/s.
        let drives = told((0..40).map(|n| vec![sighting(0.3, 3.0 - 0.005 * f64::from(n))]));
        let turns = told((0..40).map(|n| vec![sighting(0.3 + 0.001_745 * f64::from(n), 3.0)]));
        let quick = told((0..40).map(|n| vec![sighting(0.3, 6.0 - 0.03 * f64::from(n))]));
        assert!([drives, turns, quick].iter().flatten().all(|told| !told));
    }
}
