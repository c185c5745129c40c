//! Numbers of targets that outlive a leader.
//!
//! Every leader follows the same people under numbers of its own, in each component. What the team hears are the numbers of the map: a leader that
//! stands by learns from each map of the ruling one which of its own targets bears which, and keeps to that when it rules. A
//! target that it does not follow (it came late, or everything was restarted) leaves its number and place behind, and whoever
//! is found there soon gets it.

mod places;

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Vector2;
use protocol::id::TargetId;
use protocol::message::MapTarget;
use protocol::time::Timestamp;

use places::Places;

/// A target of the map and one of our own are the same this near, metres.
const SAME_M: f64 = 0.6;
/// The pair of the map before is preferred to another by so much, metres.
const LOYALTY_M: f64 = 0.2;
/// How far from where it was somebody may be found who still gets the number: at once, and more with every second; at most.
const FOUND_M: (f64, f64, f64) = (0.4, 0.6, 1.5);
/// How long a number waits for its bearer, seconds.
pub const WAITS_S: f64 = 8.0;
/// A velocity leads so far, seconds.
const HEADED_S: f64 = 1.0;
/// Most numbers of our own that are remembered.
const MAX_NAMES: usize = 4096;
/// Most numbers that wait.
const MAX_WAITING: usize = 256;

/// A number of our own: of a component, by its serial, and its target.
pub type OwnId = (u32, TargetId);

/// Our own numbers and those of the map.
#[derive(Debug)]
pub struct Names {
    of: BTreeMap<OwnId, TargetId>,
    waiting: Vec<Waiting>,
    places: Places,
    next: u32,
}

#[derive(Debug, Clone, Copy)]
struct Waiting {
    id: TargetId,
    /// Whose frame it was in.
    component: u32,
    position: Vector2<f64>,
    velocity: Vector2<f64>,
    at: Timestamp,
}

/// A target of our own at an instant.
#[derive(Debug, Clone, Copy)]
pub struct Own {
    /// Our number.
    pub id: OwnId,
    /// On the floor in its component's frame, metres.
    pub position: Vector2<f64>,
    /// m/s.
    pub velocity: Vector2<f64>,
}

impl Own {
    /// A target of a map that still has our number, and the serial of its component.
    pub fn of(target: &MapTarget, component: u32) -> Self {
        let [x, y, _] = target.position_m;
        let velocity = target.velocity_mps.map(f64::from);
        Self { id: (component, target.id), position: Vector2::new(x, y), velocity: velocity.into() }
    }
}

impl Default for Names {
    fn default() -> Self {
        Self { of: BTreeMap::new(), waiting: Vec::new(), places: Places::default(), next: 1 }
    }
}

impl Names {
    /// The first number that nobody has had.
    pub fn next(&self) -> TargetId {
        TargetId(self.next)
    }

