//! One message a frame: what the robot saw, as bearings.
//!
//! All angles are in the robot's body frame (x forward, y left, z up), counter-clockwise, tilt of the mounting removed.

mod wire;

use std::f64::consts::FRAC_PI_2;

use bincode::{Decode, Encode};

use crate::codec::{Invalid, Kind, Message, bounded_decode, check};
use crate::id::{RobotId, TrackId};
use crate::quantity::{Angle16, Fraction8, LogSigma, Millimetres};
use crate::time::Timestamp;

/// Longest way and turn between two observations, metres and radians, and largest variance of them: sums of such steps stay far from
/// what a map can carry.
const MAX_STEP: f64 = 1e4;
const MAX_STEP_VARIANCE: f64 = 1e6;
/// Most sightings in one observation.
pub const MAX_SIGHTINGS: usize = 32;
/// Most tracks in one observation.
pub const MAX_TRACKS: usize = 64;
/// Most features in one sighting.
pub const MAX_FEATURES: usize = 32;

/// One frame of one robot.
#[derive(Debug, Clone, PartialEq)]
pub struct Observation {
    /// Session of the agent, as announced.
    pub epoch: u64,
    /// Counts every observation of the session from 0: gaps are losses.
    pub sequence: u32,
    /// When the light fell in (mid-exposure), on the robot's own clock.
    pub capture: Timestamp,
    /// What the robot itself was doing.
    pub motion: Motion,
    /// Motion since the last observation, where the robot knows it.
    pub odometry: Option<Odometry>,
    /// Which stages ran before the time budget ended.
    pub stages: Stages,
    /// Fellow robots seen in this frame (≤ [`MAX_SIGHTINGS`]).
    pub sightings: Vec<PeerSighting>,
    /// Moving objects (≤ [`MAX_TRACKS`]). Empty while the robot moves.
    pub tracks: Vec<TrackObservation>,
}

/// What the robot itself is doing, as far as it knows. Tracks are suspended in every state but `Standing`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Motion {
    /// The picture stands still.
    Standing,
    /// The picture shifts sideways.
    Turning,
    /// The picture changes as a driving robot's does.
    Moving,
    /// Somebody carries it.
    Lifted,
    /// Not known yet (the first frames), or the picture fits nothing (alarm).
    Unknown,
}

/// Motion of the body since the last observation, in the body frame at that time.
#[derive(Debug, Clone, Copy, PartialEq, Encode, Decode)]
pub struct Odometry {
    /// Metres forward.
    pub dx_m: f32,
    /// Metres to the left.
    pub dy_m: f32,
    /// Radians counter-clockwise.
    pub dheading_rad: f32,
    /// Upper triangle of the covariance (xx, xy, xh, yy, yh, hh), m and rad.
    pub covariance: [f32; 6],
}

/// Bit set of the stages that ran.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Stages(pub u8);

impl Stages {
    /// Change detection.
    pub const MOTION: u8 = 1;
    /// Regions.
    pub const EXTRACTION: u8 = 2;
    /// Tracks.
    pub const TRACKING: u8 = 4;
    /// Bearings, elevations, ranges.
    pub const LOCALISATION: u8 = 8;
    /// Classes.
    pub const IDENTIFICATION: u8 = 16;
    /// Peer detection.
    pub const PEERS: u8 = 32;
    /// All of them.
    pub const ALL: Self = Self(63);

    /// Whether `stage` ran.
    pub fn ran(self, stage: u8) -> bool {
        self.0 & stage != 0
    }
}

/// A fellow robot in the picture.
#[derive(Debug, Clone, PartialEq)]
pub struct PeerSighting {
    /// Which of the announced markers it wears: a number of [`Marker`](crate::marker::Marker), such as `Marker::CYLINDER`.
    pub marker: u8,
    /// Who it is, where the marker says so. Robots that look alike leave it open: the leader names them.
    pub robot: Option<RobotId>,
    /// To the peer's axis.
    pub bearing: Angle16,
    /// One standard deviation, radians.
    pub bearing_sigma: LogSigma,
    /// To the peer's axis, along the floor, where known.
    pub range: Option<SightedRange>,
    /// The peer's heading minus the observer's, with its sigma (rad), where the marker shows it.
    pub heading: Option<(Angle16, LogSigma)>,
    /// How sure the detector is that this is a robot at all.
    pub confidence: Fraction8,
    /// The raw measurements, right edge first. Where present they *are* the measurement; bearing and range follow from them.
    pub features: Vec<Feature>,
}

/// Distance along the floor with one standard deviation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SightedRange {
    /// To the axis.
    pub range: Millimetres,
    /// Metres.
    pub sigma: LogSigma,
}

