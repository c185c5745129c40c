//! What robots wear so that others can measure them: geometry, look, and where features appear.
//!
//! `MATHS.md` §5.2: cylinder (report 5.2.1, erratum to 5-2), vertical bars (5.2.2), rectangle (5.2.3). [`Marker::features`]
//! predicts a picture from a relative pose; [`closed_form`] goes the other way.

pub mod closed_form;
mod features;
#[cfg(test)]
mod golden;

use bincode::{Decode, Encode};
use serde::{Deserialize, Serialize};

use crate::codec::{Invalid, check};

pub use features::{PredictedFeature, polar_jacobian};

/// Most bars of a marker.
pub const MAX_BARS: usize = 64;
/// Widest bar, in multiples of the narrowest.
pub const MAX_BAR_CODE: u8 = 16;
/// Most rings of a look.
pub const MAX_RINGS: usize = 32;
/// Largest legal length of a marker, metres.
pub const MAX_LENGTH_M: f64 = 10.0;

/// A marker: geometry and look. `kind` selects.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Encode, Decode)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Marker {
    /// The cylindrical body.
    Cylinder {
        /// Of the body, metres.
        radius_m: f64,
        /// Lower and upper end above the floor, metres.
        #[serde(default = "default_height_m")]
        height_m: [f64; 2],
        /// How it is painted.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        look: Option<Look>,
    },
    /// Vertical bars round a cylinder.
    Bars {
        /// Of the circle of bars, metres.
        radius_m: f64,
        /// Azimuths of the bars in the body frame, degrees.
        azimuths_deg: Vec<f64>,
        /// Lower and upper end above the floor, metres.
        height_m: [f64; 2],
        /// Code that tells the bars apart: the width of each in multiples of the look's `bar_width_deg`, 1 … 16.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        code: Option<Vec<u8>>,
        /// How it is painted.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        look: Option<Look>,
    },
    /// A flat upright rectangle of known size that looks along the body's x axis.
    Rectangle {
        /// W.
        width_m: f64,
        /// H.
        height_m: f64,
        /// L₁: from the edge that an observer in front sees on its left (the body's right) to the foot of the
        /// perpendicular from the robot's axis.
        left_edge_m: f64,
        /// d: the axis' distance behind the plate.
        behind_m: f64,
        /// Lower edge above the floor.
        bottom_m: f64,
        /// How it is painted.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        look: Option<Look>,
    },
}

fn default_height_m() -> [f64; 2] {
    [0.1, 0.5]
}

/// How a marker is painted: horizontal rings from the bottom up, by which a single picture finds it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Encode, Decode)]
#[serde(deny_unknown_fields)]
pub struct Look {
    /// Rings from the lower to the upper end, without gaps.
    pub rings: Vec<Ring>,
    /// Vertical bars are painted on the body: in them every ring has the reflectance that adds with its own to the sum of
    /// the darkest and the brightest ring's (dark and bright are exchanged). Width of a bar of code 1 as an angle at the
    /// axis, 0.1 … 180; a bar of code n is n times as wide, bars without code are of code 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bar_width_deg: Option<f64>,
    /// A lamp that says who it is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub beacon: Option<Beacon>,
}

/// A lamp on the robot's axis, seen from all round, that blinks a code again and again: the report's "active signals", an
/// identity for robots whose paint says nothing. Codes of a team must differ however far they are turned round.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize, Encode, Decode)]
#[serde(deny_unknown_fields)]
pub struct Beacon {
    /// Of the lamp's middle above the floor, millimetres, 1 … 10,000.
    pub height_mm: u16,
    /// Lit (1) and dark (0) one after the other: 4 … 32 of them, of both kinds.
    pub code: String,
    /// How long each is, milliseconds, 20 … 2000, the whole code at most 8 s. At least two frames of those who look.
    pub bit_ms: u16,
}

/// Least and most bits of a beacon's code, and its longest cycle, seconds.
pub const BEACON_BITS: [usize; 2] = [4, 32];
/// See [`BEACON_BITS`].
pub const MAX_BEACON_CYCLE_S: f64 = 8.0;

impl Beacon {
    /// Lit or dark, in order.
    pub fn bits(&self) -> impl ExactSizeIterator<Item = bool> + Clone + '_ {
        self.code.bytes().map(|bit| bit == b'1')
    }

    /// Until the code begins anew, seconds.
    pub fn cycle_s(&self) -> f64 {
        1e-3 * f64::from(self.bit_ms) * self.code.len() as f64
    }

    /// Whether it can be seen and read: height, length of a bit and the code's length are legal, the code has 0 and 1 alone and both.
    pub fn validate(&self) -> Result<(), Invalid> {
        check::in_range("marker.look.beacon.height_mm", f64::from(self.height_mm), 1.0, 1e3 * MAX_LENGTH_M)?;
        check::in_range("marker.look.beacon.bit_ms", f64::from(self.bit_ms), 20.0, 2000.0)?;
        let (least, most) = (BEACON_BITS[0] as f64, BEACON_BITS[1] as f64);
        check::in_range("marker.look.beacon.code (its length)", self.code.len() as f64, least, most)?;
        check::in_range(
            "marker.look.beacon.bit_ms (times the code's length, s)",
            self.cycle_s(),
            0.0,
            MAX_BEACON_CYCLE_S,
        )?;
        let legal = self.code.bytes().all(|bit| matches!(bit, b'0' | b'1'));
        check::consistent(legal, "marker.look.beacon.code", "has something else than 0 and 1")?;
        let blinks = self.bits().any(|lit| lit) && self.bits().any(|lit| !lit);
        check::consistent(blinks, "marker.look.beacon.code", "never changes")
    }
}

