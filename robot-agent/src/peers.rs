//! Fellow robots in a single picture, by the look they announce.
//!
//! A standing robot is background to the motion stage, so it must be found in the picture itself. What is announced makes that a
//! measurement and not a recognition task: the rings of a body of known radius at a known height have one appearance for each
//! bearing and range. Cylinders are found here (`MATHS.md` §5.2.1); bars and rectangle are further kinds of finder.
//!
//! The raw features (outlines, elevations of the marker's ends) are the measurement; bearing and range follow from them. Every
//! sigma has two parts: noise that is new in each frame, and a floor (`floor_rad`) that successive frames of a standing pair share.

mod bars;
mod beacon;
mod blur;
mod combine;
mod cylinder;
mod edges;
mod geometry;
mod kernel;
mod learn;
mod look;
mod near;
mod occluder;
mod plate;
mod rays;
mod refusals;
mod rings;
mod search;
mod shades;
mod verdict;

use nalgebra::Matrix2;
use protocol::angle::difference;
use protocol::id::RobotId;
use protocol::marker::Marker;
use protocol::message::observation::{Feature, FeaturePart, PeerSighting, SightedRange};
use protocol::quantity::{Angle16, Fraction8, LogSigma, Millimetres};
use protocol::time::Timestamp;

pub use learn::{KnownView, LearnError, Learnt, learn};
pub use search::Grid;
use verdict::LEAST_LOG_ODDS;
pub use verdict::{Basis, Fit, Node, Traits, WORTH_A_LOOK, log_odds, net, together};

use beacon::BeaconReader;
use cylinder::{CylinderFinder, Part};
use look::{CylinderLook, PlateLook};
use plate::PlateFinder;
use rays::PixelRays;

use crate::optics::MountedCamera;

/// Most different looks in one team.
pub const MAX_LOOKS: usize = 8;
/// A full search every so many frames in [`PeerDetector::follow`]; between them only known peers are measured.
const SEARCH_EVERY: u64 = 5;
/// A known peer that was not seen for so many frames is forgotten.
const FORGET_AFTER: u64 = 5;

/// Log-odds of one more plate than were announced.
const EXTRA_PLATE_LOG_ODDS: f64 = 3.0;

/// Nearer to each other than this share of their widths two bodies are one.
const SAME_BODY: f64 = 0.85;

/// Why a marker cannot be looked for.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PeerError {
    /// A marker without rings or stripes: nothing to find it by.
    #[error("the marker has no `look`: a single picture finds it by its rings or stripes (`look.rings`)")]
    NoLook,
    /// Bars without a width, or no bars.
    #[error("the bars have no width to look for: give `azimuths_deg` and `look.bar_width_deg`")]
    NoBars,
    /// A look that cannot be used.
    #[error("the marker's `{key}` is {value}; {want} would be right")]
    BadLook {
        /// The key in the marker.
        key: &'static str,
        /// What it is.
        value: f64,
        /// What would be right.
        want: &'static str,
    },
    /// Too many different looks.
    #[error("{0} different looks; at most {MAX_LOOKS} can be looked for")]
    TooMany(usize),
}

/// A fellow robot in the picture.
#[derive(Debug, Clone, PartialEq)]
pub struct Peer {
    /// Kind of marker: cylinder 0, bars 1, rectangle 2.
    pub kind: u8,
    /// Who it is, where the marker says so.
    pub robot: Option<RobotId>,
    /// To the axis, body frame, radians.
    pub bearing_rad: f64,
    /// To the axis along the floor, metres.
    pub range_m: f64,
    /// Of (bearing, range), everything included: noise, floors, the mounting's height and tilt.
    pub covariance: Matrix2<f64>,
    /// The peer's heading minus the observer's and its sigma, where the marker shows it.
    pub heading_rad: Option<[f64; 2]>,
    /// That it is a robot at all, 0 … 1.
    pub confidence: f64,
    /// Raw measurements, right edge first. Empty where no outline is in view: then bearing and range come from the rings.
    pub features: Vec<PeerFeature>,
}

