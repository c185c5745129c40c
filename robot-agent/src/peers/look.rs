//! What a cylinder is announced to look like, checked once: rings that all of a team's bodies of one paint share, and the
//! bars that tell them apart.

use std::f64::consts::TAU;

use protocol::id::RobotId;
use protocol::marker::{Look, Marker};

use super::PeerError;

/// Most rings of one look.
pub const MAX_RINGS: usize = 8;
/// Least difference of reflectance between two neighbouring rings that counts as an edge.
const LEAST_STEP: f64 = 0.05;
/// Rings may leave gaps or overlap by this much, metres.
const GAP_M: f64 = 2e-3;

/// Most bar patterns of one paint: more robots of one paint than that are found, but not told apart.
pub const MAX_PATTERNS: usize = 32;

/// Fewer rings than that are no pattern of their own.
const LEAST_UPPER_RINGS: usize = 3;

/// A striped plate.
#[derive(Debug, Clone, PartialEq)]
pub struct PlateLook {
    /// W.
    pub width_m: f64,
    /// H.
    pub height_m: f64,
    /// L₁, from the body's right edge to the foot of the perpendicular from the axis.
    pub left_edge_m: f64,
    /// d.
    pub behind_m: f64,
    /// Lower edge above the floor.
    pub bottom_m: f64,
    /// Heights of the stripes' edges above the floor, from the bottom up, one more than stripes, metres.
    pub edges_m: Vec<f64>,
    /// Of each stripe on the front, 0 … 1.
    pub reflectance: Vec<f64>,
}

/// Bars round a body, and who wears them.
#[derive(Debug, Clone, PartialEq)]
pub struct Pattern {
    /// Who, if only one.
    pub robot: Option<RobotId>,
    /// Kind of marker: cylinder 0, bars 1.
    pub kind: u8,
    /// By their indices in the announcement; none on a plain cylinder.
    pub bars: Vec<Bar>,
    /// The pattern looks the same when it is turned by this much.
    pub period_rad: f64,
    /// Of the narrowest bar.
    pub narrowest_rad: f64,
}

/// One bar.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bar {
    /// Of its middle in the body frame.
    pub azimuth_rad: f64,
    /// Half of its width as an angle at the axis.
    pub half_width_rad: f64,
}

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
    /// Different bars on bodies of this paint, at most [`MAX_PATTERNS`].
    pub patterns: Vec<Pattern>,
}

impl CylinderLook {
    /// The look of a round marker that a robot wears.
    ///
    /// # Errors
    /// [`PeerError::NoLook`] without rings, [`PeerError::BadLook`] where they cannot be used, [`PeerError::NoBars`]
    /// for bars without a width.
    pub fn from_marker(marker: &Marker, robot: Option<RobotId>) -> Result<Self, PeerError> {
        let (radius_m, ends_m, look) = match marker {
            Marker::Cylinder { radius_m, height_m, look } | Marker::Bars { radius_m, height_m, look, .. } => {
                (*radius_m, *height_m, look)
            }
            Marker::Rectangle { .. } => return Err(PeerError::NoLook),
        };
        let bad = |key, value, want| Err(PeerError::BadLook { key, value, want });
        if !(0.01..=2.0).contains(&radius_m) {
            return bad("radius_m", radius_m, "0.01 to 2");
        }
        if !(ends_m[0] >= 0.0 && ends_m[1] > ends_m[0] && ends_m[1] <= 5.0) {
            return bad("height_m", ends_m[1] - ends_m[0], "a lower end from 0 and an upper end above it, up to 5");
        }
        let (edges_m, reflectance) = rings_of(look.as_ref())?;
        let width_deg = look.as_ref().and_then(|look| look.bar_width_deg);
        let pattern = match (marker, width_deg) {
            (Marker::Bars { azimuths_deg, code, .. }, Some(width_deg)) => {
                Pattern::new(robot, azimuths_deg, code.as_deref(), width_deg)?
            }
            (Marker::Bars { .. }, None) => return Err(PeerError::NoBars),
            _ => Pattern { robot: None, kind: Marker::CYLINDER, bars: Vec::new(), period_rad: TAU, narrowest_rad: TAU },
        };
        Ok(Self { radius_m, ends_m, edges_m, reflectance, patterns: vec![pattern] })
    }

