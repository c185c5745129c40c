//! Who a fellow is by the lamp that it blinks (the report's "active signals").
//!
//! Problem: robots of one paint look alike, and a lamp is a few pixels among moving people. Insight: where the fellow is, its lamp
//! is, too, so only the brightness of one place is to be read; and nothing but the lamp changes in the rhythm of an announced code.
//! Algorithm: the brightness at each followed fellow's lamp is kept with its time; each code is laid beside it from every phase
//! (no clock is shared), as dark + gain · lit by least squares; who explains it best, and much better than anybody else, it is:
//!
//! ```text
//! nats = n/2 · ln( (Σ(y − ȳ)²/n + σ²) / (Σ(y − fit)²/n + σ²) )
//! ```

use std::collections::VecDeque;

use nalgebra::{Vector2, Vector3};
use protocol::angle::difference;
use protocol::id::RobotId;
use protocol::marker::{Beacon, Marker};
use protocol::time::Timestamp;

use super::Peer;
use crate::optics::MountedCamera;

/// Most lamps of a team.
pub const MAX_BEACONS: usize = 64;
/// Most fellows that are followed, and most readings of each.
const MAX_WATCHED: usize = 16;
const MAX_READINGS: usize = 512;
/// A code is laid beside the readings so often, seconds: of who has no name, and of who has one.
const DECIDED_EVERY_S: [f64; 2] = [0.25, 1.0];
/// The same fellow a frame later: radians, and a part of the range; and for how long he may be out of sight, seconds.
const NEAR: [f64; 2] = [0.15, 0.2];
const FORGET_S: f64 = 1.0;
/// A code is laid beside so many of its cycles, from so many phases a bit.
const CYCLES: f64 = 2.0;
const PHASES: usize = 4;
/// A reading so near to a change of the lamp may show either, as a part of a bit.
const UNSURE: f64 = 0.15;
/// Least readings, of them lit and dark.
const LEAST_READINGS: usize = 10;
const LEAST_OF_EACH: usize = 3;
/// Variance of readings that explains itself: noise, and what moves behind the lamp a little; squared grey levels.
const NOISE2: f64 = 4.0;
/// Between dark and lit there are so many grey levels, and they explain this part of all change.
const LEAST_GAIN: f64 = 8.0;
const LEAST_EXPLAINED: f64 = 0.8;
/// So much better than anybody else's code, nats.
const LEAD: f64 = 12.0;
/// A name holds so long after it was read last, seconds: somebody may stand before the lamp.
const HOLDS_S: f64 = 5.0;

/// Reads the lamps of a team.
#[derive(Debug, Default)]
pub struct BeaconReader {
    lamps: Vec<Lamp>,
    /// Different heights of lamps, metres.
    heights_m: Vec<f64>,
    watched: Vec<Watched>,
}

#[derive(Debug, Clone)]
struct Lamp {
    robot: RobotId,
    /// Of its marker: cylinder 0, bars 1, rectangle 2.
    kind: u8,
    bits: Vec<bool>,
    bit_s: f64,
    cycle_s: f64,
    /// Place in the list of heights.
    height: usize,
}

/// A fellow that is followed.
#[derive(Debug, Clone)]
struct Watched {
    bearing_rad: f64,
    range_m: f64,
    /// When, and how bright the lamp's place was for each height of a lamp.
    readings: VecDeque<(Timestamp, Vec<f64>)>,
    name: Option<(RobotId, Timestamp)>,
    decided: Timestamp,
}

/// How well a code explains what was read.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Fit {
    nats: f64,
    gain: f64,
    explained: f64,
}

impl BeaconReader {
    /// Of the fellows whose markers have a lamp and who have a name; at most [`MAX_BEACONS`].
    pub fn new(fellows: &[(Option<RobotId>, Marker)]) -> Self {
        let mut reader = Self::default();
        for (robot, marker) in fellows {
            let (Some(robot), Some(beacon)) = (robot, marker.beacon()) else { continue };
            if reader.lamps.len() < MAX_BEACONS {
                reader.add(*robot, marker, beacon);
            }
        }
        reader
    }