/// One raw measurement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PeerFeature {
    /// Which.
    pub part: FeaturePart,
    /// Of the feature itself, body frame, radians.
    pub bearing_rad: f64,
    /// Standard deviation, floor included, radians.
    pub sigma_rad: f64,
    /// The part of `sigma_rad` that successive frames of a standing pair share.
    pub floor_rad: f64,
    /// Elevations of the marker's lower and upper end on the near surface, as from the camera's viewpoint; on the first feature
    /// only. They are fitted to all inner ring edges in view; an end out of view is extrapolated and its sigma says so.
    pub elevation_rad: Option<[f64; 2]>,
    /// Standard deviation of either, floor included, without the mounting's height and tilt.
    pub elevation_sigma_rad: f64,
    /// The part that successive frames share.
    pub elevation_floor_rad: f64,
}

/// Finds fellow robots of announced looks in pictures of one camera.
#[derive(Debug)]
pub struct PeerDetector {
    camera: MountedCamera,
    rays: PixelRays,
    finders: Vec<CylinderFinder>,
    plates: Vec<PlateFinder>,
    /// Fellows that wear plates.
    announced_plates: usize,
    beacons: BeaconReader,
    unsupported: Vec<PeerError>,
    known: Vec<Known>,
    frames: u64,
}

#[derive(Debug, Clone, Copy)]
struct Known {
    bearing_rad: f64,
    range_m: f64,
    last_seen: u64,
}

impl PeerDetector {
    /// Prepares for a camera, its cylinder panorama and the looks in the team (equal ones are looked for once). Markers that
    /// cannot be looked for are kept in [`PeerDetector::unsupported`]; the others work.
    pub fn new(camera: &MountedCamera, grid: Grid, markers: &[Marker]) -> Self {
        let fellows: Vec<_> = markers.iter().map(|marker| (None, marker.clone())).collect();
        Self::for_team(camera, grid, &fellows)
    }

    /// As [`PeerDetector::new`], with the name of the robot that wears each marker, for markers that tell it.
    pub fn for_team(camera: &MountedCamera, grid: Grid, fellows: &[(Option<RobotId>, Marker)]) -> Self {
        let mut looks: Vec<CylinderLook> = Vec::new();
        let mut plates: Vec<PlateLook> = Vec::new();
        let mut unsupported = Vec::new();
        let is_plate = |marker: &Marker| matches!(marker, Marker::Rectangle { .. });
        for (robot, marker) in fellows {
            if is_plate(marker) {
                match PlateLook::from_marker(marker) {
                    Ok(look) if plates.contains(&look) => {}
                    Ok(_) if plates.len() == MAX_LOOKS => unsupported.push(PeerError::TooMany(MAX_LOOKS + 1)),
                    Ok(look) => plates.push(look),
                    Err(error) => unsupported.push(error),
                }
                continue;
            }
            match CylinderLook::from_marker(marker, *robot) {
                Ok(look) if looks.iter_mut().any(|known| known.merge(&look)) => {}
                Ok(_) if looks.len() == MAX_LOOKS => unsupported.push(PeerError::TooMany(MAX_LOOKS + 1)),
                Ok(look) => looks.push(look),
                Err(error) => unsupported.push(error),
            }
        }
        let both = |look: CylinderLook| {
            let upper = look.upper_part().map(|look| CylinderFinder::new(camera, grid, look, Part::Upper));
            std::iter::once(CylinderFinder::new(camera, grid, look, Part::Whole)).chain(upper)
        };
        let finders = looks.into_iter().flat_map(both).collect();
        Self {
            camera: camera.clone(),
            rays: PixelRays::new(camera.image_size_px()),
            finders,
            plates: plates.into_iter().map(|look| PlateFinder::new(camera, grid, look)).collect(),
            announced_plates: fellows.iter().filter(|(_, marker)| is_plate(marker)).count(),
            beacons: BeaconReader::new(fellows),
            unsupported,
            known: Vec::new(),
            frames: 0,
        }
    }

    /// Markers that are not looked for, and why.
    pub fn unsupported(&self) -> &[PeerError] {
        &self.unsupported
    }

    /// Pairs of fellows whose lamps blink the same code: neither gets a name by it.
    pub fn alike_beacons(&self) -> Vec<[RobotId; 2]> {
        self.beacons.alike()
    }

    /// The robots in one picture, in order of bearing. `raw` has the camera's size, `panorama` the grid's; a slice of another size
    /// gives none.
    pub fn detect(&mut self, raw: &[u8], panorama: &[u8]) -> Vec<Peer> {
        self.find(raw, Some(panorama), None, &[])
    }