    /// Takes another look's patterns in, if its paint is the same.
    pub fn merge(&mut self, other: &Self) -> bool {
        let same = self.radius_m == other.radius_m
            && self.ends_m == other.ends_m
            && self.edges_m == other.edges_m
            && self.reflectance == other.reflectance;
        if !same {
            return false;
        }
        for pattern in &other.patterns {
            let known = self.patterns.iter().position(|own| own.kind == pattern.kind && own.bars == pattern.bars);
            match known {
                Some(n) if self.patterns[n].robot != pattern.robot => self.patterns[n].robot = None,
                Some(_) => {}
                None if self.patterns.len() < MAX_PATTERNS => self.patterns.push(pattern.clone()),
                None => {}
            }
        }
        true
    }

    /// The same without its lowest ring: what shows over a box or a robot that stands before it. `None` where too few rings are left.
    pub fn upper_part(&self) -> Option<Self> {
        (self.reflectance.len() > LEAST_UPPER_RINGS).then(|| Self {
            edges_m: self.edges_m[1..].to_vec(),
            reflectance: self.reflectance[1..].to_vec(),
            ..self.clone()
        })
    }

    /// Kind of marker of a body of this paint whose bars, if it has any, cannot be read.
    pub fn plainest_kind(&self) -> u8 {
        let plainest = self.patterns.iter().min_by_key(|pattern| pattern.bars.len());
        plainest.map_or(Marker::CYLINDER, |pattern| pattern.kind)
    }

    /// Whether any body of this paint has bars.
    pub fn is_barred(&self) -> bool {
        self.patterns.iter().any(|pattern| !pattern.bars.is_empty())
    }

