//! What robots wear, and how they announce it.

use protocol::id::RobotId;
use protocol::marker::{Beacon, Look, Marker, Ring};
use serde::{Deserialize, Serialize};

use super::RobotsSpec;
use crate::world::body;

/// Who wears what.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WearOf {
    /// Which robot, e.g. "r2".
    pub robot: RobotId,
    /// What.
    #[serde(default)]
    pub marker: WearSpec,
    /// A lamp above it that blinks a code.
    #[serde(default)]
    pub beacon: Option<BeaconSpec>,
}

/// What a lamp blinks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BeaconSpec {
    /// Lit (1) and dark (0).
    pub code: String,
    /// Each of them, milliseconds.
    pub bit_ms: u16,
}

/// A body: `kind` selects.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum WearSpec {
    /// A cylinder painted in rings.
    #[default]
    Rings,
    /// The same with vertical bars, in which dark and bright rings are exchanged.
    Bars {
        /// Of the bars' middles in the body frame.
        azimuths_deg: Vec<f64>,
        /// Of a bar of code 1.
        bar_width_deg: f64,
        /// Width of each bar in multiples of `bar_width_deg`; without it all have 1.
        code: Option<Vec<u8>>,
    },
    /// A plate before a mast, striped as the rings are, its back in the negative.
    Plate {
        /// Of the plate.
        width_m: f64,
        /// From the edge on the body's right to the foot of the perpendicular from the axis.
        left_edge_m: f64,
        /// The axis' distance behind the plate's front.
        behind_m: f64,
    },
}

impl RobotsSpec {
    /// What a robot wears.
    pub fn wear_of(&self, robot: &RobotId) -> WearSpec {
        let of = self.wear.iter().find(|of| of.robot == *robot);
        of.map_or(WearSpec::Rings, |of| of.marker.clone())
    }

    /// What its lamp blinks, if it has one.
    pub fn beacon_of(&self, robot: &RobotId) -> Option<&BeaconSpec> {
        self.wear.iter().find(|of| of.robot == *robot).and_then(|of| of.beacon.as_ref())
    }
}

impl WearOf {
    /// As it is announced.
    pub fn marker(&self) -> Marker {
        self.marker.marker(self.beacon.as_ref())
    }
}

impl WearSpec {
    /// As it is announced.
    pub fn marker(&self, beacon: Option<&BeaconSpec>) -> Marker {
        let middle_m = 0.5 * (body::LAMP_M[0] + body::LAMP_M[1]);
        let height_mm = (1e3 * middle_m).round() as u16;
        let beacon = beacon.map(|b| Beacon { height_mm, code: b.code.clone(), bit_ms: b.bit_ms });
        let rings = body::RINGS.iter().map(|r| Ring { height_m: r.height_m, reflectance: r.reflectance }).collect();
        let (radius_m, height_m) = (body::RADIUS_M, body::PAINTED_M);
        match self {
            Self::Rings => {
                Marker::Cylinder { radius_m, height_m, look: Some(Look { rings, bar_width_deg: None, beacon }) }
            }
            Self::Bars { azimuths_deg, bar_width_deg, code } => Marker::Bars {
                radius_m,
                azimuths_deg: azimuths_deg.clone(),
                height_m,
                code: code.clone(),
                look: Some(Look { rings, bar_width_deg: Some(*bar_width_deg), beacon }),
            },
            Self::Plate { width_m, left_edge_m, behind_m } => Marker::Rectangle {
                width_m: *width_m,
                height_m: height_m[1] - height_m[0],
                left_edge_m: *left_edge_m,
                behind_m: *behind_m,
                bottom_m: height_m[0],
                look: Some(Look { rings, bar_width_deg: None, beacon }),
            },
        }
    }
}