    fn add(&mut self, robot: RobotId, marker: &Marker, beacon: &Beacon) {
        let height_m = 1e-3 * f64::from(beacon.height_mm);
        let height = self.heights_m.iter().position(|h| *h == height_m).unwrap_or_else(|| {
            self.heights_m.push(height_m);
            self.heights_m.len() - 1
        });
        let kind = match marker {
            Marker::Cylinder { .. } => 0,
            Marker::Bars { .. } => 1,
            Marker::Rectangle { .. } => 2,
        };
        let bit_s = 1e-3 * f64::from(beacon.bit_ms);
        let (bits, cycle_s) = (beacon.bits().collect(), beacon.cycle_s());
        self.lamps.push(Lamp { robot, kind, bits, bit_s, cycle_s, height });
    }

    /// Pairs of robots whose codes are the same but for where they begin: neither can be told from the other.
    pub fn alike(&self) -> Vec<[RobotId; 2]> {
        let mut pairs = Vec::new();
        for (n, a) in self.lamps.iter().enumerate() {
            pairs.extend(self.lamps[n + 1..].iter().filter(|b| a.is_like(b)).map(|b| [a.robot, b.robot]));
        }
        pairs
    }

    /// Takes the lamps' brightness out of a picture, and names those of its fellows that have no name.
    pub fn read(&mut self, camera: &MountedCamera, raw: &[u8], capture: Timestamp, peers: &mut [Peer]) {
        if self.lamps.is_empty() {
            return;
        }
        // A clock may have been set back.
        self.watched
            .retain(|w| w.readings.back().is_some_and(|(at, _)| (0.0..FORGET_S).contains(&capture.seconds_since(*at))));
        let mut names = Vec::with_capacity(peers.len());
        for peer in peers.iter() {
            let seen = self.heights_m.iter().map(|height_m| brightness(camera, raw, peer, *height_m)).collect();
            names.push(self.watch(peer, capture, seen));
        }
        for (n, peer) in peers.iter_mut().enumerate() {
            // Nobody is in two places.
            let is_one = names.iter().filter(|name| **name == names[n]).count() == 1;
            peer.robot = peer.robot.or(names[n].filter(|_| is_one));
        }
    }

    /// Adds a reading; who it is.
    fn watch(&mut self, peer: &Peer, capture: Timestamp, seen: Option<Vec<f64>>) -> Option<RobotId> {
        let away = |w: &Watched| difference(w.bearing_rad, peer.bearing_rad).abs();
        let may_be = |w: &Watched| {
            w.readings.back().is_some_and(|(at, _)| *at != capture)
                && away(w) < NEAR[0]
                && (w.range_m / peer.range_m - 1.0).abs() < NEAR[1]
        };
        let known = (0..self.watched.len()).filter(|n| may_be(&self.watched[*n]));
        let known = known.min_by(|a, b| away(&self.watched[*a]).total_cmp(&away(&self.watched[*b])));
        let seen = seen?;
        let n = match known {
            Some(n) => n,
            None if self.watched.len() < MAX_WATCHED => {
                let readings = VecDeque::new();
                let decided = Timestamp::default();
                self.watched.push(Watched { bearing_rad: 0.0, range_m: 0.0, readings, name: None, decided });
                self.watched.len() - 1
            }
            None => return None,
        };
        let watched = &mut self.watched[n];
        (watched.bearing_rad, watched.range_m) = (peer.bearing_rad, peer.range_m);
        if watched.readings.len() == MAX_READINGS {
            watched.readings.pop_front();
        }
        watched.readings.push_back((capture, seen));
        let every_s = DECIDED_EVERY_S[usize::from(watched.name.is_some())];
        if capture.seconds_since(watched.decided).abs() >= every_s {
            watched.decided = capture;
            let robot = decided(&self.lamps, peer.kind, &watched.readings);
            watched.name = robot.map(|robot| (robot, capture)).or(watched.name);
        }
        watched.name = watched.name.filter(|(_, at)| capture.seconds_since(*at) < HOLDS_S);
        watched.name.map(|(robot, _)| robot)
    }
}

impl Lamp {
    fn is_like(&self, other: &Self) -> bool {
        let n = self.bits.len();
        let turned = |by: usize| (0..n).all(|k| self.bits[(k + by) % n] == other.bits[k]);
        self.kind == other.kind && self.bit_s == other.bit_s && n == other.bits.len() && (0..n).any(turned)
    }

    /// Whether it is lit so long after its code began; `None` where it may be either.
    fn is_lit(&self, at_s: f64) -> Option<bool> {
        let (bit, n) = (at_s / self.bit_s, self.bits.len());
        let of = |bit: f64| self.bits[(bit.floor().rem_euclid(n as f64) as usize).min(n - 1)];
        (of(bit - UNSURE) == of(bit + UNSURE)).then(|| of(bit))
    }