    /// Whether [`PeerDetector::follow`] will search the whole circle of the next frame, in any case.
    pub fn will_search(&self) -> bool {
        self.frames.is_multiple_of(SEARCH_EVERY)
            || !self.known.iter().any(|k| self.frames - k.last_seen <= FORGET_AFTER)
    }

    /// The camera has moved since the last picture: places that were no robot are others now.
    pub fn moved(&mut self) {
        self.finders.iter_mut().for_each(CylinderFinder::forget);
        self.plates.iter_mut().for_each(PlateFinder::forget);
    }

    /// Names fellows that [`PeerDetector::detect`] found in a stream by the lamps that they blink. The pictures come in the order of
    /// their capture times.
    pub fn read_beacons(&mut self, raw: &[u8], capture: Timestamp, peers: &mut [Peer]) {
        self.beacons.read(&self.camera, raw, capture, peers);
    }

    /// Like [`PeerDetector::detect`] for a stream, with names by lamps: known peers are measured in each frame, the whole circle is searched
    /// every fifth frame, and once when a known peer is lost. Places where something was taken for no robot are left alone for some
    /// seconds while they look the same.
    pub fn follow(&mut self, raw: &[u8], panorama: &[u8], capture: Timestamp) -> Vec<Peer> {
        let search = self.will_search();
        let frame = self.frames;
        self.frames += 1;
        self.known.retain(|k| frame - k.last_seen <= FORGET_AFTER);
        let known: Vec<(f64, f64)> = self.known.iter().map(|k| (k.bearing_rad, k.range_m)).collect();
        let mut peers = self.find(raw, search.then_some(panorama), Some(capture), &known);
        let expected = self.known.iter().filter(|k| frame - k.last_seen <= 1).count();
        if !search && peers.len() < expected {
            peers = self.find(raw, Some(panorama), Some(capture), &known);
        }
        for peer in &peers {
            let now = Known { bearing_rad: peer.bearing_rad, range_m: peer.range_m, last_seen: frame };
            let same = |k: &&mut Known| {
                difference(k.bearing_rad, peer.bearing_rad).abs() < 0.1 && (k.range_m / peer.range_m - 1.0).abs() < 0.2
            };
            match self.known.iter_mut().find(same) {
                Some(known) => *known = now,
                None => self.known.push(now),
            }
        }
        self.read_beacons(raw, capture, &mut peers);
        peers
    }

    /// What cylinders and plates were fitted to since the last call, robots or not, at most some thousands; kept from the first call on. For learning
    /// what tells them apart.
    pub fn take_fits(&mut self) -> Vec<Fit> {
        let cylinders = self.finders.iter_mut().flat_map(CylinderFinder::take_fits);
        cylinders.chain(self.plates.iter_mut().flat_map(PlateFinder::take_fits)).collect()
    }

    /// Places that the last call looked at closely.
    pub fn looks(&self) -> usize {
        let cylinders = self.finders.iter().map(CylinderFinder::looks);
        cylinders.chain(self.plates.iter().map(PlateFinder::looks)).sum()
    }

    fn find(
        &mut self,
        raw: &[u8],
        panorama: Option<&[u8]>,
        stream: Option<Timestamp>,
        known: &[(f64, f64)],
    ) -> Vec<Peer> {
        let [w, h] = self.camera.image_size_px();
        if raw.len() != w as usize * h as usize {
            return Vec::new();
        }
        self.rays.measure_noise(raw);
        let mut found = Vec::new();
        for finder in &mut self.finders {
            let panorama = panorama.filter(|p| p.len() == finder.panorama_len());
            let finds = finder.find(&self.camera, &mut self.rays, raw, panorama, stream, (known, &found));
            found.extend(finds);
        }
        let mut plates = Vec::new();
        for finder in &mut self.plates {
            let panorama = panorama.filter(|p| p.len() == finder.panorama_len());
            plates.extend(finder.find(&self.camera, &mut self.rays, raw, panorama, stream, known));
        }
        // Plates beyond doubt may hide what stands behind them.
        let (sure, possible): (Vec<Find>, Vec<Find>) = plates.into_iter().partition(|f| f.log_odds >= LEAST_LOG_ODDS);
        if !sure.is_empty() {
            let since = found.len();
            found.extend(sure);
            for finder in &mut self.finders {
                let is_searched = panorama.is_some_and(|p| p.len() == finder.panorama_len());
                let behind = finder.find_behind(&self.camera, &mut self.rays, raw, is_searched, (&found, since));
                found.extend(behind);
            }
        }
        found.extend(possible);
        let mut peers = as_announced(without_doubles(found), self.announced_plates);
        peers.sort_by(|a, b| a.bearing_rad.total_cmp(&b.bearing_rad));
        peers
    }
}