/// One horizontal ring.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, Encode, Decode)]
#[serde(deny_unknown_fields)]
pub struct Ring {
    /// Lower and upper edge above the floor, metres.
    pub height_m: [f64; 2],
    /// Diffuse reflectance, 0 … 1.
    pub reflectance: f64,
}

impl Marker {
    /// Number of a cylinder in [`PeerSighting::marker`](crate::message::PeerSighting::marker).
    pub const CYLINDER: u8 = 0;
    /// Of one with bars.
    pub const BARS: u8 = 1;
    /// Of a rectangle.
    pub const RECTANGLE: u8 = 2;
    /// What they are called in files, by their numbers.
    pub const KINDS: [&str; 3] = ["cylinder", "bars", "rectangle"];

    /// What it is called in files.
    pub fn kind_name(&self) -> &'static str {
        Self::KINDS[usize::from(match self {
            Self::Cylinder { .. } => Self::CYLINDER,
            Self::Bars { .. } => Self::BARS,
            Self::Rectangle { .. } => Self::RECTANGLE,
        })]
    }

    /// How it is painted and lit.
    pub fn look(&self) -> Option<&Look> {
        let (Self::Cylinder { look, .. } | Self::Bars { look, .. } | Self::Rectangle { look, .. }) = self;
        look.as_ref()
    }

    /// The lamp that says who it is.
    pub fn beacon(&self) -> Option<&Beacon> {
        self.look().and_then(|look| look.beacon.as_ref())
    }

    /// Whether the geometry is possible: positive finite lengths up to [`MAX_LENGTH_M`], ends in order, a code as long as
    /// the bars, rings without overlap. Configurations and messages are checked alike.
    pub fn validate(&self) -> Result<(), Invalid> {
        let look = match self {
            Self::Cylinder { radius_m, height_m, look } => {
                positive_length("marker.radius_m", *radius_m)?;
                interval("marker.height_m", *height_m)?;
                look
            }
            Self::Bars { radius_m, azimuths_deg, height_m, code, look } => {
                positive_length("marker.radius_m", *radius_m)?;
                interval("marker.height_m", *height_m)?;
                check::count("marker.azimuths_deg", azimuths_deg.len(), MAX_BARS)?;
                check::all_finite("marker.azimuths_deg", azimuths_deg)?;
                let coded = code.as_ref().is_none_or(|code| code.len() == azimuths_deg.len());
                check::consistent(coded, "marker.code", "has not one number a bar")?;
                let legal = code.iter().flatten().all(|width| (1..=MAX_BAR_CODE).contains(width));
                check::consistent(legal, "marker.code", "has a number outside 1 to 16")?;
                look
            }
            Self::Rectangle { width_m, height_m, left_edge_m, behind_m, bottom_m, look } => {
                positive_length("marker.width_m", *width_m)?;
                positive_length("marker.height_m", *height_m)?;
                check::in_range("marker.left_edge_m", *left_edge_m, -MAX_LENGTH_M, MAX_LENGTH_M)?;
                check::in_range("marker.behind_m", *behind_m, -MAX_LENGTH_M, MAX_LENGTH_M)?;
                check::in_range("marker.bottom_m", *bottom_m, 0.0, MAX_LENGTH_M)?;
                look
            }
        };
        look.as_ref().map_or(Ok(()), Look::validate)
    }
}

impl Look {
    fn validate(&self) -> Result<(), Invalid> {
        check::count("marker.look.rings", self.rings.len(), MAX_RINGS)?;
        if let Some(width_deg) = self.bar_width_deg {
            check::in_range("marker.look.bar_width_deg", width_deg, 0.1, 180.0)?;
        }
        self.beacon.as_ref().map_or(Ok(()), Beacon::validate)?;
        for ring in &self.rings {
            interval("marker.look.rings.height_m", ring.height_m)?;
            check::in_range("marker.look.rings.reflectance", ring.reflectance, 0.0, 1.0)?;
        }
        let in_order = self.rings.windows(2).all(|pair| pair[0].height_m[1] <= pair[1].height_m[0] + 1e-9);
        check::consistent(in_order, "marker.look.rings", "overlap or are not in order from the bottom up")
    }
}

fn positive_length(field: &'static str, length_m: f64) -> Result<(), Invalid> {
    check::positive(field, length_m, MAX_LENGTH_M)
}

fn interval(field: &'static str, height_m: [f64; 2]) -> Result<(), Invalid> {
    check::in_range(field, height_m[0], 0.0, MAX_LENGTH_M)?;
    check::in_range(field, height_m[1], 0.0, MAX_LENGTH_M)?;
    check::consistent(height_m[0] < height_m[1], field, "has its lower end above its upper one")
}