    /// The best that its code can be laid beside the last readings (seconds, brightness).
    fn fit(&self, readings: &[(f64, f64)]) -> Option<Fit> {
        let last_s = readings.last()?.0;
        let used: Vec<&(f64, f64)> = readings.iter().filter(|(t, _)| last_s - t < CYCLES * self.cycle_s).collect();
        if used.first().is_none_or(|first| last_s - first.0 < self.cycle_s) {
            return None;
        }
        let phases = self.bits.len() * PHASES;
        let fits = (0..phases).filter_map(|k| self.fit_at(&used, k as f64 / PHASES as f64 * self.bit_s));
        fits.max_by(|a, b| a.nats.total_cmp(&b.nats))
    }

    fn fit_at(&self, readings: &[&(f64, f64)], phase_s: f64) -> Option<Fit> {
        // Count, sum and squares of what is read while it is dark, and lit.
        let mut sums = [[0.0; 3]; 2];
        for (t, y) in readings {
            if let Some(is_lit) = self.is_lit(t + phase_s) {
                let sum = &mut sums[usize::from(is_lit)];
                [1.0, *y, y * y].iter().zip(sum).for_each(|(value, sum)| *sum += value);
            }
        }
        let [dark, lit] = sums;
        let n = dark[0] + lit[0];
        if n < LEAST_READINGS as f64 || dark[0].min(lit[0]) < LEAST_OF_EACH as f64 {
            return None;
        }
        let about = |[n, sum, squares]: [f64; 3]| (squares - sum * sum / n).max(0.0);
        let all = about([n, dark[1] + lit[1], dark[2] + lit[2]]);
        let rest = about(dark) + about(lit);
        Some(Fit {
            nats: 0.5 * n * ((all / n + NOISE2) / (rest / n + NOISE2)).ln(),
            gain: lit[1] / lit[0] - dark[1] / dark[0],
            explained: 1.0 - rest / all.max(1e-9),
        })
    }
}

/// Whose lamp it is, if that is clear.
fn decided(lamps: &[Lamp], kind: u8, readings: &VecDeque<(Timestamp, Vec<f64>)>) -> Option<RobotId> {
    let first = readings.front()?.0;
    let (mut best, mut second): (Option<(f64, Option<RobotId>)>, f64) = (None, 0.0);
    for lamp in lamps {
        let seen: Vec<(f64, f64)> =
            readings.iter().map(|(at, seen)| (at.seconds_since(first), seen[lamp.height])).collect();
        let Some(fit) = lamp.fit(&seen).filter(|fit| fit.gain > 0.0) else { continue };
        let is_clear = fit.gain >= LEAST_GAIN && fit.explained >= LEAST_EXPLAINED && lamp.kind == kind;
        let name = is_clear.then_some(lamp.robot);
        if best.is_none_or(|(nats, _)| fit.nats > nats) {
            second = best.map_or(0.0, |(nats, _)| nats);
            best = Some((fit.nats, name));
        } else {
            second = second.max(fit.nats);
        }
    }
    best.filter(|(nats, _)| nats - second >= LEAD).and_then(|(_, name)| name)
}

