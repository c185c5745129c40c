//! What a cylinder is announced to look like, checked once.

use protocol::marker::Marker;

use super::PeerError;

/// Most rings of one look.
pub const MAX_RINGS: usize = 8;
/// Least difference of reflectance between two neighbouring rings that counts as an edge.
const LEAST_STEP: f64 = 0.05;
/// Rings may leave gaps or overlap by this much, metres.
const GAP_M: f64 = 2e-3;

/// A painted vertical cylinder: radius and rings, from the bottom up.
#[derive(Debug, Clone, PartialEq)]
pub struct CylinderLook {
    /// Of the body, metres.
    pub radius_m: f64,
    /// The announced ends of the marker above the floor, metres: what elevations are reported of.
    pub ends_m: [f64; 2],
    /// Heights of the ring edges above the floor, one more than rings, metres.
    pub edges_m: Vec<f64>,
    /// Diffuse reflectance of each ring, 0 … 1.
    pub reflectance: Vec<f64>,
}

impl CylinderLook {
    /// The look of a cylinder marker.
    ///
    /// # Errors
    /// [`PeerError::NoLook`] without rings, [`PeerError::BadLook`] where they cannot be used, [`PeerError::Unsupported`]
    /// for another kind of marker.
    pub fn from_marker(marker: &Marker) -> Result<Self, PeerError> {
        let (radius_m, ends_m, look) = match marker {
            Marker::Cylinder { radius_m, height_m, look } => (*radius_m, *height_m, look),
            Marker::Bars { .. } => return Err(PeerError::Unsupported { kind: "bars" }),
            Marker::Rectangle { .. } => return Err(PeerError::Unsupported { kind: "rectangle" }),
        };
        let bad = |key, value, want| Err(PeerError::BadLook { key, value, want });
        if !(0.01..=2.0).contains(&radius_m) {
            return bad("radius_m", radius_m, "0.01 to 2");
        }
        if !(ends_m[0] >= 0.0 && ends_m[1] > ends_m[0] && ends_m[1] <= 5.0) {
            return bad("height_m", ends_m[1] - ends_m[0], "a lower end from 0 and an upper end above it, up to 5");
        }
        let rings = match look {
            Some(look) if !look.rings.is_empty() => &look.rings,
            _ => return Err(PeerError::NoLook),
        };
        if rings.len() > MAX_RINGS {
            return bad("rings", rings.len() as f64, "at most 8 rings");
        }
        let mut edges_m = vec![rings[0].height_m[0]];
        for ring in rings {
            let [low, high] = ring.height_m;
            let below = edges_m[edges_m.len() - 1];
            if !((low - below).abs() <= GAP_M && high - low >= 0.01 && high <= 5.0 && low >= 0.0) {
                return bad("rings.height_m", low, "rings from the bottom up, each at least 0.01 high, without gaps");
            }
            if !(0.0..=1.0).contains(&ring.reflectance) {
                return bad("rings.reflectance", ring.reflectance, "0 to 1");
            }
            edges_m.push(high);
        }
        let reflectance: Vec<f64> = rings.iter().map(|ring| ring.reflectance).collect();
        if !reflectance.windows(2).any(|pair| (pair[1] - pair[0]).abs() >= LEAST_STEP) {
            return bad("rings.reflectance", reflectance[0], "at least two neighbouring rings that differ by 0.05");
        }
        Ok(Self { radius_m, ends_m, edges_m, reflectance })
    }

    /// Lower end of the painted part, metres.
    pub fn low_m(&self) -> f64 {
        self.edges_m[0]
    }

    /// Upper end of the painted part, metres.
    pub fn high_m(&self) -> f64 {
        self.edges_m[self.edges_m.len() - 1]
    }
}
