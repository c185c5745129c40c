//! The room of a scenario: size, lamps, furniture.

use serde::{Deserialize, Serialize};

/// A room with its corner-to-corner origin in the middle of the floor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RoomSpec {
    /// Along x, along y, height.
    pub size_m: [f64; 3],
    /// 1 … 4 lamps under the ceiling.
    pub lamps: Vec<LampSpec>,
    /// Light from everywhere, as a share of what the lamps give in the middle of the floor.
    pub ambient: f64,
    /// That light over time, as [time s, share], straight from one to the next; 1 without. 0.01 … 10.
    pub ambient_light: Vec<[f64; 2]>,
    /// What stands in it.
    pub furniture: Vec<FurnitureSpec>,
}

impl Default for RoomSpec {
    fn default() -> Self {
        let lamp = |x, y| LampSpec { position_m: [x, y], power: 1.0, flicker: 0.0, light: Vec::new() };
        Self {
            size_m: [8.0, 6.0, 2.7],
            lamps: vec![lamp(-2.2, -1.4), lamp(2.2, -1.4), lamp(-2.2, 1.4), lamp(2.2, 1.4)],
            ambient: 0.45,
            ambient_light: Vec::new(),
            furniture: Vec::new(),
        }
    }
}

/// A round lamp under the ceiling.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LampSpec {
    /// Where.
    pub position_m: [f64; 2],
    /// Against the other lamps.
    #[serde(default = "one")]
    pub power: f64,
    /// Amplitude of its mains flicker (100 Hz), as a share of its light: 0 … 0.5.
    #[serde(default)]
    pub flicker: f64,
    /// Its light over time, as [time s, share], straight from one to the next; 1 without. 0 … 10.
    #[serde(default)]
    pub light: Vec<[f64; 2]>,
}

/// A share over time at an instant: straight between its points, held beyond them, 1 where there are none.
pub fn share_at(points: &[[f64; 2]], time_s: f64) -> f64 {
    let after = points.partition_point(|[t, _]| *t <= time_s);
    match (after.checked_sub(1).map(|i| points[i]), points.get(after)) {
        (Some([t0, a]), Some([t1, b])) => a + (b - a) * (time_s - t0) / (t1 - t0),
        (Some([_, share]), None) | (None, Some(&[_, share])) => share,
        (None, None) => 1.0,
    }
}

fn one() -> f64 {
    1.0
}

/// A piece of furniture, by the middle of its foot. A piece on a wall has its front along its own −y: yaw 0 faces −y.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FurnitureSpec {
    /// What.
    pub kind: FurnitureKind,
    /// Middle of the foot.
    pub position_m: [f64; 2],
    /// Counter-clockwise.
    #[serde(default)]
    pub yaw_deg: f64,
    /// Width (own x), depth (own y), height; without it the usual size of the kind.
    pub size_m: Option<[f64; 3]>,
}

/// Kinds of furniture. Posters, doors and whiteboards hang on the wall that is nearest.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FurnitureKind {
    /// Table on four legs.
    Table,
    /// Chair with a back.
    Chair,
    /// Desk with drawers and a screen.
    Desk,
    /// Drawers.
    Cabinet,
    /// Shelves of books.
    Bookcase,
    /// Sofa.
    Sofa,
    /// A plain box.
    Box,
    /// A box with level stripes about as wide as a robot's rings.
    StripedBox,
    /// On the wall.
    Door,
    /// On the wall.
    Poster,
    /// On the wall.
    Whiteboard,
}

impl FurnitureKind {
    /// Usual width, depth, height.
    pub fn usual_size_m(self) -> [f64; 3] {
        match self {
            Self::Table => [1.6, 0.8, 0.74],
            Self::Chair => [0.45, 0.45, 0.88],
            Self::Desk => [1.4, 0.7, 0.74],
            Self::Cabinet => [1.0, 0.45, 1.15],
            Self::Bookcase => [1.2, 0.32, 2.0],
            Self::Sofa => [1.7, 0.8, 0.78],
            Self::Box => [0.4, 0.4, 0.4],
            Self::StripedBox => [0.4, 0.4, 0.5],
            Self::Door => [0.95, 0.0, 2.05],
            Self::Poster => [0.7, 0.0, 1.0],
            Self::Whiteboard => [1.6, 0.0, 1.0],
        }
    }

    /// Height of the lower edge above the floor.
    pub fn bottom_m(self) -> f64 {
        match self {
            Self::Poster => 0.85,
            Self::Whiteboard => 0.8,
            _ => 0.0,
        }
    }

    /// Whether it hangs on a wall.
    pub fn is_flat(self) -> bool {
        matches!(self, Self::Door | Self::Poster | Self::Whiteboard)
    }
}
