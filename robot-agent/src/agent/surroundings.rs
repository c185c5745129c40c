//! Who is round the robot by what the leader says, at the time of a frame.

use nalgebra::Vector2;
use protocol::fence::Fence;
use protocol::message::{Neighbour, Surroundings};
use protocol::time::Timestamp;

use crate::tracking::Expected;

/// Used for so long after (and before) their time, seconds: people turn.
const USED_S: f64 = 0.4;
/// How people change their speed, m/s².
const ACCELERATION: f64 = 1.5;
/// Least standard deviation of somebody's place along and across the line of sight, metres: a body is no point.
const LEAST_M: f64 = 0.06;
/// Nobody is expected nearer than this, metres: what is there is no figure any more.
const NEAREST_M: f64 = 0.4;

/// What the leader said last.
#[derive(Debug, Default)]
pub(super) struct Around {
    fence: Fence,
    at: Timestamp,
    people: Vec<Neighbour>,
}

impl Around {
    /// Takes what was said to this session, unless another leader leads.
    pub(super) fn take(&mut self, now: Timestamp, epoch: u64, said: Surroundings) {
        if said.epoch == epoch && self.fence.admits(now, said.leader, said.term) {
            (self.at, self.people) = (said.at, said.people);
        }
    }

    /// Who is expected where at `capture`.
    pub(super) fn at(&self, capture: Timestamp) -> Vec<Expected> {
        let dt_s = capture.seconds_since(self.at);
        if dt_s.abs() > USED_S {
            return Vec::new();
        }
        let strayed_m = LEAST_M.hypot(0.5 * ACCELERATION * dt_s * dt_s);
        let expected = |person: &Neighbour| {
            let (sin, cos) = person.bearing.rad().sin_cos();
            let velocity = Vector2::from(person.velocity_mmps.map(|v| 1e-3 * f64::from(v)));
            let place = Vector2::new(cos, sin) * person.range.m() + velocity * dt_s;
            let range_m = place.norm();
            let [along, across] = person.sigma.map(|sigma| sigma.value().hypot(strayed_m) / range_m);
            (range_m > NEAREST_M).then(|| Expected {
                track: person.track,
                bearing_rad: place.y.atan2(place.x),
                bearing_sigma_rad: across,
                range_m,
                log_range_sigma: along,
            })
        };
        self.people.iter().filter_map(expected).collect()
    }
}

#[cfg(test)]
mod tests {
    use protocol::id::{LeaderId, RobotId};
    use protocol::quantity::{Angle16, LogSigma, Millimetres};

    use super::*;

    #[test]
    fn somebody_who_walks_past_is_expected_where_he_is_by_then_and_the_less_surely_the_later() {
        let mut around = Around::default();
        around.take(at(10.0), 7, said(7, "l1", 1));
        let now = around.at(at(10.0))[0];
        assert!((now.range_m - 2.0).abs() < 1e-3 && now.bearing_rad.abs() < 1e-3);
        let later = around.at(at(10.3))[0];
        // 1 m/s to the left of 2 m ahead.
        assert!(
            (later.bearing_rad - 0.3f64.atan2(2.0)).abs() < 2e-3 && later.bearing_sigma_rad > now.bearing_sigma_rad
        );
        assert_eq!(around.at(at(10.6)), [], "people turn");
    }

    #[test]
    fn what_another_session_or_a_deposed_leader_was_told_is_not_used() {
        let mut around = Around::default();
        around.take(at(10.0), 8, said(7, "l1", 1));
        assert_eq!(around.at(at(10.0)), []);
        around.take(at(10.0), 7, Surroundings { people: Vec::new(), ..said(7, "l2", 2) });
        around.take(at(10.1), 7, said(7, "l1", 1));
        assert_eq!(around.at(at(10.0)), []);
    }

    fn at(seconds: f64) -> Timestamp {
        Timestamp::from_secs_f64(seconds)
    }

    fn said(epoch: u64, leader: &str, term: u64) -> Surroundings {
        Surroundings {
            robot: RobotId::new("r1").unwrap(),
            epoch,
            leader: LeaderId::new(leader).unwrap(),
            term,
            at: at(10.0),
            people: vec![Neighbour {
                track: None,
                bearing: Angle16::from_rad(0.0),
                range: Millimetres::from_m(2.0),
                sigma: [0.1, 0.1].map(LogSigma::from_value),
                velocity_mmps: [0, 1000],
            }],
        }
    }
}