/// What one finder says of a robot.
struct Find {
    peer: Peer,
    /// ln of the odds that it is one.
    log_odds: f64,
    /// Half of the body's width, and how high it is, metres.
    half_m: f64,
    high_m: f64,
}

/// What is expected, and what other finders have found: known (bearing, range) and finds.
type Before<'a> = (&'a [(f64, f64)], &'a [Find]);

/// One body may be taken for two kinds of marker: the likelier one stands. Likeliest first.
fn without_doubles(mut found: Vec<Find>) -> Vec<Find> {
    found.sort_by(|a, b| b.log_odds.total_cmp(&a.log_odds));
    let mut kept: Vec<Find> = Vec::new();
    for find in found {
        let is_taken = |other: &Find| {
            let apart = difference(other.peer.bearing_rad, find.peer.bearing_rad).abs();
            let (a, b) = (other.peer.range_m, find.peer.range_m);
            // Two bodies are not in one place; one that hides the other may seem nearer or farther than it is.
            let is_before = apart * a.min(b) < 0.8 * other.half_m.max(find.half_m)
                && (a - b).abs() < 0.05 * a + 0.6 * (other.half_m + find.half_m);
            (other.peer.kind == Marker::RECTANGLE) != (find.peer.kind == Marker::RECTANGLE)
                && (is_before || other.peer.apart_m(&find.peer) < SAME_BODY * (other.half_m + find.half_m))
        };
        if !kept.iter().any(is_taken) {
            kept.push(find);
        }
    }
    kept
}

/// Of plates, which furniture resembles most, the likeliest ones, as many as were announced, need odds as their finder asks; what else
/// looks like one, and somebody who has not announced himself, must be beyond doubt.
fn as_announced(likeliest_first: Vec<Find>, mut announced_plates: usize) -> Vec<Peer> {
    let stays = |find: &Find| {
        let is_extra = find.peer.kind == Marker::RECTANGLE && announced_plates == 0;
        announced_plates -= usize::from(find.peer.kind == Marker::RECTANGLE && !is_extra);
        !is_extra || find.log_odds >= EXTRA_PLATE_LOG_ODDS
    };
    likeliest_first.into_iter().filter(stays).map(|find| find.peer).collect()
}

impl Peer {
    /// As it goes on the wire.
    pub fn to_sighting(&self) -> PeerSighting {
        let feature = |f: &PeerFeature| Feature {
            part: f.part,
            bearing: Angle16::from_rad(f.bearing_rad),
            sigma: LogSigma::from_value(f.sigma_rad),
            elevation: f.elevation_rad.map(|e| (e.map(Angle16::from_rad), LogSigma::from_value(f.elevation_sigma_rad))),
        };
        PeerSighting {
            marker: self.kind,
            robot: self.robot,
            bearing: Angle16::from_rad(self.bearing_rad),
            bearing_sigma: LogSigma::from_value(self.bearing_sigma_rad()),
            range: Some(SightedRange {
                range: Millimetres::from_m(self.range_m),
                sigma: LogSigma::from_value(self.range_sigma_m()),
            }),
            heading: self.heading_rad.map(|[h, s]| (Angle16::from_rad(h), LogSigma::from_value(s))),
            confidence: Fraction8::from_value(self.confidence),
            features: self.features.iter().map(feature).collect(),
        }
    }

    /// How far from another's its axis is along the floor, metres.
    fn apart_m(&self, other: &Self) -> f64 {
        let (a, b) = (self.range_m, other.range_m);
        let cosine = difference(self.bearing_rad, other.bearing_rad).cos();
        (a * a + b * b - 2.0 * a * b * cosine).max(0.0).sqrt()
    }

    /// Standard deviation of the bearing, radians.
    pub fn bearing_sigma_rad(&self) -> f64 {
        self.covariance[(0, 0)].max(0.0).sqrt()
    }

    /// Standard deviation of the range, metres.
    pub fn range_sigma_m(&self) -> f64 {
        self.covariance[(1, 1)].max(0.0).sqrt()
    }
}

#[cfg(test)]
mod test_scene;
#[cfg(test)]
mod tests;