/// One raw measurement on a marker. The bearing is of the feature itself (an occluding edge, a bar); the elevations are of
/// the lower and upper end of the marker's `height_m` on its *near* surface (range − radius for a cylinder).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Feature {
    /// Which part.
    pub part: FeaturePart,
    /// Of the feature.
    pub bearing: Angle16,
    /// Standard deviation of the bearing, radians.
    pub sigma: LogSigma,
    /// Elevations of the marker's lower and upper end, with their common standard deviation (rad), where both are measured.
    pub elevation: Option<([Angle16; 2], LogSigma)>,
}

/// Which part of a marker a feature is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FeaturePart {
    /// Left occluding edge (larger bearing).
    Left,
    /// Right occluding edge (smaller bearing).
    Right,
    /// A bar, with its index where the code tells.
    Bar(Option<u8>),
    /// An edge of a rectangle, 0 right, 1 left.
    Edge(u8),
}

/// A moving object as this robot sees it.
#[derive(Debug, Clone, PartialEq)]
pub struct TrackObservation {
    /// Which.
    pub track: TrackId,
    /// How it is seen.
    pub state: TrackState,
    /// To the vertical axis of the object.
    pub bearing: Angle16,
    /// One standard deviation to the object's *axis*, radians: larger than a pixel on a swaying body.
    pub bearing_sigma: LogSigma,
    /// Elevation of the lowest and highest visible point.
    pub elevation: [Angle16; 2],
    /// Standard deviation of a `Seen` end, radians.
    pub elevation_sigma: LogSigma,
    /// What the two ends are.
    pub ends: [ElevationEnd; 2],
    /// Angular width.
    pub width: Angle16,
    /// Range along the floor from ground contact or height, where known.
    pub range: Option<SightedRange>,
    /// What it is.
    pub class: ObjectClass,
    /// That it is a real moving object.
    pub confidence: Fraction8,
    /// It was with others of late, and may be somebody else than it was under this number before.
    pub doubtful: bool,
    /// What it looks like ([`crate::appearance::Appearance::to_bytes`]), sent only when a track is born, merges or splits, or is
    /// known better than before. While it is `doubtful`: what has come out where it is followed, and never what it was before.
    pub appearance: Option<[u8; 16]>,
}

/// How a track is seen in this frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TrackState {
    /// Measured alone.
    Visible,
    /// In one region with others: the bearing is of the region.
    Merged,
    /// Not measured: predicted.
    Hidden,
}

/// What an end of an elevation interval is. A `Cut` or `Hidden` end is a one-sided bound, never a measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ElevationEnd {
    /// The object ends there.
    Seen,
    /// The field of view or the mask ends there.
    Cut,
    /// A nearer object hides the rest.
    Hidden,
}

/// What a track is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ObjectClass {
    /// Not decided.
    Unknown,
    /// A person.
    Person,
    /// A fellow robot.
    Robot,
    /// Something that sways in place.
    Swaying,
    /// Something else.
    Other,
}

impl Message for Observation {
    const KIND: Kind = Kind::Observation;

    fn validate(&self) -> Result<(), Invalid> {
        check::count("sightings", self.sightings.len(), MAX_SIGHTINGS)?;
        check::count("tracks", self.tracks.len(), MAX_TRACKS)?;
        check::in_range("stages", self.stages.0, 0.0, Stages::ALL.0.into())?;
        if let Some(odometry) = &self.odometry {
            for step in [odometry.dx_m, odometry.dy_m, odometry.dheading_rad] {
                check::in_range("odometry", step, -MAX_STEP, MAX_STEP)?;
            }
            check::covariance("odometry.covariance", &odometry.covariance, 3)?;
            for entry in odometry.covariance {
                check::in_range("odometry.covariance", entry, -MAX_STEP_VARIANCE, MAX_STEP_VARIANCE)?;
            }
        }
        self.sightings.iter().try_for_each(PeerSighting::validate)?;
        self.tracks.iter().try_for_each(TrackObservation::validate)
    }

    bounded_decode!(Kind::Observation);
}

impl PeerSighting {
    fn validate(&self) -> Result<(), Invalid> {
        check::in_range("sightings.marker", self.marker, 0.0, 2.0)?;
        check::count("sightings.features", self.features.len(), MAX_FEATURES)?;
        for feature in &self.features {
            if let FeaturePart::Edge(edge) = feature.part {
                check::in_range("sightings.features.edge", edge, 0.0, 1.0)?;
            }
            if let Some((ends, _)) = feature.elevation {
                elevations("sightings.features.elevation", ends)?;
            }
        }
        Ok(())
    }
}

impl TrackObservation {
    fn validate(&self) -> Result<(), Invalid> {
        elevations("tracks.elevation", self.elevation)
    }
}

/// Two elevations from −90° to 90°, the lower one first.
fn elevations(field: &'static str, ends: [Angle16; 2]) -> Result<(), Invalid> {
    for end in ends {
        check::in_range(field, end.rad(), -FRAC_PI_2, FRAC_PI_2)?;
    }
    check::consistent(ends[0] <= ends[1], field, "has its lower end above its upper one")
}
