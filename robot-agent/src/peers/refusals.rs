//! Places of a stream in which there was no robot.
//!
//! Problem: most of a search's time goes into fits to shelves and chairs that were refused half a second before, and will be again.
//! Insight: they stand still, and what stands there looks the same but for noise. Algorithm: a place where something was
//! fitted without any hope is left alone for some searches, unless more or less speaks for it than then; their turns come
//! apart, so that no search has them all. A picture by itself is searched whole, and so is every picture of a robot that moves.

use protocol::angle::difference;
use protocol::time::Timestamp;

use super::near::Rim;
use super::search::Hider;

/// A place is looked at again after so long, and after up to so much more, in so many steps. Seconds.
const REST_S: f64 = 1.9;
const MORE_REST_S: f64 = 2.5;
const TURNS: u32 = 5;
/// The same place: with other noise the search's columns (which are wider near at hand) and ranges (steps of 3 %) may be one or two
/// further on. Radians or metres, whichever is more, and a ratio.
const SAME_BEARING_RAD: f64 = 0.012;
const SAME_ASIDE_M: f64 = 0.04;
const SAME_RANGE: f64 = 1.065;
/// A plate's search tells its turn to this, radians.
const SAME_TURN_RAD: f64 = 0.15;
/// The picture there has changed where this much more or less supports a robot.
const SAME_SUPPORT: f64 = 0.1;
/// Most places remembered.
const MAX_PLACES: usize = 512;

/// What was to be looked at closely.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Place {
    /// How it was found.
    pub how: How,
    /// Radians.
    pub bearing_rad: f64,
    /// Along the floor, metres.
    pub range_m: f64,
    /// Of a plate.
    pub turn_rad: f64,
    /// What spoke for a robot, 0 … 1.
    pub support: f64,
}

/// By which search a place was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum How {
    /// Rings, or the upper end of a cylinder's marker.
    Cylinder(Option<Rim>),
    /// The same with what is before it left out.
    Behind(Hider, Option<Rim>),
    /// Stripes of a plate.
    Stripes,
    /// The edge between the two upper stripes of a plate.
    Edge,
    /// The upper end of a plate.
    PlateEnd,
}

/// The places that are left alone, since when, and how long, seconds.
#[derive(Debug, Default)]
pub(super) struct Refusals {
    places: Vec<(Place, Timestamp, f64)>,
    /// Of the picture at hand; none of one that is no part of a stream.
    now: Option<Timestamp>,
    turn: u32,
}

impl Refusals {
    /// A picture of a stream is searched, or one by itself.
    pub fn begin_search(&mut self, now: Option<Timestamp>) {
        self.now = now;
        // A clock may have jumped.
        let rests =
            |since: Timestamp, rest_s: f64| now.is_some_and(|now| (0.0..rest_s).contains(&now.seconds_since(since)));
        self.places.retain(|(_, since, rest_s)| rests(*since, *rest_s));
    }

    /// Whether a place is left alone in this search.
    pub fn hold(&self, place: &Place) -> bool {
        // What was refused in this search was refused from another start.
        self.places.iter().any(|(refused, since, _)| {
            Some(*since) != self.now
                && refused.how == place.how
                && difference(refused.bearing_rad, place.bearing_rad).abs()
                    < SAME_BEARING_RAD.max(SAME_ASIDE_M / place.range_m)
                && (1.0 / SAME_RANGE..SAME_RANGE).contains(&(place.range_m / refused.range_m))
                && (place.turn_rad - refused.turn_rad).abs() < SAME_TURN_RAD
                && (place.support - refused.support).abs() < SAME_SUPPORT
        })
    }

    /// The camera has moved: everything is elsewhere.
    pub fn forget(&mut self) {
        self.places.clear();
    }

    /// A place showed nothing like a robot.
    pub fn note(&mut self, place: Place) {
        if let Some(now) = self.now.filter(|_| self.places.len() < MAX_PLACES) {
            self.turn = (self.turn + 1) % TURNS;
            let rest_s = REST_S + MORE_REST_S * f64::from(self.turn) / f64::from(TURNS - 1);
            self.places.push((place, now, rest_s));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(time_s: f64) -> Option<Timestamp> {
        Some(Timestamp::from_secs_f64(1000.0 + time_s))
    }

    fn shelf() -> Place {
        Place { how: How::Stripes, bearing_rad: 3.135, range_m: 2.0, turn_rad: 0.3, support: 0.5 }
    }

    #[test]
    fn a_refused_place_rests_from_the_next_search_on_and_gets_another_look_when_it_has_changed_or_rested() {
        let mut refusals = Refusals::default();
        refusals.begin_search(at(0.0));
        refusals.note(shelf());
        assert!(!refusals.hold(&shelf()), "other starts of one search");
        refusals.begin_search(at(0.5));
        assert!(refusals.hold(&shelf()) && refusals.hold(&Place { bearing_rad: -3.135, range_m: 2.06, ..shelf() }));
        for other in [
            Place { how: How::Edge, ..shelf() },
            Place { bearing_rad: 3.11, ..shelf() },
            Place { range_m: 2.2, ..shelf() },
            Place { turn_rad: 0.6, ..shelf() },
            Place { support: 0.65, ..shelf() },
            Place { support: 0.35, ..shelf() },
        ] {
            assert!(!refusals.hold(&other), "{other:?}");
        }
        refusals.begin_search(at(REST_S + MORE_REST_S + 0.01));
        assert!(!refusals.hold(&shelf()));
    }

    #[test]
    fn nothing_is_left_alone_in_a_picture_by_itself_or_after_a_clock_jumped_back() {
        for next in [None, at(-60.0)] {
            let mut refusals = Refusals::default();
            refusals.begin_search(at(0.0));
            refusals.note(shelf());
            refusals.begin_search(next);
            assert!(!refusals.hold(&shelf()), "{next:?}");
        }
    }

    #[test]
    fn the_turns_of_many_places_come_apart() {
        let mut refusals = Refusals::default();
        refusals.begin_search(at(0.0));
        let places: Vec<Place> = (0..50).map(|n| Place { bearing_rad: 0.1 * f64::from(n), ..shelf() }).collect();
        places.iter().for_each(|place| refusals.note(*place));
        let mut due = 0;
        for search in 1..10 {
            refusals.begin_search(at(0.5 * f64::from(search)));
            let now = places.iter().filter(|place| !refusals.hold(place)).count();
            assert!(now - due <= 10, "{} at once", now - due);
            due = now;
        }
        assert_eq!(due, 50);
    }
}
