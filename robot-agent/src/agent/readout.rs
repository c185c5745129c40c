//! Fellow robots at the frame's capture time.
//!
//! A camera that reads its rows or columns one after the other sees a fellow earlier or later than the time the frame is
//! stamped with: a slit that turns five times a second by up to 0.1 s, in which a robot 2 m away that drives by goes a degree, a
//! hundred sigmas. What moves is therefore brought to the capture time by its motion since the frame before. What stands is
//! left as it was measured, with the sigma that a motion too slow to tell leaves.

use nalgebra::Matrix2;
use protocol::angle::{difference, wrap};
use protocol::time::Timestamp;

use crate::peers::Peer;

/// Within these a place is that of the same fellow a frame ago: radians, and a part of the range.
const NEAR: (f64, f64) = (0.2, 0.2);
/// What was seen so long ago says nothing of the speed now, seconds.
const MEMORY_S: f64 = 0.5;
/// Two places closer in time tell no speed, seconds.
const LEAST_S: f64 = 1e-3;
/// Sigmas beyond which something moves.
const MOVES: f64 = 4.0;
/// Speed of a fellow that is seen for the first time, standard deviation, m/s.
const SPEED_MPS: f64 = 0.3;
/// How fast speeds change between two frames, standard deviation, m/s².
const ACCELERATION_MPS2: f64 = 0.3;

/// Where fellows were seen last.
#[derive(Debug, Clone, Default)]
pub struct Readout {
    before: Vec<Place>,
}

#[derive(Debug, Clone, Copy)]
struct Place {
    /// When it was seen itself.
    at: Timestamp,
    bearing_rad: f64,
    range_m: f64,
    covariance: Matrix2<f64>,
}

impl Readout {
    /// Brings each fellow, seen `delay_s(bearing)` after the capture time, to that time.
    pub fn correct(&mut self, peers: &mut [Peer], capture: Timestamp, delay_s: impl Fn(f64) -> f64) {
        self.before.retain(|place| capture.seconds_since(place.at).abs() < MEMORY_S);
        let mut now = Vec::with_capacity(peers.len());
        for peer in peers {
            let delay_s = delay_s(peer.bearing_rad);
            let place = Place {
                at: capture.offset_by_secs(delay_s),
                bearing_rad: peer.bearing_rad,
                range_m: peer.range_m,
                covariance: peer.covariance,
            };
            // A clock may have been set back.
            let before = self.before.iter().filter(|p| p.may_be(&place) && place.at.seconds_since(p.at) > LEAST_S);
            let before = before.min_by(|a, b| a.away_rad(&place).total_cmp(&b.away_rad(&place)));
            advance(peer, &place, before, delay_s);
            now.push(place);
        }
        // Who is not seen in this frame may be in the next.
        self.before.retain(|old| !now.iter().any(|place| old.may_be(place)));
        self.before.extend(now);
    }
}

impl Place {
    fn away_rad(&self, other: &Self) -> f64 {
        difference(self.bearing_rad, other.bearing_rad).abs()
    }

    fn may_be(&self, other: &Self) -> bool {
        self.away_rad(other) < NEAR.0 && (self.range_m / other.range_m - 1.0).abs() < NEAR.1
    }
}

/// Moves a fellow to where it was `delay_s` before it was seen.
fn advance(peer: &mut Peer, place: &Place, before: Option<&Place>, delay_s: f64) {
    if delay_s == 0.0 {
        return;
    }
    let Some(before) = before else {
        widen(peer, [(SPEED_MPS / peer.range_m * delay_s).powi(2), (SPEED_MPS * delay_s).powi(2)]);
        return;
    };
    let elapsed_s = place.at.seconds_since(before.at);
    let moved = [difference(place.bearing_rad, before.bearing_rad), place.range_m - before.range_m];
    let noise = place.covariance + before.covariance;
    let part = delay_s / elapsed_s;
    let moves = moved[0].powi(2) / noise[(0, 0)] + moved[1].powi(2) / noise[(1, 1)] > MOVES * MOVES;
    if !moves {
        widen(peer, moved.map(|m| (part * m).powi(2)));
        return;
    }
    peer.bearing_rad = wrap(peer.bearing_rad - part * moved[0]);
    peer.range_m = (peer.range_m - part * moved[1]).max(0.5 * peer.range_m);
    for feature in &mut peer.features {
        feature.bearing_rad = wrap(feature.bearing_rad - part * moved[0]);
    }
    // The speed is the mean of the whole way from there, and this is a part of it.
    let bent_m = 0.5 * ACCELERATION_MPS2 * (elapsed_s - delay_s) * delay_s;
    let own = part * part;
    widen(peer, [own * noise[(0, 0)] + (bent_m / peer.range_m).powi(2), own * noise[(1, 1)] + bent_m * bent_m]);
}