/// Mean grey level of the nine pixels about a lamp of a fellow; `None` where it is not in view.
fn brightness(camera: &MountedCamera, raw: &[u8], peer: &Peer, height_m: f64) -> Option<f64> {
    let (sin, cos) = peer.bearing_rad.sin_cos();
    let pixel = camera.project_body(&Vector3::new(peer.range_m * cos, peer.range_m * sin, height_m))?;
    let [w, h] = camera.image_size_px().map(|n| n as usize);
    let inside = pixel.x >= 1.0 && pixel.y >= 1.0 && pixel.x + 2.0 < w as f64 && pixel.y + 2.0 < h as f64;
    if !inside || raw.len() != w * h || !camera.is_unmasked(&Vector2::new(pixel.x, pixel.y)) {
        return None;
    }
    let (u, v) = (pixel.x.round() as usize, pixel.y.round() as usize);
    let sum: u32 = (v - 1..=v + 1).flat_map(|v| &raw[v * w + u - 1..=v * w + u + 1]).map(|gray| u32::from(*gray)).sum();
    Some(f64::from(sum) / 9.0)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use protocol::marker::Look;

    use super::*;

    fn marker(code: &str, bit_ms: u16) -> Marker {
        let beacon = Some(Beacon { height_mm: 540, code: code.to_owned(), bit_ms });
        let look = Some(Look { rings: Vec::new(), bar_width_deg: None, beacon });
        Marker::Cylinder { radius_m: 0.2, height_m: [0.1, 0.5], look }
    }

    fn reader(codes: &[&str], bit_ms: u16) -> BeaconReader {
        let name = |n: usize| RobotId::new(&format!("r{}", n + 1)).ok();
        BeaconReader::new(
            &codes.iter().enumerate().map(|(n, code)| (name(n), marker(code, bit_ms))).collect::<Vec<_>>(),
        )
    }

    fn peer(bearing_rad: f64) -> Peer {
        Peer {
            kind: Marker::CYLINDER,
            robot: None,
            bearing_rad,
            range_m: 2.0,
            covariance: nalgebra::Matrix2::identity(),
            heading_rad: None,
            confidence: 1.0,
            features: Vec::new(),
        }
    }

    /// Who it is after each frame at 10 Hz of what a lamp's place shows by time.
    fn names(reader: &mut BeaconReader, frames: usize, shown: impl Fn(f64) -> f64) -> Vec<Option<RobotId>> {
        let frame = |n: usize| {
            // Frames jitter.
            let t = 0.1 * n as f64 + 0.008 * (7.3 * n as f64).sin();
            reader.watch(&peer(1.0), Timestamp::from_secs_f64(5.0 + t), Some(vec![shown(t)]))
        };
        (0..frames).map(frame).collect()
    }

    /// By the definition: the code from the left, over and over, begun at some time.
    fn blinks(code: &str, bit_s: f64, begun_s: f64) -> impl Fn(f64) -> f64 {
        let bits: Vec<bool> = code.chars().map(|c| c == '1').collect();
        move |t: f64| {
            let bit = ((t + begun_s) / bit_s).floor() as usize % bits.len();
            // Noise of two grey levels.
            let noise = 2.0 * ((t * 1e4).sin() + (t * 7.7e3).cos());
            90.0 + noise + if bits[bit] { 60.0 } else { 0.0 }
        }
    }

    const CODES: [&str; 3] = ["1101000", "1110010", "1010110"];

    #[test]
    fn a_lamp_tells_its_name_within_two_cycles_whenever_it_began() {
        for (n, code) in CODES.iter().enumerate() {
            for begun in [0.0, 0.13, 0.77, 1.31] {
                let told = names(&mut reader(&CODES, 200), 30, blinks(code, 0.2, begun));
                assert!(told.iter().flatten().all(|name| name.to_string() == format!("r{}", n + 1)), "{code} {told:?}");
                assert!(told[28].is_some() && told[..10].iter().all(Option::is_none), "{code} {begun} {told:?}");
            }
        }
    }

    #[test]
    fn what_does_not_blink_a_code_has_no_name() {
        let steady = names(&mut reader(&CODES, 200), 60, |t| 90.0 + 2.0 * (t * 1e4).sin());
        let somebody_passes =
            names(&mut reader(&CODES, 200), 60, |t| if (1.0..1.9).contains(&t) { 30.0 } else { 120.0 });
        let waves = names(&mut reader(&CODES, 200), 60, |t| 90.0 + 40.0 * (TAU * t / 1.4).sin());
        let another = names(&mut reader(&CODES, 200), 60, blinks("1100110", 0.3, 0.0));
        let clutter = names(&mut reader(&CODES, 200), 200, |t| 90.0 + 50.0 * ((t * 911.0).sin() * 1e3).fract());
        for told in [steady, somebody_passes, waves, another, clutter] {
            assert!(told.iter().all(Option::is_none), "{told:?}");
        }
    }

    #[test]
    fn a_name_outlives_somebody_before_the_lamp_but_not_for_long() {
        let shown = blinks(CODES[0], 0.2, 0.0);
        let told = names(&mut reader(&CODES, 200), 110, |t| if t < 4.0 { shown(t) } else { 40.0 });
        assert!(told[60].is_some() && told[109].is_none(), "{told:?}");
    }

    #[test]
    fn codes_that_only_begin_elsewhere_are_alike_and_name_nobody() {
        let mut alike = reader(&["1101000", "0001101", "1110010"], 200);
        assert_eq!(alike.alike().len(), 1);
        let told = names(&mut alike, 40, blinks("1101000", 0.2, 0.0));
        assert!(told.iter().all(Option::is_none), "{told:?}");
    }
}
