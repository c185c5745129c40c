//! A layout in truth and what its robots measure, from plain trigonometry.
//!
//! Unknowns in the order of the bound: x, y, heading of each robot but the first (which stands in the origin and looks along
//! x), then x, y of each target.

use std::f64::consts::TAU;

/// Camera above the floor, metres.
pub const CAMERA_M: f64 = 0.6;
/// Radius of cylinders and circles of bars, metres.
pub const RADIUS_M: f64 = 0.2;
/// Width and height of plates, and their lower edge, metres.
pub const PLATE_M: [f64; 3] = [0.4, 0.5, 0.35];
/// A bar is measured while it is turned to the camera by at least this, radians: 10° inside the outline.
const BAR_MARGIN: f64 = 10.0 * TAU / 360.0;

/// What all robots of a layout wear.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Worn {
    /// Two tangents.
    Cylinder,
    /// So many bars, evenly round, each known by its code.
    Bars(usize),
    /// A plate on the robot's axis, upright, looking forward. Its height is known and measured.
    Plate,
}

/// Robots and targets.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// What they wear.
    pub worn: Worn,
    /// x, y, heading; the first is the origin.
    pub robots: Vec<[f64; 3]>,
    /// x, y.
    pub targets: Vec<[f64; 2]>,
}

/// What is measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum What {
    /// A cylinder's right (−1) or left (+1) tangent.
    Tangent(f64),
    /// The bearing of a bar.
    Bar(usize),
    /// The bearing of the right (0) or left (1) edge of a plate.
    Edge(usize),
    /// The elevation of the lower (0) or upper (1) end of such an edge.
    EdgeEnd(usize, usize),
    /// The bearing of a target.
    Target,
}

/// A single number that somebody measures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measurement {
    /// Robot.
    pub observer: usize,
    /// Robot or target.
    pub other: usize,
    /// Which number.
    pub what: What,
}

impl Scene {
    /// Everything that the robots see of each other and of the targets.
    pub fn measurements(&self) -> Vec<Measurement> {
        let mut all = Vec::new();
        for observer in 0..self.robots.len() {
            for other in (0..self.robots.len()).filter(|o| *o != observer) {
                let seen = self.features(observer, other).into_iter();
                all.extend(seen.map(|what| Measurement { observer, other, what }));
            }
            all.extend((0..self.targets.len()).map(|other| Measurement { observer, other, what: What::Target }));
        }
        all
    }

    fn features(&self, observer: usize, other: usize) -> Vec<What> {
        let ([ox, oy, _], [x, y, heading]) = (self.robots[observer], self.robots[other]);
        match self.worn {
            Worn::Cylinder => vec![What::Tangent(-1.0), What::Tangent(1.0)],
            Worn::Bars(count) => {
                let back = (oy - y).atan2(ox - x);
                let limit = (RADIUS_M / (ox - x).hypot(oy - y)).acos() - BAR_MARGIN;
                let seen = |bar: &usize| turn(heading + bar_azimuth(*bar, count) - back).abs() < limit;
                (0..count).filter(seen).map(What::Bar).collect()
            }
            Worn::Plate => (0..2).flat_map(|e| [What::Edge(e), What::EdgeEnd(e, 0), What::EdgeEnd(e, 1)]).collect(),
        }
    }

    /// The unknowns.
    pub fn unknowns(&self) -> Vec<f64> {
        let robots = self.robots[1..].iter().flatten();
        robots.chain(self.targets.iter().flatten()).copied().collect()
    }

    /// The layout with other unknowns.
    pub fn with(&self, unknowns: &[f64]) -> Self {
        let (robots, targets) = unknowns.split_at(3 * (self.robots.len() - 1));
        let mut scene = self.clone();
        for (robot, x) in scene.robots[1..].iter_mut().zip(robots.chunks(3)) {
            robot.copy_from_slice(x);
        }
        for (target, x) in scene.targets.iter_mut().zip(targets.chunks(2)) {
            target.copy_from_slice(x);
        }
        scene
    }

    /// The exact number.
    pub fn exact(&self, m: &Measurement) -> f64 {
        let [x, y, heading] = self.robots[m.observer];
        let bearing = |p: [f64; 2]| turn((p[1] - y).atan2(p[0] - x) - heading);
        let axis = || {
            let [px, py, _] = self.robots[m.other];
            ([px, py], (px - x).hypot(py - y))
        };
        match m.what {
            What::Target => bearing(self.targets[m.other]),
            What::Tangent(side) => {
                let (axis, range) = axis();
                turn(bearing(axis) + side * (RADIUS_M / range).asin())
            }
            What::Bar(bar) => {
                let Worn::Bars(count) = self.worn else { return f64::NAN };
                let azimuth = bar_azimuth(bar, count);
                bearing(self.on_body(m.other, [RADIUS_M * azimuth.cos(), RADIUS_M * azimuth.sin()]))
            }
            What::Edge(edge) => bearing(self.edge(m.other, edge)),
            What::EdgeEnd(edge, end) => {
                let p = self.edge(m.other, edge);
                let z = PLATE_M[2] + PLATE_M[1] * end as f64;
                ((z - CAMERA_M) / (p[0] - x).hypot(p[1] - y)).atan()
            }
        }
    }

    fn edge(&self, robot: usize, edge: usize) -> [f64; 2] {
        // Seen from in front, the right edge is on the body's left.
        self.on_body(robot, [0.0, if edge == 0 { 0.5 } else { -0.5 } * PLATE_M[0]])
    }

    fn on_body(&self, robot: usize, [forward, left]: [f64; 2]) -> [f64; 2] {
        let [x, y, heading] = self.robots[robot];
        let (s, c) = heading.sin_cos();
        [x + c * forward - s * left, y + s * forward + c * left]
    }
}

/// Azimuth of a bar on the body.
pub fn bar_azimuth(bar: usize, count: usize) -> f64 {
    TAU * bar as f64 / count as f64
}

/// To (−π, π].
pub fn turn(angle: f64) -> f64 {
    let turned = angle.rem_euclid(TAU);
    if turned > 0.5 * TAU { turned - TAU } else { turned }
}
