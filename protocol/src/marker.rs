//! What robots wear so that others can measure them: geometry, look, and where features appear.
//!
//! `MATHS.md` §5.2: cylinder (report 5.2.1, erratum to 5-2), vertical bars (5.2.2), rectangle (5.2.3).

use bincode::{Decode, Encode};
use serde::{Deserialize, Serialize};

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
        /// Code that tells the bars apart.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        code: Option<Vec<u8>>,
        /// How it is painted.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        look: Option<Look>,
    },
    /// A flat rectangle of known size.
    Rectangle {
        /// W.
        width_m: f64,
        /// H.
        height_m: f64,
        /// L₁: from the edge to the foot of the perpendicular from the robot's axis.
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