    /// Half way from the darkest to the brightest ring: about it bars are the rings' negative.
    pub fn middle_reflectance(&self) -> f64 {
        let (low, high) = self.reflectance.iter().fold((f64::MAX, f64::MIN), |(l, h), r| (l.min(*r), h.max(*r)));
        0.5 * (low + high)
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

impl PlateLook {
    /// The look of a rectangle.
    ///
    /// # Errors
    /// As [`CylinderLook::from_marker`].
    pub fn from_marker(marker: &Marker) -> Result<Self, PeerError> {
        let Marker::Rectangle { width_m, height_m, left_edge_m, behind_m, bottom_m, look } = marker else {
            return Err(PeerError::NoLook);
        };
        for (key, value, least) in [("width_m", *width_m, 0.05), ("height_m", *height_m, 0.05)] {
            if !(least..=2.0).contains(&value) {
                return Err(PeerError::BadLook { key, value, want: "0.05 to 2" });
            }
        }
        let (edges_m, reflectance) = rings_of(look.as_ref())?;
        Ok(Self {
            width_m: *width_m,
            height_m: *height_m,
            left_edge_m: *left_edge_m,
            behind_m: *behind_m,
            bottom_m: *bottom_m,
            edges_m,
            reflectance,
        })
    }

    /// The plate's stripes, or their negative, as the rings of a slim pillar.
    pub fn pillar(&self) -> CylinderLook {
        let bar = Bar { azimuth_rad: 0.0, half_width_rad: 1.0 };
        CylinderLook {
            radius_m: 0.35 * self.width_m,
            ends_m: [self.bottom_m, self.bottom_m + self.height_m],
            edges_m: self.edges_m.clone(),
            reflectance: self.reflectance.clone(),
            patterns: vec![Pattern {
                robot: None,
                kind: Marker::RECTANGLE,
                bars: vec![bar],
                period_rad: TAU,
                narrowest_rad: 1.0,
            }],
        }
    }
}

/// Edges and reflectances of the rings of a look.
fn rings_of(look: Option<&Look>) -> Result<(Vec<f64>, Vec<f64>), PeerError> {
    let bad = |key, value, want| Err(PeerError::BadLook { key, value, want });
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
    Ok((edges_m, reflectance))
}

impl Pattern {
    fn new(
        robot: Option<RobotId>,
        azimuths_deg: &[f64],
        code: Option<&[u8]>,
        width_deg: f64,
    ) -> Result<Self, PeerError> {
        let bars: Vec<Bar> = azimuths_deg
            .iter()
            .enumerate()
            .map(|(n, azimuth_deg)| {
                let modules = code.and_then(|code| code.get(n)).map_or(1.0, |c| f64::from(*c));
                Bar {
                    azimuth_rad: protocol::angle::wrap(azimuth_deg.to_radians()),
                    half_width_rad: 0.5 * (modules * width_deg).to_radians(),
                }
            })
            .collect();
        if bars.is_empty() {
            return Err(PeerError::NoBars);
        }
        for (n, bar) in bars.iter().enumerate() {
            for other in &bars[..n] {
                let gap = protocol::angle::difference(bar.azimuth_rad, other.azimuth_rad).abs()
                    - bar.half_width_rad
                    - other.half_width_rad;
                if gap < -1e-9 {
                    let want = "bars that do not overlap (azimuths, code, bar_width_deg)";
                    return Err(PeerError::BadLook { key: "azimuths_deg", value: azimuths_deg[n], want });
                }
            }
        }
        let narrowest_rad = bars.iter().map(|bar| 2.0 * bar.half_width_rad).fold(TAU, f64::min);
        let period_rad = period(&bars);
        Ok(Self { robot, kind: Marker::BARS, bars, period_rad, narrowest_rad })
    }
}

/// The smallest turn that takes every bar to another of its width.
fn period(bars: &[Bar]) -> f64 {
    let first = bars[0];
    let turns =
        bars.iter().map(|bar| (bar.azimuth_rad - first.azimuth_rad).rem_euclid(TAU)).filter(|turn| *turn > 1e-6);
    let keeps = |turn: &f64| {
        bars.iter().all(|bar| {
            bars.iter().any(|other| {
                protocol::angle::difference(bar.azimuth_rad + turn, other.azimuth_rad).abs() < 1e-6
                    && (bar.half_width_rad - other.half_width_rad).abs() < 1e-6
            })
        })
    };
    turns.filter(keeps).fold(TAU, f64::min)
}

#[cfg(test)]
mod tests {
    use protocol::marker::Ring;

    use super::*;

    fn bars(azimuths_deg: &[f64], code: Option<Vec<u8>>) -> Result<CylinderLook, PeerError> {
        let ring = |low: f64, reflectance| Ring { height_m: [low, low + 0.1], reflectance };
        let look = Look { rings: vec![ring(0.1, 0.85), ring(0.2, 0.1)], bar_width_deg: Some(20.0), beacon: None };
        let azimuths_deg = azimuths_deg.to_vec();
        let marker = Marker::Bars { radius_m: 0.2, azimuths_deg, height_m: [0.1, 0.3], code, look: Some(look) };
        CylinderLook::from_marker(&marker, RobotId::new("r2").ok())
    }

    #[test]
    fn equal_bars_at_equal_distances_look_the_same_from_many_sides() {
        let period = |azimuths: &[f64], code| bars(azimuths, code).unwrap().patterns[0].period_rad.to_degrees();
        assert!((period(&[0.0, 90.0, 180.0, 270.0], None) - 90.0).abs() < 1e-6);
        assert!((period(&[0.0, 90.0, 180.0, 270.0], Some(vec![1, 2, 1, 2])) - 180.0).abs() < 1e-6);
        assert!((period(&[0.0, 90.0, 180.0, 270.0], Some(vec![1, 2, 1, 3])) - 360.0).abs() < 1e-6);
    }

    #[test]
    fn bodies_of_one_paint_are_one_look_and_keep_their_names_apart() {
        let mut look = bars(&[0.0, 80.0], None).unwrap();
        assert!(look.merge(&bars(&[0.0, 120.0], None).unwrap()));
        assert!(look.merge(&bars(&[0.0, 80.0], None).unwrap()));
        assert_eq!((look.patterns.len(), look.patterns[0].robot), (2, RobotId::new("r2").ok()));
        assert!((look.middle_reflectance() - 0.475).abs() < 1e-12);
    }

    #[test]
    fn bars_that_overlap_or_are_none_are_refused() {
        assert!(matches!(bars(&[0.0, 15.0], None), Err(PeerError::BadLook { key: "azimuths_deg", .. })));
        assert_eq!(bars(&[], None), Err(PeerError::NoBars));
    }
}
