//! Numbers stay where they were.
//!
//! Problem: a change of mind about whose tracks are whose filters the targets concerned again and may set them down elsewhere:
//! number 3 leaps by a metre to where nobody was followed, number 4 into its place, and back with the next frame. Nobody
//! leaps, but whoever watches the map takes it for that.
//!
//! Insight: the rays of a frame say which places are taken; by whom, is told by what was there a moment ago. So a target that
//! has leapt into the place of a number that is not there any more bears that number from now on, and whoever bore it gets
//! the other's.

use std::collections::BTreeMap;

use nalgebra::Vector2;
use protocol::id::TargetId;
use protocol::time::Timestamp;

use super::{Own, OwnId};

/// A target further than this from where its number is to be has leapt, metres.
const LEAP_M: f64 = 0.25;
/// So near to where a number is to be a target is in its place, metres.
const PLACE_M: f64 = 0.7;
/// How long a number that is not in the map keeps its place, seconds.
const KEPT_S: f64 = 0.5;
/// Nobody is taken to go faster, m/s.
const FASTEST_MPS: f64 = 2.0;

/// Where the numbers were in the map.
#[derive(Debug, Default)]
pub struct Places {
    of: BTreeMap<TargetId, Place>,
}

#[derive(Debug, Clone, Copy)]
struct Place {
    component: u32,
    at: Timestamp,
    position: Vector2<f64>,
    velocity: Vector2<f64>,
}

impl Place {
    fn expected(&self, now: Timestamp) -> Option<Vector2<f64>> {
        let age_s = now.seconds_since(self.at).max(0.0);
        (age_s < KEPT_S).then(|| self.position + self.velocity * age_s)
    }
}

impl Places {
    /// Notes where the numbers are now.
    pub fn note(&mut self, own: &[Own], numbers: &[TargetId], now: Timestamp) {
        for (own, number) in own.iter().zip(numbers) {
            let velocity = own.velocity.cap_magnitude(FASTEST_MPS);
            let place = Place { component: own.id.0, at: now, position: own.position, velocity };
            self.of.insert(*number, place);
        }
        self.of.retain(|_, place| now.seconds_since(place.at) < KEPT_S);
    }

    /// A component is no more.
    pub fn forget(&mut self, component: u32) {
        self.of.retain(|_, place| place.component != component);
    }

    /// Numbers that are not where they were to be, each with the target that has leapt into its place. `of`: whose which is.
    pub fn claims(&self, own: &[Own], of: &BTreeMap<OwnId, TargetId>, now: Timestamp) -> Vec<(TargetId, OwnId)> {
        let expected = |number: &TargetId| self.of.get(number)?.expected(now);
        let stays = |own: &Own| {
            let place = of.get(&own.id).and_then(expected);
            place.is_some_and(|place| (own.position - place).norm() <= LEAP_M)
        };
        let (still, leapt): (Vec<&Own>, Vec<&Own>) = own.iter().partition(|own| stays(own));
        if leapt.is_empty() {
            return Vec::new();
        }
        let is_held = |number: &TargetId| still.iter().any(|own| of.get(&own.id) == Some(number));
        let mut pairs: Vec<(f64, TargetId, OwnId)> = Vec::new();
        for (number, place) in self.of.iter().filter(|(number, _)| !is_held(number)) {
            let Some(there) = place.expected(now) else { continue };
            let near = leapt.iter().filter(|own| own.id.0 == place.component);
            pairs.extend(near.map(|own| ((own.position - there).norm(), *number, own.id)));
        }
        pairs.retain(|(apart_m, ..)| *apart_m < PLACE_M);
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut claims: Vec<(TargetId, OwnId)> = Vec::new();
        for (_, number, own) in pairs {
            if claims.iter().all(|(n, o)| *n != number && *o != own) {
                claims.push((number, own));
            }
        }
        claims
    }
}