    /// Learns from a map of another leader, of the instant `at`, with `next` as the first free number. `ours` is the serial of
    /// our component that holds the robots of one of its components.
    pub fn follow(
        &mut self,
        targets: &[MapTarget],
        next: TargetId,
        at: Timestamp,
        own: &[Own],
        ours: impl Fn(u8) -> Option<u32>,
    ) {
        let frames: Vec<Option<u32>> = targets.iter().map(|target| ours(target.component)).collect();
        self.next = self.next.max(next.0);
        let place = |target: &MapTarget| Vector2::new(target.position_m[0], target.position_m[1]);
        let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
        for (t, target) in targets.iter().enumerate() {
            self.next = self.next.max(target.id.0.saturating_add(1));
            for (o, mine) in own.iter().enumerate().filter(|(_, mine)| frames[t] == Some(mine.id.0)) {
                let apart_m = (mine.position - place(target)).norm();
                if apart_m < SAME_M {
                    let loyal = self.of.get(&mine.id) == Some(&target.id);
                    pairs.push((if loyal { apart_m - LOYALTY_M } else { apart_m }, t, o));
                }
            }
        }
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)).then(a.2.cmp(&b.2)));
        let (mut paired, mut taken) = (BTreeSet::new(), BTreeSet::new());
        for (_, t, o) in pairs {
            if paired.contains(&t) || taken.contains(&o) {
                continue;
            }
            paired.insert(t);
            taken.insert(o);
            let (theirs, mine) = (targets[t].id, own[o].id);
            self.of.retain(|other, name| *name != theirs || *other == mine);
            self.of.insert(mine, theirs);
        }
        let age_s = |w: &Waiting| at.seconds_since(w.at).abs();
        self.waiting.retain(|w| age_s(w) < WAITS_S && targets.iter().all(|t| t.id != w.id));
        for (t, target) in targets.iter().enumerate().filter(|(t, _)| !paired.contains(t)) {
            // Nobody of ours may go on under a number that the ruling leader sees elsewhere.
            self.of.retain(|_, name| *name != target.id);
            let velocity = Vector2::new(f64::from(target.velocity_mps[0]), f64::from(target.velocity_mps[1]));
            if let Some(component) = frames[t] {
                self.waiting.push(Waiting { id: target.id, component, position: place(target), velocity, at });
            }
        }
        self.limit_waiting();
        self.limit_names(own);
    }

    /// A target of ours ends, and may be found again in another component, at `position` in its frame.
    pub fn hand_over(
        &mut self,
        own: OwnId,
        component: u32,
        position: Vector2<f64>,
        velocity: Vector2<f64>,
        at: Timestamp,
    ) {
        if let Some(id) = self.of.remove(&own) {
            self.waiting.push(Waiting { id, component, position, velocity, at });
            self.limit_waiting();
        }
    }

    /// A component is no more.
    pub fn forget(&mut self, component: u32) {
        self.of.retain(|(of, _), _| *of != component);
        self.places.forget(component);
        self.waiting.retain(|w| w.component != component);
    }

    fn limit_waiting(&mut self) {
        let excess = self.waiting.len().saturating_sub(MAX_WAITING);
        self.waiting.drain(..excess);
    }

    /// Those go first that were given first, but for those of `present` targets.
    fn limit_names(&mut self, present: &[Own]) {
        while self.of.len() > MAX_NAMES {
            let absent = self.of.iter().filter(|(own, _)| present.iter().all(|p| p.id != **own));
            let Some(oldest) = absent.min_by_key(|(_, number)| **number).map(|(own, _)| *own) else { return };
            self.of.remove(&oldest);
        }
    }

    /// The numbers in the map of `now` of all targets of our own that are in it.
    pub fn name_all(&mut self, own: &[Own], now: Timestamp) -> Vec<TargetId> {
        for (number, bearer) in self.places.claims(own, &self.of, now) {
            let former = self.of.iter().find(|(_, name)| **name == number).map(|(own, _)| *own);
            let given_up = self.of.insert(bearer, number);
            match (former, given_up) {
                (Some(former), Some(other)) if former != bearer => _ = self.of.insert(former, other),
                (Some(former), None) => _ = self.of.remove(&former),
                _ => {}
            }
        }
        let numbers: Vec<TargetId> = own.iter().map(|own| self.name(own.id, own.position, now)).collect();
        self.limit_names(own);
        self.places.note(own, &numbers, now);
        numbers
    }

    /// The number in the map of a target of our own that is found at `position` at `now`.
    fn name(&mut self, own: OwnId, position: Vector2<f64>, now: Timestamp) -> TargetId {
        if let Some(name) = self.of.get(&own) {
            return *name;
        }
        self.waiting.retain(|w| now.seconds_since(w.at) < WAITS_S);
        let nearest = self
            .waiting
            .iter()
            .enumerate()
            .filter(|(_, w)| w.component == own.0)
            .filter_map(|(k, w)| {
                let age_s = now.seconds_since(w.at).max(0.0);
                let there = w.position + w.velocity * age_s.min(HEADED_S);
                let apart_m = (position - there).norm().min((position - w.position).norm());
                (apart_m < (FOUND_M.0 + FOUND_M.1 * age_s).min(FOUND_M.2)).then_some((apart_m, k))
            })
            .min_by(|a, b| a.0.total_cmp(&b.0));
        let name = match nearest {
            Some((_, k)) => self.waiting.remove(k).id,
            None => {
                let name = TargetId(self.next);
                self.next = self.next.saturating_add(1);
                name
            }
        };
        self.of.insert(own, name);
        name
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_is_found_where_the_ruling_leader_saw_somebody_keeps_the_number() {
        let mut names = Names::default();
        let own = [mine(1, 0.0, 0.0), mine(2, 2.0, 0.0)];
        let targets = [theirs(7, 2.1, 0.0), theirs(9, 0.0, 0.1), theirs(11, 5.0, 5.0)];
        names.follow(&targets, TargetId(20), at(0.0), &own, first);
        assert_eq!(names.name((0, TargetId(1)), own[0].position, at(0.1)), TargetId(9));
        assert_eq!(names.name((0, TargetId(2)), own[1].position, at(0.1)), TargetId(7));
        // Found late, half a metre on.
        assert_eq!(names.name((0, TargetId(3)), Vector2::new(5.4, 5.0), at(1.0)), TargetId(11));
        assert_eq!(names.name((0, TargetId(4)), Vector2::new(-3.0, 0.0), at(1.0)), TargetId(20));
        assert_eq!(names.next(), TargetId(21));
    }

    #[test]
    fn two_that_pass_each_other_keep_their_numbers_while_the_maps_say_so() {
        let mut names = Names::default();
        for step in 0..=20 {
            let x = -1.0 + 0.1 * f64::from(step);
            let own = [mine(1, x, 0.0), mine(2, -x, 0.15)];
            let targets = [theirs(5, x, 0.02), theirs(6, -x, 0.13)];
            names.follow(&targets, TargetId(7), at(0.1 * f64::from(step)), &own, first);
        }
        assert_eq!(names.name((0, TargetId(1)), Vector2::zeros(), at(2.0)), TargetId(5));
        assert_eq!(names.name((0, TargetId(2)), Vector2::zeros(), at(2.0)), TargetId(6));
    }

    #[test]
    fn who_leaps_into_the_place_of_another_gets_the_number_that_was_there() {
        let numbers = |steps: &[&[(u32, f64)]]| {
            let mut names = Names::default();
            let mut last = Vec::new();
            for (step, people) in steps.iter().enumerate() {
                let own: Vec<Own> = people.iter().map(|(id, x)| mine(*id, *x, 0.0)).collect();
                last = names.name_all(&own, at(0.03 * step as f64)).into_iter().map(|id| id.0).collect();
            }
            last
        };
        // They change places: numbers stay where they were.
        assert_eq!(numbers(&[&[(1, 0.0), (2, 1.0)], &[(1, 1.1), (2, 0.1)]]), [2, 1]);
        // One leaps away, and somebody new is found where it was.
        assert_eq!(numbers(&[&[(1, 0.0)], &[(1, 3.0), (2, 0.1)]]), [2, 1]);
        // One leaps to where nobody was: it is the same one, corrected.
        assert_eq!(numbers(&[&[(1, 0.0), (2, 5.0)], &[(1, 1.0), (2, 5.0)]]), [1, 2]);
        // Two walk past each other.
        let passing: Vec<Vec<(u32, f64)>> =
            (0..30).map(|k| f64::from(k) * 0.04).map(|x| vec![(1, x), (2, 1.2 - x)]).collect();
        assert_eq!(numbers(&passing.iter().map(Vec::as_slice).collect::<Vec<_>>()), [1, 2]);
    }

    #[test]
    fn who_stays_keeps_his_number_whoever_comes_and_goes_in_another_component() {
        let mut names = Names::default();
        let stays = mine(1, 0.0, 0.0);
        let place = |k: u32| Vector2::new(5.0 + 3.0 * f64::from(k % 40), 5.0);
        let passing = |k: u32| Own { id: (4, TargetId(k)), position: place(k), velocity: Vector2::zeros() };
        let count = MAX_NAMES as u32 + 100;
        for k in 0..count {
            let numbers = names.name_all(&[stays, passing(k)], at(f64::from(k)));
            assert_eq!(numbers, [TargetId(1), TargetId(2 + k)]);
        }
        assert_eq!(names.of.len(), MAX_NAMES);
        // One who comes while the rooms are full of forgotten numbers keeps his, too.
        let comes = mine(2, -2.0, 0.0);
        let first = names.name_all(&[stays, comes], at(f64::from(count)));
        assert_eq!(names.name_all(&[stays, comes], at(f64::from(count) + 0.1)), first);
    }

    #[test]
    fn a_number_waits_no_longer_than_it_may_mean_the_same_person() {
        let mut names = Names::default();
        names.follow(&[theirs(5, 0.0, 0.0)], TargetId(6), at(0.0), &[], first);
        assert_eq!(names.name((0, TargetId(1)), Vector2::zeros(), at(WAITS_S + 0.1)), TargetId(6));
    }

    #[test]
    fn a_leader_that_never_followed_counts_from_one() {
        let mut names = Names::default();
        assert_eq!(names.name((0, TargetId(4)), Vector2::zeros(), at(0.0)), TargetId(1));
        assert_eq!(names.name((0, TargetId(9)), Vector2::zeros(), at(0.0)), TargetId(2));
        assert_eq!(names.name((0, TargetId(4)), Vector2::zeros(), at(5.0)), TargetId(1));
    }

    #[test]
    fn places_of_different_components_are_never_compared() {
        let mut names = Names::default();
        let other = MapTarget { component: 1, ..theirs(5, 0.0, 0.0) };
        names.follow(&[other.clone(), theirs(6, 3.0, 0.0)], TargetId(7), at(0.0), &[mine(1, 0.0, 0.0)], first);
        assert_eq!(names.name((0, TargetId(1)), Vector2::zeros(), at(0.1)), TargetId(7));
        // Its component is our serial 4: found there, but not in another frame.
        let both = |component: u8| Some(if component == 1 { 4 } else { 0 });
        names.follow(&[other], TargetId(8), at(0.2), &[], both);
        assert_eq!(names.name((0, TargetId(2)), Vector2::zeros(), at(0.3)), TargetId(8));
        assert_eq!(names.name((4, TargetId(1)), Vector2::zeros(), at(0.3)), TargetId(5));
        // The two rooms turn out to be one: whoever stood there is found again in the other frame.
        names.hand_over((4, TargetId(1)), 0, Vector2::new(2.0, 1.0), Vector2::zeros(), at(0.4));
        assert_eq!(names.name((0, TargetId(3)), Vector2::new(2.1, 1.0), at(0.8)), TargetId(5));
    }

    fn at(s: f64) -> Timestamp {
        Timestamp::from_secs_f64(1000.0 + s)
    }

    fn first(component: u8) -> Option<u32> {
        (component == 0).then_some(0)
    }

    fn mine(id: u32, x: f64, y: f64) -> Own {
        Own { id: (0, TargetId(id)), position: Vector2::new(x, y), velocity: Vector2::zeros() }
    }

    fn theirs(id: u32, x: f64, y: f64) -> MapTarget {
        MapTarget {
            id: TargetId(id),
            component: 0,
            position_m: [x, y, 0.9],
            velocity_mps: [0.0; 2],
            height_m: None,
            own_covariance: [0.01, 0.0, 0.0, 0.01, 0.0, 0.01],
            pose_jacobian: Vec::new(),
            observers: Vec::new(),
            pair: None,
            age_s: 0.0,
        }
    }
}