fn widen(peer: &mut Peer, variances: [f64; 2]) {
    peer.covariance[(0, 0)] += variances[0];
    peer.covariance[(1, 1)] += variances[1];
    for feature in &mut peer.features {
        feature.sigma_rad = feature.sigma_rad.hypot(variances[0].sqrt());
    }
}

#[cfg(test)]
mod tests {
    use protocol::marker::Marker;

    use super::*;

    fn peer(bearing_rad: f64, range_m: f64) -> Peer {
        Peer {
            kind: Marker::CYLINDER,
            robot: None,
            bearing_rad,
            range_m,
            covariance: Matrix2::new(2e-4 * 2e-4, 0.0, 0.0, 0.004 * 0.004),
            heading_rad: None,
            confidence: 1.0,
            features: Vec::new(),
        }
    }

    /// What is behind is seen 0.1 s late, what is ahead on time.
    fn delay_s(bearing_rad: f64) -> f64 {
        0.1 * bearing_rad.abs() / std::f64::consts::PI
    }

    /// Errors of bearing and range in sigmas, frame by frame, of a robot at `path` (bearing and range by time).
    fn errors(path: impl Fn(f64) -> (f64, f64)) -> Vec<[f64; 2]> {
        let mut readout = Readout::default();
        let frame = |n: usize| {
            let t = 0.1 * n as f64;
            // It is seen where it is when the slit looks there; who stands for a moment is seen all the same.
            let seen = path(t + delay_s(path(t).0));
            let seen = path(t + delay_s(seen.0));
            let mut peers = vec![peer(seen.0, seen.1)];
            readout.correct(&mut peers, Timestamp::from_secs_f64(10.0 + t), delay_s);
            let truth = path(t);
            let p = &peers[0];
            [
                difference(p.bearing_rad, truth.0) / p.covariance[(0, 0)].sqrt(),
                (p.range_m - truth.1) / p.covariance[(1, 1)].sqrt(),
            ]
        };
        (0..40).map(frame).collect()
    }

    #[test]
    fn who_drives_by_is_where_he_was_at_the_capture_time() {
        // 0.2 m/s past a robot 2 m away, behind it: 6° a second.
        let by = errors(|t| {
            let (x, y) = (-2.0f64, -0.4 + 0.2 * t);
            (y.atan2(x), x.hypot(y))
        });
        assert!(by.iter().flatten().all(|e| e.abs() < 3.0), "{by:?}");
        // Seen 0.1 s late and not corrected it is off by 0.01 rad, 50 sigmas; the correction costs a factor of two.
        let mut readout = Readout::default();
        let at = |t: f64| peer(3.0 - 0.1 * t, 2.0);
        let mut seen = [at(0.1)];
        readout.correct(&mut seen, Timestamp::from_secs_f64(1.0), delay_s);
        let mut seen = [at(0.2)];
        readout.correct(&mut seen, Timestamp::from_secs_f64(1.1), delay_s);
        assert!((seen[0].bearing_rad - (2.98 + 0.1 * delay_s(2.98))).abs() < 1e-4, "{seen:?}");
        assert!(seen[0].covariance[(0, 0)] < 4.0 * 4e-8, "{seen:?}");
    }

    #[test]
    fn who_stands_stays_as_measured() {
        let stands = errors(|_| (2.5, 2.0));
        assert!(stands.iter().flatten().all(|e| e.abs() < 1e-9));
        let mut readout = Readout::default();
        for n in 0..3 {
            let mut seen = [peer(2.5, 2.0)];
            readout.correct(&mut seen, Timestamp::from_secs_f64(1.0 + 0.1 * f64::from(n)), delay_s);
            assert_eq!(seen[0].covariance[(0, 0)] > 5e-8, n == 0, "only who is new may move");
        }
    }

    #[test]
    fn a_frame_that_comes_early_and_a_clock_that_is_set_back_are_no_speed() {
        // What is right behind is seen 0.1 s late: after the next frame's capture time where that comes 0.09 s later.
        let mut readout = Readout::default();
        let seen = |readout: &mut Readout, bearing_rad: f64, t: f64| {
            let mut seen = [peer(bearing_rad, 2.0)];
            readout.correct(&mut seen, Timestamp::from_secs_f64(t), delay_s);
            seen[0].clone()
        };
        seen(&mut readout, 3.1, 1.0);
        let early = seen(&mut readout, 3.09, 1.09);
        assert!(early.bearing_rad > 3.099, "it has its speed from the frame before: {early:?}");
        let back = seen(&mut readout, 3.08, 0.9);
        assert_eq!(back.bearing_rad, 3.08);
        assert!(back.covariance[(0, 0)].sqrt() > 0.01, "nothing is known of its speed");
    }

    #[test]
    fn a_camera_that_sees_all_at_once_changes_nothing() {
        let mut readout = Readout::default();
        let mut seen = [peer(1.0, 2.0)];
        readout.correct(&mut seen, Timestamp::from_secs_f64(1.0), |_| 0.0);
        assert_eq!(seen[0], peer(1.0, 2.0));
    }
}
